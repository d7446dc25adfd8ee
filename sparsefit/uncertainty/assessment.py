"""One assessment of one fit: U0, L and tau_w of every mode of cells, or of waves; how sure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sparsefit.arrays import Array, IntArray
from sparsefit.derivative import Samples
from sparsefit.library.equal_waves import EqualWaves
from sparsefit.library.family import Family
from sparsefit.library.nuisance import NUMBERS, Nuisance, VehicleEstimate
from sparsefit.library.waves import Waves
from sparsefit.modes.fitted_rows import Rows
from sparsefit.modes.projection import Projection
from sparsefit.modes.stack import Part
from sparsefit.uncertainty.constancy import Constancy
from sparsefit.uncertainty.corrected import Known, corrected
from sparsefit.uncertainty.flow import FlowUncertainty, entries, flow_of
from sparsefit.uncertainty.goodness import Goodness, goodness_of
from sparsefit.uncertainty.model import Model
from sparsefit.uncertainty.reading import MODE, Reader, Reading, cellular, joined
from sparsefit.uncertainty.reading import vehicle as of_vehicle
from sparsefit.uncertainty.record import Uncertainty
from sparsefit.uncertainty.shape import CELL, Shape, flows_of, names_of, phases_of, waves
from sparsefit.uncertainty.vehicle import VehicleUncertainty


@dataclass(frozen=True)
class ModeAssessment:
    """U0 [m/s], L [m] and tau_w [s] of one mode, and how sure they are."""

    mean_velocity: float
    length_scale: float
    timescale: float
    uncertainty: Uncertainty

    @property
    def values(self) -> tuple[float, float, float]:
        """U0, L and tau_w."""
        return self.mean_velocity, self.length_scale, self.timescale


@dataclass(frozen=True)
class Assessment:
    """Every mode of a fit in its order, and the vehicle where something beside the flow is unknown.

    Args:
        modes: the values of each mode, corrected where asked.
        vehicle: the vehicle and the wind that fit best, None where all of it was known.
        vehicle_uncertainty: how sure what was unknown of them is.
        goodness: how well the modes fit.
        shapes: the cells that two waves make, of each mode of waves.
        flow: how sure a flow of waves is anywhere, where that is told; places count from where
            the rows do.
        vehicles: of several flights the vehicle of each, where something beside the flow is
            unknown, and how sure that is.
        constancy: whether U0 of the fastest flow kept its value, where that can be told.
    """

    modes: tuple[ModeAssessment, ...]
    vehicle: VehicleEstimate | None = None
    vehicle_uncertainty: VehicleUncertainty | None = None
    goodness: Goodness | None = None
    shapes: tuple[Shape, ...] = ()
    flow: FlowUncertainty | None = None
    vehicles: tuple[tuple[VehicleEstimate, VehicleUncertainty], ...] = ()
    constancy: Constancy | None = None

    @property
    def white(self) -> bool:
        """Whether no turbulence was found beside the flow."""
        return self.goodness is None or not self.goodness.turbulence > 0


def assess(
    samples: Samples,
    rows: Rows,
    family: Family | EqualWaves,
    fit: Projection,
    nuisance: Nuisance,
    *,
    correct: bool,
) -> Assessment | None:
    """Assess a fit of modes of `Cells`, or of one flow of waves, to the rows of a flight.

    Args:
        samples: what the rows were made of.
        rows: what was fitted, for the vehicle that is believed.
        family: the family of the modes.
        fit: the projection of the rows at the best parameters.
        nuisance: what is unknown beside the flow, and the vehicle that is believed.
        correct: whether bias that is known to first order is taken from the values; if not, it
            is left in them and counts in full as a standard error.

    Returns:
        None below 21 samples, with fewer rows than parameters of a velocity component, or where
        the vehicle that fits best is impossible.
    """
    return assess_flights([Part(samples, nuisance)], rows, family, fit, correct=correct)


def assess_flights(
    parts: Sequence[Part],
    rows: Rows,
    family: Family | EqualWaves,
    fit: Projection,
    *,
    correct: bool,
) -> Assessment | None:
    """The same of a fit to the rows of several flights; None where one of them is too short."""
    vehicles, model = vehicles_of(parts, fit.coefficients), Model.of(family, rows, fit)
    if not all(vehicle.possible for vehicle in vehicles):
        return None
    if len(parts) == 1 and parts[0].nuisance.unknown:
        model, nuisance = _as_found(parts[0].samples, model, parts[0].nuisance, vehicles[0])
        parts = [replace(parts[0], nuisance=nuisance)]
    flows = flows_of(*phases_of(model)) if isinstance(model.family, Waves) else []
    nuisances = [part.nuisance for part in parts]
    known = corrected(parts, model, reader(*nuisances, flows=flows), correct=correct)
    if known is None:
        return None
    if isinstance(model.family, Waves):
        names = names_of(model.family, len(model.parameters))
        read, count = _of_waves(known, names, len(flows), model), len(flows) * len(names)
        read = replace(read, flow=flow_of(model, common(nuisances), known.errors))
    else:
        count = len(MODE) * len(fit.parameters)
        every = known.values, known.errors, known.freedom
        by_mode = [array[:count].reshape(-1, 3) for array in every]
        modes = tuple(_mode(*one) for one in zip(*by_mode, strict=True))
        goodness = goodness_of(model, known, modes[0].mean_velocity, modes[0].length_scale)
        read = Assessment(modes, goodness=goodness)
    if known.growth is not None:
        fastest = max(mode.mean_velocity for mode in read.modes)
        read = replace(read, constancy=Constancy.of(known.growth, fastest))
    if not vehicles[0].unknown:
        return read
    own, beside = sum(map(_entries, vehicles[0].unknown)), []
    for first, vehicle in enumerate(vehicles):
        place = slice(count + own * first, count + own * (first + 1))
        every = known.values[place], known.errors[place], known.freedom[place]
        beside.append(_vehicle(vehicle, Known(*every)))
    if len(parts) > 1:
        return replace(read, vehicles=tuple(beside))
    return replace(read, vehicle=beside[0][0], vehicle_uncertainty=beside[0][1])


def vehicles_of(parts: Sequence[Part], coefficients: Array) -> list[VehicleEstimate]:
    """The vehicle of each flight, from the coefficients (j,) of all nuisance columns."""
    ends = np.cumsum([len(part.nuisance.pairs) for part in parts])[:-1]
    pairs = zip(parts, np.split(coefficients, ends), strict=True)
    return [part.nuisance.read(own) for part, own in pairs]


def common(nuisances: Sequence[Nuisance]) -> Nuisance:
    """What scales the weights of the flow: the unknown response time of a single flight."""
    return nuisances[0] if len(nuisances) == 1 else Nuisance((), nuisances[0].believed)


def reader(*nuisances: Nuisance, flows: list[IntArray] | None = None) -> Reader:
    """What a model of flights is read for: its modes, then what is unknown of each flight.

    flows: the places of the waves of every flow, of a model of `Waves`; None: all are one flow's.
    """
    shared = common(nuisances)

    def read(model: Model) -> Reading:
        waved, first = isinstance(model.family, Waves), 0
        read = waves(model, shared, flows) if waved else cellular(model, shared)
        for nuisance in nuisances:
            if nuisance.unknown:
                read = joined(read, of_vehicle(model, nuisance, first))
            first += len(nuisance.pairs)
        return joined(read, entries(model, shared)) if waved else read

    return read


def _of_waves(known: Known, names: tuple[str, ...], count: int, model: Model) -> Assessment:
    """What is known of all flows that waves make, fastest first."""
    every = known.values, known.errors, known.freedom
    own = len(names)
    flows = np.arange(count * own).reshape(count, own)
    flows = flows[np.argsort(-known.values[flows[:, 0]], kind="stable")]
    modes = tuple(_mode(*(array[flow[: len(MODE)]] for array in every)) for flow in flows)
    goodness = goodness_of(model, known, modes[0].mean_velocity, modes[0].length_scale)
    shapes: tuple[Shape, ...] = ()
    if CELL[0] in names:
        cells = flows[:, len(MODE) :]
        shapes = tuple(Shape.around(*(array[cell] for array in every)) for cell in cells)
    return Assessment(modes, goodness=goodness, shapes=shapes)


def _as_found(
    samples: Samples, model: Model, nuisance: Nuisance, vehicle: VehicleEstimate
) -> tuple[Model, Nuisance]:
    """The same fit, of the rows of the vehicle that was found: b_v = 0, W in units of Phi."""
    found, ratio = vehicle.vehicle, nuisance.ratio(model.coefficients)
    settled = [0.0] * (nuisance.shared + nuisance.scaled)
    left = (*settled, *(vehicle.wind if nuisance.constant else ()))
    turned = replace(
        model,
        rows=replace(
            Rows.of(samples.weak or samples, found, vehicle.unknown), position=model.rows.position
        ),
        weights=model.weights / ratio,
        coefficients=np.array(left),
    )
    return turned, Nuisance(vehicle.unknown, found)


def _mode(values: Array, errors: Array, freedom: Array) -> ModeAssessment:
    speed, scale, _ = values.tolist()
    each = (speed, scale, scale / speed)  # tau_w is L / U0, whatever was cut of a correction
    return ModeAssessment(*each, Uncertainty.around(each, errors.tolist(), freedom.tolist()))


def _vehicle(vehicle: VehicleEstimate, known: Known) -> tuple[VehicleEstimate, VehicleUncertainty]:
    """The vehicle with the values that were read of it, in the order of what is unknown."""
    parts: list[dict[str, tuple[float, ...]]] = [{}, {}, {}]
    first = 0
    for name in vehicle.unknown:
        part = slice(first, first + _entries(name))
        for own, array in zip(parts, (known.values, known.errors, known.freedom), strict=True):
            own[name] = tuple(array[part].tolist())
        first = part.stop
    values = parts[0]
    read: dict[str, Any] = {n: v[0] if n in NUMBERS else v for n, v in values.items()}
    return replace(vehicle, **read), VehicleUncertainty.around(*parts)


def _entries(name: str) -> int:
    """How many numbers an unknown of the vehicle is."""
    return 1 if name in NUMBERS else 2
