"""Turbulence along the path as noise: what is left of a fit is coloured, and moves it for longer.

What a vehicle meets beside the cells it holds for a while: kicks through low-pass filters,

    S_j(f) = S_kicks(f) / (1 + (f/f_j)^2),    f_j = 2^j / (pi T),  T the time flown,

each the spectrum of errors that are forgotten over 1/(2 pi f_j). Their levels, with those of
measured noise and kicks, are the likeliest (Whittle, 1953) below `BAND` times the mean frequency of
the cells along the path, where errors act on what is read; the spectra are those that a fit leaves.

A variance of such a fit has a likelihood with a peak as broad as the levels are badly known: with I
the information of the levels (Fisher's), V = a.v and nu = 2 V^2 / (v'I^+ v), an interval is that of
Student's t with nu degrees of freedom. Beside it stands the jackknife (Wu, 1986; Kunsch, 1989): the
same functions read without one of `BLOCKS` stretches of the flight, by one Gauss-Newton step. It
knows no spectrum, and errors that change along the flight.

What is read moves to generalised least squares in the band by one step. It keeps the width of least
squares: that of its own is too narrow, as it takes the levels for certain.

White noise pays nothing: this joins only where the likelihood ratio asks for it, and where what is
left is more than a filter's truncation.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sparsefit.arrays import Array
from sparsefit.cached import cached_property
from sparsefit.uncertainty.influence import Influence
from sparsefit.uncertainty.information import Information
from sparsefit.uncertainty.model import Model
from sparsefit.uncertainty.noise import Observed, likeliest
from sparsefit.uncertainty.spectra import frequency_weights

GATE = 15.0  # 2 ln(likelihood ratio): in white noise it is 0 in half of flights, and rarely above 5
TRUNCATION = 1e-5  # of the variance: what is left of a fit without noise has a colour of its own
BAND = 8.0  # times the mean frequency of the cells: over all of them L is under-covered
BLOCKS = 10  # of the jackknife
ROUNDS = 200  # of the levels: low-pass spectra of neighbouring corners are hard to tell apart
SMALL = 3.0  # a score statistic
FEWEST = 2.0  # degrees of freedom: below it no variance
ACTIVE = 1e-3  # of the spectrum somewhere, below it a level is zero


@dataclass(frozen=True, eq=False)
class Turbulence:
    """Low-pass noise in what a fit leaves, against noise of the sensors and kicks alone.

    Args:
        observed: what the fit leaves.
    """

    observed: Observed

    @cached_property
    def band(self) -> slice:
        """The frequencies, of size/2 + 1, at which the cells act, 0 left out."""
        passage, samples = self.observed.passage, self.observed.fit.samples
        step = float(np.mean(np.diff(samples.time)))
        frequencies = np.fft.rfftfreq(passage.size, step)
        flow = np.fft.rfft(self.observed.fit.plain.flow.T, passage.size)
        power = np.sum(flow.real**2 + flow.imag**2, axis=0)
        mean = float(frequencies @ power / power.sum())
        inside = np.flatnonzero((frequencies < BAND * mean) & self.observed.passed)
        return slice(1, int(inside.max(initial=1)) + 1)

    @cached_property
    def shapes(self) -> Array:
        """The spectra (n, size/2 + 1) of level 1 in Phi, the slowest first."""
        passage, time = self.observed.passage, self.observed.fit.samples.time
        frequencies = np.fft.rfftfreq(passage.size, float(np.mean(np.diff(time))))
        slowest = 1 / (math.pi * (time[-1] - time[0]))
        highest = float(frequencies[self.band].max(initial=0.0))
        count = 1 + max(0, math.floor(math.log2(max(highest / slowest, 1.0))))
        corners = slowest * 2.0 ** np.arange(count)
        shapes: Array = self.observed.shapes[1] / (1 + (frequencies / corners[:, None]) ** 2)
        return shapes

    @cached_property
    def remaining(self) -> Array:
        """What the fit leaves in the band of measured noise, kicks and `shapes`, (2 + n, b)."""
        coloured = self.observed.left(self.shapes, self.band)
        return np.concatenate([self.observed.remaining[:, self.band], coloured])

    @cached_property
    def levels(self) -> Array:
        """The levels (2 + n,) of measured noise, kicks and `shapes` in the band."""
        return likeliest(self.remaining, self.observed.seen[self.band], ROUNDS)

    @cached_property
    def weight(self) -> float:
        """How often a frequency of the transforms counts, that are longer than the flight."""
        return 2 * len(self.observed.errors) / self.observed.passage.size

    @property
    def found(self) -> bool:
        """Whether noise of the sensors and kicks cannot explain what is left."""
        return self.observed.unexplained > TRUNCATION and self.ratio > GATE

    @cached_property
    def ratio(self) -> float:
        """2 ln(likelihood ratio) of noise with turbulence against noise without.

        Where it is small, Rao's score statistic (1948) of the one spectrum that raises the
        likelihood most: they agree there, and most flights are spared the fit.
        """
        seen, shapes = self.observed.seen[self.band], self.remaining
        alone = likeliest(shapes[:2], seen) @ shapes[:2]
        over, parts = seen / alone - 1, shapes[2:] / alone
        rising = np.maximum(parts @ over, 0.0)
        score = self.weight * float((rising**2 / np.sum(parts**2, axis=1)).max())
        if score < SMALL:
            return score
        return 2 * self.weight * (_unlikely(alone, seen) - _unlikely(self.levels @ shapes, seen))

    @property
    def spectrum(self) -> Array:
        """The likeliest spectrum (size/2 + 1,) of the errors of Phi, before the fit took any."""
        if not self.found:
            return self.observed.amounts @ self.observed.shapes
        return self.levels[:2] @ self.observed.shapes + self.levels[2:] @ self.shapes

    @property
    def speed(self) -> float:
        """The turbulence along the path, rms of a component [m/s]; 0 where none was found."""
        if not self.found:
            return 0.0
        weight = frequency_weights(self.observed.passage.size)
        return math.sqrt(float(self.levels[2:] @ self.shapes @ weight))

    @property
    def generalised_step(self) -> Array:
        """The step (n,) of theta from least squares to generalised least squares in the band."""
        return generalised_step([self], [self.observed.errors])

    def generalised_equations(self, errors: Array) -> tuple[Array, Array]:
        """J'S^-1 J (n, n) and J'S^-1 e (n,) of the frequencies in the band, of errors (m, 2)."""
        passage, model = self.observed.passage, self.observed.fit.plain
        inside = slice(0, self.band.stop)
        weight = (frequency_weights(passage.size) / self.spectrum)[inside]
        seen = np.fft.rfft(np.ascontiguousarray(errors.T), passage.size)[:, inside]
        parts = self.observed.spectra[:, inside]
        heavy, jacobian = parts * weight, model.jacobian
        gram = jacobian.onto_theta((heavy @ parts.conj().T).real)
        return gram, jacobian.placed((heavy @ seen.conj().T).real)

    def variances(self, influence: Influence) -> tuple[Array, Array]:
        """Variances (f,) of functions with an influence, and their degrees of freedom (f,)."""
        own = influence.by_source(self.observed.squares)
        each = np.concatenate([own, influence.under(self.shapes)])
        variance = self.levels @ each
        spectrum = self.levels @ self.remaining
        active = (self.levels[:, None] * self.remaining / spectrum).max(axis=1) > ACTIVE
        parts = self.remaining[active] / spectrum
        spread = np.linalg.pinv(self.weight * parts @ parts.T, rcond=1e-8, hermitian=True)
        doubt = np.einsum("jf,jk,kf->f", each[active], spread, each[active])
        certain = np.full_like(doubt, math.inf)  # of what no parameter moves
        freedom = np.divide(2 * variance**2, doubt, out=certain, where=doubt > 0)
        return variance, np.maximum(freedom, FEWEST)


def generalised_step(lefts: Sequence[Turbulence], errors: Sequence[Array]) -> Array:
    """The step (n,) of theta from least squares to generalised least squares in the band.

    (J'S^-1 J)^+ J'S^-1 e of the frequencies in the band, S the likeliest spectrum, summed over the
    flights, errors (m, 2) of each: what is seen where turbulence has less power counts for more.
    """
    pairs = zip(lefts, errors, strict=True)
    equations = [left.generalised_equations(own) for left, own in pairs]
    gram, score = (np.sum(parts, axis=0) for parts in zip(*equations, strict=True))
    return Information.of(gram, lefts[0].observed.fit.plain.tangent).solved(score)


def jackknifed(
    model: Model, gradients: Array, gram: Array | None = None, weight: float = 1.0
) -> Array:
    """Variances (f,) of functions, gradients (f, n), read without a tenth of the rows each time.

    Of several flights what one of them adds: gram: J'J (n, n) of all, and the weight of its rows.
    """
    jacobian, residual = model.jacobian, model.residual
    whole, square, moved = jacobian.gram if gram is None else gram, weight**2, []
    for block in np.array_split(np.arange(len(residual)), BLOCKS):
        part = replace(jacobian, columns=jacobian.columns[:, block])
        rest = Information.of(whole - square * part.gram)
        moved.append(-gradients @ rest.solved(square * part.score(residual[block])))
    away = np.array(moved)
    variance: Array = (BLOCKS - 1) * np.var(away, axis=0)
    return variance


def _unlikely(spectrum: Array, seen: Array) -> float:
    return float(np.sum(np.log(spectrum) + seen / spectrum))
