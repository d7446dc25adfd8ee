"""One problem in the two forms that public solvers take it in: Z'Z or the rows of a QR.

In the notation of `objective`, with omega_j the weight of column j's block, u_j = omega_j v_j and
targets divided by alpha_max, every penalty of norms alone is one with weights of one:

    minimise over u:   1/2 u'G u - c'u + f sum_g |u_g|,   G = D^-1 Z'Z D^-1 / m,  D = diag(omega),

f being the penalty fraction. Targets that share the norms of their groups are one long target with
a block-diagonal design. What is formed here, G or the QR, is charged to the solver that asks.
"""

import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from sparsefit.arrays import Array, IntArray
from sparsefit.errors import described, one_line
from sparsefit.regression.backend import Solution
from sparsefit.regression.objective import Penalty, alpha_max
from sparsefit.regression.problem import RegressionProblem


@dataclass(frozen=True, eq=False)
class Part:
    """Targets of a problem that are solved together, in units of alpha_max = `unit`.

    omega (k,): the weight of each column's block.
    """

    problem: RegressionProblem
    penalty: Penalty
    targets: slice
    unit: float
    omega: Array

    @property
    def samples(self) -> int:
        """The number m of samples."""
        return self.problem.samples

    @property
    def gram(self) -> Array:
        """G (k, k), Fortran- and C-contiguous alike; a copy."""
        gram: Array = self.problem.statistics.gram / np.multiply.outer(self.omega, self.omega)
        return gram

    @property
    def cross(self) -> Array:
        """c (k,), of the first of the targets."""
        cross: Array = self.problem.statistics.cross[:, self.targets][:, 0]
        return cross / (self.omega * self.unit)

    @property
    def target(self) -> Array:
        """The first of the targets (m,), of which Z'y/m is D c."""
        target: Array = self.problem.target[:, self.targets][:, 0] / self.unit
        return target

    def rows(self) -> "Rows":
        """The rows of a QR of theta and the target where they are fewer, else both as they are."""
        problem = self.problem
        theta, target = problem.theta, problem.target
        if len(theta) > 1.5 * (problem.columns + problem.targets):
            theta, target = problem.compressed
        target, count = target[:, self.targets], target[:, self.targets].shape[1]
        root = math.sqrt(len(theta) * count / problem.samples)
        scaled = theta * (root / (problem.statistics.rms * self.omega))
        design = scaled if count == 1 else np.kron(np.eye(count), scaled)
        values = (target * (root / self.unit)).T.ravel()
        groups = np.tile(self.penalty.groups, count)
        return Rows(np.asfortranarray(design), values, groups.astype(np.intp))


@dataclass(frozen=True, eq=False)
class Rows:
    """|y - X u|^2 / (2 len(y)): design X (r, k b) in Fortran order, target y (r,), b targets.

    groups (k b,): the block of each coefficient, target by target.
    """

    design: Array
    target: Array
    groups: IntArray

    @property
    def blocks(self) -> list[IntArray]:
        """The coefficients (c,) of each block."""
        return [np.flatnonzero(self.groups == g) for g in range(int(self.groups.max()) + 1)]


Along: TypeAlias = Callable[[Part, Array, float | None], Array]
"""(part, descending penalty fractions (p,), stopping tolerance in the solver's own measure, None:
the one that its file says) -> coefficients u (p, k b), target by target."""


def solved(
    name: str,
    problem: RegressionProblem,
    penalty: Penalty,
    alpha_fractions: Sequence[float],
    along: Along,
    tolerance: float | None = None,
) -> tuple[Solution, ...]:
    """Solutions of a public solver, whatever it raises or warns of: told, never hidden.

    A warning makes the status ``inaccurate`` and its first words the solver's status.
    """
    statistics, fractions = problem.statistics, np.array(alpha_fractions)
    unit, shape = alpha_max(statistics.cross, penalty), statistics.cross.shape
    if not statistics.cross.any():
        zero = Solution(np.zeros(shape), solver_status="target is zero", iterations=0)
        return (zero,) * len(fractions)
    omega = penalty.weights[penalty.groups]
    apart = [slice(t, t + 1) for t in range(problem.targets)]
    parts = [
        Part(problem, penalty, targets, unit, omega)
        for targets in ([slice(0, problem.targets)] if penalty.joint else apart)
    ]
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        try:
            values = [
                along(part, fractions, tolerance).reshape(len(fractions), -1, len(omega))
                for part in parts
            ]
        except Exception as error:  # a public solver may raise anything
            words = f"{name}: {described(error)}"
            return (Solution(None, "error", words, type(error).__name__),) * len(fractions)
    weights = np.concatenate(values, axis=1).transpose(0, 2, 1)
    weights = weights * (unit / (omega * statistics.rms))[:, None]
    doubts = [f"{w.category.__name__}: {w.message}" for w in told if _matters(w)]
    if not doubts:
        return tuple(Solution(each, solver_status="returned") for each in weights)
    words = one_line(doubts[0], 120)
    return tuple(Solution(each, "inaccurate", f"{name}: {words}", words) for each in weights)


def _matters(told: warnings.WarningMessage) -> bool:
    """Whether a warning is about the solution, and not about a library's future."""
    future = DeprecationWarning | FutureWarning | PendingDeprecationWarning
    return not issubclass(told.category, future) and "deprecated" not in str(told.message)
