"""The sliding step: weights and wavenumbers descend together, by Newton's method.

    F(k, V) = 1/(2m) |Y - sum_j Z(k_j) V_j|^2 + alpha sum_j |V_j|

is smooth where no V_j is zero. With R the residual, D_j = dZ/dk (k_j), A_j = D_j V_j:

    dF/dV_j = alpha V_j / |V_j| - Z_j'R / m          dF/dk_j = -<R, A_j> / m
    d2F/dV_i dV_j = Z_i'Z_j / m (x) I + [i = j] alpha (I - u u') / |V_j|,   u = V_j / |V_j|
    d2F/dV_i dk_j = Z_i'A_j / m - [i = j] D_j'R / m
    d2F/dk_i dk_j = <A_i, A_j> / m - [i = j] <R, d2Z/dk2 V_j> / m

alpha = 0 is nonlinear least squares over several k at once.
Source: Denoyelle, Duval, Peyre and Soubies, "The sliding Frank-Wolfe algorithm" (2019).
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dpocon, dpotrf, dpotrs

from sparsefit.arrays import Array, IntArray
from sparsefit.regression.continuum import Bounds, Continuum, Jet

ITERATIONS = 60
REACH = 0.5  # the largest move of a wavenumber in one step, in 1/extent: within a lobe
FLAT = 1e-9  # curvatures below this, relative, are raised to it: the gradient vanishes there too
END = 1e-10  # predicted relative decrease below which rounding hides the objective's


@dataclass(frozen=True, eq=False)
class Atoms:
    """Wavenumbers k (s,) and scaled weights V (s, c, n), with what they make of Y.

    residual (m, n); value: F; jet: Z and its derivatives at k.
    """

    wavenumbers: Array
    weights: Array
    jet: Jet
    residual: Array
    value: float

    @classmethod
    def at(
        cls, continuum: Continuum, target: Array, wavenumbers: Array, weights: Array, alpha: float
    ) -> "Atoms":
        """Evaluate F at (k, V)."""
        jet = Jet.of(*continuum.columns(wavenumbers))
        flat = weights.reshape(-1, weights.shape[-1])
        residual = target - jet.value.reshape(-1, len(target)).T @ flat
        value = float(np.sum(residual**2)) / (2 * len(target)) + alpha * float(
            _norms(weights).sum()
        )
        return cls(wavenumbers, weights, jet, residual, value)


def _norms(weights: Array) -> Array:
    norms: Array = np.sqrt(np.sum(weights**2, axis=(1, 2)))
    return norms


def slide(
    continuum: Continuum,
    target: Array,
    wavenumbers: Array,
    weights: Array,
    alpha: float,
    bounds: Bounds,
) -> Atoms:
    """The stationary point of F that Newton's method reaches from (k, V), never going up.

    target Y (m, n); wavenumbers stay in bounds.
    """
    here = Atoms.at(continuum, target, wavenumbers, weights, alpha)
    extent = continuum.extent
    null = float(np.sum(target**2)) / (2 * len(target)) or 1.0
    slope = np.inf
    for _ in range(ITERATIONS):
        gradient, hessian = derivatives(here, alpha, extent)
        free = _free(here, gradient, bounds)
        step = np.zeros_like(gradient)
        step[free] = _descent(gradient[free], hessian[np.ix_(free, free)])
        s = len(here.wavenumbers)
        step *= min(1.0, REACH / max(float(np.abs(step[:s]).max()), REACH))
        predicted, steepness = -float(gradient @ step), float(np.linalg.norm(gradient[free]))
        settled = predicted <= END * null
        if settled and (steepness >= 0.5 * slope or steepness <= 1e-15 * null):
            break
        slope = steepness if settled else np.inf
        there = _moved(continuum, target, here, step, alpha, extent, bounds, predicted, settled)
        if there is None:
            break
        here = there
    return here


def derivatives(atoms: Atoms, alpha: float, extent: float) -> tuple[Array, Array]:
    """Gradient (N,) and Hessian (N, N) of F in (k extent, V), N = s + c s n, V as (s, c, n)."""
    (s, c, n), (m, _) = atoms.weights.shape, atoms.residual.shape
    jet, residual, weights = atoms.jet, atoms.residual, atoms.weights
    z = jet.value.reshape(c * s, m)
    bent = weights.transpose(0, 2, 1) @ jet.slope / extent  # A_j' (s, n, m)
    bent_flat = bent.reshape(s, n * m)
    gradient_k = -bent_flat @ residual.T.ravel() / m
    norms = _norms(weights)
    unit = weights / np.where(norms > 0, norms, 1.0)[:, None, None]
    gradient_v = alpha * unit - (z @ residual / m).reshape(s, c, n)
    hessian = np.zeros((s + c * s * n, s + c * s * n))
    bend = np.sum((jet.bend @ residual) * weights, axis=(1, 2)) / (m * extent**2)
    hessian[:s, :s] = bent_flat @ bent_flat.T / m - np.diag(bend)
    mixed = (bent.reshape(s * n, m) @ z.T / m).reshape(s, n, c * s).transpose(0, 2, 1).copy()
    mixed.reshape(s, s, c, n)[range(s), range(s)] -= jet.slope @ residual / (m * extent)
    hessian[:s, s:] = mixed.reshape(s, -1)
    hessian[s:, :s] = hessian[:s, s:].T
    hessian[s:, s:] = np.kron(z @ z.T / m, np.eye(n))
    for j in range(s):
        block = slice(s + c * n * j, s + c * n * (j + 1))
        u = unit[j].ravel()
        hessian[block, block] += alpha / max(norms[j], 1e-300) * (np.eye(c * n) - np.outer(u, u))
    return np.concatenate([gradient_k, gradient_v.ravel()]), hessian


def _free(atoms: Atoms, gradient: Array, bounds: Bounds) -> IntArray:
    """Variables that may move: not the wavenumbers that press against a bound."""
    k = atoms.wavenumbers
    pressed = (k <= bounds[0]) & (gradient[: len(k)] > 0)
    pressed |= (k >= bounds[1]) & (gradient[: len(k)] < 0)
    return np.flatnonzero(np.concatenate([~pressed, np.ones(len(gradient) - len(k), bool)]))


def _descent(gradient: Array, hessian: Array) -> Array:
    """Newton's step, with the curvatures' absolute values where they are not all positive."""
    scale = 1.0 / np.sqrt(np.maximum(np.abs(np.diagonal(hessian)), 1e-300))
    scaled = hessian * scale[:, None] * scale
    factor, failed = dpotrf(scaled, lower=1)
    if failed == 0 and dpocon(factor, float(np.abs(scaled).sum(axis=0).max()), uplo="L")[0] > FLAT:
        newton: Array = -scale * dpotrs(factor, scale * gradient, lower=1)[0]
        return newton
    roots, vectors = np.linalg.eigh(scaled)
    size = np.maximum(np.abs(roots), FLAT * np.abs(roots).max())
    step: Array = -scale * (vectors @ ((vectors.T @ (scale * gradient)) / size))
    return step


def _moved(
    continuum: Continuum,
    target: Array,
    here: Atoms,
    step: Array,
    alpha: float,
    extent: float,
    bounds: Bounds,
    predicted: float,
    settled: bool,
) -> Atoms | None:
    """The atoms after the step, halved until F falls; near the end the full step is trusted."""
    s = len(here.wavenumbers)
    for halving in range(25):
        part = 0.5**halving
        k = np.clip(here.wavenumbers + part * step[:s] / extent, *bounds)
        v = here.weights + part * step[s:].reshape(here.weights.shape)
        there = Atoms.at(continuum, target, k, v, alpha)
        if settled or there.value <= here.value - 1e-4 * part * predicted:
            return there
    return None
