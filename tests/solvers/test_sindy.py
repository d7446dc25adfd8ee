"""PySINDy's own STLSQ as a back-end: the support it promises, and ours beside it."""

import importlib.util

import numpy as np
import pytest

import sparsefit as sf
from sparsefit import backends
from sparsefit.errors import MissingExtra
from sparsefit.regression.problem import RegressionProblem
from sparsefit.solvers import least_squares

needs = pytest.mark.skipif(importlib.util.find_spec("pysindy") is None, reason="extra peers")


@pytest.fixture
def problem():
    draw = np.random.default_rng(2)
    theta = draw.standard_normal((80, 8))
    weights = np.zeros((8, 2))
    weights[[0, 3], 0], weights[[1, 3, 5], 1] = [1.5, -1.0], [1.0, 2.0, -1.5]
    target = theta @ weights + 0.01 * draw.standard_normal((80, 2))
    return RegressionProblem.from_arrays(theta, target)


@needs
def test_a_clear_support_is_found_and_a_fixed_point(problem):
    found = sf.fit(problem, backends.get("pysindy", threshold=0.3))
    assert found.status == "ok", found.reason
    assert found.certificate.kind == "fixed_point"
    assert [np.flatnonzero(w).tolist() for w in found.weights.T] == [[0, 3], [1, 3, 5]]


@needs
def test_stlsq_is_ours(problem):
    theirs = sf.fit(problem, backends.get("pysindy", threshold=0.3))
    ours = sf.fit(problem, backends.get("stlsq", mode="pysindy", threshold=0.3))
    assert np.allclose(theirs.weights, ours.weights, atol=1e-10)


@needs
def test_a_support_that_its_rule_does_not_give_is_no_fixed_point(problem):
    assert sf.fit(problem, backends.get("pysindy", threshold=100.0)).status == "unidentifiable"
    backend = backends.get("pysindy", threshold=0.3)
    wrong = np.zeros((8, 2))
    wrong[[6, 7], :] = 1.0
    assert np.any((backend.next_weights(problem, wrong) != 0) != (wrong != 0))


def test_without_pysindy_its_extra_is_named(monkeypatch):
    monkeypatch.setattr(least_squares, "find_spec", lambda _: None)
    with pytest.raises(MissingExtra, match=r"sparsefit\[peers\]"):
        backends.get("pysindy")
