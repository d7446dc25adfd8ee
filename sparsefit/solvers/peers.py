"""A problem in the form that public solvers take it in, and the base of their classes.

With omega_j the weight of column j's block, u_j = omega_j v_j and targets divided by the largest
alpha, a penalty of weighted norms is one with weights of one,

    minimise over u:   1/(2m) |y - X u|^2 + f (sum_g |u_g| + sum_j lambda_j |u_j| + rho/2 |u|^2),

X = Z diag(1/omega), f = alpha / alpha_1. Targets that share the norms of their groups are one long
target with a block-diagonal design. Where samples are many the rows are the triangle of a QR of
[X, y], or X'X/m is formed: that is in the time of the solver that asks.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, TypeAlias

import numpy as np
from scipy import sparse

from sparsefit.arrays import Array, IntArray
from sparsefit.cached import cached_property
from sparsefit.errors import InputError
from sparsefit.regression.design import Design, RowDesign, SparseDesign
from sparsefit.regression.group_penalties import GroupNorms, NestedNorms
from sparsefit.regression.losses import SQUARES
from sparsefit.regression.ordered_penalties import SortedNorm
from sparsefit.regression.penalties import AbsoluteValues, Penalty

Kind: TypeAlias = Literal[
    "LASSO", "elastic net", "group-LASSO", "joint group-LASSO", "sparse-group LASSO", "SLOPE", ""
]
"""The families of penalties that public solvers know; empty for any other."""
TALL = 1.5  # rows per column from which a QR or X'X saves more than it costs


def kind_of(penalty: Penalty) -> Kind:
    """The family that a penalty belongs to."""
    kind = type(penalty)
    if penalty.loss != SQUARES:
        return ""
    if kind is AbsoluteValues and penalty.ridge:
        return "elastic net" if np.ptp(penalty.weights) == 0.0 else ""  # type: ignore[attr-defined]
    if penalty.ridge:
        return ""
    if isinstance(penalty, NestedNorms):
        plain = type(penalty.inner) is AbsoluteValues and not penalty.coupled
        return "sparse-group LASSO" if plain else ""
    if kind is GroupNorms:
        return "joint group-LASSO" if penalty.coupled else "group-LASSO"
    if kind is AbsoluteValues:
        return "LASSO"
    return "SLOPE" if kind is SortedNorm else ""


def matrix_of(design: Design) -> Any:
    """Z (m, k) in columns of unit rms: an array in Fortran order, or scipy's CSC.

    A design in memory whose columns have unit rms to rounding is not copied.
    """
    rms = design.rms
    unscaled = bool(np.all(np.abs(rms - 1.0) <= 1e-13))
    if isinstance(design, SparseDesign):
        return design.matrix if unscaled else (design.matrix @ sparse.diags(1.0 / rms)).tocsc()
    if isinstance(design, RowDesign) and design.in_memory and design.weights is None:
        return np.asfortranarray(design.source if unscaled else design.source / rms)
    return design.columns(np.arange(design.shape[1]))


@dataclass(frozen=True, eq=False)
class Timed:
    """Weights (p, k, n) of a solver that keeps its own clock: seconds of wall and CPU [s]."""

    weights: Array
    wall: float
    cpu: float


@dataclass(frozen=True, eq=False)
class Rows:
    """|y - X u|^2 / (2 len(y)): X (r, k b) dense in Fortran order or CSC, y (r,), b targets.

    groups (k b,): the block of each coefficient, target by target, numbered from 0.
    """

    design: Any
    target: Array
    groups: IntArray

    @property
    def blocks(self) -> list[IntArray]:
        """The coefficients (c,) of each block."""
        order = np.argsort(self.groups, kind="stable")
        starts = np.searchsorted(self.groups[order], np.arange(1, int(self.groups.max()) + 1))
        return np.split(order, starts)


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
class Part:
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
    def design(self) -> Any:
        """X (m, k)."""
        return self.whole.design

    @property
    def target(self) -> Array:
        """The targets (m, b)."""
        return np.ascontiguousarray(self.whole.target[:, self.targets])

    @property
    def samples(self) -> int:
        """The number m of samples."""
        return len(self.whole.target)

    def gram(self) -> Array:
        """X'X/m (k, k), dense; a copy, as some work in place."""
        return self.whole.gram.copy()

    def cross(self) -> Array:
        """X'y/m (k,) of the first of the targets."""
        cross: Array = self.design.T @ self.target[:, 0] / self.samples
        return cross

    def rows(self) -> Rows:
        """The rows of a QR of X and the targets where they are fewer, else both as they are."""
        design, target = self.design, self.target
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
        groups = np.tile(self.groups, count).astype(np.intp)
        return Rows(ready, np.ascontiguousarray(target.T).ravel(), groups)


