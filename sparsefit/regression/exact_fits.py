"""The duality gap of a square-root fit that leaves no residual, by a dual point from its signs.

Where the residual R vanishes, s R says nothing of the dual optimum of

    y |Y - Z V|_F/sqrt(m) + alpha |V|_1:   max <U, Y>/m,  |Z'U|_max/m <= alpha,  |U|_F <= sqrt(m) y.

But an optimum of weights with signs s on columns A has Z_A'U/m = alpha s there, and of all these U
that of least norm is Z_A G_AA^-1 s alpha, G = Z'Z/m. It is scaled until it obeys both constraints
on all columns: a feasible point whatever the signs are, and so a bound.

Rounding, in the notation of `certificate`: with |u_t|_1 the sum of moduli of U = Z u,

    |err Z'U/m| <= gamma |u_t|_1,   |err |U|^2/m| <= gamma sum |u_t|_1^2,   |err <U, Y>/m| <= gamma
    sum |u_t|_1 y_t,   and the norm of R over sqrt(m) is off by gamma sqrt(r) + gamma (y_t + l_t).
"""

from dataclasses import replace

import numpy as np

from sparsefit.arrays import Array, IntArray
from sparsefit.regression.certificate import Certificate, rounding_of
from sparsefit.regression.statistics import Statistics


def sharpened(
    statistics: Statistics, weights: Array, alpha: float, known: Certificate
) -> Certificate:
    """The certificate ``known`` of weights (k, n), or that of the signs where it proves more.

    known: computed from the rows; alpha: the penalty, in the unit of Z'Y/m.
    """
    columns, targets = weights.shape
    multipliers, used = _multipliers(statistics, weights)
    if not len(used):
        return known
    pulls = statistics.gram_rows(used).T @ multipliers
    norm = float(np.sum(multipliers * pulls[used]))
    product = float(np.sum(multipliers * statistics.cross[used]))
    gamma = rounding_of(statistics.terms + 2 * columns * targets + 20)
    size, level = np.abs(multipliers).sum(axis=0), np.sqrt(statistics.target_square)
    peak, total = float(np.abs(pulls).max()), float(np.sqrt(np.sum(level**2)))
    if not (product > 0.0 and norm > 0.0):
        return known
    dual = min(alpha / peak, total / np.sqrt(norm)) * product
    wider = peak * (1.0 + gamma) + gamma * float(size.max())
    longer = norm * (1.0 + gamma) + gamma * float(np.sum(size**2))
    sure = min(alpha / wider, total / np.sqrt(longer)) * (product - gamma * float(size @ level))
    null = total**2
    reach = float(np.sum(level + np.abs(weights * statistics.rms[:, None]).sum(axis=0)))
    doubt = total * gamma * (total + reach) + 4.0 * gamma * (known.primal + abs(dual))
    value = max(known.primal - dual, 0.0) / null
    most = max(known.primal - sure + doubt, 0.0) / null
    if max(value, most) >= known.bound:
        return known
    return replace(known, value=value, dual=dual, rounding=max(most - value, 0.0))


def _multipliers(statistics: Statistics, weights: Array) -> tuple[Array, IntArray]:
    """u (c, n) with G_AA u = s for each target, on the columns (c,) that any of them uses."""
    used = np.flatnonzero(weights.any(axis=1))
    gram, signs = statistics.gram_rows(used)[:, used], np.sign(weights[used])
    multipliers: Array = np.zeros(signs.shape)
    for target, column in enumerate(signs.T):
        on = np.flatnonzero(column)
        if len(on):
            solved = np.linalg.lstsq(gram[np.ix_(on, on)], column[on], rcond=None)[0]
            multipliers[on, target] = solved
    return multipliers, used
