"""The fitted model Phi_t = C(k) w_t + e_t, its Jacobian, and how errors e move U0, L and tau_w.

C (m, 8) are the candidates at k = pi/L, t the two components; theta = (k, w_1, w_2), 17 of them.
The Jacobian of both components, stacked, is J (2m, 17) = [dC/dk w, blockdiag(C, C)].
"""

import math
from dataclasses import dataclass

import numpy as np

from sparsefit.arrays import Array, BoolArray
from sparsefit.cached import cached_property
from sparsefit.errors import InputError, positive
from sparsefit.library.cells import rms_mean_velocity
from sparsefit.modes.refine import DX, DX_SIGN, DY, DY_SIGN, centred, columns, project
from sparsefit.uncertainty.record import Uncertainty

MEAN_SQUARE = np.array([0.5] * 4 + [0.25] * 4)[:, None]  # of each candidate over a cell
LAGS = 20  # samples: twice the memory of a smoothing window of 11
NULL = 1e-12  # eigenvalues of the scaled J'J below this, relative, are its null space
LOST = 1e-6  # a gradient with more than this, relative, in the null space: inf


@dataclass(frozen=True, eq=False)
class Fitted:
    """Weights (8, 2) at a wavenumber [1/m] on centred positions (m, 2) [m]."""

    position: Array
    wavenumber: float
    weights: Array

    @cached_property
    def columns(self) -> Array:
        """C transposed, (8, m)."""
        return np.ascontiguousarray(columns(self.position, self.wavenumber)[0].T)

    @cached_property
    def slopes(self) -> tuple[Array, Array]:
        """dC/dx / k and dC/dy / k, (8, m) each."""
        return along_x(self.columns), along_y(self.columns)

    @cached_property
    def flow(self) -> Array:
        """C W, the flow velocity (m, 2) [m/s]."""
        return self.columns.T @ self.weights

    @cached_property
    def gradient(self) -> Array:
        """The flow's derivative in x and in y, (2, m, 2) [1/s]."""
        return self.wavenumber * np.stack([slope.T @ self.weights for slope in self.slopes])

    @cached_property
    def bend(self) -> Array:
        """dC/dk W (m, 2)."""
        x, y = self.position.T[..., None] / self.wavenumber
        found: Array = x * self.gradient[0] + y * self.gradient[1]
        return found

    @cached_property
    def values(self) -> Array:
        """U0 [m/s], L [m], tau_w [s]."""
        speed, scale = rms_mean_velocity(self.weights) or math.nan, math.pi / self.wavenumber
        return np.array([speed, scale, scale / speed])

    @cached_property
    def gradients(self) -> Array:
        """Of U0, L and tau_w in theta, (3, 17); U0^2 = 2 sum h w^2, h the mean square."""
        speed, scale, _ = self.values.tolist()
        found = np.zeros((3, 17))
        found[0, 1:] = (2 * MEAN_SQUARE * self.weights / speed).T.ravel()
        found[1, 0] = -scale / self.wavenumber
        found[2] = found[1] / speed - scale / speed**2 * found[0]
        return found

    @cached_property
    def inverse(self) -> tuple[Array, BoolArray]:
        """(J'J)^+ (17, 17), and which of U0, L and tau_w the flight does not tell (3,)."""
        gram = np.zeros((17, 17))
        gram[0, 0] = np.sum(self.bend**2)
        gram[0, 1:] = gram[1:, 0] = (self.columns @ self.bend).T.ravel()
        gram[1:9, 1:9] = gram[9:, 9:] = self.columns @ self.columns.T
        scale = np.sqrt(np.diag(gram))
        scale[scale == 0] = 1.0
        roots, vectors = np.linalg.eigh(gram / np.outer(scale, scale))
        kept = roots > NULL * roots[-1]
        turned = vectors.T @ (self.gradients / scale).T
        lost = ~(np.linalg.norm(turned[~kept], axis=0) <= LOST * np.linalg.norm(turned, axis=0))
        lost[[0, 2]] |= not kept.all()  # U0 grows along a null direction, if not to first order
        basis = vectors[:, kept] / scale[:, None]
        return (basis / roots[kept]) @ basis.T, lost

    @cached_property
    def influence(self) -> Array:
        """c (2, m, 3): an error e of Phi moves U0, L and tau_w by sum c e, to first order."""
        by_theta = self.inverse[0] @ self.gradients.T
        by_weight = by_theta[1:].reshape(2, 8, 3)
        found: Array = np.stack(
            [self.bend[:, [t]] * by_theta[0] + self.columns.T @ by_weight[t] for t in range(2)]
        )
        return found

    def moved(self, score: Array) -> "Fitted":
        """The fit after a step (J'J)^+ score in theta, (17,)."""
        step = self.inverse[0] @ score
        weights = self.weights + step[1:].reshape(2, 8).T
        return Fitted(self.position, self.wavenumber + float(step[0]), weights)

    def score(self, errors: Array) -> Array:
        """J'e (17,) of errors (m, 2) of Phi."""
        by_weight = (self.columns @ errors).T.ravel()
        return np.concatenate([[np.sum(self.bend * errors)], by_weight])


def along_x(columns: Array) -> Array:
    """d/dx of candidates (8, m), over k."""
    found: Array = DX_SIGN * columns[DX]
    return found


def along_y(columns: Array) -> Array:
    """d/dy of candidates (8, m), over k."""
    found: Array = DY_SIGN * columns[DY]
    return found


def uncertainty(position: Array, flow_velocity: Array, length_scale: float) -> Uncertainty:
    """Standard errors of U0, L and tau_w where the 8-column fit of Phi (m, 2) is best in L [m].

    For a Phi of unknown origin: with gamma(l) the autocovariance of the residuals at lag l,
    tapered to LAGS (Bartlett), and rho(l) that of the influence c, the variance is
    sum_l gamma(l) rho(l), component by component. gamma is corrected for the 17/2 parameters per
    component. Errors that correlate longer than LAGS need their filter: `assess`.
    """
    scale, points = positive("length_scale", length_scale, "m"), centred(position)
    samples = len(points)
    if samples <= LAGS:
        raise InputError(f"uncertainty needs more than {LAGS} samples; got {samples}")
    k = math.pi / scale
    fitted = Fitted(points, k, project(points, flow_velocity, k).weights)
    errors = flow_velocity - fitted.flow
    taper = 1 - np.arange(LAGS + 1) / (LAGS + 1)
    taper[1:] *= 2  # lags of either sign
    taper *= 1 / (samples - 8.5)
    variance = np.zeros(3)
    for error, part in zip(errors.T, fitted.influence, strict=True):
        variance += (taper * _products(error[:, None])[:, 0]) @ _products(part)
    spread = np.where(fitted.inverse[1], np.inf, np.sqrt(variance))
    return Uncertainty.around(fitted.values.tolist(), spread.tolist())


def _products(series: Array) -> Array:
    """Sums over time of the lagged products of each column (m, n), lags 0..LAGS."""
    found = np.fft.rfft(series, len(series) + LAGS, axis=0)
    lagged: Array = np.fft.irfft(np.abs(found) ** 2, len(series) + LAGS, axis=0)[: LAGS + 1]
    return lagged
