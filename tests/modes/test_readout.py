"""Length scale and mean velocity from weights, against values worked by hand."""

import numpy as np
import pytest

import sparsefit as sf
from sparsefit.errors import InputError
from sparsefit.library.cells import CANDIDATES, candidate_columns
from sparsefit.modes.readout import (
    Readout,
    paper_mean_velocity,
    peak_mean_velocity,
    rms_mean_velocity,
)
from sparsefit.regression.problem import RegressionProblem
from tests.problems import VEHICLE, flight, flight_problem


def exact_weights(speed):
    weights = np.zeros((8, 2))
    weights[CANDIDATES.index("sin x cos y"), 0] = speed
    weights[CANDIDATES.index("cos x sin y"), 1] = -speed
    return weights


def problem_of_groups(groups):
    theta = np.random.default_rng(0).normal(size=(9, len(groups)))
    return RegressionProblem.from_arrays(theta, np.ones((9, 2)), groups)


WEIGHTS = np.array([[3.0, -4.0], [0.0, 0.0], [5.0, -12.0], [1.0, 1.0]])
GROUPS = [0, 0, 1, 2]


@pytest.mark.parametrize(
    ("readout", "expected"),
    [
        ("signed-sum", [-1.0, -7.0, 2.0]),
        ("absolute-sum", [7.0, 17.0, 2.0]),
        ("group-norm", [5.0, 13.0, np.sqrt(2.0)]),
    ],
)
def test_scale_weights_worked_by_hand(readout, expected):
    found = Readout(length_scale=readout).scale_weights(problem_of_groups(GROUPS), WEIGHTS)
    assert found == pytest.approx(expected)


def test_scale_weights_do_not_need_groups_in_order():
    found = Readout().scale_weights(problem_of_groups([1, 2, 0, 1]), WEIGHTS)
    assert found == pytest.approx([13.0, np.sqrt(27.0), 0.0])


def test_signed_sum_can_cancel_where_the_group_norm_cannot():
    # The cellular flow of Eq. 1 has weights U0 and -U0: Eq. 21 to the letter sums them to zero.
    problem = RegressionProblem.from_arrays(
        np.random.default_rng(0).normal(size=(9, 8)), np.ones((9, 2)), np.zeros(8)
    )
    weights = exact_weights(15.0)
    assert Readout("signed-sum").scale_weights(problem, weights) == pytest.approx([0.0])
    assert Readout("group-norm").scale_weights(problem, weights) == pytest.approx([15 * 2**0.5])


@pytest.mark.parametrize("readout", [rms_mean_velocity, peak_mean_velocity])
@pytest.mark.parametrize("speed", [1e-9, 0.3, 15.0, 1e9])
def test_exact_weights_give_the_mean_velocity(readout, speed):
    assert readout(exact_weights(speed)) == pytest.approx(speed, rel=1e-9)


@pytest.mark.parametrize("readout", [rms_mean_velocity, peak_mean_velocity])
def test_no_flow_has_no_velocity(readout):
    assert readout(np.zeros((8, 2))) == 0.0


def test_rms_and_peak_of_singles_worked_by_hand():
    weights = np.zeros((8, 2))
    weights[0, 0], weights[3, 1] = 3.0, 4.0  # w = (3 sin x, 4 cos y): <|w|^2> = 25/2, peak 5
    assert rms_mean_velocity(weights) == pytest.approx(5.0)
    assert peak_mean_velocity(weights) == pytest.approx(5.0)


def test_rms_is_the_mean_over_the_cell():
    weights = np.random.default_rng(3).normal(size=(8, 2))
    axis = np.arange(16) / 8.0 * np.pi
    cell = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    velocity = candidate_columns(cell, np.array([np.pi])) @ weights
    expected = np.sqrt(2 * np.mean(np.sum(velocity**2, axis=1)))
    assert rms_mean_velocity(weights) == pytest.approx(expected, rel=1e-12)


def test_peak_is_no_less_than_a_fine_scan_of_the_cell():
    weights = np.random.default_rng(4).normal(size=(8, 2))
    axis = np.linspace(0, 2 * np.pi, 721)
    cell = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    scan = np.linalg.norm(candidate_columns(cell, np.array([np.pi])) @ weights, axis=1).max()
    assert scan <= peak_mean_velocity(weights) <= scan * (1 + 1e-4)


@pytest.mark.parametrize("eq24", ["mean-ratio", "pseudo-inverse"])
def test_the_papers_readout_is_sqrt_2_too_large_once_the_range_is_covered(eq24):
    # field = Phi, in [-U0, U0]: Eq. 22 gives the range sqrt(2): Phi / normal = sqrt(2) U0.
    field = 6.0 * np.array([[-1.0, 0.5], [1.0, -1.0], [0.25, 1.0]])
    assert paper_mean_velocity(field, field, eq24) == pytest.approx(6.0 * np.sqrt(2.0))


def test_the_papers_readout_worked_by_hand_where_the_range_is_not_centred():
    # Component x: field 0, 2 -> normal -+ sqrt(2)/2; Phi 1, 3. Component y: the same, Phi 2, 2.
    field = np.array([[0.0, 0.0], [2.0, 2.0]])
    phi = np.array([[1.0, 2.0], [3.0, 2.0]])
    half = np.sqrt(2.0) / 2
    assert paper_mean_velocity(field, phi, "pseudo-inverse") == pytest.approx(half * 2 / 2)
    assert paper_mean_velocity(field, phi, "mean-ratio") == pytest.approx((-1 + 3) / half / 4)


def test_the_papers_readout_has_no_answer_for_a_constant_field():
    for eq24 in ("mean-ratio", "pseudo-inverse"):
        assert np.isnan(paper_mean_velocity(np.ones((4, 2)), np.ones((4, 2)), eq24))


@pytest.mark.parametrize(
    ("readout", "tolerance"),
    [(Readout(), 1e-5), (Readout(mean_velocity="peak"), 1e-5)],
)
def test_velocity_of_a_noise_free_flight(readout, tolerance):
    samples, problem = sf.Derivative()(flight()), flight_problem()
    phi = samples.flow_velocity(VEHICLE)
    found = readout.velocity(samples.position, phi, problem.target, 4.2)
    assert found == pytest.approx(15.0, rel=tolerance)


def test_the_papers_velocity_of_a_flight_that_covers_a_cell_is_biased():
    samples, problem = sf.Derivative()(flight()), flight_problem()
    phi = samples.flow_velocity(VEHICLE)
    readout = Readout(mean_velocity="paper")
    found = readout.velocity(samples.position, phi, problem.target, 4.2)
    assert 1.2 * 15.0 < found <= np.sqrt(2) * 15.0 * 1.001


@pytest.mark.parametrize("key", ["length_scale", "mean_velocity", "eq24"])
def test_unknown_readouts_are_refused(key):
    with pytest.raises(InputError, match=f"readout {key}"):
        Readout(**{key: "pseudo"})
