"""The regression problem of all back-ends, from any design matrix."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sparsefit.arrays import Array, BoolArray, Brief, IntArray, frozen
from sparsefit.cached import cached_property
from sparsefit.errors import InputError, one_line, shown
from sparsefit.regression.design import Design
from sparsefit.regression.losses import SQUARES, Squares
from sparsefit.regression.penalties import Penalty, alpha_max

OFFSET = 30.0  # offsets beyond which columns are shifted before they are centred
LARGEST, SMALLEST = 1e140, 1e-140  # norms of columns and targets, whose products all are in range


@dataclass(frozen=True, eq=False)
class Spectrum:
    """theta = U diag(s) V': singular_values (r,), right_vectors V' (r, k), projected U'Y (r, n).

    seconds: the time of the factorisation, charged to each fit that uses it.
    """

    singular_values: Array
    right_vectors: Array
    projected: Array
    seconds: float = 0.0

    def retained(self, rcond: float | None, samples: int) -> BoolArray:
        """A mask (r,) of the largest singular value s_max and those above rcond * s_max.

        rcond: None is the rounding level eps * max(m, k).
        """
        if rcond is None:
            rcond = float(np.finfo(float).eps * max(samples, self.right_vectors.shape[1]))
        large: BoolArray = self.singular_values > rcond * self.singular_values[0]
        large[0] = True
        return large


@dataclass(frozen=True, eq=False, repr=False)
class RegressionProblem(Brief):
    """target (m, n) ~ theta (m, k) W (k, n), with columns in groups.

    `from_arrays` constructs it from arrays and labels; ``design`` has the sums of theta's columns.
    theta and target are finite; norms of their columns are in [1e-140, 1e140], or 0 of a target.

    groups: (k,), the group of each column, numbered 0, 1, 2, ... without a gap. group_scales: (g,),
    the length scale of each group, or None. subgroups: (k,), numbers from 0 of smaller groups, each
    within one group, such as the waves of a ring, or None. parameters: (s, p), of the modes of the
    family that the columns belong to. sample_count: m, where theta and target are the triangle of a
    QR of the m original rows, with their inner products. sample_weight: (m,) or None; intercept:
    whether a constant column is projected off; the target is weighted and centred by these, and
    raw_target (m, n) is as it was, None without them. partial: theta has only some rows of a
    problem, and may have columns of zeros, whose weights are zero.
    """

    theta: Any
    target: Array
    groups: IntArray
    names: tuple[str, ...]
    target_names: tuple[str, ...]
    group_scales: Array | None = None
    sample_count: int | None = None
    subgroups: IntArray | None = None
    parameters: Array | None = None
    raw_target: Array | None = None
    sample_weight: Array | None = None
    intercept: bool = False
    partial: bool = False

    def __post_init__(self) -> None:
        shapes = f"theta {self.theta.shape} and target {self.target.shape} must"
        if len(self.target) != self.theta.shape[0]:
            raise InputError(f"{shapes} have the same number of rows")
        if not all((*self.theta.shape, self.targets)):
            raise InputError(f"{shapes} not be empty")
        for name in ("theta", "target"):
            if isinstance(values := getattr(self, name), np.ndarray):
                values = values.view()
                values.flags.writeable = False
                object.__setattr__(self, name, values)
        squares = self.design.squares
        squares = np.where(squares == 0.0, 1.0, squares) if self.partial else squares
        alike = "is constant, as the intercept is; drop it" if self.intercept else ""
        _refuse_unfit(squares, self.names, alike=alike)
        _ = self.digest  # of the data as they are now
        with np.errstate(over="ignore", invalid="ignore"):  # refused by what the sum becomes
            squares = np.einsum("ij,ij->j", self.target, self.target)
        _refuse_unfit(squares, self.target_names, self.target)

    @classmethod
    def from_arrays(
        cls,
        theta: Any,
        target: ArrayLike,
        groups: ArrayLike | None = None,
        names: Sequence[str] | None = None,
        *,
        subgroups: ArrayLike | None = None,
        sample_weight: ArrayLike | None = None,
        intercept: bool = False,
        partial: bool = False,
    ) -> "RegressionProblem":
        """A problem from any design matrix theta (m, k) and target (m,) or (m, n).

        theta: an array, a sparse matrix (scipy), a memory map, a dask array, a DataFrame or any
        object with a shape whose rows can be sliced. Names of columns of a frame or series are
        kept. Theta of float64 in C or Fortran order is not copied and must not change while the
        problem is in use: `fit` and `path` refuse an array in memory that was changed in place, by
        a digest of 512 of its entries; a change of files or dask arrays is not detected.

        ``groups``: k labels that sort, equal for the columns of one group, in their order or by
        their names (a dict, a Series); without them every column is one. ``subgroups``: k labels of
        smaller groups within these. ``sample_weight`` (m,) >= 0: the weight of each sample's loss,
        whatever their sum; ``intercept`` adds an unpenalised constant column. Raises InputError on
        shapes or pandas indexes that do not match, subgroups that span groups, values that are not
        finite, masked arrays and, but where ``partial``, columns of zeros (or constant ones beside
        an intercept).
        """
        for name, rows in (("target", target), ("sample_weight", sample_weight)):
            index: Any = getattr(theta, "index", None)
            other: Any = getattr(rows, "index", None)
            if hasattr(index, "equals") and hasattr(other, "equals") and not index.equals(other):
                words = f"theta and {name} differ in their index: align them"
                raise InputError(f"{words}, or use to_numpy() where rows match by position")
        if not np.isscalar(intercept) or intercept not in (True, False):
            raise InputError(f"intercept must be true or false, not {shown(intercept)}")
        source, values = _source(theta, intercept), real_matrix(target, "target").copy("K")
        columns, inner = int(source.shape[1]), None
        named = _labels(theta, columns) if names is None else names
        listed = isinstance(named, Iterable) and getattr(named, "ndim", 1) == 1
        if not listed or isinstance(named, str) or len(labels := tuple(map(str, named))) != columns:
            raise InputError(f"names must be a list with one name per column, {columns} of them")
        numbers = np.arange(columns) if groups is None else _numbers(groups, labels, "groups")
        if subgroups is not None:
            inner = _numbers(subgroups, labels, "subgroups")
            if len(set(zip(inner.tolist(), numbers.tolist(), strict=True))) > inner.max() + 1:
                raise InputError("subgroups must lie within groups: one of them spans two groups")
        weight, posed = None, dict[str, Any](target=values)
        if sample_weight is not None:
            weight = frozen("sample_weight", sample_weight, (len(values),))
            if weight.min() < 0 or not 0.0 < weight.max() <= LARGEST**2:
                words = f"sample_weight must be in [0, {LARGEST**2:g}]"
                raise InputError(f"{words}, and not zero for every sample")
        if (intercept or weight is not None) and len(values) == source.shape[0]:
            posed = _adjusted(values, weight, intercept)
        targets = tuple(map(str, _labels(target, values.shape[1])))
        posed |= {"groups": numbers, "names": labels, "target_names": targets}
        return cls(source, **posed, subgroups=inner, partial=partial)

    @cached_property
    def design(self) -> Design:
        """The design of the columns, weighted and centred."""
        roots, direction = _row_factors(self.sample_weight, self.intercept, len(self.target))
        return Design(self.theta, self.samples, roots, direction, self.offset)

    @cached_property
    def offset(self) -> Array | None:
        """The medians (k,) of some rows, 0 of columns near zero; None of all, or no intercept.

        A column whose offset is OFFSET times its deviations loses digits when it is centred.
        """
        if not self.intercept or Design(self.theta, self.samples).kind != "dense":
            return None
        whole = isinstance(self.theta, np.ndarray)  # other sources may have no strides
        rows = self.theta[:: max(len(self.target) // 64, 1)] if whole else self.theta[0:64]
        rows = np.asarray(rows, dtype=np.float64)
        with np.errstate(over="ignore", invalid="ignore"):  # refused by what the sums become
            middle = np.median(rows, axis=0)
            far = np.abs(middle) > OFFSET * np.abs(rows - middle).max(axis=0)
        return np.where(far, middle, 0.0) if far.any() else None

    @cached_property
    def digest(self) -> bytes:
        """The digest of the design at construction; see `refuse_changes`."""
        return self.design.digest()

    def refuse_changes(self) -> None:
        """Raise InputError where the digest of the design has changed since construction."""
        if self.design.digest() != self.digest:
            raise InputError("theta was changed while the problem was in use: pass a copy")

    @cached_property
    def rows(self) -> Array:
        """Theta (m, k), weighted and centred, as one array. Raises InputError if not in memory."""
        if not self.design.in_memory:
            words = "this needs theta as one array in memory, and it is sparse, dask's or a file's"
            raise InputError(f"{words}: use lasso or another penalised back-end")
        rows: Array = self.theta
        if self.raw_target is not None:
            rows = self.design.raw_columns(np.arange(self.columns))
            rows[:, self.design.squares == 0.0] = 0.0  # columns that are constant, to rounding
        return rows

    def part(self, rows: IntArray) -> "RegressionProblem":
        """The problem of some of the samples. Raises InputError as `from_arrays` does."""
        new: dict[str, Any] = {"target": self.target[rows]}
        if self.raw_target is not None:
            weight = None if self.sample_weight is None else self.sample_weight[rows]
            new = _adjusted(self.raw_target[rows], weight, self.intercept)
        return replace(self, theta=self.theta[rows], sample_count=None, partial=True, **new)

    def alpha_max(self, penalty: Penalty) -> float:
        """The smallest alpha whose solution is zero: the dual norm of Z'u/m, u of R = Y."""
        cross = self.cross
        if np.isfinite(penalty.loss.clip):
            cross = self.design.correlate(penalty.loss.pull(self.target, self.target))
        return alpha_max(cross, penalty)

    def intercept_of(self, weights: Array, loss: Squares = SQUARES) -> Array:
        """The intercept (n,) beside weights (k, n), in the units of the target; 0 without one.

        It is the weighted mean of Y - theta W, to which Huber's loss adds its own level.
        """
        design, raw = self.design, self.raw_target
        if design.direction is None or raw is None:
            return np.zeros(self.targets)
        weighted = raw if design.weights is None else design.weights[:, None] * raw
        level = design.direction @ weighted - design.means @ weights
        if loss.direction is not None:
            residual = self.target - design.raw_predict(weights)
            level += loss.level(residual, loss.bound(self.target))
        intercept = level / np.sqrt(len(raw))
        return np.asarray(intercept if self.offset is None else intercept - self.offset @ weights)

    @property
    def samples(self) -> int:
        """Number of samples m."""
        return self.sample_count or int(self.theta.shape[0])

    @property
    def columns(self) -> int:
        """Number of columns k."""
        return int(self.theta.shape[1])

    @property
    def targets(self) -> int:
        """Number of targets n."""
        return int(self.target.shape[1])

    @cached_property
    def cross(self) -> Array:
        """Z'Y/m (k, n), read-only, as back-ends share it."""
        cross = self.design.correlate(self.target)
        cross.setflags(write=False)
        return cross

    @cached_property
    def target_square(self) -> Array:
        """|y_t|^2/m (n,), read-only."""
        square: Array = np.einsum("ij,ij->j", self.target, self.target) / self.samples
        square.setflags(write=False)
        return square

    @property
    def null_objective(self) -> float:
        """The objective at zero weights, |Y|^2/2m."""
        return 0.5 * float(self.target_square.sum())

    @cached_property
    def spectrum(self) -> Spectrum:
        """The singular value decomposition of theta, after a QR that reads a tall matrix once.

        Trailing rows of the pivoted factor are dropped where their norm is at most a sixteenth of
        the rounding level: singular values change by no more, and near-copies leave few rows.
        """
        from scipy.linalg import qr_multiply  # who reads an estimator need not wait for it

        start, rows, target = perf_counter(), self.rows, self.target
        if len(rows) > self.columns + self.targets:
            rows, target = compressed([(rows, target)])
        pivoted: Any = qr_multiply  # whose types do not know of the order
        turned, triangle, order = pivoted(rows, target.T, pivoting=True)
        norms = np.sqrt(np.cumsum(np.square(triangle[::-1]).sum(axis=1)))[::-1]
        level = float(np.finfo(float).eps) * max(self.samples, self.columns)
        rank = max(int(np.sum(norms > level / 16.0 * norms[0])), 1)
        leading = np.empty((rank, self.columns))
        leading[:, order] = triangle[:rank]
        left, singular_values, right = np.linalg.svd(leading, full_matrices=False)
        right[:, self.design.squares == 0.0] = 0.0  # of columns of zeros, to the bit
        projected = left.T @ turned[:, :rank].T
        return Spectrum(singular_values, right, projected, perf_counter() - start)


