"""How strong the penalty should be, told from the data alone: ``alpha_fraction = "auto"``.

Every rule walks the same 30 fractions, strongest first, and picks one; it keeps the criterion that
it compared. Nothing is drawn at random, the truth is not asked, and units do not matter.
"""

import math
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from sparsefit.arrays import Array, IntArray
from sparsefit.errors import InputError
from sparsefit.regression.backend import ChoosingBackend, Selection
from sparsefit.regression.design import Design
from sparsefit.regression.penalties import AbsoluteValues, Penalty
from sparsefit.regression.problem import RegressionProblem

FRACTIONS = tuple(np.geomspace(1.0, 1e-3, 30).tolist())
FOLDS = 5  # of cross-validation: each a fifth of the samples, in one piece
PIECES = 6  # of stability selection: their 20 halves are fitted
THRESHOLD = 0.75  # share of the halves that makes a group stable: the middle of 0.6 ... 0.9
FLOOR = float(np.finfo(float).eps)  # of a residual relative to the target: a perfect fit


@dataclass(frozen=True, eq=False)
class PenaltyChoice:
    """The choice of a penalty: ``criterion`` (p,) at ``fractions`` (p,), and the ``index`` taken.

    criterion: the information criterion, the relative squared error on held-out folds, or the
    bound on falsely selected groups; NaN where there is no solution. ``errors`` (p,): standard
    errors of the held-out error's excess over the least. ``effective_samples``: what the samples
    count for in an information criterion, given the autocorrelation of the residuals.
    """

    selection: Selection
    fractions: Array
    criterion: Array
    index: int
    errors: Array | None = None
    effective_samples: float = math.nan

    @property
    def fraction(self) -> float:
        """The chosen alpha_fraction."""
        return float(self.fractions[self.index])


def choose_penalty(
    problem: RegressionProblem, backend: ChoosingBackend, weights: Array
) -> PenaltyChoice:
    """The choice of ``backend.selection`` among FRACTIONS; the strongest where none is solved.

    weights (p, k, n): the path on all samples, in original units, NaN where it failed.
    Raises InputError where cross-validation or stability selection cannot cut the samples up.
    """
    rules = {"cross-validation": cross_validation, "stability": stability_selection}
    choose = rules.get(backend.selection, information_criterion)
    if not np.isfinite(weights).all(axis=(1, 2)).any():
        missing = np.full(len(weights), np.nan)
        return PenaltyChoice(backend.selection, np.array(FRACTIONS), missing, 0)
    return choose(problem, backend, weights)


def information_criterion(
    problem: RegressionProblem, backend: ChoosingBackend, weights: Array
) -> PenaltyChoice:
    """The least m' sum_t log RSS_t + log(m') df (Schwarz 1978).

    For ``ebic`` plus 2 log C(G, s) with s of G blocks in use (Chen and Chen 2008). df as in
    `degrees_of_freedom`. m' (`effective_samples`) is that of the weakest penalty's residuals,
    which hold the least of what the others leave unexplained. weights (p, k, n): the path.
    """
    points, columns, targets = weights.shape
    design, rms = problem.design, problem.design.rms
    solved = np.flatnonzero(np.isfinite(weights).all(axis=(1, 2)))
    values = (weights * rms[:, None]).transpose(1, 0, 2).reshape(columns, points * targets)
    fitted = design.predict(np.where(np.isfinite(values), values, 0.0))
    residuals = problem.target[:, None, :] - fitted.reshape(-1, points, targets)
    null = np.einsum("it,it->t", problem.target, problem.target)
    size = float(problem.samples)
    if not problem.is_compressed:  # rows that mix samples say nothing of their order
        size = effective_samples(residuals[:, solved[-1]])
    penalty = backend.penalty(problem)
    alphas = problem.alpha_max(penalty) * np.array(FRACTIONS)
    criterion = np.full(points, np.nan)
    for i in solved:
        scaled = weights[i] * rms[:, None]
        share = np.einsum("it,it->t", residuals[:, i], residuals[:, i]) / np.where(null, null, 1.0)
        pull = design.correlate(residuals[:, i])
        freedom = degrees_of_freedom(design, scaled, pull, float(alphas[i]), penalty)
        criterion[i] = size * np.log(np.maximum(share, FLOOR)).sum() + math.log(size) * freedom
        if backend.selection == "ebic":
            used = scaled.any(axis=1, keepdims=True) if penalty.joint else scaled != 0
            blocks = int(penalty.blocks.max()) + 1
            for active in (len(np.unique(penalty.blocks[on])) for on in used.T):
                rest = math.lgamma(active + 1) + math.lgamma(blocks - active + 1)
                criterion[i] += 2.0 * (math.lgamma(blocks + 1) - rest)  # log C(G, s)
    chosen = int(np.nanargmin(criterion))
    fractions = np.array(FRACTIONS)
    return PenaltyChoice(backend.selection, fractions, criterion, chosen, None, size)


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
    if not penalty.coupled and weights.shape[1] > 1:
        parts = zip(weights.T[:, :, None], pull.T[:, :, None], strict=True)
        return sum(degrees_of_freedom(design, *each, alpha, penalty) for each in parts)
    ridge = alpha * penalty.ridge
    on, factor = penalty.slope(weights + pull - ridge * weights, weights, alpha)
    if not len(on):
        return 0.0
    column, target = np.divmod(on, weights.shape[1])
    used, place = np.unique(column, return_inverse=True)
    square = design.gram_rows(used)[:, used][np.ix_(place, place)]
    square = np.where(target[:, None] == target, square, 0.0)
    shrink = np.eye(len(on)) if factor is None else (factor @ factor.T).toarray()
    bent = np.eye(len(on)) - shrink + shrink @ (square + ridge * np.eye(len(on)))
    rate = np.linalg.lstsq(bent, shrink, rcond=FLOOR)[0]
    return float(np.sum(square * rate.T))


