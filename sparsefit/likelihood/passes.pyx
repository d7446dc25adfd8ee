# cython: language_level=3, boundscheck=False, wraparound=False, initializedcheck=False
# cython: cdivision=True
"""The passes of `reference.py`, compiled: equations, notation and layouts stand there."""

from libc.math cimport INFINITY, M_PI, cos, exp, log, sin, sqrt
from libc.string cimport memcpy, memset

import numpy as np

cdef enum:
    OWN = 22
    STATES = 24  # that there is room for, 4 + w
    COLUMNS = 256  # w + p
    WAVES = 64

ctypedef const double[::1] Vector
ctypedef const double[:, ::1] Matrix
ctypedef const Py_ssize_t[::1] Indices
ctypedef double ByOwn[OWN]
ctypedef double ByElement[OWN + 5 * WAVES]


cdef struct Force:  # zero before it is used: entries that are never set stay so
    ByElement own[2]  # by the elements directly
    ByElement air[2]  # of the flow, by the elements


cdef inline void add(Py_ssize_t n, double a, const double* x, double* y) noexcept nogil:
    """y += a x."""
    cdef Py_ssize_t i
    for i in range(n):
        y[i] += a * x[i]


cdef void spread_out(
    Py_ssize_t width, Py_ssize_t n, const double* a, const double* x, double* y
) noexcept nogil:
    """Y (n, width) += a x, of n numbers a and a row x; n is 4 or more."""
    cdef double first = a[0], second = a[1], third = a[2], fourth = a[3]
    cdef Py_ssize_t i
    for i in range(width):
        y[i] += first * x[i]
        y[i + width] += second * x[i]
        y[i + 2 * width] += third * x[i]
        y[i + 3 * width] += fourth * x[i]
    for i in range(4, n):
        add(width, a[i], x, y + i * width)


cdef inline double dot(Py_ssize_t n, const double* x, const double* y) noexcept nogil:
    """x'y."""
    cdef Py_ssize_t i
    cdef double total = 0.0
    for i in range(n):
        total += x[i] * y[i]
    return total


cdef inline void mix(Py_ssize_t w, const double* mixing, double* slope) noexcept nogil:
    """Turn derivatives (w,) by the elements that vary into those by the states that move them."""
    cdef double own[STATES]
    cdef Py_ssize_t i
    memcpy(own, slope, w * sizeof(double))
    memset(slope, 0, w * sizeof(double))
    for i in range(w):
        add(w, own[i], mixing + i * w, slope)


