"""LASSO and elastic net of a sparse design: coordinate descent, and an exact polish without Z'Z.

At each penalty the working set has the columns that the strong rule admits, and the support. On it
coordinate descent finds signs s; the optimum for these signs on the support A,

    (Z_A'Z_A/m + mu I) v = Z_A'y/m - alpha w s,

is approached by conjugate gradients with Z_A itself until a sign would change; such columns become
zero. One product Z'R tests the optimality conditions of all columns. Supports may have thousands
of columns: no matrix is formed.

Sources: Tibshirani et al., J. R. Stat. Soc. B 74 (2012) 245-266, the strong rule; Hestenes and
Stiefel, J. Res. NBS 49 (1952) 409-436.
"""

from importlib import import_module
from typing import Any

import numpy as np

from sparsefit.arrays import Array, BoolArray, IntArray
from sparsefit.regression.design import Design
from sparsefit.regression.penalties import AbsoluteValues

ROUGH = 1e-3  # of alpha: the largest move of a sweep, at which descent ends
SHARPER = 0.1  # by which that is multiplied where its signs are not those of the optimum
SWEEPS = 1000  # at most, of one descent
ROUNDS, POLISHES = 40, 40
INEXACT = 0.1  # of its first residual, to which a polish is solved while signs change
GRADIENTS = 2000  # steps of conjugate gradients, at most
EXACT = 1e-10  # of alpha: the error of a correlation at an optimum


class Walk:
    """The iterate along a path: V (k,) and the residual (m,), both updated in place."""

    def __init__(self, design: Design, target: Array) -> None:
        self.design, self.scale = design, 1.0 / design.rms
        self.residual = np.array(target, dtype=np.float64)
        self.values, self.steps = np.zeros(design.shape[1]), 0

    def settle(self, limits: Array, ridge: float, in_play: BoolArray) -> tuple[Array, bool]:
        """Solve at limits alpha w (k,) and a ridge: Z'R/m (k,), and whether it is solved."""
        alpha, rough, pull = float(limits.max()), ROUGH, limits
        if 2 * np.count_nonzero(in_play) > len(in_play):  # sweeps over all cost less than a polish
            in_play[:] = True
        for _ in range(ROUNDS):
            self._descend(limits, ridge, np.flatnonzero(in_play), rough * alpha)
            self._polish(limits, ridge, alpha)
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

    def _polish(self, limits: Array, ridge: float, alpha: float) -> None:
        """Go towards the optimum for the present signs, and for those that remain of them."""
        samples = float(self.design.samples)
        for _ in range(POLISHES):
            used = np.flatnonzero(self.values)
            part, values, scale = self.design.csc[:, used], self.values[used], self.scale[used]
            pull = scale * (part.T @ self.residual) / samples  # R has no part along e
            pull -= ridge * values + limits[used] * np.sign(values)
            if np.abs(pull).max(initial=0.0) <= EXACT * alpha:
                return
            move, moved = self._solved(used, part, pull, ridge, 0.5 * EXACT * alpha)
            flips = np.flatnonzero(values * (values + move) <= 0)
            share = float((-values[flips] / move[flips]).min(initial=1.0))
            self.residual -= share * moved
            self.values[used] = values + share * move
            if share == 1.0:
                return
            self.values[used[flips[-values[flips] / move[flips] <= share]]] = 0.0

    def _solved(
        self, used: IntArray, part: Any, right: Array, ridge: float, stop: float
    ) -> tuple[Array, Array]:
        """x of (Z_A'Z_A/m + mu I) x = right by conjugate gradients, and Z_A x.

        They end at an error ``stop``, or INEXACT of the first where x changes signs.
        """
        x, image, values = np.zeros(len(right)), np.zeros(part.shape[0]), self.values[used]
        rest, direction, enough = right.copy(), right.copy(), INEXACT * np.abs(right).max()
        square, across, design = float(rest @ rest), part.T, self.design
        samples, scale, means = float(design.samples), self.scale[used], design.means[used]
        for _ in range(GRADIENTS):
            size = np.abs(rest).max()
            if size <= stop or (size <= enough and np.any(values * (values + x) <= 0)):
                break
            scaled = scale * direction
            seen = part @ scaled
            if design.direction is not None:
                seen -= float(means @ scaled) * design.direction
            curvature = float(seen @ seen) / samples + ridge * float(direction @ direction)
            if curvature <= 0.0:
                break
            length = square / curvature
            x += length * direction
            image += length * seen
            rest -= length * (scale * (across @ seen) / samples + ridge * direction)
            before, square = square, float(rest @ rest)
            direction = rest + (square / before) * direction
            self.steps += 1
        return x, image


def descent_path(
    design: Design, target: Array, cross: Array, penalty: AbsoluteValues, alphas: Array
) -> tuple[Array, BoolArray, IntArray]:
    """Weights V (p, k) of one target (m,) at descending alphas (p,), which are solved, and steps.

    cross Z'y/m (k,).
    """
    count, k = len(alphas), len(cross)
    walk = Walk(design, target)
    weights, complete = np.zeros((count, k)), np.zeros(count, bool)
    steps, pull, before = np.zeros(count, np.intp), cross, None
    for i, alpha in enumerate(alphas.tolist()):
        strong = penalty.weights * (2.0 * alpha - (before or alpha))
        in_play = (np.abs(pull) >= strong) | (walk.values != 0)
        taken = walk.steps
        before = alpha
        if not walk.values.any() and np.all(np.abs(pull) <= alpha * penalty.weights * (1 + EXACT)):
            complete[i] = True
            continue
        pull, complete[i] = walk.settle(alpha * penalty.weights, alpha * penalty.ridge, in_play)
        weights[i], steps[i] = walk.values, walk.steps - taken
    return weights, complete, steps
