"""The dual certificate of a group-LASSO of waves, over the whole plane of wavevectors.

A fit on a grid is optimal where eta <= 1 at the waves of the grid; between them eta may be higher,
and says where a finer grid would put a wave (`sparsefit.model.continuum`). Of the gridless
group-LASSO eta is at most 1 on the whole plane, and 1 at its waves.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sparsefit.arrays import Array
from sparsefit.errors import InputError
from sparsefit.estimator.estimator import Estimator
from sparsefit.flight import Flight
from sparsefit.model.columns import strengths
from sparsefit.model.continuum import PlaneHeights
from sparsefit.model.grid import extent_of
from sparsefit.regression.continuous_columns import Bounds, Continuum
from sparsefit.regression.penalties import alpha_max
from sparsefit.regression.problem import RegressionProblem
from sparsefit.solvers.continuous_dual import continuous_alpha_max
from sparsefit.solvers.gridless import GridlessGroupLasso
from sparsefit.solvers.lassos import GroupLasso

STEP = 0.4  # between wavevectors, in 1/extent: eta between them is at most 1 % higher


@dataclass(frozen=True, eq=False)
class CertificateMap:
    """eta over the plane of wavevectors, and the waves that the back-end chose.

    Args:
        axis: k_x, and k_y, of the map (q,) [1/m].
        eta: over the map (q, q), k_x by rows; NaN outside the bounds of the length scale.
        wavevectors: of the waves in use (w, 2) [1/m].
        strengths: |k| sqrt(a^2 + b^2) of each (w,) [m/s].
    """

    axis: Array
    eta: Array
    wavevectors: Array
    strengths: Array

    @property
    def highest(self) -> float:
        """The largest eta on the map: at most 1 where nothing can be gained off the grid."""
        return float(np.nanmax(self.eta))


def certificate_map(estimator: Estimator, flight: Flight) -> CertificateMap:
    """The certificate of the estimator's fit of a flight, over the plane.

    Raises:
        InputError: if the library is not of waves in groups by wave on plain samples, the back-end
            is neither group-lasso nor gridless-group-lasso, or it has no solution.
    """
    library = estimator.library
    if library.family != "waves" or library.groups != "wave" or library.unknown:
        raise InputError(
            "a certificate over the plane needs Library(family='waves') in groups by wave and a "
            f"known vehicle, not {library.family!r} by {library.groups!r}, unknown "
            f"{library.unknown!r}"
        )
    prepared = estimator.prepare(flight)
    if prepared.samples.averages is not None:
        raise InputError("a certificate over the plane needs samples, not averages of them")
    fit = estimator.fit(prepared)
    backend = fit.backend
    if not isinstance(backend, GroupLasso | GridlessGroupLasso):
        raise InputError(
            "a certificate over the plane is that of group-lasso or gridless-group-lasso, not "
            f"{backend.name}"
        )
    if not np.isfinite(fit.weights).all():
        raise InputError(f"no certificate over the plane: {fit.status}: {fit.reason}")
    if prepared.problem.continuum is None:
        raise InputError("a certificate over the plane needs columns that fit in memory")
    alpha, (low, high) = _penalty(prepared.problem, prepared.problem.continuum, backend)
    residual = fit.problem.target - fit.problem.theta @ fit.weights
    position = prepared.samples.position[:: library.every]
    plane = PlaneHeights(position, (low, high), STEP / extent_of(position))
    radius = np.hypot(plane.axis[:, None], plane.axis)
    inside = (radius >= low) & (radius <= high)
    assert fit.problem.parameters is not None
    weights = fit.weights.reshape(-1, 2)
    used = weights.any(axis=1)
    k = fit.problem.parameters[used]
    eta = np.where(inside, plane.heights(residual) / alpha, np.nan)
    return CertificateMap(plane.axis, eta, k, strengths(k, weights[used]))


def _penalty(
    problem: RegressionProblem, continuum: Continuum, backend: GroupLasso | GridlessGroupLasso
) -> tuple[float, Bounds]:
    """alpha, and the bounds of |k| [1/m] over which the back-end looked for waves."""
    if isinstance(backend, GridlessGroupLasso):
        bounds = continuum.interval(backend.lower, backend.upper)
        top = continuous_alpha_max(continuum, problem.target, bounds)
    else:
        bounds = continuum.interval(None, None)
        top = alpha_max(problem.statistics.cross, backend.penalty(problem))
    assert not isinstance(backend.alpha_fraction, str)
    return backend.alpha_fraction * top, bounds
