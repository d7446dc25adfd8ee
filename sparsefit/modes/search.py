"""The search for modes off the grid: one, wherever the flight shows it, or several, where proposed.

One mode: the deepest lobes of the whole interval are descended into, and the lobe of the
back-end's candidate whatever its depth; the best is the answer, the best of the others its rival.

Several, within the windows that a back-end proposes, the strongest proposal first:

1. the deepest lobe of what the modes so far leave unexplained joins, and all modes move off the
   grid together;
2. it stays where 2 ln(likelihood ratio) = 2m ln(RSS_without / RSS) / correlation exceeds what
   chance gives its 17 parameters once in 1000 flights, over all lobes between the bounds; then
   every mode looks again, the others in place;
3. when no window holds another, modes that no longer earn their place, or are slower than a
   twentieth of the fastest, go.

Outside the windows it only looks for what would make the answer doubtful: a flow that is left, and
the best other lobe of each mode.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sparsefit.arrays import Array
from sparsefit.library.cells import rms_mean_velocity
from sparsefit.modes.located import Located, Rival, exclusion
from sparsefit.modes.projection import Projection
from sparsefit.modes.proposals import Window
from sparsefit.modes.space import SearchSpace, concentration

DESCENDED = 5  # lobes of the whole interval; the rest are too shallow to be best or rival
NEAR = 4.0  # times what excludes it: a lobe beyond is no rival, wherever its descent would end
LOOKED_AT = 3  # lobes that were known before: the best, its rival, and another one every time
MOST = 6  # modes
SLOWEST = 0.05  # of the fastest mode's velocity: systematic errors of a derivative reach 2 %
APART = 0.5  # in lobes: modes nearer than this are one
TRIED = 2  # lobes of a window, deepest first
RIVALS = 2  # other lobes of each of several modes
SAME = 2.0  # in scan steps: descents that end nearer than this are in one lobe


def locate_one(space: SearchSpace, candidate: float | None = None) -> Located:
    """The mode with the least residual between the bounds, and its rival.

    candidate: a back-end's wavenumber [1/m], whose lobe is descended into whatever its depth.
    """
    lobes = space.minima
    starts = lobes[: DESCENDED if space.known is None else LOOKED_AT].tolist()
    if candidate is not None:
        starts.append(float(lobes[np.abs(lobes - candidate).argmin()]))
    fits: list[Projection] = []
    for start in dict.fromkeys(starts):
        if not _too_shallow(space, start, fits):
            fits.append(space.descend(np.array([start]), rough=True))
    fits.sort(key=lambda fit: fit.residual)
    best = space.descend(fits[0].parameters[:, 0], start=fits[0])
    k = float(best.parameters[0, 0])
    other = _other(space, fits, best)
    rival = None if other is None else Rival(k, float(other.parameters[0, 0]), other.residual)
    proposed = (k if candidate is None else candidate,)
    ends = tuple(float(fit.parameters[0, 0]) for fit in (best, *fits[1:]))
    return Located(space, best, proposed, rival, math.nan, _correlation(space, best), ends)


def _too_shallow(space: SearchSpace, start: float, fits: list[Projection]) -> bool:
    """Whether a lobe can be neither the best nor its rival: two fits apart are lower already."""
    lower = [fit.parameters[0, 0] for fit in fits if fit.residual < space.least(start)]
    return bool(lower) and max(lower) - min(lower) > 2 * SAME * space.scan.step


def _other(space: SearchSpace, fits: list[Projection], best: Projection) -> Projection | None:
    """The best of fits in another lobe; one that was followed, and comes near, descends to its end.

    It may end in the lobe of the best.
    """
    k, apart = best.parameters[0, 0], SAME * space.scan.step
    near = NEAR * exclusion(space)
    for fit in fits:
        if abs(fit.parameters[0, 0] - k) <= apart:
            continue
        if space.known is None or space.evidence(fit.residual, best.residual) > near:
            return fit
        fit = space.descend(fit.parameters[:, 0], rough=True, start=fit)
        if abs(fit.parameters[0, 0] - k) > apart:
            return fit
    return None


def locate_several(
    space: SearchSpace, peaks: tuple[Window, ...], windows: tuple[Window, ...]
) -> Located:
    """The modes within the windows, those of the peaks first, and what the data cannot tell."""
    chosen = _pruned(space, _gathered(space, peaks, windows))
    fit = space.descend(chosen.fit.parameters[:, 0])
    chosen = _Chosen(fit, chosen.windows)
    candidates = tuple(window.wavenumber for window in chosen.windows)
    correlation = _correlation(space, fit)
    anywhere = Window(0.0, *space.bounds)
    left = _pruned(space, _joined(space, chosen, (anywhere,)) or chosen)
    if len(left.windows) > len(chosen.windows):
        more = float(left.fit.parameters[-1, 0])
        return Located(space, fit, candidates, None, more, correlation)
    rivals = [_rival(space, fit, mode) for mode in range(len(candidates))]
    rival = min(filter(None, rivals), key=lambda one: one.residual, default=None)
    return Located(space, fit, candidates, rival, math.nan, correlation)


def _correlation(space: SearchSpace, fit: Projection) -> float:
    """Averages know how far their errors correlate; samples show it in their residuals."""
    if space.rows.operator is not None or space.pairs:
        return space.correlation
    return max(space.correlation, concentration(fit.rest))


@dataclass(frozen=True, eq=False)
class _Chosen:
    """Modes so far and the window that each came from."""

    fit: Projection
    windows: tuple[Window, ...] = ()


def _gathered(
    space: SearchSpace, peaks: tuple[Window, ...], windows: tuple[Window, ...]
) -> _Chosen:
    """Modes from the peaks, strongest first, then from every other group with a weight."""
    chosen = _Chosen(space.empty)
    for peak in peaks[:MOST]:
        more = _joined(space, chosen, (peak,))
        chosen = chosen if more is None else _settled(space, more, windows)
    if not chosen.windows:  # no lobe in any window: the strongest candidate itself
        fit = space.descend(np.array([peaks[0].wavenumber]), rough=True)
        chosen = _Chosen(fit, peaks[:1])
    while len(chosen.windows) < MOST:
        more = _joined(space, chosen, _unspent(windows, chosen))
        if more is None:
            break
        chosen = _settled(space, more, windows)
    return chosen


def _unspent(windows: tuple[Window, ...], chosen: _Chosen) -> tuple[Window, ...]:
    """A window gives one mode."""
    return tuple(window for window in windows if window not in chosen.windows)


def _joined(space: SearchSpace, chosen: _Chosen, windows: tuple[Window, ...]) -> _Chosen | None:
    """One mode more, from the deepest lobe in the windows; None where none is worth it."""
    taken = chosen.fit.parameters[:, 0]
    best: _Chosen | None = None
    for k, window in _places(space, chosen.fit, windows, taken):
        fit = space.descend(np.append(taken, k), rough=True)
        separate = _separate(space, fit.parameters[:, 0])
        if separate and (best is None or fit.residual < best.fit.residual):
            best = _Chosen(fit, (*chosen.windows, window))
    if best is None or not chosen.windows:
        return best
    gain = space.evidence(chosen.fit.residual, best.fit.residual)
    return best if gain > space.by_chance(space.parameters) else None


def _settled(space: SearchSpace, chosen: _Chosen, windows: tuple[Window, ...]) -> _Chosen:
    """Each mode looks again, the others in place: the first saw all of them mixed.

    In its own window and in those that gave no mode yet.
    """
    if len(chosen.windows) < 2:
        return chosen
    for mode, window in enumerate(chosen.windows):
        k_now = chosen.fit.parameters[:, 0]
        others = space.without(chosen.fit, mode)
        offered = (window, *_unspent(windows, chosen))
        for k, there in _places(space, others, offered, np.delete(k_now, mode)):
            if abs(k - chosen.fit.parameters[mode, 0]) < APART * space.lobe:
                continue
            start = chosen.fit.parameters[:, 0].copy()
            start[mode] = k
            fit = space.descend(start, rough=True)
            if fit.residual < chosen.fit.residual and _separate(space, fit.parameters[:, 0]):
                changed = (*chosen.windows[:mode], there, *chosen.windows[mode + 1 :])
                chosen = _Chosen(fit, changed)
    return chosen


def _places(
    space: SearchSpace, fit: Projection, windows: tuple[Window, ...], taken: Array
) -> list[tuple[float, Window]]:
    """The deepest lobes in the windows of what a fit leaves, apart from those taken, and whose."""
    if not windows:
        return []
    places: list[tuple[float, Window]] = []
    for k in space.lobes(fit).tolist():
        around = [window for window in windows if window.low <= k <= window.high]
        if around and _apart(space, taken, k):
            places.append((k, min(around, key=lambda window: abs(window.wavenumber - k))))
        if len(places) == TRIED:
            break
    return places


def _apart(space: SearchSpace, wavenumbers: Array, k: float) -> bool:
    return bool(np.all(np.abs(wavenumbers - k) >= APART * space.lobe))


def _separate(space: SearchSpace, wavenumbers: Array) -> bool:
    return bool(np.all(np.diff(np.sort(wavenumbers)) >= APART * space.lobe))


def _pruned(space: SearchSpace, chosen: _Chosen) -> _Chosen:
    """The modes without those that are too slow, or that chance could explain, weakest first."""
    while len(chosen.windows) > 1:
        k = chosen.fit.parameters[:, 0]
        speeds = [rms_mean_velocity(weights) for weights in chosen.fit.weights]
        without = [space.at(np.delete(k, mode)) for mode in range(len(k))]
        dropped = int(np.argmin([fit.residual for fit in without]))
        slowest = int(np.argmin(speeds))
        gain = space.evidence(without[dropped].residual, chosen.fit.residual)
        if speeds[slowest] < SLOWEST * max(speeds):
            dropped = slowest
        elif gain > space.by_chance(space.parameters):
            break
        windows = tuple(w for mode, w in enumerate(chosen.windows) if mode != dropped)
        chosen = _Chosen(space.descend(np.delete(k, dropped), rough=True), windows)
    return chosen


def _rival(space: SearchSpace, fit: Projection, mode: int) -> Rival | None:
    """The best other lobe of one mode, all modes descending around it."""
    wavenumbers = fit.parameters[:, 0]
    k = float(wavenumbers[mode])
    lobes = space.lobes(space.without(fit, mode)).tolist()
    rivals: list[Rival] = []
    for other in [lobe for lobe in lobes if _apart(space, wavenumbers, lobe)][:RIVALS]:
        start = wavenumbers.copy()
        start[mode] = other
        tried = space.descend(start, rough=True)
        moved = float(tried.parameters[mode, 0])
        if abs(moved - k) >= APART * space.lobe:
            rivals.append(Rival(k, moved, tried.residual))
    return min(rivals, key=lambda rival: rival.residual, default=None)
