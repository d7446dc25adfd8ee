"""The path of the square-root LASSO, from that of the LASSO and one equation in one unknown.

    minimise over V (k, n):   y rho(V) + a |V|_1,   rho = |Y - Z V|_F/sqrt(m),   y = rho(0)

Where rho > 0, its conditions are those of the LASSO with the penalty t = a rho/y (Sun and Zhang
2012, who call it the scaled LASSO). With V(t) the LASSO's solution, t/rho(V(t)) does not decrease
in t: the root of t y = a rho(V(t)) is unique. Between two events of the LASSO's path the residual
is R_0 + t D with R_0 orthogonal to D, so that rho^2 = rho_0^2 + h t^2 with h = s'G_AA^-1 s for the
signs s of the weights in use: linear in t^2, and Newton's method on t^2 ends once the events are
right. A bracket keeps it safe.

Below some penalty an optimum fits the data exactly, rho = 0, and is the limit of V(t) for t -> 0;
`NEAREST` is how near to it the path comes.

Sources: Belloni, Chernozhukov and Wang, Biometrika 98 (2011) 791-806; Sun and Zhang, Biometrika 99
(2012) 879-898.
"""

import numpy as np

from sparsefit.arrays import Array, BoolArray
from sparsefit.backends.homotopy import HomotopyPath, lasso_path
from sparsefit.backends.penalised import ExactPath, Points
from sparsefit.regression.objective import Penalty
from sparsefit.regression.statistics import Statistics

NEAREST = 1e-11  # of the largest penalty: the smallest one of the LASSO's that is asked for
SETTLED = 1e-11  # relative change of t^2 that ends the search
ROUNDS = 60


def _root_path(statistics: Statistics, penalty: Penalty, alphas: Array, targets: slice) -> Points:
    """The points at descending penalties alphas (p,), all targets together."""
    cross, gram = statistics.cross[:, targets], statistics.gram
    square = float(statistics.target_square[targets].sum())
    largest = float(np.abs(cross).max(initial=0.0))
    slope = alphas**2 / (square or 1.0)  # (a/y)^2: t^2 = slope rho^2
    high = np.minimum(alphas, largest) ** 2
    low = np.full(len(alphas), (NEAREST * largest) ** 2)
    x, steps, settled = np.maximum(high, low), 0, np.zeros(len(alphas), dtype=bool)
    for _ in range(ROUNDS):
        values, complete, taken, loop = _lasso(gram, cross, np.sqrt(x))
        steps += taken
        misfit, rate = _square(gram, cross, square, values, x)
        excess = x - slope * misfit
        high, low = np.where(excess >= 0, x, high), np.where(excess <= 0, x, low)
        settled = np.abs(excess) <= SETTLED * x
        if np.all(settled | (high <= low * (1.0 + SETTLED)) | ~complete):
            break
        bent = 1.0 - slope * rate
        newton = np.where(bent > 0, x - excess / np.where(bent > 0, bent, 1.0), 0.0)
        inside = (newton > low) & (newton < high)
        x = np.where(settled, x, np.where(inside, newton, np.sqrt(low * high)))
        x = np.minimum.accumulate(x)  # as penalties descend, so do the roots
    return Points(values, complete & settled, np.full(len(alphas), steps), loop)


def _lasso(gram: Array, cross: Array, penalties: Array) -> tuple[Array, BoolArray, int, str]:
    """The LASSO's weights (p, k, n) at descending penalties, which are complete, and the events."""
    paths: list[HomotopyPath] = [lasso_path(gram, one, penalties) for one in cross.T]
    values = np.stack([path.weights for path in paths], axis=2)
    complete: BoolArray = np.all([path.complete for path in paths], axis=0)
    return values, complete, sum(path.steps for path in paths), paths[0].loop


def _square(
    gram: Array, cross: Array, total: float, values: Array, x: Array
) -> tuple[Array, Array]:
    """rho^2 (p,) at the LASSO's weights (p, k, n) for t^2 = x, and h, its derivative there."""
    correlation = cross - gram @ values
    misfit = total - np.sum(values * (cross + correlation), axis=(1, 2))
    rate = np.zeros(len(x))
    for i, point in enumerate(values):
        for weights in point.T:
            used = np.flatnonzero(weights)
            signs = np.sign(weights[used])
            if len(used):
                inner = np.linalg.lstsq(gram[np.ix_(used, used)], signs, rcond=None)[0]
                rate[i] += float(signs @ inner)
    return np.maximum(misfit, rate * x), rate


SCALED_HOMOTOPY = ExactPath(
    "scaled-homotopy",
    _root_path,
    solved="root found, {loop} loop",
    unsolved="no root, {loop} loop",
    reason="no residual is left at a penalty as small as this, or the path is incomplete",
    quadratic=False,
)
