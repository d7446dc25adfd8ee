"""The figures of a study: measures along a factor, distribution functions, estimated against true.

Panels are levels of columns of the frame of cases, and share one legend. Lines that coincide have
one entry in it; lines beyond its length are grey. A figure without data is replaced by a sentence.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias, cast

import numpy as np
import pandas as pd

from sparsefit.errors import InputError
from sparsefit.plot import style
from sparsefit.plot.style import COLOURS, GREY, MARKERS, STYLES, with_unit, wrapped
from sparsefit.study import measures, solver_times, tables
from sparsefit.study.columns import PARAMETERS
from sparsefit.study.measures import SYMBOLS, UNITS, answered, measure
from sparsefit.study.table import listed, sentence
from sparsefit.study.tables import Entry, Options, factor_words, grouped, level_text, unit_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Ranks: TypeAlias = "Mapping[str, float] | pd.Series"  # a legend has the lines of smallest rank
NAMED_CURVES = 10  # lines in a legend; others are grey, unless there is only one more
LOG_RANGE = 8.0  # largest over smallest, from which an axis is logarithmic


def dressed(grid: Sequence[Sequence[Axes]], ranks: Ranks) -> Figure | None:
    """Return the figure of panels with one look per name, the id of a line, and one legend.

    Lines without points, and those that coincide with another in all panels, are removed. None if
    no line has a point.
    """
    every, twins = dict[str, list[Any]](), dict[Any, list[str]]()
    for axes in itertools.chain(*grid):
        for artist in (*axes.lines, *axes.collections):
            if (gid := artist.get_gid()) is not None:
                every.setdefault(gid, []).append(artist)
    for name, artists in every.items():
        curves = [artist for artist in artists if hasattr(artist, "get_xydata")]
        if any(np.isfinite(curve.get_ydata()).any() for curve in curves):
            points = [(id(curve.axes), f"{value:.2e}")
                      for curve in curves for value in curve.get_xydata().ravel()]  # fmt: skip
            twins.setdefault(tuple(points), []).append(name)
    count = {alike[0]: len(alike) for alike in twins.values()}
    for artist in itertools.chain(*(every[name] for name in every if name not in count)):
        artist.remove()
    names = sorted(count, key=lambda name: ranks.get(name, math.inf))
    if not names:
        return None
    labels = style.labels(names, 52)
    others = 0 if len(names) == NAMED_CURVES + 1 else max(len(names) - NAMED_CURVES, 0)
    for place, name in enumerate(names):
        words = labels[name] + f" and {count[name] - 1} alike" * (count[name] > 1)
        turn, colour = divmod(place, len(COLOURS))
        look: dict[str, Any] = {"color": COLOURS[colour], "gid": f"line-{place}", "zorder": 3}
        is_grey, marker = place >= len(names) - others, MARKERS[(colour + turn) % len(MARKERS)]
        if is_grey:
            words, marker = f"{others} others", "."
            look = {"color": GREY, "gid": "line-others", "zorder": 2, "alpha": 0.6, "lw": 0.6}
        for artist in every[name]:
            artist.set(**look)
            if hasattr(artist, "get_xydata"):
                is_step = artist.get_drawstyle() != "default"  # told apart in grey by its dashes
                dashes = STYLES[(0 if is_grey else place if is_step else turn) % len(STYLES)]
                dashes = "" if artist.get_linestyle() == "None" else dashes
                artist.set(label=words, ls=dashes, marker="" if is_step else marker)
    figure = cast("Figure", grid[0][0].get_figure())
    style.legend(figure)
    return figure


class Picture(NamedTuple):
    """A figure with its caption; without a figure, the caption gives the reason."""

    figure: Figure | None
    caption: str


def _parts(cases: pd.DataFrame, factors: Sequence[str]) -> Iterator[tuple[str, pd.DataFrame]]:
    """Give the levels of these columns in words, and their cases."""
    tables.check_columns(cases, factors, "the figure")
    for levels, places in grouped(cases, factors):
        words = [
            f"{factor_words(factor)} {level_text(level)} {unit_of(factor)}".rstrip()
            if "." in factor else level_text(level)
            for factor, level in zip(factors, levels, strict=True)
        ]  # fmt: skip
        yield ", ".join(words), cases.iloc[places]


def _panels(entry: Entry, cases: pd.DataFrame) -> list[tuple[str, list[tuple[str, pd.DataFrame]]]]:
    """Return the words of each row of panels, at most six, and title and cases of each panel."""
    columns = list(_parts(cases, [entry.columns] if entry.columns else []))
    return [
        (words, [(title, own[own.index.isin(part.index)]) for title, part in columns])
        for words, own in itertools.islice(_parts(cases, entry.rows), 6)
    ]


def axes_of(entry: Entry, cases: pd.DataFrame) -> list[str]:
    """Return the columns that lines are drawn along: `along`, or every swept numeric factor.

    Raises:
        InputError: if no number is swept.
    """
    axes = [entry.along] if entry.along else measures.numeric_factors(cases)
    if not axes:
        raise InputError("no number is swept: give along = …, a column such as condition")
    return axes


def lines(entry: Entry, cases: pd.DataFrame) -> Figure | None:
    """Draw measures along a factor, a line per value of `lines`, a row of panels per measure.

    Levels of `columns` and `rows` have their own panels; all other factors are pooled. Shares have
    Wilson intervals, unless lines are many.
    """
    swept = axes_of(entry, cases)
    tables.check_columns(cases, [*swept, entry.lines], "the figure")
    seen = np.any([~np.isnan(each.values(cases)) for each in entry.measures], axis=0)
    whole, cases = cases, cases[seen].reset_index(drop=True)
    rows = [
        (along, each, words, row)
        for along, each in itertools.product(swept, entry.measures)
        for words, row in _panels(entry, cases)
    ][:6]
    if not rows:
        return None
    letters = round(100 / 7 * entry.width) // len(rows[0][-1])
    is_named = not all(pd.api.types.is_numeric_dtype(cases[along]) for along in swept)
    height = 0.8 + 0.7 * is_named + 2.1 * len(rows)
    _, grid = style.panels(len(rows), len(rows[0][-1]), height=height, sharey="row")
    for at, (axes_row, (along, each, words, row)) in enumerate(zip(grid, rows, strict=True)):
        is_last = at + 1 == len(rows) or rows[at + 1][0] != along
        levels = tables.levels_of(whole, along)[seen].cat.remove_unused_categories()
        codes, levels = pd.Series(levels.cat.codes.to_numpy()), levels.cat.categories
        names = [] if pd.api.types.is_numeric_dtype(cases[along]) else list(levels)
        x = np.array(range(len(names)) if names else levels, dtype=float)
        beside = (with_unit(each.head + each.heading, each.unit), words)
        for axes, (title, here) in zip(axes_row, row, strict=True):
            values = pd.Series(each.values(here), here.index)
            every = list(values.groupby(here[entry.lines], sort=False, dropna=False))
            for place, (name, own) in enumerate(every):
                by_level = own.dropna().groupby(codes)
                y = by_level.agg(each.summary_of).reindex(range(len(x))).to_numpy(dtype=float)
                y = np.where(
                    np.isfinite(y), np.where(np.abs(y) < each.least, each.least, y), np.nan
                )
                shift = 0.0 if "." in along else 0.5 * ((place + 0.5) / len(every) - 0.5)
                axes.plot(x + shift, y, "-" if "." in along else "o", gid=str(name))
                if each.summary == "share" and (names or len(every) <= 4):
                    counts = by_level.agg(["sum", "count"]).reindex(range(len(x)), fill_value=0)
                    bars = zip(*itertools.starmap(measures.wilson, counts.to_numpy()), strict=True)
                    axes.vlines(x + shift, *bars, lw=0.8, alpha=0.7, gid=str(name))
            if names:
                style.named_axis(axes, names, letters)
            else:
                style.level_axis(axes, x)
            axes.set_title("" if at else wrapped(title, letters))
            axes.tick_params(labelbottom=is_last)
            axes.set_xlabel(with_unit(factor_words(along), unit_of(along)) if is_last else "")
        axes_row[0].set_ylabel("\n".join(wrapped(text, 26) for text in beside if text))
        scale(axes_row, is_share=each.summary == "share")
        for axes, limit in itertools.product(axes_row, entry.limits):
            axes.axhline(limit, color=GREY, lw=0.8, ls="--", zorder=1)
    first = entry.measures[0]
    return dressed(grid, _ranks(entry, cases, pd.Series(first.values(cases)), first.summary_of))


def _ranks(
    entry: Entry, cases: pd.DataFrame, values: pd.Series, summary: Callable[..., float]
) -> pd.Series:
    """Return the best rank of each line in a row of panels, by a summary of values (rows,)."""
    keys = [cases[name].astype(str) for name in (*entry.rows, entry.lines)]
    scores = values.groupby(keys, sort=False).agg(summary)
    if rows := list(range(len(entry.rows))):
        scores = scores.groupby(level=rows).rank()
    return scores.groupby(level=-1).min().dropna()


def scale(row: Sequence[Axes], *, is_share: bool) -> None:
    """Set the range of y that a row of panels shares, logarithmic if it is wide."""
    first = row[0]
    low, high = np.array([axes.dataLim.intervaly for axes in row]).T
    if is_share:
        ends = first.get_ylim()
        first.set_ylim(max(ends[0], -3.0), min(ends[1], 103.0))
    elif 0.0 <= LOG_RANGE * low.min() < high[np.isfinite(high)].max(initial=0.0):
        first.set_yscale("log")
        style.logarithmic(first.yaxis, *first.get_ylim())
    for axes in row:
        axes.autoscale(False)


def ecdf(entry: Entry, cases: pd.DataFrame) -> Figure | None:
    """Draw the distribution function of the size of each measure over all cases, failures included.

    Each axis ends at the 90 % quantile of the sizes.
    """
    cases = cases[~measures.in_still_air(cases)].reset_index(drop=True)
    panels, kind = _panels(entry, cases), "problems" if "objective" in cases else "cases"
    if not panels:
        return None
    height = 3.3 if len(panels) == 1 else 1.0 + 2.0 * len(panels)
    columns = len(panels[0][1]) * len(entry.measures)
    letters = round(100 / 7 * entry.width) // columns
    _, grid = style.panels(len(panels), columns, height=height, sharey="all")
    for axes_row, (words, row) in zip(grid, panels, strict=True):
        axes_row[0].set_ylabel(f"{wrapped(words, 26)}\n\nshare of {kind} [%]".strip())
        each_of = itertools.product(row, entry.measures)
        for axes, ((title, here), each) in zip(axes_row, each_of, strict=True):
            sizes = pd.Series(np.abs(each.read(here)), here.index)
            finite, least = sizes[np.isfinite(sizes)].to_numpy(), each.least or 1e-300
            low, high = np.quantile(finite, (0.01, 0.9)).tolist() if finite.size else (1.0, 1.0)
            low, is_log = max(low, least), True
            ends = low / 1.5, max(1.5 * high, 10.0 * low)
            if each.name == "ratio":  # 1: the fastest
                ends = 1.0, max(1.5 * float(finite.max(initial=1.0)), 10.0)
            elif finite.size and (each.more or finite.max() <= LOG_RANGE * finite.min()):
                room, is_log = 0.05 * float(np.ptp(finite)) or 0.1 * high, False
                ends = float(finite.min()) - room, float(finite.max()) + room
            lines = sizes.groupby(here[entry.lines], sort=False, dropna=False)
            for name, own in lines if finite.size else ():
                x = np.sort(own)
                x = x[np.isfinite(x)]
                share = 100.0 * np.arange(1, x.size + 1) / len(own)
                every = slice(-1, None, -max(1, x.size // 200))  # enough for a figure
                x, share = x[every][::-1], share[every][::-1]
                x = np.array([min([ends[0], *x[:1]]), *x, max([ends[1], *x[-1:]])])
                y = [0.0, *share, share.max(initial=0.0)]
                axes.plot(np.maximum(x, least), y, drawstyle="steps-post", gid=str(name))
            axes.set(xscale="log" if is_log else "linear", xlim=ends, ylim=(-2.0, 102.0))
            axes.set_title(wrapped(title, letters) if axes_row is grid[0] else "")
            label = wrapped(with_unit(each.words, each.unit), letters)
            axes.set_xlabel(label if axes_row is grid[-1] else "")
            if is_log:
                style.logarithmic(axes.xaxis, *ends)
            for limit in entry.limits:
                axes.axvline(limit, color=GREY, lw=0.8, ls="--", zorder=1)
    sizes = pd.Series(np.abs(entry.measures[0].read(cases))).fillna(math.inf)
    return dressed(grid, _ranks(entry, cases, sizes, np.median))


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
    if not answered(flown).any():
        return None
    if flown["condition"].nunique() > len(COLOURS):
        flown = flown.assign(condition="")
    titles = best_titles(flown)
    _, grid = style.panels(len(titles), len(PARAMETERS), height=0.6 + 1.8 * len(titles))
    for title, name in itertools.product(titles, PARAMETERS):
        axes = grid[titles.index(title)][PARAMETERS.index(name)]
        here = flown[flown["title"] == title]
        true, estimate = (measures.numbers(here, f"{kind}_{name}") for kind in ("true", "est"))
        low, high = float(np.nanmin(true)), float(np.nanmax(true))
        room, scale = 0.3 * (high - low) or 0.5 * abs(high) or 1.0, "linear"
        ends = (0.0 if 0.0 <= low < room else low - room), high + room
        if low > 0 and high / low > LOG_RANGE:
            ends, scale = (low / 2.0, high * 2.0), "log"
        usable, label = answered(here), f"{SYMBOLS[name]} [{UNITS[name]}]"
        counts = {"above": usable & (estimate > ends[1]), "below": usable & (estimate < ends[0]),
                  "no answer": ~usable}  # fmt: skip
        words = ", ".join(f"{mask.sum()} {text}" for text, mask in counts.items() if mask.any())
        beside = f"{wrapped(title, 24)}\n\n" * (name == PARAMETERS[0])
        axes.set(xscale=scale, yscale=scale, xlim=ends, ylim=ends)
        axes.set_xlabel(f"true {label}" if title == titles[-1] else "")
        axes.set_ylabel(f"{beside}estimated {label}")
        axes.set_title(words, fontsize=6.5, color=GREY)
        for axis in (axes.xaxis, axes.yaxis) if scale == "log" else ():
            style.logarithmic(axis, *ends)
        estimate = np.where(usable, np.clip(estimate, *ends), np.nan)
        for (condition,), at in grouped(here, ["condition"]):
            axes.plot(true[at], estimate[at], "o", alpha=0.85, clip_on=False, gid=str(condition))
        axes.plot([0, 1], [0, 1], color=GREY, lw=0.8, zorder=1, transform=axes.transAxes)
    return dressed(grid, {})


LAYOUTS: Mapping[str, Callable[[Entry, pd.DataFrame], Figure | None]] = {
    **dict.fromkeys(("settings", "lines", "protocols"), lines),
    **{"ecdf": ecdf, "scatter": scatter},
    # performance profiles of solvers (Dolan and More, 2002), and the times problem by problem
    "profiles": lambda entry, cases: ecdf(entry, solver_times.race(cases)),
    "shapes": lambda entry, cases: lines(
        entry, solver_times.race(cases, solver_times.accuracies(cases)[-1])
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
            every[name] = Picture(drawing, _caption(entry, drawing))
        elif names:
            words = ", ".join(each.words for each in entry.measures) or "an answer"
            every[name] = Picture(None, f"{name}: nothing to draw, no case has {words}.")
    return every


def _caption(entry: Entry, figure: Figure) -> str:
    """Return what a figure shows, and what its marks mean."""
    is_ecdf, units = entry.compare == "ecdf", {each.unit for each in entry.measures}
    phrases, parameter = dict[str, list[str]](), re.compile("|".join(SYMBOLS.values()))
    for each in entry.measures:  # one phrase for several parameters
        symbols = phrases.setdefault(parameter.sub("{}", each.phrase, count=1), [])
        symbols += parameter.findall(each.phrase)[:1]
    shown = "; ".join(words.format(listed(own or [""], "and")) for words, own in phrases.items())
    if is_ecdf:
        shown = "Distribution functions of all planned cases, failures included"
    said = [entry.title or shown, *entry.notes]
    if is_ecdf and any(axes.get_xscale() == "log" for axes in figure.axes):
        said.append("Logarithmic axes end beyond the 90 % quantile")
    ends = [axes.get_xlim() if is_ecdf else axes.get_ylim() for axes in figure.axes]
    limits = [own for own in sorted(entry.limits) if any(a <= own <= b for a, b in ends)]
    if limits:
        words = listed([f"{limit:g}" for limit in limits], "and")
        said.append(f"Dashed: {words} {units.pop() if len(units) == 1 else ''}".rstrip())
    if any(axes.collections for axes in figure.axes):
        said.append("Bars: 95 % Wilson intervals")
    return " ".join(map(sentence, said))
