"""How sure the weak form, an unknown vehicle and several scales are."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

import sparsefit as sf
from sparsefit.derivative import Derivative
from sparsefit.derivative.filters import Filters
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.library.builder import Library
from sparsefit.library.grid import LengthScaleGrid
from sparsefit.modes.refine import centred, project
from sparsefit.modes.rows import Rows
from sparsefit.uncertainty import Fitted, VehicleUncertainty, assess_rows, assess_scales
from sparsefit.uncertainty.assess_rows import _gradients
from sparsefit.uncertainty.carried import lagged, overlap, powers
from sparsefit.uncertainty.noise import levels, variance
from sparsefit.uncertainty.superposed import Superposed

VEHICLE = PointMassVehicle(0.5, (5.0, 3.0))
FLOW = sf.CellularFlow(12.0, 4.0)
WIND = (1.5, -2.0)
TAU_AND_THRUST = ("response_time", "thrust_acceleration")
TAU_AND_WIND = ("response_time", "wind")
FITS = [("weak", ()), ("auto", TAU_AND_THRUST), ("auto", TAU_AND_WIND), ("weak", TAU_AND_WIND)]


def flown(unknown=(), seed=3, duration=10.0, flow=FLOW, **noise):
    flow = sf.SuperposedFlow((flow,), WIND) if "wind" in unknown else flow
    return sf.simulate_flight(
        flow, VEHICLE, duration=duration, sample_rate=100.0, seed=seed, **noise
    )


def fitted(rows, k):
    weights = rows.solved(k)[0]
    return Superposed(rows.position, np.array([k]), weights[None], rows.columns, rows.operator)


def refit(rows, target, k):
    """U0, L, tau_w, and what is estimated of the vehicle, of another Phi."""
    rows = replace(rows, target=target)
    for _ in range(30):
        k += rows.project(k).move
    scale = math.pi / k
    speed = float(np.sqrt(np.sum(np.array([1.0] * 4 + [0.5] * 4) @ rows.weights(scale) ** 2)))
    vehicle = rows.vehicle(scale)
    parts = [np.atleast_1d(getattr(vehicle, name)) for name in vehicle.unknown]
    return np.concatenate([[speed, scale, scale / speed], *parts])


@pytest.mark.parametrize(("method", "unknown"), FITS)
def test_the_influence_is_what_a_refit_does(method, unknown):
    samples = Derivative(method)(flown(unknown))
    rows = Rows.of(samples, VEHICLE, unknown)
    k = FLOW.wavenumber
    for _ in range(30):
        k += rows.project(k).move
    model, vehicle = fitted(rows, k), rows.vehicle(math.pi / k)
    influence = model.influence(np.vstack([_gradients(model, vehicle)]))
    step = np.random.default_rng(0).standard_normal(rows.target.shape) * 1e-3
    up, down = (refit(rows, rows.target + sign * step, k) for sign in (1, -1))
    expected = np.einsum("tqf,qt->f", influence, step)
    np.testing.assert_allclose(0.5 * (up - down), expected, rtol=1e-3, atol=1e-9)


def test_one_scale_of_plain_samples_is_the_plain_model():
    samples = Derivative()(flown(velocity_noise=0.2))
    filters, phi = Filters.of(samples), samples.flow_velocity(VEHICLE)
    points, k = centred(samples.position), FLOW.wavenumber
    weights = project(points, phi, k).weights
    plain = Fitted(points, k, weights)
    none = np.zeros((2, len(points), 0))
    model = Superposed(points, np.array([k]), weights[None], none)
    influence = model.influence(model.gradients)
    np.testing.assert_allclose(influence, plain.influence, rtol=1e-6, atol=1e-9)
    errors = phi - plain.flow
    pushed = errors + 0.1 * plain.bend
    np.testing.assert_allclose(model.score(pushed), plain.score(pushed), rtol=1e-6, atol=1e-9)
    found = powers(model, samples, filters, 0.5, influence)
    steep = float(np.mean(np.sum(plain.gradient**2, axis=0)))
    level = levels(filters, 0.5, errors, steep)
    np.testing.assert_allclose(level @ found, variance(plain, filters, 0.5, errors), rtol=1e-6)


@pytest.mark.parametrize("method", ["auto", "weak"])
def test_noise_reaches_the_rows_through_every_filter(method):
    # A unit of noise in every raw sample in turn, by dense matrices.
    samples = Derivative(method)(flown(duration=3.0, velocity_noise=0.1))
    filters, m = Filters.of(samples), len(samples.time)
    window = filters.raw.shape[2]
    dense = np.zeros((3, 2, m, m + window - 1))
    for i in range(m):
        dense[:, :, i, i : i + window] = filters.raw
    place, velocity, acceleration = dense
    points = centred(samples.position)
    rows = Rows.of(samples, VEHICLE, ()) if method == "weak" else None
    operator = rows.operator if rows else None
    mean, rate = np.eye(m), acceleration
    if rows:
        mean, rate = operator.toarray(), samples.weak.rate.toarray() @ velocity
    weights = np.random.default_rng(1).standard_normal((8, 2))
    none = np.zeros((2, len(mean), 0))
    model = Superposed(points, np.array([FLOW.wavenumber]), weights[None], none, operator)
    influence = np.random.default_rng(2).standard_normal((2, len(mean), 2))
    found = powers(model, samples, filters, 0.5, influence)
    steps, h = m + window - 2, 0.01
    time = np.arange(steps + 1) * h
    kicked = np.clip(time[:, None] - time[None, :-1], 0.0, h)  # velocity after a unit of V'
    moved = np.where(kicked >= h, h * (time[:, None] - time[None, :-1] - h / 2), 0.0)
    np.fill_diagonal(moved, 0.0)
    by_kick = np.tensordot(rate[0], moved, (1, 0)) + np.tensordot(rate[1], kicked, (1, 0))
    expected = np.zeros((3, 2))
    for f in range(2):
        for component in range(2):
            c = influence[component, :, f]
            expected[2, f] += np.sum((c @ by_kick) ** 2)
        for raw in range(2):
            for axis in range(2):  # noise of one axis: of both components, through the gradient
                total = -sum(
                    (influence[t, :, f] @ mean) * model.gradient[axis, :, t] for t in range(2)
                )
                row = total @ place[raw]
                row = row + influence[axis, :, f] @ (mean @ velocity[raw] + 0.5 * rate[raw])
                expected[raw, f] += np.sum(row**2)
    np.testing.assert_allclose(found, expected, rtol=1e-6)


def test_white_residuals_have_the_white_variance():
    rng = np.random.default_rng(4)
    influence, errors = rng.standard_normal((2, 4000, 3)), 0.3 * rng.standard_normal((4000, 2))
    found = lagged(influence, errors, 0, 0.0)
    by_hand = sum(np.mean(errors[:, t] ** 2) * np.sum(influence[t] ** 2, axis=0) for t in range(2))
    np.testing.assert_allclose(found, by_hand, rtol=1e-9)
    smooth = np.ones(influence.shape)  # the variance of a sum of errors that correlate over 5
    averaged = np.stack([np.convolve(e, np.ones(5), "same") for e in errors.T], axis=1)
    wide, narrow = (lagged(smooth, averaged, lags, 0.0)[0] for lags in (40, 0))
    assert 3.5 < wide / narrow < 5.5  # 5 of independent ones


def test_rows_that_overlap_by_their_windows():
    # windows of 21 samples, every 2nd: 10.5 rows share a sample, twice that is 21
    samples = Derivative("weak", window=21)(flown())
    assert overlap(samples) == 21


def test_uneven_steps_are_read_from_the_residuals():
    exact = flown(velocity_noise=0.1)
    rng = np.random.default_rng(5)
    kept = np.sort(rng.choice(len(exact.time), 700, replace=False))
    flight = sf.Flight(exact.time[kept], exact.position[kept], exact.velocity[kept], VEHICLE)
    found = sf.Estimator("weak").estimate(flight)
    assert 0 < found.uncertainty.length_scale < 0.05
    low, high = found.uncertainty.length_scale_interval
    assert low < found.length_scale < high


@pytest.mark.parametrize(("method", "unknown"), FITS)
def test_intervals_hold_the_truth(method, unknown):
    truths = {"response_time": [0.5], "thrust_acceleration": [5.0, 3.0], "wind": [*WIND]}
    estimator = sf.Estimator(method, Library(LengthScaleGrid(2.0, 8.0, 0.25), unknown=unknown))
    away = []
    for seed in range(40):
        rng = np.random.default_rng([seed, 23])
        scale, timescale = rng.uniform(3, 7), rng.uniform(0.2, 0.8)
        flow = sf.CellularFlow(scale / timescale, scale)
        noise = {"velocity_noise": 0.2, "position_noise": 0.05}
        flight = flown(unknown, seed + 40, duration=14.0, flow=flow, **noise)
        found = estimator.estimate(flight)
        if found.status != "ok":
            continue
        known, vehicle = found.uncertainty, found.vehicle_uncertainty
        assert (vehicle is None) == (not unknown)
        row = [
            (found.mean_velocity - flow.mean_velocity) / known.mean_velocity,
            (found.length_scale - scale) / known.length_scale,
        ]
        for name in unknown:
            values, spreads = (np.atleast_1d(getattr(one, name)) for one in (found, vehicle))
            row += ((values - truths[name]) / spreads).tolist()
        away.append(row)
    assert len(away) > 25
    square = np.mean(np.square(away), axis=0)
    assert (square < 2.0).all()  # chi-squared / 26: 1.9 is 0.5 % likely, 0.4 is 0.2 %
    assert (square > 0.35).all()


def test_the_price_of_an_unknown_vehicle():
    flight = flown(velocity_noise=0.2, position_noise=0.05)
    known = sf.Estimator().estimate(flight)
    free = sf.Estimator(library=Library(unknown=TAU_AND_THRUST)).estimate(flight)
    assert free.uncertainty.mean_velocity > 1.2 * known.uncertainty.mean_velocity
    assert free.uncertainty.length_scale == pytest.approx(known.uncertainty.length_scale, rel=0.3)


def test_what_is_believed_of_the_unknown_changes_no_spread():
    flight = flown(velocity_noise=0.3)
    samples = Derivative()(flight)
    found = [
        assess_rows(samples, Rows.of(samples, vehicle, TAU_AND_THRUST), FLOW.wavenumber)
        for vehicle in (VEHICLE, PointMassVehicle(2.0, (-1.0, 7.0)))
    ]
    one, other = (vars(each.uncertainty) for each in found)
    for name, value in one.items():
        assert other[name] == pytest.approx(value, rel=1e-6)
    one, other = (each.vehicle_uncertainty for each in found)
    assert other.response_time == pytest.approx(one.response_time, rel=1e-6)
    assert other.wind is None


def test_a_width_beyond_the_limit_is_said():
    grid = LengthScaleGrid(2.0, 8.0, 0.25)
    flight = flown(duration=6.0, velocity_noise=1.0, position_noise=0.05)
    found = sf.Estimator(library=Library(grid, unknown=TAU_AND_THRUST)).estimate(flight)
    assert found.status == "unidentifiable"
    assert "is known only to" in found.reason
    assert found.uncertainty is not None


def test_every_scale_has_its_spread():
    parts = sf.CellularFlow(12.0, 3.1), sf.CellularFlow(8.0, 5.2)
    vehicle = PointMassVehicle(0.5, (20.0, 11.3))
    flight = sf.simulate_flight(
        sf.SuperposedFlow(parts),
        vehicle,
        duration=15.0,
        sample_rate=100.0,
        seed=11,
        velocity_noise=0.1,
    )
    estimator = sf.Estimator(readout=sf.Readout(scales="several"))
    found = estimator.estimate(flight)
    assert found.status == "ok"
    assert len(found.scales) == 2
    for one, truth in zip(found.scales, parts, strict=True):
        known = one.uncertainty
        assert abs(one.mean_velocity - truth.mean_velocity) < 4 * known.mean_velocity
        assert abs(one.length_scale - truth.length_scale) < 4 * known.length_scale
        assert known.mean_velocity < 0.1 * truth.mean_velocity
    assert found.uncertainty == found.scales[0].uncertainty
    record = json.loads(json.dumps(found.to_dict(), allow_nan=False))
    assert record["scales"][1]["uncertainty"]["length_scale"] == pytest.approx(
        found.scales[1].uncertainty.length_scale
    )
    peak = sf.Estimator(readout=sf.Readout(scales="several", mean_velocity="peak"))
    assert peak.estimate(flight).scales[0].uncertainty is None


def test_a_scale_that_is_not_told_is_said():
    estimator = sf.Estimator(readout=sf.Readout(scales="several"))
    found = estimator.estimate(flown(seed=1, duration=0.4))
    assert found.scales[0].uncertainty.mean_velocity == math.inf
    assert found.status == "unidentifiable"
    assert "does not tell" in found.reason


def test_a_second_scale_costs_the_first_something():
    samples = Derivative()(flown(velocity_noise=0.2))
    phi, k = samples.flow_velocity(VEHICLE), FLOW.wavenumber
    (alone,) = assess_scales(samples, phi, np.array([k]), 0.5)
    pair = assess_scales(samples, phi, np.array([k, 1.2 * k]), 0.5)
    assert pair[0].mean_velocity > alone.mean_velocity
    short = replace(
        samples,
        **{
            name: getattr(samples, name)[:20]
            for name in ("time", "position", "velocity", "position_rate", "acceleration")
        },
    )
    assert assess_scales(short, phi[:20], np.array([k]), 0.5) == (None,)


def test_a_line_tells_some_and_not_all():
    t = np.linspace(0, 10, 400)
    position = np.stack([3.0 * t, 3.0 * t], axis=1)
    model = Superposed(
        centred(position), np.array([0.8]), np.arange(16.0).reshape(1, 8, 2), np.zeros((2, 400, 0))
    )
    assert not model.whole  # on a diagonal sin x = sin y: only the sum of their weights is told
    one, other = np.zeros((2, 17))
    one[1] = other[1] = other[2] = 1.0
    assert model.lost(np.stack([one, other])).tolist() == [True, False]
    assert model.lost(model.gradients)[0]


def test_the_record_of_a_vehicle_by_hand():
    found = VehicleUncertainty.around({"response_time": (0.5,)}, {"response_time": (0.01,)})
    assert found.response_time == 0.01
    assert found.response_time_interval == pytest.approx((0.5 - 0.0196, 0.5 + 0.0196), abs=1e-5)
    assert found.wind is found.wind_intervals is None
    found = VehicleUncertainty.around({"wind": (1.0, 2.0)}, {"wind": (0.1, math.inf)})
    assert math.isnan(found.response_time)
    assert found.wind_intervals[1] == (-math.inf, math.inf)


def test_what_a_fit_leaves_of_a_spectrum():
    # Errors of a known spectrum, projected off J by dense matrices; ends of the flight aside.
    samples = Derivative()(flown(velocity_noise=0.1))
    points, m, size = centred(samples.position), len(samples.time), 4 * len(samples.time)
    weights = np.random.default_rng(3).standard_normal((1, 8, 2))
    model = Superposed(points, np.array([FLOW.wavenumber]), weights, np.zeros((2, m, 0)))
    shape = np.abs(np.fft.rfft(np.array([1.0, 0.6, 0.3]), size)) ** 2
    tiled = np.fft.irfft(shape, size)[np.abs(np.subtract.outer(np.arange(m), np.arange(m)))]
    covariance = np.kron(np.eye(2), tiled)
    identity = np.eye(2 * m)
    jacobian = np.stack([model.score(one.reshape(2, m).T) for one in identity])
    off = identity - jacobian @ np.linalg.pinv(jacobian)
    after = off @ covariance @ off
    expected = np.zeros(size // 2 + 1)
    for t in range(2):
        own = after[t * m : (t + 1) * m, t * m : (t + 1) * m]
        once = np.fft.rfft(own, size, axis=0)  # E F e e'F', its diagonal
        turned = np.exp(-2j * np.pi * np.outer(np.arange(size // 2 + 1), np.arange(m)) / size)
        expected += np.sum(once * turned.conj(), axis=1).real / (2 * m)
    (found,) = model.left(shape[None], size)
    assert np.abs(found - expected).max() < 0.05 * expected.max()
    assert found.sum() == pytest.approx(expected.sum(), rel=1e-2)
    assert (found < 0.9 * shape).any()
