"""Sparse-group paths from sufficient statistics: block descent finds who is in, Newton finishes.

    minimise over V (k, n):  sum_t [v_t'G v_t / 2 - b_t'v_t] + alpha (sum_g omega_g |V_g|
                             + sum_h lambda_h |V_h|),   each block h within one block g

Groups at zero whose dual norm exceeds alpha are swept, and where progress is slow all in use. With
C = B - G V and L the largest eigenvalue of G_gg, a group takes a few steps

    V_g <- prox(V_g + C_g / L),    prox = shrink by alpha omega_g / L  after  by alpha lambda_h / L,

which is the proximal operator of both norms together. In groups in use, where the outer norm is
smooth, blocks h at zero with |C_h| > alpha lambda_h are opened together. On the coefficients that
are not zero the objective is smooth: there one Newton step, with the curvature of each block,
omega/|V_b| (I - u u'), u = V_b/|V_b|, is taken as far as it descends; blocks that it takes across
zero stop there. Sweeps alone converge, and once the blocks in use stay, Newton's steps converge
quadratically. The duality gap is the stop.

Sources: Simon, Friedman, Hastie and Tibshirani, J. Comput. Graph. Stat. 22 (2013) 231-245, for the
descent; Jenatton, Mairal, Obozinski and Bach, J. Mach. Learn. Res. 12 (2011) 2297-2334, for the
operator.
"""

from dataclasses import dataclass

import numpy as np

from sparsefit.arrays import Array, BoolArray, IntArray
from sparsefit.regression.objective import Penalty

ROUNDS = 400  # of a sweep and a Newton step, at one penalty
PATIENCE = 40  # rounds without a smaller gap
INNER = 4  # proximal steps on a group in a sweep
SLOW = 0.5  # share of the last gap above which all groups in use are swept
OPTIMAL = 1e-10  # relative to alpha: below it a block is content to be zero
WORTH = 0.3  # share of the largest excess that opens a block along with it
NEWCOMERS = 8  # groups that join a sweep at the most
HALVINGS = 12  # of a Newton step that does not descend
DAMPING = 1e-13  # of the mean curvature, added to it: dependent columns have none


@dataclass(frozen=True, eq=False)
class BlockPath:
    """Weights (p, k, n), rounds spent (p,), relative gaps (p,), gap <= tolerance (p,)."""

    weights: Array
    iterations: IntArray
    gaps: Array
    complete: BoolArray


def block_path(
    gram: Array,
    cross: Array,
    penalty: Penalty,
    alphas: Array,
    *,
    target_square: float,
    tolerance: float,
) -> BlockPath:
    """Minimise the objective at every penalty, each started from the one before.

    gram (k, k) = Z'Z/m and cross (k, n) = Z'Y/m of unit-rms columns, whose targets share blocks
    where ``penalty`` is joint (n = 1 where it is not); alphas (p,) > 0, best descending;
    target_square = |Y|^2/m. A point is complete when (primal - dual) / (|Y|^2 / 2m) <= tolerance;
    otherwise it carries the best weights that were met.
    """
    scale = float(np.sqrt(target_square))
    count = len(alphas)
    weights = np.zeros((count, *cross.shape))
    rounds, gaps = np.zeros(count, np.intp), np.zeros(count)
    if scale > 0.0 and cross.any():
        descent = _Descent(gram, cross / scale, penalty)
        values = np.zeros(cross.shape)
        for i, alpha in enumerate(alphas.tolist()):
            values, gaps[i], rounds[i] = descent.settled(values, alpha / scale, tolerance)
            weights[i] = values * scale
    return BlockPath(weights, rounds, gaps, gaps <= tolerance)


