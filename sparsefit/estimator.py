"""From a flight to U0, L_w and tau_w: derivative, library, back-end and readout in one record."""

import json
import math
from dataclasses import asdict, dataclass, field, replace
from time import perf_counter
from typing import Any

import numpy as np

from sparsefit import backends
from sparsefit.backends.base import Backend, checked_number, settings_of
from sparsefit.derivative import Derivative, Samples
from sparsefit.errors import InputError, unknown
from sparsefit.fit import TOLERANCE, Fit, fit
from sparsefit.flight import Flight
from sparsefit.library import LengthScaleGrid, Library, RegressionProblem
from sparsefit.objective import Certificate
from sparsefit.readout import Readout
from sparsefit.refine import CORRELATION, Refinement, refine
from sparsefit.uncertainty import Assessment, Uncertainty, assess
from sparsefit.vehicle import PointMassVehicle
from sparsefit.verdict import why_not

CALM = 1e-6  # of the vehicle's speed: the smoothing's own error reaches 1e-9
FORMAT = "sparsefit-estimator/1"


@dataclass(frozen=True, eq=False)
class Prepared:
    """What every back-end shares on one flight: samples, Phi and the regression problem."""

    samples: Samples
    flow_velocity: np.ndarray
    target: np.ndarray  # a row per sample: the problem's own may be compressed
    problem: RegressionProblem
    seconds: float
    vehicle: PointMassVehicle | None = None
    _refined: dict[tuple[float, float, float], Refinement] = field(default_factory=dict, repr=False)
    _assessed: dict[tuple[float, bool], Assessment | None] = field(default_factory=dict, repr=False)

    @property
    def calm(self) -> bool:
        """Whether Phi is nothing beside the velocity it is the difference of: still air."""
        speed = float(np.abs(self.samples.velocity).max())
        return float(np.abs(self.flow_velocity).max()) <= CALM * speed

    @property
    def _correlation(self) -> float:
        """Samples over which the errors of Phi correlate: a polynomial's window per coefficient."""
        smoothing = self.samples.smoothing
        if smoothing is None:
            return CORRELATION
        return max(CORRELATION, smoothing.rate_window / (smoothing.order + 1))

    def refined(self, candidate: float, grid: LengthScaleGrid) -> Refinement:
        """The refinement from a candidate [m], done once for all back-ends that choose it."""
        key = (candidate, grid.lower, grid.upper)
        if key not in self._refined:
            self._refined[key] = refine(
                self.samples.position,
                self.flow_velocity,
                candidate,
                lower=grid.lower,
                upper=grid.upper,
                correlation=self._correlation,
            )
        return self._refined[key]

    def assessed(self, wavenumber: float, correct: bool) -> Assessment | None:
        """The assessment of a refined scale, k [1/m], done once; None for too few samples."""
        if self.vehicle is None:
            return None
        key = (wavenumber, correct)
        if key not in self._assessed:
            self._assessed[key] = assess(
                self.samples,
                self.flow_velocity,
                wavenumber,
                self.vehicle.response_time,
                correct=correct,
            )
        return self._assessed[key]


