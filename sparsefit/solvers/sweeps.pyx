"""Cyclic coordinate descent on sparse columns, on blocks, or on clusters of equal weights.

    v_j <- soft(v_j + z_j'R/m, w_j) / (1 + mu),   R <- R - z_j (change of v_j)

is the optimum of column j alone, z_j'z_j = m, with the limit w_j of its penalty and the ridge mu.
Where columns are projected orthogonally to e, |e| = 1, z_j = s_j (theta_j - mean_j e), they stay
sparse: R = S - c e, and S and the number c are updated.

Sources: Friedman, Hastie and Tibshirani, J. Stat. Softw. 33 (2010) 1-22; Larsson, Klopfenstein,
Massias and Wallin, "Coordinate descent for SLOPE" (AISTATS 2023), for clusters.
"""

import numpy as np

from libc.math cimport fabs, sqrt
from scipy.linalg.cython_blas cimport daxpy, ddot, dgemv
from scipy.linalg.cython_lapack cimport dposv

cdef enum:
    NEWTON = 30  # the most steps to the norm of a group
    HISTORY = 5  # the moves that are extrapolated from

cdef double EXACT = 1e-14  # relative change of that norm that ends them
cdef double NEGLIGIBLE = 1e-12  # of the square of a sum of columns, which a mean was taken off
cdef double SETTLED = 0.03  # of the largest move of clusters, at which sweeps over them end


def descend(
    const double[::1] data,
    const int[::1] rows,
    const int[::1] starts,
    const Py_ssize_t[::1] columns,
    const double[::1] scale,
    const double[::1] means,
    const double[::1] limits,
    double ridge,
    double samples,
    double[::1] residual,
    double[::1] values,
    double stop,
    Py_ssize_t most,
):
    """Sweep over the columns until no move is above ``stop``; the number of sweeps, and c.

    data, rows and starts: scipy's CSC of theta; scale s (k,), means (k,). values (k,) and residual
    S (m,) are worked on in place, from c = 0 on.
    """
    cdef Py_ssize_t count = 0, place, j, i
    cdef double pull, size, after, move, largest, factor, shift = 0.0
    for count in range(1, most + 1):
        largest = 0.0
        for place in range(columns.shape[0]):
            j = columns[place]
            pull = 0.0
            for i in range(starts[j], starts[j + 1]):
                pull += data[i] * residual[rows[i]]
            pull = (pull - shift * means[j]) * scale[j] / samples + values[j]
            size = fabs(pull) - limits[j]
            after = 0.0
            if size > 0.0:
                after = size / (1.0 + ridge) if pull > 0.0 else -size / (1.0 + ridge)
            move = after - values[j]
            if move == 0.0:
                continue
            values[j] = after
            factor = move * scale[j]
            for i in range(starts[j], starts[j + 1]):
                residual[rows[i]] -= factor * data[i]
            shift -= factor * means[j]
            largest = max(largest, fabs(move))
        if largest <= stop:
            break
    return count, shift


cdef class Blocks:
    """Groups of columns of z (m, j), group g from starts[g] to starts[g + 1], and an iterate.

    square (j,): z_i'z_i/m of columns that are orthogonal within their group, or the group's largest
    eigenvalue, which makes the update a proximal-gradient step. limits (g,) and inner (j,): alpha
    times the weights of the norms and of the absolute values within. state (q, j + m): the
    coefficients of each target and its residual; trail: the states after the last sweeps.
    """

    cdef const double[::1, :] z
    cdef const Py_ssize_t[::1] starts
    cdef const double[::1] limits, inner, square
    cdef double[:, ::1] state, pull
    cdef double[:, :, ::1] trail
    cdef double per

    def __init__(self, z, starts, limits, inner, square, samples, state):
        self.z, self.starts, self.limits, self.inner = z, starts, limits, inner
        self.square, self.per, self.state = square, 1.0 / samples, state
        self.pull = np.empty((len(state), np.diff(starts).max()))
        self.trail = np.empty((HISTORY + 2, *state.shape))

    def descend(self, double stop, Py_ssize_t most):
        """Sweep until one over all groups changes Z V/sqrt(m) by ``stop``, squared; the sweeps.

        Between two of them sweeps go over the groups in use, and extrapolate.
        """
        cdef Py_ssize_t sweeps = 0, step, count, groups = len(self.starts) - 1
        cdef Py_ssize_t[::1] used = np.empty(groups, np.intp)
        cdef double change
        while sweeps < most:
            change, count, step = 0.0, 0, 0
            for g in range(groups):
                used[count] = g
                change += updated(self, g)
                count += in_use(self, g)
            sweeps += 1
            if change <= stop:
                break
            self.trail[0] = self.state
            while sweeps < most and change > stop:
                change = 0.0
                for place in range(count):
                    change += updated(self, used[place])
                sweeps += 1
                step += 1
                self.trail[step] = self.state
                if step == HISTORY + 1:
                    extrapolate(self, used[:count])
                    self.trail[0] = self.state
                    step = 0
        return sweeps


