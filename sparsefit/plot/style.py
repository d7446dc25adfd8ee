"""The style of all figures, and their reproducible encoding."""

from __future__ import annotations

import io
import math
import re
import textwrap
import warnings
from collections.abc import Callable, Sequence
from functools import wraps
from typing import TYPE_CHECKING, Any, Literal, ParamSpec, TypeVar

import numpy as np

from sparsefit.arrays import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

Given = ParamSpec("Given")
Drawn = TypeVar("Drawn", "Figure", "Figure | None")
# Okabe and Ito (2008): distinct with common colour-vision deficiencies.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
MARKERS = ("o", "s", "D", "v", "P", "X", "*")
STYLES = ("-", "--", ":", "-.")
GREY = "#666666"
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
    "lines.linewidth": 1.2,
    "lines.markersize": 3.5,
    "lines.markeredgewidth": 0.0,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "axes.grid": True,
    "grid.color": "#E4E4E4",
    "grid.linewidth": 0.5,
    "axes.axisbelow": True,
    "text.parse_math": False,  # a "$" in a name is a letter
    "svg.fonttype": "path",
    "pdf.fonttype": 42,  # TrueType: publishers refuse Type 3
    "path.simplify": False,
    "savefig.dpi": 150,
}


def styled(
    draw: Callable[Given, Drawn], width: float = 7.0, *, formulas: bool = False
) -> Callable[Given, Drawn]:
    """Return what draws a figure, `width` [in] wide, in this style whatever the user's settings.

    formulas: whether texts between two `$` are formulas, as numbers of a logarithmic axis may be.
    """

    @wraps(draw)
    def drawn(*values: Given.args, **settings: Given.kwargs) -> Drawn:
        import matplotlib as mpl

        with mpl.rc_context(), warnings.catch_warnings():
            warnings.filterwarnings("ignore", "Glyph", UserWarning)  # missing in the font
            warnings.filterwarnings("ignore", "Attempting to set identical", UserWarning)
            mpl.rcdefaults()
            more = {"figure.figsize": (width, width), "text.parse_math": formulas}
            mpl.rcParams.update(STYLE | more)
            figure = draw(*values, **settings)
            if figure is None:
                return figure
            try:  # the numbers of axes are texts from the first drawing on
                if formulas:
                    figure.draw_without_rendering()
            except ValueError:  # of a formula that is none
                for text in figure.findobj(mpl.text.Text):
                    text.set_parse_math(False)
            if layout := figure.get_layout_engine():  # fixed, so that saving again changes nothing
                layout.execute(figure)
            figure.set_layout_engine(None)
            return figure

    return drawn


def panels(
    rows: int, columns: int, *, height: float, sharey: Literal["row", "all", "none"] = "none"
) -> tuple[Figure, list[list[Axes]]]:
    """Return a figure of the width of its style with a grid of axes that do not overlap."""
    from matplotlib.figure import Figure

    figure = Figure(dpi=150, layout="constrained")
    figure.set_figheight(height)
    grid = figure.subplots(rows, columns, squeeze=False, sharey=sharey)
    return figure, [list(row) for row in grid]


