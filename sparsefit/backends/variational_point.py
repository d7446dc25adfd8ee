"""One point of the variational group-LASSO: objective, residual correlation and Hessian at eta.

Notation and source in `variational`: D holds eta, C = B - G W, W_g = eta_g C_g.  Matrices (k, n)
of columns and targets are stored as (n, k).  One source for two loops, as in `homotopy_walk`.
"""

import numpy as np

from sparsefit.arrays import Array, IntArray
from sparsefit.backends import dense, dense_groups, linear

LOST = 1e-14  # of the terms of a curvature, which may cancel: a negative one sends eta to infinity
NEW_GROUPS = 8  # more violators at once only make the subproblem larger: most do not stay
ROOM = 64  # columns that there is room for at first
PARTS = 4  # that the triangular solves of a Hessian are done in, for
LARGE = 96  # columns and more

FINE = 0
FAILED = 1  # the factorisation
NO_MEMORY = 2


class Problem:
    """Statistics with contiguous groups, unit penalty weights and |Y|^2/m = 1.

    `gram` (k, k), `cross` (n, k), `starts` (g + 1,): the first column of each group, then k;
    `power` (g,): tr G_gg.
    """

    def __init__(self, gram: Array, cross: Array, starts: IntArray) -> None:
        self.gram, self.cross, self.starts = gram, cross, starts
        self.targets, self.columns = cross.shape[0], cross.shape[1]
        self.groups = len(starts) - 1
        self.power = np.add.reduceat(np.diagonal(gram), starts[: self.groups])


