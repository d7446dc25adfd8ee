"""The search for causes of a misfit, each tested by its gain in log-likelihood.

Beside the flow, the state-space model holds the vehicle, the air and the instruments at assumed
values. At the optimum one forward pass with a column for every known element gives the score b and
the information J of all; freeing a group g gains, to second order, all that is free moving along,

    2 (log L_g - log L) = b_g' (J_gg - J_gf J_ff^-1 J_fg)^-1 b_g  ~  chi^2 of |g| degrees (Rao 1948)

where the model holds. The most likely groups are fitted for good, and so are elements that walk:
turbulence is a wind that does, a swell a gain, a coloured error of position a bias; these gain by
a level and a rate, 2 degrees. The departure of the largest likelihood is freed before the rest is
tested again, so that process noise is believed only where nothing else explains a flight.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from sparsefit.arrays import Array
from sparsefit.likelihood.causes import BIAS, FREEDOMS, GAIN, SHAPES, WIND, Cause, Suspect
from sparsefit.likelihood.gains import Gain, chance_of, gains_of, groups_of
from sparsefit.likelihood.model import Model, Process
from sparsefit.likelihood.pattern import StreamPattern
from sparsefit.likelihood.posterior import SHORT, Posterior, measure
from sparsefit.likelihood.readings import FlightLog

FALSE_ALARM = 1e-4  # of a gain as large in a flight without a cause, over all groups
FITTED = 3  # groups of the largest gains that are fitted for good
ROUNDS = 4  # departures that are freed one after another, at most
CLEAR = 8.0  # times a second-order gain: a fit that gained more ends the search
TUNED = 3.0  # the factor between the rates of a process that are tried
DEGREES, MOST_PARTS = 5.0, 64  # of freedom of a part with gusts of its own level; of parts
FLATTEST = 1e-4  # the least variance of a component of gusts, over that of the other
LAST = 60  # passes towards an answer that has not converged
HINT = 0.1  # the p-value below which a cause that is not freed widens the intervals
FACTOR = 3.0  # by which a scale or a response time may be off
LATEST = 0.2  # of half the log: the longest latency
LOST = 100.0  # of log-likelihood in one pass, more than BIC gains by a simpler shape
CHANCE = 2.0  # of log-likelihood: the gain of a level that may be chance
COLOURED = 1e-3  # the p-value of innovations that are not white
TWO_WAVES = ("axis", "square", "rectangle", "pair")  # shapes, each freer than those before
SCANNED = (0.03, 0.1, 0.3, 1.0)  # shares of a level at which a process is first looked for
ABSENT = 1e-6  # the share of a flight, of several, without the process

Refit = Callable[[Sequence[Model], Posterior, float], Posterior | None]
"""The posterior of models near another one; None if it is unusable, of another flow, or does not
come to a log-likelihood."""


@dataclass(frozen=True)
class Trial:
    """One departure from a model, to be fitted."""

    models: tuple[Model, ...]  # of each log, with the departure
    freedom: int  # the number of additional parameters
    cause: Cause | None = None  # None of a shape that may be the answer
    free: str = ""  # the name under which it is freed
    flight: int = 0  # of several, the one concerned; else 0

    @property
    def suspicious(self) -> bool:
        """True where the diagnosis is a misfit."""
        return self.cause is not None and not self.cause.answered

    def suspect(self, before: Posterior, after: Posterior, chance: float, gain: float) -> Suspect:
        """The cause, with the change of its elements or the level of its process."""
        assert self.cause is not None
        size, flight = tuple[float, ...](), self.flight
        if self.cause.wanders:  # each flight has a level of its own
            levels = [own.levels.get(self.free, 0.0) for own in after.models]
            size = (max(levels),)
            flight = 1 + levels.index(max(levels)) if len(levels) > 1 else 0
        else:
            here, there = (own.models[max(flight, 1) - 1].values for own in (before, after))
            size = tuple(there[name] - here[name] for name in self.cause.elements if name in here)
        return Suspect(self.cause.name, size, chance, gain, self.free, flight)


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """The causes and disturbances found beside a proposed flow."""

    posterior: Posterior  # with all causes freed, and the disturbances that are there
    believed: Posterior  # with the disturbances and the shape alone
    suspects: tuple[Suspect, ...] = ()  # the causes, the largest gain first
    growth: tuple[float, float] = (math.nan, math.nan)  # of U0 [1/s], and its standard error
    turbulence_gain: float = 0.0  # 2 ln(likelihood ratio) of the disturbances that walk
    ambiguity: tuple[float, float] = (0.0, 0.0)  # relative spread of U0 and L among likely causes


def diagnose(
    logs: Sequence[FlightLog],
    posterior: Posterior,
    freed: Sequence[str] = (),
    *,
    shapes: bool = True,
    least: float = -math.inf,
    inside: Callable[[StreamPattern], bool] = lambda pattern: True,
) -> Diagnosis:
    """Find causes, disturbances and a freer shape, one after another, from a flow's optimum.

    Args:
        logs: of the flights.
        posterior: of the flow with white process noise.
        freed: names of `FREEDOMS` that are free already.
        shapes: whether a freer shape may be the answer; else it is a misfit.
        least: the log-likelihood without which a diagnosis is of no use.
        inside: whether waves are those of the proposed flow.
    """
    first = believed = posterior
    suspects, closed, wandering = list[Suspect](), set(freed), 0.0
    start, tests, gains = None, 1, dict[tuple[str, int], Gain]()
    rivals: list[tuple[Posterior, Posterior, bool]] = []
    fits: list[tuple[Trial, Posterior]] = []

    def refit(
        models: Sequence[Model], near: Posterior, least: float = -math.inf, *, last: bool = False
    ) -> Posterior | None:
        there = measure(
            logs, models, near, LAST if last else SHORT, least, rough=not last, inside=inside
        )
        if there is None or not (usable(there) and inside(there.model.pattern)):
            return None
        return there

    def attempt(trials: Iterable[Trial]) -> None:
        """Fit trials, but those that come nowhere near the best; keep the plausible ones."""
        for trial in trials:
            enough = max(posterior.log_likelihood, least)
            if leaders := list(filter(eligible, fits)):
                leader = max(leaders, key=merit)
                rivalry = max(leader[1].evidence, CHANCE) if leader[0].suspicious else 0.0
                enough = max(enough, merit(leader) + 2.0 * trial.freedom - rivalry)
            there = refit(trial.models, posterior, enough)
            if there is not None and plausible(there, first):
                fits.append((trial, there))

    def merit(attempt: tuple[Trial, Posterior]) -> float:
        return attempt[1].log_likelihood - 2.0 * attempt[0].freedom

    def eligible(attempt: tuple[Trial, Posterior]) -> bool:
        """Whether a cause that is tested beside a process has converged."""
        return attempt[1].converged or not (attempt[0].suspicious and wandering)

    for _ in range(0 if posterior.exact else ROUNDS):
        start = posterior
        gains = gains_of(start, groups_of(start.model, closed))
        tests = len(gains)
        fits.clear()
        likely = [
            (name, flight, gain)
            for (name, flight), gain in sorted(gains.items(), key=lambda item: -item[1].gain)
            if tests * chance_of(gain.gain, len(gain.step)) < FALSE_ALARM
        ]
        needed = 2.0 * CHANCE  # of a first gain, to compete
        for name, cause in FREEDOMS.items() if disturbed(start) else ():
            if not cause.wanders or name in closed:
                continue
            first_gain, models = scanned(start, process_of(name, start))
            if first_gain > needed:
                attempt([Trial(models, 1 + len(models), cause, name)])
                most = max(map(merit, fits), default=-math.inf)
                needed = max(needed, 2.0 * (most - start.log_likelihood) / CLEAR)
        if likely and _releveled(start, likely[0][2].gain) > needed:
            attempt([
                Trial(
                    tuple(own.free(*FREEDOMS[name].elements) for own in start.models),
                    len(FREEDOMS[name].elements), FREEDOMS[name], name, flight,
                )
                for name, flight, gain in likely
                if name in FREEDOMS and _releveled(start, gain.gain) > needed
            ][:FITTED])  # fmt: skip
            for name in dict.fromkeys(name for name, _, _ in likely if name in SHAPES):
                attempt(freer(start.models, name, answers=shapes))
        if not (candidates := list(filter(eligible, fits))):
            break
        best, there = max(candidates, key=merit)
        gain_of_it = 2.0 * (there.log_likelihood - start.log_likelihood)
        gain_of_it /= start.inflation if best.suspicious else 1.0
        chance = min(1.0, tests * chance_of(gain_of_it, best.freedom))
        if not chance < FALSE_ALARM:
            break
        if best.cause is not None and best.cause.wanders:
            there = _tuned(refit, there, best.free)
            there = _varied(refit, there, shapes) if best.free == "turbulence" else there
            wandering += gain_of_it
        rivals += [(there, start, True)] if suspects else []
        if best.suspicious:
            suspects.append(best.suspect(start, there, chance, gain_of_it))
            rivals += [
                (there, own, False) for trial, own in fits if trial.suspicious and trial is not best
            ]
        closed.add(best.free)
        posterior, believed = there, believed if suspects else there
    suspects.sort(key=lambda own: -own.share)
    if posterior is not first:
        posterior = _simplest(refit, posterior)
    changed = posterior is not start
    answers = [posterior, believed] if suspects else [posterior]
    for place, own in enumerate(answers):  # intervals are those at the maximum
        if usable(own) and not (own.converged and own.fine):
            answers[place] = refit(own.models, own, last=True) or own
    posterior, believed = answers[0], answers[-1]
    growth = posterior.value("growth"), posterior.error("growth")
    if "growth" not in posterior.names:
        grown = gains_of(posterior, {"growth": ("growth",)}) if changed else gains
        growth = float(grown["growth", 0].step[0]), float(grown["growth", 0].error[0])
    shares = _ambiguity(posterior, believed, rivals) if suspects else (0.0, 0.0)
    if not changed:  # gains of the last round, in which nothing was freed
        hints = [
            own.moves for own in gains.values() if tests * chance_of(own.gain, len(own.step)) < HINT
        ]
        shares = tuple(np.max([shares, *np.abs(hints).tolist()], axis=0).tolist())
    return Diagnosis(posterior, believed, tuple(suspects), growth, wandering, shares)


def _releveled(start: Posterior, gain: float) -> float:
    """The gain where the level of the noise falls with it: -n ln(1 - gain/n) of n readings.

    At a level that stays no cause gains more than the readings there are, however exact it is.
    """
    count = sum(int((leg.weights > 0.0).sum()) for leg in start.legs)
    return -count * math.log1p(-min(gain / count, 1.0 - 1e-9))


def _ambiguity(
    posterior: Posterior, believed: Posterior, rivals: Sequence[tuple[Posterior, Posterior, bool]]
) -> tuple[float, float]:
    """The relative differences of U0 and L between causes that the logs cannot distinguish.

    Process noise that remains beside a cause is a misfit that no cause explains: likelihoods that
    differ by less than it gains say nothing of which cause is right. Where a cause is not all that
    departs from the model, both may stand for a third: a flow is as sure as before and after agree
    (rivals that are marked, whatever their likelihoods). The model has a lag l to first order: the
    second is l (1/(tau - l) + |k.v|/2) of it, and may move a flow by as much.
    """
    unexplained = max(posterior.evidence, CHANCE)
    lag, turning = abs(posterior.value("lag")), math.pi / posterior.model.pattern.length_scale
    rate = 1.0 / abs(posterior.value("response_time") - lag)
    second = lag * (rate + 0.5 * turning * posterior.legs[0].log.speed)
    shares = [second * np.abs(posterior.model.pattern.apart(believed.model.pattern))]
    for best, other, marked in rivals:
        if marked or other.log_likelihood > best.log_likelihood - unexplained:
            shares.append(np.abs(best.model.pattern.apart(other.model.pattern)))
    speed, length = np.max(shares, axis=0).tolist()
    return speed, length


def scanned(start: Posterior, process: Process) -> tuple[float, tuple[Model, ...]]:
    """The gain of a process at the best of some levels, tracks as they are, and its models there.

    Each of several flights has a level of its own, which may be nothing.
    """
    alone, values, tried = len(start.legs) == 1, list[list[float]](), [(0.0, start.models)]
    for share in SCANNED if alone else (*SCANNED, ABSENT):
        models = with_process(start.models, replace(process, level=share * process.level))
        step = start.under(models)
        values.append([own.value for own in step.passes])
        tried.append((2.0 * (step.reached - start.log_likelihood), models))
        if alone and tried[-1][0] < tried[-2][0]:  # there is one maximum
            break
    if not alone:
        best = np.where(np.isfinite(values), values, -np.inf).argmax(axis=0).tolist()
        models = tuple(tried[1 + level][1][flight] for flight, level in enumerate(best))
        tried[1:] = [(2.0 * (start.under(models).reached - start.log_likelihood), models)]
    return max(tried[1:], key=lambda own: own[0])


def _simplest(refit: Refit, posterior: Posterior) -> Posterior:
    """The posterior of the first simpler shape of two waves that has a lower BIC, if one has."""
    pattern, cells = posterior.model.pattern, TWO_WAVES
    simpler = cells[: cells.index(pattern.shape) + 1] if pattern.shape in cells else ()
    for drifting, name in product((False, True)[: 1 + pattern.drifting], simpler):
        simple = pattern.reshaped(name, drifting)
        fewer = len(pattern.values) - len(simple.values)
        if len(pattern.waves) == 2 and fewer > 0:
            models = [replace(model, pattern=simple) for model in posterior.models]
            gain = posterior.under(models).reached - posterior.log_likelihood
            least = posterior.log_likelihood - 6.0 * fewer  # BIC of 160,000 readings asks no more
            there = refit(models, posterior, least) if abs(gain) < LOST else None  # it has no more
            if there is not None and there.bic < posterior.bic:
                return there
    return posterior


def _tuned(refit: Refit, posterior: Posterior, name: str) -> Posterior:
    """The posterior at the most likely rate of a process, by steps of a factor."""

    def at(factor: float) -> list[Model]:
        """The models at another rate, as strong at frequencies above."""
        models = list[Model]()
        for model in posterior.models:
            own = next(own for own in model.processes if own.name == name)
            moved = replace(own, rate=own.rate * factor, level=own.level / math.sqrt(factor))
            models += with_process([model], moved)
        return models

    factor = max((TUNED, 1.0 / TUNED), key=lambda own: posterior.under(at(own)).reached)
    for _ in range(3):
        least = posterior.log_likelihood + 0.5
        there = refit(at(factor), posterior, least)
        if there is None or there.log_likelihood < least:
            break
        posterior = there
    return posterior


def _varied(refit: Refit, posterior: Posterior, directed: bool = True) -> Posterior:
    """The posterior with gusts that vary in time and by direction, where their scores say so.

    The score of a part of a log by the logarithm of its variance is a - n, of the variance n where
    all parts have one level; where they have not, each variance is multiplied by a/n, a few times.
    So is the covariance of the components: their scores in two frames are those of a matrix.
    directed: whether it may be; cells that are held in a wrong shape leave gusts of a direction.
    """
    for _ in range(ROUNDS):
        models = list[Model]()
        for leg in posterior.legs:
            gusts, frames = leg.model.processes[-1], list[Array]()
            last = leg.last or leg.forward(()).backward(np.zeros(0))  # none at levels just set
            count = min(max(float(last.squares[-1, 1]) / DEGREES, 1.0), MOST_PARTS)
            block = math.ceil(len(leg.track) / (len(gusts.course) or count))
            mixing = np.array(gusts.mixing or np.eye(2))
            for turn in (np.eye(2), math.sqrt(0.5) * np.array([[1.0, -1.0], [1.0, 1.0]])):
                turned = replace(gusts, mixing=_rows_of(mixing @ turn))
                track = np.hstack([leg.track[:, :-2], leg.track[:, -2:] @ turn])
                here = replace(leg, track=track).with_model(with_process([leg.model], turned)[0])
                last = here.forward((), block=block).backward(np.zeros(0))
                frames.append(last.parts[:, -2:])
            parts, sides = frames[0].sum(axis=1).T + 0.5, np.hstack(frames).sum(axis=0).T + 0.5
            in_time, by_side = (
                chance_of(float(np.sum((a - n) ** 2 / n)), freedom) < FALSE_ALARM
                for (a, n), freedom in ((parts, len(parts.T)), (sides, 2))
            )
            if gusts.course or in_time:
                before = gusts.course or (1.0,)  # of as many parts, but for rounding
                ends, places = (np.linspace(0.0, 1.0, len(own)) for own in (parts.T, before))
                course = np.interp(ends, places, before) * parts[0] / parts[1]
                gusts = replace(gusts, course=tuple((course / course.mean()).tolist()))
            if directed and (gusts.mixing or by_side) and np.isfinite(sides).all():
                a, n = ([[x, 0.5 * (u - v)], [0.5 * (u - v), y]] for x, y, u, v in sides)
                size, axes = np.linalg.eigh(n)
                white = mixing @ (axes / np.sqrt(np.maximum(size, 0.5))) @ axes.T
                size, axes = np.linalg.eigh(white @ a @ white.T)
                size = np.maximum(size, FLATTEST * size[-1])  # rounding, in logs without noise
                gusts = replace(gusts, mixing=_rows_of(axes * np.sqrt(size / size.mean())))
            models += with_process([leg.model], gusts)
        least = posterior.log_likelihood + CHANCE
        there = refit(models, posterior, least) if models != list(posterior.models) else None
        if there is None or there.log_likelihood < least:
            break
        posterior = there
    return posterior


def _rows_of(matrix: Array) -> tuple[tuple[float, ...], ...]:
    """A matrix as a tuple of rows."""
    return tuple(map(tuple, matrix.tolist()))


def usable(posterior: Posterior) -> bool:
    """Whether a posterior may be compared with others: it has converged, or nearly."""
    return posterior.converged or posterior.reason.startswith("not at the maximum")


def process_of(name: str, posterior: Posterior) -> Process:
    """A process of `FREEDOMS`, at the level and the rate where its search starts."""
    pattern, noise = posterior.model.pattern, posterior.model.values["position_noise"]
    speed, time = pattern.mean_velocity, posterior.legs[0].time
    level, rate = {
        WIND: (0.1 * speed, speed / pattern.length_scale),
        BIAS: (3.0 * noise, 0.2),
        GAIN: (0.1, 4.0 / float(time[-1] - time[0])),
    }[elements := FREEDOMS[name].elements]
    return Process(name, elements, level, rate)


def with_process(models: Iterable[Model], process: Process) -> tuple[Model, ...]:
    """The models with one more disturbance, or with another in place of that of its name."""
    walking = []
    for model in models:
        every = {own.name: own for own in (*model.processes, process)}
        walking.append(replace(model, processes=tuple(every.values())))
    return tuple(walking)


def plausible(there: Posterior, believed: Posterior) -> bool:
    """Whether parameters of vehicle and instruments are within bounds about their assumed values.

    Those that were free from the start have no bounds.
    """
    for leg, before in zip(there.legs, believed.models, strict=True):
        now, was, half = leg.model.values, before.values, 0.5 * float(np.ptp(leg.log.time))
        most = dict.fromkeys((*WIND, "velocity_bias_x", "velocity_bias_y"), leg.log.speed)
        most |= {"mass_rate": 0.5 / half, "growth": 1.0 / half, "latency": LATEST * half}
        most |= dict.fromkeys(FREEDOMS["wind_growth"].elements, leg.log.speed / half)
        sizes = {name: abs(now[name]) / size for name, size in most.items()}
        sizes |= {"lag": abs(now["lag"] / now["response_time"])}
        sizes |= {"quadratic_drag": -now["quadratic_drag"] * leg.log.speed}
        for name in ("response_time", "thrust_scale", "position_scale", "velocity_scale"):
            ratio = now[name] / was[name]
            sizes[name] = abs(math.log(ratio)) / math.log(FACTOR) if ratio > 0.0 else math.inf
        if any(size > 1.0 for name, size in sizes.items() if name not in before.names):
            return False
    return True


def disturbed(posterior: Posterior) -> bool:
    """Whether there is process noise: a level that is significant, or innovations not white.

    Parameters that change along a log may be another disturbance.
    """
    if posterior.exact or posterior.pushed:
        return False
    evident = posterior.evidence > CHANCE or min(posterior.whiteness) < COLOURED
    return (evident and posterior.seen > 1.0) or posterior.constancy[0] < FALSE_ALARM


def freer(models: Sequence[Model], group: str, *, answers: bool) -> list[Trial]:
    """The freer shapes with the waves of given models, as trials.

    models share a pattern; group: "drift" or "turn"; answers: whether these may be the answer; else
    they are causes of a misfit.
    """
    pattern, trials = models[0].pattern, []
    later = TWO_WAVES[TWO_WAVES.index(pattern.shape) + 1 :]
    for name in (pattern.shape,) if group == "drift" else later:
        there: StreamPattern = pattern.reshaped(name, group == "drift" or pattern.drifting)
        cause = SHAPES[group if group == "drift" or name == "square" else "stretch"]
        moved = tuple(replace(model, pattern=there) for model in models)
        freedom = len(there.values) - len(pattern.values)
        trials.append(Trial(moved, freedom, None if answers else cause))
    return trials
