"""Columns with a continuous parameter: what a back-end needs that is bound to no grid.

A problem whose groups are samples of a continuum of columns Z(k), k a number, may say so: back-ends
that place groups of their own ask it for the columns at any k, and for scans of all of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from sparsefit.arrays import Array, IntArray

Bounds = tuple[float, float]


@dataclass(frozen=True, eq=False)
class Jet:
    """Z(k)' and its first and second derivatives by k (s, c, m), and the rms (s, c) of its columns.

    Columns are of unit rms. One that is zero in every row stays zero, with rms 1.
    """

    value: Array
    slope: Array
    bend: Array
    rms: Array

    @classmethod
    def of(cls, value: Array, slope: Array, bend: Array) -> Jet:
        """From columns theta (s, c, m) in original units and their derivatives."""
        rms = np.sqrt(_mean(value, value))
        rms[rms == 0] = 1.0
        value, slope, bend = (part / rms[..., None] for part in (value, slope, bend))
        # With z = theta / r: r r' = <theta, theta'>, r r'' + r'^2 = |theta'|^2 + <theta, theta''>.
        rate = _mean(value, slope)
        turn = _mean(slope, slope) + _mean(value, bend) - rate * rate
        slope = slope - value * rate[..., None]
        bend = bend - 2 * slope * rate[..., None] - value * turn[..., None]
        return cls(value, slope, bend, rms)


def _mean(first: Array, second: Array) -> Array:
    mean: Array = np.einsum("scm,scm->sc", first, second) / first.shape[-1]
    return mean


class Scan(Protocol):
    """The columns of one group at every k of a grid that resolves whatever they tell."""

    @property
    def wavenumbers(self) -> Array:
        """The grid k (q,), uniform, both bounds included."""
        ...

    @property
    def step(self) -> float:
        """Between the k of the grid."""
        ...

    def heights(self, residual: Array) -> Array:
        """|Z(k)'R|_F / m (q,) for a residual R (m, n)."""
        ...

    def matched(self, pattern: Array, target: Array) -> tuple[Array, Array]:
        """<f, Y> and <f, f> (q,) of f = theta(k) S, for weights S (c, n) and a target Y (m, n)."""
        ...


@runtime_checkable
class Continuum(Protocol):
    """The columns theta(k) (m, c) of a problem at any k, in place of a grid of them."""

    @property
    def size(self) -> int:
        """The number c of columns of a group."""
        ...

    @property
    def extent(self) -> float:
        """The range over which the columns are known: what they tell of k has width 1/extent."""
        ...

    @property
    def pattern(self) -> Array | None:
        """Weights S (c, n) of a target that is known up to its size; None where none is."""
        ...

    def interval(self, lower: float | None, upper: float | None) -> Bounds:
        """The least and the largest k for bounds of the groups' scale; None: the grid's own."""
        ...

    def wavenumbers(self, scales: Array) -> Array:
        """The k of groups with these scales (s,)."""
        ...

    def scan_points(self, bounds: Bounds) -> int:
        """How many k a scan of the interval takes."""
        ...

    def scan(self, bounds: Bounds) -> Scan:
        """The scan of an interval of k."""
        ...

    def columns(self, wavenumbers: Array) -> tuple[Array, Array, Array]:
        """theta(k)' and its first and second derivatives by k, (s, c, m) each, for k (s,)."""
        ...

    def design(self, wavenumbers: Array) -> tuple[Array, Array, tuple[str, ...]]:
        """theta (m, s c) of each k (s,), the groups' scales (s,) and the columns' names."""
        ...

    def at(self, rows: IntArray) -> Continuum:
        """The continuum of some rows of the problem."""
        ...
