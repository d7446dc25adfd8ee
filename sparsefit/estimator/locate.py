"""Where the modes are: on the grid as a back-end's weights say, or off it as the flight says."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial

import numpy as np

from sparsefit.arrays import Array
from sparsefit.errors import InputError
from sparsefit.estimator.prepare import Prepared
from sparsefit.estimator.waves import MOST_WAVES, wavenumbers_of, waves_of
from sparsefit.flight.waves import WaveFlow
from sparsefit.library.cells import Cells
from sparsefit.library.scan import extent_of
from sparsefit.library.waves import Waves
from sparsefit.modes.choice import Ladder
from sparsefit.modes.ladder import climbed, joined, lowest
from sparsefit.modes.located import Located
from sparsefit.modes.projection import Projection, project
from sparsefit.modes.proposals import proposals
from sparsefit.modes.readout import Readout, mean_velocity_of
from sparsefit.modes.search import MOST, SLOWEST, locate_one, locate_several
from sparsefit.modes.wave_peaks import wave_peaks
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
        ladder: the shapes of waves that were tried, if any were.
        grid: the sum of all waves on the back-end's grid, where it was not left.
    """

    wavenumbers: Array
    candidates: tuple[float, ...]
    located: Located | None = None
    fit: Projection | None = None
    ladder: Ladder | None = None
    grid: WaveFlow | None = None

    @property
    def length_scales(self) -> tuple[float, ...]:
        """L = pi/k (s,) [m]."""
        return tuple(math.pi / k for k in self.wavenumbers.tolist())

    @property
    def other(self) -> float:
        """The wavenumber [1/m] of what a mode could be mistaken for, or is left; NaN of nothing."""
        if self.ladder is not None and not self.ladder.steady_cells:
            rival = self.ladder.rival
            return math.pi / rival.length_scale if rival else math.nan
        if self.located is None:
            return math.nan
        if math.isfinite(self.located.left_over):
            return self.located.left_over
        return self.located.rival.wavenumber if self.located.rival else math.nan


def locate(prepared: Prepared, fit: Fit, readout: Readout, candidate: float) -> Place:
    """The modes that a fit with weights leads to.

    candidate: the length scale of the largest weight [m], by the readout's rule.
    """
    refined = readout.refine != "none" and not prepared.narrow
    if prepared.library.family == "waves":
        return _waves(prepared, fit, readout, candidate, refined)
    if readout.scales == "several":
        return _several(prepared, fit, readout, refined)
    if not refined:
        return Place(np.array([math.pi / candidate]), (candidate,))
    space, located = prepared.space, located_one(prepared, candidate)
    ladder = None
    if _climbable(prepared, readout):
        key = ("ladder", float(located.wavenumbers[0]))
        time = prepared.samples.time
        ladder = prepared.once(key, lambda: climbed(space, time, located.fit))
    elif prepared.library.family == "stream" and readout.mean_velocity == "rms":
        key = ("stream", float(located.wavenumbers[0]))
        ladder = prepared.once(key, lambda: lowest(space, prepared.samples.time, located.fit))
    return Place(located.wavenumbers, (candidate,), located, located.fit, ladder)


def located_one(prepared: Prepared, candidate: float) -> Located:
    """The one mode off the grid, and its rival, from the lobe of a candidate [m] and the others."""
    space = prepared.space
    return prepared.once(("one", candidate), lambda: locate_one(space, math.pi / candidate))


def _waves(
    prepared: Prepared, fit: Fit, readout: Readout, candidate: float, refined: bool
) -> Place:
    """Waves: the peaks of the weights, and off the grid what the flight bears out of them."""
    k, weights = waves_of(fit)
    peaks = wave_peaks(k, weights, extent_of(prepared.samples.position), MOST_WAVES)
    if not refined:
        on_grid = project(Waves(), prepared.rows, k[peaks.top])
        used = weights.any(axis=1)
        grid = WaveFlow(k[used], *weights[used].T)
        return Place(wavenumbers_of(k[peaks.top]), (candidate,), None, on_grid, grid=grid)
    space, time, located = prepared.space, prepared.samples.time, None
    proposed = tuple(peaks.wavevectors.ravel().tolist())
    if _climbable(prepared, readout):
        found = located = prepared.once(("one", None), lambda: locate_one(space))
        climb = partial(climbed, space, time, found.fit, peaks.wavevectors)
        ladder = prepared.once(("ladder", proposed), climb)
    else:
        join = partial(joined, space, time, peaks.wavevectors)
        ladder = prepared.once(("waves", proposed), join)
    best = ladder.best
    return Place(wavenumbers_of(best.phases[:, :2]), (candidate,), located, best.fit, ladder)


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