class Point:
    """Everything known at one `eta` (g,): a factorisation of I + D^1/2 G D^1/2 and what follows.

    Of the s groups with eta > 0 and their c columns: `group` (s,), `begin` (s + 1,) in the columns
    `column` (c,), and `label` (c,); `width` (s,) and `root` (c,) of D^1/2; `inner` C (n, c),
    `weights` W (n, c), `factor` (c, c), `half` (s, n, c), which gives the `hessian` (s, s), the
    `square` ||C_g||^2 (s,). Of all columns: `correlation` C (n, k). `value` is f without its
    last term.
    """

    eta: Array
    width: Array
    square: Array
    root: Array
    spread: Array
    inner: Array
    weights: Array
    correlation: Array
    factor: Array
    hessian: Array
    half: Array
    group: IntArray
    begin: IntArray
    label: IntArray
    column: IntArray

    def __init__(self, targets: int, columns: int, groups: int) -> None:
        n, k, g = targets, columns, groups
        self.s, self.c, self.value = 0, 0, 0.0
        self.factor, self.half = np.zeros((0, 0)), np.zeros((0, n, 0))
        self.hessian = np.zeros((g, g))
        self.share_out(np.zeros((5, k)), np.zeros((3, n, k)), np.zeros((4, k + 1), np.intp))

    def share_out(self, rows: Array, matrices: Array, integers: IntArray) -> None:
        """Give each vector and each (n, c) or (n, k) its memory."""
        self.eta, self.width, self.square = rows[0], rows[1], rows[2]
        self.root, self.spread = rows[3], rows[4]
        self.inner, self.weights, self.correlation = matrices[0], matrices[1], matrices[2]
        self.group, self.begin = integers[0], integers[1]
        self.label, self.column = integers[2], integers[3]

    def grown(self) -> bool:
        """Make room for the factor and for what enters beside it; false where memory is out."""
        c, s = self.factor.shape[0], self.half.shape[0]
        if self.c > c:
            c = min(max(self.c + self.c // 2, ROOM), len(self.column))
        if self.s + NEW_GROUPS > s:
            s = self.s + self.s // 2 + NEW_GROUPS
        try:
            self.factor = np.zeros((c, c))
            self.half = np.zeros((s, len(self.inner), c))
        except MemoryError:
            return False
        return True


def exchange(x: Point, y: Point) -> None:
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


def correlate(problem: Problem, x: Point, weights: Array, out: Array) -> None:
    """B - G W (n, k) for weights (n, c) on the support."""
    for t in range(problem.targets):
        dense.copy(problem.columns, problem.cross[t], out[t])
    linear.less_product(x.c, x.column, problem.gram, weights, out)


def evaluate(problem: Problem, x: Point) -> int:
    """Objective, residual correlation and Hessian at `x.eta`.

    With A = I + D^1/2 G D^1/2 = LL': C = D^-1/2 A^-1 D^1/2 B on the support, and its Hessian
    is that of K = D^-1/2 (I - A^-1) D^-1/2, which needs no product with G.
    """
    n = problem.targets
    x.s = dense_groups.support(
        problem.groups, x.eta, problem.starts, x.group, x.begin, x.label, x.column
    )
    x.c = x.begin[x.s]
    x.value = 0.0
    s, c = x.s, x.c
    if (c > x.factor.shape[0] or s + NEW_GROUPS > x.half.shape[0]) and not x.grown():
        return NO_MEMORY
    dense.take(s, x.eta, x.group, x.width)
    dense.roots(s, x.width)
    dense.take(c, x.width, x.label, x.root)
    dense.upper_block(c, problem.gram, x.column, x.root, x.factor)
    dense.lift(c, 1.0, x.factor)
    if not linear.factorised(c, x.factor):
        return FAILED
    for t in range(n):
        dense.take(c, problem.cross[t], x.column, x.spread)
        dense.multiply(c, x.root, x.spread, x.inner[t])
    linear.solve(c, n, x.factor, x.inner)
    for t in range(n):
        dense.multiply(c, x.root, x.inner[t], x.weights[t])
        dense.divide(c, x.root, x.inner[t], x.inner[t])
        x.value -= 0.5 * dense_groups.picked_product(c, problem.cross[t], x.column, x.weights[t])
    correlate(problem, x, x.weights, x.correlation)
    curve(problem, x)
    return FINE


def curve(problem: Problem, x: Point) -> None:
    """The Hessian on the support, from L^-1 of the groups' columns of C, a row for each group.

    Entries before a group's own stay zero, so groups are solved in parts with what is left of L.
    """
    s, c = x.s, x.c
    part = (s + PARTS - 1) // PARTS if c > LARGE else s
    for a in range(s):
        dense.fill(s, 0.0, x.hessian[a])
    for t in range(problem.targets):
        dense_groups.spread(s, c, t, x.label, x.inner[t], x.half)
    first = 0
    while first < s:
        last = min(first + part, s)
        linear.forward(c, x.begin[first], first, last, x.factor, x.half)
        first = last
    for t in range(problem.targets):
        linear.less_overlaps(c, 0, s, t, x.half, x.hessian)
    dense_groups.group_products(s, x.begin, x.inner, x.inner, x.square)
    dense_groups.add_diagonal(s, 1.0 + LOST, x.square, x.hessian)
    dense_groups.mirror(0, s, x.width, x.hessian)


def bordered(
    problem: Problem, x: Point, new: IntArray, count: int, product: Array, out: Array
) -> None:
    """Hessian on the support and `count` new groups: K = G - V'V there, V = L^-1 D^1/2 G.

    `product` (n, k) is scratch.
    """
    n, s, c = problem.targets, x.s, x.c
    total = s + count
    for a in range(s):
        dense.copy(s, x.hessian[a], out[a])
    for h in range(count):
        x.width[s + h] = 1.0
        first, last = problem.starts[new[h]], problem.starts[new[h] + 1]
        linear.product(first, last, problem.gram, x.correlation, product)
        dense.fill(s, 0.0, out[s + h])
        for g in range(h + 1):
            first, last = problem.starts[new[g]], problem.starts[new[g] + 1]
            out[s + h, s + g] = dense_groups.inner_product(first, last, x.correlation, product)
        for t in range(n):
            dense.take(c, product[t], x.column, x.spread)
            dense.multiply(c, x.root, x.spread, x.half[s + h, t])
            dense.scale(c, -1.0, x.half[s + h, t])
    linear.forward(c, 0, s, total, x.factor, x.half)
    for t in range(n):
        linear.less_overlaps(c, s, total, t, x.half, out)
    dense_groups.mirror(s, total, x.width, out)
