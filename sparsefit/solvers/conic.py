"""Penalised least squares by conic solvers behind cvxpy, and Clarabel, the referee, among them.

With targets and weights divided by the largest alpha, a program is

    minimise  loss(Y - Z V) + f Omega(V),   f = alpha / alpha_1,

with the loss of squares by the rows of a QR of [Z, Y], which keep the digits that Z'Z loses of
columns that are alike, and a penalty by its conic form. Any penalty with one is solved.

Sources: Goulart and Chen, "Clarabel" (2024); Diamond and Boyd, J. Mach. Learn. Res. 17 (2016) 1-5.
"""

import math
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from sparsefit.arrays import Array
from sparsefit.regression.backend import Tolerance
from sparsefit.regression.design import Design
from sparsefit.regression.group_penalties import GroupNorms, NestedNorms
from sparsefit.regression.losses import SQUARES, RootSquares, Squares
from sparsefit.regression.penalties import BoundedValues, Penalty
from sparsefit.regression.problem import compressed

BATCH, ROUNDS = 50, 60  # columns that join at a time, cone programs at a penalty
SECANTS, NEGLIGIBLE = 12, 1e-6  # penalties of squares that a root tries; |R|/|Y| of an exact fit
MOST = 5000  # columns, at most, that are all in play: of a triangle and its factor


@dataclass(frozen=True)
class Cvxpy:
    """Base of the solvers behind cvxpy, compiled once for a path; V and Y are divided by alpha_1.

    name: its name in cvxpy, in lower case; package: the module it needs; tolerances: the names of
    its tolerances; more: further settings; cones: whether it takes cones, and not quadratic
    programs alone.
    """

    name: ClassVar[str]
    package: ClassVar[str]
    tolerances: ClassVar[tuple[str, ...]] = ()
    more: ClassVar[Mapping[str, Any]] = {}
    cones: ClassVar[bool] = True

    def takes(self, penalty: Penalty) -> str:
        """The reason for refusing a penalty: it has no conic form, or cones."""
        groups = isinstance(penalty, GroupNorms | NestedNorms)
        if not self.cones and (groups or penalty.loss != SQUARES):
            return f"{self.name} solves quadratic programs, and group norms are cones"
        stated = type(penalty).conic is not Penalty.conic
        return "" if stated else f"{type(penalty).__name__} has no method `conic`"

    def path(
        self, design: Design, target: Array, penalty: Penalty, alphas: Array, tolerance: Tolerance
    ) -> Array:
        """Weights (p, k, n); tolerance: the solver's own, 1e-9 where none is asked for.

        A point that fails is NaN; a status other than optimal is issued as a warning.
        """
        import cvxpy

        unit, shape = float(alphas[0]), (penalty.columns, target.shape[1])
        weights, variable = np.full((len(alphas), *shape), np.nan), cvxpy.Variable(shape)
        fraction = cvxpy.Parameter(nonneg=True, value=1.0)
        matrix = design.columns(np.arange(penalty.columns))
        objective = _loss(penalty.loss, matrix, target / unit, variable, design.samples)
        if not math.isclose(unit, 1.0):  # bounds and knots are in units of V, not of V / unit
            penalty = penalty.in_units(unit)
        norm, constraints = penalty.conic(variable, cvxpy)
        if penalty.ridge:
            norm = norm + 0.5 * penalty.ridge * cvxpy.sum_squares(variable)
        program = cvxpy.Problem(cvxpy.Minimize(objective + fraction * norm), constraints)
        settings = {**self.more, **dict.fromkeys(self.tolerances, tolerance or 1e-9)}
        for values, alpha in zip(weights, alphas.tolist(), strict=True):
            fraction.value = alpha / unit
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # "may be inaccurate": the status says so
                try:
                    program.solve(solver=self.name.upper(), **settings)
                    status = str(program.status)
                except (cvxpy.error.SolverError, ValueError, ArithmeticError) as error:
                    status = str(error)
            if status in ("optimal", "optimal_inaccurate", "user_limit"):
                values[:] = variable.value
            if isinstance(penalty, BoundedValues):  # an interior point is that far out at most
                values[:] = penalty.prox(values, 0.0)
            if status != "optimal":
                warnings.warn(f"{self.name}: {status}", RuntimeWarning, stacklevel=2)
        return unit * weights


