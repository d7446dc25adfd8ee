"""The pictures of a study of solvers: profiles, time against accuracy, and growth."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TypeAlias

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from sparsefit.arrays import Array
from sparsefit.study.evidence.solver_measures import (
    MISSING,
    Times,
    growth,
    level_text,
    objectives,
    steps,
    times_to,
)
from sparsefit.study.report.drawing import (
    COLOURS,
    GREY,
    MARKERS,
    STYLES,
    laid_out,
    logarithmic,
    panels,
    shortened,
)
from sparsefit.study.spec.solver_study import SolverStudy

FLOOR = 1e-16  # an excess below it is drawn there
SHORT = 150.0  # ends of an axis that has few decades
Look: TypeAlias = Mapping[str, Mapping[str, object]]
CAPTIONS = {
    "profiles": "Performance profiles: the share of problems that a solver solves to the accuracy "
    "in at most so many times the time of the fastest solver of each. Left: how often it is the "
    "fastest; right: how often it solves at all.",
    "data-profiles": "Data profiles: the share of problems solved to the accuracy within so many "
    "seconds of CPU time.",
    "accuracy": "Every case that answered: its CPU time against the certified excess of its worst "
    "point. Dotted: the accuracies at which success is counted.",
    "growth": "Time along swept problems, to the middle accuracy.",
}


def figures_of(study: SolverStudy, cases: pd.DataFrame) -> dict[str, Figure]:
    """The pictures by the name of their file; those that have something to show."""
    look = _looks(cases)
    draw = {
        "profiles": lambda: _profiles(study, cases, look, _performance),
        "data-profiles": lambda: _profiles(study, cases, look, _data),
        "accuracy": lambda: _accuracy(study, cases, look),
    }
    grown = growth(cases, study.accuracies[len(study.accuracies) // 2])
    if len(grown):
        draw["growth"] = lambda: _growth(grown, look)
    return {name: laid_out(figure) for name, figure in draw.items()}


def _looks(cases: pd.DataFrame) -> Look:
    """A look per solver: colours first, then line styles and markers, so that all differ."""
    names = list(dict.fromkeys(cases[cases["status"] != MISSING]["solver"]))
    return {
        name: {
            "color": COLOURS[place % len(COLOURS)],
            "linestyle": STYLES[place // len(COLOURS) % len(STYLES)],
            "marker": MARKERS[(place + place // len(COLOURS)) % len(MARKERS)],
        }
        for place, name in enumerate(names)
    }


Drawn: TypeAlias = Callable[[Axes, Times, Look, bool], None]


def _profiles(study: SolverStudy, cases: pd.DataFrame, look: Look, draw: Drawn) -> Figure:
    """A row per objective, a column per accuracy."""
    rows = objectives(cases)
    figure, grid = panels(len(rows), len(study.accuracies), height=1.0 + 2.0 * len(rows))
    for objective, axes_row in zip(rows, grid, strict=True):
        for accuracy, axes in zip(study.accuracies, axes_row, strict=True):
            one = times_to(cases, objective, accuracy)
            draw(axes, one, look, objective == rows[-1])
            axes.set_ylim(-0.03, 1.03)
            axes.set_title(f"{shortened(objective, 34)}\n{level_text(accuracy)}")
            if accuracy != study.accuracies[0]:
                axes.tick_params(labelleft=False)
        axes_row[0].set_ylabel("share of problems")
    _legend(figure, look, marked=False)
    return figure


def _performance(axes: Axes, one: Times, look: Look, last: bool) -> None:
    ratios = one.ratios()
    finite = ratios[np.isfinite(ratios)]
    end = max(float(finite.max(initial=1.0)) * 1.5, 10.0)
    _steps(axes, one, ratios, (1.0, end), look)
    if last:
        axes.set_xlabel("times the fastest")


def _data(axes: Axes, one: Times, look: Look, last: bool) -> None:
    finite = one.seconds[one.solved]
    low, high = float(finite.min(initial=1e-3)), float(finite.max(initial=1.0))
    _steps(axes, one, one.seconds, (0.7 * low, 1.5 * high), look)
    if last:
        axes.set_xlabel("CPU time [s]")


def _steps(axes: Axes, one: Times, values: Array, ends: tuple[float, float], look: Look) -> None:
    axes.set_xscale("log")
    axes.set_xlim(*ends)
    _powers(axes, "x")
    for place, solver in enumerate(one.solvers):
        style = look[solver]
        # Lines that agree lie on each other: the first are drawn wider, so that all are seen.
        width = 2.2 - 1.4 * place / max(len(one.solvers) - 1, 1)
        axes.plot(
            *steps(values[:, place], *ends),
            color=str(style["color"]),
            linestyle=str(style["linestyle"]),
            linewidth=width,
            drawstyle="steps-post",
        )


def _accuracy(study: SolverStudy, cases: pd.DataFrame, look: Look) -> Figure:
    """A panel per objective: CPU time against the certified excess of each case."""
    rows = objectives(cases)
    columns = min(len(rows), 3)
    lines = -(-len(rows) // columns)
    figure, grid = panels(lines, columns, height=1.2 + 2.6 * lines)
    every = [axes for row in grid for axes in row]
    for objective, axes in zip(rows, every, strict=False):
        here = cases[
            cases["objective"].eq(objective) & cases["excess"].notna() & cases["cpu"].gt(0)
        ]
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_ylim(0.3 * FLOOR, 3.0)
        for level in study.accuracies:
            axes.axhline(level, color=GREY, linewidth=0.6, linestyle=":")
        for solver, mine in here.groupby("solver", sort=False):
            style = look[str(solver)]
            axes.plot(
                mine["cpu"].to_numpy(float),
                np.clip(mine["excess"].to_numpy(float), FLOOR, 1.0),
                color=str(style["color"]),
                marker=str(style["marker"]),
                linestyle="none",
                markersize=3.0,
                markeredgewidth=0,
                alpha=0.75,
            )
        _powers(axes, "x")
        _powers(axes, "y")
        axes.set_title(shortened(objective, 34))
        axes.set_xlabel("CPU time [s]")
    for axes in every[len(rows) :]:
        axes.set_visible(False)
    for row in grid:
        row[0].set_ylabel("certified excess")
    _legend(figure, look, marked=True, lined=False)
    return figure


def _growth(grown: pd.DataFrame, look: Look) -> Figure:
    """A row per swept series, a column per objective: time against size."""
    series = list(dict.fromkeys(grown["series"]))
    columns = list(dict.fromkeys(grown["objective"]))
    figure, grid = panels(len(series), len(columns), height=1.0 + 2.3 * len(series))
    for name, axes_row in zip(series, grid, strict=True):
        for objective, axes in zip(columns, axes_row, strict=True):
            here = grown[(grown["series"] == name) & (grown["objective"] == objective)]
            axes.set_xscale("log")
            axes.set_yscale("log")
            for solver, mine in here.groupby("solver", sort=False):
                style = look[str(solver)]
                ordered = mine.sort_values("size")
                seconds = ordered["seconds"].to_numpy(float)
                axes.plot(
                    ordered["size"].to_numpy(float),
                    np.where(np.isfinite(seconds), seconds, np.nan),
                    color=str(style["color"]),
                    linestyle=str(style["linestyle"]),
                    marker=str(style["marker"]),
                    markersize=3.0,
                    linewidth=1.0,
                )
            axes.set_title(f"{shortened(str(name), 30)}\n{shortened(objective, 30)}")
            sizes = np.unique(here["size"].to_numpy(float))
            axes.set_xticks(sizes, [f"{size:g}" for size in sizes])
            axes.xaxis.set_minor_formatter(NullFormatter())
            _powers(axes, "y")
            if len(here):
                axes.set_xlabel(str(here["along"].iloc[0]))
        axes_row[0].set_ylabel("CPU time [s]")
    _legend(figure, look, marked=True)
    return figure


def _powers(axes: Axes, which: str) -> None:
    """1000 or 1e-08 at the decades, 0.02 and 0.05 between few of them: no mathematics is set."""
    axis = axes.xaxis if which == "x" else axes.yaxis
    low, high = axes.get_xlim() if which == "x" else axes.get_ylim()
    if low > 0.0 and high / low < SHORT:
        logarithmic(axis, low, high)
        return
    axis.set_major_locator(LogLocator(numticks=6))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def _legend(figure: Figure, look: Look, *, marked: bool, lined: bool = True) -> None:
    handles = [
        Line2D([], [], color=str(style["color"]), markersize=4, label=name)
        for name, style in look.items()
    ]
    for line, style in zip(handles, look.values(), strict=True):
        line.set(
            linestyle=style["linestyle"] if lined else "none",
            marker=style["marker"] if marked else "",
        )
    figure.legend(handles=handles, loc="outside upper center", ncols=min(len(handles), 4))
