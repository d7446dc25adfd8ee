"""The iterated smoother: trajectory, parameters and levels at the maximum of the likelihood.

A pass linearises the motion along the last track, filters forward and smooths backward, which is
one Gauss-Newton step on trajectory and parameters together (Bell 1994, SIAM J. Optim. 4, 626).
Levels move in the same passes (`levels`). The process noise comes down from a level at which
every start converges; the first passes see few rows.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sparsefit.arrays import Array, IntArray
from sparsefit.errors import InputError
from sparsefit.likelihood.levels import LevelSteps
from sparsefit.likelihood.model import LEVELS, Model, StateSpace
from sparsefit.likelihood.nodes import FlightLog, Nodes
from sparsefit.likelihood.posterior import Descent, Posterior, Track
from sparsefit.likelihood.trellis import Pass, Smoothed


@dataclass(frozen=True)
class Smoothing:
    """Settings of the iterated smoother.

    Args:
        coarse: the rows of a log that the first passes see.
        phase: the largest step of the motion, in the phase of the flow's waves [rad].
        anneal: the process noise that the search starts from, in |w|/tau per sqrt(|k| |w|).
        passes: the most passes on few rows, and on all.
        gain: the log-likelihood that a last pass may still gain.
        lifts: how often the search may start again with ten times the process noise.
        negligible: the degrees of freedom that a level may take and count as zero.
        gate: the deviations beyond which a reading is left out; infinite: none is.
        outliers: the largest share of readings that may be left out.
        sorting: the passes after which no reading is left out or taken in any more.
        diffuse: the first state's deviation, in those of its readings.
        dependent: the least eigenvalue of the scaled information that an observable model has.
    """

    coarse: int = 200
    phase: float = 0.25
    anneal: float = 1.0
    passes: int = 30
    gain: float = 0.005
    lifts: int = 2
    negligible: float = 0.01
    gate: float = 4.5
    outliers: float = 0.2
    sorting: int = 8
    diffuse: float = 30.0
    dependent: float = 1e-11


@dataclass(frozen=True, eq=False)
class Step:
    """One pass of all logs, forward and, where it was wanted, backward.

    Args:
        start: where it was linearised.
        passes: the forward passes.
        chains: per log, the derivatives of the columns' elements by its free parameters.
        value: the log-likelihood at the start, priors included.
        gain: that the step should gain.
        change: of the free parameters (p,).
        information: of the free parameters (p, p), priors included.
        levels: per log, the average information of the logarithms of the variances (l, l).
        weak: the names that the log cannot tell from each other, if any.
    """

    start: Descent
    passes: tuple[Pass, ...]
    chains: tuple[Array, ...]
    value: float
    gain: float
    change: Array
    information: Array
    levels: tuple[Array, ...]
    weak: tuple[str, ...]


def measure(
    logs: FlightLog | Sequence[FlightLog],
    model: Model | Sequence[Model],
    levels: Sequence[str] = LEVELS,
    start: Posterior | None = None,
    settings: Smoothing | None = None,
) -> Posterior:
    """Find the maximum of the likelihood of logs that share the free parameters.

    Args:
        logs: one flight or several through one flow.
        model: one for all, or one per log, with the same pattern and the same free parameters;
            the values are where the search starts.
        levels: the names of the levels to estimate; others are at their values.
        start: an earlier posterior of the same logs, with fewer parameters or processes perhaps:
            its trajectories are where the search starts, and the noise is not annealed.
        settings: of the smoother.

    Raises:
        InputError: if a level or a parameter has no such name, or the log has gaps too long.
    """
    records = (logs,) if isinstance(logs, FlightLog) else tuple(logs)
    models = (model,) * len(records) if isinstance(model, Model) else tuple(model)
    state = None if start is None else start.state
    with np.errstate(all="ignore"):  # a step that is no number is not taken
        return Ascent(records, models, tuple(levels), settings or Smoothing()).posterior(state)


class Ascent:
    """The passes of one measurement; its attributes do not change after its making."""

    def __init__(
        self,
        logs: tuple[FlightLog, ...],
        models: tuple[Model, ...],
        levels: tuple[str, ...],
        settings: Smoothing,
    ) -> None:
        names = models[0].names
        if len(models) != len(logs) or any(each.names != names for each in models):
            raise InputError("several logs need one model each, with the same free parameters")
        for name in levels:
            if name not in models[0].disturbance.levels:
                valid = ", ".join(models[0].disturbance.levels)
                raise InputError(f"no level {name!r} in this model (known: {valid})")
        self.logs, self.settings, self.levels, self.local = logs, settings, levels, names
        x, y, t = np.mean([log.origin for log in logs], axis=0).tolist()
        self.origin = (x, y, t)
        self.models = tuple(
            replace(each, pattern=each.pattern.about(self.origin)) for each in models
        )
        shared = (*models[0].pattern.names, "growth")
        self.names, self.places = names, [np.arange(len(names))]
        for number in range(2, len(logs) + 1):
            own = [name for name in names if name not in shared]
            place = np.arange(len(names))
            place[[names.index(name) for name in own]] = len(self.names) + np.arange(len(own))
            self.names += tuple(f"{name}@{number}" for name in own)
            self.places.append(place)
        self.spreads = tuple(
            np.repeat([
                (settings.diffuse * model.disturbance.position_noise) ** 2,
                (settings.diffuse * model.disturbance.velocity_noise) ** 2
                + (0.0 if np.isfinite(log.speeds).any() else 10.0 * model.pattern.mean_velocity)
                ** 2,
            ], 2)
            for log, model in zip(logs, models, strict=True)
        )  # fmt: skip
        self.centres, self.priors = self.values(self.models), np.ones(len(self.names))
        for model, place in zip(self.models, self.places, strict=True):
            self.priors[place] = [model.parameters[name].prior for name in names]
        self.wanted = [list(models[0].disturbance.levels).index(name) for name in levels]

    def values(self, models: tuple[Model, ...]) -> Array:
        """The values (p,) of the free parameters."""
        values = np.zeros(len(self.names))
        for model, place in zip(models, self.places, strict=True):
            values[place] = [model.parameters[name].value for name in self.local]
        return values

    def at(self, models: tuple[Model, ...], values: Array) -> tuple[Model, ...]:
        """The models with these values (p,) of the free parameters."""
        return tuple(
            model.at(dict(zip(self.local, values[place].tolist(), strict=True)))
            for model, place in zip(models, self.places, strict=True)
        )

    def starting(self, stride: int) -> Descent:
        """The first track through every `stride`-th row."""
        nodes = tuple(
            self.nodes(*pair, stride) for pair in zip(self.logs, self.models, strict=True)
        )
        tracks = tuple(
            each.track(4 + len(StateSpace.of(model).walkers))
            for each, model in zip(nodes, self.models, strict=True)
        )
        models = []
        for model in self.models:
            tau, speed = model.parameters["response_time"].value, model.pattern.mean_velocity
            rate = math.sqrt(2.0) * math.pi / model.pattern.length_scale * speed + 1e-9
            models.append(_noisier(model, self.settings.anneal * speed / tau / math.sqrt(rate)))
        return Descent(tuple(models), nodes, tracks, self.spreads, stride=stride)

    def longest(self, log: FlightLog, model: Model) -> float:
        """The longest step [s] of the motion in a model's flow."""
        waves, tau = model.pattern.waves, model.parameters["response_time"].value
        if np.isfinite(log.speeds).any():
            speeds = np.hypot(*log.speeds.T)
        else:
            seen = np.isfinite(log.places).all(axis=1)
            moved = np.diff(log.places[seen], axis=0)
            speeds = np.hypot(*moved.T) / np.diff(log.time[seen])
        speed = float(np.nanquantile(speeds, 0.95)) + 1e-9
        size = float(np.hypot(waves[:, 0], waves[:, 1]).max())
        return min(self.settings.phase / (size * speed), 0.5 * tau)

    def nodes(self, log: FlightLog, model: Model, stride: int = 1) -> Nodes:
        """The nodes of every `stride`-th row, close enough for the motion in a model's flow."""
        longest = self.longest(log, model) * (1.0 + (stride > 1))
        latency = model.parameters["latency"].value
        return Nodes.of(log, self.origin, longest, latency, stride)

    def along(self, tracks: list[tuple[Array, Array]]) -> Descent:
        """The nodes of all rows, with given tracks: times (m,) and states (m, 4 or n) of each."""
        nodes = tuple(map(self.nodes, self.logs, self.models))
        states = []
        for (time, track), each, model in zip(tracks, nodes, self.models, strict=True):
            wide = np.zeros((len(time), 4 + len(StateSpace.of(model).walkers)))
            wide[:, : track.shape[1]] = track
            states.append(_between(time, wide, each.time))
        return Descent(self.models, nodes, tuple(states), self.spreads)

    def renoded(self, old: Descent, stride: int) -> Descent:
        """The nodes of every `stride`-th row, with the track of others or of another latency."""
        logs = zip(self.logs, old.models, strict=True)
        nodes = [self.nodes(log, model, stride) for log, model in logs]
        tracks = tuple(
            _between(before.time, track, after.time)
            for after, before, track in zip(nodes, old.nodes, old.tracks, strict=True)
        )
        same = stride == old.stride and all(
            np.array_equal(a.rows, b.rows) for a, b in zip(nodes, old.nodes, strict=True)
        )
        if same:
            pairs = zip(nodes, old.nodes, strict=True)
            nodes = [replace(new, weights=before.weights.copy()) for new, before in pairs]
        last = old.last if same else None
        return Descent(old.models, tuple(nodes), tracks, self.spreads, last, stride)

    def step(self, start: Descent) -> Step:
        """Filter all logs, and solve for the change of the free parameters."""
        value, passes, chains, crosses, blocks = 0.0, [], [], [], []
        score, information = np.zeros(len(self.names)), np.zeros((len(self.names),) * 2)
        for i, (model, nodes, track) in enumerate(
            zip(start.models, start.nodes, start.tracks, strict=True)
        ):
            chain = model.jacobian(self.local)
            columns = np.flatnonzero(np.abs(chain).sum(axis=1))
            chain, place = chain[columns], self.places[i]
            last = None if start.last is None else start.last[i]
            space = StateSpace.of(model, columns)
            each = Pass.forward(space, nodes, track, self.spreads[i], last)
            p = len(columns)
            value += each.value
            score[place] += chain.T @ each.score[:p]
            information[np.ix_(place, place)] += chain.T @ each.information[:p, :p] @ chain
            cross = np.zeros((len(self.names), len(each.score) - p))
            cross[place] = chain.T @ each.information[:p, p:]
            passes.append(each)
            chains.append(chain)
            crosses.append(cross)
            blocks.append(each.information[p:, p:])
        away = (self.centres - self.values(start.models)) / self.priors
        value -= 0.5 * float(np.sum(away**2))
        score += away / self.priors
        information += np.diag(self.priors**-2.0)
        inverse, weak = inverted(information, self.settings.dependent)
        change = inverse @ score
        levels = tuple(
            0.5 * (block - cross.T @ inverse @ cross)
            for block, cross in zip(blocks, crosses, strict=True)
        )
        return Step(
            start, tuple(passes), tuple(chains), value, 0.5 * float(score @ change), change,
            information, levels, tuple(self.names[j] for j in weak),
        )  # fmt: skip

    def moved(
        self,
        step: Step,
        smoothed: tuple[Smoothed, ...],
        share: float = 1.0,
        levels: list[Array] | None = None,
    ) -> Descent:
        """A share of a step of tracks, parameters and logarithms of variances."""
        start = step.start
        models = self.at(start.models, self.values(start.models) + share * step.change)
        if levels is not None:
            models = tuple(
                _scaled(model, np.exp(0.5 * share * change))
                for model, change in zip(models, levels, strict=True)
            )
        tracks = tuple(
            track + share * (each.track - track)
            for track, each in zip(start.tracks, smoothed, strict=True)
        )
        descent = replace(start, models=models, tracks=tracks, last=smoothed)
        if "latency" not in self.local:
            return descent
        return self.renoded(descent, start.stride)  # the positions are then of other times

    def descended(self, start: Descent, hold: int) -> tuple[Step, tuple[Smoothed, ...], int, str]:
        """Pass after pass while the likelihood rises.

        Args:
            start: where the search starts.
            hold: the passes before the levels of the instruments move.

        Returns:
            The last pass that was accepted, forward and backward, the number of passes, and the
            reason why the search did not converge.
        """
        settings = self.settings
        scouts = [LevelSteps(self.wanted, settings.negligible, hold) for _ in self.logs]
        current, reason, halvings, lifts, fresh = start, "", 0, 0, True
        history: list[float] = []
        best: tuple[Step, tuple[Smoothed, ...], list[Array]] | None = None
        count = 0
        while count < settings.passes:
            count += 1
            step = self.step(current)
            reached = step.value + step.gain
            if not math.isfinite(reached) or (
                best is not None and not fresh and reached < best[0].value + best[0].gain - 1.0
            ):
                if best is not None and halvings < 4:
                    halvings += 1
                    current = self.moved(*best[:2], 0.5**halvings, best[2])
                    continue
                if lifts == settings.lifts:
                    reason = "the likelihood cannot be raised from where the search started"
                    break
                base = current if best is None else best[0].start
                models = tuple(
                    _noisier(each, max(10.0 * each.disturbance.acceleration, 0.01))
                    for each in base.models
                )
                current, best = replace(base, models=models, last=None), None
                lifts, halvings, fresh = lifts + 1, 0, True
                scouts = [LevelSteps(self.wanted, settings.negligible, hold) for _ in self.logs]
                continue
            halvings = 0
            smoothed = tuple(
                each.backward(chain @ step.change[place])
                for each, chain, place in zip(step.passes, step.chains, self.places, strict=True)
            )
            fresh = len(history) < settings.sorting and self.gated(current, smoothed)
            history.append(reached)
            changes, gains = [], 0.0
            for i, scout in enumerate(scouts):
                logs = list(current.models[i].disturbance.levels.values())
                change, gain = scout.change(logs, smoothed[i].squares, step.levels[i],
                                            self.models[i].disturbance.acceleration)  # fmt: skip
                changes.append(change)
                gains += gain
            best = (step, smoothed, changes)
            enough = settings.gain * (30.0 if current.stride > 1 else 1.0)
            level = len(history) > 6 and max(history[-4:]) - history[-7] < 10.0 * enough
            if not fresh and step.gain < enough and (gains < enough or level):
                break
            current = self.moved(step, smoothed, 1.0, changes)
        else:
            reason = f"not at the maximum after {settings.passes} passes"
        if best is None:
            empty = tuple(Smoothed.empty(each.space, each.track) for each in step.passes)
            still = replace(step, change=np.zeros(len(self.names)))
            return replace(still, value=-math.inf, gain=0.0), empty, count, reason
        if best[0].weak and not reason:
            *others, final = best[0].weak
            reason = f"the log cannot tell {', '.join(others)} from {final}" if others else (
                f"the log does not see {final}"
            )  # fmt: skip
        return best[0], best[1], count, reason

    def gated(self, descent: Descent, smoothed: tuple[Smoothed, ...]) -> bool:
        """Leave readings out that all others contradict; take in those that they bear out.

        Returns:
            Whether any weight changed.
        """
        if not math.isfinite(self.settings.gate):
            return False
        changed = False
        for nodes, each, model in zip(descent.nodes, smoothed, descent.models, strict=True):
            far = np.abs(each.scores[:, 4:8])
            if np.median(far[nodes.weights > 0.0]) > 0.85:  # a normal one's is .67: no model yet
                continue
            most = max(self.settings.gate, 0.3 * float(far.max()))
            noise = np.sqrt(StateSpace.of(model).noise.sum(axis=0))
            out = nodes.seen & (nodes.weights == 0.0)
            away = np.abs(nodes.measured - each.track[:, :4]) / noise
            out &= away > self.settings.gate
            gate = out | (far > most)
            if gate.sum() <= self.settings.outliers * nodes.seen.sum():
                weights = np.where(nodes.seen & ~gate, 1.0, 0.0)
                changed |= bool((weights != nodes.weights).any())
                nodes.weights[:] = weights
        return changed

    def posterior(self, start: Descent | None) -> Posterior:
        """Anneal on few rows, then on all."""
        few, hold = 0, 0
        if start is None:
            strides = [
                min(len(log.time) // self.settings.coarse,
                    int(4.0 * self.longest(log, model) / float(np.median(np.diff(log.time)))))
                for log, model in zip(self.logs, self.models, strict=True)
            ]  # fmt: skip
            stride = max(min(strides), 1)
            start, hold = self.starting(stride), 2
            if stride > 1:
                step, smoothed, few, _ = self.descended(start, self.settings.passes)
                hold = 0
                start = self.renoded(self.moved(step, smoothed), 1)
        else:
            wider = []
            for model, track in zip(self.models, start.tracks, strict=True):
                wide = np.zeros((len(track), 4 + len(StateSpace.of(model).walkers)))
                shared = min(wide.shape[1], track.shape[1])
                wide[:, :shared] = track[:, :shared]
                wider.append(wide)
            moved = replace(start, models=self.models, tracks=tuple(wider), last=None)
            start = self.renoded(moved, 1)
        step, smoothed, whole, reason = self.descended(start, hold)
        end = self.moved(step, smoothed)
        shape = np.ix_(self.wanted, self.wanted)
        information = step.levels[0][shape] if step.levels[0].size else np.zeros(shape[0].shape[0])
        tracks = tuple(map(_track, step.start.nodes, smoothed))
        return Posterior(
            end.models, self.names, inverted(step.information, self.settings.dependent)[0],
            step.value + step.gain, tracks, self.levels, information, reason, (few, whole),
            self.origin, end,
        )  # fmt: skip


