"""Flights against the solutions of the equation of motion: vehicles, thrust, noise, refusals."""

import math
import signal
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import sparsefit as sf
from sparsefit.errors import InputError
from sparsefit.flight import simulate_flight, simulation
from sparsefit.flight.flow import CellularFlow, SuperposedFlow
from sparsefit.flight.vehicle import PointMassVehicle, ThrustSeries
from sparsefit.flight.waves import WaveFlow

VEHICLE = PointMassVehicle(0.5, (5.0, 3.0))
FLOW = CellularFlow(15.43, 4.21)
STILL = CellularFlow(1e-15, 4.0)  # slower than rounding: still air


def fly(flow=FLOW, vehicle=VEHICLE, **changes):
    return simulate_flight(
        flow, vehicle, **({"duration": 1.0, "sample_rate": 100.0, "seed": 7} | changes)
    )


def numbers(flight):
    return np.column_stack([flight.time, flight.position, flight.velocity])


def test_without_a_flow_the_air_is_still():
    flight, tau, a = fly(None, duration=5.0), 0.5, np.array([5.0, 3.0])
    assert flight.flow is None
    np.testing.assert_array_equal(flight.position[0], [0.0, 0.0])
    t = flight.time[:, None]
    lag = tau * (1 - np.exp(-t / tau))
    np.testing.assert_allclose(flight.velocity, a * lag, atol=1e-10)
    np.testing.assert_allclose(flight.position, a * tau * (t - lag), atol=1e-10)
    same = fly(STILL, duration=5.0, initial_position=(0.0, 0.0))
    np.testing.assert_allclose(flight.position, same.position, atol=1e-12)
    glider = PointMassVehicle(math.inf, (5.0, 3.0), drag=0.1)
    calm = fly(WaveFlow([[1.0, 0.0]], [0.0], [0.0]), glider, initial_position=(0.0, 0.0))
    np.testing.assert_allclose(calm.position, fly(None, glider).position, atol=1e-12)
    windy = fly(SuperposedFlow((STILL,), (1.0, -2.0)), duration=20.0)
    np.testing.assert_allclose(windy.velocity[-1], [1.0 + 2.5, -2.0 + 1.5], atol=1e-10)


def test_samples_and_starts():
    flight = fly(duration=10.0)
    np.testing.assert_array_equal(flight.time, np.arange(1001) / 100.0)
    np.testing.assert_array_equal(flight.velocity[0], [0.0, 0.0])
    assert (flight.flow, flight.vehicle) == (FLOW, VEHICLE)
    assert fly(duration=0.299, sample_rate=10.0).samples == 4
    started = fly(initial_position=[1.0, 2.0], initial_velocity=np.array([3.0, 4.0]))
    np.testing.assert_array_equal(started.position[0], [1.0, 2.0])
    np.testing.assert_array_equal(started.velocity[0], [3.0, 4.0])


def test_drawn_starts_fill_one_period_of_the_largest_scale():
    two = SuperposedFlow((FLOW, CellularFlow(3.0, 1.7)))
    starts = np.array([fly(two, seed=seed, duration=0.02).position[0] for seed in range(200)])
    assert starts.min() >= 0.0
    assert 0.95 * 8.42 < starts.max() < 8.42
    assert starts.mean() == pytest.approx(4.21, abs=0.5)


def test_a_seed_is_a_flight_and_a_sequence_is_left_as_it_was():
    noise = {"process_noise": 0.1, "position_noise": 0.1, "velocity_noise": 0.1}
    sequence = np.random.SeedSequence(7)
    for seed in (7, sequence, sequence):
        np.testing.assert_array_equal(numbers(fly(seed=seed, **noise)), numbers(fly(**noise)))
    np.testing.assert_array_equal(numbers(fly(substeps=3)), numbers(fly()))
    assert sequence.n_children_spawned == 0
    flights = [fly(), fly(seed=8), *(fly(seed=seed) for seed in sequence.spawn(2))]
    assert len({flight.position.tobytes() for flight in flights}) == 4