cdef void acceleration(
    const double* element, Py_ssize_t waves, const Py_ssize_t* ids, Py_ssize_t count,
    const double* state, double time, double age, double tx, double ty, Force* force,
    double* value, double* along, double* across,
) noexcept nogil:
    """v' of a state, and the slopes of its components (4 + count,) by the state and by elements.

    age: the time since the start of the log.
    """
    cdef double tau = element[0], scale = element[1], square = element[5], lag = element[11]
    cdef double x = state[0] - lag * state[2], y = state[1] - lag * state[3], t = time - lag
    cdef double swell = 1.0 + element[12], shape = 1.0 + element[13] * time
    cdef double u = 0.0, v = 0.0, xx = 0.0, xy = 0.0, yx = 0.0, ut = 0.0, vt = 0.0
    cdef ByElement* air = force.air
    cdef ByElement* own = force.own
    cdef double kx, ky, omega, slope, phase, c, s, px, py
    cdef const double* wave = element + OWN
    cdef Py_ssize_t j, i, k
    for j in range(waves):
        kx, ky, omega = wave[5 * j], wave[5 * j + 1], wave[5 * j + 4]
        phase = kx * x + ky * y - omega * t
        c, s = swell * shape * cos(phase), swell * shape * sin(phase)
        slope = wave[5 * j + 3] * c - wave[5 * j + 2] * s
        px = -ky * (wave[5 * j + 2] * c + wave[5 * j + 3] * s)
        py = kx * (wave[5 * j + 2] * c + wave[5 * j + 3] * s)
        u, v = u + ky * slope, v - kx * slope
        xx, xy, yx = xx + kx * px, xy + ky * px, yx + kx * py
        ut, vt = ut - omega * px, vt - omega * py
        k = OWN + 5 * j
        air[0][k], air[1][k] = px * x, py * x - slope
        air[0][k + 1], air[1][k + 1] = px * y + slope, py * y
        air[0][k + 2], air[1][k + 2] = -ky * s, kx * s
        air[0][k + 3], air[1][k + 3] = ky * c, -kx * c
        air[0][k + 4], air[1][k + 4] = -px * t, -py * t
    cdef double rx = u + element[6] + element[8] * time - state[2]
    cdef double ry = v + element[7] + element[9] * time - state[3]
    cdef double speed = sqrt(rx * rx + ry * ry + 1e-300)
    c, s = (cos(element[2]), sin(element[2])) if element[2] != 0.0 else (1.0, 0.0)
    cdef double hx = c * tx - s * ty, hy = s * tx + c * ty
    cdef double pace = 1.0 / tau, ahead = 1.0 / (tau - lag), light = 1.0 / (1.0 + element[10] * age)
    cdef double weight = light * tau * ahead, factor = light * ahead
    cdef double stretch = 1.0 + square * speed, bend = factor * square / speed
    cdef double fx = factor * stretch * rx, fy = factor * stretch * ry
    cdef double ax = fx + weight * (scale * hx + element[3])
    cdef double ay = fy + weight * (scale * hy + element[4])
    cdef double axx = factor * stretch + bend * rx * rx
    cdef double axy = bend * rx * ry
    cdef double ayy = factor * stretch + bend * ry * ry
    value[0], value[1] = ax, ay
    along[0], along[1] = axx * xx + axy * yx, axx * xy - axy * xx
    across[0], across[1] = axy * xx + ayy * yx, axy * xy - ayy * xx
    along[2], along[3] = -axx - lag * along[0], -axy - lag * along[1]
    across[2], across[3] = -axy - lag * across[0], -ayy - lag * across[1]
    if count == 0:
        return
    air[0][6] = air[1][7] = 1.0
    air[0][8] = air[1][9] = time
    air[0][11] = -(xx * state[2] + xy * state[3]) - ut
    air[1][11] = -(yx * state[2] - xx * state[3]) - vt
    air[0][12], air[1][12] = u / swell, v / swell
    air[0][13], air[1][13] = u * time / shape, v * time / shape
    own[0][0] = -pace * (fx + lag * ahead * ax)
    own[1][0] = -pace * (fy + lag * ahead * ay)
    own[0][1], own[1][1] = weight * hx, weight * hy
    own[0][2], own[1][2] = -weight * scale * hy, weight * scale * hx
    own[0][3] = own[1][4] = weight
    own[0][5], own[1][5] = factor * speed * rx, factor * speed * ry
    own[0][10], own[1][10] = -ax * age * light, -ay * age * light
    own[0][11], own[1][11] = ax * ahead, ay * ahead
    for i in range(count):
        k = ids[i]
        along[4 + i] = own[0][k] + axx * air[0][k] + axy * air[1][k]
        across[4 + i] = own[1][k] + axy * air[0][k] + ayy * air[1][k]


cdef struct Step:
    double following[STATES]
    double fading[STATES]
    double slope[4][STATES + COLUMNS]


