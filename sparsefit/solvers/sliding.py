"""The sliding step: weights and places descend together, by Newton's method.

    F(q, V) = 1/(2m) |Y - sum_j Z(q_j) V_j|^2 + alpha sum_j |V_j|

is smooth where no V_j is zero. With R the residual, D_jp = dZ/dq_p (q_j), A_jp = D_jp V_j:

    dF/dV_j = alpha V_j / |V_j| - Z_j'R / m          dF/dq_jp = -<R, A_jp> / m
    d2F/dV_i dV_j = Z_i'Z_j / m (x) I + [i = j] alpha (I - u u') / |V_j|,   u = V_j / |V_j|
    d2F/dV_i dq_jp = Z_i'A_jp / m - [i = j] D_jp'R / m
    d2F/dq_ip dq_jr = <A_ip, A_jr> / m - [i = j] <R, d2Z/dq_p dq_r V_j> / m

alpha = 0 is nonlinear least squares over several q at once.
Source: Denoyelle, Duval, Peyre and Soubies, "The sliding Frank-Wolfe algorithm" (2019).
"""

from dataclasses import dataclass

import numpy as np

from sparsefit.arrays import Array, IntArray
from sparsefit.regression.continuum import Bounds, Continuum, Jet

ITERATIONS = 60
REACH = 0.5  # the largest move of a place in one step, in 1/extent: within a lobe
FLAT = 1e-9  # curvatures below this, relative, are raised to it: the gradient vanishes there too
END = 1e-10  # predicted relative decrease below which rounding hides the objective's


@dataclass(frozen=True, eq=False)
class Atoms:
    """Places q (s, p) and scaled weights V (s, c, n), with what they make of Y.

    residual (m, n); value: F; jet: Z and its derivatives at q.
    """

    places: Array
    weights: Array
    jet: Jet
    residual: Array
    value: float

    @classmethod
    def at(
        cls, continuum: Continuum, target: Array, places: Array, weights: Array, alpha: float
    ) -> "Atoms":
        """Evaluate F for a target Y (m, n) at places q (s, p) with scaled weights V (s, c, n)."""
        jet = Jet.of(*continuum.columns(places))
        flat = weights.reshape(-1, weights.shape[-1])
        residual = target - jet.value.reshape(-1, len(target)).T @ flat
        value = float(np.sum(residual**2)) / (2 * len(target)) + alpha * float(
            _norms(weights).sum()
        )
        return cls(places, weights, jet, residual, value)


def _norms(weights: Array) -> Array:
    norms: Array = np.sqrt(np.sum(weights**2, axis=(1, 2)))
    return norms


def slide(
    continuum: Continuum,
    target: Array,
    places: Array,
    weights: Array,
    alpha: float,
    bounds: Bounds,
) -> Atoms:
    """The stationary point of F that Newton's method reaches from (q, V), never going up.

    target Y (m, n); wavenumbers stay in bounds.
    """
    here = Atoms.at(continuum, target, places, weights, alpha)
    null = float(np.sum(target**2)) / (2 * len(target)) or 1.0
    slope = np.inf
    for _ in range(ITERATIONS):
        spans = continuum.spans(here.places)
        gradient, hessian = derivatives(here, alpha, spans)
        free = _free(here, gradient, bounds)
        step = np.zeros_like(gradient)
        step[free] = _descent(gradient[free], hessian[np.ix_(free, free)])
        step *= min(1.0, REACH / max(float(np.abs(step[: spans.size]).max()), REACH))
        predicted, steepness = -float(gradient @ step), float(np.linalg.norm(gradient[free]))
        settled = predicted <= END * null
        if settled and (steepness >= 0.5 * slope or steepness <= 1e-15 * null):
            break
        slope = steepness if settled else np.inf
        there = _moved(continuum, target, here, step, alpha, spans, bounds, predicted, settled)
        if there is None:
            break
        here = there
    return here


def derivatives(atoms: Atoms, alpha: float, spans: Array) -> tuple[Array, Array]:
    """Gradient (N,) and Hessian (N, N) of F in (q spans, V), spans (s, p).

    N = p s + c s n: q as (s, p), then V as (s, c, n).
    """
    (s, c, n), (m, _), p = atoms.weights.shape, atoms.residual.shape, spans.shape[1]
    jet, residual, weights = atoms.jet, atoms.residual, atoms.weights
    z = jet.value.reshape(c * s, m)
    slope = jet.slope / spans[:, :, None, None]
    bent = weights.transpose(0, 2, 1)[:, None] @ slope  # A_jp' (s, p, n, m)
    bent_flat = bent.reshape(s * p, n * m)
    gradient_q = -bent_flat @ residual.T.ravel() / m
    norms = _norms(weights)
    unit = weights / np.where(norms > 0, norms, 1.0)[:, None, None]
    gradient_v = alpha * unit - (z @ residual / m).reshape(s, c, n)
    count = s * p
    hessian = np.zeros((count + c * s * n, count + c * s * n))
    bend = np.sum((jet.bend @ residual) * weights[:, None, None], axis=(3, 4)) / m
    own = (bent_flat @ bent_flat.T / m).reshape(s, p, s, p)
    own[range(s), :, range(s)] -= bend / (spans[:, :, None] * spans[:, None])
    hessian[:count, :count] = own.reshape(count, count)
    mixed = (bent.reshape(count * n, m) @ z.T / m).reshape(s, p, n, s, c).transpose(0, 1, 3, 4, 2)
    mixed = mixed.copy()
    mixed[range(s), :, range(s)] -= slope @ residual / m
    hessian[:count, count:] = mixed.reshape(count, -1)
    hessian[count:, :count] = hessian[:count, count:].T
    hessian[count:, count:] = np.kron(z @ z.T / m, np.eye(n))
    for j in range(s):
        block = slice(count + c * n * j, count + c * n * (j + 1))
        u = unit[j].ravel()
        hessian[block, block] += alpha / max(norms[j], 1e-300) * (np.eye(c * n) - np.outer(u, u))
    return np.concatenate([gradient_q, gradient_v.ravel()]), hessian


def _free(atoms: Atoms, gradient: Array, bounds: Bounds) -> IntArray:
    """Variables that may move: not the wavenumbers that press against a bound."""
    k = atoms.places[:, 0]
    slope = gradient[: atoms.places.size : atoms.places.shape[1]]
    pressed = (k <= bounds[0]) & (slope > 0)
    pressed |= (k >= bounds[1]) & (slope < 0)
    free = np.ones(len(gradient), bool)
    free[: atoms.places.size : atoms.places.shape[1]] = ~pressed
    return np.flatnonzero(free)


def _descent(gradient: Array, hessian: Array) -> Array:
    """Newton's step, with the curvatures' absolute values where they are not all positive."""
    from scipy.linalg.lapack import dpocon, dpotrf, dpotrs  # loading an estimator needs none of it

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
    spans: Array,
    bounds: Bounds,
    predicted: float,
    settled: bool,
) -> Atoms | None:
    """The atoms after the step, halved until F falls; near the end the full step is trusted."""
    for halving in range(25):
        part = 0.5**halving
        q = here.places + part * step[: spans.size].reshape(spans.shape) / spans
        q[:, 0] = np.clip(q[:, 0], *bounds)
        v = here.weights + part * step[spans.size :].reshape(here.weights.shape)
        there = Atoms.at(continuum, target, q, v, alpha)
        if settled or there.value <= here.value - 1e-4 * part * predicted:
            return there
    return None