@dataclass(frozen=True, eq=False)
class _Group:
    """One group: its columns, G_gg and G_g, L, omega, and the blocks within it.

    shrink: lambda of each coefficient's block; part (s,): that block, numbered within the group,
    None where every coefficient is one.
    """

    columns: IntArray
    square: Array
    rows: Array
    bound: float
    omega: float
    shrink: Array
    part: IntArray | None
    joint: bool

    def prox(self, values: Array, step: float) -> Array:
        """The proximal operator of step (omega |.| + sum_h lambda_h |._h|) at values (s, n)."""
        limit = step * self.shrink
        if self.part is None:
            inner = np.sign(values) * np.maximum(np.abs(values) - limit, 0.0)
        else:
            squares = (values * values).sum(axis=1)[:, None] if self.joint else values * values
            sums = np.zeros((int(self.part.max()) + 1, squares.shape[1]))
            np.add.at(sums, self.part, squares)
            norms = np.sqrt(sums)[self.part]
            inner = values * np.maximum(1.0 - limit / np.maximum(norms, 1e-300), 0.0)
        norm = float(np.sqrt(np.vdot(inner, inner)))
        if norm <= step * self.omega:
            return np.zeros_like(values)
        shrunk: Array = inner * (1.0 - step * self.omega / norm)
        return shrunk

    def improved(self, values: Array, gradient: Array, alpha: float) -> Array:
        """V_g (s, n) after a few proximal steps, from C_g there."""
        pull = gradient + self.square @ values
        for _ in range(INNER):
            before = values
            values = self.prox(
                before + (pull - self.square @ before) / self.bound, alpha / self.bound
            )
            if np.array_equal(values, before):
                break
        return values


