"""Penalised least squares by conic solvers: Clarabel itself, the referee, and those behind cvxpy.

With the columns J in play, V (j, n), targets divided by the largest alpha, and one bound t_g per
block, the referee solves

    minimise 1/2 sum_t v_t'G v_t - <C, V> + f sum omega_g t_g   s.t.  (t_g, V_g) in a cone,

G = Z_J'Z_J/m, C = Z_J'Y/m, and with the residual as a variable where that is not solved. Blocks
within blocks have bounds and cones of their own, and a ridge adds to the diagonal of G. Other
penalties and losses go to Clarabel by their conic form. Columns outside of J that violate their
optimality conditions join, the worst first. Through cvxpy any penalty with a conic form is solved.

Sources: Goulart and Chen, "Clarabel" (2024); Diamond and Boyd, J. Mach. Learn. Res. 17 (2016) 1-5.
"""

import math
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from scipy import sparse

from sparsefit.arrays import Array, IntArray
from sparsefit.regression.backend import Tolerance
from sparsefit.regression.design import Design
from sparsefit.regression.group_penalties import GroupNorms, NestedNorms
from sparsefit.regression.losses import SQUARES, RootSquares, Squares
from sparsefit.regression.penalties import (
    AbsoluteValues,
    BoundedValues,
    Penalty,
    SquaredNorm,
)
from sparsefit.regression.problem import compressed

BATCH, ROUNDS = 50, 60  # columns that join at a time, cone programs at a penalty
MOST = 5000  # columns, at most, that are all in play: of X'X and its factor


@dataclass(frozen=True)
class Clarabel:
    """Clarabel on a working set of columns: the independent referee of every penalty.

    Columns that violate their optimality conditions join, BATCH or half of the set at a time.
    """

    name: ClassVar[str] = "clarabel"
    package: ClassVar[str] = "clarabel"

    def takes(self, penalty: Penalty) -> str:
        """The reason for refusing a penalty: it has no conic form, or needs X'X of MOST columns."""
        if penalty.columns > MOST and _is_whole(penalty):
            return f"clarabel would form X'X of {penalty.columns} columns for this penalty"
        return "" if _layers(penalty) is not None else _no_conic_form(penalty)

    def path(
        self, design: Design, target: Array, penalty: Penalty, alphas: Array, tolerance: Tolerance
    ) -> Array:
        """Weights (p, k, n); tolerance: of gap and feasibility, 1e-10 where none is asked for.

        A point that fails is NaN; a status other than solved is issued as a warning.
        """
        weights = np.zeros((len(alphas), penalty.columns, target.shape[1]))
        in_play = np.full(penalty.columns, _is_whole(penalty))
        # Asked for 1e-12, cone programs of groups end almost solved, some at a gap of 1e-7.
        stop = tolerance or 1e-10
        for values, alpha in zip(weights, alphas.tolist(), strict=True):
            status = "Solved"
            for _ in range(ROUNDS):
                if len(index := np.flatnonzero(in_play)):
                    part = penalty if in_play.all() else penalty.restricted(index)
                    values[index], status = _solved(design, index, target, part, alpha, stop)
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
            if status != "Solved":
                warnings.warn(f"clarabel: {status}", RuntimeWarning, stacklevel=2)
        return weights


def _solved(
    design: Design, index: IntArray, target: Array, penalty: Any, alpha: float, stop: float
) -> tuple[Array, str]:
    """V (j, n) of these columns, NaN where there is none, and Clarabel's status."""
    columns = design.columns(index)
    if _layers(penalty) is not None:
        square, root = alpha * penalty.ridge * np.eye(len(index)), math.sqrt(design.samples)
        linear = columns.T @ target / (-alpha * design.samples)
        sums = (square + design.products(index), linear, columns[:0], target[:0])
        values, status = _cone_program(*sums, penalty, stop)
        if status != "Solved":  # rows keep digits that Z'Z loses of columns that are alike
            rows = compressed([(columns / root, target / (root * alpha))])
            others, word = _cone_program(square, 0.0 * linear, *rows, penalty, stop)
            values, status = (others, word) if "Solved" in word else (values, status)
        return values * alpha, status
    part, alphas = Design(columns, design.samples), np.array([alpha])
    return ByConicForm().path(part, target, penalty, alphas, stop)[0], "Solved"


