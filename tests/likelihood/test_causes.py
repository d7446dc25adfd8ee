"""Score tests of causes against their refits, and what is named where something is wrong."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import sparsefit as sf
from sparsefit.likelihood import diagnosis as room
from sparsefit.likelihood.causes import FREEDOMS, WIND, Suspect
from sparsefit.likelihood.diagnosis import diagnose, plausible
from sparsefit.likelihood.gains import gains_of
from sparsefit.likelihood.goodness import Constancy, _disturbances
from sparsefit.likelihood.model import Model, Process
from sparsefit.likelihood.pattern import StreamPattern
from sparsefit.likelihood.posterior import measure, whiteness
from sparsefit.likelihood.readings import FlightLog
from tests.problems import fly
from tests.worlds import GROUPS, draw

FLOW = sf.CellularFlow(10.0, 4.0)
TAU = 0.4


def flight_of(seed=3, tau=TAU, flow=FLOW):
    vehicle = sf.PointMassVehicle(tau, (5.0, 3.0))
    return fly(flow, vehicle, duration=12.0, rate=50.0, seed=seed, noise=(0.2, 0.05))


def posterior_of(flight, passes=15):
    k = np.pi / FLOW.length_scale * np.array([[1.0, 1.0], [1.0, -1.0]])
    height = FLOW.mean_velocity / (2 * np.pi / FLOW.length_scale)
    pattern = StreamPattern.of_waves("axis", k, [-height, height], [0.0, 0.0])
    log = FlightLog.of_flight(flight)
    return [log], measure([log], [Model(pattern, {"response_time": TAU})], passes=passes)


def test_the_score_of_a_cause_is_what_freeing_it_gains():
    logs, posterior = posterior_of(flight_of())
    for name, cause in FREEDOMS.items():
        if cause.wanders:
            continue
        names = cause.elements
        gain = gains_of(posterior, {name: names})[name, 0]
        freed = measure(logs, [posterior.model.free(*names)], posterior)
        gained = 2 * (freed.log_likelihood - posterior.log_likelihood)
        assert gain.gain == pytest.approx(gained, abs=0.4 + 0.1 * gained), name
        bare = np.sqrt(np.diag(np.linalg.inv(freed.information)))
        errors = [bare[freed.names.index(own)] for own in names]
        assert gain.error == pytest.approx(errors, rel=0.1), name
        before, after = posterior.model.pattern, freed.model.pattern
        for move, size in zip(gain.moves, ("mean_velocity", "length_scale"), strict=False):
            moved = getattr(after, size) / getattr(before, size) - 1
            assert move == pytest.approx(moved, rel=0.2, abs=1e-4), name


def test_sizes_that_cannot_be_are_no_causes():
    """Of a log of 12 s: a third to three times, a fifth of half of it, a change as large as all."""
    _, posterior = posterior_of(flight_of())
    speed = posterior.legs[0].log.speed
    for name, size in (
        *(("response_time", 3.0 * TAU), ("velocity_scale", 1.0 / 3.0), ("thrust_scale", 3.0)),
        *(("latency", -1.2), ("mass_rate", -1.0 / 12.0), ("growth", 1.0 / 6.0), ("wind_x", -speed)),
        *(("wind_growth_y", speed / 6.0), ("lag", -TAU), ("quadratic_drag", -1.0 / speed)),
    ):
        outward = 0.03 if name != "velocity_scale" else -0.03
        for share in (1.0 - outward, 1.0 + outward):
            model = posterior.model.at({name: share * size})
            legs = (replace(posterior.legs[0], model=model),)
            there = plausible(replace(posterior, legs=legs), posterior)
            assert there == (share == 1.0 - outward), name
    model = posterior.model.free("response_time").at({"response_time": -TAU})
    free = replace(posterior, legs=(replace(posterior.legs[0], model=model),))
    assert plausible(free, free)  # what was free from the start has the size that it has


@pytest.mark.parametrize(
    ("ratio", "words"),
    [
        *((3.28, "; position and velocity may both be in feet"), (9.8, "; the thrust may be in g")),
        *((1 / 3.28, "; the thrust may be in feet/s^2"), (3.0, ""), (1.0, "")),
    ],
)
def test_a_thrust_off_by_the_ratio_of_two_units_is_told_or_a_wind_of_that_pull(ratio, words):
    tau, thrust = 0.5, 3.0 - 4.0j
    wind = (ratio - 1.0) * tau * thrust  # whose pull makes up for what the thrust lacks

    def unit(name, *size, thrust=thrust):
        return Suspect(name, size, 0.0, 0.0, name).unit(tau, thrust)

    assert unit("thrust_scale", ratio - 1.0) == unit("wind", wind.real, wind.imag) == words
    assert unit("wind", -wind.imag, wind.real) == unit("lag", ratio - 1.0) == ""
    assert unit("wind", wind.real, wind.imag, thrust=0j) == ""


def test_nothing_is_named_where_nothing_is_wrong():
    logs, posterior = posterior_of(flight_of(seed=5))
    diagnosis = diagnose(logs, posterior)
    assert not diagnosis.suspects
    assert diagnosis.posterior is posterior
    rate, error = diagnosis.growth
    assert abs(rate) < 4 * error
    for name in ("turbulence", "wander", "swell"):
        assert room.scanned(posterior, room.process_of(name, posterior))[0] < 4.0


def test_an_answer_is_at_its_maximum_though_a_search_was_left_before():
    """Turbulence of 30 % may take more passes: intervals were of no maximum then."""
    logs, before = posterior_of(flight_of(seed=5), passes=2)
    assert not before.converged
    assert diagnose(logs, before).posterior.converged


def scaled(flight, position=1.0, velocity=1.0, angle=0.0, bias=0.0):
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    velocity = velocity * flight.velocity @ turn + bias
    return replace(flight, position=position * flight.position, velocity=velocity)


@pytest.mark.parametrize(
    ("flight", "cause", "size"),
    [
        (lambda: flight_of(tau=1.05 * TAU), "response-time", (0.05 * TAU,)),
        (lambda: scaled(flight_of(), velocity=1.04), "velocity-scale", (0.04,)),
        (lambda: scaled(flight_of(), angle=0.03), "rotation", (0.03,)),
        (lambda: scaled(flight_of(), bias=0.2), "velocity-bias", (0.2, 0.2)),
    ],
)
def test_what_is_wrong_is_named_with_its_size(flight, cause, size):
    logs, posterior = posterior_of(flight())
    diagnosis = diagnose(logs, posterior)
    assert diagnosis.suspects[0].cause == cause
    assert diagnosis.suspects[0].size == pytest.approx(size, rel=0.1)
    assert diagnosis.suspects[0].p_value < 1e-4
    gain = 2.0 * (diagnosis.posterior.log_likelihood - posterior.log_likelihood)
    assert sum(own.share for own in diagnosis.suspects) == pytest.approx(gain)
    pattern = diagnosis.posterior.model.pattern
    assert pattern.mean_velocity == pytest.approx(10.0, rel=1e-3)


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({}, True),
        ({"evidence": 1.9, "whiteness": (0.5, 9e-4)}, True),
        ({"seen": 0.0, "constancy": (9e-5, 1, 3.0)}, True),
        *(({n: v}, False) for n, v in (("exact", 1), ("pushed", 1), ("seen", 1), ("evidence", 2))),
    ],
)
def test_process_noise_is_believed_where_a_level_is_seen_and_more_than_chance(changes, expected):
    own = {"exact": 0, "pushed": 0, "seen": 1.1, "evidence": 3, "whiteness": [1], "constancy": [1]}
    assert room.disturbed(SimpleNamespace(**(own | changes))) is expected


@pytest.mark.parametrize(
    ("shape", "velocity", "freer"),
    [
        ("axis", None, {"turn", "drift"}),
        ("pair", None, {"drift"}),
        ("square", (0.1, 0.0), {"turn"}),
        ("several", None, set()),
    ],
)
def test_shapes_of_two_waves_may_turn_and_drift(shape, velocity, freer):
    k = np.array([[1.0, 1.0], [1.0, -1.0]])
    model = Model(StreamPattern.of_waves(shape, k, [1.0, -1.0], [0.0, 0.0], velocity), {})
    groups = room.groups_of(model, {"wind"})
    assert set(groups) & {"turn", "drift", "wind"} == freer


def test_white_innovations_are_white_and_coloured_ones_are_not():
    rng = np.random.default_rng(4)
    chances = [whiteness(rng.normal(size=(300, 4))) for _ in range(200)]
    assert 0.5 < np.mean(np.array(chances) < 0.5) * 2 < 1.5
    assert whiteness(np.convolve(rng.normal(size=2000), np.ones(5), "same")[:, None]) < 1e-6
    assert whiteness(np.where(rng.random((300, 4)) < 0.3, np.nan, rng.normal(size=(300, 4)))) > 1e-3
    assert np.isnan(whiteness(np.full((50, 2), np.nan)))


def pattern_of(shape="axis", speed=9.0, scale=4.0, drift=None):
    waves = np.pi / scale * np.array([[1.0, 1.0], [1.0, -1.0]])
    height = 0.5 * speed * scale / np.pi * np.ones(2)
    return StreamPattern.of_waves(shape, waves, height, 0.0 * height, drift)


@pytest.mark.parametrize(
    ("shape", "group", "shapes", "causes"),
    [
        ("axis", "turn", ["square", "rectangle", "pair"], ["turn", "stretch", "stretch"]),
        ("rectangle", "turn", ["pair"], ["stretch"]),
        ("square", "drift", ["square"], ["drift"]),
    ],
)
def test_freer_shapes_are_those_after_a_shape_or_itself_adrift(shape, group, shapes, causes):
    pattern = pattern_of(shape)
    trials = room.freer([Model(pattern, {})], group, answers=False)
    assert [trial.cause.name for trial in trials] == causes
    there = [trial.models[0].pattern for trial in trials]
    assert [own.shape for own in there] == shapes
    assert [own.drifting for own in there] == [group == "drift"] * len(shapes)
    assert [own.freedom for own in trials] == [
        len(own.values) - len(pattern.values) for own in there
    ]


@pytest.mark.parametrize(
    ("shape", "drift", "simpler"),
    [
        ("axis", (0.3, 0.1), [("axis", False)]),
        ("square", (0.3, 0.1), [("axis", False), ("square", False), ("axis", True)]),
        ("rectangle", None, [("axis", False), ("square", False)]),
    ],
)
@pytest.mark.parametrize("lost", [10.0, 1e3])  # by a shape, in one pass along the tracks
def test_simpler_shapes_that_are_near_are_fitted_first_where_they_stand(
    shape, drift, simpler, lost
):
    tried = []

    def refit(models, near, _least):
        tried.append((models[0].pattern.shape, models[0].pattern.drifting))

    model = Model(pattern_of(shape, drift=drift), {})
    posterior = SimpleNamespace(model=model, models=[model], log_likelihood=0.0)
    posterior.under = lambda _: SimpleNamespace(reached=-lost)
    posterior.bic, likelier, worse = 0.0, SimpleNamespace(bic=-1.0), SimpleNamespace(bic=1.0)
    assert room._simplest(refit, posterior) is posterior
    assert tried == (simpler if lost < room.LOST else [])
    for there, answer in ((likelier, likelier), (worse, posterior)):
        found = room._simplest(lambda *_, there=there: there, posterior)
        assert found is (answer if lost < room.LOST else posterior)


@pytest.mark.parametrize("likelier", [room.TUNED, 1.0 / room.TUNED])
def test_a_process_is_tuned_at_the_strength_that_it_has_at_high_frequencies(likelier):
    """2 r s^2 / (r^2 + omega^2) of a rate r and a level s: r s^2 stays, towards the likelier r."""
    walk, tried = Process("turbulence", ("wind_x", "wind_y"), 0.8, 0.25), []

    def under(models):
        ratio = models[0].processes[0].rate / 0.25 / likelier
        return SimpleNamespace(reached=-abs(np.log(ratio)))

    def refit(models, _near, _least):
        tried.extend(models[0].processes)

    other = Process("swell", ("gain",), 0.1, 0.1)
    model = Model(pattern_of(), {}, (walk, other))
    posterior = SimpleNamespace(models=[model], log_likelihood=0.0, under=under)
    assert room._tuned(refit, posterior, "turbulence") is posterior
    assert tried[1] == other
    assert tried[0].rate == pytest.approx(0.25 * likelier)
    assert tried[0].rate * tried[0].level ** 2 == pytest.approx(0.25 * 0.8**2)


def test_a_swell_of_several_flights_is_that_of_the_flight_where_it_is_largest():
    swells = [(Process("swell", ("gain",), own),) for own in (1e-9, 0.2)]
    models = tuple(Model(pattern_of(), {}, own) for own in swells)
    there = SimpleNamespace(models=models)
    suspect = room.Trial(models, 2, FREEDOMS["swell"], "swell").suspect(there, there, 0.0, 99.0)
    assert (suspect.size, suspect.flight) == ((0.2,), 2)
    assert "by 20 % rms" in suspect.words


@pytest.mark.parametrize(("kind", "off"), [(0, 1.0), *(pytest.param(*own, marks=pytest.mark.slow)
                         for own in ((1, 1.0), (2, 1.2), (3, 1.2)))])  # fmt: skip
def test_a_response_time_is_told_from_gusts_that_it_filters(kind, off):
    """A score at a constant variance of the innovations takes a fifth off a right one."""
    world = replace(GROUPS["turbulence10"][kind], body={"tau": off})
    ((flight, truth),) = draw(world, 1, 95004)
    estimator = sf.Estimator(readout=sf.Readout(precision=0.3))
    suspect = estimator.estimate(flight).goodness.suspect
    assert (suspect and suspect.cause) == ("response-time" if off > 1.0 else None)
    freed = replace(estimator, free=("response_time",)).estimate(flight)
    assert freed.status == "ok"
    assert freed.response_time == pytest.approx(off * flight.vehicle.response_time, rel=0.06)
    assert abs(freed.mean_velocity - truth.mean_velocity) < 3 * freed.uncertainty.mean_velocity


def test_gusts_are_as_isotropic_as_the_variance_in_their_weakest_direction():
    turned = math.sqrt(0.5) * np.array([[1.0, -1.0], [1.0, 1.0]])
    for share, mixing in ((0.04, turned @ np.diag([2.0, 0.4])), (1.0, turned)):
        gusts = Process("turbulence", WIND, 1.0, mixing=tuple(map(tuple, mixing)))
        assert gusts.isotropy == pytest.approx(share)
    assert Process("turbulence", WIND, 1.0).isotropy == 1.0


def test_a_search_that_leaves_the_proposed_flow_ends_there():
    logs, posterior = posterior_of(flight_of())
    seen = []

    def inside(pattern):
        seen.append(pattern)
        return False

    away = measure(logs, posterior.models, inside=inside)
    assert (away.reason, len(seen)) == ("the search leads to another flow", 1)
    assert measure(logs, posterior.models, inside=lambda pattern: True).converged


def test_what_is_ambiguous_is_worked_by_hand():
    """A lag of 0.02 s beside a response time of 0.12 s, at 8 m/s through cells of 4 m."""

    def flow(speed, scale, likelihood=0.0):
        values = {"lag": 0.02, "response_time": 0.12}
        model = Model(pattern_of("axis", speed, scale), {})
        legs = [SimpleNamespace(log=SimpleNamespace(speed=8.0))]
        likely = {"log_likelihood": likelihood, "evidence": 5.0}
        return SimpleNamespace(model=model, legs=legs, value=values.get, **likely)

    share = 0.02 * (10.0 + np.pi)
    own = flow(10.0, 4.0)
    assert room._ambiguity(own, flow(9.0, 4.4), ()) == pytest.approx((0.1 * share, 0.1 * share))
    rivals = [(own, flow(10.5, 3.8, -4.0), False), (own, flow(20.0, 8.0, -6.0), False)]
    assert room._ambiguity(own, flow(9.0, 4.2), rivals) == pytest.approx((0.05, 0.05))
    rivals += [(own, flow(9.2, 4.8, -99.0), True)]  # what was found beside a cause, however likely
    assert room._ambiguity(own, flow(9.0, 4.2), rivals) == pytest.approx((0.08, 0.2))


def test_disturbances_are_those_within_the_band_of_the_flow():
    """Gusts: the variance about the mean of a walk, summed over pairs of times; kicks by hand."""
    air = (Process("turbulence", ("wind_x", "wind_y"), 0.8, 0.25),)
    model = Model(pattern_of(speed=8.0), {"response_time": 0.3, "acceleration": 2.0}, air)
    time = np.linspace(0.0, 10.0, 801)
    gusts, kicks = _disturbances(SimpleNamespace(model=model, time=time))
    about = 1.0 - np.mean(np.exp(-0.25 * np.abs(time[:, None] - time)))
    assert gusts == pytest.approx(0.64 * about, rel=0.01)
    assert kicks == pytest.approx((2.0 * 0.3) ** 2 / (2.0 * 0.5))


def test_constancy_is_the_rate_of_growth_in_its_unit():
    constancy = Constancy.of(0.01, 0.005, 10.0)
    assert constancy.rate == pytest.approx(0.1)
    assert constancy.interval == pytest.approx((0.1 - 0.098, 0.1 + 0.098), abs=1e-3)
    assert constancy.p_value == pytest.approx(0.0455, abs=1e-4)  # of two standard errors
    assert Constancy.of(0.0, 0.0, 10.0) is None


def test_a_flow_is_as_sure_as_a_second_cause_leaves_it():
    logs, posterior = posterior_of(scaled(flight_of(tau=1.1 * TAU), velocity=1.04))
    diagnosis = diagnose(logs, posterior)
    assert len(diagnosis.suspects) == 2
    shifts = []
    for suspect in diagnosis.suspects:
        alone = measure(logs, [posterior.model.free(*FREEDOMS[suspect.free].elements)], posterior)
        speeds = [own.model.pattern.mean_velocity for own in (alone, diagnosis.posterior)]
        shifts.append(abs(speeds[0] / speeds[1] - 1.0))
    assert diagnosis.ambiguity[0] == pytest.approx(max(shifts), rel=0.02)
    assert max(shifts) > 0.01
