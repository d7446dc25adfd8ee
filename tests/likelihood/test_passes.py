"""The passes: exact derivatives, the compiled against the plain ones, and a dense Gaussian."""

import numpy as np
import pytest

from sparsefit.likelihood import reference
from sparsefit.likelihood.model import (
    ELEMENTS,
    Disturbance,
    Model,
    Motion,
    Process,
    Sensor,
    StateSpace,
)
from sparsefit.likelihood.pattern import StreamPattern

passes = pytest.importorskip("sparsefit.likelihood.passes")
ODD = Motion(0.4, 1.1, 0.05, 0.3, -0.2, 0.02, 0.4, -0.3, 0.02, 0.03, 0.01, 0.03)
SENSOR = Sensor(1.02, 0.97, 0.1, -0.2, 0.03, 0.02)
PROCESSES = (
    Process("turbulence", ("wind_x", "wind_y"), 0.7, 1.5),
    Process("swell", ("gain",), 0.1),
    Process("drift", ("position_bias_x", "position_bias_y"), 0.2, 0.2),
)


def odd_model(shape="pair", processes=PROCESSES):
    waves = np.array([[1.1, 0.4], [-0.3, 0.9]])
    pattern = StreamPattern.of_waves(shape, waves, [2.0, 1.0], [0.5, -1.5], (0.1, -0.2))
    return Model(pattern, ODD, SENSOR, Disturbance(0.3, 0.05, 0.2, processes), growth=0.02)


def odd_nodes(count=40, states=9, seed=3):
    rng = np.random.default_rng(seed)
    time = np.sort(rng.uniform(-3, 3, count))
    thrust = rng.normal(size=(count, 2))
    track = rng.normal(size=(count, states)) * [2, 2, 3, 3, *[0.3] * (states - 4)]
    return time, thrust, track


def space_of(model):
    return StateSpace.of(model, range(len(model.elements)))


def step_arguments(space, columns=None):
    return space.elements, space.walkers, space.rates, space.columns if columns is None else columns


def test_the_step_has_the_derivatives_of_finite_differences():
    space = space_of(odd_model())
    time, thrust, track = odd_nodes(6)
    time = np.linspace(0.0, 0.5, 6)
    _, slopes = reference.transitions(*step_arguments(space), time, thrust, track)
    none = np.zeros(0, dtype=np.intp)

    def following(elements, states):
        return reference.transitions(
            elements, space.walkers, space.rates, none, time, thrust, states
        )[0][:, :4]

    for state in range(9):
        push = np.zeros_like(track)
        push[:, state] = 1e-6
        up, down = (following(space.elements, track + sign * push) for sign in (1, -1))
        np.testing.assert_allclose(slopes[:, :, state], (up - down) / 2e-6, rtol=1e-6, atol=1e-7)
    for element in range(len(space.elements)):
        push = np.zeros(len(space.elements))
        push[element] = 1e-6
        up, down = (following(space.elements + sign * push, track) for sign in (1, -1))
        column = slopes[:, :, 9 + element]
        np.testing.assert_allclose(column, (up - down) / 2e-6, rtol=1e-6, atol=1e-7)


def test_the_readings_have_the_derivatives_of_finite_differences():
    space = space_of(odd_model())
    state = odd_nodes()[2][0]
    _, by_state, by_element = reference.observation(
        *step_arguments(space)[:2], space.columns, state
    )
    none = np.zeros(0, dtype=np.intp)

    def reading(elements, at):
        return reference.observation(elements, space.walkers, none, at)[0]

    push = 1e-6 * np.eye(9)
    slopes = [reading(space.elements, state + e) - reading(space.elements, state - e) for e in push]
    np.testing.assert_allclose(by_state, np.array(slopes).T / 2e-6, atol=1e-8)
    for element, name in enumerate(ELEMENTS):
        push = np.zeros(len(space.elements))
        push[element] = 1e-6
        slope = reading(space.elements + push, state) - reading(space.elements - push, state)
        if name != "latency":  # the readings are then of another time
            np.testing.assert_allclose(by_element[:, element], slope / 2e-6, atol=1e-8)


