"""What is read of a fit, less its bias where asked, and how sure it is.

The variance is that of the noise carried through the filters (`noise`), and where what is left is
coloured (`turbulence`) at least the mean of what its spectrum and a jackknife say; there the values
of samples and a known vehicle move, if they are corrected at all, by a step of generalised least
squares. Of bias (`bias`) that is corrected, what is doubtful counts as a standard error; of bias
that is left in, all of it. Where residuals are no noise at all, the truncation that is left has one
sign over many samples: half of what it could add up to is added.

Several flights have noise of their own each: their variances add up, each flight's through its own
filters and with the levels that a fit of its own leaves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sparsefit.arrays import Array
from sparsefit.cached import cached_property
from sparsefit.modes.stack import Part
from sparsefit.uncertainty import bias, lags, noise
from sparsefit.uncertainty.concord import Apart, concord
from sparsefit.uncertainty.constancy import Growth, Share
from sparsefit.uncertainty.filtered import Filtered
from sparsefit.uncertainty.influence import Influence
from sparsefit.uncertainty.model import Model
from sparsefit.uncertainty.reading import Reader, Reading
from sparsefit.uncertainty.turbulence import FEWEST, Turbulence, generalised_step, jackknifed

# Of a correction, what counts as a standard error: terms of second order are left out.
DOUBT_OF_TRUNCATION, DOUBT_OF_NOISE = 0.2, 0.5
REACH = 1.0  # standard errors that noisy columns may move a value: beyond, it is ill determined
SEEN = 2.0  # standard errors of a growth that is taken from what is left
MOST = 2.0  # standard errors that generalised least squares may move a value
EXACT = 1e-6  # residuals below this, relative: no noise but truncation, which adds up coherently
COHERENT, QUADRATURE = 0.5, 2.0  # of what it could add up to; weak rows fit most of theirs


@dataclass(frozen=True, eq=False)
class Known:
    """Values that were read of a fit, how sure they are, and what the fit leaves.

    Args:
        values: (f,).
        errors: their standard errors (f,), inf where not told.
        freedom: the degrees of freedom of these (f,), inf where they are certain.
        left: what the fit leaves of each flight, against noise; none where no filters are known.
        growth: by which share the flow changes in a second, where that can be told.
        apart: of several flights, how far each is from the flow that all tell.
    """

    values: Array
    errors: Array
    freedom: Array
    left: tuple[Turbulence, ...] = ()
    growth: Share | None = None
    apart: tuple[Apart, ...] = ()


def corrected(parts: Sequence[Part], model: Model, read: Reader, *, correct: bool) -> Known | None:
    """What is read of a model of the rows of flights' samples, less its bias if asked.

    The nuisance columns are those of the vehicle that fits best: the coefficient of the velocity
    is 0, and noise in its column no error to first order. None below 21 samples of a flight, or
    with fewer rows than parameters of a velocity component.
    """
    used = model.jacobian.size / 2
    fewest = min(len(part.samples.time) for part in parts)
    if fewest <= lags.LAGS or len(model.rows.target) <= used:
        return None
    fits, reading = Filtered.of_parts(parts, model), read(model)
    information = model.information
    lost = information.lost(reading.gradients) | (reading.norms & (not information.whole))
    if fits is not None:
        known = _through_filters(fits, model, read, reading, correct=correct)
    else:
        variance = _by_lags(parts, model, reading.gradients)
        if variance is None:
            return None
        known = Known(reading.values, np.sqrt(variance), np.full(len(variance), np.inf))
    return replace(known, errors=np.where(lost, np.inf, known.errors))


def _by_lags(parts: Sequence[Part], model: Model, gradients: Array) -> Array | None:
    """Variances (f,) from what the fit leaves of each flight; None where one is too short."""
    by_theta, every = model.information.solved(gradients.T), len(model.rows.target)
    variance = np.zeros(len(gradients))
    for part, rows in zip(parts, model.rows.flights, strict=True):
        own, reach = replace(model, rows=rows), lags.overlap(part.samples)
        if len(rows.target) <= reach:
            return None
        weight = part.weight if part.fading is None else part.fading
        influence = weight**2 * own.jacobian.times(by_theta)
        used = 0.5 * model.jacobian.size * len(rows.target) / every
        variance = variance + lags.lagged(influence, own.residual, reach, used)
    return variance


def _through_filters(
    fits: Sequence[Filtered], model: Model, read: Reader, reading: Reading, *, correct: bool
) -> Known:
    """Values and standard errors where the filters are known."""
    every = bias.every_without_truncation(fits, model)
    basis, mix = _few(model, reading.gradients)
    pairs = zip(fits, every, strict=True)
    seen = [_Seen.of(fit, less, fit.weight**2 * basis, mix) for fit, less in pairs]
    each = [one.variances(model, reading.gradients) for one in seen]
    variance = np.sum([own for own, _ in each], axis=0)
    freedom = _freedom(each, variance)
    spread = np.sqrt(variance)
    moved_model = every[0].model
    less = read(moved_model).values
    step = less - reading.values
    correcting = correct & ~reading.stay
    moved = np.zeros(len(step))
    if correct and _alike(fits) and any(one.left.found for one in seen):
        left, together = [one.left for one in seen], [one.less.together for one in seen]
        better = read(moved_model.shifted(generalised_step(left, together)))
        moved = np.clip(better.values - less, -MOST * spread, MOST * spread)
    correction = np.clip(step, -reading.limits, reading.limits)
    doubt = np.where(correcting, DOUBT_OF_TRUNCATION, 1.0) * correction
    for score in _scores_of_noise(seen):
        step = read(model.moved(-score)).values - reading.values
        doubt = np.hypot(doubt, np.where(correcting, DOUBT_OF_NOISE, 1.0) * step)
        correction = correction + np.clip(step, -REACH * spread, REACH * spread)
    errors = np.hypot(spread, doubt)
    values = reading.values + correcting * (correction + moved)
    lefts = tuple(one.left for one in seen)
    return Known(values, errors, freedom, lefts, _growth(seen), _apart(model, seen))


def _alike(fits: Sequence[Filtered]) -> bool:
    """Whether generalised least squares is that of the rows fitted, and no column holds errors.

    It weighs samples, not averages; and turbulence moves the vehicle, whose velocity is a column.
    """
    return all(fit.samples.weak is None and not len(fit.model.coefficients) for fit in fits)


def _apart(model: Model, seen: Sequence[_Seen]) -> tuple[Apart, ...]:
    """How far every flight of several is from the flow that all tell."""
    if len(seen) == 1:
        return ()
    none = np.zeros(model.jacobian.size)
    biases = [sum(one.scores.values(), none) for one in seen]
    return concord(model, [one.left for one in seen], [one.less.together for one in seen], biases)


def _growth(seen: Sequence[_Seen]) -> Share | None:
    """The share [1/s] by which the flow changes, and how sure it is."""
    fits = [one.fit for one in seen]
    growth = Growth.of(fits)
    if growth is None:
        return None
    value = growth.share([one.less.together for one in seen], fits)
    moved = [growth.influence(place, one.left) for place, one in enumerate(seen)]
    error, freedom = _spread(seen, moved)
    if abs(value) > SEEN * error:  # noise is then not what the growth itself leaves
        less = enumerate(seen)
        beside = [replace(one, left=growth.without(i, one.left, value)) for i, one in less]
        error, freedom = _spread(beside, moved)
    return Share(value, float(np.hypot(error, growth.doubt(value))), freedom)


def _spread(seen: Sequence[_Seen], moved: Sequence[Influence]) -> tuple[float, float]:
    """The standard error of a function by its influence in each flight, and its freedom."""
    each = [one.spread(own) for one, own in zip(seen, moved, strict=True)]
    variance = np.sum([own for own, _ in each], axis=0)
    return float(np.sqrt(variance[0])), float(_freedom(each, variance)[0])


@dataclass(frozen=True, eq=False)
class _Seen:
    """What a fit leaves of one flight, and what the errors of its rows do to what is read."""

    fit: Filtered
    less: bias.Truncated
    left: Turbulence
    influence: Influence

    @classmethod
    def of(cls, fit: Filtered, less: bias.Truncated, by_theta: Array, mix: Array | None) -> _Seen:
        observed = noise.Observed(fit, less.at_samples)
        return cls(fit, less, Turbulence(observed), Influence.of(observed, by_theta, mix))

    @cached_property
    def scores(self) -> dict[str, Array]:
        """E J'e (n,) of the noise in what the columns are taken at, by its source."""
        fit, scores = self.fit, {}
        if noise.measured_noise_known(fit.filters):
            scores["columns"] = bias.noisy_columns(fit)
        if fit.shared:
            scores["kicks"] = bias.kicked_velocity(fit, float(self.left.observed.levels[2]))
        if fit.stretch is not None:
            scores["drag"] = bias.curved(fit)
        return scores

    def variances(self, model: Model, gradients: Array) -> tuple[Array, Array]:
        """What the flight adds to the variances (f,), and the degrees of freedom of that."""
        if not self.left.found:
            return self.spread(self.influence)
        gram, weight = model.jacobian.gram, self.fit.weight
        return self.spread(self.influence, jackknifed(self.fit.model, gradients, gram, weight))

    def spread(self, influence: Influence, apart: Array | None = None) -> tuple[Array, Array]:
        """The same of any influence; apart: what a jackknife says, where there is turbulence."""
        observed = self.left.observed
        variance = observed.amounts @ influence.by_source(observed.squares)
        freedom = np.full(len(variance), np.inf)
        if self.left.found:
            coloured, freedom = self.left.variances(influence)
            both = coloured if apart is None else 0.5 * (coloured + apart)
            variance = np.maximum(variance, both)
        return variance + self._coherent(influence), freedom

    def _coherent(self, influence: Influence) -> Array | float:
        """The square (f,) of what residuals without noise may add up to; 0 with noise."""
        square = float(np.sum(self.less.errors**2))
        if square > EXACT**2 * float(np.sum(self.fit.model.flow**2)):
            return 0.0
        share = COHERENT if self.fit.samples.weak is None else QUADRATURE
        added: Array = share**2 * square * influence.squares
        return added


def _few(model: Model, gradients: Array) -> tuple[Array, Array | None]:
    """How theta moves by functions, gradients (f, n): (n, f); or, of many, by few that make them.

    Those are orthonormal for the rows, so that no function is a small difference of large parts.
    """
    basis = model.information.basis
    mix = basis.T @ gradients.T
    return (basis, mix) if mix.shape[1] > mix.shape[0] else (basis @ mix, None)


def _freedom(each: Sequence[tuple[Array, Array]], variance: Array) -> Array:
    """Degrees of freedom (f,) of a sum of variances (Satterthwaite, 1946)."""
    if len(each) == 1:
        return each[0][1]
    doubt = np.sum([own**2 / free for own, free in each], axis=0)
    certain = np.full_like(variance, np.inf)
    freedom: Array = np.divide(variance**2, doubt, out=certain, where=doubt > 0)
    return np.maximum(freedom, FEWEST)


def _scores_of_noise(seen: Sequence[_Seen]) -> list[Array]:
    """J'e (n,) of the noise in what the columns are taken at, one for each source of it."""
    scores: dict[str, Array] = {}
    for one in seen:
        for source, score in one.scores.items():
            scores[source] = scores.get(source, 0.0) + one.fit.weight**2 * score
    return list(scores.values())
