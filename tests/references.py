"""Slow, obvious references of what the package works out from Fourier sums."""

import numpy as np

from sparsefit.model.columns import candidate_columns

CHUNK = 64  # wavenumbers per block of columns


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
