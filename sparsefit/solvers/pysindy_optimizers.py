"""PySINDy's optimizers beside ours: STLSQ, SR3, SSR and FROLS, as PySINDy runs them (extra peers).

Each chooses a support of its own and fits it by least squares. None minimises what our convex
back-ends do, so each is held to its own rule, worked out here again: a fixed point is a support
that one more step of STLSQ or SR3 keeps, or that the greedy rule of SSR or FROLS finds for as many
terms. Settings act on the columns as they are, in PySINDy's conventions.

Sources: Brunton, Proctor and Kutz (PNAS 2016), STLSQ; Zheng et al. (IEEE Access 2019), SR3;
Boninsegna, Nueske and Clementi (J. Chem. Phys. 2018), SSR; Billings (2013), FROLS.
"""

import warnings
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from typing import Any, ClassVar, Literal, get_args

import numpy as np

from sparsefit.arrays import Array, BoolArray
from sparsefit.errors import (
    MissingExtra,
    described,
    integer_setting,
    number_setting,
    one_line,
    one_of,
)
from sparsefit.regression.backend import Solution
from sparsefit.regression.certificate import CertificateKind
from sparsefit.regression.problem import RegressionProblem

Optimizer = Literal["STLSQ", "SR3", "SSR", "FROLS"]


@dataclass(frozen=True)
class PySindy:
    """An optimizer of PySINDy.

    threshold: of the weights, STLSQ and SR3; ridge: PySINDy's alpha, all but SR3; relaxation: nu
    of SR3. max_iterations: for SSR the most columns that leave, for FROLS the most that enter.
    Raises InputError on settings that are out of range, and MissingExtra without PySINDy.
    """

    name: ClassVar[str] = "pysindy"
    certificate_kind: ClassVar[CertificateKind] = "fixed_point"
    optimizer: Optimizer = "STLSQ"
    threshold: float = 0.1
    ridge: float = 0.05
    max_iterations: int = 20
    relaxation: float = 1.0

    def __post_init__(self) -> None:
        one_of("optimizer of pysindy", self.optimizer, get_args(Optimizer))
        number_setting(self.name, "threshold", self.threshold, low=0.0)
        number_setting(self.name, "ridge", self.ridge, low=0.0)
        number_setting(self.name, "relaxation", self.relaxation, low=0.0, open_low=True)
        integer_setting(self.name, "max_iterations", self.max_iterations, least=1)
        if find_spec("pysindy") is None:
            raise MissingExtra("pysindy is not installed: pip install 'sparsefit[peers]'")

    def solve(self, problem: RegressionProblem) -> Solution:
        """The optimizer's weights; what it warns of is its status."""
        optimizer = self._made()
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            try:
                optimizer.fit(problem.rows.copy(), problem.target.copy())
            except Exception as error:  # a public package may raise anything
                return Solution(None, "error", f"pysindy: {described(error)}", type(error).__name__)
        weights = np.asarray(optimizer.coef_, dtype=float).T
        doubts = [str(w.message) for w in told if not issubclass(w.category, DeprecationWarning)]
        words = one_line(doubts[0], 120) if doubts else "returned"
        if not weights.any():
            reason = f"pysindy: {self.optimizer} left no column: change its settings"
            return Solution(None, "unidentifiable", reason, words)
        return Solution(weights, solver_status=words)

    def next_support(self, problem: RegressionProblem, weights: Array) -> BoolArray:
        """The support (k, n) that the optimizer's own rule gives, from weights (k, n)."""
        if self.optimizer == "STLSQ":
            return self._thresholded(problem, weights)
        if self.optimizer == "SR3":
            return self._relaxed(problem, weights)
        rule = _eliminated if self.optimizer == "SSR" else _selected
        counts = np.count_nonzero(weights, axis=0).tolist()
        supports = [
            rule(problem.rows, values, count, self.ridge)
            for values, count in zip(problem.target.T, counts, strict=True)
        ]
        return np.stack(supports, axis=1)

    def next_weights(self, problem: RegressionProblem, weights: Array) -> Array:
        """The fit (k, n) on the support that the rule gives: of a ridge, or of least squares.

        PySINDy's optimizers end with one or the other: the one that is nearer to these weights.
        """
        support, theta = self.next_support(problem, weights), problem.rows
        following = np.zeros(weights.shape)
        for target, on in enumerate(map(np.flatnonzero, support.T)):
            part, values = theta[:, on], problem.target[:, target]
            normal = part.T @ part + self.ridge * np.eye(len(on))
            fits = [np.linalg.lstsq(part, values)[0], np.linalg.solve(normal, part.T @ values)]
            near = [float(np.linalg.norm(part @ (fit - weights[on, target]))) for fit in fits]
            following[on, target] = fits[int(np.argmin(near))]
        return following

    def _made(self) -> Any:
        package: Any = import_module("pysindy")  # seconds: not before it is needed
        if self.optimizer == "STLSQ":
            return package.STLSQ(
                threshold=self.threshold, alpha=self.ridge, max_iter=self.max_iterations
            )
        if self.optimizer == "SR3":
            return package.SR3(
                reg_weight_lam=self.threshold**2 / (2.0 * self.relaxation),
                relax_coeff_nu=self.relaxation,
                max_iter=self.max_iterations,
            )
        if self.optimizer == "SSR":
            return package.SSR(alpha=self.ridge, max_iter=self.max_iterations)
        return package.FROLS(alpha=self.ridge, max_iter=self.max_iterations)

    def _thresholded(self, problem: RegressionProblem, weights: Array) -> BoolArray:
        """Where a ridge fit on the support is at least the threshold."""
        support: BoolArray = weights != 0
        for target, on in enumerate(map(np.flatnonzero, support.T.copy())):
            kept = problem.rows[:, on]
            normal = kept.T @ kept + self.ridge * np.eye(len(on))
            fitted = np.linalg.solve(normal, kept.T @ problem.target[:, target])
            support[on, target] = np.abs(fitted) >= self.threshold
        return support

    def _relaxed(self, problem: RegressionProblem, weights: Array) -> BoolArray:
        """Where (X'X + I/nu)^-1 (X'Y + W/nu) is above the threshold of the L0 penalty."""
        theta, damping = problem.rows, 1.0 / self.relaxation
        normal = theta.T @ theta + damping * np.eye(problem.columns)
        step = np.linalg.solve(normal, theta.T @ problem.target + damping * weights)
        support: BoolArray = np.abs(step) > self.threshold
        return support


