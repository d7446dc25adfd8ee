"""The units that columns of a log may be in, and what one of each is in SI units."""

from __future__ import annotations

from sparsefit.errors import InputError, unknown

DEGREES = "deg"  # of longitude and latitude, which a projection turns into metres
TIMES = {
    "s": 1.0,
    "ms": 1e-3,
    "us": 1e-6,
    "µs": 1e-6,
    "ns": 1e-9,
    "min": 60.0,
    "h": 3600.0,
    "d": 86400.0,
}
LENGTHS = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "km": 1e3, "ft": 0.3048, "mi": 1609.344, "nmi": 1852.0}
SPEEDS = {
    "m/s": 1.0,
    "mm/s": 1e-3,
    "cm/s": 1e-2,
    "km/s": 1e3,
    "km/h": 1.0 / 3.6,
    "ft/s": 0.3048,
    "mph": 0.44704,
    "kn": 1852.0 / 3600.0,
}
ACCELERATIONS = {"m/s^2": 1.0, "m/s2": 1.0, "cm/s^2": 1e-2, "ft/s^2": 0.3048, "g": 9.80665}
_OF_POSITION = LENGTHS | {DEGREES: 1.0}
_SPELLED = {  # in headers
    **{"sec": "s", "seconds": "s", "msec": "ms", "usec": "us", "hr": "h", "hours": "h"},
    **{"meters": "m", "metres": "m", "°": DEGREES, "degrees": DEGREES},
    **{"m s-1": "m/s", "cm s-1": "cm/s", "kmh": "km/h", "kph": "km/h", "kt": "kn", "knots": "kn"},
}
_BY_FIELD = {
    "time": TIMES,
    **dict.fromkeys(("x", "y"), _OF_POSITION),
    **dict.fromkeys(("vx", "vy"), SPEEDS),
    **dict.fromkeys(("ax", "ay"), ACCELERATIONS),
}


def spelled(unit: str) -> str:
    """Return the unit as this module spells it: ``kn`` of ``knots``, say."""
    return _SPELLED.get(unit, unit)


def factor_of(field: str, unit: str) -> float:
    """Return what one ``unit`` of a field is in SI units; 1 for degrees and for no unit.

    Args:
        field: ``time``, ``x``, ``y``, ``vx``, ``vy``, ``ax`` or ``ay``.
        unit: as written in the log; empty for the SI unit.

    Raises:
        InputError: naming the known units, where it is none of them.
    """
    known, unit = _BY_FIELD[field], spelled(unit)
    if not unit:
        return 1.0
    if unit not in known:
        raise InputError(f"{field}: {unknown('unit', unit, known)}")
    return known[unit]


def named(ratio: float, known: dict[str, float], within: float = 0.02) -> str:
    """Return the unit of ``known`` that is ``ratio`` of the first one, to a share; else nothing."""
    for unit, factor in list(known.items())[1:]:
        if abs(ratio / factor - 1.0) < within:
            return unit
    return ""
