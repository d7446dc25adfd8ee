"""Exact group-LASSO path by projected Newton steps on the variances of the groups, compiled.

With ``|v| = min over e > 0 of (|v|^2/e + e)/2`` the group-LASSO

    min over W of  sum_t [w_t'G w_t/2 - b_t'w_t] + alpha sum_g |W_g|

becomes, after W is eliminated, smooth and convex in one variable per group, eta >= 0:

    f(eta) = -tr(B'(G + D^-1)^-1 B)/2 + (alpha^2/2) sum_g eta_g,    D = diag(eta of the group)
    C = B - G W,   W_g = eta_g C_g,   df/deta_g = (alpha^2 - |C_g|^2)/2
    Hessian_gh = sum_t C_gt'K_gh C_ht,   K = G (I + D G)^-1

Of the c columns with eta > 0, A = I + D^1/2 G D^1/2 = LL' is well conditioned where G is singular,
and K = G - G D^1/2 A^-1 D^1/2 G. The optimality equation |C_g| = alpha is linearised as 1/|C_g| =
1/alpha, nearly affine in eta: the device of the trust-region secular equation. Groups are
contiguous, penalty weights one and |Y|^2/m = 1; matrices (k, n) are stored as (n, k).

Sources: Micchelli, Morales and Pontil, "Regularizers for structured sparsity" (2013), for the
quadratic form; More and Sorensen, "Computing a trust region step" (1983), for the secular one;
Nocedal and Wright, "Numerical Optimization" (2006), section 16.5, for the bounded subproblem.
"""

import numpy as np

from libc.math cimport INFINITY, fabs, sqrt
from libc.string cimport memcpy, memset
from scipy.linalg.cython_blas cimport daxpy, ddot, dgemm, dgemv, dtrsm
from scipy.linalg.cython_lapack cimport dposv, dpotrf, dpotrs

cdef enum:
    ITERATIONS = 80
    HALVINGS = 30
    CHORDS = 8  # corrections on an old factor before a new one pays off
    FRESH = 8  # violators that join at once, at least: most of more do not stay
    TURNS = 10  # of the bounded subproblem per variable, and as many more: beyond, it is cycling

cdef:
    double SHRINKING = 0.4  # of the gap by a correction that pays
    double POOR = 1e-3  # a relative gap above which corrections do not converge
    double NEGLIGIBLE = 1e-11  # eta times tr G_gg: its curvature would be lost
    double FLOOR = 1e-15  # a relative gap that double precision cannot improve
    double ROUNDING = 1e-13  # of f, by which it may rise; of a pull, that a free bound must exceed
    double RIDGE = 1e-13  # on the unit diagonal: duplicated groups make the Hessian singular
    double TINY = 1e-300


cdef double inner_product(Py_ssize_t n, const double *x, const double *y) noexcept:
    cdef int count = n, one = 1
    return ddot(&count, <double *>x, &one, <double *>y, &one)


cdef void add(Py_ssize_t n, double a, const double *x, double *y) noexcept:
    """y (n,) += a x."""
    cdef int count = n, one = 1
    daxpy(&count, &a, <double *>x, &one, y, &one)


cdef void squares(
    Py_ssize_t g, const Py_ssize_t[::1] starts, const double[:, ::1] x, double[::1] out
) noexcept:
    """|X_g|^2 (g,) of groups that start there."""
    for i in range(g):
        out[i] = 0.0
        for t in range(x.shape[0]):
            for j in range(starts[i], starts[i + 1]):
                out[i] += x[t, j] * x[t, j]


