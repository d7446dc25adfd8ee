"""The record: standard errors and intervals of U0, L and tau_w."""

import math
from dataclasses import dataclass

NORMAL_95 = 1.959963984540054
WIDE = 0.03  # of a value, the half-width of its interval: at it, 5 % off is 1 in 1000 likely
NAMES = ("the mean velocity", "the length scale", "the timescale")


@dataclass(frozen=True)
class Uncertainty:
    """Standard errors [m/s], [m], [s], and intervals that hold the truth in 95 % of flights.

    Where a flight does not tell a quantity its standard error is inf, and its interval infinite.
    """

    mean_velocity: float
    length_scale: float
    timescale: float
    mean_velocity_interval: tuple[float, float]
    length_scale_interval: tuple[float, float]
    timescale_interval: tuple[float, float]

    def wide(self, values: tuple[float, float, float]) -> str:
        """Which of (U0, L, tau_w) is known only to more than WIDE, in words; empty if none is."""
        spreads = (self.mean_velocity, self.length_scale, self.timescale)
        shares = [NORMAL_95 * s / abs(v) for v, s in zip(values, spreads, strict=True)]
        worst = max(range(3), key=lambda i: shares[i])
        if shares[worst] <= WIDE:
            return ""
        if not math.isfinite(shares[worst]):
            return f"the flight does not tell {NAMES[worst]} at all; fly across more cells"
        share = f"+-{100 * shares[worst]:.0f} %"
        return f"{NAMES[worst]} is known only to {share}; fly longer, across more cells"

    @classmethod
    def around(cls, values: list[float], spreads: list[float]) -> "Uncertainty":
        """Intervals of +- 1.96 standard errors around (U0, L, tau_w)."""
        sure = [spread if math.isfinite(spread) else math.inf for spread in spreads]
        ends = [
            (value - NORMAL_95 * spread, value + NORMAL_95 * spread)
            for value, spread in zip(values, sure, strict=True)
        ]
        return cls(sure[0], sure[1], sure[2], ends[0], ends[1], ends[2])
