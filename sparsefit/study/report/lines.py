"""Measures along a swept factor: lines over numbers with bands, marks over names."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from sparsefit.arrays import Array
from sparsefit.study.evidence.along import unit_of, words_of
from sparsefit.study.evidence.asked import Asked
from sparsefit.study.evidence.cases import Group, by_level, factors, groups_by, level_text
from sparsefit.study.evidence.measures import MEASURES
from sparsefit.study.evidence.summary import TINY
from sparsefit.study.report.drawing import (
    COLOURS,
    GREY,
    STYLES,
    colours,
    legend,
    markers,
    panels,
    share_y,
    ticked,
    unanswered,
    with_unit,
)
from sparsefit.study.report.line_panels import SETTING, Panel, checked_axes, rows_of, titled
from sparsefit.study.report.typical import typical
from sparsefit.study.report.vector import linked

if TYPE_CHECKING:
    from sparsefit.study.spec.study import Study

SPREAD = 0.62  # of the distance between two names on an axis
LETTERS = 96  # of a label in the width of a page
HIGHEST = 300.0  # percent: what is worse is no answer, and leaves a frame that has limits


@dataclass(frozen=True)
class Series:
    """What tells the lines of a picture apart: `line` by colour, the protocol by style.

    names: the values of `line`, in order; protocols: none where they have a place of their own.
    """

    line: str
    names: tuple[str, ...]
    protocols: tuple[str, ...]

    @property
    def keys(self) -> list[str]:
        """The columns of the cases that a line stands for."""
        return [self.line, *(["protocol"] if self.protocols else [])]

    def style(self, group: Group) -> str:
        """The style of a line: by protocol, or dashed where the colours begin anew."""
        if self.protocols:
            return STYLES[self.protocols.index(group.protocol) % len(STYLES)]
        return "-" if self.names.index(str(group.key[self.line])) < len(COLOURS) else "--"


def lines(asked: Asked, study: Study, cases: pd.DataFrame, _: object = None) -> Figure:
    """Draw measures along a factor: a line per setting, or per protocol.

    A row of panels per protocol or per level of `rows`; a column per measure or per level of
    `columns`. Without `along`, every swept number has rows of its own. What is neither is pooled;
    a protocol that has no rows is a line style.

    Raises:
        InputError: if the factor is not swept, or no case has the measure.
    """
    axes_of = checked_axes(asked, study, cases)
    shown = titled(cases, every=asked.settings == "every")
    grid = [row for along in axes_of for row in rows_of(asked, shown, along)]
    each = 2.1 if len(grid) < 4 else 1.6
    figure, axes_grid = panels(len(grid), len(grid[0]), height=0.9 + each * len(grid))
    line = "protocol" if asked.over == "protocol" else SETTING
    placed = {line, *asked.columns, *axes_of, *(name for row in grid for name in row[0].rows)}
    free = () if "protocol" in placed else tuple(map(str, dict.fromkeys(shown["protocol"])))
    series = Series(line, tuple(map(str, dict.fromkeys(shown[line]))), free)
    lowest = {row[0].along: place for place, row in enumerate(grid)}  # of the rows of one axis
    for place, (row, axes_row) in enumerate(zip(grid, axes_grid, strict=True)):
        for panel, axes in zip(row, axes_row, strict=True):
            _draw(axes, panel, asked, series)
            if panel.along != "protocol" and lowest[panel.along] == place:
                words = with_unit(words_of(panel.along), unit_of(panel.along))
                broken = words if len(words) <= LETTERS // len(row) else words.replace(" [", "\n[")
                axes.set_xlabel(broken)
        _finish(row, axes_row, asked)
    every = [axes for row in axes_grid for axes in row]
    if asked.limits:
        share_y(every, alike=True, highest=HIGHEST)
    legend(figure, every, list(_explained(asked, series.protocols)))
    return figure


def _draw(axes: Axes, panel: Panel, asked: Asked, series: Series) -> None:
    names = list(series.names)
    colour, marker = colours(names), markers(names)
    groups = groups_by(panel.cases, series.keys)
    ticks = [level_text(one.key[panel.along]) for one in by_level(panel.cases, panel.along)]
    for order, group in enumerate(groups):
        name = str(group.key[series.line])
        # Lines that agree lie on each other: the first are drawn wider, so that all are seen.
        width = 2.6 - 1.7 * order / max(len(groups) - 1, 1)
        at, middle, low, high = _summaries(group.cases, panel, ticks)
        style = series.style(group)
        if panel.along == "protocol":  # names without an order: marks, side by side
            at = at + SPREAD * ((names.index(name) + 0.5) / len(names) - 0.5)
            style, width = "", 1.8
            axes.vlines(at, low, np.where(np.isnan(high), middle, high), color=colour[name], lw=1)
        elif asked.band:
            axes.fill_between(at, low, high, color=colour[name], alpha=0.15, lw=0)
        axes.plot(
            at, middle, color=colour[name], marker=marker[name], ms=1.5 + 1.4 * width, mew=0,
            lw=width, ls=style, label=name, zorder=3, clip_on=panel.measure.summary != "share",
        )  # fmt: skip
        _lead(axes, panel, group.cases, at, middle)
    if not any(np.isfinite(one.get_ydata()).any() for one in axes.lines):
        unanswered(axes)
    if panel.measure.beside:
        _beside(axes, panel, [group.cases for group in groups])
    if panel.measure.target is not None:
        axes.axhline(panel.measure.target, color="black", lw=1.0, zorder=4)
    if panel.named:
        wrapped = [textwrap.fill(tick, 12).replace(" / ", "/\n") for tick in ticks]
        axes.set_xticks(range(len(ticks)), wrapped)
    else:
        ticked(axes, panel.cases[panel.along].to_numpy(float))


def _summaries(
    cases: pd.DataFrame, panel: Panel, ticks: list[str]
) -> tuple[Array, Array, Array, Array]:
    """Places on the axis, and there the summary and both quartiles; a gap where none is finite."""
    levels = by_level(cases, panel.along)
    texts = [level_text(level.key[panel.along]) for level in levels]
    at = [
        float(ticks.index(text)) if panel.named else float(level.key[panel.along] or 0.0)
        for text, level in zip(texts, levels, strict=True)
    ]
    told = [
        [panel.measure.summarise(level.cases, name) for level in levels]
        for name in ("", "first quartile", "third quartile")
    ]
    values = np.array(told)
    least = 0.0 if panel.measure.summary == "share" else TINY
    middle, low, high = np.where(np.isfinite(values), np.maximum(values, least), np.nan)
    return np.array(at), middle, low, high


def _lead(axes: Axes, panel: Panel, cases: pd.DataFrame, at: Array, middle: Array) -> None:
    """Let each mark lead to a case: a reader of the page can point at it."""
    levels = by_level(cases, panel.along)
    known = np.flatnonzero(np.isfinite(middle))
    if known.size:
        marks = axes.scatter(at[known], middle[known], s=40, alpha=0.0, zorder=5)
        chosen = [typical(panel.measure, levels[place].cases) for place in known]
        linked(marks, pd.concat(chosen), unseen=True)


def _beside(axes: Axes, panel: Panel, series: list[pd.DataFrame]) -> None:
    """Draw the measure that stands beside, over the flights that every line has a number of.

    Those that a line gave up are the hardest: with them it would stand above the line.
    """
    beside = MEASURES[panel.measure.beside]
    every = pd.concat([one[~np.isnan(beside.read(one))] for one in series])
    same = ["flight", *factors(every)]
    shared = every.groupby(same)[panel.along].transform("size") == len(series)
    once = every[shared].drop_duplicates(same)
    if len(once):
        at, middle, _, _ = _summaries(once, replace(panel, measure=beside), [])
        axes.plot(at, middle, color="black", lw=1.0, zorder=4)


def _finish(row: list[Panel], axes_row: list[Axes], asked: Asked) -> None:
    for panel, axes in zip(row, axes_row, strict=True):
        measure = panel.measure
        words = with_unit(measure.phrase, measure.unit).replace("Cramér-Rao ", "")
        said = [panel.title, words] if panel.title and panel.heading else [words]
        axes.set_ylabel("\n".join(textwrap.fill(line, 30) for line in said))
        if panel.along == "protocol":
            axes.grid(False, axis="x")
        if panel.heading:
            axes.set_title(panel.heading)
        if measure.summary == "share":
            axes.set_ylim(0, 103)
            continue
        axes.set_yscale("log")
        for limit in asked.limits:
            axes.axhline(limit, color=GREY, lw=0.9, ls="--", zorder=2)
            axes.text(
                1.01, limit, f"{limit:g} {measure.unit}", transform=axes.get_yaxis_transform(),
                ha="left", va="center", fontsize=6.5, color=GREY,
            )  # fmt: skip
    if row[0].title and not row[0].heading:
        axes_row[0].set_title(row[0].title, loc="left", fontweight="bold")
    if row[0].measure.summary != "share":
        share_y(axes_row, alike=bool(asked.columns), highest=np.inf)
    if asked.columns and len(asked.measures) == 1:
        for axes in axes_row[1:]:
            axes.set_ylabel("")
            axes.tick_params(labelleft=False)


def _explained(asked: Asked, styles: Sequence[str]) -> Iterator[Line2D]:
    """What the legend has beside the lines: the bound, and the style of each protocol."""
    if any(one.beside or one.target is not None for one in asked.measures):
        yield Line2D([], [], color="black", lw=1.0, label="Cramér-Rao bound")
    for place, name in enumerate(styles if len(styles) > 1 else ()):
        yield Line2D([], [], color=GREY, ls=STYLES[place % len(STYLES)], label=name)
