"""PySINDy's optimizers beside ours: STLSQ and SR3, as PySINDy runs them (extra peers).

Neither minimises what our convex back-ends do, so each is held to its own rule, worked out here
again: STLSQ fits a support by least squares, which one more thresholding keeps; the weights U of
SR3 are those that one more of its steps

    U <- U' where |U'| > threshold, else 0,   U' = (X'X + I/nu)^-1 (X'Y + U/nu)

gives again. Settings act on the columns as they are, in PySINDy's conventions.

Sources: Brunton, Proctor and Kutz (PNAS 2016), STLSQ; Zheng et al. (IEEE Access 2019), SR3.
"""

import warnings
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from typing import Any, ClassVar, Literal

import numpy as np

from sparsefit.arrays import Array
from sparsefit.errors import MissingExtra, described, one_line
from sparsefit.regression.backend import Checked, Solution, setting
from sparsefit.regression.certificate import CertificateKind
from sparsefit.regression.problem import RegressionProblem


@dataclass(frozen=True)
class PySindy(Checked):
    """An optimizer of PySINDy.

    threshold: of the weights; ridge: PySINDy's alpha, of STLSQ; relaxation: nu of SR3. Raises
    InputError on settings that are out of range, and MissingExtra without PySINDy.
    """

    name: ClassVar[str] = "pysindy"
    certificate_kind: ClassVar[CertificateKind] = "fixed_point"
    optimizer: Literal["STLSQ", "SR3"] = "STLSQ"
    threshold: float = setting(0.1, low=0.0)
    ridge: float = setting(0.05, low=0.0)
    max_iterations: int = setting(20, least=1)
    relaxation: float = setting(1.0, low=0.0, open_low=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        if find_spec("pysindy") is None:
            raise MissingExtra("pysindy is not installed: pip install 'sparsefit[peers]'")

    def solve(self, problem: RegressionProblem) -> Solution:
        """The optimizer's weights; what it warns of is its status."""
        package: Any = import_module("pysindy")  # seconds: not before it is needed
        settings: dict[str, Any] = {"alpha": self.ridge, "threshold": self.threshold}
        if self.optimizer == "SR3":
            weight = self.threshold**2 / (2.0 * self.relaxation)
            # Its tolerance of 1e-5 is looser than what a certificate is asked for.
            settings = {"reg_weight_lam": weight, "relax_coeff_nu": self.relaxation, "tol": 1e-12}
        optimizer = getattr(package, self.optimizer)(max_iter=self.max_iterations, **settings)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            try:
                optimizer.fit(problem.rows.copy(), problem.target.copy())
            except Exception as error:  # a public package may raise anything
                return Solution(None, "error", f"pysindy: {described(error)}", type(error).__name__)
        weights = np.asarray(optimizer.coef_, dtype=float).T
        doubts = [str(w.message) for w in caught if not issubclass(w.category, DeprecationWarning)]
        words = one_line(doubts[0], 120) if doubts else "returned"
        if not weights.any():
            reason = f"pysindy: {self.optimizer} left no column: change its settings"
            return Solution(None, "unidentifiable", reason, words)
        return Solution(weights, solver_status=words)

    def next_weights(self, problem: RegressionProblem, weights: Array) -> Array:
        """The weights (k, n) that the optimizer's own rule makes of these."""
        theta, following = problem.rows, np.zeros(weights.shape)
        if self.optimizer == "SR3":
            damping = 1.0 / self.relaxation
            normal = theta.T @ theta + damping * np.eye(problem.columns)
            step = np.linalg.solve(normal, theta.T @ problem.target + damping * weights)
            return np.where(np.abs(step) > self.threshold, step, 0.0)
        for target, values in enumerate(problem.target.T):
            on = np.flatnonzero(weights[:, target])
            normal = theta[:, on].T @ theta[:, on] + self.ridge * np.eye(len(on))
            fitted = np.linalg.solve(normal, theta[:, on].T @ values)
            on = on[np.abs(fitted) >= self.threshold]
            following[on, target] = np.linalg.lstsq(theta[:, on], values)[0]
        return following
