"""Logs of recorders: PX4's (ULog, read by pyulog) and those of gliders (IGC, read by aerofiles).

ULog: ``vehicle_local_position``, the position estimated by the vehicle's own filter: x north and y
east [m], vx and vy [m/s], time stamps in us (PX4 user guide, "ULog File Format" and
"vehicle_local_position"). Samples that the filter marks as invalid are left out. The response time
of the vehicle is in no PX4 log.

IGC: B records, time in UTC to a second, longitude and latitude to a thousandth of a minute of arc,
1.9 m (FAI, Technical Specification for GNSS Flight Recorders, appendix A).
"""

from __future__ import annotations

import io
from contextlib import redirect_stdout, suppress
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from typing import Any, BinaryIO

import numpy as np

from sparsefit.arrays import BoolArray
from sparsefit.errors import InputError, optional
from sparsefit.logs.flight_table import COLUMNS, FlightTable
from sparsefit.logs.layout import Layout, Source, check_size
from sparsefit.logs.plane import plane_of

TOPIC = "vehicle_local_position"
FIELDS = COLUMNS[1:5]  # of the topic: those of a flight


def decode_ulog(file: BinaryIO, layout: Layout) -> FlightTable:
    """Return the table in a log, up to where it is damaged; its frame is NED.

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
    if not np.all(stamps):  # of the measurement, if it has them
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
        with suppress(OverflowError):  # beyond the calendar
            epoch = datetime.fromtimestamp(0, UTC) + timedelta(microseconds=moment)
    return FlightTable(columns, {}, "NED", tuple(notes), origin, epoch)


def decode_igc(file: BinaryIO, layout: Layout) -> FlightTable:
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
    except Exception as error:  # aerofiles may raise anything on other files
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
