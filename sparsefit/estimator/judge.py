"""The checks that an estimate has to pass, in the order in which a pilot would ask them."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sparsefit.estimator.estimate import Doubt, ScaleEstimate, Verdict
from sparsefit.estimator.measure import Measured
from sparsefit.estimator.prepare import Prepared
from sparsefit.flight import Flight
from sparsefit.likelihood.diagnosis import usable
from sparsefit.likelihood.nodes import noise_of
from sparsefit.model.grid import extent_of

RESOLVED = 3.0  # samples per length scale: fewer, and no polynomial follows the flow between them
QUANTITIES = {
    "mean_velocity": "the mean velocity",
    "length_scale": "the length scale",
    "timescale": "the timescale",
}


@dataclass(frozen=True, eq=False)
class Judged:
    """The material of a verdict.

    Args:
        prepared: the flights.
        result: the flow at the maximum of its likelihood; None where no flow was proposed.
        scales: its estimates, fastest first.
        precision: the largest half-width of an interval, as a share of the value.
        free: what was freed by the estimator's settings, or may be ("auto").
    """

    prepared: Prepared
    result: Measured | None
    scales: Sequence[ScaleEstimate]
    precision: float
    free: tuple[str, ...] | str = ()

    @property
    def measured(self) -> Measured:
        """The result, after the check that there is one."""
        assert self.result is not None
        return self.result

    def of_flight(self, number: int) -> str:
        """The words before what is said of one of several flights."""
        return f"flight {number}: " if len(self.prepared.flights) > 1 else ""


Values = dict[str, Any]  # for the words of a check


def still(case: Judged) -> Values | None:
    """Air whose velocity does not change, but for the smoothing's own error (1e-9)."""
    phi = case.prepared.flow_velocity
    speed = float(np.abs(case.prepared.samples.velocity).max())
    return {} if float(np.abs(phi - phi.mean(axis=0)).max()) <= 1e-6 * speed else None


def disagreeing(case: Judged) -> Values | None:
    """A log of two motions: positions and velocities that differ by a fifth of the way."""
    for number, flight in enumerate(case.prepared.flights, 1):
        share = apart(flight)
        if flight.velocity_measured and share > 0.2:
            size = f"{100 * share:.0f} % of" if share < 10 else "more than 10 times"
            return {"flight": case.of_flight(number), "size": size}
    return None


def apart(flight: Flight) -> float:
    """The rms of the way less the integral of the velocity, as a share of the way.

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


def few(case: Judged) -> Values | None:
    """So few samples that they say nothing of their own noise."""
    samples = len(case.prepared.samples.time)
    return {"samples": samples} if samples <= 20 else None


def undersampled(case: Judged) -> Values | None:
    """Steps along the track that are long beside the length scale."""
    lower = case.prepared.library.grid.lower
    least = min((scale.length_scale for scale in case.scales), default=lower)
    for number, samples in enumerate(case.prepared.parts, 1):
        steps = np.diff(samples.time)
        step = float(np.median(steps)) if len(steps) else 0.0
        speed = math.sqrt(float(np.mean(np.sum(samples.velocity**2, axis=1))))
        if speed * step * RESOLVED > least and 2 * speed * step > lower:
            rate = RESOLVED * speed / least
            flight = case.of_flight(number)
            return {"flight": flight, "moved": speed * step, "least": least, "rate": rate}
    return None


def undetected(case: Judged) -> Values | None:
    """No flow beyond chance."""
    return {} if case.result is None or not case.result.detected else None


def failed(case: Judged) -> Values | None:
    """An ascent of the likelihood that did not end."""
    posterior = case.measured.posterior
    return None if usable(posterior) else {"reason": posterior.reason}


def at_edge(case: Judged) -> Values | None:
    """A wave whose length scale is beyond the grid's bounds, by a hundredth."""
    grid = case.prepared.library.grid
    lengths = math.sqrt(2) * math.pi / np.hypot(*case.measured.waves[:, :2].T)
    beyond = lengths[(lengths < 0.99 * grid.lower) | (lengths > 1.01 * grid.upper)]
    return {"length": float(beyond[0])} if len(beyond) else None


