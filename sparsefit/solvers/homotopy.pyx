"""Exact path of the LASSO and the elastic net in Gram space, from event to event, compiled.

    minimise over w (k,):   1/2 w'G w - c'w + alpha (|w|_1 + 1/2 sum_j rho_j w_j^2)

With active columns A, signs s and the diagonal mu = alpha rho at the penalty that is walked to,
H = S (G_AA + mu) S, an optimum at one alpha is the end of a walk in t from 0 to 1,

    S (c - G w + (1 - t) delta)_A - mu w_A = alpha(t),    |c - G w + (1 - t) delta| <= alpha(t)

outside A, with alpha(t) linear. The drift delta is what the weights at t = 0 lack of an optimum of
(alpha(0), mu): zero but for rounding along the LASSO's path; of the elastic net it holds the change
of mu since the last penalty; and at weights from anywhere it makes the walk a repair. The signed
weights, all positive, grow by H^-1 (alpha(0) - alpha(1) - s delta_A) for each unit of t, until an
event: a column whose correlation reaches alpha enters, an active weight that reaches zero leaves.

M = H^-1 is updated by M +- x x'/pivot at each event. The product G x, which the path needs anyway,
shows the error of x: x is refined where it is above rounding, and where it is large M is computed
again by pivoted Cholesky. A column that depends linearly on active ones waits until one of these
leaves. At each requested alpha the optimality conditions are checked with exact correlations.

Sources: Osborne, Presnell and Turlach, IMA J. Numer. Anal. 20 (2000) 389-403; Efron, Hastie,
Johnstone and Tibshirani, Ann. Statist. 32 (2004) 407-499; Asif and Romberg, IEEE Trans. Signal
Process. 62 (2014) 4209-4223, from warm starts; Golub and Van Loan (2013), section 2.1.4.
"""

import numpy as np

from libc.math cimport INFINITY, fabs
from libc.string cimport memcpy
from scipy.linalg.cython_blas cimport daxpy, ddot, dgemv, dger
from scipy.linalg.cython_lapack cimport dpotri, dpstrf

cdef enum:
    FINE = 0
    DEPENDENT = 1  # the column lies in the span of the active ones
    WORN = 2  # M is no longer accurate enough: compute it again
    OPEN = 0  # a column outside, that may enter; others are WAITING,
    WAITING = 1  # as they depend on active ones, or
    ACTIVE = 2
    STALE_AGE = 10  # updates of M before it is computed again
    ATTEMPTS = 8  # at one alpha, those after the third with a larger factor on what is dependent
    FRESH_STARTS = 60  # at one alpha, with M computed again
    STEPS_PER_COLUMN = 3  # to one requested alpha, and
    STEPS_AT_LEAST = 50  # these; more is taken for cycling

cdef:
    double REFINE_ABOVE = 1e-11  # error of a direction on the active rows that is worth refining
    double STALE_ABOVE = 1e-8  # error at which M is computed again after STALE_AGE updates
    double WRONG_ABOVE = 1e-3  # error at which M is computed again at once
    double DEPENDENT_BELOW = 1e-13  # pivot, per unit of x'x: what rounding in G alone can produce
    double CAUTION = 1e2  # by which it grows where attempts fail
    double TINY = 1e-300  # what divisors are at least
    double OPTIMAL_WITHIN = 1e-9  # excess of a correlation over alpha, relative to alpha
    double ROUNDING = 1e-13  # the same, absolute, in units of the largest |c|
    double SHARE = 1e-4  # part of that margin above which another walk, of rounding alone, pays
    double FLAT = 1e-16  # distance to an event below which it is at hand, relative to alpha


