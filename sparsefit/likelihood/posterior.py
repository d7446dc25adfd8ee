"""The posterior of a model given logs: maximum of the likelihood, covariance, Cramer-Rao bound.

Levels of noise are known to a few degrees of freedom only, and the widths of intervals depend on
them. Each level is integrated out in turn (Rue, Martino and Chopin 2009, J. R. Stat. Soc. B 71,
319), with a prior that is flat in its square root: a forward pass at another level gives the
likelihood there, the shift of the parameters and their covariance.

A process along the path stands in for turbulence, a field in space whose spectrum at the flow's
wavevectors the path alone does not determine. It is estimated at neighbouring wavevectors, as close
as the extent of the flight resolves: a wave of amplitude 0 has a score that is chi^2 if the model
holds. The mean score multiplies the covariance: a sandwich whose middle is estimated there.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from sparsefit.arrays import Array
from sparsefit.cached import cached_property
from sparsefit.errors import InputError
from sparsefit.likelihood.model import LEVELS, Model
from sparsefit.likelihood.pattern import StreamPattern
from sparsefit.likelihood.readings import FlightLog
from sparsefit.likelihood.smoother import PASSES, Step, climbed, inverted
from sparsefit.likelihood.trellis import Leg, longest_step

SHORT = 15  # passes of a search over all rows
COARSE = 200  # rows of a log in the first passes
BESIDE = 0.1  # the share of white process noise that a search keeps beside a new process
ANNEAL = 1.0  # process noise that the search starts from, in |w|/tau per sqrt(|k| |w|)
EXACT = 1e-6  # of the flow's length and velocity: noise below it counts as none
NUDGE = 0.3  # of the logarithm of a level, for a second difference of the likelihood
NEIGHBOURS = 30  # waves around those of the flow
NEAREST, FURTHEST = 2.5, 5.0  # of these, in 2 pi over the extent of the flight
NOTHING = 0.1  # degrees of freedom of a level that is negligible
FEWEST = 16  # innovations of a channel that are tested
PARTS = 8  # of a log, at whose ends parameters may change


@dataclass(frozen=True, eq=False)
class Posterior:
    """The maximum of the likelihood of logs under a model, and its covariance."""

    legs: tuple[Leg, ...]  # each log with its model, levels and track at the optimum
    names: tuple[str, ...]  # of the free parameters (p,); "tau@2" is that of the second log
    information: Array  # of these (p, p), levels at their values
    log_likelihood: float  # at the optimum
    seen: float  # the information of the logarithm of process noise's variance, most of all logs
    reason: str  # why the search did not end at the optimum; empty where it did

    @property
    def converged(self) -> bool:
        """Whether the search ended at the optimum and every free parameter is observable."""
        return not self.reason

    @property
    def fine(self) -> bool:
        """Whether no step is longer than those of the answer."""
        steps = ((leg, float(np.diff(leg.time).max())) for leg in self.legs)
        return all(step < 1.001 * longest_step(leg.log, leg.model) for leg, step in steps)

    @property
    def exact(self) -> bool:
        """Whether the readings and the motion of all logs are as exact as the passes."""
        return all(self.exact_logs)

    @property
    def exact_logs(self) -> tuple[bool, ...]:
        """Whether readings and motion are as exact as the passes, by log: no test of noise then."""
        pattern, values = self.model.pattern, self.model.values
        speed, turnover = pattern.mean_velocity, pattern.length_scale / pattern.mean_velocity
        pull = speed * (1.0 + abs(values["quadratic_drag"]) * speed) / values["response_time"]
        bound = 1e2 * EXACT * pull * math.sqrt(turnover)  # a wrong motion has more
        return tuple(
            leg.model.values["position_noise"] < 3.0 * EXACT * pattern.length_scale
            and leg.model.values["acceleration"] < bound
            for leg in self.legs
        )

    @property
    def pushed(self) -> bool:
        """Whether the noise of a measured thrust, which is not white, dominates all other noise."""
        return any(
            leg.log.thrust_noise * leg.log.interval > leg.model.values["velocity_noise"]
            and leg.model.values["acceleration"] < 1.5 * leg.log.kicks
            for leg in self.legs
        )

    @property
    def models(self) -> tuple[Model, ...]:
        """The model of each log at the optimum, values and levels."""
        return tuple(leg.model for leg in self.legs)

    @property
    def model(self) -> Model:
        """The model of the first log."""
        return self.legs[0].model

    @cached_property
    def whiteness(self) -> tuple[float, ...]:
        """The p-value of white innovations of each log, 1 of an exact one."""
        scores = [leg.last.scores[:, 8:] if leg.last else np.nan for leg in self.legs]
        return tuple(
            1.0 if exact else whiteness(np.where(leg.weights > 0.0, each, np.nan))
            for leg, each, exact in zip(self.legs, scores, self.exact_logs, strict=True)
        )

    @cached_property
    def constancy(self) -> tuple[float, int, float]:
        """The p-value of constant parameters; the log, from 1, and time [s] of a likely change.

        The score of a part of a log, less its share of the whole, is chi^2 (Andrews 1993).
        """
        from scipy.special import chdtrc

        changes = []
        for number, leg in enumerate(self.legs, 1):
            size = math.ceil(len(leg.track) / PARTS)
            *parts, whole = (
                replace(leg, last=None).forward(leg.model.names, keep=False, block=size).course
            )
            for place, part in enumerate(parts, 1):
                share = part[:, 1:] @ inverted(whole[:, 1:])[0]
                score, rest = part[:, 0] - share @ whole[:, 0], part[:, 1:] - share @ part[:, 1:]
                statistic = float(score @ inverted(rest)[0] @ score)
                changes.append((statistic, number, float(leg.time[place * size])))
        largest, number, time = max(changes)
        chance = float(chdtrc(len(self.model.names), largest / self.inflation))
        return len(changes) * chance, number, time + self.model.pattern.origin[2]

    @cached_property
    def evidence(self) -> float:
        """The log-likelihood that process noise gains."""
        degrees = [float(leg.last.squares[0, 1]) for leg in self.legs if leg.last]
        if not degrees or max(degrees) <= NOTHING:
            return 0.0
        fall = 0.5 * math.log(NOTHING / max(degrees))
        return self.log_likelihood - self.at_level(fall, "acceleration")[0]

    @property
    def bic(self) -> float:
        """Return -2 log L + (p + l) log(readings)."""
        readings = sum(int((leg.weights > 0.0).sum()) for leg in self.legs)
        free = len(self.names) + len(self.model.levels)
        return -2.0 * self.log_likelihood + free * math.log(max(readings, 2))

    def apart(self, other: Posterior) -> float:
        """The larger of the relative differences of U0 and L of another posterior."""
        return max(map(abs, self.model.pattern.apart(other.model.pattern)))

    def value(self, name: str) -> float:
        """The value of a parameter."""
        return self.model.values[name]

    def error(self, name: str) -> float:
        """The standard error of a parameter, 0 of one that is known."""
        if name not in self.names:
            return 0.0
        place = self.names.index(name)
        return math.sqrt(max(float(self.covariance[place, place]), 0.0))

    @cached_property
    def covariance(self) -> Array:
        """Covariance of the free parameters (p, p), levels integrated out, inflated."""
        bare = inverted(self.information)[0]
        if not self.converged or not np.isfinite(bare).all():
            return bare
        total = bare.copy()
        with np.errstate(all="ignore"):
            for place, leg in enumerate(self.legs):
                for name, level in leg.model.levels.items():
                    if name not in ("position_noise", "velocity_noise") and level > 0.0:
                        excess = self._widened(place, name, bare)
                        total += excess if np.isfinite(excess).all() else 0.0
        return total * self.inflation

    def _widened(self, place: int, name: str, bare: Array) -> Array:
        """The increase of the covariance (p, p) by the uncertainty of a level.

        Where the level is known to less than half, its rungs go by factors of 3 from one that
        counts as nothing (degrees of freedom grow with its square at most) to an unlikely one.
        """
        last = self.legs[place].last
        assert last is not None
        index = list(self.legs[place].model.levels).index(name)
        degrees = max(float(last.squares[index, 1]), 1e-12)
        if degrees > 1.0:
            up, down = (self.at_level(sign * NUDGE, name, place) for sign in (1, -1))
            bend = -(up[0] + down[0] - 2.0 * self.log_likelihood) / NUDGE**2
            if bend > 4.0:  # a deviation of less than half: to second order
                spread: Array = 0.5 * (up[1] + down[1] - 2.0 * bare)
                return spread / NUDGE**2 / bend
        height = 0.5 * math.log(NOTHING / degrees)
        at_optimum = self.log_likelihood, bare
        rungs = [self.at_level(height, name, place) if height < 0.0 else at_optimum]
        heights = [height]
        while len(rungs) < 40 and (
            heights[-1] < 0.0 or rungs[-1][0] > max(value for value, _ in rungs) - 4.0
        ):
            heights.append(heights[-1] + math.log(3.0))
            rungs.append(self.at_level(heights[-1], name, place))
        likely = np.array([value for value, _ in rungs]) + 0.5 * np.array(heights)
        weights = np.exp(likely - likely.max())
        covariances = np.array([covariance for _, covariance in rungs])
        mean: Array = np.tensordot(weights / weights.sum(), covariances, axes=1)
        return mean - bare

    @cached_property
    def inflation(self) -> float:
        """The mean score of neighbouring waves, 1 or more; 1 of a model without processes."""
        pattern = self.model.pattern
        if not self.model.processes:
            return 1.0
        waves, size = pattern.waves[:, :2], np.hypot(*pattern.waves[:, :2].T).mean()
        box = np.ptp(np.concatenate([leg.track[:, :2] for leg in self.legs]), axis=0)
        cell = np.minimum(2.0 * math.pi / box, size)  # the resolution of wavevectors
        turns = math.pi * (3.0 - math.sqrt(5.0)) * np.arange(NEIGHBOURS // len(waves))
        radii = np.sqrt(np.linspace(NEAREST**2, FURTHEST**2, len(turns)))[:, None]
        spiral = cell * radii * np.column_stack([np.cos(turns), np.sin(turns)])
        silent = (waves[:, None] + spiral).reshape(-1, 2)
        apart = (silent[:, None] - np.concatenate([waves, -waves])) / cell
        silent = silent[(np.linalg.norm(apart, axis=2) > 2.0).all(axis=1)]
        if not len(silent):
            return 1.0
        more = replace(pattern, silent=tuple(map(tuple, silent.tolist())))
        extra = [f"{part}_{len(waves) + j}" for j in range(1, 1 + len(silent))
                 for part in ("cosine", "sine")]  # fmt: skip
        step = self.under([replace(model, pattern=more) for model in self.models], extra)
        score, information, own = step.score, step.information, np.isin(step.names, self.names)
        among, across = information[np.ix_(own, own)], information[np.ix_(own, ~own)]
        regression = inverted(among)[0] @ across
        pairs = (score[~own] - regression.T @ score[own]).reshape(-1, 2)
        block = information[np.ix_(~own, ~own)] - across.T @ regression
        two = np.arange(len(block)).reshape(-1, 2)
        blocks = block[two[:, :, None], two[:, None]]
        seen = np.linalg.det(blocks) > 0.0  # a wave that the readings do not see has no score
        if not seen.any():
            return 1.0
        solved = np.linalg.solve(blocks[seen], pairs[seen, :, None])[..., 0]
        return max(0.5 * float(np.mean(np.sum(pairs[seen] * solved, axis=1))), 1.0)

    def under(self, models: Sequence[Model], extra: Sequence[str] = ()) -> Step:
        """One pass of other models along these tracks; extra: names of parameters not free."""
        pairs = zip(self.legs, models, strict=True)
        return Step.of([leg.with_model(model) for leg, model in pairs], extra, keep=False)

    def at_level(self, height: float, name: str, place: int | None = None) -> tuple[float, Array]:
        """The log-likelihood and the covariance (p, p) about the optimum at exp(height) of a level.

        place: the number of the log with the level, None: all. Parameters maximise the likelihood.
        """
        models = list(self.models)
        for number in range(len(models)) if place is None else (place,):
            level = math.exp(height) * models[number].levels[name]
            models[number] = models[number].at({name: level})
        step = self.under(models)
        return step.reached, step.covariance + np.outer(step.change, step.change)


def measure(
    logs: Sequence[FlightLog],
    models: Iterable[Model],
    start: Posterior | None = None,
    passes: int = SHORT,
    least: float = -math.inf,
    *,
    rough: bool = True,
    inside: Callable[[StreamPattern], bool] | None = None,
) -> Posterior | None:
    """The maximum of the likelihood of logs through one flow, with the levels of all noise.

    There is none where a log has gaps too long, or few rows of it do not hold the waves.

    Args:
        logs: one flight or several.
        models: of each log, with the same pattern and the same free parameters: where the search
            starts. Without an earlier posterior, or with a process that it has not, the levels of
            the sensors start from the logs' own noise: white process noise in place of a coloured
            one takes their share too.
        start: an earlier posterior of the same logs, with fewer parameters or processes perhaps:
            its trajectories are where the search starts, and the noise is not annealed.
        passes: over all rows at most.
        least: the log-likelihood without which the posterior is of no use: a search that falls
            behind is given up.
        rough: whether steps are as long as noise hides (`longest_step`).
        inside: whether waves are those sought: a search that leaves them is given up.
    """
    starts = _about(logs, models)
    processes = 0 if start is None else len(start.model.processes)
    if start is None or len(starts[0].processes) > processes:
        for number, (log, model) in enumerate(zip(logs, starts, strict=True)):
            noise = BESIDE * model.values["acceleration"], *log.noise
            starts[number] = model.at(dict(zip(LEVELS, noise, strict=True)))
    speed, length = starts[0].pattern.mean_velocity, starts[0].pattern.length_scale
    floors = []
    for log, each in zip(logs, starts, strict=True):
        floor = np.full(len(each.levels), 1e-150)
        floor[0] = max(EXACT * speed * math.sqrt(speed / length), log.kicks)
        floor[1] = 0.01 * EXACT * length  # process noise moves a position by less than passes err
        floor[2] = EXACT * speed
        floors.append(floor)
    hold, pairs = 0, list(zip(logs, starts, strict=True))
    # A step that is no number is not taken.
    with suppress(InputError), np.errstate(all="ignore"):
        if start is None:
            strides = [
                min(len(log.time) / COARSE, 4.0 * longest_step(log, each) / log.interval)
                for log, each in pairs
            ]
            stride, hold = max(int(min(strides)), 1), 2
            rate = math.sqrt(2.0) * math.pi * speed / length + 1e-9
            push = ANNEAL * speed / math.sqrt(rate)
            kicks = [
                max(push / each.values["response_time"], each.values["acceleration"])
                for each in starts
            ]
            legs = tuple(
                Leg.of(log, each.at({"acceleration": q}), stride, rough=rough)
                for (log, each), q in zip(pairs, kicks, strict=True)
            )
            if stride > 1:
                few, hold = climbed(legs, floors, PASSES)[0], 0
                if 4.0 * few[0].model.pattern.length_scale < length:
                    return None  # waves run away to ever shorter ones
                legs = tuple(leg.again(1) for leg in few)
        else:
            legs = tuple(
                Leg.of(*pair, 1, (leg.time, leg.track), rough=rough)
                for pair, leg in zip(pairs, start.legs, strict=True)
            )
        legs, step, reason = climbed(legs, floors, hold, passes, least, inside)
        value = step.reached - step.gain * bool(reason)  # a step that was not taken gains nothing
        value = value if math.isfinite(value) else -math.inf
        seen = max((float(known[0, 0]) for known in step.levels if known.size), default=0.0)
        return Posterior(legs, step.names, step.information, value, seen, reason)
    return None


def bound(logs: Sequence[FlightLog], models: Sequence[Model], states: Sequence[Array]) -> Array:
    """Return the Cramer-Rao bound of the free parameters (p, p), levels as they are.

    Args:
        logs: the times of readings and which are missing; their values do not matter.
        models: the true model of each log.
        states: the true positions and velocities (m, 4) at the rows of each log.

    Raises:
        InputError: if the logs do not see a free parameter.
    """
    legs = []
    for log, each, state in zip(logs, _about(logs, models), states, strict=True):
        x, y, t = each.pattern.origin
        legs.append(Leg.of(log, each, 1, (log.time - t, state - np.array([x, y, 0.0, 0.0]))))
    step = Step.of(legs, keep=False)
    if step.blind:
        raise InputError(f"the log does not see all of {', '.join(step.blind)}: there is no bound")
    return step.covariance


def _about(logs: Sequence[FlightLog], models: Iterable[Model]) -> list[Model]:
    """The models of logs, with phases relative to the middle of all of them."""
    x, y, t = np.mean([log.origin for log in logs], axis=0).tolist()
    return [replace(each, pattern=each.pattern.about((x, y, t))) for each in models]


def whiteness(innovations: Array) -> float:
    """The p-value of Bartlett's test of standardised innovations (m, c), smallest of c channels.

    Missing ones are NaN; the p-value counts the channels. NaN where too few were read.
    """
    from scipy.special import kolmogorov

    chances = []
    for channel in innovations.T:
        values = channel[np.isfinite(channel)]
        if len(values) < FEWEST:
            continue
        power = np.abs(np.fft.rfft(values - values.mean())[1 : (len(values) + 1) // 2]) ** 2
        if not power.sum() > 0.0:
            continue
        steps = np.cumsum(power) / power.sum()
        line = np.arange(1, len(power) + 1) / len(power)
        away = float(np.abs(steps - line).max())
        chances.append(float(kolmogorov(away * math.sqrt(len(power)))))
    return 1.0 - (1.0 - min(chances)) ** len(chances) if chances else math.nan
