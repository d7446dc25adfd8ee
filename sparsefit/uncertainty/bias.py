"""What smoothing and noisy columns take from theta, to first order, for any rows.

Truncation. Phi is read through the filters of `sparsefit.derivative.filters`: along the path, with
V' = (w - v)/tau + a, it is away from w by

    b = (P - 1)(w - v) + (S - 1) v - grad w . (X_s - x),

all of it known once w is: J'b is taken from the fit's normal equations, twice, as w itself moves.
Weak rows average smoothed states, and take no derivative: Psi ((S - 1) v - grad w . (X_s - x)) +
tau R (S - 1) v.

Noise of the position (variance s^2 per axis after smoothing, covariance q with that of Phi): the
columns stand at x + n, and with e = Phi - C w the normal equations are off by

    E J'e = s^2/2 J'(-Laplacian w) - s^2 sum_a (d_a J)'(d_a w) + q (d_t J_t)' 1,

which over many cells attenuates a plane wave kappa by exp(-|kappa|^2 s^2 / 2), and more where the
path leaves a combination of columns ill determined (Carroll et al., 2006). Weak averages share
noise from sample to sample: with n the smoothed noise and e = (Psi + tau R) n_v - Psi (grad w . n)
that of the rows, the last two terms are those of sum_a (d_a C)' l_a at the samples,

    l_a(i) = sum_q Psi_qi E[n_a(i) e_q].

Noise of the velocity, where the response time is unknown and v is a column: E v'e is the
covariance of both, row by row; of kicks to the acceleration, which the velocity after them holds,
tau sigma^2 h sum_j p_j r_j, p_j the weight of step j in the filtered acceleration and r_j in
the filtered velocity.

Quadratic drag: tau is the response dr/dF of each sample (`filtered`), (w - v)/tau is F(w - v) and
(P - 1)(w - v) is dr/dF (P - 1) F. And r(F) is no line: its mean over the noise of v' is another.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sparsefit.arrays import Array, ComplexArray
from sparsefit.derivative import WeakRows
from sparsefit.derivative.filters import Filters, kicks_through
from sparsefit.derivative.transform import fast_length
from sparsefit.uncertainty.filtered import Filtered
from sparsefit.uncertainty.model import Model

PASSES = 2  # of the truncation: the flow it is computed from moves by it


@dataclass(frozen=True, eq=False)
class Distortion:
    """What the filters take from a path, whatever the flow: 0 at the ends, where samples lack.

    Args:
        place: X_s - x (2, m) [m].
        speed: (S - 1) v (2, m) [m/s].
        mean: the transform of P.
        half: samples at either end that lack others.
        size: of the transforms.
    """

    place: Array
    speed: Array
    mean: ComplexArray
    half: int
    size: int

    @classmethod
    def of(cls, position: Array, velocity: Array, filters: Filters) -> Distortion | None:
        """Of states (m, 2) [m], [m/s]; None where steps are uneven or samples too few."""
        path, mean, samples = filters.path, filters.mean, len(velocity)
        if path is None or mean is None or samples < 2 * len(mean):
            return None
        size, half = fast_length(samples), len(mean) // 2
        states = np.concatenate([position.T, velocity.T])
        spectra = np.fft.rfft(states, size).reshape(2, 2, -1)
        kernels = np.fft.rfft(path, size).conj()  # (2 of place and speed, 2 from x and v, ...)
        filtered = np.fft.irfft(np.einsum("osf,saf->oaf", kernels, spectra), size)
        place, speed = np.zeros((2, 2, samples))
        inner = slice(half, samples - half)
        place[:, inner] = filtered[0, :, : samples - 2 * half] - position.T[:, inner]
        speed[:, inner] = filtered[1, :, : samples - 2 * half] - velocity.T[:, inner]
        return cls(place, speed, np.fft.rfft(mean, size).conj(), half, size)

    @property
    def share(self) -> float:
        """Samples over those of which the distortion is known."""
        samples = int(self.place.shape[1])
        return samples / (samples - 2 * self.half)

    def of_samples(self, model: Model, fit: Filtered) -> Array:
        """b at the samples (m, 2) [m/s], of a model of them and the fit that it is of."""
        velocity = fit.samples.velocity
        lost, samples = self._bent(model), len(velocity)
        excess = model.flow.T - velocity.T
        if fit.stretch is not None:
            excess = fit.vehicle.drag_of(excess.T).T
        filtered = np.fft.irfft(np.fft.rfft(excess, self.size) * self.mean, self.size)
        inner = slice(self.half, samples - self.half)
        short = np.zeros_like(excess)
        short[:, inner] = filtered[:, : samples - 2 * self.half] - excess[:, inner]
        if fit.stretch is not None:
            short = fit.response_time * fit.stretched(short)
        lost += short.T
        return lost

    def of_weak(self, model: Model, weak: WeakRows, response_time: float) -> Array:
        """What weak rows lose (q, 2) [m/s], of a model of them; tau [s]."""
        rows: Array = weak.operator @ self._bent(model)
        return rows + response_time * (weak.rate @ self.speed.T)

    def _bent(self, model: Model) -> Array:
        """(S - 1) v - grad w . (X_s - x) at the samples (m, 2) [m/s]."""
        bent: Array = self.speed.T - np.sum(model.gradient * self.place[:, None], axis=0).T
        return bent


@dataclass(frozen=True, eq=False)
class Truncated:
    """A fit less what its filters took.

    Args:
        model: the fit, moved by the truncation that it implies, of all flights.
        errors: what is then left of the rows of a flight, (q, 2) [m/s].
        at_samples: what a fit of the flight's samples leaves of their Phi, (m, 2) [m/s].
        together: what the fit of all flights leaves of it.
    """

    model: Model
    errors: Array
    at_samples: Array
    together: Array


def without_truncation(fit: Filtered) -> Truncated:
    """Take the truncation from the fit of one flight; where steps are uneven none is known."""
    return every_without_truncation([fit], fit.model)[0]


def every_without_truncation(fits: Sequence[Filtered], whole: Model) -> list[Truncated]:
    """Take the truncation from a fit of several flights."""
    distortions = [_distortion(fit) for fit in fits]
    base = moved = whole
    losses = [np.zeros_like(fit.model.rows.target) for fit in fits]
    for _ in range(PASSES if any(distortions) else 0):
        base, score = moved, np.zeros(whole.jacobian.size)
        for i, (fit, distortion) in enumerate(zip(fits, distortions, strict=True)):
            if distortion is not None:
                losses[i], share = _lost(fit, distortion, fit.at(base))
                score -= fit.weight**2 * share * fit.model.jacobian.score(losses[i])
        moved = whole.moved(score)
    cleared = []
    for fit, distortion, lost in zip(fits, distortions, losses, strict=True):
        own = fit.at(base)
        errors = at_samples = own.residual - lost
        plain = fit.as_samples(own)
        if fit.samples.weak is not None:
            at_samples = plain.residual
            if distortion is not None:
                at_samples = at_samples - distortion.of_samples(plain, fit)
            at_samples = _refitted(plain, at_samples)
        alone = at_samples if len(fits) == 1 else _refitted(plain, at_samples)
        cleared.append(Truncated(moved, errors, alone, at_samples))
    return cleared


def _distortion(fit: Filtered) -> Distortion | None:
    position = fit.model.rows.position[:, :2]
    return Distortion.of(position, fit.samples.velocity, fit.filters)


def _lost(fit: Filtered, distortion: Distortion, model: Model) -> tuple[Array, float]:
    """What the rows of a flight lose (q, 2) [m/s], and of how many times as many it is known."""
    if fit.samples.weak is not None:
        return distortion.of_weak(model, fit.samples.weak, fit.response_time), 1.0
    return distortion.of_samples(model, fit), distortion.share


def _refitted(plain: Model, errors: Array) -> Array:
    """What a fit of a flight's own samples leaves of errors (m, 2).

    Weak rows leave more of them, and so does a fit of several flights. Left in, what the two fits
    differ by would be taken for kicks, and the intervals be twice as wide.
    """
    left: Array = plain.freed(errors.T[None])[0].T
    return left


def noisy_columns(fit: Filtered) -> Array:
    """E J'e (n,) of measured noise in what the columns are taken at."""
    filters, weak, model = fit.filters, fit.samples.weak, fit.model
    variances = np.array([[filters.sigma_position], [filters.sigma_velocity]]) ** 2
    place, velocity, acceleration = filters.raw
    tau = fit.response_time
    through = velocity + fit.evenness * tau * acceleration
    square = float(np.sum(variances * place**2)) + fit.wander.rms**2
    bowed = model.rows.averaged(-0.5 * square * model.laplacian)
    score = model.jacobian.score(bowed.T)
    if fit.shared:
        pair = through, velocity
        if weak is not None:
            pair = _averaged_velocity(weak, velocity, fit.response_time)
        score += _in_velocity(fit, float(np.sum(variances * pair[0] * pair[1])))
    if weak is not None:
        return score + _shaken(model, _load_of_averages(fit, weak, variances))
    load = -square * model.gradient
    if fit.stretch is None:
        load[[0, 1], [0, 1]] += float(np.sum(variances * place * through))
    else:
        load[[0, 1], [0, 1]] += float(np.sum(variances * place * velocity))
        load += tau * float(np.sum(variances * place * acceleration)) * fit.stretch
    return score + _shaken(model, load)


