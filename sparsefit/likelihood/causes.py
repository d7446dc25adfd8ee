"""Causes of a misfit: parameters that may be freed, each tested by its gain in log-likelihood.

Beside the flow, the state-space model holds the vehicle, the air and the instruments at the values
that they are believed to have. At the optimum of the flow one forward pass with a column for every
parameter that is held gives the score b and the information J of all; freeing a group g of them
gains, to second order and with everything that is free already moving along,

    2 (log L_g - log L) = b_g' (J_gg - J_gf J_ff^-1 J_fg)^-1 b_g  ~  chi^2 of |g| degrees (Rao 1948)

where the model holds. A group whose chance is below `CHANCE`, over all groups, is fitted for good,
and the one that ends with the largest likelihood is the cause. Disturbances are tested with them:
turbulence is a wind that wanders, a coloured error of position a bias that does; the gain of one of
these is that of its level and rate, 2 degrees. What is found first is freed before the rest is
tested again, so that process noise is believed only where nothing else explains it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from sparsefit.arrays import Array
from sparsefit.errors import InputError
from sparsefit.likelihood.model import Model, Process
from sparsefit.likelihood.nodes import FlightLog
from sparsefit.likelihood.pattern import StreamPattern
from sparsefit.likelihood.posterior import Posterior, measure

CHANCE = 1e-4  # of a gain as large in a flight without a cause, over all groups
FITTED = 2  # groups of the least chance that are fitted for good
ROUNDS = 3  # causes and disturbances that are found one after another, at most
SEEN = 1e-9  # of an eigenvalue of the scaled information: a direction below it is not seen
REAL = 1.0  # degrees of freedom of the level of process noise: with fewer there is none
CLEAR = 8.0  # times the largest score: turbulence that gains more is what there is
TAKEN = 0.25  # of the variance of turbulence: a cause beside it takes away more
SLIGHT = 1e-3  # of U0 or L: a cause that moves neither by more only widens their intervals


class Cause(StrEnum):
    """What the model leaves unsaid of a flight."""

    WIND = "wind"
    GROWING_WIND = "growing-wind"
    RESPONSE_TIME = "response-time"
    THRUST = "thrust"
    THRUST_TURNED = "thrust-turned"
    DRAG = "drag"
    MASS = "mass"
    LAG = "lag"
    DECAY = "decay"
    SWELLING = "swelling"
    DRIFT = "drift"
    TURN = "turn"
    STRETCH = "stretch"
    VELOCITY_SCALE = "velocity-scale"
    POSITION_SCALE = "position-scale"
    VELOCITY_BIAS = "velocity-bias"
    LATENCY = "latency"
    ROTATION = "rotation"
    POSITION_NOISE = "position-noise"
    TURBULENCE = "turbulence"
    ANOTHER_FLOW = "another-flow"


FREEDOMS: dict[str, tuple[str, ...]] = {
    "wind": ("wind_x", "wind_y"),
    "wind_growth": ("wind_growth_x", "wind_growth_y"),
    "response_time": ("response_time",),
    "thrust_scale": ("thrust_scale",),
    "thrust_rotation": ("thrust_rotation",),
    "thrust_acceleration": ("thrust_bias_x", "thrust_bias_y"),
    "drag": ("quadratic_drag",),
    "mass": ("mass_rate",),
    "lag": ("lag",),
    "growth": ("growth",),
    "velocity_scale": ("velocity_scale",),
    "position_scale": ("position_scale",),
    "velocity_bias": ("velocity_bias_x", "velocity_bias_y"),
    "latency": ("latency",),
    "velocity_rotation": ("velocity_rotation",),
}
"""Parameters by the name under which they are freed."""
CAUSES: dict[Cause, str] = {
    Cause.RESPONSE_TIME: "response_time",
    Cause.THRUST: "thrust_scale",
    Cause.THRUST_TURNED: "thrust_rotation",
    Cause.WIND: "wind",
    Cause.GROWING_WIND: "wind_growth",
    Cause.DRAG: "drag",
    Cause.MASS: "mass",
    Cause.LAG: "lag",
    Cause.DECAY: "growth",
    Cause.VELOCITY_SCALE: "velocity_scale",
    Cause.POSITION_SCALE: "position_scale",
    Cause.VELOCITY_BIAS: "velocity_bias",
    Cause.LATENCY: "latency",
    Cause.ROTATION: "velocity_rotation",
}
"""What is freed of each cause."""
ALIKE = (  # groups of which one alone may be free: their columns are the same, or nearly
    {"wind", "thrust_acceleration", "thrust_scale", "thrust_rotation"},
    {"velocity_scale", "position_scale"},
)

OF_MOTION = {"response_time", "drag", "mass", "lag", "thrust_scale", "thrust_rotation"}
"""What turbulence, which moves the vehicle too, says nothing of."""


@dataclass(frozen=True)
class Suspect:
    """A cause of a misfit, and how large it is.

    Args:
        cause: what it is.
        size: the change of each parameter that is freed, in its own unit.
        p_value: of a gain in likelihood as large by chance, over all causes that were tested.
        share: 2 ln(likelihood ratio) of the cause against none.
        free: the name under which it is freed.
        flight: of several flights the number of the one that says so, from 1; else 0.
    """

    cause: Cause
    size: tuple[float, ...]
    p_value: float
    share: float
    free: str = ""
    flight: int = 0


@dataclass(frozen=True, eq=False)
class Gain:
    """What freeing a group of parameters would gain, to second order.

    Args:
        gain: 2 ln(likelihood ratio).
        step: of the parameters (g,), everything else that is free moving along.
        error: their standard errors (g,).
    """

    gain: float
    step: Array
    error: Array


@dataclass(frozen=True)
class Trial:
    """One departure from a model that is fitted for good.

    Args:
        models: of each log, with the departure.
        freedom: how many parameters it has more.
        cause: what it would be; None of a shape that may be chosen, and of a disturbance.
        free: the name of what it frees, or of the disturbance.
        flight: that it is about, of several; else 0.
    """

    models: tuple[Model, ...]
    freedom: int
    cause: Cause | None = None
    free: str = ""
    flight: int = 0


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """What explains a flight beside the flow that was proposed.

    Args:
        posterior: with all causes freed that were found, and the disturbances that are there.
        believed: with the disturbances and the shape alone.
        suspects: the causes in the order in which they were found.
        growth: of U0 in time, at the posterior.
        turbulence_gain: 2 ln(likelihood ratio) of the disturbances that wander; 0 without any.
    """

    posterior: Posterior
    believed: Posterior
    suspects: tuple[Suspect, ...] = ()
    growth: Gain | None = None
    turbulence_gain: float = 0.0


def diagnose(
    logs: Sequence[FlightLog],
    posterior: Posterior,
    disturbances: Sequence[Process],
    freed: Sequence[str] = (),
    *,
    shapes: bool = True,
    ready: Sequence[Posterior] = (),
) -> Diagnosis:
    """Find causes, disturbances and a freer shape, one after another, from a flow's optimum.

    Args:
        logs: of the flights.
        posterior: of the flow with white process noise.
        disturbances: processes that are tried, at the level and rate where they start.
        freed: names of `FREEDOMS` that are free already.
        shapes: whether a freer shape is an answer, and not a misfit.
        ready: posteriors with each of the disturbances, where they are there already.
    """
    believed, suspects, closed, wandering = posterior, list[Suspect](), set(freed), 0.0
    remaining = list(disturbances)
    known = {own.name: there for own, there in zip(disturbances, ready, strict=False)}
    for _ in range(ROUNDS):
        closed_too = {name for group in ALIKE if group & closed for name in group}
        closed_too |= OF_MOTION if wandering else set()
        causes = {name: cause for cause, name in CAUSES.items() if name not in closed | closed_too}
        groups = {name: FREEDOMS[name] for name in causes} | shape_groups(posterior.model)
        gains = gains_of(posterior, groups)
        tests = len(gains)
        trials: list[Trial] = []
        likely = [
            (name, flight, gain)
            for (name, flight), gain in gains.items()
            if tests * chance_of(gain.gain, len(gain.step)) < CHANCE
        ]
        most = max((gain.gain for _, _, gain in likely), default=1.0)
        for name, flight, gain in sorted(likely, key=lambda group: -group[2].gain)[:FITTED]:
            if name in SHAPE_GROUPS:
                trials += freer(posterior.models, name, answers=shapes)
                continue
            steps = zip(FREEDOMS[name], gain.step.tolist(), strict=True)
            values = {own: posterior.value(own) + step for own, step in steps}
            models = tuple(
                model.free(*values).at(values if number == flight or not flight else {})
                for number, model in enumerate(posterior.models, 1)
            )
            trials.append(Trial(models, len(values), causes[name], name, flight))
        for process in remaining if disturbed(posterior) else ():
            there = known.get(process.name)
            if (
                there
                and most
                and 2 * (there.log_likelihood - posterior.log_likelihood) > CLEAR * most
            ):
                trials = []
            trials.append(Trial(with_process(posterior.models, process), 2, free=process.name))
        best: tuple[Trial, Posterior] | None = None
        for trial in trials:
            there = known.pop(trial.free, None) if not trial.cause else None
            there = there or fitted(logs, trial.models, posterior if trial.cause else None)
            if there is None or (trial.cause and wandering and not calmer(there, posterior)):
                continue
            if usable(there) and (best is None or merit(trial, there) > merit(*best)):
                best = trial, there
        if best is None:
            break
        trial, there = best
        gain_of_it = 2.0 * (there.log_likelihood - posterior.log_likelihood)
        chance = min(1.0, tests * chance_of(gain_of_it, trial.freedom))
        if not chance < CHANCE:
            break
        if trial.cause is not None:
            names = FREEDOMS.get(trial.free, ())
            own = max(trial.flight, 1) - 1
            before, after = (each.models[own].values for each in (posterior, there))
            size = tuple(after[name] - before[name] for name in names)
            suspects.append(
                Suspect(trial.cause, size, chance, gain_of_it, trial.free, trial.flight)
            )
            closed.add(trial.free)
        elif trial.free:
            remaining = [process for process in remaining if process.name != trial.free]
            wandering += gain_of_it
        posterior = there
        believed = believed if suspects else there
    growth = gains_of(posterior, {"growth": FREEDOMS["growth"]}).get(("growth", 0))
    return Diagnosis(posterior, believed, tuple(suspects), growth, wandering)


def fitted(
    logs: Sequence[FlightLog], models: Sequence[Model], start: Posterior | None = None
) -> Posterior | None:
    """The posterior of models of logs, all their levels estimated.

    start: an optimum nearby, whose tracks and levels are gone on from; without one the levels of
    the sensors start from the logs' own noise.
    """
    starts = []
    for log, model in zip(logs, models, strict=True):
        places, speeds = log.noise
        fresh = replace(
            model.disturbance, acceleration=0.0, position_noise=places, velocity_noise=speeds
        )
        starts.append(model if start else replace(model, disturbance=fresh))
    try:
        return measure(logs, starts, tuple(models[0].disturbance.levels), start)
    except InputError:  # steps that are too short for the log's gaps, or no number any more
        return None


def usable(posterior: Posterior) -> bool:
    """Whether a posterior may be compared with others: at its maximum, or nearly."""
    return posterior.converged or posterior.reason.startswith("not at the maximum")


def with_process(models: Sequence[Model], process: Process) -> tuple[Model, ...]:
    """The models with one more disturbance."""
    return tuple(
        replace(
            model,
            disturbance=replace(
                model.disturbance, processes=(*model.disturbance.processes, process)
            ),
        )
        for model in models
    )


def gains_of(
    posterior: Posterior, groups: dict[str, tuple[str, ...]]
) -> dict[tuple[str, int], Gain]:
    """Score tests of groups of parameters from one forward pass at an optimum.

    Args:
        posterior: the optimum.
        groups: names of parameters that are not free.

    Returns:
        Gains by the name of a group and the number of the flight, from 1, whose own parameters they
        are; 0 of one flight alone, and of what all flights share.
    """
    local = posterior.model.names
    members = dict.fromkeys(own for group in groups.values() for own in group)
    names, score, information = posterior.scores([own for own in members if own not in local])
    base = [place for place, name in enumerate(names) if name.partition("@")[0] in local]
    gains = {}
    for group, members_of in groups.items():
        for flight in range(1, len(posterior.legs) + 1):
            suffix = f"@{flight}" if flight > 1 else ""
            if f"{members_of[0]}{suffix}" in names:
                added = [names.index(f"{own}{suffix}") for own in members_of]
                apart = f"{members_of[0]}@2" in names
                gains[group, flight * apart] = _gain(score, information, base, added)
    return gains


def _gain(score: Array, information: Array, base: list[int], added: list[int]) -> Gain:
    """The gain of adding columns to a base: chi^2 of their efficient score."""
    size = np.sqrt(np.maximum(np.diag(information), 1e-300))
    scaled = information / size[:, None] / size
    b = score / size
    cross = np.linalg.lstsq(scaled[np.ix_(base, base)], scaled[np.ix_(base, added)], rcond=1e-12)[0]
    efficient = b[added] - cross.T @ b[base]
    left = scaled[np.ix_(added, added)] - cross.T @ scaled[np.ix_(base, added)]
    roots, axes = np.linalg.eigh(0.5 * (left + left.T))
    seen = roots > SEEN
    along = axes[:, seen].T @ efficient
    step = axes[:, seen] @ (along / roots[seen]) / size[added]
    error = np.sqrt(np.sum(axes[:, seen] ** 2 / roots[seen], axis=1)) / size[added]
    return Gain(float(np.sum(along**2 / roots[seen])), step, error)


def merit(trial: Trial, posterior: Posterior) -> float:
    """The log-likelihood less half a unit of BIC's price for each parameter that is freed."""
    return posterior.log_likelihood - 2.0 * trial.freedom


