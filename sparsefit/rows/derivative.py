"""State derivatives from samples: the forward difference (Eq. 15) and better ones."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sparsefit.arrays import Array
from sparsefit.errors import InputError, integer, is_integer, one_of
from sparsefit.flight import Flight
from sparsefit.flight.record import MINIMUM_SAMPLES
from sparsefit.logs.checks import ONE_STEP, clock_rounding
from sparsefit.rows.clean import Pieces, Repairs, repaired
from sparsefit.rows.samples import ORDER, Samples, weak_form
from sparsefit.rows.smoothing import FEWEST, Rates, Smoothing, polynomial_kernels, smooth

METHODS = ("forward", "central", "midpoint", "savgol", "auto", "weak")
SMOOTHED = ("auto", "weak")
DEFAULTS = {"savgol": (5, 4), "weak": (None, ORDER)}  # window and order


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
    - ``auto``: one polynomial through position and velocity, its window chosen from the flight
      by an unbiased risk (`sparsefit.rows.smoothing`). Short flights, and uneven steps
      that are not repaired, fall back to ``midpoint``: ``smoothing`` says so.
    - ``weak``: no derivative; averages by test functions (`sparsefit.rows.samples`) of the
      states that ``auto`` smooths, or as measured where it cannot; any spacing.

    Args:
        method: one of `METHODS`.
        window: samples in the savgol window, odd, >= 3; None is 5. Of ``weak`` the width of a test
            function, odd, >= 5; None is the window of ``auto``, at least 21. Others have none.
        order: degree of the savgol polynomial, 1 <= order < window; None is 4. Of ``weak`` the
            exponent of the test functions, 2 to 32; None is 8.
        repair: whether outliers, jumps, gaps, repeated samples and, for ``auto`` and ``weak``,
            uneven time steps are mended before (`sparsefit.rows.clean`). Clean flights
            are not changed by it.

    Raises:
        InputError: if a setting is out of its range.
    """

    method: str = "auto"
    window: int | None = None
    order: int | None = None
    repair: bool = True

    def __post_init__(self) -> None:
        """Check the settings, and store the defaults of the method where none are given."""
        one_of("derivative", self.method, METHODS)
        if not isinstance(self.repair, bool):
            raise InputError(f"derivative repair must be true or false; got {self.repair!r}")
        if self.method not in DEFAULTS:
            if self.window is not None or self.order is not None:
                raise InputError(
                    f"derivative {self.method!r} has no window and no order; leave them out, or "
                    "use method 'savgol' or 'weak'"
                )
            return
        for name, default in zip(("window", "order"), DEFAULTS[self.method], strict=True):
            if getattr(self, name) is None:
                object.__setattr__(self, name, default)
        if self.method == "savgol":
            largest = integer("window", self.window or 0, 3, odd=True) - 1
            if not is_integer(self.order, 1, largest):
                raise InputError(
                    f"order must be an integer from 1 to window - 1 = {largest}; got {self.order!r}"
                )
            return
        if self.window is not None:
            integer("weak window", self.window, 5, odd=True)
        if not is_integer(self.order, 2, 32):  # smoother than a corner, wider than a spike
            raise InputError(f"weak order must be an integer from 2 to 32; got {self.order!r}")

    def __call__(self, flight: Flight) -> Samples:
        """Return states and derivatives of ``flight``.

        Raises:
            InputError: with ``savgol`` and ``weak``, if the flight is shorter than the window;
                with ``savgol``, if its time steps are not uniform.
        """
        log, repairs = Pieces.of(flight), Repairs()
        if self.repair:
            smoothed = self.method in SMOOTHED
            shortest = FEWEST if smoothed else self.window or MINIMUM_SAMPLES
            log, repairs = repaired(flight, even=smoothed, shortest=shortest)
        time, state, rate, smoothing = self._rates(log)

        def push_at(times: Array) -> Array | None:
            if flight.thrust is None:
                return None
            return np.stack([np.interp(times, flight.time, a) for a in flight.thrust.T], axis=1)

        averages = None
        if self.method == "weak":
            smooth_ = smoothing.method == "auto"
            times, states = (time, state) if smooth_ else (log.time, log.state)
            width = smoothing.window if smooth_ else 1
            settings = self.window, self.order or ORDER
            averages = weak_form(times, states, *settings, push_at(times), smoothed=width)
        halves = state[:, :2], state[:, 2:], rate[:, :2], rate[:, 2:]
        return Samples(time, *halves, smoothing, averages, repairs, push_at(time))

    def _rates(self, log: Pieces) -> Rates:
        """States and rates of a log in pieces, none of which a difference crosses."""
        reason = ""
        if self.method in SMOOTHED:
            if len(log.time) < FEWEST:
                reason = f"{len(log.time)} samples are fewer than {FEWEST}"
            elif log.lengths.min() < FEWEST:
                reason = f"no {FEWEST} samples without a gap"
            elif not log.even:
                reason = "time steps are not uniform"
            else:
                return smooth(log)
        parts = [self._differences(log.time[piece], log.state[piece]) for piece in log.slices]
        times, states, rates, filters = zip(*parts, strict=True)
        smoothing = replace(filters[0], reason=reason)
        return np.concatenate(times), np.vstack(states), np.vstack(rates), smoothing

    def _differences(self, time: Array, state: Array) -> Rates:
        """States and rates of one piece, states (m, 4) at times (m,), by the fixed filters."""
        steps = np.diff(time)[:, None]
        if self.method == "savgol":  # in full windows only: at an edge a polynomial extrapolates
            window, order, mean = self._savgol(time, steps[:, 0])
            full = slice(window // 2, len(time) - window // 2)
            value, slope = (
                np.stack([np.correlate(column, kernel, "valid") for column in state.T], axis=1)
                for kernel in polynomial_kernels(window, order, 1.0)[:2]
            )
            own = Smoothing("savgol", window=window, rate_window=window, order=order)
            return time[full], value, slope / mean, own
        quotient = np.diff(state, axis=0) / steps
        if self.method == "forward":
            return time[:-1], state[:-1], quotient, Smoothing("forward", rate_window=2)
        if self.method == "central":  # weights by the opposite step cancel the second-order term
            before, after = steps[:-1], steps[1:]
            rate = (after * quotient[:-1] + before * quotient[1:]) / (before + after)
            return time[1:-1], state[1:-1], rate, Smoothing("central", rate_window=3)
        middle, mean_state = time[:-1] + np.diff(time) / 2.0, (state[:-1] + state[1:]) / 2.0
        return middle, mean_state, quotient, Smoothing("midpoint", window=2, rate_window=2)

    def _savgol(self, time: Array, steps: Array) -> tuple[int, int, float]:
        """Window, order and mean step [s]; InputError where times (m,) do not suit a polynomial."""
        window, mean = self.window or 0, float(time[-1] - time[0]) / len(steps)
        if len(time) < window:
            raise InputError(
                f"savgol window {window} is longer than the flight of {len(time)} samples: "
                "use a smaller window, or central"
            )
        row = int(np.argmax(np.abs(steps - mean)))
        if abs(steps[row] - mean) > ONE_STEP * mean + clock_rounding(time):
            raise InputError(
                f"savgol needs uniform time steps; the step after row {row} is {steps[row]:.6g} s, "
                f"the mean {mean:.6g} s: use central or midpoint"
            )
        return window, self.order or 0, mean
