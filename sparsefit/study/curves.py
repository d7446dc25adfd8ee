"""Curves of pictures: one look by name in all panels, and those that coincide drawn once."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sparsefit.arrays import Array
from sparsefit.errors import InputError, suggestion
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
    with_unit,
    wrapped,
)
from sparsefit.study.entries import Entry, factor_words, grouped, level_text, sort_levels
from sparsefit.study.measures import PARAMETERS, UNITS, Measure, factors, in_still_air
from sparsefit.study.statistics import TINY, wilson
from sparsefit.study.table import plain

NAMED_CURVES = 10  # curves that a legend names; the rest are grey
PANELS = 6  # rows of panels, with more nobody reads a picture
MOST_POINTS = 300  # of one curve
LETTERS = 44  # of a name in a legend
LOG_RANGE = 8.0  # largest over smallest, from which an axis is logarithmic
UNIT_OF = {
    **{"duration": "s", "sample_rate": "Hz", "windows": "s", "gap_duration": "s"},
    **{"process_noise": "m/s²", "thrust_acceleration": "m/s²", "velocity_noise": "m/s"},
    **{"position_noise": "m", "measurement_noise": "m/s / m", "wind": "m/s"},
    **{"turbulence_length": "m", "heading": "rad", "lower": "m", "upper": "m", "step": "m"},
    **{name: UNITS[name] for name in PARAMETERS},
}


@dataclass(frozen=True, eq=False)
class Curve:
    """Points (p,) of one line, and where they are known the ends (p,) of their intervals."""

    name: str
    x: Array
    y: Array
    low: Array | None = None
    high: Array | None = None

    def coincides(self, other: Curve) -> bool:
        """Whether another curve has the same points."""
        return self.x.shape == other.x.shape and all(
            np.allclose(first, second, rtol=1e-3, equal_nan=True)
            for first, second in ((self.x, other.x), (self.y, other.y))
        )


class Looks:
    """A colour, a style and a marker by name; the same names look the same in every panel."""

    def __init__(self, names: Sequence[str]) -> None:
        self.names = list(dict.fromkeys(names))
        self.short = labels(self.names, LETTERS) if self.names else {}
        self.alike: dict[str, str] = {}

    def of(self, name: str) -> dict[str, Any]:
        """Return the look of a line as arguments of `plot`."""
        place = self.names.index(name)
        if place >= NAMED_CURVES:
            return {"color": GREY, "ls": "-", "lw": 0.6, "alpha": 0.6, "marker": "", "zorder": 2}
        colour, turn = place % len(COLOURS), place // len(COLOURS)
        return {"color": COLOURS[colour], "ls": STYLES[turn % len(STYLES)], "lw": 1.2,
                "marker": MARKERS[(colour + turn) % len(MARKERS)], "zorder": 3}  # fmt: skip

    def gid(self, name: str) -> str:
        """Return the name of a line in an SVG; the grey ones share one."""
        place = self.names.index(name)
        return f"line-{place}" if place < NAMED_CURVES else "line-others"

    def label(self, name: str) -> str:
        """Return what a legend calls a line, and how many coincide with it."""
        if self.names.index(name) >= NAMED_CURVES:
            return f"{len(self.names) - NAMED_CURVES} others"
        count = sum(other == name for other in self.alike.values())
        return f"{self.short[name]}{f' and {count} alike' if count else ''}"

    def merge(
        self, panels_: Sequence[Sequence[Curve]], ranks: Mapping[str, float]
    ) -> list[list[Curve]]:
        """Return the curves of all panels without a point, or that coincide with an earlier one.

        Args:
            ranks: by which the curves that a legend names are chosen where they are too many.
        """
        by_name: dict[str, dict[int, Curve]] = {}
        for place, curves in enumerate(panels_):
            for curve in curves:
                by_name.setdefault(curve.name, {})[place] = curve
        kept: list[str] = []
        for name in self.names:
            mine = by_name.get(name)
            if mine is None or not any(np.isfinite(curve.y).any() for curve in mine.values()):
                continue
            twin = next((
                other for other in kept
                if by_name[other].keys() == mine.keys()
                and all(by_name[other][at].coincides(mine[at]) for at in mine)
            ), None)  # fmt: skip
            if twin is None:
                kept.append(name)
            else:
                self.alike[name] = twin
        if len(kept) > NAMED_CURVES:
            kept.sort(key=lambda name: ranks.get(name, np.inf))
        self.names = kept
        return [
            sorted((each for each in curves if each.name in kept), key=lambda c: kept.index(c.name))
            for curves in panels_
        ]


def lines(entry: Entry, cases: pd.DataFrame) -> Figure | None:
    """Draw measures along a factor, a line per value of `lines`, a row of panels per measure.

    Without `along` every swept number is an axis; `columns`: a factor with a column of panels per
    level; `rows`: one with a row per level. What is neither is pooled.
    """
    axes_of = [entry.along] if entry.along else numeric_factors(cases)
    line = entry.lines
    if entry.along == "condition" and cases["condition"].nunique() < 2:
        axes_of, line = [line], "condition"
    if not axes_of:
        raise InputError("along = …: no number is swept; name a column, such as condition")
    for name in (*axes_of, line, *entry.rows, *([entry.columns] if entry.columns else [])):
        if name not in cases:
            raise InputError(f'no "{name}" in the cases{suggestion(name, map(str, cases.columns))}')
    down = [
        (along, each, key, places)
        for along in axes_of
        for each in entry.measures
        for key, places in (grouped(cases, entry.rows) if entry.rows else [((), None)])
    ][:PANELS]
    across = sort_levels(cases, entry.columns) if entry.columns else [""]
    texts = cases[entry.columns].map(lambda v: level_text(plain(v))) if entry.columns else None
    every: list[list[Curve]] = []
    for along, each, _, places in down:
        part = cases if places is None else cases.iloc[places]
        for level in across:
            here = part if texts is None else part[texts.loc[part.index] == level]
            every.append(list(_along(here, along, each, line, sort_levels(cases, along))))
    looks = Looks([str(name) for name in cases[line].unique()])
    if not any(np.isfinite(curve.y).any() for curves in every for curve in curves):
        return None
    ranks = {
        curve.name: float(np.nanmean(np.where(np.isfinite(curve.y), curve.y, np.nan)))
        for curve in every[0] if np.isfinite(curve.y).any()
    }  # fmt: skip
    drawn = iter(looks.merge(every, ranks))
    figure, grid = panels(len(down), len(across), height=1.0 + 2.1 * len(down))
    for place, ((along, each, key, _), row) in enumerate(zip(down, grid, strict=True)):
        for level, axes in zip(across, row, strict=True):
            _draw(axes, next(drawn), looks, each, cases, along, entry.limits)
            if place + 1 < len(down) and down[place + 1][0] == along:
                axes.tick_params(labelbottom=False)
            if level and not place:
                axes.set_title(f"{factor_words(entry.columns)} {level}")
        _alike(row, each)
        words = [heading(each), *map(level_text, key)]
        row[0].set_ylabel("\n".join(wrapped(text, 24) for text in words))
        for axes in row if place == len(down) - 1 or down[place + 1][0] != along else ():
            unit = UNIT_OF.get(along.rpartition(".")[2], "")
            axes.set_xlabel(with_unit(factor_words(along), unit))
    legend(figure, [axes for row in grid for axes in row])
    return figure


def heading(each: Measure) -> str:
    """Return a measure as an axis names it, `median |error| τ_w [%]`."""
    summary = "" if each.summary in ("share", "number") else f"{each.summary} "
    return with_unit(f"{summary}{each.heading or each.words}", each.unit)


def numeric_factors(cases: pd.DataFrame) -> list[str]:
    """Return the swept factors whose every level is a number."""
    return [name for name in factors(cases) if pd.api.types.is_numeric_dtype(cases[name])]


def _along(
    cases: pd.DataFrame, along: str, each: Measure, line: str, levels: Sequence[str]
) -> Iterator[Curve]:
    """Give the summaries of a measure at the levels of a factor, shares with Wilson's interval."""
    values = each.values(cases)
    at = cases[along].map(lambda value: level_text(plain(value))).to_numpy(dtype=object)
    for (name,), places in grouped(cases, [line]):
        summaries = np.full((3, len(levels)), np.nan)
        for place, level in enumerate(levels):
            here = values[places[at[places] == level]]
            finite = here[~np.isnan(here)]
            if not finite.size:
                continue
            summaries[0, place] = float(each.reduce(here))
            if each.summary == "share":
                summaries[1:, place] = wilson(float(finite.sum()), len(finite))
        summaries[~np.isfinite(summaries)] = np.nan
        numeric = pd.api.types.is_numeric_dtype(cases[along])
        x = np.array([float(level) for level in levels] if numeric else range(len(levels)), float)
        share = each.summary == "share"
        yield Curve(str(name), x, summaries[0], *(summaries[1:] if share else (None, None)))


