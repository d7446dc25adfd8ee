"""The LASSO of bounded weights against scipy and cvxpy, and a box that a user states."""

from dataclasses import dataclass, replace
from typing import ClassVar

import cvxpy
import numpy as np
import pytest
from scipy.optimize import lsq_linear

import sparsefit as sf
from sparsefit import backends
from sparsefit.penalties import Penalty
from sparsefit.solvers.penalised import PenalisedPath

DRAW = np.random.default_rng(0)
THETA = DRAW.normal(size=(60, 12)) * np.geomspace(0.1, 10.0, 12)
TARGET = THETA @ DRAW.normal(size=(12, 2)) + 0.1 * DRAW.normal(size=(60, 2))
PROBLEM = sf.RegressionProblem.from_arrays(THETA, TARGET)


@pytest.mark.parametrize(("lower", "upper"), [(-0.1, 0.2), (0.0, 0.3), (None, 0.1)])
def test_bounds_that_bind_are_certified_and_agree_with_scipy(lower, upper):
    backend = backends.get("box-lasso", lower=lower, upper=upper)
    path = sf.path(PROBLEM, backend, [1.0, 0.3, 0.03, 1e-9])
    assert all(fit.status == "ok" for fit in path.fits)
    assert not any(fit.repaired for fit in path.fits)
    bounds = (-np.inf if lower is None else lower, upper)
    for weights, target in zip(path.weights[-1].T, TARGET.T, strict=True):
        expected = lsq_linear(THETA, target, bounds, method="bvls", tol=1e-14).x
        assert weights == pytest.approx(expected, abs=1e-6)
        assert (weights == upper).sum() >= 2


def test_cvxpy_agrees_on_more_columns_than_samples():
    theta, target = DRAW.normal(size=(30, 700)), DRAW.normal(size=(30, 1))
    problem = sf.RegressionProblem.from_arrays(theta, target)
    backend = backends.get("box-lasso", lower=-0.02, upper=0.03, alpha_fraction=0.1)
    found = sf.fit(problem, backend)
    weights = cvxpy.Variable((700, 1))
    size = cvxpy.sum(cvxpy.abs(cvxpy.multiply(problem.design.rms[:, None], weights)))
    cost = cvxpy.sum_squares(target - theta @ weights) / 60 + found.alpha * size
    program = cvxpy.Problem(cvxpy.Minimize(cost), [weights >= -0.02, weights <= 0.03])
    program.solve(solver="CLARABEL")
    assert found.status == "ok"
    assert found.certificate.primal == pytest.approx(program.value, rel=1e-7)
    assert (np.abs(found.weights - 0.03) < 1e-15).sum() > 10


@dataclass(frozen=True, eq=False)
class Share(Penalty):
    """|V|_1 where -2 <= V/b <= 1, infinite elsewhere."""

    count: int
    bound: float = 0.25

    @property
    def columns(self):
        return self.count

    def norm(self, values):
        within = (np.abs(values + self.bound / 2) <= 1.5001 * self.bound).all(axis=(-2, -1))
        return np.where(within, np.abs(values).sum(axis=(-2, -1)), np.inf)

    def dual_norm(self, values):
        return np.abs(values).max(axis=-2)

    def conjugate(self, values, alpha):
        gain = np.maximum(values - alpha, np.maximum(-2 * (values + alpha), 0))
        return self.bound * gain.sum(axis=-2)

    def in_units(self, level):
        return replace(self, bound=self.bound / level)

    def prox(self, values, step):
        shrunk = np.sign(values) * np.maximum(np.abs(values) - step, 0)
        return np.clip(shrunk, -2 * self.bound, self.bound)


@dataclass(frozen=True)
class Shares(PenalisedPath):
    name: ClassVar[str] = "shares"

    def penalty(self, problem):
        return Share(problem.columns)


def test_a_users_box_is_certified_by_its_conjugate():
    unit = THETA / PROBLEM.design.rms
    problem = sf.RegressionProblem.from_arrays(unit, unit @ DRAW.normal(size=(12, 2)))
    fractions = [0.5, 0.1, 1e-3]
    assert not Share(12).constraint(np.ones((3, 12, 2))).any()
    assert Share(12).constraint(np.ones((3, 12, 2))).shape == (3, 2)
    path = sf.path(problem, Shares(), fractions)
    assert all(fit.status == "ok" for fit in path.fits)
    ours = sf.path(problem, backends.get("box-lasso", lower=-0.5, upper=0.25), fractions)
    assert path.weights == pytest.approx(ours.weights, abs=1e-8)
    assert np.isclose(path.weights[-1], 0.25, rtol=1e-12).any()


def test_bounds_that_do_not_bind_beside_some_that_do_cost_no_certificate():
    """In columns of units far apart the bounds are, too; each is where C meets alpha or is not."""
    theta = THETA * np.geomspace(1e-6, 1e6, 12)
    problem = sf.RegressionProblem.from_arrays(theta, TARGET)
    path = sf.path(problem, backends.get("box-lasso", lower=-2.0, upper=1e3), [0.5, 0.03, 1e-3])
    assert all(fit.status == "ok" for fit in path.fits)
    assert 0 < (path.weights[-1] == -2.0).sum() + (path.weights[-1] == 1e3).sum() < 12
