"""From a flight to U0, L_w and tau_w: derivative, library, back-end and readout in one record."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from time import perf_counter
from typing import TYPE_CHECKING, cast

import numpy as np

from sparsefit import backends
from sparsefit.derivative import Derivative
from sparsefit.errors import InputError, number_setting
from sparsefit.estimator import saved
from sparsefit.estimator.doubt import Doubt, Verdict
from sparsefit.estimator.estimate import Estimate
from sparsefit.flight import Flight
from sparsefit.library.builder import Library
from sparsefit.modes.readout import Readout
from sparsefit.regression.backend import Backend, settings_of
from sparsefit.regression.fit import TOLERANCE, Fit, fit

if TYPE_CHECKING:
    from sparsefit.estimator.assess import Reading
    from sparsefit.estimator.locate import Place
    from sparsefit.estimator.prepare import Prepared
    from sparsefit.flight.flow import FlowField


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

    def estimate(self, flights: Flight | Sequence[Flight]) -> Estimate:
        """Estimate the flow's parameters from a flight, or from several through the same flow.

        Several flights have one flow, one frame and one clock; each has a vehicle, unknowns and
        noise of its own, any length and any sample rate. Raises InputError where a flight does not
        suit the settings (too few samples for the derivative, say); flights that cannot tell the
        parameters have status ``unidentifiable``, those through another flow than was fitted
        ``misfit``.
        """
        from sparsefit.estimator.prepare import prepare, scaling, together
        from sparsefit.estimator.rounds import in_rounds, weighed_anew

        assert isinstance(self.derivative, Derivative)
        fleet = together(flights)
        if len(fleet) > 1 and scaling(self.library):
            return in_rounds(fleet, self.estimate, self._along)
        prepared = prepare(fleet, self.derivative, self.library, shared=False)
        estimate = self.read(prepared, self.fit(prepared))
        return estimate if len(fleet) == 1 else weighed_anew(fleet, estimate, self._along)

    def _along(self, fleet: Sequence[Flight], flow: FlowField) -> Estimate:
        """The estimate from flights through what is nearly a flow."""
        from sparsefit.estimator.prepare import prepare

        assert isinstance(self.derivative, Derivative)
        prepared = prepare(fleet, self.derivative, self.library, shared=False, flow=flow)
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
        """Parameters from a fit (Eqs. 21-25): locate the modes, assess them, judge them."""
        from sparsefit.estimator.assess import NOTHING, Reading, read_place
        from sparsefit.estimator.candidate_flow import flow_of
        from sparsefit.estimator.each_flight import told_of
        from sparsefit.estimator.locate import locate

        own = getattr(prepared, "read", None)  # rows of a stream are read by what made them
        if own is not None:
            return cast(Estimate, own(self, fit))
        start = perf_counter()
        problem = fit.problem
        by_scale: dict[float, float] = {}
        place, reading = None, Reading((NOTHING,))
        verdict = Verdict(fit.status, fit.reason)
        if np.isfinite(fit.weights).all():
            by_scale = self._by_scale(fit)
            if fit.weights.any():
                largest = max(by_scale, key=lambda scale: by_scale[scale])
                place = locate(prepared, fit, self.readout, largest)
                reading = read_place(prepared, place, self.readout)
                verdict = self._judged(prepared, place, reading, verdict)
            else:
                words = "no length scale: all weights are zero"
                verdict = Verdict.against(Doubt.NO_WEIGHTS, words)
        first, vehicle, shaped = reading.scales[0], reading.vehicle, reading.shaped
        other, several = place.other if place else math.nan, self.readout.scales == "several"
        found = place if place and len(place.wavenumbers) else None
        unknown = {name: getattr(vehicle, name) for name in vehicle.unknown} if vehicle else {}
        return Estimate(
            first.mean_velocity,
            first.length_scale,
            first.timescale,
            verdict.status,
            verdict.reason,
            fit.backend.name,
            settings_of(fit.backend),
            fit.certificate,
            first.grid_length_scale,
            by_scale,
            prepared.seconds + fit.seconds + perf_counter() - start,
            problem.samples if self.library.family == "cells" else len(prepared.target),
            problem.columns,
            math.pi / other,
            first.uncertainty,
            scales=reading.scales if place and (several or len(reading.scales) > 1) else (),
            vehicle_uncertainty=reading.vehicle_uncertainty,
            doubt=verdict.doubt,
            flow=shaped.flow if shaped else flow_of(prepared, fit, found) if found else None,
            repairs=prepared.samples.repairs,
            agreement=prepared.samples.agreement,
            goodness=reading.goodness,
            flights=told_of(prepared, reading),
            constancy=reading.constancy,
            **(shaped.fields if shaped else {}),
            **unknown,
        )

    def _judged(
        self, prepared: Prepared, place: Place, reading: Reading, verdict: Verdict
    ) -> Verdict:
        """The verdict of a fit, unless the flight gives a reason to doubt its modes."""
        from sparsefit.estimator.judge import imprecise, judge, judge_shape, rivalled

        first, wrong = reading.scales[0], reading.impossible
        if wrong is not None:
            words = f"the response time that fits best is {wrong.response_time:.3g} s"
            reason = f"{words}; fly longer, or give the response time"
            return Verdict.against(Doubt.VEHICLE, reason)
        flights, scales = [part.samples for part in prepared.parts], reading.scales
        precision = self.readout.precision if reading.assessed else None
        waves = reading.shaped is not None or self.library.family == "waves"
        if place.ladder is not None and waves and not place.ladder.steady_cells:
            doubts = judge_shape(
                place.ladder,
                reading,
                prepared.space,
                flights,
                self.readout.precision,
                prepared.library.unknown,
            )
            return doubts or verdict
        if not 0 < first.mean_velocity < math.inf:
            words = f"readout {self.readout.mean_velocity!r} gave {first.mean_velocity:g}"
            return Verdict.against(Doubt.MEAN_VELOCITY, f"no mean velocity: {words}")
        if place.located is not None:
            doubts = judge(
                place.located,
                scales,
                flights,
                reading.goodness,
                precision=precision,
                climbed=place.ladder is not None,
                unknown=prepared.library.unknown,
            )
            return doubts or (rivalled(place.ladder) if reading.shaped else None) or verdict
        return imprecise(scales, precision) or verdict

    def _by_scale(self, fit: Fit) -> dict[float, float]:
        """The weight of each length scale [m]."""
        if self.library.family == "waves":
            from sparsefit.estimator.waves import strengths_by_scale

            return strengths_by_scale(fit)
        assert fit.problem.group_scales is not None
        weights = self.readout.scale_weights(fit.problem, fit.weights).tolist()
        return dict(zip(fit.problem.group_scales.tolist(), weights, strict=True))

    def to_json(self) -> str:
        """The estimator as JSON text, which ``from_json`` reads back."""
        return saved.text_of({item.name: getattr(self, item.name) for item in fields(self)})

    @classmethod
    def from_json(cls, text: str) -> Estimator:
        """Read an estimator written by ``to_json``. Raises InputError on anything else."""
        return cls(**saved.parts_of(saved.record_of(text)))
