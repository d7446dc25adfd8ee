"""Samples of a log that cannot be: velocities off by themselves, positions that jump.

A velocity is held against what its neighbours say without it: a polynomial through a few of them
(its weight h on itself taken out: the residual over 1 - h), or Simpson's rule through the positions
beside it,

    x_{i+1} - x_{i-1} = dt/3 (v_{i-1} + 4 v_i + v_{i+1}),

whichever predicts best by the median of what it leaves. A jump of the position is one step in which
it moves otherwise than the integral of the velocity.

Either is found where what is left exceeds `SURE` robust standard deviations, `ALONE` times the
median of the samples around it, so that no sharp turn is taken for one, and `FELT` of the vehicle's
speed. Velocities are replaced by their prediction, in rounds, as an outlier spoils the prediction
of its neighbours too; what no longer stands out is given back. Positions are summed again from
their increments, a jump taken out (Hampel, 1974).
"""

from __future__ import annotations

import math
from functools import lru_cache
from itertools import pairwise

import numpy as np

from sparsefit.arrays import Array, BoolArray, IntArray

SURE = 6.5  # robust standard deviations: white noise goes beyond it once in 1e6 flights
SCREEN = 5.0  # the same, of differences alone: the first look, and the only one at most flights
ALONE = 3.0
FELT = 0.01  # of the rms speed: less moves no parameter
FELT_JUMP = 0.1  # of the way in a step at that speed
AROUND = 4  # samples on either side
ROUNDS = 6
RAYLEIGH = math.sqrt(2.0 * math.log(2.0))  # median of the length of a pair of unit normals
FITS = ((7, 3), (11, 5), (17, 5), (33, 5))  # windows and degrees of the polynomials
FEWEST = FITS[-1][0]  # samples of a piece in which outliers and jumps are sought
MOST_OUTLIERS, MOST_JUMPS = 0.2, 0.02  # of the samples: more, and the others are no measure of them
JUMP_SIDE = 30  # samples on either side that the size of a jump is read from
THERE_AND_BACK = 10  # samples within which a position that jumps back was an outlier by itself
BACK = 0.2  # of a jump: what may be left of it after the way back
SHARED, MUCH = 3.0, 1.5  # parts of a step's square, and sizes of it, that its neighbours may have
NOTHING = 1e-300  # beside any error: a spread must divide


def clean_velocity(position: Array | None, velocity: Array, step: float) -> tuple[Array, BoolArray]:
    """The velocity (m, 2) [m/s] of one piece without its outliers, and which these were (m,).

    position [m], without jumps; None where it is not to be asked; step [s] between the samples.
    Where there is no outlier, or too many to tell, the velocity is the very array that was given.
    """
    found = np.zeros(len(velocity), dtype=bool)
    if len(velocity) < FEWEST or not _stands_out(velocity):
        return velocity, found
    least, cleaned = FELT * _rms(velocity), velocity
    for _ in range(ROUNDS):
        predicted, weight = _best(position, cleaned, velocity, step)
        flagged = _isolated(_length(velocity - predicted), weight, least)
        settled = bool((flagged == found).all())
        found, cleaned = flagged, np.where(flagged[:, None], predicted, velocity)
        if settled or found.mean() > MOST_OUTLIERS:
            break
    if not 0.0 < found.mean() <= MOST_OUTLIERS:
        return velocity, np.zeros_like(found)
    return cleaned, found


def clean_position(position: Array, velocity: Array, step: float) -> tuple[Array, Array]:
    """The position (m, 2) [m] of one piece without its jumps, and how far these went (j,) [m].

    velocity [m/s], outliers and all: what is a jump only beside one of them is none; step [s]
    between the samples.
    """
    left = unexplained(position, velocity, step)
    jumps = _jumps(left, FELT_JUMP * step * _rms(velocity))
    if jumps.any():
        mended, found = clean_velocity(None, velocity, step)
        if found.any():
            left = unexplained(position, mended, step)
            jumps &= _jumps(left, FELT_JUMP * step * _rms(mended))
    if not 0 < jumps.sum() <= MOST_JUMPS * len(jumps):
        return position, np.empty(0)
    return _rejoined(position, left, np.flatnonzero(jumps))


def unexplained(position: Array, velocity: Array, step: float) -> Array:
    """What the integral of the velocity leaves of every step [m], (m - 1, 2)."""
    left: Array = np.diff(position, axis=0) - step * _quadrature(velocity)
    return left


def _jumps(left: Array, least: float) -> BoolArray:
    """Which steps stand out, by more than what is left of others (m - 1, 2) and ``least`` [m]."""
    size = _length(left)
    if len(size) < FEWEST or size.max() <= SURE * _spread(size):
        return np.zeros(len(size), dtype=bool)
    return _isolated(size, np.ones_like(size), least) & ~_beside_velocity(left, size)


def _stands_out(velocity: Array) -> bool:
    """Whether any velocity is off those beside it, by its fourth difference."""
    size = _length(np.diff(velocity, 4, axis=0))
    return bool(size.max() > SCREEN * _spread(size))


def _best(
    position: Array | None, cleaned: Array, velocity: Array, step: float
) -> tuple[Array, Array]:
    """The best prediction (m, 2) of each velocity by the others, and weights (m,) of its errors.

    cleaned: the velocities that predict. With the weights, errors of all samples have one spread.
    """
    predictions = [_by_polynomial(cleaned, *fit) for fit in FITS]
    if position is not None:
        predictions.append(_by_simpson(position, cleaned, step))
    spreads = [_spread(_length(velocity - predicted)) for predicted, _ in predictions]
    return predictions[int(np.argmin(spreads))]


