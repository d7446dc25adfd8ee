"""Panels of a picture: curves with one look by name, those that coincide once, under one legend."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sparsefit.arrays import Array
from sparsefit.plot.style import (
    COLOURS,
    GREY,
    MARKERS,
    STYLES,
    labels,
    legend,
    level_axis,
    logarithmic,
    panels,
)
from sparsefit.study.resampling import TINY

Ranks: TypeAlias = Mapping[str, float]  # a legend names the curves of the least
NAMED_CURVES = 10  # curves that a legend names; the rest are grey
LOG_RANGE = 8.0  # largest over smallest, from which an axis is logarithmic


@dataclass(frozen=True, eq=False)
class Curve:
    """Points (p,) of one line, and where they are known the ends (p,) of their intervals."""

    name: str
    x: Array
    y: Array
    bars: Array | None = None

    def coincides(self, other: Curve) -> bool:
        """Whether another curve has the same points."""
        pairs = ((self.x, other.x), (self.y, other.y))
        return self.x.shape == other.x.shape and all(
            np.allclose(*pair, rtol=1e-3, equal_nan=True) for pair in pairs
        )


@dataclass(eq=False)
class Panel:
    """One pair of axes: its curves, its words, and how they are drawn.

    style: arguments of `plot` in place of those of a line's look; x_range, y_range: the axes' ends,
    those of the data unless given; log: the logarithmic axes, `xy`; levels: the names of x = 0, 1,
    ..., or the numbers that x has; marks: dashed lines, each an axis and a value; is_share: whether
    y is a share [%], of which its intervals are shown whole.
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
    def heights(self) -> Array:
        """All finite heights of the curves, and of the intervals and marks of shares."""
        more = [curve.bars.ravel() for curve in self.curves if curve.bars is not None]
        more += [np.array([value for _, value in self.marks])] if self.is_share else []
        every = np.concatenate([np.zeros(0), *more, *(curve.y for curve in self.curves)])
        return np.asarray(every[np.isfinite(every)])


class Looks:
    """A colour, a style and a marker by name; the same names look the same in every panel.

    Curves without a point are taken out of the panels, and so are those that coincide with another
    in all of them; where more are left than a legend takes, it names those of the least rank.
    """

    def __init__(self, panels_: Sequence[Panel], ranks: Ranks) -> None:
        by_name: dict[str, dict[int, Curve]] = {}
        for place, panel in enumerate(panels_):
            for curve in panel.curves:
                by_name.setdefault(curve.name, {})[place] = curve
        twins, self.names = Counter[str](), list[str]()
        for name, mine in by_name.items():
            if not any(np.isfinite(curve.y).any() for curve in mine.values()):
                continue
            alike = (
                other for other in self.names
                if by_name[other].keys() == mine.keys()
                and all(by_name[other][at].coincides(mine[at]) for at in mine)
            )  # fmt: skip
            twin = next(alike, name)
            twins[twin] += 1
            self.names += [name] if twin == name else []
        if len(self.names) > NAMED_CURVES or ranks:
            self.names.sort(key=lambda name: ranks.get(name, np.inf))
        short = labels(self.names, 36) if self.names else {}
        self.words = {
            name: f"{short[name]} and {twins[name] - 1} alike" if twins[name] > 1 else short[name]
            for name in self.names[:NAMED_CURVES]
        }
        for panel in panels_:
            curves = {curve.name: curve for curve in panel.curves}
            panel.curves = [curves[name] for name in self.names if name in curves]

    def grey(self, more: Mapping[str, Any]) -> dict[str, Any]:
        """Return the look of the curves that a legend does not name, and their number."""
        look = {"color": GREY, "ls": "-", "lw": 0.6, "alpha": 0.6, "ms": 3.0, "mew": 0, **more}
        look["marker"] = "." if look["ls"] == "" else ""
        words = f"{len(self.names) - NAMED_CURVES} others"
        return {**look, "gid": "line-others", "label": words, "zorder": 2}

    def of(self, name: str, more: Mapping[str, Any]) -> dict[str, Any]:
        """Return the look, the name in an SVG and the label of a line as arguments of `plot`."""
        place = self.names.index(name)
        colour, turn = place % len(COLOURS), place // len(COLOURS)
        look = {"color": COLOURS[colour], "ls": STYLES[turn % len(STYLES)], "lw": 1.2, "mew": 0,
                "ms": 3.5, "marker": MARKERS[(colour + turn) % len(MARKERS)]}  # fmt: skip
        return {**look, **more, "gid": f"line-{place}", "label": self.words[name], "zorder": 3}


