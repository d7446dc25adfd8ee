"""The figures of a study: lines along a factor, errors as shares, estimated against true, profiles.

A legend names what is drawn: curves that coincide are one, and where there are more than a legend
takes, the rest are grey. A picture without a mark is a sentence.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
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
    styled,
    with_unit,
    wrapped,
)
from sparsefit.study import solver_times
from sparsefit.study.entries import (
    Entry,
    Options,
    Script,
    factor_words,
    grouped,
    level_text,
    read_entry,
    sort_levels,
)
from sparsefit.study.measures import (
    PARAMETERS,
    SYMBOLS,
    UNITS,
    Measure,
    answered,
    bounded,
    factors,
    in_flow,
    in_still_air,
    measure,
    numbers,
    three,
)
from sparsefit.study.statistics import QUANTILES, TINY, wilson
from sparsefit.study.table import plain

NAMED_CURVES = 10  # curves that a legend names; the rest are grey
PANELS = 6  # rows of panels, with more nobody reads a picture
LETTERS = 44  # of a name in a legend
ROOM = 60.0  # times the median of what is drawn: what lies further leaves a logarithmic frame
LOG_RANGE = 8.0  # largest over smallest, from which an axis is logarithmic
FLOOR = 1e-16  # an excess below it is drawn there
UNIT_OF = {
    **{"duration": "s", "sample_rate": "Hz", "windows": "s", "gap_duration": "s"},
    **{"process_noise": "m/s²", "thrust_acceleration": "m/s²", "velocity_noise": "m/s"},
    **{"position_noise": "m", "measurement_noise": "m/s / m", "wind": "m/s"},
    **{"turbulence_length": "m", "heading": "rad", "lower": "m", "upper": "m", "step": "m"},
    **{UNITS_KEY: UNITS[UNITS_KEY] for UNITS_KEY in PARAMETERS},
}


@dataclass(frozen=True, eq=False)
class Picture:
    """A figure with its caption; without a figure the caption says why there is none."""

    figure: Figure | None
    caption: str


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

    def label(self, name: str) -> str:
        """Return what a legend calls a line, and how many coincide with it."""
        if self.names.index(name) >= NAMED_CURVES:
            return f"{len(self.names) - NAMED_CURVES} others"
        count = sum(other == name for other in self.alike.values())
        return f"{self.short[name]}{f' and {count} alike' if count else ''}"

    def merge(self, panels_: Sequence[Sequence[Curve]]) -> list[list[Curve]]:
        """Return the curves of all panels without those that coincide with an earlier one."""
        by_name: dict[str, dict[int, Curve]] = {}
        for place, curves in enumerate(panels_):
            for curve in curves:
                by_name.setdefault(curve.name, {})[place] = curve
        kept: list[str] = []
        for name in self.names:
            mine = by_name.get(name)
            if mine is None:
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
        self.names = kept
        return [[curve for curve in curves if curve.name in kept] for curves in panels_]


def lines(entry: Entry, cases: pd.DataFrame) -> Figure | None:
    """Draw measures along a factor, a line per value of `lines`, a row of panels per measure.

    Without `along` every swept number is an axis; `columns`: a factor with a column of panels per
    level; `rows`: one with a row per level. What is neither is pooled.
    """
    axes_of = [entry.along] if entry.along else _numeric(cases)
    if not axes_of:
        raise InputError("along = …: no number is swept; name a column, such as condition")
    for name in (*axes_of, entry.lines, *entry.rows, *([entry.columns] if entry.columns else [])):
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
            every.append(list(_along(here, along, each, entry.lines, sort_levels(cases, along))))
    looks = Looks([str(name) for name in cases[entry.lines].unique()])
    if not any(np.isfinite(curve.y).any() for curves in every for curve in curves):
        return None
    drawn = iter(looks.merge(every))
    figure, grid = panels(len(down), len(across), height=1.0 + 2.1 * len(down))
    for place, ((along, each, key, _), row) in enumerate(zip(down, grid, strict=True)):
        for level, axes in zip(across, row, strict=True):
            _draw(axes, next(drawn), looks, each, cases, along, entry.limits)
            if level and not place:
                axes.set_title(f"{factor_words(entry.columns)} {level}")
        _alike(row, each)
        words = [with_unit(each.phrase, each.unit), *map(level_text, key)]
        row[0].set_ylabel("\n".join(wrapped(text, 30) for text in words))
        for axes in row if place == len(down) - 1 or down[place + 1][0] != along else ():
            unit = UNIT_OF.get(along.rpartition(".")[2], "")
            axes.set_xlabel(with_unit(factor_words(along), unit))
    legend(figure, [axes for row in grid for axes in row])
    return figure


def _numeric(cases: pd.DataFrame) -> list[str]:
    return [name for name in factors(cases) if pd.api.types.is_numeric_dtype(cases[name])]


def _along(
    cases: pd.DataFrame, along: str, each: Measure, line: str, levels: Sequence[str]
) -> Iterator[Curve]:
    """Give the summaries of a measure at the levels of a factor, shares with Wilson's interval."""
    values = each.values(cases)
    at = cases[along].map(lambda value: level_text(plain(value))).to_numpy(dtype=object)
    for (name,), places in grouped(cases, [line]):
        told = np.full((3, len(levels)), np.nan)
        for place, level in enumerate(levels):
            here = values[places[at[places] == level]]
            known = here[~np.isnan(here)]
            if not known.size:
                continue
            told[0, place] = float(each.reduce(here))
            if each.summary == "share":
                told[1:, place] = wilson(float(known.sum()), len(known))
        told[~np.isfinite(told)] = np.nan
        numeric = pd.api.types.is_numeric_dtype(cases[along])
        x = np.array([float(level) for level in levels] if numeric else range(len(levels)), float)
        share = each.summary == "share"
        yield Curve(str(name), x, told[0], *(told[1:] if share else (None, None)))


