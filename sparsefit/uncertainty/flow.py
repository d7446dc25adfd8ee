"""How sure the velocity of a flow of waves is, anywhere: the covariance of all that was fitted.

With theta = (all q, all W, b) and g(x, t) the derivatives of the velocity by theta,

    var w(x, t) = g' C g,    C_ij = (var(theta_i + theta_j) - var theta_i - var theta_j) / 2,

where variances are those of any other function that is read of the fit (`corrected`): the noise's,
and the square of the bias that is left in the flow.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from sparsefit.arrays import Array
from sparsefit.library.nuisance import Nuisance
from sparsefit.library.waves import Waves
from sparsefit.uncertainty.model import Model
from sparsefit.uncertainty.reading import Reading

KEPT = 16  # sizes of theta
MOST = 2_000_000  # sums of two entries times samples: beyond it neither time nor memory is spent


@dataclass(frozen=True, eq=False)
class FlowUncertainty:
    """What `Estimate.flow` may be wrong by, where and when it is asked.

    Args:
        family: of the waves.
        parameters: q (s, p).
        weights: W (s, c, 1) [m^2/s].
        wind: [m/s], (x, y).
        origin: the place [m] and time [s] from which places count, (x, y, t).
        covariance: C (n, n) of q, W and of what is in the flow beside them.
        shared: whether the response time was sought, which scales the flow.
        windy: whether the wind was sought.
    """

    family: Waves
    parameters: Array
    weights: Array
    wind: tuple[float, float]
    origin: Array
    covariance: Array
    shared: bool
    windy: bool

    def standard_error(self, x: ArrayLike, y: ArrayLike, t: ArrayLike = 0.0) -> Array:
        """Return the standard error of the velocity [m/s], shape (..., 2), at x, y [m] and t [s].

        It holds where the shape of the flow does: far from the flight it grows with the distance,
        to first order, and says nothing of a flow that changes there.
        """
        given = np.broadcast_arrays(*(np.asarray(one, dtype=np.float64) for one in (x, y, t)))
        place = np.column_stack([one.ravel() for one in given]) - self.origin
        slopes = self._slopes(place)
        variance = np.einsum("idm,ij,jdm->md", slopes, self.covariance, slopes)
        errors: Array = np.sqrt(np.maximum(variance, 0.0))
        return errors.reshape(*given[0].shape, 2)

    def _slopes(self, place: Array) -> Array:
        """The derivatives (n, 2, m) of the velocity by theta, at places (m, 3) from the origin."""
        values = self.family.values(place, self.parameters)
        bent = self.family.bent(place, self.parameters, values, self.weights)
        by_weight, count = values.reshape(-1, 2, len(place)), len(place)
        parts = [bent.reshape(-1, 2, count), by_weight]
        if self.shared:
            flow = np.einsum("i,idm->dm", self.weights.ravel(), by_weight)
            parts.append((flow + np.array(self.wind)[:, None])[None])
        if self.windy:
            parts.append(np.repeat(np.eye(2)[:, :, None], count, axis=2))
        return np.concatenate(parts)


def entries(model: Model, nuisance: Nuisance) -> Reading:
    """Every entry of theta that is in the flow, and every sum of two of them; none beyond MOST."""
    theta = model.joined(model.parameters, model.weights, model.coefficients)
    sums = _sums(_count(model, nuisance), len(theta))
    every = np.ones(len(sums), dtype=bool)
    limits = np.full(len(sums), np.inf)
    return Reading(("theta",) * len(sums), sums @ theta, sums, limits, ~every, every)


@lru_cache(maxsize=KEPT)
def _sums(count: int, size: int) -> Array:
    """Every one of the first entries of theta (size,) and every sum of two, as rows: (f, size)."""
    unit = np.eye(count, size)
    first, second = np.triu_indices(count)
    sums = np.where((first == second)[:, None], unit[first], unit[first] + unit[second])
    sums.setflags(write=False)
    return sums


def flow_of(model: Model, nuisance: Nuisance, errors: Array) -> FlowUncertainty | None:
    """From the standard errors (f,) of all that was read, `entries` last; None if any is not told.

    Places count from where the rows do.
    """
    assert isinstance(model.family, Waves)
    count = _count(model, nuisance)
    if not count:
        return None
    squares = errors[-count * (count + 1) // 2 :] ** 2
    if not np.isfinite(squares).all():
        return None
    covariance = np.zeros((count, count))
    first, second = np.triu_indices(count)
    covariance[first, second] = covariance[second, first] = squares
    own = np.diagonal(covariance).copy()
    covariance = 0.5 * (covariance - own[:, None] - own)
    np.fill_diagonal(covariance, own)
    found = nuisance.read(model.coefficients)
    return FlowUncertainty(
        model.family,
        model.parameters,
        model.weights,
        found.wind,
        np.zeros(3),
        covariance,
        nuisance.shared,
        "wind" in nuisance.unknown,
    )


def _count(model: Model, nuisance: Nuisance) -> int:
    """The number of entries of theta that are in the flow, the first ones; 0 beyond MOST."""
    wind = 2 * ("wind" in nuisance.unknown)
    count = model.parameters.size + model.weights.size + nuisance.shared + wind
    return count if count * (count + 1) // 2 * len(model.rows.position) <= MOST else 0
