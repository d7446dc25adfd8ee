"""The search: the shape that was flown is proposed first, near its place, and no freer one."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from sparsefit.errors import InputError
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.flight.waves import WaveFlow
from sparsefit.model import LengthScaleGrid, Library, Search, Start, flight_weights, propose
from sparsefit.model import search as room
from sparsefit.model.ladder import Ladder
from sparsefit.model.shapes import (
    AXIS,
    PAIR,
    RECTANGLE,
    SQUARE,
    Shape,
    axis_cells,
    fitted,
    free_waves,
)
from sparsefit.rows import Derivative, Samples
from tests.problems import fly

TIME = np.linspace(0, 12, 300)
TRACK = np.column_stack(
    [14 * np.sin(0.61 * TIME) + 1.7 * TIME, 11 * np.cos(0.83 * TIME) - 0.9 * TIME]
)
VEHICLE = PointMassVehicle(0.5)
LIBRARY = Library(LengthScaleGrid(2.5, 6.0))


def samples_of(flow, noise, memory=0.0, seed=11):
    """Samples of a track on which Phi is a flow and errors with a memory, per sample."""
    errors = np.random.default_rng(seed).standard_normal(TRACK.shape)
    for row in range(1, len(errors)):
        errors[row] += memory * errors[row - 1]
    phi = flow.velocity(*TRACK.T, TIME) + noise * errors
    velocity = np.gradient(TRACK, TIME, axis=0)
    return Samples(TIME, TRACK, velocity, velocity, (phi - velocity) / 0.5)


def flow_of(shape, q, weights=(1.0, 0.4, -0.4, 1.0)):
    phases = shape.phases(np.array(q, dtype=float))[0]
    a, b = np.reshape(weights, (-1, 2)).T
    return WaveFlow(phases[:, :2], a, b, phases[:, 2])


def proposed(shape, q, weights=(1.0, 0.4, -0.4, 1.0), noise=0.05, start=None, **errors):
    flow = flow_of(shape, q, weights)
    search = Search.of([samples_of(flow, noise, **errors)], [VEHICLE], LIBRARY)
    return flow, propose(search, start or Start())


CASES = {
    "axis": (AXIS, (0.9,)),
    "square": (SQUARE, (0.9, 0.4)),
    "rectangle": (RECTANGLE, (0.8, 1.0, -0.3)),
    "drifting": (AXIS.moving, (0.9, 0.3, 0.6)),
    "pair": (PAIR, (1.0, 0.3, -0.2, 0.7)),
}


@pytest.mark.parametrize("name", CASES)
def test_the_shape_that_was_flown_is_proposed_first_at_its_place(name):
    shape, q = CASES[name]
    weights = (1.0, 0.4, 0.9, -1.5) if name == "pair" else (1.0, 0.4, -0.4, 1.0)
    flow, proposals = proposed(shape, q, weights)
    best = proposals[0]
    assert (best.shape, best.velocity is not None) == (shape.name, shape.drifting)
    assert best.residual < 0.05
    reach = math.pi / np.ptp(TRACK, axis=0).max()
    for wave in flow.wavevectors:
        apart = [np.linalg.norm(sign * best.wavevectors - wave, axis=1) for sign in (1, -1)]
        assert np.min(apart) < 0.03 * reach
    assert best.cells.mean_velocity == pytest.approx(flow.mean_velocity, rel=0.02)
    frequencies = None if best.velocity is None else best.wavevectors @ best.velocity
    waves = WaveFlow(best.wavevectors, best.cosine, best.sine, frequencies)
    truth, own = (f.velocity(*TRACK.T, TIME) for f in (flow, waves))
    assert np.sum((truth - own) ** 2) < 2e-3 * np.sum(truth**2)


def test_coloured_noise_is_no_reason_for_more_waves():
    _, proposals = proposed(AXIS, (0.9,), noise=0.15, memory=0.97)
    assert proposals[0].shape == "axis"
    assert all(other.shape != "several" for other in proposals)


def test_what_another_shape_explains_as_well_is_proposed_beside_it():
    _, proposals = proposed(AXIS.moving, (0.9, 0.05, 0.05), noise=1.0)
    assert {p.velocity is None for p in proposals if p.shape == "axis"} == {True, False}
    gaps = np.diff([p.bic for p in proposals])
    assert (gaps >= 0).all()
    kinds = [(p.shape, p.velocity is None) for p in proposals if p.bic - proposals[0].bic > 10.0]
    assert len(set(kinds)) == len(kinds)


def test_variable_projection_is_steady_cells_along_the_axes():
    _, proposals = proposed(SQUARE, (0.9, 0.4), start=Start("variable-projection", 0.9))
    assert {p.shape for p in proposals} == {"axis"}
    assert all(p.velocity is None for p in proposals)


def test_waves_of_a_back_end_are_joined_and_moved():
    start = Start(waves=((0.62, 1.1), (-1.12, 0.6), (0.3, 0.3)))
    _, proposals = proposed(SQUARE, (0.9, 0.4), start=start)
    assert proposals[0].shape == "square"
    start = Start("variable-projection", waves=start.waves)
    _, proposals = proposed(SQUARE, (0.9, 0.4), start=start)
    assert len(proposals[0].wavevectors) == 2


@pytest.mark.parametrize(("speed", "noise"), [(0.0, True), (0.5, True), (0.6, False)])
def test_errors_are_noise_up_to_a_wave_that_chance_may_show(speed, noise):
    """Among white errors of 1 m/s; speed: the rms of the wave's own."""
    search = Search.of([samples_of(flow_of(AXIS, (0.9,)), 0.05)], [VEHICLE], LIBRARY)
    errors = np.random.default_rng(1).normal(size=search.rows.rest.shape)
    wave = flow_of(free_waves(1), (1.4, -0.3), (1.0, 0.0)).velocity(*search.rows.place[:, :2].T)
    assert search.quiet(errors + speed * wave / np.sqrt(np.mean(wave**2))) == noise


