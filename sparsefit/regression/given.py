"""Arrays and labels of a regression problem as they are handed in, made numbers or refused."""

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sparsefit.arrays import Array, BoolArray, IntArray
from sparsefit.errors import InputError, told_with

LARGEST, SMALLEST = 1e140, 1e-140  # norms of columns and targets, whose products all are in range


def source_of(theta: Any) -> Any:
    """The source of a `Design`: arrays as float64, not copied, a DataFrame's values, CSC matrices.

    Raises InputError on what is no matrix of real numbers.
    """
    package = type(theta).__module__.partition(".")[0]
    if package == "scipy" and hasattr(theta, "tocsc"):
        if theta.dtype.kind not in "fiub":
            raise InputError("theta must hold real numbers, not complex ones")
        matrix = theta.tocsc()  # a word on the format would help nobody: it is only stored so
        matrix = matrix if matrix.dtype == np.float64 else matrix.astype(np.float64)
        matrix.sum_duplicates()
        return matrix
    sliced = not hasattr(theta, "__array__") and hasattr(theta, "__getitem__")
    if package == "dask" or isinstance(theta, np.memmap) or (sliced and hasattr(theta, "shape")):
        if len(theta.shape) != 2 or np.dtype(getattr(theta, "dtype", float)).kind not in "fiub":
            raise InputError(f"theta must be a matrix of real numbers, not {type(theta).__name__}")
        return theta
    return _matrix(theta, "theta")


def target_of(target: ArrayLike) -> Array:
    """The target (m, n) as float64. Raises InputError on anything else."""
    return _matrix(target, "target")


def _matrix(values: ArrayLike, name: str) -> Array:
    """A float64 matrix, not copied where it is one in C or Fortran order."""
    if hasattr(values, "toarray"):
        raise InputError(f"{name} is a sparse matrix: hand in {name}.toarray()")
    if np.ma.is_masked(values):
        raise InputError(f"{name} is masked: drop the rows whose values are missing")
    try:
        if np.asarray(values).dtype.kind in "cmM":
            raise TypeError("it holds complex numbers or times")
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} must be an array of real numbers: {error}") from None
    if array.ndim == 1 and name == "target":
        array = array[:, None]
    if array.ndim != 2:
        raise InputError(
            f"theta must have shape (m, k) and target (m,) or (m, n), and {name} has {array.shape}"
        )
    return array if array.flags.c_contiguous or array.flags.f_contiguous else array.copy()


def numbers_of(labels: ArrayLike, columns: int, name: str) -> IntArray:
    """Numbers (k,) from 0 for the labels of the k columns, in the order of the labels.

    Raises InputError on labels that are missing, too many, NaN or cannot be sorted.
    """
    example = f"{name} must have one label per column, such as [0, 0, 1]"
    try:
        given = np.asarray(labels)
    except ValueError:
        raise InputError(f"{example}, not lists of columns") from None
    if given.shape != (columns,):
        raise InputError(f"{example}: {columns} columns, {name} of shape {given.shape}")
    if np.any(given != given):
        raise InputError(f"{name} holds NaN: each column needs a label")
    try:
        return np.unique(given, return_inverse=True)[1].astype(np.intp)
    except TypeError:
        raise InputError(f"{name} must have labels of one kind, such as all numbers") from None


def refuse_gaps(numbers: object, columns: int, name: str) -> None:
    """Raise InputError unless each column has a number and these are 0, 1, 2, ... without gaps."""
    numbered = (
        isinstance(numbers, np.ndarray)
        and (numbers.dtype.kind, numbers.shape) == ("i", (columns,))
        and numbers.min() >= 0
        and numbers.max() < columns
        and np.bincount(numbers).all()
    )
    if not numbered:
        raise InputError(
            f"{name} must be an array with an integer for each of the {columns} columns, numbered "
            "from 0 without a gap; from_arrays makes it of any labels"
        )


def refuse_unfit(squares: Array, names: Sequence[str], values: Array | None = None) -> None:
    """Raise InputError, which names it, on a column that cannot be reckoned with.

    squares (k,) of the columns' norms: NaN, infinite, above LARGEST or below SMALLEST. values
    (m, n): of a target, whose columns may be zero.
    """
    which = "" if values is None else "of the target "
    large = f"{which}holds NaN, infinity or values above {LARGEST:g}; clean the data or change the "
    _refuse(~(squares <= LARGEST**2), names, f"{large}unit")
    small = squares < SMALLEST**2
    if values is None:
        remedy = "drop it or change the unit"
        _refuse(small, names, f"is zero in every sample (or below {SMALLEST:g}); {remedy}")
    else:
        words = f"of the target is below {SMALLEST:g}, not 0; change the unit"
        _refuse(small & values.any(axis=0), names, words)


def _refuse(bad: BoolArray, names: Sequence[str], words: str) -> None:
    columns = np.flatnonzero(bad)
    if len(columns):
        more = f" (and {len(columns) - 1} more)" if len(columns) > 1 else ""
        raise InputError(f"column {names[columns[0]]!r}{more} {words}")


def squares_of(values: Array) -> Array:
    """The squares of the norms of the columns (k,) of values (m, k)."""
    with np.errstate(over="ignore", invalid="ignore"):  # refused by what the sum becomes
        squares: Array = np.einsum("ij,ij->j", values, values)
    return squares


def fitting(blocks: Iterable[tuple[ArrayLike, ArrayLike]]) -> Iterator[tuple[Array, Array]]:
    """The blocks as arrays theta (r, k) and target (r, n), r rows each.

    Raises InputError, with the number of the block, on one that is no pair of arrays, is not finite
    or has not as many columns and targets as the first.
    """
    first: tuple[int, int] | None = None
    for number, block in enumerate(blocks):
        with told_with(f"block {number}"):
            if not (isinstance(block, tuple | list) and len(block) == 2):
                raise InputError("it must be a pair (theta, target)")
            theta, target = _matrix(block[0], "theta"), target_of(block[1])
            widths = theta.shape[1], target.shape[1]
            if len(theta) != len(target) or widths != (first or widths):
                raise InputError(
                    f"theta {theta.shape} and target {target.shape} must have as many rows, and "
                    "as many columns as the blocks before"
                )
            sums = (squares_of(theta), squares_of(target))
            for squares, which in zip(sums, ("", "of the target "), strict=True):
                words = f"{which}holds NaN, infinity or values above {LARGEST:g}"
                _refuse(~(squares <= LARGEST**2), tuple(map(str, range(len(squares)))), words)
        first = widths
        yield theta, target


def compressed(blocks: Iterable[tuple[Array, Array]]) -> tuple[Array, int, int]:
    """(triangle, m, k): R (at most k + n rows) of a QR of the rows [theta, target], in blocks.

    QR, and not Z'Z, because the certificate takes residuals of these rows: orthogonal
    transformations keep them to rounding, where Z'Z would lose half the digits. Raises InputError
    where there is no block.
    """
    triangle: Any = None
    count = columns = 0
    for theta, target in blocks:
        rows = np.hstack([theta, target])
        count, columns = count + len(rows), theta.shape[1]
        triangle = np.linalg.qr(rows if triangle is None else np.vstack([triangle, rows]), mode="r")
    if triangle is None:
        raise InputError("no blocks: a regression problem needs at least one")
    return triangle, count, columns
