"""Flight recorders of gliders (IGC), read by aerofiles: fixes in longitude and latitude.

B records: time in UTC, to a second; positions to a thousandth of a minute of arc, 1.9 m (FAI,
Technical Specification for GNSS Flight Recorders, appendix A). They become metres on a local plane,
x east and y north.
"""

from __future__ import annotations

import io
from importlib import import_module
from typing import BinaryIO

import numpy as np

from sparsefit.errors import InputError, MissingExtra
from sparsefit.logs.flight_table import POSITIONS, FlightTable
from sparsefit.logs.layout import Layout
from sparsefit.logs.plane import plane_of

LARGEST = 100_000_000  # bytes: ten fixes a second for two days


def decode(file: BinaryIO, layout: Layout) -> FlightTable:
    """Return the positions in a recorder's file; their frame is ENU.

    Raises:
        InputError: if it is no IGC file, or holds no fixes; and on a column map.
        MissingExtra: without aerofiles, or without pyproj.
    """
    layout.refuse_any("an IGC file")
    text = file.read(LARGEST + 1).decode("utf-8", errors="replace")
    if len(text) > LARGEST:
        raise InputError(f"more than {LARGEST / 1e6:.0f} MB: no recording of a flight")
    try:
        igc = import_module("aerofiles.igc")
    except ImportError:
        raise MissingExtra("IGC files need aerofiles: pip install 'sparsefit[logs]'") from None
    try:
        read = igc.Reader(skip_duplicates=True).read(io.StringIO(text))
    except Exception as error:  # what aerofiles makes of a foreign file may be anything
        if isinstance(error, KeyError) and "utc_date" in str(error):
            words = "no date (HFDTE record) before the first fix"
        else:
            words = str(error)[:100] or type(error).__name__
        raise InputError(f"not an IGC file, or a damaged one: {words}") from None
    damaged, fixes = read["fix_records"]
    valid = [fix for fix in fixes if fix["validity"] == "A"]  # three-dimensional
    if not valid:
        raise InputError(f"none of {len(fixes)} fixes is valid; give a recording of a flight")
    epoch = valid[0]["datetime"]
    time = np.array([(fix["datetime"] - epoch).total_seconds() for fix in valid])
    longitude, latitude = (np.array([fix[name] for fix in valid]) for name in ("lon", "lat"))
    plane = plane_of(longitude, latitude, ("longitude", "latitude"), layout.origin)
    notes = [f"fixes from {epoch:%Y-%m-%d %H:%M:%S} UTC, rounded to 1.9 m", plane.words]
    if len(valid) < len(fixes):
        notes.append(f"{len(fixes) - len(valid)} of {len(fixes)} fixes are not valid, and left out")
    if damaged:
        notes.append("some records cannot be read, and are left out")
    columns = dict(zip(POSITIONS, (time, *plane.position.T), strict=True))
    return FlightTable(columns, {}, None, "ENU", tuple(notes), plane.origin, epoch)
