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
from sparsefit.regression.design import Design, Statistics
from sparsefit.regression.given import (
    compressed,
    fitting,
    numbers_of,
    refuse_gaps,
    refuse_unfit,
    source_of,
    squares_of,
    target_of,
)
from sparsefit.regression.penalties import Penalty, alpha_max


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
        large: BoolArray = self.singular_values > rcond * self.singular_values[0]
        large[0] = True
        return large


@dataclass(frozen=True, eq=False)
class Adjustment:
    """The factors of the rows, and the direction that an intercept takes off them.

    roots (m,): the roots of the sample weights, whose mean is 1; None where all are 1. direction
    (m,): what the intercept's column is then; None without one. levels (n,): the weighted means of
    the target, that were taken off.
    """

    roots: Array | None
    direction: Array | None
    levels: Array

    @classmethod
    def of(
        cls, target: Array, sample_weight: ArrayLike | None, intercept: bool
    ) -> "tuple[Adjustment | None, Array]":
        """The adjustment, if there is one, and the target (m, n) with it made."""
        roots, direction, levels = None, None, np.zeros(target.shape[1])
        if sample_weight is not None:
            weight = np.asarray(sample_weight, dtype=float)
            if weight.shape != (len(target),) or not (weight >= 0).all() or not weight.sum() > 0:
                words = f"sample_weight must have {len(target)} numbers >= 0 that are not all 0"
                raise InputError(words)
            roots = np.sqrt(weight / weight.mean())
            target = target * roots[:, None]
        if intercept:
            direction = np.ones(len(target)) if roots is None else roots
            levels = direction @ target / float(direction @ direction)
            target = target - np.multiply.outer(direction, levels)
        adjusted = roots is not None or intercept
        return cls(roots, direction, levels) if adjusted else None, target


