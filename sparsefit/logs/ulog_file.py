"""PX4's logs (ULog), read by pyulog: the local position that the vehicle's own filter estimates.

``vehicle_local_position``: x north and y east [m], vx and vy [m/s], time stamps in us (PX4 user
guide, "ULog File Format" and "vehicle_local_position"). Samples that the filter itself calls
invalid are left out. What the vehicle is (its response to the air) no log of PX4 tells.
"""

from __future__ import annotations

import io
from contextlib import redirect_stdout
from typing import Any, BinaryIO

import numpy as np

from sparsefit.arrays import BoolArray
from sparsefit.errors import InputError, optional
from sparsefit.logs.flight_table import COLUMNS, FlightTable
from sparsefit.logs.layout import Layout, check_size, moment_at
from sparsefit.logs.plane import plane_of

TOPIC = "vehicle_local_position"
FIELDS = COLUMNS[1:]  # of the topic: those of a flight


def decode(file: BinaryIO, layout: Layout) -> FlightTable:
    """Return the table in a log's content, as far as it goes; its frame is NED.

    Raises:
        InputError: if it is no ULog, holds no valid local position, or that of a vehicle that
            never left the ground; and on a column map, which it needs none of.
        MissingExtra: without pyulog.
    """
    layout.refuse_any("a PX4 log")
    pyulog = optional("pyulog", "PX4 logs need pyulog", "logs")
    try:
        with redirect_stdout(io.StringIO()):  # what pyulog prints is not passed on
            log = pyulog.ULog(file, [TOPIC, "vehicle_land_detected", "vehicle_gps_position"])
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
    landed = topics.get("vehicle_land_detected", {}).get("landed")
    if not valid.any() or (landed is not None and np.all(landed)):
        words = f"no valid local position in any of {len(valid)} samples"
        raise InputError(
            f"{'it stands on the ground throughout' if valid.any() else words}; give a log of a "
            "flight with a position fix"
        )
    check_size(int(np.count_nonzero(valid)))
    stamps = np.asarray(local.get("timestamp_sample", 0)).astype(np.int64)
    if not np.all(stamps):  # of the measurement, where it has any
        stamps = np.asarray(local["timestamp"]).astype(np.int64)
    local, stamps = {name: np.asarray(local[name])[valid] for name in local}, stamps[valid]
    values = (local[name].astype(np.float64) for name in FIELDS)
    columns = dict(zip(COLUMNS, ((stamps - stamps[0]) / 1e6, *values), strict=True))
    notes = [f"PX4's {TOPIC}"]
    if len(stamps) < len(valid):
        invalid = len(valid) - len(stamps)
        notes.append(f"{invalid} of {len(valid)} samples are not valid, and left out")
    if resets := np.count_nonzero(np.diff(local.get("xy_reset_counter", [0]))):
        notes.append(f"the filter reset its position {resets} times: it jumps there")
    if log.dropouts:
        longest = max(dropout.duration for dropout in log.dropouts) / 1e3
        notes.append(f"{len(log.dropouts)} dropouts of the logger, of up to {longest:.3g} s")
    if log.file_corruption:
        notes.append("damaged in places: what could not be read is missing")
    origin = epoch = None
    if {"ref_lon", "ref_lat", "xy_global"} <= set(local) and np.all(local["xy_global"]):
        places = np.column_stack([local["ref_lon"], local["ref_lat"]])
        if not np.ptp(places, axis=0).any():  # the origin of the filter, which it keeps
            origin = (float(places[0, 0]), float(places[0, 1]))
    if origin and layout.origin:
        east, north = places[:1].T
        plane = plane_of(east, north, ("ref_lon", "ref_lat"), layout.origin)
        columns["x"] = columns["x"] + plane.position[0, 1]
        columns["y"] = columns["y"] + plane.position[0, 0]
        origin = layout.origin
    clock: Any = topics.get("vehicle_gps_position", {})
    if np.any(clock.get("time_utc_usec", 0)):  # of the satellites
        row = int(np.argmax(clock["time_utc_usec"] > 0))
        since_boot = int(stamps[0]) - int(clock["timestamp"][row])
        epoch = moment_at(int(clock["time_utc_usec"][row]) + since_boot)
    return FlightTable(columns, {}, None, "NED", tuple(notes), origin, epoch)