def _eliminated(theta: Array, values: Array, count: int, ridge: float) -> BoolArray:
    """Backward: the smallest weight of a ridge fit leaves, until ``count`` columns are left."""
    gram, cross = theta.T @ theta, theta.T @ values
    support = np.ones(theta.shape[1], dtype=bool)
    while support.sum() > count:
        on = np.flatnonzero(support)
        fitted = np.linalg.solve(gram[np.ix_(on, on)] + ridge * np.eye(len(on)), cross[on])
        support[on[np.argmin(np.abs(fitted))]] = False
    return support


def _selected(theta: Array, values: Array, count: int, _: float) -> BoolArray:
    """Forward: the column that takes most of the residual, orthogonal to those before it."""
    left, residual = theta.copy(), values.copy()
    support = np.zeros(theta.shape[1], dtype=bool)
    for _step in range(count):
        squares = np.einsum("ij,ij->j", left, left)
        usable = (squares > 0.0) & ~support
        taken = np.where(usable, (left.T @ residual) ** 2 / np.where(usable, squares, 1.0), -1.0)
        best = int(np.argmax(taken))
        support[best] = True
        direction = left[:, best] / np.sqrt(squares[best])
        residual = residual - direction * (direction @ residual)
        left = left - np.outer(direction, direction @ left)
    return support
