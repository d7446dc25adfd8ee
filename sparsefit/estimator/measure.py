"""The flow at the maximum of its likelihood, from what the search proposes.

Each lobe that the search proposes is a start; the likelihood decides between them by BIC, and so it
does among shapes, causes and disturbances from there (`sparsefit.likelihood.causes`). An optimum
whose waves have left the lobe of the proposal that they started from is not believed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sparsefit.arrays import Array
from sparsefit.cached import cached_property
from sparsefit.estimator.intervals import read_with_errors
from sparsefit.estimator.prepare import Prepared
from sparsefit.likelihood.causes import (
    FREEDOMS,
    SLIGHT,
    Diagnosis,
    Suspect,
    diagnose,
    disturbed,
    fitted,
    with_process,
)
from sparsefit.likelihood.goodness import Goodness, explained, whiteness
from sparsefit.likelihood.model import Model, Process
from sparsefit.likelihood.nodes import FlightLog
from sparsefit.likelihood.pattern import SHAPES, StreamPattern
from sparsefit.likelihood.posterior import Posterior
from sparsefit.model import Proposal
from sparsefit.model.shapes import flows_of

WORSE = 3.0  # times the least RSS of the rows: a proposal that leaves more is not measured
MOST = 5  # lobes that are measured
CLOSE = 10.0  # of BIC: a rival that near could be the flow too
NEAR = 0.5  # in pi/extent: how far an optimum's waves may be from those that were proposed
APART = 0.02  # of U0 or L: rivals that differ by less say the same
LINEAR = 1e6  # [s], the response time of a vehicle whose drag is quadratic alone
FALSE_ALARM = 1e-3  # of a flow in a flight without one, over all lobes
CLEAR = 0.9  # of the air's variance: a flow that explains more is there


@dataclass(frozen=True, eq=False)
class Measured:
    """A flow at the maximum of its likelihood.

    Args:
        proposal: where it started.
        proposals: of the search, by the BIC of its rows.
        diagnosis: causes and disturbances beside it.
        posterior: that is answered with.
        suspects: the causes that are not answered with: a misfit.
        freed: the names of what was freed.
        waves: kx, ky [rad/m], omega [rad/s], a, b [m^2/s] of each wave (j, 5).
        covariance: of these, row by row, and of the wind: (5 j + 2, 5 j + 2).
        goodness: how well it explains the flights.
        rival: a proposal that explains them nearly as well, and says another U0 or L.
        detected: whether it explains more than chance and turbulence do.
    """

    proposal: Proposal
    proposals: tuple[Proposal, ...]
    diagnosis: Diagnosis
    posterior: Posterior
    suspects: tuple[Suspect, ...]
    freed: tuple[str, ...]
    waves: Array
    covariance: Array
    goodness: Goodness
    rival: Proposal | None
    detected: bool

    @property
    def drift(self) -> tuple[float, float]:
        """The velocity of the pattern [m/s]."""
        return self.posterior.model.pattern.drift

    @cached_property
    def flows(self) -> list[tuple[Array, Array]]:
        """The values of `intervals.read_waves` of each flow, and their standard errors."""
        every = []
        parts = flows_of(self.waves[:, :2], self.waves[:, 3:])
        if len(self.waves) > 4 and not len(self.waves) % 2:  # cells of several length scales
            parts = [[j, j + 1] for j in range(0, len(self.waves), 2)]
        for flow in parts:
            places = np.concatenate([np.arange(5 * j, 5 * j + 5) for j in flow])
            covariance = self.covariance[np.ix_(places, places)]
            every.append(read_with_errors(self.waves[flow], covariance))
        return every


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
    chosen = () if free == "auto" else tuple(free)
    names = tuple(dict.fromkeys((*prepared.library.unknown, *chosen)))
    parameters = [own for name in names for own in FREEDOMS[name]]
    near = NEAR * math.pi / prepared.search.lookout.extent
    trials: list[tuple[Posterior, Posterior | None, Proposal]] = []
    least, grid = min(own.residual for own in proposals), prepared.library.grid
    likely = [
        own
        for own in proposals
        if own.residual <= WORSE * least and _within(own, grid.lower, grid.upper)
    ]
    for proposal in lobes(likely, near)[:MOST]:
        models = [model.free(*parameters) for model in _models(prepared, proposal)]
        there = fitted(logs, models)
        if there is None:
            continue
        gusty = fitted(logs, with_process(there.models, gusts(there))) if disturbed(there) else None
        if all(_explained(own, proposal, near) for own in (there, gusty) if own is not None):
            trials.append((there, gusty, proposal))
    if not trials:
        return None
    trials.sort(key=_bic)
    best, gusty, proposal = trials[0]
    ready = [gusty] if gusty is not None else []
    diagnosis = diagnose(logs, best, [gusts(best)], names, shapes=shapes, ready=ready)
    posterior, suspects = diagnosis.believed, diagnosis.suspects
    alone = len(logs) == 1
    if free == "auto" or (suspects and alone and _slight(diagnosis)):
        posterior, suspects = diagnosis.posterior, ()
    rival = next(
        (
            trial[2]
            for trial in trials[1:]
            if _bic(trial) - _bic(trials[0]) < CLOSE and _apart(best, trial[0]) > APART
        ),
        None,
    )
    goodness = _goodness(posterior, diagnosis)
    waves, covariance = _waves(posterior)
    freed = (*names, *(suspect.free for suspect in diagnosis.suspects if not suspects))
    detected = goodness.r_squared > CLEAR or _detected(prepared, logs, posterior)
    return Measured(
        proposal,
        tuple(proposals),
        diagnosis,
        posterior,
        suspects,
        freed,
        waves,
        covariance,
        goodness,
        rival,
        detected,
    )


def _bic(trial: tuple[Posterior, Posterior | None, Proposal]) -> float:
    """The lower BIC of a start, with turbulence or without."""
    return min(own.bic for own in trial[:2] if own is not None)


def lobes(proposals: Sequence[Proposal], near: float) -> list[Proposal]:
    """The proposal with fewest parameters of each set of waves that are near to each other."""
    chosen: list[Proposal] = []
    for proposal in proposals:
        for place, other in enumerate(chosen):
            if _alike(proposal.wavevectors, other.wavevectors, near):
                chosen[place] = min(other, proposal, key=_freedom)
                break
        else:
            chosen.append(proposal)
    return chosen


def _within(proposal: Proposal, lower: float, upper: float) -> bool:
    """Whether the length scales of all waves are between bounds [m], but for a quarter."""
    lengths = math.sqrt(2.0) * math.pi / np.hypot(*proposal.wavevectors.T)
    return bool((lengths > 0.75 * lower).all() and (lengths < 1.25 * upper).all())


def _freedom(proposal: Proposal) -> int:
    """The place of a proposal's shape among shapes, by what it leaves free."""
    return 2 * SHAPES.index(proposal.shape) + proposal.drifting


