"""Penalised least squares by conic solvers: Clarabel itself, the referee, and those behind cvxpy.

With the columns J in play, V (j, n), targets divided by the largest alpha, and one bound t_g per
block, the referee solves

    minimise 1/2 sum_t v_t'G v_t - <C, V> + f sum omega_g t_g   s.t.  (t_g, V_g) in a cone,

G = Z_J'Z_J/m, C = Z_J'Y/m; blocks within blocks have bounds and cones of their own, and a ridge
adds to the diagonal of G. Other penalties and losses go to Clarabel by their conic form. Columns
outside of J that object to being zero join, the worst first. Through cvxpy any penalty with a conic
form is solved, on the compressed problem, or by the m rows as users of cvxpy write it.

Sources: Goulart and Chen, "Clarabel" (2024); Diamond and Boyd, J. Mach. Learn. Res. 17 (2016) 1-5.
"""

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from scipy import sparse

from sparsefit.arrays import Array, IntArray
from sparsefit.errors import InputError, MissingExtra, unknown
from sparsefit.regression.design import Design
from sparsefit.regression.group_penalties import GroupNorms, NestedNorms
from sparsefit.regression.losses import SQUARES, RootSquares
from sparsefit.regression.penalties import AbsoluteValues, Penalty, SquaredNorm
from sparsefit.solvers.peers import matrix_of

VIOLATION = 1e-10  # relative: below it a block outside the working set is optimal at zero


