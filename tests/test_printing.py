"""What a notebook shows of a record: one line, shapes in place of arrays."""

import re

import pytest

import sparsefit as sf
from tests.problems import fly


@pytest.fixture(scope="module")
def steps():
    flow = sf.CellularFlow(12.0, 4.0)
    flight = fly(flow, duration=8.0, rate=50.0, seed=1, noise=(0.2, 0.05))
    estimator = sf.Estimator()
    prepared = estimator.prepare(flight)
    fit = estimator.fit(prepared)
    path = sf.path(prepared.problem, "lasso", [0.5, 0.2, 0.1, 0.05])
    return flight, prepared, prepared.problem, fit, path, estimator.read(prepared, fit)


def test_every_step_prints_on_a_few_lines(steps):
    for step in steps:
        assert "\n" not in repr(step)
        assert len(repr(step)) < 1500
        assert "array(" not in repr(step)


def test_shapes_counts_and_what_is_not_at_its_default_are_told(steps):
    flight, _, problem, fit, path, _ = map(repr, steps)
    assert "time=<array (401,)>" in flight
    assert "thrust=" not in flight
    assert "names=<448 str>" in problem
    assert fit.startswith("Fit(weights=<array (448, 2)>, status='ok'")
    assert "fits=<4 Fit>" in path


def test_an_estimate_is_one_line_with_its_standard_errors(steps):
    answer = steps[-1]
    number = r"\d+\.\d+ ± 0\.0*\d\d?"
    pattern = rf"ok: U0 = {number} m/s, L_w = {number} m, tau_w = {number} s"
    assert re.fullmatch(pattern, str(answer))
    spread = answer.uncertainty.mean_velocity  # .0060: two digits of it are four decimals
    assert f"U0 = {answer.mean_velocity:.4f} ± {spread:.2g} m/s" in str(answer)


def test_an_estimate_that_is_refused_tells_why():
    still = fly(None, duration=5.0, rate=50.0, seed=1, noise=(0.2, 0.0))
    answer = sf.Estimator().estimate(still)
    assert str(answer) == f"unidentifiable: {answer.reason}"
    assert answer.reason.startswith("no cellular flow detected")
