"""The quantities of a simulated flight: keys of [flights] in a study, and options of `simulate`.

One row says the unit, the range and the random streams of a quantity; `keys.toml` says what it
means. Every random quantity has its own stream, by its place here: a row at the end changes no
other's draws, and a quantity that went leaves its streams behind.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

from sparsefit.errors import suggestion
from sparsefit.study.schema import ANY, NOT_NEGATIVE, POSITIVE, SHARE, Range

FLOW_KEYS = ("mean_velocity", "length_scale", "timescale")
RATIO = Range(least=0.01, most=100.0)
TURBULENCE_FIELD = "turbulence_field"  # the stream of the field of turbulence, which has no key
# Words that people write for a key.
SYNONYMS = {
    **dict.fromkeys(("dropouts", "dropout"), "lost_samples"),
    **dict.fromkeys(("rate", "frequency"), "sample_rate"),
    "noise": "velocity_noise",
    "speed": "mean_velocity",
    "tau": "response_time",
    "thrust": "thrust_acceleration",
}


@dataclass(frozen=True)
class Quantity:
    """A quantity: its name, unit and range.

    streams: the random numbers that it fills, two of a pair [x, y]; needs: the quantities without
    which it has no meaning; of_flow: whether still air leaves it out; shapes: whether cells with it
    are other than squares along the axes that stand; fault: the field of `LogFaults` that it is.
    """

    name: str
    unit: str
    range: Range
    streams: tuple[str, ...] = ()
    needs: tuple[str, ...] = ()
    of_flow: bool = False
    shapes: bool = False
    fault: str = ""


def _q(name: str, unit: str, range: Range, *needs: str, axes: str = "",
       of_flow: bool = False, shapes: bool = False, fault: str = "") -> Quantity:  # fmt: skip
    streams = (f"{axes}_x", f"{axes}_y") if axes else (name,)
    return Quantity(name, unit, range, streams, needs, of_flow or shapes, shapes, fault)


def _without_key(*streams: str) -> Quantity:
    return Quantity("", "", ANY, streams)


_ROWS = (
    _q("mean_velocity", "m/s", POSITIVE, of_flow=True),
    _q("length_scale", "m", POSITIVE, of_flow=True),
    _q("timescale", "s", POSITIVE, of_flow=True),
    _q("response_time", "s", POSITIVE),
    _q("thrust_acceleration", "m/s²", ANY, axes="thrust"),
    _q("initial_position", "m", ANY, axes="position"),
    _q("initial_velocity", "m/s", ANY, axes="velocity"),
    _q("duration", "s", POSITIVE),
    _q("sample_rate", "Hz", POSITIVE),
    _q("process_noise", "m/s²", NOT_NEGATIVE),
    _q("position_noise", "m", NOT_NEGATIVE),
    _q("velocity_noise", "m/s", NOT_NEGATIVE),
    _q("wind", "m/s", ANY, axes="wind"),
    _q("second_scale_ratio", "", RATIO, "second_velocity_ratio", of_flow=True),
    _q("second_velocity_ratio", "", RATIO, "second_scale_ratio", of_flow=True),
    _without_key("third_scale_ratio", "third_velocity_ratio"),
    _q("believed_response_time_ratio", "", POSITIVE),
    _q("believed_thrust_ratio", "", NOT_NEGATIVE),
    _q("heading", "rad", ANY, shapes=True),
    _q("aspect", "", RATIO, shapes=True),
    _q("angle", "rad", Range(above=0.0, below=math.pi), shapes=True),
    _q("offset", "m", ANY, axes="offset", shapes=True),
    _q("drift_ratio", "", NOT_NEGATIVE, "drift_direction", shapes=True),
    _q("drift_direction", "rad", ANY, of_flow=True),
    _q("swell", "", Range(least=0.0, most=0.99), shapes=True),
    _q("swell_period", "s", POSITIVE, of_flow=True),
    _q("swell_phase", "rad", ANY, of_flow=True),
    _q("second_heading", "rad", ANY, "second_scale_ratio", shapes=True),
    _q("wind_ratio", "", NOT_NEGATIVE, "wind_direction", of_flow=True),
    _q("wind_direction", "rad", ANY),
    _q("turbulence_ratio", "", NOT_NEGATIVE, "turbulence_length", of_flow=True),
    _q("turbulence_length", "m", POSITIVE, of_flow=True),
    _q("turbulence_memory", "s", POSITIVE, of_flow=True),
    _without_key(TURBULENCE_FIELD),
    _q("time_jitter", "", Range(least=0.0, most=0.49)),
    _q("position_wander", "m", NOT_NEGATIVE, fault="wander"),
    _q("position_wander_time", "s", POSITIVE, fault="wander_time"),
    _q("outliers", "", SHARE, fault="outliers"),
    _q("outlier_size", "m/s", NOT_NEGATIVE, fault="outlier_size"),
    _q("jumps", "", NOT_NEGATIVE, fault="jumps"),
    _q("jump_size", "m", NOT_NEGATIVE, fault="jump_size"),
    _q("gaps", "", NOT_NEGATIVE, fault="gaps"),
    _q("gap_duration", "s", NOT_NEGATIVE, fault="gap_duration"),
    _q("drag", "1/m", POSITIVE),
    _q("thrust_turn", "m/s²", NOT_NEGATIVE, "thrust_period"),
    _q("thrust_period", "s", POSITIVE),
    _q("thrust_phase", "rad", ANY),
    _q("thrust_noise", "m/s²", NOT_NEGATIVE, "thrust_turn"),
    _q("believed_drag_ratio", "", POSITIVE),
    _q("believed_response_time", "s", POSITIVE),
    _without_key("believed_drag"),
    _q("together", "flights", Range(least=1.0, most=64.0)),
    _q("lost_samples", "", SHARE, fault="lost_samples"),
)  # fmt: skip
STREAMS = tuple(stream for row in _ROWS for stream in row.streams)
QUANTITIES = {row.name: row for row in _ROWS if row.name}
QUANTITIES["measurement_noise"] = Quantity(  # both in one key, so that a sweep moves both
    "measurement_noise", "m/s, m", NOT_NEGATIVE, ("velocity_noise", "position_noise")
)  # fmt: skip


@dataclass(frozen=True)
class FlightWords:
    """The keys of [flights] that are words."""

    flow: Literal["cellular", "none", "turbulence"] = "cellular"
    turbulence_spectrum: Literal["dryden", "von-karman"] = "dryden"
    thrust_log: Literal["measured", "none"] = "measured"


def nearest(name: str, names: Iterable[str]) -> str:
    """The nearest key of [flights] for a message, and not all of the sixty."""
    if name in SYNONYMS:
        return f': did you mean "{SYNONYMS[name]}"?'
    near = suggestion(name, names)
    return near if "did you mean" in near else ": `sparsefit simulate --help` lists them"
