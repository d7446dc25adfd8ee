"""The exact solver of every penalty that has a prox: proximal points by Newton's method.

    minimise over V (k, q):  sum_t [v_t'G v_t / 2 - b_t'v_t] + p(V),   p = alpha Omega

From V, the proximal point with step s is P = prox_{s p}(U), U = V + s C, C = B - G X, at the X for
which X = P. That is an equation in X whose residual F = P - X is -G^-1 times the gradient of

    psi(X) = <X, G X>/2 + (<U, P> - |P|^2/2)/s - p(P),

convex and once differentiable. With the derivative of the prox, N N', Newton's step is

    d = (I + s N N'G)^-1 F = F - s N (I + s N'G N)^-1 N'G F,

of the size of what is in use, and halved until psi falls; where the rows of all targets are fewer,
the inverse is taken in rows, L = Z N/sqrt(m):  (I + s L'L)^-1 = I - s L'(I + s L L')^-1 L. Proximal
points with growing steps converge faster than linearly, for polyhedral norms in finitely many; the
duality gap is the stop. Targets have |Y|^2/m = 1.

Sources: Rockafellar, SIAM J. Control Optim. 14 (1976) 877-898; Li, Sun and Toh, "A highly efficient
semismooth Newton augmented Lagrangian method for solving Lasso problems", SIAM J. Optim. 28 (2018).
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from sparsefit.arrays import Array
from sparsefit.regression.certificate import SHARES
from sparsefit.regression.ordered_penalties import SortedNorm
from sparsefit.solvers.working_set import Columns, definite

OUTER, INNER, HALVINGS = 60, 50, 25
FIRST, LARGEST = 10.0, 1e6  # steps of the proximal point, for columns of unit rms
PATIENCE = 6  # proximal points without a smaller gap
EXACT, GRADIENTS = 1e-13, 2000  # relative residual, and the most steps of conjugate gradients
STEPS = 500  # conjugate gradients at most for the levels of clusters
INEXACT = 0.1  # of the first residual, to which they are solved where two clusters meet
SHIFT = 1e-13  # of unit columns, where clusters are more than samples


def by_gradients(
    times: Callable[[Array], Array],
    right: Array,
    start: Array | None = None,
    stop: Array | float | None = None,
    ends: Callable[[Array, float], bool] | None = None,
    most: int = GRADIENTS,
) -> tuple[Array, int, bool]:
    """X (j,) or (j, q) of A X = right by conjugate gradients from ``start``, steps, and success.

    times(X): A X, A positive semidefinite; from zero X is the solution of least norm. stop: the
    largest residual, EXACT of the right side by default; ends(X, residual): whether X suffices.
    Source: Hestenes and Stiefel, J. Res. NBS 49 (1952) 409-436.
    """
    x = np.zeros(right.shape) if start is None else start.copy()
    rest = right if start is None else right - times(x)
    stop = EXACT * np.abs(right).max(axis=0, initial=0.0) if stop is None else stop
    direction, square = rest, np.sum(rest * rest, axis=0)
    for count in range(most):
        size = np.abs(rest).max(axis=0, initial=0.0)
        if np.all(size <= stop) or (ends is not None and ends(x, float(np.max(size)))):
            return x, count, True
        image = times(direction)
        curvature = np.sum(direction * image, axis=0)
        length = square / np.where(curvature > 0.0, curvature, np.inf)
        x += length * direction
        rest = rest - length * image
        before, square = square, np.sum(rest * rest, axis=0)
        direction = rest + square / np.where(before > 0.0, before, np.inf) * direction
    return x, most, False


@np.errstate(all="ignore")  # what breaks has no small gap
def solved_by_newton(
    on: Columns, alpha: float, values: Array, goal: float
) -> tuple[Array, float, int]:
    """The optimum (j, q) at one penalty from any values, its relative gap, and Newton's steps.

    The gap is above ``goal`` where further proximal points do not reduce it.
    """
    best, least, waited, steps, step = values, np.inf, 0, 0, FIRST
    for _ in range(OUTER):
        correlation = on.cross - on.times(values)
        gap = relative_gap(on, alpha, values, correlation)
        waited = 0 if gap < 0.5 * least else waited + 1
        if gap < least:
            best, least = values, gap
        if least <= goal or waited > PATIENCE:
            break
        enough = max(1e-27, 1e-6 * least / step)
        values, taken = _proximal_point(on, alpha, values, correlation, step, enough)
        steps += taken
        step = min(step * (10.0 if taken <= 6 else 2.0 if taken <= 12 else 0.5), LARGEST)
    return best, least, steps


def relative_gap(on: Columns, alpha: float, values: Array, correlation: Array) -> float:
    """(primal - dual) / (|Y|^2/2m) of V and C = B - G V: the dual point s R/m of the best s."""
    penalty = on.penalty
    product, ridge = 1.0 - float(np.vdot(values, on.cross)), alpha * penalty.ridge
    square = max(product - float(np.vdot(values, correlation)), 0.0)
    primal = 0.5 * square + alpha * float(penalty.value(values))
    if ridge:
        correlation = correlation - ridge * values
        square += ridge * float(np.vdot(values, values))
    peak = float(penalty.constraint(correlation).max(initial=0.0))
    limit = alpha / peak if peak > 0 else np.inf
    best = min(max(product / square if square > 0 else 0.0, -limit), limit)
    s = np.array([best, *np.minimum(limit, SHARES)] if penalty.is_bounded else [best])
    beyond = penalty.conjugate(np.multiply.outer(s, correlation), alpha).sum(axis=-1)
    dual = float((s * product - 0.5 * s**2 * square - beyond).max())
    return 2.0 * max(primal - dual, 0.0)


def _proximal_point(
    on: Columns, alpha: float, start: Array, correlation: Array, step: float, enough: float
) -> tuple[Array, int]:
    """The proximal point P of V = ``start``, until F'G F <= enough, and the Newton steps."""
    from scipy.sparse import eye_array  # who reads an estimator need not wait for it

    penalty = on.penalty
    shrink = 1.0 / (1.0 + step * alpha * penalty.ridge)  # the ridge's part of the prox
    inner = step * alpha * shrink
    x, targets = start, start.shape[1]

    def at(x: Array, correlation: Array) -> tuple[Array, Array, float]:
        pull = start + step * correlation
        point = penalty.prox(pull * shrink, inner)
        height = 0.5 * float(np.vdot(x, on.cross - correlation)) - alpha * float(
            penalty.value(point)
        )
        height += (float(np.vdot(pull, point)) - 0.5 * float(np.vdot(point, point))) / step
        return pull, point, height

    pull, point, height = at(x, correlation)
    for count in range(INNER):
        residual = point - x
        pulled = on.times(residual)
        if not float(np.vdot(residual, pulled)) > enough:
            return point, count
        live, factor = penalty.slope(pull * shrink, point, inner)
        move, moved = residual, pulled
        if len(live):
            if shrink != 1.0:
                factor = np.sqrt(shrink) * (eye_array(len(live)) if factor is None else factor)
            back = np.zeros(residual.size)
            back[live] = on.solved(live, factor, pulled.ravel()[live], step, targets)
            less = back.reshape(residual.shape)
            move, moved = residual - less, pulled - on.times(less)
        fall = float(np.vdot(residual, moved))
        if not fall > 0.0:
            return point, count
        share = 1.0
        for _ in range(HALVINGS):
            there = x + share * move
            after = at(there, correlation - share * moved)
            if after[2] <= height - 1e-4 * share * fall + 1e-15 * abs(height):
                break
            share *= 0.5
        else:
            return point, count
        x, correlation = there, correlation - share * moved
        pull, point, height = after
        if count % 8 == 7:
            correlation = on.cross - on.times(x)
    return point, INNER