@pytest.mark.parametrize("shape", ["axis", "square", "rectangle", "pair"])
@pytest.mark.parametrize("drift", [None, (0.3, -0.2)])
def test_a_pattern_has_the_jacobian_of_finite_differences(shape, drift):
    waves = np.array([[1.1, 0.4], [-0.3, 0.9]])
    pattern = StreamPattern.of_waves(shape, waves, [2.0, 1.0], [0.5, -1.5], drift)
    for column in range(len(pattern.values)):
        push = np.zeros(len(pattern.values))
        push[column] = 1e-6
        up, down = (
            StreamPattern(shape, tuple(np.array(pattern.values) + sign * push), drift is not None)
            for sign in (1, -1)
        )
        slope = (up.waves - down.waves).ravel() / 2e-6
        np.testing.assert_allclose(pattern.jacobian[:, column], slope, rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize("signs", [(1, 1), (-1, 1), (1, -1), (-1, -1)])
@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_a_square_of_waves_is_these_waves_whatever_their_signs(signs, order):
    true = StreamPattern("square", (5.0, 3.0, 0.3, 0.7, -1.2))
    waves = true.waves[list(order)] * np.array(signs)[:, None] ** [[1, 1, 0, 1, 0]]
    again = StreamPattern.of_waves("square", waves[:, :2], waves[:, 2], waves[:, 3])
    np.testing.assert_allclose(again.values, true.values, rtol=1e-12)


def test_cells_along_the_axes_are_those_of_the_paper():
    pattern = StreamPattern("axis", (15.0, 4.0, np.pi, 0.0))
    elements = np.concatenate([[1.0, *np.zeros(21)], pattern.waves.ravel()])
    x, y = 1.3, 0.8
    force, _, _ = reference.acceleration(
        elements[None],
        np.zeros(0, np.intp),
        np.array([[x, y, 0, 0]]),
        np.zeros(1),
        np.zeros((1, 2)),
    )
    k = np.pi / 4.0
    cells = 15.0 * np.array([np.sin(k * x) * np.cos(k * y), -np.cos(k * x) * np.sin(k * y)])
    np.testing.assert_allclose(force[0], cells, rtol=1e-12)
    assert pattern.about((1.0, 2.0, 3.0)).mean_velocity == pytest.approx(15.0)


def test_the_origin_of_the_phases_changes_no_flow():
    for shape in ("rectangle", "pair"):
        pattern = odd_model(shape).pattern
        moved = pattern.about((0.7, -1.1, 2.0))
        here = np.array([[0.4, 0.9, 0.0, 0.0]])
        forces = [
            reference.acceleration(
                np.concatenate([[1.0, *np.zeros(21)], each.waves.ravel()])[None],
                np.zeros(0, np.intp), here - [*each.origin[:2], 0, 0],
                np.array([1.5 - each.origin[2]]), np.zeros((1, 2)),
            )[0]
            for each in (pattern, moved)
        ]  # fmt: skip
        np.testing.assert_allclose(*forces, rtol=1e-12)


def filtered(kernel, space, nodes, seed=5, adjoint=True):
    """Everything that the two passes give on random readings, some of which are missing."""
    time, thrust, track = nodes
    rng = np.random.default_rng(seed)
    m, n = track.shape
    p, levels = len(space.columns), len(space.kicks)
    measured = track[:, :4] + 0.1 * rng.normal(size=(m, 4))
    weights = np.where(rng.uniform(size=(m, 4)) < 0.2, 0.0, rng.uniform(0.5, 1.0, (m, 4)))
    pushed = rng.normal(size=(m + 1, 2 * n)) if adjoint else np.zeros((0, 2 * n))
    scores = rng.normal(size=(m, 12))
    q = p + levels * adjoint
    state = np.zeros((2 + q + n + q, max(n, q)))
    state[1 + q : 1 + q + n, :n] = np.eye(n)
    stored = np.zeros((m, n * (1 + p + n) + 4 * (2 * n + p + 2) + 4 * n))
    gain = kernel.forward(
        *step_arguments(space), space.kicks, space.noise,
        time, thrust, measured, weights, track, pushed, scores, state, stored,
    )  # fmt: skip
    carried, smoothed = np.zeros((1 + n, n)), np.zeros((m, n))
    pushed, scores, sums = np.zeros((m, 2 * n)), np.zeros((m, 12)), np.zeros((n + 4, 2))
    kernel.backward(
        space.rates, p, time, weights, 0.01 * rng.normal(size=p), space.noise.sum(axis=0),
        stored, carried, smoothed, pushed, scores, sums,
    )  # fmt: skip
    return gain, state, carried, smoothed, pushed, scores, sums


@pytest.mark.parametrize("adjoint", [False, True])
def test_the_compiled_passes_are_the_plain_ones(adjoint):
    space, nodes = space_of(odd_model()), odd_nodes()
    plain, compiled = (
        filtered(kernel, space, nodes, adjoint=adjoint) for kernel in (reference, passes)
    )
    for expected, value in zip(plain, compiled, strict=True):
        size = np.abs(expected).max()
        np.testing.assert_allclose(value, expected, rtol=1e-9, atol=1e-9 * size)
