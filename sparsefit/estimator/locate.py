"""Where the modes are: on the grid as a back-end's weights say, or off it as the flight says."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sparsefit.arrays import Array
from sparsefit.errors import InputError
from sparsefit.estimator.prepare import Prepared
from sparsefit.library.cells import Cells
from sparsefit.library.scan import extent_of
from sparsefit.modes.ladder import Ladder, climbed
from sparsefit.modes.projection import Projection, project
from sparsefit.modes.proposals import proposals
from sparsefit.modes.readout import Readout, mean_velocity_of
from sparsefit.modes.search import MOST, SLOWEST, Located, locate_one, locate_several
from sparsefit.regression.fit import Fit

FEWEST = 10  # rows that count: fewer cannot tell a shape


@dataclass(frozen=True, eq=False)
class Place:
    """The modes of a flight.

    Args:
        wavenumbers: k (s,) [1/m].
        candidates: the length scales on the back-end's grid that they come from (s,) [m].
        located: how they were found off the grid; None where they were read on it.
        fit: of the modes, all together; None where the one mode on the grid is read by its own.
        ladder: the shapes that were tried beyond square cells, if any were.
    """

    wavenumbers: Array
    candidates: tuple[float, ...]
    located: Located | None = None
    fit: Projection | None = None
    ladder: Ladder | None = None

    @property
    def length_scales(self) -> tuple[float, ...]:
        """L = pi/k (s,) [m]."""
        return tuple(math.pi / k for k in self.wavenumbers.tolist())


def locate(prepared: Prepared, fit: Fit, readout: Readout, candidate: float) -> Place:
    """The modes that a fit with weights leads to.

    candidate: the length scale of the largest weight [m], by the readout's rule.
    """
    refined = readout.refine != "none" and not prepared.narrow
    if readout.scales == "several":
        return _several(prepared, fit, readout, refined)
    if not refined:
        return Place(np.array([math.pi / candidate]), (candidate,))
    space = prepared.space
    located = prepared.once(("one", candidate), lambda: locate_one(space, math.pi / candidate))
    ladder = None
    if _climbable(prepared, readout):
        key = ("ladder", float(located.wavenumbers[0]))
        time = prepared.samples.time
        ladder = prepared.once(key, lambda: climbed(space, time, located.fit))
    return Place(located.wavenumbers, (candidate,), located, located.fit, ladder)


def _climbable(prepared: Prepared, readout: Readout) -> bool:
    """Whether the readout asks for the ladder, and there are rows enough for its freest shape."""
    if readout.refine != "ladder" or readout.mean_velocity != "rms":
        return False
    rows, moments = prepared.space.rows, len(prepared.samples.time)
    return len(rows.position) == moments and moments > FEWEST * prepared.space.correlation


def _several(prepared: Prepared, fit: Fit, readout: Readout, refined: bool) -> Place:
    """All modes within the windows that the back-end's weights propose."""
    on_grid = fit.problem is prepared.problem
    if not refined:
        return _as_proposed(prepared, fit, readout, on_grid=on_grid)
    space = prepared.space
    peaks, windows = proposals(fit, space.lobe, space.bounds, on_grid=on_grid)
    key = ("several", peaks, windows)
    located = prepared.once(key, lambda: locate_several(space, peaks, windows))
    scales = tuple(math.pi / k for k in located.candidates)
    return Place(located.wavenumbers, scales, located, located.fit)


def _as_proposed(prepared: Prepared, fit: Fit, readout: Readout, *, on_grid: bool) -> Place:
    """The peaks of the weights as they are: the back-end's own set, fitted together."""
    extent = extent_of(prepared.samples.position)
    if not extent > 0:
        raise InputError("the flight does not move: no length scale can be told; fly farther")
    lobe = 2 * math.pi / extent
    peaks = proposals(fit, lobe, (0.0, math.inf), on_grid=on_grid)[0][:MOST]
    k = np.array([peak.wavenumber for peak in peaks])
    rows, family = prepared.rows, Cells()
    every = project(family, rows, k[:, None])
    speeds = np.array([mean_velocity_of(own, readout.mean_velocity) for own in every.weights])
    k = k[speeds >= SLOWEST * speeds.max()]
    candidates = tuple(math.pi / one for one in k.tolist())
    return Place(k, candidates, None, project(family, rows, k[:, None]))