def towards_clusters_optimum(on: Columns, alpha: float, values: Array) -> tuple[Array, bool]:
    """From V (j, 1) towards the optimum for its signs and clusters, of which some may meet.

    With the columns summed over each cluster, Z_C (m, d), their levels x at the optimum solve
    Z_C'Z_C/m x = Z_C'Y/m - alpha lambda_C. Where x does not descend to 0, those that meet are
    pooled, if the objective falls. Returns V, and whether clusters met.
    """
    from scipy.optimize import isotonic_regression  # who reads an estimator need not wait for it
    from scipy.sparse import csc_array

    assert isinstance(on.penalty, SortedNorm)
    size = np.abs(values[:, 0])
    order = np.argsort(-size, kind="stable")[: np.count_nonzero(size)]
    if not len(order):
        return values, False
    size, sign = size[order], np.sign(values[order, 0])
    first = np.concatenate([[0], np.flatnonzero(size[1:] != size[:-1]) + 1])
    counts, price = np.diff(first, append=len(order)), alpha * on.penalty.weights[: len(order)]
    right = np.add.reduceat(sign * on.cross[order, 0] - price, first)[:, None]
    shift, sign = SHIFT * counts[:, None], sign[:, None]
    level, sizes = size[first, None], list[float]()
    if on.gram is not None:
        square = on.gram.take(order, 0).take(order, 1) * (sign * sign.T)
        square = np.add.reduceat(np.add.reduceat(square, first, axis=0), first, axis=1)
        square.flat[:: len(square) + 1] += shift[:, 0]
        times: Callable[[Array], Array] = square.__matmul__
        levels = definite(square, right)
    else:
        columns = sign[:, 0], order, np.append(first, len(order))
        joined = csc_array(columns, shape=(len(values), len(first)))
        sums = replace(on, rows=on.rows @ joined)  # Z_C

        def times(x: Array) -> Array:
            return sums.times(x) + shift * x

        def meets(x: Array, rest: float) -> bool:  # roughly solved, as the way ends before
            sizes.append(rest)
            return rest <= INEXACT * sizes[0] and bool(np.any(np.diff(x[:, 0], append=0.0) > 0))

        levels = by_gradients(times, right, level, ends=meets, most=STEPS)[0]
    if levels is None:
        return values, False

    def pooled(x: Array) -> Array:
        flat = isotonic_regression(x[:, 0], weights=counts, increasing=False).x
        return np.maximum(flat, 0.0)[:, None]

    above, after = (-np.diff(x[:, 0], append=0.0) for x in (level, levels))
    meet = after < 0.0
    met = bool(meet.any())
    if met:  # those that do become one, where the objective falls, else the first that do
        whole = pooled(levels)
        move = whole - level
        fall, bend = (float(np.vdot(move, x)) for x in (right - times(level), times(move)))
        if fall < 0.5 * bend and on.gram is None:
            whole = level + max(fall / bend, 0.0) * move
        elif fall < 0.5 * bend:
            share = np.min(above[meet] / (above - after)[meet]) * (1.0 + 1e-12)
            whole = pooled(level + share * (levels - level))
        levels = whole
    out = np.zeros_like(values)
    out[order] = sign * np.repeat(levels, counts, axis=0)
    return out, met
