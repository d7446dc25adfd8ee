"""Kernels: solvers of a path on the columns of a working set, warm-started.

A kernel has the problem on these columns, in units of the target (`Columns`), descending penalties,
warm starts, and the relative duality gap to reach. By penalty:

    homotopy         LASSO and elastic net, one target: piecewise linear path, from event to event
    variational      group-LASSO: Newton's method on eta_g = |V_g|/alpha, few groups in use
    block descent    group-LASSO where groups are many, sparse-group LASSO: blockwise, extrapolated
    cluster descent  SLOPE, one target: sweeps over clusters of equal |v|, and their exact optimum
    newton           any penalty with a prox: proximal points by semismooth Newton's method

``newton`` also ends what the others leave above the gap. ``homotopy``, ``variances`` and ``sweeps``
are compiled; where they are not built, ``newton`` runs in their place, slower.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib import import_module
from itertools import pairwise, starmap
from typing import Any

import numpy as np

from sparsefit.arrays import Array, BoolArray, IntArray
from sparsefit.regression.group_penalties import GroupNorms, NestedNorms, in_order
from sparsefit.regression.ordered_penalties import SortedNorm
from sparsefit.regression.penalties import AbsoluteValues, Penalty
from sparsefit.solvers.newton import (
    relative_gap,
    solved_by_newton,
    towards_clusters_optimum,
)
from sparsefit.solvers.working_set import Columns, Growing

ROUGH = 1e-5  # relative gap that suffices to extend a working set
ROUGH_CHANGE = 1e-4  # the same of descent: the change of Z V/sqrt(m) by a sweep
STOP = 1e-11  # relative gap, far below any tolerance that a certificate is asked to meet
DESCENDED = 1e-9  # that of descent, which converges linearly
MOST = 1000  # sweeps at one penalty, before Newton's method takes over
CLUSTERED, SWEEPS = 500, 30  # rounds for clusters at one penalty, and the most sweeps of one
ALIKE = 20  # rounds, after which the optimum of each face is taken, as columns are too much alike
POWERS = 8  # of G, for the length of a gradient's step


@dataclass(frozen=True, eq=False)
class Points:
    """Weights V (p, k, n) of columns of unit rms along a path of p penalties.

    complete (p,): whether each is a solution; steps (p,) taken; words: by what, for a status.
    """

    weights: Array
    complete: BoolArray
    steps: IntArray
    words: str = ""

    @classmethod
    def zeros(cls, count: int, cross: Array, words: str = "") -> Points:
        """Those where all weights are zero, and solutions; cross Z'Y/m (k, n)."""
        shape = (count, *cross.shape)
        return cls(np.zeros(shape), np.ones(count, bool), np.zeros(count, np.intp), words)


WarmStarts = dict[float, Array]
"""V (j, q) by penalty: the last final solution, at the largest, and approximate later ones."""
Kernel = Callable[[Columns, Array, WarmStarts, float], Points]
"""(problem, penalties (p,), descending, warm starts, relative gap) -> solutions of the first."""
Improved = Callable[[float, Array], tuple[Array, float, int]]
"""(penalty, start V (j, q)) -> weights nearer to the optimum, their relative gap, and steps."""
BEGIN: float = np.inf
"""The penalty of the warm start V = 0, where a path begins."""


def compiled(name: str) -> Any:
    """The compiled source of that name; None where it was not built."""
    try:
        return import_module(f"sparsefit.solvers.{name}")
    except ImportError:
        return None


