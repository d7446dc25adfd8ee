"""From a flight to U0, L_w and tau_w: derivative, library, back-end and readout in one record."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from time import perf_counter
from typing import TYPE_CHECKING, Any, Literal, cast

import numpy as np

from sparsefit import backends
from sparsefit.errors import InputError, number_setting, one_of
from sparsefit.estimator import saved
from sparsefit.estimator.doubt import Doubt, Verdict
from sparsefit.estimator.estimate import Estimate, ScaleEstimate
from sparsefit.flight import Flight
from sparsefit.model import Library, Readout
from sparsefit.regression.backend import Backend, settings_of
from sparsefit.regression.fit import TOLERANCE, Fit, fit
from sparsefit.rows import Derivative

if TYPE_CHECKING:
    from sparsefit.estimator.prepare import Prepared


@dataclass(frozen=True)
class Estimator:
    """A complete choice: how derivatives are taken, the library, the back-end and the readout.

    ``derivative`` and ``backend`` also take a name, with default settings. ``free`` names what is
    estimated beside the flow where it is measured (`sparsefit.likelihood.causes.FREEDOMS`), beside
    what the library says is unknown of the vehicle; ``"auto"`` frees whatever explains a misfit.
    """

    derivative: Derivative | str = Derivative()
    library: Library = Library()
    backend: Backend | str = "group-lasso"
    readout: Readout = Readout()
    tolerance: float = TOLERANCE
    free: tuple[str, ...] | Literal["auto"] = ()

    def __post_init__(self) -> None:
        """Check every part, and build those that are given by name."""
        if isinstance(self.derivative, str):
            object.__setattr__(self, "derivative", Derivative(self.derivative))
        object.__setattr__(self, "backend", backends.named(self.backend))
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
        if self.free != "auto":
            if isinstance(self.free, str) or not isinstance(self.free, Sequence):
                raise InputError(f'estimator: free must be "auto" or names, not {self.free!r}')
            from sparsefit.likelihood.causes import FREEDOMS

            for name in self.free:
                one_of("estimator free", name, FREEDOMS)
            object.__setattr__(self, "free", tuple(self.free))

    def estimate(self, flights: Flight | Sequence[Flight]) -> Estimate:
        """Estimate the flow's parameters from a flight, or from several through the same flow.

        Several flights have one flow, one frame and one clock; each has a vehicle and noise of its
        own, any length and any sample rate. Raises InputError where a flight does not suit the
        settings (too few samples for the derivative, say); flights that cannot tell the parameters
        have status ``unidentifiable``, those through another flow than was fitted ``misfit``.
        """
        from sparsefit.estimator.prepare import prepare, together

        assert isinstance(self.derivative, Derivative)
        prepared = prepare(together(flights), self.derivative, self.library, shared=False)
        return self.read(prepared, self.fit(prepared))

    def prepare(self, flights: Flight | Sequence[Flight]) -> Prepared:
        """Derivatives, flow velocity and regression problem of a flight, or of several."""
        from sparsefit.estimator.prepare import prepare, together

        assert isinstance(self.derivative, Derivative)
        return prepare(together(flights), self.derivative, self.library)

    def fit(self, prepared: Prepared) -> Fit:
        """The certified fit of this estimator's back-end."""
        assert not isinstance(self.backend, str)
        return fit(prepared.problem, self.backend, tolerance=self.tolerance)

    def read(self, prepared: Prepared, fit: Fit) -> Estimate:
        """Parameters from a fit (Eqs. 21-25): read on the grid, or located, measured and judged."""
        own = getattr(prepared, "read", None)  # rows of a stream are read by what made them
        if own is not None:
            return cast(Estimate, own(self, fit))
        start = perf_counter()
        parts: dict[str, Any] = {"mean_velocity": math.nan, "length_scale": math.nan}
        verdict = Verdict(fit.status, fit.reason)
        if np.isfinite(fit.weights).all():
            parts["weights_by_scale"] = self.readout.by_scale(fit, self.library)
            if not fit.weights.any():
                words = "no length scale: all weights are zero"
                verdict = Verdict.against(Doubt.NO_WEIGHTS, words)
            elif self.readout.refine == "none" or prepared.narrow:
                verdict = self._on_grid(prepared, fit, parts) or verdict
            else:
                verdict = self._off_grid(prepared, fit, parts) or verdict
            if fit.weights.any() and "grid_length_scale" not in parts:
                by_scale = parts["weights_by_scale"]
                parts["grid_length_scale"] = max(by_scale, key=lambda scale: by_scale[scale])
        speed, scale = parts["mean_velocity"], parts["length_scale"]
        parts.setdefault("timescale", scale / speed if speed else math.nan)
        if len(prepared.flights) == 1:
            parts["repairs"] = prepared.parts[0].repairs
        parts |= {"status": verdict.status, "reason": verdict.reason, "doubt": verdict.doubt}
        parts |= {"backend": fit.backend.name, "settings": settings_of(fit.backend)}
        cells = self.library.family == "cells"
        parts["samples"] = fit.problem.samples if cells else len(prepared.samples.time)
        parts["columns"], parts["certificate"] = fit.problem.columns, fit.certificate
        parts["seconds"] = prepared.seconds + fit.seconds + perf_counter() - start
        return Estimate(**parts)

    def _on_grid(self, prepared: Prepared, fit: Fit, parts: dict[str, Any]) -> Verdict | None:
        """The parameters of the modes on the grid, into `parts`."""
        from sparsefit.estimator.reported import of_vehicle
        from sparsefit.model import read_grid

        reading = read_grid(
            fit, prepared.parts, prepared.vehicles, self.library, self.readout, prepared.weights
        )
        scales = [
            ScaleEstimate(
                scale.mean_velocity,
                scale.length_scale,
                scale.length_scale / scale.mean_velocity if scale.mean_velocity else math.nan,
                scale.length_scale,
                heading=scale.heading,
            )
            for scale in reading.scales
        ]
        parts |= {name: getattr(scales[0], name) for name in ("mean_velocity", "length_scale")}
        parts |= {"flow": reading.flow, "heading": scales[0].heading}
        if self.readout.scales == "several":
            parts["scales"] = tuple(scales)
        if any(vehicle is None for vehicle, _ in reading.vehicles):
            words = "the vehicle that fits best cannot be"
            return Verdict.against(Doubt.VEHICLE, f"{words}; fly longer, or give the response time")
        if len(reading.vehicles) == 1:
            vehicle, wind = reading.vehicles[0]
            assert vehicle is not None
            parts |= of_vehicle(vehicle, wind, self.library.unknown)
        if not 0 < scales[0].mean_velocity < math.inf:
            words = f"readout {self.readout.mean_velocity!r} gave {scales[0].mean_velocity:g}"
            return Verdict.against(Doubt.MEAN_VELOCITY, f"no mean velocity: {words}")
        return None

    def _off_grid(self, prepared: Prepared, fit: Fit, parts: dict[str, Any]) -> Verdict | None:
        """The parameters at the maximum of the likelihood, into `parts`."""
        from sparsefit.estimator.judge import Case, judge, refused
        from sparsefit.estimator.measure import measure_flow
        from sparsefit.estimator.reported import of_measured, scales_of

        search = prepared.search
        early = refused(prepared)
        if early is not None:
            return early
        start = self.readout.start(search, fit, self.library)
        shapes = self.readout.refine == "ladder" or self.library.family == "waves"

        proposals = prepared.once(start, lambda: search.propose(start))
        # Starts that end in the same lobes share one measurement, which is most of an estimate.
        lobes = (own.lobe(search.lookout.extent) for own in proposals)
        result = prepared.once(
            (*lobes, self.free, shapes),
            lambda: measure_flow(prepared, proposals, self.free, shapes=shapes),
        )
        used = [scale for scale, own in parts["weights_by_scale"].items() if own]
        scales = scales_of(result, used) if result else ()
        if result is not None:
            parts |= of_measured(prepared, result, scales, several=self.readout.scales == "several")
        if self.readout.mean_velocity == "paper" and scales:
            from sparsefit.model import read_grid

            grid = read_grid(
                fit, prepared.parts, prepared.vehicles, self.library, self.readout, prepared.weights
            )
            parts |= {"mean_velocity": grid.scales[0].mean_velocity, "uncertainty": None}
        return judge(Case(prepared, result, scales, self.readout.precision, self.free))

    def to_json(self) -> str:
        """The estimator as JSON text, which ``from_json`` reads back."""
        return saved.text_of({item.name: getattr(self, item.name) for item in fields(self)})

    @classmethod
    def from_json(cls, text: str) -> Estimator:
        """Read an estimator written by ``to_json``. Raises InputError on anything else."""
        return cls(**saved.parts_of(saved.record_of(text)))
