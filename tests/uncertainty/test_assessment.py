"""How sure an assessment is: of one mode or two, weak rows or not, an unknown vehicle or not."""

import json
import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import sparsefit as sf
from sparsefit.derivative import Derivative, Samples
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.library.builder import Library
from sparsefit.library.cells import Cells
from sparsefit.library.grid import LengthScaleGrid
from sparsefit.library.nuisance import Nuisance
from sparsefit.modes.fitted_rows import Rows
from sparsefit.modes.projection import project
from sparsefit.uncertainty import Uncertainty
from sparsefit.uncertainty.assessment import _as_found, assess, reader
from sparsefit.uncertainty.model import Model
from tests.fits import cells_at, located
from tests.fleet import fly_together

FLOW = sf.CellularFlow(12.0, 4.0)
VEHICLE = PointMassVehicle(0.5, (5.0, 3.0))
KNOWN = Nuisance((), VEHICLE)
SMOOTHER = Derivative("savgol", 21, 4)
WIND = (1.5, -2.0)
TAU_AND_THRUST = ("response_time", "thrust_acceleration")
TAU_AND_WIND = ("response_time", "wind")
FITS = [("weak", ()), ("auto", TAU_AND_THRUST), ("auto", TAU_AND_WIND), ("weak", TAU_AND_WIND)]
TRUTH = {"response_time": [0.5], "thrust_acceleration": [5.0, 3.0], "wind": [*WIND]}
MEASURED = {"velocity_noise": 0.2, "position_noise": 0.05}


@cache
def flown(unknown=(), seed=3, duration=10.0, flows=(FLOW,), rate=100.0, **noise):
    wind = WIND if "wind" in unknown else (0.0, 0.0)
    flow = sf.SuperposedFlow(flows, wind) if len(flows) > 1 or any(wind) else flows[0]
    return sf.simulate_flight(
        flow, VEHICLE, duration=duration, sample_rate=rate, seed=seed, **noise
    )


@pytest.fixture(scope="module")
def exact():
    return sf.simulate_flight(FLOW, VEHICLE, duration=8.0, sample_rate=100.0, seed=3)


def assessed(samples, k=(FLOW.wavenumber,), nuisance=KNOWN, *, correct=True, phi=None):
    """The assessment where modes fit best from wavenumbers k [1/m] on."""
    rows = Rows.of(samples.weak or samples, nuisance.believed, nuisance.unknown)
    rows = rows if phi is None else Rows.plain(samples.position, phi)
    fit = located(rows, np.array(k)[:, None])
    return assess(samples, rows, Cells(), fit, nuisance, correct=correct)


@pytest.mark.parametrize(("method", "unknown"), FITS)
def test_the_influence_is_what_a_refit_does(method, unknown):
    samples = Derivative(method)(flown(unknown))
    nuisance = Nuisance(unknown, VEHICLE)
    rows = Rows.of(samples.weak or samples, VEHICLE, unknown)
    fit = located(rows, [[FLOW.wavenumber]])
    vehicle = nuisance.read(fit.coefficients)
    model = Model.of(Cells(), rows, fit)
    if unknown:
        model, nuisance = _as_found(samples, model, nuisance, vehicle)
    read = reader(nuisance)
    influence = model.influence(read(model).gradients)
    step = np.random.default_rng(0).standard_normal(rows.target.shape) * 1e-3

    def refit(sign):
        moved = replace(model.rows, target=model.rows.target + sign * step)
        return read(Model.of(Cells(), moved, located(moved, fit.parameters))).values

    expected = np.einsum("ftq,qt->f", influence, step)
    np.testing.assert_allclose(0.5 * (refit(1) - refit(-1)), expected, rtol=1e-3, atol=1e-9)


@pytest.mark.parametrize("rule", [Derivative("forward"), Derivative("midpoint"), SMOOTHER])
def test_correction_takes_the_truncation_away(rule, exact):
    samples = rule(exact)
    (plain,), (better,) = (assessed(samples, correct=own).modes for own in (False, True))
    assert abs(better.mean_velocity - 12.0) < 0.05 * abs(plain.mean_velocity - 12.0)
    assert better.timescale == pytest.approx(better.length_scale / better.mean_velocity)
    # what is left in counts in full
    assert plain.uncertainty.mean_velocity > 0.9 * abs(plain.mean_velocity - 12.0)