class Peer(ABC):
    """Base of the public solvers: their fields are settings, `solved` is their call."""

    name: ClassVar[str]
    package: ClassVar[str]
    extra: ClassVar[str] = "'sparsefit[peers]'"
    form: ClassVar[str]
    stops: ClassVar[bool] = True
    kinds: ClassVar[tuple[Kind, ...]]
    reads_sparse: ClassVar[bool] = False
    """Whether it takes a scipy.sparse matrix; others get a dense copy, which is in their time."""

    @abstractmethod
    def solved(self, part: Part, tolerance: float | None) -> "Array | Timed":
        """Coefficients u (p, k b) of a part, target by target."""

    def takes(self, penalty: Penalty) -> str:
        """The reason why it does not solve this penalty; empty where it does."""
        if kind_of(penalty) in self.kinds:
            return ""
        return f"{self.name} solves {', '.join(self.kinds)} only"

    def path(
        self,
        design: Design,
        target: Array,
        penalty: Penalty,
        alphas: Array,
        tolerance: float | None,
    ) -> "Array | Timed":
        """Weights (p, k, n) of columns of unit rms; see `registry`. Raises InputError."""
        if reason := self.takes(penalty):
            raise InputError(reason)
        parts = parts_of(design, target, penalty, alphas, dense=not self.reads_sparse)
        return parts.joined([self.solved(part, tolerance) for part in parts.parts])


@dataclass(frozen=True, eq=False)
class Parts:
    """A problem in parts that are solved apart, and the units (k,) of their coefficients."""

    parts: tuple[Part, ...]
    units: Array

    def joined(self, values: "Sequence[Array | Timed]") -> "Array | Timed":
        """Weights V (p, k, n) of the parts' coefficients u (p, k b), and their time."""
        points, shape = len(self.parts[0].fractions), (-1, len(self.units))
        raw = [value.weights if isinstance(value, Timed) else value for value in values]
        stacked = np.concatenate([each.reshape(points, *shape) for each in raw], axis=1)
        weights: Array = stacked.transpose(0, 2, 1) * self.units[:, None]
        timed = [value for value in values if isinstance(value, Timed)]
        if not timed:
            return weights
        return Timed(weights, sum(each.wall for each in timed), sum(each.cpu for each in timed))


def parts_of(
    design: Design, target: Array, penalty: Penalty, alphas: Array, *, dense: bool = False
) -> Parts:
    """The parts of a problem whose penalty has a `kind_of`; ``dense``: of a sparse design too."""
    unit, kind = float(alphas[0]), kind_of(penalty)
    omega, lambdas = np.ones(penalty.columns), None
    if isinstance(penalty, SortedNorm):
        lambdas = penalty.weights
    elif isinstance(penalty, NestedNorms):
        omega = penalty.outer.weights[penalty.blocks]
        lambdas = penalty.inner.weights / omega
    elif isinstance(penalty, AbsoluteValues | GroupNorms):
        omega = penalty.weights[penalty.blocks]
    matrix = matrix_of(design)
    if np.any(omega != 1.0):
        scale = sparse.diags(1.0 / omega)
        is_array = isinstance(matrix, np.ndarray)
        matrix = np.asfortranarray(matrix / omega) if is_array else (matrix @ scale).tocsc()
    if dense and not isinstance(matrix, np.ndarray):
        matrix = matrix.toarray(order="F")
    ridge, fractions = unit * penalty.ridge / float(omega[0]) ** 2, alphas / unit
    whole, count = Whole(matrix, target / unit), target.shape[1]
    apart = [slice(t, t + 1) for t in range(count)]
    parts = tuple(
        Part(whole, targets, penalty.blocks, fractions, kind, ridge, lambdas)
        for targets in ([slice(0, count)] if penalty.coupled else apart)
    )
    return Parts(parts, unit / omega)