cdef class Bounded:
    """argmin of x'Hx/2 - drive'x over x >= lower, lower <= 0, of up to `size` variables: step.

    On the way the variables have a unit diagonal: unit is that H, pull the drive and floor the
    bound; free is 1 where a variable is not at it.
    """

    cdef double[::1] drive, lower, step, scale, pull, floor, x, target
    cdef double[:, ::1] unit, block
    cdef Py_ssize_t[::1] free, inside

    def __init__(self, Py_ssize_t size):
        cdef double[:, ::1] rows = np.zeros((8, size))
        self.unit, self.block = np.zeros((size, size)), np.zeros((size, size))
        self.free, self.inside = np.zeros(size, np.intp), np.zeros(size, np.intp)
        self.drive, self.lower, self.step, self.scale = rows[0], rows[1], rows[2], rows[3]
        self.pull, self.floor, self.x, self.target = rows[4], rows[5], rows[6], rows[7]


cdef void minimise(Bounded b, Py_ssize_t n, const double[:, ::1] hessian) noexcept:
    """Primal active set: move towards each face's minimum, stop at the first bound that is met."""
    cdef double slack = 0.0, reach
    cdef Py_ssize_t at
    for i in range(n):
        b.scale[i] = 1.0 / sqrt(max(hessian[i, i], TINY))
        b.pull[i] = b.scale[i] * b.drive[i]
        b.floor[i] = b.lower[i] / b.scale[i]
        b.free[i] = b.floor[i] < 0.0 or b.pull[i] > 0.0
        b.x[i] = 0.0
        slack = max(slack, ROUNDING * fabs(b.pull[i]))
    for i in range(n):
        for j in range(n):
            b.unit[i, j] = hessian[i, j] * (b.scale[i] * b.scale[j])
    for _ in range(TURNS * n + TURNS):
        face_minimum(b, n)
        at, reach = -1, 1.0
        for i in range(n):
            if b.free[i] and b.target[i] < b.floor[i]:
                if at < 0 or (b.floor[i] - b.x[i]) / (b.target[i] - b.x[i]) < reach:
                    at, reach = i, (b.floor[i] - b.x[i]) / (b.target[i] - b.x[i])
        for i in range(n):
            b.x[i] += reach * (b.target[i] - b.x[i])
        if at >= 0:
            b.x[at], b.free[at] = b.floor[at], False
            continue
        reach = slack
        for i in range(n):
            if not b.free[i] and b.pull[i] - inner_product(n, &b.unit[i, 0], &b.x[0]) > reach:
                at, reach = i, b.pull[i] - inner_product(n, &b.unit[i, 0], &b.x[0])
        if at < 0:
            break
        b.free[at] = True
    for i in range(n):
        b.step[i] = b.scale[i] * b.x[i]


cdef void face_minimum(Bounded b, Py_ssize_t n) noexcept:
    """The minimum over the free variables, the others fixed; a larger ridge where singular."""
    cdef int count = 0, one = 1, failed = 1, stride = b.block.shape[1]
    cdef double ridge = RIDGE
    for i in range(n):
        b.target[i] = 0.0 if b.free[i] else b.x[i]
    for i in range(n):
        if b.free[i]:
            b.inside[count] = i
            count += 1
    while count and failed and ridge < 1.0:
        for i in range(count):
            for j in range(i + 1):
                b.block[i, j] = b.unit[b.inside[i], b.inside[j]]
            b.block[i, i] += ridge
            # the right side in the last row of its own, which no more than n - 1 free ones leave
            b.step[i] = b.pull[b.inside[i]] - inner_product(
                n, &b.unit[b.inside[i], 0], &b.target[0]
            )
        dposv("U", &count, &one, &b.block[0, 0], &stride, &b.step[0], &count, &failed)
        ridge *= 10.0
    for i in range(count):
        b.target[b.inside[i]] = b.step[i]


