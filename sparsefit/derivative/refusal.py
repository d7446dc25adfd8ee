"""Logs that no estimate should be made of: found in a moment, and refused by name.

Where position and velocity are both logged, the steps of the position against the integral of the
velocity, d = c m T, say what is wrong: T is the identity of one motion, and c is 1 in one unit; T
has exchanged or opposite axes where frames are mixed. With noise of the velocity alone the share of
d that m explains is at most c: a share of 0.8 leaves no c below 0.67 but to units.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from sparsefit.arrays import Array
from sparsefit.derivative.quality import gaps_of
from sparsefit.errors import InputError, positive
from sparsefit.flight import Flight
from sparsefit.logs.layout import LENGTHS, SPEEDS, TIMES, named

LONGEST_GAP = 60.0  # s
LONGEST_STEPS = 20.0  # median steps: of slow logs a gap is longer
RESTING = 5.0  # s: who goes no farther in that time rests; shorter logs are only short
EXPLAINED = 0.8  # of the motion, by whatever T fits best
MORE = 0.05  # of it than the identity explains
FEWEST = 12  # steps, as many together as may be, that are held against the velocity
NOTHING = 1e-300
FRAMES = {  # T, and what it says
    ((1, 0), (0, 1)): "",
    (
        (0, 1),
        (1, 0),
    ): "vx goes with y and vy with x: position and velocity are in different frames, "
    "NED and ENU, say; exchange vx and vy",
    ((-1, 0), (0, 1)): "vx has the opposite sign of the position's motion; check the frame",
    ((1, 0), (0, -1)): "vy has the opposite sign of the position's motion; check the frame",
    (
        (-1, 0),
        (0, -1),
    ): "vx and vy have the opposite sign of the position's motion; check the frame",
}
LEAST, MOST = 0.67, 2.0  # factors between: coarse samples alone do as much
APART = 20.0  # times what all other steps do: no step of one vehicle
FAST, SHARP = 5.0, 2.0  # the same of the largest speed, with a turn beyond all others
BESIDE = (1, 5)  # samples on either side of a turn
ALTERNATING = (2, 3, 4)  # vehicles whose rows take turns
CLOSE = 0.1  # of the steps between them: how little each of these moves


def check_log(
    flight: Flight,
    *,
    smallest: float = 0.0,
    largest: float = math.inf,
    longest_gap: float | None = None,
) -> None:
    """Refuse a log that no estimate should be made of.

    Args:
        flight: the flight.
        smallest: the least length scale that will be sought [m].
        largest: likewise.
        longest_gap: that is allowed [s]; None is 60 s, or 20 steps where they are longer.

    Raises:
        InputError: naming the first of these: a long gap, a vehicle that stands still, samples
            too far apart for what is sought, rows of two vehicles or flights, velocities in another
            unit, frame or sign than positions.
    """
    longest = None if longest_gap is None else positive("longest_gap", longest_gap, "s")
    _check_gap(flight, longest)
    _check_still(flight, smallest)
    _check_apart(flight, largest)
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


def _check_apart(flight: Flight, largest: float) -> None:
    """Half a period is the least step that tells a wave from another one."""
    apart = _median_step(flight.position, 1)
    if apart > largest:
        raise InputError(
            f"samples are {apart:.3g} m apart, and the largest length scale sought is {largest:g} m"
            f": no flow of that size shows; raise the grid's bounds (--grid-lower, --grid-upper)"
        )


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
    others = np.delete(speeds, row)
    if len(others) < 2:
        return
    if flight.velocity_measured:
        known = float(np.hypot(*flight.velocity.T).max())
        elsewhere = speeds[row] > FAST * known and _turns(flight.velocity, row)
    else:
        elsewhere = speeds[row] > APART * others.max()
    if elsewhere:
        raise InputError(
            f"between rows {row} and {row + 1} (t={flight.time[row]:.10g} s) the vehicle jumps by "
            f"{moved[row]:.3g} m to another motion: two flights in one log? give one of them"
        )


def _turns(velocity: Array, row: int) -> bool:
    """Whether the velocity, too, changes behind a row, as nowhere else.

    From sample to sample, or where these are noisy between medians of a few on either side. A
    velocity that is far off by itself changes twice, and is no second flight.
    """
    return any(_stands_out(velocity, row, width) for width in BESIDE)


def _stands_out(velocity: Array, row: int, width: int) -> bool:
    medians = np.median(sliding_window_view(velocity, width, axis=0), axis=-1)
    changes = np.hypot(*(medians[width:] - medians[:-width]).T)  # behind row width - 1, ...
    place = row - width + 1
    if not 0 <= place < len(changes):
        return False
    far = np.abs(np.arange(len(changes)) - place) >= width
    return bool(changes[place] > SHARP * changes[far].max(initial=0.0))


def _check_units(flight: Flight) -> None:
    """Whether position and velocity are of one motion in one unit and one frame."""
    moved, meant = _steps(flight)
    if not meant.any():
        raise InputError("the velocity is zero throughout, and the vehicle moves: leave vx, vy out")
    shares, factors = _explained(moved, meant)
    best = int(np.argmax(shares))
    if shares[best] < EXPLAINED:
        return
    if shares[best] > shares[0] + MORE:
        raise InputError(list(FRAMES.values())[best])
    if not LEAST < factors[0] < MOST:
        raise InputError(
            f"the position moves {factors[0]:.4g} times as far as the velocity says: units are "
            f"mixed{_likely(factors[0])}; give all in s, m and m/s, or name their units"
        )


def _steps(flight: Flight) -> tuple[Array, Array]:
    """Steps of the position, and of the integral of the velocity, gaps aside [m], (n, 2)."""
    steps, within = np.diff(flight.time)[:, None], ~gaps_of(flight.time)
    meant = steps * (flight.velocity[1:] + flight.velocity[:-1]) / 2.0
    return np.diff(flight.position, axis=0)[within], meant[within]


def _explained(moved: Array, meant: Array) -> tuple[list[float], list[float]]:
    """Of each of `FRAMES` the share of the motion that it explains, and its factor c.

    Over so many steps together as leave the least of the noise: a position's is that of its ends.
    """
    found: tuple[list[float], list[float]] = ([0.0] * len(FRAMES), [1.0] * len(FRAMES))
    together = 1
    while together * FEWEST <= len(moved):
        whole = len(moved) // together * together
        d, m = (one[:whole].reshape(-1, together, 2).sum(axis=1) for one in (moved, meant))
        turned = [m @ np.array(frame, dtype=np.float64) for frame in FRAMES]
        along = [float(np.sum(one * d)) for one in turned]
        own, all_of_it = float(np.sum(m * m)), float(np.sum(d * d))
        shares = [max(one, 0.0) ** 2 / max(own * all_of_it, NOTHING) for one in along]
        if max(shares) > max(found[0]):
            found = shares, [one / max(own, NOTHING) for one in along]
        together *= 2
    return found


def _likely(factor: float) -> str:
    """The units that would do it: the factor is those of velocity and time over the position's."""
    units = (
        ("position", named(1.0 / factor, LENGTHS)),
        ("velocity", named(factor, SPEEDS)),
        ("time", named(factor, TIMES)),
    )
    told = [f"{what} in {unit}" for what, unit in units if unit]
    return f" ({' or '.join(told)}?)" if told else ""
