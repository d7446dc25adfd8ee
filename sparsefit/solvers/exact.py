"""Exact paths of any penalty on a design of any shape: working sets around the kernels.

The columns of the largest |Z'Y| are in play at first. A kernel follows the path on these; the
correlations of all columns with the residuals of several penalties, in one product, tell the first
penalty at which a column outside objects. The path goes on from the penalty before it, with those
columns, and no more than half as many as there are (of groups as many, near ones too).
Where the columns are few, all of them are in play, and Z'Z is formed once for all targets.

The square-root loss has the conditions of the squares with the penalty t = a rho/y, rho the
residual's rms (Sun and Zhang, Biometrika 99 (2012) 879-898): its path is that at other penalties.
Huber's loss is the squares with a column of the identity for each row, an outlier that costs c y.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise, starmap

import numpy as np

from sparsefit.arrays import Array, IntArray
from sparsefit.regression.design import Design, Statistics
from sparsefit.regression.group_penalties import GroupNorms
from sparsefit.regression.losses import SQUARES, RootSquares
from sparsefit.regression.penalties import AbsoluteValues, Penalty, SquaredNorm
from sparsefit.solvers.descent import descent_path
from sparsefit.solvers.kernels import (
    BEGIN,
    DESCENDED,
    KERNELS,
    STOP,
    Points,
    compiled,
    kernel_for,
    path_on_gram,
)
from sparsefit.solvers.newton import Columns, definite
from sparsefit.solvers.outliers import outlier_path

FEW = 600  # columns that are all in play at once
START = 200  # columns in play at first
SEVERAL = 4  # penalties, below which Z'Z is not formed for them alone
AHEAD = 8  # penalties that are solved before all columns are asked
NEAR = 0.1  # below alpha, where groups join that do not object yet
ROUGH = 1e-5  # relative gap at which slow kernels tell which columns join
FEASIBLE = 3e-10  # relative excess of a correlation over alpha that is no objection
HELD = 2**25  # entries of the columns in play that are held as rows beside their products


@dataclass(frozen=True, eq=False)
class InPlay:
    """Columns in play: their indices (j,), B (j, q), Z_J'Z_J/m, and Z_J (m, j) where it is held.

    Where the columns are more than the rows, some kernels do without their products. store (s, m):
    the columns, and room for those to come, which takes no memory before. For descent each block is
    turned into its principal columns, which keeps its norm: turns have its places and the matrix.
    """

    design: Design
    target: Array
    penalty: Penalty
    index: IntArray
    cross: Array
    store: Array | None
    gram: Array | None
    turns: tuple[tuple[slice, Array], ...] | None = None

    def joined(self, new: IntArray, cross: Array, by_gram: bool) -> InPlay:
        """With further columns, in whole blocks, behind those that there are; cross is Z'Y/m."""
        blocks, old, gram, turns = self.penalty.blocks, len(self.index), None, self.turns
        new = new[np.argsort(blocks[new], kind="stable")]
        index, pull = np.concatenate([self.index, new]), np.concatenate([self.cross, cross[new]])
        store = self.store if self.design.shape[0] * len(index) <= HELD else None
        if store is not None:
            store[old : len(index)] = self.design.columns(new).T
        if store is not None and turns is not None:
            ends = old + 1 + np.flatnonzero(np.diff(blocks[new], append=-1))
            for part in starmap(slice, pairwise([old, *ends.tolist()])):
                turn = np.linalg.eigh(store[part] @ store[part].T)[1].T
                store[part], pull[part] = turn @ store[part], turn @ pull[part]
                turns = (*turns, (part, turn))
        if by_gram and self.gram is not None:
            gram = np.empty((len(index), len(index)))
            gram[:old, :old] = self.gram
            if store is not None:
                gram[old:] = store[old : len(index)] @ store[: len(index)].T / self.design.samples
            else:
                gram[old:] = self.design.products(new, index)
            gram[:old, old:] = gram[old:, :old].T
        return replace(self, index=index, cross=pull, store=store, gram=gram, turns=turns)

    @property
    def sums(self) -> Columns:
        """The sums that kernels need of them."""
        part = self.penalty.restricted(self.index)
        assert part is not None
        rows = None if self.store is None else self.store[: len(self.index)].T
        return Columns(part, self.cross, self.design.samples, self.gram, rows, self.target)

    def fitted(self, values: Array) -> Array:
        """Z_J V (m, q) of V (j, q)."""
        if self.store is not None:
            on = np.flatnonzero(values.any(axis=1))
            few = 2 * len(on) < len(values)
            part = self.store[on] if few else self.store[: len(values)]
            out: Array = part.T @ (values[on] if few else values)
            return out
        full = np.zeros((self.design.shape[1], values.shape[1]))
        full[self.index] = values
        return self.design.predict(full)

    def back(self, values: Array) -> Array:
        """V (a, j, q) of the columns as they are, before they were turned."""
        out = values.copy()
        for part, turn in self.turns or ():
            out[:, part] = turn.T @ values[:, part]
        return out


