"""From a fit to a set of length scales, each with a velocity: flows that are superposed.

The back-end proposes and the refit decides (`scale_search`). Proposals are the peaks of the
back-end's weights, |W_g| by group, and around each a window of wavenumbers: to the neighbouring
candidates and at least a lobe, 2 pi / extent, wide. A window gives one scale at most, and no scale
comes from outside the windows: one that the back-end gave no weight is missed, and said to be.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from sparsefit.arrays import Array
from sparsefit.modes.joint import Lobes, extent_of, fit_at
from sparsefit.modes.readout import peak_mean_velocity, rms_mean_velocity
from sparsefit.modes.refine import centred
from sparsefit.modes.scale_search import MOST, SHARE, Found, Search, Window, doubt, gathered, pruned
from sparsefit.regression.fit import Fit
from sparsefit.uncertainty import Uncertainty

Bounds = tuple[float, float]

PROPOSED = 0.02  # of the largest |W_g|: what is smaller proposes nothing


@dataclass(frozen=True)
class ScaleEstimate:
    """One cellular flow of several: U0 [m/s], L [m], L/U0 [s], and the candidate [m] behind it.

    uncertainty: of a refined scale with the ``rms`` mean velocity, all scales fitted together.
    """

    mean_velocity: float
    length_scale: float
    timescale: float
    grid_length_scale: float
    uncertainty: Uncertainty | None = None


@dataclass(frozen=True)
class ScaleSet:
    """Scales, fastest first; what keeps them from being sure, "" if nothing; the best rival [m]."""

    scales: tuple[ScaleEstimate, ...]
    reason: str = ""
    rival_length_scale: float = math.nan

    @property
    def untold(self) -> str:
        """Why assessed scales are not to be believed, in words; "" if they are.

        Every value must be told at all, and those of the fastest flow as well as those of one
        flow alone; a weak flow beside it may be known less well, as its intervals say.
        """
        for place, one in enumerate(self.scales):
            known = one.uncertainty
            if known is None:
                return "too few samples for a standard error; fly longer, or sample faster"
            if not place or not math.isfinite(known.mean_velocity + known.length_scale):
                wide = known.wide((one.mean_velocity, one.length_scale, one.timescale))
                if wide:
                    return wide
        return ""

    def assessed(
        self, assess: Callable[[tuple[float, ...]], tuple[Uncertainty | None, ...]]
    ) -> "ScaleSet":
        """With the uncertainty of every scale, from all length scales [m]."""
        known = assess(tuple(one.length_scale for one in self.scales))
        pairs = zip(self.scales, known, strict=True)
        return replace(self, scales=tuple(replace(one, uncertainty=own) for one, own in pairs))


def several(
    fit: Fit,
    flow_velocity: Array,
    lobes: Lobes,
    *,
    on_grid: bool,
    velocity: Literal["rms", "peak"] = "rms",
    correlation: float,
) -> ScaleSet:
    """The set of scales of a fit that has weights, off the grid.

    flow_velocity Phi (m, 2) [m/s]; lobes: of the same rows, over the wavenumbers to look in;
    on_grid: whether the fit's groups are the candidates of a grid, between which a scale may lie,
    or scales that the back-end placed itself; correlation: samples over which the errors of Phi
    correlate.
    """
    search = Search(flow_velocity, lobes, correlation)
    peaks, windows = proposals(fit, search.lobe, lobes.bounds, on_grid=on_grid)
    found = pruned(search, gathered(search, peaks, windows))
    found = Found(search.descend(found.fit.wavenumbers, rough=False), found.windows)
    reason, rival = doubt(search, found)
    return ScaleSet(_read(found, _speed(velocity)), reason, rival)


def as_proposed(
    fit: Fit,
    position: Array,
    flow_velocity: Array,
    *,
    on_grid: bool,
    velocity: Literal["rms", "peak"] = "rms",
) -> ScaleSet:
    """The peaks of the weights as they are: the back-end's own set, velocities fitted together.

    position (m, 2) [m], flow_velocity Phi (m, 2) [m/s]; on_grid as in `several`.
    """
    points, speed = centred(position), _speed(velocity)
    lobe = 2 * math.pi / extent_of(position)
    peaks = proposals(fit, lobe, (0.0, math.inf), on_grid=on_grid)[0][:MOST]
    every = fit_at(points, flow_velocity, np.array([one.wavenumber for one in peaks]))
    speeds = np.array([speed(own) for own in every.weights])
    kept = tuple(one for one, u in zip(peaks, speeds, strict=True) if u >= SHARE * speeds.max())
    again = fit_at(points, flow_velocity, np.array([one.wavenumber for one in kept]))
    return ScaleSet(_read(Found(again, kept), speed))


def _speed(velocity: Literal["rms", "peak"]) -> Callable[[Array], float]:
    return rms_mean_velocity if velocity == "rms" else peak_mean_velocity


def proposals(
    fit: Fit, lobe: float, limits: Bounds, *, on_grid: bool
) -> tuple[tuple[Window, ...], tuple[Window, ...]]:
    """(peaks of |W_g| by group, strongest first, one per lobe; windows of all groups in use)."""
    scales = fit.problem.group_scales
    assert scales is not None
    squares = np.bincount(fit.problem.groups, np.square(fit.weights).sum(axis=1), len(scales))
    order = np.argsort(-scales, kind="stable")
    k, strength = math.pi / scales[order], np.sqrt(squares[order])
    used = strength > PROPOSED * strength.max()
    below, above = k - lobe, k + lobe
    if on_grid:
        below[1:], above[:-1] = np.minimum(below[1:], k[:-1]), np.maximum(above[:-1], k[1:])
        around = np.concatenate([[0.0], strength, [0.0]])
        top = used & (strength >= around[:-2]) & (strength >= around[2:])
    else:
        top = used
    every = [
        Window(float(k[i]), max(float(below[i]), limits[0]), min(float(above[i]), limits[1]))
        for i in range(len(k))
    ]
    peaks: list[Window] = []
    for i in np.argsort(-strength, kind="stable"):
        if top[i] and all(abs(k[i] - one.wavenumber) > lobe for one in peaks):
            peaks.append(every[i])
    return tuple(peaks), tuple(every[i] for i in np.flatnonzero(used))


def _read(found: Found, speed: Callable[[Array], float]) -> tuple[ScaleEstimate, ...]:
    every = []
    for k, own, window in zip(found.fit.wavenumbers, found.fit.weights, found.windows, strict=True):
        scale, velocity = math.pi / float(k), float(speed(own))
        timescale = scale / velocity if velocity > 0 else math.nan
        every.append(ScaleEstimate(velocity, scale, timescale, math.pi / window.wavenumber))
    return tuple(sorted(every, key=lambda one: -one.mean_velocity))