def _draw(axes: Axes, curves: Sequence[Curve], looks: Looks, each: Measure, cases: pd.DataFrame,
          along: str, limits: Sequence[float]) -> None:  # fmt: skip
    """Draw the curves of one panel, wider where later ones may lie upon them."""
    named = not pd.api.types.is_numeric_dtype(cases[along])
    nominal = "." not in along  # its levels have no order, and no line joins them
    for order, curve in enumerate(curves):
        look = looks.of(curve.name)
        x = curve.x + (0.5 * ((order + 0.5) / len(curves) - 0.5) if nominal else 0.0)
        if nominal:
            look |= {"ls": "", "marker": look["marker"] or "."}
        gid = looks.gid(curve.name)
        if curve.low is not None and curve.high is not None and (nominal or len(curves) <= 4):
            axes.vlines(x, curve.low, curve.high, color=look["color"], lw=0.8, alpha=0.7, gid=gid)
        axes.plot(x, curve.y, ms=3.5, mew=0, gid=gid, label=looks.label(curve.name), **look)
    if not any(np.isfinite(curve.y).any() for curve in curves):
        axes.text(0.5, 0.5, "no answer", transform=axes.transAxes, ha="center", color=GREY)
    for limit in limits:
        axes.axhline(limit, color=GREY, lw=0.9, ls="--", zorder=1)
    if each.name.endswith("efficiency"):
        axes.axhline(1.0, color="black", lw=1.0, zorder=4, label="Cramér-Rao bound")
    if named:
        short = labels(sort_levels(cases, along), 28)
        axes.set_xticks(range(len(short)), list(short.values()))
        many = len(short) > 4 or any(len(text) > 14 for text in short.values())
        axes.tick_params(axis="x", rotation=40 if many else 0)
        for text in axes.get_xticklabels() if many else ():
            text.set_horizontalalignment("right")
            text.set_rotation_mode("anchor")
        axes.grid(False, axis="x")
    else:
        level_axis(axes, cases[along].to_numpy(float))


