"""Distributions of the percentage errors, and how they grow with a swept number."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sparsefit.arrays import Array
from sparsefit.errors import InputError
from sparsefit.study.evidence.summary import (
    FLOOR,
    PARAMETERS,
    SYMBOLS,
    Group,
    StudyRecord,
    by_setting,
    estimated,
    factors,
    first_settings,
    grouped,
    numbers,
    percent_errors,
    quartiles,
)
from sparsefit.study.report.drawing import (
    GREY,
    colours,
    logarithmic,
    markers,
    panels,
    shortened,
    ticked,
)
from sparsefit.study.report.scatter_figure import ORDER

ROWS = 30


def errors(study: StudyRecord, cases: pd.DataFrame, weights: pd.DataFrame | None) -> Figure:
    """Draw |% error| of every setting: each case a point, quartiles a box, failures counted."""
    every = by_setting(cases)
    groups = every[:ROWS]
    figure, (row,) = panels(1, 3, height=1.0 + 0.27 * len(groups))
    protocols = list(dict.fromkeys(str(group.key["protocol"]) for group in groups))
    colour = colours(protocols)
    for name, axes in zip(ORDER, row, strict=True):
        for place, group in enumerate(groups):
            _strip(axes, name, group, place, colour[str(group.key["protocol"])])
        _finish(axes, name, len(groups))
    row[0].set_yticks(range(len(groups)), [shortened(group.title, 34) for group in groups])
    _failures(row[-1], groups)
    _protocol_legend(figure, colour)
    if len(every) > ROWS:
        figure.suptitle(f"the first {ROWS} of {len(every)} settings", fontsize=7)
    return figure


def _sizes(cases: pd.DataFrame, name: str) -> Array:
    """(rows,) |% error| of the cases that have an estimate."""
    percent = np.abs(percent_errors(cases)[:, PARAMETERS.index(name)])
    return np.maximum(percent[estimated(cases) & ~np.isnan(percent)], FLOOR)


def _strip(axes: Axes, name: str, group: Group, place: int, colour: str) -> None:
    sizes = np.sort(_sizes(group.cases, name))
    if not sizes.size:
        return
    # A fixed pattern instead of random jitter: the same cases give the same picture.
    height = place + 0.28 * np.resize([-1.0, 0.2, 0.8, -0.4, 0.5, -0.7, 1.0, 0.0], sizes.size)
    axes.scatter(sizes, height, s=3, color=colour, alpha=0.45, linewidth=0, rasterized=True)
    low, first, median, third, high = np.quantile(sizes, [0.05, 0.25, 0.5, 0.75, 0.95])
    axes.plot([low, high], [place, place], color="black", lw=0.6, zorder=3)
    axes.barh(
        place, third - first, left=first, height=0.5, facecolor="white", edgecolor="black",
        linewidth=0.6, alpha=0.75, zorder=4,
    )  # fmt: skip
    axes.plot([median, median], [place - 0.25, place + 0.25], color=colour, lw=2.2, zorder=5)


def _finish(axes: Axes, name: str, rows: int) -> None:
    axes.set_xscale("log")
    logarithmic(axes.xaxis, *axes.get_xlim())
    axes.set_ylim(rows - 0.4, -0.6)
    axes.set_yticks(range(rows), [""] * rows)
    axes.grid(False, axis="y")
    axes.tick_params(axis="y", length=0)
    axes.set_xlabel(f"|error| of {SYMBOLS[name]} [%]")


def _failures(axes: Axes, groups: list[Group]) -> None:
    right = axes.get_yaxis_transform()
    axes.text(1.04, -0.75, "failed", transform=right, fontsize=6.5, color=GREY, va="bottom")
    for place, group in enumerate(groups):
        failed, planned = int((~estimated(group.cases)).sum()), len(group.cases)
        axes.text(
            1.04, place, f"{failed}/{planned}", transform=right, fontsize=6.5, va="center",
            color="black" if failed else GREY,
        )  # fmt: skip


def _protocol_legend(figure: Figure, colour: dict[str, str]) -> None:
    if len(colour) > 1:
        handles = [
            figure.axes[0].scatter([], [], s=14, color=one, label=name)
            for name, one in colour.items()
        ]
        figure.legend(handles=handles, loc="outside upper center", ncols=min(len(handles), 5))


def numeric_factors(cases: pd.DataFrame) -> list[str]:
    """Return the swept factors whose every level is a number."""
    return [name for name in factors(cases) if pd.api.types.is_numeric_dtype(cases[name])]


def sweep(study: StudyRecord, cases: pd.DataFrame, weights: pd.DataFrame | None) -> Figure:
    """Draw median |% error| against each swept number, with its quartile band per back-end.

    The first listed setting of each back-end. A failure counts as an infinite error, so neither
    line nor band improves by giving no answer.

    Raises:
        InputError: if the study sweeps no number.
    """
    swept = numeric_factors(cases)
    if not swept:
        raise InputError(f'{study.name} sweeps no number: drop the figure "sweep" from [outputs]')
    lines = first_settings(cases)
    protocols = list(dict.fromkeys(str(line.key["protocol"]) for line in lines))
    wanted = [(factor, protocol) for factor in swept for protocol in protocols]
    figure, grid = panels(len(wanted), 3, height=0.6 + 2.0 * len(wanted))
    for (factor, protocol), row in zip(wanted, grid, strict=True):
        own = [line for line in lines if line.key["protocol"] == protocol]
        _sweep_row(row, own, factor, numbers(cases, factor))
        if len(protocols) > 1:
            row[0].set_title(protocol, loc="left", fontweight="bold")
    handles = {
        label: handle
        for row in grid
        for handle, label in zip(*row[0].get_legend_handles_labels(), strict=True)
    }
    figure.legend(
        handles.values(), handles.keys(), loc="outside upper center", ncols=min(len(handles), 3)
    )
    return figure


def _sweep_row(row: list[Axes], lines: list[Group], factor: str, levels: Array) -> None:
    titles = [line.title for line in lines]
    colour, marker = colours(titles), markers(titles)
    for name, axes in zip(ORDER, row, strict=True):
        for line in lines:
            _band(axes, name, line, factor, colour[line.title], marker[line.title])
        _scales(axes, name, factor, levels)


def _band(axes: Axes, name: str, line: Group, factor: str, colour: str, marker: str) -> None:
    levels = sorted(grouped(line.cases, [factor]), key=lambda one: float(one.key[factor] or 0))
    values = np.array([float(level.key[factor] or 0.0) for level in levels])
    first, median, third = np.array([quartiles(level.cases, name) for level in levels]).T
    axes.plot(
        values,
        _gap(median),
        color=colour,
        marker=marker,
        ms=3.5,
        lw=1.3,
        label=line.title,
        zorder=3,
    )
    axes.fill_between(values, _gap(first), _gap(third), color=colour, alpha=0.15, lw=0)


def _gap(values: Array) -> Array:
    return np.where(np.isfinite(values), values, np.nan)


def _scales(axes: Axes, name: str, factor: str, levels: Array) -> None:
    ticked(axes, levels)
    axes.set_yscale("log")
    logarithmic(axes.yaxis, *axes.get_ylim())
    axes.set_xlabel(factor)
    axes.set_ylabel(f"median |error| of {SYMBOLS[name]} [%]")
