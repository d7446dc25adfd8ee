"""The default estimator as a user meets it: accurate, and plain about what it cannot tell."""

import math
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

import sparsefit as sf
from sparsefit import backends
from sparsefit.errors import InputError
from sparsefit.estimator import Doubt
from sparsefit.estimator.judge import doubts_of_flow
from sparsefit.estimator.measure import measure_flow
from sparsefit.estimator.prepare import Ways, latency_of
from sparsefit.likelihood.causes import Suspect
from sparsefit.likelihood.goodness import Goodness
from sparsefit.model import Start, propose
from tests.problems import VEHICLE, fly, part
from tests.worlds import GROUPS, draw

FLOW = sf.CellularFlow(mean_velocity=15.43, length_scale=4.21)
TIME = np.arange(600) * 0.01
END, DECAY = 0.5 * np.array([5.0, 3.0]), np.exp(-TIME / 0.5)[:, None]  # speeds up to tau a
flown = cache(fly)


def estimate(flight, *bounds):
    library = sf.Library(sf.model.LengthScaleGrid(*bounds))
    return sf.Estimator(library=library).estimate(flight)


def moved(position, velocity):
    return sf.Flight(TIME, position, velocity * np.ones((600, 2)), VEHICLE)


def test_a_flow_slower_than_a_metre_a_second_is_read_on_the_grid():
    found = sf.Estimator(readout=sf.Readout(refine="none")).estimate(fly(sf.CellularFlow(0.5, 4.2)))
    assert (found.status, found.length_scale) == ("ok", 4.2)
    assert found.mean_velocity == pytest.approx(0.5, rel=1e-3)


@pytest.mark.parametrize(("share", "doubt"), [(0.45, Doubt.NO_CELLS), (0.55, None)])
def test_two_waves_are_cells_from_half_of_each_others_strength_on(share, doubt):
    k = np.pi / 4.0 * np.array([[1.0, 1.0], [1.0, -1.0]])
    flow = sf.flows.WaveFlow(k, [5.0, 5.0 * share], [0.0, 0.0])
    found = estimate(fly(flow, noise=(0.1, 0.02), initial_position=(1.0, 2.0)), 2.0, 8.0)
    assert (found.status, found.doubt) == ("unidentifiable" if doubt else "ok", doubt)


@pytest.mark.parametrize(
    ("position", "velocity", "words"),
    [
        (np.column_stack([10 * TIME, 5 * TIME + 1]), [10.0, 5.0], "no cellular flow"),
        (END * (TIME[:, None] - 0.5 * (1 - DECAY)) + 1.0, END * (1 - DECAY), "still"),
    ],
    ids=["uniform wind", "still air"],
)
def test_what_is_no_cellular_flow_is_unidentifiable(position, velocity, words):
    found = estimate(moved(position, velocity))
    assert found.status == "unidentifiable"
    assert words in found.reason


@pytest.mark.parametrize(
    ("position", "velocity", "words"),
    [
        (np.outer(TIME, [5.0, 0.0]), [5.0, 0.0], "stays on the line y = 0"),
        (np.full((600, 2), 3.0), [0.0, 0.0], "does not move"),
    ],
)
def test_flights_that_can_tell_no_scale_are_refused(position, velocity, words):
    with pytest.raises(InputError, match=words):
        estimate(moved(position, velocity))


def test_settings_that_share_a_factorisation_are_each_charged_for_it():
    problem = sf.Estimator().prepare(flown(FLOW)).problem
    first = sf.fit(problem, backends.get("least-squares"))
    second = sf.fit(problem, backends.get("least-squares", rcond=0.01))
    assert min(first.seconds, second.seconds) >= problem.spectrum.seconds


@pytest.mark.parametrize("level", [0.03, 0.3])
def test_process_noise_alone_is_no_misfit(level):
    """A position that process noise moves by micrometres a step has no noise of its own."""
    flight = fly(sf.CellularFlow(9.9, 4.79), duration=20.0, seed=2, process_noise=level)
    assert estimate(flight).status == "ok"


