"""Causes of a misfit: departures of vehicle, air, instruments and flow from their model."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Cause:
    """A departure from the assumed model."""

    name: str  # in reports
    elements: tuple[str, ...]  # of the model: estimated, or varying about their values
    words: str = ""  # a template for `Suspect.words`; empty: freed only on request
    unit: str = ""  # of its size in an estimate
    wanders: bool = False  # whether the elements are random processes, not constants
    answered: bool = False  # whether the answer may contain it without being a misfit
    of_flow: bool = False  # whether it concerns the flow, not the vehicle or an instrument


LOADS = {  # by the thrust that explains a flight over that which is given
    3.2808: "; position and velocity may both be in feet",
    1.0 / 3.2808: "; the thrust may be in feet/s^2",
    9.80665: "; the thrust may be in g",
}
SAME_UNIT = 0.03  # the largest relative distance of a ratio from that of a unit
WIND, BIAS, GAIN = ("wind_x", "wind_y"), ("position_bias_x", "position_bias_y"), ("gain",)
BELIEVED = "than it is believed"
OPPOSITES = {"more": "less", "longer": "shorter", "large": "small", "grow": "decay", "lag": "lead"}
FREEDOMS: dict[str, Cause] = {
    "response_time": Cause("response-time", ("response_time",),
                           f"the response time seems {{size}} s {{longer}} {BELIEVED}", "s"),
    "thrust_scale": Cause("thrust", ("thrust_scale",),
                          f"the thrust seems {{percent}} % {{more}} {BELIEVED}"),
    "thrust_rotation": Cause("thrust-turned", ("thrust_rotation",),
                             "the thrust seems turned, by {degrees} degrees", "rad"),
    "thrust_acceleration": Cause("thrust", ("thrust_bias_x", "thrust_bias_y"), "", "m/s^2"),
    "wind": Cause("wind", WIND, "there seems to be a wind of ({x}, {y}) m/s, or another thrust",
                  "m/s"),
    "wind_growth": Cause("growing-wind", ("wind_growth_x", "wind_growth_y"), "there seems to be a "
                         "wind that grows by ({x}, {y}) m/s in a second", "m/s^2"),
    "drag": Cause("drag", ("quadratic_drag",),
                  f"the drag seems {{more}} quadratic {BELIEVED}, by {{size}} s/m", "1/m"),
    "mass": Cause("mass", ("mass_rate",),
                  "the mass seems to change, by {signed} % in a second", "1/s"),
    "lag": Cause("lag", ("lag",), "the drag seems to {lag} the wind, by {milli} ms", "s"),
    "growth": Cause("decay", ("growth",), "the mean velocity seems to {grow}, by {percent} % "
                    "in a second", "1/s", of_flow=True),
    "velocity_scale": Cause("velocity-scale", ("velocity_scale",),
                            "the logged velocity seems {percent} % too {large}"),
    "position_scale": Cause("position-scale", ("position_scale",),
                            "the logged position seems {percent} % too {large}"),
    "velocity_bias": Cause("velocity-bias", ("velocity_bias_x", "velocity_bias_y"),
                           "the logged velocity seems off by ({x}, {y}) m/s", "m/s"),
    "latency": Cause("latency", ("latency",),
                     "the logged {late} seems late, by {milli} ms", "s"),
    "velocity_rotation": Cause("rotation", ("velocity_rotation",), "the frame of the velocity "
                               "seems turned, by {degrees} degrees", "rad"),
    "turbulence": Cause("turbulence", WIND, wanders=True, answered=True),
    "wander": Cause("position-noise", BIAS, wanders=True, answered=True),
    "swell": Cause("swelling", GAIN, "the mean velocity seems to change in time, by "
                   "{percent} % rms", wanders=True, of_flow=True),
}  # fmt: skip
"""Causes by the name under which they are freed."""
SHAPES = {
    "drift": Cause(
        "drift", ("frequency_1", "frequency_2"), "the cells seem to drift", of_flow=True
    ),
    "turn": Cause("turn", ("kx_1", "ky_1", "kx_2", "ky_2"), "the cells seem turned", of_flow=True),
    "stretch": Cause("stretch", (), "the cells seem stretched", of_flow=True),
}
"""Causes that are freer shapes, where these may not be the answer."""
ALIKE = (  # sets of nearly collinear causes: one of each may be free
    {"wind", "thrust_acceleration", "thrust_scale", "thrust_rotation"},
    {"velocity_scale", "position_scale"},
)


@dataclass(frozen=True)
class Suspect:
    """A cause of a misfit and its size."""

    cause: str  #: its name
    size: tuple[float, ...]  #: the change of each freed element, in its own unit, or a level
    p_value: float  #: of a gain in likelihood as large by chance, over all causes tested
    share: float  #: 2 ln(likelihood ratio) of the cause against none
    free: str = ""  #: the name under which it is freed
    flight: int = 0  #: of several flights the number of the one concerned, from 1; else 0

    @property
    def remedy(self) -> str:
        """The names to free, as words."""
        return f'free it: free = ["{self.free}"] (--free {self.free}), or free = "auto"'

    @property
    def of_flow(self) -> bool:
        """Whether it concerns the flow itself."""
        return self.free not in FREEDOMS or FREEDOMS[self.free].of_flow

    @property
    def words(self) -> str:
        """The cause and its size as a sentence."""
        template = next(own.words for own in _CAUSES if own.name == self.cause and own.words)
        x, y = (*self.size, math.nan, math.nan)[:2]
        numbers = {"x": x, "y": y, "size": abs(x), "percent": 100 * abs(x), "signed": 100 * x}
        numbers |= {"milli": 1e3 * abs(x), "degrees": math.degrees(x)}
        rounded = {name: two_digits(number) for name, number in numbers.items()}
        chosen = {word: word if x > 0 else other for word, other in OPPOSITES.items()}
        chosen["late"] = "position" if x > 0 else "velocity"
        return template.format(**rounded, **chosen)

    def unit(self, response_time: float, thrust: complex) -> str:
        """The words for a thrust, or a wind along it, that is off by the ratio of two units."""
        ratio = 0.0
        if self.free == "thrust_scale":
            ratio = 1.0 + self.size[0]
        elif self.free == "wind" and thrust:  # the air's pull is the wind over tau
            turned = complex(*self.size) / (response_time * thrust)
            ratio = 1.0 + turned.real if abs(turned.imag) < SAME_UNIT * abs(turned) else 0.0
        return unit_of(ratio, LOADS)


def unit_of(ratio: float, units: dict[float, str]) -> str:
    """The words for the unit of a ratio; empty where none is near."""
    near = min(units, key=lambda own: abs(ratio / own - 1.0))
    return units[near] if abs(ratio / near - 1.0) < SAME_UNIT else ""


def two_digits(number: float) -> str:
    """A number to two significant digits, without an exponent below a million."""
    return f"{float(f'{number:.2g}'):g}"


_CAUSES = (*FREEDOMS.values(), *SHAPES.values())
