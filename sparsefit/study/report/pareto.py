"""Accuracy against latency: who is worth deploying, and what it would cost to do better."""

from __future__ import annotations

import textwrap

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sparsefit.study.evidence.cases import DEFAULT, level_text
from sparsefit.study.evidence.selection import Scored, Selection
from sparsefit.study.evidence.sentence import capital
from sparsefit.study.report.drawing import (
    GREY,
    colours,
    legend,
    logarithmic,
    markers,
    panels,
    shortened,
    with_unit,
)

LETTERS = 60  # of a line beside the axis
DECADE = 8.0  # from here on, an axis is logarithmic
CAPTION = (
    "The criterion on the evaluate flights, with its 95 % interval over flights, against the "
    "latency of one estimate: from the median to the 99th percentile. Ringed: the chosen one. "
    "Hollow: does not keep the constraints. Line: the Pareto front, what nothing beats in both."
)


def pareto(selection: Selection) -> Figure:
    """Draw every candidate that was timed, and the front of those that keep the constraints."""
    timed = [one for one in selection.ranked if one.latency and np.isfinite(one.latency.median)]
    figure, ((axes,),) = panels(1, 1, height=4.0)
    readings = list(dict.fromkeys(map(_reading, timed)))
    backends = list(dict.fromkeys(str(one.candidate.group.key["backend"]) for one in timed))
    colour, marker = colours(backends), markers(readings)
    for one in timed:
        _point(axes, one, colour, marker)
    _front(axes, selection, timed)
    _scales(axes, timed)
    axes.set_xlabel("latency of one estimate [ms]")
    words = with_unit(capital(selection.criterion.words), selection.criterion.measure.unit)
    axes.set_ylabel(textwrap.fill(words, LETTERS))
    legend(figure, [axes])
    return figure


def front(selection: Selection, timed: list[Scored]) -> list[Scored]:
    """Those that keep the constraints and that none beats in both, the fastest first."""
    best, kept = np.inf, []
    for one in sorted((one for one in timed if one.passes), key=_place):
        loss = float(selection.criterion.loss(np.asarray(one.evaluate)))
        if loss < best:
            best = loss
            kept.append(one)
    return kept


def _place(one: Scored) -> tuple[float, float]:
    return (one.latency.median if one.latency else np.inf, one.evaluate)


def _reading(one: Scored) -> str:
    """What tells candidates of one back-end apart: the reading and the estimator's factors."""
    levels = map(level_text, one.candidate.factors.values())
    protocol = one.candidate.group.protocol
    return ", ".join([*([] if protocol == DEFAULT else [protocol]), *levels])


def _point(axes: Axes, one: Scored, colour: dict[str, str], marker: dict[str, str]) -> None:
    if one.latency is None:
        return
    backend, reading = str(one.candidate.group.key["backend"]), _reading(one)
    ink, x, y = colour[backend], 1e3 * one.latency.median, one.evaluate
    label = f"{backend}, {shortened(reading, 30)}" if reading else backend
    low, high = one.between
    if one.apart is None and one.passes:
        axes.plot([x], [y], "o", ms=13, mfc="none", mec="black", mew=1.0, zorder=2)
    axes.plot([x, 1e3 * one.latency.p99], [y, y], color=ink, lw=0.7, alpha=0.6, zorder=3)
    axes.plot([x, x], [low, high], color=ink, lw=0.7, alpha=0.6, zorder=3)
    axes.plot(
        [x], [y], marker[reading], ms=5, color=ink, zorder=4, label=label, ls="none",
        mfc=ink if one.passes else "white",
    )  # fmt: skip


def _front(axes: Axes, selection: Selection, timed: list[Scored]) -> None:
    points = [
        (1e3 * one.latency.median, one.evaluate) for one in front(selection, timed) if one.latency
    ]
    if len(points) > 1:
        x, y = zip(*points, strict=True)
        axes.step(x, y, where="post", color=GREY, lw=0.9, ls="--", zorder=1)


def _scales(axes: Axes, timed: list[Scored]) -> None:
    times = [1e3 * one.latency.median for one in timed if one.latency]
    values = [one.evaluate for one in timed]
    if min(times) > 0 and max(times) / min(times) > 2.0:
        axes.set_xscale("log")
        logarithmic(axes.xaxis, *axes.get_xlim())
    if min(values) > 0 and max(values) / min(values) > DECADE:
        axes.set_yscale("log")
        logarithmic(axes.yaxis, *axes.get_ylim())
