"""Exact regularisation paths of any penalty, on designs of any shape, by working sets.

    minimise over V (k, n):   1/(2m) |Y - Z V|^2 + alpha Omega(V),   alpha_1 > alpha_2 > ...

A working set J begins with the columns of the largest |Z'Y|. A kernel (`kernels`) solves the next
`AHEAD` penalties on J alone, warm-started; one product Z'R with the residuals of all of them tests
the optimality conditions of the columns outside: for each block g, the dual norm of Z_g'R/m is at
most alpha. The solutions before the first violation are final. The violating blocks join J, the
largest violation first, and the path goes on from the last final solution. At most `FEW` columns
are all in the working set, and Z'Z is formed once for all targets.

Iterative kernels solve roughly first, which suffices to extend J, unless few of it are in use.

The square-root loss has the optimality conditions of the squares at the penalty t = a rho/y, rho
the residual's rms (Sun and Zhang, Biometrika 99 (2012) 879-898): `_root_path` solves for t. Huber's
loss is squares on the rows within its knot, by turns (`outliers`).
Sources: Johnson and Guestrin, "Blitz: a principled meta-algorithm for scaling sparse optimization"
(ICML 2015).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sparsefit.arrays import Array, IntArray
from sparsefit.regression.design import Design
from sparsefit.regression.group_penalties import GroupNorms
from sparsefit.regression.losses import SQUARES, RootSquares
from sparsefit.regression.penalties import AbsoluteValues, BoundedValues, Penalty, SquaredNorm
from sparsefit.solvers.descent import descent_path
from sparsefit.solvers.kernels import (
    BEGIN,
    DESCENDED,
    KERNELS,
    ROUGH,
    STOP,
    Points,
    compiled,
    kernel_for,
    path_on_gram,
)
from sparsefit.solvers.newton import by_gradients
from sparsefit.solvers.outliers import outlier_path
from sparsefit.solvers.working_set import STORED, Columns, Growing, definite

FEW = 600  # columns, at most, that are all in the working set
START = 200  # columns of the first working set
SEVERAL = 4  # penalties at least, for which Z'Z of all columns is formed
AHEAD = 8  # penalties that are solved before the columns outside are tested
NEAR = 0.1  # groups whose dual norm exceeds (1 - NEAR) alpha join with those that violate
FEASIBLE = 3e-10  # relative excess of a dual norm over alpha that counts as rounding
SMALL = 2**22  # m k of sparse columns, at most, that are stored dense
SMALL_CLUSTERS = 2**16  # for cluster descent, whose sparse steps are cheap
DIRECT = 2500  # rows or columns, whichever are fewer, of which a ridge forms the products
BLOCK = 2**23  # entries of the columns that are summed at a time


def exact_path(
    design: Design, target: Array, penalty: Penalty, alphas: Array, cross: Array | None = None
) -> Points:
    """Solutions V (p, k, n), of columns of unit rms, at descending penalties alphas (p,).

    design Z (m, k), target Y (m, n); cross: Z'Y/m (k, n), where the caller has it already.
    """
    cross = design.correlate(target) if cross is None else cross
    if isinstance(penalty.loss, RootSquares):
        return _root_path(design, target, penalty, alphas, cross)
    if np.isfinite(penalty.loss.clip):
        return outlier_path(design, target, cross, penalty, alphas)
    if isinstance(penalty, SquaredNorm):
        return _ridge_path(design, target, penalty, alphas, cross)
    if not (isinstance(penalty, BoundedValues) and penalty.is_bounded):
        return _by_targets(design, target, penalty, alphas, cross)
    # Within its bounds the LASSO is the optimum, and its path the faster and better conditioned.
    free = AbsoluteValues(penalty.weights, ridge=penalty.ridge)
    points = _by_targets(design, target, free, alphas, cross)
    beyond = np.flatnonzero(np.isinf(penalty.norm(points.weights)))
    if len(beyond):
        bounded = _by_targets(design, target, penalty, alphas[beyond], cross)
        for name in ("weights", "complete", "steps"):
            getattr(points, name)[beyond] = getattr(bounded, name)
        points = replace(points, words=bounded.words)
    return replace(points, weights=penalty.prox(points.weights, 0.0))  # what rounding moved out


def _by_targets(
    design: Design, target: Array, penalty: Penalty, alphas: Array, cross: Array
) -> Points:
    """The path with the loss of squares, target by target where nothing couples these."""
    targets = target.shape[1]
    alone = targets == 1 or not penalty.coupled
    if type(penalty) is GroupNorms and alone and np.bincount(penalty.groups).max() == 1:
        # Norms of one number are absolute values.
        penalty = AbsoluteValues(penalty.weights[penalty.groups], ridge=penalty.ridge)
    parts = [slice(None)] if penalty.coupled else [slice(t, t + 1) for t in range(targets)]
    plain = type(penalty) is AbsoluteValues and np.ptp(penalty.weights) == 0.0 and design.in_memory
    some = len(alphas) < SEVERAL or len(cross) > FEW // 2  # else most columns enter
    grows = plain and some and len(cross) <= FEW and compiled("homotopy")
    source = Growing(design) if grows else design
    solved = [_along(source, target[:, part], penalty, alphas, cross[:, part]) for part in parts]
    if len(solved) == 1:
        return solved[0]
    return Points(
        np.concatenate([points.weights for points in solved], axis=2),
        np.all([points.complete for points in solved], axis=0),
        np.sum([points.steps for points in solved], axis=0),
        solved[0].words,
    )


def _along(
    source: Design | Growing, target: Array, penalty: Penalty, alphas: Array, cross: Array
) -> Points:
    """The path of targets (m, q) whose blocks span all of them; cross Z'Y/m (k, q)."""
    design = source.design if isinstance(source, Growing) else source
    k, count = len(cross), len(alphas)
    level = float(np.sqrt(np.einsum("iq,iq->", target, target) / design.samples))
    if level == 0.0 or not cross.any():
        return Points.zeros(count, cross, "zero")
    if isinstance(penalty, AbsoluteValues) and _descends(design, penalty):
        weights, complete, steps = descent_path(design, target[:, 0], cross[:, 0], penalty, alphas)
        return Points(weights[:, :, None], complete, steps, "descent")
    # Not on whether Z'Z was formed already: solutions depend on the data alone.
    if isinstance(source, Growing):
        return path_on_gram(source, cross, penalty, alphas, level**2)
    few = FEW if count >= SEVERAL else START // 8
    if k <= few or penalty.restricted(np.arange(1)) is None:
        return path_on_gram(design.gram, cross, penalty, alphas, level**2)
    own = penalty.in_units(level)
    points = _with_working_set(design, target / level, cross / level, own, alphas / level)
    return replace(points, weights=points.weights * level)


