"""The record of how sure an estimated vehicle and wind are."""

import math
from dataclasses import dataclass

from sparsefit.library.nuisance import NUMBERS
from sparsefit.uncertainty.record import interval

Interval = tuple[float, float]


@dataclass(frozen=True)
class VehicleUncertainty:
    """Standard errors and 95 % intervals of tau [s], a [m/s^2], wind [m/s], c [1/m] and s.

    NaN and None where a quantity was not estimated; pairs are (x, y).
    """

    response_time: float = math.nan
    response_time_interval: Interval | None = None
    thrust_acceleration: tuple[float, float] | None = None
    thrust_acceleration_intervals: tuple[Interval, Interval] | None = None
    wind: tuple[float, float] | None = None
    wind_intervals: tuple[Interval, Interval] | None = None
    drag: float = math.nan
    drag_interval: Interval | None = None
    thrust_scale: float = math.nan
    thrust_scale_interval: Interval | None = None

    @classmethod
    def around(
        cls,
        values: dict[str, tuple[float, ...]],
        spreads: dict[str, tuple[float, ...]],
        freedom: dict[str, tuple[float, ...]] | None = None,
    ) -> "VehicleUncertainty":
        """Intervals of numbers (1) and pairs, by name, from standard errors.

        freedom: the degrees of freedom of each; None where the standard errors are certain.
        """
        parts: dict[str, object] = {}
        for name, own in values.items():
            free = freedom[name] if freedom else (math.inf,) * len(own)
            ends = tuple(interval(*one) for one in zip(own, spreads[name], free, strict=True))
            alone = name in NUMBERS
            parts[name] = spreads[name][0] if alone else spreads[name]
            parts[f"{name}_interval" if alone else f"{name}_intervals"] = ends[0] if alone else ends
        return cls(**parts)  # type: ignore[arg-type]
