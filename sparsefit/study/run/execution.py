"""One flight of a study, case by case: each flight, library and fit is made once and shared."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeAlias, TypeVar

from sparsefit.estimator.estimate import Estimate
from sparsefit.estimator.prepared import Prepared
from sparsefit.flight import Flight
from sparsefit.regression.backend import Backend, PathBackend
from sparsefit.regression.fit import Fit, Path, path
from sparsefit.score import score
from sparsefit.study.run.scale_columns import ScaleColumns, scale_columns
from sparsefit.study.run.yardsticks import Yardstick, intervals, yardstick
from sparsefit.study.spec.choices import make_backend
from sparsefit.study.spec.design import Cell
from sparsefit.study.spec.document import canonical_json
from sparsefit.study.spec.flights import SIMULATION, Draw, stream
from sparsefit.study.spec.plan import fit_key, flight_key, problem_key, sharing
from sparsefit.study.spec.study import Study

MAX_REASON = 500
NAN = math.nan
ALPHA = "alpha_fraction"

Result = TypeVar("Result")


@dataclass(frozen=True)
class Stage:
    """What begins now, for which cells; if it hangs or dies, they are the ones it takes along.

    `fits` is how many fits the stage makes: the time it may take is that many case timeouts.
    """

    name: str
    cells: tuple[int, ...]
    fits: int = 1


@dataclass(frozen=True)
class Outcome(ScaleColumns):
    """The result of one case: what its row holds beyond the plan."""

    flight: int
    cell: int
    status: str
    reason: str = ""
    est_mean_velocity: float = NAN
    est_length_scale: float = NAN
    est_timescale: float = NAN
    grid_length_scale: float = NAN
    hit: bool = False
    certificate_kind: str = ""
    certificate: float = NAN
    seconds: float = NAN
    shared_seconds: float = 0.0
    samples: int = 0
    columns: int = 0
    weights: tuple[tuple[float, float], ...] = ()
    extent: float = NAN
    se_mean_velocity: float = NAN
    se_length_scale: float = NAN
    se_timescale: float = NAN
    low_mean_velocity: float = NAN
    low_length_scale: float = NAN
    low_timescale: float = NAN
    high_mean_velocity: float = NAN
    high_length_scale: float = NAN
    high_timescale: float = NAN
    bound_mean_velocity: float = NAN
    bound_length_scale: float = NAN
    bound_timescale: float = NAN


Event: TypeAlias = Stage | Outcome


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
        flown = _attempt(partial(draw.fly, stream(study.seed, flight, SIMULATION)))
        if isinstance(flown, Exception):
            yield from _failed(flight, cells, flown)
            continue
        measure = _attempt(partial(yardstick, draw, flown))
        if isinstance(measure, Exception):
            yield from _failed(flight, cells, measure)
            continue
        context = _Context(study, flight, draw, measure)
        for problem in sharing(cells, problem_key):
            yield from _run_problem(context, flown, problem, alone)


@dataclass(frozen=True)
class _Context:
    study: Study
    flight: int
    draw: Draw
    yardstick: Yardstick


def _run_problem(
    context: _Context, flown: Flight, cells: tuple[Cell, ...], alone: bool
) -> Iterator[Event]:
    yield Stage("building the library", _indices(cells))
    # The truth enters at the score and nowhere before.
    blind = dataclasses.replace(flown, flow=None)
    prepared = _attempt(partial(context.study.estimator(cells[0]).prepare, blind))
    if isinstance(prepared, Exception):
        yield from _failed(context.flight, cells, prepared)
        return
    for batch in _batches(cells, alone):
        here = tuple(index for fit in batch.fits for index in _indices(fit))
        yield Stage("fitting", here, fits=max(len(batch.fractions), 1))
        for fit_cells, found in _fit(context.study, prepared, batch):
            yield from _read(context, prepared, fit_cells, found)


@dataclass(frozen=True)
class _Batch:
    """Fits made together, each the cells that read it; `fractions` are those of their path."""

    fits: tuple[tuple[Cell, ...], ...]
    fractions: tuple[float, ...] = ()


def _batches(cells: tuple[Cell, ...], alone: bool) -> list[_Batch]:
    """Fits of one [[backends]] entry that differ in `alpha_fraction` only share a path."""
    batches: dict[tuple[object, str], list[tuple[Cell, ...]]] = {}
    for fit_cells in sharing(cells, fit_key):
        cell = fit_cells[0]
        single = alone or not _path_fractions(cell)
        rest = {key: value for key, value in cell.settings.items() if key != ALPHA}
        identity = (cell.choice, canonical_json(cell.settings if single else rest))
        batches.setdefault(identity, []).append(fit_cells)
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
        found = _attempt(partial(_path, prepared, backend, batch.fractions, study.tolerance))
        if not isinstance(found, Exception):
            at = dict(zip(batch.fractions, found.fits, strict=True))
            yield from ((cells, at[float(cells[0].settings[ALPHA])]) for cells in batch.fits)
            return
    # What fails together is tried one by one: the reason belongs to one of them.
    for cells in batch.fits:
        yield cells, _attempt(partial(study.estimator(cells[0]).fit, prepared))


def _path(
    prepared: Prepared, backend: Backend, fractions: tuple[float, ...], tolerance: float
) -> Path:
    return path(prepared.problem, backend, fractions, tolerance=tolerance)


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
    estimate: Estimate = context.study.estimator(cell).read(prepared, fit)
    certificate = estimate.certificate
    weights = sorted(estimate.weights_by_scale.items()) if context.study.store_weights else ()
    scales = prepared.problem.group_scales
    flow = context.draw.flow
    scored = scales is not None and flow is not None and score(estimate, flow, scales).hit
    columns: dict[str, Any] = vars(scale_columns(estimate, flow)) | vars(context.yardstick)
    columns |= intervals(estimate.uncertainty)
    return Outcome(
        flight=context.flight,
        cell=cell.index,
        status=estimate.status,
        reason=_one_line(estimate.reason or ""),
        est_mean_velocity=float(estimate.mean_velocity),
        est_length_scale=float(estimate.length_scale),
        est_timescale=float(estimate.timescale),
        grid_length_scale=float(estimate.grid_length_scale),
        hit=scored,
        certificate_kind=certificate.kind if certificate else "",
        certificate=float(certificate.value) if certificate else NAN,
        seconds=float(fit.seconds),
        shared_seconds=float(fit.shared_seconds),
        samples=int(prepared.problem.samples),
        columns=int(prepared.problem.columns),
        weights=tuple((float(scale), float(weight)) for scale, weight in weights),
        **columns,
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