def chance_of(gain: float, freedom: int) -> float:
    """The probability that chi^2 of so many degrees exceeds a gain (Wilks 1938)."""
    from scipy.special import chdtrc

    return float(chdtrc(freedom, max(gain, 0.0)))


def disturbed(posterior: Posterior) -> bool:
    """Whether there is process noise: its level takes more than a degree of freedom."""
    if posterior.exact:
        return False
    information = np.atleast_2d(posterior.level_information)
    return bool(information.size) and float(information[0, 0]) > REAL


def calmer(there: Posterior, here: Posterior) -> bool:
    """Whether one posterior has less of every disturbance that wanders than another, by `TAKEN`."""
    before, after = (own.model.disturbance.processes for own in (here, there))
    pairs = zip(before, after, strict=True)
    return all(new.level**2 <= (1 - TAKEN) * old.level**2 for old, new in pairs)


SHAPE_GROUPS = ("waves", "drift")


def shape_groups(model: Model) -> dict[str, tuple[str, ...]]:
    """The elements of two waves that a shape binds, by the name of their group."""
    pattern = model.pattern
    if len(pattern.waves) != 2:
        return {}
    groups: dict[str, tuple[str, ...]] = {}
    if pattern.shape in ("axis", "square", "rectangle"):
        groups["waves"] = ("kx_1", "ky_1", "kx_2", "ky_2")
    if not pattern.drifting:
        groups["drift"] = ("frequency_1", "frequency_2")
    return groups


def freer(models: Sequence[Model], group: str, *, answers: bool) -> list[Trial]:
    """The freer shapes with the waves of given models, as trials.

    Args:
        models: that share a pattern.
        group: "drift" or "waves".
        answers: whether these are answers, and no causes of a misfit.
    """
    pattern = models[0].pattern
    kx, ky, a, b, _ = pattern.waves.T
    shapes = ("axis", "square", "rectangle", "pair")
    moving = group == "drift" or pattern.drifting
    first = shapes.index(pattern.shape)
    trials = []
    for name in [pattern.shape] if group == "drift" else shapes[first + 1 :]:
        there = StreamPattern.of_waves(
            name, np.column_stack([kx, ky]), a, b, pattern.drift if moving else None
        )
        there = replace(there, origin=pattern.origin)
        cause = Cause.TURN if name == "square" else Cause.STRETCH
        cause = Cause.DRIFT if group == "drift" else cause
        more = len(there.values) - len(pattern.values)
        moved = tuple(replace(model, pattern=there) for model in models)
        trials.append(Trial(moved, more, None if answers else cause))
    return trials