def _row_factors(
    weight: Array | None, intercept: bool, count: int
) -> tuple[Array | None, Array | None]:
    """The roots (m,) of sample weights over their mean, and the direction of an intercept.

    None without them. The intercept's column times the roots is sqrt(m) times the direction.
    """
    roots = None if weight is None else np.sqrt(weight / weight.mean())
    if not intercept:
        return roots, None
    return roots, (np.ones(count) if roots is None else roots) / np.sqrt(count)


@np.errstate(over="ignore", invalid="ignore")  # refused by what the sums become
def _adjusted(raw: Array, weight: Array | None, intercept: bool) -> dict[str, Any]:
    """The fields of a problem with sample weights and an intercept, for the target ``raw``."""
    roots, direction = _row_factors(weight, intercept, len(raw))
    level = 0.0 if direction is None else np.median(raw, axis=0)  # a constant target becomes 0
    target = raw - level
    target = target if roots is None else target * roots[:, None]
    if direction is not None:
        target = target - np.multiply.outer(direction, direction @ target)
    own = {"raw_target": raw, "sample_weight": weight, "intercept": intercept}
    return {"target": target, **own}


def compressed(blocks: Iterable[tuple[Array, Array]]) -> tuple[Array, Array]:
    """Theta and target in at most k + n rows: R of a QR of the rows [theta, target], in blocks.

    QR, not Z'Z: the certificate takes residuals of these rows, of which Z'Z loses half the digits.
    """
    from scipy.linalg.lapack import dgeqrf  # in place, in two thirds of the time of numpy's

    lower, columns = np.zeros((0, 0)), 0  # R', whose rows lie in a piece
    for theta, target in blocks:
        across, columns = np.concatenate([theta.T, target.T]), theta.shape[1]
        if lower.size:
            across = np.concatenate([lower, across], axis=1)
        size = len(across)
        lower = np.tril(dgeqrf(across.T, lwork=32 * size, overwrite_a=1)[0][:size].T)
    return lower[:columns].T, lower[columns:].T


