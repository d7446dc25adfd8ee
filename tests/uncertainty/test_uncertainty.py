import json
import math
from dataclasses import replace

import numpy as np
import pytest

import sparsefit as sf
from sparsefit.derivative import Derivative, Samples
from sparsefit.derivative.filters import Filters
from sparsefit.modes.refine import centred, project, refine
from sparsefit.uncertainty import Fitted, Uncertainty, assess
from sparsefit.uncertainty.bias import noisy_positions, truncation
from sparsefit.uncertainty.bound import _functionals, semiparametric
from sparsefit.uncertainty.noise import variance

FLOW = sf.CellularFlow(12.0, 4.0)
VEHICLE = sf.PointMassVehicle(0.5, (5.0, 3.0))
SMOOTHER = Derivative("savgol", 21, 4)


@pytest.fixture(scope="module")
def exact():
    return sf.simulate_flight(FLOW, VEHICLE, duration=8.0, sample_rate=100.0, seed=3)


def with_noise(flight, seed, sigma_position, sigma_velocity):
    rng = np.random.default_rng(seed)
    shape = flight.position.shape
    return sf.Flight(
        time=flight.time,
        position=flight.position + sigma_position * rng.standard_normal(shape),
        velocity=flight.velocity + sigma_velocity * rng.standard_normal(shape),
        vehicle=flight.vehicle,
        flow=flight.flow,
    )


def fitted_at(samples, wavenumber=FLOW.wavenumber):
    points, phi = centred(samples.position), samples.flow_velocity(VEHICLE)
    return Fitted(points, wavenumber, project(points, phi, wavenumber).weights), phi


def test_influence_is_that_of_the_full_jacobian(exact):
    fitted, _ = fitted_at(SMOOTHER(exact))
    jacobian, gradients = semiparametric(fitted.position, fitted.weights, fitted.wavenumber)
    rows, lost = _functionals(jacobian, gradients)
    ours = fitted.influence.reshape(-1, 3)
    np.testing.assert_allclose(ours, rows, rtol=1e-6, atol=1e-9 * np.abs(rows).max())
    assert not lost.any()
    assert not fitted.inverse[1].any()
    errors = np.random.default_rng(0).standard_normal(fitted.position.shape)
    np.testing.assert_allclose(fitted.score(errors), jacobian.T @ errors.T.ravel())


def test_an_error_of_phi_moves_the_estimate_by_its_influence(exact):
    samples = SMOOTHER(exact)
    phi = FLOW.velocity(*samples.position.T)
    error = 1e-4 * np.random.default_rng(1).standard_normal(phi.shape)

    def values(target):
        found = refine(samples.position, target, lower=3.0, upper=5.0)
        points, k = centred(samples.position), found.wavenumber
        return Fitted(points, k, project(points, target, k).weights)

    plain, moved = values(phi), values(phi + error)
    expected = np.einsum("tmf,mt->f", plain.influence, error)
    np.testing.assert_allclose(moved.values - plain.values, expected, rtol=2e-3)


def test_what_a_path_does_not_tell_is_infinite():
    x = np.linspace(0, 40, 900)
    points = np.column_stack([x, x]) - 20.0
    phi = FLOW.velocity(x, x)
    fitted = Fitted(points, FLOW.wavenumber, project(points, phi, FLOW.wavenumber).weights)
    assert fitted.inverse[1][0]  # sin kx cos kx is one wave: its two weights are not told apart


@pytest.mark.parametrize(
    "rule", [Derivative("forward"), Derivative("midpoint"), SMOOTHER], ids=lambda rule: rule.method
)
def test_truncation_is_found_without_the_truth(rule, exact):
    samples = rule(exact)
    fitted, phi = fitted_at(samples)
    lost, share = truncation(fitted, samples.velocity, Filters.of(samples))
    known = (lost != 0).any(axis=1)
    true = phi - FLOW.velocity(*samples.position.T)
    assert share == pytest.approx(len(lost) / known.sum())
    assert np.std((lost - true)[known]) < 0.05 * np.std(true[known])


@pytest.mark.parametrize("rule", [Derivative("forward"), Derivative("midpoint"), SMOOTHER])
def test_correction_takes_the_truncation_away(rule, exact):
    samples = rule(exact)
    phi = samples.flow_velocity(VEHICLE)
    k = refine(samples.position, phi, lower=1.0, upper=12.0).wavenumber
    plain = assess(samples, phi, k, VEHICLE.response_time, correct=False)
    better = assess(samples, phi, k, VEHICLE.response_time)
    assert abs(better.mean_velocity - 12.0) < 0.05 * abs(plain.mean_velocity - 12.0)
    assert better.timescale == pytest.approx(better.length_scale / better.mean_velocity)


