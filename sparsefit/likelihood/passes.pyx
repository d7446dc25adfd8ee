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


cdef struct Force:
    double value[2]
    double by_state[2][4]
    double by_element[2][COLUMNS]


cdef void acceleration(
    const double* element, Py_ssize_t waves, const Py_ssize_t* ids, Py_ssize_t count,
    const double* state, double time, double tx, double ty, Force* force,
) noexcept nogil:
    """v' of a state, and its derivatives by the state and by `count` elements."""
    cdef double tau = element[0], scale = element[1], drag = element[5], lag = element[11]
    cdef double x = state[0] - lag * state[2], y = state[1] - lag * state[3], t = time - lag
    cdef double swell = 1.0 + element[12], shape = 1.0 + element[13] * time
    cdef double size = swell * shape
    cdef double u = 0.0, v = 0.0, xx = 0.0, xy = 0.0, yx = 0.0, ut = 0.0, vt = 0.0
    cdef double sines[WAVES]
    cdef double cosines[WAVES]
    cdef double kx, ky, psi, slope, phase, c, s, dx, dy, ax, ay
    cdef const double* wave = element + OWN
    cdef Py_ssize_t j, i, kind
    for j in range(waves):
        kx, ky = wave[5 * j], wave[5 * j + 1]
        phase = kx * x + ky * y - wave[5 * j + 4] * t
        c, s = cos(phase), sin(phase)
        sines[j], cosines[j] = s, c
        slope = wave[5 * j + 3] * c - wave[5 * j + 2] * s
        psi = wave[5 * j + 2] * c + wave[5 * j + 3] * s
        u += ky * slope
        v -= kx * slope
        xx -= kx * ky * psi
        xy -= ky * ky * psi
        yx += kx * kx * psi
        ut += wave[5 * j + 4] * ky * psi
        vt -= wave[5 * j + 4] * kx * psi
    xx *= size
    xy *= size
    yx *= size
    cdef double rx = size * u + element[6] + element[8] * time - state[2]
    cdef double ry = size * v + element[7] + element[9] * time - state[3]
    cdef double speed = sqrt(rx * rx + ry * ry + 1e-300) if drag != 0.0 or count else 0.0
    cdef double ct = 1.0, st = 0.0
    if element[2] != 0.0:
        ct, st = cos(element[2]), sin(element[2])
    cdef double hx = ct * tx - st * ty, hy = st * tx + ct * ty
    cdef double mass = 1.0 + element[10] * time
    cdef double weight = 1.0 / (mass * (1.0 - lag / tau))
    cdef double stretch = 1.0 + drag * speed
    cdef double fx = stretch * rx / tau, fy = stretch * ry / tau
    force.value[0] = weight * (fx + scale * hx + element[3])
    force.value[1] = weight * (fy + scale * hy + element[4])
    cdef double part = drag / speed if drag != 0.0 else 0.0
    cdef double factor = weight / tau
    cdef double axx = factor * (stretch + part * rx * rx), axy = factor * part * rx * ry
    cdef double ayy = factor * (stretch + part * ry * ry)
    force.by_state[0][0] = axx * xx + axy * yx
    force.by_state[0][1] = axx * xy - axy * xx
    force.by_state[1][0] = axy * xx + ayy * yx
    force.by_state[1][1] = axy * xy - ayy * xx
    force.by_state[0][2] = -axx - lag * force.by_state[0][0]
    force.by_state[0][3] = -axy - lag * force.by_state[0][1]
    force.by_state[1][2] = -axy - lag * force.by_state[1][0]
    force.by_state[1][3] = -ayy - lag * force.by_state[1][1]
    cdef double lagged = lag / (tau * (tau - lag))
    for i in range(count):
        dx = dy = ax = ay = 0.0  # of the relative wind, of the acceleration
        if ids[i] >= OWN:
            j = (ids[i] - OWN) // 5
            kind = (ids[i] - OWN) - 5 * j
            kx, ky = wave[5 * j], wave[5 * j + 1]
            c, s = cosines[j], sines[j]
            if kind == 2:
                dx, dy = -ky * s, kx * s
            elif kind == 3:
                dx, dy = ky * c, -kx * c
            else:
                psi = wave[5 * j + 2] * c + wave[5 * j + 3] * s
                if kind == 4:
                    dx, dy = ky * psi * t, -kx * psi * t
                else:
                    slope = wave[5 * j + 3] * c - wave[5 * j + 2] * s
                    if kind == 0:
                        dx, dy = -ky * psi * x, kx * psi * x - slope
                    else:
                        dx, dy = slope - ky * psi * y, kx * psi * y
            dx *= size
            dy *= size
        elif ids[i] == 0:
            ax = -weight * fx / tau - lagged * force.value[0]
            ay = -weight * fy / tau - lagged * force.value[1]
        elif ids[i] == 1:
            ax, ay = weight * hx, weight * hy
        elif ids[i] == 2:
            ax, ay = -weight * scale * hy, weight * scale * hx
        elif ids[i] == 3:
            ax = weight
        elif ids[i] == 4:
            ay = weight
        elif ids[i] == 5:
            ax, ay = factor * speed * rx, factor * speed * ry
        elif ids[i] == 6:
            dx = 1.0
        elif ids[i] == 7:
            dy = 1.0
        elif ids[i] == 8:
            dx = time
        elif ids[i] == 9:
            dy = time
        elif ids[i] == 10:
            ax, ay = -force.value[0] * time / mass, -force.value[1] * time / mass
        elif ids[i] == 11:
            ax, ay = force.value[0] / (tau - lag), force.value[1] / (tau - lag)
            dx = -(xx * state[2] + xy * state[3]) - size * ut
            dy = -(yx * state[2] - xx * state[3]) - size * vt
        elif ids[i] == 12:
            dx, dy = shape * u, shape * v
        elif ids[i] == 13:
            dx, dy = swell * time * u, swell * time * v
        force.by_element[0][i] = ax + axx * dx + axy * dy
        force.by_element[1][i] = ay + axy * dx + ayy * dy


