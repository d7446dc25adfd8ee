"""`sparsefit estimate --plot FILE`: the estimate as a picture."""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from sparsefit.cli.output import check_output
from sparsefit.errors import one_line

if TYPE_CHECKING:
    from sparsefit.estimator import Estimate, Estimator
    from sparsefit.flight import Flight

SUFFIXES = (".png", ".svg", ".pdf")


def add_plot(parser: argparse.ArgumentParser) -> None:
    """Declare `--plot FILE` and `--force`."""
    parser.add_argument(
        "--plot",
        metavar="FILE",
        help="draw track, cells, weights, residual and its spectrum: .png, .svg or .pdf",
    )
    parser.add_argument("--force", action="store_true", help="overwrite the picture")


def check_plot(args: argparse.Namespace) -> None:
    """Raise InputError, before any work, where the picture could not be written."""
    if args.plot is not None:
        check_output(args.plot, force=args.force, endings=SUFFIXES)


def write_plot(
    path: str,
    names: Sequence[str],
    estimator: Estimator,
    flights: Sequence[Flight],
    found: Estimate,
) -> None:
    """Write the picture of what was found; names: of the logs, for its title.

    Of several flights all tracks are drawn, and the residual of the first.
    """
    from sparsefit.derivative import Derivative
    from sparsefit.study.report.drawing import to_pdf, to_png, to_svg
    from sparsefit.study.report.estimate_figure import estimate_figure
    from sparsefit.study.report.flown import flown_by
    from sparsefit.whole_file import write_whole

    assert isinstance(estimator.derivative, Derivative)
    first, *beside = flights
    flown = flown_by(first, estimator.derivative(first), found, beside)
    more = f" and {len(beside)} more" if beside else ""
    encode = dict(zip(SUFFIXES, (to_png, to_svg, to_pdf), strict=True))[Path(path).suffix.lower()]
    with warnings.catch_warnings():  # a name in letters that the font has not is drawn as boxes
        warnings.filterwarnings("ignore", "Glyph", UserWarning)
        content = encode(estimate_figure(flown, f"{one_line(names[0])}{more}"))
    write_whole(path, content)
