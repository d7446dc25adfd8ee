"""Penalised least squares through cvxpy by any conic or QP solver it finds: the referees.

cvxpy sees the compressed k x k problem in the form that is fast there,
    1/2 sum_t v_t'G v_t - <C, V> + alpha * Omega(V),  G = Z'Z/m, C = Z'Y/m,
with targets divided by alpha_max, so that alpha is the penalty fraction and data are of order 1.
`solve_rows` is the same problem as users write it, by the m rows, for the comparison of solvers.
"""

import warnings
from typing import Any

import numpy as np

from sparsefit.arrays import Array
from sparsefit.backends.clarabel_direct import solve_clarabel
from sparsefit.errors import one_line
from sparsefit.regression.backend import Solution, SolutionStatus
from sparsefit.regression.objective import Penalty, alpha_max
from sparsefit.regression.problem import RegressionProblem
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
TOLERANCES: dict[str, tuple[str, ...]] = {
    "clarabel": ("tol_gap_abs", "tol_gap_rel", "tol_feas"),
    "osqp": ("eps_abs", "eps_rel"),
    "scs": ("eps_abs", "eps_rel"),
    "piqp": ("eps_abs", "eps_rel"),
    "ecos": ("abstol", "reltol", "feastol"),
    "proxqp": ("eps_abs", "eps_rel"),
}
"""Solver -> the settings that hold its stopping tolerance."""
RANK = 1e-13  # of Z'Z/m: eigenvalues below it, relative, count as zero where its root is taken
DIRECT = ("clarabel-direct", "clarabel-working-set")
QUADRATIC_ONLY = ("osqp", "highs", "piqp", "daqp", "proxqp")


def installed_solvers() -> list[str]:
    """Names of the solvers that cvxpy finds here, in lower case."""
    import cvxpy

    return sorted(name.lower() for name in cvxpy.installed_solvers())


def with_tolerance(solver: str, tolerance: float | None, given: dict[str, Any]) -> dict[str, Any]:
    """The settings ``given`` with the solver's stopping tolerance, where one is asked for."""
    names = TOLERANCES.get(solver.lower(), ()) if tolerance is not None else ()
    return {**given, **dict.fromkeys(names, tolerance)}


def solve_conic(
    statistics: Statistics,
    penalty: Penalty,
    alpha_fractions: tuple[float, ...],
    solver: str,
    tolerance: float | None = None,
) -> tuple[Solution, ...]:
    """Solutions at each penalty fraction; the problem is compiled once."""
    if solver in DIRECT:
        working = solver == "clarabel-working-set"
        return solve_clarabel(
            statistics, penalty, alpha_fractions, working=working, tolerance=tolerance
        )
    import cvxpy

    unit = alpha_max(statistics.cross, penalty)
    if not statistics.cross.any():
        return tuple(_zero(statistics) for _ in alpha_fractions)
    variable = cvxpy.Variable(statistics.cross.shape)
    fraction = cvxpy.Parameter(nonneg=True)
    loss = (_root_loss if penalty.root else _quadratic_loss)(variable, statistics, unit)
    omega = _penalty_expression(variable, penalty)
    if penalty.ridge:  # the only term that is not linear in the unit of the target
        omega = omega + 0.5 * penalty.ridge * unit * cvxpy.sum_squares(variable)
    problem = cvxpy.Problem(cvxpy.Minimize(loss + fraction * omega))
    scale = unit / statistics.rms[:, None]
    settings = with_tolerance(solver, tolerance, SETTINGS.get(solver.lower(), {}))
    found = []
    for value in alpha_fractions:
        fraction.value = value
        found.append(_solve_one(problem, variable, solver, settings, scale))
    return tuple(found)


def solve_rows(
    problem: RegressionProblem,
    penalty: Penalty,
    alpha_fractions: tuple[float, ...],
    tolerance: float | None = None,
    *,
    solver: str,
) -> tuple[Solution, ...]:
    """The same as users of cvxpy write it: the sum of squares of m rows, a problem per penalty."""
    import cvxpy

    statistics = problem.statistics
    unit = alpha_max(statistics.cross, penalty)
    if not statistics.cross.any():
        return tuple(_zero(statistics) for _ in alpha_fractions)
    scaled = problem.theta / statistics.rms
    settings = with_tolerance(solver, tolerance, {})
    found = []
    for fraction in alpha_fractions:
        variable = cvxpy.Variable(statistics.cross.shape)
        omega = _penalty_expression(variable, penalty)
        if penalty.ridge:
            omega = omega + 0.5 * penalty.ridge * cvxpy.sum_squares(variable)
        residual = scaled @ variable - problem.target
        if penalty.root:
            level = np.sqrt(statistics.target_square.sum() / problem.samples)
            loss = level * cvxpy.norm(residual, "fro")
        else:
            loss = cvxpy.sum_squares(residual) / (2 * problem.samples)
        stated = cvxpy.Problem(cvxpy.Minimize(loss + fraction * unit * omega))
        scale = 1.0 / statistics.rms[:, None]
        found.append(_solve_one(stated, variable, solver, settings, scale))
    return tuple(found)


def _quadratic_loss(variable: Any, statistics: Statistics, unit: float) -> Any:
    """1/2 sum_t v_t'G v_t - <C, V>, in units of the target's unit squared."""
    import cvxpy

    gram = cvxpy.psd_wrap((statistics.gram + statistics.gram.T) / 2)
    targets = range(statistics.cross.shape[1])
    quadratic = sum(0.5 * cvxpy.quad_form(variable[:, t], gram) for t in targets)
    return quadratic - cvxpy.sum(cvxpy.multiply(statistics.cross / unit, variable))


def _root_loss(variable: Any, statistics: Statistics, unit: float) -> Any:
    """y |Y - Z V|/sqrt(m) by a root H of G = H'H: |H V - B|^2 + rest, H'B = C."""
    import cvxpy

    values, vectors = np.linalg.eigh((statistics.gram + statistics.gram.T) / 2)
    kept = values > RANK * values[-1]
    half = np.sqrt(values[kept])[:, None] * vectors[:, kept].T
    known = (vectors[:, kept].T @ statistics.cross) / np.sqrt(values[kept])[:, None] / unit
    square = float(statistics.target_square.sum()) / unit**2
    rest = np.sqrt(max(square - float(np.sum(known**2)), 0.0))
    misfit = cvxpy.vec(half @ variable - known, order="C")
    return np.sqrt(square) * cvxpy.norm(cvxpy.hstack([misfit, rest]), 2)


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
    problem: Any, variable: Any, solver: str, settings: dict[str, Any], scale: Array
) -> Solution:
    import cvxpy

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # "may be inaccurate": the certificate says by how much
        try:
            problem.solve(solver=solver.upper(), **settings)
        except (cvxpy.error.SolverError, ValueError, ArithmeticError) as error:
            return Solution(None, "error", f"{solver}: {one_line(str(error))}", "solver error")
    status = STATUS.get(problem.status, "error")
    words = f"{solver}: {problem.status}"
    iterations = problem.solver_stats.num_iters if problem.solver_stats else None
    if status == "error" or variable.value is None:
        return Solution(None, "error", words, str(problem.status), iterations)
    reason = "" if status == "ok" else words
    return Solution(variable.value * scale, status, reason, str(problem.status), iterations)


def _zero(statistics: Statistics) -> Solution:
    return Solution(np.zeros(statistics.cross.shape), solver_status="target is zero", iterations=0)