def exact_path(
    design: Design,
    target: Array,
    penalty: Penalty,
    alphas: Array,
    *,
    statistics: Statistics | None = None,
) -> Points:
    """The optimum at descending penalties alphas (p,), for targets (m, n).

    statistics: of the design and the target, where the caller has them already.
    """
    statistics = statistics or Statistics.on(design, target)
    if isinstance(penalty.loss, RootSquares):
        return _root_path(design, target, penalty, alphas, statistics)
    if np.isfinite(penalty.loss.clip):
        return outlier_path(design, target, statistics.cross, penalty, alphas)
    if isinstance(penalty, SquaredNorm):
        return _ridge_path(design, target, penalty, alphas, statistics)
    targets = target.shape[1]
    alone = targets == 1 or not penalty.coupled
    if type(penalty) is GroupNorms and alone and np.bincount(penalty.groups).max() == 1:
        # Norms of one number are absolute values.
        penalty = AbsoluteValues(penalty.weights[penalty.groups], ridge=penalty.ridge)
    parts = [slice(None)] if penalty.coupled else [slice(t, t + 1) for t in range(targets)]
    solved = [
        _along(design, target[:, part], statistics.cross[:, part], penalty, alphas, statistics)
        for part in parts
    ]
    return Points(
        np.concatenate([points.weights for points in solved], axis=2),
        np.all([points.complete for points in solved], axis=0),
        np.sum([points.steps for points in solved], axis=0),
        solved[0].words,
    )


def _along(
    design: Design,
    target: Array,
    cross: Array,
    penalty: Penalty,
    alphas: Array,
    statistics: Statistics,
) -> Points:
    """The path of targets (m, q) that share the norm of each block."""
    k, count = len(cross), len(alphas)
    level = float(np.sqrt(np.einsum("iq,iq->", target, target) / design.samples))
    if level == 0.0 or not cross.any():
        return Points.zeros(count, cross, "zero")
    if isinstance(penalty, AbsoluteValues) and _descends(design, penalty):
        weights, complete, steps = descent_path(design, target[:, 0], cross[:, 0], penalty, alphas)
        return Points(weights[:, :, None], complete, steps, "descent")
    single = count < SEVERAL  # whether Z'Z is there or not: answers depend on the data alone
    if (k <= FEW and not single) or penalty.restricted(np.arange(1)) is None:
        return path_on_gram(statistics.gram, cross, penalty, alphas, level**2)
    own = penalty.in_units(level)
    points = _with_working_set(design, target / level, cross / level, own, alphas / level)
    return replace(points, weights=points.weights * level)


def _descends(design: Design, penalty: Penalty) -> bool:
    """Whether columns stay sparse, as more of them may be in use than events are quick for."""
    large = design.kind == "sparse" and min(design.shape) > FEW and design.csc.nnz < 2**31
    return large and type(penalty) is AbsoluteValues and bool(compiled("sweeps"))


