"""Candidates (Eqs. 17-19), grids, problems from arrays and from blocks of rows."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import sparsefit as sf
from sparsefit import backends
from sparsefit.derivative import Derivative
from sparsefit.errors import InputError
from sparsefit.library import builder as room
from sparsefit.library.builder import Library
from sparsefit.library.cells import CANDIDATES
from sparsefit.library.cells import candidate_columns as columns_of
from sparsefit.library.grid import LengthScaleGrid
from sparsefit.regression.problem import RegressionProblem
from tests.problems import SMALL_GRID, VEHICLE, flight, flight_problem, regular

FORMULAS = (
    lambda x, y: np.sin(x),
    lambda x, y: np.sin(y),
    lambda x, y: np.cos(x),
    lambda x, y: np.cos(y),
    lambda x, y: np.sin(x) * np.sin(y),
    lambda x, y: np.sin(x) * np.cos(y),
    lambda x, y: np.cos(x) * np.sin(y),
    lambda x, y: np.cos(x) * np.cos(y),
)


def test_columns_are_the_formulas_of_eq_19_group_by_group():
    rng = np.random.default_rng(1)
    position, scales = rng.uniform(-40, 40, (150, 2)), np.array([1.0, 4.2, 12.0])
    theta = columns_of(position, scales)
    assert theta.shape == (150, 24)
    for j, scale in enumerate(scales):
        x, y = np.pi * position[:, 0] / scale, np.pi * position[:, 1] / scale
        for c, formula in enumerate(FORMULAS):
            assert theta[:, 8 * j + c] == pytest.approx(formula(x, y), abs=1e-13)


def test_columns_at_a_point_worked_by_hand():
    # x = L/6, y = L/3: sin x = 1/2, cos x = r/2, sin y = r/2, cos y = 1/2 with r = sqrt(3).
    r = np.sqrt(3.0)
    row = columns_of(np.array([[1.0, 2.0]]), np.array([6.0]))[0]
    assert row == pytest.approx([0.5, r / 2, r / 2, 0.5, r / 4, 0.25, 0.75, r / 4])


def test_the_true_flow_is_two_columns_of_its_group():
    flown = flight()
    theta = columns_of(flown.position, np.array([4.2]))
    weights = np.zeros((8, 2))
    weights[CANDIDATES.index("sin x cos y"), 0] = 15.0
    weights[CANDIDATES.index("cos x sin y"), 1] = -15.0
    expected = flown.flow.velocity(*flown.position.T)
    assert theta @ weights == pytest.approx(expected, abs=1e-12)


def test_a_library_too_large_is_refused_before_it_is_made():
    with pytest.raises(InputError, match="GiB"):
        columns_of(np.zeros((10_000_000, 2)), np.ones(1000))


def test_the_default_grid_is_the_papers():
    scales = LengthScaleGrid().scales
    assert len(scales) == LengthScaleGrid().size == 56
    assert (scales[0], scales[16], scales[-1]) == (1.0, 4.2, 12.0)  # 4.2 exactly
    assert scales.tolist() == [round(1 + 0.2 * i, 12) for i in range(56)]


@given(st.floats(0.1, 5.0), st.floats(0.0, 20.0), st.floats(0.05, 3.0))
def test_a_grid_by_step_stays_within_its_bounds(lower, width, step):
    grid = LengthScaleGrid(lower, lower + width, step=step)
    scales = grid.scales
    assert len(scales) == grid.size
    assert scales[0] == pytest.approx(lower, abs=1e-12)
    assert lower + width - step - 1e-9 <= scales[-1] <= lower + width + 1e-8
    assert np.all(np.diff(scales) > 0)


@given(st.floats(0.1, 5.0), st.floats(0.1, 20.0), st.integers(2, 300))
def test_a_grid_uniform_in_wavenumber_ascends_between_its_bounds(lower, width, count):
    scales = LengthScaleGrid(lower, lower + width, count=count, spacing="wavenumber").scales
    assert len(scales) == count
    assert scales[[0, -1]] == pytest.approx([lower, lower + width])
    steps = np.diff(np.pi / scales[::-1])
    np.testing.assert_allclose(steps, steps.mean(), rtol=1e-6)
    assert np.all(np.diff(scales) > 0)


def test_a_grid_by_count_is_linear():
    assert LengthScaleGrid(2.0, 4.0, count=5).scales == pytest.approx([2.0, 2.5, 3.0, 3.5, 4.0])
    assert LengthScaleGrid(3.0, 3.0).scales.tolist() == [3.0]
    assert LengthScaleGrid(3.0, 9.0, count=1).size == 1


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"lower": 0.0}, "lower"),
        ({"lower": -1.0}, "lower"),
        ({"lower": float("nan")}, "lower"),
        ({"lower": "1"}, "lower"),
        ({"upper": float("inf")}, "upper"),
        ({"lower": 5.0, "upper": 4.0}, "swap"),
        ({"step": 0.0}, "step"),
        ({"step": float("nan")}, "step"),
        ({"step": 0.1, "count": 5}, "not both"),
        ({"count": 0}, "count"),
        ({"count": 2.5}, "integer"),
        ({"count": True}, "count"),
        ({"spacing": "wavenumber"}, "needs count"),
        ({"spacing": "wave-number"}, 'did you mean "wavenumber"'),
        ({"step": 1e-9}, "larger step"),
    ],
)
def test_bad_grids_are_refused(settings, words):
    with pytest.raises(InputError, match=words):
        LengthScaleGrid(**settings)


@pytest.mark.parametrize("target", ["flow-velocity", "acceleration", "state-derivative"])
def test_a_library_builds_theta_target_groups_and_names(target):
    samples = sf.Derivative()(flight())
    problem = Library(SMALL_GRID, target).build(samples, VEHICLE)
    scales = SMALL_GRID.scales
    columns = columns_of(samples.position, scales)
    np.testing.assert_allclose(problem.theta, columns, rtol=1e-6, atol=1e-14)
    expected = {
        "flow-velocity": 0.5 * (samples.acceleration - [5.0, 3.0]) + samples.velocity,
        "acceleration": samples.acceleration,
        "state-derivative": np.hstack([samples.position_rate, samples.acceleration]),
    }[target]
    np.testing.assert_allclose(problem.target, expected, rtol=1e-6, atol=1e-12)
    assert len(problem.target_names) == problem.targets
    assert problem.groups.tolist() == np.repeat(range(len(scales)), 8).tolist()
    assert problem.group_scales.tolist() == scales.tolist()
    assert problem.names[8] == "sin x (L = 2.5 m)"
    assert (problem.samples, problem.columns) == problem.theta.shape


def test_an_unknown_target_is_refused():
    with pytest.raises(InputError, match='did you mean "flow-velocity"'):
        Library(target="flow-velocty")


THETA, TARGET = np.arange(1.0, 9.0).reshape(4, 2), np.ones(4)


@pytest.mark.parametrize(
    ("theta", "target", "words"),
    [
        (np.ones(4), TARGET, r"\(m, k\)"),
        (THETA, np.ones((4, 1, 1)), r"\(m, k\)"),
        (THETA, np.ones(3), "same number of rows"),
        (np.ones((0, 2)), np.ones(0), "must not be empty"),
        (np.ones((4, 0)), TARGET, "must not be empty"),
        (THETA, np.ones((4, 0)), "must not be empty"),
        (THETA * [1.0, 0.0], TARGET, "1.* is zero in every sample"),
        (THETA * [1e-200, 1.0], TARGET, "0.* is zero in every sample"),
        (THETA * [1.0, np.nan], TARGET, "1.* NaN"),
        (THETA * [np.inf, 1.0], TARGET, "0.* infinity"),
        (THETA * [1e200, 1.0], TARGET, r"values above 1e\+140"),
        (THETA, TARGET * np.nan, "target holds NaN"),
        (THETA, TARGET * np.inf, "target holds NaN"),
        ([["a", "b"]], [1.0], "real numbers"),
        ([[1.0, 2.0], [3.0]], [1.0, 2.0], "real numbers"),
        (THETA + 1j, TARGET, "complex"),
        (THETA, TARGET * 1j, "complex"),
        (None, TARGET, "theta"),
    ],
)
def test_bad_arrays_are_refused(theta, target, words):
    with pytest.raises(InputError, match=words):
        RegressionProblem.from_arrays(theta, target)


def test_the_message_names_the_column_and_counts_the_others():
    theta = np.ones((4, 3)) * [0.0, 1.0, 0.0]
    with pytest.raises(InputError, match=r"b.*1 more|a.*1 more"):
        RegressionProblem.from_arrays(theta, TARGET, names=["a", "b", "c"])


def test_names_and_groups_must_match_the_columns():
    with pytest.raises(InputError, match="one name per column"):
        RegressionProblem.from_arrays(THETA, TARGET, names=["only one"])
    for groups in ([0], [0, 1, 2], [[0, 1]], 0):
        with pytest.raises(InputError, match="one label per column"):
            RegressionProblem.from_arrays(THETA, TARGET, groups=groups)


@pytest.mark.parametrize(
    "labels", [["b", "a", "b"], [30, 10, 30], [1.5, -2.0, 1.5], [True, False, True]]
)
def test_labels_of_groups_are_arbitrary(labels):
    theta = np.arange(1.0, 13.0).reshape(4, 3)
    problem = RegressionProblem.from_arrays(theta, TARGET, groups=labels)
    assert problem.groups.tolist() == [1, 0, 1]


def test_one_target_may_be_a_vector_and_columns_are_their_own_groups():
    problem = RegressionProblem.from_arrays(THETA.tolist(), TARGET.tolist())
    assert (problem.samples, problem.columns, problem.targets) == (4, 2, 1)
    assert problem.groups.tolist() == [0, 1]
    assert problem.group_scales is None


def test_statistics_are_the_direct_formulas():
    problem = regular()
    s = problem.statistics
    z = problem.theta / np.sqrt(np.mean(problem.theta**2, axis=0))
    assert s.rms == pytest.approx(np.sqrt(np.mean(problem.theta**2, axis=0)))
    assert s.gram == pytest.approx(z.T @ z / 60)
    assert s.cross == pytest.approx(z.T @ problem.target / 60)
    assert s.target_square == pytest.approx(np.mean(problem.target**2, axis=0))
    assert problem.statistics is s  # formed once


@pytest.mark.parametrize("size", [1, 5, 7, 60])
def test_problems_from_blocks_of_rows_keep_every_inner_product(size):
    whole = regular()
    rows = [slice(i, i + size) for i in range(0, 60, size)]
    labels = ["abcd"[g] for g in whole.groups]
    blocks = ((whole.theta[r], whole.target[r]) for r in rows)
    folded = RegressionProblem.from_blocks(blocks, groups=labels)
    assert folded.samples == 60
    assert len(folded.theta) <= whole.columns + whole.targets
    assert folded.groups.tolist() == whole.groups.tolist()
    for name in ("rms", "gram", "cross", "target_square"):
        expected = getattr(whole.statistics, name)
        assert getattr(folded.statistics, name) == pytest.approx(expected, rel=1e-12, abs=1e-13)
    values = folded.spectrum.singular_values
    assert values == pytest.approx(whole.spectrum.singular_values, rel=1e-12)


@pytest.mark.parametrize("name", ["least-squares", "stlsq", "lasso", "group-lasso"])
def test_problems_from_blocks_have_the_same_fit_and_certificate(name):
    whole = regular()
    blocks = [(whole.theta[:31], whole.target[:31]), (whole.theta[31:], whole.target[31:])]
    folded = RegressionProblem.from_blocks(blocks, groups=whole.groups)
    expected, found = (sf.fit(p, backends.get(name)) for p in (whole, folded))
    assert found.weights == pytest.approx(expected.weights, rel=1e-8, abs=1e-10)
    assert found.status == expected.status == "ok"
    assert found.certificate.primal == pytest.approx(
        expected.certificate.primal, rel=1e-12, nan_ok=True
    )


def test_a_large_flight_is_compressed_to_the_same_estimate(monkeypatch):
    whole = flight_problem()
    monkeypatch.setattr(room, "STREAM_BYTES", 0)
    folded = Library(SMALL_GRID).build(sf.Derivative()(flight()), VEHICLE)
    assert folded.samples == whole.samples > len(folded.theta)
    assert folded.statistics.gram == pytest.approx(whole.statistics.gram, abs=1e-12)
    readouts = [sf.Readout(), sf.Readout(mean_velocity="peak"), sf.Readout(mean_velocity="paper")]
    for readout in readouts:
        estimator = sf.Estimator(library=Library(SMALL_GRID), readout=readout)
        compressed = estimator.estimate(flight())
        with monkeypatch.context() as undone:
            undone.setattr(room, "STREAM_BYTES", 2**40)
            plain = estimator.estimate(flight())
        assert compressed.length_scale == plain.length_scale
        assert compressed.mean_velocity == pytest.approx(plain.mean_velocity, rel=1e-9)


def test_a_grid_of_the_flight_is_resolved_when_the_library_is_built():
    vehicle, flow = sf.PointMassVehicle(0.5, (5.0, 3.0)), sf.CellularFlow(10.0, 4.0)
    flown = sf.simulate_flight(flow, vehicle, duration=3.0, sample_rate=50.0, seed=7)
    samples = Derivative("central")(flown)
    grid = LengthScaleGrid(2.0, 8.0, spacing="flight", fraction=0.5)
    problem = Library(grid).build(samples, vehicle)
    extent = np.ptp(samples.position, axis=0).max()
    # Lobes are 2 pi / extent wide in k: half of one at most from scale to scale.
    count = int(np.ceil((1 / 2 - 1 / 8) * extent)) + 1
    assert len(problem.group_scales) == count
    np.testing.assert_allclose(np.diff(1 / problem.group_scales), -0.375 / (count - 1))
    assert grid.resolving(extent) == LengthScaleGrid(2.0, 8.0, count=count, spacing="wavenumber")
    plain = LengthScaleGrid(2.0, 8.0)
    assert plain.resolving(extent) is plain


@pytest.mark.parametrize(
    ("changes", "words"),
    [({"step": 0.2}, "not step"), ({"count": 3}, "not step or count"), ({"fraction": 0.0}, "lobe")],
)
def test_a_grid_of_the_flight_takes_a_fraction_of_the_lobe_only(changes, words):
    with pytest.raises(InputError, match=words):
        LengthScaleGrid(2.0, 8.0, spacing="flight", **changes)


def test_a_grid_of_the_flight_has_no_scales_without_one():
    with pytest.raises(InputError, match="every flight"):
        _ = LengthScaleGrid(2.0, 8.0, spacing="flight").scales
