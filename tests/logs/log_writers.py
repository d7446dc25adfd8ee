"""Small writers of the formats that are only read: PX4's ULog and the IGC files of gliders."""

import struct
from datetime import datetime, timedelta

import numpy as np

MAGIC = b"ULog\x01\x12\x35\x01"
LOCAL = (
    ("timestamp", "uint64_t", "Q"),
    *((name, "float", "f") for name in ("x", "y", "vx", "vy")),
    *((name, "bool", "?") for name in ("xy_valid", "v_xy_valid")),
)
LANDED = (("timestamp", "uint64_t", "Q"), ("landed", "bool", "?"))


def message(kind, payload):
    return struct.pack("<HB", len(payload), ord(kind)) + payload


def ulog(topics):
    """The bytes of a log: topics by name, each a list of fields and rows of their values."""
    parts = [MAGIC + struct.pack("<Q", 0), message("B", bytes(40))]
    for name, (fields, _) in topics.items():
        told = ";".join(f"{kind} {field}" for field, kind, _ in fields)
        parts.append(message("F", f"{name}:{told};".encode()))
    for number, name in enumerate(topics):
        parts.append(message("A", struct.pack("<BH", 0, number) + name.encode()))
    for number, (fields, rows) in enumerate(topics.values()):
        packed = struct.Struct("<H" + "".join(code for *_, code in fields))
        parts += [message("D", packed.pack(number, *row)) for row in rows]
    return b"".join(parts)


GLOBAL = (
    *LOCAL,
    *((name, "double", "d") for name in ("ref_lat", "ref_lon")),
    ("xy_global", "bool", "?"),
)
FIX = (("timestamp", "uint64_t", "Q"), ("time_utc_usec", "uint64_t", "Q"))


def ulog_at(flight, longitude, latitude, booted, *, start=20_000_000):
    """The same with the place of the origin, degrees, and when it was switched on, us of UTC."""
    own = ulog_of(flight, start=start, told=True)["vehicle_local_position"][1]
    rows = [(*row, latitude, longitude, True) for row in own]
    fixes = [(start - 500, 0), (start + 7_000, booted + start + 7_000)]
    return ulog({"vehicle_local_position": (GLOBAL, rows), "vehicle_gps_position": (FIX, fixes)})


def ulog_of(flight, *, valid=None, start=20_000_000, landed=None, told=False):
    """The log of PX4 that a flight in NED would have left; valid: of each sample, (m,).

    told: its topics instead.
    """
    stamps = start + np.rint(1e6 * flight.time).astype(int)
    fine = np.ones(flight.samples, bool) if valid is None else valid
    rows = [
        (stamp, *place, *speed, good, good)
        for stamp, place, speed, good in zip(
            stamps.tolist(), flight.position, flight.velocity, fine.tolist(), strict=True
        )
    ]
    topics = {"vehicle_local_position": (LOCAL, rows)}
    if landed is not None:
        topics["vehicle_land_detected"] = (LANDED, [(start, landed), (stamps[-1], landed)])
    return topics if told else ulog(topics)


def igc(times, latitude, longitude, *, start=datetime(2024, 6, 1, 23, 59, 30)):
    """The text of a recorder's file."""
    lines = ["AXXX001 sparsefit", f"HFDTE{start:%d%m%y}"]
    for seconds, *degrees in zip(times, latitude, longitude, strict=True):
        told = ""
        for value, width, signs in zip(degrees, (2, 3), ("NS", "EW"), strict=True):
            units = round(abs(value) * 60 * 10**3)
            told += f"{units // 60000:0{width}d}{units % 60000:05d}{signs[int(value < 0)]}"
        lines.append(f"B{start + timedelta(seconds=seconds):%H%M%S}{told}A0050000512")
    return "\r\n".join([*lines, "GABCDEF"]) + "\r\n"
