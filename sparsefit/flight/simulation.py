"""Simulated flights: the equation of motion (Eq. 14) solved and sampled, with noise on request."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from sparsefit.arrays import Array
from sparsefit.errors import InputError, integer, is_integer, is_number, pair, positive
from sparsefit.flight.flow import Flow
from sparsefit.flight.interrupts import interrupts_kept
from sparsefit.flight.record import (
    MINIMUM_SAMPLES,
    MOST_SAMPLES,
    SMALLEST_STEP,
    Flight,
    check_models,
    level_of,
)
from sparsefit.flight.thrust import ThrustSeries
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.flight.waves import PointVelocity

if TYPE_CHECKING:
    from scipy.integrate import ode

RightHandSide: TypeAlias = Callable[[float, Array], list[float]]

INTEGRATION = 1e-13  # relative and absolute tolerance; leaves a defect below 1e-12 m/s per sample
EVEN = 1e-6  # of a sample interval: steps that differ by less do so by rounding
STEPS_PER_INTERVAL = 10_000  # beyond this the equation is stiff and deserves a refusal


def simulate_flight(
    flow: Flow | None,
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
    """Fly ``vehicle`` through ``flow`` and return what it logs, at t = 0, 1/rate, 2/rate, ...

    Six independent streams come from ``seed``: initial position, process noise, position noise,
    velocity noise, time jitter, thrust noise. Flights that differ in a noise level only therefore
    share one draw.

    Args:
        flow: the true flow; kept in the flight for scoring. None: still air.
        vehicle: the vehicle.
        duration: [s]; the flight has round(duration * sample_rate) + 1 samples.
        sample_rate: [Hz].
        seed: a non-negative integer or a seed sequence, which is left as it was.
        initial_position: [m]; by default uniform over one period of the flow, [0, 2L)^2 of the
            largest cells, in still air or a mere wind the origin.
        initial_velocity: [m/s].
        process_noise: standard deviation [m/s^2] of the noise on v' (Eq. 7), averaged over one
            sample interval; white within it.
        position_noise: standard deviation [m] of the measured position.
        velocity_noise: standard deviation [m/s] of the measured velocity.
        substeps: random kicks per sample interval; used only with process noise.
        time_jitter: in [0, 0.5): by which share of 1/rate a sample is taken early or late at most,
            uniformly; the time that is logged is the one at which it was taken.
        thrust: flown beside the vehicle's constant, and logged; its times cover the flight.
        thrust_noise: standard deviation [m/s^2] of the logged thrust.

    Returns:
        The flight; without noise, the solution of Eq. 14 to about 1e-12 per sample interval.

    Raises:
        InputError: if an argument is out of its range, or the equation is too stiff to integrate.
    """
    check_models(vehicle, flow)
    start_stream, process_stream, position_stream, velocity_stream, *others = _streams(seed)
    time_stream, thrust_stream = others
    time = _sample_times(duration, sample_rate)
    time = _jittered(time, time_jitter, time_stream)
    state = (
        *_start(flow, initial_position, start_stream),
        *pair("initial_velocity", initial_velocity, "m/s"),
    )
    kicks = _kicks(process_noise, time, integer("substeps", substeps, 1), process_stream)
    blur = level_of("position_noise", position_noise, "m")
    jitter = level_of("velocity_noise", velocity_noise, "m/s")
    level = level_of("thrust_noise", thrust_noise, "m/s^2")
    logged = None if thrust is None else thrust.at(time)
    states = _integrate(_right_hand_side(flow, vehicle, thrust), state, time, kicks)
    if logged is not None:
        logged = logged + level * thrust_stream.standard_normal(logged.shape)
    return Flight(
        time=time,
        position=states[:, :2] + blur * position_stream.standard_normal((len(time), 2)),
        velocity=states[:, 2:] + jitter * velocity_stream.standard_normal((len(time), 2)),
        vehicle=vehicle,
        flow=flow,
        thrust=logged,
    )


def _streams(seed: int | np.random.SeedSequence) -> list[np.random.Generator]:
    """Return the six streams of ``SeedSequence.spawn(6)``, without its count of past spawns."""
    root = seed if isinstance(seed, np.random.SeedSequence) else _root(seed)
    children = (
        np.random.SeedSequence(root.entropy, spawn_key=(*root.spawn_key, child))
        for child in range(6)
    )
    return [np.random.default_rng(child) for child in children]


def _root(seed: int) -> np.random.SeedSequence:
    if not is_integer(seed, 0):
        raise InputError(f"seed must be an integer, 0 or above, or a SeedSequence; got {seed!r}")
    return np.random.SeedSequence(int(seed))


def _sample_times(duration: float, sample_rate: float) -> Array:
    """Return t = 0, 1/rate, 2/rate, ... [s], (m,), up to the duration."""
    span = positive("duration", duration, "s")
    rate = positive("sample_rate", sample_rate, "Hz")
    if span * rate > MOST_SAMPLES:
        raise InputError(
            f"duration * sample_rate is {span * rate:.3g} samples; keep it below {MOST_SAMPLES}"
        )
    if rate > 1.0 / SMALLEST_STEP:
        raise InputError(f"sample_rate is {rate:g} Hz; keep it below {1.0 / SMALLEST_STEP:g} Hz")
    intervals = round(span * rate)
    if intervals + 1 < MINIMUM_SAMPLES:
        raise InputError(
            f"duration {span} s at sample_rate {rate} Hz gives {intervals + 1} samples, a flight "
            f"needs {MINIMUM_SAMPLES}: fly longer or sample faster"
        )
    return np.arange(intervals + 1) / rate


def _jittered(time: Array, jitter: float, stream: np.random.Generator) -> Array:
    """Return the times [s], (m,), of samples taken early or late; the first one is on time."""
    if not is_number(jitter, 0.0) or jitter >= 0.5:
        raise InputError(f"time_jitter is a share of 1/sample_rate in [0, 0.5); got {jitter!r}")
    if not jitter:
        return time
    shifts = jitter * float(time[1]) * stream.uniform(-1.0, 1.0, len(time) - 1)
    return np.concatenate([time[:1], time[1:] + shifts])


def _start(
    flow: Flow | None, position: Sequence[float] | Array | None, stream: np.random.Generator
) -> tuple[float, float]:
    """Return the initial position [m]: the one given, else one drawn from a period of the flow."""
    if position is not None:
        return pair("initial_position", position, "m")
    period = flow.period if flow else 0.0
    if not period:
        return (0.0, 0.0)
    return pair("initial_position", stream.uniform(0.0, period, 2), "m")


def _kicks(level: float, time: Array, substeps: int, stream: np.random.Generator) -> Array:
    """Return the velocity increments [m/s] of the process noise, (intervals, substeps, 2).

    They sum to N(0, (level * dt)^2) over an interval dt, so the mean derivative noise has
    standard deviation ``level``; their power is that of the mean interval where times jitter.
    Without noise: one substep that is not kicked.
    """
    sigma = level_of("process_noise", level, "m/s^2")
    if sigma == 0.0:
        return np.zeros((len(time) - 1, 1, 2))
    kicks = stream.standard_normal((len(time) - 1, substeps, 2))
    steps = np.diff(time)
    if np.ptp(steps) <= EVEN * steps[0]:
        return sigma * float(time[1]) / math.sqrt(substeps) * kicks
    powers = np.sqrt(steps * steps.mean() / substeps)
    kicks *= sigma * powers[:, None, None]
    return kicks


def _right_hand_side(
    flow: Flow | None, vehicle: PointMassVehicle, thrust: ThrustSeries | None = None
) -> RightHandSide:
    """Return f(t, (x, y, vx, vy)) of Eq. 14, on plain floats: numpy scalars cost ten times more."""
    flow_at = _anywhere(flow.pointwise()) if flow else _still
    rate, drag = vehicle.rate, vehicle.drag
    ax, ay = vehicle.thrust_acceleration
    if drag or thrust is not None:
        push, scale = thrust.pointwise() if thrust else _unpushed, vehicle.thrust_scale

        def general(t: float, state: Array) -> list[float]:
            x, y, vx, vy = state.tolist()
            wx, wy = flow_at(x, y, t)
            mx, my = push(t)
            own = rate + drag * math.hypot(wx - vx, wy - vy)
            return [vx, vy, (wx - vx) * own + ax + scale * mx, (wy - vy) * own + ay + scale * my]

        return general

    def derivative(t: float, state: Array) -> list[float]:
        x, y, vx, vy = state.tolist()
        wx, wy = flow_at(x, y, t)
        return [vx, vy, (wx - vx) * rate + ax, (wy - vy) * rate + ay]

    return derivative


def _anywhere(flow_at: PointVelocity) -> PointVelocity:
    """The same, NaN where a step has left all places, which `math.sin` refuses; `_advance` sees it.

    What the compiled integrator calls must raise nothing.
    """

    def velocity(x: float, y: float, t: float) -> tuple[float, float]:
        try:
            return flow_at(x, y, t)
        except (ValueError, OverflowError):
            return math.nan, math.nan

    return velocity


def _still(_x: float, _y: float, _t: float) -> tuple[float, float]:
    return 0.0, 0.0


def _unpushed(_t: float) -> tuple[float, float]:
    return 0.0, 0.0


def _integrate(
    right_hand_side: RightHandSide, start: tuple[float, ...], time: Array, kicks: Array
) -> Array:
    """Return the states (m, 4) at ``time``; every sample is the end of a step.

    Strang splitting: half a kick, the exact motion over one substep, the other half. The drift
    stays exact however small the noise; the error of Euler-Maruyama would drown it.
    """
    from scipy.integrate import ode  # half of what the package takes to import

    # The compiled DOP853 stops at each sample in 10-45 ms per 1000 samples. solve_ivp with
    # t_eval interpolates (defect 1e-9 m/s at rtol 1e-11); stepping it to each sample costs 5x.
    solver = ode(right_hand_side).set_integrator(
        "dop853", rtol=INTEGRATION, atol=INTEGRATION, nsteps=STEPS_PER_INTERVAL
    )
    solver.set_initial_value(start, time[0])
    fly = _advance_kicked if kicks.any() else _advance
    states = np.empty((len(time), 4))
    states[0] = start
    with warnings.catch_warnings(), interrupts_kept() as released:
        warnings.simplefilter("ignore", UserWarning)  # _advance raises in its place
        for row, interval in enumerate(kicks, start=1):
            released()
            fly(solver, float(time[row]), interval)
            states[row] = solver.y
    return states


def _advance_kicked(solver: ode, end: float, kicks: Array) -> None:
    """Integrate to ``end`` [s] in equal substeps, half of each kick before and half after."""
    stops = np.linspace(solver.t, end, len(kicks) + 1)[1:]
    for stop, kick in zip(stops, kicks, strict=True):
        _kick(solver, kick / 2.0)
        _advance(solver, stop, kick)
        _kick(solver, kick / 2.0)


def _kick(solver: ode, increment: Array) -> None:
    """Add to the velocity [m/s]; the solver starts anew from there."""
    state = np.array(solver.y)
    state[2:] += increment
    solver.set_initial_value(state, solver.t)


def _advance(solver: ode, end: float, _: Array) -> None:
    """Integrate to ``end`` [s] or refuse."""
    solver.integrate(end)
    if not solver.successful() or not np.isfinite(solver.y).all():
        raise InputError(
            f"the equation of motion cannot be integrated past t={solver.t:.6g} s: it is too stiff "
            "or too fast; raise response_time or sample_rate, or lower mean_velocity"
        )
