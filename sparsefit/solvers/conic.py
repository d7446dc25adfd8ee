"""Penalised least squares by conic solvers: Clarabel itself, the referee, and those behind cvxpy.

With the columns J in play, V (j, n), targets divided by the largest alpha, and one bound t_g per
block, the referee solves

    minimise 1/2 sum_t v_t'G v_t - <C, V> + f sum omega_g t_g   s.t.  (t_g, V_g) in a cone,

G = Z_J'Z_J/m, C = Z_J'Y/m; blocks within blocks have bounds and cones of their own, and a ridge
adds to the diagonal of G. Other penalties and losses go to Clarabel by their conic form. Columns
outside of J that object to being zero join, the worst first. Through cvxpy any penalty with a conic
form is solved.

Sources: Goulart and Chen, "Clarabel" (2024); Diamond and Boyd, J. Mach. Learn. Res. 17 (2016) 1-5.
"""

import math
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from scipy import sparse

from sparsefit.arrays import Array, IntArray
from sparsefit.errors import InputError
from sparsefit.regression.backend import Tolerance
from sparsefit.regression.design import Design
from sparsefit.regression.group_penalties import GroupNorms, NestedNorms
from sparsefit.regression.losses import SQUARES, RootSquares
from sparsefit.regression.penalties import (
    AbsoluteValues,
    BoundedValues,
    Penalty,
    SquaredNorm,
)

BATCH, ROUNDS = 50, 60  # columns that join at a time, cone programs at a penalty


@dataclass(frozen=True)
class Clarabel:
    """Clarabel on the columns in play: sparsefit's independent referee of every penalty.

    Columns join as they object to being zero, half as many at a time as there are, or BATCH.
    """

    name: ClassVar[str] = "clarabel"
    package: ClassVar[str] = "clarabel"

    def takes(self, penalty: Penalty) -> str:
        """The reason why a penalty is not solved: it states no conic form."""
        return "" if _layers(penalty) is not None else _no_conic_form(penalty)

    def path(
        self, design: Design, target: Array, penalty: Penalty, alphas: Array, tolerance: Tolerance
    ) -> Array:
        """Weights (p, k, n); tolerance: of gap and feasibility, 1e-10 where none is asked for.

        A point that Clarabel does not solve is NaN; of any that it does not call solved its status
        is a warning. Raises InputError on a penalty without a conic form.
        """
        if reason := self.takes(penalty):
            raise InputError(reason)
        weights = np.zeros((len(alphas), penalty.columns, target.shape[1]))
        whole = isinstance(penalty, SquaredNorm) or penalty.restricted(np.arange(1)) is None
        in_play = np.full(penalty.columns, whole)
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
                excess = np.where(in_play, -1.0, penalty.objections(pull, values, alpha))
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
        gram = design.products(index) + alpha * penalty.ridge * np.eye(len(index))
        cross = columns.T @ target / design.samples
        values, status = _cone_program(gram, cross / alpha, penalty, stop)
        return values * alpha, status
    asked = (columns, target, penalty, [alpha], stop, design.samples)
    ((values, status),) = BEHIND_CVXPY["clarabel"].points(*asked)
    return values, "Solved" if status == "optimal" else status


def _no_conic_form(penalty: Penalty) -> str:
    stated = type(penalty).conic is not Penalty.conic
    return "" if stated else f"{type(penalty).__name__} states no conic form"


def _layers(penalty: Penalty) -> list[Any] | None:
    """The norms of one kind of block that a penalty is a sum of; None where it is no such."""
    if penalty.loss != SQUARES:
        return None
    if isinstance(penalty, SquaredNorm):
        return []
    if isinstance(penalty, NestedNorms):
        return [penalty.outer, penalty.inner]
    return [penalty] if type(penalty) in (AbsoluteValues, GroupNorms) else None


