"""The descent: weights, residuals and moves against least squares and differences; the scans."""

import math
from itertools import permutations

import numpy as np
import pytest
from scipy.ndimage import maximum_filter

from sparsefit.flight.waves import WaveFlow
from sparsefit.model.scan import WaveScan, axis_gains, fourier_sums, peaks
from sparsefit.model.shapes import (
    AXIS,
    END,
    PAIR,
    SQUARE,
    FlowRows,
    descended,
    fitted,
    flows_of,
    free_waves,
    joined,
    orthonormal,
    read_cells,
)

RNG = np.random.default_rng(5)
TIME = np.linspace(-6, 6, 300)
PLACE = np.column_stack([9 * np.sin(0.9 * TIME) + TIME, 8 * np.cos(0.7 * TIME), TIME])
NOTHING, ONES = np.zeros((300, 2, 0)), np.ones(300)


def wave_columns(place, phases):
    """Columns (2 J, m, 2) of waves (J, 3), psi = cos before psi = sin, at (x, y, t) (m, 3)."""
    one = np.eye(2)
    return np.stack(
        [
            WaveFlow(wave[None, :2], a, b, wave[2:]).velocity(*place.T)
            for wave in phases
            for a, b in zip(one[:, :1], one[:, 1:], strict=True)
        ]
    )


def rows_of(shape, q, weights=(1.0, 0.3, -0.2, 1.0), noise=0.0, unknowns=NOTHING, weight=ONES):
    columns = wave_columns(PLACE, shape.phases(np.array(q))[0])
    flow = np.tensordot(np.array(weights), columns, axes=1)
    flow = flow + noise * RNG.standard_normal(flow.shape)
    return FlowRows(PLACE, weight[:, None] * flow, unknowns * weight[:, None, None], weight)


def rows_at(place):
    return FlowRows(
        place, np.zeros((len(place), 2)), np.zeros((len(place), 2, 0)), np.ones(len(place))
    )


@pytest.mark.parametrize("weight", [ONES, RNG.uniform(0.5, 2.0, 300)], ids=["plain", "weighted"])
@pytest.mark.parametrize("unknown", [0, 3])
def test_a_fit_is_joint_least_squares_and_its_move_that_of_gauss_newton(weight, unknown):
    unknowns = RNG.standard_normal((300, 2, unknown))
    rows = rows_of(PAIR, (1.0, 0.3, -0.2, 0.9), (1, 0.4, 0.9, -1.5), 0.1, unknowns, weight)
    q = np.array([1.0, 0.31, -0.21, 0.9])
    fit = fitted(rows, PAIR, q)

    def design(at):
        columns = wave_columns(PLACE, PAIR.phases(at)[0])
        flat = (columns * weight[:, None]).reshape(4, -1).T
        return np.hstack([flat, rows.unknowns.reshape(600, -1)])

    def rest(at):
        solution = np.linalg.lstsq(design(at), rows.target.ravel(), rcond=None)[0]
        return solution, rows.target.ravel() - design(at) @ solution

    solution, left = rest(q)
    np.testing.assert_allclose(fit.weights, solution[:4], rtol=1e-7)
    np.testing.assert_allclose(fit.coefficients, solution[4:], atol=1e-7)
    np.testing.assert_allclose(fit.rest.ravel(), left, atol=1e-9)
    # Kaufman's step: the flow's derivative at fixed weights, projected off all columns.
    steps = 1e-6 * np.eye(4)
    bent = np.stack([(design(q + s) - design(q - s)) @ solution / 2e-6 for s in steps], axis=1)
    basis = np.linalg.qr(design(q))[0]
    side = bent - basis @ (basis.T @ bent)
    expected = np.linalg.lstsq(side, left, rcond=None)[0]
    np.testing.assert_allclose(fit.move, expected, rtol=1e-4, atol=1e-9)


def test_a_descent_ends_where_the_flow_is():
    rows = rows_of(SQUARE.moving, (0.9, 0.4, 0.5, -0.3))
    fit = descended(rows, SQUARE.moving, np.array([0.93, 0.37, 0.4, -0.2]))
    np.testing.assert_allclose(fit.q, [0.9, 0.4, 0.5, -0.3], atol=1e-4)
    assert fit.residual < 1e-6 * rows.square
    hopeless = descended(rows, AXIS, np.array([0.5]), goal=0.0)
    assert hopeless.residual > 0.5 * rows.square


