"""Every back-end of any design matrix as a regressor of scikit-learn (extra ``sklearn``).

    minimise over w, b:   1/(2m) sum_i s_i |y_i - x_i w - b|^2 + alpha * penalty(w)

with the back-end's own penalty, or rule, in place of the second term; s are the sample weights.
The intercept b is not penalised. `SparseRegressor` takes any back-end, plug-ins included; `Lasso`,
`GroupLasso`, ... are classes of one back-end each, whose settings are parameters that
`GridSearchCV` can search over.

Source of the conventions: scikit-learn, "Developing scikit-learn estimators".
"""

import warnings
from dataclasses import field, fields, make_dataclass
from typing import Any, Self, cast

import numpy as np
from numpy.typing import ArrayLike

from sparsefit.arrays import Array
from sparsefit.backends import BACKENDS, get, load, named
from sparsefit.errors import MissingExtra, SparsefitError
from sparsefit.regression.backend import Backend, PenalisedBackend, unknown_setting
from sparsefit.regression.fit import TOLERANCE
from sparsefit.regression.fit import fit as certified
from sparsefit.regression.problem import RegressionProblem

try:
    from sklearn.base import BaseEstimator, MultiOutputMixin, RegressorMixin
    from sklearn.exceptions import ConvergenceWarning
    from sklearn.utils.validation import check_is_fitted, validate_data
except ImportError as error:
    raise MissingExtra("scikit-learn is missing: pip install 'sparsefit[sklearn]'") from error

NAMED = {home.partition(":")[2]: name for name, home in BACKENDS.items()}
"""Regressor -> the back-end whose settings are its parameters."""
__all__ = ["FitFailed", "SparseRegressor", *NAMED]
SHARED: dict[str, Any] = {"groups": None, "fit_intercept": True, "certificate_tolerance": TOLERANCE}
"""The parameters that every regressor has, beside those of its back-end."""


class FitFailed(SparsefitError, ValueError):  # noqa: N818 - says what is the matter
    """A back-end returned no weights; the message is its reason."""


