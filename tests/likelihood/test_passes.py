"""The passes: exact derivatives, the compiled against the plain ones, blocks, a pattern's waves."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from sparsefit.likelihood import reference, trellis
from sparsefit.likelihood.model import LEVELS, Model, Process
from sparsefit.likelihood.pattern import WAVE, StreamPattern
from sparsefit.likelihood.reference import ELEMENTS, Smoothed
from sparsefit.likelihood.trellis import Leg

WAVES = np.array([[1.1, 0.4], [-0.3, 0.9]])
HEIGHTS = [2.0, 1.0], [0.5, -1.5]
VALUES = (0.4, 1.1, 0.05, 0.3, -0.2, 0.02, 0.4, -0.3, 0.02, 0.03, 0.01, 0.03, 0.0, 0.02)
SENSORS = (1.02, 0.97, 0.1, -0.2, 0.03, 0.02)
PROCESSES = (
    Process("turbulence", ("wind_x", "wind_y"), 0.7, 1.5, (0.3, 1.7), ((1.2, 0.3), (0.1, 0.6))),
    Process("swell", ("gain",), 0.1),
    Process("drift", ("position_bias_x", "position_bias_y"), 0.2, 0.2),
)


def odd_model(shape="pair"):
    pattern = StreamPattern.of_waves(shape, WAVES, *HEIGHTS, (0.1, -0.2))
    own = dict(zip(ELEMENTS, VALUES + SENSORS, strict=False))
    return Model(pattern, own | dict(zip(LEVELS, (0.3, 0.05, 0.2), strict=True)), PROCESSES)


def odd_leg(count=40, states=9, seed=3):
    rng = np.random.default_rng(seed)
    time = np.sort(rng.uniform(-3, 3, count))
    push = rng.normal(size=(count, 2))
    track = rng.normal(size=(count, states)) * [2, 2, 3, 3, *[0.3] * (states - 4)]
    measured = track[:, :4] + 0.1 * rng.normal(size=(count, 4))
    weights = np.where(rng.uniform(size=(count, 4)) < 0.2, 0.0, rng.uniform(0.5, 1.0, (count, 4)))
    log = SimpleNamespace(spread=np.arange(1.0, 5.0))
    return Leg(log, odd_model(), time, push, measured, weights, weights > 0.0, track)


def test_steps_and_readings_have_the_derivatives_of_finite_differences():
    leg = odd_leg(6)
    space = replace(leg.model.space((), leg.track), chain=np.eye(len(leg.model.elements)))
    time = np.linspace(0.0, 0.5, 6)
    functions = {
        "step": lambda e, s: reference.following(space, time, leg.push, e, s),
        "reading": lambda e, s: reference.reading(space, e, s),
    }
    for name, function in functions.items():
        states = leg.track.T[:, :5]
        _, slopes = reference.derived(function, space, states)
        for place in range(9 + len(space.elements)):
            push, moved = np.zeros(len(space.elements)), np.zeros_like(states)
            if place < 9:
                moved[place] = 1e-6
            else:
                push[place - 9] = 1e-6
            up, down = (
                function(space.elements + sign * push, states + sign * moved) for sign in (1, -1)
            )
            if name == "reading" and place == 9 + list(ELEMENTS).index("latency"):
                continue  # the readings are then of another time
            slope = (up - down).T / 2e-6
            np.testing.assert_allclose(slopes[..., place], slope, rtol=1e-6, atol=1e-7)


def passed(leg):
    forward = leg.forward((*ELEMENTS, *(f"{name}_{j}" for j in (1, 2) for name in WAVE)))
    smoothed = forward.backward(0.01 * np.cos(np.arange(len(ELEMENTS) + 10)))
    return (
        *(forward.value, forward.score, forward.information),
        *(smoothed.track, smoothed.adjoint, smoothed.scores, smoothed.squares),
    )


@pytest.mark.parametrize("levels", [False, True])
@pytest.mark.parametrize("way", ["plain", "blocks", "far"])
def test_the_compiled_pass_is_the_plain_one_and_that_of_blocks(levels, way, monkeypatch):
    pytest.importorskip("sparsefit.likelihood.passes")
    leg, rng = odd_leg(), np.random.default_rng(5)
    adjoint, scores = rng.normal(size=(41, 18)), rng.normal(size=(40, 12))
    squares = np.zeros((6, 2)), np.zeros((1, 6, 2))
    leg.track[:, :2] += 1e8 * (way == "far")  # phases are beyond what the lanes reduce
    last = Smoothed(leg.track, adjoint, scores, *squares) if levels else None
    compiled = passed(leg := replace(leg, last=last))
    name, other = ("BLOCK", 16) if way == "blocks" else ("passes", reference)
    monkeypatch.setattr(trellis, name, other)
    for expected, value in zip(passed(leg), compiled, strict=True):
        size = np.abs(expected).max()
        np.testing.assert_allclose(value, expected, rtol=1e-8, atol=1e-9 * size)


@pytest.mark.parametrize("shape", ["axis", "square", "rectangle", "pair", "scales"])
@pytest.mark.parametrize("drift", [None, (0.3, -0.2)])
def test_a_model_has_the_jacobian_of_finite_differences(shape, drift):
    model = replace(odd_model(), pattern=StreamPattern.of_waves(shape, WAVES, *HEIGHTS, drift))
    names = (*model.pattern.names, *ELEMENTS)
    for name, column in zip(names, model.jacobian(names).T, strict=True):
        up, down = (model.at({name: model.values[name] + step}).elements for step in (1e-6, -1e-6))
        slope = (up - down) / 2e-6
        np.testing.assert_allclose(column, slope, rtol=1e-6, atol=1e-8, err_msg=name)


@pytest.mark.parametrize("signs", [(1, 1), (-1, 1), (1, -1), (-1, -1)])
@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_a_square_of_waves_is_these_waves_whatever_their_signs(signs, order):
    true = StreamPattern("square", (5.0, 3.0, 0.3, 0.7, -1.2))
    waves = true.waves[list(order)] * np.array(signs)[:, None] ** [[1, 1, 0, 1, 0]]
    again = StreamPattern.of_waves("square", waves[:, :2], waves[:, 2], waves[:, 3])
    np.testing.assert_allclose(again.values, true.values, rtol=1e-12)


def test_a_rectangle_of_waves_has_a_length_by_each_of_their_axes():
    true = StreamPattern("rectangle", (5.0, 3.0, 4.0, 0.3, 0.7, -1.2))
    again = StreamPattern.of_waves("rectangle", true.waves[:, :2], *true.waves[:, 2:4].T)
    np.testing.assert_allclose(again.values, true.values, rtol=1e-12)


def velocity(pattern, x, y, t=0.0):
    """The flow, by the force on a vehicle of unit response time at rest."""
    elements = np.concatenate([[1.0, *np.zeros(len(ELEMENTS) - 1)], pattern.waves.ravel()])[:, None]
    at = np.array([x, y, 0.0, 0.0]) - [*pattern.origin[:2], 0.0, 0.0]
    time = np.array([t - pattern.origin[2]])
    return reference.force(elements, at[:, None], time, np.zeros((2, 1)))[:, 0]


def test_a_mass_is_that_of_the_believed_vehicle_at_the_start_of_the_log():
    rng = np.random.default_rng(2)
    elements = np.repeat(odd_model().elements[:, None], 2, axis=1)
    still = np.where(np.arange(len(elements)) == list(ELEMENTS).index("mass_rate"), 0.0, 1.0)
    state, push, time = rng.normal(size=(4, 1)), rng.normal(size=(2, 1)), np.array([-5.0, 3.0])
    at = np.repeat(state, 2, axis=1), time, np.repeat(push, 2, axis=1)
    with_it = reference.force(elements, *at, start=-5.0)
    without = reference.force(still[:, None] * elements, *at, start=-5.0)
    ratios = without / with_it
    np.testing.assert_allclose(ratios, np.repeat([[1.0, 1.0 + 8.0 * 0.01]], 2, axis=0))


def test_cells_along_the_axes_are_those_of_the_paper():
    pattern, k = StreamPattern("axis", (15.0, 4.0, np.pi, 0.0)), np.pi / 4.0
    cells = 15.0 * np.array([np.sin(1.3 * k) * np.cos(0.8 * k), -np.cos(1.3 * k) * np.sin(0.8 * k)])
    np.testing.assert_allclose(velocity(pattern, 1.3, 0.8), cells, rtol=1e-12)
    assert pattern.about((1.0, 2.0, 3.0)).mean_velocity == pytest.approx(15.0)


@pytest.mark.parametrize("shape", ["rectangle", "pair", "scales"])
def test_the_origin_of_the_phases_changes_no_flow(shape):
    pattern = odd_model(shape).pattern
    moved = pattern.about((0.7, -1.1, 2.0))
    here, there = (velocity(each, 0.4, 0.9, 1.5) for each in (pattern, moved))
    np.testing.assert_allclose(here, there, rtol=1e-12)
