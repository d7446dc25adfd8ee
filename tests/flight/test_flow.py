"""Flows against their stream functions, by hand, each other and the theory of turbulence."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from sparsefit.flight import simulate_flight
from sparsefit.flight.flow import CellularFlow, ShapedCells, SuperposedFlow
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.flight.waves import Flow, Turbulence, WaveFlow

PLAIN = CellularFlow(6.0, 4.0)
WAVES = WaveFlow([[1.0, 0.5], [-0.3, 0.8]], [0.4, -1.0], [0.2, 0.5], frequencies=[0.3, -0.2])
KINDS = {
    "turned": ShapedCells(6.0, 4.0, heading=0.3),
    "stretched": ShapedCells(6.0, (4.0, 5.0)),
    "rhombic": ShapedCells(6.0, (4.0, 4.0), heading=-0.2, angle=1.0, offset=(1.0, 0.4)),
    "moving": ShapedCells(6.0, (4.0, 5.0), drift=(0.7, -0.3), swell=0.2, swell_period=7.0),
    "waves": WAVES,
    "turbulence": Turbulence(1.5, 5.0, memory=3.0, seed=4),
}
FLOWS = {
    **KINDS,
    "sum": SuperposedFlow((PLAIN, *KINDS.values()), wind=(0.5, -1.0)),
    "square": CellularFlow(4.0, 4.0),
    "fast": CellularFlow(84.2, 4.21),
    "two": SuperposedFlow((CellularFlow(15.43, 4.21), CellularFlow(3.0, 1.7))),
    "windy": SuperposedFlow((CellularFlow(15.43, 4.21),), (4.0, -1.0)),
}
PLACES = np.random.default_rng(8).uniform(-15.0, 15.0, (50, 2)).T


def psi(waves, x, y, t):
    phase = np.multiply.outer(x, waves.wavevectors[:, 0])
    phase = phase + np.multiply.outer(y, waves.wavevectors[:, 1]) - waves.frequencies * t
    return np.cos(phase) @ waves.cosine + np.sin(phase) @ waves.sine


@pytest.mark.parametrize("name", KINDS)
def test_velocity_is_the_turned_gradient_of_the_stream_function(name):
    flow, (x, y), t, h = KINDS[name], PLACES, 1.7, 1e-5
    waves = getattr(flow, "waves", flow)
    level = 1.0 + flow.swell * math.sin(2 * math.pi * t / 7.0) if name == "moving" else 1.0
    u = level * (psi(waves, x, y + h, t) - psi(waves, x, y - h, t)) / (2 * h)
    v = -level * (psi(waves, x + h, y, t) - psi(waves, x - h, y, t)) / (2 * h)
    np.testing.assert_allclose(flow.velocity(x, y, t), np.stack([u, v], axis=-1), atol=2e-7)


@pytest.mark.parametrize("name", FLOWS)
def test_one_point_on_plain_floats_is_the_velocity_there(name):
    flow = FLOWS[name]
    at = flow.formula(math)
    given = [at(x, y, 3.5) for x, y in PLACES.T.tolist()]
    np.testing.assert_allclose(given, flow.velocity(*PLACES, 3.5), atol=1e-11)


X, Y = PLACES
TURN = np.array([[math.cos(0.3), -math.sin(0.3)], [math.sin(0.3), math.cos(0.3)]])
SWELL = {"swell": 0.2, "swell_period": 8.0}  # a quarter of it from the phase 0: 1 + 0.2


@pytest.mark.parametrize(
    ("changes", "time", "expected"),
    [
        ({}, 9.0, PLAIN.velocity(X, Y, 9.0)),
        ({"heading": 0.3}, 0.0, PLAIN.velocity(*(TURN.T @ PLACES)) @ TURN.T),
        ({"offset": (1.0, -0.5), "drift": (0.7, 0.2)}, 3.0, PLAIN.velocity(X - 3.1, Y - 0.1)),
        (SWELL, 2.0, 1.2 * PLAIN.velocity(X, Y)),
        (SWELL | {"swell_phase": -math.pi / 2}, 0.0, 0.8 * PLAIN.velocity(X, Y)),
    ],
)
def test_square_cells_are_the_cellular_flow_turned_moved_and_swollen(changes, time, expected):
    found = ShapedCells(6.0, 4.0, **changes).velocity(X, Y, time)
    np.testing.assert_allclose(found, expected, atol=1e-13)


def test_walls_of_a_rhombic_cell_are_where_no_flow_crosses():
    # p = pi/4 (1, 0), q = pi/4 (1, sqrt 3)/2: x = 4 is a wall, and so is x + sqrt(3) y = 8
    # k = p - q and p + q are at -60 and 30 degrees: -15 degrees halve their angle
    cells = ShapedCells(6.0, 4.0, angle=math.pi / 3, heading=-math.pi / 12)
    along = np.linspace(-5.0, 5.0, 11)
    np.testing.assert_allclose(cells.velocity(4.0, along)[:, 0], 0.0, atol=1e-13)
    normal = np.array([0.5, math.sqrt(3) / 2])
    across = cells.velocity(8.0 - math.sqrt(3) * along, along) @ normal
    np.testing.assert_allclose(across, 0.0, atol=1e-12)


@pytest.mark.parametrize("name", ["turned", "stretched", "rhombic"])
def test_heading_halves_the_angle_and_mean_velocity_is_the_root_of_twice_the_mean_square(name):
    flow = KINDS[name]
    directions = [math.atan2(*k[::-1]) for k in flow.waves.wavevectors]
    turned = math.remainder(sum(directions) / 2 - flow.heading, math.pi / 2)
    assert turned == pytest.approx(0.0, abs=1e-14)
    # one period of the lattice: p.x and q.x from 0 to 2 pi
    p = (flow.waves.wavevectors[0] + flow.waves.wavevectors[1]) / 2
    q = (flow.waves.wavevectors[1] - flow.waves.wavevectors[0]) / 2
    share = np.arange(24) / 24 * 2 * math.pi
    phases = np.stack(np.meshgrid(share, share)).reshape(2, -1)
    x, y = np.linalg.solve(np.stack([p, q]), phases)
    mean_square = np.mean(np.sum(flow.velocity(x, y) ** 2, axis=-1))
    assert math.sqrt(2 * mean_square) == pytest.approx(6.0, rel=1e-12)
    assert flow.waves.mean_velocity == pytest.approx(6.0, rel=1e-12)


def test_length_scale_of_shapes():
    assert KINDS["turned"].length_scale == pytest.approx(4.0, rel=1e-14)
    # |k|^2 = pi^2 (1/16 + 1/25) for both waves
    expected = math.sqrt(2 / (1 / 16 + 1 / 25))
    assert KINDS["stretched"].length_scale == pytest.approx(expected, rel=1e-14)
    assert KINDS["stretched"].timescale == pytest.approx(expected / 6.0, rel=1e-14)
    assert KINDS["stretched"].period == 10.0
    assert CellularFlow(15.0, 3.0).timescale == pytest.approx(0.2, rel=1e-15)
    assert WaveFlow([[0.0, 2.0]], [1.0], [0.0]).mean_velocity == 2.0


def test_sums_name_their_cells():
    turned, gusts = KINDS["turned"], KINDS["turbulence"]
    both = SuperposedFlow((PLAIN, gusts, turned))
    assert both.cells == (PLAIN, turned)
    assert both.period == 8.0
    assert both.mean_velocity == pytest.approx(math.hypot(6.0, 6.0, 3.0))
    assert SuperposedFlow((gusts,)).period == gusts.period
    nested = SuperposedFlow((SuperposedFlow((PLAIN, gusts)), turned))
    assert nested.cells == both.cells
    np.testing.assert_allclose(nested.velocity(X, Y, 1.0), both.velocity(X, Y, 1.0), atol=1e-13)


class Shear(Flow):
    """A flow of a reader's own: u = 5 sin(pi y/4)."""

    period = 8.0

    def formula(self, functions):
        return lambda x, y, t: (5.0 * functions.sin(math.pi * y / 4.0) + 0.0 * x, 0.0 * y)