def _cone_program(
    gram: Array, cross: Array, penalty: Penalty, tolerance: float
) -> tuple[Array, str]:
    """Clarabel's V (j, n), NaN where it has none, and its status; x = (V.T.ravel(), the bounds)."""
    import clarabel

    (size, targets), linear = cross.shape, [-cross.T.ravel()]
    rows: list[IntArray] = [np.zeros(0, np.intp)]
    cones: list[Any] = []
    for layer in _layers(penalty) or []:
        apart = 0 if layer.coupled else len(layer.weights)
        block = (layer.blocks[None, :] + apart * np.arange(targets)[:, None]).ravel()
        weights = np.tile(layer.weights, 1 if layer.coupled else targets)
        bound = sum(map(len, linear)) + np.arange(len(weights))
        linear.append(weights)
        # Rows of A: for each block its bound, then its coefficients; the cone is (t_g, V_g).
        order = np.argsort(np.concatenate([block, np.arange(len(weights)) - 0.5]), kind="stable")
        rows.append(np.concatenate([np.arange(size * targets), bound])[order])
        cones += [clarabel.SecondOrderConeT(1 + int(count)) for count in np.bincount(block)]
    variables, columns = sum(map(len, linear)), np.concatenate(rows)
    bounds = sparse.csc_matrix((variables - size * targets,) * 2)
    quadratic = sparse.triu(sparse.block_diag([*[gram] * targets, bounds]), format="csc")
    places = (np.arange(len(columns)), columns)
    matrix = sparse.csc_matrix((-np.ones(len(columns)), places), (len(columns), variables))
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_threads = 1
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = tolerance
    solution = clarabel.DefaultSolver(
        quadratic, np.concatenate(linear), matrix, np.zeros(len(columns)), cones, settings
    ).solve()
    status = str(solution.status)
    values = np.array(solution.x)[: size * targets].reshape(targets, size).T
    usable = status in ("Solved", "AlmostSolved", "MaxIterations", "InsufficientProgress")
    return (values if usable else np.full_like(cross, np.nan)), status


