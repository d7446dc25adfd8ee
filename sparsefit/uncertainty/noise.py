"""The variance of functions of theta from the noise of a flight, carried through its filters.

An error of a row is the raw noise after the filters: measured noise of position and velocity, and
noise of the acceleration itself (Eq. 7), each with a spectrum that the filters fix,

    e = Psi (n_v - grad w . n_x) + tau R n_a,    R: Psi and n_a the noise of the acceleration, or
                                                 the rate operator of the weak form and n_a = n_v.

How much of either there is, is read from what the fit leaves of Phi at the samples (Whittle's
likelihood, 1953); what it does to a function that moves by c.e, from c carried back through the
filters to the raw samples, where noise is white: var = sigma^2 |F'c|^2. An autocovariance of the
residuals, tapered, would need lags beyond the window, and then has few windows to average over:
it is what remains where no filters are known (Bartlett's; Newey and West, 1987).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sparsefit.arrays import Array, BoolArray, ComplexArray
from sparsefit.cached import cached_property
from sparsefit.derivative.filters import Filters
from sparsefit.derivative.transform import fast_length
from sparsefit.uncertainty.filtered import Filtered
from sparsefit.uncertainty.lags import products
from sparsefit.uncertainty.wander import modulated

PASSED = 0.05  # of the power: below it the spectrum is leakage
ROUNDS = 60  # of the multiplicative iteration; the level is stable to 1 % by then


@dataclass(frozen=True, eq=False)
class Passage:
    """What raw noise is in the filtered states, by frequency (size/2 + 1,).

    Args:
        size: of the transforms.
        place: raw position and velocity (2, ...) in the filtered position.
        velocity: the same in the filtered velocity.
        acceleration: the same in the filtered acceleration.
        kicks: the mean acceleration in a step, in the filtered acceleration.
    """

    size: int
    place: ComplexArray
    velocity: ComplexArray
    acceleration: ComplexArray
    kicks: ComplexArray

    @classmethod
    def of(cls, filters: Filters, samples: int) -> Passage:
        """The passage of a number of filtered samples."""
        size = fast_length(samples + filters.raw.shape[2])
        place, velocity, acceleration = np.fft.rfft(filters.raw, size)
        return cls(size, place, velocity, acceleration, np.fft.rfft(filters.kicks, size))

    def of_flow_velocity(self, response_time: float) -> ComplexArray:
        """Raw position and velocity (2, ...) in Phi; tau [s]."""
        through: ComplexArray = self.velocity + response_time * self.acceleration
        return through


@dataclass(frozen=True, eq=False)
class Observed:
    """What a fit leaves of Phi at the samples, by frequency, and what noise would leave there.

    Args:
        fit: of rows that are made of filtered samples.
        errors: what a fit of the samples leaves of their Phi (m, 2) [m/s], even where weak rows
            were fitted: these overlap, and a sample tells more of the noise's spectrum.
    """

    fit: Filtered
    errors: Array

    @cached_property
    def unexplained(self) -> float:
        """The share of the rows' variance that the fit leaves, 1 - R^2; all of one that is 0."""
        target = self.fit.model.rows.target
        total = float(np.sum((target - target.mean(0)) ** 2))
        return float(np.sum(self.fit.model.residual**2)) / total if total else 1.0

    @cached_property
    def passage(self) -> Passage:
        """The passage of raw noise to the samples."""
        return Passage.of(self.fit.filters, len(self.fit.samples.time))

    @cached_property
    def spectra(self) -> ComplexArray:
        """The transforms of the columns of the samples' Jacobian, (u, size/2 + 1)."""
        return self.fit.plain.jacobian.spectra(self.passage.size)

    @cached_property
    def seen(self) -> Array:
        """The periodogram of the errors, mean of both components, (size/2 + 1,) [m^2/s^2]."""
        observed = np.fft.rfft(np.ascontiguousarray(self.errors.T), self.passage.size)
        seen: Array = np.sum(observed.real**2 + observed.imag**2, axis=0) / (2 * len(self.errors))
        return seen

    @cached_property
    def squares(self) -> Array:
        """Variances (2,) of the raw position and velocity, of which one level is sought.

        Where the derivative found the noise levels of position and velocity, their ratio is known;
        elsewhere only velocity is noisy.
        """
        filters = self.fit.filters
        if not measured_noise_known(filters):
            return np.array([0.0, 1.0])
        return np.array([filters.sigma_position, filters.sigma_velocity]) ** 2

    @cached_property
    def shapes(self) -> Array:
        """The spectra (2, size/2 + 1) in Phi of measured noise and of kicks, each of level 1."""
        passage = self.passage
        steep = float(np.mean(np.sum(self.fit.plain.gradient**2, axis=0)))  # along an axis
        tau, even = self.fit.response_time, self.fit.evenness
        through = passage.of_flow_velocity(even * tau)
        measured = self.squares @ (np.abs(through) ** 2 + steep * np.abs(passage.place) ** 2)
        measured += modulated(self.fit.wander, self.fit.plain.gradient, passage.size)
        kicks = np.abs(passage.kicks) ** 2
        if self.fit.stretch is not None:
            by_raw = self.squares @ np.abs(passage.acceleration) ** 2
            measured += tau**2 * (self._stretched(by_raw) - even**2 * by_raw)
            kicks = self._stretched(kicks)
        return np.array([np.maximum(measured, 0.0), kicks])

    def _stretched(self, spectrum: Array) -> Array:
        """The spectrum (size/2 + 1,) of noise of the acceleration that quadratic drag stretches.

        By lags: the autocovariance of A n is that of A times that of n, which ends with the filter.
        """
        stretch, size = self.fit.stretch, self.passage.size
        assert stretch is not None
        reach = min(self.fit.filters.raw.shape[2], stretch.shape[2] - 1)
        alike = products(stretch.reshape(4, -1), reach).sum(axis=0) / (2 * stretch.shape[2])
        covariance = np.fft.irfft(spectrum, size)
        folded = np.zeros(size)
        folded[: reach + 1] = alike * covariance[: reach + 1]
        folded[-np.arange(1, reach + 1)] = folded[1 : reach + 1]
        return np.fft.rfft(folded).real

    def left(self, shapes: Array, inside: slice = slice(None)) -> Array:
        """What the fit leaves of errors of these spectra, as many, inside some frequencies."""
        return self.fit.plain.left(shapes, self.spectra, self.passage.size, inside)

    @cached_property
    def remaining(self) -> Array:
        """What the fit leaves of `shapes`."""
        return self.left(self.shapes)

    @property
    def passed(self) -> BoolArray:
        """The frequencies that the filters pass: others show leakage."""
        passed: BoolArray = self.shapes[1] > PASSED
        return passed

    @cached_property
    def amounts(self) -> Array:
        """The likeliest levels (2,) of `shapes`.

        The slow part of a position that wanders is taken by the fit, and says nothing of its level:
        that is the one which the derivative found, at least.
        """
        found = likeliest(self.remaining[:, self.passed], self.seen[self.passed])
        return np.maximum(found, [1.0, 0.0]) if self.fit.wander.rms else found

    @property
    def levels(self) -> Array:
        """Variances (3,) of the raw position and velocity, and of tau times that of kicks."""
        return np.array([*(self.amounts[0] * self.squares), self.amounts[1]])


def measured_noise_known(filters: Filters) -> bool:
    """Whether the derivative found the noise levels of position and velocity."""
    return math.isfinite(filters.sigma_position) and math.isfinite(filters.sigma_velocity)


def likeliest(shapes: Array, observed: Array, rounds: int = ROUNDS) -> Array:
    """Levels >= 0 of the spectra (n, q) that are likeliest given a periodogram (q,).

    Multiplicative iteration for sum(log s + I/s), s = levels . shapes (Fevotte et al., 2009).
    """
    size = shapes.mean(axis=1)
    size[size == 0] = 1.0
    scaled = shapes / size[:, None]
    loaded, least = scaled * observed, 1e-300 + 1e-12 * float(observed.max())
    every = np.vstack([scaled, np.full(len(observed), least)])  # the last of level 1
    levels = np.append(np.full(len(shapes), observed.mean() / len(shapes)), 1.0)
    level, inverse = levels[:-1], np.empty(len(observed))
    for _ in range(rounds):
        np.reciprocal(np.dot(levels, every, out=inverse), out=inverse)
        level /= np.dot(scaled, inverse)
        inverse *= inverse
        level *= np.dot(loaded, inverse)
    found: Array = level / size
    return found
