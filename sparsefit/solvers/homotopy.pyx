"""Exact LASSO path in Gram space by homotopy (LARS with the LASSO modification), compiled.

    minimise over w (k,):   1/2 w'G w - c'w + alpha |w|_1

Between two events the solution is linear in alpha: with active columns A, signs s and
H = S G_AA S, the signed weights grow by H^-1 1 for each unit alpha loses. An event is a column
whose correlation |c - G w| reaches alpha (it enters) or an active weight that reaches zero (it
leaves). Each requested alpha is polished by a Newton step on the exact Gram rows and checked
against the optimality conditions; what fails is settled at that alpha by a primal active-set
method, in which a column that depends on active ones is exchanged for one of them; what fails
that too is reported as incomplete, with the weights that came closest.

What an active column owns is stored times its sign: active correlations are +alpha and active
weights positive. M = H^-1 is kept by bordering (enter) and by elimination (leave): M +- x x'/pivot.
The product G x, which the path needs anyway, shows how far x is from exact, so one step of iterative
refinement happens only where digits are missing; M is rebuilt when they are many.

Sources: Osborne, Presnell and Turlach, IMA J. Numer. Anal. 20 (2000) 389-403; Efron, Hastie,
Johnstone and Tibshirani, Ann. Statist. 32 (2004) 407-499; for the repair, Lee, Battle, Raina
and Ng, NIPS 19 (2006) 801-808; Golub and Van Loan, Matrix Computations (2013), section 2.1.4.
"""

import numpy as np

from libc.math cimport fabs

from sparsefit.solvers cimport dense

cdef enum:
    FINE = 0
    DEPENDENT = 1  # the column lies in the span of the active ones
    SINGULAR = 2  # M no longer describes the active block: start again from fewer columns
    NO_MEMORY = 3
    EARLY = 4  # a rebuilt inverse would gain nothing yet
    ROOM = 64  # active columns that there is room for at first
    STALE_AGE = 10  # updates between rebuilds: on a nearly singular block they gain little
    REPAIRS = 4  # from known weights, each with a larger factor on what counts as dependent
    NEWTON_STEPS = 3  # at a requested alpha
    STEPS_PER_COLUMN = 3  # to one requested alpha, and
    STEPS_AT_LEAST = 50  # these; more is taken for cycling

cdef:
    double REFINE_ABOVE = 1e-11  # error of a direction on the active rows that is worth refining
    double STALE_ABOVE = 1e-8  # error at which M is rebuilt, STALE_AGE permitting
    double WRONG_ABOVE = 1e-3  # error at which M is rebuilt at once
    double DEPENDENT_BELOW = 1e-13  # pivot, per unit of x'x: what rounding in G alone can produce
    double TINY = 1e-300  # what divisors and pivots are at least
    double OPTIMAL_WITHIN = 1e-9  # excess of a correlation over alpha, relative to alpha
    double ROUNDING = 1e-13  # the same, absolute, in units of the largest |c|
    double FLAT = 1e-16  # distance to an event below which it is at hand, relative to alpha
    double FRESH_SLOPE_ABOVE = 1e-11  # error of the slope that is corrected at a requested alpha
    double CAUTION = 1e2  # the ratio of the factors of `REPAIRS`
    double NEWTON_SHARE = 1e-2  # part of the margin that Newton steps aim at
    double HOPELESS = 1e8  # breach, in units of the margin, of weights not worth returning


