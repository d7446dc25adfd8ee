"""The quality of a log (rate, gaps, noise), and the refusal of logs unfit for an estimate."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from sparsefit.arrays import Array, BoolArray
from sparsefit.errors import InputError, positive
from sparsefit.flight import Flight

GAP = 4.0  # median steps: a polynomial through the samples carries over less
ONE_STEP = 1e-6  # relative difference of steps that count as equal


class LogQuality:
    """Rate, gaps, extent and noise of a log.

    samples: m; duration: from the first sample to the last [s]; rate: one over the median step
    [Hz]; jitter: rms of the steps about the median one, gaps aside, as a share of it; gaps: steps
    longer than four median ones; longest_gap: [s], 0 where there is none; extent: sides of the
    bounding box (x, y) [m]; speed: rms [m/s]; velocity_measured: whether it was logged, or is that
    of the positions; frame: ``ENU``, ``NED``, or empty if unknown; position_noise:
    standard deviation [m], NaN if unknown; velocity_noise: [m/s], likewise.

    Args:
        flight: the flight.
        smoothing: the noise levels that a smoother estimated, ``sigma_position`` [m] and
            ``sigma_velocity`` [m/s].
    """

    def __init__(self, flight: Flight, smoothing: Any = None) -> None:
        steps, gap = np.diff(flight.time), gaps_of(flight.time)
        step = float(np.median(steps))
        jitter = math.sqrt(float(np.mean((steps[~gap] - step) ** 2)))
        even = jitter <= ONE_STEP * step + clock_rounding(flight.time)
        self.samples, self.duration = flight.samples, flight.duration
        self.rate, self.jitter = 1.0 / step, 0.0 if even else jitter / step
        self.gaps, self.longest_gap = int(gap.sum()), float(steps[gap].max(initial=0.0))
        self.extent: list[float] = np.ptp(flight.position, axis=0).tolist()
        self.speed = math.sqrt(float(np.mean(np.sum(flight.velocity**2, axis=1))))
        self.velocity_measured, self.frame = flight.velocity_measured, flight.frame
        self.position_noise = float(smoothing.sigma_position) if smoothing else math.nan
        self.velocity_noise = float(smoothing.sigma_velocity) if smoothing else math.nan

    @property
    def words(self) -> str:
        """The numbers in a line."""
        pace = f"{self.rate:.4g} Hz" if self.rate >= 0.1 else f"every {1.0 / self.rate:.4g} s"
        even = f"jitter {100 * self.jitter:.2g} %" if self.jitter else "even steps"
        gaps = f"{self.gaps or 'no'} gap{'s' * (self.gaps != 1)}"
        gaps += f" of up to {self.longest_gap:.3g} s" if self.gaps else ""
        scale, unit = (1e3, "km") if max(self.extent) >= 1e3 else (1.0, "m")
        sides = " × ".join(f"{side / scale:.3g}" for side in self.extent)
        noise = []  # below 1e-9 of the speed or the extent it is rounding
        if self.velocity_noise > 1e-9 * self.speed and self.velocity_measured:
            noise.append(f"{self.velocity_noise:.2g} m/s")
        if self.position_noise > 1e-9 * max(self.extent):
            noise.append(f"{self.position_noise:.2g} m")
        levels = "noise not known" if math.isnan(self.position_noise) else "no noise"
        levels = f"noise {' and '.join(noise)}" if noise else levels
        return f"{pace}, {even}; {gaps}; {sides} {unit} at {self.speed:.3g} m/s rms; {levels}"


def gaps_of(time: Array) -> BoolArray:
    """Mask (m - 1,) of the steps of times (m,) [s] that are gaps: over `GAP` median steps."""
    steps = np.diff(time)
    return np.asarray(steps > GAP * np.median(steps))


def clock_rounding(time: Array) -> float:
    """The rounding [s] of a difference of two times [s], (m,)."""
    return 4.0 * float(np.spacing(np.abs(time).max()))


def check_log(
    flight: Flight,
    *,
    smallest: float = 0.0,
    largest: float = math.inf,
    longest_gap: float | None = None,
) -> None:
    """Refuse a log that is unfit for an estimate.

    Args:
        flight: the flight.
        smallest, largest: the bounds of the length scales to search [m].
        longest_gap: the longest gap allowed [s]; None: the longer of 60 s and 20 steps.

    Raises:
        InputError: naming the first of these: a long gap, a vehicle at rest, samples too far apart
            for the length scales, rows of several vehicles, a velocity of zero throughout.
    """
    steps = np.diff(flight.time)
    row, allowed = int(np.argmax(steps)), max(60.0, 20.0 * float(np.median(steps)))
    if longest_gap is not None:
        allowed = positive("longest_gap", longest_gap, "s")
    if (gap := float(steps[row])) > allowed:
        raise InputError(
            f"a gap of {gap:.4g} s after t={flight.time[row]:.10g} s (row {row}): cut it there, "
            f"or allow a longest gap of {math.ceil(gap)} s"
        )
    # A vehicle that moves no farther in 5 s is at rest; shorter logs are only short.
    if not flight.extent or (flight.duration >= 5.0 and flight.extent < smallest):
        raise InputError(
            f"the vehicle stands still: it stays within {flight.extent:.3g} m in "
            f"{flight.duration:.3g} s, and the smallest length scale sought is {smallest:g} m; "
            "give a log of a flight, or its unit if that is not m"
        )
    apart, *taken = (  # by one row, two, three and four
        float(np.median(np.hypot(*(flight.position[lag:] - flight.position[:-lag]).T)))
        for lag in range(1, min(5, flight.samples - 1))
    )
    if apart > largest:  # beyond half a period waves are aliased
        raise InputError(
            f"samples are {apart:.3g} m apart, and the largest length scale sought is {largest:g} m"
            f": no flow of that size shows; raise the grid's bounds (--grid-lower, --grid-upper)"
        )
    for count, step in enumerate(taken, start=2):  # alternating vehicles: near after `count` rows
        if step < 0.1 * apart:
            raise InputError(
                f"the rows take turns between {count} tracks, {apart:.3g} m apart: a flight is of "
                "one vehicle; give the rows of one"
            )
    if flight.velocity_measured and not flight.velocity.any():
        raise InputError("the velocity is zero throughout, and the vehicle moves: leave vx, vy out")
