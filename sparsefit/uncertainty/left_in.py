"""What `bias` says of any `Superposed` fit: to first order, and left in its values.

Truncation of the rows that were fitted, and noise in what their columns are taken at: positions,
and the velocity where the response time is unknown.
"""

import numpy as np

from sparsefit.arrays import Array
from sparsefit.derivative import Samples, WeakRows
from sparsefit.derivative.filters import Filters, kicks_through
from sparsefit.uncertainty.bias import WAVES, truncation
from sparsefit.uncertainty.model import along_x, along_y
from sparsefit.uncertainty.superposed import Superposed


def scores(
    model: Superposed, samples: Samples, filters: Filters, response_time: float, kicks: float
) -> list[Array]:
    """J'e (n,) of the truncation, and of the noise in what the columns are taken at, as known.

    The latter needs the noise levels; of weak averages it leaves out what the noise of the columns
    shares with that of Phi. kicks: the variance of tau times the noise of the acceleration, which
    the velocity after it holds: where the velocity has a column, errors and column are correlated,

        E v'e = tau sigma^2 h sum_j p_j r_j,

    p_j the weight of step j in the filtered acceleration and r_j in the filtered velocity.
    """
    lost, share = _lost(model, samples, filters, response_time)
    found = [share * model.score(lost)]
    if np.isfinite(filters.sigma_position) and np.isfinite(filters.sigma_velocity):
        found.append(_noisy_columns(model, samples, filters, response_time))
    if model.nuisance.shape[2] % 2:  # v has a column, the first
        step = float(np.mean(np.diff(samples.time)))
        held = kicks_through(filters.raw[1], step)
        score = np.zeros(model.parameters)
        by_row = kicks / response_time * float(np.sum(filters.kicks * held))
        score[17 * model.scales] = model.nuisance[..., 0].size * by_row
        found.append(score)
    return found


def _lost(
    model: Superposed, samples: Samples, filters: Filters, response_time: float
) -> tuple[Array, float]:
    """As `truncation`, of the rows (q, 2); those of the weak form average smoothed states."""
    weak = samples.weak
    if weak is None:
        return truncation(model, samples.velocity, filters)
    path, size = filters.path, len(samples.velocity)
    if path is None or size < 2 * path.shape[2]:
        return np.zeros((len(weak.time), 2)), 1.0
    place, speed = np.zeros((size, 2)), np.zeros((size, 2))
    half = path.shape[2] // 2
    inner = slice(half, size - half)
    for kernels, lost, state in (
        (path[0], place, model.position),
        (path[1], speed, samples.velocity),
    ):
        for axis in range(2):
            parts = (model.position[:, axis], samples.velocity[:, axis])
            lost[inner, axis] = sum(
                np.convolve(one, kernel[::-1], "valid")
                for one, kernel in zip(parts, kernels, strict=True)
            )
        lost[inner] -= state[inner]
    bent = np.einsum("imt,mi->mt", model.gradient, place)
    rows: Array = weak.operator @ (speed - bent) + response_time * (weak.rate @ speed)
    return rows, 1.0


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


def _noisy_columns(
    model: Superposed, samples: Samples, filters: Filters, response_time: float
) -> Array:
    """E J'e (n,), of `noisy_positions` for every scale, and of the noise of v in its column."""
    variances = np.array([[filters.sigma_position], [filters.sigma_velocity]]) ** 2
    place, velocity, acceleration = filters.raw
    square = float(np.sum(variances * place**2))
    curls = [part.wavenumber**2 * (part.columns.T @ (WAVES * part.weights)) for part in model.parts]
    bowed = 0.5 * square * np.sum(curls, axis=0)
    score = model.score(model.averaged(bowed))
    if model.nuisance.shape[2] % 2:  # v has a column, the first
        pair = velocity + response_time * acceleration, velocity
        if samples.weak is not None:
            pair = _averaged_velocity(samples.weak, velocity, response_time)
        by_row = float(np.sum(variances * pair[0] * pair[1]))
        score[17 * model.scales] += model.nuisance[..., 0].size * by_row
    if samples.weak is not None:
        return score
    through = velocity + response_time * acceleration
    shared = float(np.sum(variances * place * through))
    steep, s = square * model.gradient, model.scales
    for j, part in enumerate(model.parts):
        k, (cx, cy) = part.wavenumber, part.slopes
        of_weights = -k * (cx @ steep[0] + cy @ steep[1])
        of_weights += shared * k * np.column_stack([cx.sum(axis=1), cy.sum(axis=1)])
        x, y = part.position.T
        turned = [
            (slope + k * (x * along_x(slope) + y * along_y(slope))).T @ part.weights
            for slope in (cx, cy)
        ]
        score[j] -= np.sum(np.stack(turned) * steep)
        score[j] += shared * (turned[0][:, 0].sum() + turned[1][:, 1].sum())
        for t in range(2):
            first = s + 8 * s * t + 8 * j
            score[first : first + 8] += of_weights[:, t]
    return score
