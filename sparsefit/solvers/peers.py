"""Public solvers as one table, and a problem in the form that they take it in.

With omega_j the weight of column j's block, u_j = omega_j v_j and targets divided by the largest
alpha, a penalty of weighted norms is one with weights of one,

    minimise over u:   1/(2m) |y - X u|^2 + f (sum_g |u_g| + sum_j lambda_j |u_j| + rho/2 |u|^2),

X = Z diag(1/omega), f = alpha / alpha_1. Targets that share the norms of their groups are one long
target with a block-diagonal design. Where samples are many the rows are the triangle of a QR of
[X, y], or X'X/m is formed: that is in the time of the solver that asks. Each stops at a tolerance
of its own meaning, and the caller's certificate judges them all.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from types import MappingProxyType
from typing import Any, Literal, TypeAlias

import numpy as np
from scipy import sparse

from sparsefit.arrays import Array, IntArray
from sparsefit.cached import cached_property
from sparsefit.errors import InputError, integer_setting
from sparsefit.regression.design import Design
from sparsefit.regression.group_penalties import GroupNorms, NestedNorms
from sparsefit.regression.losses import SQUARES
from sparsefit.regression.ordered_penalties import SortedNorm
from sparsefit.regression.penalties import AbsoluteValues, Penalty

Kind: TypeAlias = Literal[
    "LASSO", "elastic net", "group-LASSO", "joint group-LASSO", "sparse-group LASSO", "SLOPE", ""
]
"""The families of penalties that public solvers know; empty for any other."""
TALL = 1.5  # rows per column from which a QR or X'X saves more than it costs
SINGLE: tuple[Kind, ...] = ("LASSO", "elastic net")
GROUPED: tuple[Kind, ...] = ("group-LASSO", "joint group-LASSO")
SORTED: tuple[Kind, ...] = ("SLOPE", "LASSO")
EVERY: tuple[Kind, ...] = (*SINGLE, *GROUPED, "sparse-group LASSO", "SLOPE")


def kind_of(penalty: Penalty) -> Kind:
    """The family that a penalty belongs to."""
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
    rms = design.rms
    unscaled = bool(np.all(np.abs(rms - 1.0) <= 1e-13))
    if design.direction is not None:
        return design.columns(np.arange(design.shape[1]))
    if design.kind == "sparse":
        return design.csc if unscaled else (design.csc @ sparse.diags(1.0 / rms)).tocsc()
    if design.in_memory and design.weights is None:
        return np.asfortranarray(design.source if unscaled else design.source / rms)
    return design.columns(np.arange(design.shape[1]))


@dataclass(frozen=True, eq=False)
class Timed:
    """Weights (p, k, n) of a solver that keeps its own clock: seconds of wall and CPU [s]."""

    weights: Array
    wall: float
    cpu: float


@dataclass(frozen=True, eq=False)
class Whole:
    """X (m, k), dense in Fortran order or scipy CSC, with all targets (m, n), and what these share.

    Targets that are solved apart share X'X and a QR: each is formed once, and charged once.
    """

    design: Any
    target: Array

    @property
    def tall(self) -> bool:
        """Whether X is dense and its rows are many."""
        (m, k), n = self.design.shape, self.target.shape[1]
        return isinstance(self.design, np.ndarray) and m > TALL * (k + n)

    @cached_property
    def gram(self) -> Array:
        """X'X/m (k, k), dense."""
        gram = self.design.T @ self.design / len(self.target)
        dense: Array = gram if isinstance(gram, np.ndarray) else gram.toarray()
        return dense

    @cached_property
    def triangle(self) -> tuple[Array, Array]:
        """X and the targets as the rows of a QR of both, which keeps every inner product."""
        rows: Any = np.linalg.qr(np.hstack([self.design, self.target]), mode="r")
        return rows[:, : self.design.shape[1]], rows[:, self.design.shape[1] :]


