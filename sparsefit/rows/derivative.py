"""Rows of a flight: states and their derivatives, or averages of them, by one linear filter each.

A polynomial is fitted to a window of n samples and evaluated with its derivatives in the middle
(Savitzky and Golay, 1964). ``auto`` chooses the windows of least estimated risk (Mallows, 1973;
Stein, 1981): with h the weight of the middle sample in its own estimate,

    risk(n) = mean((v - v_n)^2) / sigma^2 + 2 h.

Averages are the weak form (Messenger and Bortz, 2021). With a bump psi_i(t) = c (1 - s^2)^p, s =
(t - t_i) / reach, of unit integral, integration by parts moves the derivative from v to psi:

    int psi Phi dt = tau (-int psi' v dt - a) + int psi v dt = int psi C(x(t)) dt W

A row of Psi (q, m) holds the weights of the m samples, by the trapezoid rule, which is spectrally
accurate for such bumps on even steps.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from sparsefit.arrays import Array
from sparsefit.errors import InputError, integer, is_integer, one_of, shown
from sparsefit.flight import Flight
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.rows.clean import LogPieces, Repairs, filtered, pieces_of

if TYPE_CHECKING:
    from scipy.sparse import csr_array

METHODS = ("forward", "central", "midpoint", "savgol", "auto", "weak")
POWER = 8  # p of a test function: tau_w errs by 1e-4 % in windows of 21 samples, by 4 of 60
ORDER = 10  # of the polynomial; 4 doubles the error of tau_w at 0.5 m/s of noise, 8 and 10 agree
SHORTEST = ORDER + 1  # samples of a window
SIDE_BY_SIDE = 5  # windows in a flight: longer windows lose more rows at the ends than they gain
FEWEST = SIDE_BY_SIDE * SHORTEST  # samples of a flight that can be smoothed
JUDGED = 20_000  # samples, from the middle of the flight, by which windows are chosen
Rates = tuple[Array, Array, Array, "Smoothing"]  # time (q,), state (q, 4), rate (q, 4), the filter


@dataclass(frozen=True)
class Smoothing:
    """The filter of states and derivatives, and the noise levels of the flight."""

    method: str  # the method used, after a fall-back
    reason: str = ""  # for a fall-back
    window: int = 1  # samples under the filters of position and velocity; 1: none is smoothed
    rate_window: int = 1  # samples in the window of the acceleration
    order: int = 0  # degree of the polynomial; 0 where there is none
    sigma_position: float = math.nan  # of the measured position's noise [m], NaN if not estimated
    sigma_velocity: float = math.nan  # of the measured velocity's [m/s], 0 where it was not


@dataclass(frozen=True, eq=False)
class Samples:
    """States and their derivatives on m rows (Eq. 16): samples, or averages of samples."""

    time: Array  # t [s], (m,)
    position: Array  # [m], (m, 2); of averages that of the samples under them
    velocity: Array  # [m/s], (m, 2)
    position_rate: Array  # the position's derivative [m/s], (m, 2), not the measured velocity
    acceleration: Array  # the derivative of the velocity [m/s^2], (m, 2)
    smoothing: Smoothing = Smoothing("none")  # the filter that made them
    averages: Samples | None = None  # the rows of the regression and the readout, if not these
    repairs: Repairs = Repairs()  # of the log
    push: Array | None = None  # the measured thrust acceleration [m/s^2], (m, 2)
    operator: csr_array | None = None  # Psi of averages, each row of sum 1

    def flow_velocity(self, vehicle: PointMassVehicle) -> Array:
        """Return the flow velocity Phi [m/s], (m, 2), by the equation of motion (Eqs. 12-13).

        Raises InputError on averages if the vehicle's law is not linear.
        """
        if not vehicle.linear and self.operator is not None:
            raise InputError(
                "the weak form averages the equation of motion, which this vehicle's quadratic "
                "response does not allow: use the derivative 'auto'"
            )
        return vehicle.flow_velocity(self.velocity, self.acceleration, self.push)

    def averaged(self, values: Array) -> Array:
        """Psi times values (r m, k) of r rows per sample; of samples the values themselves."""
        if self.operator is None:
            return values
        flat = values.reshape(len(self.position), -1)
        return np.asarray(self.operator @ flat).reshape(-1, values.shape[1])

    def rows(self, chosen: slice) -> Samples:
        """Some of the rows, with the samples under them."""
        own: dict[str, Any] = {
            name: rows[chosen] for name, rows in vars(self).items() if isinstance(rows, np.ndarray)
        }
        if self.operator is not None:
            psi = self.operator[chosen]
            under = slice(int(psi.indices.min()), int(psi.indices.max()) + 1)
            own |= {"position": self.position[under], "operator": psi[:, under]}
        return replace(self, **own)


@dataclass(frozen=True)
class Derivative:
    """The filter that takes the derivatives of a flight's position and velocity.

    Called with a flight it returns `Samples`, without those at the ends that lack neighbours.

    - ``forward``: Eq. 15, first order.
    - ``central``: three points, any spacing, second order.
    - ``midpoint``: difference quotient and mean state of two neighbours, second order.
    - ``savgol``: a polynomial of ``order``, 4 by default, through ``window`` samples, an odd
      number, 5 by default; states are smoothed too; uniform steps only.
    - ``auto``: a polynomial through position and one through velocity, their windows chosen from
      the flight by an unbiased risk estimate. Short flights, and uneven steps that are not
      repaired, fall back to ``midpoint``, with a reason in ``smoothing``.
    - ``weak``: averages by test functions, as wide as the window of ``auto`` and at least 21
      samples, of the states smoothed by ``auto``, in short flights as measured; uniform steps.

    ``repair``: whether outliers, gaps and, for ``auto`` and ``weak``, uneven time steps are
    repaired first (`sparsefit.rows.clean`). Raises InputError on settings that are out of range.
    """

    method: str = "auto"
    window: int | None = None
    order: int | None = None
    repair: bool = True

    def __post_init__(self) -> None:
        one_of("derivative", self.method, METHODS)
        if self.method != "savgol":
            if (self.window, self.order) != (None, None):
                words = f"derivative {self.method!r} has no window and no order"
                raise InputError(f"{words}; leave them out, or use method 'savgol'")
            return
        window = integer("window", 5 if self.window is None else self.window, 3, odd=True)
        order = 4 if self.order is None else self.order
        if not is_integer(order, 1, window - 1):
            raise InputError(
                f"order must be an integer from 1 to window - 1 = {window - 1}; got {shown(order)}"
            )
        object.__setattr__(self, "window", window)
        object.__setattr__(self, "order", order)

    def __call__(self, flight: Flight) -> Samples:
        """Return states and derivatives of ``flight``.

        Raises InputError where the flight is shorter than a window, or steps that must be uniform
        are not.
        """
        tuned, reason = self.method in ("auto", "weak"), ""
        log, repairs = pieces_of(flight, repair=self.repair, even=tuned)
        if self.method in ("savgol", "weak") and not log.even:
            words = f"they are {log.steps.min():.6g} to {log.steps.max():.6g} s"
            raise InputError(f"{self.method} needs uniform time steps; {words}: use central")
        if tuned and not len(log.windows(FEWEST)):
            reason = f"no {FEWEST} samples without a gap"
        elif tuned and not log.even:
            reason = "time steps are not uniform"
        *every, own = smooth(log) if tuned and not reason else self._rates(log, reason)
        whole = log.windows(max(own.window, own.rate_window))
        time, state, rate = (values[whole] for values in every)

        def push_at(times: Array) -> Array | None:
            if flight.thrust is None:
                return None
            return np.stack([np.interp(times, flight.time, a) for a in flight.thrust.T], axis=1)

        averages = None
        if self.method == "weak":
            if not reason:
                log = replace(log, time=time, state=state, piece=log.piece[whole])
            # Below 21 samples the quadrature errs by more than 1e-5 % of tau_w.
            window = max(5, min(max(own.window, 21), 2 * (len(log.time) // 6) + 1))
            averages = weak_form(log, window, push_at(log.time))
        return Samples(
            time, state[:, :2], state[:, 2:], rate[:, :2], rate[:, 2:], own,
            averages, repairs, push_at(time),
        )  # fmt: skip

    def _rates(self, log: LogPieces, reason: str) -> Rates:
        """States and rates by differences or by one polynomial, across gaps too."""
        time, state = log.time, log.state
        if self.method == "savgol":  # in full windows only: at the ends it would extrapolate
            window, order = self.window or 0, self.order or 0
            if not len(log.windows(window)):
                words = f"savgol window {window} does not fit into {len(time)} samples"
                raise InputError(f"{words}: use a smaller window, or central")
            value, slope = (filtered(state, own) for own in polynomial_kernels(window, order)[:2])
            times = time[window // 2 :][: len(value)]
            return times, value, slope / log.step, Smoothing("savgol", "", window, window, order)
        steps = np.diff(time)[:, None]
        quotient = np.diff(state, axis=0) / steps
        if self.method == "forward":
            return time[:-1], state[:-1], quotient, Smoothing("forward", rate_window=2)
        if self.method == "central":  # opposite steps cancel the second-order term
            before, after = steps[:-1], steps[1:]
            rate = (after * quotient[:-1] + before * quotient[1:]) / (before + after)
            return time[1:-1], state[1:-1], rate, Smoothing("central", rate_window=3)
        times, states = time[:-1] + np.diff(time) / 2.0, (state[:-1] + state[1:]) / 2.0
        return times, states, quotient, Smoothing("midpoint", reason, 2, 2)


def weak_form(log: LogPieces, window: int, push: Array | None = None) -> Samples:
    """The weak form of a log on even steps, as q averages that cross no gap.

    window: samples under a test function. push: measured thrust (m, 2). Raises InputError if no
    test function fits into the flight.
    """
    from scipy.sparse import csr_array

    # Ten test functions over any sample: twice as many change nothing.
    first = log.windows(window)[:: max(1, window // 10)]
    if not len(first):
        words = f"no weak test function of {window} samples fits into {len(log.time)} samples"
        raise InputError(f"{words}: use central, or a longer log")
    s = np.linspace(-1.0, 1.0, window)
    psi, slope = (1.0 - s * s) ** POWER, s * (1.0 - s * s) ** (POWER - 1)
    psi /= psi.sum()
    slope /= float(slope @ s) * (window // 2) * log.step  # a straight line's is exact
    columns, starts = first[:, None] + np.arange(window), window * np.arange(len(first) + 1)
    values, shape = np.tile(psi, len(first)), (len(first), len(log.time))
    mean, rates = csr_array((values, columns.ravel(), starts), shape), filtered(log.state, slope)
    return Samples(
        log.time[window // 2 :][first], log.state[:, :2], mean @ log.state[:, 2:],
        rates[first, :2], rates[first, 2:], Smoothing("weak", window=window),
        push=None if push is None else mean @ push, operator=mean,
    )  # fmt: skip


@lru_cache(maxsize=256)
def polynomial_kernels(window: int, order: int) -> Array:
    """Weights (3, n), read-only, of n samples, 1 apart, in p, p' and p'' at their middle."""
    reach = window // 2
    powers = np.vander(np.linspace(-1.0, 1.0, window), order + 1, increasing=True)
    kernels = np.zeros((3, window))
    kernels[: order + 1] = np.linalg.pinv(powers)[:3]
    kernels *= np.array([1.0, 1.0 / reach, 2.0 / reach**2])[:, None]
    kernels.flags.writeable = False
    return kernels


