"""How often the 95 % intervals held the truth, regime by regime."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from sparsefit.study.evidence.confidence import held
from sparsefit.study.evidence.summary import SYMBOLS, StudyRecord, by_setting, factors, in_a_flow
from sparsefit.study.report.drawing import COLOURS, GREY, panels, shortened
from sparsefit.study.report.error_figures import ROWS

ORDER = ("length_scale", "mean_velocity", "timescale")
BAND = (93.0, 97.0)  # percent
LOWEST = 80.0  # of the axis, unless something lies below


def coverage_figure(
    study: StudyRecord, cases: pd.DataFrame, weights: pd.DataFrame | None
) -> Figure:
    """Draw the coverage of each setting and level with its Wilson interval, and the 95 % line."""
    swept = factors(cases)
    groups = by_setting(cases[in_a_flow(cases)], *swept)[:ROWS]
    names = [_name([group.key[name] for name in ("protocol", *swept)]) for group in groups]
    if len(set(names)) < len(names):
        names = [f"{name}, {group.title}" for name, group in zip(names, groups, strict=True)]
    figure, (row,) = panels(1, 3, height=1.0 + 0.26 * len(groups))
    lowest = LOWEST
    for parameter, axes in zip(ORDER, row, strict=True):
        for place, group in enumerate(groups):
            share, _ = held(group.cases, parameter)
            low, high = share.interval
            if not share.whole:
                axes.text(BAND[0], place, "no interval", fontsize=6.5, color=GREY, va="center")
            axes.plot([low, high], [place, place], color="black", lw=0.9, zorder=3)
            axes.plot([share.percent], [place], "o", ms=4, color=COLOURS[0], zorder=4)
            lowest = min(lowest, low - 2.0) if np.isfinite(low) else lowest
        axes.axvspan(*BAND, color="#DDE8F0", lw=0, zorder=0)
        axes.axvline(95.0, color=GREY, lw=0.8, zorder=1)
        axes.set_ylim(len(groups) - 0.4, -0.6)
        axes.set_yticks(range(len(groups)), [""] * len(groups))
        axes.grid(False, axis="y")
        axes.set_xlabel(f"coverage of {SYMBOLS[parameter]} [%]")
    for axes in row:
        axes.set_xlim(max(lowest, -1.0), 101.0)
    row[0].set_yticks(range(len(groups)), [shortened(name, 44) for name in names])
    return figure


def _name(values: list[object]) -> str:
    return ", ".join(str(value) for value in values)
