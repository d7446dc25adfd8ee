"""Slow, obvious references of what the package works out from Fourier sums."""

import numpy as np

from sparsefit.library.cells import Cells
from sparsefit.model.cells import candidate_columns
from sparsefit.modes.fitted_rows import Rows
from sparsefit.modes.projection import project

CHUNK = 64  # wavenumbers per block of columns


def residual_curve(position, flow_velocity, wavenumbers):
    """RSS(k) (q,) of one mode at any wavenumbers (q,) [1/m], one fit each."""
    rows = Rows.plain(position, flow_velocity)
    fits = [project(Cells(), rows, np.array([[k]])) for k in wavenumbers.tolist()]
    return np.array([fit.residual for fit in fits])


def dual_certificate(problem, residual, alpha, wavenumbers):
    """eta (q,) = |Z(k)'R|_F / (m alpha) at wavenumbers (q,) [1/m], from the rows."""
    heights = []
    for start in range(0, len(wavenumbers), CHUNK):
        theta = candidate_columns(
            problem.continuum.position, np.pi / wavenumbers[start : start + CHUNK]
        )
        rms = np.sqrt(np.mean(theta * theta, axis=0))
        found = theta.T @ residual / (np.where(rms > 0, rms, 1.0)[:, None] * len(theta))
        heights.append(np.sqrt(np.sum(found.reshape(-1, 8 * residual.shape[1]) ** 2, axis=1)))
    return np.concatenate(heights) / alpha