@dataclass(frozen=True)
class Clarabel:
    """Clarabel on the columns in play: sparsefit's independent referee of every penalty.

    working: whether columns join as they object to being zero; otherwise all are in play. batch:
    columns that join at a time, at least; more join as the set grows. rounds: the most cone
    programs at a penalty.
    """

    name: ClassVar[str] = "clarabel"
    package: ClassVar[str] = "clarabel"
    form: ClassVar[str] = "Clarabel itself on Z'Z of a working set of columns"
    working: bool = True
    batch: int = 50
    rounds: int = 60

    def takes(self, penalty: Penalty) -> str:
        """The reason why a penalty is not solved: it states no conic form."""
        return "" if _layers(penalty) is not None else _no_conic_form(penalty)

    def path(
        self,
        design: Design,
        target: Array,
        penalty: Penalty,
        alphas: Array,
        tolerance: float | None,
    ) -> Array:
        """Weights (p, k, n); tolerance: of gap and feasibility, 1e-12 where none is asked for.

        A point that Clarabel does not solve is NaN; of any that it does not call solved its status
        is a warning. Raises InputError on a penalty without a conic form.
        """
        if reason := self.takes(penalty):
            raise InputError(reason)
        weights = np.zeros((len(alphas), penalty.columns, target.shape[1]))
        whole = not self.working or isinstance(penalty, SquaredNorm)
        whole = whole or penalty.restricted(np.arange(penalty.columns)) is None
        in_play = np.full(penalty.columns, whole)
        for point, alpha in enumerate(alphas.tolist()):
            program = _Point(design, target, penalty, alpha, tolerance or 1e-12)
            values, status = np.zeros(weights.shape[1:]), "Solved"
            if in_play.any():
                values, status = program.solved(np.flatnonzero(in_play))
            for _ in range(0 if in_play.all() else self.rounds):
                if not np.isfinite(values).all():
                    break
                excess = np.where(in_play, -1.0, program.objections(values))
                count = max(self.batch, int(in_play.sum()) // 2)
                worst = np.argsort(-excess)[:count]
                joining = worst[excess[worst] > VIOLATION]
                if not len(joining):
                    break
                in_play |= np.isin(penalty.blocks, penalty.blocks[joining]) & _whole(penalty)
                in_play[joining] = True
                values, status = program.solved(np.flatnonzero(in_play))
            weights[point] = values
            if status != "Solved":
                warnings.warn(f"clarabel: {status}", RuntimeWarning, stacklevel=2)
        return weights


@dataclass(frozen=True)
class ClarabelDirect(Clarabel):
    """Clarabel itself on Z'Z of all columns."""

    name: ClassVar[str] = "clarabel-direct"
    form: ClassVar[str] = "Clarabel itself on Z'Z, all columns"
    working: bool = False


def _whole(penalty: Penalty) -> bool:
    """Whether columns join in whole blocks: groups do, columns of one order join by themselves."""
    return isinstance(penalty, GroupNorms | NestedNorms)


def _no_conic_form(penalty: Penalty) -> str:
    stated = type(penalty).conic is not Penalty.conic
    return "" if stated else f"{type(penalty).__name__} states no conic form"


@dataclass(frozen=True, eq=False)
class _Point:
    """One point of a path, at an absolute alpha."""

    design: Design
    target: Array
    penalty: Penalty
    alpha: float
    tolerance: float

    def objections(self, values: Array) -> Array:
        """By how much each column (k,) at zero objects, at V (k, n)."""
        residual = self.target - self.design.predict(values)
        level = np.sqrt(np.mean(np.square(self.target), axis=0))
        if isinstance(self.penalty.loss, RootSquares):
            size = math.sqrt(float(np.mean(np.square(residual).sum(axis=1)))) or 1.0
            residual = residual * (math.sqrt(float(np.sum(level**2))) / size)
        else:
            reach = self.penalty.loss.bound(level)
            residual = np.clip(residual, -reach, reach)
        return self.penalty.objections(self.design.correlate(residual), values, self.alpha)

    def solved(self, index: IntArray) -> tuple[Array, str]:
        """V (k, n) with the columns ``index`` in play, NaN where it has none, and a status."""
        every = len(index) == self.penalty.columns
        inner = self.penalty if every else self.penalty.restricted(index)
        assert inner is not None  # a penalty that cannot be restricted has all columns in play
        if _layers(inner) is not None:
            cross = self.design.columns(index).T @ self.target / self.design.samples
            gram = self.design.products(index) + self.alpha * inner.ridge * np.eye(len(index))
            values, status = _cone_program(gram, cross / self.alpha, inner, self.tolerance)
            values = values * self.alpha
        else:
            rows = self.design.columns(index)
            program = _Stated.of(rows, self.target, inner, self.alpha, self.design.samples)
            values, status = program.solved("clarabel", self.tolerance)
            status = {"optimal": "Solved"}.get(status, status)
        weights = np.zeros((self.penalty.columns, self.target.shape[1]))
        weights[index] = values
        return weights, status


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

    (size, targets), linear, rows = cross.shape, [-cross.T.ravel()], [np.zeros(0, np.intp)]
    cones: list[Any] = []
    for layer in _layers(penalty) or []:
        block, weights = _blocks(layer, targets)
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


def _blocks(layer: Any, targets: int) -> tuple[IntArray, Array]:
    """The block of each coefficient, target by target, and the weight of each block."""
    apart = 0 if layer.coupled else len(layer.weights)
    block = (layer.blocks[None, :] + apart * np.arange(targets)[:, None]).ravel()
    return block, np.tile(layer.weights, 1 if layer.coupled else targets)


STOPS: dict[str, Sequence[str]] = {
    "clarabel": ("tol_gap_abs", "tol_gap_rel", "tol_feas"),
    "osqp": ("eps_abs", "eps_rel"),
    "scs": ("eps_abs", "eps_rel"),
    "piqp": ("eps_abs", "eps_rel"),
    "ecos": ("abstol", "reltol", "feastol"),
    "proxqp": ("eps_abs", "eps_rel"),
}
"""Solver of cvxpy -> the settings that hold its stopping tolerance."""
MORE: dict[str, dict[str, Any]] = {
    "clarabel": {"max_threads": 1},
    "osqp": {"max_iter": 50_000, "polishing": True},
    "scs": {"max_iters": 50_000},
}
"""Settings with which a solver of cvxpy is asked for high accuracy."""
QUADRATIC = ("osqp", "highs", "piqp", "daqp", "proxqp")  # solvers of quadratic programs only


@dataclass(frozen=True)
class Cvxpy:
    """Any solver that cvxpy finds, on 1/2 v'Gv - <C, V>, G = Z'Z/m, compiled once for a path.

    solver: its name in cvxpy, in lower case.
    """

    name: ClassVar[str] = "cvxpy"
    package: ClassVar[str] = "cvxpy"
    form: ClassVar[str] = "through cvxpy, in Z'Z, compiled once"
    solver: str = "clarabel"

    def __post_init__(self) -> None:

        installed = installed_solvers()
        if self.solver in installed:
            return
        if self.solver in (*STOPS, *QUADRATIC, "qoco", "cvxopt", "mosek", "gurobi"):
            raise MissingExtra(f"{self.solver} is not installed: pip install {self.solver}")
        raise unknown("solver of cvxpy", self.solver, installed)

    def takes(self, penalty: Penalty) -> str:
        """Every penalty with a conic form; solvers of quadratic programs take no group norms."""
        if self.solver in QUADRATIC and (_whole(penalty) or penalty.loss != SQUARES):
            return f"{self.solver} solves quadratic programs, and group norms are cones"
        return _no_conic_form(penalty)

    def path(
        self,
        design: Design,
        target: Array,
        penalty: Penalty,
        alphas: Array,
        tolerance: float | None,
    ) -> Array:
        """Weights (p, k, n); tolerance: the solver's own, 1e-9 where none is asked for."""
        rows, stop = design.columns(np.arange(penalty.columns)), tolerance or 1e-9
        program = _Stated.of(rows, target, penalty, float(alphas[0]), design.samples)
        return self._along(alphas, lambda alpha: program.solved(self.solver, stop, alpha))

    def _along(self, alphas: Array, solve: Any) -> Array:
        found = []
        for alpha in alphas.tolist():
            values, status = solve(alpha)
            if status != "optimal":
                warnings.warn(f"{self.solver}: {status}", RuntimeWarning, stacklevel=3)
            found.append(values)
        return np.stack(found)


@dataclass(frozen=True)
class CvxpyRows(Cvxpy):
    """Any solver that cvxpy finds, on the sum over the m rows, a problem per penalty.

    solver: its name in cvxpy, in lower case.
    """

    name: ClassVar[str] = "cvxpy-rows"
    form: ClassVar[str] = "through cvxpy, as written: m rows"

    def path(
        self,
        design: Design,
        target: Array,
        penalty: Penalty,
        alphas: Array,
        tolerance: float | None,
    ) -> Array:
        """Weights (p, k, n); tolerance: the solver's own, and its default where none is asked."""
        matrix = matrix_of(design)

        def solve(alpha: float) -> tuple[Array, str]:
            program = _Stated.of(matrix, target, penalty, alpha, design.samples, written=True)
            return program.solved(self.solver, tolerance)

        return self._along(alphas, solve)


@dataclass(frozen=True, eq=False)
class _Stated:
    """A program of cvxpy: its variable V (k, n) over ``unit``, and alpha over ``unit``."""

    program: Any
    variable: Any
    fraction: Any
    unit: float

    @classmethod
    def of(
        cls,
        matrix: Any,
        target: Array,
        penalty: Penalty,
        unit: float,
        samples: int,
        *,
        written: bool = False,
    ) -> "_Stated":
        """State loss and penalty; compressed to k x k, or by the rows of Z (m, k) as ``written``.

        Half the mean square is 1/2 v'Gv - <C, V>; its root, and what is compressed of it, has the
        rows of a QR of [Z, Y]; Huber's has all rows.
        """
        import cvxpy

        loss, scaled = penalty.loss, target / unit
        variable, fraction = cvxpy.Variable((matrix.shape[1], target.shape[1])), 1.0
        level = np.sqrt(np.square(scaled).sum(axis=0) / samples)
        if not written:
            fraction = cvxpy.Parameter(nonneg=True, value=1.0)
        if loss == SQUARES and not written:
            gram = matrix.T @ matrix / samples
            root, cross = cvxpy.psd_wrap((gram + gram.T) / 2), matrix.T @ scaled / samples
            objective = -cvxpy.sum(cvxpy.multiply(cross, variable))
            for t in range(target.shape[1]):
                objective = objective + 0.5 * cvxpy.quad_form(variable[:, t], root)
        elif isinstance(loss, RootSquares):
            if not written and len(target) > matrix.shape[1] + target.shape[1]:
                triangle: Any = np.linalg.qr(np.hstack([matrix, scaled]), mode="r")
                matrix, scaled = triangle[:, : matrix.shape[1]], triangle[:, matrix.shape[1] :]
            size = cvxpy.norm(matrix @ variable - scaled, "fro") / math.sqrt(samples)
            objective = math.sqrt(float(np.sum(level**2))) * size
        elif loss == SQUARES:
            objective = cvxpy.sum_squares(matrix @ variable - scaled) / (2 * samples)
        else:
            residual = matrix @ variable - scaled
            parts = [
                cvxpy.sum(cvxpy.huber(residual[:, t], float(reach))) / (2 * samples)
                for t, reach in enumerate(loss.bound(level))
            ]
            objective = cvxpy.sum(cvxpy.hstack(parts))
        if not math.isclose(unit, 1.0):  # bounds and knots are in units of V, not of V / unit
            penalty = _in_units(penalty, unit)
        norm, constraints = penalty.conic(variable, cvxpy)
        if penalty.ridge:
            norm = norm + 0.5 * penalty.ridge * cvxpy.sum_squares(variable)
        goal = cvxpy.Minimize(objective + fraction * norm)
        return cls(cvxpy.Problem(goal, constraints), variable, fraction, unit)

    def solved(
        self, solver: str, tolerance: float | None, alpha: float | None = None
    ) -> tuple[Array, str]:
        """V (k, n), NaN where the solver has none, and its status; at the unit or another alpha."""
        import cvxpy

        settings: dict[str, Any] = {}
        if alpha is not None:
            self.fraction.value = alpha / self.unit
        if tolerance is not None:
            stops = dict.fromkeys(STOPS.get(solver, ()), tolerance)
            settings = {**MORE.get(solver, {}), **stops}
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # "may be inaccurate": the status says so
            try:
                self.program.solve(solver=solver.upper(), **settings)
                status = str(self.program.status)
            except (cvxpy.error.SolverError, ValueError, ArithmeticError) as error:
                status = str(error)
        values = self.variable.value
        if values is None or status not in ("optimal", "optimal_inaccurate", "user_limit"):
            return np.full(self.variable.shape, np.nan), status
        return self.unit * np.asarray(values), status


def _in_units(penalty: Penalty, unit: float) -> Penalty:
    """The penalty of V / unit, over the unit: norms stay, a ridge grows, bounds shrink."""
    changed: dict[str, Any] = {"ridge": penalty.ridge * unit}
    for name in ("lower", "upper"):
        if hasattr(penalty, name):
            changed[name] = getattr(penalty, name) / unit
    return replace(penalty, **changed)


def installed_solvers() -> list[str]:
    """Names of the solvers that cvxpy finds here, in lower case."""
    import cvxpy

    return sorted(name.lower() for name in cvxpy.installed_solvers())
