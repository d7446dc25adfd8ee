"""Named causes of a misfit: what a flow that is there could be instead, each tested by its score.

With w the fitted flow, grad w its gradient, and t the time from the middle of the flight, a fit of
steady cells leaves to first order c.z of what it does not know:

    wind        z = (1, 0), (0, 1)                                      c [m/s]
    response    z = (v - w)/tau, as Phi = v + tau (v' - a)              c [s]
    drag        z = |r| r / (1/tau + 2 c |r|), r = w - v                c [1/m]
    linear      z = r / (1/tau + 2 c |r|), in place of the response     c [1/s]
    swelling    z = w cos(j pi (t/T + 1/2)), j = 1..4                   c relative
    drift       z = -t d_x w, -t d_y w                                  c [m/s]
    turn        z = e x w - ((e x r).grad) w, e the third axis          c [rad]
    stretch     z = y d_y w - x d_x w + (w_x, -w_y)                     c relative, of either axis

Less what the fit has freed of them, the scores z'e are normal with the covariance Z'SZ of the noise
of the sensors and of kicks (Rao, 1948), and s'(Z'SZ)^-1 s is chi^2 of as many degrees. What is left
of turbulence has large scores as well. What tells a cause from it is the share of the squares that
the cause takes away, or that nothing coloured is left without it. Turbulence moves the vehicle, so
that the share of a response time or of drag says nothing of either.

What a derivative's own rule does to a flow without noise is coloured too, and scores. A cause that
explains less than a thousandth of the flow velocity is none, therefore: it moves no answer. Nor is
one that explains less than what the rule does to second order, where samples are few: of a flow of
which a filter takes the share d, the share d^2 is not corrected.

Under quadratic drag noise is larger where less drags: the covariance carries it sample by sample,
what it makes of Phi in the mean is taken from the errors, and half of that counts as doubt.

Causes whose columns are alike share the score: of the best three the one that leaves least is told.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from sparsefit.arrays import Array
from sparsefit.uncertainty.filtered import Filtered
from sparsefit.uncertainty.influence import raw_plain
from sparsefit.uncertainty.noise import Observed
from sparsefit.uncertainty.spectra import forms, frequency_weights
from sparsefit.uncertainty.turbulence import TRUNCATION, Turbulence

CHANCE = 1e-4  # of a score as large, at most: seven causes are tried
TAKEN = 0.25  # of the squares that are left, under turbulence, that a cause takes away
RELIEVED = 5.0  # the likelihood ratio of turbulence where a cause has taken it all away
SLIGHT = 1e-3  # of the flow velocity, rms, that a cause explains: less moves no answer by 0.1 %
FREED = 1e-6  # of a column, less of it is left: the fit has it already
ROUNDING = 1e-15  # of an eigenvalue: what is below is none
DOUBT = 0.5  # of what noise makes of Phi in the mean, as a standard error
CLEAR = 1.0  # times the noise of v', drag above it: below it Phi is no linear function of v'
BEST = 3  # causes that are compared by what they leave
SWELLINGS = 4  # cosines
MOST = 0.4  # of U0: with more turbulence than this there are hardly any steady cells


class Cause(StrEnum):
    """What steady cells, a known vehicle and no wind leave unsaid of a flow."""

    WIND = "wind"
    RESPONSE_TIME = "response-time"
    DRAG = "drag"
    LINEAR_DRAG = "linear-drag"
    SWELLING = "swelling"
    DRIFT = "drift"
    TURN = "turn"
    STRETCH = "stretch"
    TURBULENCE = "turbulence"
    ANOTHER_FLOW = "another-flow"


OF_DRAG = (Cause.RESPONSE_TIME, Cause.DRAG, Cause.LINEAR_DRAG)


@dataclass(frozen=True)
class Suspect:
    """A named cause of what a fit leaves, and roughly how large it is.

    Args:
        cause: what it is.
        size: to first order: wind and drift (x, y) [m/s], response time less the believed [s],
            quadratic drag less the believed [1/m], linear drag less the believed [1/s],
            turn [rad], swelling (rms) and stretch of x over y as shares; turbulence, rms [m/s];
            another flow than other flights', rms as a share.
        p_value: of a score as large by chance.
        share: of the squares that are left, what freeing the cause takes away.
    """

    cause: Cause
    size: tuple[float, ...]
    p_value: float
    share: float


def columns(fit: Filtered) -> dict[Cause, Array]:
    """The columns (k, 2, m) of each cause at the samples of a fit."""
    model, velocity = fit.plain, fit.samples.velocity.T
    flow, (along_x, along_y) = model.flow.T, model.gradient
    x, y = model.rows.position[:, :2].T
    time = fit.samples.time - 0.5 * (fit.samples.time[0] + fit.samples.time[-1])
    phase = math.pi * (time / (time[-1] - time[0]) + 0.5)
    one, none = np.ones_like(time), np.zeros_like(time)
    speed, vehicle = np.hypot(*(flow - velocity)), fit.vehicle
    root = vehicle.rate + 2 * vehicle.drag * speed
    pushed = (flow - velocity) / np.where(root > 0, root, 1.0)
    clear = np.hypot(*vehicle.drag_of((flow - velocity).T).T) > CLEAR * fit.roughness
    response = {Cause.LINEAR_DRAG: (clear * pushed)[None]}
    if not vehicle.drag:
        response = {Cause.RESPONSE_TIME: (velocity - flow)[None] / fit.response_time}
    return {
        Cause.WIND: np.array([[one, none], [none, one]]),
        **response,
        Cause.DRAG: (speed * pushed)[None],
        Cause.SWELLING: np.array([flow * np.cos(j * phase) for j in range(1, SWELLINGS + 1)]),
        Cause.DRIFT: np.array([-time * along_x, -time * along_y]),
        Cause.TURN: (np.array([-flow[1], flow[0]]) - x * along_y + y * along_x)[None],
        Cause.STRETCH: (y * along_y - x * along_x + np.array([flow[0], -flow[1]]))[None],
    }


def suspected(left: Turbulence, mean_velocity: float, flights: int = 1) -> Suspect | None:
    """What the flow seems to be instead of what was fitted; None where noise explains what is left.

    mean_velocity: U0 of the fastest cells that were fitted [m/s]. flights: that are looked at, of
    which any may be suspected by chance.
    """
    observed = left.observed
    if observed.unexplained <= TRUNCATION:
        return None
    plain = observed.fit.plain
    flow, square = _square(plain.flow), _square(observed.errors)
    truncated = _square(plain.residual - observed.errors) / flow if flow else 0.0
    slight = max(SLIGHT, truncated) ** 2 * flow
    tried = [(one, own) for one, own in _tested(left, flights) if one.share * square > slight]
    guilty = [suspect for suspect, freed in tried if _guilty(left, suspect, freed)]
    nearest = sorted(guilty, key=lambda one: one.p_value)[: len(Cause) if left.found else BEST]
    if not nearest and left.speed > MOST * mean_velocity:
        return Suspect(Cause.TURBULENCE, (left.speed,), math.exp(-left.ratio / 2), 1.0)
    return max(nearest, key=lambda one: one.share, default=None)


def _square(values: Array) -> float:
    return float(np.sum(values**2))


def _guilty(left: Turbulence, suspect: Suspect, freed: Array) -> bool:
    if suspect.p_value >= CHANCE:
        return False
    if not left.found:
        return True
    if suspect.share > TAKEN and suspect.cause not in OF_DRAG:
        return True
    return relieved(left, freed).ratio < RELIEVED


def relieved(left: Turbulence, freed: Array) -> Turbulence:
    """What is left without columns (k, 2, m), of which the fit has taken its part."""
    observed, flat = left.observed, freed.reshape(len(freed), -1)
    taken = np.linalg.lstsq(flat.T, observed.errors.T.ravel(), rcond=None)[0] @ flat
    return Turbulence(replace(observed, errors=observed.errors - taken.reshape(2, -1).T))


def _tested(left: Turbulence, flights: int) -> list[tuple[Suspect, Array]]:
    """Each cause that the fit has not freed, and what is left of its columns."""
    from scipy.special import gammaincc

    observed, named = left.observed, columns(left.observed.fit)
    own = np.concatenate(list(named.values()))
    freed = observed.fit.plain.freed(own)
    flat = freed.reshape(len(own), -1)
    bow = observed.fit.bow.T.ravel()
    errors = observed.errors.T.ravel() - bow
    scores, gram, square = flat @ errors, flat @ flat.T, float(errors @ errors)
    covariance = _covariance(observed, freed) + DOUBT**2 * np.outer(flat @ bow, flat @ bow)
    whole, tried, first = np.sum(own**2, axis=(1, 2)), [], 0
    for cause, each in named.items():
        part = slice(first, first + len(each))
        first = part.stop
        if np.trace(gram[part, part]) <= FREED**2 * np.sum(whole[part]):
            continue
        size = _solved(gram[part, part], scores[part])
        statistic = float(scores[part] @ _solved(covariance[part, part], scores[part]))
        chance = min(1.0, flights * float(gammaincc(len(each) / 2, statistic / 2)))
        share = float(scores[part] @ size) / square
        tried.append((Suspect(cause, _told(cause, size), chance, share), freed[part]))
    return tried


def _solved(gram: Array, scores: Array) -> Array:
    """G^+ s; half of the causes have one column, and a decomposition is a detour there."""
    if len(scores) == 1:
        return scores / gram[0, 0] if gram[0, 0] > 0 else np.zeros(1)
    roots, vectors = np.linalg.eigh(gram)
    kept = roots > ROUNDING * roots[-1]
    solved: Array = vectors[:, kept] @ ((vectors[:, kept].T @ scores) / roots[kept])
    return solved


def _covariance(observed: Observed, columns: Array) -> Array:
    """Z'SZ (k, k) of columns (k, 2, m), S the noise of the sensors and kicks that was found.

    Under quadratic drag noise is larger where less drags: it goes its way sample by sample.
    """
    fit, passage = observed.fit, observed.passage
    spectra, weight = np.fft.rfft(columns, passage.size), frequency_weights(passage.size)
    if fit.stretch is None:
        return forms(spectra, weight * (observed.amounts @ observed.shapes))
    kicked = np.fft.rfft(fit.stretched(columns), passage.size) * passage.kicks
    every = [*raw_plain(fit, passage, columns, spectra), kicked]
    each = [level * forms(own, weight) for level, own in zip(observed.levels, every, strict=True)]
    total: Array = np.sum(each, axis=0)
    return total


def _told(cause: Cause, size: Array) -> tuple[float, ...]:
    """The size of a cause from the coefficients of its columns."""
    if cause is Cause.SWELLING:
        return (math.sqrt(0.5 * float(size @ size)),)
    return tuple((2 * size if cause is Cause.STRETCH else size).tolist())
