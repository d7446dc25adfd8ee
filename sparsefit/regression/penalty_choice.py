"""How strong the penalty should be, told from the data alone: ``alpha_fraction = "auto"``.

Every rule walks the same 30 fractions, strongest first, and picks one; it keeps the criterion that
it compared. Nothing is drawn at random, the truth is not asked, and units do not matter.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from sparsefit.arrays import Array, IntArray
from sparsefit.errors import InputError
from sparsefit.regression.backend import ChoosingBackend, Selection
from sparsefit.regression.objective import Penalty, alpha_max
from sparsefit.regression.problem import RegressionProblem

FRACTIONS = tuple(np.geomspace(1.0, 1e-3, 30).tolist())
FOLDS = 5  # of cross-validation: each a fifth of the samples, in one piece
PIECES = 6  # of stability selection: their 20 halves are fitted
THRESHOLD = 0.75  # share of the halves that makes a group stable: the middle of 0.6 ... 0.9
FLOOR = float(np.finfo(float).eps)  # of a residual relative to the target: a perfect fit


@dataclass(frozen=True, eq=False)
class PenaltyChoice:
    """How a penalty was chosen: ``criterion`` (p,) at ``fractions`` (p,), and the ``index`` taken.

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
    return RULES[backend.selection](problem, backend, weights)


def information_criterion(
    problem: RegressionProblem, backend: ChoosingBackend, weights: Array
) -> PenaltyChoice:
    """The least m' sum_t log RSS_t + log(m') df (Schwarz 1978).

    For ``ebic`` plus 2 log C(G, s) with s of G blocks in use (Chen and Chen 2008). df as in
    `degrees_of_freedom`. m' (`effective_samples`) is that of the weakest penalty's residuals,
    which hold the least of what the others leave unexplained. weights (p, k, n): the path.
    """
    points, columns, targets = weights.shape
    flat = np.ascontiguousarray(weights.transpose(1, 0, 2)).reshape(columns, points * targets)
    fitted = (problem.theta @ flat).reshape(-1, points, targets)
    residuals = problem.target[:, None, :] - fitted
    solved = np.flatnonzero(np.isfinite(weights).all(axis=(1, 2)))
    if not len(solved):
        return _choice(backend, np.full(points, np.nan), 0)
    null = np.einsum("it,it->t", problem.target, problem.target)
    size = float(problem.samples)
    if not _compressed(problem):  # rows that mix samples say nothing of their order
        size = effective_samples(residuals[:, solved[-1]])
    penalty, statistics = backend.penalty(problem), problem.statistics
    alphas = alpha_max(statistics.cross, penalty) * np.array(FRACTIONS)
    criterion = np.full(points, np.nan)
    for i in solved:
        scaled = weights[i] * statistics.rms[:, None]
        share = np.einsum("it,it->t", residuals[:, i], residuals[:, i]) / np.where(null, null, 1.0)
        freedom = degrees_of_freedom(statistics.gram, scaled, float(alphas[i]), penalty)
        criterion[i] = size * np.log(np.maximum(share, FLOOR)).sum() + math.log(size) * freedom
        if backend.selection == "ebic":
            criterion[i] += 2.0 * _log_models(scaled, penalty)
    chosen = int(np.nanargmin(criterion))
    return replace(_choice(backend, criterion, chosen), effective_samples=size)


def degrees_of_freedom(gram: Array, weights: Array, alpha: float, penalty: Penalty) -> float:
    """df = tr[H (H + alpha K)^-1] on the support (Vaiter, Deledalle, Fadili, Peyre, Dossal 2017).

    H = Z'Z/m for each target; K, the curvature of the penalty, is block diagonal with
    omega_g/|V_g| (I - u u'), u = V_g/|V_g|. It vanishes for blocks of one coefficient, where df is
    the size of the support (Zou, Hastie and Tibshirani 2007); blocks within blocks add theirs, and
    a ridge rho I. gram (k, k); weights V (k, n), scaled.
    """
    if penalty.ridge or penalty.within is not None:
        return _dense_freedom(gram, weights, alpha, penalty)
    if penalty.elementwise:
        return float(np.count_nonzero(weights))
    if not penalty.joint:
        alone = replace(penalty, joint=True)
        return sum(degrees_of_freedom(gram, one[:, None], alpha, alone) for one in weights.T)
    norms = penalty.block_norms(weights)[:, 0]
    active = np.flatnonzero(norms)
    used = np.isin(penalty.groups, active)
    if not len(active):
        return 0.0
    member = np.searchsorted(active, penalty.groups[used])
    curvature = alpha * penalty.weights[active] / norms[active]
    hessian = gram[np.ix_(used, used)]
    # Without u u' the targets are alike; those directions, one a group, come back by Woodbury.
    inverse = np.linalg.inv(hessian + np.diag(curvature[member]))
    units = weights[used] / norms[active][member][:, None]
    basis = units.T[:, :, None] * (member[:, None] == np.arange(len(active)))  # (n, used, active)
    lifted = inverse @ basis
    core = np.diag(1.0 / curvature) - np.einsum("tkg,tkh->gh", basis, lifted)
    back = np.einsum("tkg,tkh->gh", lifted, hessian @ lifted)
    extra = np.sum(np.linalg.pinv(core, rcond=FLOOR, hermitian=True) * back)
    return float(weights.shape[1] * np.sum(inverse * hessian) + extra)