@dataclass(frozen=True, eq=False, repr=False)
class RegressionProblem(Brief):
    """target (m, n) ~ theta (m, k) W (k, n), with columns in groups.

    theta: an array in C or Fortran order, a scipy.sparse CSC matrix, a memory map or whatever else
    has rows to slice, or an array of several workers; ``design`` has its sums. theta and target are
    finite; norms of their columns are in [1e-140, 1e140], or 0 of a target. ``groups`` (k,) numbers
    the group of each column, 0, 1, 2, ... without a gap; ``group_scales`` (g,) gives each group's
    scale, where it has one. Raises InputError on arrays of other kinds or shapes, and as
    `from_arrays` does, which makes all of this from any arrays and labels.
    ``sample_count``: m, where the rows are the triangle of a QR that keeps every inner product of
    the m original ones (`from_blocks`).
    ``subgroups`` (k,): numbers, from 0, of smaller groups that each lie within one group, such as
    the waves of a ring, for penalties of both; None where there are none.
    ``parameters`` (s, p): of the modes of a family whose columns these are, mode by mode.
    ``adjusted``: weights of the samples and an intercept, which the target here has off already.
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
    adjusted: Adjustment | None = None

    def __post_init__(self) -> None:
        _check_shapes(self)
        for name in ("theta", "target"):
            if isinstance(values := getattr(self, name), np.ndarray):
                values = values.view()
                values.flags.writeable = False
                object.__setattr__(self, name, values)
        refuse_unfit(self.design.squares, self.names)
        _ = self.digest  # of the data as they are now
        refuse_unfit(squares_of(self.target), self.target_names, self.target)

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

        theta may be sparse (scipy), a memory map, a distributed array, a DataFrame, whose names
        are kept, or anything with a shape whose rows can be sliced. Arrays that are float64 in C or
        Fortran order are not copied but read where they are: leave them unchanged while the problem
        is in use, or hand in copies. The problem's own are read-only. `fit` and `path` refuse an
        array in memory that was changed in place, by a digest of 512 of its entries; of files and
        distributed arrays no change is noticed.

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
        named = tuple(map(str, range(columns) if names is None else names))
        targets = tuple(map(str, range(values.shape[1])))
        adjusted = None
        if len(values) == source.shape[0]:
            adjusted, values = Adjustment.of(values, sample_weight, intercept)
        return cls(source, values, numbers, named, targets, subgroups=inner, adjusted=adjusted)

    @classmethod
    def from_blocks(
        cls,
        blocks: Iterable[tuple[ArrayLike, ArrayLike]],
        groups: ArrayLike | None = None,
        names: Sequence[str] | None = None,
    ) -> "RegressionProblem":
        """A problem from blocks of rows (theta, target), in memory of order k^2 + a block.

        Each block is folded into the triangle of a QR decomposition of [theta, target]. Raises
        InputError as `from_arrays` does, and on blocks that do not fit each other.
        """
        triangle, count, columns = compressed(fitting(blocks))
        plain = cls.from_arrays(triangle[:, :columns], triangle[:, columns:], groups, names)
        return replace(plain, sample_count=count)

    @cached_property
    def design(self) -> Design:
        """The columns by their sums, with the weights and without the intercept."""
        roots, direction = None, None
        if self.adjusted is not None:
            roots, direction = self.adjusted.roots, self.adjusted.direction
        if direction is not None:
            direction = direction / np.linalg.norm(direction)
        return Design(self.theta, self.samples, roots, direction)

    @cached_property
    def digest(self) -> bytes:
        """The digest of the design when the problem was made; see `refuse_changes`."""
        return self.design.digest()

    def refuse_changes(self) -> None:
        """Raise InputError where the design is not what it was, as far as its digest tells."""
        if self.design.digest() != self.digest:
            raise InputError("theta was changed while the problem was in use: hand in a copy")

    @property
    def rows(self) -> Array:
        """Theta (m, k) as one array. Raises InputError where it is none."""
        if self.adjusted is None and self.design.in_memory:
            rows: Array = self.theta
            return rows
        raise InputError(
            f"this needs theta as one array in memory, and the design is {self.design.kind}, "
            "weighted or centred: use lasso, group-lasso or another penalised back-end, or hand in "
            "the array"
        )

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
        adjusted, target = self.adjusted, self.raw_target[rows]
        if adjusted is not None:
            weight = None if adjusted.roots is None else adjusted.roots[rows] ** 2
            adjusted, target = Adjustment.of(target, weight, adjusted.direction is not None)
        content: Any = {"target": target, "adjusted": adjusted}
        return replace(self, theta=self.theta[rows], **content, sample_count=None)

    def alpha_max(self, penalty: Penalty) -> float:
        """The smallest alpha whose solution is zero: the dual norm of Z'u/m of the target's u."""
        cross = self.statistics.cross
        if np.isfinite(penalty.loss.clip):
            level = np.sqrt(self.statistics.target_square)
            cross = self.design.correlate(penalty.loss.pull(self.target, level, self.samples))
        return alpha_max(cross, penalty)

    @property
    def means(self) -> Array:
        """The weighted means (k,) of the columns that an intercept takes off; 0 without one."""
        if self.adjusted is None or self.adjusted.direction is None:
            return np.zeros(self.columns)
        means: Array = self.design.means / np.linalg.norm(self.adjusted.direction)
        return means

    def intercept_of(self, weights: Array) -> Array:
        """The intercept (n,) beside weights (k, n), in the units of the target; 0 without one."""
        levels = np.zeros(self.targets) if self.adjusted is None else self.adjusted.levels
        intercept: Array = levels - self.means @ weights
        return intercept

    @property
    def samples(self) -> int:
        """Number of samples m."""
        return self.sample_count or int(self.theta.shape[0])

    @property
    def is_compressed(self) -> bool:
        """Whether the rows mix samples, so that none can be taken alone."""
        return self.sample_count is not None

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
        """Sums of the target in scaled columns, shared by all back-ends."""
        return Statistics.on(self.design, self.target)

    @cached_property
    def compressed(self) -> tuple[Array, Array]:
        """(theta, target) in at most k + n rows, by QR: the least-squares problems are the same."""
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


def _check_shapes(problem: RegressionProblem) -> None:
    for name, values in (("theta", problem.theta), ("target", problem.target)):
        dense = isinstance(values, np.ndarray) and not isinstance(values, np.memmap)
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
    for name, count, right, each in (
        ("names", len(problem.names), k, "name per column"),
        ("target_names", len(problem.target_names), n, "name per target"),
        ("group_scales", groups if scales is None else len(scales), groups, "scale per group"),
    ):
        if count != right:
            raise InputError(f"{name} must have one {each}: {right}, not {count}")
    if problem.sample_count is not None and not is_integer(problem.sample_count, m):
        raise InputError(f"sample_count must be an integer, at least {m}: the rows stand for them")
    if problem.subgroups is not None:
        refuse_gaps(problem.subgroups, k, "subgroups")
        pairs = np.unique(np.stack([problem.subgroups, problem.groups]), axis=1)
        if pairs.shape[1] != problem.subgroups.max() + 1:
            raise InputError("subgroups must lie within groups: one of them spans two groups")
