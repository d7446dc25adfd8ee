"""Where a length scale may be: the lobes of the residual, scanned for a little with every sample.

A scan of all wavenumbers takes some milliseconds; it is made of Fourier sums, of which a sample
takes one. Its lobes are where the next answers are sought, by descents on the rows of their own
moment: a lobe that has moved since by less than its width leads to the same minimum.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from sparsefit.arrays import Array
from sparsefit.derivative import Samples
from sparsefit.errors import InputError
from sparsefit.library.cells import WAVES
from sparsefit.library.scan import OF_GRAM, crossed
from sparsefit.modes.search import LOOKED_AT, SAME
from sparsefit.modes.space import SearchSpace
from sparsefit.online.window import Window

FIRST = 64  # samples, of the first scan
BESIDE = 10.0  # scan steps: lobes are some 30 apart, and move less than this between two answers
SHARE = 0.5  # of the window is new when it is scanned again
GROWN = 0.2  # by so much a window that fills has grown
FRESH = 0.75  # of the window that an answer may take the lobes of


class Lobes:
    """The lobes of the last scan that is complete.

    Args:
        window: that is scanned, between the bounds of its grid.
    """

    def __init__(self, window: Window) -> None:
        self._window = window
        grid = window.settings.library.grid
        self._bounds = math.pi / grid.upper, math.pi / grid.lower
        self._work: Iterator[None] = iter(())
        self._due = FIRST
        self._turn = 0
        self._places: Array | None = None
        self._rows = 0  # of the window when it was scanned

    @classmethod
    def of(cls, window: Window) -> Lobes | None:
        """The lobes of a window, where the estimator's readout looks for one mode off the grid."""
        return cls(window) if window.settings.searched else None

    def advance(self) -> None:
        """Take one step of a scan, where one is due."""
        window = self._window
        if self._due <= window.count:
            share = SHARE if window.first else GROWN
            self._due = window.count + max(FIRST, math.ceil(share * window.rows))
            self._work = self._scan(window.rows)
        next(self._work, None)

    def _scan(self, rows: int) -> Iterator[None]:
        samples = self._window.complete()
        if len(samples.time) < 2:
            return
        try:
            space = self._space(samples)
        except InputError:  # it stands still
            return
        for wave in OF_GRAM:
            space.scan.ones(wave)
            yield
        _ = space.scan.factor
        yield
        loads, sums = np.ascontiguousarray(space.empty.rest.T), []
        weight = 1.0 if space.scan.weight is None else space.scan.weight
        for p, q in WAVES.tolist():
            sums.append(space.scan.sums((p, q), loads * weight))
            yield
        curve = np.trace(space.scan.freed(loads, crossed(sums)), axis1=1, axis2=2)
        self._places, self._rows = space.lobes_of(curve), rows

    def _space(self, samples: Samples) -> SearchSpace:
        """What is scanned: samples, weighted as they were when the scan began."""
        settings = self._window.settings
        phi = samples.flow_velocity(settings.vehicle)
        space = SearchSpace.plain(samples.position, phi, self._bounds)
        if not settings.fades:
            return space
        rows = space.rows.fading(np.sqrt(settings.weight(samples.time[-1] - samples.time)))
        return replace(space, rows=rows, sampled=rows)

    def places(self) -> Array | None:
        """Wavenumbers (l,) [1/m]: the deepest two, one of the others in turn, then the rest.

        None before the first scan is complete, and where the window has outgrown it.
        """
        if self._places is None or self._rows < FRESH * self._window.rows:
            return None
        if len(self._places) <= LOOKED_AT:
            return self._places
        self._turn += 1
        best, others = np.split(self._places, [LOOKED_AT - 1])
        return np.concatenate([best, np.roll(others, -self._turn)])

    def moved(self, ends: tuple[float, ...], step: float) -> None:
        """Take the ends of an answer's descents [1/m], best first, for the lobes near them."""
        if self._places is None:
            return
        kept: list[float] = []
        for places, apart in ((ends, SAME), (self._places.tolist(), BESIDE)):
            for place in places:
                if all(abs(place - other) > apart * step for other in kept):
                    kept.append(place)
        self._places = np.array(kept)
