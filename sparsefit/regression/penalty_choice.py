"""The choice of the penalty from the data: ``alpha_fraction = "auto"``.

Both rules compare a criterion at the same 30 fractions, strongest first. They use no random numbers
and do not depend on units.
"""

import math
from typing import Any

import numpy as np

from sparsefit.arrays import Array
from sparsefit.errors import InputError
from sparsefit.regression.backend import PathBackend
from sparsefit.regression.design import Design
from sparsefit.regression.penalties import AbsoluteValues, Penalty
from sparsefit.regression.problem import RegressionProblem

FRACTIONS: tuple[float, ...] = tuple(np.geomspace(1.0, 1e-3, 30).tolist())
FOLDS = 5  # of cross-validation: each a fifth of the samples, in one piece
FLOOR = float(np.finfo(float).eps)  # of a residual relative to the target: a perfect fit


def choose_penalty(
    problem: RegressionProblem, backend: PathBackend, weights: Array
) -> tuple[int, Array]:
    """The index in FRACTIONS chosen by ``backend.selection``, and the criterion (p,).

    weights (p, k, n): the path on all samples, in original units; NaN where a point is not solved,
    and so is the criterion there. The index is 0 where no point is solved. ``bic`` minimises the
    `information_criterion`. ``cross-validation`` takes the strongest penalty within one standard
    error of the least `held_out_errors` (Breiman, Friedman, Olshen and Stone 1984): that of the
    differences from the best penalty fold by fold, which have no noise of the folds in common.
    Raises InputError where the samples cannot be divided into folds.
    """
    solved = np.isfinite(weights).all(axis=(1, 2))
    if not solved.any():
        return 0, np.full(len(weights), np.nan)
    if getattr(backend, "selection", "") == "bic":
        criterion = information_criterion(problem, backend.penalty(problem), weights)
        return int(np.nanargmin(criterion)), criterion
    errors = np.where(solved, held_out_errors(problem, backend), np.nan)
    criterion = errors.mean(axis=0)
    if not np.isfinite(criterion).any():
        return 0, criterion
    excess = errors - errors[:, [int(np.nanargmin(criterion))]]
    within = excess.mean(axis=0) <= excess.std(axis=0, ddof=1) / math.sqrt(FOLDS)
    return int(np.flatnonzero(within)[0]), criterion


def information_criterion(problem: RegressionProblem, penalty: Penalty, weights: Array) -> Array:
    """m' sum_t log RSS_t + log(m') df (p,) of a path, weights (p, k, n) (Schwarz 1978).

    df: `degrees_of_freedom`. m': `effective_samples` of the residuals at the weakest penalty,
    which have the least structure left.
    """
    points, columns, targets = weights.shape
    design, scaled = problem.design, weights * problem.design.rms[:, None]
    solved = np.flatnonzero(np.isfinite(weights).all(axis=(1, 2)))
    values = scaled.transpose(1, 0, 2).reshape(columns, points * targets)
    fitted = design.predict(np.where(np.isfinite(values), values, 0.0))
    residuals = problem.target[:, None, :] - fitted.reshape(-1, points, targets)
    null = np.einsum("it,it->t", problem.target, problem.target)
    size = float(problem.samples)
    if problem.sample_count is None:  # rows of a QR have lost the samples' order
        size = effective_samples(residuals[:, solved[-1]])
    alphas = problem.alpha_max(penalty) * np.array(FRACTIONS)
    criterion = np.full(points, np.nan)
    for i in solved:
        share = np.einsum("it,it->t", residuals[:, i], residuals[:, i]) / np.where(null, null, 1.0)
        pull = design.correlate(residuals[:, i])
        freedom = degrees_of_freedom(design, scaled[i], pull, float(alphas[i]), penalty)
        criterion[i] = size * np.log(np.maximum(share, FLOOR)).sum() + math.log(size) * freedom
    return criterion


