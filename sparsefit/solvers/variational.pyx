"""Exact group-LASSO path in Gram space by projected Newton on group variances, compiled.

With ``||v|| = min over e > 0 of (||v||^2 / e + e) / 2`` the group-LASSO

    min over W of  sum_t [w_t'G w_t / 2 - b_t'w_t] + alpha * sum_g ||W_g||_F

becomes, after W is eliminated, smooth and convex in one variable per group, eta >= 0:

    f(eta) = -tr(B'(G + D^-1)^-1 B) / 2 + (alpha^2 / 2) sum_g eta_g,    D = diag(eta of the group)
    C = B - G W,   W_g = eta_g C_g,   df/deta_g = (alpha^2 - ||C_g||^2) / 2
    Hessian_gh = sum_t C_gt' K_gh C_ht,   K = G (I + D G)^-1

``I + D^1/2 G D^1/2`` over the positive groups is well conditioned where G is singular. The
optimality equation ||C_g|| = alpha is linearised as 1/||C_g|| = 1/alpha, nearly affine in eta: the
device of the trust-region secular equation. Groups are contiguous, penalty weights one and
|Y|^2/m = 1; matrices (k, n) of columns and targets are stored as (n, k).

Sources: Micchelli, Morales and Pontil, "Regularizers for structured sparsity" (2013), for the
quadratic form; More and Sorensen, "Computing a trust region step" (1983), for the secular one;
Nocedal and Wright, "Numerical Optimization" (2006), section 16.5, for the bounded subproblem.
"""

import numpy as np

from libc.float cimport DBL_MIN
from libc.math cimport INFINITY, fabs, sqrt

from sparsefit.solvers cimport dense, linear

cdef enum:
    FINE = 0
    STUCK = 1  # a factorisation failed
    NO_MEMORY = 2
    ITERATIONS = 80
    HALVINGS = 30
    CHORDS = 8  # corrections on an old factor before a new one pays off
    NEW_GROUPS = 8  # more violators at once only make the subproblem larger: most do not stay
    ROOM = 64  # columns that there is room for at first
    PARTS = 4  # that the triangular solves of a Hessian are done in, for
    LARGE = 96  # columns and more
    RIDGES = 13  # trials of a larger ridge on a face that is singular
    TURNS = 10  # of the subproblem per variable, and as many more: beyond, it is cycling

cdef:
    double LOST = 1e-14  # of the terms of a curvature, which may cancel: a negative one is fatal
    double SHRINKING = 0.4  # of the gap by a correction that pays
    double POOR = 1e-3  # a relative gap above which corrections do not converge
    double NEGLIGIBLE = 1e-11  # eta times the group's power: its curvature would be lost
    double FLOOR = 1e-15  # a relative gap that double precision cannot improve
    double ROUNDING = 1e-13  # of f, by which it may rise; of a pull, that a free bound must exceed
    double NEVER = 1e300  # the gap of what was not tried
    double RIDGE = 1e-13  # on the unit diagonal: duplicated groups make the Hessian singular
    double FIRST_RIDGE = 1e-12  # of a face that is singular, tenfold at each trial


cdef class Bounded:
    """Minimise x'Hx/2 - drive'x over x >= lower (lower <= 0), for up to `size` variables.

    step (size,) is the solution. On the way the variables have a unit diagonal: unit is that H,
    pull the drive and floor the bound; free is 1 where a variable is not at it.
    """

    cdef double[::1] drive, lower, step, scale, pull, floor, free, fixed, x, target
    cdef double[:, ::1] right, unit, block
    cdef Py_ssize_t[::1] inside

    def __init__(self, Py_ssize_t size):
        cdef double[:, ::1] rows = np.zeros((11, size))
        self.unit, self.block = np.zeros((size, size)), np.zeros((size, size))
        self.inside = np.zeros(size, np.intp)
        self.drive, self.lower, self.step, self.scale = rows[0], rows[1], rows[2], rows[3]
        self.pull, self.floor, self.free, self.fixed = rows[4], rows[5], rows[6], rows[7]
        self.x, self.target, self.right = rows[8], rows[9], rows[10:11]


