"""Least squares on a few groups of columns, and the searches that find them.

    best-scale:  min over groups g of min over W_g of |Y - theta_g W_g|^2
    group-omp:   g* = argmax over g of |P_g R|^2,  W = least squares on all groups so far

P_g projects on the span of a group's columns, so neither their scale nor their correlation counts.
Best-scale is the baseline that sparse back-ends have to justify themselves against: on one cellular
flow nothing sparse is needed; on several superposed ones the best single scale is not the answer.

Source: Lozano, Swirszcz and Abe, "Group orthogonal matching pursuit for variable selection and
prediction" (NeurIPS 2009).
"""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from sparsefit.arrays import Array, IntArray
from sparsefit.regression.backend import Checked, Solution, setting
from sparsefit.regression.certificate import CertificateKind
from sparsefit.regression.problem import RegressionProblem

UNSAFE = 1e-9  # of Z'Z: a group with an eigenvalue below it, relative, is projected on by its rows
DOUBT = 1e-6  # of |Y|^2: residuals this close in Gram space are settled on the rows
MOST = 64  # groups that are taken one by one, whatever the rule says
Stop = Literal["decrease", "bic"]
"""The rules by which one more group is worth its weights."""


def explained(
    problem: RegressionProblem, weights: Array | None = None, rcond: float | None = None
) -> Array:
    """|P_g R|^2 / m (g,): what each group alone explains of R = Y - theta W (W = 0 without).

    From Z'Z/m and Z'R/m, groups of one size in one batch; from the rows where Z'Z has lost a
    group's rank. rcond: relative to the largest singular value of the group's scaled columns.
    """
    statistics, residual = problem.statistics, problem.target
    cross = statistics.cross
    if weights is not None:
        cross = cross - statistics.gram @ (weights * statistics.rms[:, None])
        residual = residual - problem.design.raw_predict(weights)
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
        sound = roots > max(floor, UNSAFE) * roots[:, -1:]
        gains[chosen] = np.sum(np.where(sound, load / np.where(sound, roots, 1.0), 0.0), axis=1)
        # A coarser rcond drops what rounding could have touched.
        for i in np.flatnonzero(~sound.all(axis=1)) if floor < UNSAFE else []:
            z = problem.design.columns(index[i])
            left, values, _ = np.linalg.svd(z, full_matrices=False)
            least = float(np.finfo(float).eps) * max(z.shape) if rcond is None else rcond
            spanned = left[:, values > least * values[0]].T @ residual
            gains[chosen[i]] = float(np.sum(spanned**2)) / problem.samples
    return gains


def fit_on(problem: RegressionProblem, columns: IntArray, rcond: float | None = None) -> Array:
    """Weights (k, n), the minimum-norm least squares on these columns in unit rms, by the rows."""
    values = np.linalg.lstsq(problem.design.columns(columns), problem.target, rcond=rcond)[0]
    weights = np.zeros((problem.columns, problem.targets))
    weights[columns] = values / problem.design.rms[columns, None]
    return weights


def residual_square(problem: RegressionProblem, weights: Array) -> float:
    """|R|^2 / m of weights (k, n)."""
    residual = problem.target - problem.design.raw_predict(weights)
    return float(np.sum(residual * residual)) / problem.samples


def least_residual(
    problem: RegressionProblem, sets: list[IntArray], rcond: float | None = None
) -> Array:
    """The weights (k, n) of the set of groups that leaves the smallest residual, by the rows."""
    fits = (fit_on(problem, np.flatnonzero(np.isin(problem.groups, s)), rcond) for s in sets)
    return min(fits, key=lambda weights: residual_square(problem, weights))


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


class SupportSearch(Checked, ABC):
    """Base of the back-ends that find a support and fit it by least squares: a fixed point."""

    certificate_kind: ClassVar[CertificateKind] = "fixed_point"

    def solve(self, problem: RegressionProblem) -> Solution:
        """Weights on the support that the search finds; a target of zeros has none."""
        if not problem.target.any():
            return Solution(None, "unidentifiable", f"{self.name}: the target is zero throughout")
        return self.searched(problem)

    @abstractmethod
    def searched(self, problem: RegressionProblem) -> Solution:
        """The solution for a target that is not zero."""

    @abstractmethod
    def next_weights(self, problem: RegressionProblem, weights: Array) -> Array:
        """The weights (k, n) that one more step, or the choice made again, makes of these."""


@dataclass(frozen=True)
class BestScale(SupportSearch):
    """The least squares of the one group of columns that leaves the smallest residual.

    rcond: singular values of a group's columns, in unit rms, below rcond times the largest count
    as zero; None is the rounding level.
    """

    name: ClassVar[str] = "best-scale"
    rcond: float | None = setting(None, low=0.0, high=1.0)

    def searched(self, problem: RegressionProblem) -> Solution:
        """Weights on the chosen group alone."""
        return Solution(self.next_weights(problem, np.empty(0)))

    def next_weights(self, problem: RegressionProblem, weights: Array) -> Array:
        """The weights (k, n) of the choice made again, whatever these are."""
        gains = explained(problem, rcond=self.rcond)
        # Z'Z loses what nearly exact fits differ by: those in doubt are compared on the rows.
        close = gains >= gains.max() - DOUBT * problem.statistics.target_square.sum()
        return least_residual(problem, [np.array([g]) for g in np.flatnonzero(close)], self.rcond)


@dataclass(frozen=True)
class GroupOMP(SupportSearch):
    """Greedy groups until one more is not worth it.

    stop: ``decrease``: a group must lower the residual sum of squares by ``tolerance`` * |Y|^2;
    ``bic``: it must lower m n ln(RSS) + parameters ln(m n). ``scales``: stop at so many groups at
    the latest; None has no such limit but 64 groups. The first group is always taken.
    """

    name: ClassVar[str] = "group-omp"
    scales: int | None = setting(None, least=1)
    tolerance: float = setting(0.01, low=0.0, high=1.0)
    stop: Stop = "decrease"

    def searched(self, problem: RegressionProblem) -> Solution:
        """Weights on the groups that the greedy choice takes."""
        weights, steps = np.zeros((problem.columns, problem.targets)), 0
        while (larger := self._step(problem, weights)) is not None:
            weights, steps = larger, steps + 1
        return Solution(weights, iterations=steps)

    def next_weights(self, problem: RegressionProblem, weights: Array) -> Array:
        """Weights (k, n) after one more step from these, or fitted again where there is none."""
        following = self._step(problem, weights)
        used = np.isin(problem.groups, problem.groups[np.any(weights != 0, axis=1)])
        return fit_on(problem, np.flatnonzero(used)) if following is None else following

    def _step(self, problem: RegressionProblem, weights: Array) -> Array | None:
        """Weights with one more group, or None where the rule says stop."""
        used = np.unique(problem.groups[np.any(weights != 0, axis=1)])
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
