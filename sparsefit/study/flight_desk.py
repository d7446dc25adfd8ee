"""The worker's side of a study of flights: a flight, its library, its fits, made once and shared.

    fly      simulate the flights of a unit, or read them from a log; answers with the truth
    prepare  build the library of the cells of one regression problem
    cases    fit (along one path, where that is shared) and read each cell

Each answer is rows, never an exception: whatever happens in a case becomes its row.
"""

from __future__ import annotations

import dataclasses
import gc
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar

from sparsefit import Estimator, Fit, LengthScaleGrid, Library, PointMassVehicle, backends
from sparsefit.errors import described, one_line
from sparsefit.estimator.estimate import Estimate
from sparsefit.estimator.prepare import Prepared
from sparsefit.flight import Flight, simulate_flight
from sparsefit.flight.flow import Cells
from sparsefit.onboard import as_flown
from sparsefit.regression.backend import PathBackend
from sparsefit.regression.fit import path
from sparsefit.score import (
    strongest,
)
from sparsefit.study.columns import MAX_REASON, PARAMETERS, Outcome, Value, values_of
from sparsefit.study.crossing import Cell
from sparsefit.study.definition import Definition, FlightDesign
from sparsefit.study.draw import SIMULATION, Draw, stream
from sparsefit.study.logged import Logged
from sparsefit.study.reading import Reading, Yardstick, yardstick

ALPHA = "alpha_fraction"
Result = TypeVar("Result")


def estimator_of(definition: Definition, cell: Cell) -> Estimator:
    """The estimator of a cell: how it derives, fits and reads, to the study's tolerance."""
    estimator = Estimator(
        derivative=cell.setup.derivative,
        library=cell.setup.library,
        backend=backends.get(cell.choice.name, **cell.settings),
        readout=cell.setup.readout,
        tolerance=definition.run.tolerance,
    )
    return as_flown(estimator) if definition.on_board else estimator


def draw_of(definition: Definition, unit: int, cell: Cell) -> Draw | Logged:
    """The flight of a unit and a cell: its flow, vehicle and noise, or its log."""
    return cell.setup.flights.draw(unit, definition.flights.count, definition.seed)


def truth_of(draw: Draw | Logged) -> dict[str, Value]:
    """The columns of the true flow, the fastest of several; few of still air, none of a log."""
    if isinstance(draw, Logged):
        return {"flow": "unknown", "log": draw.piece.label}
    if draw.flow is None:
        return {"flow": "none"}
    cells: Cells = strongest(draw.flow)
    sides, drift = cells.length_scales, cells.drift
    names = (*PARAMETERS, "length_scale_x", "length_scale_y", "heading", "drift_x", "drift_y")
    values = (*(getattr(cells, name) for name in PARAMETERS), *sides, cells.heading, *drift)
    content: dict[str, Value] = {
        f"true_{name}": float(value) for name, value in zip(names, values, strict=True)
    }
    return {**content, "flow": "cellular"}


@dataclass(frozen=True)
class Flown:
    """The flights of a unit in a condition, without their flow, and how they are judged.

    The truth enters at the score and nowhere before.
    """

    unit: int
    draw: Draw | Logged
    fleet: tuple[Flight, ...]
    yardstick: Yardstick

    @classmethod
    def of(cls, definition: Definition, unit: int, cell: Cell) -> Flown:
        """Simulate, or read from its log, what the cells of one condition share."""
        draw = draw_of(definition, unit, cell)
        seed = stream(definition.seed, unit, SIMULATION)
        fleet = draw.fleet(seed)
        if isinstance(draw, Logged):
            return cls(unit, draw, fleet, Yardstick(fleet[0].extent))
        others = draw.others(seed, definition.run.prediction_flights) if draw.flown else ()
        blind = tuple(dataclasses.replace(flown, flow=None) for flown in fleet)
        return cls(unit, draw, blind, yardstick(draw, fleet, others))


@dataclass(frozen=True)
class Failure:
    """A step that raised: the reason alone, so that nothing of it stays in memory."""

    reason: str


def attempted(step: Callable[[], Result]) -> Result | Failure:
    """The result of the step, or why there is none."""
    try:
        return step()
    except MemoryError as error:
        failure = Failure(f"memory: {described(error, MAX_REASON)}")
    except Exception as error:
        return Failure(described(error, MAX_REASON))
    gc.collect()  # what the step allocated is not charged to the next
    return failure


