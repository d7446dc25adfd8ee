"""The iterated smoother: the maximum of the likelihood, found from a start, by independent ways."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from sparsefit.errors import InputError
from sparsefit.likelihood import reference
from sparsefit.likelihood import smoother as room
from sparsefit.likelihood.diagnosis import _varied
from sparsefit.likelihood.model import LEVELS, Model, Process
from sparsefit.likelihood.pattern import StreamPattern
from sparsefit.likelihood.posterior import Posterior, bound, measure
from sparsefit.likelihood.readings import FlightLog
from sparsefit.likelihood.smoother import LevelSteps, Step, _bounded, climbed, inverted
from sparsefit.likelihood.trellis import Leg, longest_step

TRUE = StreamPattern("axis", (9.0, 4.0, 0.7, -1.2))
THRUST = (5.0, 3.0)
TAU = 0.3


def motion_of(pattern):
    """The motion through a pattern: the slopes of x, y, v_x, v_y."""
    kx, ky, a, b, omega = pattern.waves.T

    def motion(t, s):
        phase = kx * s[0] + ky * s[1] - omega * t
        slope = b * np.cos(phase) - a * np.sin(phase)
        flow = np.array([np.sum(ky * slope), -np.sum(kx * slope)])
        return np.concatenate([s[2:], (flow - s[2:]) / TAU + THRUST])

    return motion


def flown(seed, count=400, rate=25.0, noise=(0.05, 0.2), pattern=TRUE, place=(0.3, -0.8)):
    """A flight without process noise through a pattern, and its log."""
    time = np.arange(count) / rate
    flight = solve_ivp(
        motion_of(pattern), (0, time[-1]), [*place, 2.0, 1.0], "DOP853", time, rtol=1e-10
    )
    states = flight.y.T
    rng = np.random.default_rng(seed)
    readings = states + rng.normal(size=states.shape) * np.repeat(noise, 2)
    return FlightLog(time, readings[:, :2], readings[:, 2:], THRUST), states


def noisy(tau, kicks=0.0, position=0.05, velocity=0.2):
    """Values of a model: the response time and the levels of white noise."""
    return {"response_time": tau, **dict(zip(LEVELS, (kicks, position, velocity), strict=True))}


def nearby(pattern=TRUE, share=0.004):
    values = np.array(pattern.values) * (1 + share * np.cos(np.arange(len(pattern.values)) * 2.0))
    return StreamPattern(pattern.shape, tuple(values), pattern.drifting)


def measured(logs, model):
    return measure(logs, [model] * len(logs), passes=30, rough=False)


def halves(kicks, step, f, pace):
    """The variances of the kicks before and after a step, the first half's excess taken off."""
    excess = np.zeros(len(kicks))
    excess[:2] = step / 6.0 * f[range(2), range(2, 4)] ** 2 * kicks[2:4]
    return [0.5 * step * pace * kicks, 0.5 * step * pace * kicks - excess]


def test_the_level_of_process_noise_is_told_from_a_log_without_any_other():
    """A motion of white noise, drawn from its exact covariance: 4,000 numbers tell q to 1.1 %."""
    rng, step, count = np.random.default_rng(5), 0.01, 1000
    covariance = np.array([[step**3 / 3.0, step**2 / 2.0], [step**2 / 2.0, step]])
    kicks = rng.normal(size=(2, count, 2)) @ np.linalg.cholesky(covariance).T
    states = np.zeros((count + 1, 4))
    for i in range(count):
        x, v = states[i, :2], states[i, 2:]
        states[i + 1] = *(x + step * v + kicks[:, i, 0]), *(v + kicks[:, i, 1])
    log = FlightLog(step * np.arange(count + 1), states[:, :2], states[:, 2:], (0.0, 0.0))
    still = StreamPattern("several", (1.0, 0.5, 0.0, 0.0))
    model = Model(still, noisy(1e6, 0.5, 1e-9, 1e-7))
    posterior = measured([log], model)
    assert posterior.value("acceleration") == pytest.approx(1.0, rel=0.04)
    free = len(posterior.names) + len(LEVELS)
    assert posterior.bic == pytest.approx(free * np.log(4004) - 2.0 * posterior.log_likelihood)


