"""How noise of the raw samples moves functions of theta: c.e, for errors e of the rows.

Measured noise passes the filters into Phi and, as the candidates move with the position, into the
model itself; a kick of the vehicle passes those of the acceleration. By frequency, what unit white
noise adds is the power of the influence's transform times the passage (`noise.Passage`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from sparsefit.arrays import Array, ComplexArray
from sparsefit.derivative import WeakRows
from sparsefit.derivative.filters import kicks_through
from sparsefit.uncertainty.filtered import Filtered
from sparsefit.uncertainty.lags import products
from sparsefit.uncertainty.model import Model
from sparsefit.uncertainty.noise import Observed, Passage
from sparsefit.uncertainty.spectra import forms, frequency_weights, mixed

if TYPE_CHECKING:
    from scipy.sparse import csr_array


@dataclass(frozen=True, eq=False)
class Influence:
    """How errors of the rows move functions of theta, and what these are at the samples.

    Args:
        fit: of rows that are made of filtered samples.
        rows: c (f, 2, q): errors e of the rows move the functions by c.e.
        samples: the transforms (f, 2, size/2 + 1) of the same for errors of Phi at the samples.
        mix: where many functions are asked for (f,), their parts (k, f) of the k that the others
            then are of: what unit noise adds is a form of those; None: these are they.
    """

    fit: Filtered
    passage: Passage
    rows: Array
    samples: ComplexArray
    mix: Array | None = None

    @classmethod
    def of(cls, observed: Observed, by_theta: Array, mix: Array | None = None) -> Influence:
        """The influence J times `by_theta` (n, k) of theta, of k functions or what makes f."""
        fit, passage = observed.fit, observed.passage
        rows = fit.model.jacobian.times(by_theta)
        if fit.samples.weak is None:
            spectra = fit.model.jacobian.turned(by_theta, observed.spectra)
        else:
            spectra = np.fft.rfft(averaged_by(fit.samples.weak.operator, rows), passage.size)
        return cls(fit, passage, rows, spectra, mix)

    @property
    def apart(self) -> Influence:
        """The same of every function by itself."""
        if self.mix is None:
            return self
        rows, samples = (
            np.tensordot(self.mix.T, self.rows, 1),
            np.tensordot(self.mix.T, self.samples, 1),
        )
        return replace(self, rows=rows, samples=samples, mix=None)

    @property
    def squares(self) -> Array:
        """Sums of squares (f,) over the rows: what unit white errors of these add."""
        flat = self.rows.reshape(len(self.rows), -1)
        return mixed(flat @ flat.T, self.mix)

    @property
    def by_noise(self) -> Array:
        """What unit noise of raw position, velocity and tau times acceleration adds, (3, f)."""
        weak = self.fit.samples.weak
        if weak is None:
            return powers(self.fit, self.passage, self.rows, self.samples, self.mix)
        return weak_powers(self.fit, weak, self.passage, self.rows, self.mix)

    def by_source(self, squares: Array) -> Array:
        """What measured noise and kicks of level 1 add, (2, f).

        squares: variances (2,) of the white noise of raw position and velocity; what the position
        wanders is of the first.
        """
        own, wander = self.by_noise, self.fit.wander
        measured = squares @ own[:2]
        if wander.rms:
            # By lags: a transform of the flight's length would join its ends.
            raw = np.fft.irfft(self.apart._raw()[0], self.passage.size)
            alike = products(raw, raw.shape[-1] - 1).sum(axis=1)
            alike[:, 1:] *= 2
            measured = measured + alike @ wander.covariance(alike.shape[1])
        return np.array([measured, own[2]])

    def _raw(self) -> list[ComplexArray]:
        weak = self.fit.samples.weak
        if weak is None:
            return raw_plain(self.fit, self.passage, self.rows, self.samples)
        return raw_weak(self.fit, weak, self.passage, self.rows)

    def under(self, shapes: Array) -> Array:
        """What errors of Phi of these spectra (n, size/2 + 1) add, (n, f)."""
        weight = frequency_weights(self.passage.size)
        return np.array([mixed(forms(self.samples, weight * one), self.mix) for one in shapes])


def powers(
    fit: Filtered,
    passage: Passage,
    influence: Array,
    spectra: ComplexArray,
    mix: Array | None = None,
) -> Array:
    """What unit noise of raw position, velocity and tau times acceleration adds, (3, f).

    influence c (k, 2, m) of the samples, and its transforms (k, 2, size/2 + 1); mix: (k, f) of f
    functions that these make, None: these are they.
    """
    weight, kicked = frequency_weights(passage.size), np.abs(passage.kicks) ** 2
    every = [forms(one, weight) for one in raw_plain(fit, passage, influence, spectra)]
    every.append(forms(_of_kicks(fit, passage, influence, spectra), weight * kicked))
    return np.array([mixed(form, mix) for form in every])


def _of_kicks(
    fit: Filtered, passage: Passage, influence: Array, spectra: ComplexArray
) -> ComplexArray:
    """The influence of errors of tau times the acceleration, as transforms (f, 2, size/2 + 1)."""
    if fit.stretch is None:
        return spectra
    return np.fft.rfft(fit.stretched(influence), passage.size)


def raw_plain(
    fit: Filtered, passage: Passage, influence: Array, spectra: ComplexArray
) -> list[ComplexArray]:
    """The influence of raw position and velocity, as transforms (f, 2, size/2 + 1) of each."""
    bent = np.fft.rfft(_bent(fit.model, influence), passage.size)
    if fit.stretch is None:
        through = passage.of_flow_velocity(fit.response_time)
        pairs = zip(through, passage.place, strict=True)
        return [spectra * of_phi - bent * place for of_phi, place in pairs]
    pushed = fit.response_time * _of_kicks(fit, passage, influence, spectra)
    each = zip(passage.velocity, passage.acceleration, passage.place, strict=True)
    return [spectra * speed + pushed * rate - bent * place for speed, rate, place in each]


def weak_powers(
    fit: Filtered, weak: WeakRows, passage: Passage, influence: Array, mix: Array | None = None
) -> Array:
    """As `powers`, for the influence (k, 2, q) of weak rows of the samples."""
    size, rate = passage.size, averaged_by(weak.rate, influence)
    weight = frequency_weights(size)
    every = [forms(one, weight) for one in raw_weak(fit, weak, passage, influence)]
    # A kick in every raw step moves the velocities after it, and the rate operator sees these.
    slope = np.fft.rfft(rate, size)[:, :, None]
    raw = np.fft.irfft(slope * passage.velocity, size)
    step = float(np.mean(np.diff(fit.samples.time)))
    kicks = np.array([[kicks_through(one, step) for one in both] for both in raw])
    flat = kicks.reshape(len(kicks), -1)
    return np.array([mixed(form, mix) for form in (*every, flat @ flat.T)])


def raw_weak(
    fit: Filtered, weak: WeakRows, passage: Passage, influence: Array
) -> list[ComplexArray]:
    """As `raw_plain`, for the influence (f, 2, q) of weak rows of the samples."""
    mean, rate = averaged_by(weak.operator, influence), averaged_by(weak.rate, influence)
    bent = np.fft.rfft(_bent(fit.model, mean), passage.size)
    total = np.fft.rfft(mean + fit.response_time * rate, passage.size)
    pairs = zip(passage.velocity, passage.place, strict=True)
    return [total * velocity - bent * place for velocity, place in pairs]


def averaged_by(operator: csr_array, influence: Array) -> Array:
    """The influence (f, 2, m) of samples, from that (f, 2, q) of rows that an operator made."""
    flat = influence.reshape(-1, influence.shape[2]).T
    at_samples: Array = (operator.T @ flat).T.reshape(*influence.shape[:2], operator.shape[1])
    return at_samples


def _bent(model: Model, influence: Array) -> Array:
    """How errors of the positions of samples move functions, (f, 2, m), by c (f, 2, m) of Phi."""
    bent: Array = np.sum(influence[:, None] * model.gradient, axis=2)
    return bent
