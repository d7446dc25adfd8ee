"""LASSO and elastic net of a sparse design: coordinate descent, and an exact polish without Z'Z.

A path begins at each penalty on the line through its last two points. The working set has the
columns that the strong rule admits, and the support. On it coordinate descent finds signs s; the
optimum for these signs on the support A,

    (Z_A'Z_A/m + mu I) v = Z_A'y/m - alpha w s,

is approached by conjugate gradients with Z_A itself until a sign would change; such columns become
zero. One product Z'R tests the optimality conditions of all columns. Supports may have thousands
of columns: no matrix is formed.

Sources: Tibshirani et al., J. R. Stat. Soc. B 74 (2012) 245-266, the strong rule; Hestenes and
Stiefel, J. Res. NBS 49 (1952) 409-436.
"""

from importlib import import_module

import numpy as np

from sparsefit.arrays import Array, BoolArray, IntArray
from sparsefit.regression.design import Design
from sparsefit.regression.penalties import AbsoluteValues
from sparsefit.solvers.newton import by_gradients
from sparsefit.solvers.working_set import Columns, sparse_columns

ROUGH = 1e-3  # of alpha: the largest move of a sweep, at which descent ends
SHARPER = 0.1  # by which that is multiplied where its signs are not those of the optimum
SWEEPS = 1000  # at most, of one descent
ROUNDS, POLISHES = 40, 40
INEXACT = 0.1  # of its first residual, to which a polish is solved while signs change
EXACT = 1e-10  # of alpha: the error of a correlation at an optimum


class Walk:
    """The iterate along a path: V (k,) and the residual (m,), both updated in place."""

    def __init__(self, design: Design, target: Array, penalty: AbsoluteValues) -> None:
        self.design, self.penalty, self.scale = design, penalty, 1.0 / design.rms
        self.residual = np.array(target, dtype=np.float64)
        self.values, self.steps = np.zeros(design.shape[1]), 0

    def settle(self, alpha: float, in_play: BoolArray) -> tuple[Array, bool]:
        """Solve at a penalty: Z'R/m (k,), and whether it is solved."""
        limits, ridge = alpha * self.penalty.weights, alpha * self.penalty.ridge
        alpha, rough, pull = float(limits.max()), ROUGH, limits
        if 2 * np.count_nonzero(in_play) > len(in_play):  # sweeps over all cost less than a polish
            in_play[:] = True
        for _ in range(ROUNDS):
            self._descend(limits, ridge, np.flatnonzero(in_play), rough * alpha)
            for _ in range(POLISHES):
                if self._polish(limits, ridge, alpha):
                    break
            pull = self.design.correlate(self.residual[:, None])[:, 0]
            zero = self.values == 0
            rest = np.abs(pull - ridge * self.values - limits * np.sign(self.values))
            objecting = zero & (rest > limits * (1.0 + EXACT))
            signs_held = bool(np.all(zero | (rest <= EXACT * alpha)))
            if signs_held and not objecting.any():
                return pull, True
            if not signs_held or not (objecting & ~in_play).any():
                rough *= SHARPER
            in_play |= objecting
        return pull, False

    def _descend(self, limits: Array, ridge: float, columns: IntArray, stop: float) -> None:
        design, matrix = self.design, self.design.csc
        sweep = import_module("sparsefit.solvers.sweeps").descend
        theta = (matrix.data, matrix.indices, matrix.indptr)
        ours = (columns, self.scale, design.means, limits, ridge, float(design.samples))
        state = (self.residual, self.values)
        steps, shift = sweep(*theta, *ours, *state, stop, SWEEPS)
        self.steps += steps
        if design.direction is not None:
            self.residual -= shift * design.direction

    def _polish(self, limits: Array, ridge: float, alpha: float) -> bool:
        """Go towards the optimum for the present signs; whether they hold there."""
        used, design = np.flatnonzero(self.values), self.design
        values, limits = self.values[used], limits[used]
        part = Columns(self.penalty, limits, None, sparse_columns(design, used), design)

        def times(x: Array) -> Array:
            return part.times(x) + ridge * x

        def has_flips(x: Array, rest: float) -> bool:
            return rest <= INEXACT * size and bool(np.any(values * (values + x) <= 0))

        pull = part.across @ self.residual / design.samples
        pull -= ridge * values + limits * np.sign(values)
        size = float(np.abs(pull).max(initial=0.0))
        if size <= EXACT * alpha:
            return True
        move, steps, _ = by_gradients(times, pull, None, 0.5 * EXACT * alpha, has_flips)
        flips = np.flatnonzero(values * (values + move) <= 0)
        until = -values[flips] / move[flips]
        share = float(until.min(initial=1.0))
        self.residual -= share * part.fitted(move)
        self.values[used], self.steps = values + share * move, self.steps + steps
        self.values[used[flips[until <= share]]] = 0.0
        return share == 1.0


def descent_path(
    design: Design, target: Array, cross: Array, penalty: AbsoluteValues, alphas: Array
) -> tuple[Array, BoolArray, IntArray]:
    """Weights V (p, k) of a target (m,) at alphas (p,), which are solved, and steps; cross (k,)."""
    count, k = len(alphas), len(cross)
    walk = Walk(design, target, penalty)
    weights, complete = np.zeros((count, k)), np.zeros(count, bool)
    steps, pull, last = np.zeros(count, np.intp), cross, walk.residual.copy()
    for i, alpha in enumerate(alphas.tolist()):
        before = float(alphas[i - 1]) if i else alpha
        strong = penalty.weights * (2.0 * alpha - before)
        in_play = (np.abs(pull) >= strong) | (walk.values != 0)
        if not walk.values.any() and np.all(np.abs(pull) <= alpha * penalty.weights * (1 + EXACT)):
            complete[i] = True
            continue
        taken, residual = walk.steps, walk.residual.copy()
        if i > 1 and alphas[i - 2] > before:  # the path is nearly straight: begin further along
            share = min((before - alpha) / (float(alphas[i - 2]) - before), 1.0)
            walk.values += share * (walk.values - weights[i - 2])
            walk.residual += share * (residual - last)
        last = residual
        pull, complete[i] = walk.settle(alpha, in_play)
        weights[i], steps[i] = walk.values, walk.steps - taken
    return weights, complete, steps