def _dense_freedom(gram: Array, weights: Array, alpha: float, penalty: Penalty) -> float:
    """The same for any penalty, from H and K on the support as they stand."""
    column, target = np.nonzero(weights)
    if not len(column):
        return 0.0
    values = weights[column, target]
    hessian = np.where(target[:, None] == target, gram[np.ix_(column, column)], 0.0)
    curvature = np.diag(np.full(len(column), penalty.ridge))
    for part in (penalty, penalty.within):
        if part is None or part.smooth:
            continue
        block = part.groups[column] * weights.shape[1] + (0 if part.joint else target)
        same = block[:, None] == block
        square = same @ values**2
        pull = part.weights[part.groups[column]] / np.sqrt(square)
        curvature += np.diag(pull) - same * np.outer(values * pull / square, values)
    share = np.linalg.lstsq(hessian + alpha * curvature, hessian, rcond=FLOOR)[0]
    return float(np.trace(share))


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
        found = _path_on(problem, backend, folds[:i] + folds[i + 1 :])
        misfit = problem.target[fold] - problem.theta[fold] @ found
        losses[i] = np.einsum("pit,pit->p", misfit, misfit) / (len(fold) * square)
    losses[:, ~np.isfinite(weights).all(axis=(1, 2))] = np.nan
    mean = losses.mean(axis=0)
    if not np.isfinite(mean).any():
        return _choice(backend, mean, 0)
    excess = losses - losses[:, [int(np.nanargmin(mean))]]
    errors = excess.std(axis=0, ddof=1) / math.sqrt(FOLDS)
    chosen = int(np.flatnonzero(excess.mean(axis=0) <= errors)[0])
    return replace(_choice(backend, mean, chosen), errors=errors)


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
    sizes = [
        np.maximum.accumulate((found != 0).any(axis=2) @ member, axis=0).sum(axis=1)
        for found in (
            _path_on(problem, backend, list(half)) for half in combinations(pieces, PIECES // 2)
        )
    ]
    bound = np.mean(sizes, axis=0) ** 2 / ((2 * THRESHOLD - 1) * member.shape[1])
    bound[~np.isfinite(weights).all(axis=(1, 2))] = np.nan
    return _choice(backend, bound, int(np.flatnonzero(bound <= 1.0).max(initial=0)))


RULES: dict[str, Callable[[RegressionProblem, ChoosingBackend, Array], PenaltyChoice]] = {
    "ebic": information_criterion,
    "bic": information_criterion,
    "cross-validation": cross_validation,
    "stability": stability_selection,
}


def _choice(backend: ChoosingBackend, criterion: Array, index: int) -> PenaltyChoice:
    return PenaltyChoice(backend.selection, np.array(FRACTIONS), criterion, index)


def _log_models(weights: Array, penalty: Penalty) -> float:
    """Sum over the targets of log C(G, s)."""
    total = math.lgamma(len(penalty.weights) + 1)
    active = np.count_nonzero(penalty.block_norms(weights), axis=0).tolist()
    rest = (math.lgamma(s + 1) + math.lgamma(len(penalty.weights) - s + 1) for s in active)
    return len(active) * total - sum(rest)


def _compressed(problem: RegressionProblem) -> bool:
    return problem.sample_count is not None and problem.continuum is None


def _uncut(backend: ChoosingBackend) -> str:
    """What to do where samples cannot be cut up: a rule without pieces that the back-end takes."""
    for rule in ("ebic", "bic"):
        try:
            replace(backend, selection=rule)  # type: ignore[type-var]
        except ValueError:
            continue
        return f'use selection "{rule}"'
    return "give alpha_fraction as a number"


def _pieces(problem: RegressionProblem, count: int, backend: ChoosingBackend) -> list[IntArray]:
    needs = f"selection {backend.selection!r} needs"
    if _compressed(problem):
        raise InputError(f"{needs} samples, but they are compressed; {_uncut(backend)}")
    if problem.samples < 2 * count:
        least = f"at least {2 * count} samples, not {problem.samples}"
        raise InputError(f"{needs} {least}; {_uncut(backend)}")
    return list(np.array_split(np.arange(problem.samples), count))


def _path_on(problem: RegressionProblem, backend: ChoosingBackend, pieces: list[IntArray]) -> Array:
    """Weights (p, k, n) of the path on these pieces, NaN where there is no solution."""
    rows = np.concatenate(pieces)
    try:
        part = replace(
            problem,
            theta=problem.theta[rows],
            target=problem.target[rows],
            sample_count=None,
            sums=None,
            continuum=None if problem.continuum is None else problem.continuum.at(rows),
        )
    except InputError as error:
        raise InputError(
            f"selection {backend.selection!r}: on a part of the samples, {error}, or "
            + _uncut(backend)
        ) from None
    missing = np.full((problem.columns, problem.targets), np.nan)
    solutions = backend.solve_path(part, FRACTIONS)
    return np.stack([missing if s.weights is None else s.weights for s in solutions])
