"""Paths with Huber's loss: the squares with an outlier for each row, penalised by absolute values.

    h_c(r) = min over o of (r - o)^2/2 + c |o|

makes the LASSO with Huber's loss a LASSO with the squares on [Z, sqrt(m) I], whose weights are
those of Z and the outliers o/sqrt(m), of penalty c/(sqrt(m) alpha); an intercept along e is
projected off both, I - e e'. Both are solved by proximal points on the columns of Z that are in
play. The identity is not stored: the outliers are eliminated from Newton's systems, so that memory
is that of Z and a step takes m c^2 operations for c columns in use. Where no residual is beyond the
knot the LASSO is the optimum, and its path faster: it is taken from the first such penalty on.

Source: She and Owen, J. Am. Stat. Assoc. 106 (2011) 626-639.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from sparsefit.arrays import Array, IntArray
from sparsefit.errors import InputError
from sparsefit.regression.design import Design
from sparsefit.regression.penalties import AbsoluteValues, Penalty
from sparsefit.solvers.kernels import STOP, Points
from sparsefit.solvers.newton import Columns, solved_by_newton

START = 200  # columns in play at first
FEASIBLE = 3e-10  # relative excess of a correlation over alpha that lets no column join
GROSS = 10.0  # knots, at which a target is cut off at first


@dataclass(frozen=True, eq=False)
class WithOutliers(Columns):
    """The sums of (I - e e') [Z, sqrt(m) I], of which ``rows`` holds Z (m, j), orthogonal to e.

    direction e, or None without an intercept; weights are (j + m, 1).
    """

    def times(self, values: Array) -> Array:
        """G V (j + m, 1) of the coefficients and outliers V."""
        assert self.rows is not None
        count, root = self.rows.shape[1], np.sqrt(self.samples)
        fitted = self.off(self.rows @ values[:count] + root * values[count:])
        return np.concatenate([self.rows.T @ fitted, root * fitted]) / self.samples

    def solved(self, on: IntArray, factor: Any, pull: Array, step: float, targets: int) -> Array:
        """s (I + s G_on)^-1 pull (c,) on the coefficients and outliers ``on`` (c,).

        With A the columns and b the rows of those, the block of the outliers is
        (1 + s) I - s e_b e_b', and I + s/m Z_A' (D - D e e'D / e'D e) Z_A remains of the columns,
        D = 1/(1 + s) on the rows b and 1 elsewhere.
        """
        assert self.rows is not None
        split = int(np.searchsorted(on, self.rows.shape[1]))
        row, share = on[split:] - self.rows.shape[1], step / (1.0 + step)
        along = np.zeros(len(row)) if self.direction is None else self.direction[row]
        rate = step / (1.0 + step * (1.0 - float(along @ along)))

        def without_columns(right: Array) -> Array:
            """The block's inverse times s."""
            solution: Array = share * (right + rate * float(along @ right) * along)
            return solution

        if split == 0:
            return without_columns(pull)
        part = self.rows[:, on[:split]]
        outlying, weight = part[row] / np.sqrt(self.samples), np.ones(len(part))
        weight[row] = np.sqrt(1.0 - share)
        part *= weight[:, None]
        if self.direction is not None:
            weight *= self.direction
            weight /= np.linalg.norm(weight)
            part -= np.multiply.outer(weight, weight @ part)
        reduced = Columns(self.penalty, self.cross, self.samples, None, part)
        right = pull[:split] - outlying.T @ without_columns(pull[split:])
        first = reduced.solved(np.arange(split), None, right, step, 1)
        return np.concatenate([first, without_columns(pull[split:] - outlying @ first)])


def outlier_path(
    design: Design,
    target: Array,
    cross: Array,
    penalty: Penalty,
    alphas: Array,
    squares: Callable[..., Points],
) -> Points:
    """The optimum at descending penalties alphas (p,) of Huber's loss, for targets (m, n).

    cross Z'Y/m (k, n); squares(target=, alphas=): the path of the LASSO. Raises InputError where
    the penalty is not the LASSO's.
    """
    if type(penalty) is not AbsoluteValues or penalty.ridge:
        name = type(penalty).__name__
        raise InputError(f"Huber's loss takes absolute values as the penalty, not {name}")
    points, loss = Points.zeros(len(alphas), cross, "newton, an outlier for each row"), penalty.loss
    reach, target = loss.bound(target), loss.centred(target)
    for t in np.flatnonzero(target.any(axis=0)):
        y, knot, at = target[:, [t]], reach[:, [t]], np.arange(len(alphas))
        cut = GROSS * knot  # beyond the knot the loss is linear: how far off y is does not matter
        while len(at):
            near = np.clip(y, -cut, cut)
            part = _one_target(design, near, knot, penalty, alphas[at], squares)
            points.weights[at, :, t] = part.weights[:, :, 0]
            points.complete[at] &= part.complete
            points.steps[at] += part.steps
            fitted = np.hstack([design.predict(values) for values in part.weights])
            rest = loss.clipped(near - fitted, np.tile(knot, (1, len(at))))[0]
            at = at[np.any((np.abs(y) > cut) & (np.abs(rest) < knot), axis=0)]
            cut = GROSS * cut
    return points


def _one_target(
    design: Design,
    target: Array,
    knot: Array,
    penalty: AbsoluteValues,
    alphas: Array,
    squares: Callable[..., Points],
) -> Points:
    """The path for one target (m, 1), with the knot (1, 1), or (m, 1) of weighted samples."""
    k, root, along = penalty.columns, np.sqrt(design.samples), penalty.loss.direction
    pull = design.correlate(np.clip(target, -knot, knot))
    points, target = Points.zeros(len(alphas), pull), design.off(target)
    level = float(np.linalg.norm(target)) / root
    y, knot = target / level, knot / level
    index = np.sort(np.argsort(-np.abs(pull[:, 0]), kind="stable")[:START])
    rows, values = design.columns(index), np.zeros((len(index) + len(y), 1))
    plain: Points | None = None
    for i, alpha in enumerate((alphas / level).tolist()):
        if i and plain is None and not values[len(index) :].any():
            plain = squares(target=y, alphas=alphas / level)
        if plain is not None:
            residual, clipped = penalty.loss.clipped(y - design.predict(plain.weights[i]), knot)
            if np.array_equal(residual, clipped):
                points.weights[i], points.complete[i] = plain.weights[i] * level, plain.complete[i]
                continue
        price = np.broadcast_to(knot, y.shape)[:, 0] / (root * alpha)
        while True:
            weights = AbsoluteValues(np.concatenate([penalty.weights[index], price]))
            sums = np.concatenate([rows.T @ y, root * y]) / design.samples
            on = WithOutliers(weights, sums, design.samples, None, rows, direction=along)
            values, gap, steps = solved_by_newton(on, alpha, values, STOP)
            points.steps[i] += steps
            if len(index) == k:
                break
            rest = penalty.loss.clipped(y - rows @ values[: len(index)], knot)[1]
            excess = np.abs(design.correlate(rest)[:, 0]) / (alpha * penalty.weights) - 1.0
            excess[index] = -1.0
            new = np.argsort(-excess, kind="stable")[: max(len(index) // 2, 1)]
            new = np.sort(new[excess[new] > FEASIBLE])
            if not len(new):
                break
            values = np.insert(values, len(index), np.zeros((len(new), 1)), axis=0)
            index, rows = np.append(index, new), np.hstack([rows, design.columns(new)])
        points.weights[i, index] = values[: len(index)] * level
        points.complete[i] = gap <= STOP
    return points
