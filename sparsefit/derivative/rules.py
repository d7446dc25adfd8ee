"""The ways to take a derivative: the forward difference (Eq. 15) and better ones."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from sparsefit.arrays import Array
from sparsefit.derivative.agreement import Agreement, agreement_of
from sparsefit.derivative.carried import Carried
from sparsefit.derivative.kernels import polynomial_kernels
from sparsefit.derivative.outliers import unexplained
from sparsefit.derivative.pieces import Pieces
from sparsefit.derivative.repair import Repairs, repaired, untouched
from sparsefit.derivative.samples import Samples
from sparsefit.derivative.smoothing import FEWEST, Channels, Smoothing, smooth
from sparsefit.derivative.steps import uniform_step
from sparsefit.derivative.weak import ORDER, WeakRows, automatic_window, weak_rows
from sparsefit.errors import InputError, integer, is_integer, one_of
from sparsefit.flight import Flight
from sparsefit.flight.record import MINIMUM_SAMPLES

# time (m,), state (m, 4), its rate (m, 4), how they were smoothed
Rates: TypeAlias = tuple[Array, Array, Array, Smoothing]
Rule: TypeAlias = "Callable[[Derivative, Pieces], Rates]"

SAVGOL = {"window": 5, "order": 4}  # the defaults
WEAK_ORDERS = (2, 32)  # of the test functions: smoother than a corner, wider than a spike


@dataclass(frozen=True)
class Derivative:
    """How derivatives are taken from a flight's samples; position and velocity alike.

    Called with a flight of m samples it returns `Samples`, fewer than m where a rule needs
    neighbours on both sides.

    - ``forward``: Eq. 15, first order; the last sample is dropped.
    - ``central``: three points, any spacing, second order; both ends are dropped.
    - ``midpoint``: difference quotient and mean state of two neighbours, second order.
    - ``savgol``: a polynomial of ``order`` fitted to ``window`` samples (Savitzky and Golay,
      1964), states smoothed too; uniform steps only; half a window is dropped at either end.
    - ``auto``: one polynomial through position and velocity, its window chosen from the flight
      by an unbiased risk (`sparsefit.derivative.smoothing`). Short flights, and uneven steps
      that are not repaired, fall back to ``midpoint``: ``smoothing`` says so.
    - ``weak``: no derivative; averages by test functions (`sparsefit.derivative.weak`) of the
      states that ``auto`` smooths, or as measured where it cannot; any spacing.

    Args:
        method: one of `METHODS`.
        window: samples in the savgol window, odd, >= 3; None is 5. Of ``weak`` the width of a test
            function, odd, >= 5; None is the window of ``auto``, at least 21. Others have none.
        order: degree of the savgol polynomial, 1 <= order < window; None is 4. Of ``weak`` the
            exponent of the test functions, 2 to 32; None is 8.
        repair: whether outliers, jumps, gaps, repeated samples and, for ``auto`` and ``weak``,
            uneven time steps are mended before (`sparsefit.derivative.repair`). Clean flights
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
        if self.method == "savgol":
            self._check_savgol()
        elif self.method == "weak":
            self._check_weak()
        elif self.window is not None or self.order is not None:
            raise InputError(
                f"derivative {self.method!r} has no window and no order; leave them out, or "
                "use method 'savgol' or 'weak'"
            )

    def _check_savgol(self) -> None:
        for name, default in SAVGOL.items():
            if getattr(self, name) is None:
                object.__setattr__(self, name, default)
        assert self.window is not None
        largest = integer("window", self.window, 3, odd=True) - 1
        if not is_integer(self.order, 1, largest):
            raise InputError(
                f"order must be an integer from 1 to window - 1 = {largest}; got {self.order!r}"
            )

    def _check_weak(self) -> None:
        if self.order is None:
            object.__setattr__(self, "order", ORDER)
        if self.window is not None:
            integer("weak window", self.window, 5, odd=True)
        if not is_integer(self.order, *WEAK_ORDERS):
            least, most = WEAK_ORDERS
            raise InputError(
                f"weak order must be an integer from {least} to {most}; got {self.order!r}"
            )

    def _weak(
        self, log: Pieces, time: Array, state: Array, smoothing: Smoothing, thrust: Carried | None
    ) -> WeakRows:
        """Rows of the smoothed states; of the measured ones where nothing was smoothed."""
        if smoothing.method != "auto":
            time, state = log.time, np.hstack([log.position, log.velocity])
        window = self.window or automatic_window(len(time), smoothing.window)
        rows = weak_rows(time, state[:, :2], state[:, 2:], window, self.order or ORDER)
        return rows if thrust is None else thrust.averaged(rows, time)

    def __call__(self, flight: Flight) -> Samples:
        """Return states and derivatives of ``flight``.

        Raises:
            InputError: with ``savgol`` and ``weak``, if the flight is shorter than the window;
                with ``savgol``, if its time steps are not uniform.
        """
        log, repairs = self._log(flight)
        carried, thrust = Carried.of(flight, log), None
        moved = log if carried is None else carried.without(log)
        time, state, rate, smoothing = _RULES[self.method](self, moved)
        if carried is not None:
            state, rate, thrust = carried.restored(time, state, rate)
        weak = None
        if self.method == "weak":
            weak = self._weak(log, time, state, smoothing, carried)
        return Samples(
            time=time,
            position=state[:, :2],
            velocity=state[:, 2:],
            position_rate=rate[:, :2],
            acceleration=rate[:, 2:],
            smoothing=smoothing,
            weak=weak,
            repairs=repairs,
            agreement=_agreement(log, smoothing),
            thrust=thrust,
        )

    def _log(self, flight: Flight) -> tuple[Pieces, Repairs]:
        """The samples that the derivative is taken of, and what was mended in them."""
        if not self.repair:
            return untouched(flight), Repairs()
        smoothed = _RULES[self.method] is _auto
        shortest = FEWEST if smoothed else self.window or MINIMUM_SAMPLES
        return repaired(flight, even=smoothed, shortest=shortest)


