"""Simulated flights: the equation of motion (Eq. 14) solved and sampled, with noise on request."""

from __future__ import annotations

import math
import signal
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np

from sparsefit.arrays import Array
from sparsefit.errors import InputError, integer, non_negative, number_setting, pair, positive
from sparsefit.flight.record import MINIMUM_SAMPLES, MOST_SAMPLES, Flight, streams
from sparsefit.flight.vehicle import PointMassVehicle, ThrustSeries
from sparsefit.flight.waves import Flow, FlowField, check_flow

EVALUATIONS = (10_000_000, 2_000)  # of the right-hand side: in all, and more for each sample
BURST = 1_000_000  # allowed in advance of that pace: a stiff equation is refused early


def simulate_flight(
    flow: FlowField | None,
    vehicle: PointMassVehicle,
    *,
    duration: float,
    sample_rate: float,
    seed: int | np.random.SeedSequence,
    initial_position: Sequence[float] | Array | None = None,
    initial_velocity: Sequence[float] | Array = (0.0, 0.0),
    process_noise: float = 0.0,
    position_noise: float = 0.0,
    velocity_noise: float = 0.0,
    substeps: int = 10,
    time_jitter: float = 0.0,
    thrust: ThrustSeries | None = None,
    thrust_noise: float = 0.0,
) -> Flight:
    """Simulate ``vehicle`` in ``flow`` and return its log at t = 0, 1/rate, 2/rate, ...

    Six independent streams come from ``seed``: initial position, process noise, position noise,
    velocity noise, time jitter, thrust noise. Flights that differ only in a noise level therefore
    share their random numbers.

    Args:
        flow: the true flow, or any object whose ``velocity(x, y, t)`` returns (u, v) [m/s]; kept in
            the flight for scoring. None: still air.
        vehicle: the vehicle.
        duration: [s]; the flight has round(duration * sample_rate) + 1 samples.
        sample_rate: [Hz].
        seed: a non-negative integer or a seed sequence, which is left as it was.
        initial_position: [m]; by default uniform over one period of the flow, [0, 2L)^2 of the
            largest cells, or the origin if the flow has no period.
        initial_velocity: [m/s].
        process_noise: standard deviation [m/s^2] of white noise on v' (Eq. 7), over one interval.
        position_noise: standard deviation [m] of the measured position.
        velocity_noise: standard deviation [m/s] of the measured velocity.
        substeps: random kicks per sample interval; used only with process noise.
        time_jitter: in [0, 0.49], the largest shift of a sample as a share of 1/rate, uniform; the
            logged time is the shifted one.
        thrust: added to the vehicle's constant thrust, and logged; its times cover the flight.
        thrust_noise: standard deviation [m/s^2] of the logged thrust.

    Returns:
        The flight; without noise, the solution of Eq. 14 to about 1e-12 per sample interval.

    Raises:
        InputError: if an argument is out of its range, or the equation is too fast to integrate.
    """
    check_flow(flow)
    if not isinstance(vehicle, PointMassVehicle):
        raise InputError(f"vehicle must be a PointMassVehicle; got {type(vehicle).__name__}")
    if not (thrust is None or isinstance(thrust, ThrustSeries)):
        raise InputError(
            f"thrust must be a ThrustSeries(time, acceleration); got a {type(thrust).__name__}"
        )
    starts, process, places, speeds, clock, pushes = streams(seed, 6)
    span, rate = positive("duration", duration, "s"), positive("sample_rate", sample_rate, "Hz")
    if not MINIMUM_SAMPLES - 1.5 <= span * rate <= MOST_SAMPLES:
        words = f"duration * sample_rate is {span * rate:.3g}"
        raise InputError(f"{words}; a flight has {MINIMUM_SAMPLES} to {MOST_SAMPLES} samples")
    time = np.arange(round(span * rate) + 1) / rate
    number_setting("a flight", "time_jitter", time_jitter, low=0.0, high=0.49)
    if time_jitter:
        shifts = time_jitter * float(time[1]) * clock.uniform(-1.0, 1.0, len(time) - 1)
        time = np.concatenate([time[:1], time[1:] + shifts])
    period = float(getattr(flow, "period", 0.0))
    if initial_position is None:
        initial_position = starts.uniform(0.0, period, 2) if period else (0.0, 0.0)
    place = pair("initial_position", initial_position, "m")
    state = (*place, *pair("initial_velocity", initial_velocity, "m/s"))
    kick = non_negative("process_noise", process_noise, "m/s^2")
    push = non_negative("thrust_noise", thrust_noise, "m/s^2")
    blur = non_negative("position_noise", position_noise, "m")
    jitter = non_negative("velocity_noise", velocity_noise, "m/s")
    kicks = _kicks(kick, time, integer("substeps", substeps, 1), process)
    error = push * pushes.standard_normal((len(time), 2))
    logged = None if thrust is None else thrust.at(time) + error
    speed = float(getattr(flow, "mean_velocity", math.nan))
    fastest = vehicle.rate + 2.0 * math.pi * speed / period if period else math.nan
    stride = 0.25 / fastest if fastest > 0 else 0.0  # that long DOP853 keeps to the tolerance
    pace = (EVALUATIONS[0] + EVALUATIONS[1] * len(time)) / float(time[-1])
    motion = _right_hand_side(flow, vehicle, thrust, pace, failures := list[Exception]())
    try:
        states = _integrate(motion, state, time, kicks, stride)
    except InputError:
        if not failures or isinstance(flow, Flow):
            raise
        words = "flow.velocity(x, y, t) must return two finite numbers, (u, v) [m/s]"
        raise InputError(f"{words}: {failures[0]!r}") from failures[0]
    return Flight(
        time=time,
        position=states[:, :2] + blur * places.standard_normal((len(time), 2)),
        velocity=states[:, 2:] + jitter * speeds.standard_normal((len(time), 2)),
        vehicle=vehicle,
        flow=flow,
        thrust=logged,
    )


