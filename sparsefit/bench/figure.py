"""Time against gap: one panel per penalty, both axes logarithmic."""

from __future__ import annotations

from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import NullFormatter

from sparsefit.bench.contender import Contender
from sparsefit.bench.measure import LEVELS
from sparsefit.bench.ours import OURS, VARIANTS
from sparsefit.bench.problems import KINDS, Kind
from sparsefit.bench.report import TITLES
from sparsefit.bench.result import BenchResult
from sparsefit.study.report.drawing import COLOURS, GREY, STYLE, panels

FLOOR = 1e-16
SHAPES = ("o", "s", "D", "v", "P", "X", "^", "<", ">", "h", "p")


def time_against_gap(result: BenchResult) -> Figure:
    """Every run a small point, and the median time to each gap a line, in multiples of ours."""
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(STYLE)
        figure, grid = panels(1, len(KINDS), height=4.0)
        for axes, kind in zip(grid[0], KINDS, strict=True):
            _panel(axes, result, kind)
        grid[0][0].set_ylabel("relative duality gap, worst point of the path")
        shown = [c for c in result.contenders if c.installed and c.name not in VARIANTS[1:]]
        handles = [Line2D([], [], **_look(result, c)) for c in shown]
        figure.legend(handles, [c.name for c in shown], loc="outside lower center", ncols=4)
        figure.draw_without_rendering()
        figure.set_layout_engine("none")
        return figure


def _look(result: BenchResult, contender: Contender) -> dict[str, Any]:
    """Black star for ours; the others differ in marker and colour, seven colours in turn."""
    place = [c.name for c in result.contenders].index(contender.name)
    ours = contender.name == OURS
    colour = COLOURS[-1] if ours else COLOURS[:-1][place % (len(COLOURS) - 1)]
    marker = "*" if ours else SHAPES[place % len(SHAPES)]
    return {"color": colour, "marker": marker, "markersize": 9 if ours else 4.5, "linewidth": 1.0}


def _panel(axes: Axes, result: BenchResult, kind: Kind) -> None:
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_ylim(0.3 * FLOOR, 3.0)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter(_power)
        axis.set_minor_formatter(NullFormatter())
    axes.set_title(TITLES[kind])
    axes.set_xlabel("CPU time / sparsefit's")
    for level in LEVELS:
        axes.axhline(level, color=GREY, linewidth=0.5, linestyle=":")
    for contender in result.contenders:
        if kind in contender.kinds and contender.name not in VARIANTS[1:]:
            _draw(axes, result, kind, contender)


def _power(value: float, _: object) -> str:
    """1000 or 1e-08: the style of this package sets no mathematics."""
    return f"{value:g}"


def _draw(axes: Axes, result: BenchResult, kind: Kind, contender: Contender) -> None:
    look = _look(result, contender)
    runs = [
        run
        for problem in result.problems
        for run in result.of(kind, problem, contender.name)
        if run.seconds and np.isfinite(run.gap)
    ]
    if not runs:
        return
    times = [run.median / result.ours(kind, run.problem) for run in runs]
    gaps = [max(run.gap, FLOOR) for run in runs]
    faint = {**look, "markersize": 2.5, "alpha": 0.35, "linestyle": "none"}
    axes.plot(times, gaps, **faint)
    if len(contender.settings) > 1:
        reached = [(t, g) for g in LEVELS if np.isfinite(t := _median(result, kind, contender, g))]
        axes.plot([t for t, _ in reached], [g for _, g in reached], **look)
    else:
        # One setting: a single place.
        middle = float(np.exp(np.median(np.log(gaps))))
        axes.plot([float(np.median(times))], [middle], **look)


def _median(result: BenchResult, kind: Kind, contender: Contender, level: float) -> float:
    """Median over the problems; a gap that is not reached counts as infinitely slow."""
    times = []
    for problem in result.problems:
        at = result.reach(kind, problem, contender.name, level, "gap").seconds
        times.append(np.inf if at is None else at / result.ours(kind, problem))
    return float(np.quantile(times, 0.5, method="higher"))