def test_a_smooth_of_the_linear_case_is_the_dense_gaussian():
    """Without waves the motion is linear: delta, score and information of one covariance matrix."""
    log, _ = flown(1, count=12)
    pattern = StreamPattern("several", (0.01, 0.005, 0.0, 0.0)).about(log.origin)
    turbulence = Process("turbulence", ("wind_x", "wind_y"), 0.7, 1.5)
    model = Model(pattern, noisy(TAU, 0.8), (turbulence,))
    model = model.free("wind_x", "thrust_scale")
    names = ("thrust_scale", "wind_x")
    leg, spread = Leg.of(log, model), np.array([1.0, 2.0, 3.0, 4.0])
    assert leg.time.tolist() == (log.time - log.origin[2]).tolist()
    leg, track = replace(leg, log=SimpleNamespace(spread=spread)), leg.track
    space = model.space(names, track)
    forward = leg.forward(names)
    m, n = track.shape
    following, matrices, slopes = reference.transitions(space, leg.time, leg.push, track)
    # every state as a linear map of the first state, of all kicks and of theta
    size = n + 2 * n * (m - 1)
    maps, offset, by_theta = [np.zeros((n, size))], [np.zeros(n)], [np.zeros((n, 2))]
    maps[0][:, :n] = np.eye(n)
    offset[0][4:] = -track[0, 4:]
    variances = [np.concatenate([spread, space.spread.sum(axis=0)[4:]])]
    for i in range(m - 1):
        step = leg.time[i + 1] - leg.time[i]
        f = matrices[i]
        before = maps[-1].copy()
        before[:, n + 2 * n * i : n + 2 * n * i + n] += np.eye(n)
        after = f @ before
        after[:, 2 * n + 2 * n * i : 2 * n + 2 * n * i + n] += np.eye(n)
        maps.append(after)
        offset.append(f @ offset[-1] + following[i] - track[i + 1])
        by_theta.append(f @ by_theta[-1] + slopes[i])
        variances += halves(space.kicks.sum(axis=0), step, f, space.pace[i, :n])
    prior = np.diag(np.concatenate(variances))
    h = np.vstack([each[:4] for each in maps])
    noise = np.tile(space.noise.sum(axis=0), m)
    covariance = h @ prior @ h.T + np.diag(noise)
    error = (leg.measured - track[:, :4]).ravel() - np.concatenate([each[:4] for each in offset])
    design = np.vstack([each[:4] for each in by_theta])
    solved = np.linalg.solve(covariance, np.column_stack([error, design]))
    value = -0.5 * (error @ solved[:, 0] + np.linalg.slogdet(2 * np.pi * covariance)[1])
    assert forward.value == pytest.approx(value, rel=1e-10)
    np.testing.assert_allclose(forward.score, design.T @ solved[:, 0], rtol=1e-8)
    np.testing.assert_allclose(forward.information, design.T @ solved[:, 1:], rtol=1e-8)
    change = np.linalg.solve(forward.information, forward.score)
    weights = np.linalg.solve(covariance, error - design @ change)
    given = [
        o + t @ change + x @ prior @ h.T @ weights
        for o, t, x in zip(offset, by_theta, maps, strict=True)
    ]
    smoothed = forward.backward(change)
    np.testing.assert_allclose(smoothed.track, track + given, rtol=1e-8, atol=1e-10)
    (moved,) = Step.of([replace(leg, model=replace(model, fixed=pattern.names))]).moved((smoothed,))
    np.testing.assert_allclose(moved.track, smoothed.track)
    # the derivative of log L by the logarithm of each variance, and the average information
    columns = [design]
    for level, name in enumerate(model.levels):
        kicked = [np.concatenate([np.zeros(4), space.spread[level, 4:]])]
        steps = zip(np.diff(leg.time), matrices, space.pace[:-1, :n], strict=True)
        kicked += [half for step in steps for half in halves(space.kicks[level], *step)]
        slope = h @ np.diag(np.concatenate(kicked)) @ h.T + np.diag(np.tile(space.noise[level], m))
        expected = 0.5 * np.trace(np.linalg.solve(covariance, slope))
        squares = 0.5 * weights @ slope @ weights, expected
        np.testing.assert_allclose(smoothed.squares[level], squares, rtol=1e-8, err_msg=name)
        columns.append((slope @ weights)[:, None])
    both = np.hstack(columns)
    again = replace(leg, last=smoothed).forward(names)
    expected = both.T @ np.linalg.solve(covariance, both)
    np.testing.assert_allclose(again.information, expected, rtol=1e-7, atol=1e-9)


