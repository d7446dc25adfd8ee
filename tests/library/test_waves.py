"""The family of waves: incompressible columns, and derivatives that are those of differences."""

import math

import numpy as np
import pytest

from sparsefit.flight.flow import CellularFlow
from sparsefit.library.family import Family
from sparsefit.library.waves import AXIS, PAIR, RECTANGLE, SQUARE, WAVE, Waves

STEP = 1e-5
RNG = np.random.default_rng(1)
POSITION = np.column_stack([RNG.uniform(-9, 9, (30, 2)), RNG.uniform(-4, 4, 30)])
STEADY = {
    WAVE: [[0.7, 0.4], [-0.3, 0.9]],
    PAIR: [[0.7, 0.4, -0.5, 0.8]],
    AXIS: [[0.7], [1.3]],
    SQUARE: [[0.7, 0.3], [1.1, -0.6]],
    RECTANGLE: [[0.7, 0.5, 0.3]],
}
DRIFTING = {WAVE: [[0.7, 0.4, 1.5]], RECTANGLE: [[0.7, 0.5, 0.8, -0.4, 0.3]]}
CASES = [(pattern, np.array(q)) for pattern, q in STEADY.items()]
CASES += [(pattern.moving, np.array(q)) for pattern, q in DRIFTING.items()]
cases = pytest.mark.parametrize(
    ("pattern", "q"), CASES, ids=[f"{p.name}{'-drifting' * p.drifting}" for p, _ in CASES]
)


def differences(function, at):
    """Central differences of a function by every entry of the last axis of `at`."""
    ends = [
        [function(at + sign * STEP * unit) for sign in (1, -1)] for unit in np.eye(at.shape[-1])
    ]
    return [(above - below) / (2 * STEP) for above, below in ends]


@cases
def test_derivatives_by_the_parameters_are_those_of_differences(pattern, q):
    waves = Waves(pattern)
    assert isinstance(waves, Family)
    values = waves.values(POSITION, q)
    assert values.shape == (len(q), waves.size, 2 * len(POSITION))
    slopes = waves.slopes(POSITION, q, values)
    bends = waves.bends(POSITION, q, values)

    def slopes_at(other):
        return waves.slopes(POSITION, other, waves.values(POSITION, other))

    by_value = differences(lambda other: waves.values(POSITION, other), q)
    by_slope = differences(slopes_at, q)
    for i in range(waves.parameters):
        np.testing.assert_allclose(slopes[:, i], by_value[i], atol=1e-7)
        np.testing.assert_allclose(bends[:, i], by_slope[i], atol=1e-6)


@cases
def test_derivatives_in_space_are_those_of_differences(pattern, q):
    waves, values = Waves(pattern), Waves(pattern).values(POSITION, q)
    gradients, second = waves.gradients(q, values), np.zeros_like(values)
    for axis in range(2):
        shift = STEP * np.eye(3)[axis]
        ends = [waves.values(POSITION + sign * shift, q) for sign in (1, -1)]
        np.testing.assert_allclose(gradients[axis], (ends[0] - ends[1]) / (2 * STEP), atol=1e-7)
        above, below = (waves.gradients(q, end)[axis] for end in ends)
        second += (above - below) / (2 * STEP)
    np.testing.assert_allclose(waves.laplacians(q, values), second, atol=1e-6)


@cases
def test_the_bent_flow_is_the_slopes_times_the_weights(pattern, q):
    waves, values = Waves(pattern), Waves(pattern).values(POSITION, q)
    weights = np.random.default_rng(2).standard_normal((len(q), waves.size, 1))
    expected = np.einsum("spcr,scn->sprn", waves.slopes(POSITION, q, values), weights)
    np.testing.assert_allclose(waves.bent(POSITION, q, values, weights), expected, atol=1e-11)

    def bent(position):
        return waves.bent(position, q, waves.values(position, q), weights)

    gradients = waves.bent_gradients(POSITION, q, values, weights)
    for axis in range(2):
        shift = STEP * np.eye(3)[axis]
        expected = (bent(POSITION + shift) - bent(POSITION - shift)) / (2 * STEP)
        np.testing.assert_allclose(gradients[axis], expected, atol=1e-6)


@cases
def test_no_wave_has_a_divergence(pattern, q):
    waves, values = Waves(pattern), Waves(pattern).values(POSITION, q)
    (u_x, _), (_, v_y) = (np.split(one, 2, axis=-1) for one in waves.gradients(q, values))
    np.testing.assert_allclose(u_x, -v_y, atol=1e-14)


def test_the_stream_function_of_the_paper_is_the_difference_of_two_waves():
    # psi = U0 L/pi sin kx sin ky = U0 L/(2 pi) (cos(kx - ky) - cos(kx + ky))
    flow = CellularFlow(3.0, 2.0)
    k, size = math.pi / 2.0, 3.0 / math.pi
    weights = np.array([-size, 0.0, size, 0.0])
    columns = Waves(AXIS).values(POSITION[:, :2], np.array([[k]]))[0]
    expected = flow.velocity(*POSITION[:, :2].T).T.ravel()
    np.testing.assert_allclose(weights @ columns, expected, atol=1e-13)


def test_patterns_hold_one_another():
    square = SQUARE.phases(np.array([[0.7, 0.0]]))
    np.testing.assert_allclose(square, AXIS.phases(np.array([[0.7]])))
    np.testing.assert_allclose(square, RECTANGLE.phases(np.array([[0.7, 0.7, 0.0]])))
    turned = RECTANGLE.phases(np.array([[0.7, 0.4, 0.2]]))[0]
    east, north = (
        np.array([math.cos(0.2), math.sin(0.2)]),
        np.array([-math.sin(0.2), math.cos(0.2)]),
    )
    np.testing.assert_allclose(turned[:, :2], [0.7 * east + 0.4 * north, 0.7 * east - 0.4 * north])
    pair = PAIR.phases(turned[:, :2].reshape(1, 4))[0]
    np.testing.assert_allclose(pair, turned)


def test_a_drift_carries_the_flow_along():
    drift, k = np.array([0.4, -0.7]), np.array([1.1, 0.5])
    waves = Waves(WAVE.moving)
    later = POSITION + np.array([*drift, 1.0])
    q = np.array([[*k, k @ drift]])
    np.testing.assert_allclose(waves.values(later, q), waves.values(POSITION, q), atol=1e-12)


@cases
def test_no_mode_has_no_columns(pattern, q):
    waves, none = Waves(pattern), np.zeros((0, q.shape[1]))
    position = np.zeros((7, 3))
    values = waves.values(position, none)
    weights = np.zeros((0, waves.size, 1))
    assert values.shape == (0, waves.size, 14)
    assert waves.bent(position, none, values, weights).shape == (0, waves.parameters, 14, 1)
