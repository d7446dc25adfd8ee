"""The tests that make an estimate ``ok``, in order; the first that fails is the verdict."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from sparsefit.estimator.estimate import PARAMETERS, Doubt, ScaleEstimate, Verdict
from sparsefit.estimator.measure import Measured
from sparsefit.estimator.prepare import RESOLVED, Prepared
from sparsefit.likelihood.causes import FREEDOMS, Suspect, two_digits, unit_of
from sparsefit.likelihood.diagnosis import FALSE_ALARM, usable

ONE_WAY = 0.03  # of the largest variance of gusts: that across the direction of a missing wave
DISAGREES = 0.2  # largest relative rms difference of displacements by position and velocity
MORE = "more than noise is left"
UNITS = {  # by the displacement of positions over that of velocities
    1000.0: "the position may be in mm",
    100.0: "the position may be in cm",
    3.2808: "the position may be in feet",
    1.0 / 1.9438: "the velocity may be in knots",
    1.0 / 2.2369: "the velocity may be in miles/h",
    1.0 / 3.2808: "the velocity may be in feet/s",
    1.0 / 3.6: "the velocity may be in km/h",
    0.01: "the velocity may be in cm/s",
    0.001: "the position may be in km, or the time in ms",
}


def unidentifiable(doubt: Doubt, words: str) -> Verdict:
    """The verdict of a flow that the log does not determine."""
    return Verdict("unidentifiable", words, doubt)


def misfit(words: str) -> Verdict:
    """The verdict of a flow, vehicle or log that differs from the model."""
    return Verdict("misfit", words, Doubt.MISFIT)


def doubts_of_logs(prepared: Prepared, free: tuple[str, ...] | str) -> Iterator[Verdict]:
    """Verdicts before a flow is searched for; free: as in `doubts_of_flow`."""
    pairs = zip(prepared.parts, prepared.vehicles, strict=True)
    phi = np.concatenate([own.flow_velocity(vehicle) for own, vehicle in pairs])
    if (samples := len(phi)) <= 20:  # too few to estimate their noise
        yield unidentifiable(
            Doubt.FEW_SAMPLES,
            f"{samples} samples are too few for the unknowns of a flow; fly longer, or sample "
            "faster",
        )
    speed = max(float(np.abs(own.velocity).max()) for own in prepared.parts)
    if float(np.abs(phi - phi.mean(axis=0)).max()) <= 1e-6 * speed:  # smoothing errs by 1e-9
        yield unidentifiable(Doubt.STILL_AIR, "no cellular flow detected: the air is still")
    for number, ways in prepared.ways.items():
        latency, share = prepared.latencies[number - 1], ways.apart()
        if share > DISAGREES and not latency:
            size = f"{100 * share:.0f} % of" if share < 10 else "more than 10 times"
            words = (
                f"the logged velocity is not that of the logged position: they are {size} the "
                "motion apart; check units, axes and time stamps"
            )
            words = _farther(ways.ratio) if ways.parallel else words
            yield unidentifiable(Doubt.DISAGREEMENT, f"{_of_flight(prepared, number)}{words}")
        elif share > DISAGREES and not (free == "auto" or "latency" in free):
            yield _too_late(_of_flight(prepared, number), latency)


def doubts_of_flow(
    prepared: Prepared,
    result: Measured | None,
    scales: Sequence[ScaleEstimate],
    precision: float,
    free: tuple[str, ...] | str,
) -> Iterator[Verdict]:
    """Verdicts on a flow that was measured.

    Args:
        prepared: the flights.
        result: the flow at the maximum of its likelihood; None where no flow was proposed.
        scales: its estimates, fastest first.
        precision: the largest half-width of an interval, as a share of the value.
        free: names freed by the estimator's settings, or "auto".
    """
    grid, drift = prepared.library.grid, np.zeros(2)
    if result is not None:
        drift += result.posterior.model.pattern.drift
    track = np.concatenate([own.position - own.time[:, None] * drift for own in prepared.parts])
    extent = float(np.ptp(track, axis=0).max())
    if extent < grid.lower:
        yield unidentifiable(
            Doubt.SHORT_TRACK,
            f"the flight covers {extent:.2g} m, less than the shortest length scale of the search, "
            f"{grid.lower:g} m; check the units, fly farther, or lower the grid's bounds",
        )
    least = min((scale.length_scale for scale in scales), default=grid.lower)
    for number in prepared.too_fast(least):
        moved = prepared.strides[number - 1]
        rate = moved / least / float(np.median(np.diff(prepared.parts[number - 1].time)))
        yield unidentifiable(
            Doubt.UNDERSAMPLED,
            f"{_of_flight(prepared, number)}the flight moves {moved:.3g} m from sample to sample, "
            f"too far to follow a length scale of {least:.3g} m; sample at {RESOLVED * rate:.3g} "
            "Hz or more, or check the units of the log",
        )
    seen = [*free, *result.freed, *(own.free for own in result.suspects)] if result else free
    for number, latency in enumerate(prepared.latencies, 1):
        if latency and "latency" not in seen:  # determined by the log alone
            yield _too_late(_of_flight(prepared, number), latency)
    if result is None or not result.detected:
        alone = "; estimate each flight alone: frames or units may differ"
        others = alone if len(prepared.flights) > 1 else ""
        for number, ways in prepared.ways.items():
            if ways.scaled:
                others = f"; {_of_flight(prepared, number)}{_farther(ways.ratio)}"
        yield unidentifiable(
            Doubt.NO_FLOW,
            f"no cellular flow detected: no waves of {grid.lower:g} to {grid.upper:g} m explain "
            f"more than chance and turbulence do, at 1000 to 1 against a false alarm{others}",
        )
        return
    posterior, goodness, best = result.posterior, result.goodness, scales[0]
    if not usable(posterior):
        yield Verdict("inaccurate", posterior.reason)
    for length in math.sqrt(2) * math.pi / np.hypot(*result.waves[:, :2].T):
        if not 0.99 * grid.lower <= length <= 1.01 * grid.upper:
            yield unidentifiable(
                Doubt.EDGE,
                f"a length scale is at the edge of the search, {length:.3g} m; widen the grid's "
                "bounds",
            )
    tau = posterior.value("response_time")
    if not tau > 0:
        yield unidentifiable(
            Doubt.VEHICLE,
            f"the response time that fits best is {tau:.3g} s; fly longer, or give the response "
            "time",
        )
    period = 2 * best.length_scale
    if not extent < period:  # a shorter track determines no misfit
        units = [own for own in result.diagnosis.suspects if _unit(prepared, own)]
        if (suspects := [*result.suspects, *units]) and free != "auto":
            first = suspects[0]
            where = f" of flight {first.flight}" if first.flight else ""
            remedy = f"; {first.remedy}" if first.free else ""
            yield misfit(f"{MORE}{where}: {first.words}{remedy}{_unit(prepared, first)}")
        wanders = [own.name for own in posterior.model.processes]
        if free == "auto" and wanders:
            asked = prepared.library.unknown
            freed = [name for name in result.freed if name in FREEDOMS and name not in asked]
            constants = ", ".join(name for name in freed if not FREEDOMS[name].wanders)
            others = " and ".join(FREEDOMS[name].name.replace("-", " ") for name in wanders)
            if constants:
                yield misfit(
                    f"{MORE} beside {constants}: {others}; what is wrong may be none of these: "
                    "correct the vehicle or the log, or name what to free"
                )
        shares = [own.r_squared for own in goodness.flights]
        if shares and min(shares) < 0.8 < max(shares):
            yield misfit(
                f"{MORE} of flight {1 + shares.index(min(shares))}: it tells another flow than the "
                "other flights: its vehicle, frame or time may be another; leave it out"
            )
        residual = result.proposal.residual  # of rows, outliers included
        if residual > 0.5 and not (goodness.r_squared > 0.9 and goodness.whiteness > 1e-3):
            yield misfit(
                f"the fit explains only {100 * (1 - residual):.0f} % of the flow velocity: the "
                "flow is another, or hardly steady"
            )
        if goodness.turbulence_share > 0.5:  # as strong as the cells, whose rms is U0/2
            yield misfit(
                f"{MORE}: turbulence of {goodness.turbulence:.2g} m/s, "
                f"{100 * goodness.turbulence_share:.2g} % of U0, and hardly any steady cells"
            )
        # A position that jumps wanders, in steps that are not white.
        tested = {*wanders} <= {"turbulence"} and not (posterior.exact or posterior.pushed)
        if tested and not goodness.whiteness >= FALSE_ALARM:
            yield misfit(
                f"{MORE}: innovations are not white (p = {goodness.whiteness:.1g}), and no cause "
                "explains it"
            )
        chance, number, time = posterior.constancy if tested else (1.0, 0, 0.0)
        if chance < FALSE_ALARM:
            yield misfit(
                f"{_of_flight(prepared, number)}{MORE}: the flow before t = {time:.3g} s seems "
                f"another than after it (p = {chance:.1g})"
            )
        isotropy = [min([own.isotropy for own in model.processes], default=1.0)
                    for model in posterior.models]  # fmt: skip
        if min(isotropy) < ONE_WAY:
            where = _of_flight(prepared, 1 + isotropy.index(min(isotropy)))
            yield misfit(
                f"{where}{MORE}: gusts of one direction, as of waves that no shape here has"
            )
    strength = np.hypot(*result.waves[:, :2].T) * np.hypot(*result.waves[:, 2:4].T)
    roll = len(strength) == 2 and strength.min() < 0.5 * strength.max()
    if roll or (len(strength) != 2 and len(scales) < 2):
        yield unidentifiable(
            Doubt.NO_CELLS,
            f"{len(strength)} waves make no cells of one flow or two, equally strong: only the "
            "flow itself is told; fly longer",
        )
    if result.rival is not None:
        rival = result.rival
        yield unidentifiable(
            Doubt.RIVAL,
            f"cannot tell a flow of {best.mean_velocity:.3g} m/s and {best.length_scale:.3g} m "
            f"from {rival.cells.mean_velocity:.3g} m/s and {rival.cells.length_scale:.3g} m (shape "
            f"{rival.shape!r}): the flight covers {prepared.search.extent:.3g} m, or too "
            "straight a line; fly longer, across more cells, or turn",
        )
    for place, scale in enumerate(scales):  # all values are finite, the first within precision
        widths = {
            name: (high - low) / 2 / abs(getattr(scale, name))
            for _, name, _ in PARAMETERS
            for low, high in [getattr(scale.uncertainty, f"{name}_interval")]
        }
        worst = max(widths, key=lambda name: widths[name])
        quantity = f"the {worst.replace('_', ' ')}"
        if not math.isfinite(widths[worst]):
            words = f"the flight does not tell {quantity} at all; fly across more cells"
            yield unidentifiable(Doubt.IMPRECISE, words)
        if place == 0 and widths[worst] > precision:
            several = f"{', '.join(result.freed)} may stand for another cause: name what to free, "
            yield unidentifiable(
                Doubt.IMPRECISE,
                f"{quantity} is known only to +-{two_digits(100 * widths[worst])} %; "
                f"{several if free == 'auto' and len(result.freed) > 1 else ''}"
                "fly longer, across more cells, or ask for less (readout precision)",
            )
    if extent < period:
        yield unidentifiable(
            Doubt.SHORT_TRACK,
            f"the flight covers {extent:.3g} m, less than one period of the flow, {period:.3g} m; "
            "fly farther",
        )
    if not posterior.converged:
        yield Verdict("inaccurate", posterior.reason)


def _too_late(where: str, latency: float) -> Verdict:
    """The misfit of a log whose position or velocity is late [s]."""
    late = Suspect("latency", (latency,), 0.0, math.inf, "latency")
    return misfit(f"{where}{late.words}; shift its times, or {late.remedy}")


def _unit(prepared: Prepared, suspect: Suspect) -> str:
    """The words for a suspect that is off by the ratio of two units."""
    tau, *_, x, y, _ = prepared.vehicles[max(suspect.flight, 1) - 1].parameters
    return suspect.unit(tau, complex(x, y))


def _farther(ratio: float) -> str:
    """The words for positions that move `ratio` times as far as velocities."""
    unit = unit_of(ratio, UNITS)
    return (
        f"the logged position moves {float(f'{ratio:.3g}'):g} times as far as the logged velocity "
        f"says; check the units of position, velocity and time{unit and ': '}{unit}"
    )


def _of_flight(prepared: Prepared, number: int) -> str:
    """The prefix of a reason that concerns one of several flights."""
    return f"flight {number}: " if len(prepared.flights) > 1 else ""
