"""From a flight to U0, L_w and tau_w: derivative, library, back-end and readout in one record."""

import math
from dataclasses import dataclass, fields, replace
from time import perf_counter
from typing import Any, Literal

import numpy as np

from sparsefit import backends
from sparsefit.derivative import Derivative
from sparsefit.errors import InputError, number_setting
from sparsefit.estimator import saved
from sparsefit.estimator.estimate import Estimate
from sparsefit.estimator.prepared import Prepared
from sparsefit.estimator.scales import ScaleEstimate, as_proposed, several
from sparsefit.estimator.verdict import why_not
from sparsefit.flight import Flight
from sparsefit.library.builder import Library
from sparsefit.library.nuisance import VehicleEstimate
from sparsefit.modes.readout import Readout
from sparsefit.modes.rows import Rows
from sparsefit.regression.backend import Backend, settings_of
from sparsefit.regression.fit import TOLERANCE, Fit, fit
from sparsefit.uncertainty import Assessment, Uncertainty


@dataclass(frozen=True)
class Estimator:
    """A complete choice: how derivatives are taken, the library, the back-end and the readout.

    ``derivative`` and ``backend`` also take a name, with default settings.
    """

    derivative: Derivative | str = Derivative()
    library: Library = Library()
    backend: Backend | str = "group-lasso"
    readout: Readout = Readout()
    tolerance: float = TOLERANCE

    def __post_init__(self) -> None:
        if isinstance(self.derivative, str):
            object.__setattr__(self, "derivative", Derivative(self.derivative))
        if isinstance(self.backend, str):
            object.__setattr__(self, "backend", backends.get(self.backend))
        for name, kind in (
            ("derivative", Derivative),
            ("library", Library),
            ("backend", Backend),
            ("readout", Readout),
        ):
            if not isinstance(getattr(self, name), kind):
                raise InputError(
                    f"estimator: {name} must be a {kind.__name__}, not {getattr(self, name)!r}"
                )
        number_setting("estimator", "tolerance", self.tolerance, low=0.0)
        if self.readout.scales == "several" and (self._weak or self.library.unknown):
            raise InputError(
                'estimator: scales "several" needs a known vehicle and samples of Phi; drop '
                'the library\'s unknown and the derivative "weak"'
            )

    @property
    def _weak(self) -> bool:
        return isinstance(self.derivative, Derivative) and self.derivative.method == "weak"

    def estimate(self, flight: Flight) -> Estimate:
        """Estimate the flow's parameters from a flight.

        Raises InputError where the flight does not suit the settings (too few samples for the
        derivative, say); a flight that cannot tell the parameters has status ``unidentifiable``.
        """
        prepared = self.prepare(flight)
        return self.read(prepared, self.fit(prepared))

    def prepare(self, flight: Flight) -> Prepared:
        """Derivatives, flow velocity and regression problem of a flight."""
        start = perf_counter()
        assert isinstance(self.derivative, Derivative)
        samples = self.derivative(flight)
        problem = self.library.build(samples, flight.vehicle)
        phi = samples.flow_velocity(flight.vehicle)
        target = self.library.response(samples, flight.vehicle)
        _ = problem.statistics  # here, not in whichever back-end happens to come first
        rows = Rows.of(samples, flight.vehicle, self.library.unknown)
        seconds = perf_counter() - start
        return Prepared(samples, phi, target, problem, seconds, rows, flight.vehicle)

    def fit(self, prepared: Prepared) -> Fit:
        """The certified fit of this estimator's back-end."""
        assert not isinstance(self.backend, str)
        return fit(prepared.problem, self.backend, tolerance=self.tolerance)

    def read(self, prepared: Prepared, found: Fit) -> Estimate:
        """Parameters from a fit (Eqs. 21-25)."""
        start = perf_counter()
        scales = found.problem.group_scales
        assert scales is not None
        if not np.isfinite(found.weights).all():
            place, by_scale = _Place(status=found.status, reason=found.reason), {}
        else:
            weights = self.readout.scale_weights(found.problem, found.weights)
            by_scale = dict(zip(scales.tolist(), weights.tolist(), strict=True))
            place = self._place(prepared, found, float(scales[int(np.argmax(weights))]))
        mean_velocity, known = math.nan, place.assessment
        if math.isfinite(place.length_scale):
            if known is not None:
                mean_velocity = known.mean_velocity
            elif place.scales:
                mean_velocity = place.scales[0].mean_velocity
            else:
                place, mean_velocity = self._velocity(prepared, place)
            if place.possible and not 0 < mean_velocity < math.inf:
                words = f"readout {self.readout.mean_velocity!r} gave {mean_velocity:g}"
                place = replace(place, status="unidentifiable", reason=f"no mean velocity: {words}")
        return Estimate(
            mean_velocity,
            place.length_scale,
            place.length_scale / mean_velocity if mean_velocity else math.nan,
            place.status,
            place.reason,
            found.backend.name,
            settings_of(found.backend),
            found.certificate,
            place.grid_length_scale,
            by_scale,
            prepared.seconds + found.seconds + perf_counter() - start,
            found.problem.samples,
            found.problem.columns,
            place.rival_length_scale,
            place.uncertainty,
            scales=place.scales,
            vehicle_uncertainty=known.vehicle_uncertainty if known else None,
            **place.unknown,
        )

    def _velocity(self, prepared: Prepared, place: "_Place") -> tuple["_Place", float]:
        """U0 at the length scale, by the vehicle that fits it best where it is unknown."""
        phi, target, rows = prepared.flow_velocity, prepared.target, prepared.rows
        if rows is not None and self.library.unknown:
            place = replace(place, vehicle=rows.vehicle(place.length_scale))
            vehicle, samples = place.vehicle, prepared.samples
            assert vehicle is not None
            if not vehicle.possible:
                words = f"the response time that fits best is {vehicle.response_time:.3g} s"
                reason = f"{words}; fly longer, or give the response time"
                return replace(place, status="unidentifiable", reason=reason), math.nan
            phi = target = vehicle.flow_velocity(samples.velocity, samples.acceleration)
        return place, self.readout.velocity(
            prepared.samples.position, phi, target, place.length_scale, rows
        )

    def _place(self, prepared: Prepared, found: Fit, candidate: float) -> "_Place":
        """The length scale from the chosen candidate, refined where the readout says so."""
        grid = self.library.grid
        if not found.weights.any():
            return _Place(status="unidentifiable", reason="no length scale: all weights are zero")
        if self.readout.scales == "several":
            return self._several(prepared, found)
        if self.readout.refine == "none" or not grid.lower < grid.upper:
            return _Place(candidate, candidate, status=found.status, reason=found.reason)
        best = prepared.refined(candidate, grid)
        known, scale = None, best.length_scale
        if self.readout.mean_velocity == "rms":
            known = prepared.assessed(best.wavenumber, self.readout.correction != "none")
            scale = known.length_scale if known else scale
        status, reason = found.status, found.reason
        doubt = why_not(best, known, prepared.samples, grid.lower, calm=prepared.calm)
        if doubt:
            status, reason = "unidentifiable", doubt
        vehicle = known.vehicle if known else None
        return _Place(scale, candidate, best.rival_length_scale, status, reason, known, vehicle)

    def _several(self, prepared: Prepared, found: Fit) -> "_Place":
        """All scales of a fit; the place is that of the fastest."""
        grid, on_grid = self.library.grid, found.problem is prepared.problem
        velocity: Literal["rms", "peak"] = "rms"
        if self.readout.mean_velocity == "peak":
            velocity = "peak"
        phi, refined = prepared.flow_velocity, self.readout.refine != "none"
        if refined and grid.lower < grid.upper:
            lobes, correlation = prepared.lobes(grid), prepared._correlation
            chosen = several(
                found, phi, lobes, on_grid=on_grid, velocity=velocity, correlation=correlation
            )
        else:
            position = prepared.samples.position
            chosen = as_proposed(found, position, phi, on_grid=on_grid, velocity=velocity)
        reason = chosen.reason
        if refined and self.readout.mean_velocity == "rms":
            chosen = chosen.assessed(prepared.scales_assessed)
            reason = reason or chosen.untold
        first = chosen.scales[0]
        if refined and prepared.calm:
            reason = "no cellular flow detected: the air is still"
        status = "unidentifiable" if reason else found.status
        return _Place(
            first.length_scale,
            first.grid_length_scale,
            chosen.rival_length_scale,
            status,
            reason or found.reason,
            scales=chosen.scales,
        )

    def to_json(self) -> str:
        """The estimator as JSON text, which ``from_json`` reads back."""
        return saved.text_of({item.name: getattr(self, item.name) for item in fields(self)})

    @classmethod
    def from_json(cls, text: str) -> "Estimator":
        """Read an estimator written by ``to_json``. Raises InputError on anything else."""
        return cls(**saved.parts_of(saved.record_of(text)))


@dataclass(frozen=True)
class _Place:
    """Where the length scale is, and how sure that is."""

    length_scale: float = math.nan
    grid_length_scale: float = math.nan
    rival_length_scale: float = math.nan
    status: str = "ok"
    reason: str = ""
    assessment: Assessment | None = None
    vehicle: VehicleEstimate | None = None
    scales: tuple[ScaleEstimate, ...] = ()

    @property
    def uncertainty(self) -> Uncertainty | None:
        """Of the scale, or of the first of several."""
        if self.scales:
            return self.scales[0].uncertainty
        return self.assessment.uncertainty if self.assessment else None

    @property
    def possible(self) -> bool:
        """Whether there is no vehicle that cannot be."""
        return self.vehicle is None or self.vehicle.possible

    @property
    def unknown(self) -> dict[str, Any]:
        """The estimates of what was unknown, by name."""
        if self.vehicle is None:
            return {}
        return {name: getattr(self.vehicle, name) for name in self.vehicle.unknown}
