"""What every back-end shares on one flight, and what is worked out once for all of them."""

import math
from dataclasses import dataclass, field

import numpy as np

from sparsefit.derivative import Samples
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.library.grid import LengthScaleGrid
from sparsefit.modes.joint import Lobes
from sparsefit.modes.refine import CORRELATION, Refinement, centred, refine
from sparsefit.modes.rows import Rows
from sparsefit.regression.problem import RegressionProblem
from sparsefit.uncertainty import Assessment, Uncertainty, assess, assess_rows, assess_scales

CALM = 1e-6  # of the vehicle's speed: the smoothing's own error reaches 1e-9


@dataclass(frozen=True, eq=False)
class Prepared:
    """What every back-end shares on one flight: samples, Phi and the regression problem."""

    samples: Samples
    flow_velocity: np.ndarray
    target: np.ndarray  # a row per sample: the problem's own may be compressed
    problem: RegressionProblem
    seconds: float
    rows: Rows | None = None  # what is refined and read in place of plain samples of Phi
    vehicle: PointMassVehicle | None = None
    _refined: dict[tuple[float, float, float], Refinement] = field(default_factory=dict, repr=False)
    _lobes: dict[tuple[float, float], Lobes] = field(default_factory=dict, repr=False)
    _assessed: dict[tuple[float, bool], Assessment | None] = field(default_factory=dict, repr=False)

    @property
    def calm(self) -> bool:
        """Whether Phi is nothing beside the velocity it is the difference of: still air."""
        speed = float(np.abs(self.samples.velocity).max())
        phi = self.flow_velocity if self.rows is None else self.rows.remainder
        return float(np.abs(phi).max()) <= CALM * speed

    @property
    def _correlation(self) -> float:
        """Samples over which the errors of Phi correlate: a polynomial's window per coefficient."""
        smoothing = self.samples.smoothing
        if self.rows is not None and self.rows.correlation is not None:
            return self.rows.correlation
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
                rows=self.rows,
            )
        return self._refined[key]

    def lobes(self, grid: LengthScaleGrid) -> Lobes:
        """Where the residual of a scale more can have lobes, worked out once for all back-ends."""
        bounds = (math.pi / grid.upper, math.pi / grid.lower)
        if bounds not in self._lobes:
            self._lobes[bounds] = Lobes.of(centred(self.samples.position), bounds)
        return self._lobes[bounds]

    def assessed(self, wavenumber: float, correct: bool) -> Assessment | None:
        """The assessment of a refined scale, k [1/m], done once.

        None for too few samples. Where other rows than samples of Phi were fitted, nothing is
        corrected.
        """
        if self.vehicle is None:
            return None
        key = (wavenumber, correct)
        if key in self._assessed:
            return self._assessed[key]
        if self.rows is not None:
            self._assessed[key] = assess_rows(self.samples, self.rows, wavenumber)
        else:
            self._assessed[key] = assess(
                self.samples,
                self.flow_velocity,
                wavenumber,
                self.vehicle.response_time,
                correct=correct,
            )
        return self._assessed[key]

    def scales_assessed(self, length_scales: tuple[float, ...]) -> tuple[Uncertainty | None, ...]:
        """How sure each of several refined scales [m] is."""
        if self.vehicle is None:
            return (None,) * len(length_scales)
        k = math.pi / np.array(length_scales)
        tau = self.vehicle.response_time
        return assess_scales(self.samples, self.flow_velocity, k, tau)
