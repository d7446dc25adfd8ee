"""From a fit to a set of length scales, each with a velocity: flows that are superposed.

The back-end proposes and the refit decides. Proposals are the peaks of the back-end's weights,
|W_g| by group, and around each a window of wavenumbers: to the neighbouring candidates and at least
a lobe, 2 pi / extent, wide. Nothing is looked for outside the windows: a scale that the back-end
gave no weight is missed. Within them, strongest proposal first:

1. the deepest lobe of what the scales so far leave unexplained joins, and all scales move off the
   grid together (`joint.descend`);
2. it stays where 2 ln(likelihood ratio) = 2m ln(RSS_without / RSS) / correlation exceeds what
   chance gives its 17 parameters once in 1000 flights, over all lobes between the bounds;
3. when no window holds another, scales that no longer earn their place, or are slower than a
   twentieth of the fastest, go.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from sparsefit.fit import Fit
from sparsefit.joint import JointFit, Lobes, descend, fit_at
from sparsefit.readout import peak_mean_velocity, rms_mean_velocity
from sparsefit.refine import FALSE_ALARM, ROUGH, SIGNIFICANCE, STEP, centred, columns

Array = NDArray[np.float64]
Bounds = tuple[float, float]

MOST = 6  # scales
SHARE = 0.05  # of the fastest scale's velocity: systematic errors of a derivative reach 2 %
PROPOSED = 0.02  # of the largest |W_g|: what is smaller proposes nothing
APART = 0.5  # in lobes: scales nearer than this are one
TRIED = 2  # lobes of a window, deepest first
RIVALS = 2  # other lobes of each scale, refined in full
PARAMETERS = 17  # of a scale: 16 weights and k


@dataclass(frozen=True)
class ScaleEstimate:
    """One cellular flow of several: U0 [m/s], L [m], L/U0 [s], and the candidate [m] behind it."""

    mean_velocity: float
    length_scale: float
    timescale: float
    grid_length_scale: float


@dataclass(frozen=True)
class ScaleSet:
    """Scales, fastest first; what keeps them from being sure, "" if nothing; the best rival [m]."""

    scales: tuple[ScaleEstimate, ...]
    reason: str = ""
    rival_length_scale: float = math.nan


@dataclass(frozen=True)
class Window:
    """Wavenumbers low...high [1/m] that a candidate at k proposes to look in."""

    wavenumber: float
    low: float
    high: float


@dataclass(frozen=True, eq=False)
class _Search:
    """What the search for scales knows: centred rows, the bounds of k, and how errors behave."""

    position: Array
    phi: Array
    lobes: Lobes
    correlation: float
    extent: float
    floor: float

    @property
    def bounds(self) -> Bounds:
        return self.lobes.bounds

    @property
    def lobe(self) -> float:
        return 2 * math.pi / self.extent

    def descend(self, wavenumbers: Array, *, rough: bool = True) -> JointFit:
        """All scales moved to the least RSS; rough: to a thousandth of a scan step."""
        tolerance = ROUGH * STEP / self.extent if rough else 0.0
        return descend(self.position, self.phi, wavenumbers, self.bounds, tolerance)

    @property
    def lobe_count(self) -> float:
        return max(1.0, (self.bounds[1] - self.bounds[0]) / self.lobe)

    def evidence(self, without: float, residual: float) -> float:
        """2 ln(likelihood ratio) of RSS = residual to RSS = without."""
        ratio = max(without, self.floor) / max(residual, self.floor)
        return 2 * len(self.phi) * math.log(ratio) / self.correlation

    def by_chance(self, parameters: int) -> float:
        """What evidence for so many parameters reaches by chance in one flight of 1000."""
        return float(chdtri(parameters, FALSE_ALARM / self.lobe_count))


@dataclass(frozen=True, eq=False)
class _Found:
    """Scales so far and the window that each came from."""

    fit: JointFit
    windows: tuple[Window, ...] = field(default=())


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
    extent = float(np.ptp(lobes.position, axis=0).max())
    floor = 1e-15 * float(np.sum(flow_velocity**2))
    search = _Search(lobes.position, flow_velocity, lobes, correlation, extent, floor)
    peaks, windows = proposals(fit, search.lobe, lobes.bounds, on_grid=on_grid)
    found = _pruned(search, _gathered(search, peaks, windows))
    found = _Found(search.descend(found.fit.wavenumbers, rough=False), found.windows)
    reason, rival = _doubt(search, found)
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
    lobe = 2 * math.pi / float(np.ptp(position, axis=0).max())
    peaks = proposals(fit, lobe, (0.0, math.inf), on_grid=on_grid)[0][:MOST]
    every = fit_at(points, flow_velocity, np.array([one.wavenumber for one in peaks]))
    speeds = np.array([speed(own) for own in every.weights])
    kept = tuple(one for one, u in zip(peaks, speeds, strict=True) if u >= SHARE * speeds.max())
    again = fit_at(points, flow_velocity, np.array([one.wavenumber for one in kept]))
    return ScaleSet(_read(_Found(again, kept), speed))


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


def _gathered(search: _Search, peaks: tuple[Window, ...], windows: tuple[Window, ...]) -> _Found:
    """Scales from the peaks, strongest first, then from every other group with a weight."""
    found = _Found(fit_at(search.position, search.phi, np.empty(0)))
    for peak in peaks[:MOST]:
        more = _joined(search, found, (peak,))
        found = found if more is None else _settled(search, more, windows)
    if not found.windows:  # no lobe in any window: the strongest candidate itself
        found = _Found(search.descend(np.array([peaks[0].wavenumber])), peaks[:1])
    while len(found.windows) < MOST:
        more = _joined(search, found, _unspent(windows, found))
        if more is None:
            break
        found = _settled(search, more, windows)
    return found


def _unspent(windows: tuple[Window, ...], found: _Found) -> tuple[Window, ...]:
    """A window gives one scale."""
    return tuple(one for one in windows if one not in found.windows)


def _joined(search: _Search, found: _Found, windows: tuple[Window, ...]) -> _Found | None:
    """One scale more, from the deepest lobe in the windows; None where none is worth it."""
    best: _Found | None = None
    for k, window in _places(search, found.fit.rest, windows, found.fit.wavenumbers):
        fit = search.descend(np.append(found.fit.wavenumbers, k))
        separate = _separate(search, fit.wavenumbers)
        if separate and (best is None or fit.residual < best.fit.residual):
            best = _Found(fit, (*found.windows, window))
    if best is None or not found.windows:
        return best
    gain = search.evidence(found.fit.residual, best.fit.residual)
    return best if gain > search.by_chance(PARAMETERS) else None


def _settled(search: _Search, found: _Found, windows: tuple[Window, ...]) -> _Found:
    """Each scale looks again, the others in place: the first saw all of them mixed.

    In its own window and in those that gave no scale yet.
    """
    if len(found.windows) < 2:
        return found
    for j, window in enumerate(found.windows):
        rest = found.fit.rest + _contribution(search, found.fit, j)
        others = np.delete(found.fit.wavenumbers, j)
        for k, there in _places(search, rest, (window, *_unspent(windows, found)), others):
            if abs(k - found.fit.wavenumbers[j]) < APART * search.lobe:
                continue
            start = found.fit.wavenumbers.copy()
            start[j] = k
            fit = search.descend(start)
            if fit.residual < found.fit.residual and _separate(search, fit.wavenumbers):
                changed = (*found.windows[:j], there, *found.windows[j + 1 :])
                found = _Found(fit, changed)
    return found


def _places(
    search: _Search, rest: Array, windows: tuple[Window, ...], taken: Array
) -> list[tuple[float, Window]]:
    """The deepest lobes of rest (m, 2) in the windows, apart from what is taken, and whose."""
    if not windows:
        return []
    found: list[tuple[float, Window]] = []
    for k in search.lobes(rest).tolist():
        around = [one for one in windows if one.low <= k <= one.high]
        if around and _apart(search, taken, k):
            found.append((k, min(around, key=lambda one: abs(one.wavenumber - k))))
        if len(found) == TRIED:
            break
    return found


def _apart(search: _Search, wavenumbers: Array, one: float) -> bool:
    return bool(np.all(np.abs(wavenumbers - one) >= APART * search.lobe))


def _separate(search: _Search, wavenumbers: Array) -> bool:
    return bool(np.all(np.diff(np.sort(wavenumbers)) >= APART * search.lobe))


def _contribution(search: _Search, fit: JointFit, j: int) -> Array:
    value, _ = columns(search.position, float(fit.wavenumbers[j]))
    own: Array = value @ fit.weights[j]
    return own


def _pruned(search: _Search, found: _Found) -> _Found:
    """The scales without those that are too slow, or that chance could explain, weakest first."""
    while len(found.windows) > 1:
        speeds = [rms_mean_velocity(own) for own in found.fit.weights]
        without = [_without(search, found, j) for j in range(len(speeds))]
        j = int(np.argmin([one.residual for one in without]))
        slowest = int(np.argmin(speeds))
        gain = search.evidence(without[j].residual, found.fit.residual)
        if speeds[slowest] < SHARE * max(speeds):
            j = slowest
        elif gain > search.by_chance(PARAMETERS):
            break
        windows = tuple(one for i, one in enumerate(found.windows) if i != j)
        kept = without[j].wavenumbers
        found = _Found(search.descend(kept), windows)
    return found


def _without(search: _Search, found: _Found, j: int) -> JointFit:
    return fit_at(search.position, search.phi, np.delete(found.fit.wavenumbers, j))


def _doubt(search: _Search, found: _Found) -> tuple[str, float]:
    """(why the data cannot tell the scales, "" where they can; the best rival [m], NaN without)."""
    fit, m = found.fit, len(search.phi)
    null = float(np.sum((search.phi - search.phi.mean(axis=0)) ** 2))
    parameters = PARAMETERS * len(found.windows) - 2  # a uniform wind has 2
    if search.evidence(null, fit.residual) <= search.by_chance(parameters) or m <= parameters:
        words = "no length scale explains more than a uniform wind does"
        return f"no cellular flow detected: {words}", math.nan
    for k in fit.wavenumbers:
        if k in search.bounds:
            words = f"a length scale is at the edge of the search, {math.pi / k:.3g} m"
            return f"{words}; widen the grid's bounds", math.nan
    left = _pruned(search, _joined(search, found, (Window(0.0, *search.bounds),)) or found)
    if len(left.windows) > len(found.windows):
        more = math.pi / float(left.fit.wavenumbers[-1])
        return (
            f"another flow is left, of {more:.3g} m, that the back-end did not propose",
            more,
        )
    least, own, other = math.inf, math.nan, math.nan
    for j, k in enumerate(fit.wavenumbers):
        rival = _rival(search, fit, j)
        if rival is not None and rival[1] < least:
            other, least, own = math.pi / rival[0], rival[1], math.pi / float(k)
    if least < fit.residual:
        return (
            f"{other:.3g} m fits better than {own:.3g} m, and the back-end did not propose it",
            other,
        )
    if search.evidence(least, fit.residual) > 2 * math.log(search.lobe_count / SIGNIFICANCE):
        return "", other
    return (
        f"cannot tell {own:.3g} m from {other:.3g} m: the flight covers {search.extent:.3g} m, or "
        "too straight a line; fly farther, or turn",
        other,
    )


def _rival(search: _Search, fit: JointFit, j: int) -> tuple[float, float] | None:
    """(k, RSS) of the best other lobe of one scale, all scales refined around it."""
    rest = fit.rest + _contribution(search, fit, j)
    places = search.lobes(rest)
    others = [k for k in places.tolist() if _apart(search, fit.wavenumbers, k)]
    best: tuple[float, float] | None = None
    for k in others[:RIVALS]:
        start = fit.wavenumbers.copy()
        start[j] = k
        tried = search.descend(start)
        moved = abs(tried.wavenumbers[j] - fit.wavenumbers[j]) >= APART * search.lobe
        if moved and (best is None or tried.residual < best[1]):
            best = float(tried.wavenumbers[j]), tried.residual
    return best


def _read(found: _Found, speed: Callable[[Array], float]) -> tuple[ScaleEstimate, ...]:
    every = []
    for k, own, window in zip(found.fit.wavenumbers, found.fit.weights, found.windows, strict=True):
        scale, velocity = math.pi / float(k), float(speed(own))
        timescale = scale / velocity if velocity > 0 else math.nan
        every.append(ScaleEstimate(velocity, scale, timescale, math.pi / window.wavenumber))
    return tuple(sorted(every, key=lambda one: -one.mean_velocity))