def test_several_length_scales_come_from_their_windows():
    flow = flow_of(axis_cells(2), (0.8, 1.15), (1.0, 0.4, -0.4, 1.0, 0.6, 0.2, 0.2, 0.6))
    search = Search.of([samples_of(flow, 0.05)], [VEHICLE], LIBRARY)
    windows = ((0.8, 0.7, 0.9), (1.1, 1.0, 1.25), (0.6, 0.55, 0.65))
    (best,) = propose(search, Start(windows=windows))
    assert best.shape == "scales"
    np.testing.assert_allclose(best.wavevectors[::2, 0], [0.8, 1.15], rtol=2e-3)
    np.testing.assert_allclose(np.abs(best.wavevectors[1::2]), np.abs(best.wavevectors[::2]))
    first, *_ = propose(search, Start())
    assert first.shape == "scales"
    assert np.sort(first.wavevectors[::2, 0]) == pytest.approx([0.8, 1.15], rel=2e-3)


def test_waves_are_proposed_where_the_rows_do_not_exclude_them():
    search = Search.of([samples_of(flow_of(PAIR, (0.9, 0.8, 0.7, -1.0)), 0.05)], [VEHICLE], LIBRARY)
    pair = next(own for own in propose(search, Start()) if own.shape == "pair")
    near, far = (np.column_stack([s * pair.wavevectors, [0.0, 0.0]]) for s in (1.0001, 1.2))
    assert search.proposed_at(pair, near).wavevectors == pytest.approx(near[:, :2])
    assert search.proposed_at(pair, far) is None


def test_unknown_vehicles_are_linear_columns_of_the_rows():
    flow, vehicle = flow_of(AXIS, (0.9,)), PointMassVehicle(0.4, (2.0, -1.0))
    flight = fly(flow, vehicle, duration=20.0, rate=50.0)
    believed = PointMassVehicle(0.5, (2.0, -1.0))
    library = Library(LIBRARY.grid, unknown=("response_time", "wind"))
    search = Search.of([Derivative()(flight)], [believed], library)
    best = propose(search, Start())[0]
    assert best.shape == "axis"
    assert best.vehicles[0].response_time == pytest.approx(0.4, rel=0.01)
    assert best.background == pytest.approx((0.0, 0.0), abs=0.05)
    assert best.cells.mean_velocity == pytest.approx(flow.mean_velocity, rel=0.02)


