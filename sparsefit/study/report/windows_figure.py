"""The error against the seconds flown, with the 5 % and 1 % lines."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sparsefit.study.evidence.summary import FLOOR, Group, StudyRecord, first_settings
from sparsefit.study.evidence.windows import LIMITS, SHARES, by_duration, duration_groups
from sparsefit.study.report.drawing import GREY, colours, logarithmic, markers, panels, ticked

HIGHEST = 300.0  # percent: what is worse is no answer, and leaves the frame


def windows_figure(study: StudyRecord, cases: pd.DataFrame, weights: pd.DataFrame | None) -> Figure:
    """Draw the error that the median flight, and 9 in 10, keep after so many seconds.

    A row per protocol, a line per back-end (its first listed setting). A line is broken where
    the flight it stands for has no estimate.

    Raises:
        InputError: if the study does not sweep the duration.
    """
    duration_groups(study, cases)  # refuses what has nothing to show
    lines = first_settings(cases)
    backends = list(dict.fromkeys(line.title for line in lines))
    protocols = list(dict.fromkeys(str(line.key["protocol"]) for line in lines))
    figure, grid = panels(len(protocols), len(SHARES), height=0.7 + 2.3 * len(protocols))
    for protocol, row in zip(protocols, grid, strict=True):
        own = [line for line in lines if line.key["protocol"] == protocol]
        for (words, share), axes in zip(SHARES.items(), row, strict=True):
            _panel(axes, own, backends, share)
            axes.set_ylabel(f"largest |error|, {words} [%]")
        if len(protocols) > 1:
            row[0].set_title(protocol, loc="left", fontweight="bold")
    every = [axes for row in grid for axes in row]
    low = min(axes.get_ylim()[0] for axes in every)
    high = min(max(axes.get_ylim()[1] for axes in every), HIGHEST)
    for axes in every:
        axes.set_ylim(low, high)
        logarithmic(axes.yaxis, low, high)
    for axes in grid[-1]:
        axes.set_xlabel("seconds flown")
    handles, labels = grid[0][0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=min(len(handles), 6))
    return figure


def _panel(axes: Axes, lines: list[Group], backends: list[str], share: float) -> None:
    colour, marker = colours(backends), markers(backends)
    for order, line in enumerate(lines):
        seconds, kept = by_duration(line.cases, share)
        # Lines that agree lie on each other: the first are drawn wider, so that all are seen.
        width = 2.8 - 1.9 * order / max(len(lines) - 1, 1)
        shown = np.where(np.isfinite(kept), np.maximum(kept, FLOOR), np.nan)
        axes.plot(
            seconds, shown, color=colour[line.title], marker=marker[line.title],
            ms=1.5 + 1.5 * width, lw=width, mew=0, label=line.title, zorder=3,
        )  # fmt: skip
    axes.set_yscale("log")
    for limit in LIMITS:
        axes.axhline(limit, color=GREY, lw=0.9, ls="--", zorder=2)
        axes.text(
            1.01, limit, f"{limit:g} %", transform=axes.get_yaxis_transform(), ha="left",
            va="center", fontsize=6.5, color=GREY,
        )  # fmt: skip
    ticked(axes, seconds)
    axes.set_xlim(seconds[0] / 1.15, seconds[-1] * 1.15)
