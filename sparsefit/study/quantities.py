"""The quantities of a simulated flight: keys of [flights] in a study, and options of `simulate`.

One row says the unit, the range, the sentence and the random streams of a quantity. Every random
quantity has its own stream, by its place here: a row at the end changes no other's draws, and a
quantity that went leaves its streams behind.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

from sparsefit.errors import suggestion
from sparsefit.study.schema import ANY, NOT_NEGATIVE, POSITIVE, SHARE, Range, key

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
    """A quantity: its name, unit, range and sentence.

    streams: the random numbers that it fills, two of a pair [x, y]; needs: the quantities without
    which it has no meaning; of_flow: whether still air leaves it out; shapes: whether cells with it
    are other than squares along the axes that stand; fault: the field of `LogFaults` that it is.
    """

    name: str
    unit: str
    range: Range
    sentence: str
    streams: tuple[str, ...] = ()
    needs: tuple[str, ...] = ()
    of_flow: bool = False
    shapes: bool = False
    fault: str = ""


def _q(name: str, unit: str, range: Range, sentence: str, *needs: str, axes: str = "",
       of_flow: bool = False, shapes: bool = False, fault: str = "") -> Quantity:  # fmt: skip
    streams = (f"{axes}_x", f"{axes}_y") if axes else (name,)
    return Quantity(name, unit, range, sentence, streams, needs, of_flow or shapes, shapes, fault)


def _without_key(*streams: str) -> Quantity:
    return Quantity("", "", ANY, "", streams)


_ROWS = (
    _q("mean_velocity", "m/s", POSITIVE, "U0. Give two of this, `length_scale` and `timescale`.",
       of_flow=True),
    _q("length_scale", "m", POSITIVE, "Length scale L_w, the side of a cell.", of_flow=True),
    _q("timescale", "s", POSITIVE, "Timescale tau_w = L_w/U0.", of_flow=True),
    _q("response_time", "s", POSITIVE, "Response time tau of linear drag; `drag` may replace it."),
    _q("thrust_acceleration", "m/s²", ANY, "Constant thrust acceleration.", axes="thrust"),
    _q("initial_position", "m", ANY, "At t = 0; without it, random in a cell.", axes="position"),
    _q("initial_velocity", "m/s", ANY, "At t = 0; without it, zero.", axes="velocity"),
    _q("duration", "s", POSITIVE, "Duration of a flight. Needed."),
    _q("sample_rate", "Hz", POSITIVE, "Samples per second. Needed."),
    _q("process_noise", "m/s²", NOT_NEGATIVE,
       "Standard deviation of each component of the random acceleration, constant over a sample."),
    _q("position_noise", "m", NOT_NEGATIVE, "Standard deviation of the noise of each coordinate."),
    _q("velocity_noise", "m/s", NOT_NEGATIVE, "Standard deviation of the noise of each component."),
    _q("wind", "m/s", ANY, "Uniform wind.", axes="wind"),
    _q("second_scale_ratio", "", RATIO, "Length scale of a second cellular flow over the first's.",
       "second_velocity_ratio", of_flow=True),
    _q("second_velocity_ratio", "", RATIO, "Mean velocity of the second flow over the first's.",
       "second_scale_ratio", of_flow=True),
    _without_key("third_scale_ratio", "third_velocity_ratio"),
    _q("believed_response_time_ratio", "", POSITIVE, "Assumed response time over the true one."),
    _q("believed_thrust_ratio", "", NOT_NEGATIVE, "Assumed thrust over the true one."),
    _q("heading", "rad", ANY, "Counter-clockwise rotation of the cells.", shapes=True),
    _q("aspect", "", RATIO, "Side of a cell along y over that along x.", shapes=True),
    _q("angle", "rad", Range(above=0.0, below=math.pi),
       "Angle between the two families of cell walls; pi/2: rectangles.", shapes=True),
    _q("offset", "m", ANY, "Position of a corner of a cell at t = 0.", axes="offset", shapes=True),
    _q("drift_ratio", "", NOT_NEGATIVE, "Drift speed of the pattern over U0.",
       "drift_direction", shapes=True),
    _q("drift_direction", "rad", ANY, "Direction of the drift.", of_flow=True),
    _q("swell", "", Range(least=0.0, most=0.99), "Relative amplitude of U0's swell.", shapes=True),
    _q("swell_period", "s", POSITIVE, "Its period; without it, the duration.", of_flow=True),
    _q("swell_phase", "rad", ANY, "Phase of the swell at t = 0.", of_flow=True),
    _q("second_heading", "rad", ANY, "Heading of the second flow; without it, that of the first.",
       "second_scale_ratio", shapes=True),
    _q("wind_ratio", "", NOT_NEGATIVE, "Speed of the wind over U0.", "wind_direction",
       of_flow=True),
    _q("wind_direction", "rad", ANY, "Direction towards which the wind blows."),
    _q("turbulence_ratio", "", NOT_NEGATIVE, "Rms of each component of the turbulence over U0.",
       "turbulence_length", of_flow=True),
    _q("turbulence_length", "m", POSITIVE, "Integral length of the turbulence.", of_flow=True),
    _q("turbulence_memory", "s", POSITIVE, "Lifetime of an eddy; without it, frozen turbulence.",
       of_flow=True),
    _without_key(TURBULENCE_FIELD),
    _q("time_jitter", "", Range(least=0.0, most=0.49), "Largest shift of a sample over the step."),
    _q("position_wander", "m", NOT_NEGATIVE, "Rms of a slowly varying error of each coordinate.",
       fault="wander"),
    _q("position_wander_time", "s", POSITIVE, "Correlation time of `position_wander`.",
       fault="wander_time"),
    _q("outliers", "", SHARE, "Share of samples whose velocity is an outlier.", fault="outliers"),
    _q("outlier_size", "m/s", NOT_NEGATIVE, "Size of an outlier, in a random direction.",
       fault="outlier_size"),
    _q("jumps", "", NOT_NEGATIVE, "Number of lasting jumps of the position.", fault="jumps"),
    _q("jump_size", "m", NOT_NEGATIVE, "Size of a jump of the position.", fault="jump_size"),
    _q("gaps", "", NOT_NEGATIVE, "Number of gaps in the log.", fault="gaps"),
    _q("gap_duration", "s", NOT_NEGATIVE, "Longest duration of a gap.", fault="gap_duration"),
    _q("drag", "1/m", POSITIVE, "Coefficient c of quadratic drag."),
    _q("thrust_turn", "m/s²", NOT_NEGATIVE,
       "Size of a rotating thrust beside the constant one, both logged.", "thrust_period"),
    _q("thrust_period", "s", POSITIVE, "Period of the rotating thrust."),
    _q("thrust_phase", "rad", ANY, "Direction of the rotating thrust at t = 0."),
    _q("thrust_noise", "m/s²", NOT_NEGATIVE, "Standard deviation of its noise in the log.",
       "thrust_turn"),
    _q("believed_drag_ratio", "", POSITIVE, "Assumed drag over the true one."),
    _q("believed_response_time", "s", POSITIVE, "Assumed tau in place of the true drag law."),
    _without_key("believed_drag"),
    _q("together", "flights", Range(least=1.0, most=64.0),
       "Number of flights through one flow, each from its own start, that are estimated as one."),
    _q("lost_samples", "", SHARE, "Share of samples missing from the log, at random.",
       fault="lost_samples"),
)  # fmt: skip
STREAMS = tuple(stream for row in _ROWS for stream in row.streams)
QUANTITIES = {row.name: row for row in _ROWS if row.name}
QUANTITIES["measurement_noise"] = Quantity(
    "measurement_noise", "m/s, m", NOT_NEGATIVE,
    "`[velocity_noise, position_noise]` in one key, so that a sweep moves both.",
    ("velocity_noise", "position_noise"),
)  # fmt: skip


@dataclass(frozen=True)
class FlightWords:
    """The keys of [flights] that are words."""

    flow: Literal["cellular", "none", "turbulence"] = key(
        "The flow: `cellular`; `none`, still air; or `turbulence` without cells.", "cellular"
    )
    turbulence_spectrum: Literal["dryden", "von-karman"] = key("Of the turbulence.", "dryden")
    thrust_log: Literal["measured", "none"] = key(
        "Log of a rotating thrust, or `none`: its constant part alone is known.", "measured"
    )


def nearest(name: str, names: Iterable[str]) -> str:
    """The nearest key of [flights] for a message, and not all of the sixty."""
    if name in SYNONYMS:
        return f': did you mean "{SYNONYMS[name]}"?'
    near = suggestion(name, names)
    return near if "did you mean" in near else ": `sparsefit simulate --help` lists them"