cdef class Homotopy:
    """Where the path stands, for G (k, k), its largest diagonal about one, and c (k,): at w = 0.

    index and sign (k + 1,): the n active columns, in no particular order, and their signs;
    inverse: M in its leading n x n block, `age` updates old; weights and slope (k + 1,): the signed
    active weights and their growth per unit of alpha; correlation c - G w (k,) and descent, its
    decrease; open (k,): 0 for columns that may not enter, active ones and the first `waits` of
    waiting, which depend on these; known (k,): the weights at the last penalty where they are an
    optimum; step x and product G x: the last direction, pivot that of its update.
    """

    cdef Py_ssize_t k, n, age, waits
    cdef public Py_ssize_t steps
    cdef double below, pivot, alpha, highest
    cdef const double[:, ::1] gram
    cdef const double[::1] cross
    cdef double[:, ::1] inverse
    cdef Py_ssize_t[::1] index, waiting
    cdef double[::1] sign, step, product, error, fix, spare, change
    cdef double[::1] weights, slope, correlation, descent, open, known, rates

    def __init__(self, gram, cross):
        room = min(ROOM, len(cross))
        self.inverse, self.index = np.zeros((room, room)), np.zeros(len(cross) + 1, np.intp)
        self._place(gram, cross)
        start(self, 1.0)
        self.alpha = self.highest = dense.largest(self.k, self.cross)

    def _place(self, gram, cross):
        """Give each vector its memory for G (k, k) and c (k,)."""
        self.gram, self.cross, self.k = gram, cross, len(cross)
        if self.gram.shape[0] != self.k or self.gram.shape[1] != self.k:
            raise ValueError("a homotopy wants gram (k, k) and cross (k,)")
        cdef double[:, ::1] rows = np.zeros((13, self.k + 1))
        self.sign, self.step, self.product, self.change = rows[0], rows[1], rows[2], rows[3]
        self.error, self.fix, self.spare, self.weights = rows[4], rows[5], rows[6], rows[7]
        self.slope, self.known, self.correlation = rows[8], rows[9], rows[10]
        self.descent, self.open = rows[11], rows[12]
        self.waiting, self.rates = np.zeros(self.k + 1, np.intp), np.zeros(2 * self.k + 2)

    def state(self):
        """All that `resume` needs to go on from here, as arrays of their own."""
        n = self.n
        inverse, waiting = np.asarray(self.inverse)[:n, :n], np.asarray(self.waiting)[: self.waits]
        active = [np.array(np.asarray(part)[:n]) for part in self._active()]
        numbers = (self.alpha, self.age, self.below)
        return numbers, inverse.copy(), active, waiting.copy(), np.array(np.asarray(self.known))

    def _active(self):
        index, sign = np.asarray(self.index), np.asarray(self.sign)
        return [index, sign, np.asarray(self.weights), np.asarray(self.slope)]

    def resume(self, state, gram, cross):
        """Go on from a state on G (k, k) and c (k,), whose leading columns are those of then."""
        numbers, inverse, active, waiting, known = state
        steps, highest, n = self.steps, self.highest, len(inverse)
        self.index = np.zeros(len(cross) + 1, np.intp)
        self._place(gram, cross)
        start(self, 1.0)
        room = min(max(2 * n, ROOM), self.k)
        self.inverse, self.n = np.zeros((room, room)), n
        np.asarray(self.inverse)[:n, :n] = inverse
        for part, values in zip(self._active(), active, strict=True):
            part[:n] = values
        np.asarray(self.waiting)[: len(waiting)] = waiting
        np.asarray(self.known)[: len(known)] = known
        np.asarray(self.open)[active[0]] = 0.0
        np.asarray(self.open)[waiting] = 0.0
        self.alpha, self.age, self.below = numbers
        self.waits, self.steps, self.highest = len(waiting), steps, highest
        correlate(self, self.alpha)
        product_of(self, self.slope, n, self.descent)

    def advance(self, const double[::1] alphas, double[:, ::1] weights, unsigned char[::1] complete):
        """Fill weights (p, k) and complete (p,), given as zeros, at descending penalties.

        Raises ValueError if the arrays do not fit each other, MemoryError.
        """
        points = len(alphas)
        if weights.shape[0] != points or weights.shape[1] != self.k or len(complete) != points:
            raise ValueError("a homotopy fills weights (p, k) and complete (p,) at alphas (p,)")
        cdef dense.PyThreadState *held = dense.unlock()
        cdef int outcome = visit(self, alphas, weights, complete)
        dense.lock(held)
        if outcome == NO_MEMORY:
            raise MemoryError


