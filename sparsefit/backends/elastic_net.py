"""Elastic net (Zou and Hastie 2005): the LASSO with a ridge, which shares out what is alike."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sparsefit.backends.exact_paths import HOMOTOPY
from sparsefit.backends.penalised import ExactPath, PenalisedPath
from sparsefit.errors import number_setting
from sparsefit.regression.backend import AlphaFraction, Selection
from sparsefit.regression.objective import Penalty
from sparsefit.regression.problem import RegressionProblem


@dataclass(frozen=True)
class ElasticNet(PenalisedPath):
    """1/(2m) |Y - ZV|^2 + alpha [r sum |V_jt| + (1 - r)/2 |V|^2 / y], alpha = fraction * alpha_max.

    l1_ratio: r in (0, 1]; 1 is the LASSO. y is the rms of the target, so that the ridge does not
    depend on its unit; where it is 1, this is scikit-learn's objective. solver: ``homotopy``
    (exact), ``clarabel-working-set``, ``clarabel-direct``, or through cvxpy ``clarabel``, ``osqp``
    or any other it finds installed. alpha_fraction ``auto``: chosen by `fit` from the data, by
    the rule ``selection``.
    """

    name: ClassVar[str] = "elastic-net"
    exact: ClassVar[ExactPath] = HOMOTOPY
    plain: ClassVar[bool] = False
    alpha_fraction: AlphaFraction = 0.1
    l1_ratio: float = 0.5
    solver: str = HOMOTOPY.name
    selection: Selection = "cross-validation"

    def check_settings(self) -> None:
        """Raise InputError on an l1_ratio outside (0, 1]."""
        number_setting(
            self.name,
            "l1_ratio",
            self.l1_ratio,
            low=0.0,
            high=1.0,
            open_low=True,
            meaning="it is the share of the absolute values; for none of them use ridge",
        )

    def penalty(self, problem: RegressionProblem) -> Penalty:
        """Every coefficient a block of its own, and a ridge."""
        k, ratio = problem.columns, self.l1_ratio
        rms = float(np.sqrt(problem.statistics.target_square.mean())) or 1.0
        return Penalty(np.arange(k), np.full(k, ratio), joint=False, ridge=(1.0 - ratio) / rms)
