"""Logs that no estimate should be made of: found in a moment, and refused by name.

Where position and velocity are both logged, the steps of the position against the integral of the
velocity, d = m A, say what is wrong: A is the identity of one motion in one unit; c times it where
units are mixed; with exchanged or opposite axes where frames are.
"""

from __future__ import annotations

import math

import numpy as np

from sparsefit.arrays import Array
from sparsefit.derivative.quality import gaps_of
from sparsefit.errors import InputError, positive
from sparsefit.flight import Flight
from sparsefit.flight.units import LENGTHS, SPEEDS, TIMES, named

LONGEST_GAP = 60.0  # s
LONGEST_STEPS = 20.0  # median steps: of slow logs a gap is longer
RESTING = 5.0  # s: who goes no farther in that time rests; shorter logs are only short
TOGETHER = 8  # steps that are held against the velocity as one: the position's noise counts less
EXPLAINED = 0.95  # of the motion, by whatever A fits best
UNLIKE = 0.1  # of the entries of A against those of a named one
LEAST, MOST = 0.67, 2.0  # factors between: coarse samples alone do as much
APART = 20.0  # times what all other steps do: no step of one vehicle
FAST, SHARP = 5.0, 3.0  # the same of the largest speed, with a turn beyond all others
ALTERNATING = (2, 3, 4)  # vehicles whose rows take turns
CLOSE = 0.1  # of the steps between them: how little each of these moves


def check_log(flight: Flight, *, smallest: float = 0.0, longest_gap: float | None = None) -> None:
    """Refuse a log that no estimate should be made of.

    Args:
        flight: the flight.
        smallest: the least length scale that will be sought [m].
        longest_gap: that is allowed [s]; None is 60 s, or 20 steps where they are longer.

    Raises:
        InputError: naming the first of these: a long gap, a vehicle that stands still, rows of
            two vehicles or flights, velocities in another unit, frame or sign than positions.
    """
    longest = None if longest_gap is None else positive("longest_gap", longest_gap, "s")
    _check_gap(flight, longest)
    _check_still(flight, smallest)
    _check_turns(flight)
    _check_one_flight(flight)
    if flight.velocity_measured:
        _check_units(flight)


def _check_gap(flight: Flight, longest: float | None) -> None:
    steps = np.diff(flight.time)
    row = int(np.argmax(steps))
    allowed = max(LONGEST_GAP, LONGEST_STEPS * float(np.median(steps)))
    if steps[row] <= (allowed if longest is None else longest):
        return
    raise InputError(
        f"a gap of {_time(float(steps[row]))} after t={flight.time[row]:.10g} s (row {row}): what "
        f"flew there is not known; cut the log, or allow a longest gap of {math.ceil(steps[row])} s"
    )


def _time(seconds: float) -> str:
    return f"{seconds:.4g} s" if seconds < 120.0 else f"{seconds / 60.0:.4g} minutes"


def _check_still(flight: Flight, smallest: float) -> None:
    long = flight.duration >= RESTING
    if flight.extent > 0 and not (long and flight.extent < smallest):
        return
    where = f"stays within {flight.extent:.3g} m in {flight.duration:.3g} s"
    where = where if flight.extent else "never leaves its place"
    least = f", less than the smallest length scale sought, {smallest:g} m" if smallest else ""
    raise InputError(f"the vehicle stands still: it {where}{least}; give a log of a flight")


def _check_turns(flight: Flight) -> None:
    """Whether every second row (third, ...) goes on where the one before it left."""
    position = flight.position
    apart = _median_step(position, 1)
    for count in ALTERNATING:
        if count < len(position) - 1 and _median_step(position, count) < CLOSE * apart:
            raise InputError(
                f"the rows take turns between {count} tracks, {apart:.3g} m apart: a flight is of "
                "one vehicle; give the rows of one"
            )


