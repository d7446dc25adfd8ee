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

from sparsefit.arrays import Array
from sparsefit.errors import InputError
from sparsefit.modes.refine import (
    DIRECTIONS,
    MAX_STEPS,
    RANK,
    RIDGE,
    STEP,
    columns,
    fourier_sums,
    kernel_gain,
)

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


def extent_of(position: Array) -> float:
    """The larger side of the bounding box of (m, 2) [m]; InputError where it is a point."""
    extent = float(np.ptp(position, axis=0).max())
    if not extent > 0:
        raise InputError("the flight does not move: no length scale can be told; fly farther")
    return extent


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
    side = np.hstack(list(bent))
    side = side - value @ (basis @ (basis.T @ (value.T @ side)))
    beside = side.reshape(-1, len(k), 2).transpose(1, 0, 2)
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


@dataclass(frozen=True, eq=False)
class Lobes:
    """The lobes of RSS(k) of one scale more, for any remainder of Phi: the flight's part, once.

    As `refine.scan`, whose Gram matrices of the four plane waves do not depend on Phi: inverse
    (q, 8, 8) at k = j step, j = first, first + 1, ... A remainder costs four Fourier sums.
    """

    position: Array
    bounds: tuple[float, float]
    step: float
    first: int
    gain: Array
    size: int
    inverse: Array

    @classmethod
    def of(cls, position: Array, bounds: tuple[float, float]) -> "Lobes":
        """For position (m, 2) [m], centred, and bounds of k [1/m].

        InputError where there are too many lobes, or the flight does not move.
        """
        step = STEP / extent_of(position)
        first, last = max(1, math.floor(bounds[0] / step)), math.ceil(bounds[1] / step)
        if last > MAX_STEPS:
            raise InputError(
                f"a length scale of {math.pi / bounds[1]:.3g} m is too small for a flight of "
                f"{STEP / step:.3g} m: too many lobes; raise the grid's lower bound"
            )
        gain, size = kernel_gain(first, last)
        nothing, sums = np.empty((0, len(position))), np.empty((25, last - first + 1), complex)
        sums[12] = len(position)
        for i in range(12):  # (p, q) = divmod(i, 5) - 2: symmetric about i = 12, (0, 0)
            mode = np.array(divmod(i, 5)) - 2
            found = fourier_sums(position @ mode, nothing, step, size)[0, first : last + 1] / gain
            sums[i], sums[24 - i] = found.conj(), found
        pairs = (DIRECTIONS[:, None] + sign * DIRECTIONS for sign in (-1, 1))
        minus, plus = (sums[(pair + 2) @ (5, 1)] for pair in pairs)
        cosines = np.concatenate([(plus + minus).real, (plus - minus).imag], axis=1)
        sines = np.concatenate([(plus + minus).imag, (minus - plus).real], axis=1)
        gram = 0.5 * np.concatenate([cosines, sines], axis=0).transpose(2, 0, 1)
        gram[:, range(8), range(8)] += RIDGE * len(position)
        inverse = np.linalg.inv(gram).astype(float, copy=False)
        return cls(position, bounds, step, first, gain, size, inverse)

    def depths(self, rest: Array) -> Array:
        """|rest|^2 - RSS(k) (q,): what one scale more explains of rest (m, 2)."""
        loads, step, size = np.ascontiguousarray(rest.T), self.step, self.size
        waves = [fourier_sums(self.position @ -mode, loads, step, size) for mode in DIRECTIONS]
        part = slice(self.first, self.first + len(self.inverse))
        cross = np.stack([wave[1:, part] / self.gain for wave in waves])
        load = np.concatenate([cross.real, cross.imag]).transpose(2, 0, 1)
        depths: Array = np.sum(load * (self.inverse @ load), axis=(1, 2))
        return depths

    def __call__(self, rest: Array) -> Array:
        """k of the lobes [1/m], the deepest first; bounds included."""
        depth = self.depths(rest)
        padded = np.concatenate([[-np.inf], depth, [-np.inf]])
        found = np.flatnonzero((depth >= padded[:-2]) & (depth >= padded[2:]))
        found = found[np.argsort(-depth[found], kind="stable")]
        return np.clip(self.step * (self.first + found), *self.bounds)
