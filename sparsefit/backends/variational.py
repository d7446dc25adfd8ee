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

import numpy as np
from numpy.typing import ArrayLike

from sparsefit.arrays import Array, BoolArray, IntArray
from sparsefit.backends.loops import Loop, loaded

BACKEND = "group-lasso"  # whose loop this is


@dataclass(frozen=True, eq=False)
class GroupPath:
    """Weights (p, k, n), factorisations spent (p,), relative gaps (p,), gap <= tolerance (p,).

    loop: which of the two made them, "compiled" or "python".
    """

    weights: Array
    iterations: IntArray
    gaps: Array
    complete: BoolArray
    loop: Loop


def group_path(
    gram: ArrayLike,
    cross: ArrayLike,
    groups: ArrayLike,
    omega: ArrayLike,
    alphas: ArrayLike,
    target_square: ArrayLike,
    *,
    tolerance: float = 1e-10,
    loop: Loop | None = None,
) -> GroupPath:
    """Minimise the group-LASSO objective at every penalty, each started from the one before.

    gram (k, k) = Z'Z/m and cross (k, n) = Z'Y/m of unit-rms columns; groups (k,) integers in
    0..g-1, in any order, none empty; omega (g,) > 0; alphas (p,) > 0, best descending;
    target_square = |Y|^2/m, one number or one per target. All targets share one norm per group.
    A point is complete when (primal - dual) / (|Y|^2 / 2m) <= tolerance, the dual point being
    the residual scaled into the feasible set; otherwise it carries the best iterate.
    loop: None is the compiled one where it was built, else the interpreted one; both are made of
    one source. Raises ImportError where the compiled one is asked for and was not built.
    """
    search, ran = loaded(BACKEND, loop)
    penalties = np.atleast_1d(np.asarray(alphas, dtype=float))
    targets = np.asarray(cross, dtype=float)
    scale = float(np.sqrt(np.sum(target_square)))
    weights = np.zeros((penalties.size, *targets.shape))
    iterations, gaps = np.zeros(penalties.size, np.intp), np.zeros(penalties.size)
    if scale > 0.0 and np.any(targets):
        square, right, starts, order, omegas = _normalised(gram, targets / scale, groups, omega)
        solved = np.zeros((penalties.size, *right.shape))
        with np.errstate(all="ignore"):  # what breaks is caught by the gap, not by warnings
            search.path(
                *(square, right, starts, penalties / scale, tolerance),
                *(solved, iterations, gaps),
            )
        weights[:, order] = solved.transpose(0, 2, 1) * (scale / omegas)[:, None]
    return GroupPath(weights, iterations, gaps, gaps <= tolerance, ran)


def _normalised(
    gram: ArrayLike, cross: Array, groups: ArrayLike, omega: ArrayLike
) -> tuple[Array, Array, IntArray, IntArray, Array]:
    """Make groups contiguous and penalty weights one: z_j / omega_g has the weight w_j omega_g.

    Returns G (k, k), B' (n, k), where each group starts (g + 1,), the order of the columns (k,)
    and what each was divided by (k,).
    """
    labels, square = np.asarray(groups), np.asarray(gram, dtype=float)
    order = np.argsort(labels, kind="stable")
    scale = np.asarray(omega, dtype=float)[labels[order]]
    if np.any(order[1:] < order[:-1]):
        square, cross = square[np.ix_(order, order)], cross[order]
    if np.any(scale != 1.0):
        square, cross = square / np.multiply.outer(scale, scale), cross / scale[:, None]
    starts = np.concatenate([np.zeros(1, np.intp), np.cumsum(np.bincount(labels), dtype=np.intp)])
    return np.ascontiguousarray(square), np.ascontiguousarray(cross.T), starts, order, scale
