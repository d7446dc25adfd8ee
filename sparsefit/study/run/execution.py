"""One flight of a study, case by case: each flight, library and fit is made once and shared."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TypeVar

from sparsefit.estimator.prepare import Prepared
from sparsefit.flight import Flight
from sparsefit.regression.backend import PathBackend
from sparsefit.regression.fit import Fit, path
from sparsefit.study.run.columns import values_of
from sparsefit.study.run.outcome import Event, Outcome, Stage
from sparsefit.study.run.reading import Reading, Yardstick, yardstick
from sparsefit.study.spec.choices import make_backend
from sparsefit.study.spec.design import Cell
from sparsefit.study.spec.document import canonical_json
from sparsefit.study.spec.draw import SIMULATION, Draw, stream
from sparsefit.study.spec.logs import Logged
from sparsefit.study.spec.plan import fit_key, flight_key, problem_key, sharing
from sparsefit.study.spec.study import Study

MAX_REASON = 500
ALPHA = "alpha_fraction"

Result = TypeVar("Result")


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
        flown = _attempt(partial(_fly, study, flight, draw))
        if isinstance(flown, Exception):
            yield from _failed(flight, cells, flown)
            continue
        context = _Context(study, flight, draw, *flown)
        for same_problem in sharing(cells, problem_key):
            yield from _run_problem(context, same_problem, alone)


def _fly(study: Study, flight: int, draw: Draw | Logged) -> tuple[Flight, Yardstick]:
    """The flight without its flow: the truth enters at the score and nowhere before."""
    seed = stream(study.seed, flight, SIMULATION)
    flown = draw.fly(seed)
    if isinstance(draw, Logged):
        return flown, Yardstick(flown.extent)
    others = draw.others(seed, study.prediction_flights) if draw.flown else ()
    return dataclasses.replace(flown, flow=None), yardstick(draw, flown, others)


@dataclass(frozen=True)
class _Context:
    study: Study
    flight: int
    draw: Draw | Logged
    flown: Flight
    yardstick: Yardstick


def _run_problem(context: _Context, cells: tuple[Cell, ...], alone: bool) -> Iterator[Event]:
    yield Stage("building the library", _indices(cells))
    prepared = _attempt(partial(context.study.estimator(cells[0]).prepare, context.flown))
    if isinstance(prepared, Exception):
        yield from _failed(context.flight, cells, prepared)
        return
    for batch in _batches(cells, alone):
        fitted = tuple(index for cells_of_fit in batch.fits for index in _indices(cells_of_fit))
        yield Stage("fitting", fitted, fits=max(len(batch.fractions), 1))
        for cells_of_fit, fit in _fit(context.study, prepared, batch):
            yield from _read(context, prepared, cells_of_fit, fit)


@dataclass(frozen=True)
class _Batch:
    """Fits made together, each the cells that read it; `fractions` are those of their path."""

    fits: tuple[tuple[Cell, ...], ...]
    fractions: tuple[float, ...] = ()


def _batches(cells: tuple[Cell, ...], alone: bool) -> list[_Batch]:
    """Fits of one [[backends]] entry that differ in `alpha_fraction` only share a path."""
    batches: dict[tuple[object, str], list[tuple[Cell, ...]]] = {}
    for cells_of_fit in sharing(cells, fit_key):
        cell = cells_of_fit[0]
        single = alone or not _path_fractions(cell)
        shared = {key: value for key, value in cell.settings.items() if single or key != ALPHA}
        batches.setdefault((cell.choice, canonical_json(shared)), []).append(cells_of_fit)
    return [
        _Batch(tuple(fits), () if alone else _path_fractions(fits[0][0]))
        for fits in batches.values()
    ]


def _path_fractions(cell: Cell) -> tuple[float, ...]:
    """The whole grid of penalties, whatever is left to do of it: a resumed run repeats the path."""
    if cell.settings.get(ALPHA) == "auto":  # it walks a path of its own
        return ()
    asked = cell.choice.grid.get(ALPHA, ())
    grid = [value for value in asked if value != "auto"]
    paths = isinstance(make_backend(cell.backend, cell.settings), PathBackend)
    return tuple(float(value) for value in grid) if paths and len(grid) > 1 else ()


def _fit(
    study: Study, prepared: Prepared, batch: _Batch
) -> Iterator[tuple[tuple[Cell, ...], Fit | Exception]]:
    if batch.fractions:
        backend = make_backend(batch.fits[0][0].backend, batch.fits[0][0].settings)
        walk = partial(path, prepared.problem, backend, tolerance=study.tolerance)
        walked = _attempt(partial(walk, batch.fractions))
        if not isinstance(walked, Exception):
            at = dict(zip(batch.fractions, walked.fits, strict=True))
            yield from ((cells, at[float(cells[0].settings[ALPHA])]) for cells in batch.fits)
            return
    # What fails together is tried one by one: the reason belongs to one of them.
    for cells in batch.fits:
        yield cells, _attempt(partial(study.estimator(cells[0]).fit, prepared))


def _read(
    context: _Context, prepared: Prepared, cells: tuple[Cell, ...], fit: Fit | Exception
) -> Iterator[Event]:
    if isinstance(fit, Exception):
        yield from _failed(context.flight, cells, fit)
        return
    for cell in cells:
        yield Stage("reading the weights", (cell.index,))
        outcome = _attempt(partial(_outcome, context, prepared, cell, fit))
        if isinstance(outcome, Exception):
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
        _one_line(estimate.reason or ""),
        values_of(reading),
        shared_seconds=float(fit.shared_seconds),
        weights=tuple(sorted((float(scale), float(weight)) for scale, weight in weights)),
    )


def _attempt(step: Callable[[], Result]) -> Result | Exception:
    """What the step gives or raises: whatever happens in a case becomes its row."""
    try:
        return step()
    except Exception as error:
        return error


def _failed(flight: int, cells: Sequence[Cell], error: Exception) -> Iterator[Outcome]:
    reason = _one_line(f"{type(error).__name__}: {error}")
    for cell in cells:
        yield Outcome(flight, cell.index, "error", reason)


def _one_line(reason: str) -> str:
    words = " ".join(reason.split())
    return words if len(words) <= MAX_REASON else words[: MAX_REASON - 3] + "..."


def _indices(cells: Sequence[Cell]) -> tuple[int, ...]:
    return tuple(cell.index for cell in cells)
