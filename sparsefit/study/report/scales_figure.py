"""How often every scale is found, against what sets the scales apart."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sparsefit.errors import InputError
from sparsefit.study.evidence.scale_sets import Regime, all_found, first_settings, has_scales
from sparsefit.study.evidence.summary import Group, StudyRecord, grouped
from sparsefit.study.evidence.table import Cell
from sparsefit.study.report.drawing import colours, markers, panels
from sparsefit.study.report.error_figures import numeric_factors

ACROSS = "flights.second_scale_ratio"
ALONG = "flights.duration"
NUDGE = 0.012  # of the axis, per line: where several are at 100 %, all are seen


def scales_figure(study: StudyRecord, cases: pd.DataFrame, weights: pd.DataFrame | None) -> Figure:
    """Draw the share of flights with every scale within 1 %: a line per back-end.

    Against the scale ratio where it is swept; a column of panels per duration, where that is, a
    row per protocol. Other factors are pooled.

    Raises:
        InputError: if no case has a set of scales, or no number is swept.
    """
    swept = numeric_factors(cases)
    if not has_scales(cases) or not swept:
        raise InputError(
            f'{study.name} reads no set of scales over a swept number: drop the figure "scales"'
        )
    across = ACROSS if ACROSS in swept else swept[0]
    along = next((name for name in (ALONG, *swept) if name in swept and name != across), None)
    columns = grouped(cases, [along]) if along else [Group({}, cases)]
    columns.sort(key=lambda one: float(one.key[along] or 0) if along else 0.0)
    protocols = list(dict.fromkeys(str(name) for name in cases["protocol"]))
    figure, grid = panels(len(protocols), len(columns), height=0.7 + 2.1 * len(protocols))
    titles = list(dict.fromkeys(group.title for group in first_settings(cases)))
    for protocol, row in zip(protocols, grid, strict=True):
        for column, axes in zip(columns, row, strict=True):
            _panel(axes, column.cases[column.cases["protocol"] == protocol], across, titles)
            axes.set_title(_title(along, column, protocols, protocol), loc="left")
        row[0].set_ylabel("all scales within 1 % [% of flights]")
    for axes in grid[-1]:
        axes.set_xlabel(across.removeprefix("flights.").replace("_", " "))
    handles = {
        label: handle
        for row in grid
        for axes in row
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)
    }
    figure.legend(
        handles.values(), handles.keys(), loc="outside upper center", ncols=min(len(handles), 5)
    )
    return figure


def _title(along: str | None, column: Group, protocols: list[str], protocol: str) -> str:
    """How far the panel's flights fly, in cells of the largest scale, and the protocol if many."""
    cells = Regime.of(column.cases).cells
    words = [protocol] if len(protocols) > 1 else []
    if along == ALONG and np.isfinite(cells).any():
        words.append(f"{_number(column.key[along])} s, ~{np.nanmedian(cells):.0f} cells")
    elif along:
        words.append(f"{along.removeprefix('flights.').replace('_', ' ')} {column.key[along]}")
    return ": ".join(words)


def _number(value: Cell) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def _panel(axes: Axes, cases: pd.DataFrame, across: str, titles: list[str]) -> None:
    colour, marker = colours(titles), markers(titles)
    groups = first_settings(cases)
    levels = sorted({float(value) for value in cases[across]})
    span = (levels[-1] - levels[0]) or 1.0
    for place, group in enumerate(groups):
        by_level = {float(one.key[across] or 0): one for one in grouped(group.cases, [across])}
        shares = [100 * float(all_found(by_level[x].cases).mean()) for x in sorted(by_level)]
        nudge = NUDGE * span * (place - (len(groups) - 1) / 2)
        axes.plot(
            np.array(sorted(by_level)) + nudge,
            shares,
            color=colour[group.title],
            marker=marker[group.title],
            ms=3.5,
            lw=1.2,
            label=group.title,
            clip_on=False,
        )
    axes.set_ylim(0, 103)
    axes.set_xticks(levels, [f"{level:g}" for level in levels])