def drawn(grid: Sequence[Sequence[Panel]], height: float,
          ranks: Ranks | None = None) -> Figure | None:  # fmt: skip
    """Return panels as a figure under one legend, or None where no curve has a point.

    Words that a neighbour has too stand once; a row of panels has one range of y.
    """
    looks = Looks([panel for row in grid for panel in row], ranks or {})
    if not looks.names:
        return None
    figure, axes_grid = panels(len(grid), len(grid[0]), height=height)
    for place, (row, axes_row) in enumerate(zip(grid, axes_grid, strict=True)):
        heights = np.concatenate([panel.heights for panel in row])
        below = grid[place + 1] if place + 1 < len(grid) else None
        for at, (panel, axes) in enumerate(zip(row, axes_row, strict=True)):
            _draw(axes, panel, looks, heights)
            is_last = below is None or below[at].x_label != panel.x_label
            is_first = not at or row[at - 1].y_label != panel.y_label
            axes.set_xlabel(panel.x_label if is_last else "")
            axes.set_ylabel(panel.y_label if is_first else "")
            is_alike = is_first or row[at - 1].y_range != panel.y_range
            axes.tick_params(labelbottom=is_last or panel.x_range is not None, labelleft=is_alike)
            is_under = place and grid[place - 1][at].title == panel.title
            axes.set_title("" if is_under else panel.title)
    legend(figure, [axes for row in axes_grid for axes in row])
    return figure


def _draw(axes: Axes, panel: Panel, looks: Looks, heights: Array) -> None:
    """Draw a panel; `heights` are those of its whole row."""
    names = [] if isinstance(panel.levels, np.ndarray) else list(panel.levels)
    count = len(panel.curves)
    others = [curve for curve in panel.curves if curve.name not in looks.words]
    for order, curve in enumerate(panel.curves[: count - len(others)]):
        look, x = looks.of(curve.name, panel.style), curve.x
        if look["ls"] == "":
            look["marker"] = look["marker"] or "."
            x = x + 0.5 * ((order + 0.5) / count - 0.5) if names else x  # side by side
        if curve.bars is not None and (names or count <= 4):
            axes.vlines(x, *curve.bars, color=look["color"], lw=0.8, alpha=0.7, gid=look["gid"])
        axes.plot(x, curve.y, **look)
    if others:  # one line of all, in pieces
        gap = np.array([np.nan])
        axes.plot(
            np.concatenate([part for curve in others for part in (curve.x, gap)]),
            np.concatenate([part for curve in others for part in (curve.y, gap)]),
            **looks.grey(panel.style),
        )
    if not panel.heights.size:
        axes.text(0.5, 0.5, "no answer", transform=axes.transAxes, ha="center", color=GREY)
    for axis, value in panel.marks:
        line = axes.axvline if axis == "x" else axes.axhline
        line(value, color=GREY, lw=0.8, ls="--", zorder=1)
    if names:
        short = list(labels(names, 28).values())
        many = len(short) > 4 or any(len(text) > 14 for text in short)
        slant: dict[str, Any] = {"rotation": 40, "ha": "right", "rotation_mode": "anchor"}
        axes.set_xticks(range(len(short)), short, **(slant if many else {}))
        axes.grid(False, axis="x")
    elif len(panel.levels):
        level_axis(axes, np.asarray(panel.levels, dtype=float))
    ends, log = panel.y_range, panel.log
    if ends is None and heights.size:
        low, high = float(heights.min()), float(heights.max())
        room = 0.08 * (high - low) or 0.1 * abs(low) or 1.0
        ends = low - room, high + room
        if panel.is_share:
            ends = max(low - room, -3.0), min(high + room, 103.0)
        elif low >= 0 and high > LOG_RANGE * low:
            ends, log = (max(low, TINY) / 1.4, 1.4 * high), f"{log}y"
    for axis, limits in (("x", panel.x_range), ("y", ends)):
        if axis in log:
            axes.set(**{f"{axis}scale": "log"})
            logarithmic(getattr(axes, f"{axis}axis"), *(limits or axes.axis()[:2]))
        if limits:
            axes.set(**{f"{axis}lim": limits})
