"""LASSO and group-LASSO by Clarabel itself, without cvxpy, whole or on working sets of groups.

With V (k, n) and one bound t_g per block, in Gram form (targets divided by alpha_max):
    minimise 1/2 sum_t v_t'G v_t - <C, V> + f sum omega_g t_g   s.t.  (t_g, V_g) in a cone.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse

from sparsefit.arrays import Array, BoolArray, IntArray
from sparsefit.regression.backend import Solution, SolutionStatus
from sparsefit.regression.objective import Penalty, alpha_max
from sparsefit.regression.statistics import Statistics

STATUS: dict[str, SolutionStatus] = {
    "Solved": "ok",
    "AlmostSolved": "inaccurate",
    "MaxIterations": "inaccurate",
    "InsufficientProgress": "inaccurate",
}
"""Clarabel's status -> ours; whatever is not named here is an error."""
BATCH = 10  # blocks that join the working set at a time
VIOLATION = 1e-10  # relative: below it a block outside the working set is optimal at zero
ROUNDS = 60


@dataclass(frozen=True, eq=False)
class _Blocks:
    """Coefficients (in the order of V.T.ravel(), target by target) and the block of each."""

    block: IntArray
    weights: Array

    @classmethod
    def of(cls, penalty: Penalty, targets: int) -> "_Blocks":
        count = len(penalty.weights)
        shift = np.zeros(targets, dtype=np.intp) if penalty.joint else count * np.arange(targets)
        block = (penalty.groups[None, :] + shift[:, None]).ravel()
        return cls(block, np.tile(penalty.weights, 1 if penalty.joint else targets))


def solve_clarabel(
    statistics: Statistics, penalty: Penalty, alpha_fractions: tuple[float, ...], *, working: bool
) -> tuple[Solution, ...]:
    """Solutions at each penalty fraction; ``working``: on working sets, kept along the path."""
    unit = alpha_max(statistics.cross, penalty)
    shape = statistics.cross.shape
    if unit == 0:
        zero = Solution(np.zeros(shape), solver_status="target is zero", iterations=0)
        return (zero,) * len(alpha_fractions)
    blocks = _Blocks.of(penalty, shape[1])
    cross = (statistics.cross / unit).T.ravel()
    chosen = np.ones(len(blocks.weights), dtype=bool)
    if working:
        chosen[:] = False
    solutions = []
    for fraction in alpha_fractions:
        values, status, rounds = _solve_one(statistics.gram, cross, blocks, fraction, chosen)
        if values is None:
            solutions.append(Solution(None, "error", f"clarabel: {status}", status, rounds))
            continue
        weights = values.reshape(shape[::-1]).T * (unit / statistics.rms[:, None])
        word = STATUS.get(status, "error")
        reason = "" if word == "ok" else f"clarabel: {status}"
        solutions.append(Solution(weights, word, reason, status, rounds))
    return tuple(solutions)


def _solve_one(
    gram: Array, cross: Array, blocks: _Blocks, fraction: float, chosen: BoolArray
) -> tuple[Array | None, str, int]:
    """Solve on the chosen blocks, add the worst violators to ``chosen``, until there are none."""
    targets = len(cross) // len(gram)
    values, status, iterations = np.zeros_like(cross), "Solved", 0
    for _ in range(ROUNDS):
        gradient = cross - (values.reshape(targets, -1) @ gram).ravel()
        norms = np.sqrt(np.bincount(blocks.block, gradient**2, len(blocks.weights)))
        excess = np.where(chosen, -1.0, norms / (fraction * blocks.weights) - 1.0)
        worst = np.argsort(-excess)[:BATCH]
        worst = worst[excess[worst] > VIOLATION]
        solved = iterations > 0 or not chosen.any()
        if len(worst) == 0 and solved:
            break
        chosen[worst] = True
        on = np.flatnonzero(chosen[blocks.block])
        found = _cone_program(gram, cross, blocks, fraction, on)
        status, iterations = str(found.status), iterations + int(found.iterations)
        if STATUS.get(status) is None:
            return None, status, iterations
        values = np.zeros_like(cross)
        values[on] = np.array(found.x)[: len(on)]
    return values, status, iterations


def _cone_program(gram: Array, cross: Array, blocks: _Blocks, fraction: float, on: IntArray) -> Any:
    """Clarabel's solution over the coefficients ``on``: x = (their values, a bound per block)."""
    import clarabel

    k = len(gram)
    names, local = np.unique(blocks.block[on], return_inverse=True)
    size, count = len(on), len(names)
    target = on // k
    hessian = np.where(target[:, None] == target, gram[np.ix_(on % k, on % k)], 0.0)
    quadratic = sparse.triu(
        sparse.block_diag([hessian, sparse.csc_matrix((count, count))]), format="csc"
    )
    linear = np.concatenate([-cross[on], fraction * blocks.weights[names]])
    # Rows of A: for each block its bound, then its coefficients; the cone is (t_g, V_g).
    order = np.argsort(np.concatenate([local, np.arange(count) - 0.5]), kind="stable")
    columns = np.concatenate([np.arange(size), size + np.arange(count)])[order]
    rows = np.arange(size + count)
    matrix = sparse.csc_matrix((-np.ones(size + count), (rows, columns)))
    cones = [clarabel.SecondOrderConeT(1 + int(n)) for n in np.bincount(local)]
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_threads = 1
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-12
    return clarabel.DefaultSolver(
        quadratic, linear, matrix, np.zeros(size + count), cones, settings
    ).solve()
