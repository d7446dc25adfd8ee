"""The exact paths that penalised back-ends choose from, each with how it reports.

``homotopy``: penalties of single coefficients, weighted or not; a ridge adds to the diagonal of
Z'Z/m, as k more rows of Z would (Zou and Hastie 2005), and then each penalty is a path of its own.
``variational``: group norms. ``block-newton``: blocks within blocks. ``cholesky``: a ridge alone.
"""

import numpy as np

from sparsefit.arrays import Array
from sparsefit.backends.block_newton import block_path
from sparsefit.backends.homotopy import HomotopyPath, lasso_path
from sparsefit.backends.penalised import ExactPath, Points
from sparsefit.backends.variational import group_path
from sparsefit.regression.objective import Penalty
from sparsefit.regression.statistics import Statistics

FEW = 3  # groups that a single point is sought on first, and as many more each time
SHARE = 4  # of the columns, one in so many at most: beyond, all of Z'Z costs no more
FEASIBLE = 1e-12  # of alpha, by which a group without weights may pull more
STOP = 1e-11  # the solvers' own stop, far below any tolerance the certificate is asked to meet


def ridge_weights(gram: Array, cross: Array, alpha: float) -> tuple[Array, bool]:
    """V = (G + alpha I)^-1 C (k, n), and whether G + alpha I has a Cholesky factor.

    Where it has none, as alpha is lost beside G in rounding, V is the least squares of least norm.
    """
    from scipy.linalg.lapack import dposv  # who reads an estimator need not wait for it

    shifted = gram.copy()
    shifted.flat[:: len(gram) + 1] += alpha
    _, values, failed = dposv(shifted.T, cross, lower=1, overwrite_a=1)
    if failed:
        values = np.linalg.lstsq(gram, cross, rcond=None)[0]
    return values, not failed


def _homotopy(statistics: Statistics, penalty: Penalty, alphas: Array, targets: slice) -> Points:
    """The path of one target; z_j / omega_j has the weight omega_j v_j."""
    gram, cross = statistics.gram, statistics.cross[:, targets].ravel()
    omega = penalty.weights
    weighted = bool(np.any(omega != 1.0))
    if weighted:
        gram, cross = gram / np.multiply.outer(omega, omega), cross / omega
    if penalty.ridge:
        path = _ridged(gram, cross, penalty.ridge / omega**2, alphas)
    else:
        path = lasso_path(gram, cross, alphas)
    values = path.weights / omega if weighted else path.weights
    iterations = np.full(len(alphas), path.steps)  # events are not counted point by point
    return Points(values[:, :, None], path.complete, iterations, path.loop)


def _ridged(gram: Array, cross: Array, ridge: Array, alphas: Array) -> HomotopyPath:
    """Paths of one point each, on the Gram matrix with alpha times this ridge (k,)."""
    paths = []
    for alpha in alphas.tolist():
        shifted = gram.copy()
        shifted.flat[:: len(gram) + 1] += alpha * ridge
        paths.append(lasso_path(shifted, cross, np.array([alpha])))
    return HomotopyPath(
        np.concatenate([path.weights for path in paths]),
        sum(path.steps for path in paths),
        np.concatenate([path.complete for path in paths]),
        paths[0].loop,
    )


def _variational(statistics: Statistics, penalty: Penalty, alphas: Array, targets: slice) -> Points:
    """The path of targets that share the norm of each group."""
    if len(alphas) == 1 and not statistics.formed:
        point = _among_few(statistics, penalty, alphas, targets)
        if point is not None:
            return point
    path = group_path(
        statistics.gram,
        statistics.cross[:, targets],
        penalty.groups,
        penalty.weights,
        alphas,
        target_square=float(statistics.target_square[targets].sum()),
        tolerance=STOP,
    )
    return Points(path.weights, path.complete, path.iterations, path.loop)


def _among_few(
    statistics: Statistics, penalty: Penalty, alphas: Array, targets: slice
) -> Points | None:
    """One point of the path on the groups that pull hardest, where no other pulls beyond alpha.

    That is all of the optimum's conditions, from the rows of Z'Z/m of few columns. None where the
    groups become many, or the path is not complete on them.
    """
    cross, omega = statistics.cross[:, targets], penalty.weights

    def pulls(correlation: Array) -> Array:
        norms: Array = penalty.block_norms(correlation)[:, 0] / omega
        return norms

    chosen = np.sort(np.argsort(-pulls(cross), kind="stable")[:FEW])
    while True:
        columns = np.flatnonzero(np.isin(penalty.groups, chosen))
        if SHARE * len(columns) > len(cross):
            return None
        rows = statistics.gram_rows(columns)
        path = group_path(
            rows[:, columns],
            cross[columns],
            np.searchsorted(chosen, penalty.groups[columns]),
            omega[chosen],
            alphas,
            target_square=float(statistics.target_square[targets].sum()),
            tolerance=STOP,
        )
        if not path.complete[0]:
            return None
        pull = pulls(cross - rows.T @ path.weights[0])
        pull[chosen] = 0.0
        beyond = np.flatnonzero(pull > alphas[0] * (1.0 + FEASIBLE))
        if not len(beyond):
            weights = np.zeros((1, *cross.shape))
            weights[:, columns] = path.weights
            return Points(weights, path.complete, path.iterations, path.loop)
        worst = beyond[np.argsort(-pull[beyond], kind="stable")[:FEW]]
        chosen = np.sort(np.concatenate([chosen, worst]))


def _blocks(statistics: Statistics, penalty: Penalty, alphas: Array, targets: slice) -> Points:
    """The path of targets that share the norm of each group."""
    path = block_path(
        statistics.gram,
        statistics.cross[:, targets],
        penalty,
        alphas,
        target_square=float(statistics.target_square[targets].sum()),
        tolerance=STOP,
    )
    return Points(path.weights, path.complete, path.iterations, "python")


def _cholesky(statistics: Statistics, penalty: Penalty, alphas: Array, targets: slice) -> Points:
    """Each point in closed form."""
    cross = statistics.cross[:, targets]
    solved = [ridge_weights(statistics.gram, cross, alpha * penalty.ridge) for alpha in alphas]
    values, complete = zip(*solved, strict=True)
    iterations = np.ones(len(alphas), np.intp)
    return Points(np.stack(values), np.array(complete), iterations, "python")


HOMOTOPY = ExactPath(
    "homotopy",
    _homotopy,
    solved="path complete, {loop} loop",
    unsolved="path incomplete, {loop} loop",
    reason="the homotopy did not reach this penalty",
    quadratic=True,
)
VARIATIONAL = ExactPath(
    "variational",
    _variational,
    solved="converged ({loop} loop)",
    unsolved="stalled ({loop} loop)",
    reason="the Newton iteration stalled",
    quadratic=False,
)
BLOCK_NEWTON = ExactPath(
    "block-newton",
    _blocks,
    solved="converged",
    unsolved="stalled",
    reason="the descent stalled",
    quadratic=False,
)
CHOLESKY = ExactPath(
    "cholesky",
    _cholesky,
    solved="solved",
    unsolved="not positive definite",
    reason="Z'Z/m + alpha I is not positive definite to rounding",
    quadratic=True,
)