cdef class Groups:
    """The problem: G (k, k), B (n, k) and starts (g + 1,), the first column of each group, then k.

    power (g,): tr G_gg.
    """

    cdef Py_ssize_t n, k, g
    cdef const double[:, ::1] gram, cross
    cdef const Py_ssize_t[::1] starts
    cdef double[::1] power, scratch

    def __init__(self, gram, cross, starts):
        self.gram, self.cross, self.starts = gram, cross, starts
        self.n, self.k, self.g = len(cross), cross.shape[1], len(starts) - 1
        ascending = self.g > 0 and starts[0] == 0 and starts[self.g] == self.k
        if not (ascending and np.all(np.diff(starts) > 0) and self.n > 0 and len(gram) == self.k):
            raise ValueError("the arrays of a group path do not fit each other")
        self.power = np.add.reduceat(np.diag(gram), starts[: self.g])
        self.scratch = np.zeros(self.k)


cdef class Point:
    """What follows from one eta (g,), of which `evaluated` is told.

    Of the s groups with eta > 0 and their c columns: group (s,), begin (s + 1,) in the columns
    column (c,), label (c,) and root (c,) of D^1/2; inner C (n, c), weights W (n, c). factor (c, c):
    L of A; image (s, n, c): L^-1 of what groups show in the Hessian (s, s), which `curve` makes, of
    groups about to enter, too. Of all columns: correlation C (n, k). value: f without its last
    term. Arrays have room for more.
    """

    cdef Groups z
    cdef Py_ssize_t s, c, shown
    cdef double value
    cdef double[::1] eta, root
    cdef double[:, ::1] factor, inner, weights, correlation, hessian
    cdef double[:, :, ::1] image
    cdef Py_ssize_t[::1] group, begin, column, label

    def __init__(self, Groups z):
        cdef double[:, ::1] rows = np.zeros((2 + 3 * z.n, z.k))
        cdef Py_ssize_t[:, ::1] integers = np.zeros((4, z.k + 1), np.intp)
        self.z, self.eta, self.root = z, rows[0], rows[1]
        self.inner, self.weights = rows[2 : 2 + z.n], rows[2 + z.n : 2 + 2 * z.n]
        self.correlation = rows[2 + 2 * z.n :]
        self.group, self.begin = integers[0], integers[1]
        self.column, self.label = integers[2], integers[3]
        self.factor, self.hessian = np.empty((z.k, z.k)), np.empty((z.g, z.g))
        self.image = np.empty((z.g, z.n, z.k))


cdef bint evaluated(Point x) noexcept:
    """What follows from x.eta; false where a factor fails."""
    cdef Groups z = x.z
    cdef int order, stride = z.k, failed = 0
    cdef Py_ssize_t c = 0, s = 0
    for i in range(z.g):
        if x.eta[i] > 0.0:
            x.group[s], x.begin[s] = i, c
            for j in range(z.starts[i], z.starts[i + 1]):
                x.column[c], x.label[c], x.root[c] = j, s, sqrt(x.eta[i])
                c += 1
            s += 1
    x.begin[s] = c
    x.s, x.c, x.shown, x.value = s, c, 0, 0.0
    order = c
    for i in range(c):
        for j in range(i + 1):
            x.factor[i, j] = z.gram[x.column[i], x.column[j]] * (x.root[i] * x.root[j])
        x.factor[i, i] += 1.0
    if c:
        dpotrf("U", &order, &x.factor[0, 0], &stride, &failed)
    if failed:
        return False
    for t in range(z.n):
        for i in range(c):
            x.inner[t, i] = x.root[i] * z.cross[t, x.column[i]]
    solve(x, x.inner)
    for t in range(z.n):
        for i in range(c):
            x.weights[t, i] = x.root[i] * x.inner[t, i]
            x.inner[t, i] /= x.root[i]
            x.value -= 0.5 * z.cross[t, x.column[i]] * x.weights[t, i]
    correlate(x, x.weights, x.correlation)
    return True


cdef void solve(Point x, double[:, ::1] right) noexcept:
    """A^-1 times the rows (n, c), in their place."""
    cdef int order = x.c, count = x.z.n, stride = x.z.k, failed = 0
    if order:
        dpotrs("U", &order, &count, &x.factor[0, 0], &stride, &right[0, 0], &stride, &failed)


