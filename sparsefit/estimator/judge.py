"""The checks that an estimate has to pass, in the order in which a pilot would ask them."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from sparsefit.estimator.doubt import Doubt, Verdict
from sparsefit.estimator.estimate import ScaleEstimate
from sparsefit.estimator.measure import FALSE_ALARM, Measured
from sparsefit.estimator.prepare import Prepared
from sparsefit.flight import Flight
from sparsefit.likelihood.causes import Cause, Suspect, usable
from sparsefit.likelihood.nodes import noise_of
from sparsefit.model.grid import extent_of
from sparsefit.rows import Samples

CALM = 1e-6  # of the vehicle's speed: the smoothing's own error reaches 1e-9
APART = 0.2  # of the motion: position and velocity that differ by more are of two motions
RESOLVED = 3.0  # samples per length scale: fewer, and no polynomial follows the flow between them
FEWEST = 20  # samples: fewer say nothing of their own noise
HARDLY = 0.4  # of U0: with more turbulence than this there are hardly any steady cells
UNEXPLAINED = 0.5  # of |Phi|^2: what leaves more of the rows is another flow
OTHER = 0.8  # of the air's variance: a flight of which the common flow explains less
COLOURED = 1e-6  # p-value of innovations as coloured by chance: below, the model is another


@dataclass(frozen=True, eq=False)
class Case:
    """What is judged.

    Args:
        prepared: the flights.
        measured: the flow at the maximum of its likelihood; None where no flow was proposed.
        scales: its estimates, fastest first.
        precision: the largest half-width of an interval, as a share of the value.
        free: what was freed by the estimator's settings, or may be ("auto").
    """

    prepared: Prepared
    measured: Measured | None
    scales: Sequence[ScaleEstimate]
    precision: float
    free: tuple[str, ...] | str = ()


def judge(case: Case) -> Verdict | None:
    """The first reason not to believe an estimate; None where there is none."""
    return next((verdict for check in CHECKS if (verdict := check(case)) is not None), None)


def refused(prepared: Prepared) -> Verdict | None:
    """The first reason not to search for a flow at all."""
    case = Case(prepared, None, (), math.inf)
    checks = (_few, _still, _disagreeing)
    return next((verdict for check in checks if (verdict := check(case)) is not None), None)


def _of_any(case: Case, rule: Callable[[Samples], str]) -> str:
    """The first flight's words by a rule; of several flights its number comes before it."""
    for number, samples in enumerate(case.prepared.parts, 1):
        words = rule(samples)
        if words:
            return f"flight {number}: {words}" if len(case.prepared.parts) > 1 else words
    return ""


def _still(case: Case) -> Verdict | None:
    phi = case.prepared.flow_velocity
    speed = float(np.abs(case.prepared.samples.velocity).max())
    if float(np.abs(phi - phi.mean(axis=0)).max()) > CALM * speed:
        return None
    return Verdict.against(Doubt.STILL_AIR, "no cellular flow detected: the air is still")


def _disagreeing(case: Case) -> Verdict | None:
    """A log of two motions: that of its positions is not that of its velocities."""
    for number, flight in enumerate(case.prepared.flights, 1):
        share = apart(flight)
        if not flight.velocity_measured or not share > APART:
            continue
        size = f"{100 * share:.0f} % of" if share < 10 else "more than 10 times"
        words = "the logged velocity is not that of the logged position: they are "
        words += f"{size} the motion apart; check units, axes and time stamps"
        several = len(case.prepared.flights) > 1
        return Verdict.against(
            Doubt.DISAGREEMENT, f"flight {number}: {words}" if several else words
        )
    return None


def apart(flight: Flight) -> float:
    """The rms of what the integral of the velocity leaves of the way, as a share of the way.

    Ways are those over a 32nd of the log each; five deviations of the noise of the readings are
    taken off.
    """
    steps = np.diff(flight.time)[:, None]
    half = 0.5 * (flight.velocity[1:] + flight.velocity[:-1]) * steps
    integral = np.vstack([np.zeros(2), np.cumsum(half, axis=0)])
    ends = np.unique(np.linspace(0, len(flight.time) - 1, 33).astype(int))
    ways, moved = np.diff(flight.position[ends], axis=0), np.diff(integral[ends], axis=0)
    rms = math.sqrt(float(np.mean((ways - moved) ** 2)))
    drawn = float(np.mean(steps)) * math.sqrt(len(flight.time) / len(ends))
    noise = math.hypot(noise_of(flight.position), drawn * noise_of(flight.velocity))
    return max(rms - 5.0 * noise, 0.0) / math.sqrt(max(float(np.mean(moved**2)), 1e-300))


def _few(case: Case) -> Verdict | None:
    samples = len(case.prepared.samples.time)
    if samples > FEWEST:
        return None
    words = f"{samples} samples are too few for the unknowns of a flow"
    return Verdict.against(Doubt.FEW_SAMPLES, f"{words}; fly longer, or sample faster")