cdef bint in_use(Blocks b, Py_ssize_t g) noexcept:
    """Whether a coefficient of group g is not zero."""
    for t in range(b.state.shape[0]):
        for j in range(b.starts[g], b.starts[g + 1]):
            if b.state[t, j] != 0.0:
                return True
    return False


cdef double updated(Blocks b, Py_ssize_t g) noexcept:
    """Group g to its optimum given the others; sum_i square_i |change of v_i|^2.

    With p_i = z_i'R/m + square_i v_i, softly thresholded by ``inner``, a_i = sum_t p_ti^2 and
    sum_i a_i > limit^2, the optimum is v_i = n p_i / (square_i n + limit). Its norm n is the root
    of 1/sqrt(sum_i a_i / (square_i n + limit)^2) = 1, which is concave in n: Newton's method
    ascends to it.
    """
    cdef Py_ssize_t j = b.starts[g]
    cdef int m = b.z.shape[0], size = b.starts[g + 1] - b.starts[g], one = 1
    cdef double total = 0.0, norm = 0.0, change = 0.0, limit = b.limits[g], unit = 1.0, zero = 0.0
    cdef double slope, rise, share, move
    cdef double *block = <double *>&b.z[0, j]
    cdef double *residual
    for t in range(b.state.shape[0]):
        residual = &b.state[t, b.z.shape[1]]
        dgemv("T", &m, &size, &b.per, block, &m, residual, &one, &zero, &b.pull[t, 0], &one)
        for i in range(size):
            b.pull[t, i] += b.square[j + i] * b.state[t, j + i]
            if b.inner[j + i] > 0.0:
                share = max(fabs(b.pull[t, i]) - b.inner[j + i], 0.0)
                b.pull[t, i] = share if b.pull[t, i] > 0.0 else -share
            total += b.pull[t, i] * b.pull[t, i]
    for _ in range(NEWTON if total > limit * limit else 0):
        total = slope = 0.0
        for t in range(b.state.shape[0]):
            for i in range(size):
                share = 1.0 / (b.square[j + i] * norm + limit)
                rise = b.pull[t, i] * b.pull[t, i] * share * share
                total += rise
                slope += rise * share * b.square[j + i]
        rise = total * (sqrt(total) - 1.0) / slope if slope > 0.0 else 0.0
        norm += max(rise, 0.0)
        if not rise > EXACT * norm:
            break
    for t in range(b.state.shape[0]):
        move = 0.0
        for i in range(size):
            share = norm / (b.square[j + i] * norm + limit) if norm > 0.0 else 0.0
            b.pull[t, i] = b.state[t, j + i] - share * b.pull[t, i]
            b.state[t, j + i] -= b.pull[t, i]
            move += b.square[j + i] * b.pull[t, i] * b.pull[t, i]
        if move != 0.0:
            residual = &b.state[t, b.z.shape[1]]
            dgemv("N", &m, &size, &unit, block, &m, &b.pull[t, 0], &one, &unit, residual, &one)
        change += move
    return change


cdef double objective(Blocks b, const Py_ssize_t[::1] used) noexcept:
    """The objective at the iterate, whose groups in use these are."""
    cdef int m = b.z.shape[0], one = 1
    cdef double total = 0.0, square
    cdef double *residual
    for t in range(b.state.shape[0]):
        residual = &b.state[t, b.z.shape[1]]
        total += 0.5 * b.per * ddot(&m, residual, &one, residual, &one)
    for place in range(used.shape[0]):
        square = 0.0
        for t in range(b.state.shape[0]):
            for j in range(b.starts[used[place]], b.starts[used[place] + 1]):
                square += b.state[t, j] * b.state[t, j]
                total += b.inner[j] * fabs(b.state[t, j])
        total += b.limits[used[place]] * sqrt(square)
    return total


