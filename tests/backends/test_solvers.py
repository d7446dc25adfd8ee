"""Every solver behind a penalised back-end: the same objective, its refusals, its own word."""

import numpy as np
import pytest

import sparsefit as sf
from sparsefit import backends
from sparsefit.backends import peer_forms, solvers
from sparsefit.backends.peer_homotopy import interpolated
from sparsefit.errors import InputError, MissingExtra
from sparsefit.regression.problem import RegressionProblem
from tests.problems import regular

FRACTIONS = (0.8, 0.3, 0.05)
FIRST_ORDER = {"group-lasso-fista": 1e-5}  # it stops at a change of its coefficients
COMPILES = {"skglm"}  # half a minute to compile: run by the slow tests
OBJECTIVES = {
    "lasso": {},
    "group-lasso": {},
    "group-lasso, separate": {"separate": True},
    "adaptive-lasso": {},
    "group-lasso, by size": {"group_weights": "sqrt-size"},
}


def backend_of(objective, solver):
    name, settings = objective.partition(",")[0], OBJECTIVES[objective]
    return backends.get(name, solver=solver, **settings)


def taken():
    for peer in solvers.PEERS:
        for objective in OBJECTIVES:
            if "group" in objective and peer.quadratic:
                continue
            if peer.name in FIRST_ORDER and objective != "group-lasso":
                continue  # a second each
            slow = [pytest.mark.slow] if peer.name in COMPILES else []
            missing = pytest.mark.skipif(not peer.installed, reason=f"{peer.package} is not there")
            yield pytest.param(objective, peer.name, marks=[missing, *slow])


@pytest.mark.parametrize(("objective", "solver"), list(taken()))
def test_every_public_solver_solves_the_objective_that_is_certified(objective, solver):
    found = sf.path(regular(1), backend_of(objective, solver), FRACTIONS, tolerance=1e-5)
    assert np.all(found.gaps <= FIRST_ORDER.get(solver, 1e-7)), found.gaps
    assert all(fit.status == "ok" for fit in found.fits)
    assert found.fits[0].solver_status
    assert found.repaired == 0


@pytest.mark.parametrize("solver", ["cvxpy-rows-clarabel", "cvxpy-rows-scs", "clarabel-direct"])
def test_a_problem_as_users_write_it_is_the_same_problem(solver):
    problem = regular(2)
    for name in ("group-lasso", "elastic-net"):
        exact = sf.path(problem, backends.get(name), FRACTIONS)
        other = sf.path(problem, backends.get(name, solver=solver), FRACTIONS, tolerance=1e-3)
        for one, two in zip(exact.fits, other.fits, strict=True):
            difference = abs(one.certificate.primal - two.certificate.primal)
            assert difference <= 1e-4 * problem.statistics.null_objective


@pytest.mark.parametrize(
    "solver", ["clarabel", "osqp", "clarabel-direct", "scikit-learn-cd", "cvxpy-rows-osqp"]
)
def test_a_tighter_tolerance_is_a_smaller_gap(solver):
    if not solvers.solver_named(solver).installed:
        pytest.skip("not installed")
    problem = regular(3, samples=80, groups=8, noise=1.0)
    backend = backends.get("lasso", solver=solver)

    def worst(tolerance):
        found = backend.solve_path(problem, FRACTIONS, tolerance=tolerance)
        gaps = []
        for fraction, solution in zip(FRACTIONS, found, strict=True):
            exact = sf.fit(problem, backends.get("lasso", alpha_fraction=fraction))
            rows = problem.target - problem.theta @ solution.weights
            scaled = np.abs(solution.weights * problem.statistics.rms[:, None]).sum()
            unit = sf.path(problem, backends.get("lasso"), [fraction]).alpha_max
            primal = np.sum(rows**2) / (2 * problem.samples) + fraction * unit * scaled
            gaps.append(primal - exact.certificate.dual)
        return max(gaps) / problem.statistics.null_objective

    loose, tight = worst(1e-2), worst(1e-9)
    assert tight < 1e-7
    assert tight <= loose


def test_a_target_of_zeros_needs_no_public_solver():
    problem = RegressionProblem.from_arrays(regular().theta, np.zeros((60, 2)), regular().groups)
    for solver in ("osqp-direct", "cvxpy-rows-clarabel"):
        found = backends.get("lasso", solver=solver).solve(problem)
        assert found.solver_status == "target is zero"
        assert not found.weights.any()


def test_what_a_public_solver_raises_or_warns_of_is_told_in_one_line():
    problem = regular()
    penalty = backends.get("lasso").penalty(problem)

    def falls(part, fractions, tolerance):
        raise ArithmeticError("it\n fell over")

    def warns(part, fractions, tolerance):
        import warnings

        warnings.warn("did not converge", stacklevel=1)
        warnings.warn("an old name", DeprecationWarning, stacklevel=1)
        return np.zeros((len(fractions), problem.columns))

    (failed,) = peer_forms.solved("one", problem, penalty, (0.5,), falls)
    assert (failed.status, failed.weights) == ("error", None)
    assert failed.reason == "one: ArithmeticError: it fell over"
    (doubtful,) = peer_forms.solved("one", problem, penalty, (0.5,), warns)
    assert doubtful.status == "inaccurate"
    assert doubtful.solver_status == "UserWarning: did not converge"


def test_a_solver_that_is_not_installed_names_what_brings_it(monkeypatch):
    monkeypatch.setattr(solvers, "find_spec", lambda _: None)
    with pytest.raises(MissingExtra, match=r"celer is not installed: .*sparsefit\[peers\]"):
        backends.get("lasso", solver="celer")
    with pytest.raises(MissingExtra, match=r"piqp .*sparsefit\[peers\]"):
        backends.get("lasso", solver="cvxpy-rows-piqp")
    with pytest.raises(MissingExtra, match="numpy < 2"):
        backends.get("lasso", solver="adelie")


def test_a_solver_of_another_problem_is_refused_in_words():
    with pytest.raises(InputError, match="group norms are cones"):
        backends.get("group-lasso", solver="scikit-learn-lars")
    with pytest.raises(InputError, match="group norms are cones"):
        backends.get("group-lasso", solver="cvxpy-rows-osqp")
    for name in ("elastic-net", "ridge"):
        with pytest.raises(InputError, match="norms of coefficients or groups alone"):
            backends.get(name, solver="osqp-direct")
    with pytest.raises(InputError, match='did you mean "celer"'):
        backends.get("lasso", solver="celr")


def test_every_solver_described_is_known_by_its_name():
    for solver in solvers.described():
        assert solvers.solver_named(solver.name) == solver
        assert solver.form


def test_between_breakpoints_a_path_is_a_straight_line():
    knots, values = np.array([1.0, 0.5, 0.2]), np.array([[0.0, 1.0, 4.0]])
    asked = np.array([1.0, 0.75, 0.5, 0.35, 0.1])
    assert np.allclose(interpolated(knots, values, asked), [[0.0, 0.5, 1.0, 2.5, 4.0]])
    assert np.allclose(interpolated(knots[:1], values[:, :1], asked), 0.0)
