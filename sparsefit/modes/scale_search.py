"""The search for several length scales off the grid, within the windows that are proposed.

Strongest proposal first:

1. the deepest lobe of what the scales so far leave unexplained joins, and all scales move off the
   grid together (`joint.descend`);
2. it stays where 2 ln(likelihood ratio) = 2m ln(RSS_without / RSS) / correlation exceeds what
   chance gives its 17 parameters once in 1000 flights, over all lobes between the bounds; then
   every scale looks again, the others in place;
3. when no window holds another, scales that no longer earn their place, or are slower than a
   twentieth of the fastest, go.

Outside the windows it only looks for what would make the answer doubtful: a flow that is left, and
the best other lobe of each scale.
"""

import math
from dataclasses import dataclass, field

import numpy as np

from sparsefit.arrays import Array
from sparsefit.modes.joint import JointFit, Lobes, descend, fit_at
from sparsefit.modes.readout import rms_mean_velocity
from sparsefit.modes.refine import FALSE_ALARM, ROUGH, SIGNIFICANCE, STEP, columns

Bounds = tuple[float, float]

MOST = 6  # scales
SHARE = 0.05  # of the fastest scale's velocity: systematic errors of a derivative reach 2 %
APART = 0.5  # in lobes: scales nearer than this are one
TRIED = 2  # lobes of a window, deepest first
RIVALS = 2  # other lobes of each scale, refined in full
PARAMETERS = 17  # of a scale: 16 weights and k


@dataclass(frozen=True)
class Window:
    """Wavenumbers low...high [1/m] that a candidate at k proposes to look in."""

    wavenumber: float
    low: float
    high: float


@dataclass(frozen=True, eq=False)
class Search:
    """What the search for scales knows: centred rows, the bounds of k, and how errors behave."""

    phi: Array
    lobes: Lobes
    correlation: float

    @property
    def position(self) -> Array:
        """Centred positions (m, 2) [m]."""
        return self.lobes.position

    @property
    def bounds(self) -> Bounds:
        """Of the wavenumber [1/m]."""
        return self.lobes.bounds

    @property
    def extent(self) -> float:
        """The larger side of the flight's bounding box [m]."""
        return STEP / self.lobes.step

    @property
    def lobe(self) -> float:
        """The width of a lobe of the residual [1/m]."""
        return 2 * math.pi / self.extent

    def descend(self, wavenumbers: Array, *, rough: bool = True) -> JointFit:
        """All scales moved to the least RSS; rough: to a thousandth of a scan step."""
        tolerance = ROUGH * STEP / self.extent if rough else 0.0
        return descend(self.position, self.phi, wavenumbers, self.bounds, tolerance)

    @property
    def lobe_count(self) -> float:
        """How many lobes there are between the bounds."""
        return max(1.0, (self.bounds[1] - self.bounds[0]) / self.lobe)

    def evidence(self, without: float, residual: float) -> float:
        """2 ln(likelihood ratio) of RSS = residual to RSS = without."""
        floor = 1e-15 * float(np.sum(self.phi**2))  # of residuals, by rounding
        ratio = max(without, floor) / max(residual, floor)
        return 2 * len(self.phi) * math.log(ratio) / self.correlation

    def by_chance(self, parameters: int) -> float:
        """What evidence for so many parameters reaches by chance in one flight of 1000."""
        from scipy.special import chdtri

        return float(chdtri(parameters, FALSE_ALARM / self.lobe_count))


@dataclass(frozen=True, eq=False)
class Found:
    """Scales so far and the window that each came from."""

    fit: JointFit
    windows: tuple[Window, ...] = field(default=())


def gathered(search: Search, peaks: tuple[Window, ...], windows: tuple[Window, ...]) -> Found:
    """Scales from the peaks, strongest first, then from every other group with a weight."""
    found = Found(fit_at(search.position, search.phi, np.empty(0)))
    for peak in peaks[:MOST]:
        more = _joined(search, found, (peak,))
        found = found if more is None else _settled(search, more, windows)
    if not found.windows:  # no lobe in any window: the strongest candidate itself
        found = Found(search.descend(np.array([peaks[0].wavenumber])), peaks[:1])
    while len(found.windows) < MOST:
        more = _joined(search, found, _unspent(windows, found))
        if more is None:
            break
        found = _settled(search, more, windows)
    return found


def _unspent(windows: tuple[Window, ...], found: Found) -> tuple[Window, ...]:
    """A window gives one scale."""
    return tuple(one for one in windows if one not in found.windows)


def _joined(search: Search, found: Found, windows: tuple[Window, ...]) -> Found | None:
    """One scale more, from the deepest lobe in the windows; None where none is worth it."""
    best: Found | None = None
    for k, window in _places(search, found.fit.rest, windows, found.fit.wavenumbers):
        fit = search.descend(np.append(found.fit.wavenumbers, k))
        separate = _separate(search, fit.wavenumbers)
        if separate and (best is None or fit.residual < best.fit.residual):
            best = Found(fit, (*found.windows, window))
    if best is None or not found.windows:
        return best
    gain = search.evidence(found.fit.residual, best.fit.residual)
    return best if gain > search.by_chance(PARAMETERS) else None


def _settled(search: Search, found: Found, windows: tuple[Window, ...]) -> Found:
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
                found = Found(fit, changed)
    return found


def _places(
    search: Search, rest: Array, windows: tuple[Window, ...], taken: Array
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


def _apart(search: Search, wavenumbers: Array, one: float) -> bool:
    return bool(np.all(np.abs(wavenumbers - one) >= APART * search.lobe))


def _separate(search: Search, wavenumbers: Array) -> bool:
    return bool(np.all(np.diff(np.sort(wavenumbers)) >= APART * search.lobe))


def _contribution(search: Search, fit: JointFit, j: int) -> Array:
    value, _ = columns(search.position, float(fit.wavenumbers[j]))
    own: Array = value @ fit.weights[j]
    return own


def pruned(search: Search, found: Found) -> Found:
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
        found = Found(search.descend(kept), windows)
    return found


def _without(search: Search, found: Found, j: int) -> JointFit:
    return fit_at(search.position, search.phi, np.delete(found.fit.wavenumbers, j))


def doubt(search: Search, found: Found) -> tuple[str, float]:
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
    left = pruned(search, _joined(search, found, (Window(0.0, *search.bounds),)) or found)
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


def _rival(search: Search, fit: JointFit, j: int) -> tuple[float, float] | None:
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