def test_gusts_change_with_the_way_through_them_and_other_processes_with_time():
    gusts = Process("turbulence", ("wind_x", "wind_y"), 3.0, 1.5, (0.5, 1.0, 1.5))
    swell = Process("swell", ("gain",), 0.1, 0.5)
    pattern = StreamPattern("axis", (5.0, 4.0, 0.3, 0.7, 1.0, 0.0), drifting=True)
    model = Model(pattern, {"response_time": TAU}, (gusts, swell))
    track = np.zeros((3, 7))
    track[:, 2] = 1.0, 9.0, 1.0  # beside the drift 0, 8 and 0, in both steps 4 on average
    pace = model.space((), track).pace
    expected = np.array([5.0, 5.0, 3.0]) / np.sqrt(59.0 / 3.0)
    np.testing.assert_allclose(pace[:, 7:9], expected[:, None].repeat(2, axis=1))
    np.testing.assert_allclose(pace[:, 4:6], pace[:, 7:9] * [[0.5], [1.0], [1.5]])
    assert (pace[:, [0, 1, 2, 3, 6, 9]] == 1.0).all()
    walk = replace(swell, rate=0.0)  # which starts from nothing
    spaces = [replace(model, processes=(own,)).space() for own in (swell, walk)]
    assert [(own.spread[3, 4], own.kicks[3, 4]) for own in spaces] == [
        (0.1**2, 0.1**2),
        (0.0, 0.1**2),
    ]


def test_without_process_noise_it_is_the_least_squares_fit_of_the_trajectory():
    """Independently: shooting from the first state, least squares over it and the parameters."""
    from scipy.optimize import least_squares

    log, states = flown(3, count=100)
    posterior = measured([log], Model(nearby(), {"response_time": TAU}))
    assert posterior.converged, posterior.reason
    size = np.repeat([posterior.value(f"{name}_noise") for name in ("position", "velocity")], 2)

    def misfit(p):
        motion, time = motion_of(StreamPattern("axis", tuple(p[4:]))), log.time
        path = solve_ivp(motion, (0, time[-1]), p[:4], "DOP853", time, rtol=1e-10).y.T
        return ((path - np.hstack([log.position, log.velocity])) / size).ravel()

    fit = least_squares(misfit, [*states[0], *TRUE.values], x_scale="jac", xtol=1e-12)
    errors = np.sqrt(np.diag(np.linalg.inv(fit.jac.T @ fit.jac)))[4:6]
    bare = np.sqrt(np.diag(np.linalg.inv(posterior.information)))
    for place, name in enumerate(("mean_velocity", "length_scale")):
        assert bare[posterior.names.index(name)] == pytest.approx(errors[place], rel=0.02)
        away = posterior.value(name) - fit.x[4 + place]
        assert abs(away) < 0.03 * errors[place]


def test_levels_are_at_the_maximum():
    log, _ = flown(4, count=300)
    model = Model(nearby(), noisy(TAU, 0.1, 0.06, 0.17))
    posterior = measured([log], model)
    levels = posterior.model.levels
    assert levels["position_noise"] == pytest.approx(0.05, rel=0.1)
    assert levels["velocity_noise"] == pytest.approx(0.2, rel=0.1)
    for name in ("position_noise", "velocity_noise"):
        for factor in (0.97, 1.03):
            assert posterior.at_level(np.log(factor), name)[0] < posterior.log_likelihood
    # Of the logarithm of a variance, 600 readings hold 600/2, less those of the unknowns.
    assert np.diag(Step.of(posterior.legs).levels[0])[1:] == pytest.approx([300.0] * 2, abs=6.0)


@pytest.mark.parametrize(
    ("position", "kicks", "exact"), [(0.99, 0.99, True), (1.01, 0.5, False), (0.5, 1.01, False)]
)
def test_a_log_is_exact_below_3e_6_of_the_length_and_1e_4_of_the_pull(position, kicks, exact):
    pull = TRUE.mean_velocity * (1 + 0.05 * TRUE.mean_velocity) / TAU
    bound = 1e-4 * pull * np.sqrt(TRUE.length_scale / TRUE.mean_velocity)
    noise = kicks * bound, position * 3e-6 * TRUE.length_scale, 0.1
    model = Model(TRUE, noisy(TAU, *noise) | {"quadratic_drag": 0.05})
    own = SimpleNamespace(legs=(SimpleNamespace(model=model),), model=model)
    assert Posterior.exact_logs.fget(own) == (exact,)


