"""Square-root LASSO (Belloni, Chernozhukov and Wang 2011): a penalty that knows no noise level."""

import dataclasses
from dataclasses import dataclass
from typing import ClassVar

from sparsefit.backends.conic import DIRECT
from sparsefit.backends.penalised import ExactPath, PenalisedPath
from sparsefit.backends.root_path import SCALED_HOMOTOPY
from sparsefit.errors import InputError
from sparsefit.regression.backend import AlphaFraction, Selection
from sparsefit.regression.objective import Penalty, lasso_penalty
from sparsefit.regression.problem import RegressionProblem


@dataclass(frozen=True)
class SquareRootLasso(PenalisedPath):
    """y |Y - ZV|_F/sqrt(m) + alpha sum |V_jt|, y = |Y|_F/sqrt(m), alpha = fraction * alpha_max.

    A solution is one of the LASSO, at the penalty alpha |Y - ZV|_F/|Y|_F: it falls with the noise
    that is left, so that the same alpha suits clean and noisy data. All targets share that noise.
    solver: ``scaled-homotopy`` (exact path), or through cvxpy ``clarabel`` or another conic solver
    that it finds installed. alpha_fraction ``auto``: chosen by `fit` from the data, by the rule
    ``selection``.
    """

    name: ClassVar[str] = "square-root-lasso"
    exact: ClassVar[ExactPath] = SCALED_HOMOTOPY
    plain: ClassVar[bool] = False
    alpha_fraction: AlphaFraction = 0.1
    solver: str = SCALED_HOMOTOPY.name
    selection: Selection = "cross-validation"

    def check_settings(self) -> None:
        """Raise InputError on a solver that minimises sums of squares alone."""
        if self.solver in DIRECT:
            raise InputError(
                f"{self.name}: {self.solver} minimises sums of squares; use {self.exact.name} or "
                "clarabel"
            )

    def penalty(self, problem: RegressionProblem) -> Penalty:
        """Every coefficient a block of its own, added to the root of the mean square."""
        return dataclasses.replace(lasso_penalty(problem.columns), root=True)

    def referee(self) -> None:
        """None: cones reach gaps of 1e-6 here, and the path more wherever there is a residual."""
        return
