"""What is handed in for a regression problem, made arrays of numbers or refused with a reason."""

from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from numpy.typing import ArrayLike

from sparsefit.arrays import Array, BoolArray, IntArray
from sparsefit.errors import InputError, told_with

FIRST_ROWS = 32  # a column that is not zero in these is not a column of zeros
LARGEST, SMALLEST = 1e140, 1e-140  # norms of columns and targets, whose products all are in range


def rows_of(theta: ArrayLike, target: ArrayLike) -> tuple[Array, Array]:
    """theta (m, k) and target (m, n) as float64 in C order. Raises InputError on anything else."""
    design, values = _floats(theta, "theta"), _floats(target, "target")
    values = values[:, None] if values.ndim == 1 else values
    if design.ndim != 2 or values.ndim != 2:
        raise InputError(
            f"theta must have shape (m, k) and target (m,) or (m, n), not {design.shape} and "
            f"{values.shape}"
        )
    return design, values


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
            theta, target = rows_of(*block)
            widths = theta.shape[1], target.shape[1]
            if len(theta) != len(target) or widths != (first or widths):
                raise InputError(
                    f"theta {theta.shape} and target {target.shape} must have as many rows, and "
                    "as many columns as the blocks before"
                )
            refuse_large(theta, tuple(map(str, range(widths[0]))), "")
            refuse_large(target, tuple(map(str, range(widths[1]))), "of the target ")
        first = widths
        yield theta, target


def _floats(values: ArrayLike, name: str) -> Array:
    if hasattr(values, "toarray"):
        raise InputError(f"{name} is a sparse matrix: hand in {name}.toarray()")
    if np.ma.is_masked(values):
        raise InputError(f"{name} is masked: drop the rows whose values are missing")
    try:
        if np.asarray(values).dtype.kind in "cmM":
            raise TypeError("it holds complex numbers or times")
        return np.ascontiguousarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} must be an array of real numbers: {error}") from None


def numbers_of(labels: ArrayLike, columns: int, name: str) -> IntArray:
    """Numbers (k,) from 0 for the labels of the k columns, in the order of the labels.

    Raises InputError on labels that are missing, too many, NaN or cannot be sorted.
    """
    try:
        given = np.asarray(labels)
    except ValueError:  # lists of columns, say
        raise InputError(
            f"{name} must have one label per column, such as [0, 0, 1], not lists of columns"
        ) from None
    if given.shape != (columns,):
        raise InputError(
            f"{name} must have one label per column: {columns} columns, {name} of shape "
            f"{given.shape}"
        )
    if np.any(given != given):
        raise InputError(f"{name} holds NaN: each column needs a label")
    try:
        return np.unique(given, return_inverse=True)[1].astype(np.intp)
    except TypeError:
        raise InputError(f"{name} must have labels of one kind, such as all numbers") from None


def refuse_other(values: object, name: str) -> None:
    """Raise InputError unless the values are an array (m, k) of float64."""
    if not (isinstance(values, np.ndarray) and values.dtype == np.float64 and values.ndim == 2):
        raise InputError(f"{name} must be a float64 array (m, k); from_arrays makes one of others")


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


def refuse_large(values: Array, names: Sequence[str], which: str) -> None:
    """Raise InputError, which names it, on a column of values (m, k) that cannot be reckoned with.

    One with NaN, infinity or a norm above LARGEST.
    """
    flat = values.ravel(order="K")
    if not np.vdot(flat, flat) <= LARGEST**2:  # one fast sum clears every column, or none
        bad = ~(_squares(values) <= LARGEST**2)
        what = f"{which}holds NaN, infinity or values above {LARGEST:g}"
        _refuse_columns(bad, names, f"{what}; clean the data or change the unit")


def refuse_zeros(values: Array, names: Sequence[str]) -> None:
    """The same on a column of values (m, k) whose norm is below SMALLEST."""
    small = np.flatnonzero(_squares(values[:FIRST_ROWS]) < SMALLEST**2)  # few, but in odd data
    zero = np.zeros(len(names), dtype=bool)
    zero[small] = _squares(values[:, small]) < SMALLEST**2
    what = f"is zero in every sample (or below {SMALLEST:g})"
    _refuse_columns(zero, names, f"{what}; drop it or change the unit")


def refuse_small(values: Array, names: Sequence[str]) -> None:
    """The same on a target of values (m, n) whose norm is below SMALLEST, and not zero."""
    small = (_squares(values) < SMALLEST**2) & values.any(axis=0)
    _refuse_columns(small, names, f"of the target is below {SMALLEST:g}, not 0; change the unit")


def _squares(values: Array) -> Array:
    squares: Array = np.einsum("ij,ij->j", values, values)
    return squares


def _refuse_columns(bad: BoolArray, names: Sequence[str], what: str) -> None:
    found = np.flatnonzero(bad)
    if len(found):
        more = f" (and {len(found) - 1} more)" if len(found) > 1 else ""
        raise InputError(f"column {names[found[0]]!r}{more} {what}")
