"""Flight recorders of gliders (IGC), read by aerofiles: fixes in longitude and latitude.

B records: time in UTC, to a second or, with the extension TDS, finer; positions to a thousandth of
a minute of arc, 1.9 m, or with LAD and LOD finer (FAI, Technical Specification for GNSS Flight
Recorders, appendix A). They become metres on a local plane, x east and y north.
"""

from __future__ import annotations

import io
import re
from datetime import timedelta
from importlib import import_module
from typing import Any, BinaryIO

import numpy as np

from sparsefit.arrays import Array
from sparsefit.errors import InputError, MissingExtra
from sparsefit.logs.flight_table import POSITIONS, Anchor, FlightTable
from sparsefit.logs.head import Head
from sparsefit.logs.layout import Layout
from sparsefit.logs.plane import plane_of

LARGEST = 100_000_000  # bytes: ten fixes a second for two days
FIX = "A"  # of a B record that is three-dimensional
MINUTE = 3  # decimals of a minute that a B record has without extensions
GRAIN = 1852.0 / 10**MINUTE  # m
_EXTENSION = re.compile(r"(\d\d)(\d\d)([A-Z]{3})")


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
    record = re.search(r"^I\d\d(.*)$", text, re.MULTILINE)
    extensions = _EXTENSION.findall(record[1]) if record else []
    digits = {name: int(last) - int(first) + 1 for first, last, name in extensions}
    fixes, damaged = _fixes(text, fine="TDS" in digits)
    valid = [fix for fix in fixes if fix["validity"] == FIX]
    if not valid:
        raise InputError(f"none of {len(fixes)} fixes is valid; give a recording of a flight")
    start = valid[0]["datetime"]
    time = np.array([(fix["datetime"] - start).total_seconds() for fix in valid])
    time = time + _finer(valid, "TDS", digits, 0)
    degrees = []
    for name, extension in (("lon", "LOD"), ("lat", "LAD")):
        whole = np.array([fix[name] for fix in valid])
        degrees.append(whole + np.sign(whole) * _finer(valid, extension, digits, MINUTE) / 60.0)
    plane = plane_of(degrees[0], degrees[1], ("longitude", "latitude"), layout.anchor.origin)
    notes = [f"fixes from {start:%Y-%m-%d %H:%M:%S} UTC", plane.words]
    if "LAD" not in digits:
        notes.append(f"positions are rounded to {GRAIN:.2g} m")
    if len(valid) < len(fixes):
        notes.append(f"{len(fixes) - len(valid)} of {len(fixes)} fixes are not valid, and left out")
    if damaged:
        notes.append("some records cannot be read, and are left out")
    first = float(time[0])
    values = (time - first, *plane.position.T)
    columns = dict(zip(POSITIONS, values, strict=True))
    anchor = Anchor(plane.origin, start + timedelta(seconds=first))
    return FlightTable(columns, Head(frame="ENU"), tuple(notes), anchor)


def _fixes(text: str, *, fine: bool) -> tuple[list[dict[str, Any]], bool]:
    """The fixes, and a flag that there are records which could not be read.

    fine: whether several fixes in a second differ in their times; if not, one of them is read.
    """
    try:
        igc = import_module("aerofiles.igc")
    except ImportError:
        raise MissingExtra("IGC files need aerofiles: pip install 'sparsefit[logs]'") from None
    try:
        read = igc.Reader(skip_duplicates=not fine).read(io.StringIO(text))
    except KeyError as error:
        if "utc_date" not in str(error):
            raise InputError(f"not an IGC file: no {error}; give a recorder's own file") from None
        raise InputError(
            "no date (HFDTE record) before the first fix; is it an IGC file?"
        ) from None
    except Exception as error:  # what aerofiles makes of a foreign file may be anything
        words = str(error)[:100] or type(error).__name__
        raise InputError(f"not an IGC file, or a damaged one: {words}") from None
    errors, fixes = read["fix_records"]
    if not fixes:
        raise InputError("no fixes (B records): not an IGC file, or an empty one")
    return fixes, bool(errors)


def _finer(fixes: list[dict[str, Any]], name: str, digits: dict[str, int], places: int) -> Array:
    """The decimals beyond ``places`` that an extension holds (m,); zeros without it."""
    scale = 10.0 ** -(places + digits.get(name, 0))
    decimals: Array = scale * np.array([fix.get(name, 0) for fix in fixes], dtype=np.float64)
    return decimals
