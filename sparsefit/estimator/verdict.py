"""Whether a flight tells its flow's length scale, and why not, as a pilot would say it."""

import math

import numpy as np

from sparsefit.derivative import Samples
from sparsefit.modes.refine import FALSE_ALARM, Refinement
from sparsefit.uncertainty import LAGS, Assessment

NEEDED = 2 * (LAGS + 1)  # values of Phi: of fewer, nothing is known of their errors
RESOLVED = 3.0  # samples per length scale: fewer, and no polynomial follows the flow between them


def why_not(
    best: Refinement,
    known: Assessment | None,
    samples: Samples,
    lower: float,
    *,
    calm: bool = False,
) -> str:
    """The reason not to believe a refined scale, or "" if there is none.

    best: the refinement, known: its assessment, lower: the least scale searched [m]; calm: Phi is
    nothing beside the vehicle's own velocity.
    """
    scale, extent = best.length_scale, float(np.ptp(samples.position, axis=0).max())
    if calm:
        return "no cellular flow detected: the air is still"
    if 2 * best.samples < NEEDED:
        return (
            f"{best.samples} samples are too few for the 17 unknowns of a length scale; "
            "fly longer, or sample faster"
        )
    coarse = _coarse(samples, scale, lower, sure=best.identifiable)
    if coarse:
        return coarse
    if not best.detected:
        return (
            "no cellular flow detected: no length scale explains more than a uniform wind does, "
            f"at {1 / FALSE_ALARM:.0f} to 1 against a false alarm"
        )
    if best.at_bound:
        return (
            f"the best length scale is at the edge of the search, {scale:.3g} m; "
            "widen the grid's bounds"
        )
    if not best.identifiable:
        short = f", less than one cell of {scale:.3g} m," if extent < scale else ""
        return (
            f"cannot tell {scale:.3g} m from {best.rival_length_scale:.3g} m: the flight covers "
            f"{extent:.3g} m{short} or too straight a line; fly farther, or turn"
        ).replace(" m or", " m, or")
    return known.wide if known else ""


def _coarse(samples: Samples, scale: float, lower: float, *, sure: bool) -> str:
    """Whether the flow changes too much from sample to sample, in words; "" if it does not.

    A scale that is found must be resolved; where none is, the least one that was searched.
    """
    steps = np.diff(samples.time)
    if not len(steps):
        return ""
    step = float(np.median(steps))
    speed = math.sqrt(float(np.mean(np.sum(samples.velocity**2, axis=1))))
    moved, least = speed * step, scale if sure else lower
    if moved * RESOLVED <= least or 2 * moved <= lower:
        return ""
    return (
        f"the flight moves {moved:.3g} m from sample to sample, too far to follow a length scale "
        f"of {least:.3g} m; sample at {RESOLVED * speed / least:.3g} Hz or more"
    )
