"""The weak form: rows that average by test functions, and the estimates from them."""

from functools import cache

import numpy as np
import pytest

import sparsefit as sf
from sparsefit import backends
from sparsefit.derivative import Derivative
from sparsefit.derivative.weak import automatic_window, correlation, weak_rows
from sparsefit.errors import InputError
from sparsefit.library import builder as library
from sparsefit.library.builder import Library
from sparsefit.library.cells import candidate_columns
from sparsefit.library.grid import LengthScaleGrid

VEHICLE = sf.PointMassVehicle(0.5, (5.0, 3.0))
GRID = LengthScaleGrid(2.0, 7.0, step=0.5)
FLOW = sf.CellularFlow(15.0, 4.21)


@cache
def flown(seed=7, **noise):
    return sf.simulate_flight(FLOW, VEHICLE, duration=10.0, sample_rate=100.0, seed=seed, **noise)


def rows_of(time, values, window, order=8):
    """Weak rows whose position and velocity are both ``values`` (m,)."""
    state = np.column_stack([values, values])
    return weak_rows(time, state, state, window, order)


def uneven(count=400, seed=1):
    steps = np.random.default_rng(seed).uniform(0.5, 1.5, count) / 100.0
    return np.cumsum(steps)


def test_a_test_function_by_hand():
    # (1 - s^2)^2 at s = -1, -1/2, 0, 1/2, 1, over its sum 2.125
    rows = rows_of(np.arange(7.0), np.zeros(7), 5, 2)
    expected = np.array([0.0, 0.5625, 1.0, 0.5625, 0.0]) / 2.125
    np.testing.assert_allclose(rows.operator.toarray()[0, :5], expected, rtol=1e-14)
    np.testing.assert_allclose(rows.time, [2.0, 3.0, 4.0], rtol=1e-14)


@pytest.mark.parametrize("time", [np.arange(400) / 100.0, uneven()])
@pytest.mark.parametrize("window", [5, 21, 60, 101])
def test_exact_for_constant_and_linear_motion(time, window):
    rows = rows_of(time, 3.0 - 2.0 * time, window | 1)
    np.testing.assert_allclose(rows.operator.sum(axis=1), 1.0, rtol=1e-13)
    np.testing.assert_allclose(rows.velocity[:, 0], 3.0 - 2.0 * rows.time, rtol=1e-11, atol=1e-11)
    np.testing.assert_allclose(rows.acceleration, -2.0, rtol=1e-10)
    np.testing.assert_array_equal(rows.position_rate, rows.acceleration)


def test_integration_by_parts():
    time = np.arange(1000) / 100.0
    rows = rows_of(time, np.sin(3 * time), 41)
    np.testing.assert_allclose(
        rows.acceleration[:, 0], rows.operator @ (3 * np.cos(3 * time)), atol=1e-10
    )