cdef void transition(
    const double* elements, Py_ssize_t waves, const Py_ssize_t* ids, Py_ssize_t w, Py_ssize_t p,
    const double* mixing, const double* rates, const double* pace, double time, double start,
    double step, const double* push, const double* track, double* full, Force* force, Step* result,
) noexcept nogil:
    """One step of Runge and Kutta's fourth order with its derivatives; `ids` are walkers first."""
    cdef double state[4]
    cdef double rate[6][2]
    cdef double slope[6][2][STATES + COLUMNS]
    cdef double share, reach, before = 0.0, sixth = step / 6.0
    cdef double uu, uv, vu, vv, xx, xy, yx, yy, x, y, dx, dy
    cdef double* u
    cdef double* v
    cdef Py_ssize_t k, i, j, stage, width = 4 + w + p
    memset(rate, 0, 4 * sizeof(double))  # nothing comes before the first
    for k in range(4):
        memset(slope[k // 2][k % 2], 0, width * sizeof(double))
    for stage in range(2, 6):
        share = 0.5 if stage == 3 or stage == 4 else (0.0 if stage == 2 else 1.0)
        reach = share * step
        for k in range(2):
            state[k] = track[k] + reach * (track[2 + k] + before * rate[stage - 2][k])
            state[2 + k] = track[2 + k] + reach * rate[stage - 1][k]
        for i in range(w):
            full[ids[i]] = elements[ids[i]]
            if stage != 4:
                result.fading[i] = exp(-rates[i] * pace[i] * reach)
        for i in range(w):
            for j in range(w):
                full[ids[j]] += mixing[j * w + i] * result.fading[i] * track[4 + i]
        u, v = slope[stage][0], slope[stage][1]
        acceleration(
            full, waves, ids, w + p, state, time + reach, time + reach - start,
            (1.0 - share) * push[0] + share * push[2],
            (1.0 - share) * push[1] + share * push[3], force, rate[stage], u, v,
        )
        for i in range(w):
            u[4 + i] *= result.fading[i]
            v[4 + i] *= result.fading[i]
        uu, uv, vu, vv = reach * u[2], reach * u[3], reach * v[2], reach * v[3]
        xx, xy, yx, yy = reach * u[0], reach * u[1], reach * v[0], reach * v[1]
        u[2], u[3], v[2], v[3] = u[2] + xx, u[3] + xy, v[2] + yx, v[3] + yy
        for i in range(width):  # x' = v: the slopes of v' follow from those of two stages before
            x, y = slope[stage - 1][0][i], slope[stage - 1][1][i]
            dx, dy = before * slope[stage - 2][0][i], before * slope[stage - 2][1][i]
            u[i] += uu * x + uv * y + xx * dx + xy * dy
            v[i] += vu * x + vv * y + yx * dx + yy * dy
        before = reach
    for k in range(2):
        x, y = rate[2][k] + rate[3][k] + rate[4][k], rate[3][k] + rate[4][k] + rate[5][k]
        result.following[k] = track[k] + step * (track[2 + k] + sixth * x)
        result.following[2 + k] = track[2 + k] + sixth * (x + y)
        for i in range(width):
            x = slope[3][k][i] + slope[4][k][i]
            result.slope[k][i] = step * sixth * (slope[2][k][i] + x)
            result.slope[2 + k][i] = sixth * (slope[2][k][i] + 2.0 * x + slope[5][k][i])
        result.slope[k][k] += 1.0
        result.slope[k][2 + k] += step
        result.slope[2 + k][2 + k] += 1.0
    for k in range(4):
        mix(w, mixing, result.slope[k] + 4)  # states of one process fade alike
    for i in range(w):
        result.following[4 + i] = result.fading[i] * track[4 + i]


cdef void observation(
    const double* elements, const Py_ssize_t* walkers, Py_ssize_t w, const double* mixing,
    const double* state, double* full, double* reading, double (*by_state)[STATES], ByOwn* by_element,
) noexcept nogil:
    """The readings (4,) of a state, H (4, 4 + w), the derivatives by the elements (4, 22).

    Entries that are zero whatever the state are not set.
    """
    cdef Py_ssize_t i, c
    for i in range(w):
        full[walkers[i]] = elements[walkers[i]]
    for i in range(w):
        full[walkers[i]] += dot(w, mixing + i * w, state + 4)
    cdef double place = full[14], rate = full[15], turn = full[18]
    cdef double co = cos(turn) if turn != 0.0 else 1.0, si = sin(turn) if turn != 0.0 else 0.0
    cdef double vx = co * state[2] - si * state[3], vy = si * state[2] + co * state[3]
    reading[0], reading[1] = place * state[0] + full[20], place * state[1] + full[21]
    reading[2], reading[3] = rate * vx + full[16], rate * vy + full[17]
    by_element[0][14], by_element[1][14] = state[0], state[1]
    by_element[2][15], by_element[3][15] = vx, vy
    by_element[2][16] = by_element[3][17] = by_element[0][20] = by_element[1][21] = 1.0
    by_element[2][18], by_element[3][18] = -rate * vy, rate * vx
    by_element[0][19], by_element[1][19] = -place * state[2], -place * state[3]
    by_state[0][0] = by_state[1][1] = place
    by_state[2][2] = by_state[3][3] = rate * co
    by_state[2][3], by_state[3][2] = -rate * si, rate * si
    for c in range(4):
        for i in range(w):
            by_state[c][4 + i] = by_element[c][walkers[i]]
        mix(w, mixing, by_state[c] + 4)


def _room(states, columns, waves):
    """Raise `MemoryError` where a model has more than the compiled passes have room for."""
    if states > STATES or columns > COLUMNS or waves > WAVES:
        raise MemoryError(f"{states} states, {columns} columns and {waves} waves are too many")


def forward(
    space, nodes, Matrix track, Py_ssize_t first, Py_ssize_t end, last,
    double[:, ::1] rows, double[:, ::1] sums, double[:, ::1] stored,
):
    """Filter a block of nodes, as `reference.forward` does; rows and sums change in place."""
    cdef Vector elements = space.elements, rates = np.append(space.rates, 0.0), time = nodes.time
    cdef Matrix kicks = space.kicks, noise = space.noise, pace = space.pace
    cdef Vector mixing = np.append(space.mixing, 0.0)
    cdef Matrix push = nodes.push, measured = nodes.measured, weights = nodes.weights
    cdef Matrix adjoint = track if last is None else last.adjoint
    cdef Matrix scores = track if last is None else last.scores
    cdef Py_ssize_t w = rates.shape[0] - 1, n = 4 + w, width = rows.shape[1]
    cdef Py_ssize_t c = n + 1 + space.chain.shape[1], levels = width - c
    cdef Py_ssize_t waves = (elements.shape[0] - OWN) // 5
    # The elements that parameters move, and the links (element, parameter) of the chain rule.
    columns = np.flatnonzero(space.chain.any(axis=1))
    sources, targets = np.nonzero(space.chain[columns])
    cdef Indices ids = np.concatenate([space.walkers, columns, [0]]).astype(np.intp)
    cdef Indices source = np.append(w + sources, 0).astype(np.intp)
    cdef Indices target = np.append(n + 1 + targets, 0).astype(np.intp)
    cdef Vector slope = np.append(space.chain[columns][sources, targets], 0.0)
    cdef Py_ssize_t moving = len(columns), links = len(sources)
    cdef Py_ssize_t of_sensors = np.sum(columns[sources] < OWN)  # they stand first
    _room(n, max(w + moving, width), waves)
    cdef double[::1] full = np.array(elements)
    cdef double[::1] kick = np.sum(kicks, axis=0), spread = np.sum(noise, axis=0)
    cdef double[:, ::1] fresh = np.empty_like(rows)
    cdef ByOwn by_element[4]
    cdef double by_state[4][STATES]
    cdef double response[STATES + COLUMNS]  # H P, -e and G
    cdef double gain[STATES]
    cdef double reading[4]
    cdef double total = 0.0, product, size, inverse, dt, excess
    cdef double* saved = NULL
    cdef const double* h
    cdef Step step
    cdef Force force
    cdef Py_ssize_t i, j, k, channel
    memset(&force, 0, sizeof(force))
    memset(by_state, 0, sizeof(by_state))
    memset(by_element, 0, sizeof(by_element))
    for i in range(first, end):
        if stored is not None:
            saved = &stored[i - first, 0]
            for k in range(n):
                memcpy(saved + k * c, &rows[k, 0], c * sizeof(double))
            saved += n * c
        observation(
            &elements[0], &ids[0], w, &mixing[0], &track[i, 0], &full[0], reading, by_state,
            by_element,
        )
        product = 1.0
        for channel in range(4):
            if weights[i, channel] <= 0.0:
                continue
            h = by_state[channel]
            memset(response, 0, width * sizeof(double))
            response[n] = reading[channel] - measured[i, channel]
            for k in range(of_sensors):
                response[target[k]] += slope[k] * by_element[channel][ids[source[k]]]
            for k in range(levels):
                response[c + k] = noise[k, channel] * scores[i, channel] / weights[i, channel]
            for k in range(n):
                if h[k] != 0.0:
                    add(width, h[k], &rows[k, 0], response)
            size = spread[channel] / weights[i, channel] + dot(n, h, response)
            if not size > 0.0:  # the covariance has lost its sign
                return INFINITY
            product *= 2.0 * M_PI * size
            inverse = 1.0 / size
            for k in range(n):
                gain[k] = -response[k] * inverse
            spread_out(width, n, gain, response, &rows[0, 0])
            for k in range(width - n):  # the lower triangle
                add(k + 1, response[n + k] * inverse, response + n, &sums[k, 0])
            if stored is not None:
                memcpy(saved + channel * (n + c + 1), h, n * sizeof(double))
                memcpy(saved + channel * (n + c + 1) + n, response, c * sizeof(double))
                saved[channel * (n + c + 1) + n + c] = inverse
        total += log(product)
        if i + 1 == time.shape[0]:
            break
        dt = time[i + 1] - time[i]
        transition(
            &elements[0], waves, &ids[0], w, moving, &mixing[0], &rates[0], &pace[i, n], time[i],
            time[0], dt, &push[i, 0], &track[i, 0], &full[0], &force, &step,
        )
        for k in range(n):
            for j in range(levels):
                rows[k, c + j] += 0.5 * dt * pace[i, k] * kicks[j, k] * adjoint[i, n + k]
            rows[k, k] += 0.5 * dt * pace[i, k] * kick[k]
        memset(&fresh[0, 0], 0, n * width * sizeof(double))
        for j in range(links):
            for k in range(4):
                fresh[k, target[j]] += slope[j] * step.slope[k][4 + source[j]]
        for k in range(n):
            fresh[k, n] = step.following[k] - track[i + 1, k]
        for k in range(n):  # F times P, delta and V
            for j in range(4):
                gain[j] = step.slope[j][k]
            spread_out(width, 4, gain, &rows[k, 0], &fresh[0, 0])
            if k >= 4:
                add(width, step.fading[k - 4], &rows[k, 0], &fresh[k, 0])
        for k in range(n):  # and P times F'
            for j in range(k + 1):
                rows[k, j] = dot(n, &fresh[k, 0], step.slope[j]) if j < 4 else (
                    fresh[k, j] * step.fading[j - 4]
                )
                rows[j, k] = rows[k, j]
            rows[k, k] += 0.5 * dt * pace[i, k] * kick[k]
            memcpy(&rows[k, n], &fresh[k, n], (width - n) * sizeof(double))
            for j in range(levels):
                rows[k, c + j] += 0.5 * dt * pace[i, k] * kicks[j, k] * adjoint[i + 1, k]
            if k < 2:  # the first half kick has too much of the position
                excess = dt / 6.0 * step.slope[k][2 + k] * step.slope[k][2 + k]
                rows[k, k] -= excess * kick[2 + k]
                for j in range(levels):
                    rows[k, c + j] -= excess * kicks[j, 2 + k] * adjoint[i + 1, k]
            if stored is not None and k < 4:
                memcpy(saved + 4 * (n + c + 1) + k * n, step.slope[k], n * sizeof(double))
    for k in range(width - n):
        for j in range(k):
            sums[j, k] = sums[k, j]
    return total


def backward(
    space, nodes, Py_ssize_t first, Py_ssize_t end, Vector change, Matrix stored,
    double[:, ::1] carried, result, double[:, ::1] sums,
):
    """Run the adjoint through a block backwards, as `reference.backward` does."""
    cdef Vector rates = space.rates, time = nodes.time, noise = np.sum(space.noise, axis=0)
    cdef Matrix weights = nodes.weights, pace = space.pace
    cdef double[:, ::1] smoothed = result.track, adjoint = result.adjoint, scores = result.scores
    cdef Py_ssize_t n = carried.shape[1], q = change.shape[0], c = n + q, i, j, k, channel
    _room(n, q, 0)
    cdef double r[STATES]
    cdef double new[STATES]
    cdef double gain[STATES]
    cdef double along[STATES]
    cdef double fade[STATES]
    cdef double cov[STATES][STATES]
    cdef double half[STATES][STATES]
    cdef double dt, u, spread, innovation, inverse, part
    cdef const double* saved
    cdef const double* slope
    cdef const double* h
    memcpy(r, &carried[0, 0], n * sizeof(double))
    for k in range(n):
        memcpy(cov[k], &carried[1 + k, 0], n * sizeof(double))
    with nogil:
        for i in range(end - 1, first - 1, -1):
            saved = &stored[i - first, 0]
            if i + 1 < time.shape[0]:
                dt = time[i + 1] - time[i]
                slope = saved + stored.shape[1] - 4 * n
                for k in range(n):
                    sums[k, 0] += 0.5 * dt * pace[i, k] * r[k] * r[k]
                    sums[k, 1] += 0.5 * dt * pace[i, k] * cov[k][k]
                    if k < 2:
                        part = dt / 6.0 * slope[k * n + 2 + k] * slope[k * n + 2 + k]
                        sums[2 + k, 0] -= part * r[k] * r[k]
                        sums[2 + k, 1] -= part * cov[k][k]
                    fade[k] = exp(-rates[k - 4] * pace[i, k + n - 4] * dt) if k >= 4 else 0.0
                    new[k] = fade[k] * r[k]
                for k in range(n):  # N F, then F' times it
                    for j in range(n):
                        half[k][j] = fade[j] * cov[k][j]
                    for j in range(4):
                        add(n, cov[k][j], slope + j * n, half[k])
                for j in range(4):
                    add(n, r[j], slope + j * n, new)
                for k in range(n):
                    r[k] = new[k]
                    for j in range(k + 1):
                        part = fade[k] * half[k][j]
                        for channel in range(4):
                            part += slope[channel * n + k] * half[channel][j]
                        cov[k][j] = cov[j][k] = part
                    sums[k, 0] += 0.5 * dt * pace[i, k] * r[k] * r[k]
                    sums[k, 1] += 0.5 * dt * pace[i, k] * cov[k][k]
            memcpy(&adjoint[i, n], r, n * sizeof(double))
            memset(&scores[i, 0], 0, 12 * sizeof(double))
            for channel in range(3, -1, -1):
                if weights[i, channel] <= 0.0:
                    continue
                h = saved + n * c + channel * (n + c + 1)
                inverse, innovation = h[n + c], -dot(q, h + 2 * n, &change[0])
                for k in range(n):
                    gain[k] = h[n + k] * inverse
                for k in range(n):
                    along[k] = dot(n, cov[k], gain)
                u, spread = innovation * inverse - dot(n, gain, r), inverse + dot(n, along, gain)
                add(n, u, h, r)
                for k in range(n):
                    add(n, spread * h[k] - along[k], h, cov[k])
                    add(n, -h[k], along, cov[k])
                scores[i, channel], scores[i, 4 + channel] = u, u / sqrt(spread)
                scores[i, 8 + channel] = innovation * sqrt(inverse)
                sums[n + channel, 0] += noise[channel] / weights[i, channel] * u * u
                sums[n + channel, 1] += noise[channel] / weights[i, channel] * spread
            memcpy(&adjoint[i, 0], r, n * sizeof(double))
            for k in range(n):
                smoothed[i, k] += dot(n, saved + k * c, r) + dot(q, saved + k * c + n, &change[0])
    memcpy(&carried[0, 0], r, n * sizeof(double))
    for k in range(n):
        memcpy(&carried[1 + k, 0], cov[k], n * sizeof(double))