cdef void product_of(Homotopy h, const double[::1] x, Py_ssize_t n, double[::1] out) noexcept nogil:
    """G x (k,) of the first n signed active weights x."""
    dense.combine(n, h.gram, h.index, h.sign, x, out)


cdef bint grown(Homotopy h) noexcept with gil:
    """Make room for one more active column; false where memory is out."""
    n, room = h.n, min(2 * len(h.inverse), h.k)
    if n < len(h.inverse):
        return True
    try:
        fresh = np.zeros((room, room))
    except MemoryError:
        return False
    fresh[:n, :n] = np.asarray(h.inverse)[:n, :n]
    h.inverse = fresh
    return True


cdef int rebuilt(Homotopy h, double error) noexcept nogil:
    """Replace M by a fresh inverse, unless it is too EARLY, at this error, to gain anything.

    Gauss-Jordan steps, largest diagonal first: rows and columns that were swept hold -inverse.
    """
    cdef Py_ssize_t n = h.n, p
    cdef double pivot
    if h.age < 1 or (h.age < STALE_AGE and error < WRONG_ABOVE):
        return EARLY
    dense.block(n, h.gram, h.index, h.sign, h.inverse)
    dense.fill(n, 1.0, h.spare)
    for _ in range(n):
        p = dense.highest_diagonal(n, h.inverse, h.spare)
        pivot = h.inverse[p, p]
        if not TINY < pivot < 1.0 / TINY:
            return SINGULAR
        dense.copy(n, h.inverse[p], h.fix)
        dense.rank_one(n, -1.0 / pivot, h.fix, h.inverse)
        dense.scale(n, 1.0 / pivot, h.fix)
        dense.border(n, p, h.fix, h.inverse)
        h.inverse[p, p] = -1.0 / pivot
        h.spare[p] = 0.0
    dense.negate(n, h.inverse)
    h.age = 0
    return FINE


cdef int corrected(Homotopy h, Py_ssize_t count, Py_ssize_t position, double scale) noexcept nogil:
    """G x of the x in `step`, both refined where M is worn; FINE: M is fresh, find x again.

    x has `count` entries and should have a unit active correlation at `position`, if >= 0.
    """
    cdef Py_ssize_t n = h.n
    cdef double worst
    cdef int outcome
    product_of(h, h.step, count, h.product)
    dense.gather(n, h.product, h.index, h.sign, h.error)
    if position >= 0:
        h.error[position] -= 1.0
    worst = dense.largest(n, h.error) / scale
    if not worst < STALE_ABOVE:
        outcome = rebuilt(h, worst)
        if outcome != EARLY:
            return outcome
    if worst > REFINE_ABOVE:
        dense.apply(n, h.inverse, h.error, h.fix)
        dense.add(n, -1.0, h.fix, h.step)
        product_of(h, h.fix, n, h.change)
        dense.add(h.k, -1.0, h.change, h.product)
    return EARLY


cdef int entering(Homotopy h, Py_ssize_t column, double sign) noexcept nogil:
    """One unit of a new column, the others reacting so that their correlations stay."""
    cdef Py_ssize_t n = h.n
    cdef int outcome = FINE
    if n == h.k:
        return SINGULAR
    h.index[n] = column
    h.sign[n] = sign
    while outcome == FINE:
        dense.gather(n, h.gram[column], h.index, h.sign, h.error)
        dense.apply(n, h.inverse, h.error, h.step)
        dense.scale(n, -sign, h.step)
        h.step[n] = 1.0
        outcome = corrected(h, n + 1, -1, 1.0)
    h.pivot = sign * h.product[column]
    if outcome == SINGULAR or not h.pivot <= 2.0 * h.gram[column, column] + DEPENDENT_BELOW:
        return SINGULAR
    return DEPENDENT if h.pivot <= h.below * dense.square(n + 1, h.step) else FINE


