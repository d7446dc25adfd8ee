"""A study of flights, worker side: flights, regression problems and fits, shared between cases.

    fly      simulate the flights of a unit, or read them from a log
    prepare  build the library of the cells of one regression problem
    cases    fit (along the path of penalties that they are on) and read each cell
    alone    the same without the path: of a cell whose path failed

A row is (cell, status, reason, values). To time an estimate there are

    ready    simulate or read the flight, pinned to one core; returns the peak memory so far
    estimate the flow from the flight's log, all steps
"""

from __future__ import annotations

import gc
import json
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from sparsefit import backends
from sparsefit.errors import InputError, one_line
from sparsefit.estimator import Estimate, Estimator
from sparsefit.flight import Flight, simulate_flight
from sparsefit.flight.flow import Cells, CellularFlow
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.likelihood import FlightLog, Model, StreamPattern, bound
from sparsefit.model import LengthScaleGrid, Library
from sparsefit.model.grid import extent_of
from sparsefit.onboard import as_flown
from sparsefit.regression import Fit, RegressionProblem
from sparsefit.regression.fit import path
from sparsefit.score import prediction_error, score, score_scales, strongest
from sparsefit.study.columns import FLIGHT_COLUMNS, MAX_REASON, PARAMETERS, Value
from sparsefit.study.crossing import ALPHA, Cell
from sparsefit.study.draw import SIMULATION, Draw, FlightRules, Logged, Logs, stream
from sparsefit.study.worker import peak_memory


@dataclass(frozen=True)
class Flown:
    """The flights of a unit in a condition, without their flow, and what they are scored by.

    The truth enters at the score and nowhere before. extent [m]: of the flights together; bounds:
    Cramér-Rao bounds of U0 [m/s], L [m] and tau_w [s], empty where there are none. others: flights
    through the same flow, on which its prediction is scored.
    """

    draw: Draw | Logged
    fleet: tuple[Flight, ...]
    extent: float
    bounds: Mapping[str, float] = field(default_factory=dict)
    others: tuple[Flight, ...] = ()


@dataclass(frozen=True)
class Reading:
    """The estimate of a case, and what else its columns are computed from."""

    estimate: Estimate
    fit: Fit
    problem: RegressionProblem
    flown: Flown

    @cached_property
    def values(self) -> dict[str, Value]:
        """The values of the columns of `cases.parquet` that have a path, by name."""
        values = {column.name: column.read(self) for column in FLIGHT_COLUMNS if column.path}
        return {name: value for name, value in values.items() if value is not None}

    @property
    def hit(self) -> bool:
        """Whether the candidate scale nearest the truth was chosen."""
        scales, flow = self.problem.group_scales, self.flown.draw.flow
        return scales is not None and flow is not None and score(self.estimate, flow, scales).hit

    @cached_property
    def scale_sets(self) -> dict[str, Any]:
        """Columns of estimated scales beside the true ones; empty of one scale estimated as one.

        Each is listed as JSON, [[L [m], U0 [m/s]], ...], to seven digits. A readout of one scale on
        superposed flows counts as the set of that scale.
        """
        estimate, flow = self.estimate, self.flown.draw.flow
        if flow is None or (len(flow.cells) == 1 and not estimate.scales):
            return {}
        scales: Any = estimate.scales
        if not scales and math.isfinite(estimate.length_scale + estimate.mean_velocity):
            scales = (estimate,)
        scored = score_scales(scales, flow)
        result: dict[str, Any] = {f"scales_{name}": value for name, value in vars(scored).items()}
        result["scales_within_1_percent"] = scored.within(1.0)
        for name, listed in (("true_scales", flow.cells), ("est_scales", scales)):
            pairs = [(scale.length_scale, scale.mean_velocity) for scale in listed]
            rounded = [[float(f"{value:.7g}") for value in pair] for pair in pairs]
            result[name] = json.dumps(rounded, separators=(",", ":"))
        return result

    @property
    def prediction_error(self) -> float | None:
        """The relative error of the flow along other flights; None without a flow or a flight."""
        flow, others = self.estimate.flow, self.flown.others
        return prediction_error(flow, others) if flow is not None and others else None


def bounds_of(draw: Draw, fleet: tuple[Flight, ...]) -> dict[str, float]:
    """The Cramér-Rao bounds of U0 [m/s], L [m] and tau_w [s] of flights together under Eq. 7.

    They assume exact trajectories and white noise on v' alone. Empty without process noise, with
    noise of position or velocity, of any but a single cellular flow, or where the flights do not
    determine all its parameters.
    """
    noise, flow = draw.values.get("process_noise", 0.0), draw.flow
    measured = any(draw.values.get(name, 0.0) > 0 for name in ("position_noise", "velocity_noise"))
    if noise <= 0 or measured or not isinstance(flow, CellularFlow):
        return {}
    speed, scale, models = flow.mean_velocity, flow.length_scale, list[Model]()
    pattern = StreamPattern("axis", (speed, scale, -math.pi, 0.0))  # the phases of its two waves
    for flown in fleet:
        density = noise * math.sqrt(flown.duration / (flown.samples - 1))  # [m/s^2/sqrt(Hz)]
        # Trajectories are exact, almost.
        noises = {"position_noise": 1e-6 * scale, "velocity_noise": 1e-6 * speed}
        model = Model.of_flight(pattern, flown, draw.vehicle, (0.0, 0.0))
        models.append(model.at({"acceleration": density} | noises))
    states = [np.hstack([flown.position, flown.velocity]) for flown in fleet]
    try:
        covariance = bound([FlightLog.of_flight(flown) for flown in fleet], models, states)
    except InputError:
        return {}
    slopes = np.array([[1.0, 0.0], [0.0, 1.0], [-scale / speed**2, 1.0 / speed]])  # by U0 and L
    errors = np.sqrt(np.einsum("ij,jk,ik->i", slopes, covariance[:2, :2], slopes)).tolist()
    return dict(zip(("mean_velocity", "length_scale", "timescale"), errors, strict=True))


