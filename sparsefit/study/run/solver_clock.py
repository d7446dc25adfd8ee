"""When a median is known: repeats of a case, by turns with the others of its problem."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache

import numpy as np
from scipy.stats import binom

from sparsefit.study.run.solver_solve import Timing, Verdict
from sparsefit.study.spec.solver_study import Clock, SolverCase

CONFIDENCE = 0.95
SLOW = 0.3  # s: a first run this long needs no warm-up of its own, and counts
AHEAD = 1.2  # wall over CPU seconds beyond which a measurement was disturbed
SHORT = 1e-3  # s of wall below which the ratio says nothing


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
    outside = int(binom.ppf((1 - CONFIDENCE) / 2, count, 0.5))
    while outside and 2 * binom.cdf(outside - 1, count, 0.5) > 1 - CONFIDENCE:
        outside -= 1
    return outside


@dataclass
class Repeats:
    """The timings of one case so far, and what the referee said of it."""

    case: SolverCase
    timings: list[Timing] = field(default_factory=list)
    verdict: Verdict | None = None
    memory: float = math.nan
    error: str = ""
    lost: str = ""
    load: float = math.nan
    spent: float = 0.0

    @property
    def failed(self) -> bool:
        """Whether there is nothing left to time."""
        return bool(self.error or self.lost)

    def note(self, timing: Timing, *, counts: bool = True) -> None:
        """One more run; one that only warmed up is not counted."""
        self.spent += timing.cpu
        if counts:
            self.timings.append(timing)

    def known(self, clock: Clock) -> bool:
        """Whether the median is known to the precision asked for."""
        middle, low, high = median_interval([one.cpu for one in self.timings])
        return bool(high - low <= 2.0 * clock.precision * middle)

    def done(self, clock: Clock) -> bool:
        """Whether no more is to be timed."""
        if self.failed or (self.timings and self.spent >= clock.seconds):
            return True
        return len(self.timings) >= clock.repeats or self.known(clock)

    @property
    def disturbed(self) -> bool:
        """Whether the process had to wait for the machine while it was timed."""
        wall = float(np.median([one.wall for one in self.timings] or [0.0]))
        cpu = float(np.median([one.cpu for one in self.timings] or [0.0]))
        return wall > SHORT and wall > AHEAD * cpu