def logarithmic(axis: Axis, low: float, high: float) -> None:
    """Number a logarithmic axis from `low` to `high` in plain digits, `0.01  0.1  1`."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    decades = math.log10(high / low) if 0.0 < low < high else 1.0
    subs = (1.0,) if decades > 2.2 else (1.0, 2.0, 5.0)
    axis.set_major_locator(LogLocator(subs=subs, numticks=5))  # more would overlap
    axis.set_major_formatter(
        FuncFormatter(lambda value, _: re.sub(r"e\+?(-?)0*", r"e\1", f"{value:g}"))  # 1e-6
    )
    axis.set_minor_locator(NullLocator())


def level_axis(axes: Axes, levels: Array) -> None:
    """Number the x axis at swept levels (n,), on a log scale where they span a decade."""
    from matplotlib.ticker import NullLocator

    distinct = np.unique(levels)
    positive = distinct[distinct > 0]
    if positive.size > 1 and positive[-1] / positive[0] >= 10 and distinct[0] >= 0:
        if distinct[0] == 0:
            axes.set_xscale("symlog", linthresh=float(positive[0]))
        else:
            axes.set_xscale("log")
    if distinct.size <= 12:
        axes.set_xticks(distinct, [f"{level:g}" for level in distinct])
        axes.xaxis.set_minor_locator(NullLocator())


def named_axis(axes: Axes, names: Sequence[str], letters: int) -> None:
    """Write names along an x axis with room for so many letters, slanted where they are long."""
    short, slant = list(labels(names, 34).values()), dict[str, Any]()
    if sum(map(len, short)) + 2 * len(short) > letters:
        short = list(labels(names, 48).values())
        slant = {"rotation": 40, "ha": "right", "rotation_mode": "anchor"}
    axes.set_xticks(range(len(short)), short, **slant)
    axes.set_xlim(-0.5, len(short) - 0.5)
    axes.grid(False, axis="x")


def legend(figure: Figure) -> None:
    """Put one legend of all labelled lines above the panels, in the order of their ids."""
    handles: dict[str, Any] = {}
    for axes in figure.axes:
        handles |= dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))
    ordered = sorted(handles, key=lambda name: (len(gid := str(handles[name].get_gid())), gid))
    for columns in range(min(len(ordered), 6), 0, -1):
        shown = figure.legend([handles[name] for name in ordered], ordered,
                              loc="outside upper center", ncols=columns)  # fmt: skip
        size = shown.get_window_extent()
        if columns == 1 or size.width < figure.bbox.width:
            figure.set_figheight(figure.get_figheight() + size.height / figure.dpi)
            return
        shown.remove()


def with_unit(words: str, unit: str) -> str:
    """Return the label of an axis with its unit in brackets, not separated by a line break."""
    return f"{words}\N{NO-BREAK SPACE}[{unit}]" if unit else words


def labels(names: Sequence[str], length: int) -> dict[str, str]:
    """Return names in lines of at most `length` letters that stay distinct.

    If a name is longer, the words that all names share are removed; a name that is still longer has
    up to three lines, of a longer one the middle is removed.
    """
    words = [re.split(r"(?<=[\s,:;])(?=\S)", name) for name in names]
    shared = set(words[0]).intersection(*map(set, words[1:])) if len(words) > 1 else set()
    if not any(len(name) > length for name in names):
        shared.clear()
    differ = ["".join(part for part in parts if part not in shared) for parts in words]
    if any(re.fullmatch(r"[^a-zA-Z]*\s[^a-zA-Z]*\S", text.strip(" ,:;")) for text in differ):
        differ = ["".join(parts) for parts in words]  # numbers without their words
    short: dict[str, str] = {}
    for name, rest in zip(names, differ, strict=True):
        text = rest.strip(" ,:;") or name
        if len(text) > 3 * length - 4:
            text = f"{text[: 2 * length - 4]} … {text[4 - length :]}"
        short[name] = wrapped(text, length)
    return short if len(set(short.values())) == len(set(names)) else {name: name for name in names}


def wrapped(text: str, width: int) -> str:
    """Return text in lines of at most `width` letters; a pair, `0 / 0`, is not divided."""
    lines = text.replace(" / ", "\N{NO-BREAK SPACE}/\N{NO-BREAK SPACE}").split("\n")
    return "\n".join(textwrap.fill(line, width, break_on_hyphens=False) for line in lines)


def encoded(figure: Figure, suffix: str, name: str = "sparsefit") -> bytes:
    """Return a figure as the bytes of a file: `.svg`, `.png` or `.pdf`.

    Args:
        name: makes the ids in an SVG unique on a page.
    """
    import matplotlib as mpl

    stream = io.BytesIO()
    metadata = {".svg": {"Date": None, "Creator": None}, ".pdf": {"CreationDate": None}}
    with mpl.rc_context(STYLE | {"svg.hashsalt": name}), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph", UserWarning)
        more = metadata.get(suffix, {})
        figure.savefig(stream, format=suffix.lstrip("."), metadata=more, facecolor="white")
    if suffix != ".svg":
        return stream.getvalue()
    return re.sub(rb"(\.\d{3})\d+(?=[ \"\n](?!-->))", rb"\1", stream.getvalue())  # to .001 pt
