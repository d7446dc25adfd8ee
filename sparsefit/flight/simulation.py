"""Simulated flights: the equation of motion (Eq. 14) solved and sampled, with noise on request."""

from __future__ import annotations

import math
import signal
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from typing import TypeAlias

import numpy as np

from sparsefit.arrays import Array
from sparsefit.errors import InputError, integer, is_integer, is_number, pair, positive
from sparsefit.flight.flow import FlowField, as_flow
from sparsefit.flight.record import MINIMUM_SAMPLES, SMALLEST_STEP, Flight, level_of, streams
from sparsefit.flight.vehicle import MOST_SAMPLES, PointMassVehicle, ThrustSeries
from sparsefit.flight.waves import Formula

RightHandSide: TypeAlias = Callable[[float, Array], list[float]]

EVALUATIONS = (10_000_000, 2_000)  # of the right-hand side: in all, and more for each sample
_LSODA = threading.Lock()  # its state is one for the whole process


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
    """Fly ``vehicle`` through ``flow`` and return what it logs, at t = 0, 1/rate, 2/rate, ...

    Six independent streams come from ``seed``: initial position, process noise, position noise,
    velocity noise, time jitter, thrust noise. Flights that differ in a noise level only therefore
    share one draw.

    Args:
        flow: the true flow, or any object with ``velocity(x, y, t)``; kept in the flight for
            scoring. None: still air.
        vehicle: the vehicle.
        duration: [s]; the flight has round(duration * sample_rate) + 1 samples.
        sample_rate: [Hz].
        seed: a non-negative integer or a seed sequence, which is left as it was.
        initial_position: [m]; by default uniform over one period of the flow, [0, 2L)^2 of the
            largest cells, where there are none the origin.
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
        InputError: if an argument is out of its range, or the equation is too fast to integrate.
    """
    true_flow = as_flow(flow)
    if not isinstance(vehicle, PointMassVehicle):
        raise InputError(f"vehicle must be a PointMassVehicle; got {vehicle!r}")
    if is_integer(seed, 0):
        seed = np.random.SeedSequence(int(seed))
    if not isinstance(seed, np.random.SeedSequence):
        raise InputError(f"seed must be an integer, 0 or above, or a SeedSequence; got {seed!r}")
    starts, process, places, speeds, clock, pushes = streams(seed, 6)
    span, rate = positive("duration", duration, "s"), positive("sample_rate", sample_rate, "Hz")
    if span * rate > MOST_SAMPLES:
        words = f"duration * sample_rate is {span * rate:.3g} samples"
        raise InputError(f"{words}; keep it below {MOST_SAMPLES}")
    if rate > 1.0 / SMALLEST_STEP:
        raise InputError(f"sample_rate is {rate:g} Hz; keep it below {1.0 / SMALLEST_STEP:g} Hz")
    if (samples := round(span * rate) + 1) < MINIMUM_SAMPLES:
        raise InputError(
            f"duration {span} s at sample_rate {rate} Hz gives {samples} samples, a flight needs "
            f"{MINIMUM_SAMPLES}: fly longer or sample faster"
        )
    time = np.arange(samples) / rate
    if not is_number(time_jitter, 0.0) or time_jitter >= 0.5:
        raise InputError(
            f"time_jitter is a share of 1/sample_rate in [0, 0.5); got {time_jitter!r}"
        )
    if time_jitter:
        shifts = time_jitter * float(time[1]) * clock.uniform(-1.0, 1.0, len(time) - 1)
        time = np.concatenate([time[:1], time[1:] + shifts])
    period = true_flow.period if true_flow is not None else 0.0
    if initial_position is None:
        initial_position = starts.uniform(0.0, period, 2) if period else (0.0, 0.0)
    place = pair("initial_position", initial_position, "m")
    state = (*place, *pair("initial_velocity", initial_velocity, "m/s"))
    kicks = _kicks(process_noise, time, integer("substeps", substeps, 1), process)
    blur = level_of("position_noise", position_noise, "m")
    jitter = level_of("velocity_noise", velocity_noise, "m/s")
    level = level_of("thrust_noise", thrust_noise, "m/s^2")
    logged = None if thrust is None else thrust.at(time)
    flow_at = true_flow.formula(math) if true_flow else lambda _x, _y, _t: (0.0, 0.0)
    speed = getattr(true_flow, "mean_velocity", 0.0)
    pace = vehicle.rate + (2.0 * math.pi * speed / period if period else math.nan)
    stride = 0.25 / pace if pace > 0 else math.nan  # that long DOP853 keeps to the tolerance
    motion = _right_hand_side(flow_at, vehicle, thrust, EVALUATIONS[0] + EVALUATIONS[1] * samples)
    states = _integrate(motion, state, time, kicks, stride)
    if logged is not None:
        logged = logged + level * pushes.standard_normal(logged.shape)
    return Flight(
        time=time,
        position=states[:, :2] + blur * places.standard_normal((len(time), 2)),
        velocity=states[:, 2:] + jitter * speeds.standard_normal((len(time), 2)),
        vehicle=vehicle,
        flow=true_flow,
        thrust=logged,
    )


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
    if np.ptp(steps) <= 1e-6 * steps[0]:  # they differ by rounding
        return sigma * float(time[1]) / math.sqrt(substeps) * kicks
    kicks *= sigma * np.sqrt(steps * steps.mean() / substeps)[:, None, None]
    return kicks