def effective_samples(residual: Array) -> float:
    """m' = m / (1 + 2 sum_j rho_j): how many independent samples would say as much, in [2, m].

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


def cross_validation(
    problem: RegressionProblem, backend: ChoosingBackend, weights: Array
) -> PenaltyChoice:
    """The strongest penalty within one standard error of the least error on held-out folds.

    Folds are contiguous, so that what is held out is not beside what was fitted, in time or in
    space. Error: |Y - theta W|^2 / |Y|^2 per sample (Breiman, Friedman, Olshen and Stone 1984).
    The standard error is that of the difference from the best, fold by fold: how much noise a
    fold holds is the same for every penalty, and would otherwise drown what they differ by.
    weights (p, k, n): the path on all samples, NaN where it failed. Raises InputError on fewer than
    2 samples a fold, and on compressed ones.
    """
    folds = _pieces(problem, FOLDS, backend)
    square = float(np.einsum("it,it->", problem.target, problem.target)) / problem.samples or 1.0
    losses = np.empty((FOLDS, len(FRACTIONS)))
    for i, fold in enumerate(folds):
        path, levels = _path_on(problem, backend, folds[:i] + folds[i + 1 :])
        rows = problem.theta[fold]
        fitted = np.stack([rows @ each for each in path]) + levels[:, None, :]
        misfit = problem.raw_target[fold] - fitted
        losses[i] = np.einsum("pit,pit->p", misfit, misfit) / (len(fold) * square)
    losses[:, ~np.isfinite(weights).all(axis=(1, 2))] = np.nan
    mean, fractions = losses.mean(axis=0), np.array(FRACTIONS)
    if not np.isfinite(mean).any():
        return PenaltyChoice(backend.selection, fractions, mean, 0)
    excess = losses - losses[:, [int(np.nanargmin(mean))]]
    errors = excess.std(axis=0, ddof=1) / math.sqrt(FOLDS)
    chosen = int(np.flatnonzero(excess.mean(axis=0) <= errors)[0])
    return PenaltyChoice(backend.selection, fractions, mean, chosen, errors)


def stability_selection(
    problem: RegressionProblem, backend: ChoosingBackend, weights: Array
) -> PenaltyChoice:
    """The weakest penalty with at most one falsely selected group (Meinshausen, Buehlmann 2010).

    From zero down to a penalty, halves of the samples select q of the G groups on average; of those
    that more than THRESHOLD of the halves select, at most q^2 / ((2 THRESHOLD - 1) G) are false.
    A half is 3 of 6 pieces, whole so that neighbours stay together; all complementary pairs are
    used (Shah and Samworth 2013). weights (p, k, n) and InputError as in `cross_validation`.
    """
    pieces = _pieces(problem, PIECES, backend)
    member = problem.groups[:, None] == np.arange(problem.groups.max() + 1)
    sizes = []
    for half in combinations(pieces, PIECES // 2):
        chosen = np.not_equal(_path_on(problem, backend, list(half))[0], 0).any(axis=2)
        sizes.append(np.maximum.accumulate(chosen @ member, axis=0).sum(axis=1))
    bound = np.mean(sizes, axis=0) ** 2 / ((2 * THRESHOLD - 1) * member.shape[1])
    bound[~np.isfinite(weights).all(axis=(1, 2))] = np.nan
    index = int(np.flatnonzero(bound <= 1.0).max(initial=0))
    return PenaltyChoice(backend.selection, np.array(FRACTIONS), bound, index)


def _uncut(backend: ChoosingBackend) -> str:
    """The remedy where samples cannot be cut up: a rule without pieces that the back-end takes."""
    for rule in ("ebic", "bic"):
        try:
            replace(backend, selection=rule)  # type: ignore[type-var]
        except ValueError:
            continue
        return f'use selection "{rule}"'
    return "give alpha_fraction as a number"


def _pieces(problem: RegressionProblem, count: int, backend: ChoosingBackend) -> list[IntArray]:
    needs = f"selection {backend.selection!r} needs"
    if problem.is_compressed:
        raise InputError(f"{needs} samples, but they are compressed; {_uncut(backend)}")
    if problem.samples < 2 * count:
        least = f"at least {2 * count} samples, not {problem.samples}"
        raise InputError(f"{needs} {least}; {_uncut(backend)}")
    return list(np.array_split(np.arange(problem.samples), count))


def _path_on(
    problem: RegressionProblem, backend: ChoosingBackend, pieces: list[IntArray]
) -> tuple[Array, Array]:
    """Weights (p, k, n) of the path on these pieces, NaN where there is no solution; intercepts."""
    try:
        part = problem.part(np.concatenate(pieces))
    except InputError as error:
        raise InputError(
            f"selection {backend.selection!r}: on a part of the samples, {error}, or "
            + _uncut(backend)
        ) from None
    missing = np.full((problem.columns, problem.targets), np.nan)
    solutions = backend.solve_path(part, FRACTIONS)
    weights = np.stack([missing if s.weights is None else s.weights for s in solutions])
    return weights, np.stack([part.intercept_of(each) for each in weights])
