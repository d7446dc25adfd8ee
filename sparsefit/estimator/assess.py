"""What is read at the modes of a flight: their parameters, how sure they are, and the vehicle."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sparsefit.estimator.estimate import ScaleEstimate
from sparsefit.estimator.locate import Place
from sparsefit.estimator.prepare import Prepared
from sparsefit.estimator.shaped import Shaped, flow_of, rungs_of, with_wind
from sparsefit.flight.waves import WaveFlow
from sparsefit.library.cells import Cells
from sparsefit.library.nuisance import VehicleEstimate
from sparsefit.modes.choice import Ladder
from sparsefit.modes.projection import Projection, project
from sparsefit.modes.readout import Readout, mean_velocity_of
from sparsefit.uncertainty import (
    Assessment,
    Constancy,
    Goodness,
    Shape,
    VehicleUncertainty,
    assess_flights,
    common,
    values_of,
    vehicles_of,
)

NOTHING = ScaleEstimate(math.nan, math.nan, math.nan, math.nan)


@dataclass(frozen=True)
class Reading:
    """The cellular flows of a flight, fastest first, and what was unknown of the vehicle.

    assessed: whether standard errors were sought; goodness: how well the modes fit, where they
    were; shaped: the flow of waves, where it is one; vehicles: of several flights what was unknown
    of each, and how sure it is; constancy: whether U0 kept its value.
    """

    scales: tuple[ScaleEstimate, ...]
    vehicle: VehicleEstimate | None = None
    vehicle_uncertainty: VehicleUncertainty | None = None
    assessed: bool = False
    goodness: Goodness | None = None
    shaped: Shaped | None = None
    vehicles: tuple[tuple[VehicleEstimate, VehicleUncertainty | None], ...] = ()
    constancy: Constancy | None = None

    @property
    def impossible(self) -> VehicleEstimate | None:
        """A vehicle that fits best and cannot be."""
        every = (self.vehicle, *(vehicle for vehicle, _ in self.vehicles))
        return next((one for one in every if one is not None and not one.possible), None)


def read_place(prepared: Prepared, place: Place, readout: Readout) -> Reading:
    """The parameters at the modes; standard errors of refined modes with the ``rms`` readout.

    Bias that is known to first order is corrected where the readout says so, but for a length scale
    that the grid dictates: it is no minimum that errors could have moved.
    """
    if place.ladder is not None:
        reading = _of_ladder(prepared, place, place.ladder, readout)
        if reading is not None:
            return reading
    if place.grid is not None:
        return _on_grid(prepared, place, place.grid)
    sought = readout.refine != "none" and readout.mean_velocity == "rms"
    assessed = sought and place.fit is not None
    if assessed:
        correct = readout.correction != "none" and not prepared.narrow
        known = _assessment(prepared, place, correct)
        if known is not None:
            pairs = zip(known.modes, place.candidates, strict=True)
            scales = [ScaleEstimate(*m.values, own, m.uncertainty) for m, own in pairs]
            beside = known.vehicle, known.vehicle_uncertainty
            reading = Reading(_sorted(scales), *beside, True, known.goodness)
            return replace(reading, vehicles=known.vehicles, constancy=known.constancy)
    goodness = None
    if readout.refine != "none" and not assessed and place.fit is not None:
        known = _assessment(prepared, place, False)  # of the same fit: how well it explains
        goodness = known.goodness if known else None
    if readout.scales == "several":
        return replace(_several(prepared, place, readout, assessed), goodness=goodness)
    vehicles: list[VehicleEstimate] = []
    if prepared.library.unknown:
        fit = place.fit or project(Cells(), prepared.rows, place.wavenumbers[:, None])
        vehicles = vehicles_of(prepared.parts, fit.coefficients)
    speed = _mean_velocity(prepared, place, readout, vehicles)
    scale = _scale(speed, place.length_scales[0], place.candidates[0])
    reading = Reading((scale,), assessed=assessed, goodness=goodness)
    return _beside(reading, vehicles)


def _beside(reading: Reading, vehicles: Sequence[VehicleEstimate]) -> Reading:
    """A reading with the vehicles that were estimated, how sure they are not told."""
    if len(vehicles) == 1:
        return replace(reading, vehicle=vehicles[0])
    return replace(reading, vehicles=tuple((vehicle, None) for vehicle in vehicles))


def _of_ladder(
    prepared: Prepared, place: Place, ladder: Ladder, readout: Readout
) -> Reading | None:
    """The flow of the best rung; None where cells that were located are believed instead.

    That is where waves that make no cells leave turbulence: they may follow nothing else.
    """
    best, nuisance = ladder.best, common(prepared.nuisances)
    if not len(best.phases):
        return Reading((NOTHING,), assessed=True)
    correct = readout.correction != "none"

    def assessed() -> Assessment | None:
        rows, family, fit = ladder.rows, best.family, best.fit
        return assess_flights(prepared.parts, rows, family, fit, correct=correct)

    origin = prepared.origin
    flow = flow_of(best, origin, nuisance.ratio(best.fit.coefficients))
    key = ("shape", tuple(best.phases.ravel().tolist()), best.shape, correct)
    known = prepared.once(key, assessed)
    cells = best.of_cells or ladder.steady_cells
    if prepared.library.family != "waves" and (known is None or not (cells or known.white)):
        return None
    if known is None:
        plainly = _plain(prepared, place, flow, drifting=best.drifting)
        return replace(plainly, shaped=_shaped(plainly, ladder), assessed=True)
    all_of_it = with_wind(flow, nuisance.read(best.fit.coefficients))
    first = known.shapes[0] if known.shapes else None
    sure = known.flow and replace(known.flow, origin=origin)
    shaped = Shaped(best.shape, first, best.drifting, rungs_of(ladder), all_of_it, sure)
    own = place.candidates[0]
    headings = [cells.heading for cells in known.shapes] or [math.nan]
    scales = tuple(
        ScaleEstimate(*mode.values, own, mode.uncertainty, heading)
        for mode, heading in zip(known.modes, headings, strict=True)
    )
    beside = known.vehicle, known.vehicle_uncertainty
    reading = Reading(scales, *beside, True, known.goodness, shaped)
    return replace(reading, vehicles=known.vehicles, constancy=known.constancy)


def _shaped(plainly: Reading, ladder: Ladder) -> Shaped | None:
    """What was read without standard errors, as what the ladder says."""
    best, rungs = ladder.best, rungs_of(ladder)
    shaped = plainly.shaped
    return shaped and replace(shaped, name=best.shape, drifting=best.drifting, rungs=rungs)


def _on_grid(prepared: Prepared, place: Place, grid: WaveFlow) -> Reading:
    """Waves on the grid: U0 of their peaks, and the sum of all as the flow."""
    assert place.fit is not None
    ratio = common(prepared.nuisances).ratio(place.fit.coefficients)
    flow = WaveFlow(grid.wavevectors, grid.cosine / ratio, grid.sine / ratio)
    peaks = place.fit.weights[..., 0] / ratio
    return _plain(prepared, place, flow, WaveFlow(place.fit.parameters, *peaks.T))


def _plain(
    prepared: Prepared,
    place: Place,
    flow: WaveFlow,
    read: WaveFlow | None = None,
    *,
    drifting: bool = False,
) -> Reading:
    """A flow of waves without standard errors; read: the waves that are read, else its own."""
    assert place.fit is not None
    own = read or flow
    moving = np.zeros(len(own.cosine)) if own.frequencies is None else own.frequencies
    phases = np.column_stack([own.wavevectors, moving])
    amplitudes = np.column_stack([own.cosine, own.sine])
    speed, scale, timescale, *cells = values_of(phases, amplitudes, drifting=drifting).tolist()
    coefficients = place.fit.coefficients
    vehicle = common(prepared.nuisances).read(coefficients)
    shape = Shape.of(np.array(cells)) if cells else None
    shaped = Shaped("", shape, drifting, flow=with_wind(flow, vehicle))
    scales = (ScaleEstimate(speed, scale, timescale, place.candidates[0]),)
    reading = Reading(scales, shaped=shaped)
    if not prepared.library.unknown:
        return reading
    return _beside(reading, vehicles_of(prepared.parts, coefficients))


def _sorted(scales: list[ScaleEstimate]) -> tuple[ScaleEstimate, ...]:
    return tuple(sorted(scales, key=lambda scale: -scale.mean_velocity))


def _scale(speed: float, length_scale: float, candidate: float) -> ScaleEstimate:
    timescale = length_scale / speed if speed else math.nan
    return ScaleEstimate(speed, length_scale, timescale, candidate)


def _mean_velocity(
    prepared: Prepared, place: Place, readout: Readout, vehicles: Sequence[VehicleEstimate]
) -> float:
    """U0 of the one mode at its place, by the vehicles that fit it best where these are unknown."""
    samples, phi, target = prepared.samples, prepared.flow_velocity, prepared.target
    if vehicles:
        if not all(vehicle.possible for vehicle in vehicles):
            return math.nan
        each = [
            vehicle.flow_velocity(own.velocity, own.acceleration, own.thrust)
            for vehicle, own in zip(
                vehicles, (part.samples for part in prepared.parts), strict=True
            )
        ]
        phi = target = np.concatenate(each)
    plain = not vehicles and not prepared.weak and prepared.parts[0].fading is None
    if plain or readout.mean_velocity == "paper":
        return readout.velocity(samples.position, phi, target, place.length_scales[0])
    fit = place.fit or project(Cells(), prepared.rows, place.wavenumbers[:, None])
    return mean_velocity_of(_true_weights(prepared, fit)[0], readout.mean_velocity)


def _true_weights(prepared: Prepared, fit: Projection) -> np.ndarray:
    """Weights (s, 8, 2) in units of the true Phi, where that of the believed vehicle is scaled."""
    return fit.weights / common(prepared.nuisances).ratio(fit.coefficients)


def _assessment(prepared: Prepared, place: Place, correct: bool) -> Assessment | None:
    def assessed() -> Assessment | None:
        fit = place.fit
        assert fit is not None
        return assess_flights(prepared.parts, prepared.rows, Cells(), fit, correct=correct)

    key = ("assessed", tuple(place.wavenumbers.tolist()), correct)
    return prepared.once(key, assessed)


def _several(prepared: Prepared, place: Place, readout: Readout, assessed: bool) -> Reading:
    assert place.fit is not None
    speeds = [
        mean_velocity_of(weights, readout.mean_velocity)
        for weights in _true_weights(prepared, place.fit)
    ]
    scales = [
        ScaleEstimate(speed, scale, scale / speed if speed > 0 else math.nan, candidate)
        for speed, scale, candidate in zip(
            speeds, place.length_scales, place.candidates, strict=True
        )
    ]
    reading = Reading(_sorted(scales), assessed=assessed)
    if not prepared.library.unknown:
        return reading
    return _beside(reading, vehicles_of(prepared.parts, place.fit.coefficients))