cdef void minimised(Bounded b, Py_ssize_t n, const double[:, ::1] hessian) noexcept nogil:
    """Fill `step` (n,) for H (n, n), `drive` and `lower`."""
    cdef bint settled = True
    if n == 0:
        return
    for i in range(n):
        b.scale[i] = 1.0 / sqrt(hessian[i, i] if hessian[i, i] > DBL_MIN else DBL_MIN)
        b.pull[i] = b.scale[i] * b.drive[i]
        b.floor[i] = b.lower[i] / b.scale[i]
    for i in range(n):
        for j in range(n):
            b.unit[i, j] = b.block[i, j] = hessian[i, j] * (b.scale[i] * b.scale[j])
        b.unit[i, i] += RIDGE
        b.block[i, i] += RIDGE
    dense.copy(n, b.pull, b.x)
    if linear.factorised(n, b.block):
        dense.copy(n, b.pull, b.right[0])
        linear.solve(n, 1, b.block, b.right)
        dense.copy(n, b.right[0], b.x)
        for i in range(n):
            settled = settled and b.x[i] >= b.floor[i]
    else:
        settled = False
    if not settled:
        for i in range(n):
            b.free[i] = 1.0 if b.floor[i] < 0.0 or b.x[i] > 0.0 else 0.0
        search_faces(b, n)
    dense.multiply(n, b.scale, b.x, b.step)


cdef void search_faces(Bounded b, Py_ssize_t n) noexcept nogil:
    """Primal active set: move towards each face's minimiser, stop at the first bound met."""
    cdef double slack = ROUNDING * dense.largest(n, b.pull), reach, move
    cdef Py_ssize_t worst, hit
    dense.fill(n, 0.0, b.x)
    for _ in range(TURNS * n + TURNS):
        dense.copy(n, b.x, b.target)
        face_minimum(b, n)
        hit, reach = -1, INFINITY
        for i in range(n):
            if b.free[i] > 0.0 and b.target[i] < b.floor[i]:
                if (b.floor[i] - b.x[i]) / (b.target[i] - b.x[i]) < reach:
                    reach = (b.floor[i] - b.x[i]) / (b.target[i] - b.x[i])
                    hit = i
        if hit >= 0:
            for i in range(n):
                move = b.target[i] - b.x[i]
                if b.free[i] > 0.0 and b.target[i] < b.floor[i] and (
                    (b.floor[i] - b.x[i]) / move <= reach
                ):
                    b.x[i] = b.floor[i]
                    b.free[i] = 0.0
                else:
                    b.x[i] += reach * move
            continue
        dense.copy(n, b.target, b.x)
        dense.apply(n, b.unit, b.x, b.right[0])
        for i in range(n):
            b.fixed[i] = (1.0 - b.free[i]) * (b.pull[i] - b.right[0, i])
        worst = dense.highest(n, b.fixed)
        if not b.fixed[worst] > slack:
            break
        b.free[worst] = 1.0


cdef void face_minimum(Bounded b, Py_ssize_t n) noexcept nogil:
    """Minimiser over the free variables, the others fixed; a larger ridge where singular."""
    cdef Py_ssize_t count = 0
    cdef double ridge = FIRST_RIDGE, added = 0.0
    for i in range(n):
        if b.free[i] > 0.0:
            b.inside[count] = i
            count += 1
        b.fixed[i] = (1.0 - b.free[i]) * b.x[i]
    dense.apply(n, b.unit, b.fixed, b.right[0])
    dense.subtract(n, b.pull, b.right[0])
    dense.take(count, b.right[0], b.inside, b.right[0])
    for _ in range(RIDGES + 1):
        for i in range(count):
            for j in range(i, count):
                b.block[i, j] = b.unit[b.inside[i], b.inside[j]]
            b.block[i, i] += added
        if linear.factorised(count, b.block):
            linear.solve(count, 1, b.block, b.right)
            break
        added += ridge
        ridge *= 10.0
    dense.put(count, b.right[0], b.inside, b.target)