def kicked_velocity(fit: Filtered, kicks: float) -> Array:
    """E J'e (n,) of kicks in the column of the velocity; kicks: the variance of tau times them."""
    held = kicks_through(fit.filters.raw[1], float(np.mean(np.diff(fit.samples.time))))
    by_row = kicks * fit.evenness / fit.response_time * float(np.sum(fit.filters.kicks * held))
    return _in_velocity(fit, by_row)


def curved(fit: Filtered) -> Array:
    """J'e (n,) of noise in v', of which the relative velocity of quadratic drag is no line."""
    return fit.plain.jacobian.score(fit.bow)


def _in_velocity(fit: Filtered, by_row: float) -> Array:
    """J'e (n,) where every row of either component gives the column of v its e."""
    model = fit.model
    score = np.zeros(model.jacobian.size)
    first = fit.place - len(model.coefficients)
    score[first] = model.rows.nuisance[..., fit.place].size * by_row
    return score


def _shaken(model: Model, load: Array) -> Array:
    """sum_a (d_a J)' load_a (n,), of loads (2, 2, m) by axis and component at the samples."""
    modes, size, targets = model.weights.shape
    stacked = load.reshape(2, targets, -1).swapaxes(1, 2)  # (2, r, n), as the columns are
    products = model.columns.reshape(modes * size, -1) @ stacked
    along = model.maps[1:3] @ products.reshape(2, modes, size, targets)
    bent = model.family.bent_gradients(
        model.rows.position, model.parameters, model.columns, model.weights
    )
    by_parameter = np.sum(bent * stacked[:, None, None], axis=(0, 3, 4))
    return model.joined(by_parameter, along.sum(axis=0), np.zeros(len(model.coefficients)))


