"""What a fit answers: a back-end's weights with what the caller verified about them."""

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from sparsefit.arrays import Array, Brief, IntArray
from sparsefit.errors import is_real
from sparsefit.regression.backend import Backend, PenalisedBackend
from sparsefit.regression.certificate import Certificate
from sparsefit.regression.frames import (
    frame_of_fit,
    frame_of_path,
    html_of_fit,
    html_of_path,
    plot_path,
    predicted,
)
from sparsefit.regression.penalty_choice import PenaltyChoice
from sparsefit.regression.problem import RegressionProblem

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, eq=False, repr=False)
class Fit(Brief):
    """A back-end's weights with what the caller verified about them.

    weights (k, n) in the original units of theta, NaN throughout where there is no solution;
    status ``ok``, ``inaccurate`` (certificate, with what rounding can hide of it, above tolerance),
    ``unidentifiable`` or ``error``, with its reason; seconds of the solve; ``repaired``: the
    certificate rejected the fast path's answer and this one is the referee's. ``penalty_choice``:
    how the back-end's alpha_fraction, here the chosen number, was found where "auto" was asked for.
    ``shared_seconds``: the part of seconds that an earlier fit spent, on a factorisation that this
    one uses.
    """

    weights: Array
    status: str
    reason: str
    certificate: Certificate | None
    seconds: float
    backend: Backend
    solver_status: str = ""
    iterations: int | None = None
    repaired: bool = False
    penalty_choice: PenaltyChoice | None = field(default=None, repr=False, kw_only=True)
    shared_seconds: float = field(default=0.0, repr=False, kw_only=True)
    problem: RegressionProblem = field(repr=False, kw_only=True)

    @property
    def alpha_fraction(self) -> float:
        """The penalty as a fraction of alpha_max; NaN of a back-end without one."""
        value = getattr(self.backend, "alpha_fraction", None)
        return float(value) if is_real(value) else math.nan

    @property
    def alpha(self) -> float:
        """The penalty in the unit of the target, alpha_fraction * alpha_max; NaN without one."""
        if math.isnan(self.alpha_fraction) or not isinstance(self.backend, PenalisedBackend):
            return math.nan
        return self.alpha_fraction * self.problem.alpha_max(self.backend.penalty(self.problem))

    def predict(self, theta: Any) -> Array:
        """The target at theta (r, k), an array, frame or sparse matrix: (r,) of one target, (r, n).

        Raises InputError where theta has other columns than the problem.
        """
        return predicted(self, theta)

    def to_frame(self) -> "pd.DataFrame":
        """Weights by the names of columns (rows) and targets (columns)."""
        return frame_of_fit(self)

    def _repr_html_(self) -> str:
        return html_of_fit(self)

    @property
    def support(self) -> IntArray:
        """Indices (c,) of the columns with a weight that is not zero for some target."""
        return np.flatnonzero(np.any((self.weights != 0) & np.isfinite(self.weights), axis=1))

    @property
    def samples(self) -> int:
        """Rows m of the problem."""
        return self.problem.samples

    @property
    def columns(self) -> int:
        """Columns k of the problem."""
        return self.problem.columns

    @property
    def rank(self) -> int:
        """Numerical rank of theta, as far as Z'Z/m shows it."""
        return self.problem.statistics.rank


@dataclass(frozen=True, eq=False, repr=False)
class Path(Brief):
    """Fits along a path of penalties, in the order asked for: alpha = alpha_fraction * alpha_max.

    alpha_fractions (p,); alpha_max: the smallest alpha whose solution is zero, in the unit of the
    target, that of Z'Y/m; fits: p of them; seconds: of all, certificates included.
    """

    alpha_fractions: Array
    alpha_max: float
    fits: tuple[Fit, ...]
    seconds: float

    @property
    def alphas(self) -> Array:
        """The penalties alpha (p,), in the unit of the target."""
        return self.alpha_fractions * self.alpha_max

    def to_frame(self) -> "pd.DataFrame":
        """Weights with a row per penalty (alpha_fraction, alpha) and columns by their names."""
        return frame_of_path(self)

    def plot(self, axes: Any = None) -> Any:
        """Draw the weights over the penalty on axes of matplotlib (new ones by default)."""
        return plot_path(self, axes)

    def _repr_html_(self) -> str:
        return html_of_path(self)

    @property
    def weights(self) -> Array:
        """Weights (p, k, n) in the original units of theta."""
        return np.stack([fit.weights for fit in self.fits])

    @property
    def gaps(self) -> Array:
        """Relative duality gap (p,) of each point, NaN where there is no solution."""
        return np.array([f.certificate.value if f.certificate else np.nan for f in self.fits])

    @property
    def repaired(self) -> int:
        """How many points the referee had to repair."""
        return sum(fit.repaired for fit in self.fits)
