"""The figures of a study: three kinds of figure of the cases, in panels by columns of the frame.

`lines`: measures along a factor; `ecdf`: distribution functions; `scatter`: estimated against true.
Panels hold curves with one style per name, under one legend. Curves that coincide have one entry in
the legend; curves beyond its length are grey. A figure without data is replaced by a sentence.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np
import pandas as pd

from sparsefit.arrays import Array, IntArray
from sparsefit.errors import InputError
from sparsefit.plot import style
from sparsefit.plot.style import COLOURS, GREY, MARKERS, STYLES, with_unit, wrapped
from sparsefit.study import measures, solver_times, tables
from sparsefit.study.columns import PARAMETERS
from sparsefit.study.measures import SYMBOLS, Measure, answered, measure
from sparsefit.study.table import listed, sentence
from sparsefit.study.tables import Entry, Options, factor_words, grouped, level_text, unit_of

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
    axes, by default those of the data; log: the logarithmic axes, `xy`; levels: the numbers on the
    x axis if they are few, and their names if it has no numbers; marks: dashed lines, each an axis
    and a value; is_share: whether y is a share [%], whose intervals are within the limits.
    """

    curves: list[Curve]
    x_label: str
    y_label: str
    title: str = ""
    style: Mapping[str, Any] = field(default_factory=dict)
    x_range: tuple[float, float] | None = None
    y_range: tuple[float, float] | None = None
    log: str = ""
    levels: Sequence[float] | Array = ()
    names: Sequence[str] = ()
    marks: Sequence[tuple[str, float]] = ()
    is_share: bool = False

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
            style.level_axis(axes, np.asarray(self.levels))
        ends, log = self.y_range, self.log
        if ends is None and heights.size:
            low, high = float(heights.min()), float(heights.max())
            room = 0.08 * (high - low) or 0.1 * abs(low) or 1.0
            ends = low - room, high + room
            if self.is_share:
                ends = max(low - room, -3.0), min(high + room, 103.0)
            elif low >= 0 and high > LOG_RANGE * low:
                low, log = max(low, measures.TINY), f"{log}y"
                room = max(1.4, (high / low) ** 0.06)
                ends = low / room, high * room
        for axis, limits in (("x", self.x_range), ("y", ends)):
            if axis in log:
                axes.set(**{f"{axis}scale": "log"})
                style.logarithmic(getattr(axes, f"{axis}axis"), *(limits or axes.axis()[:2]))
            if limits:
                axes.set(**{f"{axis}lim": limits})


def _named(every: Sequence[Panel], ranks: Ranks) -> dict[str, str | None]:
    """Return the legend of each curve, by ascending rank; None for a grey curve.

    Curves without points, and curves that coincide with another in all panels, are removed from the
    panels. The legend has the curves of smallest rank.
    """
    by_name: dict[str, dict[int, Curve]] = {}
    for place, panel in enumerate(every):
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
    for panel in every:
        curves = {curve.name: curve for curve in panel.curves}
        panel.curves = [curves[name] for name in names if name in curves]
    named = names if len(names) == NAMED_CURVES + 1 else names[:NAMED_CURVES]
    labels = style.labels(names, 52)  # distinct from the grey ones, too
    short = {name: labels[name] for name in named}
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
            axes.set_xlabel(wrapped(panel.x_label, letters) if is_last else "")
            axes.set_ylabel(panel.y_label if is_first else "")
            is_alike = is_first or row[at - 1].y_range != panel.y_range
            axes.tick_params(labelbottom=is_last or panel.x_range is not None, labelleft=is_alike)
            is_under = place and grid[place - 1][at].title == panel.title
            axes.set_title("" if is_under else wrapped(panel.title, letters))
    style.legend(figure, [axes for row in axes_grid for axes in row])
    return figure


class Picture(NamedTuple):
    """A figure with its caption; without a figure, the caption gives the reason."""

    figure: Figure | None
    caption: str