cdef class Point:
    """Everything known at one eta (g,): a factorisation of I + D^1/2 G D^1/2 and what follows.

    Of the s groups with eta > 0 and their c columns: group (s,), begin (s + 1,) in the columns
    column (c,), and label (c,); width (s,) and root (c,) of D^1/2; inner C (n, c), weights W
    (n, c), factor (c, c), half (s, n, c), which gives the hessian (s, s), the square ||C_g||^2
    (s,). Of all columns: correlation C (n, k). value is f without its last term.
    """

    cdef Py_ssize_t s, c
    cdef double value
    cdef double[::1] eta, width, square, root, spread
    cdef double[:, ::1] inner, weights, correlation, factor, hessian
    cdef double[:, :, ::1] half
    cdef Py_ssize_t[::1] group, begin, label, column

    def __init__(self, n, k, g):
        cdef double[:, ::1] rows = np.zeros((5, k))
        cdef double[:, :, ::1] matrices = np.zeros((3, n, k))
        cdef Py_ssize_t[:, ::1] integers = np.zeros((4, k + 1), np.intp)
        self.factor, self.half = np.zeros((0, 0)), np.zeros((0, n, 0))
        self.hessian = np.zeros((g, g))
        self.eta, self.width, self.square = rows[0], rows[1], rows[2]
        self.root, self.spread = rows[3], rows[4]
        self.inner, self.weights, self.correlation = matrices[0], matrices[1], matrices[2]
        self.group, self.begin = integers[0], integers[1]
        self.label, self.column = integers[2], integers[3]


