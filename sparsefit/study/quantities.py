"""The keys of [flights]: the quantity that each is, where it must lie, and its random stream.

length_scale = 4.21                       every flight
length_scale = { uniform = [2.0, 10.0] }  each flight its own; loguniform, linspace, choice
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sparsefit.codec import Place, number, only, shown
from sparsefit.study.toml_file import items

# Every random quantity has its own stream: adding one at the end changes no other's draws.
STREAMS = (
    *("mean_velocity", "length_scale", "timescale", "response_time", "thrust_x", "thrust_y"),
    *("position_x", "position_y", "velocity_x", "velocity_y", "duration", "sample_rate"),
    *("process_noise", "position_noise", "velocity_noise", "wind_x", "wind_y"),
    *("second_scale_ratio", "second_velocity_ratio", "third_scale_ratio", "third_velocity_ratio"),
    *("believed_response_time_ratio", "believed_thrust_ratio", "heading", "aspect", "angle"),
    *("offset_x", "offset_y", "drift_ratio", "drift_direction", "swell", "swell_period"),
    *("swell_phase", "second_heading", "wind_ratio", "wind_direction", "turbulence_ratio"),
    *("turbulence_length", "turbulence_memory", "turbulence_field", "time_jitter"),
    *("position_wander", "position_wander_time", "outliers", "outlier_size", "jumps", "jump_size"),
    *("gaps", "gap_duration", "drag", "thrust_turn", "thrust_period", "thrust_phase"),
    *("thrust_noise", "believed_drag_ratio", "believed_response_time", "believed_drag"),
    *("together", "lost_samples"),
)
TURBULENCE_FIELD = "turbulence_field"  # the stream of the field of turbulence, which has no key
FLOW_KEYS = ("mean_velocity", "length_scale", "timescale")
# Believed over true: the vehicle that the estimator is given.
RATIO_KEYS = ("believed_response_time_ratio", "believed_thrust_ratio", "believed_drag_ratio")
LAW_KEYS = ("believed_response_time", "believed_drag")  # the law of drag in its place
SUPERPOSED = (
    ("second_scale_ratio", "second_velocity_ratio"),
    ("third_scale_ratio", "third_velocity_ratio"),
)
SUPERPOSED_KEYS = tuple(key for pair in SUPERPOSED for key in pair)
# Keys beside others, which make no shape of cells by themselves.
BESIDE = ("drift_direction", "swell_period", "swell_phase")
SHAPING = (
    *("offset_x", "offset_y", "heading", "aspect", "angle", "drift_ratio"),
    *("swell", "second_heading"),
)
TURBULENCE_KEYS = ("turbulence_ratio", "turbulence_length", "turbulence_memory")
# Of a flight's flow: a protocol without one leaves them out.
OF_FLOW = (*FLOW_KEYS, *SUPERPOSED_KEYS, *SHAPING, *BESIDE, *TURBULENCE_KEYS, "wind_ratio")
FAULTS = {
    "position_wander": "wander",
    "position_wander_time": "wander_time",
    "outliers": "outliers",
    "outlier_size": "outlier_size",
    "jumps": "jumps",
    "jump_size": "jump_size",
    "gaps": "gaps",
    "gap_duration": "gap_duration",
    "lost_samples": "lost_samples",
}  # key: the field of `LogFaults` that it is
COUNTS = ("jumps", "gaps")
MOST_TOGETHER = 64.0  # flights that are estimated as one
REQUIRED = ("duration", "sample_rate")
DRAG_KEYS = ("response_time", "drag")  # at least one
# A key, and the key without which it has no meaning.
NEEDS = {
    "drift_ratio": "drift_direction",
    "turbulence_ratio": "turbulence_length",
    "wind_ratio": "wind_direction",
    "second_heading": "second_scale_ratio",
    "thrust_turn": "thrust_period",
    "thrust_noise": "thrust_turn",
}
RATIOS = (0.01, 100.0)
# Words that people write for a key.
SYNONYMS = {
    "dropouts": "lost_samples",
    "dropout": "lost_samples",
    "noise": "velocity_noise",
    "speed": "mean_velocity",
    "tau": "response_time",
    "thrust": "thrust_acceleration",
    "rate": "sample_rate",
    "frequency": "sample_rate",
}


@dataclass(frozen=True)
class Quantity:
    """A key of [flights]: the streams it fills (two: a pair [x, y]) and its range.

    open_end: whether least and most are excluded themselves.
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
    **_of("process_noise", "position_noise", "velocity_noise", RATIO_KEYS[1], "thrust_turn",
          "thrust_noise", least=0.0),
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
    **_of("outliers", "lost_samples", least=0.0, most=1.0),
    **_of("time_jitter", least=0.0, most=0.49),
    "thrust_acceleration": Quantity(("thrust_x", "thrust_y")),
    "initial_position": Quantity(("position_x", "position_y")),
    "initial_velocity": Quantity(("velocity_x", "velocity_y")),
    "wind": Quantity(("wind_x", "wind_y")),
    "offset": Quantity(("offset_x", "offset_y")),
    "measurement_noise": Quantity(("velocity_noise", "position_noise"), 0.0),
}  # fmt: skip
RULES = ("linspace", "uniform", "loguniform", "choice")


