"""The search along the group-LASSO path, on normalised statistics: `variational` is its front door.

Notation and source there.  One source for two loops, as in `homotopy_walk`.
"""

import numpy as np

from sparsefit.arrays import Array, IntArray
from sparsefit.backends import dense, dense_groups, linear, variational_point, variational_step

ITERATIONS = 80
HALVINGS = 30
CHORDS = 8  # corrections on an old factor before a new one pays off
SHRINKING = 0.4  # of the gap by a correction that pays
POOR = 1e-3  # a relative gap above which corrections do not converge
NEGLIGIBLE = 1e-11  # eta times the group's power: its curvature would be lost to rounding
FLOOR = 1e-15  # a relative gap that double precision cannot improve
ROUNDING = 1e-13  # of f, by which it may rise
NEVER = 1e300  # the gap of what was not tried
NEW_GROUPS = variational_point.NEW_GROUPS

FINE = variational_point.FINE
STUCK = variational_point.FAILED
NO_MEMORY = variational_point.NO_MEMORY


class Search(variational_point.Problem):
    """The best that is known at one penalty `alpha`, and scratch; `goal`: the gap to reach.

    `weights` (n, c) on the columns of the present point, their `correlation` (n, k) and `gap`: of
    the best chord step, which moves eta to `eta` (g,); `best` (n, k) and `best_gap`: of the best
    weights at this penalty. `fresh`: the first `count` of it are groups about to enter.
    """

    eta: Array
    width: Array
    square: Array
    spread: Array
    inner: Array
    pushed: Array
    trial: Array
    trial_correlation: Array
    weights: Array
    correlation: Array
    best: Array
    hessian: Array
    fresh: IntArray

    def __init__(self, gram: Array, cross: Array, starts: IntArray, goal: float) -> None:
        super().__init__(gram, cross, starts)
        n, k, g = self.targets, self.columns, self.groups
        self.bounded = variational_step.Bounded(g)
        self.alpha, self.goal, self.gap, self.best_gap, self.count = 0.0, goal, NEVER, NEVER, 0
        self.fresh, self.hessian = np.zeros(NEW_GROUPS, np.intp), np.zeros((g, g))
        self.place(np.zeros((4, k)), np.zeros((7, n, k)))

    def place(self, rows: Array, matrices: Array) -> None:
        """Give each vector and each (n, c) or (n, k) its memory."""
        self.eta, self.width, self.square, self.spread = rows[0], rows[1], rows[2], rows[3]
        self.inner, self.pushed, self.trial = matrices[0], matrices[1], matrices[2]
        self.weights, self.best, self.correlation = matrices[3], matrices[4], matrices[5]
        self.trial_correlation = matrices[6]


def relative_gap(
    z: Search, x: variational_point.Point, weights: Array, correlation: Array
) -> float:
    """Relative duality gap of W with dual point s R: (1-s)^2 R'R + 2 (alpha |W| - s <C, W>)."""
    product, explained = 0.0, 0.0
    dense_groups.group_products(z.groups, z.starts, correlation, correlation, z.square)
    top = dense.root(dense.largest(z.groups, z.square))
    shrink = 1.0 if top <= z.alpha else z.alpha / top
    for t in range(z.targets):
        product += dense_groups.picked_product(x.c, correlation[t], x.column, weights[t])
        explained += dense_groups.picked_product(x.c, z.cross[t], x.column, weights[t])
    dense_groups.group_products(x.s, x.begin, weights, weights, z.square)
    norm = dense_groups.root_sum(x.s, z.square)
    residual = max(0.0, 1.0 - explained - product)
    gap = residual * (1.0 - shrink) * (1.0 - shrink) + 2.0 * (z.alpha * norm - shrink * product)
    return 0.0 if gap < 0.0 else gap


def keep(z: Search, x: variational_point.Point, weights: Array, correlation: Array) -> None:
    """Remember weights (n, c) and correlation (n, k) as those of the best chord step."""
    dense.copy_rows(x.c, z.targets, weights, z.weights)
    dense.copy_rows(z.columns, z.targets, correlation, z.correlation)


