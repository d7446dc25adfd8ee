"""Every back-end of any design matrix as a regressor of scikit-learn (extra ``sklearn``).

    minimise over w, b:   1/(2m) sum_i s_i |y_i - x_i w - b|^2 + alpha * penalty(w)

with the back-end's own penalty, or rule, in place of the second term; s are the sample weights.
The intercept b is not penalised: X and y are centred first, and so columns are scaled to unit
standard deviation where a back-end scales them. `SparseRegressor` takes any back-end, a plug-in
too; `Lasso`, `GroupLasso`, ... are one class for each of ours, whose parameters are the back-end's
settings, so that `GridSearchCV` can search over them.

Source of the conventions: scikit-learn, "Developing scikit-learn estimators".
"""

import warnings
from dataclasses import dataclass, field, fields, make_dataclass
from typing import Any, Self, cast

import numpy as np
from numpy.typing import ArrayLike

from sparsefit.arrays import Array, BoolArray
from sparsefit.backends import BACKENDS, get, load, named
from sparsefit.errors import (
    InputError,
    MissingExtra,
    SparsefitError,
    flag_setting,
    number_setting,
)
from sparsefit.regression.answer import Fit
from sparsefit.regression.backend import Backend
from sparsefit.regression.fit import TOLERANCE
from sparsefit.regression.fit import fit as certified
from sparsefit.regression.problem import RegressionProblem

try:
    from sklearn.base import BaseEstimator, MultiOutputMixin, RegressorMixin
    from sklearn.exceptions import ConvergenceWarning
    from sklearn.utils.validation import check_array, check_is_fitted, validate_data
except ImportError as error:
    raise MissingExtra("scikit-learn is missing: pip install 'sparsefit[sklearn]'") from error

NEED_POSITIONS = ("gridless-group-lasso", "parametric-nls")  # no design matrix is enough for them
NAMED = {
    home.partition(":")[2]: name for name, home in BACKENDS.items() if name not in NEED_POSITIONS
}
"""Regressor -> the back-end whose settings are its parameters."""
__all__ = ["FitFailed", "SparseRegressor", *NAMED]
CONSTANT = 16.0 * float(np.finfo(float).eps)  # what rounding leaves of a constant, relative
SHARED: dict[str, Any] = {
    "groups": None,
    "fit_intercept": True,
    "certificate_tolerance": TOLERANCE,
}
"""The parameters that every regressor has, beside those of its back-end."""


class FitFailed(SparsefitError, ValueError):  # noqa: N818 - says what is the matter
    """A back-end found no weights; the message is its reason."""