cdef struct Step:
    double following[STATES]
    double fading[STATES]
    double slope[4][STATES + COLUMNS]


cdef void transition(
    const double* elements, Py_ssize_t waves, const Py_ssize_t* ids, Py_ssize_t w, Py_ssize_t p,
    const double* rates, double time, double step, const double* thrust, const double* track,
    double* full, Step* result,
) noexcept nogil:
    """One step of Runge and Kutta's fourth order with its derivatives; `ids` are walkers first."""
    cdef Force force
    cdef double state[4]
    cdef double speed[4]
    cdef double tangent[4][STATES + COLUMNS]
    cdef double moved[4][STATES + COLUMNS]
    cdef double total[4][STATES + COLUMNS]
    cdef double whole[4]
    cdef double share, weight, reach, fade, a, b, c, d
    cdef Py_ssize_t k, i, stage, width = 4 + w + p
    memset(speed, 0, sizeof(speed))
    memset(whole, 0, sizeof(whole))
    for k in range(4):
        memset(tangent[k], 0, width * sizeof(double))
        memset(total[k], 0, width * sizeof(double))
    for stage in range(4):
        share = 0.5 if stage == 1 or stage == 2 else (0.0 if stage == 0 else 1.0)
        weight = 2.0 if stage == 1 or stage == 2 else 1.0
        reach = share * step
        for k in range(4):
            state[k] = track[k] + reach * speed[k]
            for i in range(width):
                moved[k][i] = reach * tangent[k][i]
            moved[k][k] += 1.0
        for i in range(w):
            full[ids[i]] = elements[ids[i]]
        for i in range(w):
            result.fading[i] = exp(-rates[i] * reach) if rates[i] != 0.0 else 1.0
            full[ids[i]] += result.fading[i] * track[4 + i]
        acceleration(
            full, waves, ids, w + p, state, time + reach,
            (1.0 - share) * thrust[0] + share * thrust[2],
            (1.0 - share) * thrust[1] + share * thrust[3], &force,
        )
        for i in range(w):
            force.by_element[0][i] *= result.fading[i]
            force.by_element[1][i] *= result.fading[i]
        speed[0], speed[1] = state[2], state[3]
        speed[2], speed[3] = force.value[0], force.value[1]
        for k in range(2):
            a, b = force.by_state[k][0], force.by_state[k][1]
            c, d = force.by_state[k][2], force.by_state[k][3]
            for i in range(width):
                tangent[k][i] = moved[2 + k][i]
            for i in range(width):
                tangent[2 + k][i] = (
                    a * moved[0][i] + b * moved[1][i] + c * moved[2][i] + d * moved[3][i]
                )
            for i in range(w + p):
                tangent[2 + k][4 + i] += force.by_element[k][i]
        for k in range(4):
            whole[k] += weight * speed[k]
            for i in range(width):
                total[k][i] += weight * tangent[k][i]
    for k in range(4):
        result.following[k] = track[k] + step / 6.0 * whole[k]
        for i in range(width):
            result.slope[k][i] = step / 6.0 * total[k][i]
        result.slope[k][k] += 1.0
    for i in range(w):
        result.following[4 + i] = result.fading[i] * track[4 + i]


