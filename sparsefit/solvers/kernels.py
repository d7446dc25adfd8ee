"""Exact paths on the columns in play, each of which can go on where it was with more columns.

A kernel solves at descending penalties on G and B of the columns in play. It keeps where the path
stood after every penalty: where a column outside objects to one of them, the path goes on from the
penalty before, with that column beside the others. ``homotopy`` and ``variances`` are compiled;
where they are not built, the generic Newton's method runs in their place, slower.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from importlib import import_module
from itertools import pairwise
from typing import Any, ClassVar, Protocol

import numpy as np

from sparsefit.arrays import Array, BoolArray, IntArray
from sparsefit.regression.group_penalties import GroupNorms
from sparsefit.regression.penalties import AbsoluteValues, Penalty
from sparsefit.solvers.faces import on_a_face
from sparsefit.solvers.newton import Normal, relative_gap, settled

EXTRAPOLATED = 5  # sweeps that are extrapolated from
MANY = 300  # rows, from which on descent is faster where more columns are in use
MOST = 1200  # sweeps at one penalty, before Newton's method takes over
STOP = 1e-11  # relative gap, far below any tolerance that a certificate is asked to meet


@dataclass(frozen=True, eq=False)
class Points:
    """Weights V (p, k, n) of columns of unit rms along a path of p penalties.

    complete (p,): whether each is a solution; steps (p,) taken; words: by what, for a status.
    """

    weights: Array
    complete: BoolArray
    steps: IntArray
    words: str


@dataclass(frozen=True, eq=False)
class Stretch:
    """A stretch of a path: values (p, j, q), which are optimal (p,), and steps taken (p,)."""

    values: Array
    complete: BoolArray
    steps: IntArray


class Kernel(Protocol):
    """A path on the columns in play, from its largest penalty on."""

    name: ClassVar[str]
    by_gram: ClassVar[bool]  # whether it needs G where columns are more than rows

    def advance(self, alphas: Array) -> Stretch:
        """The path at further penalties (p,), descending."""
        ...

    def enlarged(self, normal: Normal, cross: Array, penalty: Penalty, accepted: int) -> Kernel:
        """The path after ``accepted`` points of the last stretch, on the columns and more of them.

        Those so far come first, in their order. cross B (j, q).
        """
        ...


def compiled(name: str) -> Any:
    """The compiled source of that name; None where it was not built."""
    try:
        return import_module(f"sparsefit.solvers.{name}")
    except ImportError:
        return None


class HomotopyKernel:
    """The LASSO or elastic net of one target, from event to event; z_j/omega_j has omega_j v_j."""

    name: ClassVar[str] = "homotopy"
    by_gram: ClassVar[bool] = True
    stop: float = STOP

    def __init__(self, normal: Normal, cross: Array, penalty: Penalty, units: Units) -> None:
        assert isinstance(penalty, AbsoluteValues)
        assert normal.gram is not None
        self.units, self.penalty, self.normal, self.cross = units, penalty, normal, cross
        gram, pull, omega = normal.gram, cross[:, 0], penalty.weights
        if np.any(omega != 1.0):
            gram, pull = gram / np.multiply.outer(omega, omega), pull / omega
        gram = np.ascontiguousarray(gram / units.square if units.square != 1.0 else gram)
        ridge = penalty.ridge * units.height / (units.square * omega**2)
        self.walk = compiled("homotopy").Homotopy(gram, pull / units.height, ridge)
        self.known, self.alphas = [np.zeros(len(omega))], np.zeros(1)

    def advance(self, alphas: Array) -> Stretch:
        """The path at further penalties."""
        height = self.units.height
        values, complete = np.zeros((len(alphas), len(self.known[-1]))), np.zeros(len(alphas), bool)
        before, steps = self.walk.steps, np.zeros(len(alphas), np.intp)
        with np.errstate(all="ignore"):
            self.walk.advance(alphas / height, values, complete)
        self.known = [self.known[-1], *values]
        self.alphas = np.append(self.alphas[-1:], alphas)
        steps[-1] = self.walk.steps - before
        solved = (values * (height / self.units.square / self.penalty.weights))[:, :, None]
        level = self.units.level
        for i in np.flatnonzero(~complete):  # on columns that nearly depend on each other
            point = (self.normal, self.cross / level, self.penalty.in_units(level))
            values, gap, _ = settled(*point, alphas[i] / level, solved[i] / level, self.stop)
            solved[i], complete[i] = values * level, gap <= self.stop
        return Stretch(solved, complete, steps)

    def enlarged(
        self, normal: Normal, cross: Array, penalty: Penalty, accepted: int
    ) -> HomotopyKernel:
        """A walk from the weights then, on more columns."""
        kernel, start = HomotopyKernel(normal, cross, penalty, self.units), self.known[accepted]
        kernel.known = [np.pad(start, (0, len(cross) - len(start)))]
        kernel.alphas = self.alphas[accepted : accepted + 1]
        kernel.walk.start(kernel.known[0], float(kernel.alphas[0]) / self.units.height)
        return kernel


class NewtonKernel:
    """Any penalty, on its faces or by proximal points, each started from the penalty before."""

    name: ClassVar[str] = "newton"
    by_gram: ClassVar[bool] = False
    stop: float = STOP

    def __init__(self, normal: Normal, cross: Array, penalty: Penalty, units: Units) -> None:
        self.normal, self.units, self.cross = normal, units, cross / units.level
        # In units of the target's rms y the ridge of y V is y rho, that of alpha and V being one.
        self.penalty, self.known = penalty.in_units(units.level), [np.zeros(cross.shape)]

    def advance(self, alphas: Array) -> Stretch:
        """The path at further penalties."""
        gaps, steps = np.zeros(len(alphas)), np.zeros(len(alphas), np.intp)
        self.known = self.known[-1:]
        for i, alpha in enumerate((alphas / self.units.level).tolist()):
            problem, values = (self.normal, self.cross, self.penalty, alpha), self.known[-1]
            values, gaps[i], steps[i] = on_a_face(*problem, values, self.stop)
            if gaps[i] > self.stop:
                values, gaps[i], taken = settled(*problem, values, self.stop)
                steps[i] += taken
            self.known.append(values)
        return Stretch(np.stack(self.known[1:]) * self.units.level, gaps <= self.stop, steps)

    def enlarged(
        self, normal: Normal, cross: Array, penalty: Penalty, accepted: int
    ) -> NewtonKernel:
        """The values with zeros for the new columns."""
        kernel = NewtonKernel(normal, cross, penalty, self.units)
        start = self.known[accepted]
        kernel.known = [np.pad(start, ((0, len(cross) - len(start)), (0, 0)))]
        return kernel


class VariationalKernel:
    """Group norms over all targets at hand, by Newton's method on the groups' variances."""

    name: ClassVar[str] = "variational"
    by_gram: ClassVar[bool] = True
    stop: float = STOP

    def __init__(self, normal: Normal, cross: Array, penalty: Penalty, units: Units) -> None:
        assert isinstance(penalty, GroupNorms)
        self.level, self.units = units.level, units
        # Groups by their first column, so that those that join come last.
        _, first, label = np.unique(penalty.groups, return_index=True, return_inverse=True)
        place = np.argsort(np.argsort(first))[label]
        self.order = np.argsort(place, kind="stable")
        self.scale = penalty.weights[penalty.groups[self.order]]
        gram, pull = normal.gram, cross / units.level
        assert gram is not None
        if np.any(self.order[1:] < self.order[:-1]):
            pull, gram = pull[self.order], gram[np.ix_(self.order, self.order)]
        if np.any(self.scale != 1.0):
            pull = pull / self.scale[:, None]
            gram = gram / np.multiply.outer(self.scale, self.scale)
        starts = np.searchsorted(place[self.order], np.arange(len(first) + 1)).astype(np.intp)
        self.problem = np.ascontiguousarray(gram), np.ascontiguousarray(pull.T), starts
        self.eta = [np.zeros(len(first))]

    def advance(self, alphas: Array) -> Stretch:
        """The path at further penalties."""
        kernels = compiled("variances")
        search = kernels.Search(kernels.Groups(*self.problem), self.eta[-1], self.stop)
        values = np.zeros((len(alphas), len(self.order), len(self.problem[1])))
        gaps, steps = np.zeros(len(alphas)), np.zeros(len(alphas), np.intp)
        self.eta, self.attempts = self.eta[-1:], dict(zip(alphas.tolist(), values, strict=True))
        with np.errstate(all="ignore"):  # what breaks is caught by the gap, not by warnings
            for i, alpha in enumerate((alphas / self.level).tolist()):
                solved, gaps[i], steps[i] = search.minimised(alpha)
                values[i, self.order] = solved.T * (self.level / self.scale)[:, None]
                self.eta.append(search.eta)
        return Stretch(values, gaps <= self.stop, steps)

    def enlarged(
        self, normal: Normal, cross: Array, penalty: Penalty, accepted: int
    ) -> VariationalKernel | DescentKernel:
        """The variances with zeros for the new groups; descent where many are in use."""
        in_use = np.any([values.any(axis=1) for values in self.attempts.values()], axis=0).sum()
        if normal.rows is not None and in_use > len(normal.rows) >= MANY:
            return DescentKernel(normal, cross, penalty, self.units, self.attempts, {})
        kernel = VariationalKernel(normal, cross, penalty, self.units)
        start = self.eta[min(accepted + 1, len(self.eta) - 1)]
        kernel.eta = [np.pad(start, (0, len(kernel.eta[0]) - len(start)))]
        return kernel


class DescentKernel:
    """Group norms by block descent with extrapolation, where the groups in use outnumber the rows.

    Source: Bertrand and Massias, "Anderson acceleration of coordinate descent" (AISTATS 2021).
    """

    name: ClassVar[str] = "block descent"
    by_gram: ClassVar[bool] = False
    stop: float = 1e-9

    def __init__(
        self,
        normal: Normal,
        cross: Array,
        penalty: Penalty,
        units: Units,
        attempts: dict[float, Array],
        bends: dict[int, float],
    ) -> None:
        assert isinstance(penalty, GroupNorms)
        assert normal.rows is not None
        assert normal.target is not None
        self.units, self.samples = units, normal.samples
        self.order = np.argsort(penalty.groups, kind="stable")
        self.penalty = replace(penalty, groups=penalty.groups[self.order])
        self.starts = np.searchsorted(self.penalty.groups, np.arange(len(penalty.weights) + 1))
        self.cross, self.target = cross[self.order] / units.level, normal.target.T / units.level
        self.rows = np.asfortranarray(normal.rows[:, self.order])
        # By the first column of a group, which keeps its place where others join.
        self.bends, first = dict(bends), self.order[self.starts[:-1]].tolist()
        for g, place in enumerate(first):
            if place not in bends:
                block = self.rows[:, self.starts[g] : self.starts[g + 1]]
                self.bends[place] = float(np.linalg.eigvalsh(block.T @ block)[-1]) / self.samples
        self.bend = np.array([self.bends[place] for place in first])
        self.attempts = {
            alpha: np.pad(values, ((0, len(cross) - len(values)), (0, 0)))
            for alpha, values in attempts.items()
        }

    def advance(self, alphas: Array) -> Stretch:
        """The path at further penalties, each from the attempt at the nearest one."""
        solved, gaps = np.empty((len(alphas), *self.cross.shape)), np.zeros(len(alphas))
        steps, level = np.zeros(len(alphas), np.intp), self.units.level
        for i, alpha in enumerate(alphas.tolist()):
            nearest = min(self.attempts, key=lambda each: abs(each - alpha))
            start = np.ascontiguousarray(self.attempts[nearest][self.order].T / level)
            values, gaps[i], steps[i] = self._descended(start, alpha / level)
            if gaps[i] > self.stop:
                place = self.cross, self.penalty, alpha / level, values.T
                plain = Normal(None, self.rows, self.samples)
                point, gaps[i], taken = settled(plain, *place, self.stop)
                values, steps[i] = point.T, steps[i] + taken
            solved[i, self.order] = values.T * level
            self.attempts[alpha] = solved[i]
        return Stretch(solved, gaps <= self.stop, steps)

    def _descended(self, values: Array, alpha: float) -> tuple[Array, float, int]:
        """The optimum (q, j) in units of the target, its gap, and sweeps."""
        penalty, residual = self.penalty, self.target - values @ self.rows.T
        limits, everything = alpha * penalty.weights, np.arange(len(self.bend))

        def swept(groups: IntArray) -> tuple[Array, Array]:
            compiled("sweeps").descend_groups(
                *(self.rows, self.starts, groups, limits, self.bend, float(self.samples)),
                *(residual, values),
            )
            return values.copy(), residual.copy()

        def height(values: Array, residual: Array) -> float:
            square = float(np.vdot(residual, residual)) / self.samples
            return 0.5 * square + alpha * float(penalty.value(values.T))

        steps = 0
        while True:
            correlation = (residual @ self.rows).T / self.samples
            gap = relative_gap(values.T, correlation, self.cross, penalty, alpha)
            if gap <= self.stop or steps >= MOST:
                return values, gap, steps
            steps += 1 + EXTRAPOLATED
            trail = [swept(everything)]
            used = np.flatnonzero(penalty.block_norms(values.T).any(axis=1))
            trail += [swept(used) for _ in range(EXTRAPOLATED)]
            moves = np.stack([(after[0] - before[0]).ravel() for before, after in pairwise(trail)])
            square = moves @ moves.T
            square.flat[:: EXTRAPOLATED + 1] += 1e-12 * np.trace(square) + 1e-300
            share = np.linalg.solve(square, np.ones(EXTRAPOLATED))
            share /= share.sum()
            point, rest = (
                np.tensordot(share, list(part)[1:], 1) for part in zip(*trail, strict=True)
            )
            if height(point, rest) < height(values, residual):
                values, residual = point, rest

    def enlarged(
        self, normal: Normal, cross: Array, penalty: Penalty, accepted: int
    ) -> DescentKernel:
        """The attempts with zeros for the new columns."""
        return DescentKernel(normal, cross, penalty, self.units, self.attempts, self.bends)


def kernel_for(
    penalty: Penalty, targets: int
) -> type[HomotopyKernel | VariationalKernel | NewtonKernel]:
    """The fastest kernel for a penalty on so many targets."""
    if type(penalty) is AbsoluteValues and targets == 1 and compiled("homotopy"):
        return HomotopyKernel
    if not penalty.ridge and isinstance(penalty, GroupNorms) and compiled("variances"):
        return VariationalKernel
    return NewtonKernel


@dataclass(frozen=True)
class Units:
    """The rms of the target, and powers of two near the largest of G's diagonal and of Z'Y/m.

    Both of columns that are divided by their penalty's weight.
    """

    level: float
    square: float = 1.0
    height: float = 1.0

    @classmethod
    def of(cls, penalty: Penalty, cross: Array, level: float) -> Units:
        """Those of a penalty and Z'Y/m (k, q)."""
        if not isinstance(penalty, AbsoluteValues):
            return cls(level)
        largest = float((np.abs(cross) / penalty.weights[:, None]).max())
        return cls(level, binary_unit(float(penalty.weights.min()) ** -2), binary_unit(largest))


def path_on_gram(
    gram: Array, cross: Array, penalty: Penalty, alphas: Array, square: float, stop: float = STOP
) -> Stretch:
    """The path of targets that are solved together, on all columns: G (k, k), B (k, q), |Y|^2/m.

    stop: the relative gap that is enough.
    """
    units = Units.of(penalty, cross, float(np.sqrt(square)) or 1.0)
    kernel = kernel_for(penalty, cross.shape[1])(Normal(gram, None, 0), cross, penalty, units)
    kernel.stop = stop
    return kernel.advance(np.asarray(alphas, dtype=float))


def binary_unit(largest: float) -> float:
    """Power of two next to a number: dividing by it rounds nothing."""
    if not 0.0 < largest < np.inf:
        return 1.0
    return float(2.0 ** (np.frexp(largest)[1] - 1)) if not 0.99 < largest < 1.01 else 1.0
