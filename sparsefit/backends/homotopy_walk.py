"""The walk along the LASSO path, on scaled statistics: `homotopy` is its front door.

One source for two loops: this file runs as it stands, on numpy's arrays, and is compiled, with the
types of compiled/homotopy_walk.pxd, to a loop that holds no interpreter lock.  What is done to
whole arrays is a function of `dense`, which has both forms.
"""

from sparsefit.arrays import Array, BoolArray
from sparsefit.backends import active_set, dense, homotopy_point

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


def follow(walk: homotopy_point.Walk, alpha: float, goal: float, limit: int) -> int:
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
            outcome = homotopy_point.leave(walk, position)
        else:
            first = dense.position(2 * walk.k, entry, walk.rates)
            outcome = homotopy_point.enter(walk, first % walk.k, 1.0 if first < walk.k else -1.0)
        if outcome in (SINGULAR, NO_MEMORY):
            return outcome
    return FINE


def correlate(walk: homotopy_point.Walk, alpha: float) -> None:
    """Exact c - G w into `correlation`, the active ones less `alpha` into `error`."""
    n = walk.n
    walk.product_of(walk.weights, n, walk.correlation)
    dense.subtract(walk.k, walk.cross, walk.correlation)
    walk.gather(walk.correlation, walk.error)
    dense.shift(n, -alpha, walk.error)


def polish(walk: homotopy_point.Walk, alpha: float) -> float:
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


def freshen(walk: homotopy_point.Walk) -> None:
    """Correct the slope where the updates have worn it: H slope = 1."""
    n = walk.n
    walk.gather(walk.descent, walk.error)
    dense.shift(n, -1.0, walk.error)
    if not dense.largest(n, walk.error) < FRESH_SLOPE_ABOVE:
        walk.solve(walk.error, walk.fix)
        dense.add(n, -1.0, walk.fix, walk.slope)
        walk.product_of(walk.slope, n, walk.descent)


def settle(walk: homotopy_point.Walk, alpha: float, limit: int) -> int:
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
            outcome = homotopy_point.leave(walk, position)
        else:
            dense.add(n, 1.0, walk.fix, walk.weights)
            correlate(walk, alpha)
            dense.sizes(k, walk.correlation, walk.open, excess)
            column = dense.highest(k, excess)
            if not excess[column] > max(enough, 0.0):  # a NaN, too
                return FINE
            sign = 1.0 if walk.correlation[column] > 0.0 else -1.0
            outcome = homotopy_point.enter(walk, column, sign)
            if outcome == DEPENDENT:
                outcome = exchange(walk, column, sign)
        walk.steps += 1
        if outcome in (SINGULAR, NO_MEMORY):
            return outcome
    return FINE


def exchange(walk: homotopy_point.Walk, column: int, sign: float) -> int:
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
    outcome = homotopy_point.leave(walk, position)
    if outcome == FINE:
        outcome = homotopy_point.enter(walk, column, sign)
    if outcome == FINE:
        walk.weights[walk.n - 1] = amount
    return outcome


def reach(walk: homotopy_point.Walk, alpha: float, goal: float, found: Array) -> int:
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
            outcome = homotopy_point.start_at(walk, walk.known, caution)
            caution *= CAUTION
        if attempt > 0 and outcome == FINE:
            outcome = settle(walk, goal, limit)
        if outcome == NO_MEMORY:
            return NO_MEMORY
        breach = polish(walk, goal) if outcome == FINE else HOPELESS
        if breach < least:
            least = breach
            homotopy_point.full(walk, found)
        if breach <= 1.0:
            return FINE
    return SINGULAR


def visit(walk: homotopy_point.Walk, alphas: Array, weights: Array, complete: BoolArray) -> int:
    """Every penalty in turn: weights (p, k), complete (p,), both zero before; the steps taken.

    Negative where memory is out.
    """
    highest = alpha = dense.largest(walk.k, walk.cross)
    homotopy_point.start(walk, 1.0)
    for point in range(len(alphas)):
        goal = alphas[point]
        if goal >= highest:
            complete[point] = True
            continue
        outcome = reach(walk, alpha, goal, weights[point])
        if outcome == NO_MEMORY:
            return -1
        if outcome == FINE:
            complete[point] = True
            dense.copy(walk.k, weights[point], walk.known)
        alpha = goal
    return walk.steps


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
    walk, held = homotopy_point.Walk(gram, cross), dense.unlock()
    steps = visit(walk, alphas, weights, complete)
    dense.lock(held)
    if steps < 0:
        raise MemoryError
    return steps