@dataclass(frozen=True)
class Cvxpy:
    """A solver that cvxpy finds, on 1/2 v'Gv - <C, V>, G = Z'Z/m, compiled once for a path.

    name: its name in cvxpy, in lower case; package: the module it needs; tolerances: its settings
    that hold one; more: what asks it for accuracy; extra: what pip installs, if not the package.
    """

    name: str
    package: str
    tolerances: tuple[str, ...] = ()
    more: Mapping[str, Any] = field(default_factory=dict)
    extra: str = ""

    def takes(self, penalty: Penalty) -> str:
        """Every penalty with a conic form; solvers of quadratic programs take no group norms."""
        groups = isinstance(penalty, GroupNorms | NestedNorms)
        quadratic = self.name in ("osqp", "highs", "piqp", "daqp", "proxqp")
        if quadratic and (groups or penalty.loss != SQUARES):
            return f"{self.name} solves quadratic programs, and group norms are cones"
        return _no_conic_form(penalty)

    def path(
        self, design: Design, target: Array, penalty: Penalty, alphas: Array, tolerance: Tolerance
    ) -> Array:
        """Weights (p, k, n); tolerance: the solver's own, 1e-9 where none is asked for."""
        columns, weights = design.columns(np.arange(penalty.columns)), []
        asked = (alphas.tolist(), tolerance or 1e-9, design.samples)
        for values, status in self.points(columns, target, penalty, *asked):
            if status != "optimal":
                warnings.warn(f"{self.name}: {status}", RuntimeWarning, stacklevel=2)
            weights.append(values)
        return np.stack(weights)

    def points(
        self,
        matrix: Array,
        target: Array,
        penalty: Penalty,
        alphas: list[float],
        tolerance: float,
        samples: int,
    ) -> Iterator[tuple[Array, str]]:
        """V (k, n) of the columns (m, k) at each alpha, NaN where there is none, and the status.

        V and the target are divided by the first alpha. Half the mean square is 1/2 v'Gv - <C, V>;
        its root has the rows of a QR of [Z, Y], Huber's loss all rows.
        """
        import cvxpy

        loss, unit = penalty.loss, alphas[0]
        variable = cvxpy.Variable((matrix.shape[1], target.shape[1]))
        scaled, fraction = target / unit, cvxpy.Parameter(nonneg=True, value=1.0)
        level = np.sqrt(np.square(scaled).sum(axis=0) / samples)
        if loss == SQUARES:
            gram = matrix.T @ matrix / samples
            root, cross = cvxpy.psd_wrap((gram + gram.T) / 2), matrix.T @ scaled / samples
            objective = -cvxpy.sum(cvxpy.multiply(cross, variable))
            for t in range(target.shape[1]):
                objective = objective + 0.5 * cvxpy.quad_form(variable[:, t], root)
        elif isinstance(loss, RootSquares):
            triangle: Any = np.linalg.qr(np.hstack([matrix, scaled]), mode="r")
            matrix, scaled = triangle[:, : matrix.shape[1]], triangle[:, matrix.shape[1] :]
            size = cvxpy.norm(matrix @ variable - scaled, "fro") / math.sqrt(samples)
            objective = math.sqrt(float(np.sum(level**2))) * size
        else:
            residual = matrix @ variable - scaled
            parts = [
                cvxpy.sum(cvxpy.huber(residual[:, t], float(reach))) / (2 * samples)
                for t, reach in enumerate(loss.bound(scaled))
            ]
            objective = cvxpy.sum(cvxpy.hstack(parts))
        if not math.isclose(unit, 1.0):  # bounds and knots are in units of V, not of V / unit
            penalty = penalty.in_units(unit)
        norm, constraints = penalty.conic(variable, cvxpy)
        if penalty.ridge:
            norm = norm + 0.5 * penalty.ridge * cvxpy.sum_squares(variable)
        program = cvxpy.Problem(cvxpy.Minimize(objective + fraction * norm), constraints)
        settings = {**self.more, **dict.fromkeys(self.tolerances, tolerance)}
        for alpha in alphas:
            fraction.value = alpha / unit
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # "may be inaccurate": the status says so
                try:
                    program.solve(solver=self.name.upper(), **settings)
                    status = str(program.status)
                except (cvxpy.error.SolverError, ValueError, ArithmeticError) as error:
                    status = str(error)
            values = np.full(variable.shape, np.nan)
            usable = status in ("optimal", "optimal_inaccurate", "user_limit")
            if variable.value is not None and usable:
                values = unit * np.asarray(variable.value)
            if isinstance(penalty, BoundedValues):  # an interior point is that far out at most
                values = unit * penalty.prox(values / unit, 0.0)
            yield values, status


EPS, EXTRA = ("eps_abs", "eps_rel"), "'sparsefit[peers]'"
_LISTED = (
    Cvxpy(
        *("clarabel", "clarabel", ("tol_gap_abs", "tol_gap_rel", "tol_feas"), {"max_threads": 1})
    ),
    Cvxpy("osqp", "osqp", EPS, {"max_iter": 50_000, "polishing": True}),
    Cvxpy("scs", "scs", EPS, {"max_iters": 50_000}),
    Cvxpy("piqp", "piqp", EPS, extra=EXTRA),
    Cvxpy("daqp", "daqp", extra=EXTRA),
    Cvxpy("proxqp", "proxsuite", EPS),
    Cvxpy("ecos", "ecos", ("abstol", "reltol", "feastol")),
    Cvxpy("highs", "highspy"),
    Cvxpy("gurobi", "gurobipy"),
    *(Cvxpy(name, name) for name in ("qoco", "cvxopt", "mosek")),
)
BEHIND_CVXPY: Mapping[str, Cvxpy] = {each.name: each for each in _LISTED}
"""The solvers behind cvxpy by name; Clarabel is the referee's for penalties that have no cone."""
