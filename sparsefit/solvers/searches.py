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
from numpy.typing import ArrayLike

from sparsefit.arrays import Array, IntArray
from sparsefit.regression.backend import Checked, Solution, setting
from sparsefit.regression.certificate import CertificateKind
from sparsefit.regression.problem import RegressionProblem

FEW = 2000  # columns, whose Z'Z is formed once


def explained(problem: RegressionProblem, weights: Array | None = None) -> Array:
    """|P_g R|^2 / m (g,): the mean square of R = Y - theta W that each group alone explains.

    From Z_g'Z_g/m and Z'R/m; from the rows where Z_g'Z_g has lost a group's rank.
    """
    design, cross, residual = problem.design, problem.cross, problem.target
    if weights is not None:
        residual = residual - design.raw_predict(weights)
        cross = design.correlate(residual)
    whole = design.gram if problem.columns <= FEW else None
    order, sizes = np.argsort(problem.groups, kind="stable"), np.bincount(problem.groups)
    gains = np.zeros(len(sizes))
    for size in np.unique(sizes):
        chosen = np.flatnonzero(sizes == size)
        index = order[np.isin(problem.groups[order], chosen)].reshape(-1, size)
        if whole is None:
            squares = np.stack([design.products(columns) for columns in index])
        else:
            squares = whole[index[:, :, None], index[:, None, :]]
        roots, vectors = np.linalg.eigh(squares)
        load = np.sum((vectors.transpose(0, 2, 1) @ cross[index]) ** 2, axis=2)
        gains[chosen] = np.sum(load / np.where(roots > 0.0, roots, 1.0), axis=1)
        for i in np.flatnonzero(roots[:, 0] <= 1e-9 * roots[:, -1]):
            z = design.columns(index[i])
            fitted = z @ np.linalg.lstsq(z, residual, rcond=None)[0]
            gains[chosen[i]] = np.sum(fitted**2) / problem.samples
    return gains


def fit_on(problem: RegressionProblem, groups: ArrayLike) -> tuple[Array, float]:
    """Weights (k, n), the minimum-norm least squares on some groups, by the rows; |R|^2 / m."""
    columns = np.flatnonzero(np.isin(problem.groups, groups))
    values = np.linalg.lstsq(problem.design.columns(columns), problem.target, rcond=None)[0]
    weights = np.zeros((problem.columns, problem.targets))
    weights[columns] = values / problem.design.rms[columns, None]
    return weights, _square(problem, weights)


def _square(problem: RegressionProblem, weights: Array) -> float:
    residual = problem.target - problem.design.raw_predict(weights)
    return float(np.sum(residual * residual)) / problem.samples


class SupportSearch(Checked, ABC):
    """Base of the back-ends that find a support and fit it by least squares: a fixed point."""

    certificate_kind: ClassVar[CertificateKind] = "fixed_point"
    most: ClassVar[int] = 64  # steps

    def solve(self, problem: RegressionProblem) -> Solution:
        """The weights (k, n) after steps from zero until none pays, or after ``most``.

        A target of zeros is unidentifiable.
        """
        if not problem.target.any():
            return Solution(None, "unidentifiable", f"{self.name}: the target is zero throughout")
        weights, steps = np.zeros((problem.columns, problem.targets)), 0
        while steps < self.most and (larger := self.step(problem, weights)) is not None:
            weights, steps = larger, steps + 1
        return Solution(weights, iterations=steps)

    def next_weights(self, problem: RegressionProblem, weights: Array) -> Array:
        """Weights (k, n) after one more step from these, or fitted again where there is none."""
        following = self.step(problem, weights)
        return fit_on(problem, _used(problem, weights))[0] if following is None else following

    @abstractmethod
    def step(self, problem: RegressionProblem, weights: Array) -> Array | None:
        """Weights (k, n) on a better support, or None where there is none."""


def _used(problem: RegressionProblem, weights: Array) -> IntArray:
    return np.unique(problem.groups[np.any(weights != 0, axis=1)])


@dataclass(frozen=True)
class BestScale(SupportSearch):
    """The least squares of the one group of columns that leaves the smallest residual."""

    name: ClassVar[str] = "best-scale"
    most: ClassVar[int] = 1

    def step(self, problem: RegressionProblem, weights: Array) -> Array | None:
        gains = explained(problem)
        # Z'Z loses what nearly exact fits differ by: those in doubt are compared on the rows.
        close = gains >= gains.max() - 1e-6 * problem.target_square.sum()
        fits = (fit_on(problem, group) for group in np.flatnonzero(close))
        best, _ = min(fits, key=lambda fit: fit[1])
        return None if np.array_equal(best != 0, weights != 0) else best


@dataclass(frozen=True)
class GroupOMP(SupportSearch):
    """Greedy selection of groups until another one does not pay.

    stop: ``decrease``: a group must lower the residual sum of squares by ``tolerance`` * |Y|^2;
    ``bic``: it must lower m n ln(RSS) + parameters ln(m n). ``scales``: stop at so many groups at
    the latest; None has no such limit but 64 groups. The first group is always taken.
    """

    name: ClassVar[str] = "group-omp"
    scales: int | None = setting(None, least=1)
    tolerance: float = setting(0.01, low=0.0, high=1.0)
    stop: Literal["decrease", "bic"] = "decrease"

    def step(self, problem: RegressionProblem, weights: Array) -> Array | None:
        used = _used(problem, weights)
        if len(used) >= min(self.scales or self.most, int(problem.groups.max()) + 1):
            return None
        gains = explained(problem, weights)
        gains[used] = -1.0
        taken = [*used, int(np.argmax(gains))]
        if len(used) and np.isin(problem.groups, taken).sum() >= problem.samples:
            return None  # no freedom is left: the next fit would be exact
        larger, after = fit_on(problem, taken)
        if not len(used):
            return larger if larger.any() else None  # the target may be orthogonal to all columns
        before, total = _square(problem, weights), float(problem.target_square.sum())
        if self.stop == "decrease":
            return larger if before - after > self.tolerance * total else None
        added = int(np.sum(larger != 0) - np.sum(weights != 0))
        count = problem.samples * problem.targets
        gain = count * math.log(max(before, 1e-300) / max(after, 1e-300))
        is_rounding = before <= 1e-28 * total
        return None if is_rounding or gain <= added * math.log(count) else larger
