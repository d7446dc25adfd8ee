"""Cyclic descent over sparse columns, or over groups of dense ones, with the residual kept, compiled.

    v_j <- soft(v_j + z_j'R/m, w_j) / (1 + mu),   R <- R - z_j (change of v_j)

is the optimum of column j alone, z_j'z_j = m, with the limit w_j of its penalty and the ridge mu.
Where the part along e, |e| = 1, is taken off the columns, z_j = s_j (theta_j - mean_j e), the rows
stay sparse: R = S - c e, of which S and the number c change.

Source: Friedman, Hastie and Tibshirani, J. Stat. Softw. 33 (2010) 1-22.
"""

import numpy as np

from libc.math cimport fabs, sqrt
from scipy.linalg.cython_blas cimport dgemv


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
    const double[::1] bend,
    double samples,
    double[:, ::1] residual,
    double[:, ::1] values,
):
    """Sweep once over some groups: group g has the columns starts[g] to starts[g + 1] of z (m, j).

    limits alpha w (g,) and bend (g,), the largest eigenvalue of Z_g'Z_g/m, with which a group's
    step cannot overshoot. residual (q, m) and values (q, j) are worked on in place.
    """
    cdef double[:, ::1] pull = np.empty((residual.shape[0], np.diff(starts).max()))
    cdef int m = z.shape[0], size, one = 1
    cdef Py_ssize_t j, g
    cdef double square, share, move, per = 1.0 / samples, unit = 1.0, zero = 0.0
    cdef double *block
    for place in range(groups.shape[0]):
        g = groups[place]
        j, size = starts[g], starts[g + 1] - starts[g]
        square, block = 0.0, <double *>&z[0, j]
        for t in range(residual.shape[0]):
            dgemv(
                "T", &m, &size, &per, block, &m, &residual[t, 0], &one, &zero, &pull[t, 0], &one
            )
            for i in range(size):
                pull[t, i] += bend[g] * values[t, j + i]
                square += pull[t, i] * pull[t, i]
        share = max(1.0 - limits[g] / sqrt(square), 0.0) / bend[g] if square > 0.0 else 0.0
        for t in range(residual.shape[0]):
            move = 0.0
            for i in range(size):
                pull[t, i] = values[t, j + i] - share * pull[t, i]
                values[t, j + i] -= pull[t, i]
                move += fabs(pull[t, i])
            if move != 0.0:
                dgemv(
                    "N", &m, &size, &unit, block, &m, &pull[t, 0], &one, &unit, &residual[t, 0], &one
                )