@pytest.mark.parametrize(
    ("noise", "level", "atol"),
    [("position", 0.1, 1e-13), ("velocity", 0.1, 1e-13), ("process", 1e-6, 1e-10)],
)
def test_noise_levels_share_one_draw_and_vanish_continuously(noise, level, atol):
    field = "position" if noise == "position" else "velocity"
    none, one, two = (getattr(fly(**{f"{noise}_noise": x * level}), field) for x in range(3))
    np.testing.assert_allclose(two - none, 2 * (one - none), atol=atol)
    if noise == "process":
        assert 0.0 < np.abs(one - none).max() < 1e-5
    else:
        assert (one - none).std() == pytest.approx(level, rel=0.2)


def test_each_noise_has_its_own_stream():
    truth, noisy = fly(), fly(position_noise=0.1)
    np.testing.assert_array_equal(noisy.velocity, truth.velocity)
    both = fly(position_noise=0.1, velocity_noise=0.3)
    np.testing.assert_array_equal(both.position, noisy.position)
    pushed = fly(process_noise=0.1, position_noise=0.1)
    clean = fly(process_noise=0.1)
    np.testing.assert_allclose(
        pushed.position - clean.position, noisy.position - truth.position, atol=1e-13
    )


@pytest.mark.parametrize("substeps", [1, 10])
def test_process_noise_is_the_spread_of_the_mean_derivative(substeps):
    heavy = PointMassVehicle(1e9)  # drag vanishes: v' is the noise alone
    flight = fly(STILL, heavy, duration=10.0, process_noise=0.7, substeps=substeps)
    rate = np.diff(flight.velocity, axis=0) * 100.0
    assert rate.std() == pytest.approx(0.7, rel=0.05)
    assert rate.mean() == pytest.approx(0.0, abs=4 * 0.7 / math.sqrt(2000))
    assert abs(np.corrcoef(rate[:-1, 0], rate[1:, 0])[0, 1]) < 0.1


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"duration": 0.0}, r"duration must be a finite number above 0 \[s\]"),
        ({"sample_rate": -1.0}, "sample_rate"),
        ({"duration": 0.01}, "is 1; a flight has 3 to 5000000 samples"),
        ({"duration": 1e12}, "is 1e\\+14; a flight has 3 to"),
        *(({"seed": bad}, "seed must be an integer") for bad in (-1, None, 1.5)),
        ({"process_noise": -0.1}, "process_noise"),
        ({"position_noise": math.nan}, "position_noise"),
        ({"velocity_noise": "a"}, "velocity_noise"),
        ({"substeps": 0}, "substeps must be an integer, 1 or above"),
        ({"substeps": 2.0}, "substeps"),
        ({"initial_position": (1.0,)}, "initial_position must be two numbers"),
        ({"initial_velocity": (1.0, math.inf)}, r"initial_velocity\[1\]"),
        ({"flow": "cellular"}, "flow must be"),
        ({"vehicle": 0.5}, "vehicle must be"),
        ({"thrust": np.zeros((101, 2))}, "thrust must be a ThrustSeries.*; got a ndarray"),
    ],
)
def test_bad_arguments_are_named_before_anything_is_flown(changes, message, monkeypatch):
    monkeypatch.setattr(CellularFlow, "formula", None)
    with pytest.raises(InputError, match=message):
        fly(**changes)


@pytest.fixture
def pressed_at(monkeypatch):
    """Press Ctrl-C once in a flight, under a handler; the times [s] at which the flow was asked."""
    inherited, at = signal.getsignal(signal.SIGINT), CellularFlow.formula

    def under(handler):
        asked = []
        signal.signal(signal.SIGINT, handler)

        def formula(flow, functions):
            velocity = at(flow, functions)

            def pressed(x, y, t):
                asked.append(t)
                if asked[-1] > 0.1 >= max(asked[:-1]):
                    signal.raise_signal(signal.SIGINT)
                return velocity(x, y, t)

            return pressed

        monkeypatch.setattr(CellularFlow, "formula", formula)
        return asked

    yield under
    signal.signal(signal.SIGINT, inherited)


