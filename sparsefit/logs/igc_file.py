"""Flight recorders of gliders (IGC), read by aerofiles: fixes in longitude and latitude.

B records: time in UTC, to a second; positions to a thousandth of a minute of arc, 1.9 m (FAI,
Technical Specification for GNSS Flight Recorders, appendix A). They become metres on a local plane,
x east and y north.
"""

from __future__ import annotations

import io
from dataclasses import replace
from typing import BinaryIO

import numpy as np

from sparsefit.errors import InputError, optional
from sparsefit.logs.flight_table import FlightTable
from sparsefit.logs.layout import Layout, Source


def decode(file: BinaryIO, layout: Layout) -> FlightTable:
    """Return the positions in a recorder's file; their frame is ENU.

    Raises:
        InputError: if it is no IGC file, or holds no fixes.
        MissingExtra: without aerofiles, or without pyproj.
    """
    most = 100_000_000  # bytes: ten fixes a second for two days
    text = file.read(most + 1).decode("utf-8", errors="replace")
    if len(text) > most:
        raise InputError(f"more than {most / 1e6:.0f} MB: no recording of a flight")
    igc = optional("aerofiles.igc", "IGC files need aerofiles", "logs")
    try:
        read = igc.Reader(skip_duplicates=True).read(io.StringIO(text))
    except Exception as error:  # what aerofiles makes of a foreign file may be anything
        words = str(error)[:100] or type(error).__name__
        raise InputError(f"not an IGC file, or a damaged one: {words}") from None
    damaged, fixes = read["fix_records"]
    valid = [fix for fix in fixes if fix["validity"] == "A"]  # three-dimensional
    if not valid:
        raise InputError(f"none of {len(fixes)} fixes is valid; give a recording of a flight")
    clock = [fix["datetime"].replace(tzinfo=None) for fix in valid]
    cells = {"time": np.array(clock, "M8[us]")}
    cells |= {name: np.array([fix[name] for fix in valid]) for name in ("lon", "lat")}
    degrees = replace(layout, sources={"x": Source("lon"), "y": Source("lat")})
    table = degrees.flight_table(list(cells), lambda _: (cells, ({}, "")), "fix {}".format)
    notes = [f"fixes from {clock[0]:%Y-%m-%d %H:%M:%S} UTC, rounded to 1.9 m", *table.notes[1:]]
    if len(valid) < len(fixes):
        notes.append(f"{len(fixes) - len(valid)} of {len(fixes)} fixes are not valid, and left out")
    if damaged:
        notes.append("some records cannot be read, and are left out")
    return replace(table, notes=tuple(notes))
