"""Exact LASSO path in Gram space by homotopy (LARS with the LASSO modification).

    minimise over w (k,):   1/2 w'G w - c'w + alpha |w|_1

Between two events the solution is linear in alpha: with active columns A, signs s and
H = S G_AA S, the signed weights grow by H^-1 1 for each unit alpha loses.  An event is a column
whose correlation |c - G w| reaches alpha (it enters) or an active weight that reaches zero (it
leaves).  Each requested alpha is polished by a Newton step on the exact Gram rows and checked
against the optimality conditions; what fails is settled at that alpha by a primal active-set
method, in which a column that depends on active ones is exchanged for one of them; what fails
that too is reported as incomplete, with the weights that came closest.  `_homotopy.c` is the
same algorithm, compiled.

Sources: Osborne, Presnell and Turlach, IMA J. Numer. Anal. 20 (2000) 389-403; Efron, Hastie,
Johnstone and Tibshirani, Ann. Statist. 32 (2004) 407-499; for the repair, Lee, Battle, Raina
and Ng, NIPS 19 (2006) 801-808.
"""

from dataclasses import dataclass, field

import numpy as np

from sparsefit.arrays import Array, BoolArray
from sparsefit.backends.active_set import DEPENDENT_BELOW, ActiveSet, SingularBlockError
from sparsefit.backends.loops import Loop, loop_of

BACKEND = "lasso"  # whose loop this is
OPTIMAL_WITHIN = 1e-9  # excess of a correlation over alpha, relative to alpha
ROUNDING = 1e-13  # the same, absolute, in units of the largest |c|
FLAT = 1e-16  # distance to an event below which it is at hand, relative to alpha
FRESH_SLOPE_ABOVE = 1e-11  # error of the slope that is corrected at a requested alpha
CAUTION = (1.0, 1e2, 1e4, 1e6)  # factors on what counts as dependent, one repair after another
NEWTON_STEPS, NEWTON_SHARE = 3, 1e-2  # at a requested alpha, and the part of the margin they aim at
HOPELESS = 1e8  # breach, in units of the margin, of weights that are not worth returning
STEPS_PER_COLUMN, STEPS_AT_LEAST = 3, 50  # to one requested alpha; more is taken for cycling


@dataclass(frozen=True, eq=False)
class HomotopyPath:
    """Weights (p, k) at the p requested penalties, events on the way, and which are optimal.

    Where `complete` (p,) is false the weights are the best ones known, not a solution. `loop`:
    which of the two made them, "compiled" or "python".
    """

    weights: Array
    steps: int
    complete: BoolArray
    loop: Loop


@dataclass(frozen=True, eq=False)
class _Walk:
    """Where the path stands: signed active weights and correlations, and their slopes.

    `weights` and `slope` (k,) hold the active columns in the order of `active`; `correlation` is
    c - G w (k,), `descent` its decrease per unit of alpha; `open` (2, k) is 0 for the columns
    that may not enter: active ones, and `waiting` ones that depend on the active ones.
    """

    active: ActiveSet
    cross: Array
    weights: Array
    slope: Array
    correlation: Array
    descent: Array
    open: Array
    dependent_below: float = DEPENDENT_BELOW
    waiting: list[int] = field(default_factory=list)

    @classmethod
    def start(cls, gram: Array, cross: Array, caution: float = 1.0) -> "_Walk":
        """At w = 0; `caution` makes more columns count as dependent."""
        zero, ones = np.zeros((3, len(cross))), np.ones((2, len(cross)))
        active, below = ActiveSet.empty(gram), caution * DEPENDENT_BELOW
        return cls(active, cross, zero[0], zero[1], cross.copy(), zero[2], ones, below)

    @classmethod
    def at(cls, gram: Array, cross: Array, weights: Array, caution: float) -> "_Walk":
        """At `weights` (k,), entered largest first and without those that depend on others."""
        walk = cls.start(gram, cross, caution)
        for column in np.argsort(-np.abs(weights))[: np.count_nonzero(weights)].tolist():
            if _enter(walk, column, float(np.sign(weights[column]))):
                walk.weights[walk.active.size - 1] = abs(weights[column])
        return walk

    def full(self) -> Array:
        """Weights (k,) in the order of the columns."""
        weights = np.zeros(len(self.cross))
        weights[self.active.columns] = self.weights[: self.active.size] * self.active.signs
        return weights


