"""What the flow seems to be instead of the one that was fitted, in words."""

from __future__ import annotations

import math

from sparsefit.estimator.doubt import Doubt, Verdict
from sparsefit.uncertainty import Cause, Goodness, Suspect

NAMED = 0.9  # R^2: a fit that explains less may be of another lobe, and its cause by chance
LARGE = 0.15  # of U0, turbulence that makes 1 - R^2 a tenth: less is the sensors' noise
FREED = {Cause.WIND: "wind", Cause.RESPONSE_TIME: "response_time"}  # what a library can free


def misfit(goodness: Goodness | None, unknown: tuple[str, ...] = ()) -> Verdict | None:
    """The verdict ``misfit`` with its cause and remedy in words; None where nothing is suspected.

    No cause is named where the fit explains less than `NAMED` and noise does not explain the rest.
    unknown: what the library had freed already.
    """
    suspect = goodness.suspect if goodness else None
    if goodness is None or suspect is None:
        return None
    coloured = goodness.turbulence_share > LARGE
    if goodness.r_squared < NAMED and coloured:
        explained = f"the fit explains only {100 * goodness.r_squared:.0f} % of the flow velocity"
        words = f"{explained}: the flow is another, or hardly steady"
        return Verdict("misfit", words, Doubt.MISFIT)
    where = f" of flight {goodness.flight}" if goodness.flight else ""
    left = f"more than noise is left{where} (R² {goodness.r_squared:.4g})"
    words = f"{left}: {_words(suspect, goodness)}"
    if suspect.cause in FREED and not (goodness.flight and suspect.cause is Cause.RESPONSE_TIME):
        freed = (*unknown, FREED[suspect.cause])
        names = ", ".join(f'"{name}"' for name in freed)
        words += f"; free it: unknown = [{names}] (--unknown {' '.join(freed)})"
    return Verdict("misfit", words, Doubt.MISFIT)


def _words(suspect: Suspect, goodness: Goodness) -> str:
    size = suspect.size
    match suspect.cause:
        case Cause.WIND:
            return f"there seems to be a wind of ({size[0]:.2g}, {size[1]:.2g}) m/s"
        case Cause.RESPONSE_TIME:
            longer = "longer" if size[0] > 0 else "shorter"
            return f"the response time seems {abs(size[0]):.2g} s {longer} than it is believed"
        case Cause.DRAG:
            more = "more" if size[0] > 0 else "less"
            amount = f"{more} quadratic than it is believed, by about {abs(size[0]):.2g} 1/m"
            return f"the drag seems {amount}; give the vehicle another drag"
        case Cause.LINEAR_DRAG:
            more = "more" if size[0] > 0 else "less"
            amount = f"{more} linear than it is believed, by about {abs(size[0]):.2g} 1/s"
            return f"the drag seems {amount}; give the vehicle another drag"
        case Cause.SWELLING:
            return f"the mean velocity seems to change in time, by {100 * size[0]:.2g} % rms"
        case Cause.DRIFT:
            return f"the cells seem to drift at about ({size[0]:.2g}, {size[1]:.2g}) m/s"
        case Cause.TURN:
            return f"the cells seem turned, by about {math.degrees(size[0]):.2g} degrees"
        case Cause.STRETCH:
            axes = "x than in y" if size[0] > 0 else "y than in x"
            return f"the cells seem longer in {axes}, by about {100 * abs(size[0]):.2g} %"
        case Cause.ANOTHER_FLOW:
            others = "flight" if len(goodness.flights) == 2 else "flights"
            return (
                f"it tells another flow than the other {others}, by about {100 * size[0]:.2g} %: "
                "its vehicle, frame or time may be another; leave it out"
            )
        case Cause.TURBULENCE:
            share = 100 * goodness.turbulence_share
            return (
                f"turbulence of {size[0]:.2g} m/s, {share:.2g} % of U0, and hardly any steady cells"
            )
