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
    FRESH = 8  # violating groups that may join at once, at least: most of more do not stay
    TURNS = 10  # steps of the bounded subproblem, per variable and in addition: more is cycling

cdef:
    double NEGLIGIBLE = 1e-11  # eta tr G_gg that counts as zero: its curvature is lost in rounding
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
    """The quantities at one eta (g,), which `evaluated` computes.

    Of the s groups with eta > 0 and their c columns: group (s,), column (c,), label (c,) and root
    (c,) of D^1/2; weights W (n, c). factor (c, c): L of A; image (s, n, c): L^-1 of what groups
    contribute to the Hessian (s, s), by `curve`, of groups about to enter, too. Of all columns:
    correlation C (n, k). value: f without its last term. Arrays have room for more.
    """

    cdef Groups z
    cdef Py_ssize_t s, c
    cdef double value
    cdef double[::1] eta, root
    cdef double[:, ::1] factor, weights, correlation, hessian
    cdef double[:, :, ::1] image
    cdef Py_ssize_t[::1] group, begin, column

    def __init__(self, Groups z):
        cdef double[:, ::1] rows = np.zeros((2 + 2 * z.n, z.k))
        cdef Py_ssize_t[:, ::1] integers = np.zeros((3, z.k + 1), np.intp)
        self.z, self.eta, self.root = z, rows[0], rows[1]
        self.weights, self.correlation = rows[2 : 2 + z.n], rows[2 + z.n :]
        self.group, self.begin, self.column = integers[0], integers[1], integers[2]
        self.factor, self.hessian = np.empty((z.k, z.k)), np.empty((z.g, z.g))
        self.image = np.empty((z.g, z.n, z.k))


cdef bint evaluated(Point x) noexcept:
    """Compute the quantities at x.eta, negligible entries zero; false: no Cholesky factor."""
    cdef Groups z = x.z
    cdef int k = z.k, order, count = z.n, stride = z.k, failed = 0, one = 1
    cdef Py_ssize_t c = 0, s = 0
    cdef double minus = -1.0, unit = 1.0
    for i in range(z.g):
        if not x.eta[i] * z.power[i] > NEGLIGIBLE:
            x.eta[i] = 0.0
            continue
        x.group[s], x.begin[s] = i, c
        for j in range(z.starts[i], z.starts[i + 1]):
            x.column[c], x.root[c] = j, sqrt(x.eta[i])
            c += 1
        s += 1
    x.begin[s] = c
    x.s, x.c, x.value = s, c, 0.0
    order = c
    for i in range(c):
        for j in range(i + 1):
            x.factor[i, j] = z.gram[x.column[i], x.column[j]] * (x.root[i] * x.root[j])
        x.factor[i, i] += 1.0
        for t in range(z.n):
            x.weights[t, i] = x.root[i] * z.cross[t, x.column[i]]
    if c:
        dpotrf("U", &order, &x.factor[0, 0], &stride, &failed)
    if c and not failed:
        dpotrs(
            "U", &order, &count, &x.factor[0, 0], &stride, &x.weights[0, 0], &stride, &failed
        )
    for t in range(z.n):
        memcpy(&x.correlation[t, 0], &z.cross[t, 0], z.k * sizeof(double))
        for i in range(c):
            x.weights[t, i] *= x.root[i]
            x.value -= 0.5 * z.cross[t, x.column[i]] * x.weights[t, i]
        for a in range(s):
            order = x.begin[a + 1] - x.begin[a]
            dgemv(
                "N", &k, &order, &minus, <double *>&z.gram[x.column[x.begin[a]], 0], &k,
                &x.weights[t, x.begin[a]], &one, &unit, &x.correlation[t, 0], &one,
            )
    return not failed


cdef void curve(Point x, Py_ssize_t total) noexcept:
    """The Hessian of the first `total` of x.group: K = G - V'V, V = L^-1 D^1/2 G."""
    cdef Groups z = x.z
    cdef Py_ssize_t h
    cdef int order = x.c, room = z.k, count = total * z.n
    cdef int apart = z.n * room, all = total, stride = z.g
    cdef double unit = 1.0, minus = -1.0
    cdef double *row = &z.scratch[0]
    for a in range(total):
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
            &x.image[0, 0, 0], &room,
        )
    for t in range(z.n if x.c else 0):
        dgemm(
            "T", "N", &all, &all, &order, &minus, &x.image[0, t, 0], &apart, &x.image[0, t, 0],
            &apart, &unit, &x.hessian[0, 0], &stride,
        )
    for a in range(total):
        for b in range(a):
            x.hessian[b, a] = x.hessian[a, b]