def degrees_of_freedom(
    design: Design, weights: Array, pull: Array, alpha: float, penalty: Penalty
) -> float:
    """df = tr[H dV/dB] of weights V (k, n), scaled, with C = ``pull`` (Vaiter et al. 2017).

    From V = prox(V + C), with the derivative M = N N' of the prox on the coefficients in use,
    dV/dB = (I - M + M (H + alpha rho I))^-1 M, H = Z'Z/m for each target. For single coefficients
    that is the size of the support (Zou, Hastie and Tibshirani 2007).
    """
    if isinstance(penalty, AbsoluteValues) and not penalty.ridge:
        return float(np.count_nonzero(weights))
    if not weights.any():
        return 0.0
    if not penalty.coupled and weights.shape[1] > 1:
        parts = zip(weights.T[:, :, None], pull.T[:, :, None], strict=True)
        return sum(degrees_of_freedom(design, *each, alpha, penalty) for each in parts)
    ridge = alpha * penalty.ridge
    origin = weights + pull - ridge * weights
    # A prox has exact ties, where weights of one cluster may differ by rounding.
    on, factor = penalty.slope(origin, penalty.prox(origin, alpha), alpha)
    if not len(on):
        return 0.0
    column, target = np.divmod(on, weights.shape[1])
    used, place = np.unique(column, return_inverse=True)
    square = design.products(used)[np.ix_(place, place)]
    square = np.where(target[:, None] == target, square, 0.0)
    shrink = np.eye(len(on)) if factor is None else (factor @ factor.T).toarray()
    bent = np.eye(len(on)) - shrink + shrink @ (square + ridge * np.eye(len(on)))
    rate = np.linalg.lstsq(bent, shrink, rcond=FLOOR)[0]
    return float(np.sum(square * rate.T))


def effective_samples(residual: Array) -> float:
    """The number m' = m / (1 + 2 sum_j rho_j) of equivalent independent samples, in [2, m].

    residual (m, n), in the order of the samples. The autocorrelations rho_j, pooled over the
    targets, are summed in pairs up to the first pair that is not positive (Geyer 1992).
    """
    m = len(residual)
    spectrum = np.abs(np.fft.rfft(residual, 2 * m, axis=0)) ** 2
    covariance = np.fft.irfft(spectrum, 2 * m, axis=0)[:m].sum(axis=1)
    if m < 4 or not covariance[0] > 0:
        return float(max(m, 2))
    pairs = (covariance / covariance[0])[: m - m % 2].reshape(-1, 2).sum(axis=1)
    ended = np.flatnonzero(pairs <= 0)
    time = 2.0 * float(pairs[: ended[0] if len(ended) else None].sum()) - 1.0
    return float(np.clip(m / max(time, 1.0), 2.0, m))


def held_out_errors(problem: RegressionProblem, backend: PathBackend) -> Array:
    """|Y - theta W|^2 per sample of each fold over that of the target, (folds, p); NaN unsolved.

    Squares count by the sample's weight, and linearly beyond the knot of Huber's loss. Folds are
    contiguous, so that what is held out is not beside what was fitted, in time or in space. Raises
    InputError on fewer than 2 samples a fold, and on compressed ones.
    """
    if problem.sample_count is not None or problem.samples < 2 * FOLDS:
        least = f"at least {2 * FOLDS} samples, not {problem.samples}"
        words = "samples, but they are compressed" if problem.sample_count else least
        raise InputError(f"cross-validation needs {words}; give alpha_fraction as a number")
    folds = np.array_split(np.arange(problem.samples), FOLDS)
    square = float(np.einsum("it,it->", problem.target, problem.target)) / problem.samples or 1.0
    reach = backend.penalty(problem).loss.bound(problem.target)
    reach = np.broadcast_to(reach, problem.target.shape)
    errors = np.empty((FOLDS, len(FRACTIONS)))
    whole = problem.target if problem.raw_target is None else problem.raw_target
    missing = np.full((problem.columns, problem.targets), np.nan)
    for i, fold in enumerate(folds):
        part = problem.part(np.concatenate(folds[:i] + folds[i + 1 :]))
        answers: Any = backend.solve_path(part, FRACTIONS)
        path = [missing if each.weights is None else each.weights for each in answers]
        loss = backend.penalty(part).loss
        rows, levels = problem.theta[fold], [part.intercept_of(each, loss) for each in path]
        fitted = np.stack([rows @ each for each in path]) + np.stack(levels)[:, None, :]
        misfit = whole[fold] - fitted
        if problem.design.weights is not None:
            misfit *= problem.design.weights[fold, None]
        pull = np.clip(misfit, -reach[fold], reach[fold])
        errors[i] = np.einsum("pit,pit->p", pull, 2.0 * misfit - pull) / (len(fold) * square)
    return errors
