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
    LANES = 8  # nodes whose steps are made at once: loops over them are vectorised

cdef extern from *:
    ctypedef double* Apart "double *__restrict"  # where nothing else is read or written

ctypedef const double[::1] Vector
ctypedef const double[:, ::1] Matrix
ctypedef const Py_ssize_t[::1] Indices
ctypedef double ByOwn[OWN]
ctypedef double ByState[STATES]
ctypedef double Row[STATES + COLUMNS]
ctypedef double Lanes[LANES]  # a quantity of several nodes side by side
ctypedef Lanes Four[4]
ctypedef Lanes Columns[STATES + COLUMNS]


cdef struct Chain:  # links (element, column, slope): of walkers, of other elements, of waves
    Py_ssize_t w, columns, walking, other, links  # columns: 4 + w + p; the others: ends of links
    const Py_ssize_t* sources
    const Py_ssize_t* targets
    const double* slopes


cdef struct Steps:  # of several nodes; zero before: entries of `own` and `air` never set stay so
    Lanes own[2][OWN]  # the slopes of v' by the elements directly
    Lanes air[2][OWN + 5 * WAVES]  # those of the flow
    Lanes element[OWN + 5 * WAVES]
    Lanes start, step, time  # time: at a stage
    Four push, pushed, state  # push: at the node and at the next; the others: at a stage
    Lanes track[STATES]
    Lanes fading[4][STATES]  # what is left of walkers at each stage
    Columns relative[2]  # slopes of r
    Columns slope[6][2]  # of v' at each stage from the third on, then v' itself
    Columns change[4]  # by accelerations: of F and E less those of rest, of states


cdef inline void add(Py_ssize_t n, double a, const double* x, Apart y) noexcept nogil:
    """y += a x."""
    cdef Py_ssize_t i
    for i in range(n):
        y[i] += a * x[i]


cdef inline void gather(
    Py_ssize_t size, Py_ssize_t n, const double* a, Py_ssize_t stride, const double* x, Apart y
) noexcept nogil:
    """y (size,) += a X, of n numbers a and n rows X `stride` apart; n is 4 or more."""
    cdef Py_ssize_t i
    for i in range(size):
        y[i] += (a[0] * x[i] + a[1] * x[i + stride]) + (
            a[2] * x[i + 2 * stride] + a[3] * x[i + 3 * stride]
        )
    for i in range(4, n):
        add(size, a[i], x + i * stride, y)


cdef inline void turn(const Lanes* a, const double* x, const double* y, Apart z) noexcept nogil:
    """z += a[0] x + a[1] y, of several nodes."""
    cdef Py_ssize_t l
    for l in range(LANES):
        z[l] += a[0][l] * x[l] + a[1][l] * y[l]


cdef inline double dot(Py_ssize_t n, const double* x, const double* y) noexcept nogil:
    """x'y."""
    cdef Py_ssize_t i
    cdef double total = 0.0
    for i in range(n):
        total += x[i] * y[i]
    return total


cdef inline void circular(const double* phase, Apart c, Apart s) noexcept nogil:
    """cos and sin of phases (LANES,), to rounding, without a branch: fdlibm's polynomials."""
    cdef double size = 0.0, r, z, x, y
    cdef int turns
    cdef Py_ssize_t l
    for l in range(LANES):
        size += phase[l] * phase[l]
    if not size < 1e12:  # no number, or a quarter turn in two parts is not exact enough
        for l in range(LANES):
            c[l], s[l] = cos(phase[l]), sin(phase[l])
        return
    for l in range(LANES):
        turns = <int>(phase[l] * (2.0 / M_PI) + 1048576.5) - 1048576
        r = phase[l] - turns * 1.5707963267341256 - turns * 6.077100506506192e-11
        z = r * r
        y = r - r * z * (0.16666666666666632 - z * (0.00833333333332249 - z * (
            0.0001984126982985795 - z * (2.7557313707070068e-06 - z * (
            2.5050760253406863e-08 - z * 1.58969099521155e-10)))))
        x = 1.0 - 0.5 * z + z * z * (0.0416666666666666 - z * (0.001388888888887411 - z * (
            2.480158728947673e-05 - z * (2.7557314351390663e-07 - z * (
            2.087572321298175e-09 - z * 1.1359647557788195e-11)))))
        c[l] = (1 - ((turns + 1) & 2)) * (y if turns & 1 else x)
        s[l] = (1 - (turns & 2)) * (x if turns & 1 else y)


