"""The one clock: seconds on the wall of a process and of all that it starts, kept by the parent.

    wall, cpu        of each repeat, measured from outside of the process that solves
    median, 95 %     by order statistics, whatever the distribution

Code that is timed can change its own clock and not this. CPU time stands beside the wall: a solver
that sleeps, or works elsewhere, has less of it; a disturbed machine too.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache

import numpy as np

CONFIDENCE = 0.95
AHEAD = 1.2  # wall over CPU seconds beyond which a measurement was disturbed
SHORT = 1e-3  # s of wall below which the ratio says nothing
SLOW = 0.3  # s: a first run this long needs no warm-up of its own, and counts


@dataclass(frozen=True)
class Timing:
    """Seconds [s] on the wall, and of CPU of the process and what it started."""

    wall: float
    cpu: float


def median_interval(values: Sequence[float]) -> tuple[float, float, float]:
    """Median and its 95 % interval by order statistics; NaN ends below six values.

    Between the j-th smallest and the j-th largest of n lies the true median with probability
    1 - 2 P(B < j), B binomial of n and 1/2, whatever the distribution.
    """
    ordered = np.sort(np.asarray(values, dtype=float))
    if not len(ordered):
        return math.nan, math.nan, math.nan
    outside = _outside(len(ordered))
    if not outside:
        return float(np.median(ordered)), math.nan, math.nan
    return float(np.median(ordered)), float(ordered[outside - 1]), float(ordered[-outside])


@cache
def _outside(count: int) -> int:
    """The largest j of `median_interval`, 0 where there is none."""
    from scipy.stats import binom  # slow to import, and of no use to a worker

    outside = int(binom.ppf((1 - CONFIDENCE) / 2, count, 0.5))
    while outside and 2 * binom.cdf(outside - 1, count, 0.5) > 1 - CONFIDENCE:
        outside -= 1
    return outside


@dataclass
class Repeats:
    """The timings of one case so far; spent: seconds of wall [s], counted or not."""

    timings: list[Timing] = field(default_factory=list)
    spent: float = 0.0

    def note(self, timing: Timing, *, first: bool) -> None:
        """One more run; a short first one has only warmed up, and is not counted."""
        self.spent += timing.wall
        if not first or timing.wall > SLOW:
            self.timings.append(timing)

    def registered(self, precision: float) -> bool:
        """Whether the median of the wall is known to this share of it."""
        middle, low, high = median_interval([timing.wall for timing in self.timings])
        return bool(high - low <= 2.0 * precision * middle)

    def enough(self, repeats: int, seconds: float, precision: float) -> bool:
        """Whether no more is to be timed."""
        if self.timings and self.spent >= seconds:
            return True
        return len(self.timings) >= repeats or self.registered(precision)

    @property
    def disturbed(self) -> bool:
        """Whether the wall ran well ahead of the CPU."""
        wall, cpu = self.middle("wall"), self.middle("cpu")
        return wall > SHORT and wall > AHEAD * cpu

    def middle(self, name: str) -> float:
        """The median of `wall` or `cpu` [s]; NaN without a timing."""
        return median_interval([getattr(timing, name) for timing in self.timings])[0]
