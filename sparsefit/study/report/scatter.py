"""Fig. 2: estimated against true, with every outlier and failure in sight."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sparsefit.arrays import Array, BoolArray
from sparsefit.study.evidence.asked import Asked
from sparsefit.study.evidence.cases import (
    SYMBOLS,
    UNITS,
    Group,
    estimated,
    factors,
    first_settings,
    in_a_flow,
    numbers,
)
from sparsefit.study.report.drawing import (
    GREY,
    colours,
    legend,
    logarithmic,
    markers,
    panels,
    shortened,
)
from sparsefit.study.report.vector import linked

if TYPE_CHECKING:
    from sparsefit.study.spec.study import Study

ORDER = ("timescale", "length_scale", "mean_velocity")
LOG_RANGE = 8.0


@dataclass(frozen=True)
class Frame:
    """The square window of a panel: what lies outside is drawn as a triangle on its edge."""

    low: float
    high: float
    log: bool

    @classmethod
    def around(cls, true: Array) -> Frame:
        """Return the window of the true values: estimates are not allowed to stretch it."""
        low, high = float(true.min()), float(true.max())
        if low > 0 and high / low > LOG_RANGE:
            return cls(low / 2.0, high * 2.0, True)
        margin = 0.3 * (high - low) or 0.5 * abs(high)
        return cls(max(low - margin, 0.0) if low >= 0 else low - margin, high + margin, False)


def scatter(_: Asked, study: Study, cases: pd.DataFrame, weights: object = None) -> Figure:
    """Draw Fig. 2: a row per back-end (its first listed setting), a colour per protocol.

    The first listed setting, and the first level of every swept factor: nothing here was chosen
    by looking at the truth.
    """
    firsts = first_listed(cases)
    backends = list(dict.fromkeys(str(group.key["backend"]) for group in firsts))
    protocols = list(dict.fromkeys(group.protocol for group in firsts))
    figure, grid = panels(len(backends), 3, height=0.75 + 2.15 * len(backends))
    for backend, row in zip(backends, grid, strict=True):
        shown = [group for group in firsts if group.key["backend"] == backend]
        for name, axes in zip(ORDER, row, strict=True):
            _panel(axes, name, shown, protocols)
        row[0].set_ylabel(f"{shortened(shown[0].title, 34)}\n\nestimated {SYMBOLS[ORDER[0]]} [s]")
    for name, axes in zip(ORDER, grid[-1], strict=True):
        axes.set_xlabel(f"true {SYMBOLS[name]} [{UNITS[name]}]")
    if len(protocols) > 1:
        legend(figure, grid[0][:1])
    return figure


def first_listed(cases: pd.DataFrame) -> list[Group]:
    """Return, for every protocol and back-end, its first setting and first sweep level."""
    return first_settings(cases[in_a_flow(cases)], *factors(cases))


def _panel(axes: Axes, name: str, shown: list[Group], protocols: list[str]) -> None:
    every = pd.concat([group.cases for group in shown])
    frame = Frame.around(numbers(every, f"true_{name}"))
    _set_up(axes, frame)
    if name != ORDER[0]:
        axes.set_ylabel(f"estimated {SYMBOLS[name]} [{UNITS[name]}]")
    colour, marker = colours(protocols), markers(protocols)
    for group in shown:
        _points(axes, name, group, frame, colour[group.protocol], marker[group.protocol])
    _counts(axes, Placed.of(every, name, frame))


def _set_up(axes: Axes, frame: Frame) -> None:
    if frame.log:
        axes.set_xscale("log")
        axes.set_yscale("log")
        logarithmic(axes.xaxis, frame.low, frame.high)
        logarithmic(axes.yaxis, frame.low, frame.high)
    axes.set_xlim(frame.low, frame.high)
    axes.set_ylim(frame.low, frame.high)
    axes.set_aspect("equal", adjustable="box")
    axes.plot([frame.low, frame.high], [frame.low, frame.high], color=GREY, lw=0.8, zorder=1)


@dataclass(frozen=True)
class Placed:
    """Cases by where their estimates lie: in the frame, above it, below it, or nowhere."""

    inside: BoolArray
    above: BoolArray
    below: BoolArray
    failed: BoolArray

    @classmethod
    def of(cls, cases: pd.DataFrame, name: str, frame: Frame) -> Placed:
        """Return where the estimates of one parameter lie."""
        estimate, answered = numbers(cases, f"est_{name}"), estimated(cases)
        above, below = answered & (estimate > frame.high), answered & (estimate < frame.low)
        return cls(answered & ~above & ~below, above, below, ~answered)


def _points(axes: Axes, name: str, group: Group, frame: Frame, colour: str, marker: str) -> None:
    true, estimate = (numbers(group.cases, f"{one}_{name}") for one in ("true", "est"))
    at = Placed.of(group.cases, name, frame)
    points = axes.scatter(
        true[at.inside], estimate[at.inside], s=12, marker=marker, facecolor=colour,
        edgecolor="white", linewidth=0.3, alpha=0.85, label=group.protocol, zorder=3,
    )  # fmt: skip
    linked(points, group.cases[at.inside])
    # On the edge itself, whatever the scale of the axis: y in fractions of the frame.
    edge = axes.get_xaxis_transform()
    for chosen, height, sign in ((at.above, 0.975, "^"), (at.below, 0.025, "v"),
                                 (at.failed, 0.09, "x")):  # fmt: skip
        points = axes.scatter(
            true[chosen], np.full(chosen.sum(), height), s=16, marker=sign, color=colour,
            linewidth=0.8, transform=edge, zorder=4, clip_on=False,
        )  # fmt: skip
        linked(points, group.cases[chosen])


def _counts(axes: Axes, at: Placed) -> None:
    tally = {"▲ {} above": at.above, "▼ {} below": at.below, "× {} failed": at.failed}
    words = "  ".join(text.format(chosen.sum()) for text, chosen in tally.items() if chosen.any())
    axes.set_title(words, fontsize=6.5, color=GREY, loc="right", pad=5)
