"""Median error of tau_w against measurement noise, one line per protocol."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sparsefit.errors import InputError
from sparsefit.study.evidence.methods import FLOOR, NOISE, Line, lines
from sparsefit.study.evidence.summary import SYMBOLS, StudyRecord, factors
from sparsefit.study.report.drawing import COLOURS, colours, logarithmic, markers, panels, shortened

COLUMNS = 4  # back-end settings drawn


def has_methods(cases: pd.DataFrame) -> bool:
    """Whether the study sweeps the measurement noise."""
    return NOISE in factors(cases)


def methods_figure(study: StudyRecord, cases: pd.DataFrame, weights: pd.DataFrame | None) -> Figure:
    """Draw a panel per setting, and a row per level of what else is swept.

    Raises:
        InputError: if the study does not sweep the measurement noise.
    """
    if not has_methods(cases):
        raise InputError(
            f'{study.name} does not sweep {NOISE}: drop the figure "methods" from [outputs]'
        )
    every = lines(cases)
    names = [name.rpartition(".")[2] for name in factors(cases) if name != NOISE]
    rows = list(dict.fromkeys(line.others for line in every))
    settings = list(dict.fromkeys(line.setting for line in every))[:COLUMNS]
    protocols = list(dict.fromkeys(line.protocol for line in every))
    colour, marker = colours(protocols), markers(protocols)
    style = {one: "--" if place >= len(COLOURS) else "-" for place, one in enumerate(protocols)}
    figure, grid = panels(len(rows), len(settings), height=0.9 + 2.1 * len(rows))
    for others, row in zip(rows, grid, strict=True):
        for setting, axes in zip(settings, row, strict=True):
            own = [line for line in every if (line.others, line.setting) == (others, setting)]
            for line in own:
                name = line.protocol
                _draw(axes, line, colour[name], marker[name], style[name])
            axes.set_yscale("log")
            axes.set_title(shortened(setting.replace("alpha_fraction=", "alpha "), 24))
        _share(row)
        told = [f"{name} = {one}" for name, one in zip(names, others, strict=True)]
        row[0].set_ylabel("\n".join([*told, f"median |error| of {SYMBOLS['timescale']} [%]"]))
    for axes in grid[-1]:
        axes.set_xlabel("noise [m/s] / [m]")
    handles, labels = grid[0][0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=4)
    return figure


def _draw(axes: Axes, line: Line, colour: str, marker: str, style: str) -> None:
    sizes = np.array([max(one, FLOOR) for one in line.levels.values()])
    axes.plot(
        np.arange(len(sizes)),
        np.where(np.isfinite(sizes), sizes, np.nan),
        color=colour,
        marker=marker,
        ms=3.5,
        lw=1.2,
        ls=style,
        label=line.protocol,
    )
    axes.set_xticks(np.arange(len(sizes)), [name.replace(" / ", "/\n") for name in line.levels])


def _share(row: list[Axes]) -> None:
    """One error axis for the panels of a row, numbered at its left."""
    ends = [axes.get_ylim() for axes in row]
    low, high = min(one[0] for one in ends), max(one[1] for one in ends)
    for place, axes in enumerate(row):
        axes.set_ylim(low, high)
        logarithmic(axes.yaxis, low, high)
        if place:
            axes.tick_params(labelleft=False)
