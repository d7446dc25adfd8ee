"""Two runs as pages: the tables, and a picture of every error before and after."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from sparsefit.arrays import Array
from sparsefit.study.evidence.compared import Compared
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


def write_comparison(both: Compared, made: tuple[Table, Table], folder: Path) -> list[Path]:
    """Write `comparison.md`, its tables as CSV and its picture into a folder, made if need be.

    made: the tables of effects and of changed cases.
    """
    folder.mkdir(parents=True, exist_ok=True)
    tables = dict(zip(("effects", "changes"), made, strict=True))
    files = figure_files("comparison", laid_out(lambda: errors_figure(both)))
    files |= {f"{name}.csv": to_csv(table).encode() for name, table in tables.items()}
    parts = [
        f"# {escape_markdown(' and '.join(both.names))}",
        escape_markdown(both.sentence),
        f"![errors of both](comparison.svg)\n\n*{escape_markdown(CAPTION)}*",
        *(to_markdown(table).strip("\n") for table in tables.values()),
    ]
    files["comparison.md"] = ("\n\n".join(parts) + "\n").encode()
    return write_files(folder, files)


def errors_figure(both: Compared) -> Figure:
    """Draw the error of each case in the second run against that in the first."""
    figure, ((axes,),) = panels(1, 1, height=4.6)
    sizes = both.sizes
    known = np.concatenate(sizes)
    low = max(LOW, 10.0 ** np.floor(np.log10(np.nanmin(known, initial=HIGH) + LOW)))
    one, other = (_framed(each, low) for each in sizes)
    moved = both.changed
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlim(low, HIGH)
    axes.set_ylim(low, HIGH)
    axes.set_aspect("equal", adjustable="box")
    logarithmic(axes.xaxis, low, HIGH)
    logarithmic(axes.yaxis, low, HIGH)
    axes.plot([low, HIGH], [low, HIGH], color=GREY, lw=0.8, zorder=1)
    for kept, colour, words in ((~moved, GREY, "unchanged"), (moved, COLOURS[1], "changed")):
        axes.scatter(
            one[kept], other[kept], s=10, color=colour, alpha=0.6, linewidth=0, clip_on=False,
            label=f"{int(kept.sum())} {words}", zorder=3,
        )  # fmt: skip
    axes.set_xlabel(f"largest |error|, {shortened(both.names[0], 40)} [%]")
    axes.set_ylabel(f"largest |error|, {shortened(both.names[1], 40)} [%]")
    legend(figure, [axes])
    return figure


def _framed(sizes: Array, low: float) -> Array:
    """The errors within the frame; what has none stands on its far edge."""
    return np.clip(np.where(np.isnan(sizes), HIGH, sizes), low, HIGH)
