"""One flight of a study, case by case: each flight, library and fit is made once and shared."""

from __future__ import annotations

import dataclasses
import gc
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TypeVar, cast

from sparsefit.errors import described, one_line
from sparsefit.estimator.estimator import Estimator
from sparsefit.estimator.prepare import Prepared
from sparsefit.flight import Flight
from sparsefit.regression.backend import Backend, PathBackend
from sparsefit.regression.fit import Fit, path
from sparsefit.study.run.columns import values_of
from sparsefit.study.run.outcome import READING, Event, Outcome, Stage
from sparsefit.study.run.reading import Reading, Yardstick, yardstick
from sparsefit.study.spec.design import Cell
from sparsefit.study.spec.document import canonical_json
from sparsefit.study.spec.draw import SIMULATION, Draw, stream
from sparsefit.study.spec.logs import Logged
from sparsefit.study.spec.plan import fit_key, flight_key, problem_key, sharing
from sparsefit.study.spec.study import Study

MAX_REASON = 500
ALPHA = "alpha_fraction"

Result = TypeVar("Result")


@dataclass(frozen=True)
class _Failed:
    """A step that raised: the reason alone, so that nothing of it stays in memory."""

    reason: str


def run_flight(
    study: Study, flight: int, todo: Sequence[Cell], *, alone: bool = False
) -> Iterator[Event]:
    """Stages and outcomes of the cells `todo` of one flight.

    A case that raises ends as status `error` with the reason, and the others go on. `alone`
    forbids fits that share their work, so that one that hangs takes no other along.
    """
    for cells in sharing(todo, flight_key):
        draw = study.draw(flight, cells[0])
        yield Stage("simulating the flight", _indices(cells))
        flown = _attempt(partial(fly, study, flight, draw))
        if isinstance(flown, _Failed):
            yield from _failed(flight, cells, flown)
            continue
        context = _Context(study, flight, draw, *flown)
        for same_problem in sharing(cells, problem_key):
            yield from _run_problem(context, same_problem, alone)


def fly(study: Study, flight: int, draw: Draw | Logged) -> tuple[tuple[Flight, ...], Yardstick]:
    """The flights of a case without their flow: the truth enters at the score and nowhere before.

    They are one but where several are estimated together.
    """
    seed = stream(study.seed, flight, SIMULATION)
    fleet = draw.fleet(seed)
    if isinstance(draw, Logged):
        return fleet, Yardstick(fleet[0].extent)
    others = draw.others(seed, study.prediction_flights) if draw.flown else ()
    blind = tuple(dataclasses.replace(flown, flow=None) for flown in fleet)
    return blind, yardstick(draw, fleet, others)


@dataclass(frozen=True)
class _Context:
    study: Study
    flight: int
    draw: Draw | Logged
    fleet: tuple[Flight, ...]
    yardstick: Yardstick


@dataclass(frozen=True)
class _Task:
    """One fit: the cells that read it, and the estimator that makes it."""

    cells: tuple[Cell, ...]
    estimator: Estimator

    @property
    def backend(self) -> Backend:
        return cast(Backend, self.estimator.backend)


def _run_problem(context: _Context, cells: tuple[Cell, ...], alone: bool) -> Iterator[Event]:
    tasks: list[_Task] = []
    for cells_of_fit in sharing(cells, fit_key):
        yield Stage("making the back-end", _indices(cells_of_fit))
        estimator = _attempt(partial(context.study.estimator, cells_of_fit[0]))
        if isinstance(estimator, _Failed):
            yield from _failed(context.flight, cells_of_fit, estimator)
        else:
            tasks.append(_Task(cells_of_fit, estimator))
    if not tasks:
        return
    left = tuple(cell for task in tasks for cell in task.cells)
    yield Stage("building the library", _indices(left))
    online = cells[0].setup.online
    prepared = _attempt(partial(online.prepare, tasks[0].estimator, context.fleet))
    if isinstance(prepared, _Failed):
        yield from _failed(context.flight, left, prepared)
        return
    for batch in _batches(tasks, alone):
        fitted = tuple(index for task in batch.tasks for index in _indices(task.cells))
        yield Stage("fitting", fitted, fits=max(len(batch.fractions), 1))
        for task, fit in _fit(context.study, prepared, batch):
            yield from _read(context, prepared, task, fit)


