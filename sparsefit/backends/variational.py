"""Exact group-LASSO path from sufficient statistics by projected Newton on group variances.

With ``||v|| = min over e > 0 of (||v||^2 / e + e) / 2`` the group-LASSO

    min over W of  sum_t [w_t'G w_t / 2 - b_t'w_t] + alpha * sum_g omega_g ||W_g||_F

becomes, after W is eliminated, smooth and convex in one variable per group, eta >= 0:

    f(eta) = -tr(B'(G + D^-1)^-1 B) / 2 + (alpha^2 / 2) sum_g eta_g,    D = diag(eta of the group)
    C = B - G W,   W_g = eta_g C_g,   df/deta_g = (alpha^2 - ||C_g||^2) / 2
    Hessian_gh = sum_t C_gt' K_gh C_ht,   K = G (I + D G)^-1

omega is absorbed by scaling the columns. ``I + D^1/2 G D^1/2`` over the positive groups is well
conditioned where G is singular. The optimality equation ||C_g|| = alpha is linearised as
1/||C_g|| = 1/alpha, nearly affine in eta: the device of the trust-region secular equation.

Sources: Micchelli, Morales and Pontil, "Regularizers for structured sparsity" (2013), for the
quadratic form; More and Sorensen, "Computing a trust region step" (1983), for the secular one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg.lapack import dpotrs

from sparsefit.arrays import Array, BoolArray, IntArray
from sparsefit.backends.variational_compiled import compiled_loop, compiled_path
from sparsefit.backends.variational_point import (
    Point,
    Problem,
    Support,
    bordered,
    evaluate,
    group_squares,
    normalise,
)
from sparsefit.backends.variational_step import bounded_minimum

Engine: TypeAlias = Literal["compiled", "python"]

_NEW_GROUPS = 8  # more violators at once only make the subproblem larger: most do not stay
_ITERATIONS = 80
_CHORDS = 8  # corrections on an old factor before a new one pays off
_POOR = 1e-3  # a relative gap above which corrections do not converge
_NEGLIGIBLE = 1e-11  # eta times the group's power: its curvature would be lost to rounding
_FLOOR = 1e-15  # a relative gap that double precision cannot improve


@dataclass(frozen=True, eq=False)
class GroupPath:
    """Weights (p, k, n), factorisations spent (p,), relative gaps (p,), gap <= tolerance (p,).

    engine: the loop that ran, compiled or this module's.
    """

    weights: Array
    iterations: IntArray
    gaps: Array
    complete: BoolArray
    engine: Engine


@dataclass(frozen=True, eq=False)
class _Candidate:
    """Weights on the columns of the support, their exact correlation and relative duality gap."""

    support: Support
    weights: Array
    correlation: Array
    gap: float


def group_path(
    gram: ArrayLike,
    cross: ArrayLike,
    groups: ArrayLike,
    omega: ArrayLike,
    alphas: ArrayLike,
    target_square: ArrayLike,
    *,
    tolerance: float = 1e-10,
    engine: Engine | None = None,
) -> GroupPath:
    """Minimise the group-LASSO objective at every penalty, each started from the one before.

    gram (k, k) = Z'Z/m and cross (k, n) = Z'Y/m of unit-rms columns; groups (k,) integers in
    0..g-1, in any order, none empty; omega (g,) > 0; alphas (p,) > 0, best descending;
    target_square = |Y|^2/m, one number or one per target. All targets share one norm per group.
    A point is complete when (primal - dual) / (|Y|^2 / 2m) <= tolerance, the dual point being
    the residual scaled into the feasible set; otherwise it carries the best iterate.
    engine: ``compiled`` or ``python``, the same algorithm; by default compiled where it was built.
    Raises ImportError where ``compiled`` is asked for and was not.
    """
    loop, missing = compiled_loop() if engine != "python" else (None, "")
    if engine == "compiled" and loop is None:
        raise ImportError(f"the compiled group-LASSO path is not there: {missing}")
    ran: Engine = "python" if loop is None else "compiled"
    penalties = np.atleast_1d(np.asarray(alphas, dtype=float))
    targets = np.asarray(cross, dtype=float)
    scale = float(np.sqrt(np.sum(target_square)))
    if scale == 0.0 or not np.any(targets):
        return _zero_path(penalties.size, targets.shape, ran)
    problem, order, column_scale = normalise(gram, targets / scale, groups, omega)
    if loop is not None:
        found, iterations, gaps = compiled_path(loop, problem, penalties / scale, tolerance)
        weights = np.empty_like(found)
        weights[:, order] = found * (scale / column_scale)[:, None]
        return GroupPath(weights, iterations, gaps, gaps <= tolerance, ran)
    point = evaluate(problem, np.zeros(problem.sizes.size), None)
    assert point is not None  # nothing to factorise at eta = 0
    weights = np.zeros((penalties.size, *targets.shape))
    iterations = np.zeros(penalties.size, np.intp)
    gaps = np.zeros(penalties.size)
    for i, alpha in enumerate(penalties / scale):
        point, best, iterations[i] = _minimise(problem, point, float(alpha), tolerance)
        columns = best.support.columns
        weights[i, order[columns]] = best.weights * (scale / column_scale[columns, None])
        gaps[i] = best.gap
    return GroupPath(weights, iterations, gaps, gaps <= tolerance, ran)


def _zero_path(points: int, shape: tuple[int, ...], engine: Engine) -> GroupPath:
    done, none = np.ones(points, dtype=bool), np.zeros(points, np.intp)
    return GroupPath(np.zeros((points, *shape)), none, np.zeros(points), done, engine)


def _minimise(
    problem: Problem, point: Point, alpha: float, tolerance: float
) -> tuple[Point, _Candidate, int]:
    """Newton steps on eta from `point` until weights certified to `tolerance` are found."""
    best, goal = None, max(tolerance, _FLOOR)
    for iteration in range(_ITERATIONS):
        eta, reached = _predict(problem, point, alpha, goal)
        best = reached if best is None or reached.gap < best.gap else best
        if best.gap <= goal:
            return point, best, iteration
        new = _violators(reached.correlation, problem, point, alpha)
        if new.size:
            eta = _enlarged(problem, point, new, alpha, secular=True)
        following = _accept(problem, point, eta, new, alpha)
        if following is None:
            break
        point = following
    here = _candidate(problem, point.support, point.weights, point.correlation, alpha)
    return point, here if best is None or here.gap < best.gap else best, iteration + 1


def _candidate(
    problem: Problem, support: Support, weights: Array, correlation: Array, alpha: float
) -> _Candidate:
    """Relative duality gap of W with dual point s R: (1-s)^2 R'R + 2 (alpha |W| - s <C, W>)."""
    top = np.sqrt(np.max(problem.squares(correlation)))
    shrink = 1.0 if top <= alpha else alpha / float(top)
    columns = support.columns
    product = float(np.vdot(weights, correlation[columns]))
    residual = max(0.0, 1.0 - float(np.vdot(weights, problem.cross[columns])) - product)
    norm = float(np.sum(np.sqrt(group_squares(weights, support.label))))
    gap = residual * (1.0 - shrink) ** 2 + 2.0 * (alpha * norm - shrink * product)
    return _Candidate(support, weights, correlation, max(gap, 0.0))


