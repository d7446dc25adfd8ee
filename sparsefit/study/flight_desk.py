"""The worker's side of a study of flights: a flight, its library, its fits, made once and shared.

    fly      simulate the flights of a unit, or read them from a log
    prepare  build the library of the cells of one regression problem
    cases    fit (along one path, where that is shared) and read each cell

A row is (cell, status, reason, body), as the store keeps it. To time an estimate there are

    ready    fly the flight of a unit, on a core of its own; answers with the memory so far
    estimate it, from its record to the answer
"""

from __future__ import annotations

import gc
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sparsefit import Estimator, Library, PointMassVehicle, backends
from sparsefit.errors import InputError, SparsefitError, described, one_line
from sparsefit.estimator.estimate import Estimate
from sparsefit.estimator.prepare import Prepared
from sparsefit.flight import simulate_flight
from sparsefit.flight.flow import Cells
from sparsefit.model import LengthScaleGrid
from sparsefit.model.grid import extent_of
from sparsefit.onboard import as_flown
from sparsefit.regression import Fit
from sparsefit.regression.fit import path
from sparsefit.score import strongest
from sparsefit.study.columns import MAX_REASON, PARAMETERS, Value, body_of, values_of
from sparsefit.study.crossing import Cell
from sparsefit.study.definition import Definition
from sparsefit.study.draw import SIMULATION, Draw, FlightRules, stream
from sparsefit.study.logged import Logged, Logs
from sparsefit.study.reading import Flown, Reading, bounds_of
from sparsefit.study.worker import resident

ALPHA = "alpha_fraction"


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


def path_fractions(cell: Cell) -> tuple[float, ...]:
    """The whole grid of penalties of a [[backends]] entry that walks one path; else none.

    All of it, whatever is left to do of it: a resumed run repeats the path.
    """
    grid = [value for value in cell.choice.grid.get(ALPHA, ()) if value != "auto"]
    # With "auto" a back-end walks a path of its own.
    walks = cell.walks and cell.settings.get(ALPHA) != "auto" and len(grid) > 1
    return tuple(map(float, grid)) if walks else ()


def fly(definition: Definition, unit: int, rules: FlightRules | Logs) -> Flown:
    """Simulate, or read from its log, what the cells of one condition share."""
    draw = rules.draw(unit, definition.flights.count, definition.seed)
    seed = stream(definition.seed, unit, SIMULATION)
    fleet = draw.fleet(seed)
    extent = extent_of(np.concatenate([flown.position for flown in fleet]))
    if isinstance(draw, Logged):
        return Flown(unit, draw, fleet, extent)
    others = draw.others(seed, definition.run.prediction_flights) if draw.flown else ()
    blind = tuple(replace(flown, flow=None) for flown in fleet)
    return Flown(unit, draw, blind, extent, bounds_of(draw, fleet), others)


def truth_of(draw: Draw | Logged) -> dict[str, Value]:
    """The columns of the true flow, the fastest of several; few of still air, none of a log."""
    if isinstance(draw, Logged):
        return {"flow": "unknown", "log": draw.label}
    if draw.flow is None:
        return {"flow": "none"}
    cells: Cells = strongest(draw.flow)
    sides, drift = cells.length_scales, cells.drift
    names = (*PARAMETERS, "length_scale_x", "length_scale_y", "heading", "drift_x", "drift_y")
    values = (*(getattr(cells, name) for name in PARAMETERS), *sides, cells.heading, *drift)
    truth = {f"true_{name}": float(value) for name, value in zip(names, values, strict=True)}
    return {**truth, "flow": "cellular"}


