"""The group-LASSO target by target, on few groups, and by two kernels."""

import numpy as np
import pytest

import sparsefit as sf
from sparsefit import backends
from sparsefit.regression.penalties import alpha_max
from sparsefit.regression.problem import RegressionProblem
from tests.problems import regular


def single(problem, target=0):
    return RegressionProblem.from_arrays(problem.theta, problem.target[:, [target]], problem.groups)


def test_separate_is_one_problem_per_target_at_a_common_penalty():
    problem = regular(6)
    backend = backends.get("group-lasso", alpha_fraction=0.2, separate=True)
    together = backend.solve(problem).weights
    top = alpha_max(problem.statistics.cross, backend.penalty(problem))
    for t in range(2):
        alone = single(problem, t)
        own = alpha_max(alone.statistics.cross, backend.penalty(alone))
        one = backends.get("group-lasso", alpha_fraction=0.2 * top / own).solve(alone)
        assert together[:, [t]] == pytest.approx(one.weights, abs=1e-5)


@pytest.mark.parametrize("separate", [True, False])
def test_a_fit_names_the_kernel_that_ran(monkeypatch, separate):
    problem, backend = regular(3), backends.get("group-lasso", separate=separate)
    usual = sf.path(problem, backend).fits[15]
    assert usual.solver_status == "variational, all columns"
    monkeypatch.setattr("sparsefit.solvers.kernels.compiled", lambda name: None)
    found = sf.path(problem, backend).fits[15]
    assert found.solver_status == "newton, all columns"
    assert found.weights == pytest.approx(usual.weights, rel=1e-5, abs=1e-7)


@pytest.mark.parametrize("separate", [False, True])
@pytest.mark.parametrize("fraction", [1.0, 0.6, 0.3, 0.1, 1e-3])
@pytest.mark.parametrize("group_weights", ["unit", "sqrt-size"])
def test_a_point_on_the_groups_that_pull_is_the_point_on_all(separate, fraction, group_weights):
    """The Gram matrix is not formed for one point alone."""
    alone, whole = regular(groups=40, samples=400), regular(groups=40, samples=400)
    setting = {"separate": separate, "group_weights": group_weights}
    backend = backends.get("group-lasso", alpha_fraction=fraction, **setting)
    few = sf.fit(alone, backend)
    assert few.status == "ok"
    assert "gram" not in vars(alone.design)
    assert whole.statistics.gram.shape == (120, 120)
    every = sf.fit(whole, backend)
    np.testing.assert_allclose(few.weights, every.weights, rtol=1e-9, atol=1e-12)
    assert few.certificate.value < 1e-10