def _grid(entry: Entry, cases: pd.DataFrame) -> list[list[tuple[str, str, IntArray]]]:
    """Return the labels of row and column, and the indices of the cases, of each panel.

    The rows of panels are the groups of `rows`, at most six, the columns the levels of `columns`.
    """
    names = [entry.lines, *entry.rows, *filter(None, [entry.columns])]
    tables.check_columns(cases, names, "the figure")

    def words(factor: str, level: Any) -> str:
        text = level_text(level)
        words = f"{factor_words(factor)} {text} {unit_of(factor)}"
        return words.rstrip() if "." in factor else text

    def parts(factors: Sequence[str]) -> list[tuple[str, IntArray]]:
        return [(", ".join(map(words, factors, key)), at) for key, at in grouped(cases, factors)]

    columns = parts([entry.columns] if entry.columns else [])
    return [[(row, title, np.intersect1d(own, places)) for title, places in columns]
            for row, own in parts(entry.rows)[:6]]  # fmt: skip


def _curves(entry: Entry, cases: pd.DataFrame, places: IntArray) -> list[tuple[str, IntArray]]:
    """Return the name of each line of a panel, and the indices of its cases."""
    here = cases.iloc[places]
    return [(str(name), places[at]) for (name,), at in grouped(here, [entry.lines])]


def axes_of(entry: Entry, cases: pd.DataFrame) -> list[str]:
    """Return the columns that lines are drawn along: `along`, or every swept numeric factor.

    Raises:
        InputError: if no number is swept.
    """
    axes = [entry.along] if entry.along else measures.numeric_factors(cases)
    if not axes:
        raise InputError("no number is swept: give along = …, a column such as condition")
    return axes


def lines(entry: Entry, cases: pd.DataFrame, ranks: Ranks | None = None) -> Figure | None:
    """Draw measures along a factor, a line per value of `lines`, a row of panels per measure.

    Levels of `columns` and `rows` have their own panels; all other factors are pooled.
    """
    axes = axes_of(entry, cases)
    tables.check_columns(cases, axes, "the figure")
    if entry.along == "condition" and cases["condition"].nunique() < 2:
        entry = replace(entry, lines="condition")
    seen = np.any([~np.isnan(each.values(cases)) for each in entry.measures], axis=0)
    whole, cases, grid = cases, cases[seen], list[list[Panel]]()
    for along in axes:
        level_of = tables.levels_of(whole, along)[seen].cat.remove_unused_categories()
        codes, levels = level_of.cat.codes.to_numpy(), level_of.cat.categories
        named = () if pd.api.types.is_numeric_dtype(cases[along]) else tuple(levels)
        x = np.array(range(len(levels)) if named else levels, dtype=float)
        x_label = with_unit(factor_words(along), unit_of(along))
        for each in entry.measures:
            values = each.values(cases)
            words = with_unit(each.head + each.heading, each.unit)
            for row in _grid(entry, cases):
                grid.append([
                    Panel(
                        [_along(name, each, values[at], codes[at], x)
                         for name, at in _curves(entry, cases, places)],
                        x_label, "\n".join(wrapped(text, 26) for text in (words, level) if text),
                        title, {} if "." in along else {"ls": ""}, levels=x, names=named,
                        marks=[("y", limit) for limit in entry.limits],
                        is_share=each.summary == "share",
                    )
                    for level, title, places in row
                ])  # fmt: skip
    grid = grid[:6]  # rows of panels
    means = {curve.name: float(np.nanmean(curve.y)) for row in grid[:1] for curve in row[0].curves
             if np.isfinite(curve.y).any()}  # fmt: skip
    slanted = 0.7 if any(row[0].names for row in grid) else 0.0
    return drawn(grid, 0.8 + slanted + 2.1 * len(grid), ranks or means)


def _along(name: str, each: Measure, values: Array, codes: IntArray, x: Array) -> Curve:
    """Return a curve of the summaries at every level, with Wilson intervals of shares."""
    groups = [values[(codes == level) & ~np.isnan(values)] for level in range(len(x))]
    y = np.array([each.summary_of(here) if here.size else np.nan for here in groups])
    y[~np.isfinite(y)] = np.nan
    y[np.abs(y) < each.least] = each.least
    if each.summary != "share":
        return Curve(name, x, y)
    return Curve(
        name, x, y, np.array([measures.wilson(here.sum(), here.size) for here in groups]).T
    )