cdef class Homotopy:
    """The state of a path of G (k, k), its largest diagonal about one, c (k,) and rho (k,).

    index, sign (n,): the active columns, in no particular order; rows (n, k): those of G, times the
    sign; inverse: M in its leading n x n block, `age` updates old; weights and slope (n,): signed
    weights and their growth by t; mu (n,); correlation c - G w + (1 - t) delta (k,) and descent,
    its decrease by t; standing (k,): OPEN, WAITING or ACTIVE; known (k,): the weights of the last
    optimum; step x and product G x: the last direction. Of a G whose rows are formed as they are
    needed, ready (k,) marks those that are, and fill(column, correlation) forms that of a column.
    """

    cdef Py_ssize_t k, n, age
    cdef public Py_ssize_t steps
    cdef double below, alpha
    cdef bint ridged
    cdef const double[:, ::1] gram
    cdef const unsigned char[::1] ready
    cdef object fill
    cdef const double[::1] cross, ridge
    cdef double[:, ::1] rows, inverse
    cdef int[::1] pivots
    cdef Py_ssize_t[::1] index, standing
    cdef double[::1] sign, weights, slope, mu, step, error, fix, work
    cdef double[::1] correlation, descent, drift, product, known

    def __init__(self, gram, cross, ridge, ready=None, fill=None):
        self.gram, self.cross, self.ridge, self.k = gram, cross, ridge, len(cross)
        k = self.k
        self.ready, self.fill = np.ones(k, np.uint8) if ready is None else ready, fill
        if self.gram.shape[0] != k or self.gram.shape[1] != k or len(self.ridge) != k:
            raise ValueError("a homotopy wants gram (k, k), cross (k,) and ridge (k,)")
        self.rows, self.inverse = np.empty((k, k)), np.empty((k, k))  # what none touches is free
        self.index, self.standing = np.zeros(k, np.intp), np.zeros(k, np.intp)
        self.pivots, self.work = np.zeros(k, np.intc), np.zeros(2 * k)
        cdef double[:, ::1] vectors = np.zeros((12, k))
        self.sign, self.weights, self.slope, self.mu = vectors[0], vectors[1], vectors[2], vectors[3]
        self.step, self.error, self.fix, self.known = vectors[4], vectors[5], vectors[6], vectors[7]
        self.correlation, self.descent, self.drift = vectors[8], vectors[9], vectors[10]
        self.product, self.below = vectors[11], DEPENDENT_BELOW
        self.ridged = bool(np.any(ridge))
        self.start(np.zeros(k), 0.0)

    def start(self, const double[::1] weights, double alpha):
        """Begin at the weights (k,) of the optimum at alpha; at alpha_max where they are zero."""
        for j in range(self.k):
            self.known[j] = weights[j]
        return_to_known(self, alpha)
        if not self.n:
            self.alpha = float(np.abs(self.cross).max())

    def advance(self, const double[::1] alphas, double[:, ::1] weights, unsigned char[::1] complete):
        """Fill weights (p, k) and complete (p,), given as zeros, at descending penalties.

        Raises ValueError if the arrays do not fit each other.
        """
        points = len(alphas)
        if weights.shape[0] != points or weights.shape[1] != self.k or len(complete) != points:
            raise ValueError("a homotopy fills weights (p, k) and complete (p,) at alphas (p,)")
        for point in range(points):
            complete[point] = True
            if self.n or alphas[point] < self.alpha:
                complete[point] = reach(self, alphas[point], weights[point]) == FINE
                if complete[point]:
                    memcpy(&self.known[0], &weights[point, 0], self.k * sizeof(double))


cdef void combine(
    double[:, ::1] rows, Py_ssize_t k, Py_ssize_t n, const double[::1] x, double[::1] out
) noexcept:
    """The sum out (k,) of n rows times x (n,): G x of signed active weights, or M x."""
    cdef int width = k, count = n, stride = rows.shape[1], one = 1
    cdef double unit = 1.0, zero = 0.0
    if n:
        dgemv(
            "N", &width, &count, &unit, &rows[0, 0], &stride, <double *>&x[0], &one, &zero,
            &out[0], &one,
        )


cdef void add(Py_ssize_t n, double a, double[::1] x, double[::1] y) noexcept:
    """y (n,) += a x."""
    cdef int count = n, one = 1
    daxpy(&count, &a, &x[0], &one, &y[0], &one)


cdef void update(Homotopy h, double a) noexcept:
    """M += a x x' of the step x (n,)."""
    cdef int n = h.n, stride = h.inverse.shape[1], one = 1
    dger(&n, &n, &a, &h.step[0], &one, &h.step[0], &one, &h.inverse[0, 0], &stride)


cdef double largest(Py_ssize_t n, const double[::1] x) noexcept:
    """The largest |x| (n,); NaN where there is one."""
    cdef double most = 0.0
    for i in range(n):
        if not fabs(x[i]) <= most:
            most = fabs(x[i])
    return most