@pytest.mark.filterwarnings("error")
def test_ctrl_c_in_a_flight_is_raised_between_its_samples(pressed_at):
    asked = pressed_at(signal.default_int_handler)
    with pytest.raises(KeyboardInterrupt):
        fly()
    assert max(asked) < 0.2
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_a_flight_goes_on_where_ctrl_c_is_ignored_or_only_noted(pressed_at):
    undisturbed, noted = fly(), []

    def note(number, _frame):
        noted.append(number)

    for handler in (signal.SIG_IGN, note):
        asked = pressed_at(handler)
        np.testing.assert_array_equal(fly().position, undisturbed.position)
        assert max(asked) > 0.2
        assert signal.getsignal(signal.SIGINT) is handler
    assert noted == [signal.SIGINT]


def test_a_vehicle_that_follows_the_flow_fast_is_flown():
    flight = fly(vehicle=PointMassVehicle(2e-5), duration=0.2)  # 500 response times a sample
    air = FLOW.velocity(*flight.position[1:].T)
    np.testing.assert_allclose(flight.velocity[1:], air, atol=5e-3)


@pytest.mark.parametrize("vehicle", [PointMassVehicle(1e-9), PointMassVehicle(math.inf, drag=1e12)])
def test_a_vehicle_that_follows_the_flow_at_once_is_refused(vehicle):
    with pytest.raises(InputError, match="too stiff or too fast; raise response_time"):
        fly(vehicle=vehicle)


@pytest.mark.parametrize("flow", [CellularFlow(1e6, 1.0), CellularFlow(1.0, 1e-9)])
def test_an_equation_too_fast_is_refused(flow, monkeypatch):
    monkeypatch.setattr(simulation, "EVALUATIONS", (60_000, 0))  # which would take seconds
    monkeypatch.setattr(simulation, "BURST", 0)
    with pytest.raises(InputError, match="too stiff or too fast; raise response_time"):
        fly(flow)


def test_a_flight_that_takes_too_long_is_refused_near_its_start(monkeypatch):
    # 10 evaluations in a response time: 1e5 a second, of which 0.2 may be
    monkeypatch.setattr(simulation, "EVALUATIONS", (20_000, 0))
    monkeypatch.setattr(simulation, "BURST", 4_000)
    with pytest.raises(InputError, match=r"past t=0\.0[1-9] s: it is too stiff"):
        fly(vehicle=PointMassVehicle(1e-4))
    monkeypatch.setattr(simulation, "EVALUATIONS", (400_000, 0))
    assert fly(vehicle=PointMassVehicle(1e-4)).samples == 101


@pytest.mark.parametrize("wrong", [1.0, (1.0, 2.0, 3.0), "ab", (None, 1.0)])
def test_a_flow_without_two_numbers_is_named(wrong):
    with pytest.raises(InputError, match=r"must return two finite numbers, \(u, v\) .*Error\("):
        fly(SimpleNamespace(velocity=lambda _x, _y, _t: wrong))


def test_anything_with_a_velocity_can_be_flown():
    def shear(x, y, t=0.0):
        return np.stack(np.broadcast_arrays(0.0 * np.asarray(y), np.sin(x)), axis=-1)

    own = SimpleNamespace(velocity=shear)
    flight = fly(own, PointMassVehicle(0.5), initial_position=(1.0, 0.0))
    speed = math.sin(1.0) * (1 - np.exp(-flight.time / 0.5))
    np.testing.assert_allclose(flight.velocity[:, 1], speed, atol=1e-11)
    assert flight.flow is own


def flown(vehicle, **options):
    """In still air, from rest."""
    return sf.simulate_flight(None, vehicle, duration=3.0, sample_rate=20.0, seed=0, **options)


