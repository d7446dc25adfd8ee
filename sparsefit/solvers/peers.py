"""Public solvers, a function each, and the problem in their common form.

With omega_j the weight of column j's block, u_j = omega_j v_j and targets divided by the largest
alpha, a penalty of weighted norms is one with weights of one,

    minimise over u:   1/(2m) |y - X u|^2 + f (sum_g |u_g| + sum_j lambda_j |u_j| + rho/2 |u|^2),

X = Z diag(1/omega), f = alpha / alpha_1. Targets that share the norms of their groups are one long
target with a block-diagonal design. Where samples are many the rows are the triangle of a QR of
[X, y], or X'X/m is formed, in the time of the solver that uses it. Tolerances have the meaning of
each solver; weights are compared by the caller's certificate.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from typing import Any, Literal, TypeAlias

import numpy as np
from scipy import sparse

from sparsefit.arrays import Array, IntArray
from sparsefit.cached import cached_property
from sparsefit.errors import integer
from sparsefit.regression.backend import Tolerance
from sparsefit.regression.design import Design
from sparsefit.regression.group_penalties import GroupNorms, NestedNorms
from sparsefit.regression.losses import SQUARES
from sparsefit.regression.ordered_penalties import SortedNorm
from sparsefit.regression.penalties import AbsoluteValues, Penalty

Kind: TypeAlias = Literal[
    "LASSO", "elastic net", "group-LASSO", "joint group-LASSO", "sparse-group LASSO", "SLOPE", ""
]
"""The kinds of penalties that public solvers solve; empty for any other."""
SINGLE: tuple[Kind, ...] = ("LASSO", "elastic net")
GROUPED: tuple[Kind, ...] = ("group-LASSO", "joint group-LASSO")


def kind_of(penalty: Penalty) -> Kind:
    """The kind of a penalty."""
    if penalty.loss != SQUARES or (penalty.ridge and type(penalty) is not AbsoluteValues):
        return ""
    if isinstance(penalty, NestedNorms):
        plain = type(penalty.inner) is AbsoluteValues and not penalty.coupled
        return "sparse-group LASSO" if plain else ""
    if type(penalty) is AbsoluteValues:
        even = np.ptp(penalty.weights) == 0.0
        return "LASSO" if not penalty.ridge else "elastic net" if even else ""
    if type(penalty) is GroupNorms:
        return "joint group-LASSO" if penalty.coupled else "group-LASSO"
    return "SLOPE" if type(penalty) is SortedNorm else ""


def matrix_of(design: Design) -> Any:
    """Z (m, k) in columns of unit rms: an array in Fortran order, or scipy's CSC.

    A design in memory whose columns have unit rms to rounding is not copied.
    """
    unscaled = bool(np.all(np.abs(design.rms - 1.0) <= 1e-13))
    if design.kind == "sparse" and design.direction is None:
        return design.csc if unscaled else (design.csc @ sparse.diags(1.0 / design.rms)).tocsc()
    if unscaled and design.in_memory and design.weights is None and design.direction is None:
        return np.asfortranarray(design.source)
    return design.columns(np.arange(design.shape[1]))


@dataclass(frozen=True, eq=False)
class Task:
    """Targets (m, n) and the design X (m, k), dense in Fortran order or CSC, at fractions f (p,).

    lambdas (k,): weights of single coefficients of the sparse-group LASSO, or the sequence of
    SLOPE. ridge: rho. Targets solved separately share X'X and the QR, computed and charged once.
    """

    design: Any
    target: Array
    groups: IntArray
    fractions: Array
    kind: Kind
    ridge: float = 0.0
    lambdas: Array | None = None

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


def solved_in_parts(
    call: Callable[[Task, slice], Array],
    design: Design,
    target: Array,
    penalty: Penalty,
    alphas: Array,
    *,
    dense: bool = False,
) -> Array:
    """Weights V (p, k, n) at alphas (p,), apart for targets that the penalty does not couple.

    call: gives weights (p, k b), target by target, of a task and its b targets, a slice of n.
    penalty: one that has a `kind_of`; dense: whether a sparse design is handed over as an array.
    Columns that are zero throughout are left out: some solvers divide by a group's norm.
    """
    live, unit, lambdas = np.flatnonzero(design.squares > 0), float(alphas[0]), None
    columns, omega = penalty.columns, np.ones(len(live))
    penalty = penalty if len(live) == columns else penalty.restricted(live) or penalty
    if isinstance(penalty, SortedNorm):
        lambdas = penalty.weights
    elif isinstance(penalty, NestedNorms):
        omega = penalty.outer.weights[penalty.blocks]
        lambdas = penalty.inner.weights / omega
    elif isinstance(penalty, AbsoluteValues | GroupNorms):
        omega = penalty.weights[penalty.blocks]
    matrix = matrix_of(design)
    matrix = matrix if len(live) == columns else matrix[:, live]
    if np.any(omega != 1.0):
        is_array = isinstance(matrix, np.ndarray)
        scaled = matrix / omega if is_array else matrix @ sparse.diags(1.0 / omega)
        matrix = np.asfortranarray(scaled) if is_array else scaled.tocsc()
    if dense and not isinstance(matrix, np.ndarray):
        matrix = matrix.toarray(order="F")
    ridge = unit * penalty.ridge / float(omega[0]) ** 2
    kind, count = kind_of(penalty), target.shape[1]
    task = Task(matrix, target / unit, penalty.blocks, alphas / unit, kind, ridge, lambdas)
    apart = [slice(None)] if penalty.coupled else [slice(t, t + 1) for t in range(count)]
    parts = [call(task, targets).reshape(len(alphas), -1, len(omega)) for targets in apart]
    weights = np.zeros((len(alphas), columns, count))
    weights[:, live] = np.concatenate(parts, axis=1).transpose(0, 2, 1) * (unit / omega)[:, None]
    return weights


def _interpolated(knots: Array, coefficients: Array, alphas: Array) -> Array:
    """A piecewise linear path at alphas (p,): knots (b,) descending, coefficients (k, b) -> (p, k).

    Below the last knot, where a path broke off, its last coefficients are all there is.
    """
    values = np.zeros((len(alphas), len(coefficients)))
    for j in np.flatnonzero(coefficients.any(axis=1)):
        values[:, j] = np.interp(alphas, knots[::-1], coefficients[j, ::-1])
    return values


def by_scikit_learn_lars(task: Task, targets: slice, stop: float, iterations: int) -> Array:
    """Breakpoints of scikit-learn's LARS (Efron et al. 2004); iterations: events per column."""
    linear_model: Any = import_module("sklearn.linear_model")
    ends = {"alpha_min": float(task.fractions[-1]), "max_iter": iterations * len(task.groups)}
    if task.tall:
        sums = task.cross(targets) * task.samples, task.gram * task.samples
        more = {"n_samples": task.samples, "copy_Gram": False}
        knots, _, values = linear_model.lars_path_gram(*sums, method="lasso", **more, **ends)
    else:
        rows = task.design, np.ascontiguousarray(task.target[:, targets])[:, 0]
        knots, _, values = linear_model.lars_path(*rows, Gram=None, method="lasso", **ends)
    return _interpolated(knots, values, task.fractions)


