"""Public solvers of penalised least squares, a class each, for studies of solvers.

    [[solvers]]
    file = "public_solvers.py"             # beside the study

brings all of them; ``solver = ["homotopy", "celer", "osqp"]`` of a back-end names those that are
compared. Install with ``pip install 'sparsefit[peers]'``. From Python: ``Recipe("celer",
file="public_solvers.py").make()`` of `sparsefit.solvers.registry`.

Each is handed the problem in the common form of `sparsefit.solvers.commands`. Targets that share
the norms of their groups are one long target with a block-diagonal design. Where samples are many
the rows are the triangle of a QR of [X, y], or X'X/m is formed, in the time of the solver that uses
it. Tolerances have the meaning of each solver; weights are compared by sparsefit's certificate.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from importlib import import_module
from typing import Any, ClassVar

import numpy as np
from scipy import sparse

from sparsefit.arrays import Array, IntArray
from sparsefit.errors import integer
from sparsefit.regression.backend import Tolerance
from sparsefit.regression.design import Design
from sparsefit.regression.penalties import Penalty
from sparsefit.solvers.commands import Kind, Task, kind_of
from sparsefit.solvers.conic import Cvxpy

SINGLE: tuple[Kind, ...] = ("LASSO", "elastic net")
GROUPED: tuple[Kind, ...] = ("group-LASSO", "joint group-LASSO")
EXTRA = "'sparsefit[peers]'"
EPS = ("eps_abs", "eps_rel")


class Rows(Task):
    """A problem in the forms that public solvers read.

    Targets that are solved separately share X'X and the QR, computed and charged once.
    """

    @property
    def samples(self) -> int:
        """The number m of samples."""
        return len(self.target)

    @property
    def tall(self) -> bool:
        """Whether X is dense and its rows so many that a QR or X'X saves more than it costs."""
        (m, k), n = self.design.shape, self.target.shape[1]
        return isinstance(self.design, np.ndarray) and m > 1.5 * (k + n)

    @cached_property
    def gram(self) -> Array:
        """X'X/m (k, k) of a dense X."""
        gram: Array = self.design.T @ self.design / self.samples
        return gram

    @cached_property
    def triangle(self) -> tuple[Array, Array]:
        """X and the targets as the rows of a QR of both, with the same inner products."""
        rows: Any = np.linalg.qr(np.hstack([self.design, self.target]), mode="r")
        return rows[:, : self.design.shape[1]], rows[:, self.design.shape[1] :]

    def cross(self, targets: slice) -> Array:
        """X'y/m (k,) of the first target of the slice."""
        cross: Array = self.design.T @ self.target[:, targets.start or 0] / self.samples
        return cross

    @property
    def elastic(self) -> tuple[Array, float]:
        """The penalty as a (l |u|_1 + (1 - l)/2 |u|^2): a = f (1 + rho) (p,) and l."""
        return self.fractions * (1.0 + self.ridge), 1.0 / (1.0 + self.ridge)

    def rows(self, targets: slice) -> tuple[Any, Array]:
        """X (r, k b) and y (r,) of |y - X u|^2 / 2r, by the rows of a QR where they are fewer."""
        design, target = self.triangle if self.tall else (self.design, self.target)
        target = target[:, targets]
        count = target.shape[1]
        root = math.sqrt(len(target) * count / self.samples)
        if count > 1:
            stack: Any = np.kron if isinstance(design, np.ndarray) else sparse.kron
            design = stack(np.eye(count), design)
        if root != 1.0:
            design, target = design * root, target * root
        ready = np.asfortranarray(design) if isinstance(design, np.ndarray) else design.tocsc()
        return ready, np.ascontiguousarray(target.T).ravel()

    def blocks(self, targets: slice) -> list[IntArray]:
        """The coefficients (c,) of each block, target by target."""
        groups = np.tile(self.groups, self.target[:, targets].shape[1]).astype(np.intp)
        order = np.argsort(groups, kind="stable")
        return np.split(order, np.searchsorted(groups[order], np.arange(1, int(groups.max()) + 1)))