def test_a_flow_of_ones_own_has_a_formula_and_a_period_and_can_be_summed():
    vehicle, wave = PointMassVehicle(0.5), WaveFlow([[0.0, math.pi / 4]], [-20.0 / math.pi], [0.0])
    options = {"duration": 1.0, "sample_rate": 50.0, "seed": 3}
    for own, twin in ((Shear(), wave), *((SuperposedFlow((f, PLAIN)) for f in (Shear(), wave)),)):
        mine, theirs = (simulate_flight(flow, vehicle, **options) for flow in (own, twin))
        np.testing.assert_allclose(mine.position, theirs.position, atol=1e-10)
    assert (Shear().cells, own.cells) == ((), (PLAIN,))
    with pytest.raises(TypeError, match="abstract"):
        type("Unfinished", (Flow,), {"period": 1.0})()


@pytest.mark.parametrize("name", FLOWS)
def test_each_sample_of_a_flight_follows_from_the_last_by_the_slow_reference(name):
    flow, vehicle = FLOWS[name], PointMassVehicle(0.5, (5.0, 3.0))
    flight = simulate_flight(flow, vehicle, duration=1.0, sample_rate=100.0, seed=7)
    assert (flight.position[0] < flow.period).all()
    states = np.hstack([flight.position, flight.velocity])

    def slow(t, s):
        return np.hstack([s[2:], (flow.velocity(*s[:2], t) - s[2:]) / 0.5 + [5.0, 3.0]])

    for row in range(0, 100, 20):
        span = flight.time[[row, row + 1]]
        step = solve_ivp(slow, span, states[row], method="DOP853", rtol=1e-13, atol=1e-14)
        np.testing.assert_allclose(states[row + 1], step.y[:, -1], atol=2e-12)


