"""What the loops do to whole arrays, in numpy: `compiled/dense.pxd` has each of it compiled.

`n` is the number of leading entries that take part, of vectors, or of rows and columns; results
are written in place.  `unlock` and `lock` let other threads run in between; numpy needs neither.
"""

import math

import numpy as np

from sparsefit.arrays import Array, IntArray


def unlock() -> object:
    """Let go of the interpreter's lock: what `lock` takes it back with."""
    return None


def lock(held: object) -> None:
    """Take the interpreter's lock back."""


def fill(n: int, value: float, x: Array) -> None:
    """x = value."""
    x[:n] = value


def copy(n: int, x: Array, out: Array) -> None:
    """out = x."""
    out[:n] = x[:n]


def scale(n: int, a: float, x: Array) -> None:
    """x *= a."""
    x[:n] *= a


def shift(n: int, a: float, x: Array) -> None:
    """x += a."""
    x[:n] += a


def add(n: int, a: float, x: Array, y: Array) -> None:
    """y += a x."""
    y[:n] += a * x[:n]


def subtract(n: int, x: Array, y: Array) -> None:
    """y = x - y."""
    np.subtract(x[:n], y[:n], out=y[:n])


def clip(n: int, x: Array) -> None:
    """What is negative becomes zero."""
    np.maximum(x[:n], 0.0, out=x[:n])


def sizes(n: int, x: Array, share: Array, out: Array) -> None:
    """out = |x| share."""
    np.multiply(np.abs(x[:n]), share[:n], out=out[:n])


def square(n: int, x: Array) -> float:
    """x'x."""
    return float(x[:n] @ x[:n])


def largest(n: int, x: Array) -> float:
    """The largest |x_i|, 0 of none; a NaN stays."""
    return float(np.abs(x[:n]).max(initial=0.0))


def least(n: int, x: Array) -> float:
    """The least x_i, at most 0; a NaN stays."""
    return float(x[:n].min(initial=0.0))


def highest(n: int, x: Array) -> int:
    """Where the largest positive x_i stands, 0 where there is none; NaNs are passed over."""
    return int(np.where(x[:n] > 0.0, x[:n], 0.0).argmax())


def position(n: int, value: float, x: Array) -> int:
    """Where the value stands first."""
    return int((x[:n] == value).argmax())


def soonest(n: int, move: Array, weights: Array, near: float) -> int:
    """Which of the weights is the first to vanish on the way along `move`; -1 if none shrinks."""
    if n == 0:
        return -1
    rate = -move[:n] / np.fmax(weights[:n], near)
    first = highest(n, rate)
    return first if rate[first] > 0.0 else -1


def rates(
    n: int, correlation: Array, descent: Array, share: Array, alpha: float, near: float, out: Array
) -> float:
    """Events per unit of alpha, at +alpha and then at -alpha (2n), times share; the largest."""
    np.divide(1.0 - descent[:n], np.fmax(alpha - correlation[:n], near), out=out[:n])
    np.divide(1.0 + descent[:n], np.fmax(alpha + correlation[:n], near), out=out[n : 2 * n])
    both = out[: 2 * n].reshape(2, n)
    both *= share[:n]
    return float(np.fmax.reduce(out[: 2 * n], initial=0.0))


def gather(n: int, full: Array, index: IntArray, sign: Array, out: Array) -> None:
    """out = sign * full[index]."""
    np.multiply(full[index[:n]], sign[:n], out=out[:n])


def combine(n: int, matrix: Array, index: IntArray, sign: Array, x: Array, out: Array) -> None:
    """out = sum of x_i sign_i matrix[index_i]."""
    np.dot(x[:n] * sign[:n], matrix[index[:n]], out=out[: matrix.shape[1]])


def apply(n: int, matrix: Array, x: Array, out: Array) -> None:
    """out = M x of a symmetric matrix."""
    out[:n] = np.dot(matrix[:n, :n], x[:n])


def block(n: int, matrix: Array, index: IntArray, sign: Array, out: Array) -> None:
    """out = the rows and columns `index` of the matrix, times their signs."""
    out[:n, :n] = matrix[np.ix_(index[:n], index[:n])] * np.multiply.outer(sign[:n], sign[:n])


def upper_block(n: int, matrix: Array, index: IntArray, share: Array, out: Array) -> None:
    """The same, of which only the diagonal and what is right of it count."""
    block(n, matrix, index, share, out)


def rank_one(n: int, a: float, x: Array, matrix: Array) -> None:
    """M += a x x'."""
    matrix[:n, :n] += (a * x[:n])[:, None] * x[:n]


def border(n: int, position: int, line: Array, matrix: Array) -> None:
    """Row and column `position` of M become the line."""
    matrix[position, :n] = matrix[:n, position] = line[:n]


def negate(n: int, matrix: Array) -> None:
    """M = -M."""
    np.negative(matrix[:n, :n], out=matrix[:n, :n])


def highest_diagonal(n: int, matrix: Array, left: Array) -> int:
    """Where the largest diagonal entry stands among those that are left (> 0)."""
    return int(np.where(left[:n] > 0.0, matrix.diagonal()[:n], -np.inf).argmax())


def multiply(n: int, x: Array, y: Array, out: Array) -> None:
    """out = x y."""
    np.multiply(x[:n], y[:n], out=out[:n])


def divide(n: int, by: Array, x: Array, out: Array) -> None:
    """out = x / by."""
    np.divide(x[:n], by[:n], out=out[:n])


def add_ratio(n: int, a: float, x: Array, by: Array, y: Array) -> None:
    """y += a x / by."""
    y[:n] += a * x[:n] / by[:n]


def opposite(n: int, x: Array, out: Array) -> None:
    """out = 1 - x."""
    np.subtract(1.0, x[:n], out=out[:n])


def root(value: float) -> float:
    """The square root."""
    return math.sqrt(value)


def roots(n: int, x: Array) -> None:
    """x = its square roots."""
    np.sqrt(x[:n], out=x[:n])


def root_sum(n: int, x: Array) -> float:
    """Sum of the square roots of x."""
    return float(np.sqrt(x[:n]).sum())


def total(n: int, x: Array) -> float:
    """Sum of x."""
    return float(x[:n].sum())


def take(n: int, full: Array, index: IntArray, out: Array) -> None:
    """out = full[index]."""
    out[:n] = full[index[:n]]


def put(n: int, x: Array, index: IntArray, out: Array) -> None:
    """out[index] = x."""
    out[index[:n]] = x[:n]


def picked_product(n: int, full: Array, index: IntArray, x: Array) -> float:
    """full[index]'x."""
    return float(full[index[:n]] @ x[:n])


def lift(n: int, value: float, matrix: Array) -> None:
    """The value more on the diagonal."""
    matrix[:n, :n].flat[:: n + 1] += value


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