class FlightDesk:
    """Answers for the cells of one flight after the other; what a step raises is its answer.

    Flights, regression problems and fits are kept while cells share them. A process that takes
    over from a lost one makes them again.
    """

    def __init__(self, definition: Definition) -> None:
        self._definition = definition
        self._estimators: dict[int, Estimator] = {}
        self._flown: tuple[object, Flown] | None = None
        self._prepared: tuple[object, Prepared] | None = None
        # What is imported at first use is imported now, so that no case is charged for it.
        vehicle = PointMassVehicle(0.5, (5.0, 3.0))
        flight = simulate_flight(None, vehicle, duration=1.0, sample_rate=20.0, seed=0)
        Estimator(library=Library(LengthScaleGrid(3.0, 5.0, 1.0))).estimate(flight)
        gc.collect()
        gc.freeze()  # later collections pass over what is loaded now

    def answer(self, verb: str, **content: Any) -> Mapping[str, Any]:
        """The answer to a verb for a unit and cells that share its flight."""
        cells = [self._definition.flights.cells[index] for index in content["cells"]]
        flown = self._fly(content["unit"], cells[0])
        if verb == "prepare":
            self._prepare(flown, cells[0])
        elif verb == "cases":
            prepared = self._prepare(flown, cells[0])
            fits = self._fits(prepared, cells)
            return {"rows": [self._row(flown, prepared, cell, fit) for cell, fit in fits]}
        elif verb == "ready":
            if hasattr(os, "sched_setaffinity"):
                os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
            return {"memory": resident()}
        elif verb == "estimate":
            with suppress(Exception):  # a refusal takes its time too
                self._estimator(cells[0]).estimate(flown.fleet)
        return {}

    def _estimator(self, cell: Cell) -> Estimator:
        if cell.index not in self._estimators:
            self._estimators[cell.index] = estimator_of(self._definition, cell)
        return self._estimators[cell.index]

    def _fly(self, unit: int, cell: Cell) -> Flown:
        key = (unit, cell.setup.flights)
        if self._flown is None or self._flown[0] != key:
            self._flown = self._prepared = None
            gc.collect()  # what a flight has left is not charged to the next
            self._flown = (key, fly(self._definition, *key))
        return self._flown[1]

    def _prepare(self, flown: Flown, cell: Cell) -> Prepared:
        setup = cell.setup
        key = (setup.derivative, setup.library, setup.online)
        if self._prepared is None or self._prepared[0] != key:
            self._prepared = None
            prepared = setup.online.prepare(self._estimator(cell), flown.fleet)
            self._prepared = (key, prepared)
        return self._prepared[1]

    def _fits(self, prepared: Prepared, cells: Sequence[Cell]) -> Iterator[tuple[Cell, Fit]]:
        """The fit of each cell; cells that differ in `alpha_fraction` only share a path."""
        estimator = self._estimator(cells[0])
        fractions = path_fractions(cells[0]) if len(cells) > 1 else ()
        if fractions:
            backend: Any = estimator.backend
            tolerance = self._definition.run.tolerance
            fits = path(prepared.problem, backend, fractions, tolerance=tolerance).fits
            walked = dict(zip(fractions, fits, strict=True))
            yield from ((cell, walked[float(cell.settings[ALPHA])]) for cell in cells)
        else:  # one fit, read in several ways
            fit = estimator.fit(prepared)
            yield from ((cell, fit) for cell in cells)

    def _row(
        self, flown: Flown, prepared: Prepared, cell: Cell, fit: Fit
    ) -> tuple[int, str, str, str]:
        estimate = self._estimator(cell).read(prepared, fit)
        values = values_of(Reading(estimate, fit, prepared.problem, flown)) | truth_of(flown.draw)
        pairs = estimate.weights_by_scale.items() if self._definition.keeps_weights else ()
        weights = sorted((float(scale), float(weight)) for scale, weight in pairs)
        reason = one_line(estimate.reason or "", MAX_REASON)
        return cell.index, estimate.status, reason, body_of(values, weights)


@dataclass(frozen=True, eq=False)
class CaseAgain:
    """A case that was run once more, in this process.

    values: the columns of `cases.parquet` that are read from it, by name.
    """

    flown: Flown
    estimate: Estimate
    values: dict[str, Value]

    @classmethod
    def of(cls, definition: Definition, unit: int, cell: Cell) -> CaseAgain:
        """Fly, fit and read. Raises SparsefitError where the case fails, as in the run."""
        try:
            flown = fly(definition, unit, cell.setup.flights)
            estimator = estimator_of(definition, cell)
            prepared = cell.setup.online.prepare(estimator, flown.fleet)
            fit = estimator.fit(prepared)
            estimate = estimator.read(prepared, fit)
            values = values_of(Reading(estimate, fit, prepared.problem, flown))
        except InputError:
            raise
        except Exception as error:
            name = f"{unit:04d}-{cell.key}"
            raise SparsefitError(f"{name} ends in an error: {described(error)}") from error
        return cls(flown, estimate, values)
