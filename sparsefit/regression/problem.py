"""The regression problem that every back-end solves, from any design matrix."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike

from sparsefit.arrays import Array, BoolArray, Brief, IntArray
from sparsefit.cached import cached_property
from sparsefit.errors import InputError, is_integer
from sparsefit.regression.continuum import Continuum
from sparsefit.regression.design import CentredDesign, Design, dense_rows
from sparsefit.regression.given import (
    design_of,
    fitting,
    numbers_of,
    refuse_gaps,
    refuse_large,
    refuse_small,
    refuse_zeros,
    source_of,
    squares_of,
    target_of,
)
from sparsefit.regression.penalties import Penalty, alpha_max
from sparsefit.regression.statistics import Statistics


@dataclass(frozen=True, eq=False)
class Spectrum:
    """theta = U diag(s) V': singular_values (r,), right_vectors V' (r, k), projected U'Y (r, n).

    seconds: what it took, so that every fit that uses it can be charged.
    """

    singular_values: Array
    right_vectors: Array
    projected: Array
    seconds: float = 0.0

    def retained(self, rcond: float | None, samples: int) -> BoolArray:
        """The largest singular value s_max and those above rcond * s_max.

        None is the rounding level eps * max(m, k).
        """
        if rcond is None:
            rcond = float(np.finfo(float).eps * max(samples, self.right_vectors.shape[1]))
        kept: BoolArray = self.singular_values > rcond * self.singular_values[0]
        kept[0] = True
        return kept


@dataclass(frozen=True, eq=False)
class Adjustment:
    """What rows are multiplied by, and what an intercept takes off them.

    roots (m,): the roots of the sample weights, whose mean is 1; None where all are 1. direction
    (m,): what the intercept's column is then; None without one. means (k,) and levels (n,): the
    weighted means of the columns and of the target, that were taken off.
    """

    roots: Array | None
    direction: Array | None
    means: Array
    levels: Array


@dataclass(frozen=True, eq=False, repr=False)
class RegressionProblem(Brief):
    """target (m, n) ~ theta (m, k) W (k, n), with columns in groups.

    theta: an array in C or Fortran order, a scipy.sparse CSC matrix, a memory map or whatever else
    has rows to slice, a dask array, or a `Design`; ``design`` has its sums. theta and target are
    finite; norms of their columns are in [1e-140, 1e140], or 0 of a target.
    ``groups`` (k,) numbers the group of each column, 0, 1, 2, ... without a gap; ``group_scales``
    (g,) gives each group's scale, where it has one. Raises InputError on arrays of other kinds or
    shapes, and as `from_arrays` does, which makes all of this from any arrays and labels.
    ``sample_count``: m, where the rows are the triangle of a QR that keeps every inner product of
    the m original ones (`from_blocks`). ``continuum``: the columns between those of the groups, for
    back-ends that make columns of their own; None where they are not known row by row.
    ``subgroups`` (k,): numbers, from 0, of smaller groups that each lie within one group, such as
    the waves of a ring, for penalties of both; None where there are none.
    ``parameters`` (s, p): of the modes of a family whose columns these are, mode by mode.
    ``sums``: the statistics of these rows, where they were summed as the rows came.
    ``adjusted``: weights of the samples and an intercept, which the target here has off already.
    """

    theta: Any
    target: Array
    groups: IntArray
    names: tuple[str, ...]
    target_names: tuple[str, ...]
    group_scales: Array | None = None
    sample_count: int | None = None
    continuum: Continuum | None = None
    subgroups: IntArray | None = None
    parameters: Array | None = None
    sums: Statistics | None = None
    adjusted: Adjustment | None = None

    def __post_init__(self) -> None:
        _check_shapes(self)
        for name in ("theta", "target"):
            object.__setattr__(self, name, _read_only(getattr(self, name)))
        squares = self.design.squares
        refuse_large(squares, self.names, "")
        refuse_zeros(squares, self.names)
        squares = squares_of(self.target)
        refuse_large(squares, self.target_names, "of the target ")
        refuse_small(squares, self.target, self.target_names)

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
    ) -> "RegressionProblem":
        """A problem from any design matrix theta (m, k) and target (m,) or (m, n).

        theta may be sparse (scipy), a memory map, a dask array, a DataFrame, whose columns' names
        are kept, or anything with a shape whose rows can be sliced. Arrays that are float64 in C or
        Fortran order are not copied but read where they are: leave them unchanged while the problem
        is in use, or hand in copies. The problem's own are read-only.

        ``groups``: k labels (of any kind that sorts), equal for the columns of one group; without
        them every column is a group of its own. ``subgroups``: k labels of smaller groups within
        these. ``sample_weight`` (m,) >= 0 weighs the squares, whatever their sum; ``intercept``
        projects an unpenalised constant column out. Raises InputError on shapes that do not match,
        subgroups that span groups, values that are not finite, columns of zeros (or constant ones
        beside an intercept) and masked arrays.
        """
        source, values = source_of(theta), target_of(target)
        columns = int(source.shape[1])
        labels = np.arange(columns) if groups is None else groups
        numbers = numbers_of(labels, columns, "groups")
        inner = None if subgroups is None else numbers_of(subgroups, columns, "subgroups")
        if names is None and hasattr(theta, "columns") and hasattr(theta, "to_numpy"):
            names = [str(name) for name in theta.columns]
        if isinstance(names, str) or not isinstance(names, Iterable | None):
            raise InputError(f"names must be a list with one name per column, not {names!r}")
        known = tuple(map(str, range(columns) if names is None else names))
        targets = tuple(map(str, range(values.shape[1])))
        adjusted = None
        if (sample_weight is not None or intercept) and len(values) == source.shape[0]:
            adjusted, values = _adjustment(source, values, sample_weight, intercept)
        return cls(source, values, numbers, known, targets, subgroups=inner, adjusted=adjusted)

    @classmethod
    def from_blocks(
        cls,
        blocks: Iterable[tuple[ArrayLike, ArrayLike]],
        groups: ArrayLike | None = None,
        names: Sequence[str] | None = None,
    ) -> "RegressionProblem":
        """A problem from blocks of rows (theta, target), in memory of order k^2 + a block.

        Each block is folded into the triangle of a QR decomposition of [theta, target]. QR, and
        not Z'Z, because the certificate takes residuals of these rows: orthogonal
        transformations keep them to rounding, where Z'Z would lose half the digits. Raises
        InputError as `from_arrays` does, and on blocks that do not fit each other.
        """
        triangle, count, columns = compressed(fitting(blocks))
        plain = cls.from_arrays(triangle[:, :columns], triangle[:, columns:], groups, names)
        return replace(plain, sample_count=count)

    def at(self, places: Array) -> "RegressionProblem":
        """The same rows and target, with the continuum's columns at each q (s, p) as groups.

        Raises InputError where no continuum is known.
        """
        if self.continuum is None:
            raise InputError("this problem has the columns of its groups and no others")
        places = np.reshape(places, (-1, self.continuum.parameters))
        theta, parameters, scales, names = self.continuum.design(places)
        groups = np.repeat(np.arange(len(scales)), self.continuum.size)
        return replace(
            self,
            theta=theta,
            groups=groups,
            names=names,
            group_scales=scales,
            sample_count=None,
            subgroups=None,
            parameters=parameters,
            sums=None,
        )

    @cached_property
    def design(self) -> Design:
        """The columns by their sums, with the weights and without the intercept."""
        if self.adjusted is None:
            return design_of(self.theta, self.samples)
        design = design_of(self.theta, self.samples, self.adjusted.roots)
        if self.adjusted.direction is None:
            return design
        return CentredDesign.of(design, self.adjusted.direction)

    @property
    def rows(self) -> Array:
        """Theta (m, k) as one array. Raises InputError where it is none."""
        return dense_rows(self.design)

    @property
    def raw_target(self) -> Array:
        """The target (m, n) as it was, before weights and an intercept."""
        target, adjusted = self.target, self.adjusted
        if adjusted is None:
            return target
        if adjusted.direction is not None:
            target = target + np.multiply.outer(adjusted.direction, adjusted.levels)
        if adjusted.roots is not None:
            target = target / np.where(adjusted.roots > 0, adjusted.roots, 1.0)[:, None]
        return target

    def part(self, rows: IntArray) -> "RegressionProblem":
        """The problem of some samples alone. Raises InputError as `from_arrays` does."""
        plain = replace(
            self,
            theta=self.theta[rows],
            target=self.raw_target[rows],
            sample_count=None,
            sums=None,
            continuum=None if self.continuum is None else self.continuum.at(rows),
            adjusted=None,
        )
        if self.adjusted is None:
            return plain
        roots, intercept = self.adjusted.roots, self.adjusted.direction is not None
        weight = None if roots is None else roots[rows] ** 2
        adjusted, target = _adjustment(plain.theta, plain.target, weight, intercept)
        return replace(plain, target=target, adjusted=adjusted)

    def alpha_max(self, penalty: Penalty) -> float:
        """The smallest alpha whose solution is zero: the dual norm of Z'u/m of the target's u."""
        cross = self.statistics.cross
        if np.isfinite(penalty.loss.clip):
            bound = penalty.loss.bound(np.sqrt(self.statistics.target_square))
            cross = self.design.correlate(np.clip(self.target, -bound, bound))
        return alpha_max(cross, penalty)

    def intercept_of(self, weights: Array) -> Array:
        """The intercept (n,) beside weights (k, n), in the units of the target; 0 without one."""
        if self.adjusted is None or self.adjusted.direction is None:
            return np.zeros(self.targets)
        levels: Array = self.adjusted.levels - self.adjusted.means @ weights
        return levels

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

    def together(self, coupled: bool) -> list[slice]:
        """The targets that are one problem: all of them where ``coupled``, else each by itself."""
        return [slice(None)] if coupled else [slice(t, t + 1) for t in range(self.targets)]

    @cached_property
    def statistics(self) -> Statistics:
        """Sufficient statistics in scaled columns, shared by all back-ends."""
        return self.sums or Statistics.on(self.design, self.target)

    @cached_property
    def compressed(self) -> tuple[Array, Array]:
        """(theta, target) in at most k + n rows, by QR: every least-squares problem is the same."""
        theta = self.rows
        if len(theta) <= self.columns + self.targets:
            return theta, self.target
        triangle = cast(Array, np.linalg.qr(np.hstack([theta, self.target]), mode="r"))
        return triangle[:, : self.columns], triangle[:, self.columns :]

    @cached_property
    def spectrum(self) -> Spectrum:
        """Singular values of theta, by QR first: the tall matrix is read once."""
        start = perf_counter()
        rows, target = self.compressed
        left, singular_values, right = np.linalg.svd(rows, full_matrices=False)
        projected = left.T @ target
        return Spectrum(singular_values, right, projected, perf_counter() - start)


def compressed(blocks: Iterable[tuple[Array, Array]]) -> tuple[Array, int, int]:
    """(triangle, m, k): R (at most k + n rows) of a QR of the rows [theta, target], in blocks.

    Raises InputError where there is no block.
    """
    triangle: Array | None = None
    count = columns = 0
    for theta, target in blocks:
        rows = np.hstack([theta, target])
        count, columns = count + len(rows), theta.shape[1]
        stacked = rows if triangle is None else np.vstack([triangle, rows])
        triangle = cast(Array, np.linalg.qr(stacked, mode="r"))
    if triangle is None:
        raise InputError("no blocks: a regression problem needs at least one")
    return triangle, count, columns


def _check_shapes(problem: RegressionProblem) -> None:
    for name, values in (("theta", problem.theta), ("target", problem.target)):
        dense = isinstance(values, np.ndarray)
        right = values.dtype == np.float64 and values.ndim == 2 if dense else name == "theta"
        if not right or not hasattr(values, "shape"):
            raise InputError(f"{name} must be a float64 array (m, k); from_arrays makes one")
    (m, k), (rows, n) = problem.theta.shape, problem.target.shape
    both = f"theta {problem.theta.shape} and target {problem.target.shape} must"
    if rows != m:
        raise InputError(f"{both} have the same number of rows")
    if m == 0 or k == 0 or n == 0:
        raise InputError(f"{both} not be empty")
    refuse_gaps(problem.groups, k, "groups")
    scales, groups = problem.group_scales, int(problem.groups.max()) + 1
    for name, given, right, each in (
        ("names", len(problem.names), k, "name per column"),
        ("target_names", len(problem.target_names), n, "name per target"),
        ("group_scales", groups if scales is None else len(scales), groups, "scale per group"),
    ):
        if given != right:
            raise InputError(f"{name} must have one {each}: {right}, not {given}")
    if problem.sample_count is not None and not is_integer(problem.sample_count, m):
        raise InputError(f"sample_count must be an integer, at least {m}: the rows stand for them")
    if problem.subgroups is not None:
        refuse_gaps(problem.subgroups, k, "subgroups")
        both_numbers = np.unique(np.stack([problem.subgroups, problem.groups]), axis=1)
        if both_numbers.shape[1] != problem.subgroups.max() + 1:
            raise InputError("subgroups must lie within groups: one of them spans two groups")


def _read_only(values: Any) -> Any:
    if not isinstance(values, np.ndarray):
        return values
    view = values.view()
    view.flags.writeable = False
    return view


def _adjustment(
    source: Any, target: Array, sample_weight: ArrayLike | None, intercept: bool
) -> tuple[Adjustment, Array]:
    """What weights and an intercept do, and the target (m, n) with it done."""
    roots = None
    if sample_weight is not None:
        weight = np.asarray(sample_weight, dtype=float)
        if weight.shape != (len(target),) or not (weight >= 0).all() or not weight.sum() > 0:
            raise InputError(
                f"sample_weight must have {len(target)} numbers >= 0 that are not all 0"
            )
        roots = np.sqrt(weight / weight.mean())
        target = target * roots[:, None]
    means, levels, direction = np.zeros(source.shape[1]), np.zeros(target.shape[1]), None
    if intercept:
        direction = np.ones(len(target)) if roots is None else roots
        design = design_of(source, len(target), roots)
        square = float(direction @ direction)
        means = design.raw_correlate(direction[:, None])[:, 0] / square
        levels = direction @ target / square
        target = target - np.multiply.outer(direction, levels)
    return Adjustment(roots, direction, means, levels), target
