"""What is handed in for a regression problem, made arrays of numbers or refused with a reason."""

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sparsefit.arrays import Array, BoolArray, IntArray
from sparsefit.errors import InputError, told_with
from sparsefit.regression.design import DaskDesign, Design, RowDesign, SparseDesign

LARGEST, SMALLEST = 1e140, 1e-140  # norms of columns and targets, whose products all are in range


def rows_of(theta: ArrayLike, target: ArrayLike) -> tuple[Array, Array]:
    """theta (m, k) and target (m, n) as float64. Raises InputError on anything else."""
    design, values = _floats(theta, "theta"), target_of(target)
    if design.ndim != 2:
        _refuse_dimensions(design, values)
    return design, values


def target_of(target: ArrayLike) -> Array:
    """The target (m, n) as float64. Raises InputError on anything else."""
    values = _floats(target, "target")
    values = values[:, None] if values.ndim == 1 else values
    if values.ndim != 2:
        _refuse_dimensions(np.zeros((0, 0)), values)
    return values


def _refuse_dimensions(design: Array, values: Array) -> None:
    raise InputError(
        f"theta must have shape (m, k) and target (m,) or (m, n), not {design.shape} and "
        f"{values.shape}"
    )


def source_of(theta: Any) -> Any:
    """What a design is made of, unchanged: see `design_of`; arrays as float64, not copied.

    A DataFrame becomes the array of its values. Raises InputError on what is no matrix of reals.
    """
    if isinstance(theta, Design):
        return theta
    package = type(theta).__module__.partition(".")[0]
    if package == "scipy":
        from scipy import sparse

        if sparse.issparse(theta):
            stored: Any = theta
            if stored.dtype.kind not in "fiub":
                raise InputError("theta must hold real numbers, not complex ones")
            matrix = stored.tocsc()  # a word on the format would help nobody: it is only stored so
            matrix = matrix if matrix.dtype == np.float64 else matrix.astype(np.float64)
            matrix.sum_duplicates()
            return matrix
    sliced = not hasattr(theta, "__array__") and hasattr(theta, "__getitem__")
    if package == "dask" or isinstance(theta, np.memmap) or (sliced and hasattr(theta, "shape")):
        if len(theta.shape) != 2 or np.dtype(getattr(theta, "dtype", float)).kind not in "fiub":
            raise InputError(f"theta must be a matrix of real numbers, not {type(theta).__name__}")
        return theta
    array = _floats(theta, "theta")
    if array.ndim != 2:
        _refuse_dimensions(array, np.zeros((0, 0)))
    return array


def design_of(source: Any, samples: int, weights: Array | None = None) -> Design:
    """The design of a source, with factors (m,) of its rows: sums are divided by ``samples``."""
    if isinstance(source, Design):
        return source
    package = type(source).__module__.partition(".")[0]
    if package == "scipy":
        if weights is not None:
            from scipy import sparse

            source = (sparse.diags_array(weights) @ source).tocsc()
        return SparseDesign(source, samples)
    if package == "dask":
        return DaskDesign(source if weights is None else source * weights[:, None], samples)
    return RowDesign(source, samples, weights)


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
            refuse_large(squares_of(theta), tuple(map(str, range(widths[0]))), "")
            refuse_large(squares_of(target), tuple(map(str, range(widths[1]))), "of the target ")
        first = widths
        yield theta, target


def _floats(values: ArrayLike, name: str) -> Array:
    """A float64 array, not copied where it is one in C or Fortran order."""
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
    return array if array.flags.c_contiguous or array.flags.f_contiguous else array.copy()


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


def refuse_large(squares: Array, names: Sequence[str], which: str) -> None:
    """Raise InputError, which names it, on a column that cannot be reckoned with.

    One with NaN, infinity or a norm above LARGEST; squares (k,) of the norms.
    """
    what = f"{which}holds NaN, infinity or values above {LARGEST:g}"
    _refuse_columns(~(squares <= LARGEST**2), names, f"{what}; clean the data or change the unit")


def refuse_zeros(squares: Array, names: Sequence[str]) -> None:
    """Raise InputError on a column whose norm is below SMALLEST; squares (k,)."""
    what = f"is zero in every sample (or below {SMALLEST:g})"
    _refuse_columns(squares < SMALLEST**2, names, f"{what}; drop it or change the unit")


def refuse_small(squares: Array, values: Array, names: Sequence[str]) -> None:
    """Raise InputError on a target of values (m, n) whose norm is below SMALLEST, and not zero."""
    small = (squares < SMALLEST**2) & values.any(axis=0)
    _refuse_columns(small, names, f"of the target is below {SMALLEST:g}, not 0; change the unit")


def squares_of(values: Array) -> Array:
    """The squares of the norms of the columns (k,) of values (m, k)."""
    with np.errstate(over="ignore", invalid="ignore"):  # refused by what the sum becomes
        squares: Array = np.einsum("ij,ij->j", values, values)
    return squares


def _refuse_columns(bad: BoolArray, names: Sequence[str], what: str) -> None:
    found = np.flatnonzero(bad)
    if len(found):
        more = f" (and {len(found) - 1} more)" if len(found) > 1 else ""
        raise InputError(f"column {names[found[0]]!r}{more} {what}")
