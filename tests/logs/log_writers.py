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
BOOT = 20_000_000  # us before the first sample


def rows_of(flight, valid):
    """Those of its local position; valid: one for all samples, or of each, (m,)."""
    stamps = BOOT + np.rint(1e6 * flight.time).astype(int)
    fine = np.broadcast_to(valid, flight.samples).tolist()
    parts = zip(stamps.tolist(), flight.position, flight.velocity, fine, strict=True)
    return [(stamp, *place, *speed, good, good) for stamp, place, speed, good in parts]


def ulog_at(flight, longitude, latitude, booted):
    """A log with the place of its origin, degrees, and when it was switched on, us of UTC."""
    rows = [(*row, latitude, longitude, True) for row in rows_of(flight, True)]
    fixes = [(BOOT - 500, 0), (BOOT + 7_000, booted + BOOT + 7_000)]
    return ulog({"vehicle_local_position": (GLOBAL, rows), "vehicle_gps_position": (FIX, fixes)})


def ulog_of(flight, *, valid=True, landed=None):
    rows = rows_of(flight, valid)
    topics = {"vehicle_local_position": (LOCAL, rows)}
    if landed is not None:
        topics["vehicle_land_detected"] = (LANDED, [(BOOT, landed), (rows[-1][0], landed)])
    return ulog(topics)


def igc(times, latitude, longitude, *, start=datetime(2024, 6, 1, 23, 59, 30)):
    lines = ["AXXX001 sparsefit", f"HFDTE{start:%d%m%y}"]
    for seconds, *degrees in zip(times, latitude, longitude, strict=True):
        told = ""
        for value, width, signs in zip(degrees, (2, 3), ("NS", "EW"), strict=True):
            units = round(abs(value) * 60 * 10**3)
            told += f"{units // 60000:0{width}d}{units % 60000:05d}{signs[int(value < 0)]}"
        lines.append(f"B{start + timedelta(seconds=seconds):%H%M%S}{told}A0050000512")
    return "\r\n".join([*lines, "GABCDEF"]) + "\r\n"