class _Descent:
    """One problem with targets of unit square; what it keeps is fixed once it is made."""

    def __init__(self, gram: Array, cross: Array, penalty: Penalty) -> None:
        self.gram, self.cross, self.penalty = gram, cross, penalty
        self.groups = [self._group(g) for g in range(len(penalty.weights))]

    def _group(self, number: int) -> _Group:
        within = self.penalty.within
        columns = np.flatnonzero(self.penalty.groups == number)
        square = self.gram[np.ix_(columns, columns)]
        bound = float(np.linalg.eigvalsh(square)[-1])
        shrink, part, joint = np.zeros((len(columns), 1)), None, False
        if within is not None:
            shrink, joint = within.weights[within.groups[columns]][:, None], within.joint
            if joint or not within.elementwise:
                part = np.unique(within.groups[columns], return_inverse=True)[1]
        omega = float(self.penalty.weights[number])
        return _Group(columns, square, self.gram[columns], bound, omega, shrink, part, joint)

    def settled(self, values: Array, alpha: float, tolerance: float) -> tuple[Array, float, int]:
        """The optimum at one penalty from any weights, its relative gap and the rounds it took."""
        values = values.copy()
        best, least, last, waited = values, np.inf, np.inf, 0
        for count in range(ROUNDS):
            residual = self.cross - self.gram @ values
            duals = self.penalty.block_dual_norms(residual)[:, 0]
            gap = self._gap(values, residual, alpha, float(duals.max()))
            waited += 1
            if gap < least:
                best, least, waited = values.copy(), gap, 0
            if gap <= tolerance or waited > PATIENCE:
                return best, least, count
            used = np.zeros(len(self.groups), dtype=bool)
            used[self.penalty.groups[values.any(axis=1)]] = True
            self._sweep(values, residual, alpha, self._newcomers(duals, alpha, used))
            if self.penalty.within is not None:
                self._open(self.penalty.within, values, residual, alpha, used)
            if gap > SLOW * last:
                self._sweep(values, residual, alpha, np.flatnonzero(used))
            self._newton(values, residual, alpha)
            last = gap
        return best, least, ROUNDS

    def _gap(self, values: Array, residual: Array, alpha: float, peak: float) -> float:
        """(primal - dual) / (|Y|^2 / 2m), the dual point a multiple of the residual."""
        product = 1.0 - float(np.vdot(values, self.cross))
        square = max(product - float(np.vdot(values, residual)), 0.0)
        s = product / square if square > 0 else 0.0
        limit = alpha / peak if peak > 0 else np.inf
        s = min(max(s, -limit), limit)
        primal = 0.5 * square + alpha * float(self.penalty.norm(values))
        return 2.0 * max(primal - s * product + 0.5 * s * s * square, 0.0)

    def _newcomers(self, duals: Array, alpha: float, used: BoolArray) -> IntArray:
        """The groups not in use that object most to that."""
        others = np.flatnonzero((duals > alpha) & ~used)
        return others[np.argsort(-duals[others])[:NEWCOMERS]]

    def _sweep(self, values: Array, residual: Array, alpha: float, numbers: IntArray) -> None:
        """Improve these groups one after the other; values and residual change."""
        for number in numbers.tolist():
            group = self.groups[number]
            old = values[group.columns]
            new = group.improved(old, residual[group.columns], alpha)
            change = new - old
            if change.any():
                values[group.columns] = new
                residual -= group.rows.T @ change

    def _open(
        self, within: Penalty, values: Array, residual: Array, alpha: float, used: BoolArray
    ) -> None:
        """Let blocks at zero in groups in use in, along C_h less what the penalty takes of it.

        The step is the least of a parabola above the objective along that direction.
        """
        sizes, limit = within.block_norms(residual), alpha * within.weights[:, None]
        inside = np.zeros(len(limit), dtype=bool)
        inside[within.groups] = used[self.penalty.groups]
        closed = inside[:, None] & (within.block_norms(values) == 0.0)
        excess = np.where(closed, np.maximum(sizes - limit, 0.0), 0.0)
        most = float(excess.max())
        if most <= OPTIMAL * alpha:
            return
        excess[excess < WORTH * most] = 0.0
        share = excess / np.where(sizes > 0, sizes, 1.0)
        direction = residual * share[within.groups]
        on = np.flatnonzero(direction.any(axis=1))
        moved = self.gram[:, on] @ direction[on]
        gain = float(np.vdot(direction, direction))
        norms = self.penalty.block_norms(values)[:, 0]
        pull = alpha * self.penalty.weights / np.where(norms > 0, norms, 1.0)
        bend = pull[self.penalty.groups] @ np.square(direction).sum(axis=1)
        step = gain / (float(np.vdot(direction, moved)) + float(bend))
        values += step * direction
        residual -= step * moved

    def _newton(self, values: Array, residual: Array, alpha: float) -> None:
        """A Newton step on the coefficients in use, as far as it descends; values change."""
        from scipy.linalg.lapack import dposv  # who reads an estimator need not wait for it

        column, target = np.nonzero(values)
        if not len(column):
            return
        start, pull = values[column, target], residual[column, target]
        square = self.gram[np.ix_(column, column)]
        if values.shape[1] > 1:
            square = np.where(target[:, None] == target, square, 0.0)
        layers = self._layers(column, target)
        gradient, curvature = -pull, square.copy()
        for block, weights in layers:
            norms = np.sqrt(np.bincount(block, start * start))
            force = alpha * weights / norms[block]
            gradient = gradient + force * start
            unit = start / norms[block]
            curvature.flat[:: len(start) + 1] += force
            same = block[:, None] == block
            curvature -= np.where(same, (force * unit)[:, None] * unit, 0.0)
        curvature.flat[:: len(start) + 1] += DAMPING * np.trace(curvature) / len(start)
        _, step, failed = dposv(curvature.T, -gradient, lower=1)
        if failed:
            step = -np.linalg.lstsq(curvature, gradient, rcond=1e-12)[0]

        def height(point: Array) -> float:
            moved = point - start
            norms = sum(
                float(np.sum(weights * np.abs(_share(point, block)))) for block, weights in layers
            )
            return float(moved @ (0.5 * (square @ moved) - pull)) + alpha * norms

        least = height(start)
        for halving in range(HALVINGS):
            point = start + 0.5**halving * step
            for block, _ in layers:
                point = np.where(np.bincount(block, point * start)[block] < 0.0, 0.0, point)
            if height(point) < least:
                values[column, target] = point
                return

    def _layers(self, column: IntArray, target: IntArray) -> list[tuple[IntArray, Array]]:
        """For each kind of block, the block of each coefficient and the weight of that block."""
        layers = []
        for part in (self.penalty, self.penalty.within):
            if part is not None and part.weights.any():
                own = part.groups[column]
                number = own if part.joint else own * self.cross.shape[1] + target
                layers.append((np.unique(number, return_inverse=True)[1], part.weights[own]))
        return layers


def _share(point: Array, block: IntArray) -> Array:
    """Entries that sum up to the norms of their blocks: v_j^2 / |V_b|."""
    squares = point * point
    norms = np.sqrt(np.bincount(block, squares))
    shares: Array = squares / np.where(norms > 0, norms, 1.0)[block]
    return shares