def _right_hand_side(
    flow_at: Formula, vehicle: PointMassVehicle, thrust: ThrustSeries | None, most: int
) -> RightHandSide:
    """Return f(t, (x, y, vx, vy)) of Eq. 14, on plain floats: numpy scalars cost ten times more.

    The compiled integrator calls it: it raises nothing. It is NaN where a step has left all
    places, which `math.sin` refuses, and after ``most`` evaluations; `_integrate` sees both.
    """
    push = thrust.pointwise() if thrust else None
    rate, count = vehicle.rate, 0
    _, quadratic, ax, ay, scale = vehicle.parameters

    def derivative(t: float, state: Array) -> list[float]:
        nonlocal count
        count += 1
        x, y, vx, vy = state.tolist()
        try:
            wx, wy = flow_at(x, y, t) if count <= most else (math.nan, math.nan)
        except (ValueError, OverflowError):
            wx = wy = math.nan
        mx, my = push(t) if push else (0.0, 0.0)
        own = rate + quadratic * math.hypot(wx - vx, wy - vy) if quadratic else rate
        return [vx, vy, (wx - vx) * own + ax + scale * mx, (wy - vy) * own + ay + scale * my]

    return derivative


def _integrate(
    right_hand_side: RightHandSide,
    start: tuple[float, ...],
    time: Array,
    kicks: Array,
    stride: float,
) -> Array:
    """Return the states (m, 4) at ``time``; every sample is the end of a step.

    Strang splitting: half a kick, the exact motion over one substep, the other half. The motion
    stays exact however small the noise; the error of Euler-Maruyama would drown it. A first step
    of stride [s], or to the end of a substep, spares the integrator's own small guess, to which NaN
    leaves it. A stiff equation, of a vehicle that follows the flow at once, is passed on to an
    implicit method.

    Raises:
        InputError: where neither method gets to the end of an interval.
    """
    from scipy.integrate import ode  # half of what the package takes to import

    # The compiled DOP853 stops at each sample in 10-45 ms per 1000 samples. solve_ivp with
    # t_eval interpolates (defect 1e-9 m/s at rtol 1e-11); stepping it to each sample costs 5x.
    states, row, last = np.empty((len(time), 4)), 0, len(time) - 1
    states[0] = start
    halves, kicked = kicks / 2.0, bool(kicks.any())
    stops = np.linspace(time[:-1], time[1:], halves.shape[1] + 1, axis=1)[:, 1:]
    first = min(stride, float(stops[0, 0] - time[0])) if math.isfinite(stride) else 0.0
    with warnings.catch_warnings(), _interrupts_kept() as interrupt:
        warnings.simplefilter("ignore", UserWarning)  # the refusal below says it
        for stiff in (False, True):
            if row == last:
                break
            solver = ode(right_hand_side)
            # The defect is below 1e-12 m/s a sample. An equation is stiff that takes more steps.
            tolerance, steps = (1e-12, 100_000) if stiff else (1e-13, 200)
            solver.set_integrator(
                "lsoda" if stiff else "dop853",
                rtol=tolerance,
                atol=tolerance,
                nsteps=steps,
                first_step=0.0 if stiff else first,
            )
            solver.set_initial_value(states[row], time[row])

            def kick(half: Array, solver: ode = solver) -> None:
                if kicked:  # the solver starts anew from there
                    solver.set_initial_value([*solver.y[:2], *(solver.y[2:] + half)], solver.t)

            with _LSODA if stiff else nullcontext():
                while row < last:
                    interrupt()
                    for stop, half in zip(stops[row].tolist(), halves[row], strict=True):
                        kick(half)
                        solver.integrate(stop)
                        if not solver.successful() or not np.isfinite(solver.y).all():
                            break
                        kick(half)
                    else:
                        row += 1
                        states[row] = solver.y
                        continue
                    break
    if row < last:
        raise InputError(
            f"the equation of motion cannot be integrated past t={time[row]:.6g} s: it is too "
            "stiff or too fast; raise response_time or sample_rate, or lower mean_velocity"
        )
    return states


@contextmanager
def _interrupts_kept() -> Iterator[Callable[[], None]]:
    """Keep Ctrl-C until the function that is yielded is called, or the block ends.

    An exception inside a call back of compiled code would end the process. The interrupt then
    does as it would have done. Only the main thread is ever interrupted.
    """
    before, pressed = signal.getsignal(signal.SIGINT), []  # type: ignore[var-annotated]

    def interrupt() -> None:
        while pressed and callable(before):
            before(*pressed.pop())

    if threading.current_thread() is not threading.main_thread() or not callable(before):
        yield interrupt
        return
    signal.signal(signal.SIGINT, lambda *press: pressed.append(press))
    try:
        yield interrupt
        interrupt()
    finally:
        signal.signal(signal.SIGINT, before)
