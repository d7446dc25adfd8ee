"""The path of the square-root LASSO, from that of the LASSO and one equation in one unknown.

    minimise over V (k, n):   y rho(V) + a |V|_1,   rho = |Y - Z V|_F/sqrt(m),   y = rho(0)

Where rho > 0, its conditions are those of the LASSO with the penalty t = a rho/y (Sun and Zhang
2012, who call it the scaled LASSO). With V(t) the LASSO's solution, t/rho(V(t)) does not decrease
in t: the root of t y = a rho(V(t)) is unique. Between two events of the LASSO's path the residual
is R_0 + t D with R_0 orthogonal to D, so that rho^2 = rho_0^2 + h t^2 with h = s'G_AA^-1 s for the
signs s of the weights in use: linear in t^2, and Newton's method on t^2 ends once the events are
right. A bracket keeps it safe.

Below some penalty an optimum fits the data exactly, rho = 0, and is the limit of V(t) for t -> 0;
`NEAREST` is how near to it the path comes.

Sources: Belloni, Chernozhukov and Wang, Biometrika 98 (2011) 791-806; Sun and Zhang, Biometrika 99
(2012) 879-898.
"""

from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from sparsefit.arrays import Array, BoolArray, IntArray
from sparsefit.backends.homotopy import HomotopyPath, lasso_path
from sparsefit.backends.penalised import ExactPath, Points
from sparsefit.regression.objective import Penalty
from sparsefit.regression.statistics import Statistics

Values = TypeVar("Values", Array, BoolArray)
NEAREST = 1e-11  # of the largest penalty: the smallest one of the LASSO's that is asked for
SETTLED = 1e-11  # relative excess of t^2 that ends the search
ROUNDING = 1e-15  # of (y + |V|_1)^2: what rho^2 from Z'Z may be off by, which ends it too
STEP = 1e-4  # relative step in t over which h is told from |V|_1, whose slope is -h
ROUNDS = 60


def _root_path(statistics: Statistics, penalty: Penalty, alphas: Array, targets: slice) -> Points:
    """The points at descending penalties alphas (p,), all targets together, in units of y."""
    level = float(np.sqrt(statistics.target_square[targets].sum())) or 1.0
    cross, alphas, gram = statistics.cross[:, targets] / level, alphas / level, statistics.gram
    largest = float(np.abs(cross).max(initial=0.0))
    least = (NEAREST * largest) ** 2
    high = np.maximum(np.minimum(alphas, largest) ** 2, least)
    search = _Search.between(least, high, alphas**2)
    values = np.zeros((len(alphas), *cross.shape))
    steps, loop = 0, ""
    for _ in range(ROUNDS):
        at = np.flatnonzero(search.open)
        if not len(at):
            break
        found, shrink, complete, taken, loop = _lasso(gram, cross, np.sqrt(search.x[at]))
        steps, values[at] = steps + taken, found
        size = np.abs(found).sum(axis=(1, 2))
        misfit = 1.0 - np.sum(found * (2.0 * cross - gram @ found), axis=(1, 2))
        misfit = np.maximum(misfit, shrink * search.x[at])
        off = ROUNDING * (1.0 + size) ** 2
        search = search.after(at, misfit, shrink, off, complete)
    return Points(values * level, search.settled, np.full(len(alphas), steps), loop)


@dataclass(frozen=True, eq=False)
class _Search:
    """Where the search for each root x = t^2 of x = slope rho^2(x) stands, all (p,).

    low and high hold the root, unless it is below ``least``; floor: whether least was tried.
    """

    least: float
    slope: Array
    x: Array
    low: Array
    high: Array
    floor: BoolArray
    settled: BoolArray
    open: BoolArray

    @classmethod
    def between(cls, least: float, high: Array, slope: Array) -> "_Search":
        """At the upper ends."""
        never = np.zeros(len(high), dtype=bool)
        return cls(least, slope, high, np.full(len(high), least), high, never, never, ~never)

    def after(
        self, at: IntArray, misfit: Array, rate: Array, off: Array, complete: BoolArray
    ) -> "_Search":
        """The search after rho^2, its derivative and its rounding (c,) at the points ``at``."""
        x, slope = self.x[at], self.slope[at]
        excess, bent = x - slope * misfit, 1.0 - slope * rate
        newton = np.where(bent > 0, x - excess / np.where(bent > 0, bent, 1.0), 0.0)
        floor = self.floor[at] | (x <= self.least)
        high = np.where(excess >= 0, x, self.high[at])
        low = np.where(excess <= 0, x, self.low[at])
        near = np.abs(excess) <= SETTLED * x
        hidden = (misfit <= 2.0 * off) & ~near  # perhaps no residual is left: look there
        near |= (np.abs(excess) <= slope * off) & (newton > self.least) & ~hidden
        beyond = ((newton <= self.least) | hidden) & ~floor
        inside = (newton > low) & (newton < high)
        following = np.where(beyond, self.least, np.where(inside, newton, np.sqrt(low * high)))
        gone = (x <= self.least) & ((excess >= 0) | hidden)
        narrow = high <= low * (1.0 + SETTLED)
        return replace(
            self,
            x=_put(self.x, at, np.where(near, x, following)),
            low=_put(self.low, at, low),
            high=_put(self.high, at, high),
            floor=_put(self.floor, at, floor),
            settled=_put(self.settled, at, (near | narrow) & ~gone & complete),
            open=_put(self.open, at, ~(near | narrow | gone) & complete),
        )


def _put(values: Values, at: IntArray, new: Values) -> Values:
    """A copy of values with others at some places."""
    changed: Values = values.copy()
    changed[at] = new
    return changed


def _lasso(gram: Array, cross: Array, penalties: Array) -> tuple[Array, Array, BoolArray, int, str]:
    """The LASSO at penalties t (c,): V (c, k, n), h (c,), which are complete, events, the loop."""
    asked = np.concatenate([penalties, penalties * (1.0 - STEP)])
    order = np.argsort(-asked, kind="stable")
    back = np.argsort(order)
    paths: list[HomotopyPath] = [lasso_path(gram, one, asked[order]) for one in cross.T]
    values = np.stack([path.weights[back] for path in paths], axis=2)
    complete: BoolArray = np.all([path.complete[back] for path in paths], axis=0)
    here, there = np.split(values, 2)
    grown = np.abs(there).sum(axis=(1, 2)) - np.abs(here).sum(axis=(1, 2))
    rate = np.maximum(grown / np.where(penalties > 0, STEP * penalties, 1.0), 0.0)
    steps = sum(path.steps for path in paths)
    return here, rate, complete[: len(penalties)], steps, paths[0].loop


SCALED_HOMOTOPY = ExactPath(
    "scaled-homotopy",
    _root_path,
    solved="root found, {loop} loop",
    unsolved="no root, {loop} loop",
    reason="no residual is left at a penalty as small as this, or the path is incomplete",
    quadratic=False,
)