@pytest.mark.parametrize(
    ("place", "velocity"),
    [
        ((1, 1), (3, -3)),  # sin(pi/4) cos(pi/4) = 1/2
        ((2, 0), (6, 0)),  # mid-edge (L/2, 0): sin(pi/2) cos(0) = 1
        ((0, 2), (0, -6)),
        ((5, 1), (-3, 3)),  # rotation alternates
        *(((x, y), (0, 0)) for x, y in [(0, 0), (4, 0), (4, 4), (2, 2), (6, 2), (-2, 6)]),
    ],
)
def test_velocity_at_hand_worked_points(place, velocity):
    assert PLAIN.velocity(*place) == pytest.approx(velocity, abs=1e-14)


def test_superposition_is_the_sum_and_a_wind_carries_it():
    other = CellularFlow(2.0, 1.5)
    windy = SuperposedFlow((PLAIN, other), wind=[1, -2])
    expected = PLAIN.velocity(X, Y) + other.velocity(X, Y) + [1.0, -2.0]
    np.testing.assert_allclose(windy.velocity(X, Y), expected, atol=1e-14)
    assert (windy.wind, SuperposedFlow((PLAIN,)).wind) == ((1.0, -2.0), (0.0, 0.0))


LENGTH, STEP, POINTS = 5.0, 0.5, 2048
LINE = np.arange(POINTS) * STEP
KNEES = {"dryden": (1.0, 1.0), "von-karman": (1.339, 5.0 / 6.0)}


@pytest.fixture(scope="module")
def lines():
    """The velocity along a line of 205 lengths, for 16 fields each."""
    return {
        name: np.array(
            [Turbulence(2.0, LENGTH, spectrum=name, seed=s).velocity(LINE, 0.0) for s in range(16)]
        )
        for name in KNEES
    }


