"""Standard errors of an estimate, and the goodness of fit of its model.

Innovations of the right model, each over its standard deviation, are white with variance 1.
Bartlett's test (1954) compares the cumulative periodogram of each channel with a straight line: its
largest distance has Kolmogorov's distribution. Levels are fitted, so that the variance is 1 even of
a wrong model; the spectrum shows the misfit.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sparsefit.likelihood.causes import Suspect
from sparsefit.likelihood.diagnosis import Diagnosis
from sparsefit.likelihood.posterior import Posterior
from sparsefit.likelihood.trellis import Leg

NORMAL_95 = 1.959963984540054


class Uncertainty(dict[str, Any]):
    """Standard errors by the names of quantities, and the intervals that hold 95 % of truths.

    A quantity NAME has NAME and NAME_interval, a pair (x, y) NAME and NAME_intervals, each in its
    own unit, all of them attributes as well; inf where a flight does not determine a quantity.
    """

    @classmethod
    def of(cls, values: Mapping[str, Any], errors: Mapping[str, Any]) -> Uncertainty:
        """From values and standard errors by name, each a number or a pair."""
        record = cls()
        for name, value in values.items():
            record[name] = errors[name]
            if isinstance(value, tuple):
                ends = tuple(map(interval, value, errors[name]))
                record[f"{name.replace('scales', 'scale')}_intervals"] = ends
            else:
                record[f"{name}_interval"] = interval(value, errors[name])
        return record

    @classmethod
    def of_flow(cls, values: tuple[float, float, float], errors: Sequence[float]) -> Uncertainty:
        """Of (U0, L, tau_w) from their standard errors; one that is not finite is inf."""
        sure = [error if math.isfinite(error) else math.inf for error in errors]
        flow = ("mean_velocity", "length_scale", "timescale")
        return cls.of(dict(zip(flow, values, strict=True)), dict(zip(flow, sure, strict=True)))

    def __getattr__(self, name: str) -> Any:
        """An entry as an attribute."""
        try:
            return self[name]
        except KeyError:
            raise AttributeError(f"no uncertainty of {name!r}") from None


def interval(value: float, error: float) -> tuple[float, float]:
    """The 95 % interval of a value with a standard error."""
    return value - NORMAL_95 * error, value + NORMAL_95 * error


@dataclass(frozen=True)
class Goodness:
    """The goodness of fit of a model; NaN where it was not computed.

    `r_squared` is the share of the variance of the air's velocity along the track, within the band
    of the flow, that the flow explains; process noise and turbulence are the rest.
    """

    r_squared: float
    #: the probability that white innovations show as much structure in time: below 0.01 there is
    #: more than noise
    whiteness: float = math.nan
    likelihood_ratio: float = math.nan  #: 2 ln(likelihood ratio) of turbulence against none
    turbulence: float = math.nan  #: along the path, rms of a component about its mean [m/s]
    turbulence_share: float = math.nan  #: of the mean velocity U0 of the fastest flow
    suspect: Suspect | None = None  #: the cause of the largest gain, if any was found
    flights: tuple[Goodness, ...] = ()  #: of each of several

    @classmethod
    def of(cls, posterior: Posterior, diagnosis: Diagnosis) -> Goodness:
        """From a posterior and its diagnosis."""
        speed = posterior.model.pattern.mean_velocity
        gusts, kicks = np.array([_disturbances(leg) for leg in posterior.legs]).T
        flow, every = speed**2 / 4, posterior.whiteness  # mean square of a component of cells
        shares = (flow / (flow + gusts + kicks)).tolist()
        each = [cls(share, white) for share, white in zip(shares, every, strict=True)]
        turbulence = float(np.mean(gusts))
        return cls(
            flow / (flow + turbulence + float(np.mean(kicks))),
            1 - (1 - min(every)) ** len(every),
            diagnosis.turbulence_gain,
            math.sqrt(turbulence),
            math.sqrt(turbulence) / speed,
            diagnosis.suspects[0] if diagnosis.suspects else None,
            flights=tuple(each) if len(each) > 1 else (),
        )


def _disturbances(leg: Leg) -> tuple[float, float]:
    """The mean squares [m^2/s^2] of turbulence and of process noise, within the flight's band.

    With a = beta T, a process of rate beta varies within a time T by 1 - 2/a + 2 (1 - exp(-a))/a^2
    of its variance; the rest is a wind.
    """
    model, pattern = leg.model, leg.model.pattern
    timescale = pattern.length_scale / pattern.mean_velocity
    tau = min(model.values["response_time"], timescale)
    kicks = (model.values["acceleration"] * tau) ** 2 / (2 * timescale)
    gusts = 0.0
    for process in model.processes:
        if process.name == "turbulence":
            times = process.rate * float(leg.time[-1] - leg.time[0])
            gusts = process.level**2 * (1.0 - 2.0 / times + 2.0 * -math.expm1(-times) / times**2)
    return gusts, kicks


@dataclass(frozen=True)
class Constancy:
    """The rate of change of the mean velocity, to first order; several flows share it."""

    rate: float  #: dU0/dt [m/s^2], 0 of a flow that is constant
    standard_error: float  #: of it [m/s^2]
    interval: tuple[float, float]  #: of 95 % [m/s^2]
    p_value: float  #: of a constant flow, two-sided

    @classmethod
    def of(cls, growth: float, error: float, mean_velocity: float) -> Constancy | None:
        """From the relative rate of growth [1/s], its standard error, and U0 [m/s]."""
        rate, spread = growth * mean_velocity, error * mean_velocity
        if not (math.isfinite(rate) and 0.0 < spread < math.inf):
            return None
        chance = math.erfc(abs(rate / spread) / math.sqrt(2.0))
        return cls(rate, spread, interval(rate, spread), chance)
