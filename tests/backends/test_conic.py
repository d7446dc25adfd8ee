"""The conic referees: every solver on the same model, and what they say when they fail."""

import warnings

import cvxpy
import numpy as np
import pytest

import sparsefit as sf
from sparsefit import backends
from sparsefit.backends import conic
from sparsefit.errors import InputError
from sparsefit.regression.problem import RegressionProblem
from tests.problems import flight_problem, regular

FOUND = {name.lower() for name in cvxpy.installed_solvers()}
SOLVERS = {
    "lasso": ["clarabel", "clarabel-direct", "clarabel-working-set", "osqp", "scs"],
    "group-lasso": ["clarabel", "clarabel-direct", "clarabel-working-set", "scs"],
}
PAIRS = [
    (name, solver)
    for name, solvers in SOLVERS.items()
    for solver in solvers
    if solver in (*conic.DIRECT, *FOUND)
]
EXACT = {"lasso": "homotopy", "group-lasso": "variational"}


@pytest.mark.parametrize(("name", "solver"), PAIRS)
def test_every_solver_finds_the_objective_of_the_exact_path(name, solver):
    problem = regular(1)
    fractions = [0.8, 0.3, 0.1, 0.02]
    exact = sf.path(problem, backends.get(name), fractions)
    other = sf.path(problem, backends.get(name, solver=solver), fractions, tolerance=1e-6)
    null = problem.statistics.null_objective
    assert other.repaired == 0
    for one, two in zip(exact.fits, other.fits, strict=True):
        assert two.status == "ok", two.reason
        assert two.solver_status
        assert abs(one.certificate.primal - two.certificate.primal) <= 1e-6 * null


@pytest.mark.parametrize("name", ["lasso", "group-lasso"])
@pytest.mark.parametrize("solver", ["clarabel", "clarabel-direct", "clarabel-working-set"])
def test_clarabel_agrees_on_a_flight(name, solver):
    problem = flight_problem(velocity_noise=0.2)
    null = problem.statistics.null_objective
    exact = sf.fit(problem, backends.get(name, alpha_fraction=0.1))
    other = sf.fit(problem, backends.get(name, alpha_fraction=0.1, solver=solver), tolerance=1e-6)
    assert other.status == "ok", other.reason
    assert abs(exact.certificate.primal - other.certificate.primal) <= 1e-7 * null


@pytest.mark.parametrize(("name", "solver"), PAIRS)
def test_a_zero_target_needs_no_solver(name, solver):
    problem = RegressionProblem.from_arrays(regular().theta, np.zeros((60, 2)), regular().groups)
    found = backends.get(name, solver=solver).solve(problem)
    assert (found.status, found.solver_status) == ("ok", "target is zero")
    assert not found.weights.any()


@pytest.mark.parametrize(
    ("status", "ours"),
    [
        ("optimal", "ok"),
        ("optimal_inaccurate", "inaccurate"),
        ("user_limit", "inaccurate"),
        ("infeasible", "error"),
        ("unbounded_inaccurate", "error"),
        ("something new", "error"),
    ],
)
def test_almost_solved_is_not_solved_and_the_unknown_is_an_error(status, ours, monkeypatch):
    real = cvxpy.Problem.solve

    def solve(problem, **settings):
        value = real(problem, **settings)
        monkeypatch.setattr(cvxpy.Problem, "status", property(lambda _: status))
        return value

    monkeypatch.setattr(cvxpy.Problem, "solve", solve)
    found = backends.get("lasso", solver="clarabel").solve(regular())
    assert (found.status, found.solver_status) == (ours, status)
    assert (found.weights is None) == (ours == "error")
    assert (found.reason == "") == (ours == "ok")


@pytest.mark.parametrize("error", [cvxpy.error.SolverError, ValueError, ZeroDivisionError])
def test_a_solver_that_raises_is_an_error_with_its_words_in_one_line(error, monkeypatch):
    def solve(problem, **settings):
        raise error("the solver\n  fell over")

    monkeypatch.setattr(cvxpy.Problem, "solve", solve)
    found = sf.fit(regular(), backends.get("group-lasso", solver="clarabel"))
    assert found.status == "error"
    assert found.reason == "clarabel: the solver fell over"
    assert np.isnan(found.weights).all()


def test_a_stopped_solver_is_inaccurate_and_keeps_its_best_weights(monkeypatch):
    monkeypatch.setitem(conic.SETTINGS, "osqp", {"max_iter": 5})
    found = sf.fit(regular(), backends.get("lasso", solver="osqp"))
    assert found.status in ("inaccurate", "error")
    if found.status == "inaccurate":
        assert found.certificate.value > 1e-8
        assert np.isfinite(found.weights).all()


def test_warnings_of_the_solver_do_not_reach_the_user(monkeypatch):
    real = cvxpy.Problem.solve

    def solve(problem, **settings):
        warnings.warn("Solution may be inaccurate", stacklevel=1)
        return real(problem, **settings)

    monkeypatch.setattr(cvxpy.Problem, "solve", solve)
    assert backends.get("lasso", solver="clarabel").solve(regular()).status == "ok"


@pytest.mark.parametrize(("name", "exact"), EXACT.items())
def test_names_of_solvers_are_checked_when_the_settings_are_made(name, exact):
    for solver in (exact, "clarabel", *conic.DIRECT, *(FOUND & {"scs"})):
        assert backends.get(name, solver=solver).solver == solver
    with pytest.raises(InputError, match="not installed"):
        backends.get(name, solver="gurobi-of-the-future")


def test_quadratic_solvers_are_for_the_lasso_only():
    for solver in ("osqp", "highs"):
        if solver in FOUND:
            assert backends.get("lasso", solver=solver).solver == solver
            with pytest.raises(InputError, match="group norms are cones"):
                backends.get("group-lasso", solver=solver)


def test_a_solver_that_cannot_take_the_problem_is_an_error():
    if "scipy" not in FOUND:
        pytest.skip("needs a solver of linear programs only")
    found = sf.fit(regular(), backends.get("lasso", solver="scipy"))
    assert found.status == "error"
    assert "scipy" in found.reason


def test_the_referee_is_another_solver_and_has_none():
    for name, exact in EXACT.items():
        backend = backends.get(name, alpha_fraction=0.3)
        referee = backend.referee()
        assert backend.solver == exact
        assert referee.solver.startswith("clarabel")
        assert referee.alpha_fraction == 0.3
        assert referee.referee() is None