def _alike(waves: Array, others: Array, near: float) -> bool:
    """Whether every wave (j, 2) has one of as many others nearby, of either sign."""
    if len(waves) != len(others):
        return False
    apart = np.minimum(
        np.linalg.norm(waves[:, None] - others, axis=2),
        np.linalg.norm(waves[:, None] + others, axis=2),
    )
    return bool((apart.min(axis=1) < near).all() and (apart.min(axis=0) < near).all())


def _models(prepared: Prepared, proposal: Proposal) -> list[Model]:
    """The models of a proposal, one per flight."""
    drift = proposal.drift if proposal.drifting else None
    pattern = StreamPattern.of_waves(
        proposal.shape, proposal.wavevectors, proposal.cosine, proposal.sine, drift
    )
    models = []
    for flight, vehicle in zip(prepared.flights, proposal.vehicles, strict=True):
        tau, measured = min(vehicle.response_time, LINEAR), flight.thrust is not None
        bias = vehicle.thrust_acceleration if measured else (0.0, 0.0)
        own = {
            "response_time": tau,
            "thrust_scale": vehicle.thrust_scale if measured else 1.0,
            "thrust_bias_x": bias[0],
            "thrust_bias_y": bias[1],
            "quadratic_drag": vehicle.drag * tau,
            "wind_x": proposal.background[0],
            "wind_y": proposal.background[1],
        }
        models.append(Model(pattern, own))
    return models


def gusts(posterior: Posterior) -> Process:
    """Turbulence, where the likelihood starts to seek its level: a wind that wanders."""
    pattern = posterior.model.pattern
    rate = pattern.mean_velocity / pattern.length_scale
    return Process("turbulence", ("wind_x", "wind_y"), 0.1 * pattern.mean_velocity, rate)


def _explained(posterior: Posterior, proposal: Proposal, near: float) -> bool:
    """Whether an optimum is still in the lobe of its proposal."""
    pattern = posterior.model.pattern
    return _alike(pattern.waves[:, :2], proposal.wavevectors, near)


def _slight(diagnosis: Diagnosis) -> bool:
    """Whether the causes move U0 and L by so little that their intervals may hold that."""
    return _apart(diagnosis.believed, diagnosis.posterior) < SLIGHT