def estimator_of(plan: Any, cell: Cell) -> Estimator:
    """The estimator of a cell: derivative, library, back-end and readout, the study's tolerance."""
    backend = backends.get(cell.backend.name, **cell.backend.settings)
    tolerance = plan.definition.run.tolerance
    estimator = replace(cell.setup.estimator, backend=backend, tolerance=tolerance)
    return as_flown(estimator) if plan.on_board else estimator


def fly(plan: Any, unit: int, rules: FlightRules | Logs) -> Flown:
    """Simulate the flights that the cells of one condition share, or read them from a log."""
    draw = rules.draw(unit, plan.count, plan.definition.seed)
    seed = stream(plan.definition.seed, unit, SIMULATION)
    fleet = draw.fleet(seed)
    extent = extent_of(np.concatenate([flown.position for flown in fleet]))
    if isinstance(draw, Logged):
        return Flown(draw, fleet, extent)
    others = draw.others(seed, plan.definition.run.prediction_flights) if draw.flown else ()
    blind = tuple(replace(flown, flow=None) for flown in fleet)
    return Flown(draw, blind, extent, bounds_of(draw, fleet), others)


def truth_of(draw: Draw | Logged) -> dict[str, Value]:
    """The columns of the true flow (of several, the strongest); of a log its name alone."""
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
    """Computes cases, one flight after the other.

    The last flight and regression problem are kept for the cells that share them; a worker that
    replaces a lost one computes them again.
    """

    def __init__(self, plan: Any) -> None:
        self._plan, self._cells = plan, plan.points
        self._estimators: dict[int, Estimator] = {}
        self._flown: tuple[Any, Any] = (None, None)  # which, and the flights
        self._prepared: tuple[Any, Any] = (None, None)  # which, and the regression problem
        # Imports at first use are made now, outside the time of any case.
        vehicle = PointMassVehicle(0.5, (5.0, 3.0))
        flight = simulate_flight(None, vehicle, duration=1.0, sample_rate=20.0, seed=0)
        Estimator(library=Library(LengthScaleGrid(3.0, 5.0, 1.0))).estimate(flight)

    def fly(self, unit: int, cells: Sequence[int]) -> None:
        """Simulate or read the flights of a unit in the condition of these cells."""
        key = (unit, self._cells[cells[0]].setup.flights)
        if self._flown[0] != key:
            self._flown = self._prepared = (None, None)
            gc.collect()  # garbage of a flight is not collected in the time of the next
            self._flown = (key, fly(self._plan, *key))

    def prepare(self, unit: int, cells: Sequence[int]) -> None:
        """Build the regression problem that these cells share."""
        self.fly(unit, cells)
        setup = self._cells[cells[0]].setup
        key = (setup.derivative, setup.library, setup.online)
        if self._prepared[0] != key:
            self._prepared = (None, None)
            self._prepared = (key, self._estimator(cells[0]).prepare(self._flown[1].fleet))

    def _estimator(self, index: int) -> Estimator:
        if index not in self._estimators:
            cell = self._cells[index]
            estimator = estimator_of(self._plan, cell)
            self._estimators[index] = cell.setup.online.flying(estimator)
        return self._estimators[index]

    def cases(self, unit: int, cells: Sequence[int], *, alone: bool = False) -> dict[str, Any]:
        """The rows of cells that share a fit, or a path of penalties."""
        rows = []
        for index, reading in self.readings(unit, cells, alone=alone):
            estimate, values = reading.estimate, reading.values | truth_of(reading.flown.draw)
            reason = one_line(estimate.reason or "", MAX_REASON)
            rows.append((index, estimate.status, reason, values))
        return {"rows": rows}

    def alone(self, unit: int, cells: Sequence[int]) -> dict[str, Any]:
        """The rows of cells whose path, or common fit, has failed."""
        return self.cases(unit, cells, alone=True)

    def readings(
        self, unit: int, cells: Sequence[int], *, alone: bool = False
    ) -> Iterator[tuple[int, Reading]]:
        """The estimate of each of these cells, by its index; alone: without its path."""
        self.prepare(unit, cells)
        flown, prepared = self._flown[1], self._prepared[1]
        first, problem = self._estimator(cells[0]), prepared.problem
        points = [self._cells[index].backend for index in cells]
        if (fractions := points[0].fractions) and not alone:
            backend: Any = first.backend
            walked = path(problem, backend, fractions, tolerance=first.tolerance).fits
            fit_of = dict(zip(fractions, walked, strict=True))
            fits = [fit_of[float(point.settings[ALPHA])] for point in points]
        else:  # one fit, read in several ways
            fits = [first.fit(prepared)] * len(cells)
        for index, fit in zip(cells, fits, strict=True):
            yield index, Reading(self._estimator(index).read(prepared, fit), fit, problem, flown)

    def ready(self, unit: int, cells: Sequence[int]) -> dict[str, Any]:
        """Pin the process to one core and have the flight; the peak memory [MB] so far."""
        self.fly(unit, cells)
        if hasattr(os, "sched_setaffinity"):
            os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
        return {"memory": peak_memory()}

    def estimate(self, unit: int, cells: Sequence[int]) -> None:
        """Estimate the flow from the log; an estimate that raises is timed as well."""
        with suppress(Exception):
            self._estimator(cells[0]).estimate(self._flown[1].fleet)