def _agreement(log: Pieces, smoothing: Smoothing) -> Agreement | None:
    """Of the longest piece."""
    if smoothing.method != "auto" or smoothing.positions_only:
        return None
    piece = max(log.slices, key=lambda rows: rows.stop - rows.start)
    step, position = log.step(), log.position[piece]
    left = unexplained(position, log.velocity[piece], step)
    moved = np.diff(position, axis=0) - left
    return agreement_of(left, moved, step, smoothing.sigma_position, smoothing.sigma_velocity)


def _in_each_piece(rule: Callable[[Derivative, Array, Array], Rates]) -> Rule:
    """The rule for a log with gaps, none of which a difference may cross."""

    def apply(derivative: Derivative, log: Pieces) -> Rates:
        state = np.hstack([log.position, log.velocity])
        parts = [rule(derivative, log.time[piece], state[piece]) for piece in log.slices]
        if len(parts) == 1:
            return parts[0]
        times, states, rates, smoothing = zip(*parts, strict=True)
        return np.concatenate(times), np.vstack(states), np.vstack(rates), smoothing[0]

    return apply


def _forward(_: Derivative, time: Array, state: Array) -> Rates:
    return time[:-1], state[:-1], _quotients(time, state), Smoothing("forward", rate_window=2)


def _central(_: Derivative, time: Array, state: Array) -> Rates:
    """Weight the two quotients by the opposite step, which cancels the second-order term."""
    quotient, steps = _quotients(time, state), np.diff(time)[:, None]
    before, after = steps[:-1], steps[1:]
    rate = (after * quotient[:-1] + before * quotient[1:]) / (before + after)
    return time[1:-1], state[1:-1], rate, Smoothing("central", rate_window=3)


def _midpoint(_: Derivative, time: Array, state: Array) -> Rates:
    middle = time[:-1] + np.diff(time) / 2.0
    mean = (state[:-1] + state[1:]) / 2.0
    smoothing = Smoothing("midpoint", window=2, rate_window=2)
    return middle, mean, _quotients(time, state), smoothing


def _savgol(rule: Derivative, time: Array, state: Array) -> Rates:
    """Only full windows are kept: the polynomial at an edge extrapolates."""
    window, order = rule.window, rule.order
    assert window is not None
    assert order is not None
    if len(time) < window:
        raise InputError(
            f"savgol window {window} is longer than the flight of {len(time)} samples: "
            "use a smaller window, or central"
        )
    step = uniform_step(time)
    full = slice(window // 2, len(time) - window // 2)
    value, slope, _ = polynomial_kernels(window, order, 1.0)
    smoothed, rate = (
        np.stack([np.correlate(column, kernel, "valid") for column in state.T], axis=1)
        for kernel in (value, slope)
    )
    smoothing = Smoothing("savgol", window=window, rate_window=window, order=order)
    return time[full], smoothed, rate / step, smoothing


def _auto(rule: Derivative, log: Pieces) -> Rates:
    """Only full windows are kept, as in savgol; positions are centred to keep their digits."""
    count = len(log.time)
    if count < FEWEST:
        return _fallen_back(rule, log, f"{count} samples are fewer than {FEWEST}")
    if any(piece.stop - piece.start < FEWEST for piece in log.slices):
        return _fallen_back(rule, log, f"no {FEWEST} samples without a gap")
    if not log.even():
        return _fallen_back(rule, log, "time steps are not uniform")
    origin = log.position.mean(axis=0)
    channels = Channels.measured(
        log.position - origin,
        log.velocity,
        log.step(),
        log.starts,
        positions_only=not log.velocity_measured,
    )
    kept, smoothed, rate, smoothing = smooth(channels)
    smoothed[:, :2] += origin
    return log.time[kept], smoothed, rate, smoothing


def _fallen_back(rule: Derivative, log: Pieces, reason: str) -> Rates:
    middle, mean, rate, smoothing = _in_each_piece(_midpoint)(rule, log)
    return middle, mean, rate, replace(smoothing, reason=reason)


def _quotients(time: Array, state: Array) -> Array:
    """Difference quotients (m - 1, 4) of neighbours."""
    return np.diff(state, axis=0) / np.diff(time)[:, None]


_RULES: dict[str, Rule] = {
    "forward": _in_each_piece(_forward),
    "central": _in_each_piece(_central),
    "midpoint": _in_each_piece(_midpoint),
    "savgol": _in_each_piece(_savgol),
    "auto": _auto,
    "weak": _auto,
}
METHODS: tuple[str, ...] = tuple(_RULES)
