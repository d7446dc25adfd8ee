"""Panels of a figure: curves with one style per name, under one legend."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np

from sparsefit.arrays import Array
from sparsefit.plot import style
from sparsefit.plot.style import COLOURS, GREY, MARKERS, STYLES
from sparsefit.study.measures import TINY

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Ranks: TypeAlias = Mapping[str, float]  # a legend has the curves of smallest rank
NAMED_CURVES = 10  # curves in a legend; others are grey, unless there is only one more
LOG_RANGE = 8.0  # largest over smallest, from which an axis is logarithmic


class Curve(NamedTuple):
    """Points (p,) of a line, and the ends (2, p) of their intervals if known."""

    name: str
    x: Array
    y: Array
    bars: Array | None = None

    @property
    def points(self) -> tuple[str, ...]:
        """The coordinates to three digits; curves with equal ones are drawn once."""
        return tuple(f"{value:.2e}" for value in (*self.x, *self.y))


@dataclass(eq=False)
class Panel:
    """A pair of axes with its curves and labels.

    style: arguments of `plot` that replace those of the curve; x_range, y_range: limits of the
    axes, by default those of the data; log: the logarithmic axes, `xy`; levels: names of x = 0, 1,
    ..., or the numbers on the x axis; marks: dashed lines, each an axis and a value; is_share:
    whether y is a share [%], whose intervals are within the limits.
    """

    curves: list[Curve]
    x_label: str
    y_label: str
    title: str = ""
    style: Mapping[str, Any] = field(default_factory=dict)
    x_range: tuple[float, float] | None = None
    y_range: tuple[float, float] | None = None
    log: str = ""
    levels: Sequence[str] | Array = ()
    marks: Sequence[tuple[str, float]] = ()
    is_share: bool = False

    @property
    def names(self) -> list[str]:
        """The names of x = 0, 1, ...; empty for a numeric axis."""
        return [] if isinstance(self.levels, np.ndarray) else list(self.levels)

    def bars_of(self, curve: Curve) -> Array | None:
        """Return the intervals to draw: on an axis of names, or of at most four curves."""
        return curve.bars if self.names or len(self.curves) <= 4 else None

    @property
    def heights(self) -> Array:
        """The finite y values of curves and drawn intervals, and the marks of shares."""
        bars = [self.bars_of(curve) for curve in self.curves]
        parts = [curve.y for curve in self.curves]
        parts += [each.ravel() for each in bars if each is not None]
        parts += [np.array([value for _, value in self.marks if self.is_share])]
        every = np.concatenate(parts)
        return np.asarray(every[np.isfinite(every)])

    def draw(self, axes: Axes, words: Mapping[str, str | None]) -> None:
        """Draw the curves; `words` has the legend of each, None for a grey one."""
        names = list(words)
        others = [curve for curve in self.curves if words[curve.name] is None]
        named = self.curves[: len(self.curves) - len(others)]
        drawn = np.array([np.isfinite(curve.y) for curve in named]) if self.names else None
        for order, curve in enumerate(named):
            place, x, bars = names.index(curve.name), curve.x, self.bars_of(curve)
            turn, colour = divmod(place, len(COLOURS))
            look: dict[str, Any] = {
                "color": COLOURS[colour], "lw": 1.2, "mew": 0, "ms": 3.5,
                "marker": MARKERS[(colour + turn) % len(MARKERS)], **self.style,
                "gid": f"line-{place}", "zorder": 3,
            }  # fmt: skip
            # Without markers, lines are told apart in grey by their dashes.
            look.setdefault("ls", STYLES[(turn if look["marker"] else place) % len(STYLES)])
            if look["ls"] == "":
                look["marker"] = look["marker"] or "."
                if drawn is not None:  # side by side at each level
                    count = np.maximum(drawn.sum(axis=0), 1)
                    x = x + 0.5 * ((drawn[:order].sum(axis=0) + 0.5) / count - 0.5)
            if bars is not None:
                axes.vlines(x, *bars, color=look["color"], lw=0.8, alpha=0.7, gid=look["gid"])
            axes.plot(x, curve.y, **look, label=words[curve.name])
        if others:  # one line with gaps
            gap, look = np.array([np.nan]), {"ls": "-", **self.style}
            x, y = (np.concatenate([part for curve in others for part in (curve[at], gap)])
                    for at in (1, 2))  # fmt: skip
            look |= {"color": GREY, "lw": 0.6, "alpha": 0.6, "ms": 3.0, "mew": 0, "zorder": 2}
            look["marker"] = "." if look["ls"] == "" else ""
            hidden = list(words.values()).count(None)
            axes.plot(x, y, **look, gid="line-others", label=f"{hidden} others")
        if not self.heights.size:
            axes.text(0.5, 0.5, "no answer", transform=axes.transAxes, ha="center", color=GREY)
        for axis, value in self.marks:
            line = axes.axvline if axis == "x" else axes.axhline
            line(value, color=GREY, lw=0.8, ls="--", zorder=1)

    def scale(self, axes: Axes, heights: Array, letters: int) -> None:
        """Set limits, scales and ticks for the y values of a row, and `letters` along an axis."""
        if self.names:
            short = list(style.labels(self.names, 34).values())
            is_long = sum(map(len, short)) + 2 * len(short) > letters
            slant: dict[str, Any] = {"rotation": 40, "ha": "right", "rotation_mode": "anchor"}
            if is_long:  # slanted, in one line
                short = list(style.labels(self.names, 48).values())
            axes.set_xticks(range(len(short)), short, **(slant if is_long else {}))
            if self.style.get("ls") == "":
                axes.set_xlim(-0.5, len(short) - 0.5)
            axes.grid(False, axis="x")
        elif len(self.levels):
            style.level_axis(axes, np.asarray(self.levels, dtype=float))
        ends, log = self.y_range, self.log
        if ends is None and heights.size:
            low, high = float(heights.min()), float(heights.max())
            room = 0.08 * (high - low) or 0.1 * abs(low) or 1.0
            ends = low - room, high + room
            if self.is_share:
                ends = max(low - room, -3.0), min(high + room, 103.0)
            elif low >= 0 and high > LOG_RANGE * low:
                low, log = max(low, TINY), f"{log}y"
                room = max(1.4, (high / low) ** 0.06)
                ends = low / room, high * room
        for axis, limits in (("x", self.x_range), ("y", ends)):
            if axis in log:
                axes.set(**{f"{axis}scale": "log"})
                style.logarithmic(getattr(axes, f"{axis}axis"), *(limits or axes.axis()[:2]))
            if limits:
                axes.set(**{f"{axis}lim": limits})


def _named(panels: Sequence[Panel], ranks: Ranks) -> dict[str, str | None]:
    """Return the legend of each curve, by ascending rank; None for a grey curve.

    Curves without points, and curves that coincide with another in all panels, are removed from the
    panels. The legend has the curves of smallest rank.
    """
    by_name: dict[str, dict[int, Curve]] = {}
    for place, panel in enumerate(panels):
        for curve in panel.curves:
            by_name.setdefault(curve.name, {})[place] = curve
    twins: dict[Any, list[str]] = {}
    for name, mine in by_name.items():
        if any(np.isfinite(curve.y).any() for curve in mine.values()):
            key = tuple((place, curve.points) for place, curve in mine.items())
            twins.setdefault(key, []).append(name)
    count = {alike[0]: len(alike) for alike in twins.values()}
    names = list(count)
    if len(names) > NAMED_CURVES or ranks:
        names.sort(key=lambda name: ranks.get(name, np.inf))
    for panel in panels:
        curves = {curve.name: curve for curve in panel.curves}
        panel.curves = [curves[name] for name in names if name in curves]
    named = names if len(names) == NAMED_CURVES + 1 else names[:NAMED_CURVES]
    every = style.labels(names, 52)  # distinct from the grey ones, too
    short = {name: every[name] for name in named}
    more = {name: f" and {size - 1} alike" * (size > 1) for name, size in count.items()}
    return {name: f"{short[name]}{more[name]}" if name in short else None for name in names}


def drawn(grid: Sequence[Sequence[Panel]], height: float,
          ranks: Ranks | None = None) -> Figure | None:  # fmt: skip
    """Return panels as a figure with one legend, or None if no curve has a point.

    Labels that neighbouring panels share are drawn once; a row of panels has one range of y.
    """
    words = _named([panel for row in grid for panel in row], ranks or {})
    if not words:
        return None
    figure, axes_grid = style.panels(len(grid), len(grid[0]), height=height)
    letters = round(100 / 7 * figure.get_figwidth()) // len(grid[0])
    for place, (row, axes_row) in enumerate(zip(grid, axes_grid, strict=True)):
        heights = np.concatenate([panel.heights for panel in row])
        below = grid[place + 1] if place + 1 < len(grid) else None
        for at, (panel, axes) in enumerate(zip(row, axes_row, strict=True)):
            panel.draw(axes, words)
            panel.scale(axes, heights, letters)
            is_last = below is None or below[at].x_label != panel.x_label
            is_first = not at or row[at - 1].y_label != panel.y_label
            axes.set_xlabel(style.wrapped(panel.x_label, letters) if is_last else "")
            axes.set_ylabel(panel.y_label if is_first else "")
            is_alike = is_first or row[at - 1].y_range != panel.y_range
            axes.tick_params(labelbottom=is_last or panel.x_range is not None, labelleft=is_alike)
            is_under = place and grid[place - 1][at].title == panel.title
            axes.set_title("" if is_under else panel.title)
    style.legend(figure, [axes for row in axes_grid for axes in row])
    return figure
