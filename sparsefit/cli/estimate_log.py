"""What `sparsefit estimate` is told of the log it reads, and what it says of it."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from sparsefit.cli.parser import number
from sparsefit.errors import InputError, told_with

if TYPE_CHECKING:
    from sparsefit.derivative.quality import LogQuality
    from sparsefit.estimator import Estimate
    from sparsefit.flight import Flight
    from sparsefit.library import LengthScaleGrid
    from sparsefit.logs.table import FlightTable


def add_log(parser: argparse.ArgumentParser) -> None:
    """Declare how the log is read."""
    group = parser.add_argument_group("log")
    group.add_argument(
        "--columns",
        metavar="MAP",
        help="columns of a foreign table and their units: time=t[ms],x=lon,y=lat,vx=u[cm/s],"
        "vy=v[cm/s]; without a unit s, m and m/s, and degrees of lon... and lat...",
    )
    group.add_argument(
        "--only",
        action="append",
        metavar="COLUMN=VALUE",
        help="the rows to read, of one vehicle, where a table holds several",
    )
    group.add_argument(
        "--from", dest="begin", type=number("s"), metavar="S", help="first second that is read"
    )
    group.add_argument(
        "--to", dest="end", type=number("s"), metavar="S", help="last second that is read"
    )
    group.add_argument(
        "--longest-gap",
        type=number("s"),
        metavar="S",
        help="a log with a longer one is refused; default: 60 s, or 20 steps",
    )


def read_logs(args: argparse.Namespace) -> list[FlightTable]:
    """The tables of all logs, cut to the times that were asked for, in the first one's frame."""
    from sparsefit.logs.files import read_table

    if len(args.only or ()) > 1:
        told = "a flight is of one vehicle; several together are read from Python: read_flight"
        raise InputError(f"--only is given {len(args.only)} times: {told}(..., only=...) of each")
    only = args.only[0] if args.only else None
    tables: list[FlightTable] = []
    for path in args.flight:
        anchor = tables[0].anchor if tables else None
        table = read_table(path, columns=args.columns, only=only, anchor=anchor)
        with told_with(path):
            tables.append(table.between(args.begin, args.end))
    return tables


def quality_of_log(
    args: argparse.Namespace, path: str, flight: Flight, grid: LengthScaleGrid
) -> LogQuality:
    """Refuse a log that nothing should be made of; of others say how good they are.

    grid: the length scales that are sought.
    """
    from sparsefit.derivative import Derivative
    from sparsefit.derivative.quality import quality_of
    from sparsefit.derivative.refusal import check_log

    with told_with(path):
        check_log(flight, smallest=grid.lower, largest=grid.upper, longest_gap=args.longest_gap)
    return quality_of(flight, Derivative()(flight).smoothing)


@dataclass(frozen=True)
class Log:
    """A log that was read.

    Args:
        path: of its file.
        flight: that it holds.
        quality: what it is like.
        notes: how a foreign log was read.
    """

    path: str
    flight: Flight
    quality: LogQuality
    notes: tuple[str, ...]

    def rows(self, estimate: Estimate) -> list[tuple[str, str]]:
        """Lines on the log: its quality, its frame, and how a foreign one was read."""
        from sparsefit.flight.record import FRAMES

        crossed, frame = _crossed(estimate, self.flight), self.quality.frame
        cells = "cell" if crossed == 1 else "cells"
        words = self.quality.words + (f"; {crossed} {cells} crossed" if crossed else "")
        told = f"{frame}: {FRAMES[frame]}" if frame else f"not told: {FRAMES['']}"
        read = [("read as" if not place else "", note) for place, note in enumerate(self.notes)]
        return [("log", words), ("frame", told), *read]

    def record(self, estimate: Estimate) -> dict[str, Any]:
        """The same for programs; what is not known is None."""
        from sparsefit.codec import finite_or_none

        record: dict[str, Any] = finite_or_none(asdict(self.quality))
        crossed = _crossed(estimate, self.flight)
        return record | {"cells_crossed": crossed, "read_as": list(self.notes)}


def refuse_frames(paths: Sequence[str], tables: Sequence[FlightTable]) -> None:
    """InputError where of several logs only some tell where on the Earth they are."""
    told = [table.anchor.origin is not None for table in tables]
    if any(told) and not all(told):
        where, nowhere = paths[told.index(True)], paths[told.index(False)]
        raise InputError(
            f"{nowhere}: it does not tell where on the Earth it is, and {where} does: several "
            "flights need one frame; give x and y of all in metres about one place"
        )


def _crossed(estimate: Estimate, flight: Flight) -> int | None:
    from sparsefit.estimator.crossed import cells_crossed

    return cells_crossed(estimate, flight.time, flight.position)
