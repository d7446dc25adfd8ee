"""The back-ends that weigh all scales against each other, as the exported C solves them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sparsefit.arrays import Array
from sparsefit.backends.lasso import Lasso
from sparsefit.backends.stlsq import STLSQ
from sparsefit.export.model import Sums
from sparsefit.export.model_scale import solved
from sparsefit.export.plan import Plan
from sparsefit.library.cells import CANDIDATES


@dataclass(frozen=True, eq=False)
class Choice:
    """What a back-end chose.

    scale: the place of the heaviest scale, None where all weights are zero; weights (k, 2) [m/s];
    certificate: a duality gap, or the share of columns that the last iteration still removed.
    """

    scale: int | None
    weights: Array
    certificate: float
    sums: Sums


def scaled(sums: Sums) -> tuple[Array, Array, Array, Array]:
    """(Z'Z/m (k, k), Z'Phi/m (k, 2), rms of the columns (k,), mean squares of Phi (2,))."""
    norm, root = np.sqrt(np.diagonal(sums.gram)), math.sqrt(sums.weight)
    unit = np.where(norm > 0, 1.0 / np.where(norm > 0, norm, 1.0), 0.0)
    gram = sums.gram * np.outer(unit, unit)
    return gram, sums.cross * unit[:, None] / root, norm / root, sums.squares / sums.weight


def lasso(plan: Plan, sums: Sums, weights: Array, sweeps: int) -> tuple[Array, float]:
    """Weights (k, 2) after so many sweeps from those of before, and their relative duality gap."""
    assert isinstance(plan.backend, Lasso)
    gram, cross, rms, squares = scaled(sums)
    alpha = float(plan.backend.alpha_fraction) * float(np.abs(cross).max())
    v = weights * rms[:, None]
    gap = 0.0
    for c in range(2):
        settled = plan.settled * math.sqrt(squares[c])
        left = cross[:, c] - gram @ v[:, c]
        for _ in range(sweeps):
            if _sweep(gram, alpha, v[:, c], left) <= settled:
                break
        gap += duality_gap(alpha, float(squares[c]), cross[:, c], v[:, c], left)
    unit = np.where(rms > 0, 1.0 / np.where(rms > 0, rms, 1.0), 0.0)
    return v * unit[:, None], gap / (0.5 * float(squares.sum()))


def _sweep(gram: Array, alpha: float, v: Array, left: Array) -> float:
    """One sweep over the weights v (k,) and the correlations left (k,), both in place."""
    largest = 0.0
    for a in range(len(v)):
        value = left[a] + v[a]
        step = math.copysign(max(abs(value) - alpha, 0.0), value) - v[a]
        if step:
            left -= step * gram[a]
            v[a] += step
            largest = max(largest, abs(step))
    return largest


def duality_gap(alpha: float, square: float, cross: Array, v: Array, left: Array) -> float:
    """P - D of one component of Phi."""
    q = square - float(v @ cross)
    r, highest = q - float(v @ left), float(np.abs(left).max())
    s = q / r if r > 0 else 1.0
    s = min(s, alpha / highest) if s * highest > alpha else s
    return 0.5 * r + alpha * float(np.abs(v).sum()) - s * q + 0.5 * s * s * r


def stlsq(plan: Plan, sums: Sums, weights: Array, sweeps: int) -> tuple[Array, float]:
    """Weights (k, 2), and the share of columns that the last iterations still removed."""
    settings = plan.backend
    assert isinstance(settings, STLSQ)
    assert settings.threshold is not None
    gram, cross, rms, squares = scaled(sums)
    found, moving = np.zeros(weights.shape), 0
    for c in range(2):
        support, gone = np.arange(len(gram)), 0
        threshold = settings.threshold * math.sqrt(squares[c])
        for _ in range(settings.max_iterations):
            on = np.ix_(support, support)
            ridge = settings.ridge * np.eye(len(support))
            v = solved(gram[on] + ridge, cross[support, c : c + 1], plan.floor)[0][:, 0]
            kept = np.abs(v) >= threshold
            gone = int(np.count_nonzero(~kept))
            support, v = support[kept], v[kept]
            if not gone:
                break
        if settings.unbias and len(support):
            on = np.ix_(support, support)
            v = solved(gram[on], cross[support, c : c + 1], plan.floor)[0][:, 0]
        moving += gone
        found[support, c] = v / np.where(rms[support] > 0, rms[support], 1.0)
    return found, moving / found.size


def heaviest(weights: Array, readout: str) -> int | None:
    """The scale with the largest weight, of weights (8 g, 2); None where all are zero."""
    if not weights.any():
        return None
    sizes = {"signed-sum": weights, "absolute-sum": np.abs(weights)}.get(readout, weights**2)
    return int(sizes.reshape(-1, 2 * len(CANDIDATES)).sum(axis=1).argmax())
