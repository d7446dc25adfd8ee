"""A fit together with the filters through which its rows see the flight."""

from __future__ import annotations

from dataclasses import dataclass, replace

from sparsefit.cached import cached_property
from sparsefit.derivative import Samples
from sparsefit.derivative.filters import Filters
from sparsefit.library.nuisance import Nuisance
from sparsefit.modes.fitted_rows import Rows
from sparsefit.uncertainty.model import Model
from sparsefit.uncertainty.wander import Wander


@dataclass(frozen=True, eq=False)
class Filtered:
    """A fit of rows that are made of filtered samples.

    Args:
        samples: the states that the filters gave, and the weak rows made of them if any.
        filters: the weights behind them.
        model: the fit, as a model of its rows.
        plain: the same fit as a model of the samples: other than `model` for weak rows only.
        response_time: tau [s] of the vehicle that fits best.
        shared: whether the velocity has a column, the first of the nuisance columns.
    """

    samples: Samples
    filters: Filters
    model: Model
    plain: Model
    response_time: float
    shared: bool

    @classmethod
    def of(cls, samples: Samples, model: Model, nuisance: Nuisance) -> Filtered | None:
        """A model of the samples' rows; None where no filter of this package made them."""
        filters, plain = Filters.of(samples), model
        if filters is None or len(samples.time) != len(model.rows.position):
            return None  # or weak rows of the states as they were measured
        if samples.weak is not None:
            single = replace(samples, weak=None)
            rows = Rows.of(single, nuisance.believed, nuisance.unknown)
            timed = model.rows.position.shape[1] > 2
            plain = replace(model, rows=rows.timed(samples.time) if timed else rows)
        tau = nuisance.believed.response_time
        return cls(samples, filters, model, plain, tau, nuisance.shared)

    @cached_property
    def wander(self) -> Wander:
        """What the position wanders."""
        return Wander.of(self.samples)

    def as_samples(self, model: Model) -> Model:
        """A model of the rows, as one of the samples."""
        return model if self.model is self.plain else replace(model, rows=self.plain.rows)
