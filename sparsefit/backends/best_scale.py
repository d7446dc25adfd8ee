"""Each length scale alone: the baseline that sparse back-ends have to justify themselves against.

    min over groups g of min over W_g of |Y - theta_g W_g|^2

All targets choose together. On one cellular flow nothing sparse is needed; on several superposed
ones the best single scale is not the answer.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sparsefit.arrays import Array, BoolArray
from sparsefit.backends.group_fit import DOUBT, explained, fit_on, residual_square
from sparsefit.errors import number_setting
from sparsefit.regression.backend import Solution
from sparsefit.regression.certificate import CertificateKind
from sparsefit.regression.problem import RegressionProblem


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

    def next_support(self, problem: RegressionProblem, weights: Array) -> BoolArray:
        """The support (k, n) of the choice made again, whatever the weights."""
        support: BoolArray = self._best(problem) != 0
        return support

    def _best(self, problem: RegressionProblem) -> Array:
        gains = explained(problem, rcond=self.rcond)
        # Z'Z loses what nearly exact fits differ by: those in doubt are compared on the rows.
        doubtful = np.flatnonzero(
            gains >= gains.max() - DOUBT * problem.statistics.target_square.sum()
        )
        fits = [fit_on(problem, np.flatnonzero(problem.groups == g), self.rcond) for g in doubtful]
        return min(fits, key=lambda weights: residual_square(problem, weights))