def by_spams(task: Task, targets: slice, stop: float, iterations: int) -> Array:
    """Breakpoints of the LARS of SPAMS; iterations: events per row or column."""
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
        "max_length_path": iterations * min(task.samples, columns),
    }
    form = {"mode": spams.PENALTY, "return_reg_path": True, "numThreads": 1}
    _, steps = spams.lasso(target, **data, **form, **ends)
    breakpoints = np.asarray(steps)[:, np.any(steps, axis=0)]  # which zeros follow
    values = np.hstack([np.zeros((columns, 1)), breakpoints])
    # It returns the breakpoints without their penalties: the largest correlation there is one.
    fitted = task.gram @ values if task.tall else data["D"].T @ (data["D"] @ values)
    knots = np.minimum.accumulate(np.abs(cross - fitted).max(axis=0))
    return _interpolated(knots, values, task.fractions)


def by_scikit_learn_cd(task: Task, targets: slice, stop: float, iterations: int) -> Array:
    """Coordinate descent of scikit-learn, each point from the last; stop: of its gap."""
    linear_model: Any = import_module("sklearn.linear_model")
    (alphas, ratio), values = task.elastic, [np.zeros(len(task.groups))]
    sums: dict[str, Any] = {"precompute": False}
    if task.tall:
        sums = {"precompute": task.gram * task.samples, "Xy": task.cross(targets) * task.samples}
    more = {"l1_ratio": ratio, "tol": stop, "max_iter": iterations, "check_input": False, **sums}
    rows = task.design, np.ascontiguousarray(task.target[:, targets])[:, 0]
    for alpha in alphas.tolist():
        start = values[-1].copy()  # it works in place on what it is given
        _, path, _ = linear_model.enet_path(*rows, alphas=[alpha], coef_init=start, **more)
        values.append(path[:, 0].copy())
    return np.stack(values[1:])


def by_celer(task: Task, targets: slice, stop: float, iterations: int) -> Array:
    """``celer_path`` (Massias, Gramfort and Salmon 2018); stop: of its gap over |y|^2."""
    package: Any = import_module("celer")
    alphas, ratio = task.elastic
    form: dict[str, Any] = {"pb": "lasso"}
    if task.kind not in SINGLE:
        groups = [block.tolist() for block in task.blocks(targets)]
        form = {"pb": "grouplasso", "groups": groups}
    ends = {"max_iter": iterations, "tol": stop}
    rows = task.rows(targets)
    _, coefficients, *_ = package.celer_path(*rows, alphas=alphas, l1_ratio=ratio, **form, **ends)
    values: Array = coefficients.T
    return values