def _drive(square: Array, alpha: float, *, secular: bool) -> Array:
    """Right-hand side of the Newton system for 1/||C|| = 1/alpha, or of the gradient of f."""
    if secular:
        return square * (np.sqrt(square) / alpha - 1.0)
    return 0.5 * (square - alpha**2)


def _predict(problem: Problem, point: Point, alpha: float, goal: float) -> tuple[Array, _Candidate]:
    """Newton step on the support, then chord steps on the same factor while they pay.

    From an approximate C and its defect rho = B - G D C - C (exact, a product with G):
    C + D^-1/2 A^-1 D^1/2 rho solves the linear part, and a change d of eta moves C by
    -K (d C). The exact correlation of W = eta C gives the certificate and the violators.
    """
    support, root = point.support, point.root[:, None]
    groups, label = support.groups, support.label
    inner, width, eta, gap = point.inner, point.eta[groups], point.eta, np.inf
    if not groups.size:
        return eta, _candidate(problem, support, point.weights, point.correlation, alpha)
    best = _Candidate(support, point.weights, point.correlation, gap)
    for _ in range(1 + _CHORDS):
        step = bounded_minimum(
            point.hessian, _drive(group_squares(inner, label), alpha, secular=True), -width
        )
        pushed = step[label][:, None] * inner / root
        inner = inner - (pushed - dpotrs(point.factor, pushed, lower=1)[0]) / root
        width = np.maximum(width + step, 0.0)
        weights = width[label][:, None] * inner
        correlation = problem.cross - support.rows.T @ weights
        reached = _candidate(problem, support, weights, correlation, alpha)
        if not reached.gap < 0.4 * gap:
            break
        best, gap, eta = reached, reached.gap, _moved(problem, point.eta, groups, width)
        if gap <= goal or gap > _POOR:
            break
        defect = correlation[support.columns] - inner
        inner = inner + dpotrs(point.factor, root * defect, lower=1)[0] / root
    return eta, best


def _violators(correlation: Array, problem: Problem, point: Point, alpha: float) -> IntArray:
    """Groups at eta = 0 whose correlation exceeds alpha, the worst few, ascending."""
    square = np.where(point.eta > 0, 0.0, problem.squares(correlation))
    new = np.flatnonzero(square > alpha**2)
    if new.size > _NEW_GROUPS:
        new = np.sort(new[np.argsort(-square[new])[:_NEW_GROUPS]])
    return new


def _enlarged(
    problem: Problem, point: Point, new: IntArray, alpha: float, *, secular: bool
) -> Array:
    """eta after the bounded Newton step on the support and the `new` groups together."""
    groups = np.concatenate([point.support.groups, new])
    hessian = bordered(problem, point, new) if new.size else point.hessian
    square = np.concatenate(
        [group_squares(point.inner, point.support.label), problem.squares(point.correlation)[new]]
    )
    step = bounded_minimum(hessian, _drive(square, alpha, secular=secular), -point.eta[groups])
    return _moved(problem, point.eta, groups, point.eta[groups] + step)


def _moved(problem: Problem, eta: Array, groups: IntArray, values: Array) -> Array:
    """eta with new values on `groups`; what rounding left just above the bound is zero."""
    moved = eta.copy()
    moved[groups] = np.where(values * problem.power[groups] > _NEGLIGIBLE, values, 0.0)
    return moved


def _accept(
    problem: Problem, point: Point, eta: Array, new: IntArray, alpha: float
) -> Point | None:
    """The point at eta if f does not rise there, else at a halved plain Newton step."""
    price = 0.5 * alpha**2
    bound = point.value + price * float(point.eta.sum())
    bound += 1e-13 * abs(bound)
    step, plain = eta - point.eta, False
    for _ in range(30):
        reached = evaluate(problem, point.eta + step, point.support)
        if reached is not None and reached.value + price * float(reached.eta.sum()) <= bound:
            return reached
        if plain:
            step = 0.5 * step
        else:  # only the plain step is sure to descend
            step = _enlarged(problem, point, new, alpha, secular=False) - point.eta
            plain = True
    return None