cdef void acceleration(
    Steps* now, Py_ssize_t waves, const Chain* chain, double origin, Columns* slope
) noexcept nogil:
    """v' of the states at a stage, and its slopes; origin: the start of the log."""
    cdef Lanes x, y, t, size, phase, c, s, u, v, xx, xy, yx, ut, vt
    cdef Lanes rate[2]
    cdef Lanes pull[2][2]  # the slopes of v' by r
    cdef Lanes* e = now.element
    cdef double lag, kx, ky, a, b, omega, co, si, bend, px, py, hx, hy, ax, ay, speed
    cdef double rx, ry, age, ahead, light, weight, factor, stretch
    cdef Py_ssize_t i, k, l, d
    for l in range(LANES):
        x[l] = now.state[0][l] - e[11][l] * now.state[2][l]
        y[l] = now.state[1][l] - e[11][l] * now.state[3][l]
        t[l] = now.time[l] - e[11][l]
        size[l] = (1.0 + e[12][l]) * (1.0 + e[13][l] * now.time[l])
        u[l] = v[l] = xx[l] = xy[l] = yx[l] = ut[l] = vt[l] = 0.0
    for k in range(OWN, OWN + 5 * waves, 5):
        for l in range(LANES):
            phase[l] = e[k][l] * x[l] + e[k + 1][l] * y[l] - e[k + 4][l] * t[l]
        circular(phase, c, s)
        for l in range(LANES):
            kx, ky, a, b, omega = e[k][l], e[k + 1][l], e[k + 2][l], e[k + 3][l], e[k + 4][l]
            co, si = size[l] * c[l], size[l] * s[l]
            bend, px, py = b * co - a * si, -ky * (a * co + b * si), kx * (a * co + b * si)
            u[l], v[l] = u[l] + ky * bend, v[l] - kx * bend
            xx[l], xy[l], yx[l] = xx[l] + kx * px, xy[l] + ky * px, yx[l] + kx * py
            ut[l], vt[l] = ut[l] - omega * px, vt[l] - omega * py
            now.air[0][k][l], now.air[1][k][l] = px * x[l], py * x[l] - bend
            now.air[0][k + 1][l], now.air[1][k + 1][l] = px * y[l] + bend, py * y[l]
            now.air[0][k + 2][l], now.air[1][k + 2][l] = -ky * si, kx * si
            now.air[0][k + 3][l], now.air[1][k + 3][l] = ky * co, -kx * co
            now.air[0][k + 4][l], now.air[1][k + 4][l] = -px * t[l], -py * t[l]
    circular(e[2], c, s)
    for l in range(LANES):
        rx = u[l] + e[6][l] + e[8][l] * now.time[l] - now.state[2][l]
        ry = v[l] + e[7][l] + e[9][l] * now.time[l] - now.state[3][l]
        speed = sqrt(rx * rx + ry * ry + 1e-300)
        lag, age = e[11][l], now.time[l] - origin
        hx = c[l] * now.pushed[0][l] - s[l] * now.pushed[1][l]
        hy = s[l] * now.pushed[0][l] + c[l] * now.pushed[1][l]
        ahead, light = 1.0 / (e[0][l] - lag), 1.0 / (1.0 + e[10][l] * age)
        weight, factor = light * e[0][l] * ahead, light * ahead
        stretch, bend = 1.0 + e[5][l] * speed, factor * e[5][l] / speed
        px, py = factor * stretch * rx, factor * stretch * ry
        rate[0][l] = ax = px + weight * (e[1][l] * hx + e[3][l])
        rate[1][l] = ay = py + weight * (e[1][l] * hy + e[4][l])
        pull[0][0][l] = factor * stretch + bend * rx * rx
        pull[0][1][l] = pull[1][0][l] = bend * rx * ry
        pull[1][1][l] = factor * stretch + bend * ry * ry
        now.own[0][0][l] = -(px + lag * ahead * ax) / e[0][l]
        now.own[1][0][l] = -(py + lag * ahead * ay) / e[0][l]
        now.own[0][1][l], now.own[1][1][l] = weight * hx, weight * hy
        now.own[0][2][l], now.own[1][2][l] = -weight * e[1][l] * hy, weight * e[1][l] * hx
        now.own[0][3][l] = now.own[1][4][l] = weight
        now.own[0][5][l], now.own[1][5][l] = factor * speed * rx, factor * speed * ry
        now.own[0][10][l], now.own[1][10][l] = -ax * age * light, -ay * age * light
        now.own[0][11][l], now.own[1][11][l] = ax * ahead, ay * ahead
        now.relative[0][0][l], now.relative[1][0][l] = xx[l], yx[l]
        now.relative[0][1][l], now.relative[1][1][l] = xy[l], -xx[l]
        now.relative[0][2][l], now.relative[1][2][l] = -1.0 - lag * xx[l], -lag * yx[l]
        now.relative[0][3][l], now.relative[1][3][l] = -lag * xy[l], -1.0 + lag * xx[l]
        now.air[0][6][l] = now.air[1][7][l] = 1.0
        now.air[0][8][l] = now.air[1][9][l] = now.time[l]
        now.air[0][11][l] = -(xx[l] * now.state[2][l] + xy[l] * now.state[3][l]) - ut[l]
        now.air[1][11][l] = -(yx[l] * now.state[2][l] - xx[l] * now.state[3][l]) - vt[l]
        a, b = 1.0 / (1.0 + e[12][l]), now.time[l] / (1.0 + e[13][l] * now.time[l])
        now.air[0][12][l], now.air[1][12][l] = u[l] * a, v[l] * a
        now.air[0][13][l], now.air[1][13][l] = u[l] * b, v[l] * b
    for d in range(2):
        memcpy(slope[d][chain.columns], rate[d], sizeof(Lanes))
        memset(slope[d], 0, chain.columns * sizeof(Lanes))
        memset(now.relative[d] + 4, 0, (chain.columns - 4) * sizeof(Lanes))
        for i in range(chain.links):
            k = chain.sources[i]
            add(LANES, chain.slopes[i], now.air[d][k], now.relative[d][chain.targets[i]])
    for d in range(2):
        for i in range(chain.columns):
            turn(pull[d], now.relative[0][i], now.relative[1][i], slope[d][i])
        for i in range(chain.other):
            k = chain.sources[i]
            add(LANES, chain.slopes[i], now.own[d][k], slope[d][chain.targets[i]])