cdef void correlate(Point x, const double[:, ::1] weights, double[:, ::1] out) noexcept:
    """B - G W (n, k) of weights (n, c)."""
    cdef Groups z = x.z
    cdef int k = z.k, count, one = 1
    cdef double minus = -1.0, unit = 1.0
    cdef Py_ssize_t first, end  # of a run of adjacent rows of G
    for t in range(z.n):
        memcpy(&out[t, 0], &z.cross[t, 0], z.k * sizeof(double))
        first = 0
        while first < x.c:
            end = first + 1
            while end < x.c and x.column[end] == x.column[end - 1] + 1:
                end += 1
            count = end - first
            dgemv(
                "N", &k, &count, &minus, <double *>&z.gram[x.column[first], 0], &k,
                <double *>&weights[t, first], &one, &unit, &out[t, 0], &one,
            )
            first = end


cdef void curve(Point x, Py_ssize_t total) noexcept:
    """The Hessian of the first `total` of x.group: K = G - V'V, V = L^-1 D^1/2 G."""
    cdef Groups z = x.z
    cdef Py_ssize_t first = x.shown, h
    cdef int order = x.c, room = z.k, count = (total - first) * z.n
    cdef int apart = z.n * room, new = total - first, all = total, stride = z.g
    cdef double unit = 1.0, minus = -1.0
    cdef double *row = &z.scratch[0]
    if new <= 0:
        return
    for a in range(first, total):
        for b in range(a + 1):
            x.hessian[a, b] = 0.0
        for t in range(z.n):
            memset(row, 0, z.k * sizeof(double))
            for j in range(z.starts[x.group[a]], z.starts[x.group[a] + 1]):
                add(z.k, x.correlation[t, j], &z.gram[j, 0], row)
            for i in range(x.c):
                x.image[a, t, i] = x.root[i] * row[x.column[i]]
            for b in range(a + 1):
                h = x.group[b]
                for j in range(z.starts[h], z.starts[h + 1]):
                    x.hessian[a, b] += x.correlation[t, j] * row[j]
    if x.c:
        dtrsm(
            "L", "U", "T", "N", &order, &count, &unit, &x.factor[0, 0], &room,
            &x.image[first, 0, 0], &room,
        )
    for t in range(z.n if x.c else 0):
        dgemm(
            "T", "N", &all, &new, &order, &minus, &x.image[0, t, 0], &apart, &x.image[first, t, 0],
            &apart, &unit, &x.hessian[first, 0], &stride,
        )
    for a in range(first, total):
        for b in range(a):
            x.hessian[b, a] = x.hessian[a, b]
    x.shown = total