def acceleration(vehicle, velocity, flow, thrust=None):
    """v' = (1/tau + c |w - v|) (w - v) + a [m/s^2], Eq. 12."""
    relative = np.subtract(flow, velocity)
    law = 1.0 / vehicle.response_time + vehicle.drag * np.hypot(*relative)
    return law * relative + vehicle.thrust(thrust)


def test_the_flow_velocity_by_hand_and_rows_are_samples():
    # (w - v)/tau + a = ((1, 2) - (3, 1))/0.5 + (5, 3); in still air the terminal velocity is tau a
    assert VEHICLE.flow_velocity([3.0, 1.0], [1.0, 5.0]) == pytest.approx([1.0, 2.0], abs=1e-15)
    assert VEHICLE.flow_velocity([2.5, 1.5], [0.0, 0.0]) == pytest.approx([0.0, 0.0], abs=1e-15)
    velocity = np.arange(8.0).reshape(4, 2)
    rows = VEHICLE.flow_velocity(velocity, np.ones(2))
    np.testing.assert_array_equal(rows[2], VEHICLE.flow_velocity(velocity[2], [1.0, 1.0]))
    assert rows.shape == VEHICLE.flow_velocity(velocity, velocity).shape == (4, 2)


@given(
    tau=st.one_of(st.just(math.inf), st.floats(0.01, 100)),
    drag=st.one_of(st.floats(1e-3, 10)),
    values=st.lists(st.floats(-100, 100), min_size=8, max_size=8),
)
def test_the_flow_velocity_inverts_every_law(tau, drag, values):
    vehicle = PointMassVehicle(tau, (values[0], values[1]), drag, thrust_scale=1.5)
    velocity, flow, thrust = np.array(values[2:]).reshape(3, 2)
    back = vehicle.flow_velocity(velocity, acceleration(vehicle, velocity, flow, thrust), thrust)
    np.testing.assert_allclose(back, flow, atol=1e-5)


def test_a_vehicle_falls_at_its_terminal_velocity():
    # v' = a - c v |v| from rest: v = sqrt(a/c) tanh(sqrt(a c) t), x = log(cosh(sqrt(a c) t)) / c.
    flight = flown(PointMassVehicle(math.inf, (4.0, 0.0), 0.25))
    t = flight.time
    np.testing.assert_allclose(flight.velocity[:, 0], 4.0 * np.tanh(t), atol=1e-11)
    np.testing.assert_allclose(flight.position[:, 0], 4.0 * np.log(np.cosh(t)), atol=1e-11)


def test_a_thrust_that_turns_is_flown_and_logged():
    # v' = s m(t) - v/tau with m a ramp (t, 0): v = s tau (t - tau (1 - exp(-t/tau))).
    ramp = ThrustSeries([0.0, 3.0], [[0.0, 1.0], [3.0, 1.0]])
    flight = flown(PointMassVehicle(0.5, thrust_scale=2.0), thrust=ramp)
    t = flight.time
    speed = t - 0.5 * (1 - np.exp(-2 * t))
    np.testing.assert_allclose(flight.velocity[:, 0], speed, atol=1e-11)
    np.testing.assert_allclose(flight.thrust, np.stack([t, np.ones_like(t)], axis=1), atol=1e-14)
    clean, noisy = (
        flown(PointMassVehicle(0.5), thrust=ramp, thrust_noise=noise) for noise in (0.0, 0.5)
    )
    np.testing.assert_array_equal(clean.velocity, noisy.velocity)
    assert np.std(noisy.thrust - clean.thrust) == pytest.approx(0.5, rel=0.2)


def test_a_series_is_a_straight_line_between_its_samples():
    boat = ThrustSeries([0.0, 1.0], [[1.0, 0.0], [3.0, 0.0]])
    np.testing.assert_allclose(boat.at([0.5]), [[2.0, 0.0]])
    assert boat.pointwise()(0.25) == pytest.approx((1.5, 0.0))
    with pytest.raises(InputError, match="known from 0 to 1 s, the flight is from 0 to 2 s"):
        boat.at([0.0, 2.0])
