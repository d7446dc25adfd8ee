"""PX4's logs (ULog), read by pyulog: the local position that the vehicle's own filter estimates.

``vehicle_local_position``: x north and y east [m], vx and vy [m/s], time stamps in us (PX4 user
guide, "ULog File Format" and "vehicle_local_position"). Samples that the filter itself calls
invalid are left out. What the vehicle is (its response to the air) no log of PX4 tells.
"""

from __future__ import annotations

import io
from contextlib import redirect_stdout
from importlib import import_module
from typing import Any

import numpy as np

from sparsefit.arrays import Array, BoolArray
from sparsefit.errors import InputError, MissingExtra
from sparsefit.flight.layout import Layout
from sparsefit.flight.record import MOST_SAMPLES
from sparsefit.flight.table import COLUMNS, FlightTable

TOPIC, LANDED = "vehicle_local_position", "vehicle_land_detected"
FIELDS = ("x", "y", "vx", "vy")
VALID = ("xy_valid", "v_xy_valid")
RESETS = "xy_reset_counter"
CUT = "the log is truncated: it ends within a message; copy it again"
HEADER = 3  # bytes before each message: a log may end in place of one, and nowhere else
SHOWN = 8  # topics that a refusal lists


class _Content(io.BytesIO):
    """A log in memory that is refused where it ends within a message: pyulog would go on."""

    def read(self, size: int | None = -1, /) -> bytes:
        found = super().read(size)
        wanted = -1 if size is None else size
        if len(found) < wanted and (wanted != HEADER or len(found) > 0):
            raise EOFError  # no ValueError: of those pyulog makes nothing
        return found


def decode(content: bytes, layout: Layout) -> FlightTable:
    """Return the table in a log's content; its frame is NED.

    Raises:
        InputError: if it is no ULog, is cut off, holds no valid local position, or that of a
            vehicle that never left the ground; and on a column map, which it needs none of.
        MissingExtra: without pyulog.
    """
    layout.refuse_any("a PX4 log")
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
    kept = _valid(local)
    _check_flown(local, kept, _topic(log, LANDED))
    if np.count_nonzero(kept) > MOST_SAMPLES:
        raise InputError(f"more than {MOST_SAMPLES} samples: cut the log into pieces")
    time = _time(local)[kept]
    values = [time - time[0], *(np.asarray(local[name], np.float64)[kept] for name in FIELDS)]
    columns = {name: one.tolist() for name, one in zip(COLUMNS, values, strict=True)}
    return FlightTable(columns, {}, "NED", _notes(log, local, kept))


def _parsed(content: bytes) -> Any:
    """The log. What pyulog prints is not passed on."""
    try:
        pyulog = import_module("pyulog")
    except ImportError:
        raise MissingExtra("PX4 logs need pyulog: pip install 'sparsefit[logs]'") from None
    try:
        with redirect_stdout(io.StringIO()):
            return pyulog.ULog(_Content(content), [TOPIC, LANDED])
    except EOFError:
        raise InputError(CUT) from None
    except Exception as error:  # a damaged log may raise anything
        words = " ".join(str(error).split())[:100] or type(error).__name__
        raise InputError(f"not a ULog of PX4, or a damaged one: {words}") from None


def _topic(log: Any, name: str) -> dict[str, Any] | None:
    """The samples of the first instance of a topic, by field."""
    found = [data for data in log.data_list if data.name == name]
    return min(found, key=lambda data: data.multi_id).data if found else None


def _valid(local: dict[str, Any]) -> BoolArray:
    """The samples (m,) that the filter calls valid and that are numbers."""
    kept = np.ones(len(local["timestamp"]), dtype=bool)
    for name in VALID:
        if name in local:
            kept &= np.asarray(local[name]) != 0
    for name in FIELDS:
        kept &= np.isfinite(local[name])
    return kept


def _check_flown(local: dict[str, Any], kept: BoolArray, landed: dict[str, Any] | None) -> None:
    """Refuse a log without a fix, and one of a vehicle that never left the ground."""
    grounded = landed is not None and "landed" in landed and bool(np.all(landed["landed"]))
    if not kept.any():
        rests = grounded or not (np.ptp(local["x"]) or np.ptp(local["y"]))
        still = ", and stands still" if rests else ""
        raise InputError(
            f"the vehicle has no valid local position in any of {len(kept)} samples{still}; give a "
            "log of a flight with a position fix"
        )
    if grounded:
        raise InputError(
            "the vehicle stands still: it is landed throughout; give a log of a flight"
        )


def _time(local: dict[str, Any]) -> Array:
    """Seconds since the first message: of the measurement where it is told, else of the message."""
    stamps = local.get("timestamp_sample")
    stamps = stamps if stamps is not None and np.all(stamps) else local["timestamp"]
    microseconds = np.asarray(stamps).astype(np.int64)
    time: Array = (microseconds - microseconds[0]) / 1e6
    return time


def _notes(log: Any, local: dict[str, Any], kept: BoolArray) -> tuple[str, ...]:
    notes = [f"PX4's {TOPIC}"]
    invalid = len(kept) - int(np.count_nonzero(kept))
    if invalid:
        notes.append(f"{invalid} of {len(kept)} samples are not valid, and left out")
    if RESETS in local:
        resets = int(np.count_nonzero(np.diff(np.asarray(local[RESETS])[kept])))
        if resets:
            notes.append(f"the filter reset its position {resets} times: it jumps there")
    if log.dropouts:
        longest = max(dropout.duration for dropout in log.dropouts) / 1e3
        notes.append(f"{len(log.dropouts)} dropouts of the logger, of up to {longest:.3g} s")
    if log.file_corruption:
        notes.append("damaged in places: what could not be read is missing")
    return tuple(notes)
