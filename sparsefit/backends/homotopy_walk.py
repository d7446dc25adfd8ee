"""The walk along the LASSO path, on scaled statistics: `homotopy` is its front door.

One source for two loops: this file runs as it stands, on numpy's arrays, and is compiled, with the
types of compiled/homotopy_walk.pxd, to a loop that holds no interpreter lock.  What is done to
whole arrays is a function of `dense`, which has both forms.
"""

import numpy as np

from sparsefit.arrays import Array, BoolArray, IntArray
from sparsefit.backends import active_set, dense

OPTIMAL_WITHIN = 1e-9  # excess of a correlation over alpha, relative to alpha
ROUNDING = 1e-13  # the same, absolute, in units of the largest |c|
FLAT = 1e-16  # distance to an event below which it is at hand, relative to alpha
TINY = active_set.TINY
FRESH_SLOPE_ABOVE = 1e-11  # error of the slope that is corrected at a requested alpha
REPAIRS = 4  # from known weights, each with a larger factor on what counts as dependent:
CAUTION = 1e2  # the ratio of these factors
NEWTON_STEPS = 3  # at a requested alpha,
NEWTON_SHARE = 1e-2  # and the part of the margin they aim at
HOPELESS = 1e8  # breach, in units of the margin, of weights that are not worth returning
STEPS_PER_COLUMN = 3  # to one requested alpha, and
STEPS_AT_LEAST = 50  # these; more is taken for cycling

FINE = active_set.FINE
DEPENDENT = active_set.DEPENDENT
SINGULAR = active_set.SINGULAR
NO_MEMORY = active_set.NO_MEMORY


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


def follow(walk: Walk, alpha: float, goal: float, limit: int) -> int:
    """Walk from event to event until alpha is `goal`, or `limit` events are past."""
    for _ in range(limit):
        n, near, exit_ = walk.n, FLAT * alpha + TINY, 0.0
        # Events per unit of alpha: the largest rate comes first, and 0 means never.
        entry = dense.rates(
            walk.k, walk.correlation, walk.descent, walk.open, alpha, near, walk.rates
        )
        position = dense.soonest(n, walk.slope, walk.weights, near)
        if position >= 0:
            exit_ = -walk.slope[position] / max(walk.weights[position], near)
        soonest = max(entry, exit_)
        arrived = not soonest * (alpha - goal) > 1.0  # a NaN ends the walk too
        length = alpha - goal if arrived else 1.0 / soonest
        dense.add(n, length, walk.slope, walk.weights)
        dense.add(walk.k, -length, walk.descent, walk.correlation)
        if arrived:
            return FINE
        walk.steps += 1
        alpha -= length
        if exit_ >= entry:
            outcome = leave(walk, position)
        else:
            first = dense.position(2 * walk.k, entry, walk.rates)
            outcome = enter(walk, first % walk.k, 1.0 if first < walk.k else -1.0)
        if outcome in (SINGULAR, NO_MEMORY):
            return outcome
    return FINE


def correlate(walk: Walk, alpha: float) -> None:
    """Exact c - G w into `correlation`, the active ones less `alpha` into `error`."""
    n = walk.n
    walk.product_of(walk.weights, n, walk.correlation)
    dense.subtract(walk.k, walk.cross, walk.correlation)
    walk.gather(walk.correlation, walk.error)
    dense.shift(n, -alpha, walk.error)


def polish(walk: Walk, alpha: float) -> float:
    """Newton steps from exact correlations; the breach of optimality left, in units of the margin.

    At most 1 is optimal.
    """
    n, weights = walk.n, walk.weights
    margin, slack = OPTIMAL_WITHIN * alpha + ROUNDING, 0.0
    correlate(walk, alpha)
    for _ in range(NEWTON_STEPS):
        walk.solve(walk.error, walk.fix)
        dense.add(n, 1.0, walk.fix, weights)
        correlate(walk, alpha)
        slack = dense.largest(n, walk.error)
        if slack <= NEWTON_SHARE * margin:
            break
        if walk.rebuilt(1.0) == SINGULAR:
            return HOPELESS
    freshen(walk)
    excess = (dense.largest(walk.k, walk.correlation) - alpha) / margin
    least, most = dense.least(n, weights), dense.largest(n, weights)
    wrong = -least / (ROUNDING * most) if least < 0.0 else 0.0
    dense.clip(n, weights)  # an exit that lies within rounding of this alpha
    breach = max(slack / margin, excess, wrong)
    # A NaN compares as false.
    return breach if slack / margin + excess + wrong < HOPELESS else HOPELESS


def freshen(walk: Walk) -> None:
    """Correct the slope where the updates have worn it: H slope = 1."""
    n = walk.n
    walk.gather(walk.descent, walk.error)
    dense.shift(n, -1.0, walk.error)
    if not dense.largest(n, walk.error) < FRESH_SLOPE_ABOVE:
        walk.solve(walk.error, walk.fix)
        dense.add(n, -1.0, walk.fix, walk.slope)
        walk.product_of(walk.slope, n, walk.descent)