@dataclass(frozen=True, eq=False)
class Task:
    """Targets y (m, b) that are solved together, at fractions f (p,), with the design X (m, k).

    lambdas (k,): weights of single coefficients of the sparse-group LASSO, or the sequence of
    SLOPE. ridge: rho.
    """

    whole: Whole
    targets: slice
    groups: IntArray
    fractions: Array
    kind: Kind
    ridge: float = 0.0
    lambdas: Array | None = None

    @property
    def target(self) -> Array:
        """The targets (m, b)."""
        return np.ascontiguousarray(self.whole.target[:, self.targets])

    @property
    def samples(self) -> int:
        """The number m of samples."""
        return len(self.whole.target)

    @property
    def elastic(self) -> tuple[Array, float]:
        """The penalty as a (l |u|_1 + (1 - l)/2 |u|^2): a = f (1 + rho) (p,) and l."""
        return self.fractions * (1.0 + self.ridge), 1.0 / (1.0 + self.ridge)

    def gram(self) -> Array:
        """X'X/m (k, k), dense; a copy, as some work in place."""
        return self.whole.gram.copy()

    def cross(self) -> Array:
        """X'y/m (k,) of the first of the targets."""
        cross: Array = self.whole.design.T @ self.target[:, 0] / self.samples
        return cross

    def rows(self) -> tuple[Any, Array]:
        """X (r, k b) and y (r,) of |y - X u|^2 / 2r, by the rows of a QR where they are fewer."""
        design, target = self.whole.design, self.target
        if self.whole.tall:
            design, target = self.whole.triangle
            target = target[:, self.targets]
        count = target.shape[1]
        root = math.sqrt(len(target) * count / self.samples)
        if count > 1:
            stack: Any = np.kron if isinstance(design, np.ndarray) else sparse.kron
            design = stack(np.eye(count), design)
        if root != 1.0:
            design, target = design * root, target * root
        ready = np.asfortranarray(design) if isinstance(design, np.ndarray) else design.tocsc()
        return ready, np.ascontiguousarray(target.T).ravel()

    @property
    def blocks(self) -> list[IntArray]:
        """The coefficients (c,) of each block, target by target."""
        groups = np.tile(self.groups, self.target.shape[1]).astype(np.intp)
        order = np.argsort(groups, kind="stable")
        return np.split(order, np.searchsorted(groups[order], np.arange(1, int(groups.max()) + 1)))


def solved_in_parts(
    call: Callable[[Task], Array | Timed],
    design: Design,
    target: Array,
    penalty: Penalty,
    alphas: Array,
    *,
    dense: bool = False,
) -> Array | Timed:
    """Weights V (p, k, n) by a call that gives u (p, k b) of a part; its time, where it says it.

    penalty: one that has a `kind_of`; ``dense``: a sparse design is handed over as an array.
    """
    unit, omega, lambdas = float(alphas[0]), np.ones(penalty.columns), None
    if isinstance(penalty, SortedNorm):
        lambdas = penalty.weights
    elif isinstance(penalty, NestedNorms):
        omega = penalty.outer.weights[penalty.blocks]
        lambdas = penalty.inner.weights / omega
    elif isinstance(penalty, AbsoluteValues | GroupNorms):
        omega = penalty.weights[penalty.blocks]
    matrix = matrix_of(design)
    if np.any(omega != 1.0):
        is_array = isinstance(matrix, np.ndarray)
        scaled = matrix / omega if is_array else matrix @ sparse.diags(1.0 / omega)
        matrix = np.asfortranarray(scaled) if is_array else scaled.tocsc()
    if dense and not isinstance(matrix, np.ndarray):
        matrix = matrix.toarray(order="F")
    ridge = unit * penalty.ridge / float(omega[0]) ** 2
    whole, count = Whole(matrix, target / unit), target.shape[1]
    shared = (penalty.blocks, alphas / unit, kind_of(penalty), ridge, lambdas)
    apart = [slice(None)] if penalty.coupled else [slice(t, t + 1) for t in range(count)]
    answers = [call(Task(whole, targets, *shared)) for targets in apart]
    timed = [each for each in answers if isinstance(each, Timed)]
    raw = [each.weights if isinstance(each, Timed) else each for each in answers]
    stacked = np.concatenate([u.reshape(len(alphas), -1, len(omega)) for u in raw], axis=1)
    weights: Array = stacked.transpose(0, 2, 1) * (unit / omega)[:, None]
    if not timed:
        return weights
    return Timed(weights, sum(each.wall for each in timed), sum(each.cpu for each in timed))


