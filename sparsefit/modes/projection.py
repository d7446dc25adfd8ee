"""The projection: the best weights of s modes at given parameters, and where these would move.

At parameters q = (q_1 ... q_s), p each, the rows are

    Phi = sum_j Psi C(q_j) W_j + N b + E,

C the columns of a family, Psi averages or nothing, N nuisance columns. RSS(q) = min over W, b of
|E|^2 is a function of q alone (variable projection; Golub and Pereyra, 1973). With A the
derivatives of sum_j C(q_j) W_j by all s p parameters and P what projects off all columns, the
Gauss-Newton move solves

    A'P A dq = A'E.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sparsefit.arrays import Array
from sparsefit.library.family import Columns
from sparsefit.modes.fitted_rows import Rows

RANK = 1e-12  # eigenvalues of the scaled Gram matrix below this, relative, are dropped
ROUNDING = 8 * float(np.finfo(float).eps)  # of |Phi| |E|: falls of RSS below it are rounding


@dataclass(frozen=True, eq=False)
class Projection:
    """The fit of s modes at fixed parameters.

    Args:
        parameters: q, (s, p).
        residual: RSS [m^2/s^2].
        weights: W (s, c, n) [m/s].
        coefficients: b (j,) of the nuisance columns.
        rest: E (q, 2) [m/s], what is left of the rows.
        moves: the Gauss-Newton move of every parameter, (s, p); 0 where RSS is flat to rounding.
    """

    parameters: Array
    residual: float
    weights: Array
    coefficients: Array
    rest: Array
    moves: Array


def project(family: Columns, rows: Rows, parameters: Array) -> Projection:
    """Fit the rows by modes of the family at parameters (s, p); without modes by N alone."""
    modes, count = parameters.shape
    target, nuisance = rows.stacked(family)
    if not modes:
        rest, coefficients = left_beside(nuisance, target)
        none = np.zeros((0, family.size, family.targets))
        residual = float(np.sum(rest * rest))
        return Projection(
            parameters, residual, none, coefficients, rows.unstacked(rest), parameters
        )
    values = family.values(rows.position, parameters)
    design = rows.averaged(values.reshape(-1, values.shape[-1]))
    basis = _basis(design @ design.T)

    def onto(columns: Array) -> Array:
        weights: Array = basis @ (basis.T @ (design @ columns))
        return weights

    def freed(columns: Array) -> Array:
        left: Array = columns - design.T @ onto(columns)
        return left

    if nuisance.shape[2]:
        # Freed twice: the inverse is exact to 1e-10 only. All n in one column share b.
        loose = np.stack([freed(freed(columns)) for columns in nuisance])
        rest, coefficients = left_beside(loose, freed(freed(target)))
        weights = onto(target - np.einsum("tqj,j->qt", nuisance, coefficients))
    else:
        loose, coefficients = nuisance, np.zeros(0)
        weights = onto(target)
        rest = target - design.T @ weights
    blocks = weights.reshape(modes, family.size, -1)
    bent = family.bent(rows.position, parameters, values, blocks)
    bent = rows.averaged(bent.swapaxes(2, 3).reshape(-1, values.shape[-1]))  # rows, as the design
    side = bent - (bent @ design.T @ basis) @ (basis.T @ design)
    side = side.reshape(modes * count, -1, side.shape[1])
    if nuisance.shape[2]:
        side = np.stack([left_beside(loose, by_one.T)[0].T for by_one in side])
    squares = np.sum(bent.reshape(len(side), -1) ** 2, axis=1)
    moves = _moves(side.reshape(len(side), -1), rest.T.ravel(), squares)
    return Projection(
        parameters,
        float(np.sum(rest * rest)),
        blocks,
        coefficients,
        rows.unstacked(rest),
        moves.reshape(modes, count),
    )


def _basis(gram: Array) -> Array:
    """Weights (k, rank) of orthonormal columns, from the Gram matrix (k, k) less its null space."""
    scale = np.sqrt(gram.diagonal())
    scale[scale == 0] = 1.0
    roots, vectors = np.linalg.eigh(gram / (scale[:, None] * scale))
    kept = roots > RANK * roots[-1]
    basis: Array = vectors[:, kept] / np.sqrt(roots[kept]) / scale[:, None]
    return basis


def left_beside(columns: Array, target: Array) -> tuple[Array, Array]:
    """(what columns (n, r, j) leave of target (r, n), their coefficients (j,))."""
    if not columns.shape[2]:
        return target, np.zeros(0)
    stacked = columns.reshape(-1, columns.shape[2])
    coefficients: Array = np.linalg.lstsq(stacked, target.T.ravel(), rcond=None)[0].astype(float)
    return target - np.einsum("tqj,j->qt", columns, coefficients), coefficients


def _moves(side: Array, rest: Array, squares: Array) -> Array:
    """Gauss-Newton moves (s p,), none along directions in which RSS is flat to rounding."""
    curvature = side @ side.T
    own = curvature.diagonal()
    scale = np.sqrt(np.where(own > RANK * squares, own, np.inf))  # inf: it does not move
    slope: Array = side @ rest / scale
    if len(scale) == 1:
        return slope / scale
    roots, vectors = np.linalg.eigh(curvature / (scale[:, None] * scale))
    inverse = np.divide(1.0, roots, out=np.zeros_like(roots), where=roots > RANK)
    moves: Array = vectors @ (inverse * (slope @ vectors)) / scale
    return moves


def secant(before: Projection, after: Projection) -> float:
    """The share of the next move that leads to where moves end, by the last two; 1 if they grow.

    Where much is left of the rows, Gauss-Newton moves overshoot, or fall short, again and again.
    """
    step = after.parameters - before.parameters
    change = float(np.sum(step * (before.moves - after.moves)))
    return float(np.sum(step * step)) / change if change > 0 else 1.0
