"""One estimate as a picture: its track over the cells found, weights, residual and its spectrum."""

from __future__ import annotations

import math

from matplotlib.figure import Figure

from sparsefit.estimator.estimate import Estimate
from sparsefit.study.report.drawing import laid_out, panels, shortened
from sparsefit.study.report.flown import (
    Flown,
    draw_residual,
    draw_spectrum,
    draw_track,
    draw_weights,
)

LONGEST = 90  # letters of the title


def estimate_figure(flown: Flown, name: str) -> Figure:
    """Draw the track over the estimated cells, the weights, and the residual with its spectrum.

    Args:
        flown: what was flown and found.
        name: of the log, for the title.
    """
    return laid_out(lambda: _drawn(flown, name))


def _drawn(flown: Flown, name: str) -> Figure:
    figure, ((track, weights), (residual, spectrum)) = panels(2, 2, height=5.9)
    shades = draw_track(track, flown)
    if shades is not None:
        sense = ", clockwise" if flown.flight.frame == "NED" else ""
        beside = track.inset_axes((1.03, 0.0, 0.04, 1.0))  # as high as the map, whatever its shape
        figure.colorbar(shades, cax=beside, label=f"vorticity{sense} [1/s]")
    draw_weights(weights, flown)
    draw_residual(residual, flown)
    draw_spectrum(spectrum, flown)
    figure.suptitle(f"{shortened(name, LONGEST)}\n{_answer(flown.estimate)}", fontsize=9)
    return figure


def _answer(estimate: Estimate) -> str:
    """U0 and L with their standard errors, and the status."""
    known = estimate.uncertainty
    spreads = (known.mean_velocity, known.length_scale) if known else (math.nan, math.nan)
    speed = _quantity(estimate.mean_velocity, spreads[0])
    length = _quantity(estimate.length_scale, spreads[1])
    return f"U0 = {speed} m/s, L = {length} m: {estimate.status}"


def _quantity(value: float, spread: float) -> str:
    if not math.isfinite(value):
        return "–"
    if not 0 < spread < math.inf:
        return f"{value:.4g}"
    places = max(0, min(1 - math.floor(math.log10(spread)), 6))
    return f"{value:.{places}f} ± {spread:.{places}f}"
