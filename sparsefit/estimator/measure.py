"""The flow at the maximum of its likelihood, from the proposals of the search.

Each lobe that the search proposes is a start; BIC of the likelihood selects among them, and among
shapes, causes and disturbances from there (`sparsefit.likelihood.diagnosis`). An optimum whose
waves have left the lobe of their proposal is kept only where the rows do not exclude it.

Waves (k_x, k_y, a, b, omega) (j, 5) are those of psi = sum a cos(phi) + b sin(phi), phi = k.x -
omega t; `sparsefit.model.shapes` reads cells of them. Variances are those of the waves through
central differences.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from sparsefit.arrays import Array
from sparsefit.cached import cached_property
from sparsefit.estimator.estimate import FlightEstimate, RungEstimate, ScaleEstimate, flight_fields
from sparsefit.estimator.prepare import Prepared
from sparsefit.flight.flow import SuperposedFlow
from sparsefit.flight.waves import WaveFlow
from sparsefit.likelihood.causes import FREEDOMS, WIND, Suspect
from sparsefit.likelihood.diagnosis import (
    Diagnosis,
    diagnose,
    disturbed,
    process_of,
    scanned,
    with_process,
)
from sparsefit.likelihood.goodness import Constancy, Goodness, Uncertainty
from sparsefit.likelihood.model import Model
from sparsefit.likelihood.pattern import SHAPES, StreamPattern, paired
from sparsefit.likelihood.posterior import Posterior, measure
from sparsefit.likelihood.readings import FlightLog
from sparsefit.model import Proposal
from sparsefit.model.shapes import flows_of, read_cells

WORSE = 3.0  # times the least RSS of the rows: a proposal that leaves more is not measured
MOST = 5  # lobes that are measured
CLOSE = 10.0  # of BIC: the largest difference to a rival
NEAR = 0.5  # in pi/extent: the largest distance of an optimum's waves from the proposed ones
STRAY = 0.25  # of |k|: the largest move of a wave when a cause is freed
APART = 0.02  # the least relative difference of U0 or L of a rival
SLIGHT = 1e-3  # the largest relative change of U0 and L by a cause that is freed unasked
FALSE_ALARM = 1e-3  # probability of a flow in a flight without one, over all lobes
EXPLAINED = 0.9  # of the air's variance: a flow that explains more in white innovations is there
HIDDEN = 500.0  # of 2 ln(likelihood ratio), that a wrong vehicle may hide of a flow
MOSTLY = 0.5  # of the variance of the air that waves explain, whatever a vehicle hides of them


@dataclass(frozen=True, eq=False)
class Measured:
    """A flow at the maximum of its likelihood."""

    proposal: Proposal  # where it started
    proposals: tuple[Proposal, ...]  # of the search, by the BIC of its rows
    diagnosis: Diagnosis  # causes and disturbances beside it
    posterior: Posterior  # of the answer
    suspects: tuple[Suspect, ...]  # causes that are not in the answer: a misfit
    freed: tuple[str, ...]  # names of freedoms in the answer
    goodness: Goodness  # of the fit
    rival: Proposal | None  # another U0 or L of nearly the same BIC
    detected: bool  # whether it explains more than chance and turbulence

    @cached_property
    def waves(self) -> Array:
        """The waves of psi = sum a cos(phi) + b sin(phi), phi = k.x - omega t, as rows (j, 5).

        k_x, k_y [rad/m], a, b [m^2/s] and omega [rad/s], in the axes and the time of the flight.
        """
        return self.posterior.model.pattern.about((0.0, 0.0, 0.0)).waves

    @cached_property
    def flows(self) -> list[tuple[Array, Array]]:
        """(U0, L, tau_w, L_x, L_y, heading) of each flow, and their standard errors."""
        parts = flows_of(self.waves[:, :2], self.waves[:, 2:4])
        if len(self.waves) > 4 and not len(self.waves) % 2:  # cells of several length scales
            parts = [[j, j + 1] for j in range(0, len(self.waves), 2)]
        pattern, names = self.posterior.model.pattern, self.posterior.names

        def values(at: Array) -> list[Array]:
            waves = replace(pattern, values=tuple(at.tolist())).waves
            return [read_waves(waves[list(flow)]) for flow in parts]

        here = np.array(pattern.values)
        steps = np.diag(1e-6 * np.maximum(np.abs(here), 1e-2))
        moved = [(values(here + step), values(here - step), 2.0 * step.sum()) for step in steps]
        places = [names.index(name) for name in pattern.names]
        covariance = self.posterior.covariance[np.ix_(places, places)]
        flows = []
        for flow, value in enumerate(values(here)):
            slope = np.array([(up[flow] - down[flow]) / width for up, down, width in moved])
            variances = np.einsum("if,ij,jf->f", slope, covariance, slope)
            if self.posterior is self.diagnosis.posterior:
                speed, length = self.diagnosis.ambiguity
                variances[:3] += np.square(value[:3] * [speed, length, math.hypot(speed, length)])
            flows.append((value, np.sqrt(np.maximum(variances, 0.0))))
        return flows

    def scales(self, grid: Sequence[float]) -> tuple[ScaleEstimate, ...]:
        """The flows of cells, fastest first; grid: the candidates [m] in use."""
        scales = []
        for values, errors in self.flows:
            speed, scale, timescale, _, _, heading = values.tolist()
            sure = Uncertainty.of_flow((speed, scale, timescale), errors[:3].tolist())
            candidate = min(grid, key=lambda own: abs(own - scale))
            scales.append(ScaleEstimate(speed, scale, timescale, candidate, sure, heading))
        return tuple(sorted(scales, key=lambda own: -own.mean_velocity))

    def fields(
        self, prepared: Prepared, scales: Sequence[ScaleEstimate], *, several: bool
    ) -> dict[str, Any]:
        """The fields of an `Estimate`, by name; several: whether several flows are sought."""
        first, posterior, waves = scales[0], self.posterior, self.waves
        pattern, least = posterior.model.pattern, min(own.bic for own in self.proposals)
        flow = WaveFlow(waves[:, :2], *waves.T[2:])
        uniform = tuple(posterior.value(name) for name in WIND)
        names = ("mean_velocity", "length_scale", "timescale", "uncertainty")
        parts: dict[str, Any] = {name: getattr(first, name) for name in names}
        parts |= {"grid_length_scale": first.grid_length_scale} if several else {}
        parts |= {"rival_length_scale": self.rival.cells.length_scale} if self.rival else {}
        parts |= {
            "scales": tuple(scales) if several or len(scales) > 1 else (),
            "shape": "several" if pattern.shape == "scales" else pattern.shape,
            "flow": SuperposedFlow((flow,), (uniform[0], uniform[1])) if any(uniform) else flow,
            "goodness": self.goodness,
            "freed": self.freed,
            "constancy": Constancy.of(*self.diagnosis.growth, pattern.mean_velocity),
            "rungs": tuple(
                RungEstimate(own.shape, own.velocity is not None, own.bic - least, own.residual)
                for own in self.proposals
            ),
        }
        if len(waves) > 1:
            cells, sure = (
                {"length_scales": tuple(own[3:5].tolist()), "heading": float(own[5])}
                for own in max(self.flows, key=lambda flow: float(flow[0][0]))
            )
            if pattern.drifting:
                cells["drift"] = pattern.drift
                sure["drift"] = posterior.error("drift_x"), posterior.error("drift_y")
            uncertainty = Uncertainty.of(cells, sure)
            parts |= {"drift": (0.0, 0.0)} | cells | {"shape_uncertainty": uncertainty}
        own = [flight_fields(posterior, *each) for each in enumerate(prepared.vehicles)]
        if len(own) == 1:
            return parts | own[0]
        noises = np.array([model.values["velocity_noise"] for model in posterior.models])
        noises /= math.sqrt(float(np.mean(noises**2))) or 1.0
        flights = zip(prepared.parts, noises.tolist(), self.goodness.flights, own, strict=True)
        parts["flights"] = tuple(
            FlightEstimate(
                samples=len(rows.time), noise=noise, goodness=goodness, repairs=rows.repairs, **each
            )
            for rows, noise, goodness, each in flights
        )
        return parts


@dataclass(frozen=True, eq=False)
class Optimum:
    """A proposed flow at the maximum of its likelihood."""

    posterior: Posterior
    proposal: Proposal

    @cached_property
    def loose(self) -> bool:
        """Whether waves make no cells, or make more flows, one of them weaker than turbulence.

        Cells come first, and the rest is turbulence.
        """
        waves = self.posterior.model.pattern.waves
        parts = flows_of(waves[:, :2], waves[:, 2:4])
        squares = np.sum(waves[:, :2] ** 2, axis=1) * np.sum(waves[:, 2:4] ** 2, axis=1)
        weakest = 0.25 * min(float(squares[part].sum()) for part in parts)  # of a component
        gusts = self.posterior.model.levels.get("turbulence", 0.0) ** 2
        several = len(waves) == 4 and (len(parts) == 1 or weakest < gusts)
        return len(waves) % 2 == 1 or several

    @property
    def rank(self) -> tuple[bool, float]:
        """The order of optima, best first: cells, then BIC."""
        return self.loose, self.posterior.bic


def measure_flow(
    prepared: Prepared, proposals: Sequence[Proposal], free: tuple[str, ...] | str, *, shapes: bool
) -> Measured | None:
    """Measure the proposed flows, best first; None if there is no proposal.

    Args:
        prepared: the flights.
        proposals: of the search.
        free: names of `FREEDOMS` to be freed beside the library's unknowns; "auto": all causes
            that are found.
        shapes: whether freer shapes than proposed may be the answer.
    """
    if not proposals:
        return None
    places = [flight.position for flight in prepared.sound]
    logs = [*map(FlightLog.of_flight, prepared.flights, places)]
    evident = ("latency",) if any(prepared.latencies) else ()
    asked = evident if free == "auto" else free
    names = tuple(dict.fromkeys((*prepared.library.unknown, *asked)))
    near = NEAR * math.pi / prepared.search.extent
    optima = _optima(prepared, logs, proposals, names, near)
    if not optima:
        return None
    turbulent = cache(lambda: _turbulent(logs, optima[0].posterior))

    def diagnosed(own: Optimum, least: float = -math.inf) -> tuple[Diagnosis, float]:
        """The diagnosis of an optimum, and 2 ln(likelihood ratio) of it over turbulence alone."""
        there, proposal = own.posterior, own.proposal
        alone = Diagnosis(there, there)
        goodness = Goodness.of(there, alone)
        excess, white = math.inf, goodness.whiteness > 1e-6 or there.exact or there.pushed
        if not (white and goodness.r_squared > EXPLAINED and proposal.residual < MOSTLY):
            least = max(least, turbulent())  # a flow less likely than that is not detected
            above = there.log_likelihood - turbulent() - math.log(len(prepared.search.lobes) or 1)
            excess = 2.0 * (above + math.log(FALSE_ALARM)) - len(there.model.pattern.names)
        followed = not prepared.too_fast(there.model.pattern.length_scale)
        if not followed or not (excess > -HIDDEN or goodness.r_squared > MOSTLY):
            return alone, excess
        around = max(near, STRAY * float(np.hypot(*proposal.wavevectors.T).min()))
        found = diagnose(
            logs,
            there,
            names,
            shapes=shapes,
            least=least,
            inside=lambda own: own.is_near(proposal.wavevectors, around),
        )
        return found, excess

    first, *others = optima
    diagnosis, excess = diagnosed(first)
    compared = first.posterior  # with those of the others
    if diagnosis.believed.model.processes:
        # Waves may have fitted the gusts: all optima are compared with these in the model.
        beside = [Optimum(diagnosis.believed, first.proposal)]
        for own in others:
            again = _beside(beside[0], own, logs)
            if again is not None and again.model.pattern.is_near(own.proposal.wavevectors, near):
                beside.append(Optimum(again, own.proposal))
        best = min(beside, key=lambda own: own.rank)
        others, compared = [own for own in beside if own is not best], best.posterior
        if best is not beside[0]:
            first = next(own for own in optima if own.proposal is best.proposal)
            diagnosis, excess = diagnosed(first)
    shape = first.posterior.model.pattern.waves.shape
    alike = [own for own in optima if own.posterior.model.pattern.waves.shape == shape]
    plain = min(alike, key=lambda own: len(own.posterior.names))
    if len(plain.posterior.names) < min(len(first.posterior.names), len(diagnosis.posterior.names)):
        # A cause beside it may be what the freer shape stands in for.
        fewer = len(diagnosis.posterior.names) - len(plain.posterior.names) - 1
        # BIC of 160,000 readings asks no more of a simpler shape with a cause.
        found, gap = diagnosed(plain, diagnosis.posterior.log_likelihood - 6.0 * fewer)
        if found.posterior.bic < diagnosis.posterior.bic:
            others = [own for own in others if own.proposal is not plain.proposal]
            others.append(Optimum(diagnosis.posterior, first.proposal))
            first, compared, diagnosis, excess = plain, found.posterior, found, gap
    posterior, suspects = diagnosis.believed, diagnosis.suspects
    of_flow = any(own.of_flow for own in suspects)
    refitted = diagnosis.posterior is not diagnosis.believed
    slight = refitted and not of_flow and posterior.apart(diagnosis.posterior) < SLIGHT
    # Positions alone do not distinguish another vehicle from another scale of their own.
    if free == "auto" or (suspects and len(logs) == len(prepared.ways) == 1 and slight):
        posterior, suspects = diagnosis.posterior, ()
    rivals = list[Proposal]()
    for own in others:
        answers = first.posterior, diagnosis.posterior
        near_both = min(each.apart(own.posterior) for each in answers) <= APART
        if not (own.loose or near_both) and own.posterior.bic - compared.bic < CLOSE:
            rivals.append(own.proposal)
    goodness = Goodness.of(posterior, diagnosis)
    excess += 2 * (diagnosis.posterior.log_likelihood - first.posterior.log_likelihood)
    excess -= 4 * (len(diagnosis.posterior.names) - len(first.posterior.names))
    freed = (*names, *(own.free for own in diagnosis.suspects if not suspects))
    return Measured(
        first.proposal, tuple(proposals), diagnosis, posterior, suspects, freed, goodness,
        rivals[0] if rivals else None, excess > 0,
    )  # fmt: skip


def _optima(
    prepared: Prepared,
    logs: Sequence[FlightLog],
    proposals: Sequence[Proposal],
    names: Sequence[str],
    near: float,
) -> list[Optimum]:
    """The proposals at the maxima of their likelihoods, best first; names: those of freedoms."""
    late = prepared.latencies if "latency" in names else [0.0] * len(logs)
    constants = [
        own for name in names for own in FREEDOMS[name].elements if not FREEDOMS[name].wanders
    ]
    least, grid = min(own.residual for own in proposals), prepared.library.grid
    likely = []
    for own in proposals:
        lengths = math.sqrt(2.0) * math.pi / np.hypot(*own.wavevectors.T)
        within = (lengths > 0.75 * grid.lower).all() and (lengths < 1.25 * grid.upper).all()
        if own.residual <= WORSE * least and within:
            likely.append(own)
    optima = list[Optimum]()
    chosen = lobes(likely, near)[:MOST]
    chosen.sort(key=lambda own: len(own.wavevectors) % 2)  # an odd number makes no cells
    for proposal in chosen:
        if len(proposal.wavevectors) % 2 and not all(own.loose for own in optima):
            break
        waves = proposal.wavevectors, proposal.cosine, proposal.sine
        pattern = StreamPattern.of_waves(proposal.shape, *waves, proposal.velocity)
        triples = zip(prepared.flights, proposal.vehicles, late, strict=True)
        models = [
            Model.of_flight(pattern, flight, vehicle, proposal.background)
            .free(*constants)
            .at({"latency": latency} if latency else {})
            for flight, vehicle, latency in triples
        ]
        there = measure(logs, models)
        for name in names:
            if there is not None and FREEDOMS[name].wanders:
                there = measure(logs, with_process(there.models, process_of(name, there)), there)
        if there is None:
            continue
        followed = not prepared.too_fast(there.model.pattern.length_scale)
        if proposal.shape == "scales" and followed:  # its waves are free if BIC says so
            free_waves = there.model.pattern.reshaped("several", pattern.drifting)
            freer = [replace(own, pattern=free_waves) for own in there.models]
            loose = measure(logs, freer, there, least=there.log_likelihood)
            there = loose if loose is not None and loose.bic < there.bic else there
        # An optimum that left its proposal is one of its own where the rows do not exclude it.
        if not there.model.pattern.is_near(proposal.wavevectors, near):
            phases = there.model.pattern.waves[:, [0, 1, 4]]
            proposal = prepared.search.proposed_at(proposal, phases) or proposal
        if there.model.pattern.is_near(proposal.wavevectors, near):
            optima.append(Optimum(there, proposal))
    optima.sort(key=lambda own: own.rank)
    cells = min(
        optima, key=lambda own: (own.loose, own.posterior.model.pattern.waves.size), default=None
    )
    if cells and cells is not optima[0] and disturbed(cells.posterior):
        gain, _ = scanned(cells.posterior, process_of("turbulence", cells.posterior))
        if cells.posterior.bic - gain < optima[0].posterior.bic:  # more waves stand in for gusts
            optima = [cells, *(own for own in optima if own is not cells)]
    return optima


def _beside(base: Optimum, other: Optimum, logs: Sequence[FlightLog]) -> Posterior | None:
    """An optimum with a base's processes in its model; None if it comes nowhere near its BIC."""
    gusts, white, least = base.posterior, other.posterior, -math.inf
    pairs = zip(white.models, gusts.models, strict=True)
    gusty = [replace(own, processes=its.processes) for own, its in pairs]
    if not base.loose:  # else others come first
        least = white.log_likelihood + 0.5 * (white.bic - gusts.bic - CLOSE)
    return measure(logs, gusty, white, least=least)