def _is_whole(penalty: Penalty) -> bool:
    """Whether all columns are in play, as no part of them has a penalty of its own."""
    return isinstance(penalty, SquaredNorm) or penalty.restricted(np.arange(1)) is None


def _no_conic_form(penalty: Penalty) -> str:
    stated = type(penalty).conic is not Penalty.conic
    return "" if stated else f"{type(penalty).__name__} has no method `conic`"


def _layers(penalty: Penalty) -> list[Any] | None:
    """The terms of a penalty, norms of one kind of block each; None of any other penalty."""
    if penalty.loss != SQUARES:
        return None
    if isinstance(penalty, SquaredNorm):
        return []
    if isinstance(penalty, NestedNorms):
        return [penalty.outer, penalty.inner]
    return [penalty] if type(penalty) in (AbsoluteValues, GroupNorms) else None


def _cone_program(
    square: Array, linear: Array, rows: Array, right: Array, penalty: Penalty, tolerance: float
) -> tuple[Array, str]:
    """Clarabel's V (j, n), NaN where it has none, and its status; x = (V.T, R.T, the bounds).

    1/2 sum_t v_t'S v_t + <L, V> + 1/2 |R|^2 + the norms, R = right - rows V; S ``square`` (j, j), L
    ``linear`` (j, n), rows (r, j), right (r, n).
    """
    import clarabel

    (size, targets), count = linear.shape, right.size
    prices = [linear.T.ravel(), np.zeros(count)]
    places: list[IntArray] = [np.zeros(0, np.intp)]
    cones: list[Any] = [clarabel.ZeroConeT(count)] if count else []
    for layer in _layers(penalty) or []:
        apart = 0 if layer.coupled else len(layer.weights)
        block = (layer.blocks[None, :] + apart * np.arange(targets)[:, None]).ravel()
        weights = np.tile(layer.weights, 1 if layer.coupled else targets)
        bound = sum(map(len, prices)) + np.arange(len(weights))
        prices.append(weights)
        # Rows of A: for each block its bound, then its coefficients; the cone is (t_g, V_g).
        order = np.argsort(np.concatenate([block, np.arange(len(weights)) - 0.5]), kind="stable")
        places.append(np.concatenate([np.arange(size * targets), bound])[order])
        cones += [clarabel.SecondOrderConeT(1 + int(each)) for each in np.bincount(block)]
    variables, columns = sum(map(len, prices)), np.concatenate(places)
    bounds = sparse.csc_array((variables - size * targets - count,) * 2)
    parts: list[Any] = [*[square] * targets, sparse.eye_array(count), bounds]
    quadratic = sparse.triu(sparse.block_diag(parts), format="csc")
    # Zeros of the rows stay stored, and the result is an array of scipy.
    parts = [*[rows] * targets, sparse.coo_array((0, 0))]
    residual: Any = sparse.block_diag(parts)
    blank = sparse.coo_array((count, variables - size * targets - count))
    ones = (-np.ones(len(columns)), (np.arange(len(columns)), columns))
    cone = sparse.coo_array(ones, shape=(len(columns), variables))
    whole: Any = [sparse.hstack([residual, sparse.eye_array(count), blank]), cone]
    matrix = sparse.vstack(whole, format="csc")
    limits = np.concatenate([right.T.ravel(), np.zeros(len(columns))])
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_threads = 1
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = tolerance
    solution = clarabel.DefaultSolver(
        quadratic, np.concatenate(prices), matrix, limits, cones, settings
    ).solve()
    status = str(solution.status)
    values = np.array(solution.x)[: size * targets].reshape(targets, size).T
    usable = status in ("Solved", "AlmostSolved", "MaxIterations", "InsufficientProgress")
    return (values if usable else np.full_like(linear, np.nan)), status


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
        return _no_conic_form(penalty)

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


class ByConicForm(Cvxpy):
    """Clarabel behind cvxpy: the referee of penalties and losses that have a conic form alone."""

    name = "clarabel"
    package = "clarabel"
    tolerances = ("tol_gap_abs", "tol_gap_rel", "tol_feas")
    more: ClassVar[Mapping[str, Any]] = {"max_threads": 1}
