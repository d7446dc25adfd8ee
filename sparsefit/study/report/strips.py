"""A row per setting: the distribution of an error, or a share with its interval."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from sparsefit.arrays import Array
from sparsefit.study.evidence.asked import Asked
from sparsefit.study.evidence.cases import (
    Group,
    by_setting,
    estimated,
    factors,
    in_a_flow,
    level_text,
)
from sparsefit.study.evidence.measure import Measure, Share
from sparsefit.study.evidence.summary import TINY
from sparsefit.study.report.drawing import (
    COLOURS,
    GREY,
    colours,
    legend,
    logarithmic,
    panels,
    shortened,
)
from sparsefit.study.report.typical import typical
from sparsefit.study.report.vector import linked

if TYPE_CHECKING:
    from sparsefit.study.spec.study import Study

ROWS = 45
WORST = 5  # of a row are told by name where a reader can point at them
LOWEST = 80.0  # percent, of an axis of shares, unless something lies below


def strips(asked: Asked, study: Study, cases: pd.DataFrame, _: object = None) -> Figure:
    """Draw every measure of the entry for every setting, one panel per measure.

    Sizes: each case a point, quartiles a box, failures counted, all levels together. Shares: a
    point with its Wilson interval for every setting and level, and a band between the limits.
    """
    asked.needs(study.name, "measure")
    shares = asked.first.summary == "share"
    kept = cases[in_a_flow(cases)] if shares else cases
    every = by_setting(kept, *(factors(cases) if shares else ()))
    groups = every[:ROWS]
    figure, (row,) = panels(1, len(asked.measures), height=1.0 + 0.27 * len(groups))
    colour = colours(list(dict.fromkeys(group.protocol for group in groups)))
    for measure, axes in zip(asked.measures, row, strict=True):
        if shares:
            for place, group in enumerate(groups):
                _interval(axes, measure, group.cases, place)
        else:
            every_strip = [
                _strip(axes, measure, group.cases, place, colour[group.protocol])
                for place, group in enumerate(groups)
            ]
            # One cloud for all rows: each rasterised artist is an image of its own in the file.
            x, y, shades = (np.concatenate(parts) for parts in zip(*every_strip, strict=True))
            if x.size:
                axes.scatter(x, y, s=3, c=shades, alpha=0.45, linewidth=0, rasterized=True)
        axes.set_ylim(len(groups) - 0.4, -0.6)
        axes.set_yticks(range(len(groups)), [""] * len(groups))
        axes.grid(False, axis="y")
        axes.tick_params(axis="y", length=0)
        words = f"coverage of {measure.symbol}" if shares and measure.of else measure.words
        axes.set_xlabel(f"{words} [{measure.unit}]")
    if shares:
        _band(row, asked.limits)
        names = _names(groups, factors(cases))
    else:
        for axes in row:
            # A box would hold the axis at its left end, and what is smaller would leave the frame.
            axes.use_sticky_edges = False
            axes.set_xscale("log")
            logarithmic(axes.xaxis, *axes.get_xlim())
        _failures(row[-1], groups)
        if len(colour) > 1:
            legend(figure, [], [row[0].scatter([], [], s=14, color=one, label=name)
                                for name, one in colour.items()])  # fmt: skip
        names = [shortened(group.title, 34) for group in groups]
    row[0].set_yticks(range(len(groups)), names)
    if len(every) > ROWS:
        row[0].set_title(f"the first {ROWS} of {len(every)} settings", loc="left", fontsize=7)
    return figure


def _strip(
    axes: Axes, measure: Measure, cases: pd.DataFrame, place: int, colour: str
) -> tuple[Array, Array, Array]:
    """Draw quartiles and the largest errors of a row; x, y and colour (n, 3) of all the others."""
    values = np.maximum(measure.read(cases), TINY)
    order = np.argsort(values, kind="stable")[: np.isfinite(values).sum()]
    sizes = values[order]
    if not sizes.size:
        return sizes, sizes, np.empty((0, 3))
    # A fixed pattern instead of random jitter: the same cases give the same picture.
    height = place + 0.28 * np.resize([-1.0, 0.2, 0.8, -0.4, 0.5, -0.7, 1.0, 0.0], sizes.size)
    points = axes.scatter(
        sizes[-WORST:], height[-WORST:], s=3, color=colour, alpha=0.45, linewidth=0
    )
    linked(points, cases.iloc[order[-WORST:]])
    low, first, median, third, high = np.quantile(sizes, [0.05, 0.25, 0.5, 0.75, 0.95])
    axes.plot([low, high], [place, place], color="black", lw=0.6, zorder=3)
    axes.barh(
        place, third - first, left=first, height=0.5, facecolor="white", edgecolor="black",
        linewidth=0.6, alpha=0.75, zorder=4,
    )  # fmt: skip
    axes.plot([median, median], [place - 0.25, place + 0.25], color=colour, lw=2.2, zorder=5)
    others = sizes[:-WORST]
    return others, height[: len(others)], np.tile(to_rgb(colour), (len(others), 1))


def _interval(axes: Axes, measure: Measure, cases: pd.DataFrame, place: int) -> None:
    share = Share.of(measure, cases)
    if not share.whole:
        axes.text(95.0, place, "none", fontsize=6.5, color=GREY, va="center", ha="center")
    axes.plot(share.interval, [place, place], color="black", lw=0.9, zorder=3)
    axes.plot([share.percent], [place], "o", ms=4, color=COLOURS[0], zorder=4)
    if share.whole:
        mark = axes.scatter([share.percent], [place], s=30, alpha=0.0, zorder=5)
        linked(mark, typical(measure, cases), unseen=True)


def _band(row: list[Axes], limits: tuple[float, ...]) -> None:
    lowest = min([LOWEST, *(axes.dataLim.x0 - 2.0 for axes in row if axes.lines)])
    for axes in row:
        if limits:
            axes.axvspan(min(limits), max(limits), color="#DDE8F0", lw=0, zorder=0)
            axes.axvline(sum(limits) / len(limits), color=GREY, lw=0.8, zorder=1)
        axes.set_xlim(max(lowest, -1.0) if np.isfinite(lowest) else LOWEST, 101.0)


def _names(groups: list[Group], swept: list[str]) -> list[str]:
    """Protocol and levels, with the setting where they do not tell rows apart."""
    keys = [[group.key[name] for name in ("protocol", *swept)] for group in groups]
    names = [", ".join(map(level_text, key)) for key in keys]
    if len(set(names)) < len(names):
        names = [f"{name}, {group.title}" for name, group in zip(names, groups, strict=True)]
    return [shortened(name, 44) for name in names]


def _failures(axes: Axes, groups: list[Group]) -> None:
    right = axes.get_yaxis_transform()
    axes.text(1.04, -0.75, "failed", transform=right, fontsize=6.5, color=GREY, va="bottom")
    for place, group in enumerate(groups):
        failed, planned = int((~estimated(group.cases)).sum()), len(group.cases)
        axes.text(
            1.04, place, f"{failed}/{planned}", transform=right, fontsize=6.5, va="center",
            color="black" if failed else GREY,
        )  # fmt: skip
