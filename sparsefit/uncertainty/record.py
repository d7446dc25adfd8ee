"""The record: standard errors and intervals of U0, L and tau_w."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

NORMAL_95 = 1.959963984540054
NAMES = {
    "mean_velocity": "the mean velocity",
    "length_scale": "the length scale",
    "timescale": "the timescale",
}


@dataclass(frozen=True)
class Uncertainty:
    """Standard errors [m/s], [m], [s], and intervals that hold the truth in 95 % of flights.

    Where a flight does not tell a quantity its standard error is inf, and its interval infinite.
    freedom: the degrees of freedom of the standard errors, infinite where these are certain.
    """

    mean_velocity: float
    length_scale: float
    timescale: float
    mean_velocity_interval: tuple[float, float]
    length_scale_interval: tuple[float, float]
    timescale_interval: tuple[float, float]
    freedom: tuple[float, float, float] = (math.inf, math.inf, math.inf)

    def widest(self, values: tuple[float, float, float]) -> tuple[str, float]:
        """Which of (U0, L, tau_w) is known worst, and the half-width of its interval over it."""
        known = zip(values, NAMES, self.freedom, strict=True)
        shares = [reach(free) * getattr(self, name) / abs(value) for value, name, free in known]
        worst = max(range(3), key=lambda i: shares[i])
        return tuple(NAMES)[worst], shares[worst]

    def wide(self, values: tuple[float, float, float], precision: float) -> str:
        """Which of (U0, L, tau_w) has an interval of a half-width beyond a share of it, in words.

        Empty if none has.
        """
        name, share = self.widest(values)
        if share <= precision:
            return ""
        if not math.isfinite(share):
            return f"the flight does not tell {NAMES[name]} at all; fly across more cells"
        known = f"{NAMES[name]} is known only to +-{100 * share:.0f} %"
        return f"{known}; fly longer, across more cells, or ask for less (readout precision)"

    @classmethod
    def around(
        cls,
        values: Sequence[float],
        errors: Sequence[float],
        freedom: Sequence[float] = (math.inf, math.inf, math.inf),
    ) -> "Uncertainty":
        """Intervals around (U0, L, tau_w), of standard errors with degrees of freedom."""
        sure = [error if math.isfinite(error) else math.inf for error in errors]
        ends = [interval(*one) for one in zip(values, sure, freedom, strict=True)]
        first, second, third = freedom
        known = sure[0], sure[1], sure[2], ends[0], ends[1], ends[2]
        return cls(*known, (first, second, third))


def interval(value: float, error: float, freedom: float = math.inf) -> tuple[float, float]:
    """The 95 % interval of a value with a standard error of so many degrees of freedom."""
    half = reach(freedom) * error
    return value - half, value + half


def reach(freedom: float) -> float:
    """The standard errors in half a 95 % interval (Student's t), 1.96 where these are certain."""
    if math.isinf(freedom):
        return NORMAL_95
    from scipy.special import stdtrit

    return float(stdtrit(freedom, 0.975))
