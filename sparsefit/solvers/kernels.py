"""Exact paths on the columns in play, each of which can go on where it was with more columns.

A kernel solves at descending penalties on G and B of the columns in play. It keeps where the path
stood after every penalty: where a column outside objects to one of them, the path goes on from the
penalty before, with that column beside the others. ``homotopy`` and ``variances`` are compiled;
where they are not built, the generic Newton's method runs in their place, slower.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import Any, ClassVar, Protocol

import numpy as np

from sparsefit.arrays import Array, BoolArray, IntArray
from sparsefit.regression.group_penalties import GroupNorms
from sparsefit.regression.penalties import AbsoluteValues, Penalty
from sparsefit.solvers.faces import on_a_face
from sparsefit.solvers.newton import Normal, settled

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
    stop: float = STOP

    def __init__(self, normal: Normal, cross: Array, penalty: Penalty, units: Units) -> None:
        assert isinstance(penalty, GroupNorms)
        self.level, self.units = units.level, units
        # Groups by their first column, so that those that join come last.
        _, first, label = np.unique(penalty.groups, return_index=True, return_inverse=True)
        place = np.argsort(np.argsort(first))[label]
        self.order = np.argsort(place, kind="stable")
        self.scale = penalty.weights[penalty.groups[self.order]]
        gram, rows, pull = normal.gram, normal.rows, cross / units.level
        if np.any(self.order[1:] < self.order[:-1]):
            pull = pull[self.order]
            gram = None if gram is None else gram[np.ix_(self.order, self.order)]
            rows = None if rows is None else rows[:, self.order]
        if np.any(self.scale != 1.0):
            pull = pull / self.scale[:, None]
            gram = None if gram is None else gram / np.multiply.outer(self.scale, self.scale)
            rows = None if rows is None else rows / self.scale
        label = place[self.order]
        starts, none = np.searchsorted(label, np.arange(len(first) + 1)), np.zeros((0, 0))
        self.problem = (
            none if gram is None else np.ascontiguousarray(gram),
            none if rows is None else np.ascontiguousarray(rows.T),
            *(float(normal.samples), np.ascontiguousarray(pull.T), starts.astype(np.intp)),
        )
        self.eta = [np.zeros(len(first))]

    def advance(self, alphas: Array) -> Stretch:
        """The path at further penalties."""
        kernels = compiled("variances")
        search = kernels.Search(kernels.Groups(*self.problem), self.eta[-1], self.stop)
        values = np.zeros((len(alphas), len(self.order), len(self.problem[3])))
        gaps, steps = np.zeros(len(alphas)), np.zeros(len(alphas), np.intp)
        self.eta = self.eta[-1:]
        with np.errstate(all="ignore"):  # what breaks is caught by the gap, not by warnings
            for i, alpha in enumerate((alphas / self.level).tolist()):
                solved, gaps[i], steps[i] = search.minimised(alpha)
                values[i, self.order] = solved.T * (self.level / self.scale)[:, None]
                self.eta.append(search.eta)
        return Stretch(values, gaps <= self.stop, steps)

    def enlarged(
        self, normal: Normal, cross: Array, penalty: Penalty, accepted: int
    ) -> VariationalKernel:
        """The variances with zeros for the new groups."""
        kernel = VariationalKernel(normal, cross, penalty, self.units)
        start = self.eta[min(accepted + 1, len(self.eta) - 1)]
        kernel.eta = [np.pad(start, (0, len(kernel.eta[0]) - len(start)))]
        return kernel


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