def vehicle(case: Judged) -> Values | None:
    """A response time below zero."""
    tau = case.measured.posterior.value("response_time")
    return None if tau > 0 else {"tau": tau}


def suspected(case: Judged) -> Values | None:
    """A cause that is not answered with."""
    suspects = case.measured.suspects
    if not suspects or case.free == "auto" or short(case) is not None:
        return None
    first = suspects[0]
    remedy = f'; free it: free = ["{first.free}"] (--free {first.free}), or free = "auto"'
    where = f" of flight {first.flight}" if first.flight else ""
    return {"where": where, "cause": first.words, "remedy": remedy if first.free else ""}


def foreign(case: Judged) -> Values | None:
    """A flight of which the common flow explains much less than of another."""
    shares = [own.r_squared for own in case.measured.goodness.flights]
    if not shares or not min(shares) < 0.8 < max(shares) or short(case) is not None:
        return None
    return {"flight": 1 + shares.index(min(shares))}


def unexplained(case: Judged) -> Values | None:
    """A search that left half of the rows' squares."""
    residual, goodness = case.measured.proposal.residual, case.measured.goodness
    explained = goodness.r_squared > 0.9 and goodness.whiteness > 1e-3  # rows have the outliers
    if residual <= 0.5 or explained or short(case) is not None:
        return None
    return {"share": 100 * (1 - residual)}


def gusty(case: Judged) -> Values | None:
    """Disturbances of the air of more than .4 U0: hardly any steady cells."""
    goodness = case.measured.goodness
    if not goodness.turbulence_share > 0.4 or short(case) is not None:
        return None
    return {"level": goodness.turbulence, "share": 100 * goodness.turbulence_share}


def coloured(case: Judged) -> Values | None:
    """Innovations that are not white, where noise is more than that of the arithmetic."""
    goodness = case.measured.goodness
    if case.measured.posterior.exact or short(case) is not None:
        return None
    wanders = case.measured.posterior.model.disturbance.processes
    white = goodness.whiteness >= 1e-6 or bool(wanders)
    return None if white else {"p": goodness.whiteness}


def no_cells(case: Judged) -> Values | None:
    """Waves that are not those of one flow of cells or two."""
    waves = len(case.measured.waves)
    return None if waves == 2 or len(case.scales) > 1 else {"waves": waves}


def rivalled(case: Judged) -> Values | None:
    """Another lobe that explains the flights nearly as well."""
    rival, best = case.measured.rival, case.scales[0]
    if rival is None:
        return None
    return {"best": best, "rival": rival, "extent": case.prepared.search.lookout.extent}


def uncertain(case: Judged) -> Values | None:
    """No standard error."""
    return {} if any(scale.uncertainty is None for scale in case.scales) else None


def imprecise(case: Judged) -> Values | None:
    """Every value must be told at all, and those of the fastest flow to the precision."""
    for place, scale in enumerate(case.scales):
        widths = {
            name: (high - low) / 2 / abs(getattr(scale, name))
            for name in QUANTITIES
            for low, high in [getattr(scale.uncertainty, f"{name}_interval")]
        }
        worst = max(widths, key=lambda name: widths[name])
        if not math.isfinite(widths[worst]):
            words = f"the flight does not tell {QUANTITIES[worst]} at all; fly across more cells"
            return {"words": words}
        if place == 0 and widths[worst] > case.precision:
            accuracy = f"{QUANTITIES[worst]} is known only to +-{100 * widths[worst]:.0f} %"
            remedy = "fly longer, across more cells, or ask for less (readout precision)"
            return {"words": f"{accuracy}; {remedy}"}
    return None


def short(case: Judged) -> Values | None:
    """A track that covers less than one period, 2 L, of the fastest flow, which may move."""
    period = 2 * case.scales[0].length_scale
    moved = np.array(case.measured.posterior.model.pattern.drift)
    parts = case.prepared.parts
    extent = extent_of(np.concatenate([own.position - own.time[:, None] * moved for own in parts]))
    return {"extent": extent, "period": period} if extent < period else None