def _by_simpson(position: Array, velocity: Array, step: float) -> tuple[Array, Array]:
    """At the ends by the parabola through three velocities, whose integral is the first step."""
    moved = np.diff(position, axis=0) / step
    predicted = np.empty_like(velocity)
    predicted[1:-1] = 0.75 * (moved[1:] + moved[:-1]) - 0.25 * (velocity[2:] + velocity[:-2])
    predicted[0] = (12.0 * moved[0] - 8.0 * velocity[1] + velocity[2]) / 5.0
    predicted[-1] = (12.0 * moved[-1] - 8.0 * velocity[-2] + velocity[-3]) / 5.0
    return predicted, np.ones(len(velocity))


def _by_polynomial(velocity: Array, window: int, degree: int) -> tuple[Array, Array]:
    """At either end the window stays and its last samples are predicted off its middle."""
    hat, half = _hat(window, degree), window // 2
    inner = [np.correlate(column, hat[half], "valid") for column in velocity.T]
    ends = hat[:half] @ velocity[:window], hat[half + 1 :] @ velocity[-window:]
    fitted = np.vstack([ends[0], np.column_stack(inner), ends[1]])
    own = np.full(len(velocity), hat[half, half])
    own[:half], own[len(own) - half :] = np.diag(hat)[:half], np.diag(hat)[half + 1 :]
    predicted = (fitted - own[:, None] * velocity) / (1.0 - own)[:, None]
    return predicted, np.sqrt((1.0 - own) / (1.0 - hat[half, half]))


@lru_cache(maxsize=len(FITS))
def _hat(window: int, degree: int) -> Array:
    """The weights (n, n) of n even samples in a polynomial through them."""
    powers = np.vander(np.linspace(-1.0, 1.0, window), degree + 1, increasing=True)
    hat: Array = powers @ np.linalg.pinv(powers)
    return hat


def _isolated(size: Array, weight: Array, least: float) -> BoolArray:
    """Which errors (m,) stand out from all others, and from those around them."""
    weighted = weight * size
    found: BoolArray = (weighted > SURE * _spread(weighted)) & (size > least)
    rows = np.flatnonzero(found)
    if len(rows):
        first = np.clip(rows - AROUND, 0, len(size) - 2 * AROUND - 1)
        around = weighted[first[:, None] + np.arange(2 * AROUND + 1)]
        found[rows] = weighted[rows] > ALONE * np.median(around, axis=1)
    return found


def _beside_velocity(left: Array, size: Array) -> BoolArray:
    """Which steps are off for a velocity beside them: a neighbour is off likewise, or by more.

    left (m - 1, 2): what the velocity leaves of each step; size (m - 1,): its length.
    """
    along, none = np.sum(left[1:] * left[:-1], axis=1), [0.0]
    shared = np.maximum(np.append(none, along), np.append(along, none))
    largest = np.maximum(np.append(none, size[:-1]), np.append(size[1:], none))
    beside: BoolArray = (shared > size**2 / SHARED) | (largest > MUCH * size)
    return beside


def _quadrature(velocity: Array) -> Array:
    """The mean velocity (m - 1, 2) in each step, exact for cubics, at the ends for parabolas."""
    mean: Array = np.empty((len(velocity) - 1, 2))
    inner = velocity[1:-2] + velocity[2:-1]
    mean[1:-1] = (13.0 * inner - velocity[:-3] - velocity[3:]) / 24.0
    mean[0] = (5.0 * velocity[0] + 8.0 * velocity[1] - velocity[2]) / 12.0
    mean[-1] = (5.0 * velocity[-1] + 8.0 * velocity[-2] - velocity[-3]) / 12.0
    return mean


def _rejoined(position: Array, left: Array, jumps: IntArray) -> tuple[Array, Array]:
    """Positions without the steps at these rows; a jump is read from the samples on its sides.

    left (m - 1, 2): what the integral of the velocity leaves of each step [m].
    """
    beside = np.vstack([[0.0, 0.0], np.cumsum(left, axis=0)])
    ends = [-1, *jumps.tolist(), len(position) - 1]
    shift = np.zeros_like(position)
    for before, jump, after in zip(ends[:-2], ends[1:-1], ends[2:], strict=True):
        left = beside[max(before, jump - JUMP_SIDE) + 1 : jump + 1]
        right = beside[jump + 1 : min(after, jump + JUMP_SIDE) + 1]
        shift[jump + 1] = right.mean(axis=0) - left.mean(axis=0)
    for go, back in pairwise((jumps + 1).tolist()):
        stays = shift[go] + shift[back]
        if back - go <= THERE_AND_BACK and np.abs(stays).max() < BACK * np.abs(shift[go]).max():
            shift[back] = -shift[go]
    return position - np.cumsum(shift, axis=0), _length(shift[jumps + 1])


def _length(pairs: Array) -> Array:
    length: Array = np.hypot(pairs[:, 0], pairs[:, 1])
    return length


def _spread(size: Array) -> float:
    """The standard deviation, along an axis, of normal pairs with these lengths (m,)."""
    middle = [(len(size) - 1) // 2, len(size) // 2]  # as np.median, which takes five times as long
    return max(0.5 * float(np.partition(size, middle)[middle].sum()) / RAYLEIGH, NOTHING)


def _rms(velocity: Array) -> float:
    return math.sqrt(float(np.mean(velocity**2)))