@dataclass(frozen=True)
class Estimate:
    """Estimated parameters, in m/s, m and s, NaN where there is none, and how they came about.

    status ``ok``, ``inaccurate``, ``unidentifiable`` or ``error``, with its reason;
    grid_length_scale: the chosen candidate [m]; weights_by_scale: its weight for each candidate
    length scale [m]; seconds: preparation, fit and readout together; rival_length_scale: where the
    refinement found the best other lobe of the residual [m]. uncertainty: of a refined scale with
    the ``rms`` mean velocity, `unidentifiable` or not: it holds within the lobe that was chosen,
    and says nothing of its rival; None with other readouts, and below 21 samples.
    """

    mean_velocity: float
    length_scale: float
    timescale: float
    status: str
    reason: str
    backend: str
    settings: dict[str, Any]
    certificate: Certificate | None = None
    grid_length_scale: float = math.nan
    weights_by_scale: dict[float, float] = field(default_factory=dict, repr=False)
    seconds: float = math.nan
    samples: int = 0
    columns: int = 0
    rival_length_scale: float = math.nan
    uncertainty: Uncertainty | None = None

    def to_dict(self) -> dict[str, Any]:
        """The estimate as JSON-ready values; NaN becomes None."""
        values = asdict(self)
        values["weights_by_scale"] = [[s, w] for s, w in self.weights_by_scale.items()]
        cleaned: dict[str, Any] = _without_nan(values)
        return cleaned


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
        checked_number("estimator", "tolerance", self.tolerance, low=0.0)

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
        seconds = perf_counter() - start
        return Prepared(samples, phi, target, problem, seconds, flight.vehicle)

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
        if known is not None:
            mean_velocity = known.mean_velocity
        elif math.isfinite(place.length_scale):
            mean_velocity = self.readout.velocity(
                prepared.samples.position,
                prepared.flow_velocity,
                prepared.target,
                place.length_scale,
            )
            if not (math.isfinite(mean_velocity) and mean_velocity > 0):
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
            known.uncertainty if known else None,
        )

    def _place(self, prepared: Prepared, found: Fit, candidate: float) -> "_Place":
        """The length scale from the chosen candidate, refined where the readout says so."""
        grid = self.library.grid
        if not found.weights.any():
            return _Place(status="unidentifiable", reason="no length scale: all weights are zero")
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
        return _Place(scale, candidate, best.rival_length_scale, status, reason, known)

    def to_json(self) -> str:
        """The estimator as JSON text, which ``from_json`` reads back."""
        record = {
            "format": FORMAT,
            "derivative": asdict(self.derivative),  # type: ignore[arg-type]
            "library": asdict(self.library),
            "backend": {"name": self.backend.name, **settings_of(self.backend)},  # type: ignore[union-attr]
            "readout": asdict(self.readout),
            "tolerance": self.tolerance,
        }
        return json.dumps(record, indent=2, allow_nan=False) + "\n"

    @classmethod
    def from_json(cls, text: str) -> "Estimator":
        """Read an estimator written by ``to_json``. Raises InputError on anything else."""
        try:
            record = json.loads(text)
        except json.JSONDecodeError as error:
            raise InputError(f"not an estimator: line {error.lineno}: {error.msg}") from None
        if not isinstance(record, dict) or record.get("format") != FORMAT:
            raise InputError(f'not an estimator: no "format": "{FORMAT}"; write one with to_json')
        parts = {k: v for k, v in record.items() if k != "format"}
        tolerance = parts.pop("tolerance", TOLERANCE)
        known = ("derivative", "library", "backend", "readout")
        for key, value in parts.items():
            if key not in known:
                raise unknown("key of the estimator", key, (*known, "tolerance"))
            if not isinstance(value, dict):
                raise InputError(f"estimator: {key} must be an object, not {value!r}")
        library = dict(parts.get("library", {}))
        backend = dict(parts.get("backend", {"name": "group-lasso"}))
        try:
            return cls(
                Derivative(**parts.get("derivative", {})),
                Library(**{**library, "grid": LengthScaleGrid(**library.get("grid", {}))}),
                backends.get(str(backend.pop("name", "")), **backend),
                Readout(**parts.get("readout", {})),
                tolerance,
            )
        except TypeError as error:  # an unexpected keyword, or a value of the wrong type
            raise InputError(f"estimator: {error}") from None


@dataclass(frozen=True)
class _Place:
    """Where the length scale is, and how sure that is."""

    length_scale: float = math.nan
    grid_length_scale: float = math.nan
    rival_length_scale: float = math.nan
    status: str = "ok"
    reason: str = ""
    assessment: Assessment | None = None


def _without_nan(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_nan(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_without_nan(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
