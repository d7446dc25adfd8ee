"""Least squares on a few groups of columns, and the searches that take one group after the other.

    best-scale:  min over groups g of min over W_g of |Y - theta_g W_g|^2
    group-omp:   g* = argmax over g of |P_g R|^2,  W = least squares on all groups so far

P_g projects on the span of a group's columns, so neither their scale nor their correlation counts.
Best-scale is the baseline that sparse back-ends have to justify themselves against: on one cellular
flow nothing sparse is needed; on several superposed ones the best single scale is not the answer.

Source: Lozano, Swirszcz and Abe, "Group orthogonal matching pursuit for variable selection and
prediction" (NeurIPS 2009).
"""

import math
from dataclasses import dataclass
from typing import ClassVar, Literal, get_args

import numpy as np

from sparsefit.arrays import Array, IntArray
from sparsefit.errors import integer_setting, number_setting, one_of
from sparsefit.regression.backend import Solution
from sparsefit.regression.certificate import CertificateKind
from sparsefit.regression.problem import RegressionProblem

UNSAFE = 1e-9  # of Z'Z: a group with an eigenvalue below it, relative, is projected on by its rows
Stop = Literal["decrease", "bic"]
"""The rules by which one more group is worth its weights."""
MOST = 64  # groups that are taken one by one, whatever the rule says
DOUBT = 1e-6  # of |Y|^2: residuals this close in Gram space are settled on the rows


def explained(
    problem: RegressionProblem, weights: Array | None = None, rcond: float | None = None
) -> Array:
    """|P_g R|^2 / m (g,): what each group alone explains of R = Y - theta W (W = 0 without).

    From Z'Z/m and Z'R/m, groups of one size in one batch; from the rows where Z'Z has lost a
    group's rank. rcond: relative to the largest singular value of the group's scaled columns.
    """
    statistics = problem.statistics
    cross = statistics.cross
    if weights is not None:
        cross = cross - statistics.gram @ (weights * statistics.rms[:, None])
    order = np.argsort(problem.groups, kind="stable")
    sizes = np.bincount(problem.groups)
    starts = np.cumsum(sizes) - sizes
    gains = np.zeros(len(sizes))
    floor = max(rcond or 0.0, 0.0) ** 2
    for size in np.unique(sizes[sizes > 0]):
        chosen = np.flatnonzero(sizes == size)
        index = order[starts[chosen][:, None] + np.arange(size)]
        roots, vectors = np.linalg.eigh(statistics.gram[index[:, :, None], index[:, None, :]])
        load = np.sum((vectors.transpose(0, 2, 1) @ cross[index]) ** 2, axis=2)
        kept = roots > max(floor, UNSAFE) * roots[:, -1:]
        gains[chosen] = np.sum(np.where(kept, load / np.where(kept, roots, 1.0), 0.0), axis=1)
        if floor < UNSAFE:  # a coarser rcond drops what rounding could have touched
            for i in np.flatnonzero(~kept.all(axis=1)):
                gains[chosen[i]] = _explained_by_rows(problem, index[i], weights, rcond)
    return gains


def _explained_by_rows(
    problem: RegressionProblem, columns: IntArray, weights: Array | None, rcond: float | None
) -> float:
    """|P_g R|^2 / m by the singular value decomposition of the group's scaled columns."""
    residual = problem.target if weights is None else residual_of(problem, weights)
    z = problem.design.columns(columns)
    left, values, _ = np.linalg.svd(z, full_matrices=False)
    rounding = float(np.finfo(float).eps) * max(z.shape)
    left = left[:, values > (rounding if rcond is None else rcond) * values[0]]
    return float(np.sum((left.T @ residual) ** 2)) / problem.samples


def fit_on(problem: RegressionProblem, columns: IntArray, rcond: float | None = None) -> Array:
    """Weights (k, n), the minimum-norm least squares on these columns in unit rms, by the rows."""
    values = np.linalg.lstsq(problem.design.columns(columns), problem.target, rcond=rcond)[0]
    weights = np.zeros((problem.columns, problem.targets))
    weights[columns] = values / problem.design.rms[columns, None]
    return weights


def residual_of(problem: RegressionProblem, weights: Array) -> Array:
    """R = Y - theta W (rows, n), from the columns in use."""
    residual: Array = problem.target - problem.design.raw_predict(weights)
    return residual


def residual_square(problem: RegressionProblem, weights: Array) -> float:
    """|R|^2 / m of weights (k, n)."""
    residual = residual_of(problem, weights)
    return float(np.sum(residual * residual)) / problem.samples


