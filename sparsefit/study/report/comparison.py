"""Two runs as pages: the tables, and a picture of every error before and after."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from sparsefit.arrays import Array, BoolArray
from sparsefit.study.evidence.compared import Compared
from sparsefit.study.evidence.solver_compared import SolversCompared
from sparsefit.study.evidence.table import Table
from sparsefit.study.report.drawing import (
    COLOURS,
    GREY,
    figure_files,
    laid_out,
    legend,
    logarithmic,
    panels,
    shortened,
)
from sparsefit.study.report.escape import escape_markdown
from sparsefit.study.report.render import to_csv, to_markdown
from sparsefit.whole_file import write_files

LOW, HIGH = 1e-4, 300.0  # percent: the frame; what lies outside stands on its edge
CAPTION = (
    "Largest |error| of U0, L_w and τ_w of every case, first run across, second up. Grey: "
    "unchanged. On the right edge and on top: no estimate. Below the line, the second is better."
)


TIMES = (
    "CPU time of every case that both have a time of, first run across, second up. Grey: of the "
    "same status. Below the line, the second is faster."
)


def write_comparison(
    both: Compared | SolversCompared, made: tuple[Table, Table], folder: Path
) -> list[Path]:
    """Write `comparison.md`, its tables as CSV and its picture into a folder, made if need be.

    made: the tables of effects and of changed cases.
    """
    folder.mkdir(parents=True, exist_ok=True)
    tables = dict(zip(("effects", "changes"), made, strict=True))
    solvers = isinstance(both, SolversCompared)
    files = figure_files("comparison", laid_out(lambda: _figure(both)))
    files |= {f"{name}.csv": to_csv(table).encode() for name, table in tables.items()}
    parts = [
        f"# {escape_markdown(' and '.join(both.names))}",
        escape_markdown(both.sentence),
        f"![both runs](comparison.svg)\n\n*{escape_markdown(TIMES if solvers else CAPTION)}*",
        *(to_markdown(table).strip("\n") for table in tables.values()),
    ]
    files["comparison.md"] = ("\n\n".join(parts) + "\n").encode()
    return write_files(folder, files)


def _figure(both: Compared | SolversCompared) -> Figure:
    return times_figure(both) if isinstance(both, SolversCompared) else errors_figure(both)


def errors_figure(both: Compared) -> Figure:
    """Draw the error of each case in the second run against that in the first."""
    sizes = both.sizes
    known = np.concatenate(sizes)
    low = max(LOW, 10.0 ** np.floor(np.log10(np.nanmin(known, initial=HIGH) + LOW)))
    framed = [_framed(each, low) for each in sizes]
    return _held_against(framed, both.changed, low, HIGH, both.names, ("largest |error|", "%"))


def times_figure(both: SolversCompared) -> Figure:
    """Draw the time of each case in the second run against that in the first."""
    times = np.array([1e3 * run["cpu"].to_numpy(dtype=float) for run in (both.first, both.second)])
    timed = np.isfinite(times).all(axis=0)
    low = 10.0 ** np.floor(np.log10(times[:, timed].min(initial=1.0)))
    high = 10.0 ** np.ceil(np.log10(times[:, timed].max(initial=10.0)))
    shown = (low, high, both.names, ("CPU time", "ms"))
    return _held_against(list(times[:, timed]), both.changed[timed], *shown)


def _held_against(
    pair: Sequence[Array],
    moved: BoolArray,
    low: float,
    high: float,
    names: tuple[str, str],
    words: tuple[str, str],
) -> Figure:
    """A point for each case, first across and second up; words: what is drawn, and its unit."""
    figure, ((axes,),) = panels(1, 1, height=4.6)
    one, other = pair
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlim(low, high)
    axes.set_ylim(low, high)
    axes.set_aspect("equal", adjustable="box")
    logarithmic(axes.xaxis, low, high)
    logarithmic(axes.yaxis, low, high)
    axes.plot([low, high], [low, high], color=GREY, lw=0.8, zorder=1)
    for kept, colour, told in ((~moved, GREY, "unchanged"), (moved, COLOURS[1], "changed")):
        axes.scatter(
            one[kept], other[kept], s=10, color=colour, alpha=0.6, linewidth=0, clip_on=False,
            label=f"{int(kept.sum())} {told}", zorder=3,
        )  # fmt: skip
    axes.set_xlabel(f"{words[0]}, {shortened(names[0], 40)} [{words[1]}]")
    axes.set_ylabel(f"{words[0]}, {shortened(names[1], 40)} [{words[1]}]")
    legend(figure, [axes])
    return figure


def _framed(sizes: Array, low: float) -> Array:
    """The errors within the frame; what has none stands on its far edge."""
    return np.clip(np.where(np.isnan(sizes), HIGH, sizes), low, HIGH)