cdef class Search:
    """Newton's method on eta at one penalty after another, each started from the one before.

    goal: the relative gap to reach; eta (g,): where the path stands. weights (n, c) on the columns
    of the point, their correlation (n, k), gap and eta `next` (g,): of the last good correction.
    """

    cdef Groups z
    cdef Point point, other
    cdef Bounded bounded
    cdef double alpha, goal, gap
    cdef double[::1] square, width, next
    cdef double[:, ::1] inner, push, trial, trial_correlation, weights, correlation

    def __init__(self, Groups groups, eta, double goal):
        n, k = groups.n, groups.k
        cdef double[:, ::1] rows = np.zeros((3 + 6 * n, k))
        self.z, self.goal, self.bounded = groups, max(goal, FLOOR), Bounded(groups.g)
        self.point, self.other = Point(groups), Point(groups)
        self.square, self.width, self.next = rows[0], rows[1], rows[2]
        self.inner, self.push, self.trial = rows[3 : 3 + n], rows[3 + n :][:n], rows[3 + 2 * n :][:n]
        self.trial_correlation, self.weights = rows[3 + 3 * n :][:n], rows[3 + 4 * n :][:n]
        self.correlation = rows[3 + 5 * n :]
        for g in range(groups.g):
            self.point.eta[g] = eta[g]
        significant(groups, self.point.eta)
        if not evaluated(self.point):
            raise ValueError("the variances of a group path are not finite")

    def minimised(self, double alpha):
        """Weights (n, k), their relative gap, and the factorisations that were spent."""
        values, least, spent, g = np.zeros((self.z.n, self.z.k)), INFINITY, 0, self.z.g
        self.alpha = alpha
        while True:
            correct(self)
            if self.gap < least:
                least, c = self.gap, self.point.c
                values[:] = 0.0
                values[:, np.asarray(self.point.column)[:c]] = np.asarray(self.weights)[:, :c]
            if least <= self.goal or spent >= ITERATIONS:
                return values, least, spent
            squares(g, self.z.starts, self.correlation, self.square)
            excess = np.asarray(self.square)[:g] - alpha**2
            excess[np.asarray(self.point.eta)[:g] > 0.0] = 0.0
            worst = np.argsort(-excess, kind="stable")[: max(FRESH, self.point.s)]
            fresh = worst[excess[worst] > 0.0]
            if len(fresh):
                self.point.shown = min(self.point.shown, self.point.s)
                np.asarray(self.point.group)[self.point.s : self.point.s + len(fresh)] = fresh
                enlarge(self, len(fresh), True)
            if not accepted(self, len(fresh)):
                return values, least, spent
            spent += 1


cdef void significant(Groups z, double[::1] eta) noexcept:
    """Eta is zero where its curvature would be lost."""
    for g in range(z.g):
        if not eta[g] * z.power[g] > NEGLIGIBLE:
            eta[g] = 0.0


cdef void remember(Search s, double[:, ::1] weights, double[:, ::1] correlation) noexcept:
    """The last good correction."""
    for t in range(s.z.n):
        memcpy(&s.weights[t, 0], &weights[t, 0], s.point.c * sizeof(double))
        memcpy(&s.correlation[t, 0], &correlation[t, 0], s.z.k * sizeof(double))


cdef void correct(Search s) noexcept:
    """Newton's step on the support, without a factor, to weights and the next eta.

    A change d of eta moves C by -K (d C); steps on the same factor follow while they pay, which
    correct the defect B - G D C - C of C, too.
    """
    cdef Point x = s.point
    cdef Bounded b = s.bounded
    cdef double gap
    s.gap = relative_gap(s, x.weights, x.correlation)
    remember(s, x.weights, x.correlation)
    memcpy(&s.next[0], &x.eta[0], s.z.g * sizeof(double))
    if not x.s or s.gap <= s.goal:
        return
    curve(x, x.s)
    s.gap = INFINITY
    for t in range(s.z.n):
        memcpy(&s.inner[t, 0], &x.inner[t, 0], x.c * sizeof(double))
    for a in range(x.s):
        s.width[a] = x.eta[x.group[a]]
    for _ in range(1 + CHORDS):
        squares(x.s, x.begin, s.inner, s.square)
        for a in range(x.s):
            b.drive[a] = s.square[a] * (sqrt(s.square[a]) / s.alpha - 1.0)
            b.lower[a] = -s.width[a]
        minimise(b, x.s, x.hessian)
        for t in range(s.z.n):
            for i in range(x.c):
                s.push[t, i] = b.step[x.label[i]] * s.inner[t, i] / x.root[i]
                s.inner[t, i] -= s.push[t, i] / x.root[i]
        solve(x, s.push)
        for a in range(x.s):
            s.width[a] = max(s.width[a] + b.step[a], 0.0)
        for t in range(s.z.n):
            for i in range(x.c):
                s.inner[t, i] += s.push[t, i] / x.root[i]
                s.trial[t, i] = s.width[x.label[i]] * s.inner[t, i]
        correlate(x, s.trial, s.trial_correlation)
        gap = relative_gap(s, s.trial, s.trial_correlation)
        if not gap < SHRINKING * s.gap:
            break
        s.gap = gap
        remember(s, s.trial, s.trial_correlation)
        for a in range(x.s):
            s.next[x.group[a]] = s.width[a]
        significant(s.z, s.next)
        if gap <= s.goal or gap > POOR:
            break
        for t in range(s.z.n):
            for i in range(x.c):
                s.push[t, i] = x.root[i] * (s.correlation[t, x.column[i]] - s.inner[t, i])
        solve(x, s.push)
        for t in range(s.z.n):
            for i in range(x.c):
                s.inner[t, i] += s.push[t, i] / x.root[i]