def _undersampled(case: Case) -> Verdict | None:
    lower = case.prepared.library.grid.lower
    least = min((scale.length_scale for scale in case.scales), default=lower)

    def rule(samples: Samples) -> str:
        steps = np.diff(samples.time)
        step = float(np.median(steps)) if len(steps) else 0.0
        speed = math.sqrt(float(np.mean(np.sum(samples.velocity**2, axis=1))))
        if speed * step * RESOLVED <= least or 2 * speed * step <= lower:
            return ""
        return (
            f"the flight moves {speed * step:.3g} m from sample to sample, too far to follow a "
            f"length scale of {least:.3g} m; sample at {RESOLVED * speed / least:.3g} Hz or more"
        )

    words = _of_any(case, rule)
    return Verdict.against(Doubt.UNDERSAMPLED, words) if words else None


def _undetected(case: Case) -> Verdict | None:
    if case.measured is not None and case.measured.detected:
        return None
    words = "no cellular flow detected: no waves explain more than chance and turbulence do"
    odds = f"{1 / FALSE_ALARM:.0f} to 1 against a false alarm"
    return Verdict.against(Doubt.NO_FLOW, f"{words}, at {odds}")


def _failed(case: Case) -> Verdict | None:
    posterior = _measured(case).posterior
    if usable(posterior):
        return None
    return Verdict("inaccurate", posterior.reason or "the likelihood's ascent did not converge")


def _at_edge(case: Case) -> Verdict | None:
    low, high = case.prepared.library.grid.lower, case.prepared.library.grid.upper
    waves = _measured(case).waves
    lengths = math.sqrt(2) * math.pi / np.hypot(waves[:, 0], waves[:, 1])
    beyond = lengths[(lengths < 0.99 * low) | (lengths > 1.01 * high)]
    if not len(beyond):
        return None
    words = f"a length scale is at the edge of the search, {float(beyond[0]):.3g} m"
    return Verdict.against(Doubt.EDGE, f"{words}; widen the grid's bounds")


def _vehicle(case: Case) -> Verdict | None:
    tau = _measured(case).posterior.value("response_time")
    if tau > 0:
        return None
    words = f"the response time that fits best is {tau:.3g} s"
    return Verdict.against(Doubt.VEHICLE, f"{words}; fly longer, or give the response time")


def _misfit(case: Case) -> Verdict | None:
    measured = _measured(case)
    if _short(case) is not None:
        return None
    if measured.suspects and case.free != "auto":
        suspect = measured.suspects[0]
        where = f" of flight {suspect.flight}" if suspect.flight else ""
        words = f"more than noise is left{where}: {cause_in_words(suspect)}"
        remedy = suspect.free
        if remedy:
            words += f'; free it: free = ["{remedy}"] (--free {remedy}), or free = "auto"'
        return Verdict("misfit", words, Doubt.MISFIT)
    goodness, left = measured.goodness, measured.proposal.residual
    shares = [own.r_squared for own in goodness.flights]
    if shares and min(shares) < OTHER < max(shares):
        flight = 1 + shares.index(min(shares))
        words = f"more than noise is left of flight {flight}: it tells another flow than the other"
        words += " flights: its vehicle, frame or time may be another; leave it out"
        return Verdict("misfit", words, Doubt.MISFIT)
    if left > UNEXPLAINED:
        words = f"the fit explains only {100 * (1 - left):.0f} % of the flow velocity"
        words = f"{words}: the flow is another, or hardly steady"
        return Verdict("misfit", words, Doubt.MISFIT)
    if goodness.turbulence_share > HARDLY:
        share = 100 * goodness.turbulence_share
        words = f"turbulence of {goodness.turbulence:.2g} m/s, {share:.2g} % of U0, and hardly any"
        return Verdict("misfit", f"more than noise is left: {words} steady cells", Doubt.MISFIT)
    noisy = not measured.posterior.exact
    if noisy and goodness.whiteness < COLOURED and not goodness.turbulence > 0:
        words = f"more than noise is left: innovations are not white (p = {goodness.whiteness:.1g})"
        return Verdict("misfit", f"{words}, and no cause explains it", Doubt.MISFIT)
    return None


def _no_cells(case: Case) -> Verdict | None:
    measured = _measured(case)
    waves = len(measured.waves)
    if waves == 2 or len(case.scales) > 1:
        return None
    words = f"{waves} waves make no cells of one flow or two, equally strong"
    return Verdict.against(Doubt.NO_CELLS, f"{words}: only the flow itself is told; fly longer")


