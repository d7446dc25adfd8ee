"""The keys of [flights]: what each is, where it must lie, and the stream it is drawn from."""

from __future__ import annotations

import math
from dataclasses import dataclass

# Every random quantity has its own stream: adding one at the end changes no other's draws.
STREAMS = (
    "mean_velocity",
    "length_scale",
    "timescale",
    "response_time",
    "thrust_x",
    "thrust_y",
    "position_x",
    "position_y",
    "velocity_x",
    "velocity_y",
    "duration",
    "sample_rate",
    "process_noise",
    "position_noise",
    "velocity_noise",
    "wind_x",
    "wind_y",
    "second_scale_ratio",
    "second_velocity_ratio",
    "third_scale_ratio",
    "third_velocity_ratio",
    "believed_response_time_ratio",
    "believed_thrust_ratio",
    "heading",
    "aspect",
    "angle",
    "offset_x",
    "offset_y",
    "drift_ratio",
    "drift_direction",
    "swell",
    "swell_period",
    "swell_phase",
    "second_heading",
    "wind_ratio",
    "wind_direction",
    "turbulence_ratio",
    "turbulence_length",
    "turbulence_memory",
    "turbulence_field",
    "time_jitter",
    "position_wander",
    "position_wander_time",
    "outliers",
    "outlier_size",
    "jumps",
    "jump_size",
    "gaps",
    "gap_duration",
    "drag",
    "thrust_turn",
    "thrust_period",
    "thrust_phase",
    "thrust_noise",
    "believed_drag_ratio",
    "believed_response_time",
    "believed_drag",
    "together",
)
# The field of turbulence is drawn from a stream of this name; no key fills it.
TURBULENCE_FIELD = "turbulence_field"
FLOW_KEYS = ("mean_velocity", "length_scale", "timescale")
# Believed over true: what the estimator is told of the vehicle.
RATIO_KEYS = ("believed_response_time_ratio", "believed_thrust_ratio", "believed_drag_ratio")
LAW_KEYS = ("believed_response_time", "believed_drag")  # the law of drag that it is told instead
NOISE_KEYS = ("process_noise", "position_noise", "velocity_noise")
SUPERPOSED = (
    ("second_scale_ratio", "second_velocity_ratio"),
    ("third_scale_ratio", "third_velocity_ratio"),
)
SUPERPOSED_KEYS = tuple(key for pair in SUPERPOSED for key in pair)
SHAPE_KEYS = (
    *("heading", "aspect", "angle", "offset", "drift_ratio", "drift_direction"),
    *("swell", "swell_period", "swell_phase", "second_heading"),
)
SHAPE_STREAMS = ("offset_x", "offset_y", *(key for key in SHAPE_KEYS if key != "offset"))
# What belongs to another key, and makes no shape by itself.
BESIDE = ("drift_direction", "swell_period", "swell_phase")
TURBULENCE_KEYS = ("turbulence_ratio", "turbulence_length", "turbulence_memory")
# Of a flight's flow: a protocol without one leaves them out.
OF_FLOW = (*FLOW_KEYS, *SUPERPOSED_KEYS, *SHAPE_STREAMS, *TURBULENCE_KEYS, "wind_ratio")
FAULTS = {
    "position_wander": "wander",
    "position_wander_time": "wander_time",
    "outliers": "outliers",
    "outlier_size": "outlier_size",
    "jumps": "jumps",
    "jump_size": "jump_size",
    "gaps": "gaps",
    "gap_duration": "gap_duration",
}  # key: the field of `LogFaults` that it is
COUNTS = ("jumps", "gaps")
MOST_TOGETHER = 64.0  # flights that are estimated as one
REQUIRED = ("duration", "sample_rate")
DRAG_KEYS = ("response_time", "drag")  # at least one
# A key, and the one that it says nothing without.
NEEDS = {
    "drift_ratio": "drift_direction",
    "turbulence_ratio": "turbulence_length",
    "wind_ratio": "wind_direction",
    "second_heading": "second_scale_ratio",
    "thrust_turn": "thrust_period",
    "thrust_noise": "thrust_turn",
}
RATIOS = (0.01, 100.0)


@dataclass(frozen=True)
class Quantity:
    """A key of [flights]: the streams it fills (two: a pair [x, y]) and where it must lie.

    open_end: its least and, where there is one, its most are not allowed themselves.
    """

    streams: tuple[str, ...]
    least: float | None = None
    most: float | None = None
    open_end: bool = False


def _of(*keys: str, least: float | None = None, most: float | None = None,
        open_end: bool = False) -> dict[str, Quantity]:  # fmt: skip
    return {key: Quantity((key,), least, most, open_end) for key in keys}


QUANTITIES = {
    **_of(*FLOW_KEYS, *REQUIRED, *DRAG_KEYS, RATIO_KEYS[0], RATIO_KEYS[2], *LAW_KEYS,
          "thrust_period", least=0.0, open_end=True),
    **_of(*NOISE_KEYS, RATIO_KEYS[1], "thrust_turn", "thrust_noise", least=0.0),
    **_of(*SUPERPOSED_KEYS, "aspect", least=RATIOS[0], most=RATIOS[1]),
    **_of("heading", "second_heading", "drift_direction", "wind_direction", "swell_phase",
          "thrust_phase"),
    **_of("angle", least=0.0, most=math.pi, open_end=True),
    **_of("swell", least=0.0, most=0.99),
    **_of("together", least=1.0, most=MOST_TOGETHER),
    **_of("turbulence_length", "turbulence_memory", "swell_period", "position_wander_time",
          least=0.0, open_end=True),
    **_of("drift_ratio", "wind_ratio", "turbulence_ratio", "position_wander", "outlier_size",
          *COUNTS, "jump_size", "gap_duration", least=0.0),
    **_of("outliers", least=0.0, most=1.0),
    **_of("time_jitter", least=0.0, most=0.49),
    "thrust_acceleration": Quantity(("thrust_x", "thrust_y")),
    "initial_position": Quantity(("position_x", "position_y")),
    "initial_velocity": Quantity(("velocity_x", "velocity_y")),
    "wind": Quantity(("wind_x", "wind_y")),
    "offset": Quantity(("offset_x", "offset_y")),
    "measurement_noise": Quantity(("velocity_noise", "position_noise"), 0.0),
}  # fmt: skip