cdef bint grown(Point x) noexcept with gil:
    """Make room for the factor and for what enters beside it; false where memory is out."""
    c, s = x.factor.shape[0], x.half.shape[0]
    if x.c > c:
        c = min(max(x.c + x.c // 2, ROOM), len(x.column))
    if x.s + NEW_GROUPS > s:
        s = x.s + x.s // 2 + NEW_GROUPS
    try:
        x.factor = np.zeros((c, c))
        x.half = np.zeros((s, len(x.inner), c))
    except MemoryError:
        return False
    return True


cdef class Search:
    """The problem, the best that is known at one penalty `alpha`, and scratch; goal: the gap to reach.

    gram (k, k), cross (n, k), starts (g + 1,): the first column of each group, then k; power (g,):
    tr G_gg. weights (n, c) on the columns of the present point, their correlation (n, k) and gap:
    of the best chord step, which moves eta to eta (g,); best (n, k) and best_gap: of the best
    weights at this penalty. fresh: the first `count` of it are groups about to enter.
    """

    cdef Py_ssize_t targets, columns, groups, count
    cdef const double[:, ::1] gram, cross
    cdef const Py_ssize_t[::1] starts
    cdef Bounded bounded
    cdef double alpha, goal, gap, best_gap
    cdef double[::1] power, eta, width, square, spread
    cdef double[:, ::1] inner, pushed, trial, trial_correlation, weights, correlation, best, hessian
    cdef Py_ssize_t[::1] fresh

    def __init__(self, gram, cross, starts, goal):
        self.gram, self.cross, self.starts = gram, cross, starts
        n, k, g = len(cross), cross.shape[1], len(starts) - 1
        self.targets, self.columns, self.groups = n, k, g
        self.power = np.add.reduceat(np.diagonal(gram), starts[:g])
        self.bounded = Bounded(g)
        self.goal, self.gap, self.best_gap = goal, NEVER, NEVER
        self.fresh, self.hessian = np.zeros(NEW_GROUPS, np.intp), np.zeros((g, g))
        cdef double[:, ::1] rows = np.zeros((4, k))
        cdef double[:, :, ::1] matrices = np.zeros((7, n, k))
        self.eta, self.width, self.square, self.spread = rows[0], rows[1], rows[2], rows[3]
        self.inner, self.pushed, self.trial = matrices[0], matrices[1], matrices[2]
        self.weights, self.best, self.correlation = matrices[3], matrices[4], matrices[5]
        self.trial_correlation = matrices[6]


cdef double picked(
    Py_ssize_t n, const double[::1] full, const Py_ssize_t[::1] index, const double[::1] x
) noexcept nogil:
    """The product of some entries of a vector with x (n,)."""
    cdef double total = 0.0
    for i in range(n):
        total += full[index[i]] * x[i]
    return total


cdef double overlap(
    Py_ssize_t first, Py_ssize_t last, const double[:, ::1] x, const double[:, ::1] y
) noexcept nogil:
    """<X, Y> of columns first ... last - 1."""
    cdef double total = 0.0
    for t in range(x.shape[0]):
        for j in range(first, last):
            total += x[t, j] * y[t, j]
    return total


cdef void squares(
    Py_ssize_t n, const Py_ssize_t[::1] starts, const double[:, ::1] x, double[::1] out
) noexcept nogil:
    """||X_g||^2 (n,) of groups that start there."""
    for g in range(n):
        out[g] = overlap(starts[g], starts[g + 1], x, x)


cdef void mirror(
    Py_ssize_t first, Py_ssize_t last, const double[::1] width, double[:, ::1] matrix
) noexcept nogil:
    """Divide rows first ... last - 1, up to the diagonal, by both widths, and copy them across."""
    for i in range(first, last):
        for j in range(i + 1):
            matrix[i, j] = matrix[j, i] = matrix[i, j] / (width[i] * width[j])


cdef void correlate(
    Search z, Point x, const double[:, ::1] weights, double[:, ::1] out
) noexcept nogil:
    """B - G W (n, k) for weights (n, c) on the support."""
    for t in range(z.targets):
        dense.copy(z.columns, z.cross[t], out[t])
    linear.less_product(x.c, x.column, z.gram, weights, out)


cdef int evaluate(Search z, Point x) noexcept nogil:
    """Objective, residual correlation and Hessian at `x.eta`.

    With A = I + D^1/2 G D^1/2 = LL': C = D^-1/2 A^-1 D^1/2 B on the support, and its Hessian
    is that of K = D^-1/2 (I - A^-1) D^-1/2, which needs no product with G.
    """
    cdef Py_ssize_t n = z.targets, s = 0, c = 0
    for g in range(z.groups):
        if x.eta[g] > 0.0:
            x.group[s] = g
            x.begin[s] = c
            for j in range(z.starts[g], z.starts[g + 1]):
                x.label[c] = s
                x.column[c] = j
                c += 1
            s += 1
    x.begin[s] = c
    x.s, x.c, x.value = s, c, 0.0
    if (c > x.factor.shape[0] or s + NEW_GROUPS > x.half.shape[0]) and not grown(x):
        return NO_MEMORY
    for g in range(s):
        x.width[g] = sqrt(x.eta[x.group[g]])
    dense.take(c, x.width, x.label, x.root)
    for i in range(c):
        for j in range(i, c):
            x.factor[i, j] = z.gram[x.column[i], x.column[j]] * (x.root[i] * x.root[j])
        x.factor[i, i] += 1.0
    if not linear.factorised(c, x.factor):
        return STUCK
    for t in range(n):
        for i in range(c):
            x.inner[t, i] = x.root[i] * z.cross[t, x.column[i]]
    linear.solve(c, n, x.factor, x.inner)
    for t in range(n):
        dense.multiply(c, x.root, x.inner[t], x.weights[t])
        dense.divide(c, x.root, x.inner[t], x.inner[t])
        x.value -= 0.5 * picked(c, z.cross[t], x.column, x.weights[t])
    correlate(z, x, x.weights, x.correlation)
    curve(z, x)
    return FINE


cdef void curve(Search z, Point x) noexcept nogil:
    """The Hessian on the support, from L^-1 of the groups' columns of C, a row for each group.

    Entries before a group's own stay zero, so groups are solved in parts with what is left of L.
    """
    cdef Py_ssize_t s = x.s, c = x.c, first = 0, last
    cdef Py_ssize_t part = (s + PARTS - 1) // PARTS if c > LARGE else s
    for a in range(s):
        dense.fill(s, 0.0, x.hessian[a])
        for t in range(z.targets):
            dense.fill(c, 0.0, x.half[a, t])
    for t in range(z.targets):
        for i in range(c):
            x.half[x.label[i], t, i] = x.inner[t, i]
    while first < s:
        last = min(first + part, s)
        linear.forward(c, x.begin[first], first, last, x.factor, x.half)
        first = last
    for t in range(z.targets):
        linear.less_overlaps(c, 0, s, t, x.half, x.hessian)
    squares(s, x.begin, x.inner, x.square)
    for a in range(s):
        x.hessian[a, a] += (1.0 + LOST) * x.square[a]
    mirror(0, s, x.width, x.hessian)


cdef void bordered(Search z, Point x) noexcept nogil:
    """Hessian on the support and the fresh groups: K = G - V'V there, V = L^-1 D^1/2 G."""
    cdef Py_ssize_t s = x.s, c = x.c, total = x.s + z.count, first, last
    for a in range(s):
        dense.copy(s, x.hessian[a], z.hessian[a])
    for h in range(z.count):
        x.width[s + h] = 1.0
        first, last = z.starts[z.fresh[h]], z.starts[z.fresh[h] + 1]
        linear.product(first, last, z.gram, x.correlation, z.pushed)
        dense.fill(s, 0.0, z.hessian[s + h])
        for g in range(h + 1):
            first, last = z.starts[z.fresh[g]], z.starts[z.fresh[g] + 1]
            z.hessian[s + h, s + g] = overlap(first, last, x.correlation, z.pushed)
        for t in range(z.targets):
            for i in range(c):
                x.half[s + h, t, i] = -x.root[i] * z.pushed[t, x.column[i]]
    linear.forward(c, 0, s, total, x.factor, x.half)
    for t in range(z.targets):
        linear.less_overlaps(c, s, total, t, x.half, z.hessian)
    mirror(s, total, x.width, z.hessian)


cdef double relative_gap(
    Search z, Point x, const double[:, ::1] weights, const double[:, ::1] correlation
) noexcept nogil:
    """Relative duality gap of W with dual point s R: (1-s)^2 R'R + 2 (alpha |W| - s <C, W>)."""
    cdef double product = 0.0, explained = 0.0, norm = 0.0, top, shrink, residual, gap
    squares(z.groups, z.starts, correlation, z.square)
    top = sqrt(dense.largest(z.groups, z.square))
    shrink = 1.0 if top <= z.alpha else z.alpha / top
    for t in range(z.targets):
        product += picked(x.c, correlation[t], x.column, weights[t])
        explained += picked(x.c, z.cross[t], x.column, weights[t])
    squares(x.s, x.begin, weights, z.square)
    for g in range(x.s):
        norm += sqrt(z.square[g])
    residual = max(0.0, 1.0 - explained - product)
    gap = residual * (1.0 - shrink) * (1.0 - shrink) + 2.0 * (z.alpha * norm - shrink * product)
    return 0.0 if gap < 0.0 else gap


cdef void remember(
    Search z, Point x, const double[:, ::1] weights, const double[:, ::1] correlation
) noexcept nogil:
    """Remember weights (n, c) and correlation (n, k) as those of the best chord step."""
    dense.copy_rows(x.c, z.targets, weights, z.weights)
    dense.copy_rows(z.columns, z.targets, correlation, z.correlation)


cdef void drop_negligible(Search z) noexcept nogil:
    """Groups whose curvature would be lost to rounding are zero."""
    for g in range(z.groups):
        if not z.eta[g] * z.power[g] > NEGLIGIBLE:
            z.eta[g] = 0.0


cdef void predict(Search z, Point x) noexcept nogil:
    """Newton step on the support, then chord steps on the same factor while they pay.

    From an approximate C and its defect rho = B - G D C - C (exact, a product with G):
    C + D^-1/2 A^-1 D^1/2 rho solves the linear part, and a change d of eta moves C by
    -K (d C). The exact correlation of W = eta C gives the certificate and the violators.
    """
    cdef Py_ssize_t n = z.targets, c = x.c, s = x.s
    cdef double gap
    dense.copy(z.groups, x.eta, z.eta)
    remember(z, x, x.weights, x.correlation)
    z.gap = NEVER
    if s == 0:
        z.gap = relative_gap(z, x, x.weights, x.correlation)
        return
    dense.copy_rows(c, n, x.inner, z.inner)
    dense.take(s, x.eta, x.group, z.width)
    for _ in range(1 + CHORDS):
        squares(s, x.begin, z.inner, z.square)
        for g in range(s):
            z.bounded.drive[g] = z.square[g] * (sqrt(z.square[g]) / z.alpha - 1.0)
            z.bounded.lower[g] = -z.width[g]
        minimised(z.bounded, s, x.hessian)
        for i in range(c):
            z.spread[i] = z.bounded.step[x.label[i]] / x.root[i]
        for t in range(n):
            for i in range(c):
                z.pushed[t, i] = z.spread[i] * z.inner[t, i]
                z.inner[t, i] -= z.pushed[t, i] / x.root[i]
        linear.solve(c, n, x.factor, z.pushed)
        dense.add(s, 1.0, z.bounded.step, z.width)
        dense.clip(s, z.width)
        dense.take(c, z.width, x.label, z.spread)
        for t in range(n):
            for i in range(c):
                z.inner[t, i] += z.pushed[t, i] / x.root[i]
                z.trial[t, i] = z.spread[i] * z.inner[t, i]
        correlate(z, x, z.trial, z.trial_correlation)
        gap = relative_gap(z, x, z.trial, z.trial_correlation)
        if not gap < SHRINKING * z.gap:
            break
        remember(z, x, z.trial, z.trial_correlation)
        z.gap = gap
        dense.put(s, z.width, x.group, z.eta)
        drop_negligible(z)
        if gap <= z.goal or gap > POOR:
            break
        for t in range(n):
            for i in range(c):
                z.pushed[t, i] = x.root[i] * (z.correlation[t, x.column[i]] - z.inner[t, i])
        linear.solve(c, n, x.factor, z.pushed)
        for t in range(n):
            for i in range(c):
                z.inner[t, i] += z.pushed[t, i] / x.root[i]


cdef void find_violators(Search z, Point x) noexcept nogil:
    """Groups at eta = 0 whose correlation exceeds alpha, the worst few, ascending."""
    cdef Py_ssize_t group, at
    squares(z.groups, z.starts, z.correlation, z.square)
    for g in range(z.groups):
        if x.eta[g] > 0.0 or not z.square[g] > z.alpha * z.alpha:
            z.square[g] = 0.0
    z.count = 0
    while z.count < min(NEW_GROUPS, z.groups):
        group = dense.highest(z.groups, z.square)
        if not z.square[group] > 0.0:
            break
        z.square[group] = 0.0
        at = z.count
        while at > 0 and z.fresh[at - 1] > group:
            z.fresh[at] = z.fresh[at - 1]
            at -= 1
        z.fresh[at] = group
        z.count += 1


cdef void enlarge(Search z, Point x, bint secular) noexcept nogil:
    """`z.eta` after the bounded Newton step on the support and the fresh groups together.

    The step is that of 1/||C|| = 1/alpha, where `secular`, or of the gradient of f.
    """
    cdef Py_ssize_t s = x.s, total = x.s + z.count
    cdef double square
    bordered(z, x)
    squares(z.groups, z.starts, x.correlation, z.square)
    for g in range(total):
        square = x.square[g] if g < s else z.square[z.fresh[g - s]]
        z.width[g] = x.eta[x.group[g]] if g < s else 0.0
        z.bounded.lower[g] = -z.width[g]
        if secular:
            z.bounded.drive[g] = square * (sqrt(square) / z.alpha - 1.0)
        else:
            z.bounded.drive[g] = 0.5 * (square - z.alpha * z.alpha)
    minimised(z.bounded, total, z.hessian)
    dense.copy(z.groups, x.eta, z.eta)
    for g in range(total):
        z.eta[x.group[g] if g < s else z.fresh[g - s]] = z.width[g] + z.bounded.step[g]
    drop_negligible(z)


cdef double objective(Search z, Point x) noexcept nogil:
    """f at the point."""
    return x.value + 0.5 * z.alpha * z.alpha * dense.total(z.groups, x.eta)


cdef void exchange(Point x, Point y) noexcept nogil:
    """Let each become the other."""
    x.eta, y.eta = y.eta, x.eta
    x.width, y.width = y.width, x.width
    x.square, y.square = y.square, x.square
    x.root, y.root = y.root, x.root
    x.inner, y.inner = y.inner, x.inner
    x.weights, y.weights = y.weights, x.weights
    x.correlation, y.correlation = y.correlation, x.correlation
    x.factor, y.factor = y.factor, x.factor
    x.hessian, y.hessian = y.hessian, x.hessian
    x.half, y.half = y.half, x.half
    x.group, y.group = y.group, x.group
    x.begin, y.begin = y.begin, x.begin
    x.label, y.label = y.label, x.label
    x.column, y.column = y.column, x.column
    x.s, y.s = y.s, x.s
    x.c, y.c = y.c, x.c
    x.value, y.value = y.value, x.value


cdef int accept(Search z, Point x, Point y) noexcept nogil:
    """Make x the point at `z.eta` if f does not rise there, else at a halved plain Newton step."""
    cdef double share = 1.0, here = objective(z, x), bound
    cdef int outcome
    bound = here + ROUNDING * fabs(here)
    for trial in range(HALVINGS):
        dense.copy(z.groups, x.eta, y.eta)
        dense.scale(z.groups, 1.0 - share, y.eta)
        dense.add(z.groups, share, z.eta, y.eta)
        outcome = evaluate(z, y)
        if outcome == NO_MEMORY:
            return NO_MEMORY
        if outcome == FINE and objective(z, y) <= bound:
            exchange(x, y)
            return FINE
        if trial > 0:
            share *= 0.5
        else:  # only the plain step is sure to descend
            enlarge(z, x, False)
    return STUCK


cdef void take_best(Search z, Point x, const double[:, ::1] weights, double gap) noexcept nogil:
    """Remember weights (n, c) on the support as the best at this penalty."""
    z.best_gap = gap
    for t in range(z.targets):
        dense.fill(z.columns, 0.0, z.best[t])
        dense.put(x.c, weights[t], x.column, z.best[t])


cdef Py_ssize_t minimise(Search z, Point x, Point y) noexcept nogil:
    """Newton steps on eta until weights certified to the goal are known: factorisations spent.

    Negative where memory is out.
    """
    cdef Py_ssize_t spent = 0
    cdef int outcome = FINE
    cdef double gap
    z.best_gap = NEVER
    while spent < ITERATIONS and outcome == FINE:
        predict(z, x)
        if spent == 0 or z.gap < z.best_gap:
            take_best(z, x, z.weights, z.gap)
        if z.best_gap <= z.goal:
            return spent
        find_violators(z, x)
        if z.count > 0:
            enlarge(z, x, True)
        outcome = accept(z, x, y)
        spent += 1
    gap = relative_gap(z, x, x.weights, x.correlation)
    if gap < z.best_gap:
        take_best(z, x, x.weights, gap)
    return -1 if outcome == NO_MEMORY else spent


cdef int visit(
    Search z, Point x, Point y, const double[::1] alphas, double[:, :, ::1] weights,
    Py_ssize_t[::1] iterations, double[::1] gaps
) noexcept nogil:
    """Every penalty in turn, each started from the one before."""
    if evaluate(z, x) == NO_MEMORY:
        return NO_MEMORY
    for i in range(alphas.shape[0]):
        z.alpha = alphas[i]
        iterations[i] = minimise(z, x, y)
        if iterations[i] < 0:
            return NO_MEMORY
        gaps[i] = z.best_gap
        dense.copy_rows(z.columns, z.targets, z.best, weights[i])
    return FINE


def path(gram, cross, starts, eta, const double[::1] alphas, double tolerance):
    """Weights (p, n, k), factorisations spent (p,) and relative gaps (p,), from eta (g,) on.

    gram (k, k), cross (n, k), starts (g + 1,): the first column of each group, then k.
    Raises ValueError if the arrays do not fit each other, MemoryError.
    """
    n, k, g, points = len(cross), cross.shape[1], len(starts) - 1, len(alphas)
    ascending = g > 0 and starts[0] == 0 and starts[g] == k and np.all(np.diff(starts) > 0)
    if not (ascending and n > 0 and gram.shape == (k, k) and eta.shape == (g,)):
        raise ValueError("the arrays of a group path do not fit each other")
    cdef double[:, :, ::1] weights = np.zeros((points, n, k))
    cdef Py_ssize_t[::1] iterations = np.zeros(points, np.intp)
    cdef double[::1] gaps = np.zeros(points)
    cdef Search z = Search(gram, cross, starts, max(tolerance, FLOOR))
    cdef Point x = Point(n, k, g), y = Point(n, k, g)
    dense.copy(g, eta, x.eta)
    cdef dense.PyThreadState *held = dense.unlock()
    cdef int outcome = visit(z, x, y, alphas, weights, iterations, gaps)
    dense.lock(held)
    if outcome == NO_MEMORY:
        raise MemoryError
    return np.asarray(weights), np.asarray(iterations), np.asarray(gaps)