@pytest.mark.parametrize(
    ("score", "step"),
    [((0.8, 0.1), (0.5, -0.2)), ((9.0, 0.0), (2.0, -0.9)), ((0.0, -4.5), (0.45, -0.9))],
)
def test_a_step_of_levels_is_that_of_the_quadratic_in_its_bounds(score, step):
    information = np.array([[2.0, 1.0], [1.0, 2.0]])
    bounded = _bounded(information, np.array(score), np.array([-0.9, -0.9]))
    np.testing.assert_allclose(bounded, step, rtol=1e-8)


def test_a_level_falls_to_its_floor_and_no_further():
    squares, levels = np.array([[1e-9, 50.0], [50.0, 50.0], [50.0, 50.0]]), [0.1, 0.05, 0.2]
    change, _ = LevelSteps(0.8 * np.array(levels), 0).change(levels, squares, np.zeros((0, 0)))
    np.testing.assert_allclose(change, [2.0 * np.log(0.8), 0.0, 0.0], atol=1e-12)


def test_far_from_the_optimum_levels_take_the_steps_of_a_secant():
    """The logarithm of a / n of process noise falls by 0.6 over 0.8, and is 0.2 by then."""
    steps, nothing = LevelSteps(np.full(3, 1e-9), 5), np.zeros((0, 0))
    for level, ratio, step in ((0.1, 0.8, 2.0), (0.1 * np.exp(0.4), 0.2, 0.2 * 0.8 / 0.6)):
        squares = np.array([[50.0 * np.exp(ratio), 50.0], [50.0, 50.0], [50.0, 50.0]])
        change, gain = steps.change([level, 0.05, 0.2], squares, nothing)
        np.testing.assert_allclose(change, [step, 0.0, 0.0], atol=1e-12)
        assert np.isinf(gain)


def test_near_the_optimum_levels_take_newtons_steps_and_tell_their_gain():
    """Scores of 5, -3 and 0 with informations of 50, 60 and 70, in logarithms of the variances."""
    squares, steps = np.array([[55.0, 50], [47, 50], [50, 50]]), LevelSteps(np.full(3, 1e-9), 0)
    for information in (np.zeros((0, 0)), np.diag([50.0, 60.0, 70.0])):
        change, gain = steps.change([0.1, 0.05, 0.2], squares, information)
    np.testing.assert_allclose(change, np.log1p([0.1, -0.05, 0.0]), rtol=1e-8)
    assert gain == pytest.approx(0.5 + 0.15)


@pytest.mark.parametrize(
    ("speed", "tau", "interval", "steps"),
    [(10.0, 0.3, 0.1, [1.0, 1.0, 1.5, 2.0]), (0.1, 0.3, 0.1, [4.71]), (0.1, 0.3, 0.4, [14.14])],
)
def test_a_step_is_a_quarter_radian_or_more_as_noise_hides(speed, tau, interval, steps):
    for step, radians in zip(steps, (0.0, 0.25, 0.375, 0.55), strict=False):  # fine, then rough
        log = SimpleNamespace(speed=speed / np.sqrt(2.0), interval=interval)
        log.noise = 0.0, log.speed * (radians / 2.0) ** 4
        reached = longest_step(log, Model(TRUE, {"response_time": tau}), radians > 0.0)
        assert reached == pytest.approx(step * 0.1 / np.pi, rel=2e-3)


@pytest.mark.parametrize(("length", "unseen"), [(3.0, [0, 1, 2]), (8.0, [1, 2])])
def test_what_is_unknown_has_a_fifth_of_a_direction_without_information(length, unseen):
    """Three columns in a plane that add up to nothing with the weights 1, length, length."""
    away = np.sqrt(1.0 - 0.25 / length**2)
    columns = np.array([[1.0, 0.0], [-0.5 / length, away], [-0.5 / length, -away]])
    size = np.array([1.0, 1e3, 1e-3])
    inverse, named = inverted(np.outer(size, size) * (columns @ columns.T))
    assert named.tolist() == unseen
    expected = np.linalg.pinv(columns @ columns.T) / np.outer(size, size)
    np.testing.assert_allclose(inverse, expected, rtol=1e-9)
    assert np.isnan(inverted(np.full((2, 2), np.inf))[0]).all()


