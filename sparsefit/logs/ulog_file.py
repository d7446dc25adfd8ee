"""PX4's logs (ULog), read by pyulog: the local position that the vehicle's own filter estimates.

``vehicle_local_position``: x north and y east [m], vx and vy [m/s], time stamps in us (PX4 user
guide, "ULog File Format" and "vehicle_local_position"). Samples that the filter itself calls
invalid are left out. What the vehicle is (its response to the air) no log of PX4 tells.
"""

from __future__ import annotations

import io
from contextlib import redirect_stdout
from dataclasses import replace
from datetime import datetime
from importlib import import_module
from typing import Any, BinaryIO

import numpy as np

from sparsefit.arrays import BoolArray, IntArray
from sparsefit.errors import InputError, MissingExtra
from sparsefit.flight.record import MOST_SAMPLES
from sparsefit.logs.flight_table import COLUMNS, Anchor, FlightTable, moment_at
from sparsefit.logs.head import Head
from sparsefit.logs.layout import Layout
from sparsefit.logs.plane import plane_of

TOPIC, LANDED = "vehicle_local_position", "vehicle_land_detected"
GPS = "vehicle_gps_position"
FIELDS = ("x", "y", "vx", "vy")
VALID = ("xy_valid", "v_xy_valid")
RESETS = "xy_reset_counter"
CUT = "the log is truncated: it ends within a message; copy it again"
MAGIC = b"ULog\x01\x12\x35"  # how a log begins
HEADER = 3  # bytes before each message: a log may end in place of one, and nowhere else
SHOWN = 8  # topics that a refusal lists


class _Content(io.BytesIO):
    """A log in memory that is refused where it ends within a message: pyulog would go on."""

    def read(self, size: int | None = -1, /) -> bytes:
        block = super().read(size)
        wanted = -1 if size is None else size
        if len(block) < wanted and (wanted != HEADER or len(block) > 0):
            raise EOFError  # no ValueError: of those pyulog makes nothing
        return block


def decode(file: BinaryIO, layout: Layout) -> FlightTable:
    """Return the table in a log's content; its frame is NED.

    Raises:
        InputError: if it is no ULog, is cut off, holds no valid local position, or that of a
            vehicle that never left the ground; and on a column map, which it needs none of.
        MissingExtra: without pyulog.
    """
    layout.refuse_any("a PX4 log")
    content = file.read()
    if content.find(MAGIC, 1) > 0:
        raise InputError("two logs in one file, one after the other; split it where another begins")
    log = _parsed(content)
    local = _topic(log, TOPIC)
    if local is None:
        topics = sorted({data.name for data in log.data_list})
        shown = ", ".join(topics[:SHOWN]) + (", ..." if len(topics) > SHOWN else "")
        raise InputError(
            f"no {TOPIC} in this log (it has {shown or 'nothing'}); log it, or export a position "
            "to CSV"
        )
    lacking = [name for name in ("timestamp", *FIELDS) if name not in local]
    if lacking:
        raise InputError(f"{TOPIC} has no {', '.join(lacking)}; is it a log of PX4?")
    valid = np.ones(len(local["timestamp"]), dtype=bool)
    for name in VALID:
        valid &= np.asarray(local.get(name, True)) != 0
    for name in FIELDS:
        valid &= np.isfinite(local[name])
    _check_flown(local, valid, _topic(log, LANDED))
    if np.count_nonzero(valid) > MOST_SAMPLES:
        raise InputError(f"more than {MOST_SAMPLES} samples: cut the log into pieces")
    time = _stamps(local)[valid]
    fields = (np.asarray(local[name], np.float64)[valid] for name in FIELDS)
    values = [(time - time[0]) / 1e6, *fields]
    columns = dict(zip(COLUMNS, values, strict=True))
    notes = _notes(log, local, valid)
    anchor = Anchor(_origin(local, valid), _epoch(log, local, valid))
    return _at(FlightTable(columns, Head(frame="NED"), notes, anchor), layout.anchor.origin)


