"""Several flights through one flow: one set of rows, with nuisances of each flight.

Gram matrices add up: with w_f the weight of flight f, one over the level of its noise,

    sum_f w_f^2 |Phi_f - sum_j C(q_j) W_j - N_f b_f|^2

is least squares over one flow q, W and what is unknown of every flight, b_f. One flight is a stack
of one, of weight 1.

An unknown response time scales Phi_f, which W, common to all flights, cannot follow. Near the
believed one, r = tau_0/tau = 1 - b,

    Phi_f = r (C W + wind) + (1 - r) v = C W + r wind + b (v - C W):

its column is the velocity less a flow that is nearly C W, in place of the velocity alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from sparsefit.arrays import Array
from sparsefit.derivative import Samples, WeakRows
from sparsefit.library.nuisance import Nuisance
from sparsefit.modes.fitted_rows import Rows

CORRELATION = 5.0  # samples: errors of smoothed derivatives and of positions are not white
Pair = tuple[int | None, int | None]


@dataclass(frozen=True, eq=False)
class Part:
    """One flight of a stack.

    Args:
        samples: states and derivatives.
        nuisance: what is unknown of it beside the flow.
        weight: of its rows.
        fading: weight of every row (m,), its square of mean 1, where older rows of the one flight
            count for less; None: all are alike.
        flow: what the column of the velocity is less, at the samples (m, 2) [m/s]; None: nothing.
    """

    samples: Samples
    nuisance: Nuisance
    weight: float = 1.0
    fading: Array | None = None
    flow: Array | None = None

    def relative(self, source: Samples | WeakRows) -> Array:
        """The velocity of its samples, or of their averages, less the flow, (q, 2) [m/s]."""
        if self.flow is None:
            return source.velocity
        if isinstance(source, WeakRows):
            averaged: Array = source.velocity - source.operator @ self.flow
            return averaged
        return source.velocity - self.flow

    @property
    def correlation(self) -> float:
        """The rows over which errors of Phi correlate, at least.

        Rows that fade count as (sum w)^2 / sum w^2 of them do, w their squared weights.
        """
        if self.fading is None:
            return self._correlation
        return self._correlation * float(np.mean(self.fading**4))

    @property
    def _correlation(self) -> float:
        weak, smoothing = self.samples.weak, self.samples.smoothing
        if weak is not None:
            return weak.correlation
        if smoothing is None:
            return CORRELATION
        # A polynomial's window per coefficient.
        return max(CORRELATION, smoothing.rate_window / (smoothing.order + 1))


def rows_of(parts: Sequence[Part]) -> Rows:
    """The rows that are fitted: averages where the samples have a weak form."""
    sources: list[Samples | WeakRows] = [part.samples.weak or part.samples for part in parts]
    return _joined(parts, sources)


def samples_of(parts: Sequence[Part]) -> Rows:
    """The samples at which a scan looks, as rows."""
    return _joined(parts, [part.samples for part in parts])


def _joined(parts: Sequence[Part], sources: Sequence[Samples | WeakRows]) -> Rows:
    nuisances, weights = [part.nuisance for part in parts], [part.weight for part in parts]
    moving = [part.relative(source) for part, source in zip(parts, sources, strict=True)]
    rows = Rows.of_flights(sources, nuisances, weights, moving)
    return rows if parts[0].fading is None else rows.fading(parts[0].fading)


def correlation_of(parts: Sequence[Part], rows: Rows) -> float:
    """Rows over which errors correlate: as many count together as count in every flight."""
    if len(parts) == 1:
        return parts[0].correlation
    sizes = [len(own.target) for own in rows.flights]
    worth = sum(size / part.correlation for size, part in zip(sizes, parts, strict=True))
    return sum(sizes) / worth


def series_of(parts: Sequence[Part], sampled: Rows) -> tuple[tuple[Pair, ...], Array]:
    """The series of all nuisance columns at scanned samples (j, m), and where they belong.

    Pairs say which of them every coefficient multiplies in the x and in the y component.
    """
    ends = np.cumsum([0, *(len(own.target) for own in sampled.flights)]).tolist()
    pairs: list[Pair] = []
    series: list[Array] = []
    for part, (first, last) in zip(parts, pairwise(ends), strict=True):
        every = part.nuisance.series(part.relative(part.samples), part.samples.thrust)
        pairs += [_shifted(pair, len(series)) for pair in part.nuisance.pairs]
        series += [np.pad(one, (first, ends[-1] - last)) for one in every]
    stacked = np.array(series).reshape(-1, ends[-1])
    return tuple(pairs), stacked if sampled.scale is None else stacked * sampled.scale


def _shifted(pair: Pair, by: int) -> Pair:
    x, y = pair
    return None if x is None else x + by, None if y is None else y + by