def _source(theta: Any, intercept: bool) -> Any:
    """The source of a `Design`: an array of float64, not copied where it is one, or a CSC matrix.

    Beside an intercept a nearly full sparse matrix becomes an array, whose columns can be shifted.
    Raises InputError on anything but a matrix of real numbers.
    """
    package = type(theta).__module__.partition(".")[0]
    sliced = not hasattr(theta, "__array__") and hasattr(theta, "__getitem__")
    is_sparse = package == "scipy" and hasattr(theta, "tocsc")
    by_rows = package == "dask" or isinstance(theta, np.memmap) or sliced
    if not (is_sparse or (by_rows and hasattr(theta, "shape"))):
        return real_matrix(theta, "theta")
    if len(theta.shape) != 2 or np.dtype(getattr(theta, "dtype", float)).kind not in "fiub":
        raise InputError(f"theta must be a matrix of real numbers, not {type(theta).__name__}")
    if not is_sparse:
        return theta
    if intercept and 1.5 * theta.nnz >= math.prod(theta.shape):  # less memory as an array
        return theta.toarray().astype(np.float64, copy=False)
    matrix = theta.tocsc()
    matrix = matrix if matrix.dtype == np.float64 else matrix.astype(np.float64)
    if not matrix.has_canonical_format:
        matrix = matrix.copy()  # the caller's, perhaps
        matrix.sum_duplicates()
    return matrix