class FlightDesk:
    """Answers for the cells of one flight after the other.

    Flights, regression problems and fits are kept while cells share them. A process that takes
    over from a lost one makes them again.
    """

    def __init__(self, definition: Definition) -> None:
        self._definition = definition
        self._flown: tuple[object, Flown | Failure] | None = None
        self._prepared: tuple[object, Prepared | Failure] | None = None
        # What is imported at first use is imported now, so that no case is charged for it.
        vehicle = PointMassVehicle(0.5, (5.0, 3.0))
        flight = simulate_flight(None, vehicle, duration=1.0, sample_rate=20.0, seed=0)
        Estimator(library=Library(LengthScaleGrid(3.0, 5.0, 1.0))).estimate(flight)

    @property
    def _design(self) -> FlightDesign:
        return self._definition.flights

    def answer(self, verb: str, **content: Any) -> Mapping[str, Any]:
        """The answer to `fly`, `prepare` or `cases` of a unit and cells."""
        unit, cells = content["unit"], [self._design.cells[index] for index in content["cells"]]
        if verb == "fly":
            return _said(self._fly(unit, cells[0]))
        if verb == "prepare":
            return _said(self._prepare(unit, cells[0]))
        rows = [_row(outcome) for outcome in self.outcomes(unit, cells)]
        return {"rows": rows}

    def outcomes(self, unit: int, cells: Sequence[Cell]) -> Iterator[Outcome]:
        """The outcomes of cells that share a regression problem and, if several, a path."""
        flown = self._fly(unit, cells[0])
        prepared = self._prepare(unit, cells[0])
        for failed in (flown, prepared):
            if isinstance(failed, Failure):
                yield from (_error(unit, cell, failed) for cell in cells)
                return
        assert isinstance(flown, Flown)
        assert not isinstance(prepared, Failure)
        for cell, fit in self._fits(prepared, cells):
            if isinstance(fit, Failure):
                yield _error(unit, cell, fit)
                continue
            outcome = attempted(partial(self._outcome, flown, prepared, cell, fit))
            yield _error(unit, cell, outcome) if isinstance(outcome, Failure) else outcome

    def _fly(self, unit: int, cell: Cell) -> Flown | Failure:
        key = (unit, cell.setup.flights)
        if self._flown is None or self._flown[0] != key:
            self._flown = self._prepared = None
            self._flown = (key, attempted(partial(Flown.of, self._definition, unit, cell)))
        return self._flown[1]

    def _prepare(self, unit: int, cell: Cell) -> Prepared | Failure:
        setup = cell.setup
        key = (unit, setup.flights, setup.derivative, setup.library, setup.online)
        flown = self._fly(unit, cell)
        if isinstance(flown, Failure):
            return flown
        if self._prepared is None or self._prepared[0] != key:
            self._prepared = None
            step = partial(_prepared, self._definition, cell, flown.fleet)
            self._prepared = (key, attempted(step))
        return self._prepared[1]

    def _fits(
        self, prepared: Prepared, cells: Sequence[Cell]
    ) -> Iterator[tuple[Cell, Fit | Failure]]:
        """The fit of each cell; cells that differ in `alpha_fraction` only share a path."""
        fractions = path_fractions(cells[0]) if len(cells) > 1 else ()
        if fractions:
            walked = attempted(partial(self._path, prepared, cells[0], fractions))
            if not isinstance(walked, Failure):
                for cell in cells:
                    yield cell, walked[float(cell.settings[ALPHA])]
                return
        # Cells that fail together are tried one by one: the reason belongs to one of them.
        fits: dict[str, Fit | Failure] = {}
        for cell in cells:
            key = cell.canonical_settings
            if key not in fits:
                estimator = attempted(partial(estimator_of, self._definition, cell))
                fits[key] = (
                    estimator
                    if isinstance(estimator, Failure)
                    else attempted(partial(estimator.fit, prepared))
                )
            yield cell, fits[key]

    def _path(
        self, prepared: Prepared, cell: Cell, fractions: tuple[float, ...]
    ) -> dict[float, Fit]:
        backend: Any = estimator_of(self._definition, cell).backend
        tolerance = self._definition.run.tolerance
        walked = path(prepared.problem, backend, fractions, tolerance=tolerance)
        return dict(zip(fractions, walked.fits, strict=True))

    def _outcome(self, flown: Flown, prepared: Prepared, cell: Cell, fit: Fit) -> Outcome:
        estimate, values = read_case(self._definition, flown, prepared, cell, fit)
        weights: tuple[tuple[float, float], ...] = ()
        if self._definition.keeps_weights:
            pairs = estimate.weights_by_scale.items()
            weights = tuple(sorted((float(scale), float(weight)) for scale, weight in pairs))
        reason = one_line(estimate.reason or "", MAX_REASON)
        shared = float(fit.shared_seconds)
        return Outcome(flown.unit, cell.index, estimate.status, reason, values, shared, weights)


def _prepared(definition: Definition, cell: Cell, fleet: tuple[Flight, ...]) -> Prepared:
    return cell.setup.online.prepare(estimator_of(definition, cell), fleet)


def read_case(
    definition: Definition, flown: Flown, prepared: Prepared, cell: Cell, fit: Fit
) -> tuple[Estimate, dict[str, Value]]:
    """The estimate of a fit, and the values of its columns."""
    estimate = estimator_of(definition, cell).read(prepared, fit)
    flow = flown.draw.flow
    return estimate, values_of(Reading(estimate, fit, prepared.problem, flow, flown.yardstick))


def path_fractions(cell: Cell) -> tuple[float, ...]:
    """The whole grid of penalties of a [[backends]] entry that walks one path; else none.

    All of it, whatever is left to do of it: a resumed run repeats the path.
    """
    if cell.settings.get(ALPHA) == "auto":  # it walks a path of its own
        return ()
    grid = [value for value in cell.choice.grid.get(ALPHA, ()) if value != "auto"]
    if len(grid) < 2:
        return ()
    backend = backends.get(cell.choice.name, **cell.settings)
    return tuple(map(float, grid)) if isinstance(backend, PathBackend) else ()


def _error(unit: int, cell: Cell, failure: Failure) -> Outcome:
    return Outcome(unit, cell.index, "error", failure.reason)


def _said(step: object) -> dict[str, Any]:
    return {"failed": step.reason if isinstance(step, Failure) else ""}


def _row(outcome: Outcome) -> dict[str, Any]:
    """An outcome as JSON holds it."""
    return {
        "cell": outcome.cell,
        "status": str(outcome.status),
        "reason": outcome.reason,
        "values": {n: _finite(v) for n, v in outcome.values.items() if v == v and v != ""},
        "shared": _finite(outcome.shared_seconds),
        "weights": [[_finite(value) for value in pair] for pair in outcome.weights],
    }


def _finite(value: Any) -> Any:
    if not isinstance(value, float) or math.isfinite(value):
        return value
    return None if math.isnan(value) else str(value)
