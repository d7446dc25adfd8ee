"""Several length scales off the grid at once: variable projection over k_1 ... k_s.

At wavenumbers k = (k_1 ... k_s) the flow velocity is Phi = sum_j C(k_j) W_j + E, C (m, 8) the
candidates of one length scale (`refine.columns`), W_j (8, 2) free. RSS(k) = min_W |E|^2 is
minimised over all k_j together (Golub and Pereyra, 1973). With A_j = dC/dk (k_j) W_j and P what
projects off all columns, the Gauss-Newton move solves

    sum_i <P A_j, P A_i> dk_i = <E, A_j>

One scale fitted alone leans towards the other; fitted together they do not.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sparsefit.refine import RANK, STEP, columns, scan

Array = NDArray[np.float64]
ITERATIONS = 60
HALVINGS = 12
END = 1e-14  # of k: moves below it are rounding


@dataclass(frozen=True, eq=False)
class JointFit:
    """The fit at wavenumbers k (s,) [1/m]: RSS [m^2/s^2], W (s, 8, 2), E (m, 2), the moves (s,).

    Weights are those of candidates about the middle of the flight's bounding box.
    """

    wavenumbers: Array
    residual: float
    weights: Array
    rest: Array
    moves: Array


def fit_at(position: Array, flow_velocity: Array, wavenumbers: Array) -> JointFit:
    """Fit Phi (m, 2) [m/s] at k (s,) [1/m]; position (m, 2) [m], centred; no scale: E = Phi."""
    k = np.asarray(wavenumbers, dtype=float)
    if not len(k):
        none = np.zeros((0, 8, 2))
        square = float(np.sum(flow_velocity**2))
        return JointFit(k, square, none, flow_velocity, k)
    pairs = [columns(position, one) for one in k.tolist()]
    value = np.hstack([pair[0] for pair in pairs])
    scale = np.sqrt(np.einsum("ij,ij->j", value, value))
    scale[scale == 0] = 1.0
    roots, vectors = np.linalg.eigh(value.T @ value / np.outer(scale, scale))
    kept = roots > RANK * roots[-1]
    basis = vectors[:, kept] / np.sqrt(roots[kept]) / scale[:, None]  # value @ basis: orthonormal
    weights = basis @ (basis.T @ (value.T @ flow_velocity))
    rest = flow_velocity - value @ weights
    blocks = weights.reshape(len(k), 8, 2)
    bent = np.stack([slope @ own for (_, slope), own in zip(pairs, blocks, strict=True)])
    beside = np.stack([one - value @ (basis @ (basis.T @ (value.T @ one))) for one in bent])
    moves = _moves(beside.reshape(len(k), -1), rest.ravel(), np.sum(bent**2, axis=(1, 2)))
    return JointFit(k, float(np.sum(rest * rest)), blocks, rest, moves)


def _moves(beside: Array, rest: Array, squares: Array) -> Array:
    """The Gauss-Newton moves (s,), none along directions in which RSS is flat to rounding."""
    curvature, slope = beside @ beside.T, beside @ rest
    free = np.diagonal(curvature) > RANK * squares
    scale = np.sqrt(np.where(free, np.diagonal(curvature), 1.0))
    roots, vectors = np.linalg.eigh(
        np.where(np.outer(free, free), curvature, 0.0) / np.outer(scale, scale)
    )
    kept = roots > RANK
    inverse = np.where(kept, 1.0 / np.where(kept, roots, 1.0), 0.0)
    moves: Array = vectors @ (inverse * (vectors.T @ (np.where(free, slope, 0.0) / scale))) / scale
    return moves


def descend(
    position: Array,
    flow_velocity: Array,
    wavenumbers: Array,
    bounds: tuple[float, float],
    tolerance: float = 0.0,
) -> JointFit:
    """Gauss-Newton from k (s,), all scales together; RSS falls at every step, k stays in bounds.

    position (m, 2), centred. A wavenumber moves at most a scan step at a time: within its lobe.
    It ends when no wavenumber would move by more than ``tolerance`` [1/m].
    """
    reach = STEP / float(np.ptp(position, axis=0).max())
    here = fit_at(position, flow_velocity, np.clip(wavenumbers, *bounds))
    for _ in range(ITERATIONS):
        longest = float(np.abs(here.moves).max(initial=0.0))
        moves = here.moves * min(1.0, reach / longest) if longest > 0 else here.moves
        there = None
        for halving in range(HALVINGS):
            k = np.clip(here.wavenumbers + moves * 0.25**halving, *bounds)
            if np.all(np.abs(k - here.wavenumbers) <= np.maximum(END * k, tolerance)):
                break
            tried = fit_at(position, flow_velocity, k)
            if tried.residual < here.residual:
                there = tried
                break
        if there is None:
            return here
        here = there
    return here


def lobes(
    position: Array, flow_velocity: Array, low: float, high: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(k, RSS) of the local minima of the 8-column fit in [low, high] [1/m], deepest first.

    position (m, 2), centred; flow_velocity: what other scales have left. Steps resolve every lobe.
    """
    step = STEP / float(np.ptp(position, axis=0).max())
    first, last = max(1, math.floor(low / step)), math.ceil(high / step)
    curve = scan(position, flow_velocity, step, first, max(last, first))
    padded = np.concatenate([[np.inf], curve, [np.inf]])
    found = np.flatnonzero((curve <= padded[:-2]) & (curve <= padded[2:]))
    found = found[np.argsort(curve[found], kind="stable")]
    return np.clip(step * (first + found), low, high), curve[found]