def _apart(posterior: Posterior, other: Posterior) -> float:
    """The larger of the relative differences of U0 and L."""
    here, there = posterior.model.pattern, other.model.pattern
    return max(
        abs(there.mean_velocity / here.mean_velocity - 1),
        abs(there.length_scale / here.length_scale - 1),
    )


def _waves(posterior: Posterior) -> tuple[Array, Array]:
    """The waves (j, 5) in the flight's own coordinates, and the covariance of them and the wind."""
    pattern = posterior.model.pattern
    own = pattern.about((0.0, 0.0, 0.0))
    slopes = own.jacobian.reshape(len(own.waves), 5, -1)[:, [0, 1, 4, 2, 3]]
    waves = own.waves[:, [0, 1, 4, 2, 3]]
    places = [posterior.names.index(name) for name in pattern.names]
    gradient = np.zeros((slopes.shape[0] * 5 + 2, len(posterior.names)))
    moved = slopes.copy()
    x, y, t = pattern.origin
    # phases count from the origin in `covariance`: phi_0 = phi - k.x0 + omega t0
    shift = slopes[:, 0] * x + slopes[:, 1] * y - slopes[:, 2] * t
    a, b = waves[:, 3:4], waves[:, 4:5]
    if pattern.origin != (0.0, 0.0, 0.0):
        moved[:, 3], moved[:, 4] = slopes[:, 3] - b * shift, slopes[:, 4] + a * shift
    gradient[:-2, places] = moved.reshape(-1, slopes.shape[2])
    for row, name in enumerate(("wind_x", "wind_y"), len(gradient) - 2):
        if name in posterior.names:
            gradient[row, posterior.names.index(name)] = 1.0
    return waves, gradient @ posterior.covariance @ gradient.T


def _goodness(posterior: Posterior, diagnosis: Diagnosis) -> Goodness:
    """How well a posterior explains the flights."""
    model = posterior.model
    pattern = model.pattern
    speed = pattern.mean_velocity
    turbulence = float(np.mean([_gusts(own) for own in posterior.models]))
    noise = float(np.mean([_kicks(own, pattern) for own in posterior.models]))
    every = [whiteness(each) for each in posterior.innovations]
    least = 1 - (1 - min(every)) ** len(every)
    each: tuple[Goodness, ...] = ()
    if len(every) > 1:
        shares = [
            explained(speed**2 / 4, _gusts(own) + _kicks(own, pattern), 0.0)
            for own in posterior.models
        ]
        each = tuple(Goodness(share, own) for share, own in zip(shares, every, strict=True))
    return Goodness(
        explained(speed**2 / 4, turbulence, noise),
        least,
        diagnosis.turbulence_gain,
        math.sqrt(turbulence),
        math.sqrt(turbulence) / speed,
        diagnosis.suspects[0] if diagnosis.suspects else None,
        flights=each,
    )


def _gusts(model: Model) -> float:
    """The mean square of a component of the turbulence [m^2/s^2]."""
    return sum(own.level**2 for own in model.disturbance.processes if own.name == "turbulence")


def _kicks(model: Model, pattern: StreamPattern) -> float:
    """The mean square [m^2/s^2] of the wind that process noise is worth in the flow's band."""
    timescale = pattern.length_scale / pattern.mean_velocity
    tau = min(model.values["response_time"], timescale)
    return (model.disturbance.acceleration * tau) ** 2 / (2 * timescale)


def _detected(prepared: Prepared, logs: Sequence[FlightLog], posterior: Posterior) -> bool:
    """Whether a flow explains more than chance and turbulence of its own size do."""
    pattern = posterior.model.pattern
    names = set(pattern.names) - {"mean_velocity"}
    still = replace(
        StreamPattern("axis", (1e-6 * pattern.mean_velocity, pattern.length_scale, 0.0, 0.0)),
        origin=pattern.origin,
    )
    calm = [
        replace(
            own,
            pattern=still,
            fixed=still.names,
            disturbance=replace(own.disturbance, processes=()),
        ).free("wind_x", "wind_y")
        for own in posterior.models
    ]
    gusty = replace(gusts(posterior), level=0.5 * pattern.mean_velocity)
    nothing = fitted(logs, with_process(calm, gusty))
    if nothing is None:
        return False
    chance = 2 * math.log(max(len(prepared.search.lookout.lobes), 1) / FALSE_ALARM) + len(names) + 1
    return 2 * (posterior.log_likelihood - nothing.log_likelihood) > chance
