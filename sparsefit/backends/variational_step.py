"""The bound-constrained quadratic subproblem of a projected Newton step, by an active set.

Source: Nocedal and Wright, "Numerical Optimization" (2006), section 16.5.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg.lapack import dposv

from sparsefit.arrays import Array, BoolArray, IntArray


def bounded_minimum(hessian: Array, drive: Array, lower: Array) -> Array:
    """Minimise x'Hx/2 - drive'x over x >= lower (lower <= 0) by an active set from x = 0.

    Unit diagonal and a ridge of rounding size: duplicated groups make H singular.
    """
    scale = 1.0 / np.sqrt(np.maximum(hessian.diagonal(), np.finfo(float).tiny))
    unit = hessian * np.multiply.outer(scale, scale)
    unit.flat[:: len(unit) + 1] += 1e-13
    pull, floor = drive * scale, lower / scale
    full, failed = dposv(unit, pull)[1:]
    if not failed and np.all(full >= floor):
        return np.asarray(full * scale)
    inner = (floor < 0) | ((drive > 0) if failed else (full > 0))
    return _active_set(unit, pull, floor, inner) * scale


def _active_set(hessian: Array, drive: Array, lower: Array, free: BoolArray) -> Array:
    """Primal active set: move towards each face's minimiser, stop at the first bound met."""
    x = np.zeros_like(drive)
    slack = 1e-13 * float(np.max(np.abs(drive)))
    for _ in range(10 * drive.size + 10):
        inside = np.flatnonzero(free)
        target = x.copy()
        target[inside] = _face(hessian, drive, x, free, inside)
        move = target - x
        falling = np.flatnonzero(free & (target < lower))
        if falling.size:
            ratio = (lower[falling] - x[falling]) / move[falling]
            reach = float(np.min(ratio))
            x = x + reach * move
            hit = falling[ratio <= reach]
            x[hit], free[hit] = lower[hit], False
            continue
        x = target
        pull = np.where(free, 0.0, drive - hessian @ x)
        worst = int(np.argmax(pull))
        if pull[worst] <= slack:
            break
        free[worst] = True
    return x


def _face(hessian: Array, drive: Array, x: Array, free: BoolArray, inside: IntArray) -> Array:
    """Minimiser over the free coordinates, the others fixed; a larger ridge where singular."""
    if not inside.size:
        return np.zeros(0)
    fixed = np.flatnonzero(~free)
    block = hessian[np.ix_(inside, inside)]
    pull = drive[inside] - hessian[np.ix_(inside, fixed)] @ x[fixed]
    solved, failed = dposv(block, pull)[1:]
    ridge = 1e-12
    while failed and ridge < 1.0:
        block.flat[:: len(block) + 1] += ridge
        solved, failed = dposv(block, pull)[1:]
        ridge *= 10.0
    return np.asarray(solved)
