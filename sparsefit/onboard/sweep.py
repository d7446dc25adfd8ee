"""The search on board: averaged flow velocities, and a sweep over cells that may explain them.

A row is a mean over a quarter of the smallest length scale: the position, and the flow's velocity
from the vehicle's and its slope. A sweep evaluates cells of every |k| and heading, at steps of two
over the extent of the rows, a few with each sample; the best are refined by halving the step.
Square cells of any heading have six parameters, a, b, a, b, kx, ky:

    psi = sum over k = (kx, ky), (-ky, kx) of a cos(k.x) + b sin(k.x),   w = (psi_y, -psi_x),
    U0 = |k| sqrt(sum of a^2 + b^2),   L = sqrt(2) pi/|k|
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np

from sparsefit.arrays import Array

M = 6  # parameters of the flow
ROWS, FEWEST_ROWS, BLOCK_MOST, PEAKS, ROUNDS = 192, 24, 64, 5, 8
EXPLAINED, EVIDENCE = 0.6, 15.0
AROUND = math.sqrt(2.0) * math.pi  # |k| L
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
        lower: lower bound of the length scale [m].
        upper: upper bound [m].
        precision: largest relative half-width of the 95 % intervals of an ok answer.
        memory: time constant of the weights of past samples [s]; 0: equal weights.
        any_heading: 0 for cells along the axes.
        candidates: number of candidates evaluated per sample of the search.
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
        doubt: none if the answer is ok.
        samples: number of accepted samples.
        value: U0 [m/s], L [m], L/U0 [s], heading [rad], (4,); NaN during the search.
        error: their standard errors (4,).
        innovation: mean square of the normalised innovations.
        correlation: mean product of successive normalised innovations.
        unexplained: share of the squares of the averaged flow velocities.
        rival: L of the rival [m], if that is the doubt.
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


def waves(flow: Array, place: Array) -> Array:
    """w (2, ...) [m/s] of flows (6, ...) at places (2, ...) [m] from where their phases count."""
    (x, y), (a, b, c, d, k, l) = place, flow  # noqa: E741
    first, second = k * x + l * y, k * y - l * x
    along, across = b * np.cos(first) - a * np.sin(first), d * np.cos(second) - c * np.sin(second)
    return np.stack([l * along + k * across, l * across - k * along])


def slopes(function: Callable[[Array], Array], point: Array) -> Array:
    """The Jacobian (m, n) of a function (m, ...) of points (n, ...), by complex steps."""
    jacobian: Array = function(point[:, None] + 1e-30j * np.eye(len(point))).imag / 1e-30
    return jacobian


def turned(angle: Array) -> Array:
    """Angles [rad] less the nearest multiple of a right one."""
    return angle - math.pi / 2 * np.floor(np.real(angle) / (math.pi / 2) + 0.5)


def features(flow: Array) -> Array:
    """U0, L, L/U0, the heading [rad] and the unevenness (5, ...) of flows (6, ...).

    The unevenness is half the logarithm of the ratio of the two waves' squared amplitudes.
    """
    first, second = flow[0] ** 2 + flow[1] ** 2, flow[2] ** 2 + flow[3] ** 2
    size = np.sqrt(flow[4] ** 2 + flow[5] ** 2)
    speed, length = size * np.sqrt(first + second), AROUND / size
    heading = turned(np.arctan(flow[5] / flow[4]) - math.pi / 4)
    return np.array([speed, length, length / speed, heading, np.log(second / first) / 2])


def rebased(flow: Array, place: Array) -> Array:
    """Flows (6, ...) whose phases count from a place (2,) [m]."""
    (x, y), (a, b, c, d, k, l) = place, flow  # noqa: E741
    first, second = k * x + l * y, k * y - l * x
    turns = [np.cos(first), np.sin(first), np.cos(second), np.sin(second)]
    return np.array([
        turns[0] * a + turns[1] * b, turns[0] * b - turns[1] * a,
        turns[2] * c + turns[3] * d, turns[2] * d - turns[3] * c, k, l,
    ])  # fmt: skip


@dataclass(frozen=True)
class Peak:
    """A candidate of a sweep: the share of the rows' squares that it explains, |k|, k's angle."""

    score: float
    size: float
    angle: float


class Sweep:
    """The rows of a flight, and the sweep over them."""

    def __init__(self, settings: BoardSettings) -> None:
        self.settings, self.doubt = settings, BoardDoubt.FEW_SAMPLES
        self.block: list[Array] = []
        self.block_time = self.rival = self.spacing = self.total = 0.0
        self.memory = np.zeros((ROWS, 4))
        self.count = self.place = 0
        self.sweeping = False
        self.radius = self.turn = self.rounds = 0
        self.peaks: list[Peak] = []
        self.middle = np.zeros(2)

    def forget(self) -> None:
        """Discard rows, block and sweep."""
        self.block, self.count, self.place, self.sweeping = [], 0, 0, False
        self.doubt = BoardDoubt.FEW_SAMPLES

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

    @property
    def rows(self) -> tuple[Array, Array]:
        """Positions from the middle [m] and velocities of the flow [m/s], (2, rows) each."""
        x, y, u, v = self.memory[: self.count].T
        return np.array([x - self.middle[0], y - self.middle[1]]), np.array([u, v])

    def look(self) -> bool:
        """Evaluate the next candidate; False where the sweep is at its end."""
        settings = self.settings
        step = self.spacing if settings.any_heading else self.spacing / 2
        size = AROUND / settings.upper + step * self.radius
        if size > AROUND / settings.lower + step:
            return False
        turns = math.ceil(math.pi / 2 * size / step) if settings.any_heading else 1
        angle = math.pi / 4 + math.pi / 2 * self.turn / turns
        self.keep(Peak(self.fit(size, angle)[0], size, angle))
        self.turn = (self.turn + 1) % turns
        self.radius += self.turn == 0
        return True

    def fit(self, size: float, angle: float) -> tuple[float, Array]:
        """The share of the rows' squares that two waves explain, and the waves (6,).

        Args:
            size: |k| [rad/m] of both, which are at right angles; angle: of the first [rad].

        Returns:
            The share, and (a, b, c, d, k_x, k_y): the cosine and sine amplitudes [m^2/s] of either
            wave, and k [rad/m] of the first.
        """
        place, speed = self.rows
        k, l = size * math.cos(angle), size * math.sin(angle)  # noqa: E741
        share, flow = 0.0, np.array([0.0, 0.0, 0.0, 0.0, k, l])
        for j, (kx, ky) in enumerate(((k, l), (-l, k))):
            phase, along = kx * place[0] + ky * place[1], (ky * speed[0] - kx * speed[1]) / size
            columns = size * np.array([-np.sin(phase), np.cos(phase)])
            normal, right = columns @ columns.T, columns @ along
            normal[range(2), range(2)] *= 1.01  # a little ridge
            flow[2 * j : 2 * j + 2] = np.linalg.solve(normal, right)
            share += flow[2 * j : 2 * j + 2] @ right / self.total
        return share, flow

    def keep(self, candidate: Peak) -> None:
        """Keep a candidate that is the best of its lobe and among the best of all."""
        place = min(range(PEAKS), key=lambda i: self.peaks[i].score)
        for i, peak in enumerate(self.peaks):
            across = turned(np.array(candidate.angle - peak.angle)) * candidate.size
            if (candidate.size - peak.size) ** 2 + across**2 < (2.6 * self.spacing) ** 2:
                place = i
        if candidate.score > self.peaks[place].score:
            self.peaks[place] = candidate

    def refine(self, place: int, step: float) -> None:
        """Move a candidate by a step of k along itself or across, where that is better."""
        size, angle = self.peaks[place].size, self.peaks[place].angle
        best = Peak(self.fit(size, angle)[0], size, angle)
        for way in range(4 if self.settings.any_heading else 2):
            signed = -step if way % 2 else step
            size = best.size + (signed if way < 2 else 0.0)
            angle = best.angle + (0.0 if way < 2 else signed / best.size)
            moved = Peak(self.fit(size, angle)[0], size, angle)
            best = moved if moved.score > best.score else best
        self.peaks[place] = best

    def work(self) -> Peak | None:
        """Do the work of one sample; return the candidate to start filters from, if any."""
        if self.count < FEWEST_ROWS:
            return None
        self.middle = self.memory[: self.count, :2].mean(axis=0)
        place, speed = self.rows
        self.total = float(np.sum(speed**2))
        if not self.sweeping:
            self.spacing = 1.0 / max(self.settings.lower / 2, np.abs(place).max())
            self.sweeping, self.peaks = True, [Peak(0.0, 0.0, 0.0)] * PEAKS
            self.radius = self.turn = self.rounds = 0
        if not self.rounds:
            looks = (self.look() for _ in range(self.settings.candidates))
            self.rounds = int(not all(looks))
            return None
        if self.rounds <= PEAKS * ROUNDS:
            peak, halvings = divmod(self.rounds - 1, ROUNDS)
            if self.peaks[peak].size > 0.0:
                self.refine(peak, self.spacing / 2 ** (halvings + 1))
            self.rounds += 1
            return None
        self.sweeping = False
        best, rival = max(self.peaks, key=lambda peak: peak.score), 0.0
        for each in self.peaks:
            other = each.size == 0.0 or abs(math.log(best.size / each.size)) > 0.03
            if other and each.score > rival:
                rival, self.rival = each.score, AROUND / each.size
        if not best.score > EXPLAINED:
            self.doubt = BoardDoubt.NO_FLOW
        elif self.count * math.log((1.0 - rival) / (1.0 - best.score)) < EVIDENCE:
            self.doubt = BoardDoubt.RIVAL
        else:
            return best
        return None