def _parsed(content: bytes) -> Any:
    """The log. What pyulog prints is not passed on."""
    try:
        pyulog = import_module("pyulog")
    except ImportError:
        raise MissingExtra("PX4 logs need pyulog: pip install 'sparsefit[logs]'") from None
    try:
        with redirect_stdout(io.StringIO()):
            return pyulog.ULog(_Content(content), [TOPIC, LANDED, GPS])
    except EOFError:
        raise InputError(CUT) from None
    except Exception as error:  # a damaged log may raise anything
        words = str(error)[:100] or type(error).__name__
        raise InputError(f"not a ULog of PX4, or a damaged one: {words}") from None


def _topic(log: Any, name: str) -> dict[str, Any] | None:
    """The samples of the first instance of a topic, by field."""
    topics = [data for data in log.data_list if data.name == name]
    return min(topics, key=lambda data: data.multi_id).data if topics else None


def _check_flown(local: dict[str, Any], valid: BoolArray, landed: dict[str, Any] | None) -> None:
    """Refuse a log without a fix, and one of a vehicle that never left the ground."""
    grounded = landed is not None and "landed" in landed and bool(np.all(landed["landed"]))
    if not valid.any():
        rests = grounded or not (np.ptp(local["x"]) or np.ptp(local["y"]))
        still = ", and stands still" if rests else ""
        raise InputError(
            f"the vehicle has no valid local position in any of {len(valid)} samples{still}; "
            "give a log of a flight with a position fix"
        )
    if grounded:
        raise InputError(
            "the vehicle stands still: it is landed throughout; give a log of a flight"
        )


def _stamps(local: dict[str, Any]) -> IntArray:
    """Microseconds (m,) since the vehicle was switched on, of the measurement where it has any."""
    stamps = local.get("timestamp_sample")
    stamps = stamps if stamps is not None and np.all(stamps) else local["timestamp"]
    return np.asarray(stamps).astype(np.int64)


def _origin(local: dict[str, Any], valid: BoolArray) -> tuple[float, float] | None:
    """Longitude and latitude of the filter's origin, where it knows one and keeps it."""
    if not all(name in local for name in ("ref_lon", "ref_lat", "xy_global")):
        return None
    places = np.column_stack([local["ref_lon"], local["ref_lat"]])[valid]
    if not np.all(local["xy_global"][valid]) or np.ptp(places, axis=0).any():
        return None
    return float(places[0, 0]), float(places[0, 1])


def _epoch(log: Any, local: dict[str, Any], valid: BoolArray) -> datetime | None:
    """The time of the first sample, by the satellites' clock."""
    fixes = _topic(log, GPS)
    if fixes is None or "time_utc_usec" not in fixes or not np.any(fixes["time_utc_usec"]):
        return None
    row = int(np.argmax(fixes["time_utc_usec"] > 0))
    since_boot = int(_stamps(local)[valid][0]) - int(fixes["timestamp"][row])
    return moment_at(int(fixes["time_utc_usec"][row]) + since_boot)


def _at(table: FlightTable, origin: tuple[float, float] | None) -> FlightTable:
    """The table with its zero moved to an origin, where it knows its own."""
    own = table.anchor.origin
    if origin is None or own is None or own == origin:
        return table
    plane = plane_of(np.array(own[:1]), np.array(own[1:]), ("ref_lon", "ref_lat"), origin)
    east, north = plane.position[0].tolist()
    columns = table.columns | {
        "x": north + table.columns["x"],
        "y": east + table.columns["y"],
    }
    return replace(table, columns=columns, anchor=replace(table.anchor, origin=origin))


def _notes(log: Any, local: dict[str, Any], valid: BoolArray) -> tuple[str, ...]:
    notes = [f"PX4's {TOPIC}"]
    invalid = len(valid) - int(np.count_nonzero(valid))
    if invalid:
        notes.append(f"{invalid} of {len(valid)} samples are not valid, and left out")
    if RESETS in local:
        resets = int(np.count_nonzero(np.diff(np.asarray(local[RESETS])[valid])))
        if resets:
            notes.append(f"the filter reset its position {resets} times: it jumps there")
    if log.dropouts:
        longest = max(dropout.duration for dropout in log.dropouts) / 1e3
        notes.append(f"{len(log.dropouts)} dropouts of the logger, of up to {longest:.3g} s")
    if log.file_corruption:
        notes.append("damaged in places: what could not be read is missing")
    return tuple(notes)
