"""PX4's logs (ULog), read by pyulog: the local position that the vehicle's own filter estimates.

``vehicle_local_position``: x north and y east [m], vx and vy [m/s], time stamps in us (PX4 user
guide, "ULog File Format" and "vehicle_local_position"). Samples that the filter itself calls
invalid are left out. What the vehicle is (its response to the air) no log of PX4 tells.
"""

from __future__ import annotations

import io
from contextlib import redirect_stdout, suppress
from datetime import UTC, datetime, timedelta
from typing import Any, BinaryIO

import numpy as np

from sparsefit.arrays import BoolArray
from sparsefit.errors import InputError, optional
from sparsefit.logs.flight_table import COLUMNS, FlightTable
from sparsefit.logs.layout import Layout, check_size
from sparsefit.logs.plane import plane_of

TOPIC = "vehicle_local_position"
FIELDS = COLUMNS[1:5]  # of the topic: those of a flight


def decode(file: BinaryIO, layout: Layout) -> FlightTable:
    """Return the table in a log's content, as far as it goes; its frame is NED.

    Raises:
        InputError: if it is no ULog, or holds no valid local position.
        MissingExtra: without pyulog.
    """
    pyulog = optional("pyulog", "PX4 logs need pyulog", "logs")
    try:
        with redirect_stdout(io.StringIO()):  # what pyulog prints is not passed on
            log = pyulog.ULog(file, [TOPIC, "vehicle_gps_position"])
    except Exception as error:  # a damaged log may raise anything
        words = str(error)[:100] or type(error).__name__
        raise InputError(f"not a ULog of PX4, or a damaged one: {words}") from None
    instances = sorted(log.data_list, key=lambda data: -data.multi_id)
    topics = {data.name: data.data for data in instances}  # the first of each
    lacking = {"timestamp", *FIELDS} - set(topics.get(TOPIC, ()))
    if lacking:
        words = f"has no {', '.join(sorted(lacking))}" if TOPIC in topics else "is not in the log"
        raise InputError(f"{TOPIC} {words}; log it, or export a position to CSV")
    local = topics[TOPIC]
    valid: BoolArray = np.logical_and.reduce([np.isfinite(local[name]) for name in FIELDS])
    for name in ("xy_valid", "v_xy_valid"):
        valid &= np.asarray(local.get(name, True)) != 0
    if not valid.any():
        words = f"no valid local position in any of {len(valid)} samples"
        raise InputError(f"{words}; give a log of a flight with a position fix")
    check_size(int(np.count_nonzero(valid)))
    stamps = np.asarray(local.get("timestamp_sample", 0)).astype(np.int64)
    if not np.all(stamps):  # of the measurement, where it has any
        stamps = np.asarray(local["timestamp"]).astype(np.int64)
    local, stamps = {name: np.asarray(local[name])[valid] for name in local}, stamps[valid]
    values = (local[name].astype(np.float64) for name in FIELDS)
    columns = dict(zip(COLUMNS, ((stamps - stamps[0]) / 1e6, *values), strict=False))
    notes = [f"PX4's {TOPIC}"]
    if invalid := len(valid) - len(stamps):
        notes.append(f"{invalid} of {len(valid)} samples are not valid, and left out")
    if log.file_corruption:
        notes.append("damaged in places: what could not be read is missing")
    origin = epoch = None
    if {"ref_lon", "ref_lat", "xy_global"} <= set(local) and np.all(local["xy_global"]):
        origin = (float(local["ref_lon"][0]), float(local["ref_lat"][0]))
    if origin and layout.origin:
        east, north = np.array([origin]).T
        plane = plane_of(east, north, ("ref_lon", "ref_lat"), layout.origin)
        columns["x"] = columns["x"] + plane.position[0, 1]
        columns["y"] = columns["y"] + plane.position[0, 0]
        origin = layout.origin
    clock: Any = topics.get("vehicle_gps_position", {})
    if np.any(clock.get("time_utc_usec", 0)):  # of the satellites
        row = int(np.argmax(clock["time_utc_usec"] > 0))
        since_boot = int(stamps[0]) - int(clock["timestamp"][row])
        moment = int(clock["time_utc_usec"][row]) + since_boot
        with suppress(OverflowError):  # beyond all calendars
            epoch = datetime.fromtimestamp(0, UTC) + timedelta(microseconds=moment)
    return FlightTable(columns, {}, "NED", tuple(notes), origin, epoch)
