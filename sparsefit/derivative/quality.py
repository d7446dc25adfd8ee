"""How good a log is: its rate, steps, gaps, extent and noise, in numbers and in a line of words."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sparsefit.arrays import Array, BoolArray
from sparsefit.derivative.pieces import GAP
from sparsefit.derivative.smoothing import Smoothing
from sparsefit.derivative.steps import ONE_STEP, clock_rounding
from sparsefit.flight import Flight

CLEAN = 1e-9  # of the extent, or the speed: noise below it is rounding


@dataclass(frozen=True)
class LogQuality:
    """What a log is like before anything is made of it.

    Args:
        samples: m.
        duration: from the first sample to the last [s].
        rate: one over the median step [Hz].
        jitter: rms of the steps about the median one, gaps aside, as a share of it.
        gaps: steps longer than four median ones.
        longest_gap: [s], 0 where there is none.
        extent: sides of the bounding box (x, y) [m].
        speed: rms [m/s].
        velocity_measured: whether it was logged, or is that of the positions.
        frame: what x and y are: ``ENU``, ``NED``, or empty where the log does not say.
        position_noise: standard deviation [m] as the smoother finds it, NaN where it cannot.
        velocity_noise: [m/s].
    """

    samples: int
    duration: float
    rate: float
    jitter: float
    gaps: int
    longest_gap: float
    extent: tuple[float, float]
    speed: float
    velocity_measured: bool
    frame: str = ""
    position_noise: float = math.nan
    velocity_noise: float = math.nan

    @property
    def words(self) -> str:
        """The numbers in a line."""
        parts = [self._pace, self._gaps, f"{_extent(self.extent)} at {self.speed:.3g} m/s rms"]
        return "; ".join([*parts, self._noise])

    @property
    def _pace(self) -> str:
        pace = f"{self.rate:.4g} Hz" if self.rate >= 0.1 else f"every {1.0 / self.rate:.4g} s"
        return f"{pace}, {f'jitter {100 * self.jitter:.2g} %' if self.jitter else 'even steps'}"

    @property
    def _gaps(self) -> str:
        if not self.gaps:
            return "no gaps"
        return f"{self.gaps} gap{'s' if self.gaps > 1 else ''} of up to {self.longest_gap:.3g} s"

    @property
    def _noise(self) -> str:
        position, velocity = self.position_noise, self.velocity_noise
        parts = []
        if velocity > CLEAN * self.speed and self.velocity_measured:
            parts.append(f"{velocity:.2g} m/s")
        if position > CLEAN * max(self.extent):
            parts.append(f"{position:.2g} m")
        if not parts:
            return "noise not known" if math.isnan(position) else "no noise"
        return f"noise {' and '.join(parts)}"


def _extent(sides: tuple[float, float]) -> str:
    if max(sides) >= 1e3:
        return f"{sides[0] / 1e3:.3g} × {sides[1] / 1e3:.3g} km"
    return f"{sides[0]:.3g} × {sides[1]:.3g} m"


def quality_of(flight: Flight, smoothing: Smoothing | None = None) -> LogQuality:
    """Return what a flight's log is like.

    Args:
        flight: the flight.
        smoothing: what the smoother found of its noise, where it was asked.
    """
    steps = np.diff(flight.time)
    step, gap = float(np.median(steps)), gaps_of(flight.time)
    within = steps[~gap]
    jitter = math.sqrt(float(np.mean((within - step) ** 2))) if within.size else 0.0
    even = jitter <= ONE_STEP * step + clock_rounding(flight.time)
    sides = np.ptp(flight.position, axis=0).tolist()
    return LogQuality(
        samples=flight.samples,
        duration=flight.duration,
        rate=1.0 / step,
        jitter=0.0 if even else jitter / step,
        gaps=int(gap.sum()),
        longest_gap=float(steps[gap].max(initial=0.0)),
        extent=(sides[0], sides[1]),
        speed=math.sqrt(float(np.mean(np.sum(flight.velocity**2, axis=1)))),
        velocity_measured=flight.velocity_measured,
        frame=flight.frame,
        position_noise=smoothing.sigma_position if smoothing else math.nan,
        velocity_noise=smoothing.sigma_velocity if smoothing else math.nan,
    )


def gaps_of(time: Array) -> BoolArray:
    """Tell which steps (m - 1,) of times (m,) [s] are gaps: longer than `GAP` median ones."""
    steps = np.diff(time)
    gaps: BoolArray = steps > GAP * np.median(steps)
    return gaps