cdef void observation(
    const double* elements, const Py_ssize_t* ids, Py_ssize_t w, Py_ssize_t p,
    const double* state, double* full, double* reading, double* by_state, double* by_column,
) noexcept nogil:
    """The readings (4,) of a state, H (4, 4 + w) and D (4, p), `by_column` (4, w + p)."""
    cdef Py_ssize_t i, n = 4 + w, width = w + p
    for i in range(w):
        full[ids[i]] = elements[ids[i]]
    for i in range(w):
        full[ids[i]] += state[4 + i]
    cdef double place = full[14], rate = full[15], c = 1.0, s = 0.0
    if full[18] != 0.0:
        c, s = cos(full[18]), sin(full[18])
    cdef double vx = c * state[2] - s * state[3], vy = s * state[2] + c * state[3]
    reading[0], reading[1] = place * state[0] + full[20], place * state[1] + full[21]
    reading[2], reading[3] = rate * vx + full[16], rate * vy + full[17]
    memset(by_state, 0, 4 * n * sizeof(double))
    memset(by_column, 0, 4 * width * sizeof(double))
    by_state[0] = by_state[n + 1] = place
    by_state[2 * n + 2] = by_state[3 * n + 3] = rate * c
    by_state[2 * n + 3], by_state[3 * n + 2] = -rate * s, rate * s
    for i in range(width):
        if ids[i] == 14:
            by_column[i], by_column[width + i] = state[0], state[1]
        elif ids[i] == 15:
            by_column[2 * width + i], by_column[3 * width + i] = vx, vy
        elif ids[i] == 16:
            by_column[2 * width + i] = 1.0
        elif ids[i] == 17:
            by_column[3 * width + i] = 1.0
        elif ids[i] == 18:
            by_column[2 * width + i], by_column[3 * width + i] = -rate * vy, rate * vx
        elif ids[i] == 19:
            by_column[i], by_column[width + i] = -place * state[2], -place * state[3]
        elif ids[i] == 20:
            by_column[i] = 1.0
        elif ids[i] == 21:
            by_column[width + i] = 1.0
    for i in range(w):
        by_state[4 + i] += by_column[i]
        by_state[n + 4 + i] += by_column[width + i]
        by_state[2 * n + 4 + i] += by_column[2 * width + i]
        by_state[3 * n + 4 + i] += by_column[3 * width + i]


def transitions(
    Vector elements, Indices walkers, Vector rates, Indices columns, Vector time, Matrix thrust,
    Matrix track,
):
    """Return the step from every node to the next, and its derivatives, as the reference does."""
    cdef Py_ssize_t w = walkers.shape[0], p = columns.shape[0], m = time.shape[0] - 1, i, k
    cdef Py_ssize_t n = 4 + w, waves = (elements.shape[0] - OWN) // 5
    _room(n, w + p, waves)
    cdef Py_ssize_t[::1] ids = np.concatenate([walkers, columns, [0]]).astype(np.intp)
    cdef double[::1] full = np.array(elements), decay = np.append(rates, 0.0)
    cdef double[:, ::1] following = np.empty((m, n))
    cdef double[:, :, ::1] slopes = np.empty((m, 4, n + p))
    cdef Step step
    for i in range(m):
        transition(
            &elements[0], waves, &ids[0], w, p, &decay[0], time[i], time[i + 1] - time[i],
            &thrust[i, 0], &track[i, 0], &full[0], &step,
        )
        memcpy(&following[i, 0], step.following, n * sizeof(double))
        for k in range(4):
            memcpy(&slopes[i, k, 0], step.slope[k], (n + p) * sizeof(double))
    return np.asarray(following), np.asarray(slopes)


