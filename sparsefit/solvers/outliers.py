"""Paths with Huber's loss, penalised by absolute values: squares within the knot, by turns.

Where the rows I are those of |r_i| < c, the loss is quadratic near V, and the next V is the LASSO

    minimise over V:   (V - V0)'H (V - V0)/2 - (V - V0)'Z'u/m + alpha Omega(V),   H = Z_I'Z_I/m,

u = clip(R, c), by its exact path on H; an intercept along e takes the part along e_I off Z_I. The
step is damped, by H + d I, until the objective falls. As the loss is quadratic by pieces, the
optimum is reached once the rows are right. All columns are tested by Z'u, and those that violate
the conditions join.

Source: Lee, Sun and Saunders, SIAM J. Optim. 24 (2014) 1420-1443, proximal Newton methods.
"""

import numpy as np

from sparsefit.arrays import Array, BoolArray
from sparsefit.errors import InputError
from sparsefit.regression.design import Design
from sparsefit.regression.penalties import AbsoluteValues, Penalty
from sparsefit.solvers.kernels import Points, path_on_gram

START = 200  # columns in play at first
FEASIBLE = 3e-10  # relative excess of a correlation over alpha that lets no column join
ROUNDS = 300  # steps at one penalty
LEAST, FIRST = 1e-12, 1e-6  # damping of unit columns, and where the objective would rise


def outlier_path(
    design: Design, target: Array, cross: Array, penalty: Penalty, alphas: Array
) -> Points:
    """The optimum at descending penalties alphas (p,) of Huber's loss, for targets (m, n).

    cross Z'Y/m (k, n). Raises InputError where the penalty is not the LASSO's.
    """
    if type(penalty) is not AbsoluteValues or penalty.ridge:
        name = type(penalty).__name__
        raise InputError(f"Huber's loss takes absolute values as the penalty, not {name}")
    points = Points.zeros(len(alphas), cross, "homotopy within the knot")
    loss, knots, target = penalty.loss, penalty.loss.bound(target), penalty.loss.centred(target)
    for t in np.flatnonzero(target.any(axis=0)):
        y, knot = target[:, [t]], knots[:, [t]]
        pull = np.abs(design.correlate(loss.clipped(y, knot)[1])[:, 0]) / penalty.weights
        index = np.sort(np.argsort(-pull, kind="stable")[:START])
        rows, values = design.columns(index), np.zeros((len(index), 1))
        for i, alpha in enumerate(alphas.tolist()):
            new = index
            while len(new):
                part = penalty.restricted(index)
                values, solved, steps = _optimum(rows, y, knot, part, alpha, values, design.samples)
                points.steps[i] += steps
                rest = loss.clipped(y - rows @ values, knot)[1]
                excess = np.abs(design.correlate(rest)[:, 0]) / (alpha * penalty.weights) - 1.0
                excess[index] = -1.0
                new = np.argsort(-excess, kind="stable")[: max(len(index) // 2, 1)]
                new = np.sort(new[excess[new] > FEASIBLE])
                values = np.vstack([values, np.zeros((len(new), 1))])
                index, rows = np.append(index, new), np.hstack([rows, design.columns(new)])
            points.weights[i, index, t] = values[:, 0]
            points.complete[i] &= solved
    return points


def _optimum(
    rows: Array,
    y: Array,
    knot: Array,
    penalty: AbsoluteValues,
    alpha: float,
    values: Array,
    samples: int,
) -> tuple[Array, bool, int]:
    """The optimum (j, 1) on columns Z (m, j) from any values, whether it is one, and the steps."""
    loss, ours = penalty.loss, np.array([alpha])

    def at(v: Array) -> tuple[float, Array, BoolArray]:
        residual, pull = loss.clipped(y - rows @ v, knot)
        height = float(np.vdot(pull, residual - 0.5 * pull)) / samples
        return height + alpha * float(penalty.norm(v)), pull, (np.abs(residual) < knot)[:, 0]

    (height, pull, inside), damping = at(values), LEAST
    for count in range(ROUNDS):
        part = rows[inside]
        if loss.direction is not None and (along := loss.direction[inside]).any():
            part = part - np.multiply.outer(along / (along @ along), along @ part)
        square = part.T @ part / samples
        square.flat[:: len(square) + 1] += damping
        cross = square @ values + rows.T @ pull / samples
        size = float(np.vdot(pull, pull)) / samples or 1.0
        path = path_on_gram(square, cross, penalty, ours, size)
        moved = path.weights[0]
        after, solved = at(moved), bool(path.complete[0])
        if after[0] <= height * (1.0 + 1e-15):
            same = np.array_equal(inside, after[2])
            error = damping * float(np.abs(moved - values).max())
            values, (height, pull, inside) = moved, after
            if solved and same and error <= 1e-12 * alpha:
                return values, True, count
        else:
            solved = False
        damping = max(0.3 * damping, LEAST) if solved else max(4.0 * damping, FIRST)
    return values, False, ROUNDS
