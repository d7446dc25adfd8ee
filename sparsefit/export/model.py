"""The recurrence of the exported C in Python, float64: rows, their sums by blocks, the answers.

The sums of one length scale are those of h_i(kx) h_j(ky), with h = (1, cos, sin, cos 2, sin 2), and
of h_i h_j Phi, each with its Taylor coefficients in k: they hold all of theta'theta and theta'Phi.
What the C adds up row by row is added up here block by block; otherwise it is the same arithmetic,
and what tells whether the C is right.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from sparsefit.arrays import Array, IntArray
from sparsefit.cached import cached_property
from sparsefit.export.layout import TERMS
from sparsefit.export.model_rows import Row, microseconds, rows_of
from sparsefit.export.plan import Plan
from sparsefit.flight import Flight
from sparsefit.library.cells import CANDIDATES

SIDE, CROSS_SIDE = 5, 3
CROSS = SIDE * SIDE
PARTNER = [0, 2, 1, 4, 3]
RATE = np.array([0.0, -1.0, 1.0, -2.0, 2.0])  # d/d(kx) of a harmonic, times its partner
ALONG_X = np.array([2, 0, 1, 0, 2, 2, 1, 1])  # the harmonics of the 8 candidates
ALONG_Y = np.array([0, 2, 0, 1, 2, 1, 2, 1])
MINIMUM_ROWS, BLOCK = 100, 16  # the tunables of the C, as they are generated


@dataclass(frozen=True)
class Tuning:
    """The tunables of the C: rows before an answer, rows of a block, what is kept of earlier sums.

    longest_step: of a sample, in nominal steps; beyond it is a gap. step_tolerance: of savgol, the
    share by which a step may differ. sweeps: of the LASSO, an answer.
    """

    minimum_rows: int = MINIMUM_ROWS
    block: int = BLOCK
    forgetting: float = 1.0
    longest_step: float = 4.0
    step_tolerance: float = 1e-3
    sweeps: int = 20


GENERATED = Tuning()
"""The tunables as they stand in the C that is exported."""


@dataclass(frozen=True, eq=False)
class Sums:
    """What the C holds of the rows so far.

    scales: (g, orders, 43); squares: of Phi_x and Phi_y (2,) [m^2/s^2]; gram (k, k) and cross
    (k, 2) of all columns, where they are kept; lowest and highest (2,) [m] of the positions.
    """

    rows: int
    scales: Array
    squares: Array
    gram: Array
    cross: Array
    lowest: Array
    highest: Array

    @property
    def weight(self) -> float:
        """The rows that count: fewer than there were where some are forgotten."""
        return float(self.scales[0, 0, 0])

    @property
    def square(self) -> float:
        """|Phi|^2 [m^2/s^2]."""
        return float(self.squares.sum())

    @property
    def extent(self) -> float:
        """The larger side of the bounding box [m]."""
        return float((self.highest - self.lowest).max())

    @cached_property
    def left_by_wind(self) -> float:
        """What a uniform wind leaves of |Phi|^2."""
        wind = self.scales[0, 0, [CROSS, CROSS + CROSS_SIDE**2]]
        return self.square - float(wind @ wind) / self.weight

    def joined(self, other: Sums) -> Sums:
        """These sums and those of rows after them."""
        return Sums(
            self.rows + other.rows,
            self.scales + other.scales,
            self.squares + other.squares,
            self.gram + other.gram,
            self.cross + other.cross,
            np.minimum(self.lowest, other.lowest),
            np.maximum(self.highest, other.highest),
        )

    def faded(self, kept: float) -> Sums:
        """These sums, less what is forgotten."""
        return replace(
            self,
            scales=kept * self.scales,
            squares=kept * self.squares,
            gram=kept * self.gram,
            cross=kept * self.cross,
        )


def nothing(plan: Plan) -> Sums:
    """The sums of no rows."""
    k, far = plan.columns, np.full(2, np.inf)
    scales = np.zeros((len(plan.scales), plan.orders, TERMS))
    return Sums(0, scales, np.zeros(2), np.zeros((k, k)), np.zeros((k, 2)), far, -far)


def harmonics(k: Array, x: Array, orders: int) -> Array:
    """Taylor coefficients in k (orders, g, m, 5) of the harmonics of k x, at k (g,), x (m,)."""
    phase = np.outer(k, x)
    cos, sin = np.cos(phase), np.sin(phase)
    h = [np.stack([np.ones_like(cos), cos, sin, 1.0 - 2.0 * sin * sin, 2.0 * sin * cos], axis=-1)]
    for order in range(1, orders):
        h.append((x / order)[:, None] * RATE * h[-1][..., PARTNER])
    return np.stack(h)


def sums_of(plan: Plan, place: Array, phi: Array) -> Sums:
    """The sums of rows at places (m, 2) [m] from the origin, with Phi (m, 2) [m/s]."""
    if not len(place):
        return nothing(plan)
    hx, hy = (harmonics(plan.wavenumbers, along, plan.orders) for along in place.T)
    scales = np.zeros((len(plan.scales), plan.orders, TERMS))
    for d in range(plan.orders):
        for e in range(d + 1):
            x, y = hx[e].transpose(0, 2, 1), hy[d - e]
            scales[:, d, :CROSS] += (x @ y).reshape(len(x), -1)
            for c in range(2):
                part = slice(CROSS + c * CROSS_SIDE**2, CROSS + (c + 1) * CROSS_SIDE**2)
                crossed = (x[:, :CROSS_SIDE] * phi[:, c]) @ y[..., :CROSS_SIDE]
                scales[:, d, part] += crossed.reshape(len(x), -1)
    theta = np.zeros((len(place), 0))
    if plan.columns:
        pairs = hx[0][..., ALONG_X] * hy[0][..., ALONG_Y]
        theta = pairs.transpose(1, 0, 2).reshape(len(place), len(CANDIDATES) * len(scales))
    low, high = place.min(axis=0), place.max(axis=0)
    squares = np.sum(phi * phi, axis=0)
    return Sums(len(place), scales, squares, theta.T @ theta, theta.T @ phi, low, high)


def summed(
    plan: Plan, rows: Iterable[Row], at: IntArray, tuning: Tuning = GENERATED
) -> Iterator[tuple[int, Sums]]:
    """Samples at which an answer is asked for, in order, each with the sums of all rows to there.

    rows: with the sample that completed each; at: samples, ascending.
    """
    rest, whole = nothing(plan), list(rows)
    last = np.array([row.sample for row in whole], dtype=np.intp)
    place = np.array([row.place for row in whole]).reshape(-1, 2)
    phi = np.array([row.phi for row in whole]).reshape(-1, 2)
    folded = 0
    for sample in at.tolist():
        count = int(np.searchsorted(last, sample, side="right"))
        while count - folded >= tuning.block:
            block = slice(folded, folded + tuning.block)
            rest = rest.faded(tuning.forgetting).joined(sums_of(plan, place[block], phi[block]))
            folded = block.stop
        yield sample, rest.joined(sums_of(plan, place[folded:count], phi[folded:count]))


def sums_at(
    plan: Plan,
    flight: Flight,
    at: IntArray,
    tuning: Tuning = GENERATED,
    origin: tuple[float, float] = (0.0, 0.0),
) -> Iterator[tuple[int, Sums]]:
    """The sums after each of some samples of a flight, as the C has them."""
    rows = rows_of(plan, flight, breaks_of(plan, flight, tuning), origin)
    return summed(plan, rows, at, tuning)


def breaks_of(plan: Plan, flight: Flight, tuning: Tuning) -> IntArray:
    """The samples before which the window is emptied: after a gap, or an uneven step of savgol."""
    time = microseconds(flight.time)
    steps, nominal = np.diff(time), nominal_step(time)
    if plan.derivative.method == "savgol":
        broken = np.abs(steps - nominal) > tuning.step_tolerance * nominal
    else:
        broken = steps > tuning.longest_step * nominal
    return np.flatnonzero(broken) + 1


def nominal_step(time_us: IntArray) -> int:
    """The nominal time from sample to sample [us]: the median."""
    return max(1, math.floor(float(np.median(np.diff(time_us))) + 0.5))