cdef void transitions(
    Steps* now, const double* elements, Py_ssize_t waves, const Chain* chain, double origin
) noexcept nogil:
    """Steps of Runge and Kutta's fourth order with their derivatives."""
    cdef Four pull, bend
    cdef Columns* slope
    cdef double share, before = 0.0, x, y
    cdef Py_ssize_t k, i, l, d, stage, last = chain.columns
    for d in range(4):  # nothing comes before the first
        memset(now.slope[d // 2][d % 2], 0, (last + 1) * sizeof(Lanes))
    for stage in range(2, 6):
        share, slope = 0.5 * ((stage - 1) // 2), now.slope[stage]
        for d in range(2):
            for l in range(LANES):
                x, y = share * now.step[l], before * now.step[l]
                now.time[l] = now.start[l] + x
                now.pushed[d][l] = (1.0 - share) * now.push[d][l] + share * now.push[2 + d][l]
                now.state[d][l] = now.track[d][l] + x * (
                    now.track[2 + d][l] + y * now.slope[stage - 2][d][last][l]
                )
                now.state[2 + d][l] = now.track[2 + d][l] + x * now.slope[stage - 1][d][last][l]
        for i in range(chain.walking):
            for l in range(LANES):
                now.element[chain.sources[i]][l] = elements[chain.sources[i]]
        for i in range(chain.walking):
            k = chain.targets[i]
            for l in range(LANES):
                x = chain.slopes[i] * now.fading[stage - 2][k - 4][l]
                now.element[chain.sources[i]][l] += x * now.track[k][l]
        acceleration(now, waves, chain, origin, slope)
        for d in range(2):
            for i in range(chain.w):  # states of one process fade alike
                for l in range(LANES):
                    slope[d][4 + i][l] *= now.fading[stage - 2][i][l]
            for l in range(LANES):
                x, y = share * now.step[l], before * now.step[l]
                pull[0][l], pull[1][l] = x * slope[d][2][l], x * slope[d][3][l]
                bend[0][l], bend[1][l] = x * slope[d][0][l], x * slope[d][1][l]
                slope[d][2][l] += bend[0][l]
                slope[d][3][l] += bend[1][l]
                bend[0][l], bend[1][l] = y * bend[0][l], y * bend[1][l]
            for i in range(last):  # x' = v: these follow from those of two stages before
                turn(pull, now.slope[stage - 1][0][i], now.slope[stage - 1][1][i], slope[d][i])
                turn(bend, now.slope[stage - 2][0][i], now.slope[stage - 2][1][i], slope[d][i])
        before = share
    for d in range(2):
        for i in range(last + 1):
            for l in range(LANES):
                x, y = now.slope[3][d][i][l] + now.slope[4][d][i][l], 1.0 / 6.0 * now.step[l]
                now.change[d][i][l] = now.step[l] * y * (now.slope[2][d][i][l] + x)
                x = 2.0 * x + now.slope[2][d][i][l]
                now.change[2 + d][i][l] = y * (x + now.slope[5][d][i][l])


cdef void observation(
    const double* elements, const Chain* chain, const double* state, double* full, double* reading,
    ByState* by_state, ByOwn* by_element,
) noexcept nogil:
    """The readings (4,) of a state, H (4, 4 + w), the derivatives by the elements (4, 22).

    Entries that are zero whatever the state are not set.
    """
    cdef Py_ssize_t i, c
    for i in range(chain.walking):
        full[chain.sources[i]] = elements[chain.sources[i]]
    for i in range(chain.walking):
        full[chain.sources[i]] += chain.slopes[i] * state[chain.targets[i]]
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
        memset(by_state[c] + 4, 0, chain.w * sizeof(double))
        for i in range(chain.walking):
            by_state[c][chain.targets[i]] += chain.slopes[i] * by_element[c][chain.sources[i]]


def _room(states, columns, waves):
    """Raise `MemoryError` where a model has more than the compiled passes have room for."""
    if states > STATES or columns > COLUMNS or waves > WAVES:
        raise MemoryError(f"{states} states, {columns} columns and {waves} waves are too many")


def forward(
    space, leg, Py_ssize_t first, Py_ssize_t end,
    double[:, ::1] rows, double[:, ::1] sums, double[:, ::1] stored,
):
    """Filter a block of nodes, as `reference.forward` does; rows and sums change in place."""
    cdef Vector elements = space.elements, rates = np.append(space.rates, 0.0), time = leg.time
    cdef Matrix kicks = space.kicks.T.copy(), noise = space.noise.T.copy(), pace = space.pace
    cdef Matrix push = leg.push, measured = leg.measured, weights = leg.weights, track = leg.track
    cdef Py_ssize_t w = rates.shape[0] - 1, n = 4 + w, width = rows.shape[1]
    cdef Py_ssize_t c = n + 1 + space.chain.shape[1], levels = width - c
    cdef Matrix adjoint = leg.last.adjoint if levels else track
    cdef Matrix scores = leg.last.scores if levels else track
    cdef Py_ssize_t waves = (elements.shape[0] - OWN) // 5
    places, states = np.nonzero(space.mixing)
    moved, columns = np.nonzero(space.chain)
    cdef Indices source = np.concatenate([space.walkers[places], moved, [0]]).astype(np.intp)
    cdef Indices target = np.concatenate([4 + states, n + columns, [0]]).astype(np.intp)
    cdef Vector slope = np.r_[space.mixing[places, states], space.chain[moved, columns], 0.0]
    cdef Py_ssize_t walking = len(places), other = walking + np.sum(moved < OWN)
    cdef Chain chain = Chain(
        w, c - 1, walking, other, len(source) - 1, &source[0], &target[0], &slope[0]
    )
    _room(n, w + width, waves)
    cdef double[::1] room = np.zeros(sizeof(Steps) // sizeof(double))
    cdef Steps* now = <Steps*>&room[0]
    cdef double[::1] full = np.array(elements)
    cdef double[::1] kick = np.sum(kicks, axis=1), spread = np.sum(noise, axis=1)
    cdef double[:, ::1] fresh = np.empty_like(rows)
    cdef ByOwn by_element[4]
    cdef ByState by_state[4]
    cdef Row step[4]
    cdef Row responses[4]  # H P, -e and G
    cdef ByState reading, inverses, gain
    cdef double total = 0.0, product, size, inverse, dt, own, fade
    cdef double* response
    cdef double* saved = NULL
    cdef const double* h
    cdef Py_ssize_t i, j, k, l, channel, lane, later
    for k in range(OWN + 5 * waves):
        for l in range(LANES):
            now.element[k][l] = elements[k]
    memset(by_state, 0, sizeof(by_state))
    memset(by_element, 0, sizeof(by_element))
    for i in range(first, end):
        if stored is not None:
            saved = &stored[i - first, 0]
            for k in range(n):
                memcpy(saved + k * c, &rows[k, 0], c * sizeof(double))
            saved += n * c
        observation(&elements[0], &chain, &track[i, 0], &full[0], reading, by_state, by_element)
        product = 1.0
        for channel in range(4):
            inverses[channel], response = 0.0, &responses[channel][0]
            memset(response, 0, width * sizeof(double))
            if weights[i, channel] <= 0.0:
                continue
            h = by_state[channel]
            response[n] = reading[channel] - measured[i, channel]
            for k in range(walking, other):
                response[target[k] + 1] += slope[k] * by_element[channel][source[k]]
            add(levels, scores[i, channel] / weights[i, channel], &noise[channel, 0], response + c)
            for k in range(n):
                if h[k] != 0.0:
                    add(width, h[k], &rows[k, 0], response)
            size = spread[channel] / weights[i, channel] + dot(n, h, response)
            if not size > 0.0:  # the covariance has lost its sign
                return INFINITY
            product *= 2.0 * M_PI * size
            inverses[channel] = inverse = 1.0 / size
            for k in range(n):
                add(width, -response[k] * inverse, response, &rows[k, 0])
            if stored is not None:
                memcpy(saved + channel * (n + c + 1), h, n * sizeof(double))
                memcpy(saved + channel * (n + c + 1) + n, response, c * sizeof(double))
                saved[channel * (n + c + 1) + n + c] = inverse
        total += log(product)
        for k in range(width - n):
            for channel in range(4):
                gain[channel] = responses[channel][n + k] * inverses[channel]
            gather(width - n, 4, gain, STATES + COLUMNS, responses[0] + n, &sums[k, 0])
        if i + 1 == time.shape[0]:
            break
        dt, lane = time[i + 1] - time[i], (i - first) % LANES
        if lane == 0:
            for l in range(LANES):
                later = min(i + l, time.shape[0] - 2)
                now.start[l], now.step[l] = time[later], time[later + 1] - time[later]
                for k in range(4):
                    now.push[k][l] = push[later + k // 2, k % 2]
                for k in range(n):
                    now.track[k][l] = track[later, k]
                for k in range(w):
                    fade = exp(-0.5 * rates[k] * pace[later, n + k] * now.step[l])
                    now.fading[0][k][l], now.fading[3][k][l] = 1.0, fade * fade
                    now.fading[1][k][l] = now.fading[2][k][l] = fade
            transitions(now, &elements[0], waves, &chain, time[0])
        for k in range(4):
            for j in range(c):
                step[k][j] = now.change[k][j][lane]
            step[k][k] += 1.0
            if k < 2:
                step[k][2 + k] += dt
        for k in range(n):
            own = 0.5 * dt * pace[i, k]
            rows[k, k] += own * kick[k]
            add(levels, own * adjoint[i, n + k], &kicks[k, 0], &rows[k, 0] + c)
        memset(&fresh[0, 0], 0, n * width * sizeof(double))
        for k in range(n):  # F times P, delta and V
            if k < 4:
                fresh[k, n] = track[i, k] - track[i + 1, k] + step[k][c - 1]
                fresh[k, n] += dt * track[i, 2 + k] if k < 2 else 0.0
                memcpy(&fresh[k, n + 1], step[k] + n, (c - n - 1) * sizeof(double))
                gather(width, n, step[k], width, &rows[0, 0], &fresh[k, 0])
            else:
                fade = now.fading[3][k - 4][lane]
                fresh[k, n] = fade * track[i, k] - track[i + 1, k]
                add(width, fade, &rows[k, 0], &fresh[k, 0])
        for k in range(n):  # and P times F'
            for j in range(k + 1):
                rows[k, j] = rows[j, k] = dot(n, &fresh[k, 0], step[j]) if j < 4 else (
                    fresh[k, j] * now.fading[3][j - 4][lane]
                )
            memcpy(&rows[k, n], &fresh[k, n], (width - n) * sizeof(double))
            own = 0.5 * dt * pace[i, k]
            rows[k, k] += own * kick[k]
            add(levels, own * adjoint[i + 1, k], &kicks[k, 0], &rows[k, 0] + c)
            if k < 2:  # the first half kick has too much of the position
                own = dt / 6.0 * step[k][2 + k] * step[k][2 + k]
                rows[k, k] -= own * kick[2 + k]
                add(levels, -own * adjoint[i + 1, k], &kicks[2 + k, 0], &rows[k, 0] + c)
            if stored is not None and k < 4:
                memcpy(saved + 4 * (n + c + 1) + k * n, step[k], n * sizeof(double))
    return total


def backward(
    space, leg, Py_ssize_t first, Py_ssize_t end, Vector change, Matrix stored,
    double[:, ::1] carried, result, double[:, ::1] sums,
):
    """Run the adjoint through a block backwards, as `reference.backward` does."""
    cdef Vector rates = space.rates, time = leg.time, noise = np.sum(space.noise, axis=0)
    cdef Matrix weights = leg.weights, pace = space.pace
    cdef double[:, ::1] smoothed = result.track, adjoint = result.adjoint, scores = result.scores
    cdef Py_ssize_t n = carried.shape[1], q = change.shape[0], c = n + q, i, j, k, channel
    _room(n, q, 0)
    cdef ByState r, new, gain, along, fade
    cdef ByState cov[STATES]
    cdef ByState half[STATES]
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