def test_flights_through_one_flow_are_weighed_by_their_noise():
    flow = flow_of(AXIS, (0.9,))
    flights = [samples_of(flow, 0.05, seed=1), samples_of(flow, 0.5, seed=2).rows(slice(150))]
    weights = flight_weights(flights, [VEHICLE] * 2, LIBRARY)
    assert weights[0] / weights[1] == pytest.approx(10.0, rel=0.3)
    assert np.average(np.square(weights), weights=[300, 150]) == pytest.approx(1.0)
    assert flight_weights(flights[:1], [VEHICLE], LIBRARY) == (1.0,)
    both = Search.of(flights, [VEHICLE] * 2, LIBRARY, weights)
    assert propose(both, Start())[0].shape == "axis"


def test_a_flight_without_noise_weighs_a_thousand_times_as_much_at_most(monkeypatch):
    def exact(rows, *_):
        return SimpleNamespace(rest=np.repeat([[0.0], [1.0]], len(rows.weight) // 2, axis=0))

    monkeypatch.setattr(room, "fitted", exact)
    weights = flight_weights([samples_of(flow_of(AXIS, (0.9,)), 0.05)] * 2, [VEHICLE] * 2, LIBRARY)
    assert weights == pytest.approx((math.sqrt(2.0), 1e-3 * math.sqrt(2.0)), rel=1e-5)


@pytest.mark.parametrize(
    ("gains", "lobes"),
    [
        ((1.0, 3.0, 2.0, 0.0, 0.0), [1.0 + 0.1 / 6]),  # 3 + q/2 - 3 q^2/2 at steps q of 0.1
        ((0.0, 5.0, 5.0, 5.0, 0.0), [1.05, 1.1, 1.15]),  # a plateau: its ends half a step in
        ((2.0, 0.0, 0.0, 0.0, 3.0), [1.3, 0.9]),  # no farther than the bounds
    ],
)
def test_lobes_are_the_tops_of_parabolas(gains, lobes, monkeypatch):
    k = 0.9 + 0.1 * np.arange(5)
    monkeypatch.setattr(room, "axis_gains", lambda *_: (k, np.array(gains)))
    own = SimpleNamespace(rows=None, bounds=(0.9, 1.3))
    np.testing.assert_allclose(Search.line(own, None), lobes)


def test_a_shape_is_tried_again_only_where_it_comes_near_its_own_best(monkeypatch):
    search = Search.of([samples_of(flow_of(AXIS, (0.9,)), 0.05)], [VEHICLE], LIBRARY)
    ladder = Ladder(search)
    assert ladder.descend(AXIS, np.array([0.91])) is not None
    assert ladder.descend(AXIS, np.array([0.6])) is None
    assert ladder.descend(SQUARE, np.array([1.1, 0.3])) is not None  # the first of its kind
    there = fitted(search.rows, PAIR, np.array([0.9, 0.9, 0.9, -0.9]))
    ladder.tried = [there, fitted(search.rows, PAIR, -there.q)]  # waves of either sign are equal
    assert [fit for fit, _ in ladder.ranked()] == [there]
    monkeypatch.setattr(Search, "possible", lambda *_: False)
    ladder.tried = []
    ladder.lines(0.9)  # of which none is plausible: the deepest lobe as it is
    assert [fit.q.tolist() for fit in ladder.tried] == [search.lobes[:1].tolist()]


def test_waves_that_are_joined_keep_their_drift():
    shape, q = PAIR.moving, (1.0, 0.3, -0.2, 0.7, 0.3, 0.6)
    flow = flow_of(shape, q, (1.0, 0.4, 0.9, -1.5))
    search = Search.of([samples_of(flow, 0.05)], [VEHICLE], LIBRARY)
    first = fitted(search.rows, free_waves(1, drifting=True), np.array([1.0, 0.3, 0.3, 0.6]))
    both = Ladder(search).with_waves(first, np.array([[1.01, 0.3], [-0.2, 0.69]]))
    np.testing.assert_allclose(both.q, q, atol=5e-3)


def test_a_flight_that_rests_or_is_too_long_is_refused_at_once():
    flow = flow_of(AXIS, (0.9,))
    samples = samples_of(flow, 0.0)
    resting = Samples(TIME, np.ones_like(TRACK), TRACK, TRACK, TRACK)
    hopping = replace(resting, position=np.tile([[0.0, 0.0], [1.0, 1.0]], (150, 1)))
    for still in (resting, hopping):  # between two places, of which every other row is one
        with pytest.raises(InputError, match="does not move"):
            Search.of([still], [VEHICLE], LIBRARY)
    far = Samples(TIME, 1e4 * TRACK, samples.velocity, samples.velocity, samples.acceleration)
    with pytest.raises(InputError, match="too many lobes; check units, or raise the lower bound"):
        Search.of([far], [VEHICLE], LIBRARY)


@pytest.mark.parametrize("heading", [0.3, -0.7, 1.2, 2.9, -2.2])
def test_any_two_waves_of_a_rectangle_lead_back_to_it(heading):
    phases = RECTANGLE.moving.phases(np.array([0.8, 0.5, heading, 0.7, -0.2]))[0]
    for waves in (phases, -phases, phases[::-1], phases * [[1], [-1]]):
        q = RECTANGLE.moving.nearest(waves)
        assert -math.pi / 4 < q[2] <= math.pi / 4
        again = RECTANGLE.moving.phases(q)[0]
        same = [np.abs(again - sign * phases[order]).max(axis=1)
                for sign in (1, -1) for order in ([0, 1], [1, 0])]  # fmt: skip
        assert np.min(same, axis=0).max() < 1e-12


SHAPES = (AXIS, SQUARE.moving, RECTANGLE, RECTANGLE.moving, PAIR.moving, axis_cells(2))


@pytest.mark.parametrize("shape", [*SHAPES, free_waves(3)], ids=lambda shape: shape.name)
def test_derivatives_of_phases_are_differences(shape: Shape):
    q = np.random.default_rng(2).uniform(0.5, 1.5, shape.parameters)
    phases, slopes = shape.phases(q)
    assert phases.shape == (len(shape.waves), 3)
    for number, slope in enumerate(slopes):
        step = 1e-6 * np.eye(len(q))[number]
        expected = (shape.phases(q + step)[0] - shape.phases(q - step)[0]) / 2e-6
        np.testing.assert_allclose(slope, expected, atol=1e-8)


def test_amplitudes_are_those_of_the_vehicles_that_fit_best():
    flow = flow_of(AXIS, (0.9,))
    vehicles = [PointMassVehicle(0.5), PointMassVehicle(0.3)]
    believed = [PointMassVehicle(0.6), PointMassVehicle(0.4)]
    flights = [
        Derivative()(fly(flow, own, duration=15.0, rate=50.0, seed=seed))
        for seed, own in enumerate(vehicles)
    ]
    library = Library(LIBRARY.grid, unknown=("response_time",))
    proposals = propose(Search.of(flights, believed, library), Start())
    # Rows of one amplitude fit two vehicles only to first order, and so may prefer freer shapes.
    best = next(p for p in proposals if p.shape == "axis" and p.velocity is None)
    assert best.cells.mean_velocity == pytest.approx(flow.mean_velocity, rel=0.03)
    assert [v.response_time for v in best.vehicles] == pytest.approx([0.5, 0.3], rel=0.1)


def test_nothing_is_proposed_where_nothing_is_to_be_explained():
    velocity = np.gradient(TRACK, TIME, axis=0)
    still = Samples(TIME, TRACK, velocity, velocity, -velocity / 0.5)
    assert propose(Search.of([still], [VEHICLE], LIBRARY), Start()) == ()
    few = samples_of(flow_of(AXIS, (0.9,)), 0.0).rows(slice(None, None, 150))
    assert len(propose(Search.of([few], [VEHICLE], LIBRARY), Start())) <= 10