def _load_of_averages(fit: Filtered, weak: WeakRows, variances: Array) -> Array:
    """l (2, 2, m), by axis and component; variances (2, 1) of the raw position and velocity."""
    ends, gradient = weak.operator.indptr, fit.model.gradient
    counts, samples = np.diff(ends), gradient.shape[2]
    wide = int(counts.max())
    held = np.arange(wide) < counts[:, None]  # rows stand on neighbouring samples
    places = np.minimum(weak.operator.indices[ends[:-1], None] + np.arange(wide), samples - 1)
    mean, rate = np.zeros((2, *held.shape))
    mean[held], rate[held] = weak.operator.data, weak.rate.data
    place, velocity, _ = fit.filters.raw
    apart = np.abs(np.subtract.outer(np.arange(wide), np.arange(wide)))
    of_place = _together(place, place, variances, wide) + fit.wander.covariance(wide)[apart]
    total = (mean + fit.response_time * rate) @ _together(place, velocity, variances, wide).T
    load = np.zeros((2, 2, samples))
    for axis, component in np.ndindex(2, 2):
        shared = -(mean * gradient[axis, component][places]) @ of_place
        if axis == component:
            shared += total
        np.add.at(load[axis, component], places[held], (mean * shared)[held])
    return load


def _together(first: Array, second: Array, variances: Array, size: int) -> Array:
    """E f(i) s(j) (size, size), of white noise through two filters (2, n)."""
    products = zip(second, first, variances[:, 0], strict=True)
    full = np.sum([square * np.correlate(s, f, "full") for s, f, square in products], axis=0)
    inside = np.pad(full, size)[len(full) // 2 + 1 : len(full) // 2 + 2 * size]
    lags = np.subtract.outer(np.arange(size), np.arange(size))
    covariance: Array = inside[lags + size - 1]
    return covariance


def _averaged_velocity(
    weak: WeakRows, velocity: Array, response_time: float
) -> tuple[Array, Array]:
    """Weights (2, n) of raw samples in the Phi and in the velocity of one weak row."""
    middle = [len(weak.time) // 2]
    mean, rate = (one[middle].toarray()[0] for one in (weak.operator, weak.rate))
    used = np.flatnonzero(mean)
    held = slice(used[0], used[-1] + 1)
    of_phi, of_velocity = (mean + response_time * rate)[held], mean[held]
    return (
        np.stack([np.convolve(of_phi, raw) for raw in velocity]),
        np.stack([np.convolve(of_velocity, raw) for raw in velocity]),
    )
