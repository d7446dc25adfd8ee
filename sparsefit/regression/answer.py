"""What a fit answers: a back-end's weights with what the caller verified about them."""

from dataclasses import dataclass, field

import numpy as np

from sparsefit.arrays import Array, Brief, IntArray
from sparsefit.regression.backend import Backend
from sparsefit.regression.certificate import Certificate
from sparsefit.regression.penalty_choice import PenaltyChoice
from sparsefit.regression.problem import RegressionProblem


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