def real_matrix(values: ArrayLike, name: str) -> Array:
    """The values as a float64 matrix, without a copy if in C or Fortran order.

    name: of theta, of a target, which may be one column, or of rows, which may be one.
    """
    if hasattr(values, "toarray"):
        raise InputError(f"{name} is a sparse matrix: pass {name}.toarray()")
    if np.ma.is_masked(values):
        raise InputError(f"{name} is masked: drop the rows whose values are missing")
    try:
        if np.asarray(values).dtype.kind in "cmM":
            raise TypeError("complex numbers and times are none")
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        if name == "theta" and hasattr(values, "iloc"):  # names the first column without numbers
            for place, label in enumerate(getattr(values, "columns", ())):
                real_matrix(values.iloc[:, [place]], f"column {shown(label)}")
        raise InputError(f"{name} must hold real numbers: {one_line(str(error), 100)}") from None
    if array.ndim == 1 and name != "theta":
        array = array[:, None] if name == "target" else array[None]
    if array.ndim != 2:
        shape = "(m,) or (m, n)" if name == "target" else "(m, k)"
        raise InputError(f"{name} must have shape {shape}, not {array.shape}")
    return array if array.flags.c_contiguous or array.flags.f_contiguous else array.copy()


def _labels(table: Any, count: int) -> Sequence[Any]:
    """The column names of a frame, or the name of a series; 0, 1, ... of any other array."""
    if hasattr(table, "to_numpy") and hasattr(table, "columns"):
        return list(table.columns)
    name = getattr(table, "name", None) if hasattr(table, "to_numpy") and count == 1 else None
    return range(count) if name is None else [name]