def _draw(axes: Axes, curves: Sequence[Curve], looks: Looks, each: Measure, cases: pd.DataFrame,
          along: str, limits: Sequence[float]) -> None:  # fmt: skip
    """Draw the curves of one panel, wider where later ones may lie upon them."""
    named = not pd.api.types.is_numeric_dtype(cases[along])
    for order, curve in enumerate(curves):
        look = looks.of(curve.name)
        x = curve.x + (0.5 * ((order + 0.5) / len(curves) - 0.5) if named else 0.0)
        if named:
            look |= {"ls": "", "marker": look["marker"] or "."}
        gid = f"line-{looks.names.index(curve.name)}"
        if curve.low is not None and curve.high is not None and (named or len(curves) <= 4):
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
        values, told = np.abs(each.read(cases)), []
        planned = ~in_still_air(cases)
        for (name,), places in grouped(cases, [entry.lines]):
            here = places[planned[places]]
            known = np.sort(values[here][np.isfinite(values[here])])
            if known.size:
                share = 100.0 * np.arange(1, known.size + 1) / len(here)
                told.append(Curve(str(name), np.maximum(known, each.least or 1e-300), share))
        every.append(told)
    if not any(every):
        return None
    looks = Looks([str(name) for name in cases[entry.lines].unique()])
    drawn = looks.merge(every)
    figure, (row,) = panels(1, len(every), height=3.6)
    for axes, each, curves in zip(row, entry.measures, drawn, strict=True):
        axes.set_xscale("log")
        for curve in curves:
            look = looks.of(curve.name) | {"marker": ""}
            axes.plot(curve.x, curve.y, drawstyle="steps-post", label=looks.label(curve.name),
                      gid=f"line-{looks.names.index(curve.name)}", **look)  # fmt: skip
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


def best_titles(cases: pd.DataFrame) -> list[str]:
    """Return the title of least median of the largest error in each reading, four at most."""
    each, best = measure("largest-error"), []
    groups = ["reading"] if "reading" in cases else ["protocol"]
    for _, places in grouped(cases, groups):
        part = cases.iloc[places]
        scores = {
            str(title): each.summarise(part.iloc[here])
            for (title,), here in grouped(part, ["title"])
        }
        best.append(min(scores, key=lambda name: (math.isnan(scores[name]), scores[name])))
    return list(dict.fromkeys(best))[:4]


def scatter(entry: Entry, cases: pd.DataFrame) -> Figure | None:
    """Draw estimated against true parameters, of the best candidate of each reading.

    Colours are conditions. What lies outside of the frame is a triangle on its edge, a failure a
    cross, each counted.
    """
    flown = cases[in_flow(cases)]
    titles = best_titles(flown) if len(flown) else []
    if not titles or not answered(flown).any():
        return None
    names = list(map(str, flown["condition"].unique()))
    if len(names) > NAMED_CURVES:
        flown, names = flown.assign(condition="all conditions"), ["all conditions"]
    looks = Looks(names)
    figure, grid = panels(len(titles), 3, height=0.9 + 2.15 * len(titles))
    short = labels(titles, 60)
    for title, row in zip(titles, grid, strict=True):
        part = flown[flown["title"] == title]
        for name, axes in zip(PARAMETERS, row, strict=True):
            _scattered(axes, part, name, looks)
            axes.set_ylabel(f"estimated {SYMBOLS[name]} [{UNITS[name]}]")
        row[0].set_ylabel(f"{wrapped(short[title], 30)}\n\n{row[0].get_ylabel()}")
    for name, axes in zip(PARAMETERS, grid[-1], strict=True):
        axes.set_xlabel(f"true {SYMBOLS[name]} [{UNITS[name]}]")
    if len(names) > 1:
        legend(figure, [axes for row in grid for axes in row])
    return figure