def _room(states, columns, waves):
    """Raise `MemoryError` where a model has more than the compiled passes have room for."""
    if states > STATES or columns > COLUMNS or waves > WAVES:
        raise MemoryError(f"{states} states, {columns} columns and {waves} waves are too many")


def forward(
    Vector elements, Indices walkers, Vector rates, Indices columns, Matrix kicks, Matrix noise,
    Vector time, Matrix thrust, Matrix measured, Matrix weights, Matrix track, Matrix adjoint,
    Matrix scores, double[:, ::1] state, double[:, ::1] stored,
):
    """Filter a block of nodes, as `reference.forward` does; the state is changed in place."""
    cdef Py_ssize_t w = walkers.shape[0], p = columns.shape[0], n = 4 + w
    cdef Py_ssize_t m = measured.shape[0], waves = (elements.shape[0] - OWN) // 5
    cdef Py_ssize_t levels = kicks.shape[0] if adjoint.shape[0] else 0, q = p + levels
    _room(n, w + q, waves)
    cdef Py_ssize_t[::1] ids = np.concatenate([walkers, columns, [0]]).astype(np.intp)
    cdef double[::1] full = np.array(elements), decay = np.append(rates, 0.0)
    cdef double[::1] kick = np.sum(kicks, axis=0), spread = np.sum(noise, axis=0)
    cdef double[:, ::1] v = np.empty((n, q + 1)), fresh = np.empty((n, q + 1))
    cdef double[:, ::1] cov = np.empty((n, n)), half = np.empty((n, n))
    cdef double[:, ::1] info = np.zeros((q + 1, q + 1)), by_column = np.empty((4, w + p + 1))
    cdef double[::1] score = np.zeros(q + 1), delta = np.empty(n), moved = np.empty(n)
    cdef double[::1] gain = np.empty(n), response = np.empty(q + 1)
    cdef double[:, ::1] by_state = np.empty((4, n))
    cdef double reading[4]
    cdef double total = 0.0, size, innovation, variance, part, dt
    cdef double* saved
    cdef Step step
    cdef Py_ssize_t i, j, k, c
    cdef bint storing = stored is not None
    for k in range(n):
        delta[k] = state[0, k]
        for j in range(q):
            v[k, j] = state[1 + j, k]
        for j in range(n):
            cov[k, j] = state[1 + q + k, j]
    with nogil:
        for i in range(m):
            if storing:
                saved = &stored[i, 0]
                memcpy(saved, &delta[0], n * sizeof(double))
                for j in range(p):
                    for k in range(n):
                        saved[n + j * n + k] = v[k, j]
                memcpy(saved + n * (1 + p), &cov[0, 0], n * n * sizeof(double))
                saved += n * (1 + p + n)
            observation(
                &elements[0], &ids[0], w, p, &track[i, 0], &full[0], reading, &by_state[0, 0],
                &by_column[0, 0],
            )
            for c in range(4):
                if weights[i, c] <= 0.0:
                    continue
                variance = spread[c] / weights[i, c]
                size, innovation = variance, measured[i, c] - reading[c]
                for j in range(q):
                    response[j] = 0.0
                for k in range(p):
                    response[k] = (&by_column[0, 0])[c * (w + p) + w + k]
                for k in range(levels):
                    response[p + k] = noise[k, c] * scores[i, c] / weights[i, c]
                for k in range(n):
                    gain[k] = 0.0
                for k in range(n):
                    part = by_state[c, k]
                    if part == 0.0:
                        continue
                    innovation -= part * delta[k]
                    for j in range(n):
                        gain[j] += part * cov[k, j]
                    for j in range(q):
                        response[j] += part * v[k, j]
                for k in range(n):
                    size += by_state[c, k] * gain[k]
                if not size > 0.0:  # the covariance has lost its sign
                    with gil:
                        return -INFINITY
                part = innovation / size
                total -= 0.5 * (innovation * part + log(2.0 * M_PI * size))
                for k in range(n):
                    delta[k] += gain[k] * part
                for j in range(q):
                    score[j] += response[j] * part
                for k in range(n):
                    part = gain[k] / size
                    for j in range(q):
                        v[k, j] -= part * response[j]
                    for j in range(n):
                        cov[k, j] -= part * gain[j]
                for k in range(q):
                    part = response[k] / size
                    for j in range(k + 1):
                        info[k, j] += part * response[j]
                if storing:
                    memcpy(saved + c * (2 * n + p + 2), &by_state[c, 0], n * sizeof(double))
                    for k in range(n):
                        saved[c * (2 * n + p + 2) + n + k] = gain[k] / size
                    memcpy(saved + c * (2 * n + p + 2) + 2 * n, &response[0], p * sizeof(double))
                    saved[c * (2 * n + p + 2) + 2 * n + p] = innovation
                    saved[c * (2 * n + p + 2) + 2 * n + p + 1] = size
            if i + 1 == time.shape[0]:
                break
            dt = time[i + 1] - time[i]
            transition(
                &elements[0], waves, &ids[0], w, p, &decay[0], time[i], dt, &thrust[i, 0],
                &track[i, 0], &full[0], &step,
            )
            for j in range(levels):
                for k in range(n):
                    v[k, p + j] += 0.5 * dt * kicks[j, k] * adjoint[i, n + k]
            for k in range(n):
                cov[k, k] += 0.5 * dt * kick[k]
            for k in range(n):  # F times delta, V and P, then P times F'
                if k >= 4:
                    moved[k] = step.fading[k - 4] * delta[k]
                    for j in range(q):
                        fresh[k, j] = step.fading[k - 4] * v[k, j]
                    for j in range(n):
                        half[k, j] = step.fading[k - 4] * cov[k, j]
                    continue
                moved[k] = 0.0
                for j in range(p):
                    fresh[k, j] = step.slope[k][n + j]
                for j in range(p, q):
                    fresh[k, j] = 0.0
                for j in range(n):
                    half[k, j] = 0.0
                for c in range(n):
                    part = step.slope[k][c]
                    moved[k] += part * delta[c]
                    for j in range(q):
                        fresh[k, j] += part * v[c, j]
                    for j in range(n):
                        half[k, j] += part * cov[c, j]
            for k in range(n):
                delta[k] = moved[k] + step.following[k] - track[i + 1, k]
                for j in range(k + 1):
                    if j >= 4:
                        part = half[k, j] * step.fading[j - 4]
                    else:
                        part = 0.0
                        for c in range(n):
                            part += half[k, c] * step.slope[j][c]
                    cov[k, j] = cov[j, k] = part
                cov[k, k] += 0.5 * dt * kick[k]
                memcpy(&v[k, 0], &fresh[k, 0], q * sizeof(double))
            for j in range(levels):
                for k in range(n):
                    v[k, p + j] += 0.5 * dt * kicks[j, k] * adjoint[i + 1, k]
            if storing:
                for k in range(4):
                    memcpy(
                        &stored[i, stored.shape[1] - 4 * n + k * n], step.slope[k],
                        n * sizeof(double),
                    )
    for k in range(n):
        state[0, k] = delta[k]
        for j in range(q):
            state[1 + j, k] = v[k, j]
        for j in range(n):
            state[1 + q + k, j] = cov[k, j]
    for k in range(q):
        state[1 + q + n, k] += score[k]
        for j in range(k + 1):
            state[2 + q + n + k, j] += info[k, j]
            if j < k:
                state[2 + q + n + j, k] += info[k, j]
    return total


