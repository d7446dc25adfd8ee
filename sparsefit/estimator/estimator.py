"""From a flight to U0, L_w and tau_w: derivative, library, back-end and readout in one record."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cache
from importlib import import_module
from time import perf_counter
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from threadpoolctl import ThreadpoolController

from sparsefit import backends
from sparsefit.errors import InputError, number_setting, one_of, shown
from sparsefit.estimator import saved
from sparsefit.estimator.estimate import Doubt, Estimate, ScaleEstimate, Verdict
from sparsefit.flight import Flight
from sparsefit.model import Library, Readout
from sparsefit.regression.backend import Backend
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
        for name, kind in (saved.RECORDS | {"backend": Backend}).items():
            if not isinstance(getattr(self, name), kind):
                raise InputError(
                    f"estimator: {name} must be a {kind.__name__}, not {shown(getattr(self, name))}"
                )
        number_setting("estimator", "tolerance", self.tolerance, low=0.0)
        on_grid = self.readout.refine == "none" or self.readout.mean_velocity == "paper"
        if self.library.unknown and on_grid:
            raise InputError(
                f"estimator: unknown {self.library.unknown[0]!r} is measured off the grid alone: "
                "set readout refine 'variable-projection' and mean_velocity 'rms'"
            )
        if self.free in (["auto"], ("auto",)):
            object.__setattr__(self, "free", "auto")
        if self.free != "auto":
            if isinstance(self.free, str) or not isinstance(self.free, Sequence):
                raise InputError(f'estimator: free must be "auto" or names, not {shown(self.free)}')
            from sparsefit.likelihood.causes import FREEDOMS

            for name in self.free:
                one_of("cause to free", name, FREEDOMS)
            object.__setattr__(self, "free", tuple(self.free))

    def estimate(self, flights: Flight | Sequence[Flight]) -> Estimate:
        """Estimate the flow's parameters from a flight, or from several through the same flow.

        Several flights have one flow, one frame and one clock; each has a vehicle and noise of its
        own, any length and any sample rate. Raises InputError where a flight does not suit the
        settings (too few samples for the derivative, say); flights that cannot tell the parameters
        have status ``unidentifiable``, those through another flow than was fitted ``misfit``. The
        linear algebra runs on one thread: its matrices are too small for more.
        """
        with _blas().limit(limits=1):
            prepared = self.prepare(flights, shared=False)
            return self.read(prepared, self.fit(prepared))

    def prepare(self, flights: Flight | Sequence[Flight], *, shared: bool = True) -> Prepared:
        """Derivatives, flow velocity and regression problem of a flight, or of several.

        shared: whether several back-ends will use it, so that common work belongs here.
        """
        from sparsefit.estimator.prepare import prepare

        assert isinstance(self.derivative, Derivative)
        return prepare(flights, self.derivative, self.library, shared=shared)

    def fit(self, prepared: Prepared) -> Fit:
        """The certified fit of this estimator's back-end."""
        assert not isinstance(self.backend, str)
        return fit(prepared.problem, self.backend, tolerance=self.tolerance)

    def read(self, prepared: Prepared, fit: Fit) -> Estimate:
        """Parameters from a fit (Eqs. 21-25): read on the grid, or located, measured and judged."""
        start = perf_counter()
        by_scale: dict[float, float] = {}
        parts: dict[str, Any] = dict.fromkeys(("mean_velocity", "length_scale"), math.nan)
        verdict: Verdict | None = None
        if np.isfinite(fit.weights).all():
            by_scale = self.readout.by_scale(fit, self.library)
            if not fit.weights.any():
                words = "no length scale: all weights are zero"
                verdict = Verdict("unidentifiable", words, Doubt.NO_WEIGHTS)
            else:
                parts["grid_length_scale"] = max(by_scale, key=lambda own: by_scale[own])
                used = [own for own, weight in by_scale.items() if weight]
                if self.readout.refine == "none":
                    more, verdict = self._on_grid(prepared, fit)
                else:
                    more, verdict = self._off_grid(prepared, fit, used)
                parts |= more
        verdict = verdict or Verdict(fit.status, fit.reason)
        speed, scale = parts["mean_velocity"], parts["length_scale"]
        parts.setdefault("timescale", scale / speed if speed else math.nan)
        if len(prepared.flights) == 1:
            parts["repairs"] = prepared.parts[0].repairs
        cells = self.library.family == "cells"
        return Estimate(
            **parts,
            **vars(verdict),
            weights_by_scale=by_scale,
            backend=fit.backend.name,
            settings=fit.settings,
            samples=fit.problem.samples if cells else sum(len(own.time) for own in prepared.parts),
            columns=fit.problem.columns,
            certificate=fit.certificate,
            seconds=prepared.seconds + fit.seconds + perf_counter() - start,
        )

    def _on_grid(self, prepared: Prepared, fit: Fit) -> tuple[dict[str, Any], Verdict | None]:
        """Fields of the estimate from the modes on the grid, and what speaks against them."""
        from sparsefit.model import read_grid

        settings = (self.library, self.readout, prepared.weights, prepared.once)
        read, flow = read_grid(fit, prepared.parts, prepared.vehicles, *settings)
        scales = []
        for own in read:
            speed, scale = own.mean_velocity, own.length_scale
            timescale = scale / speed if speed else math.nan
            scales.append(ScaleEstimate(speed, scale, timescale, scale, heading=own.heading))
        speed, parts = read[0].mean_velocity, dict[str, Any](flow=flow, heading=read[0].heading)
        parts |= {"mean_velocity": speed, "length_scale": read[0].length_scale}
        parts |= {"scales": tuple(scales)} if self.readout.scales == "several" else {}
        if 0 < speed < math.inf:
            return parts, None
        words = f"no mean velocity: readout {self.readout.mean_velocity!r} gave {speed:g}"
        return parts, Verdict("unidentifiable", words, Doubt.MEAN_VELOCITY)

    def _off_grid(
        self, prepared: Prepared, fit: Fit, used: Sequence[float]
    ) -> tuple[dict[str, Any], Verdict | None]:
        """Fields at the maximum of the likelihood, and what speaks against them.

        used: the candidate length scales [m] of weights above zero.
        """
        from sparsefit.estimator.judge import doubts_of_flow, doubts_of_logs
        from sparsefit.estimator.measure import measure_flow
        from sparsefit.model import propose

        several, precision = self.readout.scales == "several", self.readout.precision
        parts = dict[str, Any]()
        early = prepared.once(
            ("logs", self.free), lambda: next(doubts_of_logs(prepared, self.free), None)
        )
        if early is None or early.doubt is Doubt.STILL_AIR:
            search = prepared.search  # which refuses flights that do not move
        if early is not None:
            return parts, early
        start = self.readout.start(search, fit, self.library)
        shapes = self.readout.refine == "ladder" or self.library.family == "waves"
        proposals = prepared.once(start, lambda: propose(search, start))
        # Starts that end in the same lobes share one measurement, which is most of an estimate.
        lobes = (own.lobe(search.extent) for own in proposals)
        result = prepared.once(
            (*lobes, self.free, shapes),
            lambda: measure_flow(prepared, proposals, self.free, shapes=shapes),
        )
        scales = result.scales(used) if result else ()
        if result is not None:
            parts = result.fields(prepared, scales, several=several)
        if self.readout.mean_velocity == "paper" and scales:
            on_grid, _ = self._on_grid(prepared, fit)
            parts |= {"mean_velocity": on_grid["mean_velocity"], "uncertainty": None}
            del parts["timescale"]
        return parts, next(doubts_of_flow(prepared, result, scales, precision, self.free), None)

    def to_json(self) -> str:
        """The estimator as JSON text, which ``from_json`` reads back."""
        return saved.text_of({item.name: getattr(self, item.name) for item in fields(self)})

    @classmethod
    def from_json(cls, text: str) -> Estimator:
        """Read an estimator written by ``to_json``. Raises InputError on anything else."""
        return cls(**saved.parts_of(saved.record_of(text)))


@cache
def _blas() -> ThreadpoolController:
    """Thread pools of the linear algebra of NumPy and SciPy, whose own is loaded here."""
    import_module("scipy.linalg")
    return ThreadpoolController().select(user_api="blas")