def _scattered(axes: Axes, cases: pd.DataFrame, name: str, looks: Looks) -> None:
    true, estimate = numbers(cases, f"true_{name}"), numbers(cases, f"est_{name}")
    low, high = float(np.nanmin(true)), float(np.nanmax(true))
    if low > 0 and high / low > LOG_RANGE:
        axes.set_xscale("log")
        axes.set_yscale("log")
        low, high = low / 2.0, high * 2.0
        logarithmic(axes.xaxis, low, high)
        logarithmic(axes.yaxis, low, high)
    else:
        room = 0.3 * (high - low) or 0.5 * abs(high) or 1.0
        low, high = low - room if low < 0 else max(low - room, 0.0), high + room
    axes.plot([low, high], [low, high], color=GREY, lw=0.8, zorder=1)
    axes.set_xlim(low, high)
    axes.set_ylim(low, high)
    axes.set_aspect("equal", adjustable="box")
    known = answered(cases)
    above, below = known & (estimate > high), known & (estimate < low)
    parts = (
        ("o", known & ~above & ~below, None, ""),
        ("^", above, 0.975, "▲ {} above"), ("v", below, 0.025, "▼ {} below"),
        ("x", ~known, 0.09, "× {} failed"),
    )  # fmt: skip
    for condition in looks.names:
        mine = (cases["condition"] == condition).to_numpy()
        ink = looks.of(condition)["color"]
        for sign, mask, height, _ in parts:
            chosen = mask & mine
            edge = axes.get_xaxis_transform()  # on the frame itself, whatever its scale
            more: dict[str, Any] = {"transform": edge, "clip_on": False, "linewidth": 0.8}
            if height is None:
                more = {"edgecolor": "white", "linewidth": 0.3, "label": looks.label(condition)}
            y = estimate[chosen] if height is None else np.full(int(chosen.sum()), height)
            axes.scatter(true[chosen], y, s=12, marker=sign, c=ink, alpha=0.85, zorder=3,
                         gid=f"line-{looks.names.index(condition)}", **more)  # fmt: skip
    words = [text.format(int(mask.sum())) for _, mask, _, text in parts if text and mask.any()]
    axes.set_title("  ".join(words), fontsize=6.5, color=GREY, loc="right", pad=5)


def solver_profiles(entry: Entry, cases: pd.DataFrame) -> Figure | None:
    """Draw the share of problems solved in at most so many times the fastest solver's time.

    A row per objective, a column per accuracy (Dolan and More, 2002).
    """
    levels, rows = solver_times.accuracies(cases), solver_times.objectives(cases)[:PANELS]
    figure, grid = panels(len(rows), len(levels), height=1.2 + 2.0 * len(rows))
    looks = Looks(_ranked(cases))
    for objective, row in zip(rows, grid, strict=True):
        for level, axes in zip(levels, row, strict=True):
            times = solver_times.times_to(cases, objective, level)
            ratios = times.ratios
            finite = ratios[np.isfinite(ratios)]
            end = max(float(finite.max(initial=1.0)) * 1.5, 10.0)
            for place in reversed(times.order):
                inside = np.sort(ratios[np.isfinite(ratios[:, place]), place])
                if not inside.size:
                    continue
                x = np.concatenate([[1.0], inside, [end]])
                share = np.arange(len(inside) + 1) / len(ratios)
                name = times.solvers[place]
                axes.plot(x, np.append(share, share[-1]), drawstyle="steps-post",
                          gid=f"line-{looks.names.index(name)}", label=looks.label(name),
                          **(looks.of(name) | {"marker": ""}))  # fmt: skip
            axes.set_xscale("log")
            axes.set_xlim(1.0, end)
            logarithmic(axes.xaxis, 1.0, end)
            axes.set_ylim(-0.03, 1.03)
            axes.set_title(f"to {solver_times.level_text(level)}")
            axes.tick_params(labelleft=level == levels[0])
        row[0].set_ylabel(f"{wrapped(objective, 26)}\n\nshare of problems")
    for axes in grid[-1]:
        axes.set_xlabel("times the fastest")
    legend(figure, [axes for row in grid for axes in row])
    return figure