@pytest.mark.parametrize("case", ["several scales", "unknown vehicle"])
def test_an_estimate_is_corrected_whatever_was_fitted(case):
    beside = (sf.CellularFlow(7.0, 6.5),) if case == "several scales" else ()
    flight = flown(duration=8.0, flows=(FLOW, *beside))
    library = Library() if beside else Library(unknown=TAU_AND_THRUST)
    away = []
    for correction in ("none", "first-order"):
        readout = sf.Readout(scales="several" if beside else "one", correction=correction)
        found = sf.Estimator(SMOOTHER, library, readout=readout).estimate(flight)
        away.append(abs(found.mean_velocity - 12.0 if beside else found.response_time - 0.5))
    assert away[1] < 0.1 * away[0]


def test_what_a_path_does_not_tell_is_infinite():
    x = np.linspace(0, 40, 900)
    position, phi = np.column_stack([x, x]), FLOW.velocity(x, x)
    model = cells_at(Rows.plain(position, phi), FLOW.wavenumber)
    assert not model.information.whole  # sin kx cos kx is one wave: its two weights are not told
    samples = Samples(0.01 * np.arange(900), position, phi, phi, phi)
    (mode,) = assessed(samples, phi=phi).modes
    assert mode.uncertainty.mean_velocity == math.inf
    assert mode.uncertainty.timescale == math.inf


@pytest.mark.parametrize("method", ["auto", "forward"])
def test_intervals_cover_process_noise(method):
    covered = []
    setting = {"duration": 6.0, "rate": 50.0, "seed": 1, "process_noise": 3.0}
    for flight in fly_together([(FLOW,)] * 25, VEHICLE, **setting):
        (mode,) = assessed(Derivative(method)(flight)).modes
        known = mode.uncertainty
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
            flow, vehicle, duration=10.0, sample_rate=100.0, seed=seed, **MEASURED
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
        (mode,) = assessed(Derivative()(flight)).modes
        low, high = mode.uncertainty.mean_velocity_interval
        assert low < 12.0 < high
        assert high - low < 1e-2


def test_phi_of_unknown_origin_has_the_lagged_variance(exact):
    samples = SMOOTHER(exact)
    bare = replace(samples, smoothing=None)
    phi = FLOW.velocity(*samples.position.T)
    phi = phi + 0.3 * np.random.default_rng(0).standard_normal(phi.shape)
    rows = Rows.plain(samples.position, phi)
    fit = project(Cells(), rows, np.array([[FLOW.wavenumber]]))
    (mode,) = assess(bare, rows, Cells(), fit, KNOWN, correct=True).modes
    assert mode.length_scale == pytest.approx(4.0)  # as given: nothing is known to correct
    assert 0 < mode.uncertainty.length_scale < 0.1


def test_below_21_samples_there_is_no_assessment():
    samples = Derivative()(flown(velocity_noise=0.2))
    names = ("time", "position", "velocity", "position_rate", "acceleration")
    for count, expected in ((20, True), (21, False)):
        short = replace(samples, **{name: getattr(samples, name)[:count] for name in names})
        rows = Rows.of(short, VEHICLE)
        fit = project(Cells(), rows, np.array([[FLOW.wavenumber]]))
        assert (assess(short, rows, Cells(), fit, KNOWN, correct=False) is None) == expected


def test_an_impossible_vehicle_has_no_assessment():
    samples = Derivative()(flown(velocity_noise=0.2))
    nuisance = Nuisance(("response_time",), VEHICLE)
    rows = Rows.of(samples, VEHICLE, ("response_time",))
    fit = project(Cells(), rows, np.array([[FLOW.wavenumber]]))
    wrong = replace(fit, coefficients=np.array([1.5]))
    assert assess(samples, rows, Cells(), fit, nuisance, correct=False) is not None
    assert assess(samples, rows, Cells(), wrong, nuisance, correct=False) is None


def test_estimates_carry_uncertainty_where_it_is_known():
    flight = flown(seed=1, duration=8.0, velocity_noise=0.2)
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


def test_uneven_steps_are_read_from_the_residuals():
    exact = flown(velocity_noise=0.1)
    rng = np.random.default_rng(5)
    kept = np.sort(rng.choice(len(exact.time), 700, replace=False))
    flight = sf.Flight(exact.time[kept], exact.position[kept], exact.velocity[kept], VEHICLE)
    found = sf.Estimator("weak").estimate(flight)
    assert 0 < found.uncertainty.length_scale < 0.05
    low, high = found.uncertainty.length_scale_interval
    assert low < found.length_scale < high


FLIGHTS = 30


