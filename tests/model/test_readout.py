"""Length scale and mean velocity from weights on the grid, against values worked by hand."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.special import j0

import sparsefit as sf
from sparsefit import backends
from sparsefit.errors import InputError
from sparsefit.flight.waves import WaveFlow
from sparsefit.model import LengthScaleGrid, Library, Readout, Search, read_grid
from sparsefit.model.grid import CANDIDATES, candidate_columns
from sparsefit.model.readout import (
    CandidateFlow,
    paper_mean_velocity,
    rms_mean_velocity,
    wave_peaks,
    windows,
)
from sparsefit.rows import Derivative
from tests.problems import VEHICLE, flight, fly

GRID = LengthScaleGrid(2.0, 7.0, step=0.2)
PLAIN, FLOW = Readout(), sf.CellularFlow(15.0, 4.2)


def exact_weights(speed):
    weights = np.zeros((8, 2))
    weights[CANDIDATES.index("sin x cos y"), 0] = speed
    weights[CANDIDATES.index("cos x sin y"), 1] = -speed
    return weights


def by_scale(readout, groups, weights):
    """The weights of groups, whose scales are 1, 2, ... m."""
    problem = SimpleNamespace(groups=np.array(groups), group_scales=np.arange(1.0, 2 + max(groups)))
    read = Readout(readout).by_scale(SimpleNamespace(problem=problem, weights=weights), Library())
    assert list(read) == problem.group_scales.tolist()
    return list(read.values())


def reading(method="auto", readout=PLAIN, backend="group-lasso", vehicle=VEHICLE, **library):
    samples, library = Derivative(method)(flight()), Library(GRID, **library)
    fit = sf.fit(library.build([samples], [vehicle]), backends.get(backend))
    return fit, samples, library, read_grid(fit, [samples], [vehicle], library, readout)


WEIGHTS = np.array([[3.0, -4.0], [0.0, 0.0], [5.0, -12.0], [1.0, 1.0]])


@pytest.mark.parametrize(
    ("readout", "expected", "of_cells"),
    [
        ("signed-sum", [-1.0, -7.0, 2.0], 0.0),
        ("absolute-sum", [7.0, 17.0, 2.0], 30.0),
        ("group-norm", [5.0, 13.0, np.sqrt(2.0)], 15.0 * np.sqrt(2.0)),
    ],
)
def test_scale_weights_worked_by_hand(readout, expected, of_cells):
    assert by_scale(readout, [0, 0, 1, 2], WEIGHTS) == pytest.approx(expected)
    # The cellular flow of Eq. 1 has weights U0 and -U0: Eq. 21 to the letter sums them to zero.
    assert by_scale(readout, [0] * 8, exact_weights(15.0)) == pytest.approx([of_cells])


def test_the_papers_readout_worked_by_hand_where_the_range_is_not_centred():
    # Component x: field 0, 2 -> normal -+ sqrt(2)/2; Phi 1, 3. Component y: the same, Phi 2, 2.
    field = np.array([[0.0, 0.0], [2.0, 2.0]])
    phi = np.array([[1.0, 2.0], [3.0, 2.0]])
    half = np.sqrt(2.0) / 2
    expected = {"pseudo-inverse": half * 2 / 2, "mean-ratio": (-1 + 3) / half / 4}
    for eq24, speed in expected.items():
        assert paper_mean_velocity(field, phi, eq24) == pytest.approx(speed)
        assert np.isnan(paper_mean_velocity(np.ones((4, 2)), phi[:1], eq24))  # a constant field


@pytest.mark.parametrize("method", ["auto", "weak"])
@pytest.mark.parametrize("readout", ["rms", "paper"])
def test_a_noise_free_flight_is_read_on_the_grid(method, readout):
    _, _, _, read = reading(method, Readout(mean_velocity=readout, refine="none"))
    (scale,), _ = read
    assert scale.length_scale == 4.2
    if readout == "paper":  # Eq. 22's amplitude
        assert 1.2 * 15.0 < scale.mean_velocity <= np.sqrt(2) * 15.0 * 1.001
    else:
        assert scale.mean_velocity == pytest.approx(15.0, rel=1e-4)


def test_the_velocity_is_a_refit_on_the_columns_of_the_scale():
    _, samples, _, read = reading()
    phi = samples.flow_velocity(VEHICLE)
    theta = candidate_columns(samples.position, np.array([4.2]))
    weights = np.linalg.lstsq(theta, phi, rcond=None)[0]
    assert read[0][0].mean_velocity == pytest.approx(rms_mean_velocity(weights), rel=1e-12)


@pytest.mark.parametrize(
    "readout", [{"refine": "none"}, {"mean_velocity": "paper", "refine": "variable-projection"}]
)
def test_unknown_vehicles_are_not_read_on_the_grid(readout):
    with pytest.raises(InputError, match="unknown 'response_time' is measured off the grid"):
        sf.Estimator(library=Library(GRID, unknown=("response_time",)), readout=Readout(**readout))


def test_several_scales_are_the_peaks_of_the_weights_fitted_together():
    fit, _, _, read = reading(readout=Readout(scales="several", refine="none"))
    assert read[0][0].length_scale == 4.2
    assert read[0][0].mean_velocity == pytest.approx(15.0, rel=1e-3)
    peaks = windows(fit, 0.2, (0.5, 1.5))
    assert np.pi / peaks[0][0] == pytest.approx(4.2)
    assert all(low <= k <= high for k, low, high in peaks)


@pytest.mark.parametrize(("share", "count"), [(0.03, 1), (0.08, 2)])
def test_scales_are_read_from_a_twentieth_of_the_fastest_on(share, count):
    flow = sf.flows.SuperposedFlow((FLOW, sf.CellularFlow(15.0 * share, 6.0)))
    samples, library = Derivative()(fly(flow, seed=7)), Library(GRID)
    problem = library.build([samples], [VEHICLE])
    fit = SimpleNamespace(problem=problem, weights=np.zeros((problem.columns, 2)))
    for scale, strength in ((4.2, 1.0), (6.0, 0.5)):
        fit.weights[8 * int(np.abs(problem.group_scales - scale).argmin())] = strength
    readout = Readout(scales="several", refine="none")
    assert len(read_grid(fit, [samples], [VEHICLE], library, readout)[0]) == count


def test_waves_are_read_with_their_flow():
    library = {"family": "waves", "every": 10}
    fit, samples, own, read = reading(backend="group-lasso", **library)
    assert isinstance(read[1], WaveFlow)
    (scale,) = read[0]
    assert scale.length_scale == pytest.approx(4.2, rel=0.1)
    assert scale.heading == pytest.approx(0.0, abs=0.2)
    start = Readout().start(Search.of([samples], [VEHICLE], own), fit, own)
    assert len(start.waves) >= 2
    by_scale = Readout().by_scale(fit, own)
    assert max(by_scale, key=by_scale.get) == pytest.approx(4.2, rel=0.1)


def test_a_start_is_that_of_the_nearest_lobe():
    fit, samples, library, _ = reading()
    search = Search.of([samples], [VEHICLE], library)
    start = Readout().start(search, fit, library)
    assert start.lobe == search.lobes[0]
    assert np.pi / start.lobe == pytest.approx(4.2, rel=1e-3)
    several = Readout(scales="several").start(search, fit, library)
    assert several.windows


def weighted(scales, strengths):
    """A fit whose groups have these norms: one column in use, of one target."""
    weights = np.zeros((8 * len(scales), 2))
    weights[::8, 1] = strengths
    groups = np.repeat(np.arange(len(scales)), 8)
    problem = SimpleNamespace(group_scales=np.array(scales), groups=groups)
    return SimpleNamespace(problem=problem, weights=weights)


def test_peaks_and_windows_of_a_grid():
    fit = weighted(np.arange(1.0, 8.0), [0.07, 0.01, 0.05, 0.0, 3.0, 0.5, 0.8])
    peaks = windows(fit, 1e-3, (np.pi / 7, np.pi))
    # 6 m is the flank of 7 m; 3 m is below a fiftieth
    np.testing.assert_allclose(peaks, np.pi / np.array([[5.0, 6, 4], [7, 7, 6], [1, 2, 1]]))
    assert len(windows(weighted(np.arange(1.0, 14.0), [1.0, 0.0] * 6 + [1.0]), 1e-3, (0, 9))) == 6


def test_windows_are_never_narrower_than_a_lobe_either_side():
    fit = weighted([3.0, 3.01, 3.02, 3.03, 3.04], [1.0, 2.0, 1.0, 1.5, 1.0])
    ((_, low, high),) = windows(fit, 0.1, (0.1, 3.0))
    assert (low, high) == pytest.approx((np.pi / 3.01 - 0.1, np.pi / 3.01 + 0.1))


@pytest.mark.parametrize("key", ["length_scale", "mean_velocity", "eq24"])
def test_unknown_readouts_are_refused(key):
    with pytest.raises(InputError, match=f"readout {key}"):
        Readout(**{key: "pseudo"})


def test_candidates_are_a_flow_anywhere():
    flow = sf.CellularFlow(15.43, 4.21)
    k, weights = np.array([math.pi / flow.length_scale]), exact_weights(15.43)
    own = CandidateFlow(k, weights[None], np.array([4.21, 8.42]) * 2)
    x, y = np.random.default_rng(1).uniform(-9, 9, (2, 8, 5))
    np.testing.assert_allclose(own.velocity(x, y), flow.velocity(x, y), atol=1e-12)
    assert rms_mean_velocity(weights) == pytest.approx(15.43)


def test_the_rms_is_that_over_the_cell():
    weights = np.random.default_rng(4).normal(size=(8, 2))
    axis = np.linspace(0, 2 * np.pi, 64, endpoint=False)
    cell = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    speed = np.linalg.norm(candidate_columns(cell, np.array([np.pi])) @ weights, axis=1)
    assert rms_mean_velocity(weights) == pytest.approx(np.sqrt(2 * np.mean(speed**2)), rel=1e-12)


def test_a_wave_between_those_of_a_grid_is_one_peak_at_its_place():
    """The weights of neighbours fall as the sums over a disc of positions do."""
    step = math.pi / 20.0
    axis = step * np.arange(-8, 9)
    k = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    k = k[(k[:, 1] > 0) & (np.hypot(*k.T) > 0.3)]
    true = np.array([0.9, 0.45])
    share = j0(10.0 * np.linalg.norm(k - true, axis=1)) ** 2
    weights = np.column_stack([share, np.zeros(len(k))]) / np.hypot(*k.T)[:, None]
    tops, peaks = wave_peaks(k, weights, 20.0, 5)
    assert np.linalg.norm(peaks[0] - true) < 0.3 * step
    assert tops[0] == share.argmax()
    assert len(wave_peaks(k, 0 * weights, 20.0, 5)[0]) == 0