def homotopy(on: Columns, alphas: Array, warm_starts: WarmStarts, stop: float) -> Points:
    """LASSO or elastic net of one target; its weights are taken into the columns, z_j/omega_j."""
    assert isinstance(on.penalty, AbsoluteValues)
    assert on.gram is not None
    least = float(on.penalty.weights.min())
    omega, gram, pull, growing = on.penalty.weights / least, on.gram, on.cross[:, 0], on.growing
    if np.any(omega != 1.0):
        gram, pull = gram / np.multiply.outer(omega, omega), pull / omega
    height = float(np.abs(pull).max()) or 1.0
    unit, scale = height / least, height / omega
    ridge = on.penalty.ridge * unit / omega**2
    rows = () if growing is None else (growing.ready, growing.fill)
    walk = compiled("homotopy").Homotopy(np.ascontiguousarray(gram), pull / height, ridge, *rows)
    last = max(warm_starts)
    if last < BEGIN:
        walk.start(warm_starts[last][:, 0] / scale, last / unit)
    values, complete = np.zeros((len(alphas), len(omega))), np.zeros(len(alphas), bool)
    with np.errstate(all="ignore"):
        # Rounding must let no column in at alpha_max.
        walk.advance(alphas / unit * (1.0 + 1e-15), values, complete)
    steps, values = np.zeros(len(alphas), np.intp), (values * scale)[:, :, None]
    steps[-1] = walk.steps
    if growing is not None and not complete.all():
        growing.complete()
    for i in np.flatnonzero(~complete):  # on columns that nearly depend on each other
        values[i], gap, _ = solved_by_newton(on, float(alphas[i]), values[i], stop)
        complete[i] = gap <= stop
    return Points(values, complete, steps)


@np.errstate(all="ignore")  # what breaks is caught by the gap, not by warnings
def _each(
    on: Columns, alphas: Array, warm_starts: WarmStarts, stop: float, improved: Improved
) -> Points:
    """A path, each penalty from the nearest warm start; Newton's method ends where it must."""
    near, points = warm_starts, Points.zeros(len(alphas), on.cross)
    for i, alpha in enumerate(alphas.tolist()):
        start = near[min(near, key=lambda each: abs(each - alpha))]
        values, gap, points.steps[i] = improved(alpha, start)
        crowded = gap <= stop == ROUGH and float(values.any(axis=1).mean()) > 0.75
        if gap > stop:
            values, gap, taken = solved_by_newton(on, alpha, values, stop)
            points.steps[i] += taken
        points.weights[i], points.complete[i] = values, gap <= (STOP if stop == ROUGH else stop)
        near = {**warm_starts, alpha: values}
        if crowded:  # too few columns for what follows
            return Points(points.weights[: i + 1], points.complete[: i + 1], points.steps[: i + 1])
    return points


def newton(on: Columns, alphas: Array, warm_starts: WarmStarts, stop: float) -> Points:
    """Any penalty: see `sparsefit.solvers.newton`."""
    return _each(on, alphas, warm_starts, stop, lambda alpha, start: (start, np.inf, 0))


def variational(on: Columns, alphas: Array, warm_starts: WarmStarts, stop: float) -> Points:
    """Group-LASSO, groups over all targets of the problem: see ``variances.pyx``."""
    assert on.gram is not None
    outer, starts, weights = _groups(on.penalty)
    scale = outer.weights[outer.groups, None]
    unit = np.any(outer.weights != 1.0)
    gram, pull = (on.gram / (scale * scale.T), on.cross / scale) if unit else (on.gram, on.cross)
    alpha = min(warm_starts, key=lambda each: abs(each - alphas[0]))
    norms = np.sqrt(np.add.reduceat(np.square(warm_starts[alpha]).sum(axis=1), starts[:-1]))
    sources = compiled("variances")
    problem = sources.Groups(np.ascontiguousarray(gram), np.ascontiguousarray(pull.T), starts)
    search = sources.Search(problem, norms * weights / alpha, stop)  # |W_g| = eta_g alpha there

    def improved(alpha: float, start: Array) -> tuple[Array, float, int]:
        values, gap, spent = search.minimised(alpha)
        return values.T / scale, gap, spent

    return _each(on, alphas, warm_starts, stop, improved)