class SparseRegressor(MultiOutputMixin, RegressorMixin, BaseEstimator):  # type: ignore[misc]
    """A linear model y = X w + b, fitted by a back-end and certified.

    Parameters
    ----------
    backend : str or back-end, default="group-lasso"
        A name, with default settings, or an object as from ``sparsefit.backends.get``.
    groups : array-like of shape (n_features,), default=None
        Labels, equal for the columns of one group; None makes each column a group of its own.
    fit_intercept : bool, default=True
        True: b is fitted, without penalty; otherwise it is 0.
    certificate_tolerance : float, default=1e-8
        The largest certificate of status ``ok``.

    Attributes
    ----------
    coef_ : (n_features,), or (n_targets, n_features) where y is two-dimensional.
    intercept_ : float, or (n_targets,).
    status_, reason_ : ``ok``, or ``inaccurate`` and why.
    certificate_ : of `sparsefit.fit`: its kind, value and rounding.
    solver_status_ : the status reported by the solver.
    alpha_fraction_, alpha_ : the penalty used, where there is one, as a fraction and in the unit
        of y: that of `sklearn.linear_model.Lasso` on columns of unit standard deviation.
    n_iter_ : steps of the solver, or None; ``n_features_in_``, ``feature_names_in_`` : of X.
    """

    def __init__(
        self,
        backend: str | Backend = "group-lasso",
        *,
        groups: ArrayLike | None = None,
        fit_intercept: bool = True,
        certificate_tolerance: float = TOLERANCE,
    ) -> None:
        self.backend = backend
        self.groups = groups
        self.fit_intercept = fit_intercept
        self.certificate_tolerance = certificate_tolerance

    def fit(self, X: Any, y: Any, sample_weight: ArrayLike | None = None) -> Self:  # noqa: N803
        """Fit X (n_samples, n_features), dense or sparse, and y (n_samples,) or of several columns.

        sample_weight (n_samples,) >= 0: the weight of each sample's loss. Warns ConvergenceWarning
        where the certificate exceeds its tolerance. Raises FitFailed where the back-end returns no
        weights, and InputError on settings out of range; both are ValueError.
        """
        backend, least = self._backend(), 2 if self.fit_intercept else 1
        checks = {"accept_sparse": self._formats, "dtype": np.float64, "ensure_min_samples": least}
        design, target = validate_data(self, X, y, multi_output=True, y_numeric=True, **checks)
        names = getattr(self, "feature_names_in_", None)
        problem = RegressionProblem.from_arrays(
            *(design, target, self.groups, names), sample_weight=sample_weight,
            intercept=self.fit_intercept, partial=True,
        )  # fmt: skip
        if not problem.design.squares.any():
            raise FitFailed("every column of X is constant: there is nothing to choose from")
        fitted = certified(problem, backend, tolerance=self.certificate_tolerance)
        if not np.isfinite(fitted.weights).all():
            raise FitFailed(f"{backend.name} has no answer, {fitted.status}: {fitted.reason}")
        if fitted.status != "ok":
            words = f"{backend.name} is not certified, {fitted.status}: {fitted.reason}"
            warnings.warn(words, ConvergenceWarning, stacklevel=2)
        coefficients, intercept = fitted.weights.T, fitted.intercept
        self.coef_ = coefficients if target.ndim == 2 else coefficients[0]
        self.intercept_ = intercept if target.ndim == 2 else float(intercept[0])
        self.status_, self.reason_ = fitted.status, fitted.reason
        self.certificate_, self.solver_status_ = fitted.certificate, fitted.solver_status
        self.n_iter_ = fitted.iterations
        if hasattr(fitted.backend, "alpha_fraction"):
            self.alpha_fraction_, self.alpha_ = fitted.alpha_fraction, fitted.alpha
        return self

    def predict(self, X: Any) -> Array:  # noqa: N803
        """X w + b for X (n_samples, n_features), in the shape that y had."""
        check_is_fitted(self)
        design = validate_data(self, X, accept_sparse=self._formats, dtype=np.float64, reset=False)
        predicted: Array = design @ self.coef_.T + self.intercept_
        return predicted

    def __sklearn_tags__(self) -> Any:
        tags = super().__sklearn_tags__()
        tags.input_tags.sparse = bool(self._formats)
        return tags

    @property
    def _formats(self) -> list[str] | bool:
        # searches over supports read dense columns
        return ["csc", "csr"] if isinstance(self._backend(), PenalisedBackend) else False

    def _backend(self) -> Backend:
        return named(self.backend)


class _Named(SparseRegressor):
    """Base of the regressors of one back-end, with its settings as parameters."""

    _name: str

    def __new__(cls, *arguments: Any, **settings: Any) -> Self:
        """Refuse an unknown parameter with the nearest valid name."""
        for key in settings:
            if key not in (valid := cls._get_param_names()):
                raise unknown_setting(f"parameter of {cls.__name__}", key, valid)
        instance: Self = super().__new__(cls)
        return instance

    def _backend(self) -> Backend:
        settings = {key: value for key, value in self.get_params().items() if key not in SHARED}
        return get(self._name, **settings)


def __getattr__(name: str) -> Any:
    """The regressor of a back-end, created and its back-end imported at first use."""
    if name not in NAMED:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    backend = load(NAMED[name])
    own = f"{(backend.__doc__ or '').strip()}\n\n    Attributes: see `SparseRegressor`."
    defaults = {item.name: item.default for item in fields(cast(Any, backend))} | SHARED
    settings = [(key, Any, field(default=value)) for key, value in defaults.items()]
    texts = {"__doc__": own, "__module__": __name__, "_name": NAMED[name]}
    plain: dict[str, Any] = {"eq": False, "repr": False, "kw_only": True}
    made = make_dataclass(name, settings, bases=(_Named,), namespace=texts, **plain)
    globals()[name] = made
    return made


def __dir__() -> list[str]:
    return sorted(__all__)
