"""The error of the length scale on each grid, before and after it is refined."""

from __future__ import annotations

import textwrap

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sparsefit.errors import InputError
from sparsefit.study.evidence.summary import (
    REFINE,
    SYMBOLS,
    Group,
    StudyRecord,
    first_settings,
    grouped,
    quartiles,
)
from sparsefit.study.report.drawing import colours, logarithmic, markers, panels

SPREAD = 0.62  # of the distance between two grids


def grids_figure(study: StudyRecord, cases: pd.DataFrame, weights: pd.DataFrame | None) -> Figure:
    """Draw the median |% error| of L_w with its quartiles: a panel per way of refining.

    Each protocol is a grid; a colour per back-end (its first listed setting); other swept
    factors are pooled. A failure counts as an infinite error: no mark where half fail.

    Raises:
        InputError: if the study does not sweep `readout.refine`.
    """
    if REFINE not in cases:
        raise InputError(f'{study.name} does not sweep "{REFINE}": drop the figure "grids"')
    levels = grouped(cases, [REFINE])
    figure, (row,) = panels(1, len(levels), height=2.9)
    for level, axes in zip(levels, row, strict=True):
        _panel(axes, first_settings(level.cases))
        axes.set_title(f"refine = {level.key[REFINE]}", loc="left", fontweight="bold")
    low = min(axes.get_ylim()[0] for axes in row)
    high = max(axes.get_ylim()[1] for axes in row)
    for axes in row:
        axes.set_ylim(low, high)
        logarithmic(axes.yaxis, low, high)
    row[0].set_ylabel(f"median |error| of {SYMBOLS['length_scale']} [%]")
    handles, labels = row[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=min(len(handles), 6))
    return figure


def _panel(axes: Axes, groups: list[Group]) -> None:
    grids = list(dict.fromkeys(str(group.key["protocol"]) for group in groups))
    backends = list(dict.fromkeys(group.title for group in groups))
    colour, marker = colours(backends), markers(backends)
    for group in groups:
        first, median, third = quartiles(group.cases, "length_scale")
        if not np.isfinite(median):
            continue
        shift = (backends.index(group.title) + 0.5) / len(backends) - 0.5
        x = grids.index(str(group.key["protocol"])) + SPREAD * shift
        top = third if np.isfinite(third) else median
        new = group.title not in axes.get_legend_handles_labels()[1]
        axes.plot([x, x], [first, top], color=colour[group.title], lw=1.0, zorder=2)
        axes.plot(
            [x], [median], ls="", marker=marker[group.title], ms=4, color=colour[group.title],
            label=group.title if new else "_", zorder=3,
        )  # fmt: skip
    axes.set_yscale("log")
    axes.set_xticks(range(len(grids)), [textwrap.fill(name, 12) for name in grids])
    axes.set_xlim(-0.5, len(grids) - 0.5)
    axes.grid(False, axis="x")