@dataclass(frozen=True)
class Package:
    """A public solver: the module it needs, the penalties it takes, and its call.

    call(part, tolerance, iterations) gives coefficients u (p, k b), target by target; tolerance:
    None where none is asked for. extra: what pip installs for it; form: how the problem is handed
    over, in words; stops: whether there is a tolerance to set; reads_sparse: whether it takes
    scipy.sparse (others get a dense copy, which is in their time).
    """

    call: Callable[[Task, float | None, int], Array]
    package: str
    kinds: tuple[Kind, ...]
    form: str
    iterations: int
    extra: str = "'sparsefit[peers]'"
    stops: bool = True
    reads_sparse: bool = False


@dataclass(frozen=True)
class Peer:
    """A solver of `PACKAGES`. iterations: the most that it makes at a penalty, in its own unit."""

    name: str
    iterations: int = 0

    def __post_init__(self) -> None:
        integer_setting(self.name, "iterations", self.iterations, least=0)

    def takes(self, penalty: Penalty) -> str:
        """The reason why it does not solve this penalty; empty where it does."""
        kinds = PACKAGES[self.name].kinds
        return "" if kind_of(penalty) in kinds else f"{self.name} solves {', '.join(kinds)} only"

    def path(
        self,
        design: Design,
        target: Array,
        penalty: Penalty,
        alphas: Array,
        tolerance: float | None,
    ) -> Array | Timed:
        """Weights (p, k, n) of columns of unit rms; see `registry`. Raises InputError."""
        if reason := self.takes(penalty):
            raise InputError(reason)
        package = PACKAGES[self.name]
        most = self.iterations or package.iterations
        return solved_in_parts(
            lambda part: package.call(part, tolerance, most),
            *(design, target, penalty, alphas),
            dense=not package.reads_sparse,
        )


def _scikit_lars(part: Task, tolerance: float | None, iterations: int) -> Array:
    """Breakpoints of LARS (Efron et al. 2004) on X'X where samples are many, else on X."""
    linear_model: Any = import_module("sklearn.linear_model")
    lowest, most = float(part.fractions[-1]), iterations * len(part.groups)
    shared = {"method": "lasso", "alpha_min": lowest, "max_iter": most}
    if part.whole.tall:
        knots, _, values = linear_model.lars_path_gram(
            *(part.cross() * part.samples, part.gram() * part.samples),
            **shared, n_samples=part.samples, copy_Gram=False,
        )  # fmt: skip
    else:
        design, target = part.whole.design, part.target[:, 0]
        knots, _, values = linear_model.lars_path(design, target, Gram=None, **shared)
    return _interpolated(knots, values, part.fractions).T


def _spams(part: Task, tolerance: float | None, iterations: int) -> Array:
    """Breakpoints of the LARS of SPAMS, on X'X/m where samples are many, else on X."""
    spams: Any = import_module("spams")
    root, columns = math.sqrt(part.samples), len(part.groups)
    target = np.asfortranarray(part.target[:, :1] / root)
    cross = np.asfortranarray(part.cross()[:, None])
    data: dict[str, Any]
    if part.whole.tall:
        data = {"Q": np.asfortranarray(part.gram()), "q": cross}
    else:
        data = {"D": np.asfortranarray(part.whole.design / root)}
    _, steps = spams.lasso(
        target, **data, return_reg_path=True, lambda1=float(part.fractions[-1]),
        mode=spams.PENALTY, max_length_path=iterations * min(part.samples, columns), numThreads=1,
    )  # fmt: skip
    values = np.hstack([np.zeros((columns, 1)), np.asarray(steps)])
    # It returns the breakpoints without their penalties: the largest correlation there is one.
    fitted = data["Q"] @ values if "Q" in data else data["D"].T @ (data["D"] @ values)
    knots = np.minimum.accumulate(np.abs(cross - fitted).max(axis=0))
    return _interpolated(knots, values, part.fractions).T


