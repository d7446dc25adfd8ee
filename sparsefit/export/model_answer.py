"""The answers of the exported C's model: what `sf_estimate` says after any sample of a flight."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from sparsefit.arrays import Array, IntArray
from sparsefit.export.model import GENERATED, Sums, Tuning, sums_at
from sparsefit.export.model_choice import Choice, heaviest, lasso, stlsq
from sparsefit.export.model_scale import (
    ScaleFit,
    ScalePlace,
    descend,
    explained,
    least_squares,
    left_of,
)
from sparsefit.export.plan import Plan
from sparsefit.flight import Flight

LOBES = 3  # minima of the residual on the grid that are descended into
STATUS = ("ok", "unidentifiable")
DOUBTS = (
    *("", "few-samples", "no-flow", "edge", "coarse", "rival", "short-track", "dependent"),
    *("no-weights", "imprecise"),
)
"""The doubts of the C, in the order of its enumeration."""


@dataclass(frozen=True)
class Answer:
    """What `sf_estimate` tells after a sample (counted from 0).

    rows: taken so far; doubt: one of `DOUBTS`, empty where the status is ok; the length scales [m]
    and U0 [m/s] are NaN where there are none, the rival 0; length_scale_error: the standard error
    of a length scale off the grid [m]; unexplained: the share of |Phi|^2 that is left;
    certificate: of the back-end, NaN where it has none.
    """

    sample: int
    rows: int
    doubt: str
    refined: bool = False
    mean_velocity: float = math.nan
    length_scale: float = math.nan
    grid_length_scale: float = math.nan
    rival: float = 0.0
    length_scale_error: float = math.nan
    unexplained: float = math.nan
    certificate: float = math.nan

    @property
    def status(self) -> str:
        """``ok`` or ``unidentifiable``."""
        return STATUS[bool(self.doubt)]

    @property
    def timescale(self) -> float:
        """tau_w = L/U0 [s]."""
        return self.length_scale / self.mean_velocity


def answers(
    plan: Plan,
    flight: Flight,
    at: IntArray,
    tuning: Tuning = GENERATED,
    origin: tuple[float, float] = (0.0, 0.0),
) -> Iterator[Answer]:
    """The answers after each of some samples of a flight, ascending, asked for in this order."""
    weights = np.zeros((plan.columns, 2))
    for sample, sums in sums_at(plan, flight, at, tuning, origin):
        begun = Answer(sample, sums.rows, "few-samples")
        if sums.rows < tuning.minimum_rows:
            yield begun
            continue
        if not sums.square > 0:
            yield replace(begun, doubt="no-flow")
            continue
        choice = chosen(plan, sums, weights, tuning)
        weights = choice.weights
        begun = replace(begun, certificate=choice.certificate)
        if choice.scale is None:
            yield replace(begun, doubt="no-weights")
        else:
            yield (_refined(plan, sums, begun) if plan.refined else _on_grid(plan, choice, begun))


def chosen(plan: Plan, sums: Sums, weights: Array, tuning: Tuning) -> Choice:
    """The scale that the back-end weighs most, from the weights (k, 2) of the answer before."""
    if not plan.columns:
        best = least_of(plan, sums)
        return Choice(best, weights, math.nan, sums)
    solve = lasso if plan.backend.name == "lasso" else stlsq
    found, certificate = solve(plan, sums, weights, tuning.sweeps)
    scale = heaviest(found, plan.estimator.readout.length_scale)
    return Choice(scale, found, certificate, sums)


def residuals(plan: Plan, sums: Sums) -> Array:
    """What the 8 columns of each scale leave of |Phi|^2 (g,)."""
    left = sums.square - explained(sums.scales[:, 0], plan.floor)
    return np.maximum(left, plan.rounding * sums.square)


def least_of(plan: Plan, sums: Sums) -> int:
    """The scale that leaves least."""
    return int(residuals(plan, sums).argmin())


def deepest(plan: Plan, sums: Sums) -> list[int]:
    """The deepest minima of the residual on the grid, deepest first."""
    left = residuals(plan, sums)
    around = np.concatenate([[sums.square], left, [sums.square]])
    minima = np.flatnonzero((left < around[:-2]) & (left <= around[2:]))
    order = np.argsort(left[minima], kind="stable")
    lobes: list[int] = minima[order][:LOBES].tolist()
    return lobes


def exceeds(plan: Plan, worse: float, better: float, rows: float, limit: float) -> bool:
    """Whether 2 ln(likelihood ratio) of two residuals exceeds a limit."""
    return 2.0 * rows * math.log(worse / better) > limit * plan.correlation


def _told(plan: Plan, sums: Sums, fit: ScaleFit, answer: Answer) -> Answer:
    left = left_of(plan, sums.square, fit.explained)
    wind = max(sums.left_by_wind, plan.rounding * sums.square)
    detected = exceeds(plan, wind, left, sums.weight, plan.detection)
    return replace(
        answer,
        mean_velocity=fit.mean_velocity,
        unexplained=left / sums.square,
        doubt="" if detected else "no-flow",
    )


def _short(plan: Plan, sums: Sums, fit: ScaleFit, length_scale: float) -> str:
    if not fit.pivot > plan.safe:
        return "dependent"
    return "short-track" if sums.extent < 2.0 * length_scale else ""


def _on_grid(plan: Plan, choice: Choice, answer: Answer) -> Answer:
    sums = choice.sums
    assert choice.scale is not None
    scale = float(plan.scales[choice.scale])
    fit = least_squares(sums.scales[choice.scale, 0], plan.floor)
    answer = replace(answer, length_scale=scale, grid_length_scale=scale)
    answer = _told(plan, sums, fit, answer)
    return answer if answer.doubt else replace(answer, doubt=_short(plan, sums, fit, scale))


def _refined(plan: Plan, sums: Sums, answer: Answer) -> Answer:
    lobes = deepest(plan, sums)
    if not lobes:
        return replace(answer, doubt="no-flow")
    places = [(lobe, descend(plan, sums, lobe)) for lobe in lobes]
    # A later lobe has to be better, not as good: as the C goes through them.
    order = sorted(range(len(places)), key=lambda i: places[i][1].left)
    (lobe, best), others = places[order[0]], [places[i][1] for i in order[1:]]
    below = [other for other in others if other.left < sums.square]
    scale = math.pi / best.k
    answer = replace(
        answer,
        refined=not best.doubt,
        length_scale=scale,
        grid_length_scale=float(plan.scales[lobe]),
        rival=math.pi / below[0].k if below else 0.0,
        length_scale_error=scale * best.error / best.k,
    )
    answer = _told(plan, sums, best.fit, answer)
    if answer.doubt:
        return answer
    return replace(answer, doubt=_doubt(plan, sums, best, below))


def _doubt(plan: Plan, sums: Sums, best: ScalePlace, others: list[ScalePlace]) -> str:
    rival = others[0].left if others else sums.square
    if best.doubt:
        return best.doubt
    if not exceeds(plan, rival, best.left, sums.weight, plan.distinct):
        return "rival"
    if 2.0 * best.error > plan.precision * best.k:
        return "imprecise"
    return _short(plan, sums, best.fit, math.pi / best.k)