def test_pieces_catch_from_farther_away():
    rows = rows_of(free_waves(1), (0.9, 0.4), (1.0, 0.5))
    start = np.array([0.9, 0.4]) + 1.6 * math.pi / np.ptp(PLACE[:, 0])
    alone = descended(rows, free_waves(1), start)
    followed = descended(rows, free_waves(1), joined(rows, free_waves(1), start, 4))
    reach = END * math.pi / np.ptp(PLACE[:, 0])  # where a descent ends
    np.testing.assert_allclose(followed.q, [0.9, 0.4], atol=2 * reach)
    assert alone.residual > 0.3 * rows.square


def test_columns_that_are_combinations_are_dropped_by_one_rule():
    columns = RNG.standard_normal((50, 3))
    both = np.hstack([columns, columns @ [[1.0], [2.0], [-1.0]]])
    basis = orthonormal(both.T @ both)
    used = basis.any(axis=0)
    assert used.sum() == 3
    basis = basis[:, used]
    np.testing.assert_allclose((both @ basis).T @ (both @ basis), np.eye(3), atol=1e-10)
    assert orthonormal(np.zeros((0, 0))).shape == (0, 0)


@pytest.mark.parametrize("dimensions", [1, 2, 3])
@pytest.mark.parametrize("most_single", [2048, 0])
def test_fourier_sums_are_sums(dimensions, most_single):
    place = PLACE[:, :dimensions]
    step, half = np.full(dimensions, 0.11), (4, 3, 2)[:dimensions]
    loads = RNG.standard_normal((2, 300))
    axes = [0.11 * np.arange(-n, n + 1) for n in half]
    k = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    for times in (1, 2):
        expected = np.moveaxis(np.exp(1j * times * (k @ place.T)) @ loads.T, -1, 0)
        sums = fourier_sums(place, step, half, loads, times=times, most_single=most_single)
        np.testing.assert_allclose(sums, expected, atol=300 * 3e-4)


def explained(k, rest):
    """The fall of RSS by one wave beside a wind, by least squares."""
    columns = wave_columns(PLACE * (1, 1, 0), np.array([[*k, 0.0]])).reshape(2, -1).T
    winds = np.tile(np.eye(2), (300, 1))
    moved = (rest - rest.mean(axis=0)).ravel()
    design = np.hstack([columns, winds])
    left = moved - design @ np.linalg.lstsq(design, moved, rcond=None)[0]
    return moved @ moved - left @ left


def test_gains_are_those_of_least_squares():
    scan = WaveScan.of(rows_at(PLACE), (0.3, 2.0))
    rest = RNG.standard_normal((300, 2))
    gains, omega = scan.gains(rest)
    assert not omega.any()
    for i, j in ((0, 3), (9, 8), (12, 4)):
        k = scan.axis[[i, j]]
        inside = 0.3 <= np.hypot(*k) <= 2.0
        assert gains[i, j] == pytest.approx(explained(k, rest) if inside else 0.0, rel=2e-3)
    k, line = axis_gains(rows_at(PLACE), rest, (0.4, 1.5))
    for place in (3, 30, 44):
        pair = [explained((k[place], sign * k[place]), rest) for sign in (1, -1)]
        assert line[place] == pytest.approx(sum(pair), rel=2e-2)


def test_squares_are_seen_where_they_are():
    rows = rows_of(SQUARE, (1.1, 0.3))
    scan = WaveScan.of(rows, (0.3, 3.0))
    seen = scan.axis[scan.squares(scan.gains(rows.rest)[0], 1)[0]]
    waves = SQUARE.phases(np.array([1.1, 0.3]))[0][:, :2]
    apart = min(np.abs(s * wave - seen).max() for wave in waves for s in (1, -1))
    assert apart < 0.75 * scan.steps[0]