def _interpolated(knots: Array, coefficients: Array, alphas: Array) -> Array:
    """A piecewise linear path at alphas (p,): knots (b,) descending, coefficients (k, b) -> (k, p).

    Below the last knot, where a path broke off, its last coefficients are all there is.
    """
    if len(knots) == 1:
        return np.repeat(coefficients, len(alphas), axis=1)
    alphas = np.clip(alphas, knots[-1], knots[0])
    upper = np.clip(np.searchsorted(-knots, -alphas, side="left"), 1, len(knots) - 1)
    width = knots[upper - 1] - knots[upper]
    share = np.where(width > 0, (knots[upper - 1] - alphas) / np.where(width > 0, width, 1.0), 1.0)
    between: Array = coefficients[:, upper - 1] * (1 - share) + coefficients[:, upper] * share
    return between


def _scikit_descent(part: Task, tolerance: float | None, iterations: int) -> Array:
    """Coordinate descent of scikit-learn, each point from the last; tolerance: of its gap."""
    linear_model: Any = import_module("sklearn.linear_model")
    form: dict[str, Any] = {"precompute": False}
    if part.whole.tall:
        form = {"precompute": part.gram() * part.samples, "Xy": part.cross() * part.samples}
    alphas, ratio = part.elastic
    values = [np.zeros(len(part.groups))]
    for alpha in alphas.tolist():
        # It works in place on what it is given.
        _, coefficients, _ = linear_model.enet_path(
            part.whole.design, part.target[:, 0], l1_ratio=ratio, alphas=[alpha],
            coef_init=values[-1].copy(), tol=tolerance or 1e-8, max_iter=iterations,
            check_input=False, **form,
        )  # fmt: skip
        values.append(coefficients[:, 0].copy())
    return np.stack(values[1:])


def _celer(part: Task, tolerance: float | None, iterations: int) -> Array:
    """``celer_path`` (Massias, Gramfort and Salmon 2018); tolerance: of its gap over |y|^2."""
    package: Any = import_module("celer")
    alphas, ratio = part.elastic
    single = part.kind in SINGLE
    _, coefficients, *_ = package.celer_path(
        *part.rows(), "lasso" if single else "grouplasso", alphas=alphas, l1_ratio=ratio,
        groups=None if single else [block.tolist() for block in part.blocks],
        max_iter=iterations, tol=tolerance or 1e-8,
    )  # fmt: skip
    values: Array = coefficients.T
    return values


def _glum(part: Task, tolerance: float | None, iterations: int) -> Array:
    """The IRLS with descent of glum; tolerance: the norm of its minimum-norm subgradient."""
    package: Any = import_module("glum")
    (design, target), (alphas, ratio) = part.rows(), part.elastic
    model = package.GeneralizedLinearRegressor(
        l1_ratio=ratio, fit_intercept=False, family="normal", solver="irls-cd", warm_start=True,
        gradient_tol=tolerance or 1e-8, max_iter=iterations, copy_X=False, check_input=False,
    )  # fmt: skip
    values = []
    for alpha in alphas.tolist():
        model.set_params(alpha=alpha).fit(design, target)
        values.append(np.array(model.coef_))
    return np.stack(values)


def _sortedl1(part: Task, tolerance: float | None, iterations: int) -> Array:
    """``Slope.path`` of sortedl1 (Larsson et al. 2023); tolerance: of its relative gap."""
    package: Any = import_module("sortedl1")
    design, target = part.rows()
    lambdas = np.ones(design.shape[1]) if part.lambdas is None else part.lambdas
    model = package.Slope(
        lam=lambdas, fit_intercept=False, tol=tolerance or 1e-8, max_iter=iterations
    )
    path = model.path(  # the whole path, however little its last points explain
        *(design, target), alphas=part.fractions, tol_dev_change=0.0, tol_dev_ratio=1.0,
        max_clusters=design.shape[1] + 1,
    )  # fmt: skip
    values: Array = np.asarray(path.coefs).reshape(design.shape[1], -1).T
    return values