@pytest.mark.parametrize("noise", [0.0, pytest.param(0.3, marks=pytest.mark.slow)])
@pytest.mark.parametrize(("lower", "upper"), [(1.0, 3.0), (1.9, 2.3), (4.4, 12.0), (8.0, 9.0)])
def test_bounds_that_exclude_the_truth_are_flagged(lower, upper, noise):
    # L/2 = 2.105 m and 2L = 8.42 m, the harmonics, are within some of them.
    found = estimate(flown(FLOW, seed=int(noise > 0.0), noise=(noise, 0.0)), lower, upper)
    assert found.status in ("unidentifiable", "misfit")
    assert found.reason


def test_samples_too_far_apart_are_named_with_the_rate_that_is_enough():
    found = estimate(flown(FLOW, rate=5.0, duration=20.0, seed=7))
    assert found.status == "unidentifiable"
    assert "from sample to sample" in found.reason
    rate = float(found.reason.split("sample at ")[1].split(" Hz or more")[0])
    found = estimate(flown(FLOW, rate=2 * math.ceil(rate), duration=20.0, seed=7))
    assert found.status == "ok"
    assert found.mean_velocity == pytest.approx(15.43, rel=0.05)


@pytest.mark.parametrize(
    ("flow", "options"),
    [
        *((FLOW, {"rate": rate, "duration": 20.0}) for rate in (4.0, 8.0, 16.0)),
        (sf.CellularFlow(6.0, 10.0), {"duration": 2.0, "noise": (0.5, 0.1)}),  # within one cell
        *((sf.CellularFlow(12.0, 6.0), {"rate": 50, "duration": 0.02 * n}) for n in (17, 47)),
    ],
)
@pytest.mark.parametrize("scales", ["one", "several"])
def test_what_tells_little_is_right_or_flagged(flow, options, scales):
    found = sf.Estimator(readout=sf.Readout(scales=scales)).estimate(flown(flow, **options))
    if found.status == "ok":
        assert found.mean_velocity == pytest.approx(flow.mean_velocity, rel=0.05)
        assert found.length_scale == pytest.approx(flow.length_scale, rel=0.05)
    else:
        assert found.reason


def test_a_rival_that_explains_a_short_flight_as_well_is_told():
    flow = sf.flows.ShapedCells(9.8, (5.89, 6.77), heading=1.3)
    vehicle, settings = sf.PointMassVehicle(0.5, (4.0, 2.0)), {"initial_position": (0.8, 1.0)}
    flight = fly(flow, vehicle, duration=3.0, rate=50.0, seed=48, noise=(0.4, 0.1), **settings)
    found = estimate(flight)
    assert found.doubt is Doubt.RIVAL
    # The likelier is wrong and the rival near the truth; both are in the reason.
    assert found.length_scale == pytest.approx(4.2, abs=0.1)
    assert found.rival_length_scale == pytest.approx(6.5, abs=0.1)
    assert f"{found.rival_length_scale:.3g} m (shape" in found.reason


@pytest.mark.parametrize("samples", [3, 5, 12, 18, 21])  # up to 20 of Phi
def test_a_handful_of_samples_tells_nothing(samples):
    found = estimate(part(flown(FLOW, seed=7), slice(samples)))
    assert found.status == "unidentifiable"
    assert "samples are too few" in found.reason


@pytest.mark.parametrize("seed", range(2))
def test_still_air_flown_slowly_with_noisy_instruments_is_no_flow(seed):
    # Long windows leave few independent errors: their correlation is read from their spectrum.
    vehicle = sf.PointMassVehicle(0.5, (1.0, 0.6))
    flight = fly(None, vehicle, duration=20.0, seed=seed, noise=(0.5, 0.1))
    found = sf.Estimator().estimate(flight)
    assert (found.status, found.doubt) == ("unidentifiable", Doubt.NO_FLOW), found.reason