def _with_working_set(
    design: Design, target: Array, cross: Array, penalty: Penalty, alphas: Array
) -> Points:
    """The path in units of the target on the columns in play, few of them at first."""
    (k, q), count, m = cross.shape, len(alphas), design.shape[0]
    name, pull = kernel_for(penalty, q), penalty.block_dual_norms(cross).max(axis=-1)
    # The whole blocks of the largest dual norms; of one block of all columns the largest |Z'Y|.
    pull = pull[penalty.blocks] if len(pull) > 1 else np.abs(cross).max(axis=1)
    start = START if k > FEW else START // 8
    index = _whole(penalty, np.argsort(-pull, kind="stable"), start)
    # Sparse columns stay so.
    store = None if design.kind == "sparse" else np.empty((min(k, HELD // m), m))
    whole = store is not None and len(store) == k
    turns = () if name == "variational" and whole and k > FEW else None
    play = InPlay(design, target, penalty, index[:0], cross[:0], store, np.zeros((0, 0)), turns)
    play = play.joined(index, cross, True)
    points = Points.zeros(count, cross)
    done, attempts = 0, {BEGIN: np.zeros((len(index), q))}
    while done < count:
        if turns is not None and 3 * len(play.index) > m:
            name = "block descent"
        here, goal = alphas[done : done + AHEAD], DESCENDED if name == "block descent" else STOP
        stops = (goal,) if name in ("homotopy", "variational") else (ROUGH, goal)
        near = NEAR if name in ("variational", "block descent") else 0.0
        for stop in stops:
            stretch = KERNELS[name](play.sums, here, attempts, stop)
            attempts |= dict(zip(here.tolist(), stretch.weights, strict=True))
            accepted, new = _objections(play, here, stretch.weights, near)
            if len(new):
                break
        accepted = 0 if stop == ROUGH else accepted
        until = done + accepted
        points.weights[done:until, play.index] = play.back(stretch.weights[:accepted])
        points.complete[done:until] = stretch.complete[:accepted]
        points.steps[done:until] = stretch.steps[:accepted]
        done = until
        reached, wider = float(alphas[done - 1]) if done else BEGIN, ((0, len(new)), (0, 0))
        attempts = {at: np.pad(v, wider) for at, v in attempts.items() if at <= reached}
        if len(new):
            size = len(play.index) + len(new)
            in_rows = 4 * size > m if name == "block descent" else name == "newton" and size > m
            play = play.joined(new, cross, not (whole and in_rows))
    return replace(points, words=f"{name}, {len(play.index)} columns in play")


def _objections(play: InPlay, alphas: Array, values: Array, near: float) -> tuple[int, IntArray]:
    """The penalties before the first at which a column outside objects, and those to join.

    values (a, j, q) at alphas (a,). Those that object to the first three points join, and those as
    ``near`` to it, a share of alpha.
    """
    (count, size, q), penalty = values.shape, play.penalty
    flat = np.ascontiguousarray(values.transpose(1, 0, 2)).reshape(size, count * q)
    residual = np.tile(play.target, (1, count)) - play.fitted(flat)
    pulls = play.design.correlate(residual).reshape(-1, count, q).transpose(1, 0, 2)
    full, excess = np.zeros(pulls.shape[1:]), np.empty(pulls.shape[:2])
    for i, alpha in enumerate(alphas.tolist()):
        full[play.index] = values[i]
        excess[i] = penalty.objections(pulls[i], full, alpha)
    excess[:, play.index] = -2.0
    objecting = np.flatnonzero((excess > FEASIBLE).any(axis=1))
    if not len(objecting):
        return count, np.zeros(0, dtype=np.intp)
    worst = excess[objecting[:3]].max(axis=0)
    new = np.argsort(-worst, kind="stable")[: np.count_nonzero(worst > (-near or FEASIBLE))]
    return int(objecting[0]), _whole(penalty, new, max(size if near else size // 2, START // 4))


def _whole(penalty: Penalty, columns: IntArray, most: int) -> IntArray:
    """The blocks of the leading columns, at most so many columns where one block is not more."""
    blocks = penalty.blocks
    if blocks[0] == blocks[-1]:  # one block of all columns
        return np.sort(columns[:most])
    named = blocks[columns]
    first = np.sort(np.unique(named, return_index=True)[1])
    order = named[first]
    sizes = np.cumsum(np.bincount(blocks)[order])
    chosen = order[: max(int(np.searchsorted(sizes, most, side="right")), 1)]
    return np.flatnonzero(np.isin(blocks, chosen))


def _ridge_path(
    design: Design, target: Array, penalty: Penalty, alphas: Array, statistics: Statistics
) -> Points:
    """(G + mu I)^-1 Z'Y/m at each mu = alpha rho, by the smaller of Z'Z and Z Z'."""
    (m, k), rows, cross = design.shape, None, statistics.cross
    if k <= m:
        square, right = statistics.gram, cross
    else:
        rows = design.columns(np.arange(k))
        square, right = rows @ rows.T / design.samples, target
    points = Points.zeros(len(alphas), cross, "cholesky")
    points.steps[:] = 1
    for i, alpha in enumerate(alphas.tolist()):
        shifted = square.copy()
        shifted.flat[:: len(square) + 1] += alpha * penalty.ridge
        solved = definite(shifted, right)
        points.complete[i] = solved is not None
        if solved is None:  # alpha is lost beside G in rounding: the least squares of least norm
            solved = np.asarray(np.linalg.lstsq(square, right, rcond=None)[0])
        points.weights[i] = solved if rows is None else rows.T @ solved / design.samples
    return points


NEAREST = 1e-11  # of the largest penalty: the smallest t that is asked for,
DESCENT = 1e-3  # or by descent, which takes minutes to fit exactly: points below are incomplete
SETTLED = 1e-11  # relative excess of t^2 that ends the search
ROUNDING = 1e-15  # of (y + |V|_1)^2: what rho^2 from Z'Z may be off by, which ends it too
STEP = 1e-4  # relative step in t over which the derivative of rho^2 is taken
ROUNDS = 60


def _root_path(
    design: Design, target: Array, penalty: Penalty, alphas: Array, statistics: Statistics
) -> Points:
    """The points by a safeguarded search for each root x = t^2 of x = (alpha/y)^2 rho^2(t).

    t/rho(V(t)) does not decrease in t, and between events rho^2 is linear in t^2, so that Newton's
    method on t^2 ends once the events are right. A bracket keeps it safe. Below some penalty an
    optimum fits the data exactly, and is the limit for t -> 0.
    """
    level = float(np.sqrt(np.einsum("iq,iq->", target, target) / design.samples)) or 1.0
    inner = replace(penalty, loss=SQUARES)
    cross, slope = statistics.cross, (alphas / level) ** 2
    if not cross.any():
        return Points.zeros(len(alphas), cross, "zero")
    largest = float(penalty.dual_norm(cross).max())
    least = ((DESCENT if _descends(design, inner) else NEAREST) * largest) ** 2
    x = np.maximum(np.minimum(alphas, largest) ** 2, least)
    low, high = np.full(len(x), least), x.copy()
    floor, complete = np.zeros(len(x), bool), np.zeros(len(x), bool)
    is_open, steps = np.ones(len(x), bool), np.zeros(len(x), np.intp)
    values, words = np.zeros((len(alphas), *cross.shape)), ""
    for _ in range(ROUNDS):
        at = np.flatnonzero(is_open)
        if not len(at):
            break
        wanted = np.sqrt(np.concatenate([x[at], x[at] * (1.0 - STEP) ** 2]))
        order = np.argsort(-wanted, kind="stable")
        points = exact_path(design, target, inner, wanted[order], statistics=statistics)
        back = np.argsort(order)
        here, there = np.split(points.weights[back], 2)
        steps[at] += points.steps.sum()
        values[at], words, solved = here, points.words, points.complete[back][: len(at)]
        size = penalty.norm(here)
        misfit = np.array([np.square(target - design.predict(v)).sum() for v in here])
        misfit /= design.samples
        rate = np.maximum((penalty.norm(there) - size) / (STEP * np.sqrt(x[at])), 0.0)
        excess, bent = x[at] - slope[at] * misfit, 1.0 - slope[at] * rate
        newton = np.where(bent > 0, x[at] - excess / np.where(bent > 0, bent, 1.0), 0.0)
        off = ROUNDING * (level + np.abs(here).sum(axis=(1, 2))) ** 2
        tried = floor[at] | (x[at] <= least)
        high[at] = np.where(excess >= 0, x[at], high[at])
        low[at] = np.where(excess <= 0, x[at], low[at])
        near = np.abs(excess) <= SETTLED * x[at]
        hidden = (misfit <= 2.0 * off) & ~near  # perhaps no residual remains: look there
        near |= (np.abs(excess) <= slope[at] * off) & (newton > least) & ~hidden
        beyond = ((newton <= least) | hidden) & ~tried
        inside = (newton > low[at]) & (newton < high[at])
        following = np.where(inside, newton, np.sqrt(low[at]) * np.sqrt(high[at]))
        gone = (x[at] <= least) & ((excess >= 0) | hidden)
        narrow = high[at] <= low[at] * (1.0 + SETTLED)
        x[at] = np.where(near, x[at], np.where(beyond, least, following))
        floor[at] = tried
        complete[at] = (near | narrow) & ~gone & solved
        is_open[at] = ~(near | narrow | gone) & solved
    return Points(values, complete, steps, f"root of the scaled path; {words}")
