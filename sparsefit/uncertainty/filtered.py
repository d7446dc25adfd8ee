"""A fit together with the filters through which its rows see the flight.

An error of the acceleration is one of Phi by dr/dF, the vehicle's response: tau for linear drag, a
matrix from sample to sample for quadratic drag (`sparsefit.flight.vehicle`), along the fitted
flow. It grows without bound where nothing drags; what noise is there bounds it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sparsefit.arrays import Array
from sparsefit.cached import cached_property
from sparsefit.derivative import Samples
from sparsefit.derivative.filters import Filters
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.library.nuisance import Nuisance
from sparsefit.modes.fitted_rows import Rows
from sparsefit.modes.stack import Part
from sparsefit.uncertainty.model import Model
from sparsefit.uncertainty.wander import Wander

DIRECTIONS = 8  # of noise
SLOW = 0.25  # of the samples, where least drags: there an error of v' is most of what is left
KICKS = 4.0  # times the sensors' noise of v', squared, with kicks: more is a misfit, no noise
LEAST = 1e-6  # of the rms drag: without noise, what bounds the response


@dataclass(frozen=True, eq=False)
class Filtered:
    """A fit of rows that are made of filtered samples.

    Args:
        samples: the states that the filters gave, and the weak rows made of them if any.
        filters: the weights behind them.
        model: the fit, as a model of its rows.
        plain: the same fit as a model of the samples: other than `model` for weak rows only.
        vehicle: that fits best.
        response_time: its tau [s]; of quadratic drag, the root mean square of its response.
        shared: whether the velocity has a column, the first of the flight's nuisance columns.
        stretch: the response of quadratic drag over `response_time`, (2, 2, m); None: 1.
        roughness: of quadratic drag, the rms of the noise in |v' - a| [m/s^2].
        weight: of the flight's rows among those of several; `model` and `plain` are without it.
        place: of its first coefficient among those of several flights.
    """

    samples: Samples
    filters: Filters
    model: Model
    plain: Model
    vehicle: PointMassVehicle
    response_time: float
    shared: bool
    stretch: Array | None = None
    roughness: float = 0.0
    weight: float = 1.0
    place: int = 0

    @classmethod
    def of(
        cls,
        samples: Samples,
        model: Model,
        nuisance: Nuisance,
        *,
        weight: float = 1.0,
        place: int = 0,
        moving: Array | None = None,
    ) -> Filtered | None:
        """A model of the samples' rows; None where no filter of this package made them.

        moving: the velocity (m, 2) [m/s] of the nuisance columns, where it is not the samples'.
        """
        filters, plain = Filters.of(samples), model
        if filters is None or len(samples.time) != len(model.rows.position):
            return None  # or weak rows of the states as they were measured
        if samples.weak is not None:
            velocity = samples.velocity if moving is None else moving
            own = nuisance.columns(velocity, samples.thrust)
            after = len(model.coefficients) - place - own.shape[2]
            every = np.pad(own, ((0, 0), (0, 0), (place, after)))
            target = samples.flow_velocity(nuisance.believed)
            plain = replace(model, rows=Rows(model.rows.position, target, every))
        vehicle, shared, here = nuisance.believed, nuisance.shared, (weight, place)
        if not vehicle.drag:
            tau = vehicle.response_time
            return cls(samples, filters, model, plain, vehicle, tau, shared, None, 0.0, *here)
        drags = vehicle.drag_of(plain.fitted - samples.velocity)
        seen = samples.flow_velocity(vehicle) - samples.velocity
        squares = np.sum(drags**2, axis=1)
        slow = squares <= np.quantile(squares, SLOW)
        away = np.sum((vehicle.drag_of(seen) - drags)[slow] ** 2, axis=1)
        levels = np.square([[filters.sigma_position], [filters.sigma_velocity]])
        sensors = 2 * float(np.sum(levels * filters.raw[2] ** 2))
        seen_noise = min(away.mean(), KICKS * sensors) if math.isfinite(sensors) else away.mean()
        noise = float(np.sqrt(max(seen_noise, LEAST**2 * squares.mean())))
        response = vehicle.response(drags, noise)
        tau = float(np.sqrt(0.5 * np.mean(np.sum(response**2, axis=(0, 1)))))
        stretch = response / tau
        return cls(samples, filters, model, plain, vehicle, tau, shared, stretch, noise, *here)

    @classmethod
    def of_parts(cls, parts: Sequence[Part], model: Model) -> list[Filtered] | None:
        """Each flight of a model of several; None where no filter made the samples of one."""
        first, fits = 0, []
        for part, rows in zip(parts, model.rows.flights, strict=True):
            own = model if rows is model.rows else replace(model, rows=rows)
            moving = part.relative(part.samples)
            known = cls.of(
                part.samples, own, part.nuisance, weight=part.weight, place=first, moving=moving
            )
            if known is None:
                return None
            fits.append(known)
            first += len(part.nuisance.pairs)
        return fits

    @cached_property
    def wander(self) -> Wander:
        """What the position wanders."""
        return Wander.of(self.samples)

    @cached_property
    def evenness(self) -> float:
        """The mean response over `response_time`, its root mean square: 1 for linear drag."""
        if self.stretch is None:
            return 1.0
        return float(0.5 * np.mean(np.trace(self.stretch)))

    def stretched(self, values: Array) -> Array:
        """What a response of `response_time` would make (..., 2, m), as the vehicle's makes it."""
        if self.stretch is None:
            return values
        turned: Array = np.einsum("abm,...bm->...am", self.stretch, values)
        return turned

    @cached_property
    def bow(self) -> Array:
        """What noise of the acceleration makes of Phi in the mean (m, 2) [m/s]; 0 of linear drag.

        The mean of r(F + n) less r(F), n of rms `roughness` in all directions.
        """
        vehicle, model = self.vehicle, self.plain
        if self.stretch is None:
            return np.zeros_like(model.rows.target)
        drags = vehicle.drag_of(model.fitted - self.samples.velocity)
        turns = 2 * math.pi * np.arange(DIRECTIONS) / DIRECTIONS
        around = self.roughness * np.stack([np.cos(turns), np.sin(turns)], axis=1)
        mean: Array = np.mean([vehicle.relative_of(drags + one) for one in around], axis=0)
        return mean - vehicle.relative_of(drags)

    def as_samples(self, model: Model) -> Model:
        """A model of the rows, as one of the samples."""
        return model if self.model is self.plain else replace(model, rows=self.plain.rows)

    def at(self, whole: Model) -> Model:
        """A model of all flights, as one of the rows of this one."""
        return whole if self.model.rows is whole.rows else replace(whole, rows=self.model.rows)