cdef int place(Homotopy h, Py_ssize_t position, Py_ssize_t column, double sign) except -1:
    """Write the row of an active column."""
    if not h.ready[column]:
        h.fill(column, np.asarray(h.correlation))
    h.index[position] = column
    h.sign[position] = sign
    for j in range(h.k):
        h.rows[position, j] = sign * h.gram[column, j]
    return 0


cdef int inverted(Homotopy h, double alpha) except -1:
    """Compute M again, with mu at this alpha; active columns that depend on others wait, at zero.

    Correlations are exact then.
    """
    cdef int n = h.n, rank = h.n, stride = h.inverse.shape[1], failed = 0
    for i in range(n):
        h.mu[i] = alpha * h.ridge[h.index[i]]
        for j in range(i + 1):
            h.inverse[i, j] = h.rows[i, h.index[j]] * h.sign[j]
        h.inverse[i, i] += h.mu[i]
    if n:
        dpstrf(
            "U", &n, &h.inverse[0, 0], &stride, &h.pivots[0], &rank, &h.below, &h.work[0], &failed
        )
    for i in range(n):  # in the order of the pivots
        h.step[i] = h.sign[i] * (h.index[i] + 1)
        h.fix[i] = h.weights[i]
    for i in range(n):
        column = <Py_ssize_t>fabs(h.step[h.pivots[i] - 1]) - 1
        h.standing[column] = ACTIVE if i < rank else WAITING
        h.weights[i] = h.fix[h.pivots[i] - 1]
        place(h, i, column, 1.0 if h.step[h.pivots[i] - 1] > 0.0 else -1.0)
        h.mu[i] = alpha * h.ridge[column]
    h.n = n = rank
    h.age = 0
    if n:
        dpotri("U", &n, &h.inverse[0, 0], &stride, &failed)
    for i in range(n):
        for j in range(i):
            h.inverse[j, i] = h.inverse[i, j]
    correlate(h)
    return WORN if failed else FINE


cdef int return_to_known(Homotopy h, double alpha) except -1:
    """Begin again at the known weights, for alpha."""
    h.n = 0
    h.alpha = alpha
    for j in range(h.k):
        h.standing[j] = OPEN
        if h.known[j] != 0.0:
            place(h, h.n, j, 1.0 if h.known[j] > 0.0 else -1.0)
            h.weights[h.n] = fabs(h.known[j])
            h.n += 1
    return inverted(h, alpha)


cdef void correlate(Homotopy h) noexcept:
    """Exact correlations c - G w (k,)."""
    if h.n:
        combine(h.rows, h.k, h.n, h.weights, h.correlation)
        for j in range(h.k):
            h.correlation[j] = h.cross[j] - h.correlation[j]
    else:
        memcpy(&h.correlation[0], &h.cross[0], h.k * sizeof(double))


cdef void excess(Homotopy h, double alpha) noexcept:
    """By how much the active correlations, less mu w, exceed alpha, into `error` (n,)."""
    for i in range(h.n):
        h.error[i] = h.sign[i] * h.correlation[h.index[i]] - h.mu[i] * h.weights[i] - alpha


cdef int refined(Homotopy h, Py_ssize_t count, Py_ssize_t position, double scale) noexcept:
    """Refine the step x (count,) and its product by the residual of H x on the active rows.

    H x should be zero there, and one at `position`, if >= 0. WORN: M is inaccurate.
    """
    cdef double worst
    combine(h.rows, h.k, count, h.step, h.product)
    for i in range(h.n):
        h.error[i] = h.sign[i] * h.product[h.index[i]] + h.mu[i] * h.step[i]
    if position >= 0:
        h.error[position] -= 1.0
    worst = largest(h.n, h.error) / scale
    if not worst < STALE_ABOVE and (h.age >= STALE_AGE or (h.age > 0 and not worst < WRONG_ABOVE)):
        return WORN
    if worst > REFINE_ABOVE:
        combine(h.inverse, h.n, h.n, h.error, h.fix)
        add(h.n, -1.0, h.fix, h.step)
        combine(h.rows, h.k, count, h.step, h.product)
    return FINE