def lasso_path(gram: Array, cross: Array, alphas: Array, loop: Loop | None = None) -> HomotopyPath:
    """Solve for G = `gram` (k, k), c = `cross` (k,) at every one of `alphas` (p,), descending.

    Columns may be zero, repeated or dependent.  `alphas` are >= 0, in the units of `cross`.
    `loop`: None is the compiled one where it was built, else this module's; both are the same
    algorithm.  Raises ValueError if alphas ascend or are negative, ImportError if the compiled
    loop is asked for and was not built.
    """
    if np.any(np.diff(alphas) > 0) or not np.all(np.asarray(alphas) >= 0):
        raise ValueError("alphas must descend and not be negative: sort them largest first")
    unit, height = _binary_unit(np.diagonal(gram)), _binary_unit(cross)
    scaled = gram if unit == 1.0 else gram / unit
    signal, penalties = cross / height, np.asarray(alphas, dtype=float) / height
    loop = loop or loop_of(BACKEND) or "python"
    visit = _visit_compiled if loop == "compiled" else _visit
    weights, steps, complete = np.zeros((len(alphas), len(cross))), 0, np.zeros(len(alphas), bool)
    if np.isfinite(signal).all() and np.isfinite(scaled).all():
        # What a broken inverse overflows to is caught by the checks, not by warnings.
        with np.errstate(all="ignore"):
            steps = visit(scaled, signal, penalties, weights, complete)
    return HomotopyPath(weights * (height / unit), steps, complete, loop)


def _binary_unit(values: Array) -> float:
    """Power of two next to max |values|: dividing by it rounds nothing."""
    largest = float(np.max(np.abs(values), initial=0.0))
    if not 0.0 < largest < np.inf:
        return 1.0
    return float(2.0 ** (np.frexp(largest)[1] - 1)) if not 0.99 < largest < 1.01 else 1.0


def _visit_compiled(
    gram: Array, cross: Array, alphas: Array, weights: Array, complete: BoolArray
) -> int:
    from sparsefit.backends import _homotopy

    square, signal = np.ascontiguousarray(gram), np.ascontiguousarray(cross)
    return _homotopy.path(square, signal, np.ascontiguousarray(alphas), weights, complete)


def _visit(gram: Array, cross: Array, alphas: Array, weights: Array, complete: BoolArray) -> int:
    """The path on scaled data, into weights (p, k) and complete (p,); the steps it took."""
    walk, known = _Walk.start(gram, cross), np.zeros(len(cross))
    alpha, steps = float(np.max(np.abs(cross), initial=0.0)), 0
    begun = False
    for point, goal in enumerate(alphas.tolist()):
        begun = begun or goal < alpha
        if not begun:
            complete[point] = True
            continue
        walk, weights[point], taken, complete[point] = _reach(walk, alpha, goal, known)
        known = weights[point] if complete[point] else known
        alpha, steps = goal, steps + taken
    return steps


def _reach(walk: _Walk, alpha: float, goal: float, known: Array) -> tuple[_Walk, Array, int, bool]:
    """Follow the path to `goal`; where it breaks, settle there, at last from the `known` weights.

    Returns the walk to go on with, the weights (k,), the steps taken and whether the weights are
    an optimum; where no attempt finds one, they are those of the attempt that came closest.
    """
    limit = STEPS_PER_COLUMN * len(known) + STEPS_AT_LEAST
    steps, found, least = 0, known, HOPELESS
    for attempt in range(-2, len(CAUTION)):
        try:
            if attempt == -2:
                steps += _follow(walk, alpha, goal, limit)
            else:
                if attempt >= 0:
                    walk = _Walk.at(walk.active.gram, walk.cross, known, CAUTION[attempt])
                steps += _settle(walk, goal, limit)
            breach = _polish(walk, goal)
        except SingularBlockError:
            continue
        if breach < least:
            found, least = walk.full(), breach
        if breach <= 1.0:
            return walk, found, steps, True
    return walk, found, steps, False


def _follow(walk: _Walk, alpha: float, goal: float, limit: int) -> int:
    """Walk from event to event until alpha is `goal`; returns the events, at most `limit`."""
    k = len(walk.cross)
    active, correlation, descent = walk.active, walk.correlation, walk.descent
    distance, rate = np.empty((2, k)), np.empty((2, k))
    (upper, lower), (up, down), flat = distance, rate, rate.reshape(-1)
    for step in range(limit):
        n = active.size
        near = FLAT * alpha + 1e-300
        # Events per unit of alpha: the largest rate comes first, and 0 means never.
        np.subtract(alpha, correlation, out=upper)
        np.add(alpha, correlation, out=lower)
        np.maximum(distance, near, out=distance)
        np.subtract(1.0, descent, out=up)
        np.add(1.0, descent, out=down)
        np.divide(rate, distance, out=rate)
        np.multiply(rate, walk.open, out=rate)
        first = int(flat.argmax())
        entry, exit_, position = float(flat[first]), 0.0, 0
        if n:
            shrinking = walk.slope[:n] / np.minimum(-walk.weights[:n], -near)
            position = int(shrinking.argmax())
            exit_ = float(shrinking[position])
        soonest = max(entry, exit_)
        arrived = soonest * (alpha - goal) <= 1.0
        length = alpha - goal if arrived else 1.0 / soonest
        walk.weights[:n] += length * walk.slope[:n]
        correlation -= length * descent
        if arrived:
            return step
        alpha -= length
        if exit_ >= entry:
            _leave(walk, position)
        else:
            _enter(walk, first % k, 1.0 if first < k else -1.0)
    return limit


