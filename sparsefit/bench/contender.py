"""What takes part in the comparison: one function per solver, and the forms of data they share."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from typing import TypeAlias, cast

import numpy as np

from sparsefit.arrays import Array
from sparsefit.bench.problems import KINDS, Kind, Task
from sparsefit.regression.statistics import Statistics, accumulate, row_blocks

Solve: TypeAlias = Callable[[Task, Array, float], Array]
"""(task, penalty fractions (p,), tolerance setting) -> weights (p, k, n) in original units."""

LADDER = (1e-4, 1e-6, 1e-8, 1e-10, 1e-12)
EXACT = (math.nan,)  # no tolerance to set


@dataclass(frozen=True)
class Contender:
    """A solver in its fastest form.

    package: what must be importable. settings: tolerances to scan, loosest first. timed: points
    of the path that are solved where a whole path takes minutes, the rest being extrapolated;
    0 for all of them. peer: a public package whose time ours is compared with. compiles: its
    first run takes many seconds.
    """

    name: str
    solve: Solve
    package: str
    form: str
    kinds: tuple[Kind, ...] = KINDS
    settings: tuple[float, ...] = EXACT
    timed: int = 0
    peer: bool = True
    compiles: bool = False

    @property
    def installed(self) -> bool:
        """Whether its package can be imported."""
        return find_spec(self.package) is not None


def gram_form(task: Task) -> Statistics:
    """Z'Z/m and Z'Y/m by numpy, as a peer's user has them; charged to whoever asks."""
    return accumulate(row_blocks(task.problem.theta, task.problem.target))


@dataclass(frozen=True, eq=False)
class Rows:
    """A design with the same objective: |y - Xv|^2 / (2 len(X)) = |Y - ZV|^2 / 2m.

    X (r, k n) in Fortran order and y (r,), the targets one under the other; rms (k,).
    """

    design: Array
    target: Array
    rms: Array
    targets: int

    def weights(self, coefficients: Array) -> Array:
        """Weights (p, k, n) in original units from coefficients (k n, p), target by target."""
        k = len(self.rms)
        blocks = coefficients.T.reshape(-1, self.targets, k).transpose(0, 2, 1)
        found: Array = blocks / self.rms[:, None]
        return found


def rows_form(task: Task) -> Rows:
    """The rows of a QR of [Z, Y] where there are fewer of them, else Z and Y themselves."""
    theta, target = task.problem.theta, task.problem.target
    (m, k), n = theta.shape, target.shape[1]
    rows = np.hstack([theta, target])
    if m > 1.5 * (k + n):
        rows = cast(Array, np.linalg.qr(rows, mode="r"))
    rms = np.sqrt(np.einsum("ij,ij->j", rows[:, :k], rows[:, :k]) / m)
    scaled = rows[:, :k] * (math.sqrt(len(rows) * n / m) / rms)
    values = rows[:, k:] * math.sqrt(len(rows) * n / m)
    design = scaled if n == 1 else np.kron(np.eye(n), scaled)
    return Rows(np.asfortranarray(design), values.T.ravel(), rms, n)


def interpolated(knots: Array, coefficients: Array, alphas: Array) -> Array:
    """A piecewise linear path at alphas (p,): knots (b,) descending, coefficients (k, b) -> (k, p).

    Below the last knot, where a path broke off, its last coefficients are all there is.
    """
    alphas = np.clip(alphas, knots[-1], knots[0])
    upper = np.clip(np.searchsorted(-knots, -alphas, side="left"), 1, len(knots) - 1)
    width = knots[upper - 1] - knots[upper]
    part = np.where(width > 0, (knots[upper - 1] - alphas) / np.where(width > 0, width, 1.0), 1.0)
    between: Array = coefficients[:, upper - 1] * (1 - part) + coefficients[:, upper] * part
    return between