@dataclass(frozen=True)
class Rule:
    """A reason not to believe an estimate.

    Args:
        test: of a case: the values for the words, None where the case passes.
        words: a template for `str.format`.
        doubt: the kind of doubt.
        status: that a case has that does not pass.
    """

    test: Callable[[Judged], Values | None]
    words: str
    doubt: Doubt | None
    status: str = "unidentifiable"

    def __call__(self, case: Judged) -> Verdict | None:
        """The verdict, None where the case passes."""
        values = self.test(case)
        if values is None:
            return None
        return Verdict(self.status, self.words.format(**values), self.doubt)


MORE = "more than noise is left"
EARLY = (
    Rule(few, "{samples} samples are too few for the unknowns of a flow; fly longer, or sample "
          "faster", Doubt.FEW_SAMPLES),
    Rule(still, "no cellular flow detected: the air is still", Doubt.STILL_AIR),
    Rule(disagreeing, "{flight}the logged velocity is not that of the logged position: they are "
          "{size} the motion apart; check units, axes and time stamps", Doubt.DISAGREEMENT),
)  # fmt: skip
"""Checks before a flow is searched for."""
CHECKS = (
    Rule(undersampled, "{flight}the flight moves {moved:.3g} m from sample to sample, too far to "
          "follow a length scale of {least:.3g} m; sample at {rate:.3g} Hz or more",
          Doubt.UNDERSAMPLED),
    Rule(undetected, "no cellular flow detected: no waves explain more than chance and turbulence "
          "do, at 1000 to 1 against a false alarm", Doubt.NO_FLOW),
    Rule(failed, "{reason}", None, "inaccurate"),
    Rule(at_edge, "a length scale is at the edge of the search, {length:.3g} m; widen the grid's "
          "bounds", Doubt.EDGE),
    Rule(vehicle, "the response time that fits best is {tau:.3g} s; fly longer, or give the "
          "response time", Doubt.VEHICLE),
    Rule(suspected, MORE + "{where}: {cause}{remedy}", Doubt.MISFIT, "misfit"),
    Rule(foreign, MORE + " of flight {flight}: it tells another flow than the other flights: its "
          "vehicle, frame or time may be another; leave it out", Doubt.MISFIT, "misfit"),
    Rule(unexplained, "the fit explains only {share:.0f} % of the flow velocity: the flow is "
          "another, or hardly steady", Doubt.MISFIT, "misfit"),
    Rule(gusty, MORE + ": turbulence of {level:.2g} m/s, {share:.2g} % of U0, and hardly any "
          "steady cells", Doubt.MISFIT, "misfit"),
    Rule(coloured, MORE + ": innovations are not white (p = {p:.1g}), and no cause explains it",
          Doubt.MISFIT, "misfit"),
    Rule(no_cells, "{waves} waves make no cells of one flow or two, equally strong: only the flow "
          "itself is told; fly longer", Doubt.NO_CELLS),
    Rule(rivalled, "cannot tell a flow of {best.mean_velocity:.3g} m/s and {best.length_scale:.3g}"
          " m from {rival.mean_velocity:.3g} m/s and {rival.length_scale:.3g} m (shape "
          "{rival.shape!r}): the flight covers {extent:.3g} m, or too straight a line; fly longer, "
          "across more cells, or turn", Doubt.RIVAL),
    Rule(uncertain, "too few samples for a standard error; fly longer, or sample faster",
          Doubt.FEW_SAMPLES),
    Rule(imprecise, "{words}", Doubt.IMPRECISE),
    Rule(short, "the flight covers {extent:.3g} m, less than one period of the flow, {period:.3g} "
          "m; fly farther", Doubt.SHORT_TRACK),
)  # fmt: skip
"""Checks of a flow that was measured."""


def judge(case: Judged, checks: Sequence[Rule] = CHECKS) -> Verdict | None:
    """The first reason not to believe an estimate; None where there is none."""
    return next((verdict for check in checks if (verdict := check(case)) is not None), None)
