"""Ridge regression (Hoerl and Kennard 1970), in closed form: shrunk, and not sparse."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sparsefit.backends.exact_paths import CHOLESKY
from sparsefit.backends.penalised import ExactPath, PenalisedPath
from sparsefit.errors import one_of
from sparsefit.regression.backend import AlphaFraction, Selection
from sparsefit.regression.objective import Penalty
from sparsefit.regression.problem import RegressionProblem


@dataclass(frozen=True)
class Ridge(PenalisedPath):
    """1/(2m) |Y - ZV|^2 + alpha/2 |V|^2, alpha = alpha_fraction * k.

    No penalty has a solution of zero: the unit is the number of columns k, the trace of Z'Z/m,
    which bounds its largest eigenvalue. solver: ``cholesky`` (closed form), ``clarabel-direct``, or
    through cvxpy ``clarabel``, ``osqp`` or any other it finds installed. alpha_fraction ``auto``:
    chosen by `fit` from the data, by the rule ``selection``, which counts no zeros here.
    """

    name: ClassVar[str] = "ridge"
    exact: ClassVar[ExactPath] = CHOLESKY
    plain: ClassVar[bool] = False
    alpha_fraction: AlphaFraction = 0.001
    solver: str = CHOLESKY.name
    selection: Selection = "cross-validation"

    def check_settings(self) -> None:
        """Raise InputError on a rule that chooses by which weights are zero."""
        if self.selection in ("ebic", "stability"):
            one_of(
                "selection of ridge, whose weights are never zero,",
                self.selection,
                ("bic", "cross-validation"),
            )

    def penalty(self, problem: RegressionProblem) -> Penalty:
        """A ridge alone."""
        k = problem.columns
        return Penalty(np.arange(k), np.zeros(k), joint=True, ridge=1.0)