def _groups(penalty: Penalty) -> tuple[GroupNorms, IntArray, Array]:
    """The group norms, whose columns are adjacent; the groups' first columns, and their weights."""
    outer = penalty.outer if isinstance(penalty, NestedNorms) else penalty
    assert isinstance(outer, GroupNorms)
    starts = np.flatnonzero(np.diff(outer.groups, prepend=-1, append=-1))
    return outer, starts, outer.weights[outer.groups[starts[:-1]]]


def block_descent(on: Columns, alphas: Array, warm_starts: WarmStarts, stop: float) -> Points:
    """Group-LASSO and sparse-group LASSO by block coordinate descent with Anderson extrapolation.

    The columns of a group are adjacent, and those of the group-LASSO orthogonal within it, so that
    a block has its exact optimum; the sparse-group LASSO takes a proximal-gradient step for each.
    Where a problem has G alone, its rows are those of a Cholesky factor. Sweeps end at a change of
    Z V/sqrt(m) of ``share`` times the gap, which follows the gaps that were reached.
    Source: Bertrand and Massias, "Anderson acceleration of coordinate descent" (AISTATS 2021).
    """
    penalty, inner = on.penalty, np.zeros(len(on.cross))
    (_, starts, weights), (rows, target, samples) = _groups(penalty), on.roots
    square, sizes = np.einsum("ij,ij->j", rows, rows) / samples, np.diff(starts)
    if isinstance(penalty, NestedNorms):
        inner = penalty.inner.weights
        parts = [rows[:, part] for part in starmap(slice, pairwise(starts))]
        steepest = [np.linalg.eigvalsh(part.T @ part)[-1] for part in parts]
        square = np.repeat(np.array(steepest) / samples, sizes)
    sweeps, most, share = compiled("sweeps"), MOST, 1.0

    def improved(alpha: float, start: Array) -> tuple[Array, float, int]:
        nonlocal most, share
        if not start.any() and relative_gap(on, alpha, start, on.cross) <= stop:
            return start, 0.0, 0  # rounding must let no group in at alpha_max
        state, steps = np.ascontiguousarray(np.hstack([start.T, target - start.T @ rows.T])), 0
        limits = alpha * weights, alpha * inner
        blocks = sweeps.Blocks(rows, starts, *limits, square, samples, state)
        values, residual = state[:, : len(inner)].T, state[:, len(inner) :]
        while True:
            change = ROUGH_CHANGE if stop == ROUGH else share * stop
            steps += blocks.descend(change**2, most - steps)
            if stop == ROUGH:
                return values, ROUGH, steps
            pull = (residual @ rows).T / samples
            if on.gram is not None:  # of which R may have lost digits
                pull = on.cross - on.times(values)
            gap = relative_gap(on, alpha, values, pull)
            share *= min(0.5 * stop / max(gap, 1e-300), 2.0)
            if gap <= stop or steps >= most:
                most = MOST if gap <= stop else 0
                return values, gap, steps

    return _each(on, alphas, warm_starts, stop, improved)