cdef int enter(Homotopy h, Py_ssize_t column, double sign, double alpha, double fall) except -1:
    """Activate a column with weight zero and update the slope; a dependent one has to wait.

    The step x is one unit of the column, the others reacting so that their correlations stay.
    """
    cdef Py_ssize_t n = h.n
    cdef int count = n + 1, one = 1
    cdef double pivot, amount
    place(h, n, column, sign)
    h.mu[n] = alpha * h.ridge[column]
    for i in range(n):
        h.error[i] = -sign * h.rows[i, column]
    combine(h.inverse, h.n, h.n, h.error, h.step)
    h.step[n] = 1.0
    if refined(h, n + 1, -1, 1.0) == WORN:
        return WORN
    pivot = sign * h.product[column] + h.mu[n]
    if not pivot <= 2.0 * h.gram[column, column] + h.mu[n] + DEPENDENT_BELOW and h.age > 0:
        return WORN
    if not pivot > h.below * ddot(&count, &h.step[0], &one, &h.step[0], &one):
        h.standing[column] = WAITING
        return DEPENDENT
    for i in range(n + 1):
        h.inverse[n, i] = h.inverse[i, n] = 0.0
    h.n += 1
    h.age += 1
    update(h, 1.0 / pivot)
    h.standing[column] = ACTIVE
    amount = (fall - sign * h.descent[column]) / pivot
    h.weights[n] = h.slope[n] = 0.0
    add(n + 1, amount, h.step, h.slope)
    add(h.k, amount, h.product, h.descent)
    return FINE


cdef int leave(Homotopy h, Py_ssize_t position) noexcept:
    """Deactivate a column at weight zero and update the slope; waiting columns may enter again.

    The step x changes one active correlation by one and no other: it is a column of M.
    """
    cdef Py_ssize_t last = h.n - 1
    cdef double pivot, amount
    memcpy(&h.step[0], &h.inverse[position, 0], h.n * sizeof(double))
    if refined(h, h.n, position, fabs(h.step[position])) == WORN:
        return WORN
    pivot = h.step[position]
    if not pivot * (1.0 + h.mu[position]) > 0.1:
        return WORN
    amount = -h.slope[position] / pivot
    add(h.n, amount, h.step, h.slope)
    add(h.k, amount, h.product, h.descent)
    update(h, -1.0 / pivot)
    for j in range(h.k):
        if h.standing[j] == WAITING:
            h.standing[j] = OPEN
    h.standing[h.index[position]] = OPEN
    if position != last:
        memcpy(&h.rows[position, 0], &h.rows[last, 0], h.k * sizeof(double))
        memcpy(&h.inverse[position, 0], &h.inverse[last, 0], h.n * sizeof(double))
        h.inverse[position, position] = h.inverse[last, last]
        for i in range(last):
            h.inverse[i, position] = h.inverse[position, i]
    h.index[position], h.sign[position] = h.index[last], h.sign[last]
    h.weights[position], h.slope[position] = h.weights[last], h.slope[last]
    h.mu[position] = h.mu[last]
    h.n = last
    h.age += 1
    return FINE


