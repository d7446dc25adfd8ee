"""Whether a flight tells its flow, and why not, as a pilot would say it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sparsefit.derivative import Samples
from sparsefit.estimator.assess import Reading
from sparsefit.estimator.doubt import Doubt, Verdict
from sparsefit.estimator.estimate import ScaleEstimate
from sparsefit.estimator.judge_flights import disagreeing, of_any, still, too_coarse
from sparsefit.estimator.misfit import misfit
from sparsefit.estimator.shaped import outside
from sparsefit.library.scan import extent_of
from sparsefit.modes.choice import Ladder
from sparsefit.modes.located import Located
from sparsefit.modes.rung import Rung
from sparsefit.modes.space import FALSE_ALARM, SearchSpace
from sparsefit.uncertainty import LAGS, Goodness

TRACE = 1e-3  # of |Phi|^2: what is left of a flow without noise is what differences do to it


def judge(
    located: Located,
    scales: Sequence[ScaleEstimate],
    flights: Sequence[Samples],
    goodness: Goodness | None = None,
    *,
    precision: float | None,
    climbed: bool = False,
    unknown: tuple[str, ...] = (),
) -> Verdict | None:
    """The first reason not to believe modes off the grid; None where there is none.

    Args:
        located: the modes and their rivals.
        scales: the estimates of the modes, fastest first.
        flights: the samples of each.
        goodness: of the fit, where it is known.
        precision: the largest share of a value that its interval may reach to either side; None
            where no standard errors were asked for.
        climbed: whether other shapes than steady cells along the axes were tried.
        unknown: what the library has freed beside the flow.
    """
    short = _short(located.space.extent, scales, goodness)
    return (
        still(located.space, flights)
        or disagreeing(flights)
        or _few(located)
        or _undersampled(located, flights)
        or _undetected(located, climbed=climbed)
        or _at_edge(located)
        or _left_over(located)
        or (misfit(goodness, unknown) if short is None else None)
        or _mistaken(located)
        or imprecise(scales, precision)
        or short
    )


def imprecise(scales: Sequence[ScaleEstimate], precision: float | None) -> Verdict | None:
    """Whether a value is known too poorly.

    Every value must be told at all, and those of the fastest flow well; a weak flow beside it may
    be known less well, as its intervals say.
    """
    if precision is None:
        return None
    for place, scale in enumerate(scales):
        known = scale.uncertainty
        if known is None:
            if len(scales) == 1:  # `_few` has counted the samples
                return None
            words = "too few samples for a standard error; fly longer, or sample faster"
            return Verdict.against(Doubt.FEW_SAMPLES, words)
        if not place or not math.isfinite(known.mean_velocity + known.length_scale):
            values = scale.mean_velocity, scale.length_scale, scale.timescale
            wide = known.wide(values, precision)
            if wide:
                return Verdict.against(Doubt.IMPRECISE, wide)
    return None


def _few(located: Located) -> Verdict | None:
    """Of fewer values of Phi than this nothing is known of their errors."""
    samples = len(located.space.rows.target)
    unknowns = located.space.parameters * len(located.candidates)
    if samples > max(LAGS, unknowns if len(located.candidates) > 1 else 0):
        return None
    words = f"{samples} samples are too few for the {unknowns} unknowns of "
    words += "a length scale" if len(located.candidates) == 1 else "the length scales"
    return Verdict.against(Doubt.FEW_SAMPLES, f"{words}; fly longer, or sample faster")


def _undersampled(located: Located, flights: Sequence[Samples]) -> Verdict | None:
    """A scale that is told must be resolved; where none is, the least one that was searched."""
    lower = math.pi / located.space.bounds[1]
    least = math.pi / float(located.wavenumbers.max()) if located.identifiable else lower
    return of_any(flights, lambda samples: too_coarse(samples, least, lower))


def _undetected(located: Located, *, climbed: bool) -> Verdict | None:
    if located.detected:
        return None
    axes, other = " along the axes", "; cells that are turned, stretched or drift are for refine = "
    words = f"no cellular flow{'' if climbed else axes} detected: no length scale explains more "
    words += f"than a uniform wind does, at {1 / FALSE_ALARM:.0f} to 1 against a false alarm"
    return Verdict.against(Doubt.NO_FLOW, words if climbed else f'{words}{other}"ladder"')


def _at_edge(located: Located) -> Verdict | None:
    if math.isnan(located.edge):
        return None
    which = "the best" if len(located.candidates) == 1 else "a"
    return Verdict.against(
        Doubt.EDGE,
        f"{which} length scale is at the edge of the search, {math.pi / located.edge:.3g} m; "
        "widen the grid's bounds",
    )


def _short(
    extent: float, scales: Sequence[ScaleEstimate], goodness: Goodness | None
) -> Verdict | None:
    """Whether the flight covers less than one period, 2 L, of the fastest flow.

    A fit that leaves nothing but truncation is no chance.
    """
    period = 2 * scales[0].length_scale
    if not extent < period or (goodness and goodness.exact):
        return None
    words = f"the flight covers {extent:.3g} m, less than one period of the flow, {period:.3g} m"
    return Verdict.against(Doubt.SHORT_TRACK, f"{words}; fly farther")


def _left_over(located: Located) -> Verdict | None:
    if math.isnan(located.left_over):
        return None
    return Verdict.against(
        Doubt.LEFT_OVER,
        f"another flow is left, of {math.pi / located.left_over:.3g} m, that the back-end did "
        "not propose",
    )


def _mistaken(located: Located) -> Verdict | None:
    """Whether a mode could be its rival."""
    if located.rival is None:
        return None
    scale, other = (math.pi / k for k in (located.rival.mode_wavenumber, located.rival.wavenumber))
    if located.beaten:
        words = f"{other:.3g} m fits better than {scale:.3g} m, and the back-end did not propose it"
        return Verdict.against(Doubt.BEATEN, words)
    if located.distinct:
        return None
    extent = located.space.extent
    short = f", less than one cell of {scale:.3g} m" if extent < scale else ""
    return Verdict.against(
        Doubt.RIVAL,
        f"cannot tell {scale:.3g} m from {other:.3g} m: the flight covers {extent:.3g} m{short}, "
        "or too straight a line; fly farther, or turn",
    )


def judge_shape(
    ladder: Ladder,
    reading: Reading,
    space: SearchSpace,
    flights: Sequence[Samples],
    precision: float,
    unknown: tuple[str, ...] = (),
) -> Verdict | None:
    """The first reason not to believe waves, or a shape other than steady cells along the axes."""
    short = _short(_swept(flights, reading), reading.scales, reading.goodness)
    return (
        disagreeing(flights)
        or _no_waves(ladder, space, flights)
        or _unresolved(ladder, space, flights)
        or (misfit(reading.goodness, unknown) if short is None else None)
        or _more(ladder)
        or rivalled(ladder)
        or _uneven(ladder, reading)
        or _unsure(reading.scales, precision)
        or short
    )


def _swept(flights: Sequence[Samples], reading: Reading) -> float:
    """The extent [m] of the flights through the pattern, which may drift."""
    cells = reading.shaped.cells if reading.shaped else None
    drift = np.array(cells.drift if cells else (0.0, 0.0))
    every = [samples.position - samples.time[:, None] * drift for samples in flights]
    return extent_of(np.concatenate(every))


def _no_waves(ladder: Ladder, space: SearchSpace, flights: Sequence[Samples]) -> Verdict | None:
    calm = still(space, flights)
    if calm is not None:
        return replace(calm, reason="no flow detected: the air is still")
    if ladder.evidence <= ladder.chance:
        words = "no cellular flow detected: no waves explain more than chance does"
        return Verdict.against(Doubt.NO_FLOW, words)
    return None


def _unresolved(ladder: Ladder, space: SearchSpace, flights: Sequence[Samples]) -> Verdict | None:
    """Whether a wave is out of the bounds of the search, or too short for the samples."""
    edge, lower = outside(ladder, space.bounds), math.pi / space.bounds[1]
    if not math.isnan(edge):
        words = f"a wave of the flow has a length scale of {edge:.3g} m, outside the search"
        return Verdict.against(Doubt.EDGE, f"{words}; widen the grid's bounds")
    largest = float(np.hypot(*ladder.best.phases[:, :2].T).max())
    least = math.sqrt(2.0) * math.pi / largest
    return of_any(flights, lambda samples: too_coarse(samples, least, lower))


def _more(ladder: Ladder) -> Verdict | None:
    if ladder.quiet or ladder.left <= TRACE:
        return None
    words = f"more is left than noise beside the flow of shape {ladder.best.shape!r}"
    return Verdict.against(Doubt.LEFT_OVER, f"{words}: the flow is another")


def _uneven(ladder: Ladder, reading: Reading) -> Verdict | None:
    """Whether several waves are no two flows of cells, each with a U0 and an L of its own."""
    if ladder.best.shape != "several" or len(reading.scales) > 1:
        return None
    words = f"{len(ladder.best.phases)} waves make no cells of one flow or two, equally strong"
    return Verdict.against(Doubt.NO_CELLS, f"{words}: only the flow itself is told; fly longer")


def rivalled(ladder: Ladder | None) -> Verdict | None:
    """Whether another shape, or the same one elsewhere, explains the flight nearly as well."""
    if ladder is None or ladder.rival is None:
        return None
    if ladder.best.drifting != ladder.rival.drifting:
        return _too_short(ladder, ladder.rival)
    moving = "drifting" if ladder.best.drifting else "steady"
    words = f"cannot tell a {moving} flow of {_told(ladder.best)} from {_told(ladder.rival)}"
    return Verdict.against(Doubt.RIVAL, f"{words}; fly longer, across more cells")


def _too_short(ladder: Ladder, rival: Rung) -> Verdict:
    """A flight that does not tell a drift from other cells that stand."""
    steady, moving = map(_told, sorted((ladder.best, rival), key=lambda rung: rung.drifting))
    words = f"a flight of {np.ptp(ladder.rows.position[:, 2]):.3g} s is too short to tell whether "
    words += f"the flow drifts: {moving} if it does, {steady} if it stands"
    return Verdict.against(Doubt.RIVAL, f"{words}; fly longer, across more cells")


def _told(rung: Rung) -> str:
    return f"{rung.mean_velocity:.3g} m/s and {rung.length_scale:.3g} m (shape {rung.shape!r})"


def _unsure(scales: Sequence[ScaleEstimate], precision: float) -> Verdict | None:
    if scales[0].uncertainty is None:
        words = "too few samples for a standard error; fly longer, or sample faster"
        return Verdict.against(Doubt.FEW_SAMPLES, words)
    return imprecise(scales, precision)