def test_parameters_that_a_log_cannot_tell_apart_are_named():
    log, _ = flown(5)
    model = Model(nearby(), {"response_time": TAU}).free("wind_x", "thrust_bias_x")
    posterior = measured([log], model)
    assert not posterior.converged
    assert posterior.reason == "the log cannot tell thrust_bias_x from wind_x"
    with pytest.raises(InputError, match='did you mean "wind_x"'):
        model.free("windx")


@pytest.mark.parametrize("case", ["gaps", "positions", "velocities missing", "uneven", "outliers"])
def test_logs_with_faults_are_measured(case):
    log, _ = flown(6, count=500)
    time, places, speeds = log.time.copy(), log.position.copy(), log.velocity.copy()
    rng = np.random.default_rng(1)
    rows = np.ones(len(time), dtype=bool)
    if case == "gaps":
        rows[100:120] = rows[300:330] = False
    elif case == "positions":
        speeds[:] = np.nan
    elif case == "velocities missing":
        speeds[rng.uniform(size=len(time)) < 0.5] = np.nan
    elif case == "uneven":
        rows = rng.uniform(size=len(time)) < 0.6
    else:
        hit = rng.uniform(size=len(time)) < 0.02
        speeds[hit] += 5.0 * rng.choice([-1, 1], size=(hit.sum(), 2))
    faulty = FlightLog(time[rows], places[rows], speeds[rows], THRUST)
    posterior = measured([faulty], Model(nearby(), {"response_time": TAU}))
    assert posterior.converged, posterior.reason
    for name in ("mean_velocity", "length_scale"):
        true = dict(zip(TRUE.names, TRUE.values, strict=True))[name]
        assert abs(posterior.value(name) - true) < 4.0 * posterior.error(name)
        assert posterior.error(name) < 1e-3 * true
    leg = posterior.legs[0]
    outliers = np.count_nonzero(leg.seen & (leg.weights == 0.0))
    assert (outliers > 5) == (case == "outliers")


def test_the_bound_is_the_covariance_at_the_truth():
    log, states = flown(8)
    posterior = measured([log], Model(TRUE, {"response_time": TAU}))
    true = Model(TRUE, posterior.model.own)
    at_truth, bare = bound([log], [true], [states]), np.linalg.inv(posterior.information)
    np.testing.assert_allclose(np.diag(bare), np.diag(at_truth), rtol=0.01)
    blind = true.free("wind_x", "thrust_bias_x")
    with pytest.raises(InputError, match="does not see all of thrust_bias_x, wind_x"):
        bound([log], [blind], [states])


def test_flights_share_the_flow_and_have_vehicles_of_their_own():
    logs = [flown(9)[0], flown(10, place=(2.0, 1.0))[0]]
    model = Model(nearby(), {"response_time": TAU}).free("response_time")
    alone = [measured([log], model) for log in logs]
    both = measured(logs, model)
    assert both.converged, both.reason
    assert both.names == (*model.names, "response_time@2")
    assert both.models[0].pattern == both.models[1].pattern
    for place, name in enumerate(("mean_velocity", "length_scale")):
        assert both.error(name) < min(each.error(name) for each in alone)
        assert abs(both.value(name) - TRUE.values[place]) < 4.0 * both.error(name)


VEHICLE = {"response_time": TAU, "wind_x": 0.0, "thrust_scale": 1.0, "thrust_rotation": 0.0}


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *(("response_time", 0.33), ("wind_x", 0.5), ("thrust_scale", 1.1)),
        *(("position_scale", 0.96), ("latency", 0.06), ("latency", 0.04)),
        ("thrust_rotation", 0.1),
    ],
)
def test_a_parameter_that_is_free_is_measured(name, value):
    """The log of a vehicle or an instrument that is as believed, believed to be otherwise."""
    log, _ = flown(11, count=500)
    places, speeds, time = log.position, log.velocity, log.time
    model = Model(nearby(), {"response_time": TAU}).free(name)
    if name in VEHICLE:
        model, value = model.at({name: value}), VEHICLE[name]
    elif name == "position_scale":
        places = places * value
        model = model.at({"length_scale": model.pattern.length_scale * value})  # as it is seen
    else:
        late = round(value * 25)
        value = late / 25
        places, speeds, time = places[:-late], speeds[late:], time[late:]
    posterior = measured([FlightLog(time, places, speeds, THRUST)], model)
    assert posterior.converged, posterior.reason
    assert abs(posterior.value(name) - value) < 4.0 * posterior.error(name)
    assert posterior.error(name) < 0.02
    away = posterior.value("length_scale") - 4.0
    assert abs(away) < 4.0 * posterior.error("length_scale")


