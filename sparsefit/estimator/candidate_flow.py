"""The flow that weights of the paper's candidates say, to be evaluated anywhere.

w(x) = sum_j C(k_j, x - x0) W_j + wind, C the 8 candidates of a wavenumber (Eq. 17).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from sparsefit.arrays import Array
from sparsefit.estimator.locate import Place
from sparsefit.estimator.prepare import Prepared
from sparsefit.flight.waves import WaveFlow
from sparsefit.library.cells import Cells
from sparsefit.library.waves import AXIS
from sparsefit.regression.fit import Fit
from sparsefit.uncertainty import common, vehicles_of


@dataclass(frozen=True, eq=False)
class CandidateFlow:
    """A sum of weighted candidates and a wind; its weights are free, so it may have a divergence.

    Args:
        wavenumbers: k = pi/L (s,) [1/m].
        weights: W (s, 8, 2) [m/s].
        origin: x0 (2,) [m], where the phases of the candidates are 0.
        wind: [m/s], (x, y).
    """

    wavenumbers: Array
    weights: Array
    origin: Array
    wind: tuple[float, float] = (0.0, 0.0)

    def velocity(self, x: ArrayLike, y: ArrayLike, t: ArrayLike = 0.0) -> Array:
        """Return the flow velocity [m/s], shape (..., 2), at x, y [m]; t [s] changes nothing."""
        east, north, _ = np.broadcast_arrays(
            np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64), t
        )
        place = np.column_stack([east.ravel(), north.ravel()]) - self.origin
        total = np.zeros((len(place), 2)) + self.wind
        for k, weights in zip(self.wavenumbers, self.weights, strict=True):
            total += Cells().values(place, np.array([[k]]))[0].T @ weights
        return total.reshape(*east.shape, 2)


def flow_of(prepared: Prepared, fit: Fit, place: Place) -> CandidateFlow | WaveFlow | None:
    """The flow of modes that were fitted, else what the back-end's own weights say.

    None where the weights of the back-end are not those of the flow's velocity, or where no
    vehicle could have flown so.
    """
    if place.fit is None:
        return _as_weighed(prepared, fit)
    coefficients, nuisance = place.fit.coefficients, common(prepared.nuisances)
    if not all(vehicle.possible for vehicle in vehicles_of(prepared.parts, coefficients)):
        return None
    weights, wind = (
        place.fit.weights / nuisance.ratio(coefficients),
        nuisance.read(coefficients).wind,
    )
    return CandidateFlow(place.wavenumbers, weights, prepared.origin[:2], wind)


def _as_weighed(prepared: Prepared, fit: Fit) -> CandidateFlow | WaveFlow | None:
    library, scales = prepared.library, fit.problem.group_scales
    if library.target != "flow-velocity" or library.unknown or scales is None:
        return None
    if library.family == "stream":
        assert fit.problem.parameters is not None
        waves = AXIS.phases(fit.problem.parameters)[..., :2].reshape(-1, 2)
        return WaveFlow(waves, *fit.weights.reshape(-1, 2).T)
    weights = fit.weights.reshape(len(scales), Cells.size, -1)
    used = weights.any(axis=(1, 2))
    return CandidateFlow(math.pi / scales[used], weights[used], np.zeros(2))
