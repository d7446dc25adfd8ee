"""Errors against the Cramér-Rao bound, as noise, sampling and time in the air change."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from sparsefit.arrays import Array
from sparsefit.errors import InputError
from sparsefit.study.evidence.efficiency import bounded, percent_of_truth, ratios, rms
from sparsefit.study.evidence.summary import (
    PARAMETERS,
    SYMBOLS,
    Group,
    StudyRecord,
    factors,
    first_settings,
    grouped,
    signed_errors,
    three_of,
)
from sparsefit.study.report.drawing import GREY, colours, logarithmic, markers, panels, ticked
from sparsefit.study.report.error_figures import numeric_factors

NOISE = "flights.process_noise"
STYLES = ("-", "--", ":", "-.")
LEGIBLE = 8  # rows: with more, nobody reads the picture unless the study asks for it
WORDS = {"flights.duration": "{:g} s flown", "flights.sample_rate": "{:g} Hz"}
PANELS = (("length_scale", False), ("length_scale", True), ("mean_velocity", True))


def efficiency_figure(
    study: StudyRecord, cases: pd.DataFrame, weights: pd.DataFrame | None
) -> Figure:
    """Draw rms error with the bound, and rms of error / bound, against the process noise.

    A row per combination of the other swept factors; a colour per back-end (its first listed
    setting), a line style per protocol.

    Raises:
        InputError: if the study does not sweep the process noise, or no flight has a bound.
    """
    if NOISE not in numeric_factors(cases) or bounded(cases).empty:
        raise InputError(
            f'{study.name} has no bound over a swept "{NOISE}": '
            'drop the figure "efficiency" from [outputs]'
        )
    others = [name for name in factors(cases) if name != NOISE]
    facets = grouped(cases, others) if others else [Group({}, cases)]
    lines = first_settings(cases)
    backends = list(dict.fromkeys(line.title for line in lines))
    protocols = list(dict.fromkeys(str(line.key["protocol"]) for line in lines))
    figure, grid = panels(len(facets), len(PANELS), height=0.9 + 1.55 * len(facets))
    for facet, row in zip(facets, grid, strict=True):
        kept = facet.cases.index
        here = [
            Group(one.key, one.cases.loc[one.cases.index.isin(kept)], one.setting) for one in lines
        ]
        for (name, relative), axes in zip(PANELS, row, strict=True):
            _panel(axes, name, here, (backends, protocols), relative=relative)
            if axes is row[0] and facet.key:
                axes.set_title(_words(facet), loc="left", fontweight="bold")
    for axes in grid[-1]:
        axes.set_xlabel("process noise [m/s²]")
    _legend(figure, backends, protocols)
    return figure


def legible(cases: pd.DataFrame) -> bool:
    """Whether there is a bound over a swept process noise, in no more rows than can be read."""
    if NOISE not in numeric_factors(cases) or bounded(cases).empty:
        return False
    others = [name for name in factors(cases) if name != NOISE]
    return not others or len(grouped(cases, others)) <= LEGIBLE


def _words(facet: Group) -> str:
    return ", ".join(
        WORDS.get(name, name + " = {}").format(value) for name, value in facet.key.items()
    )


def _panel(
    axes: Axes,
    name: str,
    lines: Sequence[Group],
    names: tuple[list[str], list[str]],
    *,
    relative: bool,
) -> None:
    backends, protocols = names
    colour, marker, place = colours(backends), markers(backends), PARAMETERS.index(name)
    for order, line in enumerate(lines):
        noise, values = _curve(line.cases, place, relative=relative)
        # Lines that agree lie on each other: the first are drawn wider, so that all are seen.
        width = 2.6 - 1.8 * order / max(len(lines) - 1, 1)
        style = STYLES[protocols.index(str(line.key["protocol"])) % len(STYLES)]
        axes.plot(
            noise, values, color=colour[line.title], marker=marker[line.title], lw=width,
            ms=1.3 + 1.4 * width, ls=style, mew=0, zorder=3,
        )  # fmt: skip
    if relative:
        axes.axhline(1.0, color="black", lw=1.0, zorder=4)
        axes.set_ylabel(f"{SYMBOLS[name]}: rms error/bound")
    else:
        noise, values = _bound([line.cases for line in lines], place)
        axes.plot(noise, values, color="black", lw=1.0, zorder=4)
        axes.set_ylabel(f"{SYMBOLS[name]}: rms error [%]")
    axes.set_yscale("log")
    logarithmic(axes.yaxis, *axes.get_ylim())
    ticked(axes, np.unique(np.concatenate([line.cases[NOISE].to_numpy(float) for line in lines])))


def _curve(cases: pd.DataFrame, place: int, *, relative: bool) -> tuple[Array, Array]:
    levels = sorted(grouped(cases, [NOISE]), key=lambda one: float(one.key[NOISE] or 0.0))
    noise = np.array([float(level.key[NOISE] or 0.0) for level in levels])
    values = [rms(_measure(level.cases, relative=relative))[place] for level in levels]
    return noise, np.array(values)


def _measure(cases: pd.DataFrame, *, relative: bool) -> Array:
    if relative:
        return ratios(cases)
    kept = bounded(cases)
    percent: Array = 100.0 * signed_errors(kept) / three_of(kept, "true")
    return percent


def _bound(lines: Sequence[pd.DataFrame], place: int) -> tuple[Array, Array]:
    """Rms bound [%] over the flights that every line called ok, each once.

    Those that a line gave up are the hardest: with them the bound would stand above its errors.
    """
    every = pd.concat([bounded(line) for line in lines])
    shared = every.groupby(["flight", NOISE])[NOISE].transform("size") == len(lines)
    once = every[shared].drop_duplicates(["flight", NOISE])
    levels = sorted(grouped(once, [NOISE]), key=lambda one: float(one.key[NOISE] or 0.0))
    noise = np.array([float(level.key[NOISE] or 0.0) for level in levels])
    return noise, np.array([rms(percent_of_truth(one.cases, "bound"))[place] for one in levels])


def _legend(figure: Figure, backends: list[str], protocols: list[str]) -> None:
    colour, marker = colours(backends), markers(backends)
    handles = [
        Line2D([], [], color=colour[name], marker=marker[name], ms=4, label=name)
        for name in backends
    ]
    handles.append(Line2D([], [], color="black", lw=1.0, label="Cramér-Rao bound"))
    if len(protocols) > 1:
        handles += [
            Line2D([], [], color=GREY, ls=STYLES[place % len(STYLES)], label=name)
            for place, name in enumerate(protocols)
        ]
    figure.legend(handles=handles, loc="outside upper center", ncols=5)