def _ranked(cases: pd.DataFrame) -> list[str]:
    """Return the solvers by their place in the objectives, the fastest first."""
    strict, ranks = solver_times.accuracies(cases)[-1], dict[str, int]()
    for objective in solver_times.objectives(cases):
        times = solver_times.times_to(cases, objective, strict)
        for rank, place in enumerate(times.order):
            name = times.solvers[place]
            ranks[name] = min(ranks.get(name, rank), rank)
    return sorted(ranks, key=lambda name: ranks[name])


def solver_accuracy(entry: Entry, cases: pd.DataFrame) -> Figure | None:
    """Draw the time of every case against the certified excess of its worst point."""
    rows = solver_times.objectives(cases)[:PANELS]
    across = min(len(rows), 2)
    figure, grid = panels(
        -(-len(rows) // across), across, height=1.0 + 2.5 * -(-len(rows) // across)
    )
    looks = Looks(_ranked(cases))
    every = [axes for row in grid for axes in row]
    for objective, axes in zip(rows, every, strict=False):
        here = cases[cases["objective"].eq(objective) & cases["excess"].notna()]
        axes.set_xscale("log")
        axes.set_yscale("log")
        for level in solver_times.accuracies(cases):
            axes.axhline(level, color=GREY, lw=0.6, ls=":")
        for (name,), places in grouped(here, ["solver"]):
            look = looks.of(str(name)) | {"ls": ""}
            look["marker"] = look["marker"] or "."
            axes.plot(
                here[solver_times.TIME].to_numpy(float)[places],
                np.clip(here["excess"].to_numpy(float)[places], FLOOR, 1.0), ms=3.0, mew=0,
                gid=f"line-{looks.names.index(str(name))}", label=looks.label(str(name)), **look,
            )  # fmt: skip
        axes.set_ylim(0.3 * FLOOR, 3.0)
        logarithmic(axes.xaxis, *axes.get_xlim())
        logarithmic(axes.yaxis, *axes.get_ylim())
        axes.set_title(objective)
        axes.set_xlabel("time on the wall [s]")
    for axes in every[len(rows) :]:
        axes.set_visible(False)
    for row in grid:
        row[0].set_ylabel("certified excess")
    legend(figure, every[: len(rows)])
    return figure


def by_shape(entry: Entry, cases: pd.DataFrame) -> Figure | None:
    """Draw the time to the strictest accuracy of every solver, problem by problem, by objective."""
    strict, rows = solver_times.accuracies(cases)[-1], solver_times.objectives(cases)[:PANELS]
    figure, grid = panels(len(rows), 1, height=1.6 + 2.2 * len(rows))
    looks = Looks(_ranked(cases))
    for objective, (axes,) in zip(rows, grid, strict=True):
        times = solver_times.times_to(cases, objective, strict)
        for place in times.order:
            name = times.solvers[place]
            seconds = np.where(times.solved[:, place], times.seconds[:, place], np.nan)
            axes.plot(np.arange(len(seconds)), seconds, ms=3.0, mew=0, label=looks.label(name),
                      gid=f"line-{looks.names.index(name)}", **looks.of(name))  # fmt: skip
        axes.set_yscale("log")
        logarithmic(axes.yaxis, *axes.get_ylim())
        axes.set_ylabel(
            f"{wrapped(objective, 26)}\n\ntime to {solver_times.level_text(strict)} [s]"
        )
        axes.set_xticks(range(len(times.problems)), [""] * len(times.problems))
    short = labels(times.problems, 30)
    axes.set_xticks(range(len(short)), list(short.values()), rotation=40, ha="right",
                    rotation_mode="anchor")  # fmt: skip
    legend(figure, [axes for row in grid for axes in row])
    return figure


LAYOUTS: Mapping[str, Callable[[Entry, pd.DataFrame], Figure | None]] = {
    "settings": lines,
    "lines": lines,
    "protocols": lines,
    "ecdf": ecdf,
    "scatter": scatter,
    "profiles": solver_profiles,
    "accuracy": solver_accuracy,
    "shapes": by_shape,
}
ERRORS = three("error")[::-1]
NAMED: Mapping[str, Options] = {
    "scatter": {"compare": "scatter"},
    "errors": {"compare": "ecdf", "measure": three("size"), "limits": (5.0,)},
    "sweep": {"compare": "lines", "measure": ERRORS},
    "methods": {"compare": "lines", "measure": ("timescale-error",),
                "along": "flights.measurement_noise"},
    "efficiency": {"compare": "lines", "along": "flights.process_noise",
                   "measure": three("efficiency")[:2]},
    "scales": {"compare": "lines", "measure": ("scales-found",)},
    "coverage": {"compare": "lines", "along": "condition", "limits": (93.0, 97.0),
                 "measure": three("coverage")},
    "profiles": {"compare": "profiles"},
    "accuracy": {"compare": "accuracy"},
    "shapes": {"compare": "shapes"},
}  # fmt: skip
CAPTIONS = {
    "scatter": "Estimated against true, {titles}. Triangles: outside the frame; crosses: failures.",
    "profiles": "Share of problems solved in at most so many times the time of the fastest solver "
    "of each. Left: how often a solver is the fastest; right: how often it solves at all.",
    "accuracy": "Every case that answered: its time against the certified excess of its worst "
    "point. Dotted: the accuracies at which success is counted.",
    "shapes": "Time to the strictest accuracy, problem by problem; no point: not solved.",
}


def figure(study: Any, entry: str | Options) -> Figure:
    """Return the figure that an entry asks for, of the cases of a study.

    Raises:
        InputError: for what is unknown, or where there is no mark to draw.
    """
    _, picture = _picture(study, entry, study.cases, Script.of(study))
    if picture.figure is None:
        raise InputError(f"{study.name}: {picture.caption}")
    return picture.figure


def _picture(
    study: Any, entry: str | Options, cases: pd.DataFrame, script: Script
) -> tuple[str, Picture]:
    """Return a picture and the name of its file."""
    if isinstance(entry, str) and entry in script.functions:
        made: list[object] = []
        try:
            drawn = styled(lambda: _made(made, script.call(entry, study, cases)))
        except TypeError:
            raise InputError(f"{script.path}: {entry}(cases) returned no figure") from None
        return entry, Picture(drawn, str(getattr(drawn, "caption", "")))
    read = read_entry(entry, NAMED, LAYOUTS, "figure", script)
    name = read.file_name
    marked = styled_or_none(lambda: LAYOUTS[read.compare or "settings"](read, cases))
    if marked is None:
        words = ", ".join(each.words for each in read.measures) or "an answer"
        return name, Picture(None, f"{name}: nothing to draw, no case has {words}.")
    return name, Picture(marked, _caption(read, cases))


def _made(_: list[object], value: object) -> Figure:
    if not isinstance(value, Figure):
        raise TypeError("no figure")
    return value


def styled_or_none(draw: Callable[[], Figure | None]) -> Figure | None:
    """Return a figure drawn in this package's style, None where there is nothing to draw."""
    empty = False

    def drawn() -> Figure:
        nonlocal empty
        made = draw()
        empty = made is None
        return made or Figure()

    result = styled(drawn)
    return None if empty else result


def _caption(entry: Entry, cases: pd.DataFrame) -> str:
    if entry.compare == "scatter":
        count = cases["title"].nunique()
        titles = "; ".join(best_titles(cases[in_flow(cases)]))
        return CAPTIONS["scatter"].format(
            titles=titles if count == 1 else f"the best of {count} by reading: {titles}"
        )
    if entry.compare in CAPTIONS:
        return CAPTIONS[entry.compare]
    words = "; ".join(dict.fromkeys(each.phrase for each in entry.measures))
    if entry.compare == "ecdf":
        words = "; ".join(dict.fromkeys(each.words for each in entry.measures))
        return f"Share of planned cases with at most so much: {words}. Failures never get there."
    failing = [each for each in entry.measures if each.miss is not None]
    ranks = any(each.summary in QUANTILES for each in failing)
    more = " A failure ranks behind every number; where it decides, a line breaks." if ranks else ""
    shares = any(each.summary == "share" for each in entry.measures)
    bars = " Bars: 95 % Wilson intervals." if shares else ""
    return f"{words[:1].upper()}{words[1:]}.{more}{bars}"


def figures(study: Any, cases: pd.DataFrame) -> dict[str, Picture]:
    """Return the pictures that a study asks for, or all that fit, by file name."""
    script = Script.of(study)
    entries = study.definition.outputs.figures or fitting(cases)
    return dict(_picture(study, entry, cases, script) for entry in entries)


def fitting(cases: pd.DataFrame) -> list[str]:
    """Return the names of the figures that have something to show of these cases."""
    if "objective" in cases:
        return ["profiles", "shapes", "accuracy"]
    several = cases["flight"].nunique() > 1 and bool(in_flow(cases).any())
    says = {
        "sweep": several and bool(_numeric(cases)),
        "errors": several,
        "scatter": several,
        "efficiency": bool(bounded(cases).any()) and "flights.process_noise" in factors(cases),
        "coverage": several and np.isfinite(measure("length-scale-coverage").values(cases)).any(),
    }
    return [name for name, holds in says.items() if holds]
