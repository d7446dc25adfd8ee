"""Penalised least squares by Clarabel itself, without cvxpy, whole or on working sets of groups.

With V (k, n) and one bound t_g per block, in Gram form (targets divided by alpha_max):
    minimise 1/2 sum_t v_t'G v_t - <C, V> + f sum omega_g t_g   s.t.  (t_g, V_g) in a cone.

Blocks within blocks have bounds and cones of their own; a ridge adds to the diagonal of G.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

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
TOLERANCE = 1e-12  # of gap and feasibility, where none is asked for
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
    statistics: Statistics,
    penalty: Penalty,
    alpha_fractions: tuple[float, ...],
    *,
    working: bool,
    tolerance: float | None = None,
) -> tuple[Solution, ...]:
    """Solutions at each penalty fraction; ``working``: on working sets, kept along the path.

    tolerance: of Clarabel's gap and feasibility; None is `TOLERANCE`.
    """
    stop = TOLERANCE if tolerance is None else tolerance
    unit = alpha_max(statistics.cross, penalty)
    shape = statistics.cross.shape
    if not statistics.cross.any():
        zero = Solution(np.zeros(shape), solver_status="target is zero", iterations=0)
        return (zero,) * len(alpha_fractions)
    blocks = _Blocks.of(penalty, shape[1])
    chosen = np.full(len(blocks.weights), not working or penalty.smooth)
    solutions = []
    for fraction in alpha_fractions:
        gram = statistics.gram + fraction * unit * penalty.ridge * np.eye(shape[0])
        program = _Program(gram, statistics.cross / unit, penalty, blocks, fraction, stop)
        values, status, rounds = program.solve(chosen)
        if values is None:
            solutions.append(Solution(None, "error", f"clarabel: {status}", status, rounds))
            continue
        weights = values.reshape(shape[::-1]).T * (unit / statistics.rms[:, None])
        word = STATUS.get(status, "error")
        reason = "" if word == "ok" else f"clarabel: {status}"
        solutions.append(Solution(weights, word, reason, status, rounds))
    return tuple(solutions)


@dataclass(frozen=True, eq=False)
class _Program:
    """One point of a path: G (k, k) with the ridge, C (k, n) over alpha_max, and the fraction."""

    gram: Array
    cross: Array
    penalty: Penalty
    blocks: _Blocks
    fraction: float
    tolerance: float

    def solve(self, chosen: BoolArray) -> tuple[Array | None, str, int]:
        """Solve on the chosen blocks, add the worst violators to them, until there are none."""
        targets = self.cross.shape[1]
        values, status, iterations = np.zeros(self.cross.size), "Solved", 0
        for _ in range(ROUNDS):
            gradient = self.cross - self.gram @ values.reshape(targets, -1).T
            excess = np.full(len(chosen), -1.0)
            if not chosen.all():
                duals = self.penalty.block_dual_norms(gradient).T.ravel()
                excess = np.where(chosen, -1.0, duals / self.fraction - 1.0)
            worst = np.argsort(-excess)[:BATCH]
            worst = worst[excess[worst] > VIOLATION]
            solved = iterations > 0 or not chosen.any()
            if len(worst) == 0 and solved:
                break
            chosen[worst] = True
            on = np.flatnonzero(chosen[self.blocks.block])
            found = self._cone_program(on)
            status, iterations = str(found.status), iterations + int(found.iterations)
            if STATUS.get(status) is None:
                return None, status, iterations
            values = np.zeros(self.cross.size)
            values[on] = np.array(found.x)[: len(on)]
        return values, status, iterations

    def _layers(self) -> list[_Blocks]:
        """The blocks, and those within them; none where the penalty is a ridge alone."""
        if self.penalty.smooth:
            return []
        within = self.penalty.within
        inner = [] if within is None else [_Blocks.of(within, self.cross.shape[1])]
        return [self.blocks, *inner]

    def _cone_program(self, on: IntArray) -> Any:
        """Clarabel's solution over the coefficients ``on``: x = (values, the bounds of blocks)."""
        import clarabel
        from scipy import sparse

        k, size = len(self.gram), len(on)
        target = on // k
        hessian = np.where(target[:, None] == target, self.gram[np.ix_(on % k, on % k)], 0.0)
        linear, rows, cones = [-self.cross.T.ravel()[on]], [np.zeros(0, np.intp)], []
        for layer in self._layers():
            names, local = np.unique(layer.block[on], return_inverse=True)
            bound = sum(map(len, linear)) + np.arange(len(names))
            linear.append(self.fraction * layer.weights[names])
            # Rows of A: for each block its bound, then its coefficients; the cone is (t_g, V_g).
            order = np.argsort(np.concatenate([local, np.arange(len(names)) - 0.5]), kind="stable")
            rows.append(np.concatenate([np.arange(size), bound])[order])
            cones += [clarabel.SecondOrderConeT(1 + int(n)) for n in np.bincount(local)]
        variables, columns = sum(map(len, linear)), np.concatenate(rows)
        bounds = sparse.csc_matrix((variables - size, variables - size))
        quadratic = sparse.triu(sparse.block_diag([hessian, bounds]), format="csc")
        places = (np.arange(len(columns)), columns)
        matrix = sparse.csc_matrix((-np.ones(len(columns)), places), (len(columns), variables))
        settings = clarabel.DefaultSettings()
        settings.verbose = False
        settings.max_threads = 1
        settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = self.tolerance
        return clarabel.DefaultSolver(
            quadratic, np.concatenate(linear), matrix, np.zeros(len(columns)), cones, settings
        ).solve()
