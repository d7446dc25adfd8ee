"""Back-ends as the optimizer of a SINDy model (extra ``peers``), in place of ``pysindy.STLSQ()``.

    X' = Theta(X) W

PySINDy computes the library Theta (m, k) and the derivatives X' (m, n); an optimizer determines the
sparse W, here by any back-end, with a certificate.

Source: Brunton, Proctor and Kutz, PNAS 113 (2016) 3932-3937; `pysindy.optimizers.BaseOptimizer`.
"""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sparsefit.backends import get
from sparsefit.errors import MissingExtra
from sparsefit.regression.backend import Backend
from sparsefit.regression.fit import TOLERANCE
from sparsefit.sklearn import SparseRegressor

try:
    from pysindy.optimizers import BaseOptimizer
except ImportError as error:
    raise MissingExtra("pysindy is not installed: pip install 'sparsefit[peers]'") from error

__all__ = ["Optimizer"]


class Optimizer(BaseOptimizer):  # type: ignore[misc]
    """An optimizer of PySINDy that fits by a back-end of sparsefit.

    Parameters
    ----------
    backend : str or back-end, default="stlsq"
        As of `SparseRegressor`; ``stlsq`` is PySINDy's own with PySINDy's defaults: threshold 0.1
        and ridge 0.05 on columns as they are. A back-end of groups, such as ``group-lasso``, keeps
        or drops a term for all states.
    groups, certificate_tolerance :
        As of `SparseRegressor`; groups of n_library_terms labels.
    unbias : bool, default=True
        True: weights are fitted again by least squares on the support, whose certificate stays.

    Attributes
    ----------
    coef_ : (n_states, n_library_terms)
    status_, reason_, certificate_, solver_status_ : as of `SparseRegressor`
    alpha_fraction_ : as there, where the back-end has a penalty
    """

    def __init__(
        self,
        backend: str | Backend = "stlsq",
        *,
        groups: ArrayLike | None = None,
        unbias: bool = True,
        certificate_tolerance: float = TOLERANCE,
    ) -> None:
        super().__init__(unbias=unbias)
        self.backend = backend
        self.groups = groups
        self.certificate_tolerance = certificate_tolerance

    def _reduce(self, x: Any, y: Any) -> None:
        """Set coef_ for the library's columns x (m, k) and the derivatives y (m, n)."""
        pysindys = self.backend == "stlsq"
        regressor = SparseRegressor(
            get("stlsq", mode="pysindy") if pysindys else self.backend,
            groups=self.groups,
            fit_intercept=False,
            certificate_tolerance=self.certificate_tolerance,
        ).fit(np.asarray(x), np.asarray(y))
        for name in ("coef_", "status_", "reason_", "certificate_", "solver_status_"):
            setattr(self, name, getattr(regressor, name))
        self.history_.append(self.coef_)
        if hasattr(regressor, "alpha_fraction_"):
            self.alpha_fraction_ = regressor.alpha_fraction_

    def __str__(self) -> str:
        """The parameters, and after a fit its status with what that does and does not say."""
        if not hasattr(self, "status_"):
            return repr(self)
        kind = self.certificate_.kind if self.certificate_ else "no certificate"
        claim = {
            "duality_gap": "these weights are the optimum of their penalised problem",
            "normal_equations": "these weights are the least squares of their columns",
            "fixed_point": "one more iteration keeps these terms: no optimum is claimed",
        }.get(kind, kind)
        said = claim if self.status_ == "ok" else f"{self.reason_}; were it ok, {claim}"
        value = f" {self.certificate_.value:.1e}" if self.certificate_ else ""
        return f"{self!r}\n{self.status_} ({kind}{value}): {said}; not that the model is true"
