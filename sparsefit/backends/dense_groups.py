"""What the group-LASSO's loop alone does to whole arrays, in numpy: `compiled/dense_groups.pxd` has
each of it compiled.

Conventions as in `dense`.
"""

import numpy as np

from sparsefit.arrays import Array, IntArray


def add_ratio(n: int, a: float, x: Array, by: Array, y: Array) -> None:
    """y += a x / by."""
    y[:n] += a * x[:n] / by[:n]


def opposite(n: int, x: Array, out: Array) -> None:
    """out = 1 - x."""
    np.subtract(1.0, x[:n], out=out[:n])


def root_sum(n: int, x: Array) -> float:
    """Sum of the square roots of x."""
    return float(np.sqrt(x[:n]).sum())


def picked_product(n: int, full: Array, index: IntArray, x: Array) -> float:
    """full[index]'x."""
    return float(full[index[:n]] @ x[:n])


def add_diagonal(n: int, a: float, x: Array, matrix: Array) -> None:
    """a x more on the diagonal."""
    matrix[:n, :n].flat[:: n + 1] += a * x[:n]


def mirror(first: int, last: int, width: Array, matrix: Array) -> None:
    """Rows first ... last - 1 up to the diagonal, by the widths of row and column, and columns."""
    part = matrix[first:last, :last]
    part /= np.multiply.outer(width[first:last], width[:last])
    for a in range(first, last):
        matrix[: a + 1, a] = matrix[a, : a + 1]


def unit_scale(n: int, matrix: Array, out: Array) -> None:
    """What gives the matrix a unit diagonal, from both sides."""
    out[:n] = 1.0 / np.sqrt(np.fmax(matrix.diagonal()[:n], np.finfo(float).tiny))


def scaled(n: int, x: Array, matrix: Array, out: Array) -> None:
    """out = diag(x) M diag(x)."""
    np.multiply(matrix[:n, :n], np.multiply.outer(x[:n], x[:n]), out=out[:n, :n])


def all_above(n: int, floor: Array, x: Array) -> bool:
    """Whether no x lies below its floor."""
    return bool(np.all(x[:n] >= floor[:n]))


def start_free(n: int, floor: Array, x: Array, out: Array) -> None:
    """out = 1 where the floor lies below zero or x above."""
    out[:n] = (floor[:n] < 0.0) | (x[:n] > 0.0)


def chosen(n: int, x: Array, out: IntArray) -> int:
    """Where x is positive, ascending, into out: how many."""
    found = np.flatnonzero(x[:n] > 0.0)
    out[: len(found)] = found
    return len(found)


def first_bound(n: int, free: Array, floor: Array, x: Array, target: Array) -> int:
    """Which free variable is the first to meet its floor on the way to the target; -1: none."""
    falling = (free[:n] > 0.0) & (target[:n] < floor[:n])
    if not falling.any():
        return -1
    where = np.flatnonzero(falling)
    return int(where[((floor[where] - x[where]) / (target[where] - x[where])).argmin()])


def advance(n: int, reach: float, target: Array, floor: Array, free: Array, x: Array) -> None:
    """Go that part of the way to the target; what meets its floor is no longer free."""
    move = target[:n] - x[:n]
    falling = (free[:n] > 0.0) & (target[:n] < floor[:n])
    ratio = np.divide(floor[:n] - x[:n], move, out=np.full(n, np.inf), where=falling)
    x[:n] = np.where(ratio <= reach, floor[:n], x[:n] + reach * move)
    free[:n][ratio <= reach] = 0.0


def support(
    n: int,
    eta: Array,
    starts: IntArray,
    group: IntArray,
    begin: IntArray,
    label: IntArray,
    column: IntArray,
) -> int:
    """Groups with eta > 0, where each begins in their columns, and whose each column is; how many.

    `begin` ends with the number of the columns.
    """
    where = np.flatnonzero(eta[:n] > 0.0)
    s, sizes = len(where), starts[where + 1] - starts[where]
    group[:s], begin[0], begin[1 : s + 1] = where, 0, np.cumsum(sizes)
    c = begin[s]
    label[:c] = np.repeat(np.arange(s), sizes)
    column[:c] = np.arange(c) + (starts[where] - begin[:s])[label[:c]]
    return s


def spread(n: int, width: int, t: int, label: IntArray, x: Array, out: Array) -> None:
    """out[g, t] = the x whose label is g, in their places (width,), else zero; g < n."""
    out[:n, t, :width] = 0.0
    out[label[:width], t, np.arange(width)] = x[:width]


def group_products(n: int, starts: IntArray, x: Array, y: Array, out: Array) -> None:
    """out_g = sum of x y over the entries starts_g ... starts_g+1 - 1 of all rows."""
    if n > 0:
        both = np.einsum("ij,ij->j", x[:, : starts[n]], y[:, : starts[n]])
        out[:n] = np.add.reduceat(both, starts[:n])


def inner_product(first: int, last: int, x: Array, y: Array) -> float:
    """Sum of x y over the entries first ... last - 1 of all rows."""
    return float(np.einsum("ij,ij->", x[:, first:last], y[:, first:last]))


def secular_drive(n: int, square: Array, alpha: float, out: Array) -> None:
    """Right-hand side of the Newton system for 1/||C|| = 1/alpha."""
    out[:n] = square[:n] * (np.sqrt(square[:n]) / alpha - 1.0)


def plain_drive(n: int, square: Array, alpha: float, out: Array) -> None:
    """Right-hand side of the Newton system for the gradient of f."""
    out[:n] = 0.5 * (square[:n] - alpha * alpha)


def violations(n: int, eta: Array, level: float, square: Array) -> None:
    """Only squares above the level, of groups with eta = 0, stay; the others become zero."""
    square[:n][(eta[:n] > 0.0) | ~(square[:n] > level)] = 0.0


def drop_negligible(n: int, least: float, power: Array, eta: Array) -> None:
    """eta = 0 where eta times power is not above the least: what rounding left of a bound."""
    eta[:n][~(eta[:n] * power[:n] > least)] = 0.0