cdef void extrapolate(Blocks b, const Py_ssize_t[::1] used) noexcept:
    """The combination x = sum_i c_i x_i, sum_i c_i = 1, of the trail whose moves cancel best.

    c minimises |sum_i c_i (x_i - x_{i-1})|; x is taken where the objective falls.
    """
    cdef int order = HISTORY, one = 1, failed, width = b.state.shape[1]
    cdef Py_ssize_t columns = b.z.shape[1]
    cdef double[HISTORY * HISTORY] products
    cdef double[HISTORY] share
    cdef double before = objective(b, used), total = 0.0
    b.trail[0] = b.state
    for i in range(1, HISTORY + 1):  # the moves
        share[i - 1] = 1.0
        for t in range(b.state.shape[0]):
            for j in range(width):
                b.trail[i, t, j] = b.trail[i + 1, t, j] - b.trail[i, t, j]
    for i in range(HISTORY):
        for l in range(i + 1):
            products[i * HISTORY + l] = 0.0
            for t in range(b.state.shape[0]):
                for j in range(columns):
                    products[i * HISTORY + l] += b.trail[i + 1, t, j] * b.trail[l + 1, t, j]
        total += products[i * HISTORY + i]
    for i in range(HISTORY):
        products[i * HISTORY + i] += 1e-12 * total + 1e-300
    dposv("U", &order, &one, products, &order, share, &order, &failed)
    total = 0.0
    for i in range(HISTORY):
        total += share[i]
    for i in range(HISTORY - 1):  # sum_i c_i x_i is the last x less partial sums of c times moves
        share[i] = -share[i] / total + (share[i - 1] if i else 0.0)
        for t in range(b.state.shape[0]):
            daxpy(&width, &share[i], &b.trail[i + 2, t, 0], &one, &b.state[t, 0], &one)
    if failed or not objective(b, used) <= before:
        b.state[:] = b.trail[0]


cdef class Clusters:
    """Coefficients that are not zero, by their size: d clusters of equal ones, the largest first.

    member (c,) in that order, begin (d + 1,) of each cluster among them, level (d,); sign (j,).
    """

    cdef Py_ssize_t d
    cdef Py_ssize_t[::1] member, begin, spare
    cdef double[::1] level, sign

    def __init__(self, values):
        size = np.abs(values)
        order = np.argsort(-size, kind="stable")[: np.count_nonzero(values)]
        ends = np.flatnonzero(np.diff(size[order], append=0.0))
        self.d, self.sign = len(ends), np.sign(values)
        cdef Py_ssize_t[:, ::1] integers = np.zeros((3, len(values) + 1), np.intp)
        self.member, self.begin, self.spare = integers[0], integers[1], integers[2]
        self.level = np.zeros(len(values) + 1)
        np.asarray(self.member)[: len(order)] = order
        np.asarray(self.begin)[1 : self.d + 1] = ends + 1
        np.asarray(self.level)[: self.d] = size[order[ends]]


cdef void moved(Clusters c, Py_ssize_t k, Py_ssize_t place, double level, bint merges) noexcept:
    """Move cluster k to a level, before cluster ``place`` or into it; level 0 removes it."""
    cdef Py_ssize_t first = c.begin[k], size = c.begin[k + 1] - first
    for i in range(size):
        c.spare[i] = c.member[first + i]
    if level == 0.0:
        for i in range(first, c.begin[c.d] - size):
            c.member[i] = c.member[i + size]
        for l in range(k, c.d):
            c.begin[l] = c.begin[l + 1] - size
            c.level[l] = c.level[l + 1]
        c.d -= 1
        return
    if place > k:
        place -= 1
        for i in range(first, c.begin[place + 1] - size):
            c.member[i] = c.member[i + size]
        for l in range(k, place):
            c.begin[l] = c.begin[l + 1] - size
            c.level[l] = c.level[l + 1]
        c.begin[place] = c.begin[place + 1] - size
    else:
        for i in range(first - 1, c.begin[place] - 1, -1):
            c.member[i + size] = c.member[i]
        for l in range(k, place, -1):
            c.begin[l] = c.begin[l - 1] + size
            c.level[l] = c.level[l - 1]
    c.level[place] = level
    for i in range(size):
        c.member[c.begin[place] + i] = c.spare[i]
    if merges:  # with the cluster behind it, of that level
        c.d -= 1
        for l in range(place + 1, c.d + 1):
            c.begin[l] = c.begin[l + 1]
            c.level[l] = c.level[l + 1]