cdef void enlarge(Search s, Py_ssize_t fresh, bint secular) noexcept:
    """`next` after the bounded step on the support and so many further groups together.

    The step is that of 1/|C| = 1/alpha, where `secular`, or of the gradient of f.
    """
    cdef Point x = s.point
    cdef Bounded b = s.bounded
    cdef double square
    curve(x, x.s + fresh)
    squares(s.z.g, s.z.starts, x.correlation, s.square)
    for a in range(x.s + fresh):
        square = s.square[x.group[a]]
        b.lower[a] = -x.eta[x.group[a]]
        b.drive[a] = 0.5 * (square - s.alpha * s.alpha)
        if secular:
            b.drive[a] = square * (sqrt(square) / s.alpha - 1.0)
    minimise(b, x.s + fresh, x.hessian)
    memcpy(&s.next[0], &x.eta[0], s.z.g * sizeof(double))
    for a in range(x.s + fresh):
        s.next[x.group[a]] = max(x.eta[x.group[a]] + b.step[a], 0.0)
    significant(s.z, s.next)


cdef bint accepted(Search s, Py_ssize_t fresh) noexcept:
    """Go to `next` if f does not rise there, else to a halved plain Newton step; false: neither."""
    cdef double here = objective(s, s.point), share = 1.0
    for trial in range(HALVINGS):
        for g in range(s.z.g):
            s.other.eta[g] = (1.0 - share) * s.point.eta[g] + share * s.next[g]
        if evaluated(s.other) and objective(s, s.other) <= here + ROUNDING * fabs(here):
            s.point, s.other = s.other, s.point
            return True
        if trial:
            share *= 0.5
        else:  # only the plain step is sure to descend
            enlarge(s, fresh, False)
    return False


cdef double objective(Search s, Point x) noexcept:
    """f at a point."""
    cdef double total = 0.0
    for g in range(s.z.g):
        total += x.eta[g]
    return x.value + 0.5 * s.alpha * s.alpha * total


cdef double relative_gap(
    Search s, const double[:, ::1] weights, const double[:, ::1] correlation
) noexcept:
    """Relative duality gap of W with dual point u R: (1-u)^2 R'R + 2 (alpha |W| - u <C, W>)."""
    cdef Point x = s.point
    cdef double product = 0.0, explained = 0.0, norm = 0.0, top = 0.0, shrink
    squares(s.z.g, s.z.starts, correlation, s.square)
    for g in range(s.z.g):
        if not s.square[g] <= top:
            top = s.square[g]
    shrink = 1.0 if sqrt(top) <= s.alpha else s.alpha / sqrt(top)
    for t in range(s.z.n):
        for i in range(x.c):
            product += correlation[t, x.column[i]] * weights[t, i]
            explained += s.z.cross[t, x.column[i]] * weights[t, i]
    squares(x.s, x.begin, weights, s.square)
    for a in range(x.s):
        norm += sqrt(s.square[a])
    product = (
        max(1.0 - explained - product, 0.0) * (1.0 - shrink) * (1.0 - shrink)
        + 2.0 * (s.alpha * norm - shrink * product)
    )
    return 0.0 if product < 0.0 else product