def test_uneven_steps_err_in_second_order():
    errors = []
    for count in (400, 1600):
        time = 4.0 * np.cumsum(np.random.default_rng(2).uniform(0.7, 1.3, count)) / count
        rows = rows_of(time, np.sin(3 * time), (count // 10) | 1)
        errors.append(
            np.abs(rows.acceleration[:, 0] - rows.operator @ (3 * np.cos(3 * time))).max()
        )
    assert errors[1] < errors[0] / 4


def test_no_row_spans_a_gap_in_the_log():
    time = np.concatenate([np.arange(200), np.arange(300, 500)]) / 100.0
    rows = rows_of(time, time, 41)
    for row in rows.operator:
        inside = time[row.indices]
        assert np.ptp(inside) <= rows.window * np.ptp(time) / 399
        assert len(inside) >= 20


def test_correlation_is_that_of_filtered_noise():
    # The mean square over n rows has variance 2 correlation / n, in units of its square.
    half, order, block = 10, 8, 1000
    s = np.linspace(-1, 1, 2 * half + 1)
    noise = np.random.default_rng(3).standard_normal(600 * block)
    rows = np.convolve(noise, s * (1 - s * s) ** (order - 1), "valid")[: 599 * block]
    means = np.mean(rows.reshape(599, block) ** 2, axis=1)
    measured = means.var() / means.mean() ** 2 * block / 2
    assert correlation(half, order) == pytest.approx(measured, rel=0.2)


def test_the_window_is_the_smoothers():
    assert automatic_window(2000, 137) == 137
    assert automatic_window(2000, 11) == 21
    assert automatic_window(60, 1) == 21
    assert automatic_window(30, 1) == 11


def test_theta_is_averaged_in_blocks(monkeypatch):
    samples = Derivative("weak", window=31)(flown())
    problem = Library(GRID).build(samples, VEHICLE)
    expected = samples.weak.operator @ candidate_columns(samples.weak.position, GRID.scales)
    assert len(expected) > 256
    np.testing.assert_allclose(problem.theta, expected, atol=1e-13)
    np.testing.assert_array_equal(problem.target, samples.weak.flow_velocity(VEHICLE))
    monkeypatch.setattr(library, "STREAM_BYTES", 0)
    folded = Library(GRID).build(samples, VEHICLE)
    assert folded.samples == problem.samples == len(expected)
    np.testing.assert_allclose(folded.theta.T @ folded.theta, expected.T @ expected, atol=1e-9)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("window", [None, 21, 61])
def test_without_noise_the_quadrature_alone_errs(seed, window):
    estimate = sf.Estimator(Derivative("weak", window), Library(GRID)).estimate(flown(seed))
    assert estimate.status == "ok"
    assert estimate.length_scale == pytest.approx(FLOW.length_scale, rel=1e-8)
    assert estimate.timescale == pytest.approx(FLOW.timescale, rel=1e-6)


def test_uneven_flights_need_no_derivative():
    flight = flown()
    kept = np.sort(np.random.default_rng(4).choice(1001, 700, replace=False))
    uneven_flight = sf.Flight(
        time=flight.time[kept],
        position=flight.position[kept],
        velocity=flight.velocity[kept],
        vehicle=VEHICLE,
    )
    estimate = sf.Estimator("weak", Library(GRID)).estimate(uneven_flight)
    assert estimate.timescale == pytest.approx(FLOW.timescale, rel=5e-3)


@pytest.mark.parametrize("target", ["acceleration", "state-derivative"])
def test_other_targets_are_averaged_too(target):
    estimator = sf.Estimator("weak", Library(GRID, target), "best-scale")
    estimate = estimator.estimate(flown())
    assert estimate.length_scale == pytest.approx(FLOW.length_scale, rel=1e-8)


@pytest.mark.parametrize(
    ("name", "settings"),
    [("least-squares", {"rcond": 0.03}), ("stlsq", {}), ("lasso", {}), ("group-omp", {})],
)
def test_back_ends_and_readouts_run_unchanged(name, settings):
    backend = backends.get(name, **settings)
    flight = flown(velocity_noise=0.2, position_noise=0.05)
    for readout in ("rms", "peak", "paper"):
        estimator = sf.Estimator("weak", Library(GRID), backend, sf.Readout(mean_velocity=readout))
        estimate = estimator.estimate(flight)
        assert sf.Estimator.from_json(estimator.to_json()) == estimator
        assert estimate.length_scale == pytest.approx(FLOW.length_scale, rel=1e-3)
        bias = 0.5 if readout == "paper" else 0.02  # Eq. 22's amplitude is off by up to sqrt(2)
        assert estimate.mean_velocity == pytest.approx(FLOW.mean_velocity, rel=bias)


def test_a_back_end_with_columns_of_its_own_says_no():
    estimate = sf.Estimator("weak", Library(GRID), backends.get("gridless-group-lasso")).estimate(
        flown()
    )
    assert estimate.status == "error"
    assert "needs the position of every row" in estimate.reason


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"window": 4}, "odd integer, 5 or above"),
        ({"window": 3}, "odd integer, 5 or above"),
        ({"window": 21.0}, "odd integer"),
        ({"order": 1}, "from 2 to 32"),
        ({"order": 2.5}, "from 2 to 32"),
    ],
)
def test_refuses_settings(settings, words):
    with pytest.raises(InputError, match=words):
        Derivative("weak", **settings)


def test_refuses_a_window_longer_than_the_flight():
    with pytest.raises(InputError, match="no weak test function of 1201 samples"):
        Derivative("weak", 1201)(flown())
