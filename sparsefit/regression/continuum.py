"""Columns with continuous parameters: what a back-end needs that is bound to no grid.

A problem whose groups are samples of a continuum of columns Z(q), q of p numbers, may say so: back-
ends that place groups of their own ask it for the columns at any q, and for scans of all of them.
The first number of q is a wavenumber between bounds; others, such as a heading, are free.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from sparsefit.arrays import Array, IntArray

Bounds = tuple[float, float]


@dataclass(frozen=True, eq=False)
class Jet:
    """Z(q)' (s, c, m), its first and second derivatives by q, and the rms (s, c) of its columns.

    The derivatives are (s, p, c, m) and (s, p, p, c, m). Columns are of unit rms. One that is zero
    in every row stays zero, with rms 1.
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
        value, slope = value / rms[..., None], slope / rms[:, None, :, None]
        bend = bend / rms[:, None, None, :, None]
        # With z = theta / r: r r_p = <theta, theta_p>, and
        # r r_pq + r_p r_q = <theta_p, theta_q> + <theta, theta_pq>.
        first, second = slope[:, :, None], slope[:, None]
        rates = _mean(value[:, None], slope)
        rate, other = rates[:, :, None, :, None], rates[:, None, :, :, None]
        turn = _mean(first, second) + _mean(value[:, None, None], bend)
        turn -= rates[:, :, None] * rates[:, None]
        slope -= value[:, None] * rates[..., None]
        bend -= slope[:, :, None] * other
        bend -= slope[:, None] * rate
        bend -= value[:, None, None] * turn[..., None]
        return cls(value, slope, bend, rms)


def _mean(first: Array, second: Array) -> Array:
    mean: Array = np.vecdot(first, second) / first.shape[-1]
    return mean


class Scan(Protocol):
    """The columns of one group at every q of a grid that resolves whatever they tell."""

    @property
    def slack(self) -> float:
        """By what share of it a peak may be higher than the grid shows it, three times over."""
        ...

    def tops(self, residual: Array, slack: float) -> tuple[Array, Array]:
        """Where |Z(q)'R|_F / m of a residual R (m, n) has a local maximum on the grid, (j, p).

        Those within ``slack`` of the highest, highest first, and how far from each a peak may be,
        (j, p).
        """
        ...


class KnownScan(Scan, Protocol):
    """A scan of one wavenumber k, which also looks for a target that is known up to its size."""

    @property
    def wavenumbers(self) -> Array:
        """The grid k (q,), uniform, both bounds included."""
        ...

    @property
    def step(self) -> float:
        """Between the k of the grid."""
        ...

    def matched(self, pattern: Array, target: Array) -> tuple[Array, Array]:
        """<f, Y> and <f, f> (q,) of f = theta(k) S, for weights S (c, n) and a target Y (m, n)."""
        ...


class Continuum(Protocol):
    """The columns theta(q) (m, c) of a problem at any q, in place of a grid of them."""

    @property
    def size(self) -> int:
        """The number c of columns of a group."""
        ...

    @property
    def parameters(self) -> int:
        """The number p of parameters."""
        ...

    @property
    def extent(self) -> float:
        """The range over which the columns are known: what they tell of k has width 1/extent."""
        ...

    def interval(self, lower: float | None, upper: float | None) -> Bounds:
        """The least and largest wavenumber for bounds of the groups' scale; None: the grid's."""
        ...

    def scan_points(self, bounds: Bounds) -> int:
        """How many q a scan between bounds of the wavenumber takes."""
        ...

    def scan(self, bounds: Bounds) -> Scan:
        """The scan between bounds of the wavenumber."""
        ...

    def columns(self, places: Array) -> tuple[Array, Array, Array]:
        """theta(q)' (s, c, m) and its derivatives (s, p, c, m), (s, p, p, c, m), at q (s, p)."""
        ...

    def spans(self, places: Array) -> Array:
        """By how much each parameter can turn a column's phase, per unit, at q (s, p): (s, p)."""
        ...

    def images(self, places: Array) -> tuple[Array, Array]:
        """All q (i, s, p) that mean the same groups, and the signs (i, c) of weights that do."""
        ...

    def design(self, places: Array) -> tuple[Array, Array, Array, tuple[str, ...]]:
        """Of groups at q (s, p): theta (m, s c), the modes' parameters, scales (s,) and names."""
        ...

    def places(self, parameters: Array) -> Array:
        """q (s, p) of groups with these parameters, as `design` gives them."""
        ...

    def at(self, rows: IntArray) -> Continuum | None:
        """The continuum of some rows of the problem; None where they are not whole samples."""
        ...


@runtime_checkable
class KnownContinuum(Continuum, Protocol):
    """A continuum over one wavenumber k of which one target may be known up to its size."""

    @property
    def pattern(self) -> Array | None:
        """Its weights S (c, n); None where none is known."""
        ...

    def scan(self, bounds: Bounds) -> KnownScan:
        """The scan between bounds of the wavenumber."""
        ...