class SparseRegressor(MultiOutputMixin, RegressorMixin, BaseEstimator):  # type: ignore[misc]
    """A linear model y = X w + b, fitted by a back-end and certified.

    Parameters
    ----------
    backend : str or back-end, default="group-lasso"
        A name, our own or a plug-in's, with its default settings, or what
        ``sparsefit.backends.get(name, **settings)`` returns.
    groups : array-like of shape (n_features,), default=None
        Labels, equal for the columns of one group; None makes each column a group of its own.
    fit_intercept : bool, default=True
        Whether b is fitted, without penalty; otherwise it is 0.
    certificate_tolerance : float, default=1e-8
        Up to which certificate an answer counts as proven.

    Attributes
    ----------
    coef_ : (n_features,), or (n_targets, n_features) where y is two-dimensional.
    intercept_ : float, or (n_targets,).
    status_, reason_ : ``ok``, or ``inaccurate`` and why.
    certificate_ : what `sparsefit.fit` verified: its kind, value and rounding.
    solver_status_ : the solver's own word; of ``ensemble`` the inclusion probabilities.
    alpha_fraction_ : the penalty used, where the back-end has one ("auto" is a number here).
    n_features_in_, feature_names_in_ : of X.
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
        """Fit X of shape (n_samples, n_features) and y of (n_samples,) or (n_samples, n_targets).

        sample_weight (n_samples,): how much the square of each residual counts, >= 0.

        Warns ConvergenceWarning where the certificate is above its tolerance. Raises FitFailed
        where the back-end has no answer, and InputError on settings that are out of range; both
        are ValueError.
        """
        backend = self._backend()
        owner, tolerance = type(self).__name__, self.certificate_tolerance
        flag_setting(owner, "fit_intercept", self.fit_intercept)
        number_setting(owner, "certificate_tolerance", tolerance, low=0.0)
        design, target = validate_data(
            self,
            X,
            y,
            dtype=np.float64,
            multi_output=True,
            y_numeric=True,
            ensure_min_samples=2 if self.fit_intercept else 1,
        )
        weight = _checked_weight(sample_weight, len(design))
        values = target.astype(np.float64).reshape(len(design), -1)
        rows = _Rows.of(design, values, weight, centred=self.fit_intercept)
        groups = _checked_groups(self.groups, design.shape[1])[rows.varies]
        numbered = [f"x{i}" for i in range(design.shape[1])]
        names = np.array(getattr(self, "feature_names_in_", numbered))[rows.varies].tolist()
        problem = RegressionProblem.from_arrays(rows.theta, rows.target, groups, names)
        fitted = certified(problem, backend, tolerance=tolerance)
        _tell(fitted)
        coefficients = np.zeros((values.shape[1], design.shape[1]))
        coefficients[:, rows.varies] = fitted.weights.T
        intercept = rows.level - coefficients @ rows.mean
        self.coef_ = coefficients if target.ndim == 2 else coefficients[0]
        self.intercept_ = intercept if target.ndim == 2 else float(intercept[0])
        self.status_, self.reason_ = fitted.status, fitted.reason
        self.certificate_, self.solver_status_ = fitted.certificate, fitted.solver_status
        if hasattr(fitted.backend, "alpha_fraction"):
            self.alpha_fraction_ = fitted.backend.alpha_fraction
        return self

    def predict(self, X: Any) -> Array:  # noqa: N803
        """X w + b for X (n_samples, n_features), in the shape that y had."""
        check_is_fitted(self)
        design = validate_data(self, X, dtype=np.float64, reset=False)
        predicted: Array = design @ self.coef_.T + self.intercept_
        return predicted

    def _backend(self) -> Backend:
        return named(self.backend)


@dataclass(frozen=True, eq=False)
class _Rows:
    """sqrt(s) (x - mean) and sqrt(s) (y - level) of the samples with a weight s above 0.

    theta (m, c) has the columns that vary, varies (k,) says which; mean (k,), level (n,).
    """

    theta: Array
    target: Array
    mean: Array
    level: Array
    varies: BoolArray

    @classmethod
    def of(cls, design: Array, values: Array, weight: Array, *, centred: bool) -> "_Rows":
        """Raises FitFailed where no column varies."""
        mean, level = np.zeros(design.shape[1]), np.zeros(values.shape[1])
        if centred:
            mean, level = (np.average(part, axis=0, weights=weight) for part in (design, values))
        counted = weight > 0
        root = np.sqrt(weight[counted])[:, None]
        theta, size = (design[counted] - mean) * root, np.abs(design[counted] * root)
        varies: BoolArray = np.abs(theta).max(axis=0) > CONSTANT * size.max(axis=0)
        if not varies.any():
            raise FitFailed("every column of X is constant: there is nothing to choose from")
        used = theta if varies.all() else theta[:, varies]
        return cls(used, (values[counted] - level) * root, mean, level, varies)


class _Named(SparseRegressor):
    """Base of the regressors of one back-end, whose parameters are its settings."""

    _name: str

    def _backend(self) -> Backend:
        settings = {key: value for key, value in self.get_params().items() if key not in SHARED}
        return get(self._name, **settings)


def __getattr__(name: str) -> Any:
    """The regressor of a back-end, made when first asked for: a back-end is imported no sooner."""
    if name not in NAMED:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    backend = load(NAMED[name])
    settings = [(one.name, Any, field(default=one.default)) for one in fields(cast(Any, backend))]
    shared = [(key, Any, field(default=value)) for key, value in SHARED.items()]
    made = make_dataclass(
        name,
        [*settings, *shared],
        bases=(_Named,),
        namespace={"__doc__": _described(backend), "__module__": __name__, "_name": NAMED[name]},
        eq=False,
        repr=False,
        kw_only=True,
    )
    globals()[name] = made
    return made


def __dir__() -> list[str]:
    return sorted(__all__)


def _described(backend: type[Backend]) -> str:
    own = (backend.__doc__ or "").strip()
    return f"{own}\n\n    `SparseRegressor` tells of the other parameters and the attributes."


def _checked_weight(given: ArrayLike | None, samples: int) -> Array:
    """The sample weights (m,). Raises InputError unless they are >= 0 and one of them is not 0."""
    if given is None:
        return np.ones(samples)
    weight: Array = check_array(
        given, ensure_2d=False, dtype=np.float64, input_name="sample_weight"
    )
    if weight.shape != (samples,):
        raise InputError(f"sample_weight must have shape ({samples},), not {weight.shape}")
    if np.any(weight < 0) or not weight.any():
        raise InputError("sample_weight must not be negative, nor zero for every sample")
    return weight


def _checked_groups(given: ArrayLike | None, columns: int) -> np.ndarray[Any, Any]:
    """A label for each column. Raises InputError where there are not as many."""
    labels = np.arange(columns) if given is None else np.asarray(given)
    if labels.shape != (columns,):
        raise InputError(
            f"groups must have one label per column: X has {columns} columns, groups the shape "
            f"{labels.shape}"
        )
    return labels


def _tell(fitted: Fit) -> None:
    """Raise FitFailed on a fit without weights, and warn of one that is not proven."""
    name, words = fitted.backend.name, f"{fitted.status}: {fitted.reason}"
    if not np.isfinite(fitted.weights).all():
        raise FitFailed(f"{name} has no answer, {words}")
    if fitted.status != "ok":
        warnings.warn(f"{name} is not certified, {words}", ConvergenceWarning, stacklevel=3)
