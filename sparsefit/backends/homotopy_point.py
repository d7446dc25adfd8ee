"""Where the walk along the LASSO path stands, and how columns enter and leave: `homotopy_walk`'s.

One source for two loops, as there.
"""

import numpy as np

from sparsefit.arrays import Array, IntArray
from sparsefit.backends import active_set, dense

FINE = active_set.FINE
DEPENDENT = active_set.DEPENDENT
SINGULAR = active_set.SINGULAR


class Walk(active_set.ActiveSet):
    """Where the path stands, for G = `gram` (k, k) and c = `cross` (k,): at w = 0.

    `weights` and `slope` (k + 1,): the signed active weights and their growth per unit of alpha;
    `correlation` c - G w (k,), `descent` its decrease per unit of alpha; `open` (k,): 0 for columns
    that may not enter, the active ones and the first `waits` of `waiting`, which depend on these;
    `known` (k,): the weights at the last penalty where they are an optimum; `steps` taken.
    """

    cross: Array
    weights: Array
    slope: Array
    correlation: Array
    descent: Array
    open: Array
    known: Array
    waiting: IntArray
    rates: Array

    def __init__(self, gram: Array, cross: Array) -> None:
        super().__init__(gram)
        self.cross, self.waits, self.steps = cross, 0, 0
        self.waiting, self.rates = np.zeros(self.k + 1, np.intp), np.zeros(2 * self.k + 2)
        self.place(np.zeros((6, self.k + 1)))

    def place(self, rows: Array) -> None:
        """Give each vector its memory (k + 1,)."""
        self.weights, self.slope, self.known = rows[0], rows[1], rows[2]
        self.correlation, self.descent, self.open = rows[3], rows[4], rows[5]


def enter(walk: Walk, column: int, sign: float) -> int:
    """Let a column in with weight zero and bend the slope; a dependent one has to wait."""
    n = walk.n
    walk.open[column] = 0.0
    outcome = walk.entering(column, sign)
    if outcome == DEPENDENT:
        walk.waiting[walk.waits] = column
        walk.waits += 1
    if outcome == FINE:
        outcome = walk.enter()
    if outcome != FINE:
        return outcome
    amount = (1.0 - sign * walk.descent[column]) / walk.pivot
    walk.weights[n] = walk.slope[n] = 0.0
    dense.add(n + 1, amount, walk.step, walk.slope)
    dense.add(walk.k, amount, walk.product, walk.descent)
    return FINE


def leave(walk: Walk, position: int) -> int:
    """Take a column out at weight zero and bend the slope; those that waited may try again."""
    n, last, column = walk.n, walk.n - 1, walk.index[position]
    if walk.leaving(position) == SINGULAR:
        return SINGULAR
    amount = walk.slope[position] / walk.pivot
    dense.add(n, -amount, walk.step, walk.slope)
    dense.add(walk.k, -amount, walk.product, walk.descent)
    walk.leave(position)
    walk.weights[position], walk.slope[position] = walk.weights[last], walk.slope[last]
    walk.open[column] = 1.0
    while walk.waits > 0:
        walk.waits -= 1
        walk.open[walk.waiting[walk.waits]] = 1.0
    return FINE


def start(walk: Walk, caution: float) -> None:
    """Back to w = 0; `caution` makes more columns count as dependent."""
    walk.n = walk.age = walk.waits = 0
    walk.below = caution * active_set.DEPENDENT_BELOW
    dense.copy(walk.k, walk.cross, walk.correlation)
    dense.fill(walk.k, 0.0, walk.descent)
    dense.fill(walk.k, 1.0, walk.open)


def start_at(walk: Walk, weights: Array, caution: float) -> int:
    """At `weights` (k,), entered largest first and without those that depend on others."""
    start(walk, caution)
    k, left = walk.k, walk.rates
    dense.sizes(k, weights, walk.open, left)
    for _ in range(k):
        column = dense.highest(k, left)
        size = left[column]
        if not size > 0.0:
            break
        left[column] = 0.0
        outcome = enter(walk, column, 1.0 if weights[column] > 0.0 else -1.0)
        if outcome == FINE:
            walk.weights[walk.n - 1] = size
        elif outcome != DEPENDENT:
            return outcome
    return FINE


def full(walk: Walk, out: Array) -> None:
    """Weights (k,) in the order of the columns."""
    dense.fill(walk.k, 0.0, out)
    dense.multiply(walk.n, walk.sign, walk.weights, walk.fix)
    dense.put(walk.n, walk.fix, walk.index, out)