def ecdf(entry: Entry, cases: pd.DataFrame, ranks: Ranks | None = None) -> Figure | None:
    """Draw the distribution function of the size of each measure over all cases, failures included.

    Each axis ends at the 90 % quantile of the sizes.
    """
    grid, kind = list[list[Panel]](), "problems" if "objective" in cases else "cases"
    for row in _grid(entry, cases):
        grid.append([])
        for (level, title, own), each in itertools.product(row, entry.measures):
            here = cases.iloc[own]
            values, curves, least = np.abs(each.read(here)), list[Curve](), each.least or 1e-300
            finite = values[np.isfinite(values)]
            low, high = np.quantile(finite, (0.01, 0.9)).tolist() if finite.size else (1.0, 1.0)
            low, log = max(low, least), "x"
            ends = low / 1.5, max(1.5 * high, 10.0 * low)
            if each.name == "ratio":  # 1: the fastest
                ends = 1.0, max(1.5 * float(finite.max(initial=1.0)), 10.0)
            elif finite.size and (each.more or finite.max() <= LOG_RANGE * finite.min()):
                room = 0.05 * float(np.ptp(finite)) or 0.1 * high
                ends, log = (float(finite.min()) - room, float(finite.max()) + room), ""
            for name, at in _curves(entry, here, np.flatnonzero(~measures.in_still_air(here))):
                sizes = np.sort(values[at])
                sizes = sizes[np.isfinite(sizes)]
                share = 100.0 * np.arange(1, sizes.size + 1) / len(at)
                if sizes.size > 200:  # enough for a figure
                    seen = np.linspace(0, sizes.size - 1, 200).astype(int)
                    sizes, share = sizes[seen], share[seen]
                if finite.size:  # a line at 0 of a candidate without any answer
                    start, end = min([ends[0], *sizes[:1]]), max([ends[1], *sizes[-1:]])
                    x = np.maximum([start, *sizes, end], least)
                    curves.append(Curve(name, x, np.array([0.0, *share, share.max(initial=0.0)])))
            beside = f"{wrapped(level, 26)}\n\nshare of {kind} [%]".strip()
            grid[-1].append(Panel(
                curves, with_unit(each.words, each.unit), beside, title,
                {"drawstyle": "steps-post", "marker": ""}, ends, (-2.0, 102.0), log,
                marks=[("x", limit) for limit in entry.limits],
            ))  # fmt: skip
    first = [curve for curve in grid[0][0].curves if curve.y[-2] >= 50.0]
    medians = {curve.name: float(curve.x[np.searchsorted(curve.y, 50.0)]) for curve in first}
    return drawn(grid, 3.3 if len(grid) == 1 else 1.0 + 2.0 * len(grid), ranks or medians)


def best_titles(cases: pd.DataFrame) -> list[str]:
    """Return the title with the least median of the largest error in each reading, at most four."""
    each, reading = measure("largest-error"), "reading" if "reading" in cases else "protocol"
    errors = pd.Series(each.values(cases), cases.index)
    scores = errors.groupby([cases[reading], cases["title"]], sort=False).agg(each.summary_of)
    best = scores.fillna(math.inf).groupby(level=0, sort=False).idxmin()
    return list(dict.fromkeys(str(title) for _, title in best))[:4]


def scatter(entry: Entry, cases: pd.DataFrame) -> Figure | None:
    """Draw estimated against true parameters of the best candidate of each reading.

    Colours are conditions. Points outside the axes are drawn on their edge, and counted.
    """
    flown = cases[measures.in_flow(cases)]
    if flown["condition"].nunique() > len(COLOURS):
        flown = flown.assign(condition="")
    grid = [
        [_points(flown[flown["title"] == title], name, "" if at else f"{wrapped(title, 24)}\n\n")
         for at, name in enumerate(PARAMETERS)]
        for title in (best_titles(flown) if answered(flown).any() else ())
    ]  # fmt: skip
    figure = drawn(grid, 0.6 + 1.8 * len(grid)) if grid else None
    for axes in figure.axes if figure else ():
        axes.plot([0, 1], [0, 1], color=GREY, lw=0.8, zorder=1, transform=axes.transAxes)
        axes.set_title(axes.get_title(), fontsize=6.5, color=GREY)
    return figure