cdef class Search:
    """Newton's method on eta at one penalty after another, each started from the one before.

    goal: the relative gap to reach; point.eta (g,): the iterate; next (g,): the next one.
    """

    cdef Groups z
    cdef Point point, other
    cdef Bounded bounded
    cdef double alpha, goal
    cdef double[::1] square, next

    def __init__(self, Groups groups, eta, double goal):
        self.z, self.goal, self.bounded = groups, max(goal, FLOOR), Bounded(groups.g)
        self.point, self.other = Point(groups), Point(groups)
        self.square, self.next = np.zeros(groups.g), np.zeros(groups.g)
        for g in range(groups.g):
            self.point.eta[g] = eta[g]
        if not evaluated(self.point):
            raise ValueError("the variances of a group path are not finite")

    def minimised(self, double alpha):
        """Weights (n, k), their relative gap, and the number of Cholesky factorisations."""
        values, least, spent = np.zeros((self.z.n, self.z.k)), INFINITY, 0
        self.alpha = alpha
        while True:
            gap, x = relative_gap(self), self.point
            if gap < least:
                least = gap
                values[:] = 0.0
                values[:, np.asarray(x.column)[: x.c]] = np.asarray(x.weights)[:, : x.c]
            if least <= self.goal or spent >= ITERATIONS:
                return values, least, spent
            excess = np.asarray(self.square) - alpha**2
            excess[np.asarray(x.eta)[: self.z.g] > 0.0] = 0.0
            worst = np.argsort(-excess, kind="stable")[: max(FRESH, x.s)]
            fresh = worst[excess[worst] > 0.0]
            np.asarray(x.group)[x.s : x.s + len(fresh)] = fresh
            if not accepted(self, x.s + len(fresh)):
                return values, least, spent
            spent += 1


cdef void enlarge(Search s, Py_ssize_t total, bint secular) noexcept:
    """Set `next` by a bounded Newton step on the first `total` of x.group, in use or to join.

    The step is that of the equation 1/|C| = 1/alpha, where `secular`, or of the gradient of f.
    """
    cdef Point x = s.point
    cdef Bounded b = s.bounded
    cdef double square
    for a in range(total):
        square = s.square[x.group[a]]
        b.lower[a] = -x.eta[x.group[a]]
        b.drive[a] = 0.5 * (square - s.alpha * s.alpha)
        if secular:
            b.drive[a] = square * (sqrt(square) / s.alpha - 1.0)
    minimise(b, total, x.hessian)
    memcpy(&s.next[0], &x.eta[0], s.z.g * sizeof(double))
    for a in range(total):
        s.next[x.group[a]] = max(x.eta[x.group[a]] + b.step[a], 0.0)


cdef bint accepted(Search s, Py_ssize_t total) noexcept:
    """Step to `next` if f does not rise, else by a plain Newton step, halved; false: neither."""
    cdef double here = objective(s, s.point), share = 1.0
    curve(s.point, total)
    enlarge(s, total, True)
    for trial in range(HALVINGS):
        for g in range(s.z.g):
            s.other.eta[g] = (1.0 - share) * s.point.eta[g] + share * s.next[g]
        if evaluated(s.other) and objective(s, s.other) <= here + ROUNDING * fabs(here):
            s.point, s.other = s.other, s.point
            return True
        if trial:
            share *= 0.5
        else:  # only the plain step is sure to descend
            enlarge(s, total, False)
    return False


cdef double objective(Search s, Point x) noexcept:
    """f at a point."""
    cdef double total = 0.0
    for g in range(s.z.g):
        total += x.eta[g]
    return x.value + 0.5 * s.alpha * s.alpha * total


cdef double relative_gap(Search s) noexcept:
    """Relative duality gap of W with dual point u R: (1-u)^2 R'R + 2 (alpha |W| - u <C, W>)."""
    cdef Point x = s.point
    cdef double product = 0.0, explained = 0.0, norm = 0.0, top = 0.0, shrink
    squares(s.z.g, s.z.starts, x.correlation, s.square)
    for g in range(s.z.g):
        if not s.square[g] <= top:
            top = s.square[g]
    shrink = 1.0 if sqrt(top) <= s.alpha else s.alpha / sqrt(top)
    for t in range(s.z.n):
        for i in range(x.c):
            product += x.correlation[t, x.column[i]] * x.weights[t, i]
            explained += s.z.cross[t, x.column[i]] * x.weights[t, i]
    squares(x.s, x.begin, x.weights, s.next)
    for a in range(x.s):
        norm += sqrt(s.next[a])
    product = (
        max(1.0 - explained - product, 0.0) * (1.0 - shrink) * (1.0 - shrink)
        + 2.0 * (s.alpha * norm - shrink * product)
    )
    return 0.0 if product < 0.0 else product