@pytest.mark.parametrize("late", [-0.2, 0.2])
def test_a_large_latency_is_named_or_freed(late):
    whole = flown(FLOW, rate=50.0, duration=20.0, noise=(0.2, 0.05))
    shift = round(late * 50)
    there, then = slice(10, -10), slice(10 - shift, len(whole.time) - 10 - shift)
    flight = replace(part(whole, there), position=whole.position[then])
    found = estimate(flight)
    if found.status == "ok":  # with the latency freed, which moves the flow by nothing
        assert found.freed == ("latency",)
        assert found.mean_velocity == pytest.approx(15.43, rel=0.01)
    else:
        words = f"the logged {'position' if late > 0 else 'velocity'} seems late, by"
        assert (found.status, words in found.reason) == ("misfit", True)
        milliseconds = float(found.reason.split(words)[1].split(" ms")[0])
        assert milliseconds == pytest.approx(200, abs=40)
    freed = sf.Estimator(free="auto").estimate(flight)  # rows so far apart may not show the flow
    assert freed.status == "misfit" or freed.mean_velocity == pytest.approx(15.43, rel=0.01)


@pytest.mark.parametrize(
    ("position", "velocity", "words"),
    [
        (1e-3, 1e-3, "less than the shortest length scale of the search, 1 m; check the units"),
        (1.0, 1.944, "time: the velocity may be in knots"),
        (1.0, 2.237, "time: the velocity may be in miles/h"),
        (3.28084, 1.0, "time: the position may be in feet"),
        (3.28084, 3.28084, "position and velocity may both be in feet"),
        (1e3, 1.0, "moves 1000 times as far as the logged velocity says; check the units"),
        (1.0, -1.0, "they are 200 % of the motion apart; check units, axes and time stamps"),
    ],
)
def test_other_units_are_told(position, velocity, words):
    whole = flown(sf.CellularFlow(15.43, 3.0), rate=50.0, duration=20.0)
    log = {"position": position * whole.position, "velocity": velocity * whole.velocity}
    found = sf.Estimator().estimate(replace(whole, **log))
    status = "misfit" if "both" in words else "unidentifiable"
    assert (found.status, words in found.reason) == (status, True), found.reason


def test_a_latency_is_read_from_a_log_where_it_mends_the_way():
    """The way of a velocity that is 10 % too large is a tenth apart, at any latency."""
    whole = flown(FLOW, rate=50.0, duration=20.0)
    late = replace(part(whole, slice(10, -10)), position=whole.position[5:-15])
    assert latency_of(late) == pytest.approx(0.1, abs=0.0154)  # half a step
    large = replace(whole, velocity=1.1 * whole.velocity)
    assert Ways.of(large).apart() == pytest.approx(0.1 / 1.1, rel=0.02)
    assert latency_of(large) == latency_of(whole) == 0.0


def test_positions_far_away_are_no_readings():
    whole = flown(FLOW, rate=50.0, duration=10.0, noise=(0.05, 0.01))
    position = whole.position.copy()
    position[[42, 89, 90, 118, 403, 406], 0] += 50.0
    found = sf.Estimator().estimate(replace(whole, position=position))
    assert found.status == "ok", found.reason
    assert found.length_scale == pytest.approx(FLOW.length_scale, rel=0.01)


@pytest.mark.parametrize(
    ("kind", "seed", "precision"),
    [
        (0, 95002, 0.15),  # four waves are likelier in white noise
        pytest.param(4, 95003, 0.03, marks=pytest.mark.slow),  # gusts that come and go: else 12 %
    ],
)
def test_gusts_leave_the_cells_what_they_are(kind, seed, precision):
    ((flight, truth),) = draw(GROUPS["turbulence30"][kind], 1, seed)
    found = sf.Estimator(readout=sf.Readout(precision=precision)).estimate(flight)
    assert (found.status, found.shape) == ("ok", "axis")
    assert abs(found.mean_velocity - truth.mean_velocity) < 3 * found.uncertainty.mean_velocity


def test_a_freer_shape_does_not_stand_in_for_a_wrong_vehicle():
    """Waves that drift apart fit as well as cells beside nine tenths of the thrust."""
    ((flight, _),) = draw(GROUPS["vehicle"][5], 6, 883001, first=5)
    suspect = sf.Estimator().estimate(flight).goodness.suspect
    assert (suspect.free, suspect.size) == ("thrust_scale", pytest.approx((-0.1,), abs=0.01))