def test_position_noise_attenuates_a_plane_wave():
    # Evenly over whole cells: C'e = -s^2 |kappa|^2/2 C'C W, so each weight loses its share.
    s, axis = 0.1, np.arange(64) * 0.25 - 7.875
    points = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    weights = np.zeros((8, 2))
    weights[0, 0], weights[5, 0], weights[6, 1] = 2.0, 12.0, -12.0
    fitted = Fitted(points, FLOW.wavenumber, weights)
    raw = np.zeros((3, 2, 1))
    raw[0, 0], raw[1, 1] = 1.0, 1.0
    filters = Filters(raw, np.ones(1), None, None, s, 0.0)
    score = noisy_positions(fitted, filters, 0.5)[1:].reshape(2, 8)
    k2, m = FLOW.wavenumber**2, len(points)
    assert score[0, 5] == pytest.approx(-(s**2) * k2 * 12.0 * m / 4)  # C'C: m/4 of a product,
    assert score[0, 0] == pytest.approx(-0.5 * s**2 * k2 * 2.0 * m / 2)  # m/2 of a single


def test_position_noise_shifts_the_fit_as_a_monte_carlo_says(exact):
    # Noise of the position alone, Phi exact: an ill-determined flight loses more than a wave does.
    s, phi = 0.05, FLOW.velocity(*exact.position.T)
    points, k = centred(exact.position), FLOW.wavenumber
    fitted = Fitted(points, k, project(points, phi, k).weights)
    raw = np.zeros((3, 2, 1))
    raw[0, 0], raw[1, 1] = 1.0, 1.0
    filters = Filters(raw, np.ones(1), None, None, s, 0.0)
    expected = fitted.moved(noisy_positions(fitted, filters, 0.5)).values - fitted.values
    rng, found = np.random.default_rng(5), []
    for _ in range(60):
        noise = s * rng.standard_normal(points.shape)
        for sign in (-1, 1):  # antithetic: the first order cancels
            best = refine(points + sign * noise, phi, lower=3.5, upper=4.5)
            place = centred(points + sign * noise)
            weights = project(place, phi, best.wavenumber).weights
            found.append(Fitted(place, best.wavenumber, weights).values - fitted.values)
    mean, error = np.mean(found, axis=0), np.std(found, axis=0) / math.sqrt(len(found))
    assert abs(mean[0] - expected[0]) < 4 * error[0] + 0.1 * abs(expected[0])
    assert abs(expected[0]) > 10 * error[0]


def test_variance_is_that_of_white_noise_through_the_filters(exact):
    # The variance of sum c e, e = through(noise) - grad w . place(noise), by brute force.
    flight = with_noise(exact, 7, 0.02, 0.3)
    samples = SMOOTHER(flight)
    fitted, phi = fitted_at(SMOOTHER(exact))
    filters = replace(Filters.of(samples), sigma_position=0.02, sigma_velocity=0.3)
    errors = phi - phi
    sums, rng = [], np.random.default_rng(8)
    for _ in range(400):
        noise = [sigma * rng.standard_normal(exact.position.shape) for sigma in (0.02, 0.3)]

        def read(kernel, noise=noise):
            return sum(
                np.column_stack([np.correlate(column, one, "valid") for column in values.T])
                for one, values in zip(kernel, noise, strict=True)
            )

        place, velocity, acceleration = (read(kernel) for kernel in filters.raw)
        errors = velocity + VEHICLE.response_time * acceleration
        errors = errors - np.einsum("imt,mi->mt", fitted.gradient, place)
        sums.append(np.einsum("tmf,mt->f", fitted.influence, errors))
    # The level is read from one draw of the errors.
    found = variance(fitted, filters, VEHICLE.response_time, errors)
    np.testing.assert_allclose(found, np.var(sums, axis=0), rtol=0.35)


@pytest.mark.parametrize("method", ["auto", "forward"])
def test_intervals_cover_process_noise(method):
    covered = []
    for seed in range(25):
        flight = sf.simulate_flight(
            FLOW, VEHICLE, duration=6.0, sample_rate=50.0, seed=seed, process_noise=3.0, substeps=2
        )
        samples = Derivative(method)(flight)
        phi = samples.flow_velocity(VEHICLE)
        k = refine(samples.position, phi, lower=3.0, upper=5.0).wavenumber
        known = assess(samples, phi, k, VEHICLE.response_time).uncertainty
        (low, high), (least, most) = known.mean_velocity_interval, known.length_scale_interval
        covered.append((low < 12.0 < high, least < 4.0 < most))
        assert high - low < 4.0  # an interval that always covers says nothing
    # More than 5 of 25 misses have a probability of 1e-3 at 95 %.
    assert (np.sum(covered, axis=0) >= 20).all()