def settle(walk: Walk, alpha: float, limit: int) -> int:
    """Primal active set at one `alpha` from any weights: descends until no column objects."""
    enough, near = alpha * (1.0 + 0.1 * OPTIMAL_WITHIN) + 0.1 * ROUNDING, FLAT * alpha + TINY
    k, excess = walk.k, walk.rates
    for _ in range(limit):
        n, ratio = walk.n, 0.0
        correlate(walk, alpha)
        walk.solve(walk.error, walk.fix)
        position = dense.soonest(n, walk.fix, walk.weights, near)
        if position >= 0:
            ratio = -walk.fix[position] / max(walk.weights[position], near)
        if ratio > 1.0:
            dense.add(n, 1.0 / ratio, walk.fix, walk.weights)
            outcome = leave(walk, position)
        else:
            dense.add(n, 1.0, walk.fix, walk.weights)
            correlate(walk, alpha)
            dense.sizes(k, walk.correlation, walk.open, excess)
            column = dense.highest(k, excess)
            if not excess[column] > max(enough, 0.0):  # a NaN, too
                return FINE
            sign = 1.0 if walk.correlation[column] > 0.0 else -1.0
            outcome = enter(walk, column, sign)
            if outcome == DEPENDENT:
                outcome = exchange(walk, column, sign)
        walk.steps += 1
        if outcome in (SINGULAR, NO_MEMORY):
            return outcome
    return FINE


def exchange(walk: Walk, column: int, sign: float) -> int:
    """Let a dependent column in for the active one that its entering drives to zero first.

    Along a null direction of G no correlation changes and the objective falls in proportion.
    """
    n = walk.n
    if walk.entering(column, sign) == SINGULAR:
        return SINGULAR
    position = dense.soonest(n, walk.step, walk.weights, TINY)
    if position < 0:
        return FINE
    amount = max(walk.weights[position], TINY) / -walk.step[position]
    dense.add(n, amount, walk.step, walk.weights)
    outcome = leave(walk, position)
    if outcome == FINE:
        outcome = enter(walk, column, sign)
    if outcome == FINE:
        walk.weights[walk.n - 1] = amount
    return outcome


def full(walk: Walk, out: Array) -> None:
    """Weights (k,) in the order of the columns."""
    dense.fill(walk.k, 0.0, out)
    dense.multiply(walk.n, walk.sign, walk.weights, walk.fix)
    dense.put(walk.n, walk.fix, walk.index, out)


def reach(walk: Walk, alpha: float, goal: float, found: Array) -> int:
    """Follow the path to `goal`; where it breaks, settle there, at last from the `known` weights.

    `found` (k,) becomes the weights of the optimum, or of the attempt that came closest: FINE
    tells the one, SINGULAR the other.
    """
    limit, least, caution = STEPS_PER_COLUMN * walk.k + STEPS_AT_LEAST, HOPELESS, 1.0
    dense.copy(walk.k, walk.known, found)
    for attempt in range(REPAIRS + 2):
        outcome = FINE
        if attempt == 0:
            outcome = follow(walk, alpha, goal, limit)
        elif attempt > 1:
            outcome = start_at(walk, walk.known, caution)
            caution *= CAUTION
        if attempt > 0 and outcome == FINE:
            outcome = settle(walk, goal, limit)
        if outcome == NO_MEMORY:
            return NO_MEMORY
        breach = polish(walk, goal) if outcome == FINE else HOPELESS
        if breach < least:
            least = breach
            full(walk, found)
        if breach <= 1.0:
            return FINE
    return SINGULAR


def visit(walk: Walk, alphas: Array, weights: Array, complete: BoolArray) -> int:
    """Every penalty in turn: weights (p, k), complete (p,), both zero before."""
    highest = alpha = dense.largest(walk.k, walk.cross)
    start(walk, 1.0)
    for point in range(len(alphas)):
        goal = alphas[point]
        if goal >= highest:
            complete[point] = True
            continue
        outcome = reach(walk, alpha, goal, weights[point])
        if outcome == NO_MEMORY:
            return NO_MEMORY
        if outcome == FINE:
            complete[point] = True
            dense.copy(walk.k, weights[point], walk.known)
        alpha = goal
    return FINE


def path(gram: Array, cross: Array, alphas: Array, weights: Array, complete: BoolArray) -> int:
    """Fill weights (p, k) and complete (p,), given as zeros; returns the steps taken.

    Raises ValueError if the arrays do not fit each other, MemoryError.
    """
    k, points = len(cross), len(alphas)
    square = gram.shape[0] == gram.shape[1] == weights.shape[1] == k
    if not square or weights.shape[0] != points or len(complete) != points:
        raise ValueError(
            "path wants gram (k, k), cross (k,), alphas (p,), weights (p, k) and complete (p,)"
        )
    walk, held = Walk(gram, cross), dense.unlock()
    outcome = visit(walk, alphas, weights, complete)
    dense.lock(held)
    if outcome == NO_MEMORY:
        raise MemoryError
    return walk.steps