def by_glum(task: Task, targets: slice, stop: float, iterations: int) -> Array:
    """IRLS with descent; stop: the norm of its minimum-norm subgradient."""
    package: Any = import_module("glum")
    rows, (alphas, ratio) = task.rows(targets), task.elastic
    form = {"family": "normal", "l1_ratio": ratio, "fit_intercept": False}
    ways = {"solver": "irls-cd", "warm_start": True, "copy_X": False, "check_input": False}
    ends = {"gradient_tol": stop, "max_iter": iterations}
    model = package.GeneralizedLinearRegressor(**form, **ways, **ends)
    return np.stack([model.set_params(alpha=a).fit(*rows).coef_.copy() for a in alphas.tolist()])


def by_sortedl1(task: Task, targets: slice, stop: float, iterations: int) -> Array:
    """``Slope.path`` (Larsson et al. 2023), the whole of it; stop: of its relative gap."""
    package: Any = import_module("sortedl1")
    design, target = task.rows(targets)
    columns = design.shape[1]
    lambdas = np.ones(columns) if task.lambdas is None else task.lambdas
    model = package.Slope(lam=lambdas, fit_intercept=False, tol=stop, max_iter=iterations)
    whole = {"tol_dev_change": 0.0, "tol_dev_ratio": 1.0, "max_clusters": columns + 1}
    path = model.path(design, target, alphas=task.fractions, **whole)
    return np.asarray(path.coefs).reshape(columns, -1).T


def by_skglm(task: Task, targets: slice, stop: float, iterations: int) -> Array:
    """AndersonCD, GroupBCD or FISTA (Bertrand et al. 2022), each point from the last one.

    stop: of the largest violation of its optimality conditions, in the largest penalty.
    """
    solvers, datafits = import_module("skglm.solvers"), import_module("skglm.datafits")
    penalties: Any = import_module("skglm.penalties")
    compiled = import_module("skglm.utils.jit_compilation").compiled_clone
    (design, target), (alphas, ratio) = task.rows(targets), task.elastic
    ends: dict[str, Any] = {"max_iter": iterations, "tol": stop}
    warm: dict[str, Any] = {"max_epochs": 50 * iterations, "warm_start": True}
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
class Peer:
    """A public solver, a row of `PEERS`; its setting is ``iterations``.

    solved: (task, targets, stop, iterations) -> coefficients u (p, k b) of b targets, target by
    target; package: the module it needs, and extra, what pip installs for it; kinds: the penalties
    that it takes; iterations: the most at a penalty, in its own unit; stops: whether there is a
    tolerance to set; reads_sparse: whether it takes scipy.sparse (others get a dense copy, which is
    in their time).
    """

    name: str
    solved: Callable[..., Array]
    package: str
    kinds: tuple[Kind, ...]
    iterations: int = 1000
    stops: bool = True
    reads_sparse: bool = True
    extra: str = "'sparsefit[peers]'"

    def __post_init__(self) -> None:
        integer(f"{self.name}: iterations", self.iterations, 1)

    def takes(self, penalty: Penalty) -> str:
        """The reason for refusing a penalty; empty where it is solved."""
        is_known = kind_of(penalty) in self.kinds
        return "" if is_known else f"{self.name} solves {', '.join(self.kinds)} only"

    def path(
        self, design: Design, target: Array, penalty: Penalty, alphas: Array, tolerance: Tolerance
    ) -> Array:
        """Weights (p, k, n) of columns of unit rms; see `registry`."""
        call = partial(self.solved, stop=tolerance or 1e-8, iterations=self.iterations)
        return solved_in_parts(call, design, target, penalty, alphas, dense=not self.reads_sparse)


_LISTED = (
    Peer("scikit-learn-lars", by_scikit_learn_lars, "sklearn", SINGLE[:1], 10, False, False),
    Peer("spams", by_spams, "spams", SINGLE[:1], 10, False, False, "spams-bin"),
    Peer("scikit-learn-cd", by_scikit_learn_cd, "sklearn", SINGLE, 100_000),
    Peer("celer", by_celer, "celer", (*SINGLE, *GROUPED), 200),
    Peer("skglm", by_skglm, "skglm", (*SINGLE, *GROUPED, "sparse-group LASSO", "SLOPE")),
    Peer("glum", by_glum, "glum", SINGLE),
    Peer("sortedl1", by_sortedl1, "sortedl1", ("SLOPE", "LASSO"), 100_000),
)
PEERS: Mapping[str, Peer] = {peer.name: peer for peer in _LISTED}
"""The public solvers of penalised least squares by name."""