@dataclass(frozen=True)
class _Batch:
    """Fits made together; `fractions` are those of their path."""

    tasks: tuple[_Task, ...]
    fractions: tuple[float, ...] = ()


def _batches(tasks: Sequence[_Task], alone: bool) -> list[_Batch]:
    """Fits of one [[backends]] entry that differ in `alpha_fraction` only share a path."""
    batches: dict[tuple[object, str], list[_Task]] = {}
    for task in tasks:
        cell = task.cells[0]
        single = alone or not _path_fractions(task)
        shared = {key: value for key, value in cell.settings.items() if single or key != ALPHA}
        batches.setdefault((cell.choice, canonical_json(shared)), []).append(task)
    return [
        _Batch(tuple(group), () if alone else _path_fractions(group[0]))
        for group in batches.values()
    ]


def _path_fractions(task: _Task) -> tuple[float, ...]:
    """The whole grid of penalties, whatever is left to do of it: a resumed run repeats the path."""
    cell = task.cells[0]
    if cell.settings.get(ALPHA) == "auto":  # it walks a path of its own
        return ()
    grid = [value for value in cell.choice.grid.get(ALPHA, ()) if value != "auto"]
    paths = len(grid) > 1 and isinstance(task.backend, PathBackend)
    return tuple(float(value) for value in grid) if paths else ()


def _fit(study: Study, prepared: Prepared, batch: _Batch) -> Iterator[tuple[_Task, Fit | _Failed]]:
    if batch.fractions:
        walk = partial(path, prepared.problem, batch.tasks[0].backend, tolerance=study.tolerance)
        walked = _attempt(partial(walk, batch.fractions))
        if not isinstance(walked, _Failed):
            at = dict(zip(batch.fractions, walked.fits, strict=True))
            for task in batch.tasks:
                yield task, at[float(task.cells[0].settings[ALPHA])]
            return
    # What fails together is tried one by one: the reason belongs to one of them.
    for task in batch.tasks:
        yield task, _attempt(partial(task.estimator.fit, prepared))


def _read(
    context: _Context, prepared: Prepared, task: _Task, fit: Fit | _Failed
) -> Iterator[Event]:
    if isinstance(fit, _Failed):
        yield from _failed(context.flight, task.cells, fit)
        return
    for cell in task.cells:
        yield Stage(READING, (cell.index,))
        outcome = _attempt(partial(_outcome, context, prepared, cell, fit))
        if isinstance(outcome, _Failed):
            yield from _failed(context.flight, (cell,), outcome)
        else:
            yield outcome


def _outcome(context: _Context, prepared: Prepared, cell: Cell, fit: Fit) -> Outcome:
    estimate = context.study.estimator(cell).read(prepared, fit)
    problem = prepared.problem
    reading = Reading(estimate, fit, problem, context.draw.flow, context.yardstick)
    weights = estimate.weights_by_scale.items() if context.study.store_weights else ()
    return Outcome(
        context.flight,
        cell.index,
        estimate.status,
        one_line(estimate.reason or "", MAX_REASON),
        values_of(reading),
        shared_seconds=float(fit.shared_seconds),
        weights=tuple(sorted((float(scale), float(weight)) for scale, weight in weights)),
    )


def _attempt(step: Callable[[], Result]) -> Result | _Failed:
    """What the step gives, or why not: whatever happens in a case becomes its row."""
    try:
        return step()
    except Exception as error:
        failed = _Failed(described(error, MAX_REASON))
        memory = isinstance(error, MemoryError)
    if memory:  # what the failed step held is not charged to the next
        gc.collect()
    return failed


def _failed(flight: int, cells: Sequence[Cell], failed: _Failed) -> Iterator[Outcome]:
    for cell in cells:
        yield Outcome(flight, cell.index, "error", failed.reason)


def _indices(cells: Sequence[Cell]) -> tuple[int, ...]:
    return tuple(cell.index for cell in cells)