def _skglm(part: Task, tolerance: float | None, iterations: int) -> Array:
    """AndersonCD, GroupBCD or FISTA of skglm (Bertrand et al. 2022), each point from the last one.

    tolerance: of the largest violation of its optimality conditions, in the largest penalty.
    """
    solvers, datafits = import_module("skglm.solvers"), import_module("skglm.datafits")
    penalties: Any = import_module("skglm.penalties")
    compiled = import_module("skglm.utils.jit_compilation").compiled_clone
    (design, target), (alphas, ratio) = part.rows(), part.elastic
    stop: dict[str, Any] = {"max_iter": iterations, "tol": tolerance or 1e-8}
    warm: dict[str, Any] = {"max_epochs": 50 * iterations, "warm_start": True}
    datafit, blocks = datafits.Quadratic(), part.blocks
    starts = np.concatenate([[0], np.cumsum(list(map(len, blocks)))]).astype(np.int32)
    layout, ones = (starts, np.concatenate(blocks).astype(np.int32)), np.ones(len(blocks))
    make: Callable[[float], Any]
    if part.kind in SINGLE:
        solver: Any = solvers.AndersonCD(**stop, **warm, fit_intercept=False)
        make = partial(penalties.L1_plus_L2, l1_ratio=ratio) if part.ridge else penalties.L1
    elif part.kind == "SLOPE":
        stop["max_iter"] *= 100
        solver = solvers.FISTA(**stop, opt_strategy="fixpoint")
        make = partial(penalties.SLOPE, part.lambdas)
    else:
        strategy = "subdiff" if part.lambdas is None else "fixpoint"
        solver = solvers.GroupBCD(**stop, **warm, ws_strategy=strategy)
        datafit = datafits.QuadraticGroup(*layout)
        parts = (ones,) if part.lambdas is None else (ones, part.lambdas)
        norms = "WeightedGroupL2" if part.lambdas is None else "WeightedL1GroupL2"

        def make(alpha: float) -> Any:
            return getattr(penalties, norms)(alpha, *parts, *layout)

    datafit, penalty, fitted = compiled(datafit), None, np.zeros(len(target))
    values = [np.zeros(design.shape[1])]
    for alpha in alphas.tolist():
        if penalty is None or part.kind in ("elastic net", "SLOPE"):
            penalty = compiled(make(alpha))
        penalty.alpha = alpha
        values.append(solver.solve(design, target, datafit, penalty, values[-1].copy(), fitted)[0])
        fitted = design @ values[-1]
    return np.stack(values[1:])


ON_GRAM = "on Z'Z, or on the rows where they are fewer"
ON_ROWS = "on the rows, or on the triangle of a QR where they are many"
PACKAGES: Mapping[str, Package] = MappingProxyType(
    {
        "scikit-learn-lars": Package(
            _scikit_lars, "sklearn", ("LASSO",), f"lars_path {ON_GRAM}", 10, stops=False
        ),
        "spams": Package(
            _spams, "spams", ("LASSO",), f"LARS {ON_GRAM}", 10, extra="spams-bin", stops=False
        ),
        "scikit-learn-cd": Package(
            _scikit_descent, "sklearn", SINGLE, f"enet_path {ON_GRAM}", 100_000, reads_sparse=True
        ),
        "celer": Package(
            _celer, "celer", (*SINGLE, *GROUPED), f"celer_path {ON_ROWS}", 200, reads_sparse=True
        ),
        "skglm": Package(
            _skglm,
            "skglm",
            EVERY,
            f"AndersonCD, GroupBCD, FISTA {ON_ROWS}",
            1000,
            reads_sparse=True,
        ),
        "glum": Package(
            _glum, "glum", SINGLE, f"its regressor, normal {ON_ROWS}", 1000, reads_sparse=True
        ),
        "sortedl1": Package(
            _sortedl1, "sortedl1", SORTED, f"Slope.path {ON_ROWS}", 100_000, reads_sparse=True
        ),
    }
)
"""The public solvers by name; iterations: per column of the events of LARS, else of its own."""