cdef int enter(Homotopy h, Py_ssize_t column, double sign) noexcept nogil:
    """Let a column in with weight zero and bend the slope; a dependent one has to wait."""
    cdef Py_ssize_t n = h.n
    cdef double amount
    h.open[column] = 0.0
    cdef int outcome = entering(h, column, sign)
    if outcome == DEPENDENT:
        h.waiting[h.waits] = column
        h.waits += 1
    if outcome != FINE:
        return outcome
    if n == h.inverse.shape[0] and not grown(h):
        return NO_MEMORY
    dense.fill(n + 1, 0.0, h.spare)
    dense.border(n + 1, n, h.spare, h.inverse)
    dense.rank_one(n + 1, 1.0 / h.pivot, h.step, h.inverse)
    h.n += 1
    h.age += 1
    amount = (1.0 - sign * h.descent[column]) / h.pivot
    h.weights[n] = h.slope[n] = 0.0
    dense.add(n + 1, amount, h.step, h.slope)
    dense.add(h.k, amount, h.product, h.descent)
    return FINE


cdef int leave(Homotopy h, Py_ssize_t position) noexcept nogil:
    """Take a column out at weight zero and bend the slope; those that waited may try again."""
    cdef Py_ssize_t n = h.n, last = h.n - 1, column = h.index[position]
    cdef int outcome = FINE
    cdef double amount
    while outcome == FINE:  # one active correlation changes by one, the others held: a column of M
        dense.copy(n, h.inverse[position], h.step)
        outcome = corrected(h, n, position, fabs(h.step[position]))
    h.pivot = h.step[position]
    if outcome == SINGULAR or not h.pivot > 0.1:
        return SINGULAR
    amount = h.slope[position] / h.pivot
    dense.add(n, -amount, h.step, h.slope)
    dense.add(h.k, -amount, h.product, h.descent)
    dense.rank_one(n, -1.0 / h.pivot, h.step, h.inverse)
    h.index[position] = h.index[last]
    h.sign[position] = h.sign[last]
    dense.copy(n, h.inverse[last], h.spare)
    h.spare[position] = h.spare[last]
    dense.border(n, position, h.spare, h.inverse)
    h.n = last
    h.age += 1
    h.weights[position] = h.weights[last]
    h.slope[position] = h.slope[last]
    h.open[column] = 1.0
    while h.waits > 0:
        h.waits -= 1
        h.open[h.waiting[h.waits]] = 1.0
    return FINE


cdef void start(Homotopy h, double caution) noexcept nogil:
    """Back to w = 0; `caution` makes more columns count as dependent."""
    h.n = h.age = h.waits = 0
    h.below = caution * DEPENDENT_BELOW
    dense.copy(h.k, h.cross, h.correlation)
    dense.fill(h.k, 0.0, h.descent)
    dense.fill(h.k, 1.0, h.open)


cdef int start_at(Homotopy h, const double[::1] weights, double caution) noexcept nogil:
    """At `weights` (k,), entered largest first and without those that depend on others."""
    cdef Py_ssize_t column
    cdef double size
    cdef int outcome
    start(h, caution)
    dense.sizes(h.k, weights, h.open, h.rates)
    for _ in range(h.k):
        column = dense.highest(h.k, h.rates)
        size = h.rates[column]
        if not size > 0.0:
            break
        h.rates[column] = 0.0
        outcome = enter(h, column, 1.0 if weights[column] > 0.0 else -1.0)
        if outcome == FINE:
            h.weights[h.n - 1] = size
        elif outcome != DEPENDENT:
            return outcome
    return FINE