def noise_level(values: Array, log: LogPieces) -> float:
    """Standard deviation of white noise on smooth columns (m, c), at least that of rounding.

    The q-th difference of white noise has the variance C(2q, q) sigma^2; the rest of the signal
    only adds to it, so the least over several q is taken (Rice, 1984; Gasser, Sroka and
    Jennen-Steinmetz, 1986).
    """
    variances, differences = [], values
    for order in range(2, min(13, len(values)), 2):
        differences = np.diff(differences, 2, axis=0)
        within = differences[log.windows(order + 1)]
        if len(within):
            variances.append(float(np.mean(within**2)) / math.comb(2 * order, order))
    # Below rounding the window would differ from machine to machine; the squared level is a
    # divisor, hence 1e-60.
    rounding = 64.0 * float(np.finfo(np.float64).eps) * float(np.abs(values).max())
    return max(math.sqrt(min(variances)), rounding, 1e-60)


def least_risk(values: Array, sigma: float, log: LogPieces) -> int:
    """The window [samples] of least risk for columns (m, c) with white noise sigma.

    Windows are odd, from `SHORTEST` to 1001, each 1.25 times the last, as long as they leave
    1 - 1/`SIDE_BY_SIDE` of the flight. As bias grows steeply, two rises of the risk in a row end
    the search. Each window is compared with the shortest one on the same rows, where noise cancels.
    """
    columns, shortest = np.ascontiguousarray(values.T), np.empty(0)
    least, rising, window = (math.inf, SHORTEST), 0, SHORTEST
    while window <= 1001 and rising < 2:
        whole = log.windows(window)
        if SIDE_BY_SIDE * len(whole) < (SIDE_BY_SIDE - 1) * len(values):
            break
        kernel, half = polynomial_kernels(window, ORDER)[0], window // 2
        middle = columns[:, half : len(values) - half]
        errors = middle - [np.correlate(column, kernel, "valid") for column in columns]
        square = np.mean(errors**2, axis=0) / sigma**2
        if window == SHORTEST:
            shortest, own = square, float(kernel[half])
        trim = half - SHORTEST // 2
        excess = square - shortest[trim : len(shortest) - trim]
        risk = float(np.mean(excess[whole])) + 2.0 * (float(kernel[half]) - own)
        rising = 0 if risk < least[0] else rising + 1
        least = min(least, (risk, window))
        window = max(window + 2, 2 * round(window * 1.25 / 2) + 1)
    return least[1]


