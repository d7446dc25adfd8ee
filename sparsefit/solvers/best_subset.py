"""The best one, two or three groups of all: exact, by enumeration with a bound.

    min over sets S of s groups of min over W_S of |Y - theta_S W_S|^2,    s = 1, 2, 3

Every set of s groups is worked out, or excluded by a bound on what it can explain (`GroupSpans`):
that is the proof that no set is better. Sets that differ by less than 1e-6 of |Y|^2 are settled on
the rows. One group more is taken while it is worth its weights. What the caller verifies beside is
a fixed point: that no exchange of one group for another fits better.

With U_g an orthonormal basis of the span of group g's columns, a set S of groups explains

    e_S = B_S' M_S^-1 B_S,   M_S = (U_g'U_h)_{g,h in S},   B_S = (U_g'Y)_{g in S}

of |Y|^2. With c_gh the largest cosine between two spans, |U_g'U_h|_2, no eigenvalue of M_S is less
than 1 - rho, where rho is the largest one of the matrix of cosines with a diagonal of zeros, so

    e_S <= sum_{g in S} e_g / (1 - rho),   e_S <= |Y|^2.

Sets are compared by M_S + `DAMPING` I, which lowers e_S: a direction in which spans differ by a
sine of 3e-5 counts half. Rounding moves that e_S by less than 1e-6 of |Y|^2.

Sources: Furnival and Wilson, Technometrics 16 (1974) 499-511, for subsets by bounds; Bertsimas,
King and Mazumder, Ann. Statist. 44 (2016) 813-852, for what they are worth.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import comb
from typing import ClassVar

import numpy as np

from sparsefit.arrays import Array, IntArray
from sparsefit.errors import number_setting
from sparsefit.regression.backend import Solution, setting
from sparsefit.regression.problem import RegressionProblem
from sparsefit.solvers.searches import (
    DOUBT,
    Stop,
    SupportSearch,
    is_worth,
    least_residual,
    residual_square,
)

DAMPING = 1e-9
RANK = 1e-9  # singular values of a group's scaled columns below it, relative, count as zero
CHUNK = 4096  # sets worked out at once
FEW = 64  # sets nearly alike that are settled on the rows
MOST = 2_000_000  # sets of one size: of three groups of 8 columns, 20 us each


@dataclass(frozen=True)
class BestSubset(SupportSearch):
    """Least squares on the set of at most ``scales`` groups that leaves the smallest residual.

    scales: 1, 2 or 3. stop and tolerance: whether s + 1 groups are worth it, as in `GroupOMP`;
    ``decrease`` with a tolerance of 0 always takes ``scales`` of them. separate: each target has a
    set of its own; otherwise all share one.
    """

    name: ClassVar[str] = "best-subset"
    scales: int = setting(3, least=1)
    tolerance: float = setting(0.01, low=0.0, high=1.0)
    stop: Stop = "decrease"
    separate: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        number_setting(self.name, "scales", self.scales, low=1, high=3, meaning="all are tried")

    def searched(self, problem: RegressionProblem) -> Solution:
        """Weights on the best set; ``solver_status`` says of how many, and how many were fitted."""
        groups = int(problem.groups.max()) + 1
        largest = min(self.scales, groups)
        if (many := comb(groups, largest)) > MOST:
            reason = f"{many} sets of {largest} of {groups} groups are too many; lower scales"
            return Solution(None, "error", f"{self.name}: {reason}")
        parts = [self._searched(part, largest) for part in self._parts(problem)]
        weights = np.concatenate([values for values, _, _ in parts], axis=1)
        tried, worked = sum(count for _, count, _ in parts), sum(count for *_, count in parts)
        words = f"the best of {tried} sets, {tried - worked} excluded by their bound"
        return Solution(weights, solver_status=words, iterations=worked)

    def next_weights(self, problem: RegressionProblem, weights: Array) -> Array:
        """Weights (k, n) after the best exchange of one group of these, if any betters them."""
        pairs = zip(self._parts(problem), problem.together(not self.separate), strict=True)
        return np.concatenate([_exchanged(part, weights[:, t]) for part, t in pairs], axis=1)

    def _parts(self, problem: RegressionProblem) -> list[RegressionProblem]:
        """The targets that share a set."""
        if not self.separate or problem.targets == 1:
            return [problem]
        each = enumerate(problem.target_names)
        return [replace(problem, target=problem.target[:, [t]], target_names=(n,)) for t, n in each]

    def _searched(self, problem: RegressionProblem, largest: int) -> tuple[Array, int, int]:
        """Weights (k, n), the sets there were and those that were worked out."""
        weights, sets, worked = np.zeros((problem.columns, problem.targets)), 0, 0
        if not problem.target.any():
            return weights, 0, 0
        spans, total = GroupSpans.of(problem), float(problem.statistics.target_square.sum())
        for size in range(1, largest + 1):
            if size > 1:  # no group more can be worth it, or leaves any freedom to the next fit
                close = residual_square(problem, weights) <= self.tolerance * total
                least = np.bincount(problem.groups).min() + np.count_nonzero(weights.any(axis=1))
                if (self.stop == "decrease" and close) or least >= problem.samples:
                    break
            best, count = spans.best(size, DOUBT)
            larger = least_residual(problem, list(best[:FEW]))
            sets, worked = sets + comb(len(spans.alone), size), worked + count
            if size > 1 and not is_worth(problem, weights, larger, self.stop, self.tolerance):
                break
            weights = larger
        return weights, sets, worked


def _exchanged(problem: RegressionProblem, weights: Array) -> Array:
    """The best weights (k, n) on sets of groups that differ from these in one group at most."""
    used = np.unique(problem.groups[np.any(weights != 0, axis=1)])
    others = np.setdiff1d(np.arange(problem.groups.max() + 1), used)
    if not len(used):
        return weights
    swapped = [np.where(used == old, new, used) for old in used for new in others]
    sets, spans = np.array([used, *swapped]), GroupSpans.of(problem)
    explained = spans.explained(sets)
    order = np.argsort(-explained, kind="stable")
    near = explained[order] >= explained.max() - DOUBT * spans.total
    return least_residual(problem, list(sets[order[near]][:FEW]))


@dataclass(frozen=True, eq=False)
class GroupSpans:
    """Bases of G groups, padded with zeros to p columns each.

    products U_g'U_h (G, G, p, p), the padding's with itself being 1; loads U_g'Y (G, p, n); alone
    e_g (G,); cosines c (G, G); total |Y|^2.
    """

    products: Array
    loads: Array
    alone: Array
    cosines: Array
    total: float

    @classmethod
    def of(cls, problem: RegressionProblem) -> "GroupSpans":
        """The spans of the groups of a problem, whose targets share the sets."""
        rows, target = problem.compressed
        scaled = rows / problem.statistics.rms
        sizes = np.bincount(problem.groups)
        bases = np.zeros((len(sizes), len(rows), int(sizes.max())))
        for group in range(len(sizes)):
            left, size, _ = np.linalg.svd(scaled[:, problem.groups == group], full_matrices=False)
            spanned = left[:, size > RANK * size[0]]
            bases[group, :, : spanned.shape[1]] = spanned
        flat = bases.transpose(1, 0, 2).reshape(len(rows), -1)
        shape = (len(sizes), bases.shape[2])
        products = (flat.T @ flat).reshape(shape * 2).transpose(0, 2, 1, 3).copy()
        cosines = np.minimum(np.linalg.norm(products, ord=2, axis=(2, 3)), 1.0)
        np.fill_diagonal(cosines, 0.0)
        products[np.arange(len(sizes)), np.arange(len(sizes))] = np.eye(shape[1])
        loads = (flat.T @ target).reshape(*shape, -1)
        alone = np.sum(loads**2, axis=(1, 2))
        return cls(products, loads, alone, cosines, float(np.sum(target**2)))

    def best(self, size: int, doubt: float) -> tuple[IntArray, int]:
        """Sets (c, size) within ``doubt`` of |Y|^2 of the best e, best first.

        And how many were worked out: the others are excluded by their bound.
        """
        least, near, worked = -np.inf, [], 0
        for sets in self._sets(size):
            bounds = self._bounds(sets)
            for chunk in np.array_split(np.argsort(-bounds), -(-len(sets) // CHUNK)):
                open_ones = sets[chunk[bounds[chunk] >= least]]
                gains = self.explained(open_ones)
                worked += len(open_ones)
                least = max(least, float(gains.max(initial=-np.inf)) - doubt * self.total)
                near.append((open_ones[gains >= least], gains[gains >= least]))
        sets, gains = (np.concatenate(part) for part in zip(*near, strict=True))
        sets, gains = sets[gains >= least], gains[gains >= least]
        return sets[np.argsort(-gains, kind="stable")], worked

    def explained(self, sets: IntArray) -> Array:
        """The damped e (c,) of sets of groups (c, s)."""
        count, size = sets.shape
        side, values = size * self.products.shape[2], np.empty(count)
        for start in range(0, count, CHUNK):
            part = sets[start : start + CHUNK]
            blocks = self.products[part[:, :, None], part[:, None, :]].transpose(0, 1, 3, 2, 4)
            matrix = blocks.reshape(len(part), side, side) + DAMPING * np.eye(side)
            loads = self.loads[part].reshape(len(part), side, -1)
            values[start : start + CHUNK] = np.sum(
                loads * np.linalg.solve(matrix, loads), axis=(1, 2)
            )
        return values

    def _sets(self, size: int) -> Iterator[IntArray]:
        """All sets of ``size`` groups (c, size), those with what explains most alone first."""
        order = np.argsort(-self.alone, kind="stable")
        for i in range(len(order) - size + 1):
            rest = order[i + 1 :]
            if size == 1:
                yield order[i : i + 1, None]
            elif size == 2:
                yield np.stack([np.full(len(rest), order[i]), rest], axis=1)
            else:
                first, second = np.triu_indices(len(rest), 1)
                yield np.stack([np.full(len(first), order[i]), rest[first], rest[second]], axis=1)

    def _bounds(self, sets: IntArray) -> Array:
        """The bound of e (c,), as in the head of this file."""
        if sets.shape[1] == 1:
            return self.alone[sets[:, 0]]
        pairs = [(i, j) for i in range(sets.shape[1]) for j in range(i)]
        a = np.stack([self.cosines[sets[:, i], sets[:, j]] for i, j in pairs])
        radius = a[0] if len(a) == 1 else _largest_root(np.sum(a**2, axis=0), np.prod(a, axis=0))
        left = np.maximum(1.0 - radius, 0.0)
        total = self.alone[sets].sum(axis=1)
        bound: Array = np.where(left > 0, total / np.where(left > 0, left, 1.0), np.inf)
        return np.minimum(bound, self.total)


def _largest_root(squares: Array, product: Array) -> Array:
    """The largest x with x^3 - squares x - 2 product = 0: of three cosines as a matrix."""
    third = np.sqrt(squares / 3.0)
    ratio = product / np.where(third > 0, third, 1.0) ** 3
    root: Array = 2.0 * third * np.cos(np.arccos(np.clip(ratio, -1.0, 1.0)) / 3.0)
    return root