def backward(
    Vector rates, Py_ssize_t columns, Vector time, Matrix weights, Vector change, Vector noise,
    Matrix stored, double[:, ::1] carried, double[:, ::1] smoothed, double[:, ::1] adjoint,
    double[:, ::1] scores, double[:, ::1] sums,
):
    """Run the adjoint through a block backwards, as `reference.backward` does."""
    cdef Py_ssize_t n = carried.shape[1], p = columns, width = 2 * n + p + 2, i, j, k, c
    _room(n, p, 0)
    cdef double r[STATES]
    cdef double new[STATES]
    cdef double along[STATES]
    cdef double fade[STATES]
    cdef double cov[STATES][STATES]
    cdef double half[STATES][STATES]
    cdef double dt, u, spread, innovation, size, part
    cdef const double* saved
    cdef const double* slope
    cdef const double* h
    cdef const double* gain
    for k in range(n):
        r[k] = carried[0, k]
        for j in range(n):
            cov[k][j] = carried[1 + k, j]
    with nogil:
        for i in range(weights.shape[0] - 1, -1, -1):
            if i + 1 < time.shape[0]:
                dt = time[i + 1] - time[i]
                slope = &stored[i, stored.shape[1] - 4 * n]
                for k in range(n):
                    sums[k, 0] += 0.5 * dt * r[k] * r[k]
                    sums[k, 1] += 0.5 * dt * cov[k][k]
                    new[k] = 0.0
                    if k >= 4:
                        fade[k] = exp(-rates[k - 4] * dt) if rates[k - 4] != 0.0 else 1.0
                        new[k] = fade[k] * r[k]
                for k in range(n):  # N F, then F' times it
                    for j in range(n):
                        half[k][j] = fade[j] * cov[k][j] if j >= 4 else 0.0
                    for c in range(4):
                        part = cov[k][c]
                        for j in range(n):
                            half[k][j] += part * slope[c * n + j]
                for c in range(4):
                    for j in range(n):
                        new[j] += slope[c * n + j] * r[c]
                for k in range(n):
                    r[k] = new[k]
                    for j in range(k + 1):
                        part = fade[k] * half[k][j] if k >= 4 else 0.0
                        for c in range(4):
                            part += slope[c * n + k] * half[c][j]
                        cov[k][j] = cov[j][k] = part
                    sums[k, 0] += 0.5 * dt * r[k] * r[k]
                    sums[k, 1] += 0.5 * dt * cov[k][k]
            for k in range(n):
                adjoint[i, n + k] = r[k]
            saved = &stored[i, 0]
            memset(&scores[i, 0], 0, 12 * sizeof(double))
            for c in range(3, -1, -1):
                if weights[i, c] <= 0.0:
                    continue
                h = saved + n * (1 + p + n) + c * width
                gain = h + n
                innovation, size = gain[n + p], gain[n + p + 1]
                for k in range(p):
                    innovation -= gain[n + k] * change[k]
                u, spread = innovation / size, 1.0 / size
                for k in range(n):
                    u -= gain[k] * r[k]
                    part = 0.0
                    for j in range(n):
                        part += cov[k][j] * gain[j]
                    along[k] = part
                    spread += part * gain[k]
                for k in range(n):
                    r[k] += h[k] * u
                    for j in range(n):
                        cov[k][j] += spread * h[k] * h[j] - h[k] * along[j] - along[k] * h[j]
                scores[i, c], scores[i, 4 + c] = u, u / sqrt(spread)
                scores[i, 8 + c] = innovation / sqrt(size)
                sums[n + c, 0] += noise[c] / weights[i, c] * u * u
                sums[n + c, 1] += noise[c] / weights[i, c] * spread
                sums[n + 4, 0] += innovation * innovation / size
                sums[n + 4, 1] += 1.0
            for k in range(n):
                adjoint[i, k] = r[k]
                part = saved[k]
                for j in range(p):
                    part += change[j] * saved[n + j * n + k]
                for j in range(n):
                    part += saved[n * (1 + p) + k * n + j] * r[j]
                smoothed[i, k] = part
    for k in range(n):
        carried[0, k] = r[k]
        for j in range(n):
            carried[1 + k, j] = cov[k][j]