@dataclass(frozen=True)
class Public:
    """Base of the solvers that read arrays.

    kinds: the penalties that it takes; reads_sparse: whether it takes scipy.sparse (others get a
    dense copy, which is in their time); iterations: the most at a penalty, in its own unit.
    """

    name: ClassVar[str]
    package: ClassVar[str]
    extra: ClassVar[str] = EXTRA
    kinds: ClassVar[tuple[Kind, ...]]
    stops: ClassVar[bool] = True
    reads_sparse: ClassVar[bool] = True
    compiles: ClassVar[bool] = True  # numba's, and modules that take seconds to load
    iterations: int = 1000

    def __post_init__(self) -> None:
        integer(f"{self.name}: iterations", self.iterations, 1)

    def takes(self, penalty: Penalty) -> str:
        """The reason for refusing a penalty; empty where it is solved."""
        is_known = kind_of(penalty) in self.kinds
        return "" if is_known else f"{self.name} solves {', '.join(self.kinds)} only"

    def path(
        self, design: Design, target: Array, penalty: Penalty, alphas: Array, tolerance: Tolerance
    ) -> Array:
        """Weights (p, k, n) of columns of unit rms."""
        task = Rows.of(design, target, penalty, alphas, dense=not self.reads_sparse)
        return task.weights(partial(self.coefficients, task, tolerance or 1e-8))

    def coefficients(self, task: Rows, stop: float, targets: slice) -> Array:
        """Coefficients u (p, k b) of the b targets of a slice, target by target."""
        raise NotImplementedError


def _interpolated(knots: Array, coefficients: Array, alphas: Array) -> Array:
    """A piecewise linear path at alphas (p,): knots (b,) descending, coefficients (k, b) -> (p, k).

    Below the last knot, where a path broke off, its last coefficients are all there is.
    """
    values = np.zeros((len(alphas), len(coefficients)))
    for j in np.flatnonzero(coefficients.any(axis=1)):
        values[:, j] = np.interp(alphas, knots[::-1], coefficients[j, ::-1])
    return values


@dataclass(frozen=True)
class ScikitLearnLars(Public):
    """Breakpoints of scikit-learn's LARS (Efron et al. 2004); iterations: events per column."""

    name = "scikit-learn-lars"
    package = "sklearn"
    kinds = SINGLE[:1]
    stops = False
    reads_sparse = False
    iterations: int = 10

    def coefficients(self, task: Rows, stop: float, targets: slice) -> Array:
        linear_model: Any = import_module("sklearn.linear_model")
        ends = {
            "alpha_min": float(task.fractions[-1]),
            "max_iter": self.iterations * len(task.groups),
        }
        if task.tall:
            sums = task.cross(targets) * task.samples, task.gram * task.samples
            more = {"n_samples": task.samples, "copy_Gram": False}
            knots, _, values = linear_model.lars_path_gram(*sums, method="lasso", **more, **ends)
        else:
            rows = task.design, np.ascontiguousarray(task.target[:, targets])[:, 0]
            knots, _, values = linear_model.lars_path(*rows, Gram=None, method="lasso", **ends)
        return _interpolated(knots, values, task.fractions)


@dataclass(frozen=True)
class Spams(Public):
    """Breakpoints of the LARS of SPAMS; iterations: events per row or column."""

    name = "spams"
    package = "spams"
    extra = "spams-bin"
    kinds = SINGLE[:1]
    stops = False
    reads_sparse = False
    iterations: int = 10

    def coefficients(self, task: Rows, stop: float, targets: slice) -> Array:
        spams: Any = import_module("spams")
        root, columns = math.sqrt(task.samples), len(task.groups)
        target = np.asfortranarray(task.target[:, targets] / root)
        cross = np.asfortranarray(task.cross(targets)[:, None])
        if task.tall:
            data = {"Q": np.array(task.gram, order="F"), "q": cross}
        else:
            data = {"D": np.asfortranarray(task.design / root)}
        ends = {
            "lambda1": float(task.fractions[-1]),
            "max_length_path": self.iterations * min(task.samples, columns),
        }
        form = {"mode": spams.PENALTY, "return_reg_path": True, "numThreads": 1}
        _, steps = spams.lasso(target, **data, **form, **ends)
        breakpoints = np.asarray(steps)[:, np.any(steps, axis=0)]  # which zeros follow
        values = np.hstack([np.zeros((columns, 1)), breakpoints])
        # It returns the breakpoints without their penalties: the largest correlation there is one.
        fitted = task.gram @ values if task.tall else data["D"].T @ (data["D"] @ values)
        knots = np.minimum.accumulate(np.abs(cross - fitted).max(axis=0))
        return _interpolated(knots, values, task.fractions)


