"""Factors and products of the group-LASSO's loop, by numpy and LAPACK: `compiled/linear.pxd` has
each of it by scipy's BLAS and LAPACK in C.

Matrices are stored by rows, leading entries in use; `n` is the order, `count` a number of rows.
A factor U, with A = U'U, is the upper triangle of its matrix.
"""

import numpy as np
from scipy.linalg.lapack import dpotrf, dpotrs, dtrtrs

from sparsefit.arrays import Array, IntArray


def factorised(n: int, a: Array) -> bool:
    """Cholesky's U of A, whose upper triangle is given, in its place; false where it fails."""
    if n == 0:
        return True
    factor, failed = dpotrf(a[:n, :n].T, lower=1, clean=0)
    a[:n, :n] = factor.T
    return not failed


def solve(n: int, count: int, factor: Array, x: Array) -> None:
    """x = x A^-1 for the rows of x (count, n)."""
    if n > 0:
        x[:count, :n] = dpotrs(factor[:n, :n].T, x[:count, :n].T, lower=1)[0].T


def forward(n: int, above: int, first: int, last: int, factor: Array, x: Array) -> None:
    """x = x U^-1 for rows of x[first:last], whose entries before `above` are zero."""
    if above < n and first < last:
        rows = x[first:last, :, above:n]
        flat = rows.reshape(-1, n - above)
        rows[:] = dtrtrs(factor[above:n, above:n].T, flat.T, lower=1)[0].T.reshape(rows.shape)


def less_overlaps(n: int, first: int, last: int, t: int, x: Array, out: Array) -> None:
    """out -= x x' of the rows x[:last, t], in rows first ... last - 1, up to the diagonal."""
    out[first:last, :last] -= x[first:last, t, :n] @ x[:last, t, :n].T


def less_product(n: int, index: IntArray, matrix: Array, x: Array, out: Array) -> None:
    """out -= x times the rows `index`, ascending, of the matrix, for every row of x."""
    out -= x[:, :n] @ matrix[index[:n]]


def product(first: int, last: int, matrix: Array, x: Array, out: Array) -> None:
    """out = x times the matrix, for every row of x, of which entries first ... last - 1 count."""
    np.matmul(x[:, first:last], matrix[first:last], out=out)
