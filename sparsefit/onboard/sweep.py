"""The search on board: averaged flow velocities, a sweep over cells, and least squares of the best.

A row is the mean over a quarter of the least length scale that is sought: the velocity, and Phi
from the slope of the velocity. A sweep looks at cells of every |k| and heading, at steps of two
over the extent of the rows, a few with each sample. Square cells of any heading are six parameters,
a, b, a, b, kx, ky:

    psi = sum over k = (kx, ky), (-ky, kx) of a cos(k.x) + b sin(k.x),   w = (psi_y, -psi_x),
    U0 = |k| sqrt(sum of a^2 + b^2),   L = sqrt(2) pi/|k|
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np

from sparsefit.arrays import Array

M = 6  # parameters of the flow
ROWS, FEWEST_ROWS, BLOCK_MOST, PEAKS, REFINEMENTS = 192, 24, 64, 5, 14
EVEN, EXPLAINED, EVIDENCE = 0.03, 0.6, 15.0
SPEED, LENGTH, TIME, HEADING, UNEVEN = range(5)  # of `features`


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


@dataclass(frozen=True, eq=False)
class BoardAnswer:
    """The answer of a board, as `sf_answer` of the C.

    Args:
        doubt: none where the answer is ok.
        samples: number of samples taken so far.
        value: U0 [m/s], L [m], L/U0 [s], heading [rad], (4,); NaN where nothing is followed.
        error: their standard errors (4,).
        innovation: mean square of the normalised innovations.
        correlation: their mean product from one sample to the next.
        unexplained: share of the averaged flow velocity's squares that the flow leaves.
        rival: L of the rival [m], where that is the doubt.
        flow: a, b, a, b, kx, ky, and the place that phases count from [m], (8,).
    """

    doubt: BoardDoubt
    samples: int
    value: Array
    error: Array
    innovation: float = 0.0
    correlation: float = 0.0
    unexplained: float = 0.0
    rival: float = 0.0
    flow: Array = field(default_factory=lambda: np.zeros(8))

    @property
    def status(self) -> str:
        """``ok``, ``misfit`` or ``unidentifiable``."""
        if self.doubt in (BoardDoubt.INNOVATIONS, BoardDoubt.SHAPE, BoardDoubt.TURNED):
            return "misfit"
        return "unidentifiable" if self.doubt else "ok"


def waves(flow: Array, x: Array, y: Array) -> tuple[Array, Array, Array]:
    """Return w (2, ...), its gradient by the place (2, 2, ...) and by the flow (2, 6, ...).

    flow: a, b, a, b [m^2/s], kx, ky [rad/m], (6, ...); x, y: from where phases count [m], (...).
    """
    w, place = np.zeros((2, *np.shape(x))), np.zeros((2, 2, *np.shape(x)))
    gradient = np.zeros((2, M, *np.shape(x)))
    for j, (k, l) in enumerate(((flow[4], flow[5]), (-flow[5], flow[4]))):  # noqa: E741
        a, b, phase = flow[2 * j], flow[2 * j + 1], k * x + l * y
        c, s = np.cos(phase), np.sin(phase)
        slope, height, normal = b * c - a * s, a * c + b * s, np.stack([l + 0 * x, -k + 0 * x])
        w += slope * normal
        place -= height * normal[:, None] * np.stack([k + 0 * x, l + 0 * x])
        gradient[:, 2 * j], gradient[:, 2 * j + 1] = -s * normal, c * normal
        by_k = np.stack([-height * l * x, height * k * x - slope])
        by_l = np.stack([slope - height * l * y, height * k * y])
        gradient[:, 4] += by_l if j else by_k
        gradient[:, 5] += -by_k if j else by_l
    return w, place, gradient


def turned(angle: float) -> float:
    """An angle [rad] less the nearest multiple of a right one."""
    return angle - math.pi / 2 * math.floor(angle / (math.pi / 2) + 0.5)


def features(flow: Array) -> tuple[Array, Array]:
    """U0, L, L/U0, the heading [rad] and the unevenness of a flow (6,), and gradients (5, 6).

    The unevenness is half the logarithm of the ratio of the two waves' squared amplitudes.
    """
    first, second = flow[0] ** 2 + flow[1] ** 2, flow[2] ** 2 + flow[3] ** 2
    k = flow[4] ** 2 + flow[5] ** 2
    speed, length = math.sqrt(k * (first + second)), math.sqrt(2.0 / k) * math.pi
    heading = turned(math.atan2(flow[5], flow[4]) - math.pi / 4)
    gradients = np.zeros((5, M))
    gradients[SPEED] = np.concatenate([k * flow[:4], speed**2 / k * flow[4:]]) / speed
    gradients[LENGTH, 4:] = -length * flow[4:] / k
    gradients[TIME] = length / speed * (gradients[LENGTH] / length - gradients[SPEED] / speed)
    gradients[HEADING, 4:] = -flow[5] / k, flow[4] / k
    gradients[UNEVEN, :4] = *(-flow[:2] / first), *(flow[2:4] / second)
    values = [speed, length, length / speed, heading, math.log(second / first) / 2]
    return np.array(values), gradients


def rebased(flow: Array, place: Array) -> tuple[Array, Array]:
    """A flow (6,) whose phases count from a place (2,) [m], and the Jacobian (6, 6) of that."""
    moved, jacobian = flow.copy(), np.eye(M)
    for j, by in enumerate((place, np.array([place[1], -place[0]]))):
        turn = float(flow[4:] @ by)
        c, s, two = math.cos(turn), math.sin(turn), slice(2 * j, 2 * j + 2)
        jacobian[two, two] = [[c, s], [-s, c]]
        moved[two] = jacobian[two, two] @ flow[two]
        jacobian[two, 4:] = np.outer([moved[2 * j + 1], -moved[2 * j]], by)
    return moved, jacobian


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
        self.turn = (self.turn + 1) % turns
        self.radius += self.turn == 0
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
        lobe = (2.6 * self.spacing) ** 2
        near = (
            place
            for place, peak in enumerate(self.peaks)
            if (size - peak.size) ** 2 + (turned(angle - peak.angle) * size) ** 2 < lobe
        )
        place = next(near, len(self.peaks))
        if place == PEAKS:
            place = min(range(PEAKS), key=lambda i: self.peaks[i].score)
        if place == len(self.peaks) or score > self.peaks[place].score:
            self.peaks[place : place + 1] = [Peak(score, size, angle)]

    def refine(self, rows: Array, peak: Peak, *, first: bool) -> bool:
        """A step of Levenberg and Marquardt for a peak, on all rows; False where there is none."""
        w, _, by_flow = waves(peak.trial[:, None], *(rows[:, :2] - self.middle).T)
        error, columns = (rows[:, 2:].T - w).ravel(), np.moveaxis(by_flow, 1, 2).reshape(-1, M)
        normal, right = columns.T @ columns, columns.T @ error
        residual, cost = float(error @ error), math.inf
        if not first:  # the waves are as strong as each other, and lie along the axes
            values, gradients = features(peak.trial)
            ties = [UNEVEN] if self.settings.any_heading else [UNEVEN, HEADING]
            weight = self.total / (20 * len(rows)) / EVEN**2
            cost = residual + weight * float(np.sum(values[ties] ** 2))
            right = right - weight * gradients[ties].T @ values[ties]
            normal = normal + weight * gradients[ties].T @ gradients[ties]
        if first or cost < peak.cost:
            peak.flow, peak.information, peak.right = peak.trial, normal, right
            peak.residual, peak.cost = residual, cost
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

    def work(self) -> Peak | None:
        """Do the work of one sample; return the peak that is to be followed, if there is one."""
        if self.count < FEWEST_ROWS:
            return None
        rows = self.memory[: self.count]
        if not self.sweeping:
            extent = max(self.settings.lower, *np.ptp(rows[:, :2], axis=0).tolist())
            self.spacing, self.sweeping, self.peaks = 2.0 / extent, True, []
            self.radius = self.turn = self.refining = self.iteration = 0
        self.total = float(np.sum(rows[:, 2:] ** 2))
        if not self.refining:
            looks = (self.look(rows) for _ in range(self.settings.candidates))
            self.refining = int(not all(looks))
            self.middle = rows[:, :2].mean(axis=0)
            return None
        peak = self.peaks[self.refining - 1]
        if not self.iteration:
            direction = np.array([math.cos(peak.angle), math.sin(peak.angle)])
            peak.trial = np.concatenate([np.zeros(4), peak.size * direction])
        if not self.refine(rows, peak, first=not self.iteration):
            peak.residual, self.iteration = math.inf, REFINEMENTS
        self.iteration += 1
        if self.iteration >= REFINEMENTS:
            self.iteration, self.refining = 0, self.refining + 1
        if self.refining <= len(self.peaks):
            return None
        self.sweeping = False
        best = min(self.peaks, key=lambda peak: peak.residual)
        rival, size = math.inf, math.hypot(*best.flow[4:])
        for peak in self.peaks:
            own = math.hypot(*peak.flow[4:])
            if not 0.97 <= size / own <= 1.03 and peak.residual < rival:
                rival, self.rival = peak.residual, math.sqrt(2.0) * math.pi / own
        if not best.residual < (1 - EXPLAINED) * self.total:
            self.doubt = BoardDoubt.NO_FLOW
        elif self.count * math.log(rival / best.residual) < EVIDENCE:
            self.doubt = BoardDoubt.RIVAL
        else:
            return best
        return None