def _median_step(position: Array, lag: int) -> float:
    return float(np.median(np.hypot(*(position[lag:] - position[:-lag]).T)))


def _check_one_flight(flight: Flight) -> None:
    """Whether the vehicle is suddenly elsewhere, at another velocity."""
    steps = np.diff(flight.time)
    moved = np.hypot(*np.diff(flight.position, axis=0).T)
    speeds = moved / steps
    row = int(np.argmax(speeds))
    others = np.delete(np.arange(len(steps)), row)
    if len(others) < 2:
        return
    if flight.velocity_measured:
        turned = np.hypot(*np.diff(flight.velocity, axis=0).T)
        known = float(np.hypot(*flight.velocity.T).max())
        elsewhere = speeds[row] > FAST * known and turned[row] > SHARP * turned[others].max()
    else:
        elsewhere = speeds[row] > APART * speeds[others].max()
    if elsewhere:
        raise InputError(
            f"between rows {row} and {row + 1} (t={flight.time[row]:.10g} s) the vehicle jumps by "
            f"{moved[row]:.3g} m to another motion: two flights in one log? give one of them"
        )


def _check_units(flight: Flight) -> None:
    """Whether position and velocity are of one motion in one unit and one frame."""
    moved, meant = _motions(flight)
    if len(moved) < TOGETHER or not meant.any():
        if flight.velocity.any() or len(moved) < TOGETHER:
            return
        raise InputError("the velocity is zero throughout, and the vehicle moves: leave vx, vy out")
    found: Array = np.linalg.lstsq(meant, moved, rcond=None)[0].astype(np.float64)
    left = float(np.sum((moved - meant @ found) ** 2))
    if left > (1.0 - EXPLAINED) * float(np.sum(moved**2)):
        return
    factor = float(np.sqrt(abs(np.linalg.det(found))))
    if not factor > 0:
        return
    axes: Array = found / factor
    if _is(axes, [[0, 1], [1, 0]]):
        raise InputError(
            "vx goes with y and vy with x: position and velocity are in different frames, NED and "
            "ENU, say; exchange vx and vy"
        )
    for signs, names in (((-1, 1), "vx has"), ((1, -1), "vy has"), ((-1, -1), "vx and vy have")):
        if _is(axes, np.diag(signs)):
            raise InputError(f"{names} the opposite sign of the position's motion; check the frame")
    if _is(axes, np.eye(2)) and not LEAST < factor < MOST:
        raise InputError(
            f"the position moves {factor:.4g} times as far as the velocity says: units are mixed"
            f"{_likely(factor)}; give all in s, m and m/s, or name their units"
        )


def _is(axes: Array, named_axes: object) -> bool:
    return bool(np.abs(axes - np.asarray(named_axes)).max() < UNLIKE)


def _motions(flight: Flight) -> tuple[Array, Array]:
    """Steps of the position, and of the integral of the velocity, several together [m], (n, 2)."""
    steps = np.diff(flight.time)[:, None]
    moved = np.diff(flight.position, axis=0)
    meant = steps * (flight.velocity[1:] + flight.velocity[:-1]) / 2.0
    within = ~gaps_of(flight.time)
    moved, meant = moved[within], meant[within]
    starts = np.arange(0, len(moved) - TOGETHER + 1, TOGETHER)
    if not len(starts):
        return moved[:0], meant[:0]
    whole = slice(0, int(starts[-1]) + TOGETHER)
    return np.add.reduceat(moved[whole], starts), np.add.reduceat(meant[whole], starts)


def _likely(factor: float) -> str:
    """The units that would do it: the factor is those of velocity and time over the position's."""
    units = (
        ("position", named(1.0 / factor, LENGTHS)),
        ("velocity", named(factor, SPEEDS)),
        ("time", named(factor, TIMES)),
    )
    told = [f"{what} in {unit}" for what, unit in units if unit]
    return f" ({' or '.join(told)}?)" if told else ""
