"""Cyclic descent over sparse columns, groups of dense ones, or clusters of equal weights, compiled.

    v_j <- soft(v_j + z_j'R/m, w_j) / (1 + mu),   R <- R - z_j (change of v_j)

is the optimum of column j alone, z_j'z_j = m, with the limit w_j of its penalty and the ridge mu.
Where the part along e, |e| = 1, is taken off the columns, z_j = s_j (theta_j - mean_j e), the rows
stay sparse: R = S - c e, of which S and the number c change.

Sources: Friedman, Hastie and Tibshirani, J. Stat. Softw. 33 (2010) 1-22; Larsson, Klopfenstein,
Massias and Wallin, "Coordinate descent for SLOPE" (AISTATS 2023), for clusters.
"""

import numpy as np

from libc.math cimport fabs, sqrt
from scipy.linalg.cython_blas cimport daxpy, dgemv

cdef enum:
    NEWTON = 30  # the most steps to the norm of a group

cdef double EXACT = 1e-14  # relative change of that norm that ends them
cdef double SETTLED = 0.03  # of the largest move of clusters: what further sweeps gain little on


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


def descend_groups(
    const double[::1, :] z,
    const Py_ssize_t[::1] starts,
    const Py_ssize_t[::1] groups,
    const double[::1] limits,
    const double[::1] inner,
    const double[::1] square,
    double samples,
    double[:, :, ::1] values,
    double[:, :, ::1] residuals,
):
    """Sweep over some groups: group g has the columns starts[g] to starts[g + 1] of z (m, j).

    The columns of a group are orthogonal, with square (j,) z_i'z_i/m, or square is a bound of the
    group's largest eigenvalue: the step is a proximal one then. limits: alpha w (g,); inner (j,):
    those of the absolute values within, by which pull is first brought nearer to zero. Each
    sweep makes the next of values (s, q, j) and residuals (s, q, m) of those before, the first of
    which are given. With a_i = sum_t pull_ti^2, the norm n of a group's optimum,
    v_i = n pull_i / (d_i n + limit), is the root of 1/sqrt(sum_i a_i / (d_i n + limit)^2) = 1,
    which is concave in n: Newton's method climbs to it.
    """
    cdef double[:, ::1] pull = np.empty((values.shape[1], np.diff(starts).max()))
    cdef double[:, ::1] value, residual
    cdef int m = z.shape[0], size, one = 1
    cdef Py_ssize_t j, g
    cdef double total, slope, norm, rise, share, limit, move
    cdef double per = 1.0 / samples, unit = 1.0, zero = 0.0
    cdef double *block
    for sweep in range(1, values.shape[0]):
        value, residual = values[sweep], residuals[sweep]
        value[:], residual[:] = values[sweep - 1], residuals[sweep - 1]
        for place in range(groups.shape[0]):
            g = groups[place]
            j, size, limit = starts[g], starts[g + 1] - starts[g], limits[g]
            total, norm, block = 0.0, 0.0, <double *>&z[0, j]
            for t in range(value.shape[0]):
                dgemv(
                    "T", &m, &size, &per, block, &m, &residual[t, 0], &one, &zero, &pull[t, 0], &one
                )
                for i in range(size):
                    pull[t, i] += square[j + i] * value[t, j + i]
                    if inner[j + i] > 0.0:
                        share = max(fabs(pull[t, i]) - inner[j + i], 0.0)
                        pull[t, i] = share if pull[t, i] > 0.0 else -share
                    total += pull[t, i] * pull[t, i]
            for _ in range(NEWTON if total > limit * limit else 0):
                total = slope = 0.0
                for t in range(value.shape[0]):
                    for i in range(size):
                        share = 1.0 / (square[j + i] * norm + limit)
                        rise = pull[t, i] * pull[t, i] * share * share
                        total += rise
                        slope += rise * share * square[j + i]
                rise = total * (sqrt(total) - 1.0) / slope if slope > 0.0 else 0.0
                norm += max(rise, 0.0)
                if not rise > EXACT * norm:
                    break
            for t in range(value.shape[0]):
                move = 0.0
                for i in range(size):
                    share = norm / (square[j + i] * norm + limit) if norm > 0.0 else 0.0
                    pull[t, i] = value[t, j + i] - share * pull[t, i]
                    value[t, j + i] -= pull[t, i]
                    move += fabs(pull[t, i])
                if move != 0.0:
                    dgemv(
                        "N", &m, &size, &unit, block, &m, &pull[t, 0], &one, &unit,
                        &residual[t, 0], &one,
                    )


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
    """Cluster k to that level, before the cluster at ``place`` or into it; at zero it is gone."""
    cdef Py_ssize_t first = c.begin[k], size = c.begin[k + 1] - c.begin[k], shift
    cdef Py_ssize_t total = c.begin[c.d], into
    for i in range(size):
        c.spare[i] = c.member[first + i]
    for i in range(first, total - size):
        c.member[i] = c.member[i + size]
    for l in range(k, c.d):  # k is taken out
        c.begin[l] = c.begin[l + 1] - size
        c.level[l] = c.level[l + 1]
    c.d -= 1
    if level == 0.0:
        return
    into = place - (place > k)
    first = c.begin[into]
    for i in range(total - size - 1, first - 1, -1):
        c.member[i + size] = c.member[i]
    for i in range(size):
        c.member[first + i] = c.spare[i]
    if merges:
        for l in range(into + 1, c.d + 1):
            c.begin[l] += size
        return
    for l in range(c.d, into - 1, -1):
        c.begin[l + 1] = c.begin[l] + size
        c.level[l + 1] = c.level[l]
    c.level[into] = level
    c.d += 1


def descend_clusters(
    const double[:, ::1] gram,
    const double[::1] price,
    double[::1] correlation,
    double[::1] values,
    Py_ssize_t sweeps,
):
    """Sweep over SLOPE's clusters, each to its optimum, past others or into one of them.

    price (j + 1,): sums of the leading alpha lambda. correlation B - G v (j,) and values v (j,) are
    worked on in place. Returns whether no cluster met another.
    """
    cdef Clusters c = Clusters(np.asarray(values))
    cdef int j = len(values), one = 1
    cdef Py_ssize_t k, a, first, size, rank, place
    cdef double square, pull, level, step, turn, largest = 0.0, moves
    cdef bint merges, same = True
    for _ in range(sweeps):
        k, moves = 0, 0.0
        while k < c.d:
            first, size = c.begin[k], c.begin[k + 1] - c.begin[k]
            square = pull = 0.0
            for i in range(first, first + size):
                a = c.member[i]
                pull += c.sign[a] * correlation[a]
                for l in range(first, first + size):
                    square += c.sign[a] * c.sign[c.member[l]] * gram[a, c.member[l]]
            if not square > 0.0:
                k += 1
                continue
            pull += square * c.level[k]
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
            for i in range(first, first + size):
                a = c.member[i]
                pull = -step * c.sign[a]
                daxpy(&j, &pull, <double *>&gram[a, 0], &one, &correlation[0], &one)
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
