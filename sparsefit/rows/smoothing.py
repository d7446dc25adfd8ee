"""The smoother that tunes itself: one polynomial through position and velocity together.

Over a window of n samples the path is a polynomial p of degree d + 1, fitted to both channels,

    min_p  sum_j |x_j - p(t_j)|^2 / sigma_x^2 + |v_j - p'(t_j)|^2 / sigma_v^2,

and read in the middle: x = p, v = p', v' = p''. It is the filter of Savitzky and Golay (1964, Anal.
Chem. 36, 1627) with derivative data: velocity carries the position over the window, so position
noise averages over all n samples where position alone must bend.

The window is the one of least estimated risk (Mallows, 1973; Stein, 1981): with h the weights of
the middle sample in its own estimates, unbiased whatever the path,

    risk(n) = mean((x - x_n)^2 / sigma_x^2 + (v - v_n)^2 / sigma_v^2) + 2 (h_x + h_v).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from sparsefit.arrays import Array, ComplexArray
from sparsefit.cached import cached_property
from sparsefit.rows.clean import Pieces, straddling

ORDER = 10  # of the velocity; 4 doubles the error of tau_w at 0.5 m/s of noise, 8 and 10 agree
SHORTEST, LONGEST = ORDER + 1, 1001  # samples; either channel alone determines the polynomial
GROWTH = 1.25  # from window to window
SIDE_BY_SIDE = 5  # windows in a flight: longer ones lose more at the ends than they gain
FEWEST = SIDE_BY_SIDE * SHORTEST  # samples of a flight that can be smoothed
# v' may be noisy, as regression averages it, but what a window takes from it is missing from U0:
# its window is shorter. 1 costs twice the mean error of tau_w at 0.5 m/s, 0.35 to 0.6 agree.
RATE_SHARE = 0.6
LONG = 40  # samples of a window that a Fourier transform sums faster, where
NOISY = 1e-10  # of the largest sample is noise: below it the transform's rounding would count
Rates = tuple[Array, Array, Array, "Smoothing"]  # time (q,), state (q, 4), rate (q, 4), the filter


@dataclass(frozen=True)
class Smoothing:
    """The filter of states and derivatives, and the noise levels of the flight.

    Args:
        method: the method that was used; where ``auto`` cannot be, the one it fell back to.
        reason: of a fall-back; otherwise empty.
        window: samples in the window of position and velocity; 1 where nothing is smoothed.
        rate_window: samples in the window of the derivatives.
        order: degree of the velocity's polynomial; 0 where there is none.
        coupled: whether position and velocity share one polynomial.
        sigma_position: standard deviation of the measured position's noise [m], NaN if not sought.
        sigma_velocity: of the measured velocity's [m/s], 0 where it was not measured.
    """

    method: str
    reason: str = ""
    window: int = 1
    rate_window: int = 1
    order: int = 0
    coupled: bool = False
    sigma_position: float = math.nan
    sigma_velocity: float = math.nan

    @property
    def correlation(self) -> float:
        """Rows over which errors of the acceleration correlate: a window per coefficient."""
        return self.rate_window / (self.order + 1)


@lru_cache(maxsize=128)
def polynomial_kernels(window: int, order: int, step: float, ratio: float = 0.0) -> Array:
    """Weights (3, n), or (3, 2 n), of samples in p, p' and p'' at the middle of n even samples.

    order: degree of p through one channel (ratio 0), or of p' through n positions and then n
    velocities, their noise in the ratio sigma_v / sigma_x [1/s]; step [s]. Read-only.
    """
    reach = window // 2 * step
    powers = np.vander(np.linspace(-1.0, 1.0, window), order + 1 + (ratio > 0), increasing=True)
    if ratio > 0:
        slopes = np.zeros_like(powers)
        slopes[:, 1:] = powers[:, :-1] * np.arange(1, order + 2) / reach
        basis, triangle = np.linalg.qr(np.vstack([ratio * powers, slopes]))
        solved: Array = np.linalg.solve(triangle.T, np.eye(order + 2)[:, :3]).T @ basis.T
        solved[:, :window] *= ratio
    else:
        solved = np.zeros((3, window))
        solved[: order + 1] = np.linalg.pinv(powers)[:3]
    solved *= np.array([1.0, 1.0 / reach, 2.0 / reach**2])[:, None]
    solved.flags.writeable = False
    return solved


@dataclass(frozen=True, eq=False)
class Channels:
    """Position [m] and velocity [m/s] of even samples as rows x, y, vx, vy (2, 2, m).

    Args:
        log: the samples, in pieces.
        rows: position, then velocity, from their origin.
        sigma: noise levels of position [m] and velocity [m/s]; the latter 0 where it is not
            measured.
    """

    log: Pieces
    rows: Array
    sigma: tuple[float, float]

    @classmethod
    def of(cls, log: Pieces) -> Channels:
        """The channels of a log on even steps, positions from their mean to keep their digits."""
        position, velocity = log.state[:, :2] - log.state[:, :2].mean(axis=0), log.state[:, 2:]
        of_velocity = noise_level(velocity, log) if log.velocity_measured else 0.0
        # Kernels of a limited ratio cannot use positions that are better than this.
        of_position = max(noise_level(position, log), of_velocity * log.step / LONGEST)
        rows = np.ascontiguousarray(np.stack([position.T, velocity.T]))
        return cls(log, rows, (of_position, of_velocity))

    def kernels(self, window: int, *, coupled: bool) -> Array:
        """Weights (4, 2 n) of n positions, then n velocities, in x, x', v, v' at the middle."""
        step, longest = self.log.step, float(LONGEST)
        if coupled:
            ratio = self.sigma[1] / self.sigma[0] * step
            ratio = min(max(ratio, 1.0 / longest), longest) / step
            return polynomial_kernels(window, ORDER, step, ratio)[[0, 1, 1, 2]]
        alone, kernels = polynomial_kernels(window, ORDER, step), np.zeros((4, 2 * window))
        kernels[:2, :window] = alone[:2]
        own = slice(window, None) if self.log.velocity_measured else slice(window)
        kernels[2:, own] = alone[:2] if self.log.velocity_measured else alone[1:]
        return kernels

    @cached_property
    def _spectra(self) -> tuple[ComplexArray, int] | None:
        """Transforms of the rows (2, 2, f) and their length; None where noise is too low."""
        from scipy.fft import next_fast_len

        levels = NOISY * np.abs(self.rows).max(axis=(1, 2))
        if not np.all(np.array(self.sigma) > levels):
            return None
        length = int(next_fast_len(self.rows.shape[2], real=True))
        return np.fft.rfft(self.rows, length), length

    def filtered(self, kernel: Array) -> Array:
        """The weighted sums (2, m - n + 1) of a kernel (2 n,), of x and of y."""
        halves, size = kernel.reshape(2, -1), self.rows.shape[2]
        window, used = halves.shape[1], [c for c in range(2) if halves[c].any()]
        if window >= LONG and self._spectra is not None:
            spectra, length = self._spectra
            weights = np.fft.rfft(halves[used], length).conj()
            product = np.einsum("cq,crq->rq", weights, spectra[used])
            return np.fft.irfft(product, length)[:, : size - window + 1]
        sums = [
            np.stack([np.correlate(row, halves[c], "valid") for row in self.rows[c]]) for c in used
        ]
        return sums[0] if len(sums) == 1 else sums[0] + sums[1]

    def residuals(self, window: int, *, coupled: bool) -> tuple[Array, float]:
        """Squared residuals (m - n + 1,) in units of the noise, and the sum of the own weights."""
        kernels, half = self.kernels(window, coupled=coupled), window // 2
        position, velocity = self.rows[:, :, half : self.rows.shape[2] - half]
        x, y = (position - self.filtered(kernels[0])) / self.sigma[0]
        if not self.log.velocity_measured:
            return 0.5 * (x * x + y * y), float(kernels[0, half])
        vx, vy = (velocity - self.filtered(kernels[2])) / self.sigma[1]
        square = 0.5 * ((x * x + vx * vx) + (y * y + vy * vy))
        return square, float(kernels[0, half] + kernels[2, window + half])

    def least_risk(self, reference: tuple[Array, float], *, coupled: bool) -> tuple[float, int]:
        """The least risk beside a reference on the same rows, and its window.

        Windows are odd, from `SHORTEST`, each `GROWTH` times the last, as long as they leave
        1 - 1/`SIDE_BY_SIDE` of the flight. Bias grows steeply: a few rising risks end the search.
        """
        least, rising, window = (math.inf, SHORTEST), 0, SHORTEST
        count, lengths = self.rows.shape[2], self.log.lengths
        while window <= LONGEST and rising < 2:
            whole = int(np.maximum(lengths - window, 0).sum())
            if SIDE_BY_SIDE * whole < (SIDE_BY_SIDE - 1) * count:
                break
            square, weight = self.residuals(window, coupled=coupled)
            trim = (len(reference[0]) - len(square)) // 2
            excess = square - reference[0][trim : len(reference[0]) - trim]
            if len(self.log.starts):
                excess = excess[~straddling(self.log.starts, window, len(square))]
            risk = float(np.mean(excess)) + 2.0 * (weight - reference[1])
            rising = 0 if risk < least[0] else rising + 1
            least = min(least, (risk, window))
            window = max(window + 2, 2 * round(window * GROWTH / 2) + 1)
        return least

    def window(self) -> tuple[int, bool]:
        """The window of least risk [samples], and whether position and velocity are coupled.

        Uncoupled filters win where the logged velocity is not the derivative of the position.
        """
        reference = self.residuals(SHORTEST, coupled=False)
        risk, alone = self.least_risk(reference, coupled=False)
        if not self.log.velocity_measured:
            return alone, False
        together = self.least_risk(reference, coupled=True)
        return (together[1], True) if together[0] < risk else (alone, False)


def noise_level(values: Array, log: Pieces) -> float:
    """Standard deviation of white noise on smooth columns (m, c), at least that of rounding.

    The q-th difference of white noise has the variance C(2q, q) sigma^2; what is left of the
    signal only adds to it, so the least over several q is taken (Rice, 1984; Gasser, Sroka and
    Jennen-Steinmetz, 1986).
    """
    variances = []
    for order in range(2, min(13, len(values)), 2):
        differences = np.diff(values, order, axis=0)
        if len(log.starts):
            differences = differences[~straddling(log.starts, order + 1, len(differences))]
        variances.append(float(np.mean(differences**2)) / math.comb(2 * order, order))
    # With less than rounding, that would choose the window, on each machine another; the square
    # of a level must divide.
    rounding = 64.0 * float(np.finfo(np.float64).eps) * float(np.abs(values).max())
    return max(math.sqrt(min(variances)), rounding, 1e-60)


def smooth(log: Pieces) -> Rates:
    """Smooth a log on even steps by the window of least risk, where whole windows are there.

    Returns the times (q,) [s], the states x, y, vx, vy (q, 4) [m, m/s], their rates (q, 4)
    [m/s, m/s^2] and the filter.
    """
    channels = Channels.of(log)
    window, coupled = channels.window()
    shorter = max(SHORTEST, 2 * int(RATE_SHARE * window / 2) + 1)
    state, rate = (channels.kernels(n, coupled=coupled) for n in (window, shorter))
    half = window // 2
    trim = half - shorter // 2
    states = np.vstack([channels.filtered(kernel) for kernel in state[[0, 2]]])
    rates = np.vstack([channels.filtered(kernel) for kernel in rate[[1, 3]]])
    rates = rates[:, trim : rates.shape[1] - trim]
    smoothing = Smoothing(
        "auto",
        window=window,
        rate_window=shorter,
        order=ORDER,
        coupled=coupled,
        sigma_position=channels.sigma[0],
        sigma_velocity=channels.sigma[1],
    )
    whole = half + np.flatnonzero(~straddling(log.starts, window, states.shape[1]))
    if len(log.starts):
        states, rates = states[:, whole - half], rates[:, whole - half]
    states, rates = np.ascontiguousarray(states.T), np.ascontiguousarray(rates.T)
    states[:, :2] += log.state[:, :2].mean(axis=0)
    return log.time[whole], states, rates, smoothing