cdef int follow(Homotopy h, double alpha, double goal, Py_ssize_t limit) noexcept nogil:
    """Walk from event to event until alpha is `goal`, or `limit` events are past."""
    cdef double near, exit_, entry, soonest, length
    cdef Py_ssize_t n, position, first
    cdef bint arrived
    cdef int outcome
    for _ in range(limit):
        n, near, exit_ = h.n, FLAT * alpha + TINY, 0.0
        # Events per unit of alpha: the largest rate comes first, and 0 means never.
        entry = dense.rates(h.k, h.correlation, h.descent, h.open, alpha, near, h.rates)
        position = dense.soonest(n, h.slope, h.weights, near)
        if position >= 0:
            exit_ = -h.slope[position] / max(h.weights[position], near)
        soonest = max(entry, exit_)
        arrived = not soonest * (alpha - goal) > 1.0  # a NaN ends the walk too
        length = alpha - goal if arrived else 1.0 / soonest
        dense.add(n, length, h.slope, h.weights)
        dense.add(h.k, -length, h.descent, h.correlation)
        if arrived:
            return FINE
        h.steps += 1
        alpha -= length
        if exit_ >= entry:
            outcome = leave(h, position)
        else:
            first = dense.position(2 * h.k, entry, h.rates)
            outcome = enter(h, first % h.k, 1.0 if first < h.k else -1.0)
        if outcome == SINGULAR or outcome == NO_MEMORY:
            return outcome
    return FINE


cdef void correlate(Homotopy h, double alpha) noexcept nogil:
    """Exact c - G w into `correlation`, the active ones less `alpha` into `error`."""
    product_of(h, h.weights, h.n, h.correlation)
    dense.subtract(h.k, h.cross, h.correlation)
    dense.gather(h.n, h.correlation, h.index, h.sign, h.error)
    dense.shift(h.n, -alpha, h.error)


cdef double polish(Homotopy h, double alpha) noexcept nogil:
    """Newton steps from exact correlations; the breach of optimality left, in units of the margin.

    At most 1 is optimal.
    """
    cdef Py_ssize_t n = h.n
    cdef double margin = OPTIMAL_WITHIN * alpha + ROUNDING, slack = 0.0, excess, lowest, wrong
    correlate(h, alpha)
    for _ in range(NEWTON_STEPS):
        dense.apply(n, h.inverse, h.error, h.fix)
        dense.add(n, 1.0, h.fix, h.weights)
        correlate(h, alpha)
        slack = dense.largest(n, h.error)
        if slack <= NEWTON_SHARE * margin:
            break
        if rebuilt(h, 1.0) == SINGULAR:
            return HOPELESS
    dense.gather(n, h.descent, h.index, h.sign, h.error)  # H slope = 1, where updates have worn it
    dense.shift(n, -1.0, h.error)
    if not dense.largest(n, h.error) < FRESH_SLOPE_ABOVE:
        dense.apply(n, h.inverse, h.error, h.fix)
        dense.add(n, -1.0, h.fix, h.slope)
        product_of(h, h.slope, n, h.descent)
    excess = (dense.largest(h.k, h.correlation) - alpha) / margin
    lowest, wrong = dense.least(n, h.weights), 0.0
    if lowest < 0.0:
        wrong = -lowest / (ROUNDING * dense.largest(n, h.weights))
    dense.clip(n, h.weights)  # an exit that lies within rounding of this alpha
    # A NaN compares as false.
    if not slack / margin + excess + wrong < HOPELESS:
        return HOPELESS
    return max(slack / margin, excess, wrong)