@cache
def measured_flights(windy, modes):
    """Flows, and the samples of a flight through each with weak rows beside them."""
    flows = []
    for seed in range(FLIGHTS):
        rng = np.random.default_rng([seed, 23])
        scale, timescale = rng.uniform(3, 7), rng.uniform(0.2, 0.8)
        parts = [sf.CellularFlow(scale / timescale, scale)]
        if modes == 2:
            parts.append(sf.CellularFlow(0.6 * scale / timescale, 1.5 * scale))
        flows.append(tuple(parts))
    wind = WIND if windy else (0.0, 0.0)
    setting = {"duration": 14.0, "rate": 50.0 * modes, "seed": 40, "wind": wind, **MEASURED}
    flights = fly_together(flows, VEHICLE, **setting)
    return list(zip(flows, map(Derivative("weak"), flights), strict=True))


@pytest.mark.parametrize(
    ("method", "unknown", "modes"),
    [*((method, unknown, 1) for method, unknown in FITS), ("weak", TAU_AND_WIND, 2)],
)
def test_intervals_hold_the_truth(method, unknown, modes):
    nuisance, away = Nuisance(unknown, PointMassVehicle(0.6, (4.0, 3.5))), []
    if "thrust_acceleration" not in unknown:
        nuisance = replace(nuisance, believed=VEHICLE)
    for flows, measured in measured_flights("wind" in unknown, modes):
        samples = measured if method == "weak" else replace(measured, weak=None)
        known = assessed(samples, [flow.wavenumber for flow in flows], nuisance, correct=False)
        first = known.modes[0]
        if modes == 1 and first.uncertainty.wide(first.values, 0.03):  # no answer of the estimator
            continue
        assert (known.vehicle_uncertainty is None) == (not unknown)
        row = []
        for mode, flow in zip(known.modes, flows, strict=True):
            row.append((mode.mean_velocity - flow.mean_velocity) / mode.uncertainty.mean_velocity)
            row.append((mode.length_scale - flow.length_scale) / mode.uncertainty.length_scale)
        for name in unknown:
            values, spreads = (
                np.atleast_1d(getattr(own, name))
                for own in (known.vehicle, known.vehicle_uncertainty)
            )
            row += ((values - TRUTH[name]) / spreads).tolist()
        away.append(row)
    assert len(away) > 25
    square = np.mean(np.square(away), axis=0)
    assert (square < 2.0).all()  # chi-squared / 26: 1.9 is 0.5 % likely, 0.4 is 0.2 %
    assert (square > 0.35).all()


def test_estimates_of_an_unknown_vehicle_carry_its_uncertainty():
    library = Library(LengthScaleGrid(2.0, 8.0, 0.25), unknown=TAU_AND_WIND)
    found = sf.Estimator("weak", library).estimate(flown(TAU_AND_WIND, **MEASURED))
    assert found.status == "ok"
    known = found.vehicle_uncertainty
    assert abs(found.response_time - 0.5) < 4 * known.response_time
    assert (np.abs(np.subtract(found.wind, WIND)) < 4 * np.array(known.wind)).all()
    assert known.thrust_acceleration is None


def test_the_price_of_an_unknown_vehicle():
    flight = flown(**MEASURED)
    known = sf.Estimator().estimate(flight)
    free = sf.Estimator(library=Library(unknown=TAU_AND_THRUST)).estimate(flight)
    assert free.uncertainty.mean_velocity > 1.2 * known.uncertainty.mean_velocity
    assert free.uncertainty.length_scale == pytest.approx(known.uncertainty.length_scale, rel=0.3)


@pytest.mark.parametrize("correct", [False, True])
def test_what_is_believed_of_the_unknown_changes_nothing(correct):
    samples = Derivative()(flown(velocity_noise=0.3))
    one, other = (
        assessed(samples, nuisance=Nuisance(TAU_AND_THRUST, vehicle), correct=correct)
        for vehicle in (VEHICLE, PointMassVehicle(2.0, (-1.0, 7.0)))
    )
    for name, value in vars(one.modes[0].uncertainty).items():
        assert getattr(other.modes[0].uncertainty, name) == pytest.approx(value, rel=1e-6)
    assert other.modes[0].values == pytest.approx(one.modes[0].values, rel=1e-8)
    assert other.vehicle.response_time == pytest.approx(one.vehicle.response_time, rel=1e-8)
    first, second = one.vehicle_uncertainty, other.vehicle_uncertainty
    assert second.response_time == pytest.approx(first.response_time, rel=1e-6)
    assert second.wind is None


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
    rows, k = Rows.of(samples, VEHICLE), FLOW.wavenumber
    alone, pair = (
        assess(
            samples, rows, Cells(), project(Cells(), rows, np.array(own)), KNOWN, correct=False
        ).modes
        for own in ([[k]], [[k], [1.2 * k]])
    )
    assert pair[0].uncertainty.mean_velocity > alone[0].uncertainty.mean_velocity