def _rivalled(case: Case) -> Verdict | None:
    rival = _measured(case).rival
    if rival is None:
        return None
    best = f"{case.scales[0].mean_velocity:.3g} m/s and {case.scales[0].length_scale:.3g} m"
    other = f"{rival.mean_velocity:.3g} m/s and {rival.length_scale:.3g} m (shape {rival.shape!r})"
    words = f"cannot tell a flow of {best} from {other}: the flight covers "
    words += f"{case.prepared.search.lookout.extent:.3g} m, or too straight a line"
    return Verdict.against(Doubt.RIVAL, f"{words}; fly longer, across more cells, or turn")


def _imprecise(case: Case) -> Verdict | None:
    """Every value must be told at all, and those of the fastest flow to the precision."""
    for place, scale in enumerate(case.scales):
        sure = scale.uncertainty
        values = scale.mean_velocity, scale.length_scale, scale.timescale
        if sure is None:
            words = "too few samples for a standard error; fly longer, or sample faster"
            return Verdict.against(Doubt.FEW_SAMPLES, words)
        if not place or not math.isfinite(sure.mean_velocity + sure.length_scale):
            wide = sure.wide(values, case.precision)
            if wide:
                return Verdict.against(Doubt.IMPRECISE, wide)
    return None


def _short(case: Case) -> Verdict | None:
    """A track that covers less than one period, 2 L, of the fastest flow, which may drift."""
    measured, period = _measured(case), 2 * case.scales[0].length_scale
    places = [
        samples.position - samples.time[:, None] * np.array(measured.drift)
        for samples in case.prepared.parts
    ]
    extent = extent_of(np.concatenate(places))
    if not extent < period:
        return None
    words = f"the flight covers {extent:.3g} m, less than one period of the flow, {period:.3g} m"
    return Verdict.against(Doubt.SHORT_TRACK, f"{words}; fly farther")


def _measured(case: Case) -> Measured:
    assert case.measured is not None
    return case.measured


CHECKS: tuple[Callable[[Case], Verdict | None], ...] = (
    _still,
    _disagreeing,
    _few,
    _undersampled,
    _undetected,
    _failed,
    _at_edge,
    _vehicle,
    _misfit,
    _no_cells,
    _rivalled,
    _imprecise,
    _short,
)


def cause_in_words(suspect: Suspect) -> str:
    """A cause and its size as a sentence."""
    size = suspect.size
    first = size[0] if size else math.nan
    pair = f"({first:.2g}, {size[1]:.2g})" if len(size) > 1 else ""
    percent = f"{100 * abs(first):.2g} %"
    more, longer = ("more", "longer") if first > 0 else ("less", "shorter")
    match suspect.cause:
        case Cause.WIND:
            return f"there seems to be a wind of {pair} m/s"
        case Cause.GROWING_WIND:
            return f"there seems to be a wind that grows by {pair} m/s in a second"
        case Cause.RESPONSE_TIME:
            return f"the response time seems {abs(first):.2g} s {longer} than it is believed"
        case Cause.THRUST:
            return f"the thrust seems {percent} {more} than it is believed"
        case Cause.THRUST_TURNED:
            return f"the thrust seems turned, by {math.degrees(first):.2g} degrees"
        case Cause.DRAG:
            return f"the drag seems {more} quadratic than it is believed, by {abs(first):.2g} s/m"
        case Cause.MASS:
            return f"the mass seems to change, by {100 * first:.2g} % in a second"
        case Cause.LAG:
            return f"the drag seems to lag behind the wind, by {1e3 * first:.2g} ms"
        case Cause.DECAY:
            grows = "grow" if first > 0 else "decay"
            return f"the mean velocity seems to {grows}, by {percent} in a second"
        case Cause.SWELLING:
            return f"the mean velocity seems to change in time, by {percent} rms"
        case Cause.DRIFT:
            return f"the cells seem to drift at about {pair} m/s"
        case Cause.VELOCITY_SCALE:
            return f"the logged velocity seems {percent} too {'large' if first > 0 else 'small'}"
        case Cause.POSITION_SCALE:
            return f"the logged position seems {percent} too {'large' if first > 0 else 'small'}"
        case Cause.VELOCITY_BIAS:
            return f"the logged velocity seems off by {pair} m/s"
        case Cause.LATENCY:
            late = "position" if first > 0 else "velocity"
            return f"the logged {late} seems late, by {1e3 * abs(first):.2g} ms"
        case Cause.ROTATION:
            angle = math.degrees(first)
            return f"the frame of the velocity seems turned, by {angle:.2g} degrees"
        case Cause.POSITION_NOISE:
            return f"the position seems to wander, by {abs(first):.2g} m rms"
        case Cause.ANOTHER_FLOW:
            return f"it tells another flow than the other flights, by about {percent}"
        case Cause.TURN | Cause.STRETCH:
            return "the cells seem turned or stretched"
        case Cause.TURBULENCE:
            return f"turbulence of {abs(first):.2g} m/s"