def predict(z: Search, x: variational_point.Point) -> None:
    """Newton step on the support, then chord steps on the same factor while they pay.

    From an approximate C and its defect rho = B - G D C - C (exact, a product with G):
    C + D^-1/2 A^-1 D^1/2 rho solves the linear part, and a change d of eta moves C by
    -K (d C). The exact correlation of W = eta C gives the certificate and the violators.
    """
    n, c, s = z.targets, x.c, x.s
    dense.copy(z.groups, x.eta, z.eta)
    keep(z, x, x.weights, x.correlation)
    z.gap = NEVER
    if s == 0:
        z.gap = relative_gap(z, x, x.weights, x.correlation)
        return
    dense.copy_rows(c, n, x.inner, z.inner)
    dense.take(s, x.eta, x.group, z.width)
    for _ in range(1 + CHORDS):
        dense_groups.group_products(s, x.begin, z.inner, z.inner, z.square)
        dense_groups.secular_drive(s, z.square, z.alpha, z.bounded.drive)
        dense.copy(s, z.width, z.bounded.lower)
        dense.scale(s, -1.0, z.bounded.lower)
        z.bounded.minimise(s, x.hessian)
        dense.take(c, z.bounded.step, x.label, z.spread)
        dense.divide(c, x.root, z.spread, z.spread)
        for t in range(n):
            dense.multiply(c, z.spread, z.inner[t], z.pushed[t])
            dense_groups.add_ratio(c, -1.0, z.pushed[t], x.root, z.inner[t])
        linear.solve(c, n, x.factor, z.pushed)
        dense.add(s, 1.0, z.bounded.step, z.width)
        dense.clip(s, z.width)
        dense.take(c, z.width, x.label, z.spread)
        for t in range(n):
            dense_groups.add_ratio(c, 1.0, z.pushed[t], x.root, z.inner[t])
            dense.multiply(c, z.spread, z.inner[t], z.trial[t])
        variational_point.correlate(z, x, z.trial, z.trial_correlation)
        gap = relative_gap(z, x, z.trial, z.trial_correlation)
        if not gap < SHRINKING * z.gap:
            break
        keep(z, x, z.trial, z.trial_correlation)
        z.gap = gap
        dense.put(s, z.width, x.group, z.eta)
        dense_groups.drop_negligible(z.groups, NEGLIGIBLE, z.power, z.eta)
        if gap <= z.goal or gap > POOR:
            break
        for t in range(n):
            dense.take(c, z.correlation[t], x.column, z.pushed[t])
            dense.add(c, -1.0, z.inner[t], z.pushed[t])
            dense.multiply(c, x.root, z.pushed[t], z.pushed[t])
        linear.solve(c, n, x.factor, z.pushed)
        for t in range(n):
            dense_groups.add_ratio(c, 1.0, z.pushed[t], x.root, z.inner[t])


def find_violators(z: Search, x: variational_point.Point) -> None:
    """Groups at eta = 0 whose correlation exceeds alpha, the worst few, ascending."""
    square, fresh = z.square, z.fresh
    dense_groups.group_products(z.groups, z.starts, z.correlation, z.correlation, square)
    dense_groups.violations(z.groups, x.eta, z.alpha * z.alpha, square)
    z.count = 0
    while z.count < min(NEW_GROUPS, z.groups):
        group = dense.highest(z.groups, square)
        if not square[group] > 0.0:
            break
        square[group] = 0.0
        at = z.count
        while at > 0 and fresh[at - 1] > group:
            fresh[at] = fresh[at - 1]
            at -= 1
        fresh[at] = group
        z.count += 1


def enlarge(z: Search, x: variational_point.Point, secular: bool) -> None:
    """`z.eta` after the bounded Newton step on the support and the fresh groups together.

    The step is that of 1/||C|| = 1/alpha, where `secular`, or of the gradient of f.
    """
    s, total = x.s, x.s + z.count
    variational_point.bordered(z, x, z.fresh, z.count, z.pushed, z.hessian)
    dense_groups.group_products(z.groups, z.starts, x.correlation, x.correlation, z.square)
    dense.take(s, x.eta, x.group, z.width)
    dense.copy(s, x.square, z.spread)
    for h in range(z.count):
        z.width[s + h] = 0.0
        z.spread[s + h] = z.square[z.fresh[h]]
    dense.copy(total, z.width, z.bounded.lower)
    dense.scale(total, -1.0, z.bounded.lower)
    if secular:
        dense_groups.secular_drive(total, z.spread, z.alpha, z.bounded.drive)
    else:
        dense_groups.plain_drive(total, z.spread, z.alpha, z.bounded.drive)
    z.bounded.minimise(total, z.hessian)
    dense.add(total, 1.0, z.bounded.step, z.width)
    dense.copy(z.groups, x.eta, z.eta)
    dense.put(s, z.width, x.group, z.eta)
    for h in range(z.count):
        z.eta[z.fresh[h]] = z.width[s + h]
    dense_groups.drop_negligible(z.groups, NEGLIGIBLE, z.power, z.eta)