def _loss(loss: Squares, matrix: Array, target: Array, variable: Any, samples: int) -> Any:
    """The loss of Y - Z V, V a variable of cvxpy: of squares or their root by a QR of [Z, Y]."""
    import cvxpy

    if np.isinf(loss.clip):
        level = np.linalg.norm(target) / math.sqrt(samples)
        matrix, target = compressed([(matrix, target)])
        residual = matrix @ variable - target
        if isinstance(loss, RootSquares):
            return level / math.sqrt(samples) * cvxpy.norm(residual, "fro")
        return cvxpy.sum_squares(residual) / (2 * samples)
    residual = matrix @ variable - target
    if loss.direction is not None:  # an intercept, which costs nothing
        residual = residual + loss.direction[:, None] @ cvxpy.Variable((1, target.shape[1]))
    knots = np.broadcast_to(loss.bound(target), target.shape)
    unit_free = cvxpy.huber(cvxpy.multiply(1.0 / knots, residual), 1.0)
    return cvxpy.sum(cvxpy.multiply(knots**2 / (2 * samples), unit_free))


class Clarabel(Cvxpy):
    """Clarabel on a working set of columns: the independent referee of every penalty.

    Columns that violate their optimality conditions join, BATCH or half of the set at a time.
    """

    name = "clarabel"
    package = "clarabel"
    tolerances = ("tol_gap_abs", "tol_gap_rel", "tol_feas")
    more: ClassVar[Mapping[str, Any]] = {"max_threads": 1}

    def takes(self, penalty: Penalty) -> str:
        """The reason for refusing a penalty: no conic form, or more than MOST columns at once."""
        if penalty.columns > MOST and penalty.restricted(np.arange(1)) is None:
            return f"clarabel would factorise {penalty.columns} columns for this penalty"
        return super().takes(penalty)

    def path(
        self, design: Design, target: Array, penalty: Penalty, alphas: Array, tolerance: Tolerance
    ) -> Array:
        """Weights (p, k, n) as of `Cvxpy`; 1e-10 where no tolerance is asked for."""
        weights = np.zeros((len(alphas), penalty.columns, target.shape[1]))
        in_play = np.full(penalty.columns, penalty.restricted(np.arange(1)) is None)
        # Asked for 1e-12, cone programs of groups end almost solved, some at a gap of 1e-7.
        stop = tolerance or 1e-10
        for values, alpha in zip(weights, alphas, strict=True):
            for _ in range(ROUNDS):
                if len(index := np.flatnonzero(in_play)):
                    part = penalty if in_play.all() else penalty.restricted(index) or penalty
                    columns = Design(design.columns(index), design.samples)
                    values[index] = super().path(columns, target, part, np.array([alpha]), stop)[0]
                if in_play.all() or not np.isfinite(values).all():
                    break
                rest = target - design.predict(values)
                pull = design.correlate(penalty.loss.pull(rest, target))
                excess = penalty.violations(pull, values, alpha)[penalty.units]
                excess[in_play] = -1.0
                worst = np.argsort(-excess)[: max(BATCH, len(index) // 2)]
                joining = worst[excess[worst] > 1e-10]
                if not len(joining):
                    break
                in_play[joining] = True
                if isinstance(penalty, GroupNorms | NestedNorms):  # whole blocks join
                    in_play |= np.isin(penalty.blocks, penalty.blocks[joining])
            if isinstance(penalty.loss, RootSquares):
                values[:] = self._by_squares(design, target, penalty, float(alpha), values, stop)
        return weights

    def _by_squares(
        self,
        design: Design,
        target: Array,
        penalty: Penalty,
        alpha: float,
        values: Array,
        stop: float,
    ) -> Array:
        """Weights (k, n) of the squares at the penalty t = alpha |R|/|Y| that their residual sets.

        The gap of a root is linear in the error of its residual, that of squares quadratic. The
        search for t begins at an interior point ``values`` (k, n), the answer where a fit is exact.
        """
        squares, size = replace(penalty, loss=SQUARES), float(np.linalg.norm(target)) or 1.0
        start, xs, excesses = values, list[float](), list[float]()
        for _ in range(SECANTS):
            wanted = (alpha / size * float(np.linalg.norm(target - design.predict(values)))) ** 2
            if xs:
                excesses.append(xs[-1] - wanted)
            if len(xs) > 1 and excesses[-1] != excesses[-2]:  # |R|^2 is linear in t^2 by pieces
                slope = (xs[-1] - xs[-2]) / (excesses[-1] - excesses[-2])
                wanted = max(xs[-1] - slope * excesses[-1], 0.1 * wanted)
            if not wanted > (NEGLIGIBLE * alpha) ** 2:
                return start
            if xs and abs(wanted / xs[-1] - 1.0) < 1e-10:
                break
            xs.append(wanted)
            values = self.path(design, target, squares, np.sqrt(xs[-1:]), stop)[0]
        return values
