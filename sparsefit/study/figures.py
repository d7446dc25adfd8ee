"""The figures of a study: lines along a factor, errors as shares, estimated against true, profiles.

A legend names what is drawn: curves that coincide are one, and where there are more than a legend
takes, the rest are grey. A picture without a mark is a sentence.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sparsefit.errors import InputError
from sparsefit.plot.style import (
    GREY,
    labels,
    legend,
    logarithmic,
    panels,
    styled,
    wrapped,
)
from sparsefit.study.curves import LOG_RANGE, NAMED_CURVES, Looks, ecdf, lines, numeric_factors
from sparsefit.study.entries import (
    Entry,
    Options,
    Script,
    grouped,
    read_entry,
)
from sparsefit.study.measures import (
    PARAMETERS,
    SYMBOLS,
    UNITS,
    answered,
    bounded,
    factors,
    in_flow,
    measure,
    numbers,
    three,
)
from sparsefit.study.solver_pictures import by_shape, solver_accuracy, solver_profiles
from sparsefit.study.statistics import QUANTILES


@dataclass(frozen=True, eq=False)
class Picture:
    """A figure with its caption; without a figure the caption says why there is none."""

    figure: Figure | None
    caption: str


def best_titles(cases: pd.DataFrame) -> list[str]:
    """Return the title of least median of the largest error in each reading, four at most."""
    each, best = measure("largest-error"), []
    groups = ["reading"] if "reading" in cases else ["protocol"]
    for _, places in grouped(cases, groups):
        part = cases.iloc[places]
        scores = {
            str(title): each.summarise(part.iloc[here])
            for (title,), here in grouped(part, ["title"])
        }
        best.append(min(scores, key=lambda name: (math.isnan(scores[name]), scores[name])))
    return list(dict.fromkeys(best))[:4]


def scatter(entry: Entry, cases: pd.DataFrame) -> Figure | None:
    """Draw estimated against true parameters, of the best candidate of each reading.

    Colours are conditions. What lies outside of the frame is a triangle on its edge, a failure a
    cross, each counted.
    """
    flown = cases[in_flow(cases)]
    titles = best_titles(flown) if len(flown) else []
    if not titles or not answered(flown).any():
        return None
    names = list(map(str, flown["condition"].unique()))
    if len(names) > NAMED_CURVES:
        flown, names = flown.assign(condition="all conditions"), ["all conditions"]
    looks = Looks(names)
    figure, grid = panels(len(titles), 3, height=0.9 + 2.15 * len(titles))
    short = labels(titles, 60)
    for title, row in zip(titles, grid, strict=True):
        part = flown[flown["title"] == title]
        for name, axes in zip(PARAMETERS, row, strict=True):
            _scattered(axes, part, name, looks)
            axes.set_ylabel(f"estimated {SYMBOLS[name]} [{UNITS[name]}]")
        row[0].set_ylabel(f"{wrapped(short[title], 30)}\n\n{row[0].get_ylabel()}")
    for name, axes in zip(PARAMETERS, grid[-1], strict=True):
        axes.set_xlabel(f"true {SYMBOLS[name]} [{UNITS[name]}]")
    if len(names) > 1:
        legend(figure, [axes for row in grid for axes in row])
    return figure


def _scattered(axes: Axes, cases: pd.DataFrame, name: str, looks: Looks) -> None:
    true, estimate = numbers(cases, f"true_{name}"), numbers(cases, f"est_{name}")
    low, high = float(np.nanmin(true)), float(np.nanmax(true))
    if low > 0 and high / low > LOG_RANGE:
        axes.set_xscale("log")
        axes.set_yscale("log")
        low, high = low / 2.0, high * 2.0
        logarithmic(axes.xaxis, low, high)
        logarithmic(axes.yaxis, low, high)
    else:
        room = 0.3 * (high - low) or 0.5 * abs(high) or 1.0
        low, high = low - room if low < 0 else max(low - room, 0.0), high + room
    axes.plot([low, high], [low, high], color=GREY, lw=0.8, zorder=1)
    axes.set_xlim(low, high)
    axes.set_ylim(low, high)
    axes.set_aspect("equal", adjustable="box")
    usable = answered(cases)
    above, below = usable & (estimate > high), usable & (estimate < low)
    parts = (
        ("o", usable & ~above & ~below, None, ""),
        ("^", above, 0.975, "▲ {} above"), ("v", below, 0.025, "▼ {} below"),
        ("x", ~usable, 0.09, "× {} failed"),
    )  # fmt: skip
    for condition in looks.names:
        mine = (cases["condition"] == condition).to_numpy()
        ink = looks.of(condition)["color"]
        for sign, mask, height, _ in parts:
            chosen = mask & mine
            edge = axes.get_xaxis_transform()  # on the frame itself, whatever its scale
            more: dict[str, Any] = {"transform": edge, "clip_on": False, "linewidth": 0.8}
            if height is None:
                more = {"edgecolor": "white", "linewidth": 0.3, "label": looks.label(condition)}
            y = estimate[chosen] if height is None else np.full(int(chosen.sum()), height)
            axes.scatter(true[chosen], y, s=12, marker=sign, c=ink, alpha=0.85, zorder=3,
                         gid=looks.gid(condition), **more)  # fmt: skip
    words = [text.format(int(mask.sum())) for _, mask, _, text in parts if text and mask.any()]
    axes.set_title("  ".join(words), fontsize=6.5, color=GREY, loc="right", pad=5)


LAYOUTS: Mapping[str, Callable[[Entry, pd.DataFrame], Figure | None]] = {
    "settings": lines,
    "lines": lines,
    "protocols": lines,
    "ecdf": ecdf,
    "scatter": scatter,
    "profiles": solver_profiles,
    "accuracy": solver_accuracy,
    "shapes": by_shape,
}
ERRORS = three("error")[::-1]
NAMED: Mapping[str, Options] = {
    "scatter": {"compare": "scatter"},
    "errors": {"compare": "ecdf", "measure": three("size"), "limits": (5.0,)},
    "sweep": {"compare": "lines", "measure": ERRORS},
    "methods": {"compare": "lines", "measure": ("timescale-error",),
                "along": "flights.measurement_noise"},
    "efficiency": {"compare": "lines", "along": "flights.process_noise",
                   "measure": three("efficiency")[:2]},
    "scales": {"compare": "lines", "measure": ("scales-found",)},
    "coverage": {"compare": "lines", "along": "condition", "limits": (93.0, 97.0),
                 "measure": three("coverage")},
    "profiles": {"compare": "profiles"},
    "accuracy": {"compare": "accuracy"},
    "shapes": {"compare": "shapes"},
}  # fmt: skip
CAPTIONS = {
    "scatter": "Estimated against true, {titles}. Triangles: outside the frame; crosses: failures.",
    "profiles": "Share of problems solved in at most so many times the time of the fastest solver "
    "of each. Left: how often a solver is the fastest; right: how often it solves at all.",
    "accuracy": "Every case that answered: its time against the certified excess of its worst "
    "point. Dotted: the accuracies at which success is counted.",
    "shapes": "Time to the strictest accuracy, problem by problem; no point: not solved.",
}


def figure(study: Any, entry: str | Options) -> Figure:
    """Return the figure that an entry asks for, of the cases of a study.

    Raises:
        InputError: for what is unknown, or where there is no mark to draw.
    """
    _, picture = _picture(study, entry, study.cases, Script.of(study))
    if picture.figure is None:
        raise InputError(f"{study.name}: {picture.caption}")
    return picture.figure


def _picture(
    study: Any, entry: str | Options, cases: pd.DataFrame, script: Script
) -> tuple[str, Picture]:
    """Return a picture and the name of its file."""
    if isinstance(entry, str) and entry in script.functions:

        def scripted() -> Figure:
            made = script.call(entry, study, cases)
            if not isinstance(made, Figure):
                raise InputError(f"{script.path}: {entry}(cases) returned no figure")
            return made

        return entry, Picture(styled(scripted), entry.replace("_", " ").capitalize())
    read = read_entry(entry, NAMED, LAYOUTS, "figure", script)
    name = read.file_name
    marked = styled(lambda: LAYOUTS[read.compare or "settings"](read, cases))
    if marked is None:
        words = ", ".join(each.words for each in read.measures) or "an answer"
        return name, Picture(None, f"{name}: nothing to draw, no case has {words}.")
    return name, Picture(marked, _caption(read, cases))


def _caption(entry: Entry, cases: pd.DataFrame) -> str:
    if entry.compare == "scatter":
        count = cases["title"].nunique()
        titles = "; ".join(best_titles(cases[in_flow(cases)]))
        return CAPTIONS["scatter"].format(
            titles=titles if count == 1 else f"the best of {count} by reading: {titles}"
        )
    if entry.compare in CAPTIONS:
        return CAPTIONS[entry.compare]
    words = "; ".join(dict.fromkeys(each.phrase for each in entry.measures))
    if entry.compare == "ecdf":
        words = "; ".join(dict.fromkeys(each.words for each in entry.measures))
        return f"Share of planned cases with at most so much: {words}. Failures never get there."
    failing = [each for each in entry.measures if each.miss is not None]
    ranks = any(each.summary in QUANTILES for each in failing)
    more = " A failure ranks behind every number; where it decides, a line breaks." if ranks else ""
    shares = any(each.summary == "share" for each in entry.measures)
    bars = " Bars: 95 % Wilson intervals." if shares else ""
    return f"{words[:1].upper()}{words[1:]}.{more}{bars}"


def figures(study: Any, cases: pd.DataFrame) -> dict[str, Picture]:
    """Return the pictures that a study asks for, or all that fit, by file name."""
    script = Script.of(study)
    entries = study.definition.outputs.figures or fitting(cases)
    return dict(_picture(study, entry, cases, script) for entry in entries)


def fitting(cases: pd.DataFrame) -> list[str]:
    """Return the names of the figures that have something to show of these cases."""
    if "objective" in cases:
        return ["profiles", "shapes", "accuracy"]
    several = cases["flight"].nunique() > 1 and bool(in_flow(cases).any())
    says = {
        "sweep": several and bool(numeric_factors(cases)),
        "errors": several,
        "scatter": several,
        "efficiency": bool(bounded(cases).any()) and "flights.process_noise" in factors(cases),
        "coverage": several and np.isfinite(measure("length-scale-coverage").values(cases)).any(),
    }
    return [name for name, holds in says.items() if holds]
