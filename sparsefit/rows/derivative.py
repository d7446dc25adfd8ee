"""State derivatives from samples: the forward difference (Eq. 15) and better ones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sparsefit.arrays import Array
from sparsefit.errors import InputError, integer, is_integer, one_of
from sparsefit.flight import Flight
from sparsefit.rows.clean import LogPieces, Repairs, pieces_of, repaired
from sparsefit.rows.samples import ORDER, SHORTEST, Samples, weak_form
from sparsefit.rows.smoothing import (
    FEWEST,
    Rates,
    Smoothing,
    filtered,
    polynomial_kernels,
    smooth,
)

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
    - ``auto``: a polynomial through position and one through velocity, their windows chosen from
      the flight by an unbiased risk (`sparsefit.rows.smoothing`). Short flights, and uneven steps
      that are not repaired, fall back to ``midpoint``: ``smoothing`` says so.
    - ``weak``: no derivative; averages by test functions (`sparsefit.rows.samples`) of the
      states that ``auto`` smooths, or as measured where it cannot; any spacing.

    Args:
        method: one of `METHODS`.
        window: samples in the savgol window, odd, >= 3; None is 5. Of ``weak`` the width of a test
            function, odd, >= 5; None is the window of ``auto``, at least 21. Others have none.
        order: degree of the savgol polynomial, 1 <= order < window; None is 4. Of ``weak`` the
            exponent of the test functions, 2 to 32; None is 8.
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
        """Check the settings, and store the defaults of the method where none are given."""
        one_of("derivative", self.method, METHODS)
        if not isinstance(self.repair, bool):
            raise InputError(f"derivative repair must be true or false; got {self.repair!r}")
        settings = DEFAULTS.get(self.method, (None, None))
        if settings == (None, None) and (self.window, self.order) != settings:
            raise InputError(
                f"derivative {self.method!r} has no window and no order; leave them out, or "
                "use method 'savgol' or 'weak'"
            )
        for name, default in zip(("window", "order"), settings, strict=True):
            if getattr(self, name) is None:
                object.__setattr__(self, name, default)
        if self.method == "savgol":
            largest = integer("window", self.window or 0, 3, odd=True) - 1
            if not is_integer(self.order, 1, largest):
                raise InputError(
                    f"order must be an integer from 1 to window - 1 = {largest}; got {self.order!r}"
                )
        if self.method == "weak":
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
        log, repairs = pieces_of(flight), Repairs()
        if self.repair:
            log, repairs = repaired(flight, even=self.method in SMOOTHED)
        time, state, rate, smoothing = self._rates(log)

        def push_at(times: Array) -> Array | None:
            if flight.thrust is None:
                return None
            return np.stack([np.interp(times, flight.time, a) for a in flight.thrust.T], axis=1)

        averages = None
        if self.method == "weak":
            states = (time, state) if smoothing.method == "auto" else (log.time, log.state)
            window = self.window
            if window is None:
                window = max(smoothing.window if smoothing.method == "auto" else 1, SHORTEST)
                window = max(5, min(window, 2 * (len(states[0]) // 6) + 1))
            averages = weak_form(*states, window, self.order or ORDER, push_at(states[0]))
        halves = state[:, :2], state[:, 2:], rate[:, :2], rate[:, 2:]
        return Samples(time, *halves, smoothing, averages, repairs, push_at(time))

    def _rates(self, log: LogPieces) -> Rates:
        """States and rates of a log, none across a gap."""
        reason = ""
        if self.method in SMOOTHED:
            if len(log.time) < FEWEST:
                reason = f"{len(log.time)} samples are fewer than {FEWEST}"
            elif not log.whole(FEWEST).any():
                reason = f"no {FEWEST} samples without a gap"
            elif not log.even:
                reason = "time steps are not uniform"
            else:
                return smooth(log)
        time, state = log.time, log.state
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
            kernels = polynomial_kernels(window, order, 1.0)
            value, slope = (filtered(state, kernel) for kernel in kernels[:2])
            own = Smoothing("savgol", window=window, rate_window=window, order=order)
            rows, width = (time[window // 2 :][: len(value)], value, slope / log.step), window
        else:
            steps = np.diff(time)[:, None]
            quotient = np.diff(state, axis=0) / steps
            if self.method == "forward":
                own, width = Smoothing("forward", rate_window=2), 2
                rows = time[:-1], state[:-1], quotient
            elif self.method == "central":  # opposite steps cancel the second-order term
                before, after = steps[:-1], steps[1:]
                rate = (after * quotient[:-1] + before * quotient[1:]) / (before + after)
                own, width = Smoothing("central", rate_window=3), 3
                rows = time[1:-1], state[1:-1], rate
            else:
                own, width = Smoothing("midpoint", reason, window=2, rate_window=2), 2
                rows = time[:-1] + np.diff(time) / 2.0, (state[:-1] + state[1:]) / 2.0, quotient
        if not len(log.starts):
            return *rows, own
        whole = log.whole(width)
        return rows[0][whole], rows[1][whole], rows[2][whole], own