def _kicks(level: float, time: Array, substeps: int, stream: np.random.Generator) -> Array:
    """Return the velocity increments [m/s] of the process noise, (intervals, substeps, 2).

    They sum to N(0, (level * dt)^2) over an interval dt, so that the mean noise of v' has the
    standard deviation ``level``; with jitter dt is the mean interval. Without noise: zeros.
    """
    if level == 0.0:
        return np.zeros((len(time) - 1, 1, 2))
    kicks = stream.standard_normal((len(time) - 1, substeps, 2))
    steps = np.diff(time)
    if np.ptp(steps) <= 1e-6 * steps[0]:  # they differ by rounding
        return level * float(time[1]) / math.sqrt(substeps) * kicks
    kicks *= level * np.sqrt(steps * steps.mean() / substeps)[:, None, None]
    return kicks


def _right_hand_side(
    flow: FlowField | None,
    vehicle: PointMassVehicle,
    thrust: ThrustSeries | None,
    pace: float,
    failures: list[Exception],
) -> Callable[[float, Array], list[float]]:
    """Return f(t, (x, y, vx, vy)) of Eq. 14, on plain floats: numpy scalars cost ten times more.

    The compiled integrator calls it, so it raises nothing: it returns NaN, which `_integrate`
    refuses, where the flow raises or is not finite (failures gets the exception), and after more
    evaluations than ``pace`` [1/s] and `BURST` allow.
    """

    flow_at: Any = getattr(flow, "velocity", lambda _x, _y, _t: (0.0, 0.0))
    if isinstance(flow, Flow):
        flow_at = flow.formula(math)
    push = thrust.pointwise() if thrust else None
    rate, count = vehicle.rate, 0
    _, quadratic, ax, ay, scale = vehicle.parameters

    def derivative(t: float, state: Array) -> list[float]:
        nonlocal count
        count += 1
        x, y, vx, vy = state.tolist()
        try:
            wx, wy = flow_at(x, y, t) if count <= BURST + pace * t else (math.nan, math.nan)
            mx, my = push(t) if push else (0.0, 0.0)
            own = rate + quadratic * math.hypot(wx - vx, wy - vy) if quadratic else rate
            return [vx, vy, (wx - vx) * own + ax + scale * mx, (wy - vy) * own + ay + scale * my]
        except Exception as error:  # of a flow that the caller wrote, or `math.sin` of infinity
            failures.append(error)
            return [math.nan] * 4

    return derivative


def _integrate(
    right_hand_side: Callable[[float, Array], list[float]],
    start: tuple[float, ...],
    time: Array,
    kicks: Array,
    stride: float,
) -> Array:
    """Return the states (m, 4) at ``time``; every sample is the end of a step.

    Strang splitting: half a kick, the exact motion over one substep, the other half. The motion
    is exact for any noise, unlike that of Euler-Maruyama. The first step is stride [s], at most a
    substep; 0: the integrator's own guess, which is small.

    Raises:
        InputError: where the integrator does not get to the end of a substep.
    """
    from scipy.integrate import ode  # half of what the package takes to import

    # The compiled DOP853 stops at each sample in 10-45 ms per 1000 samples. solve_ivp with
    # t_eval interpolates (defect 1e-9 m/s at rtol 1e-11); stepping it to each sample costs 5x.
    states, halves, kicked = np.empty((len(time), 4)), kicks / 2.0, bool(kicks.any())
    states[0] = start
    stops = np.linspace(time[:-1], time[1:], halves.shape[1] + 1, axis=1)[:, 1:]
    first = min(stride, float(stops[0, 0] - time[0]))
    solver = ode(right_hand_side)
    solver.set_integrator("dop853", rtol=1e-13, atol=1e-13, nsteps=5_000, first_step=first)
    solver.set_initial_value(start, time[0])

    def kick(half: Array) -> None:
        if kicked:  # the solver starts anew from there
            solver.set_initial_value([*solver.y[:2], *(solver.y[2:] + half)], solver.t)

    with warnings.catch_warnings(), _interrupts_between_samples() as interrupt:
        warnings.simplefilter("ignore", UserWarning)  # the refusal says it
        for row in range(len(time) - 1):
            interrupt()
            for stop, half in zip(stops[row].tolist(), halves[row], strict=True):
                kick(half)
                solver.integrate(stop)
                if not solver.successful() or not np.isfinite(solver.y).all():
                    raise InputError(
                        f"the equation of motion cannot be integrated past t={time[row]:.6g} s: it "
                        "is too stiff or too fast; raise response_time or sample_rate, or lower "
                        "mean_velocity (or the flow is not finite there)"
                    )
                kick(half)
            states[row + 1] = solver.y
    return states


@contextmanager
def _interrupts_between_samples() -> Iterator[Callable[[], None]]:
    """Keep Ctrl-C until the function that is yielded is called, or the block ends.

    An exception inside a call back of compiled code would end the process. The interrupt then
    does as it would have done. Only the main thread is ever interrupted.
    """
    before, pressed = signal.getsignal(signal.SIGINT), list[Any]()
    main = threading.current_thread() is threading.main_thread() and callable(before)

    def interrupt() -> None:
        while pressed and callable(before):
            before(*pressed.pop())

    if main:
        signal.signal(signal.SIGINT, lambda *press: pressed.append(press))
    try:
        yield interrupt
        interrupt()
    finally:
        if main:
            signal.signal(signal.SIGINT, before)
