"""The sparse-group LASSO against cvxpy, and a path of it that is cut short."""

import dataclasses

import cvxpy as cp
import numpy as np
import pytest

import sparsefit as sf
from sparsefit import backends
from sparsefit.regression.penalties import alpha_max
from sparsefit.regression.problem import RegressionProblem
from tests.problems import regular

UNEQUAL = [0, 1, 1, 2, 2, 2, 3, 3, 3, 3, 3, 3]
WAVES = [0, 1, 1, 2, 2, 3, 4, 4, 5, 5, 6, 6]  # within the groups above


def nested(seed=2, subgroups=WAVES):
    plain = regular(seed)
    return RegressionProblem.from_arrays(plain.theta, plain.target, UNEQUAL, subgroups=subgroups)


@pytest.mark.parametrize(("ratio", "subgroups"), [(0.0, None), (0.3, None), (0.3, WAVES)])
@pytest.mark.parametrize("separate", [True, False])
def test_a_naive_model_of_the_rows_agrees(separate, ratio, subgroups):
    problem = nested(subgroups=subgroups)
    rms = np.sqrt(np.mean(problem.theta**2, axis=0))
    z, y, m = problem.theta / rms, problem.target, problem.samples
    backend = backends.get(
        "sparse-group-lasso", l1_ratio=ratio, separate=separate, group_weights="sqrt-size"
    )
    alpha = 0.15 * alpha_max(problem.statistics.cross, backend.penalty(problem))
    v, size = cp.Variable((12, 2)), 0.0
    for part in ([0], [1]) if separate else ([0, 1],):
        for g in range(4):
            on = np.flatnonzero(np.array(UNEQUAL) == g)
            size += (1 - ratio) * len(on) ** 0.5 * cp.norm(cp.vec(v[on][:, part], order="F"))
        for h in range(7 if subgroups else 0):
            on = np.flatnonzero(np.array(WAVES) == h)
            size += ratio * cp.norm(cp.vec(v[on][:, part], order="F"))
    if subgroups is None:
        size += ratio * cp.sum(cp.abs(v))
    model = cp.Problem(cp.Minimize(cp.sum_squares(y - z @ v) / (2 * m) + alpha * size))
    model.solve(solver="CLARABEL", tol_gap_abs=1e-11, tol_gap_rel=1e-11)
    found = sf.fit(problem, dataclasses.replace(backend, alpha_fraction=0.15))
    assert (found.status, found.repaired) == ("ok", False)
    assert found.certificate.primal == pytest.approx(model.value, rel=1e-8)
    assert found.weights * rms[:, None] == pytest.approx(v.value, abs=1e-4)
    other = sf.fit(problem, dataclasses.replace(found.backend, solver="clarabel"))
    assert other.status == "ok", other.reason
    assert other.certificate.primal == pytest.approx(found.certificate.primal, rel=1e-8)


def test_a_path_that_is_cut_short_is_reported_as_incomplete(monkeypatch):
    monkeypatch.setattr("sparsefit.solvers.newton.OUTER", 1)
    problem = nested()
    backend = backends.get("sparse-group-lasso")
    assert backend.solve(problem).status == "inaccurate"
    found = sf.fit(problem, backend)  # the referee repairs it
    assert (found.status, found.repaired) == ("ok", True)