def _numbers(labels: Any, names: Sequence[str], name: str) -> IntArray:
    """Numbers (k,) from 0 for the labels of the k columns, in the order of the labels.

    labels: in the order of the columns, or a dict or Series by the names of all columns.
    """
    example, columns = f"{name} must have one label per column, such as [0, 0, 1]", len(names)
    if hasattr(labels, "items"):
        by_name = {str(key): label for key, label in labels.items()}
        if by_name.keys() == set(names):
            labels = [by_name[each] for each in names]
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


def _refuse_unfit(
    squares: Array, names: Sequence[str], target: Array | None = None, alike: str = ""
) -> None:
    """Raise an InputError that names the first column whose norm is out of range.

    squares (k,): of the norms, refused where NaN, infinite, above LARGEST or below SMALLEST (alike:
    the words for that). A column of the target (m, n) may be zero.
    """
    which, small = "", squares < SMALLEST**2
    words = alike or f"is zero in every sample (or below {SMALLEST:g}); drop it or change the unit"
    if target is not None:
        which, small = "of the target ", small & target.any(axis=0)
        words = f"is below {SMALLEST:g}, not 0; change the unit"
    large = f"holds NaN, infinity or values above {LARGEST:g}; clean the data or change the unit"
    for bad, reason in ((~(squares <= LARGEST**2), large), (small, words)):
        columns = np.flatnonzero(bad)
        if len(columns):
            more = f" (and {len(columns) - 1} more)" if len(columns) > 1 else ""
            raise InputError(f"column {shown(names[columns[0]])}{more} {which}{reason}")
