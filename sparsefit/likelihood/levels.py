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

INSTRUMENTS = (1, 2)  # the places of the levels of position and velocity; 0 is process noise


class LevelSteps:
    """The steps of the logarithms of the variances of one log, pass after pass."""

    def __init__(self, wanted: list[int], floors: Array, negligible: float, hold: int) -> None:
        """Begin far from the optimum.

        Args:
            wanted: the places of the levels that are estimated.
            floors: standard deviations (l,) that no level goes below.
            negligible: the degrees of freedom that a level may take and count as zero.
            hold: the passes before the levels of the instruments move.
        """
        self.wanted, self.floors, self.negligible, self.hold = wanted, floors, negligible, hold
        self.count, self.gain = 0, math.inf
        self.before: tuple[Array, Array] | None = None

    def change(
        self, levels: list[float], squares: Array, information: Array
    ) -> tuple[Array, float]:
        """Return the step (l,) of the logarithms, and what it may gain.

        Args:
            levels: standard deviations (l,).
            squares: a and n (l, 2).
            information: of the logarithms (l, l), or of no rows.
        """
        self.count += 1
        (a, n), step = squares.T, np.zeros(len(levels))
        place = 2.0 * np.log(np.maximum(levels, 1e-150))
        lowest = np.minimum(2.0 * np.log(self.floors) - place, 0.0)
        few = np.where(np.isin(np.arange(len(a)), INSTRUMENTS), 5.0, 1e-300)
        ratio = np.log((a + few) / (n + few))  # few readings' worth says little of their noise
        active = [
            j
            for j in self.wanted
            if max(a[j], n[j]) > self.negligible and (lowest[j] < -1e-3 or ratio[j] > 0.0)
        ]
        annealing = 0 not in self.wanted and lowest[0] < -1e-3
        if annealing:
            step[0] = -math.log(100.0) if n[0] > self.negligible else lowest[0]
        moving = active
        if self.count <= self.hold or annealing:
            active = [j for j in active if j not in INSTRUMENTS]
        share, gain = np.zeros(len(levels)), math.inf
        if self.gain < 10.0 and len(information) and active:
            least = np.where(np.isin(active, INSTRUMENTS), -0.7, -0.99)
            block = information[np.ix_(active, active)]
            share[active] = _bounded(block, (a - n)[active], least)
            gain = float((a - n) @ share)
        near = not active or 0.0 <= gain < 10.0
        if near:
            step[active] = np.log1p(share[active])
            self.gain = gain if active else 0.0
        else:
            slope = np.where(few > 1.0, 1.0, 0.4)
            if self.before is not None:
                away = place - self.before[0]
                with np.errstate(divide="ignore", invalid="ignore"):
                    secant = np.clip((self.before[1] - ratio) / away, 0.2, 1.0)
                slope = np.where(np.abs(away) > 0.05, secant, slope)
            step[active] = np.clip(ratio / slope, -math.log(100.0), math.log(10.0))[active]
            moving = moving if self.count >= self.hold else active
            self.gain = float(np.abs((a - n) * np.clip(ratio, -1.0, 1.0))[moving].sum())
        self.before = place, ratio
        return np.maximum(step, lowest), self.gain if near and not annealing else math.inf


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
