"""The record: standard errors and intervals of U0, L and tau_w."""

import math
from dataclasses import dataclass

NORMAL_95 = 1.959963984540054
WIDE = 0.03  # of a value, the half-width of its interval: at it, 5 % off is 1 in 1000 likely
NAMES = {
    "mean_velocity": "the mean velocity",
    "length_scale": "the length scale",
    "timescale": "the timescale",
}


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

    def widest(self, values: tuple[float, float, float]) -> tuple[str, float]:
        """Which of (U0, L, tau_w) is known worst, and the half-width of its interval over it."""
        errors = [getattr(self, name) for name in NAMES]
        shares = [NORMAL_95 * e / abs(v) for v, e in zip(values, errors, strict=True)]
        worst = max(range(3), key=lambda i: shares[i])
        return tuple(NAMES)[worst], shares[worst]

    def wide(self, values: tuple[float, float, float]) -> str:
        """Which of (U0, L, tau_w) is known only to more than WIDE, in words; empty if none is."""
        name, share = self.widest(values)
        if share <= WIDE:
            return ""
        if not math.isfinite(share):
            return f"the flight does not tell {NAMES[name]} at all; fly across more cells"
        known = f"{NAMES[name]} is known only to +-{100 * share:.0f} %"
        return f"{known}; fly longer, across more cells"

    @classmethod
    def around(cls, values: list[float], errors: list[float]) -> "Uncertainty":
        """Intervals of +- 1.96 standard errors around (U0, L, tau_w)."""
        sure = [error if math.isfinite(error) else math.inf for error in errors]
        ends = [
            (value - NORMAL_95 * error, value + NORMAL_95 * error)
            for value, error in zip(values, sure, strict=True)
        ]
        return cls(sure[0], sure[1], sure[2], ends[0], ends[1], ends[2])
