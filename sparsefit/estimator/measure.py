"""The flow at the maximum of its likelihood, from what the search proposes.

Each lobe that the search proposes is a start; the likelihood decides between them by BIC, and so it
does among shapes, causes and disturbances from there (`sparsefit.likelihood.causes`). An optimum
whose waves have left the lobe of the proposal that they started from is not believed.

Waves (k_x, k_y, a, b, omega) (j, 5) are those of psi = sum a cos(phi) + b sin(phi), phi = k.x -
omega t; `sparsefit.model.shapes` reads cells of them. Variances are those of the waves through
central differences.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sparsefit.arrays import Array
from sparsefit.cached import cached_property
from sparsefit.estimator.estimate import (
    FlightEstimate,
    RungEstimate,
    ScaleEstimate,
    flight_fields,
)
from sparsefit.estimator.prepare import Prepared
from sparsefit.flight.flow import SuperposedFlow
from sparsefit.flight.waves import WaveFlow
from sparsefit.likelihood.causes import FREEDOMS, WIND, Suspect
from sparsefit.likelihood.diagnosis import (
    Diagnosis,
    diagnose,
    fitted,
    process_of,
    with_process,
)
from sparsefit.likelihood.goodness import Constancy, Goodness, Uncertainty
from sparsefit.likelihood.model import Model
from sparsefit.likelihood.nodes import FlightLog
from sparsefit.likelihood.pattern import SHAPES, StreamPattern
from sparsefit.likelihood.posterior import Posterior
from sparsefit.model import Proposal
from sparsefit.model.shapes import flows_of, read_cells

WORSE = 3.0  # times the least RSS of the rows: a proposal that leaves more is not measured
MOST = 5  # lobes that are measured
CLOSE = 10.0  # of BIC: a rival that near could be the flow too
NEAR = 0.5  # in pi/extent: how far an optimum's waves may be from those that were proposed
STRAY = 0.25  # of |k|: waves that move by more beside a cause are others
APART = 0.02  # of U0 or L: rivals that differ by less say the same
SLIGHT = 1e-3  # of U0 or L: a cause that moves neither by more only widens their intervals
FALSE_ALARM = 1e-3  # of a flow in a flight without one, over all lobes
EXPLAINED = 0.9  # of the air's variance: a flow that explains more in white innovations is there
HIDDEN = 500.0  # of 2 ln(likelihood ratio), that a wrong vehicle may hide of a flow
CELLS = ("length_scales", "heading")
MOSTLY = 0.5  # of the variance of the air that waves explain, whatever a vehicle hides of them


@dataclass(frozen=True, eq=False)
class Measured:
    """A flow at the maximum of its likelihood."""

    proposal: Proposal  # where it started
    proposals: tuple[Proposal, ...]  # of the search, by the BIC of its rows
    diagnosis: Diagnosis  # causes and disturbances beside it
    posterior: Posterior  # that is answered with
    suspects: tuple[Suspect, ...]  # the causes that are not answered with: a misfit
    freed: tuple[str, ...]  # the names of what was freed
    goodness: Goodness  # how well it explains the flights
    rival: Proposal | None  # that explains them nearly as well, and says another U0 or L
    detected: bool  # whether it explains more than chance and turbulence do

    @cached_property
    def waves(self) -> Array:
        """(k_x, k_y, a, b, omega) (j, 5) in the coordinates and the time of the flight."""
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
        parts: dict[str, Any] = {
            name: getattr(first, name)
            for name in ("mean_velocity", "length_scale", "timescale", "uncertainty")
        }
        parts |= {"grid_length_scale": first.grid_length_scale} if several else {}
        parts |= {"rival_length_scale": self.rival.cells.length_scale} if self.rival else {}
        parts |= {
            "scales": tuple(scales) if several or len(scales) > 1 else (),
            "shape": pattern.shape,
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
            values, errors = max(self.flows, key=lambda own: float(own[0][0]))
            cells = dict(zip(CELLS, [tuple(values[3:5].tolist()), float(values[5])], strict=True))
            sure = dict(zip(CELLS, [tuple(errors[3:5].tolist()), float(errors[5])], strict=True))
            if pattern.drifting:
                cells["drift"] = pattern.drift
                sure["drift"] = posterior.error("drift_x"), posterior.error("drift_y")
            uncertainty = Uncertainty.of(cells, sure)
            parts |= {"drift": (0.0, 0.0)} | cells | {"shape_uncertainty": uncertainty}
        own = [flight_fields(posterior, *each) for each in enumerate(prepared.vehicles)]
        if len(own) == 1:
            parts |= own[0]
            return parts
        noises = np.array([model.disturbance.velocity_noise for model in posterior.models])
        noises /= math.sqrt(float(np.mean(noises**2))) or 1.0
        flights = zip(prepared.parts, noises.tolist(), self.goodness.flights, own, strict=True)
        parts["flights"] = tuple(
            FlightEstimate(
                samples=len(rows.time), noise=noise, goodness=goodness, repairs=rows.repairs, **each
            )
            for rows, noise, goodness, each in flights
        )
        return parts


def measure_flow(
    prepared: Prepared, proposals: Sequence[Proposal], free: tuple[str, ...] | str, *, shapes: bool
) -> Measured | None:
    """Measure what is proposed, best first; None where nothing is.

    Args:
        prepared: the flights.
        proposals: of the search.
        free: names of `FREEDOMS` to be freed beside the library's unknowns; "auto": whatever is
            found to be a cause.
        shapes: whether freer shapes than proposed are answers.
    """
    if not proposals:
        return None
    logs = [FlightLog.of_flight(flight) for flight in prepared.flights]
    evident = ("latency",) if any(prepared.latencies) else ()
    asked = evident if free == "auto" else free
    names = tuple(dict.fromkeys((*prepared.library.unknown, *asked)))
    late = prepared.latencies if "latency" in names else [0.0] * len(logs)
    constants = [
        own for name in names for own in FREEDOMS[name].elements if not FREEDOMS[name].wanders
    ]
    near = NEAR * math.pi / prepared.search.extent
    least, grid = min(own.residual for own in proposals), prepared.library.grid
    likely = []
    for own in proposals:
        lengths = math.sqrt(2.0) * math.pi / np.hypot(*own.wavevectors.T)
        within = (lengths > 0.75 * grid.lower).all() and (lengths < 1.25 * grid.upper).all()
        if own.residual <= WORSE * least and within:
            likely.append(own)
    starts: list[tuple[bool, Posterior, Proposal]] = []
    chosen = lobes(likely, near)[:MOST]
    chosen.sort(key=lambda own: len(own.wavevectors) % 2)  # an odd number makes no cells
    for proposal in chosen:
        if len(proposal.wavevectors) % 2 and not all(loose for loose, _, _ in starts):
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
        there = fitted(logs, models)
        for name in names:
            if there is not None and FREEDOMS[name].wanders:
                there = fitted(logs, with_process(there.models, process_of(name, there)), there)
        if there is not None and alike(there, proposal, near):
            starts.append((_loose(there), there, proposal))
    if not starts:
        return None
    (_, first, proposal), *others = sorted(starts, key=lambda own: (own[0], own[1].bic))
    diagnosis = Diagnosis(first, first)
    goodness = Goodness.of(first, diagnosis)
    white = goodness.whiteness > 1e-6 or first.exact or first.pushed
    clear = white and goodness.r_squared > EXPLAINED and proposal.residual < MOSTLY
    excess = math.inf if clear else _excess(prepared, logs, first)
    followed = not prepared.too_fast(first.model.pattern.length_scale)
    if followed and (excess > -HIDDEN or goodness.r_squared > MOSTLY):
        around = max(near, STRAY * float(np.hypot(*proposal.wavevectors.T).min()))
        diagnosis = diagnose(
            logs, first, names, shapes=shapes, inside=lambda own: alike(own, proposal, around)
        )
    posterior, suspects = diagnosis.believed, diagnosis.suspects
    of_flow = any(own.of_flow for own in suspects)
    refitted = diagnosis.posterior is not diagnosis.believed
    slight = refitted and not of_flow and _apart(posterior, diagnosis.posterior) < SLIGHT
    if free == "auto" or (suspects and len(logs) == 1 and slight):
        posterior, suspects = diagnosis.posterior, ()
    rivals, walks = list[Proposal](), diagnosis.posterior.model.disturbance.processes
    for loose, there, rival in others:
        near_both = min(_apart(own, there) for own in (first, diagnosis.posterior)) <= APART
        if loose or near_both or there.bic - first.bic >= CLOSE:
            continue
        beside: Posterior | None = there
        if len(walks) == 1 and not diagnosis.suspects:  # both in turbulence
            beside = fitted(logs, with_process(there.models, walks[0]), there)
        if beside and (beside is there or beside.bic - diagnosis.posterior.bic < CLOSE):
            rivals.append(rival)
    goodness = Goodness.of(posterior, diagnosis)
    excess += 2 * (diagnosis.posterior.log_likelihood - first.log_likelihood)
    excess -= 4 * (len(diagnosis.posterior.names) - len(first.names))
    freed = (*names, *(own.free for own in diagnosis.suspects if not suspects))
    return Measured(
        proposal, tuple(proposals), diagnosis, posterior, suspects, freed, goodness,
        rivals[0] if rivals else None, excess > 0,
    )  # fmt: skip


def _loose(posterior: Posterior) -> bool:
    """Whether waves make no cells; cells come first, and the rest is turbulence."""
    waves = posterior.model.pattern.waves
    parts = flows_of(waves[:, :2], waves[:, 2:4])
    return len(waves) % 2 == 1 or (len(waves) == 4 and len(parts) == 1)


def lobes(proposals: Sequence[Proposal], near: float) -> list[Proposal]:
    """The proposal with fewest parameters of each set of waves that are near to each other."""
    chosen: list[Proposal] = []

    def freedom(proposal: Proposal) -> tuple[int, bool]:
        return SHAPES.index(proposal.shape), proposal.velocity is not None

    for own in proposals:
        for place, other in enumerate(chosen):
            if _near(own.wavevectors, other.wavevectors, near):
                chosen[place] = min(other, own, key=freedom)
                break
        else:
            chosen.append(own)
    return chosen


def alike(posterior: Posterior, proposal: Proposal, near: float) -> bool:
    """Whether an optimum is still in the lobe of its proposal."""
    return _near(posterior.model.pattern.waves[:, :2], proposal.wavevectors, near)


def _near(waves: Array, others: Array, near: float) -> bool:
    """Whether every wave (j, 2) has one of as many others nearby, of either sign."""
    if len(waves) != len(others):
        return False
    apart = np.minimum(*(np.linalg.norm(waves[:, None] + s * others, axis=2) for s in (-1, 1)))
    return bool((apart.min(axis=1) < near).all() and (apart.min(axis=0) < near).all())


def _apart(posterior: Posterior, other: Posterior) -> float:
    """The larger of the relative differences of U0 and L."""
    return max(map(abs, posterior.model.pattern.apart(other.model.pattern)))


def _excess(prepared: Prepared, logs: Sequence[FlightLog], posterior: Posterior) -> float:
    """2 ln(likelihood ratio) of a flow against turbulence of its size, less that by chance."""
    pattern = posterior.model.pattern
    speed, length = pattern.mean_velocity, pattern.length_scale
    still = StreamPattern("axis", (1e-6 * speed, length, 0.0, 0.0), origin=pattern.origin)
    calm: list[Model] = []
    for model in posterior.models:
        air = replace(model.disturbance, processes=())
        bare = replace(model, pattern=still, fixed=still.names, disturbance=air)
        calm.append(bare.free(*WIND))
    gusts = replace(process_of("turbulence", posterior), level=0.5 * speed)
    nothing = fitted(logs, with_process(calm, gusts))
    if nothing is None:
        return -math.inf
    odds = max(len(prepared.search.lobes), 1) / FALSE_ALARM
    chance = 2 * math.log(odds) + len(pattern.names)
    return 2 * (posterior.log_likelihood - nothing.log_likelihood) - chance


def read_waves(waves: Array) -> Array:
    """U0 [m/s], L [m], tau_w [s], L_x, L_y [m] and heading [rad] of waves (j, 5); NaN of one."""
    cells = read_cells(waves[:, :2], waves[:, 2:4])
    speed, scale = cells.mean_velocity, cells.length_scale
    timescale = scale / speed if speed else math.inf
    return np.array([speed, scale, timescale, *cells.length_scales, cells.heading])