def _descends(design: Design, penalty: Penalty) -> bool:
    """Whether the LASSO goes by coordinate descent on sparse columns: supports may be large."""
    large = design.kind == "sparse" and min(design.shape) > FEW and design.csc.nnz < 2**31
    return large and type(penalty) is AbsoluteValues and bool(compiled("sweeps"))


def _with_working_set(
    design: Design, target: Array, cross: Array, penalty: Penalty, alphas: Array
) -> Points:
    """The path of a target of unit rms, |Y|^2/m = 1, by working sets."""
    (k, q), count, m = cross.shape, len(alphas), design.shape[0]
    name, pull = kernel_for(penalty, q), penalty.block_dual_norms(cross).max(axis=-1)
    if len(pull) <= penalty.units.max():  # a norm of all columns
        pull = np.abs(cross).max(axis=1)
    start = START if k > FEW else START // 8
    index = _leading(penalty.units, np.argsort(-pull, kind="stable"), start)
    # Sparse columns stay so, but few entries are faster dense.
    stays = design.kind == "sparse" and m * k > (
        SMALL_CLUSTERS if name == "cluster descent" else SMALL
    )
    store = None if stays else np.empty((min(k, STORED // m), m))
    whole = store is not None and len(store) == k
    rotations = () if name == "variational" and whole and k > FEW else None
    working = Columns(
        *(penalty, cross[:0], np.zeros((0, 0))), design=design, target=target, whole=penalty,
        index=index[:0], store=store, rotations=rotations,
    )  # fmt: skip
    points, new = Points.zeros(count, cross), index
    settled = 0 if rotations is None else AHEAD  # penalties that are not solved roughly first
    done, warm_starts = 0, {BEGIN: np.zeros((len(index), q))}
    while done < count:
        if len(new):
            size = len(working.index) + len(new)
            if rotations is not None and 3 * size > m:
                name = "block descent"
            by_gram = not whole or size <= {"block descent": m // 4, "newton": m}.get(name, size)
            if name == "cluster descent":  # which moves in sparse columns, too
                by_gram = not stays or size <= FEW or design.csc.nnz >= 2**31
            working = working.extended(new, cross, by_gram)
        here = alphas[done : done + (settled or AHEAD)]
        is_rough = not settled and size < k and name not in ("homotopy", "variational")
        goal = DESCENDED if name == "block descent" else STOP
        batch = KERNELS[name](working, here, warm_starts, ROUGH if is_rough else goal)
        here, is_rough = here[: len(batch.weights)], is_rough and not batch.complete.all()
        warm_starts |= dict(zip(here.tolist(), batch.weights, strict=True))
        near = 0.0 if name == "newton" else NEAR  # whose steps cost more with each column
        accepted, new = _violations(working, here, batch.weights, near)
        few = rotations is not None and 6 * int(batch.weights[-1].any(axis=1).sum()) <= size
        settled = 0 if len(new) else len(here) if is_rough else few * AHEAD
        until = done if is_rough else done + accepted
        points.weights[done:until, working.index] = working.unrotated(batch.weights[: until - done])
        points.complete[done:until] = batch.complete[: until - done]
        points.steps[done:until] = batch.steps[: until - done]
        done = until
        reached, rows = float(alphas[done - 1]) if done else BEGIN, np.zeros((len(new), q))
        warm_starts = {at: np.vstack([v, rows]) for at, v in warm_starts.items() if at <= reached}
    return replace(points, words=f"{name}, {len(working.index)} columns in play")


def _violations(
    working: Columns, alphas: Array, values: Array, near: float
) -> tuple[int, IntArray]:
    """Test the optimality conditions of the columns outside a working set.

    values (a, j, q): its solutions at alphas (a,). Returns the number of solutions before the first
    violation, and the columns to join, sorted: units that violate the conditions of the first three
    solutions with a violation, or whose dual norm there exceeds (1 - near) alpha.
    """
    (count, size, q), penalty, design = values.shape, working.whole, working.design
    k, units = design.shape[1], penalty.units
    flat = np.ascontiguousarray(values.transpose(1, 0, 2)).reshape(size, count * q)
    residual = np.tile(working.target, (1, count)) - working.fitted(flat)
    pulls = design.correlate(residual).T.reshape(count, q, k).swapaxes(1, 2)
    full = np.zeros(pulls.shape)
    full[:, working.index] = values
    points = zip(pulls, full, alphas.tolist(), strict=True)
    excess = np.array([penalty.violations(*point) for point in points])
    excess[:, units[working.index]] = -2.0
    objecting = np.flatnonzero((excess > FEASIBLE).any(axis=1))
    if not len(objecting):
        return count, np.zeros(0, dtype=np.intp)
    worst = excess[objecting[:3]].max(axis=0)
    order = np.argsort(-worst, kind="stable")[: np.count_nonzero(worst > (-near or FEASIBLE))]
    separate = type(penalty).violations is Penalty.violations
    most = 2 * size if near or not separate else size // 2
    return int(objecting[0]), _leading(units, order, max(most, START // 4))


def _leading(units: IntArray, order: IntArray, most: int) -> IntArray:
    """The columns, sorted, of the first units of an order: ``most``, but one unit at least."""
    sizes, joins = np.bincount(units), np.zeros(units.max() + 1, bool)
    last = int(np.searchsorted(np.cumsum(sizes[order]), most, side="right"))
    joins[order[: max(last, 1)]] = True
    return np.flatnonzero(joins[units])


def _ridge_path(
    design: Design, target: Array, penalty: Penalty, alphas: Array, cross: Array
) -> Points:
    """(G + mu I)^-1 Z'Y/m at each mu = alpha rho, by the smaller of Z'Z and Z Z'.

    Where both are large, or Z Z' would read a file many times, it is by conjugate gradients. Where
    these fail, penalties from there on are solved by a matrix of up to four times that size.
    """
    (m, k), square, right = design.shape, np.zeros((0, 0)), cross
    most, is_direct = min(m, k), k <= m or design.in_memory or design.kind == "sparse"
    is_direct = is_direct and most <= DIRECT
    points = Points.zeros(len(alphas), cross, "conjugate gradients")
    values, points.steps[:] = np.zeros(cross.shape), 1
    for i, alpha in enumerate(alphas.tolist()):
        mu = alpha * penalty.ridge
        if not is_direct:

            def times(v: Array, mu: float = mu) -> Array:
                return design.correlate(design.predict(v)) + mu * v

            values, points.steps[i], is_solved = by_gradients(times, cross, values)
            points.weights[i], points.complete[i] = values, is_solved
            is_direct = not is_solved and most <= 4 * DIRECT
            if not is_direct:
                continue
        if not len(square):
            square, right = (design.gram, cross) if k <= m else (_row_products(design), target)
        shifted = square.copy()
        shifted.flat[:: len(square) + 1] += mu
        solved = definite(shifted, right)
        points.complete[i] = solved is not None
        if solved is None:  # alpha is lost beside G in rounding: the least squares of least norm
            solved = np.asarray(np.linalg.lstsq(square, right, rcond=None)[0])
        points.weights[i] = solved if k <= m else design.correlate(solved)
    return replace(points, words="cholesky") if is_direct else points


def _row_products(design: Design) -> Array:
    """Z Z'/m (m, m), from some columns at a time."""
    (m, k), step = design.shape, max(BLOCK // design.shape[0], 1)
    square = np.zeros((m, m))
    for start in range(0, k, step):
        columns = design.columns(np.arange(start, min(start + step, k)))
        square += columns @ columns.T
    return square / design.samples


NEAREST = 1e-11  # of the largest penalty: the smallest t that is tried,
DESCENT = 1e-3  # or by descent, which takes minutes to fit exactly: points below are incomplete
SETTLED = 1e-11  # relative excess of t^2 that ends the search
ROUNDING = 1e-15  # of (y + |V|_1)^2: what rho^2 from Z'Z may be off by, which ends it too
ROUNDS = 60  # of which a tenth may go by before squares that cannot be solved end a search


def _root_path(
    design: Design, target: Array, penalty: Penalty, alphas: Array, cross: Array
) -> Points:
    """The points by a safeguarded search for each root x = t^2 of x = (alpha/y)^2 rho^2(t).

    t/rho(V(t)) does not decrease in t, and between events rho^2 is linear in t^2, so that secants
    end once the events are right. A bracket keeps them safe. Below some penalty an optimum fits the
    data exactly, and is the limit for t -> 0: tried where no root is known above, or no residual
    seems to remain. Of all answers that with the least objective is returned.
    """
    level = float(np.sqrt(np.einsum("iq,iq->", target, target) / design.samples)) or 1.0
    inner, slope = replace(penalty, loss=SQUARES), (alphas / level) ** 2
    points, words = Points.zeros(len(alphas), cross), "zero"
    largest = float(penalty.dual_norm(cross).max())
    nearest = DESCENT if _descends(design, inner) else NEAREST
    least, is_open = (nearest * largest) ** 2, np.full(len(alphas), bool(cross.any()))
    x = np.maximum(np.minimum(alphas, largest) ** 2, least)
    low, high, last, before = np.full(len(x), least), x.copy(), x.copy(), np.zeros(len(x))
    lowest, is_tried = np.full(len(x), np.inf), np.zeros(len(x), bool)
    for count in range(ROUNDS):
        at = np.flatnonzero(is_open)
        at = at[np.argsort(-x[at], kind="stable")]
        if not len(at):
            break
        squares, here = exact_path(design, target, inner, np.sqrt(x[at]), cross=cross), x[at]
        values, words, solved = squares.weights, squares.words, squares.complete
        points.steps[at] += squares.steps.sum()
        misfit = np.array([np.square(target - design.predict(v)).sum() for v in values])
        misfit /= design.samples
        objective = level * np.sqrt(misfit) + alphas[at] * penalty.norm(values)
        better = objective <= lowest[at] * (1.0 + SETTLED)
        points.weights[at[better]] = values[better]
        lowest[at] = np.minimum(objective, lowest[at])
        excess, off = (
            here - slope[at] * misfit,
            ROUNDING * (level + np.abs(values).sum(axis=(1, 2))) ** 2,
        )
        is_tried[at] |= here <= least
        high[at] = np.where(excess >= 0, here, high[at])
        low[at] = np.where(excess <= 0, here, low[at])
        rise = np.where(here != last[at], excess - before[at], 1.0)
        rise /= np.where(here != last[at], here - last[at], 1.0)
        secant = here - excess / np.where(rise > 0, rise, np.nan)
        last[at], before[at] = here, excess
        hidden = (misfit <= 2.0 * off) & ~is_tried[at]  # perhaps no residual remains
        is_near = (np.abs(excess) <= SETTLED * here) | (
            (np.abs(excess) <= slope[at] * off) & ~hidden
        )
        # No slope, which at a bend is of no use, leads below where the root is known to be above.
        beyond = ~is_tried[at] & (hidden | (secant <= least))
        inside = (secant > low[at]) & (secant < high[at])
        x[at] = np.where(inside, secant, np.sqrt(low[at]) * np.sqrt(high[at]))
        x[at] = np.where(beyond, least, x[at])
        gone = (here <= least) & (excess >= 0)
        narrow = (high[at] <= low[at] * (1.0 + SETTLED)) | ~solved & (10 * count >= ROUNDS)
        points.complete[at] = (is_near | narrow) & ~gone & solved
        is_open[at] = ~(is_near | narrow | gone)
    return replace(points, words=f"root of the scaled path; {words}")