def test_optima_of_parts_of_a_flight_are_misfits_but_not_beside_a_position_that_jumps():
    drawn = (5, 24, 772004, "innovations are not white"), (3, 2, 913, "another than after it (p =")
    hidden = (5, 62, 7103, "gusts of one direction")  # two waves of the second flow
    for world, count, seed, words in (*drawn, hidden):
        ((flight, _),) = draw(GROUPS["own"][world], count, seed, first=count - 1)
        assert words in sf.Estimator().estimate(flight).reason
    jumping = sf.flows.LogFaults(jumps=3).spoil(fly(FLOW, seed=0, noise=(0.2, 0.05)), 0)
    found = sf.Estimator().estimate(jumping)
    assert found.status == "ok"
    assert found.goodness.whiteness < 1e-4 < 0.1 < found.position_wander
    assert found.length_scale == pytest.approx(FLOW.length_scale, rel=1e-3)


def test_causes_beside_which_something_wanders_are_not_believed():
    whole = flown(FLOW, rate=50.0, duration=20.0, seed=5, noise=(0.2, 0.05))
    slow, share = whole.velocity.copy(), 0.02 / (0.1 + 0.02)
    for row in range(1, len(slow)):  # a low-pass filter of 0.1 s, which is no latency
        slow[row] = slow[row - 1] + share * (whole.velocity[row] - slow[row - 1])
    found = sf.Estimator(free="auto").estimate(replace(whole, velocity=slow))
    assert found.status != "ok" or found.mean_velocity == pytest.approx(15.43, rel=0.02)


def test_two_things_that_are_wrong_are_answered_where_they_are_named():
    """Here positions that are too small explain as much as velocities that are too large."""
    whole = flown(FLOW, rate=50.0, duration=20.0, seed=5, noise=(0.2, 0.05))
    vehicle = sf.PointMassVehicle(0.9 * VEHICLE.response_time, VEHICLE.thrust_acceleration)
    flight = replace(whole, velocity=1.04 * whole.velocity, vehicle=vehicle)
    found = sf.Estimator(free="auto").estimate(flight)
    assert found.doubt == Doubt.IMPRECISE
    assert f"{', '.join(found.freed)} may stand for another cause: name what" in found.reason
    named = sf.Estimator(free=("response_time", "velocity_scale")).estimate(flight)
    assert named.status == "ok"
    assert named.mean_velocity == pytest.approx(15.43, abs=3 * named.uncertainty.mean_velocity)


def test_how_precise_an_answer_must_be_is_a_setting():
    flight = flown(FLOW, seed=7, noise=(0.3, 0.05))
    asked = {
        share: sf.Estimator(readout=sf.Readout(precision=share)).estimate(flight)
        for share in (1e-4, 0.03)
    }
    assert asked[0.03].status == "ok"
    assert (asked[1e-4].status, asked[1e-4].doubt) == ("unidentifiable", Doubt.IMPRECISE)
    assert "ask for less (readout precision)" in asked[1e-4].reason
    assert asked[1e-4].mean_velocity == asked[0.03].mean_velocity
    with pytest.raises(InputError, match="readout: precision must be"):
        sf.Readout(precision=-0.1)


@cache
def measured():
    """A flow that is `ok`, by its flight and the measurement."""
    prepared = sf.Estimator().prepare(flown(FLOW, seed=7, noise=(0.3, 0.05)))
    return prepared, measure_flow(prepared, propose(prepared.search, Start()), (), shapes=True)


THRUST, TURN = Suspect("thrust", (0.1,), 0.0, 30.0, "thrust_scale"), Suspect("turn", (), 0.0, 30.0)
PULL = 0.5 * (1.0 / 3.28 - 1.0)  # of the response time and what the thrust (5, 3) lacks
FEET = Suspect("wind", (5.0 * PULL, 3.0 * PULL), 0.0, 30.0, "wind")
FREE = 'free it: free = ["thrust_scale"] (--free thrust_scale), or free = "auto"'
ODD = {"residual": 0.51, "r_squared": 0.91}


