"""Levels of noise and disturbances: their steps from pass to pass.

With the derivative of log L by the logarithm of a variance written as a - n, a = sum r^2/2 of what
was smoothed and n its expectation, a variance moves far from the optimum by a secant on log(a/n),
near it by scoring with the average information (Gilmour, Thompson and Cullis 1995, Biometrics 51,
1440), linear in the variances, so that a level that falls to nothing takes the others with it.
"""

from __future__ import annotations

import math

import numpy as np

from sparsefit.arrays import Array


class LevelSteps:
    """The steps of the logarithms of the variances of one log, pass after pass."""

    def __init__(self, wanted: list[int], negligible: float, hold: int) -> None:
        """Begin far from the optimum.

        Args:
            wanted: the places of the levels that are estimated: 0 is the process noise, 1 and 2
                are the instruments'.
            negligible: the degrees of freedom that a level may take and count as zero.
            hold: the passes before the levels of the instruments move.
        """
        self.wanted, self.negligible, self.hold = wanted, negligible, hold
        self.count, self.gain = 0, math.inf
        self.place: Array | None = None
        self.ratio: Array | None = None

    def change(
        self, levels: list[float], squares: Array, information: Array, least: float
    ) -> tuple[Array, float]:
        """Return the step (l,) of the logarithms, and what it may gain.

        Args:
            levels: standard deviations (l,).
            squares: a and n (l, 2).
            information: of the logarithms (l, l), or of no rows.
            least: the process noise, where it is not estimated.
        """
        self.count += 1
        (a, n), step = squares.T, np.zeros(len(levels))
        place = 2.0 * np.log(np.maximum(levels, 1e-150))
        active = [j for j in self.wanted if max(a[j], n[j]) > self.negligible]
        least = max(least, 1e-9)
        annealing = 0 not in self.wanted and levels[0] > 1.001 * least
        if annealing:
            step[0] = 2.0 * math.log(least / levels[0])
            if n[0] > self.negligible:
                step[0] = max(step[0], -math.log(100.0))
        if self.count <= self.hold or annealing:
            active = [j for j in active if j not in (1, 2)]
        share, gain = np.zeros(len(levels)), math.inf
        if self.gain < 10.0 and len(information) and active:
            least_share = np.where(np.isin(active, (1, 2)), -0.7, -0.99)
            share[active] = _bounded(
                information[np.ix_(active, active)], (a - n)[active], least_share
            )
            gain = float((a - n) @ share)
        few = np.where(np.isin(np.arange(len(a)), (1, 2)), 5.0, 1e-300)
        ratio = np.log((a + few) / (n + few))  # few readings' worth says little of their noise
        near = not active or 0.0 <= gain < 10.0
        if near:
            step[active] = np.log1p(share[active])
            self.gain = gain if active else 0.0
        else:
            slope = np.where(few > 1.0, 1.0, 0.4)
            if self.place is not None and self.ratio is not None:
                with np.errstate(divide="ignore", invalid="ignore"):
                    secant = (self.ratio - ratio) / (place - self.place)
                moved = np.abs(place - self.place) > 0.05
                slope = np.where(moved, np.clip(secant, 0.2, 1.0), slope)
            tried = np.clip(ratio / slope, -math.log(100.0), math.log(10.0))
            step[active] = tried[active]
            moving = self.wanted if self.count >= self.hold else active
            self.gain = float(np.abs((a - n) * np.clip(ratio, -1.0, 1.0))[moving].sum())
        self.place, self.ratio = place, ratio
        return step, self.gain if near and not annealing else math.inf


def _bounded(information: Array, score: Array, least: Array) -> Array:
    """The step of a quadratic (l,), as shares of variances: none falls by more than `least`."""
    share, free = np.zeros(len(score)), np.ones(len(score), dtype=bool)
    for _ in score:
        block = information[np.ix_(free, free)]
        rest = score[free] - information[np.ix_(free, ~free)] @ share[~free]
        share[free] = np.linalg.solve(block + 1e-9 * np.diag(np.diag(block)), rest)
        excess = np.where(free, np.maximum(share - 2.0, least - share), 0.0)
        furthest = int(np.argmax(excess))
        if excess[furthest] <= 0.0:
            break
        share[furthest] = min(max(share[furthest], least[furthest]), 2.0)
        free[furthest] = False
    return share
