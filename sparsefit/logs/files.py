"""Flights in files: ``.csv`` and ``.parquet`` are written and read exactly, others are read."""

from __future__ import annotations

import os
from dataclasses import replace
from datetime import datetime
from pathlib import Path

from sparsefit.errors import InputError, one_of, told_with
from sparsefit.flight.record import Flight
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.logs import csv_file, parquet_file
from sparsefit.logs.flight_table import FlightTable
from sparsefit.logs.layout import Layout
from sparsefit.logs.recorders import decode_igc, decode_ulog
from sparsefit.whole_file import regular_file, write_whole

LARGEST = 2_000_000_000  # bytes: twice what the most samples take as text
WRITTEN = {".csv": csv_file.encode, ".parquet": parquet_file.encode}
TABLES = {".csv": csv_file.decode, ".parquet": parquet_file.decode}
TABLES |= dict.fromkeys((".txt", ".tsv", ".dat"), csv_file.decode)
FORMATS = {**TABLES, ".ulg": decode_ulog, ".igc": decode_igc}


def read_flight(
    path: str | os.PathLike[str],
    *,
    vehicle: PointMassVehicle | None = None,
    columns: str | None = None,
    origin: tuple[float, float] | None = None,
    epoch: str | datetime | None = None,
) -> Flight:
    """Read a flight from a table, a PX4 log (``.ulg``) or an IGC file.

    Of a table (``.csv``, ``.parquet``, ``.txt``, ``.tsv``, ``.dat``): columns ``time, x, y, vx,
    vy`` in any order, in s, m, m/s or the unit behind the name, ``vx [cm/s]``; ``ax, ay``, the
    acceleration by propulsion [m/s^2]; others are ignored. Without ``vx`` and ``vy`` the log has
    positions only. The vehicle: ``# response_time=``, ``# thrust_ax=``, ``# thrust_ay=`` lines in
    CSV (0 where it is missing) and the others of `sparsefit.logs.flight_table`, ``frame``
    (``ENU`` or ``NED``) among them; ``mean_velocity`` and ``length_scale`` of the paper's cells,
    where the true flow is known; the same keys in the metadata of Parquet.

    Args:
        path: the file.
        vehicle: used in place of the one in the file.
        columns: the columns of a table with other names, and their units:
            ``"time=t[ms],x=lon,y=lat,vx=u[cm/s],vy=v[cm/s]"``; without a unit, that in the header
            applies. Longitude and latitude, degrees, become metres on a local plane about their
            middle, x east and y north; ISO 8601 times become seconds since the first.
        origin: longitude and latitude [degrees] of x = y = 0, for logs with geographic
            coordinates: gives several logs one frame.
        epoch: the ISO time of t = 0, for logs with calendar times: gives several logs one clock.

    Raises:
        InputError: naming file, line and column, if it is no flight, or there is no vehicle.
        MissingExtra: where pyproj (degrees), pyulog (PX4) or aerofiles (IGC) is not installed.
    """
    table = read_table(path, Layout.of(columns, origin, epoch))
    with told_with(Path(path)):
        return table.flight(vehicle)


def read_table(path: str | os.PathLike[str], layout: Layout | None = None) -> FlightTable:
    """Read the columns and settings of a flight file, which may lack a vehicle.

    Raises:
        InputError: naming file, line and column, if the file is missing or holds no such table.
        MissingExtra: as of `read_flight`.
    """
    path, layout = Path(path), layout or Layout()
    with regular_file(path, most=LARGEST) as file, told_with(path):
        mapped, suffix = bool(layout.sources), path.suffix.lower()
        formats = TABLES if mapped else FORMATS  # others name their columns themselves
        one_of("file type" + " with columns=" * mapped, suffix or path.name, formats)
        table = formats[suffix](file, layout)
    if layout.epoch is None or table.epoch is None:
        return table
    time = table.columns["time"] + (table.epoch - layout.epoch).total_seconds()
    return replace(table, columns=table.columns | {"time": time}, epoch=layout.epoch)


def write_flight(flight: Flight, path: str | os.PathLike[str], *, overwrite: bool = False) -> None:
    """Write ``flight`` to a ``.csv`` or ``.parquet`` file; `read_flight` returns it exactly.

    A true flow other than `CellularFlow` is left out. The file appears whole or not at all.

    Raises:
        InputError: if the file exists and ``overwrite`` is false, or cannot be written.
    """
    path = Path(path)
    one_of("file type", path.suffix.lower() or path.name, WRITTEN)
    if os.path.lexists(path) and not overwrite:
        raise InputError(f"{path} exists; pass overwrite=True or choose another name")
    write_whole(path, WRITTEN[path.suffix.lower()](FlightTable.from_flight(flight)))