def test_a_log_that_no_number_describes_is_an_answer_with_a_reason():
    log, _ = flown(13, count=60)
    wild = FlightLog(log.time, 1e170 * log.position, log.velocity, THRUST)
    posterior = measured([wild], Model(nearby(), {"response_time": TAU}))
    assert not posterior.converged
    assert "cannot be raised" in posterior.reason


def test_weak_process_noise_is_found_above_nothing_and_integrated_out():
    """The level falls to 0 first; errors allow for as much of it as the log does not exclude."""
    log, states = flown(14)
    kicks = 0.05 * np.random.default_rng(3).normal(size=(len(states), 2))
    wander = np.cumsum(np.cumsum(kicks, axis=0), axis=0) * 0.04**1.5
    noisy = FlightLog(log.time, log.position + wander, log.velocity, THRUST)
    model = Model(nearby(), {"response_time": TAU})
    still, moved = (measured([each], model) for each in (log, noisy))
    assert still.value("acceleration") < moved.value("acceleration")
    assert still.evidence == 0.0 < 1e4 < moved.evidence
    for posterior in (still, moved):
        bare = np.sqrt(np.linalg.inv(posterior.information)[0, 0])
        assert bare < posterior.error("mean_velocity") < 4.0 * bare
        assert abs(posterior.value("mean_velocity") - 9.0) < 4.0 * posterior.error("mean_velocity")
        lost = replace(posterior, reason="it did not end")  # levels are integrated at an optimum
        np.testing.assert_allclose(lost.covariance, np.linalg.inv(lost.information), rtol=1e-6)


@pytest.mark.parametrize(("bend", "rel"), [(3.0, 0.02), (5.0, 1e-9)])
def test_the_spread_of_a_level_adds_its_part_to_the_covariance(bend, rel):
    """Of a normal likelihood of the level's logarithm; a quadratic in it is averaged."""

    def rung(height, _name, _place):
        return -0.5 * bend * height**2, np.array([[0.4 + 0.7 * height**2]])

    model = Model(TRUE, {"response_time": TAU})
    leg = SimpleNamespace(model=model, last=SimpleNamespace(squares=np.full((3, 2), 10.0)))
    own = SimpleNamespace(legs=(leg,), log_likelihood=0.0, at_level=rung)
    excess = Posterior._widened(own, 0, "position_noise", np.array([[0.4]]))
    mean, variance = 0.5 / bend, 1.0 / bend  # with the level itself as its prior weight
    expected = variance + (mean**2 if bend < 4.0 else 0.0)
    np.testing.assert_allclose(excess, [[0.7 * expected]], rtol=rel)


def test_waves_around_those_of_the_flow_are_two_cells_from_them_and_their_opposites(monkeypatch):
    seen = []

    def under(information):
        def step(_posterior, models, extra):
            seen.extend(models[0].pattern.silent)
            score, own = np.zeros(len(extra)), information * np.eye(len(extra))
            return SimpleNamespace(names=tuple(extra), score=score, information=own)

        return step

    walk = Process("turbulence", ("wind_x", "wind_y"), 0.5, 1.0)
    model = Model(TRUE, {"response_time": TAU}, (walk,))
    legs = (Leg(None, model, *[None] * 5, np.array([[0.0, 0.0], [10.0, 8.0]])),)
    for information in (1.0, 0.0):  # of no wave that is seen
        monkeypatch.setattr(Posterior, "under", under(information))
        assert Posterior(legs, (), np.eye(0), 0.0, 0.0, "").inflation == 1.0
    waves = TRUE.waves[:, :2]
    away = np.array(seen)[:, None] - np.concatenate([waves, -waves])
    cells = away * [10.0, 8.0] / (2.0 * np.pi)
    nearest = np.linalg.norm(cells, axis=2).min(axis=1)
    assert len(nearest) > 10
    assert 2.0 < nearest.min() < nearest.max() < 5.1