def objective(z: Search, x: variational_point.Point) -> float:
    """f at the point."""
    return x.value + 0.5 * z.alpha * z.alpha * dense.total(z.groups, x.eta)


def accept(z: Search, x: variational_point.Point, y: variational_point.Point) -> int:
    """Make x the point at `z.eta` if f does not rise there, else at a halved plain Newton step."""
    g, share, here = z.groups, 1.0, objective(z, x)
    bound = here + ROUNDING * abs(here)
    for trial in range(HALVINGS):
        dense.copy(g, x.eta, y.eta)
        dense.scale(g, 1.0 - share, y.eta)
        dense.add(g, share, z.eta, y.eta)
        outcome = variational_point.evaluate(z, y)
        if outcome == NO_MEMORY:
            return NO_MEMORY
        if outcome == FINE and objective(z, y) <= bound:
            variational_point.exchange(x, y)
            return FINE
        if trial > 0:
            share *= 0.5
        else:  # only the plain step is sure to descend
            enlarge(z, x, False)
    return STUCK


def hold(z: Search, x: variational_point.Point, weights: Array, gap: float) -> None:
    """Remember weights (n, c) on the support as the best at this penalty."""
    z.best_gap = gap
    for t in range(z.targets):
        dense.fill(z.columns, 0.0, z.best[t])
        dense.put(x.c, weights[t], x.column, z.best[t])


def minimise(z: Search, x: variational_point.Point, y: variational_point.Point) -> int:
    """Newton steps on eta until weights certified to the goal are known: factorisations spent.

    Negative where memory is out.
    """
    z.best_gap, spent, outcome = NEVER, 0, FINE
    while spent < ITERATIONS and outcome == FINE:
        predict(z, x)
        if spent == 0 or z.gap < z.best_gap:
            hold(z, x, z.weights, z.gap)
        if z.best_gap <= z.goal:
            return spent
        find_violators(z, x)
        if z.count > 0:
            enlarge(z, x, True)
        outcome = accept(z, x, y)
        spent += 1
    gap = relative_gap(z, x, x.weights, x.correlation)
    if gap < z.best_gap:
        hold(z, x, x.weights, gap)
    return -1 if outcome == NO_MEMORY else spent


def visit(
    z: Search,
    x: variational_point.Point,
    y: variational_point.Point,
    alphas: Array,
    weights: Array,
    iterations: IntArray,
    gaps: Array,
) -> int:
    """Every penalty in turn, each started from the one before."""
    if variational_point.evaluate(z, x) == NO_MEMORY:
        return NO_MEMORY
    for i in range(len(alphas)):
        z.alpha = alphas[i]
        iterations[i] = minimise(z, x, y)
        if iterations[i] < 0:
            return NO_MEMORY
        gaps[i] = z.best_gap
        dense.copy_rows(z.columns, z.targets, z.best, weights[i])
    return FINE


def path(
    gram: Array,
    cross: Array,
    starts: IntArray,
    alphas: Array,
    tolerance: float,
    weights: Array,
    iterations: IntArray,
    gaps: Array,
) -> None:
    """Fill weights (p, n, k), factorisations spent (p,) and relative gaps (p,), given as zeros.

    `gram` (k, k), `cross` (n, k), `starts` (g + 1,): the first column of each group, then k.
    Raises ValueError if the arrays do not fit each other, MemoryError.
    """
    points, n, k, g = len(alphas), cross.shape[0], cross.shape[1], len(starts) - 1
    fits = g > 0 and n > 0 and gram.shape[0] == k and gram.shape[1] == k
    fits = fits and starts[0] == 0 and starts[g] == k and weights.shape[0] == points
    fits = fits and weights.shape[1] == n and weights.shape[2] == k
    fits = fits and len(iterations) == points and len(gaps) == points
    for group in range(g):
        fits = fits and starts[group] < starts[group + 1]
    if not fits:
        raise ValueError("the arrays of a group path do not fit each other")
    z = Search(gram, cross, starts, max(tolerance, FLOOR))
    x, y = variational_point.Point(n, k, g), variational_point.Point(n, k, g)
    held = dense.unlock()
    outcome = visit(z, x, y, alphas, weights, iterations, gaps)
    dense.lock(held)
    if outcome == NO_MEMORY:
        raise MemoryError
