"""Exact LASSO path in Gram space by homotopy (LARS with the LASSO modification).

    minimise over w (k,):   1/2 w'G w - c'w + alpha |w|_1

Between two events the solution is linear in alpha: with active columns A, signs s and
H = S G_AA S, the signed weights grow by H^-1 1 for each unit alpha loses.  An event is a column
whose correlation |c - G w| reaches alpha (it enters) or an active weight that reaches zero (it
leaves).  Each requested alpha is polished by a Newton step on the exact Gram rows and checked
against the optimality conditions; what fails is settled at that alpha by a primal active-set
method, in which a column that depends on active ones is exchanged for one of them; what fails
that too is reported as incomplete, with the weights that came closest.  The walk itself is
`homotopy_walk`, on the `active_set`.

Sources: Osborne, Presnell and Turlach, IMA J. Numer. Anal. 20 (2000) 389-403; Efron, Hastie,
Johnstone and Tibshirani, Ann. Statist. 32 (2004) 407-499; for the repair, Lee, Battle, Raina
and Ng, NIPS 19 (2006) 801-808.
"""

from dataclasses import dataclass

import numpy as np

from sparsefit.arrays import Array, BoolArray
from sparsefit.backends.loops import Loop, loaded

BACKEND = "lasso"  # whose loop this is


@dataclass(frozen=True, eq=False)
class HomotopyPath:
    """Weights (p, k) at the p requested penalties, events on the way, and which are optimal.

    Where `complete` (p,) is false the weights are the best ones known, not a solution. `loop`:
    which of the two made them, "compiled" or "python".
    """

    weights: Array
    steps: int
    complete: BoolArray
    loop: Loop


def lasso_path(gram: Array, cross: Array, alphas: Array, loop: Loop | None = None) -> HomotopyPath:
    """Solve for G = `gram` (k, k), c = `cross` (k,) at every one of `alphas` (p,), descending.

    Columns may be zero, repeated or dependent.  `alphas` are >= 0, in the units of `cross`.
    `loop`: None is the compiled one where it was built, else the interpreted one; both are made of
    one source.  Raises ValueError if alphas ascend or are negative, ImportError if the compiled
    loop is asked for and was not built.
    """
    if np.any(np.diff(alphas) > 0) or not np.all(np.asarray(alphas) >= 0):
        raise ValueError("alphas must descend and not be negative: sort them largest first")
    unit, height = _binary_unit(np.diagonal(gram)), _binary_unit(cross)
    scaled = gram if unit == 1.0 else gram / unit
    signal, penalties = cross / height, np.asarray(alphas, dtype=float) / height
    walk, ran = loaded(BACKEND, loop)
    weights, steps, complete = np.zeros((len(alphas), len(cross))), 0, np.zeros(len(alphas), bool)
    if np.isfinite(signal).all() and np.isfinite(scaled).all():
        # What a broken inverse overflows to is caught by the checks, not by warnings.
        with np.errstate(all="ignore"):
            steps = walk.path(
                *(np.ascontiguousarray(part) for part in (scaled, signal, penalties)),
                *(weights, complete),
            )
    return HomotopyPath(weights * (height / unit), steps, complete, ran)


def _binary_unit(values: Array) -> float:
    """Power of two next to max |values|: dividing by it rounds nothing."""
    largest = float(np.max(np.abs(values), initial=0.0))
    if not 0.0 < largest < np.inf:
        return 1.0
    return float(2.0 ** (np.frexp(largest)[1] - 1)) if not 0.99 < largest < 1.01 else 1.0
