"""The search on board: averaged flow velocities, a sweep over cells, and least squares of the best.

A row is the mean over a quarter of the least length scale that is sought: the velocity, and Phi
from the slope of the velocity. A sweep looks at cells of every |k| and heading, at steps of two
over the extent of the rows, a few with each sample.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from sparsefit.arrays import Array
from sparsefit.onboard.square_cells import M, heading, heading_of, length_of, unevenness, waves

ROWS, FEWEST_ROWS, BLOCK_MOST, PEAKS, REFINEMENTS = 192, 24, 64, 5, 14
EVEN, EXPLAINED, EVIDENCE = 0.03, 0.6, 15.0


class BoardDoubt(IntEnum):
    """The kind of doubt of an answer, as `sf_doubt` of the C."""

    NO_DOUBT = 0
    FEW_SAMPLES = 1
    NO_FLOW = 2
    RIVAL = 3
    SETTLING = 4
    IMPRECISE = 5
    INNOVATIONS = 6
    SHAPE = 7
    TURNED = 8
    EDGE = 9


@dataclass(frozen=True)
class BoardSettings:
    """The vehicle and the search, as `sf_config` of the C.

    Args:
        response_time: tau [s], infinite where resistance is quadratic alone.
        drag_coefficient: c [1/m], of the quadratic law.
        thrust_x: a0 [m/s^2], along x.
        thrust_y: a0 [m/s^2], along y.
        thrust_scale: s, of the measured acceleration.
        lower: the least length scale that is sought [m].
        upper: the largest length scale [m].
        precision: half-width of the 95 % intervals over the value, of an answer that is ok.
        memory: the time in which the weight of a sample falls by e [s]; 0: all count alike.
        any_heading: 0 where the cells are taken to lie along the axes.
        candidates: number of candidates that are looked at with a sample of the search.
    """

    response_time: float
    drag_coefficient: float
    thrust_x: float
    thrust_y: float
    thrust_scale: float
    lower: float
    upper: float
    precision: float
    memory: float = 0.0
    any_heading: int = 1
    candidates: int = 8


class Peak:
    """A candidate of a sweep: its share of the rows, |k|, direction of k, and its least squares."""

    def __init__(self, score: float, size: float, angle: float) -> None:
        self.score, self.size, self.angle = score, size, angle
        self.flow, self.trial, self.right = np.full(M, np.nan), np.zeros(M), np.zeros(M)
        self.information = np.zeros((M, M))
        self.residual = self.cost = math.inf
        self.damping = 0.01


class Sweep:
    """The rows of a flight, and the sweep over them."""

    def __init__(self, settings: BoardSettings) -> None:
        self.settings, self.doubt = settings, BoardDoubt.FEW_SAMPLES
        self.block: list[Array] = []
        self.block_time = self.rival = self.spacing = self.total = 0.0
        self.memory = np.zeros((ROWS, 4))
        self.count = self.place = 0
        self.sweeping = False
        self.radius = self.turn = self.refining = self.iteration = 0
        self.peaks: list[Peak] = []
        self.middle = np.zeros(2)

    @property
    def rows(self) -> Array:
        """The rows (m, 4): place [m] and flow velocity [m/s]."""
        return self.memory[: self.count]

    def take(self, z: Array, h: float, push: Array) -> Array | None:
        """Add a sample, h seconds after the last, to the block; the row that it becomes, if any."""
        settings = self.settings
        self.block_time = self.block_time + h if self.block else 0.0
        self.block.append(np.concatenate([[self.block_time], z, push]))
        count, mean = len(self.block), np.mean(self.block, axis=0)
        moved = self.block_time * math.hypot(mean[3], mean[4])
        if count < 4 or (moved < settings.lower / 4 and count < BLOCK_MOST):
            return None
        block = np.array(self.block)
        time = block[:, 0] - mean[0]
        force = time @ block[:, 3:5] / (time @ time) - mean[5:]
        rate = 1.0 / settings.response_time
        reach = rate + math.sqrt(rate**2 + 4 * settings.drag_coefficient * math.hypot(*force))
        row = np.concatenate([mean[1:3], mean[3:5] + (2 * force / reach if reach > 0 else 0.0)])
        self.memory[self.place] = row
        self.block, self.place = [], (self.place + 1) % ROWS
        self.count = min(self.count + 1, ROWS)
        return row

    def look(self, rows: Array) -> bool:
        """Look at the next candidate; False where the sweep is at its end."""
        settings, around = self.settings, math.sqrt(2.0) * math.pi
        step = self.spacing if settings.any_heading else self.spacing / 2
        size = around / settings.upper + step * self.radius
        if size > around / settings.lower + step:
            return False
        turns, angle = 1, math.pi / 4
        if settings.any_heading:
            turns = math.ceil(math.pi / 2 * size / step)
            angle = math.pi / 2 * self.turn / turns
        self.hold(self.explained(rows, size, angle), size, angle)
        self.turn += 1
        if self.turn >= turns:
            self.turn, self.radius = 0, self.radius + 1
        return True

    def explained(self, rows: Array, size: float, angle: float) -> float:
        """Share of the rows' squares that two waves at a right angle explain, equally strong."""
        share, weight, amplitude = 0.0, [], []
        for k, l in (  # noqa: E741
            (size * math.cos(angle), size * math.sin(angle)),
            (-size * math.sin(angle), size * math.cos(angle)),
        ):
            phase = rows[:, :2] @ (k, l)
            s, c, across = np.sin(phase), np.cos(phase), rows[:, 2:] @ (l / size, -k / size)
            ss, sc, cc = 1.01 * (s @ s), s @ c, 1.01 * (c @ c)  # a little ridge
            determinant = ss * cc - sc * sc
            of_sine = (cc * (s @ across) - sc * (c @ across)) / determinant
            of_cosine = (ss * (c @ across) - sc * (s @ across)) / determinant
            share += of_sine * (s @ across) + of_cosine * (c @ across)
            weight.append(2 * determinant / (ss + cc))
            amplitude.append(math.hypot(of_sine, of_cosine))
        apart = weight[0] * weight[1] / (weight[0] + weight[1])
        return float(share - apart * (amplitude[0] - amplitude[1]) ** 2) / self.total

    def hold(self, score: float, size: float, angle: float) -> None:
        """Hold a candidate that is the best of its lobe, and among the best of all."""
        place = len(self.peaks)
        for i, peak in enumerate(self.peaks):
            turn = heading_of(angle - peak.angle)
            if (size - peak.size) ** 2 + (turn * size) ** 2 < (2.6 * self.spacing) ** 2:
                place = i
                break
        if place == PEAKS:
            place = min(range(PEAKS), key=lambda i: self.peaks[i].score)
        if place == len(self.peaks):
            self.peaks.append(Peak(score, size, angle))
        elif score > self.peaks[place].score:
            self.peaks[place] = Peak(score, size, angle)

    def refine(self, rows: Array, peak: Peak, *, first: bool) -> bool:
        """A step of Levenberg and Marquardt for a peak, on all rows; False where there is none."""
        w, _, by_flow = waves(peak.trial[:, None], *(rows[:, :2] - self.middle).T)
        error, columns = (rows[:, 2:].T - w).ravel(), np.moveaxis(by_flow, 1, 2).reshape(-1, M)
        normal, right = columns.T @ columns, columns.T @ error
        residual = cost = float(error @ error)
        weight = self.total / (20 * len(rows)) / EVEN**2
        ties = (
            () if first else (unevenness,) if self.settings.any_heading else (unevenness, heading)
        )
        for tie in ties:
            value, gradient = tie(peak.trial)
            cost += weight * value**2
            right = right - weight * value * gradient
            normal = normal + weight * np.outer(gradient, gradient)
        if first or cost < peak.cost:
            peak.flow, peak.information, peak.right = peak.trial, normal, right
            peak.residual, peak.cost = residual, math.inf if first else cost
            peak.damping = 0.01 if first else peak.damping / 4
        else:
            peak.damping *= 6
        damped = peak.information + np.diag(peak.damping * np.diag(peak.information) + 1e-9)
        try:
            np.linalg.cholesky(damped)
        except np.linalg.LinAlgError:
            return False
        peak.trial = peak.flow + np.linalg.solve(damped, peak.right)
        return True

    def work(self) -> BoardDoubt | Peak:
        """Do the work of one sample: a doubt that stays, or the peak that is to be followed."""
        if self.count < FEWEST_ROWS:
            self.doubt = BoardDoubt.FEW_SAMPLES
            return self.doubt
        rows = self.rows
        if not self.sweeping:
            extent = max(self.settings.lower, *np.ptp(rows[:, :2], axis=0).tolist())
            self.spacing, self.sweeping, self.peaks = 2.0 / extent, True, []
            self.radius = self.turn = self.refining = self.iteration = 0
        self.total = float(np.sum(rows[:, 2:] ** 2))
        if not self.refining:
            for _ in range(self.settings.candidates):
                if not self.look(rows):
                    self.refining, self.iteration = 1, 0
                    break
            return self.doubt
        peak = self.peaks[self.refining - 1]
        if not self.iteration:
            direction = np.array([math.cos(peak.angle), math.sin(peak.angle)])
            peak.trial = np.concatenate([np.zeros(4), peak.size * direction])
            if self.refining == 1:
                self.middle = rows[:, :2].mean(axis=0)
        if not self.refine(rows, peak, first=not self.iteration):
            peak.residual, self.iteration = math.inf, REFINEMENTS
        self.iteration += 1
        if self.iteration >= REFINEMENTS:
            self.iteration, self.refining = 0, self.refining + 1
            if self.refining > len(self.peaks):
                self.sweeping = False
                return self.decide()
        return self.doubt

    def decide(self) -> BoardDoubt | Peak:
        """The best peak, where it explains the rows and has no rival; else the doubt."""
        best = min(self.peaks, key=lambda peak: peak.residual)
        rival = math.inf
        for peak in self.peaks:
            length = length_of(peak.flow)
            ratio = length / length_of(best.flow)
            if not 0.97 <= ratio <= 1.03 and peak.residual < rival:
                rival, self.rival = peak.residual, length
        if not best.residual < (1 - EXPLAINED) * self.total:
            self.doubt = BoardDoubt.NO_FLOW
            return self.doubt
        if self.count * math.log(rival / best.residual) < EVIDENCE:
            self.doubt = BoardDoubt.RIVAL
            return self.doubt
        return best
