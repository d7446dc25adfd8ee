"""What is read of a fit, less its bias where asked, and how sure it is.

The variance is that of the noise carried through the filters (`noise`), and where what is left is
coloured (`turbulence`) at least the mean of what its spectrum and a jackknife say; there the values
move, if they are corrected at all, by a step of generalised least squares. Of bias (`bias`)
that is corrected, what is doubtful counts as a standard error; of bias that is left in, all of it.
Where residuals are no noise at all, the truncation that is left has one sign over many samples:
half of what it could add up to is added.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sparsefit.arrays import Array
from sparsefit.derivative import Samples
from sparsefit.library.nuisance import Nuisance
from sparsefit.uncertainty import bias, lags, noise
from sparsefit.uncertainty.filtered import Filtered
from sparsefit.uncertainty.influence import Influence
from sparsefit.uncertainty.model import Model
from sparsefit.uncertainty.reading import Reader
from sparsefit.uncertainty.turbulence import Turbulence, jackknifed

# Of a correction, what counts as a standard error: terms of second order are left out.
DOUBT_OF_TRUNCATION, DOUBT_OF_NOISE = 0.2, 0.5
REACH = 1.0  # standard errors that noisy columns may move a value: beyond, it is ill determined
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
        left: what the fit leaves, against noise; None where no filters are known.
    """

    values: Array
    errors: Array
    freedom: Array
    left: Turbulence | None = None


def corrected(
    samples: Samples, model: Model, nuisance: Nuisance, read: Reader, *, correct: bool
) -> Known | None:
    """What is read of a model of the rows of a flight's samples, less its bias if asked.

    The nuisance columns are those of the vehicle that fits best: the coefficient of the velocity
    is 0, and noise in its column no error to first order. None below 21 samples, or with fewer
    rows than parameters of a velocity component.
    """
    rows, used = len(model.rows.target), model.jacobian.size / 2
    if len(samples.time) <= lags.LAGS or rows <= used:
        return None
    fit, reading = Filtered.of(samples, model, nuisance), read(model)
    information = model.information
    lost = information.lost(reading.gradients) | (reading.norms & (not information.whole))
    if fit is not None:
        known = _through_filters(fit, read, correct=correct)
    else:
        reach = lags.overlap(samples)
        if rows <= reach:
            return None
        influence = model.influence(reading.gradients)
        variance = lags.lagged(influence, model.residual, reach, used)
        known = Known(reading.values, np.sqrt(variance), np.full(len(variance), np.inf))
    return replace(known, errors=np.where(lost, np.inf, known.errors))


def _through_filters(fit: Filtered, read: Reader, *, correct: bool) -> Known:
    """Values and standard errors where the filters are known."""
    reading, less = read(fit.model), bias.without_truncation(fit)
    observed = noise.Observed(fit, less.at_samples)
    by_theta = fit.model.information.solved(reading.gradients.T)
    influence, levels = Influence.of(observed, by_theta), observed.levels
    freedom = np.full(len(reading.values), np.inf)
    variance = observed.amounts @ influence.by_source(observed.squares)
    left = Turbulence(observed)
    if left.found:
        coloured, freedom = left.variances(influence)
        apart = jackknifed(fit.model, reading.gradients)
        variance = np.maximum(variance, 0.5 * (coloured + apart))
    variance = variance + _coherent(fit, reading.gradients, less.errors)
    spread = np.sqrt(variance)
    step = read(less.model).values - reading.values
    correcting = correct & ~reading.stay
    moved = np.zeros(len(step))
    if correct and left.found:
        better = read(less.model.shifted(left.generalised_step))
        moved = np.clip(better.values - read(less.model).values, -MOST * spread, MOST * spread)
    correction = np.clip(step, -reading.limits, reading.limits)
    doubt = np.where(correcting, DOUBT_OF_TRUNCATION, 1.0) * correction
    for score in _scores_of_noise(fit, float(levels[2])):
        step = read(fit.model.moved(-score)).values - reading.values
        doubt = np.hypot(doubt, np.where(correcting, DOUBT_OF_NOISE, 1.0) * step)
        correction = correction + np.clip(step, -REACH * spread, REACH * spread)
    errors = np.hypot(spread, doubt)
    return Known(reading.values + correcting * (correction + moved), errors, freedom, left)


def _coherent(fit: Filtered, gradients: Array, errors: Array) -> Array:
    """The square (f,) of what residuals (q, 2) without noise may add up to; 0 with noise."""
    square = float(np.sum(errors**2))
    if square > EXACT**2 * float(np.sum(fit.model.flow**2)):
        return np.zeros(len(gradients))
    share = COHERENT if fit.samples.weak is None else QUADRATURE
    influence = fit.model.influence(gradients)
    added: Array = share**2 * square * np.sum(influence**2, axis=(1, 2))
    return added


def _scores_of_noise(fit: Filtered, kicks: float) -> list[Array]:
    """J'e (n,) of the noise in what the columns are taken at, one for each source of it."""
    scores = []
    if noise.measured_noise_known(fit.filters):
        scores.append(bias.noisy_columns(fit))
    if fit.shared:
        scores.append(bias.kicked_velocity(fit, kicks))
    if fit.stretch is not None:
        scores.append(bias.curved(fit))
    return scores