@dataclass(frozen=True)
class ScikitLearnDescent(Public):
    """Coordinate descent of scikit-learn, each point from the last; stop: of its gap."""

    name = "scikit-learn-cd"
    package = "sklearn"
    kinds = SINGLE
    iterations: int = 100_000

    def coefficients(self, task: Rows, stop: float, targets: slice) -> Array:
        linear_model: Any = import_module("sklearn.linear_model")
        (alphas, ratio), values = task.elastic, [np.zeros(len(task.groups))]
        sums: dict[str, Any] = {"precompute": False}
        if task.tall:
            sums = {
                "precompute": task.gram * task.samples,
                "Xy": task.cross(targets) * task.samples,
            }
        more = {
            "l1_ratio": ratio,
            "tol": stop,
            "max_iter": self.iterations,
            "check_input": False,
            **sums,
        }
        rows = task.design, np.ascontiguousarray(task.target[:, targets])[:, 0]
        for alpha in alphas.tolist():
            start = values[-1].copy()  # it works in place on what it is given
            _, path, _ = linear_model.enet_path(*rows, alphas=[alpha], coef_init=start, **more)
            values.append(path[:, 0].copy())
        return np.stack(values[1:])


@dataclass(frozen=True)
class Celer(Public):
    """``celer_path`` (Massias, Gramfort and Salmon 2018); stop: of its gap over |y|^2."""

    name = "celer"
    package = "celer"
    kinds = (*SINGLE, *GROUPED)
    iterations: int = 200

    def coefficients(self, task: Rows, stop: float, targets: slice) -> Array:
        package: Any = import_module("celer")
        alphas, ratio = task.elastic
        form: dict[str, Any] = {"pb": "lasso"}
        if task.kind not in SINGLE:
            groups = [block.tolist() for block in task.blocks(targets)]
            form = {"pb": "grouplasso", "groups": groups}
        ends = {"max_iter": self.iterations, "tol": stop}
        rows = task.rows(targets)
        _, coefficients, *_ = package.celer_path(
            *rows, alphas=alphas, l1_ratio=ratio, **form, **ends
        )
        values: Array = coefficients.T
        return values


@dataclass(frozen=True)
class Skglm(Public):
    """AndersonCD, GroupBCD or FISTA (Bertrand et al. 2022), each point from the last one.

    stop: of the largest violation of its optimality conditions, in the largest penalty.
    """

    name = "skglm"
    package = "skglm"
    kinds = (*SINGLE, *GROUPED, "sparse-group LASSO", "SLOPE")

    def coefficients(self, task: Rows, stop: float, targets: slice) -> Array:
        solvers, datafits = import_module("skglm.solvers"), import_module("skglm.datafits")
        penalties: Any = import_module("skglm.penalties")
        compiled = import_module("skglm.utils.jit_compilation").compiled_clone
        (design, target), (alphas, ratio) = task.rows(targets), task.elastic
        ends: dict[str, Any] = {"max_iter": self.iterations, "tol": stop}
        warm: dict[str, Any] = {"max_epochs": 50 * self.iterations, "warm_start": True}
        datafit, make = datafits.Quadratic(), penalties.L1
        if task.kind in SINGLE:
            solver: Any = solvers.AndersonCD(**ends, **warm, fit_intercept=False)
            if task.ridge:
                make = partial(penalties.L1_plus_L2, l1_ratio=ratio)
        elif task.kind == "SLOPE":
            ends["max_iter"] *= 100
            solver = solvers.FISTA(**ends, opt_strategy="fixpoint")
            make = partial(penalties.SLOPE, task.lambdas)
        else:
            blocks = task.blocks(targets)
            starts = np.concatenate([[0], np.cumsum(list(map(len, blocks)))]).astype(np.int32)
            layout = {"grp_ptr": starts, "grp_indices": np.concatenate(blocks).astype(np.int32)}
            datafit, ones = datafits.QuadraticGroup(**layout), np.ones(len(blocks))
            if task.lambdas is None:
                strategy, norms = "subdiff", partial(penalties.WeightedGroupL2, weights=ones)
            else:
                both = {"weights_groups": ones, "weights_features": task.lambdas}
                strategy, norms = "fixpoint", partial(penalties.WeightedL1GroupL2, **both)
            solver, make = (
                solvers.GroupBCD(**ends, **warm, ws_strategy=strategy),
                partial(norms, **layout),
            )
        datafit, penalty, fitted = compiled(datafit), None, np.zeros(len(target))
        values = [np.zeros(design.shape[1])]
        for alpha in alphas.tolist():
            if penalty is None or task.kind in ("elastic net", "SLOPE"):
                penalty = compiled(make(alpha))
            penalty.alpha = alpha
            last = values[-1].copy()
            values.append(solver.solve(design, target, datafit, penalty, last, fitted)[0])
            fitted = design @ values[-1]
        return np.stack(values[1:])