def test_a_wave_that_drifts_is_seen_in_pieces():
    shape = free_waves(1, drifting=True)
    drift = 1.7 * np.array([1.2, -0.5]) / 1.69
    rows = rows_of(shape, (1.2, -0.5, *drift), (1.0, 0.5))
    scan = WaveScan.of(rows, (0.3, 2.0), 3.0)
    assert scan.pieces >= 4
    gains, omega = scan.gains(rows.rest)
    assert 0.0 == gains.min() < 0.6 * rows.square < gains.max() < 1.1 * rows.square
    i, j = np.unravel_index(np.argmax(gains), gains.shape)
    seen = np.array([*scan.axis[[i, j]], omega[i, j]])
    apart = [np.abs((s * np.array([1.2, -0.5, 1.7]) - seen) / scan.steps).max() for s in (1, -1)]
    assert min(apart) < 1.0


def test_long_tracks_are_scanned_in_pieces_or_not_at_all():
    long = PLACE * [60.0, 60.0, 1.0]
    scan = WaveScan.of(rows_at(np.repeat(long, 20, axis=0)), (0.3, 4.4))
    assert scan.pieces > 1
    assert WaveScan.of(rows_at(1e3 * PLACE), (0.1, 4.4)) is None


@pytest.mark.parametrize("dimensions", [1, 2])
def test_peaks_are_above_their_neighbours_highest_first(dimensions):
    values = RNG.uniform(0.1, 1.0, (40,) * dimensions)
    tops = peaks(values)
    expected = np.argwhere(values == maximum_filter(values, 3, mode="constant"))
    np.testing.assert_array_equal(sorted(tops.tolist()), expected)
    assert (np.diff(values[tuple(tops.T)]) <= 0).all()
    assert len(peaks(values, 3)) == 3
    assert len(peaks(np.zeros((5,) * dimensions))) == 0


def test_waves_are_read_by_hand():
    # L_x = 2, L_y = 4, turned by 0.3: k = pi (1/2, +-1/4) in the cells' own axes
    turn = np.array([[math.cos(0.3), math.sin(0.3)], [-math.sin(0.3), math.cos(0.3)]])
    k = math.pi * np.array([[0.5, 0.25], [0.5, -0.25]]) @ turn
    cells = read_cells(k, np.array([[3.0, 4.0], [0.0, -5.0]]))
    assert cells.length_scales == pytest.approx((2.0, 4.0))
    assert cells.heading == pytest.approx(0.3)
    square = math.pi**2 * (0.25 + 0.0625)
    assert cells.mean_velocity == pytest.approx(math.sqrt(2 * 25 * square))
    assert cells.length_scale == pytest.approx(math.pi * math.sqrt(2 / square))
    slow = 0.1 * math.pi * np.eye(2)
    both = read_cells(np.vstack([slow, k]), np.array([[1.0, 0], [0, 1.0], [3.0, 4.0], [0, -5.0]]))
    assert both.length_scales == cells.length_scales
    assert both.mean_velocity == cells.mean_velocity
    alone = read_cells(k[:1], np.ones((1, 2)))
    assert math.isnan(alone.heading)


@pytest.mark.parametrize(
    ("headings", "lengths", "sizes", "pairs"),
    [
        # lengths and sizes that differ by an eighth, at angles of 60 degrees
        ((0.0, 60.0, 30.0, 90.0), (1.0, 1.1, 2.0, 2.0), (3.0, 2.9, 1.1, 1.0), {(0, 1), (2, 3)}),
        ((0.0, 45.0, 90.0, 135.0), (1.0,) * 4, (1.0,) * 4, {(0, 2), (1, 3)}),  # all alike
        ((0.0, 90.0, 10.0, 100.0), (1.0, 1.0, 2.0, 2.0), (1.2, 1.0, 5.0, 5.0), {(0, 1), (2, 3)}),
        ((0.0, 90.0, 10.0, 100.0), (1.0, 1.0, 2.0, 2.0), (1.25, 1.0, 5.0, 5.0), {(0, 1, 2, 3)}),
    ],
)
def test_two_flows_of_cells_are_pairs_of_like_waves(headings, lengths, sizes, pairs):
    """In whatever order the waves are; sizes of a pair may differ by exp(0.2)."""
    turns = np.radians(headings)
    waves = np.array(lengths)[:, None] * np.column_stack([np.cos(turns), np.sin(turns)])
    amplitudes = np.outer(sizes, [0.6, -0.8])
    for order in permutations(range(4)):
        flows = flows_of(waves[list(order)], amplitudes[list(order)])
        assert {tuple(sorted(order[i] for i in flow)) for flow in flows} == pairs
