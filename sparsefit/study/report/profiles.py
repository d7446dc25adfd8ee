"""Error profiles drawn: the share of flights with an error of at most x, a line per setting."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sparsefit.arrays import Array
from sparsefit.study.evidence.asked import Asked
from sparsefit.study.evidence.cases import (
    Group,
    by_setting,
    factors,
    groups_by,
    is_condition,
    level_text,
)
from sparsefit.study.evidence.measure import Measure
from sparsefit.study.evidence.profiles import profile_of
from sparsefit.study.report.drawing import (
    COLOURS,
    STYLES,
    legend,
    logarithmic,
    panels,
    shortened,
    with_unit,
)

if TYPE_CHECKING:
    from sparsefit.study.spec.study import Study

LETTERS = 36  # of a line under a panel
ACROSS = 3  # panels in a row
SMALLEST, LARGEST = 1e-3, 100.0  # percent: outside, an error is perfect or no answer


def profiles(asked: Asked, study: Study, cases: pd.DataFrame, _: object = None) -> Figure:
    """Draw the profiles of every setting and level, a panel per protocol and measure.

    Levels are those of the estimator's factors; those of the flights are pooled.
    """
    own = [name for name in factors(cases) if not is_condition(name)]
    asked.needs(study.name, "measure")
    parts = [
        (measure, protocol.protocol, protocol.cases)
        for measure in asked.measures
        for protocol in groups_by(cases, ["protocol"])
    ]
    across = min(ACROSS, len(parts))
    down = -(-len(parts) // across)
    figure, grid = panels(down, across, height=0.9 + 2.1 * down)
    every = [axes for row in grid for axes in row]
    every_setting = by_setting(cases, *own)
    settings = list(dict.fromkeys(group.title for group in every_setting))
    levels = list(dict.fromkeys(_levels(group, own) for group in every_setting))
    for axes, (measure, name, part) in zip(every, parts, strict=False):
        for group in by_setting(part, *own):
            place, level = settings.index(group.title), levels.index(_levels(group, own))
            axes.step(
                *_steps(measure, group.cases), where="post", lw=1.1,
                color=COLOURS[place % len(COLOURS)],
                ls=STYLES[(level + place // len(COLOURS)) % len(STYLES)],
                label=shortened(", ".join([group.title, *_levels(group, own)]), 40),
            )  # fmt: skip
        _frame(axes, measure, name if len(parts) > 1 else "")
    for axes in every[len(parts) :]:
        axes.set_axis_off()
    legend(figure, every[: len(parts)])
    return figure


def _levels(group: Group, own: list[str]) -> tuple[str, ...]:
    return tuple(level_text(group.key[name]) for name in own)


def _steps(measure: Measure, cases: pd.DataFrame) -> tuple[Array, Array]:
    """The corners of a profile, from the left edge of the frame to beyond the right one."""
    errors, shares = profile_of(measure, cases)
    x = np.concatenate([[SMALLEST], np.clip(errors, SMALLEST, None), [1e6]])
    return x, np.concatenate([[0.0], shares, shares[-1:] if shares.size else [0.0]])


def _frame(axes: Axes, measure: Measure, title: str) -> None:
    axes.set_xscale("log")
    axes.set_xlim(SMALLEST, LARGEST)
    logarithmic(axes.xaxis, SMALLEST, LARGEST)
    axes.set_ylim(0.0, 101.0)
    axes.set_xlabel(textwrap.fill(with_unit(measure.words, measure.unit), LETTERS))
    axes.set_ylabel("share of flights [%]")
    axes.set_title(title)