def _enter(walk: _Walk, column: int, sign: float) -> bool:
    """Let a column in with weight zero and bend the slope; a dependent one has to wait."""
    walk.open[:, column] = 0.0
    direction = walk.active.entering(column, sign)
    if direction.dependent(walk.dependent_below):
        walk.waiting.append(column)
        return False
    amount = (1.0 - sign * walk.descent[column]) / direction.pivot
    walk.active.enter(column, sign, direction)
    n = walk.active.size
    walk.weights[n - 1] = walk.slope[n - 1] = 0.0
    walk.slope[:n] += amount * direction.step
    np.add(walk.descent, amount * direction.product, out=walk.descent)
    return True


def _leave(walk: _Walk, position: int) -> None:
    """Take a column out at weight zero and bend the slope; those that waited may try again."""
    last = walk.active.size - 1
    column = int(walk.active.columns[position])
    direction = walk.active.leaving(position)
    amount = float(walk.slope[position]) / direction.pivot
    walk.slope[: last + 1] -= amount * direction.step
    np.subtract(walk.descent, amount * direction.product, out=walk.descent)
    walk.active.leave(position, direction)
    walk.weights[position], walk.slope[position] = walk.weights[last], walk.slope[last]
    walk.open[:, [column, *walk.waiting]] = 1.0
    walk.waiting.clear()


def _polish(walk: _Walk, alpha: float) -> float:
    """Newton steps from exact correlations; the breach of optimality left, in units of the margin.

    At most 1 is optimal.
    """
    active, n = walk.active, walk.active.size
    weights, margin = walk.weights[:n], OPTIMAL_WITHIN * alpha + ROUNDING
    np.subtract(walk.cross, active.product(weights), out=walk.correlation)
    for _ in range(NEWTON_STEPS):
        weights += active.solve(active.gather(walk.correlation) - alpha)
        np.subtract(walk.cross, active.product(weights), out=walk.correlation)
        slack = np.abs(active.gather(walk.correlation) - alpha).max(initial=0.0)
        if slack <= NEWTON_SHARE * margin:
            break
        active.rebuilt()
    _freshen(walk)
    smallest, largest = weights.min(initial=0.0), weights.max(initial=0.0)
    np.maximum(weights, 0.0, out=weights)  # an exit that lies within rounding of this alpha
    excess = float(np.abs(walk.correlation).max()) - alpha
    wrong = -smallest / (ROUNDING * largest) if smallest < 0.0 else 0.0
    breach = float(max(slack / margin, excess / margin, wrong))
    return breach if breach >= 0.0 else np.inf  # a NaN compares as false


def _freshen(walk: _Walk) -> None:
    """Correct the slope where the updates have worn it: H slope = 1."""
    active, n = walk.active, walk.active.size
    error = 1.0 - active.gather(walk.descent)
    if not np.abs(error).max(initial=0.0) < FRESH_SLOPE_ABOVE:
        walk.slope[:n] += active.solve(error)
        walk.descent[:] = active.product(walk.slope[:n])


def _settle(walk: _Walk, alpha: float, limit: int) -> int:
    """Primal active set at one `alpha` from any weights: descends until no column objects."""
    active = walk.active
    for step in range(limit):
        n = active.size
        weights = walk.weights[:n]
        walk.correlation[:] = walk.cross - active.product(weights)
        move = active.solve(active.gather(walk.correlation) - alpha)
        ratio = move / np.minimum(-weights, -FLAT * alpha - 1e-300)
        position = int(ratio.argmax()) if n else 0
        if n and ratio[position] > 1.0:
            weights += move / ratio[position]
            _leave(walk, position)
            continue
        weights += move
        walk.correlation[:] = walk.cross - active.product(weights)
        excess = np.abs(walk.correlation) * walk.open[0]
        column = int(excess.argmax())
        if excess[column] <= alpha * (1.0 + 0.1 * OPTIMAL_WITHIN) + 0.1 * ROUNDING:
            return step
        sign = float(np.sign(walk.correlation[column]))
        if not _enter(walk, column, sign):
            _exchange(walk, column, sign)
    return limit


def _exchange(walk: _Walk, column: int, sign: float) -> None:
    """Let a dependent column in for the active one that its entering drives to zero first.

    Along a null direction of G no correlation changes and the objective falls in proportion.
    """
    n = walk.active.size
    step = walk.active.entering(column, sign).step[:n]
    ratio = -step / np.maximum(walk.weights[:n], 1e-300)
    position = int(ratio.argmax()) if n else 0
    if not n or not ratio[position] > 0.0:
        return
    walk.weights[:n] += step / ratio[position]
    amount = 1.0 / float(ratio[position])
    _leave(walk, position)
    if _enter(walk, column, sign):
        walk.weights[walk.active.size - 1] = amount
