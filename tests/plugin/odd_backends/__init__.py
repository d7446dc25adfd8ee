"""Back-ends of another package: `Damped` is as one should be, every other has one fault."""

from dataclasses import dataclass
from importlib import import_module
from typing import ClassVar

import numpy as np

from sparsefit.backends import Solution
from sparsefit.regression.penalties import lasso_penalty


@dataclass(frozen=True)
class Damped:
    """argmin_W |Y - theta W|^2 + amount m sum_j rms_j^2 |W_j|^2: a ridge, free of units."""

    name: ClassVar[str] = "damped"
    certificate_kind: ClassVar[str] = "fixed_point"
    amount: float = 1e-6

    def solve(self, problem):
        """Weights (k, n), from the normal equations in columns of unit rms."""
        gram = problem.design.gram + self.amount * np.eye(problem.columns)
        return Solution(np.linalg.solve(gram, problem.cross) / problem.design.rms[:, None])

    def next_weights(self, problem, weights):
        return Damped.solve(self, problem).weights


@dataclass(frozen=True)
class HalfLasso:
    """Says that it solves the LASSO, and that all is well; its weights are half of a ridge's."""

    name: ClassVar[str] = "half-lasso"
    certificate_kind: ClassVar[str] = "duality_gap"
    alpha_fraction: float = 0.1

    def penalty(self, problem):
        return lasso_penalty(problem.columns)

    def solve(self, problem):
        return Solution(0.5 * Damped().solve(problem).weights, status="ok")


@dataclass(frozen=True)
class Scribbler(Damped):
    """Writes into the problem that it was lent."""

    name: ClassVar[str] = "scribbler"

    def solve(self, problem):
        solution = Damped.solve(self, problem)
        problem.theta.base[0] += 1.0
        return solution


@dataclass(frozen=True)
class Chatterbox(Damped):
    """Prints."""

    name: ClassVar[str] = "chatterbox"

    def solve(self, problem):
        print("iteration 1 of 1")
        return Damped.solve(self, problem)


@dataclass(frozen=True)
class Misshapen(Damped):
    """Returns the weights transposed."""

    name: ClassVar[str] = "misshapen"

    def solve(self, problem):
        return Solution(Damped.solve(self, problem).weights.T)


@dataclass(frozen=True)
class Needy(Damped):
    """Imports, when it solves, a package that is not there."""

    name: ClassVar[str] = "needy"

    def solve(self, problem):
        return import_module("no_such_solver").solve(problem)