@pytest.mark.slow
def test_intervals_cover_measured_noise_of_flights_at_large():
    # Smoothed over 100 samples and more: the residuals' correlation outlasts any fixed lag.
    covered, vehicle = [], sf.PointMassVehicle(0.1, (20.0, 12.0))
    for seed in range(120):
        rng = np.random.default_rng([seed, 17])
        scale, timescale = rng.uniform(2, 10), rng.uniform(0.1, 1)
        flow = sf.CellularFlow(scale / timescale, scale)
        flight = sf.simulate_flight(
            flow,
            vehicle,
            duration=10.0,
            sample_rate=100.0,
            seed=seed,
            velocity_noise=0.2,
            position_noise=0.05,
        )
        found = sf.Estimator().estimate(flight)
        if found.status == "ok":
            known = found.uncertainty
            (low, high), (least, most) = known.mean_velocity_interval, known.length_scale_interval
            covered.append((low < flow.mean_velocity < high, least < scale < most))
    assert len(covered) > 90
    missed = np.sum(~np.array(covered), axis=0)
    assert (missed <= 15).all()  # 1e-3 likely at 95 %, in 120
    assert missed.sum() > 0  # an interval that always covers is too wide


def test_noise_free_intervals_hold_the_truth_and_are_narrow(exact):
    for rate in (1, 2, 4):
        flight = sf.Flight(
            time=exact.time[::rate],
            position=exact.position[::rate],
            velocity=exact.velocity[::rate],
            vehicle=VEHICLE,
        )
        samples = Derivative()(flight)
        phi = samples.flow_velocity(VEHICLE)
        k = refine(samples.position, phi, lower=1.0, upper=12.0).wavenumber
        known = assess(samples, phi, k, VEHICLE.response_time).uncertainty
        low, high = known.mean_velocity_interval
        assert low < 12.0 < high
        assert high - low < 1e-2


def test_phi_of_unknown_origin_has_the_lagged_variance(exact):
    samples = SMOOTHER(exact)
    bare = Samples(
        samples.time,
        samples.position,
        samples.velocity,
        samples.position_rate,
        samples.acceleration,
    )
    phi = FLOW.velocity(*samples.position.T)
    phi = phi + 0.3 * np.random.default_rng(0).standard_normal(phi.shape)
    known = assess(bare, phi, FLOW.wavenumber, 0.5)
    assert known.length_scale == pytest.approx(4.0)  # as given: nothing is known to correct
    assert 0 < known.uncertainty.length_scale < 0.1
    assert assess(replace(bare, position=bare.position[:20]), phi[:20], 0.8, 0.5) is None


def test_words_for_what_is_hardly_known():
    known = Uncertainty.around([10.0, 4.0, 0.4], [2.0, 0.01, 0.08])
    assert "mean velocity is known only to +-39 %" in known.wide((10.0, 4.0, 0.4))
    assert Uncertainty.around([10.0, 4.0, 0.4], [0.02, 0.01, 0.002]).wide((10.0, 4.0, 0.4)) == ""
    lost = Uncertainty.around([10.0, 4.0, 0.4], [math.nan, 0.01, 0.002])
    assert lost.mean_velocity == math.inf
    assert "does not tell the mean velocity" in lost.wide((10.0, 4.0, 0.4))


def test_estimates_carry_uncertainty_where_it_is_known():
    flight = sf.simulate_flight(
        FLOW, VEHICLE, duration=8.0, sample_rate=100.0, seed=1, velocity_noise=0.2
    )
    found = sf.Estimator().estimate(flight)
    low, high = found.uncertainty.length_scale_interval
    assert low < found.length_scale < high
    assert found.to_dict()["uncertainty"]["length_scale_interval"] == [low, high]
    lost = Uncertainty.around([12.0, 4.0, 0.3], [math.inf, 0.1, math.inf])
    written = json.dumps(replace(found, uncertainty=lost).to_dict(), allow_nan=False)
    assert json.loads(written)["uncertainty"]["mean_velocity_interval"] == [None, None]
    for readout in (sf.Readout(refine="none"), sf.Readout(mean_velocity="peak")):
        assert sf.Estimator(readout=readout).estimate(flight).uncertainty is None
    plain = sf.Estimator(readout=sf.Readout(correction="none")).estimate(flight)
    assert plain.mean_velocity != found.mean_velocity
    assert plain.mean_velocity == pytest.approx(found.mean_velocity, rel=1e-2)
