"""Fig. 1: the weight of every candidate length scale."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sparsefit.arrays import Array
from sparsefit.errors import InputError
from sparsefit.study.evidence.asked import Asked
from sparsefit.study.evidence.cases import Group, numbers
from sparsefit.study.evidence.table import plain
from sparsefit.study.report.drawing import COLOURS, GREY, legend, panels, shortened
from sparsefit.study.report.scatter import first_listed

if TYPE_CHECKING:
    from sparsefit.study.spec.study import Study


def weights_figure(
    _: Asked, study: Study, cases: pd.DataFrame, weights: pd.DataFrame | None
) -> Figure:
    """Draw Fig. 1 for the first flight: a panel per protocol and back-end, first listed setting.

    Raises:
        InputError: if the study kept no weights.
    """
    if weights is None or weights.empty:
        raise InputError(f'{study.name} kept no weights: list the figure "weights" and run afresh')
    first = cases[cases["flight"] == cases["flight"].iloc[0]]
    groups = first_listed(first)
    columns = 1 if len(groups) <= 4 else 2
    rows = -(-len(groups) // columns)
    figure, grid = panels(rows, columns, height=0.6 + 1.25 * rows)
    flat = [axes for row in grid for axes in row]
    many = len({group.protocol for group in groups}) > 1
    for axes, group in zip(flat, groups, strict=False):
        _panel(axes, group, weights)
        title = f"{group.title} ({group.protocol})" if many else group.title
        axes.set_title(shortened(title, 72 if columns == 1 else 32), loc="left")
    for axes in flat[len(groups) :]:
        axes.set_visible(False)
    _share(flat[: len(groups)], columns)
    figure.align_ylabels()
    legend(figure, flat[: len(groups)])
    return figure


def _panel(axes: Axes, group: Group, weights: pd.DataFrame) -> None:
    case = group.cases.iloc[0]
    own = weights[weights["case_id"] == case["case_id"]].sort_values("length_scale")
    scales, values = numbers(own, "length_scale"), numbers(own, "weight")
    axes.axhline(0.0, color=GREY, lw=0.5)
    axes.axvline(
        float(case["true_length_scale"]), color=COLOURS[1], ls=(0, (4, 2)), lw=1.2,
        label="true length scale", zorder=2,
    )  # fmt: skip
    axes.vlines(scales, 0.0, values, color=COLOURS[0], lw=1.1, label="weight", zorder=3)
    _chosen(axes, plain(case["grid_length_scale"]), scales, values)
    chosen, status = plain(case["grid_length_scale"]), str(case["status"])
    words = f"chosen {chosen:.3g} m" if isinstance(chosen, float) else "no scale chosen"
    verdict = words if status == "ok" else f"{words}, {status}"
    axes.set_title(verdict, loc="right", color=GREY, fontsize=6.5)
    axes.set_ylabel("weight")
    axes.grid(False, axis="x")


def _chosen(axes: Axes, chosen: object, scales: Array, values: Array) -> None:
    if isinstance(chosen, float) and scales.size:
        nearest = int(np.argmin(np.abs(scales - chosen)))
        axes.plot(
            scales[nearest], values[nearest], "o", color=COLOURS[2], ms=5, label="chosen scale",
            zorder=4,
        )  # fmt: skip


def _share(used: list[Axes], columns: int) -> None:
    """One range of length scales for all panels, named under the lowest of each column."""
    low = min(axes.get_xlim()[0] for axes in used)
    high = max(axes.get_xlim()[1] for axes in used)
    for axes in used:
        axes.set_xlim(low, high)
        axes.margins(y=0.15)
    for axes in used[:-columns]:
        axes.tick_params(labelbottom=False)
    for axes in used[-columns:]:
        axes.set_xlabel("candidate length scale [m]")
