"""What sets of groups explain of a target, and which sets cannot be the best of their size.

With U_g an orthonormal basis of the span of group g's columns, a set S of groups explains

    e_S = B_S' M_S^-1 B_S,   M_S = (U_g'U_h)_{g,h in S},   B_S = (U_g'Y)_{g in S}

of |Y|^2. With c_gh the largest cosine between two spans, |U_g'U_h|_2, no eigenvalue of M_S is less
than 1 - rho, where rho is the largest one of the matrix of cosines with a diagonal of zeros, so

    e_S <= sum_{g in S} e_g / (1 - rho),   e_S <= |Y|^2.

Sets are compared by M_S + `DAMPING` I, which lowers e_S: a direction in which spans differ by a
sine of 3e-5 counts half. Rounding moves that e_S by less than 1e-6 of |Y|^2.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from sparsefit.arrays import Array, IntArray
from sparsefit.regression.problem import RegressionProblem

DAMPING = 1e-9
RANK = 1e-9  # singular values of a group's scaled columns below it, relative, count as zero
CHUNK = 4096  # sets worked out at once


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
            kept = left[:, size > RANK * size[0]]
            bases[group, :, : kept.shape[1]] = kept
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
                found = self.explained(open_ones)
                worked += len(open_ones)
                least = max(least, float(found.max(initial=-np.inf)) - doubt * self.total)
                near.append((open_ones[found >= least], found[found >= least]))
        sets, known = (np.concatenate(part) for part in zip(*near, strict=True))
        sets, known = sets[known >= least], known[known >= least]
        return sets[np.argsort(-known, kind="stable")], worked

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
