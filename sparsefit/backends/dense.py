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


def copy_rows(n: int, rows: int, x: Array, out: Array) -> None:
    """out = x, in the first n entries of the first rows."""
    out[:rows, :n] = x[:rows, :n]


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


def root(value: float) -> float:
    """The square root."""
    return math.sqrt(value)


def roots(n: int, x: Array) -> None:
    """x = its square roots."""
    np.sqrt(x[:n], out=x[:n])


def total(n: int, x: Array) -> float:
    """Sum of x."""
    return float(x[:n].sum())


def take(n: int, full: Array, index: IntArray, out: Array) -> None:
    """out = full[index]."""
    out[:n] = full[index[:n]]


def put(n: int, x: Array, index: IntArray, out: Array) -> None:
    """out[index] = x."""
    out[index[:n]] = x[:n]


def lift(n: int, value: float, matrix: Array) -> None:
    """The value more on the diagonal."""
    matrix[:n, :n].flat[:: n + 1] += value