def is_worth(
    problem: RegressionProblem, weights: Array, larger: Array, stop: Stop, tolerance: float
) -> bool:
    """Whether ``larger`` weights lower the residual sum of squares by more than they cost.

    ``decrease``: by tolerance * |Y|^2; ``bic``: m n ln(RSS) by ln(m n) for each weight more.
    """
    before, after = residual_square(problem, weights), residual_square(problem, larger)
    total = float(problem.statistics.target_square.sum())
    if stop == "decrease":
        return before - after > tolerance * total
    if before <= 1e-28 * total:
        return False  # rounding
    added = int(np.sum(larger != 0) - np.sum(weights != 0))
    count = problem.samples * problem.targets
    return count * math.log(before / max(after, 1e-300)) > added * math.log(count)


@dataclass(frozen=True)
class BestScale:
    """The least squares of the one group of columns that leaves the smallest residual.

    rcond: singular values of a group's columns, in unit rms, below rcond times the largest count
    as zero; None is the rounding level.
    """

    name: ClassVar[str] = "best-scale"
    certificate_kind: ClassVar[CertificateKind] = "fixed_point"
    rcond: float | None = None

    def __post_init__(self) -> None:
        if self.rcond is not None:
            number_setting(self.name, "rcond", self.rcond, low=0.0, high=1.0)

    def solve(self, problem: RegressionProblem) -> Solution:
        """Weights on the chosen group alone."""
        if not problem.target.any():
            return Solution(None, "unidentifiable", f"{self.name}: the target is zero throughout")
        return Solution(self._best(problem))

    def next_weights(self, problem: RegressionProblem, weights: Array) -> Array:
        """The weights (k, n) of the choice made again, whatever these are."""
        return self._best(problem)

    def _best(self, problem: RegressionProblem) -> Array:
        gains = explained(problem, rcond=self.rcond)
        # Z'Z loses what nearly exact fits differ by: those in doubt are compared on the rows.
        doubtful = np.flatnonzero(
            gains >= gains.max() - DOUBT * problem.statistics.target_square.sum()
        )
        fits = [fit_on(problem, np.flatnonzero(problem.groups == g), self.rcond) for g in doubtful]
        return min(fits, key=lambda weights: residual_square(problem, weights))


@dataclass(frozen=True)
class GroupOMP:
    """Greedy groups until one more is not worth it.

    stop: ``decrease``: a group must lower the residual sum of squares by ``tolerance`` * |Y|^2;
    ``bic``: it must lower m n ln(RSS) + parameters ln(m n). ``scales``: stop at so many groups at
    the latest; None has no such limit but 64 groups. The first group is always taken.
    """

    name: ClassVar[str] = "group-omp"
    certificate_kind: ClassVar[CertificateKind] = "fixed_point"
    scales: int | None = None
    tolerance: float = 0.01
    stop: Stop = "decrease"

    def __post_init__(self) -> None:
        if self.scales is not None:
            integer_setting(self.name, "scales", self.scales, least=1)
        number_setting(self.name, "tolerance", self.tolerance, low=0.0, high=1.0)
        one_of(f"stop of {self.name}", self.stop, get_args(Stop))

    def solve(self, problem: RegressionProblem) -> Solution:
        """Weights on the groups that the greedy choice takes."""
        if not problem.target.any():
            return Solution(None, "unidentifiable", f"{self.name}: the target is zero throughout")
        weights = np.zeros((problem.columns, problem.targets))
        steps = 0
        while (larger := self._step(problem, weights)) is not None:
            weights, steps = larger, steps + 1
        return Solution(weights, iterations=steps)

    def next_weights(self, problem: RegressionProblem, weights: Array) -> Array:
        """Weights (k, n) after one more step from these, or fitted again where there is none."""
        following = self._step(problem, weights)
        used = np.flatnonzero(np.isin(problem.groups, self._used(problem, weights)))
        return fit_on(problem, used) if following is None else following

    def _used(self, problem: RegressionProblem, weights: Array) -> IntArray:
        return np.unique(problem.groups[np.any(weights != 0, axis=1)])

    def _step(self, problem: RegressionProblem, weights: Array) -> Array | None:
        """Weights with one more group, or None where the rule says stop."""
        used = self._used(problem, weights)
        if len(used) >= min(self.scales or MOST, int(problem.groups.max()) + 1):
            return None
        gains = explained(problem, weights)
        gains[used] = -1.0
        taken = np.flatnonzero(np.isin(problem.groups, [*used, int(np.argmax(gains))]))
        if len(used) and len(taken) >= problem.samples:
            return None  # no freedom is left: the next fit would be exact
        larger = fit_on(problem, taken)
        if not len(used):
            return larger if larger.any() else None  # the target may be orthogonal to all columns
        worth = is_worth(problem, weights, larger, self.stop, self.tolerance)
        return larger if worth else None