cdef int walk(Homotopy h, double goal, Py_ssize_t limit) except -1:
    """Follow the path from exact correlations to alpha `goal`; WORN: M became inaccurate."""
    cdef double alpha = h.alpha, fall = h.alpha - goal, remains = 1.0
    cdef double soonest, rate, near, sign, length
    cdef Py_ssize_t at
    cdef bint exits
    cdef int outcome
    excess(h, alpha)
    for j in range(h.k):
        h.drift[j] = 0.0
        if h.standing[j] != ACTIVE and fabs(h.correlation[j]) > alpha:
            h.drift[j] = (alpha if h.correlation[j] > 0.0 else -alpha) - h.correlation[j]
    for i in range(h.n):
        h.drift[h.index[i]] = -h.sign[i] * h.error[i]
        h.fix[i] = fall + h.error[i]
    if h.n:
        combine(h.inverse, h.n, h.n, h.fix, h.slope)
        combine(h.rows, h.k, h.n, h.slope, h.descent)
        for i in range(h.n):
            h.error[i] = h.fix[i] - h.sign[i] * h.descent[h.index[i]] - h.mu[i] * h.slope[i]
        if largest(h.n, h.error) > REFINE_ABOVE * largest(h.n, h.fix):
            combine(h.inverse, h.n, h.n, h.error, h.step)
            add(h.n, 1.0, h.step, h.slope)
            combine(h.rows, h.k, h.n, h.slope, h.descent)
    else:
        for j in range(h.k):
            h.descent[j] = 0.0
    add(h.k, 1.0, h.drift, h.correlation)
    add(h.k, 1.0, h.drift, h.descent)
    for _ in range(limit):
        near, soonest, at, exits, sign = FLAT * alpha + TINY, 0.0, -1, False, 1.0
        # Events per unit of t: the largest rate comes first, and 0 means never.
        for j in range(h.k):
            if h.standing[j] != OPEN:
                continue
            rate = (fall - h.descent[j]) / max(alpha - h.correlation[j], near)
            if rate > soonest:
                soonest, at, sign = rate, j, 1.0
            rate = (fall + h.descent[j]) / max(alpha + h.correlation[j], near)
            if rate > soonest:
                soonest, at, sign = rate, j, -1.0
        for i in range(h.n):
            rate = -h.slope[i] / max(h.weights[i], near)
            if rate > soonest or (rate > 0.0 and rate == soonest):
                soonest, at, exits = rate, i, True
        length = 1.0 / soonest if soonest * remains > 1.0 else remains
        if h.n:
            add(h.n, length, h.slope, h.weights)
        add(h.k, -length, h.descent, h.correlation)
        remains -= length
        alpha = goal + remains * fall
        h.alpha = alpha
        if not soonest * (remains + length) > 1.0:  # a NaN ends the walk too
            h.alpha = goal
            return FINE
        h.steps += 1
        outcome = leave(h, at) if exits else enter(h, at, sign, goal, fall)
        if outcome == WORN:
            return WORN
    return WORN


cdef double breach(Homotopy h, double alpha) noexcept:
    """The violation of the optimality conditions over the margin: at an optimum it is at most 1.

    Correlations are computed exactly; signed weights below zero are set to zero.
    """
    cdef double margin = OPTIMAL_WITHIN * alpha + ROUNDING, worst, lowest = 0.0
    correlate(h)
    excess(h, alpha)
    worst = largest(h.n, h.error) / margin
    for j in range(h.k):
        if h.standing[j] != ACTIVE and not (fabs(h.correlation[j]) - alpha) / margin <= worst:
            worst = (fabs(h.correlation[j]) - alpha) / margin
    for i in range(h.n):
        if h.weights[i] < 0.0:
            lowest = max(lowest, -h.weights[i])
            h.weights[i] = 0.0  # an exit that lies within rounding of this alpha
    if lowest > 0.0:
        worst = max(worst, lowest / (ROUNDING * max(largest(h.n, h.weights), TINY)))
    return worst


cdef int reach(Homotopy h, double goal, double[::1] out) except -1:
    """Follow the path to `goal`, where needed with M computed again or from the known weights.

    out (k,): the weights of the optimum (FINE), or those of the smallest violation (WORN).
    """
    cdef Py_ssize_t limit = STEPS_PER_COLUMN * h.k + STEPS_AT_LEAST, starts = 0, attempt = 0
    cdef double least = INFINITY, here
    cdef int outcome = FINE
    if h.ridged:
        outcome = inverted(h, goal)
    while attempt < ATTEMPTS and starts < FRESH_STARTS:
        outcome = walk(h, goal, limit)
        if outcome == WORN:
            starts += 1
            if h.age == 0 or starts > FRESH_STARTS // 2:
                attempt += 1
                h.below *= CAUTION
                outcome = return_to_known(h, goal)
            else:
                outcome = inverted(h, goal)
            continue
        here = breach(h, goal)
        if here < least:
            least = here
            for j in range(h.k):
                out[j] = 0.0
            for i in range(h.n):
                out[h.index[i]] = h.sign[i] * h.weights[i]
        if here <= SHARE or (here <= 1.0 and attempt > 0):
            break
        attempt += 1
        if attempt > 1:
            outcome = inverted(h, goal)
        if attempt > 3:
            h.below *= CAUTION
            outcome = return_to_known(h, goal)
    h.below = DEPENDENT_BELOW
    return FINE if least <= 1.0 else WORN