def _scaled(model: Model, factors: Array) -> Model:
    """The model with its levels (l,) multiplied."""
    levels = model.disturbance.levels
    new = {name: levels[name] * float(factor) for name, factor in zip(levels, factors, strict=True)}
    return replace(model, disturbance=model.disturbance.at(new))


def _noisier(model: Model, level: float) -> Model:
    """The model with at least this process noise."""
    level = max(level, model.disturbance.acceleration)
    return replace(model, disturbance=model.disturbance.at({"acceleration": level}))


def _between(old: Array, track: Array, new: Array) -> Array:
    """A track (m, n) at other times, by cubics through values and slopes; straight beyond it."""
    slope = np.gradient(track, old, axis=0)
    slope[:, :2] = track[:, 2:4]
    inside = np.clip(new, old[0], old[-1])
    first = np.clip(np.searchsorted(old, inside, side="right") - 1, 0, len(old) - 2)
    step = (old[first + 1] - old[first])[:, None]
    u = (inside - old[first])[:, None] / step
    start, end = track[first], track[first + 1]
    leaving, coming = step * slope[first] - (end - start), (end - start) - step * slope[first + 1]
    between: Array = start + u * (end - start) + u * (1.0 - u) * ((1.0 - u) * leaving + u * coming)
    between[:, :2] += (new - inside)[:, None] * between[:, 2:4]
    return between


def _track(nodes: Nodes, smoothed: Smoothed) -> Track:
    residual, innovation = smoothed.scores[:, 4:8], smoothed.scores[:, 8:]
    used = nodes.weights > 0.0
    return Track(
        nodes.time, smoothed.track, np.where(used, innovation, np.nan),
        np.where(used, residual, np.nan), nodes.rows, int((nodes.seen & ~used).sum()),
    )  # fmt: skip


def inverted(information: Array, least: float) -> tuple[Array, IntArray]:
    """The inverse of an information matrix (p, p), and which parameters it leaves unknown."""
    if not len(information) or not np.isfinite(information).all():
        return np.full_like(information, np.nan), np.zeros(0, dtype=np.intp)
    size = np.sqrt(np.maximum(np.diag(information), 0.0))
    scale = np.where(size > 0.0, size, 1.0)
    values, vectors = np.linalg.eigh(information / scale / scale[:, None])
    blind = values < least
    weak = np.flatnonzero((np.abs(vectors[:, blind]) > 0.2).any(axis=1))
    half = vectors[:, ~blind] / np.sqrt(values[~blind]) / scale[:, None]
    return half @ half.T, weak
