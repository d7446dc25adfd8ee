"""How sure an estimate is: standard errors and intervals of U0, L and tau_w."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Uncertainty:
    """Standard errors [m/s], [m], [s], and intervals that hold the truth in 95 % of flights.

    They cover what noise does, not what is systematic: the truncation of a forward difference,
    the attenuation by smoothing or by noise of the position.
    """

    mean_velocity: float
    length_scale: float
    timescale: float
    mean_velocity_interval: tuple[float, float]
    length_scale_interval: tuple[float, float]
    timescale_interval: tuple[float, float]