def lobes(proposals: Sequence[Proposal], near: float) -> list[Proposal]:
    """The proposal with fewest parameters of each set of waves that are near to each other."""
    chosen: list[Proposal] = []

    def freedom(proposal: Proposal) -> tuple[int, bool]:
        return SHAPES.index(proposal.shape), proposal.velocity is not None

    for own in proposals:
        for place, other in enumerate(chosen):
            if paired(own.wavevectors, other.wavevectors, near):
                chosen[place] = min(other, own, key=freedom)
                break
        else:
            chosen.append(own)
    return chosen


def _turbulent(logs: Sequence[FlightLog], posterior: Posterior) -> float:
    """The log-likelihood of turbulence as fast as a flow, without the flow."""
    pattern, speed = posterior.model.pattern, posterior.model.pattern.mean_velocity
    longest = 1e2 * pattern.length_scale  # no waves: no steps between readings that follow them
    still = StreamPattern("axis", (1e-6 * speed, longest, 0.0, 0.0), origin=pattern.origin)
    calm = [
        replace(model, pattern=still, processes=(), fixed=still.names).free(*WIND)
        for model in posterior.models
    ]
    gusts = replace(process_of("turbulence", posterior), level=0.5 * speed)
    nothing = measure(logs, with_process(calm, gusts))
    return math.inf if nothing is None else nothing.log_likelihood


def read_waves(waves: Array) -> Array:
    """U0 [m/s], L [m], tau_w [s], L_x, L_y [m] and heading [rad] of waves (j, 5); NaN of one."""
    cells = read_cells(waves[:, :2], waves[:, 2:4])
    speed, scale = cells.mean_velocity, cells.length_scale
    timescale = scale / speed if speed else math.inf
    return np.array([speed, scale, timescale, *cells.length_scales, cells.heading])