def _alike(row: Sequence[Axes], each: Measure) -> None:
    """Give the y axes of a row one range, logarithmic where the values span it."""
    heights = np.concatenate([
        np.asarray(line.get_ydata(), dtype=float)
        for axes in row for line in axes.lines if line.get_gid()
    ])  # fmt: skip
    heights = heights[np.isfinite(heights)]
    if each.summary == "share":
        tops = [axes.get_ylim() for axes in row]
        low = max(min(bottom for bottom, _ in tops), -3.0)
        high = min(max(top for _, top in tops), 103.0)
        for axes in row:
            axes.set_ylim(low, high)
    elif heights.size and heights.min() >= 0 and heights.max() > LOG_RANGE * heights.min():
        low = max(float(heights.min()), TINY if each.least else 1e-12) / 1.4
        for axes in row:
            axes.set_yscale("log")
            axes.set_ylim(low, 1.4 * float(heights.max()))
            logarithmic(axes.yaxis, low, 1.4 * float(heights.max()))
    elif heights.size:
        room = 0.08 * float(np.ptp(heights)) or 0.1 * abs(float(heights[0])) or 1.0
        for axes in row:
            axes.set_ylim(float(heights.min()) - room, float(heights.max()) + room)
    for axes in row[1:]:
        axes.tick_params(labelleft=False)


def ecdf(entry: Entry, cases: pd.DataFrame) -> Figure | None:
    """Draw the share of cases with at most so much of each measure, failures in the share."""
    every: list[list[Curve]] = []
    for each in entry.measures:
        values, drawn_here = np.abs(each.read(cases)), []
        planned = ~in_still_air(cases)
        for (name,), places in grouped(cases, [entry.lines]):
            here = places[planned[places]]
            sizes = np.sort(values[here][np.isfinite(values[here])])
            if sizes.size:
                share = 100.0 * np.arange(1, sizes.size + 1) / len(here)
                if sizes.size > MOST_POINTS:  # an eye sees no more steps
                    places_ = np.linspace(0, sizes.size - 1, MOST_POINTS).astype(int)
                    sizes, share = sizes[places_], share[places_]
                drawn_here.append(Curve(str(name), np.maximum(sizes, each.least or 1e-300), share))
        every.append(drawn_here)
    if not any(every):
        return None
    looks = Looks([str(name) for name in cases[entry.lines].unique()])
    ranks = {
        curve.name: float(curve.x[np.searchsorted(curve.y, 50.0)])
        for curve in every[0] if curve.y[-1] >= 50.0
    }  # fmt: skip
    drawn = looks.merge(every, ranks)
    figure, (row,) = panels(1, len(every), height=3.6)
    for axes, each, curves in zip(row, entry.measures, drawn, strict=True):
        axes.set_xscale("log")
        for curve in curves:
            look = looks.of(curve.name) | {"marker": ""}
            axes.plot(curve.x, curve.y, drawstyle="steps-post", label=looks.label(curve.name),
                      gid=looks.gid(curve.name), **look)  # fmt: skip
        every_x = np.concatenate([curve.x for curve in curves])
        low = max(float(np.quantile(every_x, 0.01)), each.least)
        high = float(np.quantile(every_x, 0.98))
        axes.set_xlim(low / 1.5, max(high * 1.5, low * 10))
        logarithmic(axes.xaxis, *axes.get_xlim())
        axes.set_ylim(0, 102)
        axes.set_xlabel(with_unit(wrapped(each.words, 34), each.unit))
        for limit in entry.limits:
            axes.axvline(limit, color=GREY, lw=0.8, ls=":")
    row[0].set_ylabel("share of cases [%]")
    legend(figure, row)
    return figure