def _points(cases: pd.DataFrame, name: str, beside: str) -> Panel:
    """Return estimated against true values of a parameter, a curve per condition."""
    true, estimate = measures.numbers(cases, f"true_{name}"), measures.numbers(cases, f"est_{name}")
    low, high = float(np.nanmin(true)), float(np.nanmax(true))
    is_log = low > 0 and high / low > LOG_RANGE
    room = 0.3 * (high - low) or 0.5 * abs(high) or 1.0
    ends = (low / 2.0, high * 2.0) if is_log else (low - room, high + room)
    if not is_log and low >= 0:
        ends = max(ends[0], 0.0), ends[1]
    usable = answered(cases)
    counts = {"above": usable & (estimate > ends[1]), "below": usable & (estimate < ends[0]),
              "no answer": ~usable}  # fmt: skip
    words = ", ".join(f"{mask.sum()} {text}" for text, mask in counts.items() if mask.any())
    estimate = np.where(usable, np.clip(estimate, *ends), np.nan)
    curves = [Curve(str(key), true[places], estimate[places])
              for (key,), places in grouped(cases, ["condition"])]  # fmt: skip
    unit = f"{SYMBOLS[name]} [{measures.UNITS[name]}]"
    style = {"ls": "", "marker": "o", "alpha": 0.85, "clip_on": False}
    return Panel(curves, f"true {unit}", f"{beside}estimated {unit}", words, style, ends, ends,
                 "xy" if is_log else "")  # fmt: skip


LAYOUTS: Mapping[str, Callable[[Entry, pd.DataFrame], Figure | None]] = {
    **dict.fromkeys(("settings", "lines", "protocols"), lines),
    **{"ecdf": ecdf, "scatter": scatter},
    # performance profiles of solvers (Dolan and More, 2002), and the times problem by problem
    "profiles": lambda entry, cases: ecdf(
        entry, solver_times.race(cases), solver_times.places(cases)
    ),
    "shapes": lambda entry, cases: lines(
        entry,
        solver_times.race(cases, solver_times.accuracies(cases)[-1]),
        solver_times.places(cases),
    ),
}


def figures(
    study: Any, cases: pd.DataFrame, names: Sequence[str | Options] = ()
) -> dict[str, Picture]:
    """Return figures by file name: those named, else those of [outputs], else all that apply."""
    from matplotlib.figure import Figure

    every, names = dict[str, Picture](), names or study.definition.outputs.figures
    wanted = names or tables.defaults(study, cases, "figures")
    for name, entry in tables.asked(study, "figure", LAYOUTS, wanted):
        if not isinstance(entry, Entry):
            made: Figure = style.styled(entry, formulas=True)(cases, Figure)
            every[name] = Picture(made, sentence(name.replace("_", " ")))
            continue
        drawing = style.styled(LAYOUTS[entry.compare or "settings"], entry.width)(entry, cases)
        if drawing is not None:
            shown = entry.title or measures.phrases(entry.measures)
            if entry.compare == "ecdf" and not entry.title:
                shown = "Distribution functions of all planned cases, failures included"
            said = [shown, *entry.notes]
            if entry.compare == "ecdf" and any(a.get_xscale() == "log" for a in drawing.axes):
                said.append("Logarithmic axes end beyond the 90 % quantile")
            axis = "x" if entry.compare == "ecdf" else "y"
            ends = [getattr(axes, f"get_{axis}lim")() for axes in drawing.axes]
            limits = [own for own in sorted(entry.limits) if any(a <= own <= b for a, b in ends)]
            if limits:
                units = {each.unit for each in entry.measures}
                words = listed([f"{limit:g}" for limit in limits], "and")
                said.append(f"Dashed: {words} {units.pop() if len(units) == 1 else ''}".rstrip())
            if any(axes.collections for axes in drawing.axes):
                said.append("Bars: 95 % Wilson intervals")
            caption = " ".join(map(sentence, said))
            every[name] = Picture(drawing, caption)
        elif names:
            words = ", ".join(each.words for each in entry.measures) or "an answer"
            every[name] = Picture(None, f"{name}: nothing to draw, no case has {words}.")
    return every