@dataclass(frozen=True)
class Entry:
    """A quantity of a flight: `rule` is "constant" or one of `RULES`, `values` its numbers."""

    rule: str
    values: tuple[float, ...]

    def at(self, flight: int, count: int, stream: np.random.SeedSequence) -> float:
        """The value of flight number `flight` of `count`; `stream` decides a random one.

        One uniform number u in [0, 1) is drawn whatever the rule, so levels of a sweep that
        differ in their range only share it (common random numbers).
        """
        if self.rule == "constant":
            return self.values[0]
        if self.rule == "linspace":
            first, last = self.values
            return first + (last - first) * flight / max(count - 1, 1)
        share = float(np.random.default_rng(stream).random())
        if self.rule == "choice":
            return self.values[int(share * len(self.values))]
        low, high = self.values
        if self.rule == "loguniform":
            return math.exp(math.log(low) + share * (math.log(high) - math.log(low)))
        return low + share * (high - low)


def read_entry(value: object, quantity: Quantity, place: Place) -> Entry:
    """An entry from its TOML value; every number in it lies in the range of the quantity."""
    entry = _rule(value, place) if isinstance(value, dict) else _constant(value, place)
    least, most, open_end = quantity.least, quantity.most, quantity.open_end
    for item in entry.values:
        if least is not None and most is not None:
            within = least < item < most if open_end else least <= item <= most
            if not within:
                raise place.error(f"must lie between {least:g} and {most:g}, not {item:g}")
        if least is not None and (item <= least if open_end else item < least):
            bound = "above" if open_end else "at least"
            raise place.error(f"must be {bound} {least:g}, not {item:g}")
    return entry


def _constant(value: object, place: Place) -> Entry:
    if isinstance(value, list | str):
        rules = ", ".join(RULES)
        raise place.error(f"must be a number or a table with one of {rules}, not {shown(value)}")
    return Entry("constant", (number(value, place),))


def _rule(value: dict[str, object], place: Place) -> Entry:
    only(value, RULES, place)
    if len(value) != 1:
        raise place.error(f"must hold exactly one of {', '.join(RULES)}, not {shown(value)}")
    ((rule, listed),) = value.items()
    values = tuple(number(item, place) for item in items(listed, place))
    if rule == "choice":
        return Entry(rule, values)
    if len(values) != 2:
        raise place.error(f"{rule} takes two numbers [a, b], not {len(values)}")
    low, high = values
    if rule != "linspace" and low > high:
        raise place.error(f"{rule} range [{low:g}, {high:g}] is empty: write the smaller first")
    if rule == "loguniform" and low <= 0.0:
        raise place.error(f"loguniform range must be above 0, not from {low:g}")
    return Entry(rule, values)