@pytest.mark.parametrize("name", KNEES)
def test_each_component_has_the_intensity(lines, name):
    assert np.sqrt(np.mean(lines[name] ** 2, axis=(0, 1))) == pytest.approx([2.0, 2.0], rel=0.03)
    field = Turbulence(2.0, LENGTH, spectrum=name)
    # pairs of waves at right angles: over the plane it is exact, for each component
    power = field.waves.wavevectors**2 * (field.waves.cosine**2 + field.waves.sine**2)[:, None] / 2
    assert power.sum(axis=0) == pytest.approx([4.0, 4.0], rel=1e-12)
    assert field.mean_velocity == pytest.approx(field.waves.mean_velocity, rel=1e-12) == 4.0


@pytest.mark.parametrize("name", KNEES)
def test_spectrum_along_a_line_is_the_named_one(lines, name):
    window = np.hanning(POINTS)
    sums = np.abs(np.fft.rfft(lines[name][:, :, 0] * window, axis=1)) ** 2
    measured = sums.mean(axis=0) * STEP / math.pi / np.sum(window**2)
    k = 2 * math.pi * np.fft.rfftfreq(POINTS, STEP)
    knee, power = KNEES[name]
    # one-sided, of integral sigma^2: sigma^2 2 L/pi / (1 + (c L k)^2)^p
    theory = 4.0 * 2 * LENGTH / math.pi / (1 + (knee * LENGTH * k) ** 2) ** power
    for low, high in ((0.2, 0.7), (0.7, 2.0), (2.0, 7.0), (7.0, 20.0)):
        band = (k * LENGTH >= low) & (k * LENGTH < high)
        assert measured[band].sum() / theory[band].sum() == pytest.approx(1.0, abs=0.16)


def test_the_lateral_component_is_that_of_a_plane_flow_without_divergence(lines):
    # Dryden in the plane: the correlation of the lateral velocity is (1 - r/L) exp(-r/L)
    for lag in (5, 10, 20):
        ratio = lag * STEP / LENGTH
        along, across = (
            np.mean(lines["dryden"][:, lag:, part] * lines["dryden"][:, :-lag, part]) / 4.0
            for part in (0, 1)
        )
        assert along == pytest.approx(math.exp(-ratio), abs=0.08)
        assert across == pytest.approx((1 - ratio) * math.exp(-ratio), abs=0.08)


def test_memory_is_the_integral_time_of_a_place():
    time, places = np.arange(0.0, 3.0, 0.3), 40.0 * np.arange(40)[:, None]
    fields = (Turbulence(1.0, LENGTH, memory=2.0, seed=seed) for seed in range(16))
    series = np.concatenate([field.velocity(places, 0.0, time) for field in fields])
    memory = np.mean(series * series[:, :1], axis=(0, 2))
    np.testing.assert_allclose(memory, np.exp(-math.pi / 4 * (time / 2.0) ** 2), atol=0.12)


def test_frozen_turbulence_does_not_move_and_is_the_start_of_an_evolving_one():
    frozen, moving = Turbulence(1.0, 5.0, seed=3), Turbulence(1.0, 5.0, memory=2.0, seed=3)
    np.testing.assert_array_equal(frozen.velocity(LINE, 1.0, 9.0), frozen.velocity(LINE, 1.0))
    np.testing.assert_array_equal(frozen.velocity(LINE, 1.0), moving.velocity(LINE, 1.0))
    assert np.ptp(moving.velocity(1.0, 1.0, LINE)) > 1.0


def test_a_seed_is_a_field_and_intensity_only_scales_it():
    here = Turbulence(1.0, 5.0, seed=3).velocity(LINE, 1.0)
    np.testing.assert_array_equal(Turbulence(1.0, 5.0, seed=3).velocity(LINE, 1.0), here)
    assert np.abs(Turbulence(1.0, 5.0, seed=4).velocity(LINE, 1.0) - here).max() > 0.5
    twice = Turbulence(2.0, 5.0, seed=3).velocity(LINE, 1.0)
    np.testing.assert_allclose(twice, 2.0 * here, rtol=1e-12, atol=1e-12)
    assert len(Turbulence(1.0, 5.0).waves.cosine) == 128
    assert Turbulence(1.0, 5.0) == Turbulence(1.0, 5.0, seed=0)
