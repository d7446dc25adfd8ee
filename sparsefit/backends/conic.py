"""The referees: penalised least squares through cvxpy by any conic or QP solver it finds.

cvxpy sees the compressed k x k problem in the form that is fast there,
    1/2 sum_t v_t'G v_t - <C, V> + alpha * Omega(V),  G = Z'Z/m, C = Z'Y/m,
with targets divided by alpha_max, so that alpha is the penalty fraction and data are of order 1.
"""

import warnings
from typing import Any

import numpy as np

from sparsefit.arrays import Array
from sparsefit.backends.clarabel_direct import solve_clarabel
from sparsefit.errors import InputError, unknown
from sparsefit.regression.backend import Solution, SolutionStatus
from sparsefit.regression.objective import Penalty, alpha_max
from sparsefit.regression.statistics import Statistics

STATUS: dict[str, SolutionStatus] = {
    "optimal": "ok",
    "optimal_inaccurate": "inaccurate",
    "user_limit": "inaccurate",
}
"""cvxpy's status -> ours; whatever is not named here is an error."""

SETTINGS: dict[str, dict[str, Any]] = {
    "clarabel": {
        "tol_gap_abs": 1e-11,
        "tol_gap_rel": 1e-11,
        "tol_feas": 1e-11,
        "max_threads": 1,
    },
    "osqp": {"eps_abs": 1e-9, "eps_rel": 1e-9, "max_iter": 50_000, "polishing": True},
    "scs": {"eps_abs": 1e-9, "eps_rel": 1e-9, "max_iters": 50_000},
}
DIRECT = ("clarabel-direct", "clarabel-working-set")
QUADRATIC_ONLY = ("osqp", "highs", "piqp", "daqp", "proxqp")


def installed_solvers() -> list[str]:
    """Names of the solvers that cvxpy finds here, in lower case."""
    import cvxpy

    return sorted(name.lower() for name in cvxpy.installed_solvers())


def check_solver(owner: str, solver: Any, exact: str, *, quadratic: bool) -> None:
    """Raise InputError unless the solver is ``exact`` or a conic one that cvxpy finds here.

    quadratic: whether the problem is a quadratic program, without cones of group norms.
    """
    if solver in (exact, "clarabel", *DIRECT) or (solver == "osqp" and quadratic):
        return
    if not isinstance(solver, str):
        raise InputError(f"{owner}: solver must be a name, not {solver!r}")
    installed = installed_solvers()
    if solver.lower() not in installed:
        names = [exact, *DIRECT, *installed]
        raise unknown(f"solver of {owner} (or it is not installed)", solver, names)
    if not quadratic and solver.lower() in QUADRATIC_ONLY:
        raise InputError(
            f"{owner}: {solver} solves quadratic programs only, and group norms are cones; use "
            f"{exact}, clarabel or another conic solver"
        )


def solve_conic(
    statistics: Statistics, penalty: Penalty, alpha_fractions: tuple[float, ...], solver: str
) -> tuple[Solution, ...]:
    """Solutions at each penalty fraction; the problem is compiled once."""
    if solver in DIRECT:
        return solve_clarabel(
            statistics, penalty, alpha_fractions, working=solver == "clarabel-working-set"
        )
    import cvxpy

    unit = alpha_max(statistics.cross, penalty)
    if not statistics.cross.any():
        return tuple(_zero(statistics) for _ in alpha_fractions)
    variable = cvxpy.Variable(statistics.cross.shape)
    fraction = cvxpy.Parameter(nonneg=True)
    gram = cvxpy.psd_wrap((statistics.gram + statistics.gram.T) / 2)
    quadratic = sum(
        0.5 * cvxpy.quad_form(variable[:, t], gram) for t in range(statistics.cross.shape[1])
    )
    linear = cvxpy.sum(cvxpy.multiply(statistics.cross / unit, variable))
    omega = _penalty_expression(variable, penalty)
    if penalty.ridge:  # the only term that is not linear in the unit of the target
        omega = omega + 0.5 * penalty.ridge * unit * cvxpy.sum_squares(variable)
    problem = cvxpy.Problem(cvxpy.Minimize(quadratic - linear + fraction * omega))
    scale = unit / statistics.rms[:, None]
    return tuple(_solve_one(problem, variable, fraction, f, solver, scale) for f in alpha_fractions)


def _penalty_expression(variable: Any, penalty: Penalty) -> Any:
    """The norms of the penalty, 0 where it has none."""
    import cvxpy

    if penalty.smooth:
        return 0.0
    if penalty.elementwise:
        return cvxpy.sum(cvxpy.multiply(np.abs(penalty.weights)[:, None], cvxpy.abs(variable)))
    terms = []
    for group, weight in enumerate(penalty.weights):
        block = variable[np.flatnonzero(penalty.groups == group), :]
        if penalty.joint:
            terms.append(weight * cvxpy.norm(cvxpy.vec(block, order="C"), 2))
        else:
            terms.append(weight * cvxpy.sum(cvxpy.norm(block, 2, axis=0)))
    within = 0.0 if penalty.within is None else _penalty_expression(variable, penalty.within)
    return cvxpy.sum(cvxpy.hstack(terms)) + within


def _solve_one(
    problem: Any, variable: Any, fraction: Any, value: float, solver: str, scale: Array
) -> Solution:
    import cvxpy

    fraction.value = value
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # "may be inaccurate": the certificate says by how much
        try:
            problem.solve(solver=solver.upper(), **SETTINGS.get(solver.lower(), {}))
        except (cvxpy.error.SolverError, ValueError, ArithmeticError) as error:
            return Solution(None, "error", f"{solver}: {_one_line(error)}", "solver error")
    status = STATUS.get(problem.status, "error")
    words = f"{solver}: {problem.status}"
    iterations = problem.solver_stats.num_iters if problem.solver_stats else None
    if status == "error" or variable.value is None:
        return Solution(None, "error", words, str(problem.status), iterations)
    reason = "" if status == "ok" else words
    return Solution(variable.value * scale, status, reason, str(problem.status), iterations)


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())


def _zero(statistics: Statistics) -> Solution:
    return Solution(np.zeros(statistics.cross.shape), solver_status="target is zero", iterations=0)