@pytest.mark.parametrize(
    ("inside", "outside", "words"),
    [
        ({"turbulence_share": 0.49}, {"turbulence_share": 0.51}, "any steady cells"),
        ({"whiteness": 2e-4}, {"whiteness": 5e-5}, "no cause explains it"),
        ({"residual": 0.49, "r_squared": 0.5}, ODD | {"r_squared": 0.89}, "or hardly steady"),
        (ODD, ODD | {"whiteness": 5e-4}, "or hardly steady"),
        ({"flights": (0.81, 0.99)}, {"flights": (0.81, 0.79)}, "may be another; leave it out"),
        ({"flights": (0.5, 0.79)}, {"detected": False}, "at 1000 to 1 against a false alarm"),
        ({"lower": 4.21 / 0.995}, {"lower": 4.21 / 0.985}, "widen the grid's bounds"),
        ({"upper": 4.21 / 1.005}, {"upper": 4.21 / 1.015}, "widen the grid's bounds"),
        ({}, {"suspects": (TURN, THRUST)}, "more than noise is left: the cells seem turned"),
        ({}, {"suspects": (THRUST, TURN)}, f"more than it is believed; {FREE}"),
        ({}, {"suspects": (FEET,)}, "; the thrust may be in feet/s^2"),
    ],
)
def test_a_flow_is_judged_by_each_of_its_numbers(inside, outside, words):
    def reasons(changes):
        def of(record):
            own = {key: changes[key] for key in changes if key in record.__dataclass_fields__}
            return replace(record, **own)

        changes = {"whiteness": 0.5, **changes}
        if "flights" in changes:
            changes["flights"] = tuple(Goodness(own, 0.5) for own in changes["flights"])
        prepared, result = measured()
        library = replace(prepared.library, grid=of(prepared.library.grid))
        changes |= {"goodness": of(result.goodness), "proposal": of(result.proposal)}
        known = replace(prepared, library=library), of(result), result.scales([4.2])
        return {own.reason for own in doubts_of_flow(*known, 0.03, ())}

    assert not reasons(inside)
    (reason,) = reasons(outside)
    assert reason.endswith(words)


def test_a_track_is_as_long_as_it_is_through_cells_that_drift():
    prepared, _ = measured()
    own = prepared.parts[0]
    drift = np.ptp(own.position, axis=0) / np.ptp(own.time) * [1.0, 0.0]
    model = SimpleNamespace(pattern=SimpleNamespace(drift=drift))
    carried = SimpleNamespace(posterior=SimpleNamespace(model=model))
    library = replace(prepared.library, grid=replace(prepared.library.grid, lower=1e3, upper=1.1e3))
    verdict = next(doubts_of_flow(replace(prepared, library=library), carried, [], 0.03, ()))
    extent = np.ptp(own.position - own.time[:, None] * drift, axis=0).max()
    assert (verdict.doubt, f"covers {extent:.2g} m" in verdict.reason) == (Doubt.SHORT_TRACK, True)


class Growing:
    """Cells whose mean velocity grows by 1 % in a second."""

    period = 8.0

    def velocity(self, x, y, t):
        u, v = sf.CellularFlow(8.0, 4.0).velocity(x, y)
        return (1.0 + 0.01 * (t - 7.5)) * u, (1.0 + 0.01 * (t - 7.5)) * v


def test_a_mean_velocity_that_grows_is_a_misfit_with_its_rate():
    vehicle = sf.PointMassVehicle(0.4, (5.0, 3.0))
    flight = fly(Growing(), vehicle, duration=15.0, rate=40.0, noise=(0.2, 0.05))
    estimate = sf.Estimator().estimate(flight)
    assert (estimate.status, estimate.goodness.suspect.cause) == ("misfit", "decay")
    low, high = estimate.constancy.interval
    assert 0.0 < low < 0.08 < high


def test_a_lag_is_as_sure_as_its_first_order():
    """Of one of 33 ms in a response time of 125 ms the second order is 38 % of the first."""
    ((flight, truth),) = draw(GROUPS["vehicle"][13], 2, 61001, first=1)
    estimate = sf.Estimator(free="auto").estimate(flight)
    assert estimate.freed == ("lag",)
    assert estimate.causes["lag"] == pytest.approx(0.033, rel=0.1)
    low, high = estimate.uncertainty.mean_velocity_interval
    assert low < truth.mean_velocity < high
    assert high - low < 0.05 * truth.mean_velocity
