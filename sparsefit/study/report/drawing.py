"""How every picture looks, and how it becomes the same bytes each time it is drawn."""

from __future__ import annotations

import html
import io
import math
from collections.abc import Callable, Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter, NullLocator

from sparsefit.arrays import Array
from sparsefit.study.report.vector import inlined, settled

WIDTH = 7.0  # inches: a page between its margins
DPI = 150
# Okabe and Ito: told apart with every common colour vision, and by lightness in grey.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
MARKERS = ("o", "s", "D", "v", "P", "X", "*")
STYLES = ("-", "--", ":", "-.")
GREY = "#666666"
TICKS = 4  # at most, of a logarithmic axis: more would touch each other
MARGIN = 0.05  # of an axis, beside its levels
FITTING = {5: 16, 4: 24, 3: 34, 2: 52}  # columns of a legend: the longest label that they take
STYLE: dict[Any, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 8.0,
    "axes.titlesize": 8.0,
    "axes.labelsize": 8.0,
    "xtick.labelsize": 7.0,
    "ytick.labelsize": 7.0,
    "legend.fontsize": 7.0,
    "legend.frameon": False,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.6,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "axes.grid": True,
    "grid.color": "#E4E4E4",
    "grid.linewidth": 0.5,
    "axes.axisbelow": True,
    "axes.unicode_minus": True,
    # Names come from files: a "$" in one is a letter.
    "text.parse_math": False,
    "svg.fonttype": "path",
    "svg.hashsalt": "sparsefit",
    "path.simplify": False,
}


def laid_out(make: Callable[[], Figure]) -> Figure:
    """Return the figure made in this package's style, whatever the user's own settings are."""
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(STYLE)
        figure = make()
        # Laid out once: saving twice must not move anything, nor draw a second time for it.
        if layout := figure.get_layout_engine():
            layout.execute(figure)
        figure.set_layout_engine(None)
        return figure


def panels(rows: int, columns: int, *, height: float) -> tuple[Figure, list[list[Axes]]]:
    """Return a figure of page width with a grid of axes, laid out so that nothing overlaps."""
    figure = Figure(figsize=(WIDTH, height), dpi=DPI, layout="constrained")
    grid = figure.subplots(rows, columns, squeeze=False)
    return figure, [list(row) for row in grid]


def logarithmic(axis: Axis, low: float, high: float) -> None:
    """Number a logarithmic axis from `low` to `high` in plain digits, `0.01  0.1  1`."""
    decades = math.log10(high / low) if 0.0 < low < high else 1.0
    subs = (1.0,) if decades > 2.2 else (1.0, 2.0, 5.0)
    axis.set_major_locator(LogLocator(subs=subs, numticks=TICKS))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def ticked(axes: Axes, levels: Array) -> None:
    """Number the x axis at the levels themselves, on a log scale where they span a decade."""
    positive = np.unique(levels[levels > 0])
    if positive.size > 1 and positive[-1] / positive[0] >= 10 and levels.min() >= 0:
        if (levels == 0).any():
            axes.set_xscale("symlog", linthresh=float(positive[0]))
        else:
            axes.set_xscale("log")
        # The levels themselves are the ticks: nothing was measured between them.
        axes.set_xticks(np.unique(levels), [f"{level:g}" for level in np.unique(levels)])
        axes.xaxis.set_minor_locator(NullLocator())
    # All levels, whether anything was found at them or not: panels below each other agree.
    scale = axes.xaxis.get_transform()
    low, high = scale.transform(np.array([levels.min(), levels.max()], dtype=float))
    room = MARGIN * (high - low) or 0.5
    axes.set_xlim(*scale.inverted().transform(np.array([low - room, high + room])))


def unanswered(axes: Axes) -> None:
    """Say in an empty panel that there is no answer, over a range that a log scale takes."""
    axes.text(0.5, 0.5, "no answer", transform=axes.transAxes, ha="center", color=GREY)
    axes.tick_params(labelleft=False)
    axes.set_ylim(1.0, 10.0)


def share_y(row: list[Axes], *, alike: bool, highest: float) -> None:
    """Number the logarithmic y axes of a row; those that show alike share their range."""
    ends = [axes.get_ylim() for axes in row]
    low, high = min(end[0] for end in ends), max(end[1] for end in ends)
    for axes, (first, last) in zip(row, ends, strict=True):
        bottom, top = (low, min(high, highest)) if alike else (first, last)
        axes.set_ylim(bottom, top)
        logarithmic(axes.yaxis, bottom, top)


def legend(figure: Figure, every: Sequence[Axes], more: Sequence[Artist] = ()) -> None:
    """Put one legend above all panels: what any of them names, and `more`.

    From all panels: one whose fit failed has nothing to explain.
    """
    handles = {
        label: handle
        for axes in every
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)
    }
    shown = [*handles.values(), *more]
    longest = max(len(str(handle.get_label())) for handle in shown)
    columns = next((many for many, letters in FITTING.items() if longest <= letters), 1)
    figure.legend(handles=shown, loc="outside upper center", ncols=min(len(shown), columns))


def with_unit(words: str, unit: str) -> str:
    """Return the words of an axis with their unit in brackets, where they have one."""
    return f"{words} [{unit}]" if unit else words


def shortened(text: str, length: int) -> str:
    """Return `text`, its middle left out where it is longer than `length` letters."""
    half = (length - 1) // 2
    return text if len(text) <= length else f"{text[:half]}…{text[-half:]}"


def to_svg(figure: Figure) -> bytes:
    """Return the figure as SVG: without date or version, the same bytes on every machine."""
    return settled(_saved(figure, "svg", {"Date": None, "Creator": None}).decode()).encode()


def figure_files(name: str, figure: Figure) -> dict[str, bytes]:
    """Return the figure as NAME.svg and .png."""
    return {f"{name}.svg": to_svg(figure), f"{name}.png": to_png(figure)}


def to_inline(figure: Figure, name: str, title: str) -> str:
    """Return the figure as an element of a page (`vector.inlined`), its labels as text."""
    svg = _saved(figure, "svg", {"Date": None, "Creator": None}, {"svg.fonttype": "none"})
    return inlined(svg.decode(), name, html.escape(title))


def to_png(figure: Figure) -> bytes:
    """Return the figure as PNG of 150 dots per inch, without metadata."""
    return _saved(figure, "png", {"Software": None})


def to_pdf(figure: Figure) -> bytes:
    """Return the figure as PDF, without date or version."""
    return _saved(figure, "pdf", {"CreationDate": None, "Creator": None, "Producer": None})


def _saved(
    figure: Figure, kind: str, metadata: dict[str, None], more: dict[Any, Any] | None = None
) -> bytes:
    stream = io.BytesIO()
    with mpl.rc_context(STYLE | (more or {})):
        figure.savefig(stream, format=kind, dpi=DPI, metadata=metadata, facecolor="white")
    return stream.getvalue()


def colours(names: list[str]) -> dict[str, str]:
    """Return a colour per name, in order; more names than colours begin anew."""
    return {name: COLOURS[place % len(COLOURS)] for place, name in enumerate(names)}


def markers(names: list[str]) -> dict[str, str]:
    """Return a marker per name, so that no meaning hangs on colour alone."""
    return {name: MARKERS[place % len(MARKERS)] for place, name in enumerate(names)}
