"""Columns with continuous parameters: what a back-end needs that is bound to no grid.

A problem whose groups are samples of a continuum of columns Z(q), q of p numbers, may say so: back-
ends that place groups of their own ask it for the columns at any q, and for scans of all of them.
The first number of q is a wavenumber between bounds; others, such as a heading, are free.
"""

from __future__ import annotations

from typing import Protocol

from sparsefit.arrays import Array, IntArray

Bounds = tuple[float, float]


class Scan(Protocol):
    """The columns of one group at every q of a grid that resolves whatever they tell."""

    @property
    def slack(self) -> float:
        """The share of the highest of the grid below it within which peaks may be the supremum."""
        ...

    def tops(
        self, residual: Array, slack: float, pattern: Array | None = None
    ) -> tuple[Array, Array]:
        """Places (j, p) of local maxima of |Z(q)'R|_F / m within ``slack`` of the highest.

        Highest first, for a residual R (m, n), with how far from each a peak may be, (j, p).
        pattern: weights (c, n) of a target known up to its size, <f, R> / |f| of which is scanned.
        """
        ...


class Continuum(Protocol):
    """The columns theta(q) (m, c) of a problem at any q, in place of a grid of them."""

    @property
    def size(self) -> int:
        """The c columns of a group."""
        ...

    @property
    def parameters(self) -> int:
        """The p numbers of q."""
        ...

    @property
    def extent(self) -> float:
        """The range over which columns are known: what they tell of k has width 1/extent."""
        ...

    @property
    def pattern(self) -> Array | None:
        """The weights (c, n) of a target that is known up to its size; None where none is."""
        ...

    def interval(self, lower: float | None, upper: float | None) -> Bounds:
        """The least and largest wavenumber for bounds of the groups' scale; None: the grid's."""
        ...

    def scan_points(self, bounds: Bounds) -> int:
        """The number of q that a scan between bounds of the wavenumber takes."""
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