cdef int exchange(Homotopy h, Py_ssize_t column, double sign) noexcept nogil:
    """Let a dependent column in for the active one that its entering drives to zero first.

    Along a null direction of G no correlation changes and the objective falls in proportion.
    """
    cdef Py_ssize_t n = h.n, position
    cdef double amount
    cdef int outcome
    if entering(h, column, sign) == SINGULAR:
        return SINGULAR
    position = dense.soonest(n, h.step, h.weights, TINY)
    if position < 0:
        return FINE
    amount = max(h.weights[position], TINY) / -h.step[position]
    dense.add(n, amount, h.step, h.weights)
    outcome = leave(h, position)
    if outcome == FINE:
        outcome = enter(h, column, sign)
    if outcome == FINE:
        h.weights[h.n - 1] = amount
    return outcome


cdef int settle(Homotopy h, double alpha, Py_ssize_t limit) noexcept nogil:
    """Primal active set at one `alpha` from any weights: descends until no column objects."""
    cdef double enough = alpha * (1.0 + 0.1 * OPTIMAL_WITHIN) + 0.1 * ROUNDING
    cdef double near = FLAT * alpha + TINY, ratio, sign
    cdef Py_ssize_t n, position, column
    cdef int outcome
    for _ in range(limit):
        n, ratio = h.n, 0.0
        correlate(h, alpha)
        dense.apply(n, h.inverse, h.error, h.fix)
        position = dense.soonest(n, h.fix, h.weights, near)
        if position >= 0:
            ratio = -h.fix[position] / max(h.weights[position], near)
        if ratio > 1.0:
            dense.add(n, 1.0 / ratio, h.fix, h.weights)
            outcome = leave(h, position)
        else:
            dense.add(n, 1.0, h.fix, h.weights)
            correlate(h, alpha)
            dense.sizes(h.k, h.correlation, h.open, h.rates)
            column = dense.highest(h.k, h.rates)
            if not h.rates[column] > max(enough, 0.0):  # a NaN, too
                return FINE
            sign = 1.0 if h.correlation[column] > 0.0 else -1.0
            outcome = enter(h, column, sign)
            if outcome == DEPENDENT:
                outcome = exchange(h, column, sign)
        h.steps += 1
        if outcome == SINGULAR or outcome == NO_MEMORY:
            return outcome
    return FINE


cdef int reach(Homotopy h, double goal, double[::1] out) noexcept nogil:
    """Follow the path to `goal`; where it breaks, settle there, at last from the `known` weights.

    out (k,) becomes the weights of the optimum, or of the attempt that came closest: FINE tells
    the one, SINGULAR the other.
    """
    cdef Py_ssize_t limit = STEPS_PER_COLUMN * h.k + STEPS_AT_LEAST
    cdef double least = HOPELESS, caution = 1.0, breach
    cdef int outcome, attempt
    dense.copy(h.k, h.known, out)
    for attempt in range(REPAIRS + 2):
        outcome = FINE
        if attempt == 0:
            outcome = follow(h, h.alpha, goal, limit)
        elif attempt > 1:
            outcome = start_at(h, h.known, caution)
            caution *= CAUTION
        if attempt > 0 and outcome == FINE:
            outcome = settle(h, goal, limit)
        if outcome == NO_MEMORY:
            return NO_MEMORY
        breach = polish(h, goal) if outcome == FINE else HOPELESS
        if breach < least:
            least = breach
            dense.fill(h.k, 0.0, out)
            dense.multiply(h.n, h.sign, h.weights, h.fix)
            dense.put(h.n, h.fix, h.index, out)
        if breach <= 1.0:
            return FINE
    return SINGULAR


cdef int visit(
    Homotopy h, const double[::1] alphas, double[:, ::1] weights, unsigned char[::1] complete
) noexcept nogil:
    """Every penalty in turn."""
    cdef int outcome
    for point in range(alphas.shape[0]):
        if alphas[point] >= h.highest:
            complete[point] = True
            continue
        outcome = reach(h, alphas[point], weights[point])
        if outcome == NO_MEMORY:
            return NO_MEMORY
        if outcome == FINE:
            complete[point] = True
            dense.copy(h.k, weights[point], h.known)
        h.alpha = alphas[point]
    return FINE
