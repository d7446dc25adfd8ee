"""Rows of a flight: states and their derivatives, or averages of them.

Derivatives are the forward difference (Eq. 15) and better ones. Averages are the weak form
(Messenger and Bortz, 2021). With a bump psi_i(t) = c (1 - s^2)^p, s = (t - t_i) / reach, of unit
integral, integration by parts moves the derivative of v onto psi:

    int psi Phi dt = tau (-int psi' v dt - a) + int psi v dt = int psi C(x(t)) dt W

A row of Psi (q, m) holds the weights of the m samples, by the trapezoid rule, which is spectrally
accurate for such bumps on even steps.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from sparsefit.arrays import Array
from sparsefit.errors import InputError, integer, is_integer, one_of
from sparsefit.flight import Flight
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.logs.checks import clock_rounding
from sparsefit.rows.clean import LogPieces, Repairs, pieces_of
from sparsefit.rows.smoothing import (
    FEWEST,
    Rates,
    Smoothing,
    filtered,
    polynomial_kernels,
    smooth,
)

if TYPE_CHECKING:
    from scipy.sparse import csr_array

METHODS = ("forward", "central", "midpoint", "savgol", "auto", "weak")


@dataclass(frozen=True, eq=False)
class Samples:
    """States and their derivatives on m rows (Eq. 16): samples, or averages of samples.

    Args:
        time: t [s], (m,).
        position: [m], (m, 2); of averages that of the samples under them.
        velocity: [m/s], (m, 2).
        position_rate: the derivative of the position [m/s], (m, 2); the measured velocity is
            another one.
        acceleration: the derivative of the velocity [m/s^2], (m, 2).
        smoothing: the filter that made them; `none` where it was no `Derivative`.
        averages: the weak form, which the regression and the readout take in place of the
            samples; these, by ``auto``, then only serve the search.
        repairs: the samples that were replaced or dropped before.
        push: the measured acceleration by the vehicle's engines [m/s^2], (m, 2), or None.
        operator: Psi of averages, each row of sum 1; None of samples.
    """

    time: Array
    position: Array
    velocity: Array
    position_rate: Array
    acceleration: Array
    smoothing: Smoothing = Smoothing("none")
    averages: Samples | None = None
    repairs: Repairs = Repairs()
    push: Array | None = None
    operator: csr_array | None = None

    @property
    def source(self) -> Samples:
        """The rows of the regression: averages where there are any, else the samples."""
        return self.averages or self

    def flow_velocity(self, vehicle: PointMassVehicle) -> Array:
        """Return the flow velocity Phi [m/s], (m, 2), that moved ``vehicle`` so (Eqs. 12-13).

        Raises InputError on averages where the vehicle's response is not linear.
        """
        if not vehicle.linear and self.operator is not None:
            raise InputError(
                "the weak form averages the equation of motion, which this vehicle's quadratic "
                "response does not allow: use the derivative 'auto'"
            )
        return vehicle.flow_velocity(self.velocity, self.acceleration, self.push)

    def blocks(self) -> Iterator[tuple[slice, Samples]]:
        """Rows in blocks of bounded memory: which they are, and the samples under them."""
        psi, count = self.operator, len(self.velocity)
        size = 4096 if psi is None else 256
        for start in range(0, count, size):
            rows = span = slice(start, min(start + size, count))
            if psi is not None:
                used = psi.indices[psi.indptr[rows.start] : psi.indptr[rows.stop]]
                span = slice(int(used.min()), int(used.max()) + 1)
            own = None if psi is None else psi[rows, span]
            yield rows, replace(self, position=self.position[span], operator=own)

    def averaged(self, values: Array) -> Array:
        """Psi times values of one row or more per sample, (r m, k); the values of samples."""
        if self.operator is None:
            return values
        flat = values.reshape(len(self.position), -1)
        return np.asarray(self.operator @ flat).reshape(-1, values.shape[1])

    def every(self, step: int) -> Samples:
        """Every so many-th of the samples."""
        arrays: dict[str, Any] = {
            name: own[::step] for name, own in vars(self).items() if isinstance(own, np.ndarray)
        }
        return replace(self, **arrays)

    @classmethod
    def joined(cls, flights: Sequence[Samples]) -> Samples:
        """The states and rates of several flights one after another."""
        names = ("time", "position", "velocity", "position_rate", "acceleration")
        parts = [np.concatenate([vars(flight)[name] for flight in flights]) for name in names]
        return cls(parts[0], parts[1], parts[2], parts[3], parts[4])


@dataclass(frozen=True)
class Derivative:
    """The filter that takes derivatives of a flight's samples; position and velocity alike.

    Called with a flight of m samples it returns `Samples`, fewer than m where a rule needs
    neighbours on both sides.

    - ``forward``: Eq. 15, first order; the last sample is dropped.
    - ``central``: three points, any spacing, second order; both ends are dropped.
    - ``midpoint``: difference quotient and mean state of two neighbours, second order.
    - ``savgol``: a polynomial of ``order`` fitted to ``window`` samples (Savitzky and Golay,
      1964), states smoothed too; uniform steps only; half a window is dropped at either end.
    - ``auto``: a polynomial through position and one through velocity, their windows chosen from
      the flight by an unbiased risk (`sparsefit.rows.smoothing`). Short flights, and uneven steps
      that are not repaired, fall back to ``midpoint``: ``smoothing`` says so.
    - ``weak``: no derivative; averages by test functions, as wide as the
      window of ``auto`` and at least 21 samples, of the states that ``auto`` smooths, or as
      measured where it cannot; any spacing.

    Args:
        method: one of `METHODS`.
        window: samples in the savgol window, odd, >= 3; None is 5. Others have none.
        order: degree of the savgol polynomial, 1 <= order < window; None is 4.
        repair: whether outliers, gaps and, for ``auto`` and ``weak``, uneven time steps are mended
            before (`sparsefit.rows.clean`). Clean flights are not changed by it.

    Raises:
        InputError: if a setting is out of its range.
    """

    method: str = "auto"
    window: int | None = None
    order: int | None = None
    repair: bool = True

    def __post_init__(self) -> None:
        one_of("derivative", self.method, METHODS)
        if not isinstance(self.repair, bool):
            raise InputError(f"derivative repair must be true or false; got {self.repair!r}")
        if self.method != "savgol":
            if (self.window, self.order) != (None, None):
                raise InputError(
                    f"derivative {self.method!r} has no window and no order; leave them out, or "
                    "use method 'savgol'"
                )
            return
        window = integer("window", 5 if self.window is None else self.window, 3, odd=True)
        order = 4 if self.order is None else self.order
        if not is_integer(order, 1, window - 1):
            raise InputError(
                f"order must be an integer from 1 to window - 1 = {window - 1}; got {order!r}"
            )
        object.__setattr__(self, "window", window)
        object.__setattr__(self, "order", order)

    def __call__(self, flight: Flight) -> Samples:
        """Return states and derivatives of ``flight``.

        Raises:
            InputError: with ``savgol`` and ``weak``, if the flight is shorter than the window;
                with ``savgol``, if its time steps are not uniform.
        """
        smoothed, reason = self.method in ("auto", "weak"), ""
        log, repairs = pieces_of(flight, repair=self.repair, even=smoothed)
        if smoothed and len(log.time) < FEWEST:
            reason = f"{len(log.time)} samples are fewer than {FEWEST}"
        elif smoothed and not log.whole(FEWEST).any():
            reason = f"no {FEWEST} samples without a gap"
        elif smoothed and not log.even:
            reason = "time steps are not uniform"
        smoothed &= not reason
        time, state, rate, smoothing = smooth(log) if smoothed else self._rates(log, reason)

        def push_at(times: Array) -> Array | None:
            if flight.thrust is None:
                return None
            return np.stack([np.interp(times, flight.time, a) for a in flight.thrust.T], axis=1)

        averages = None
        if self.method == "weak":
            states = (time, state) if smoothed else (log.time, log.state)
            # Below 21 samples the quadrature errs by more than 1e-5 % of tau_w.
            window = min(max(smoothing.window, 21), 2 * (len(states[0]) // 6) + 1)
            averages = weak_form(*states, max(5, window), push=push_at(states[0]))
        halves = state[:, :2], state[:, 2:], rate[:, :2], rate[:, 2:]
        return Samples(time, *halves, smoothing, averages, repairs, push_at(time))

    def _rates(self, log: LogPieces, reason: str) -> Rates:
        """States and rates by differences or by one polynomial, none across a gap."""
        time, state = log.time, log.state
        steps = np.diff(time)[:, None]
        quotient = np.diff(state, axis=0) / steps
        if self.method == "savgol":  # in full windows only: at an edge a polynomial extrapolates
            window, order = self.window or 0, self.order or 0
            if not log.whole(window).any():
                raise InputError(
                    f"savgol window {window} is longer than the flight of {len(time)} samples: "
                    "use a smaller window, or central"
                )
            if not log.even:
                row = int(np.argmax(np.abs(log.away)))
                raise InputError(
                    f"savgol needs uniform time steps; the step after row {row} is "
                    f"{np.diff(time)[row]:.6g} s, the mean {log.step:.6g} s: use central or "
                    "midpoint"
                )
            own = Smoothing("savgol", window=window, rate_window=window, order=order)
            kernels = polynomial_kernels(window, order, 1.0)
            value, slope = (filtered(state, kernel) for kernel in kernels[:2])
            rows = time[window // 2 :][: len(value)], value, slope / log.step
        elif self.method == "forward":
            own = Smoothing("forward", rate_window=2)
            rows = time[:-1], state[:-1], quotient
        elif self.method == "central":  # opposite steps cancel the second-order term
            own = Smoothing("central", rate_window=3)
            before, after = steps[:-1], steps[1:]
            rate = (after * quotient[:-1] + before * quotient[1:]) / (before + after)
            rows = time[1:-1], state[1:-1], rate
        else:
            own = Smoothing("midpoint", reason, window=2, rate_window=2)
            rows = time[:-1] + np.diff(time) / 2.0, (state[:-1] + state[1:]) / 2.0, quotient
        whole = log.whole(own.rate_window)
        return rows[0][whole], rows[1][whole], rows[2][whole], own


def weak_form(
    time: Array, state: Array, window: int, order: int = 8, push: Array | None = None
) -> Samples:
    """The weak form of states x, y, vx, vy (m, 4) [m], [m/s] at times (m,) [s], as q averages.

    window: samples under a test function. order: the exponent p; 4 needs windows of 60 samples for
    an error of tau_w of 1e-4 %, 8 of 21. push: measured thrust (m, 2). Raises InputError where no
    test function fits into the flight.
    """
    from scipy.sparse import csr_array

    samples = len(time)
    step = float(time[-1] - time[0]) / (samples - 1)
    reach, slack = window // 2 * step, 1e-9 * step + clock_rounding(time)
    inside = (time - time[0] >= reach - slack) & (time[-1] - time >= reach - slack)
    # Ten test functions over any sample: twice as many change nothing.
    centres = time[inside][:: max(1, window // 10)]
    low = np.searchsorted(time, centres - reach - slack)
    counts = np.searchsorted(time, centres + reach + slack) - low
    present = counts >= 0.5 * window  # an integral over a gap in the log is none
    centres, low, counts = centres[present], low[present], counts[present]
    if not len(centres):
        raise InputError(
            f"no weak test function of {window} samples fits into {samples} samples: use a "
            "smaller window, or central"
        )
    ends = np.concatenate([[0], np.cumsum(counts)])
    row = np.repeat(np.arange(len(centres)), counts)
    column = np.arange(ends[-1]) - (ends[:-1] - low)[row]
    away, width = time[column] - centres[row], np.gradient(time)[column]
    s = np.clip(away / reach, -1.0, 1.0)
    mass = width * (1 - s * s) ** order
    total = np.bincount(row, mass)[row]
    slope = width * 2 * order * s * (1 - s * s) ** (order - 1) / (reach * total)
    mass /= total
    # Uneven steps: the quadrature of -psi' is made exact for constant and linear velocities.
    slope -= np.bincount(row, slope)[row] * mass
    slope /= np.bincount(row, slope * away)[row]
    shape = (len(centres), samples)
    mean, rate = (csr_array((values, column, ends), shape=shape) for values in (mass, slope))
    rates = rate @ state
    return Samples(
        centres,
        state[:, :2],
        mean @ state[:, 2:],
        rates[:, :2],
        rates[:, 2:],
        Smoothing("weak", window=window),
        push=None if push is None else mean @ push,
        operator=mean,
    )