@dataclass(frozen=True)
class Glum(Public):
    """IRLS with descent; stop: the norm of its minimum-norm subgradient."""

    name = "glum"
    package = "glum"
    kinds = SINGLE

    def coefficients(self, task: Rows, stop: float, targets: slice) -> Array:
        package: Any = import_module("glum")
        rows, (alphas, ratio) = task.rows(targets), task.elastic
        form = {"family": "normal", "l1_ratio": ratio, "fit_intercept": False}
        ways = {"solver": "irls-cd", "warm_start": True, "copy_X": False, "check_input": False}
        ends = {"gradient_tol": stop, "max_iter": self.iterations}
        model = package.GeneralizedLinearRegressor(**form, **ways, **ends)
        return np.stack(
            [model.set_params(alpha=a).fit(*rows).coef_.copy() for a in alphas.tolist()]
        )


@dataclass(frozen=True)
class SortedL1(Public):
    """``Slope.path`` (Larsson et al. 2023), the whole of it; stop: of its relative gap."""

    name = "sortedl1"
    package = "sortedl1"
    kinds = ("SLOPE", "LASSO")
    iterations: int = 100_000

    def coefficients(self, task: Rows, stop: float, targets: slice) -> Array:
        package: Any = import_module("sortedl1")
        design, target = task.rows(targets)
        columns = design.shape[1]
        lambdas = np.ones(columns) if task.lambdas is None else task.lambdas
        model = package.Slope(lam=lambdas, fit_intercept=False, tol=stop, max_iter=self.iterations)
        whole = {"tol_dev_change": 0.0, "tol_dev_ratio": 1.0, "max_clusters": columns + 1}
        path = model.path(design, target, alphas=task.fractions, **whole)
        return np.asarray(path.coefs).reshape(columns, -1).T


class Osqp(Cvxpy):
    """OSQP (Stellato et al. 2020): quadratic programs, by operator splitting."""

    name = "osqp"
    package = "osqp"
    tolerances = EPS
    more: ClassVar[Mapping[str, Any]] = {"max_iter": 50_000, "polishing": True}
    cones = False


class Scs(Cvxpy):
    """SCS (O'Donoghue et al. 2016): cones, by operator splitting."""

    name = "scs"
    package = "scs"
    tolerances = EPS
    more: ClassVar[Mapping[str, Any]] = {"max_iters": 50_000}


class Piqp(Cvxpy):
    """PIQP (Schwan et al. 2023): quadratic programs, by an interior point."""

    name = "piqp"
    package = "piqp"
    extra = EXTRA
    tolerances = EPS
    cones = False


class Daqp(Cvxpy):
    """DAQP (Arnstrom et al. 2022): quadratic programs, by an active set."""

    name = "daqp"
    package = "daqp"
    extra = EXTRA
    cones = False


class ProxQp(Cvxpy):
    """ProxQP (Bambade et al. 2022): quadratic programs, by an augmented Lagrangian."""

    name = "proxqp"
    package = "proxsuite"
    tolerances = EPS
    cones = False


class Ecos(Cvxpy):
    """ECOS (Domahidi et al. 2013): cones, by an interior point."""

    name = "ecos"
    package = "ecos"
    tolerances = ("abstol", "reltol", "feastol")


class Highs(Cvxpy):
    """HiGHS: quadratic programs, by an active set."""

    name = "highs"
    package = "highspy"
    cones = False


class Gurobi(Cvxpy):
    """Gurobi, with a licence of its own."""

    name = "gurobi"
    package = "gurobipy"


class Qoco(Cvxpy):
    """QOCO (Chari and Acikmese 2025): cones, by an interior point."""

    name = "qoco"
    package = "qoco"


class Cvxopt(Cvxpy):
    """CVXOPT: cones, by an interior point."""

    name = "cvxopt"
    package = "cvxopt"


class Mosek(Cvxpy):
    """MOSEK, with a licence of its own."""

    name = "mosek"
    package = "mosek"