def descend_clusters(
    const double[:, ::1] gram,
    columns,
    const double[::1] price,
    double[::1] state,
    double[::1] values,
    Py_ssize_t sweeps,
):
    """Sweep over SLOPE's clusters, each to its optimum, past others or into one of them.

    price (j + 1,): sums of the leading alpha lambda. Values v (j,) and the state are worked on in
    place: the correlation B - G v (j,) or, of sparse columns, (data, rows, starts, samples, means)
    of scipy's CSC where ``gram`` is None, the residual plus a multiple of e (m,), in the end.
    Returns whether no cluster met another.
    """
    cdef Clusters c = Clusters(np.asarray(values))
    cdef int j = len(values), one = 1
    cdef Py_ssize_t k, a, l, first, size, rank, place
    cdef double square, pull, level, step, turn, largest = 0.0, moves, per = 1.0
    cdef double mean = 0.0, shift = 0.0, whole
    cdef bint merges, same = True, sparse = gram is None
    cdef const double[::1] data, means
    cdef const int[::1] rows, starts
    cdef double[::1] sum_of_columns
    if sparse:
        data, rows, starts, samples, means = columns
        per, sum_of_columns = 1.0 / samples, np.zeros(len(state))
    for _ in range(sweeps):
        k, moves = 0, 0.0
        while k < c.d:
            first, size = c.begin[k], c.begin[k + 1] - c.begin[k]
            square = pull = mean = 0.0
            for i in range(first, first + size):
                a = c.member[i]
                if sparse:
                    mean += c.sign[a] * means[a]
                    for l in range(starts[a], starts[a + 1]):
                        sum_of_columns[rows[l]] += c.sign[a] * data[l]
                    continue
                pull += c.sign[a] * state[a]
                for l in range(first, first + size):
                    square += c.sign[a] * c.sign[c.member[l]] * gram[a, c.member[l]]
            for i in range(first, first + size if sparse else first):
                a = c.member[i]
                for l in range(starts[a], starts[a + 1]):
                    turn = sum_of_columns[rows[l]]
                    square += per * turn * turn
                    pull += per * turn * state[rows[l]]
                    sum_of_columns[rows[l]] = 0.0
            whole, square = square, square - per * mean * mean
            if not square > NEGLIGIBLE * whole:  # the sum of a cluster may be constant
                k += 1
                continue
            pull += square * c.level[k] - per * mean * shift
            turn = 1.0 if pull > 0.0 else -1.0
            pull = fabs(pull)
            rank, place, merges = first, k, False
            level = (pull - price[rank + size] + price[rank]) / square
            while place > 0 and level > c.level[place - 1]:
                rank -= c.begin[place] - c.begin[place - 1]
                place -= 1
                level = (pull - price[rank + size] + price[rank]) / square
                if level <= c.level[place]:
                    level, merges = c.level[place], True
                    break
            if place == k and not merges:
                place = k + 1
                while place < c.d and level < c.level[place]:
                    rank += c.begin[place + 1] - c.begin[place]
                    level = (pull - price[rank + size] + price[rank]) / square
                    if level >= c.level[place]:
                        level, merges = c.level[place], True
                        break
                    place += 1
            level = max(level, 0.0)
            step = turn * level - c.level[k]
            moves = max(moves, fabs(step) * sqrt(square))
            if step == 0.0:
                k += 1
                continue
            shift -= step * mean
            for i in range(first, first + size):
                a = c.member[i]
                pull = -step * c.sign[a]
                if sparse:
                    for l in range(starts[a], starts[a + 1]):
                        state[rows[l]] += pull * data[l]
                else:
                    daxpy(&j, &pull, <double *>&gram[a, 0], &one, &state[0], &one)
                c.sign[a] *= turn
                if level == 0.0:
                    values[a] = 0.0
            if merges or level == 0.0 or (place != k and place != k + 1):
                same = False
                moved(c, k, place, level, merges)
            else:
                c.level[k] = level
            k += 1
        largest = max(largest, moves)
        if moves <= SETTLED * largest:
            break
    for l in range(c.d):
        for i in range(c.begin[l], c.begin[l + 1]):
            values[c.member[i]] = c.sign[c.member[i]] * c.level[l]
    return bool(same)
