"""What keeps flights from telling any flow: still air, two motions in one log, steps too long."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from sparsefit.derivative import Samples
from sparsefit.estimator.doubt import Doubt, Verdict
from sparsefit.modes.space import SearchSpace

CALM = 1e-6  # of the vehicle's speed: the smoothing's own error reaches 1e-9
RESOLVED = 3.0  # samples per length scale: fewer, and no polynomial follows the flow between them
FAR_APART = 10.0  # motions: beyond it a share says no more


def still(space: SearchSpace, flights: Sequence[Samples]) -> Verdict | None:
    """Whether the air moved the vehicles no more than smoothing errs."""
    speed = max(float(np.abs(samples.velocity).max()) for samples in flights)
    rest, scale = space.empty.rest, space.rows.scale
    left = rest if scale is None else rest / scale[:, None]
    if float(np.abs(left).max()) > CALM * speed:
        return None
    return Verdict.against(Doubt.STILL_AIR, "no cellular flow detected: the air is still")


def of_any(flights: Sequence[Samples], rule: Callable[[Samples], Verdict | None]) -> Verdict | None:
    """The first flight's verdict by a rule; of several flights its number comes before it."""
    for number, samples in enumerate(flights, 1):
        verdict = rule(samples)
        if verdict is not None and len(flights) > 1:
            return replace(verdict, reason=f"flight {number}: {verdict.reason}")
        if verdict is not None:
            return verdict
    return None


def disagreeing(flights: Sequence[Samples]) -> Verdict | None:
    """Whether a log holds two motions, one of its positions and one of its velocities."""
    return of_any(flights, _disagreement)


def _disagreement(samples: Samples) -> Verdict | None:
    """Whether position and velocity tell two motions: of these no one has flown."""
    agreement = samples.agreement
    if agreement is None or not agreement.broken:
        return None
    return Verdict.against(
        Doubt.DISAGREEMENT,
        "the logged velocity is not that of the logged position: they are "
        f"{_as_share(agreement.apart)} the motion apart; check units, axes and time stamps",
    )


def _as_share(apart: float) -> str:
    """Of a motion that hardly is (a velocity of zeros) every share is huge and says nothing."""
    return f"{100 * apart:.0f} % of" if apart < FAR_APART else f"more than {FAR_APART:g} times"


def too_coarse(samples: Samples, least: float, lower: float) -> Verdict | None:
    """Whether steps are too long for a length scale [m]; lower: the bound of the search."""
    steps = np.diff(samples.time)
    if not len(steps):
        return None
    step = float(np.median(steps))
    speed = math.sqrt(float(np.mean(np.sum(samples.velocity**2, axis=1))))
    moved = speed * step
    if moved * RESOLVED <= least or 2 * moved <= lower:
        return None
    return Verdict.against(
        Doubt.UNDERSAMPLED,
        f"the flight moves {moved:.3g} m from sample to sample, too far to follow a length scale "
        f"of {least:.3g} m; sample at {RESOLVED * speed / least:.3g} Hz or more",
    )