def cluster_descent(on: Columns, alphas: Array, warm_starts: WarmStarts, stop: float) -> Points:
    """SLOPE of one target: proximal-gradient steps split clusters of equal |v|, sweeps move them.

    Where sweeps leave the clusters as they are, the optimum for these is found by a linear system.
    Source: Larsson, Klopfenstein, Massias and Wallin, "Coordinate descent for SLOPE" (2023).
    """
    assert isinstance(on.penalty, SortedNorm)
    gram, rows = None if on.gram is None else np.ascontiguousarray(on.gram), on.rows
    x = np.cos(np.arange(len(on.cross)))[:, None]
    for _ in range(POWERS):  # the largest eigenvalue of G; opposite columns have no constant one
        x = on.times(x / np.linalg.norm(x))
    step, sweep = 1.0 / (1.05 * float(np.linalg.norm(x))), compiled("sweeps").descend_clusters
    penalty, sums = on.penalty, np.concatenate([[0.0], np.cumsum(on.penalty.weights)])
    columns, trail, bends = None, list[tuple[float, Array]](), gram is None
    if gram is None:
        along = on.design.direction
        means = np.zeros(len(x)) if along is None else rows.T @ along
        columns = (rows.data, rows.indices, rows.indptr, on.design.samples, means)

    def improved(alpha: float, values: Array) -> tuple[Array, float, int]:
        nonlocal bends
        gap, rounds, met, least, since = np.inf, 0, bool(values.any()), np.inf, 0
        if alpha in warm_starts or not bends:
            values, met = towards_clusters_optimum(on, alpha, values)
        elif len(trail) > 1 and trail[-2][0] > trail[-1][0]:  # the path is nearly straight
            (above, first), (last, second) = trail[-2:]
            values = second + min((last - alpha) / (above - last), 1.0) * (second - first)
        for rounds in range(CLUSTERED):
            pull = on.cross - on.times(values)
            gap = np.inf if met and stop < ROUGH else relative_gap(on, alpha, values, pull)
            if gap <= 0.5 * least:
                least, since = gap, rounds
            if gap <= stop or rounds > since + CLUSTERED // 5:  # far from a solution
                break
            values = penalty.prox(values + step * pull, step * alpha)
            state = on.target - on.fitted(values) if columns else on.cross - on.times(values)
            price = alpha * sums
            met = not sweep(gram, columns, price, state[:, 0], values[:, 0], SWEEPS)
            going = not met or rounds >= ALIKE
            while going:
                values, met = towards_clusters_optimum(on, alpha, values)
                going = met and gram is not None
        trail.append((alpha, values))
        bends = gram is None or rounds > 1
        return values, gap, rounds

    return _each(on, alphas, warm_starts, stop, improved)


KERNELS: dict[str, Kernel] = {
    "homotopy": homotopy,
    "newton": newton,
    "variational": variational,
    "block descent": block_descent,
    "cluster descent": cluster_descent,
}


def kernel_for(penalty: Penalty, targets: int) -> str:
    """The kernel for a penalty on so many targets, where few groups are in use."""
    if type(penalty) is AbsoluteValues and targets == 1 and compiled("homotopy"):
        return "homotopy"
    if not penalty.ridge and isinstance(penalty, GroupNorms) and compiled("variances"):
        return "variational"
    nested = isinstance(penalty, NestedNorms) and isinstance(penalty.inner, AbsoluteValues)
    if nested and not penalty.ridge and compiled("sweeps"):
        return "block descent"
    slope = type(penalty) is SortedNorm and not penalty.ridge
    return "cluster descent" if slope and targets == 1 and compiled("sweeps") else "newton"


def path_on_gram(
    gram: Array | Growing, cross: Array, penalty: Penalty, alphas: Array, square: float
) -> Points:
    """The path on all columns of targets solved together: B (k, q), |Y|^2/m and G (k, k).

    Of absolute values G may be formed as columns enter, by a `Growing`.
    """
    growing = gram if isinstance(gram, Growing) else None
    gram = gram.values if isinstance(gram, Growing) else gram
    level, name = float(np.sqrt(square)), kernel_for(penalty, cross.shape[1])
    order = in_order(penalty.blocks, 0)[0]
    if order is not None and (ordered := penalty.restricted(order)) is not None:
        points = path_on_gram(gram[np.ix_(order, order)], cross[order], ordered, alphas, square)
        return replace(points, weights=points.weights[:, np.argsort(order)])
    on = Columns(penalty.in_units(level), cross / level, gram, growing=growing)
    goal = DESCENDED if name == "block descent" else STOP
    points = KERNELS[name](on, alphas / level, {BEGIN: np.zeros(cross.shape)}, goal)
    return replace(points, weights=points.weights * level, words=f"{name}, all columns")