def smooth(log: LogPieces) -> Rates:
    """Smooth a log on even steps by the windows of least risk, across gaps too.

    Returns the times (q,) [s], the states x, y, vx, vy (q, 4) [m, m/s], their rates (q, 4)
    [m/s, m/s^2] and the filter. A velocity that was not measured is the slope of the position.
    """
    origin = log.state[:, :2].mean(axis=0)  # subtracted to keep digits
    channels = [log.state[:, :2] - origin, log.state[:, 2:]][: 1 + log.velocity_measured]
    levels = [noise_level(values, log) for values in channels]
    first = max(0, (len(log.time) - JUDGED) // 2)
    rows = slice(first, first + JUDGED)
    judged = replace(log, piece=log.piece[rows])
    pairs = zip(channels, levels, strict=True)
    windows = [least_risk(values[rows], level, judged) for values, level in pairs]
    widest = max(windows)
    # Regression averages noise in v', but attenuation of v' biases U0, so its window is shorter. A
    # factor of 1 doubles the mean error of tau_w at .5 m/s of noise; .35 to .6 agree.
    shorter = [max(SHORTEST, 2 * int(0.6 * n / 2) + 1) for n in windows]

    def read(channel: int, window: int, derivative: int) -> Array:
        kernel = polynomial_kernels(window, ORDER)[derivative] / log.step**derivative
        trim = (widest - window) // 2
        return filtered(channels[channel][trim : len(log.time) - trim], kernel)

    # The last channel gives velocity and acceleration, of positions by one derivative more.
    more = 1 - log.velocity_measured
    position, rate = read(0, windows[0], 0) + origin, read(0, shorter[0], 1)
    velocity, acceleration = read(-1, windows[-1], more), read(-1, shorter[-1], more + 1)
    states, rates = np.hstack([position, velocity]), np.hstack([rate, acceleration])
    level = levels[1] if log.velocity_measured else 0.0
    own = Smoothing("auto", "", widest, shorter[-1], ORDER, levels[0], level)
    return log.time[widest // 2 :][: len(states)], states, rates, own