def test_waves_around_those_of_the_flow_widen_what_only_wanders_in_time():
    """Gusts that are a field in space, about as long as the cells, and gusts in time alone."""
    rng, fade, motion = np.random.default_rng(15), np.exp(-0.08), motion_of(TRUE)
    size, angle = rng.uniform(0.8, 1.4, 40), rng.uniform(0.0, np.pi, 40)
    waves = size[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    along, phases = waves[:, ::-1] * [0.05, -0.05], rng.uniform(0.0, 2.0 * np.pi, 40)
    walk, root = np.zeros((601, 2)), np.array([[1.2, 0.0], [0.6, 0.4]])
    for i in range(600):
        walk[i + 1] = fade * walk[i] + 0.8 * np.sqrt(1 - fade**2) * root @ rng.normal(size=2)
    posteriors = []
    for in_space in (True, False):
        states = np.tile([0.3, -0.8, 2.0, 1.0], (2401, 1))
        for i in range(2400):  # Heun's steps of 0.01 s
            slopes = []
            for time in (0.01 * i, 0.01 * (i + 1)):
                there = states[i] + 0.01 * sum(slopes)
                gust = np.cos(waves @ there[:2] + phases) @ along if in_space else walk[i // 4]
                slopes.append(motion(time, there) + np.append([0.0, 0.0], gust / TAU))
            states[i + 1] = states[i] + 0.005 * sum(slopes)
        readings = states[:2400:4] + rng.normal(size=(600, 4)) * [0.05, 0.05, 0.2, 0.2]
        log = FlightLog(0.04 * np.arange(600), readings[:, :2], readings[:, 2:], THRUST)
        turbulence = Process("turbulence", ("wind_x", "wind_y"), 0.2, 2.0)
        model = Model(nearby(), {"response_time": TAU}, (turbulence,))
        posteriors.append(measured([log], model))
    assert posteriors[0].inflation > 1.8
    assert (
        posteriors[1].inflation < 1.5
    )  # in time alone: 1 but for chance, of half of chi^2 of 2 degrees
    assert measured([log], Model(nearby(), {"response_time": TAU})).inflation == 1.0
    varied = _varied(lambda models, near, _: measure([log], models, near), posteriors[1])
    assert varied.log_likelihood > posteriors[1].log_likelihood + 20.0
    own = np.array(varied.model.processes[0].mixing)
    np.testing.assert_allclose(own @ own.T, root @ root.T / 0.98, atol=0.25)
    parted = replace(turbulence, course=(1.0,) * 59)  # 55 parts of 11 rows are 59 of 600, rounded
    again = measured([log], replace(model, processes=(parted,)))
    varied = _varied(lambda models, near, _: measure([log], models, near), again)
    assert varied.log_likelihood > again.log_likelihood + 20.0  # and by direction, as above


@pytest.mark.parametrize(("bend", "slope", "reach"), [(1.0, 0.1, 2.0), (10.0, 0.0, 3.0)])
def test_passes_that_go_to_and_fro_or_fall_are_shortened(bend, slope, reach, monkeypatch):
    """Steps from x to -x of a likelihood that is lower by .1 x: no pass falls by 1, none ends.

    Or to -2 x, where it falls by more: a half of such a step rises.
    """

    def at(x):
        model = SimpleNamespace(names=(), levels={})
        return (SimpleNamespace(x=x, stride=1, model=model),)

    def step_of(legs):
        x, smoothed = legs[0].x, (SimpleNamespace(squares=np.zeros((0, 2))),)
        return SimpleNamespace(
            reached=-bend * x * x - slope * x, gain=bend * x * x, levels=[np.zeros((0, 0))],
            blind=(), smoothed=lambda: smoothed,
            moved=lambda _, share=1.0, __=None: at(x - reach * share * x),
        )  # fmt: skip

    monkeypatch.setattr(room.Step, "of", step_of)
    monkeypatch.setattr(room, "_gated", lambda *_: False)
    legs, step, reason = climbed(at(0.3), [np.zeros(0)], 0)
    assert reason == ""
    assert step.gain < room.GAIN
    assert legs[0].x == pytest.approx(0.0, abs=0.1)
