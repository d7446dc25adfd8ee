"""One estimate as a picture: its tracks over the flow, weights, residual and its spectrum."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sparsefit.arrays import Array
from sparsefit.flight import Flight
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.plot.flow import axis_unit, draw_map
from sparsefit.plot.style import COLOURS, GREY, labels, logarithmic, panels, styled

if TYPE_CHECKING:
    from sparsefit.estimator import Estimate, Estimator

GAP = 3.0  # median steps: a longer one is a gap, over which no line is drawn
ROOM = 1.4  # of the residual's range, for a legend above it
SEGMENTS = 8  # of a spectrum, half of each in the next: Welch (1967)
FEWEST = 32  # samples of a segment
LEAST = 1e-5  # of the largest power that is drawn
NARROW = 0.2  # of a length scale: a range of fewer tells nothing


def draw_estimate(
    estimate: Estimate,
    estimator: Estimator,
    flights: Sequence[Flight],
    title: str,
    truth: Sequence[float] = (),
) -> Figure:
    """Return the tracks over the flow, the weights, and the residual with its spectrum.

    Args:
        truth: the true length scales [m], where they are known.
    """

    def draw() -> Figure:
        figure, ((track, weights), (residual, spectrum)) = panels(2, 2, height=5.9)
        flow = estimate.flow
        drift = estimate.drift or (0.0, 0.0)
        shades = draw_map(track, flow, flights, estimate.length_scale, drift)
        moving = ", moving with it" if any(drift) else ""
        track.set_title(f"track over the vorticity{moving}" if flow else "no flow to be drawn")
        if shades is not None:
            turn = ", clockwise" if flights[0].frame == "NED" else ""
            beside = track.inset_axes((1.03, 0.0, 0.04, 1.0))  # as high as the map
            figure.colorbar(shades, cax=beside, label=f"vorticity{turn} [1/s]")
        _draw_weights(weights, estimate, truth)
        _draw_left(residual, spectrum, estimate, estimator, flights)
        name = labels([title], 90)[title]
        figure.suptitle(f"{name}\n{_answer(estimate)}", fontsize=9)
        return figure

    return styled(draw)


def _answer(estimate: Estimate) -> str:
    uncertainty = estimate.uncertainty
    spreads = (
        (uncertainty.mean_velocity, uncertainty.length_scale)
        if uncertainty
        else (math.nan, math.nan)
    )
    speed = _quantity(estimate.mean_velocity, spreads[0])
    length = _quantity(estimate.length_scale, spreads[1])
    return f"U0 = {speed} m/s, L = {length} m: {estimate.status}"


def _quantity(value: float, spread: float) -> str:
    """Return a value with its standard error, both to two digits of that."""
    if not math.isfinite(value):
        return "–"
    if not 0 < spread < math.inf:
        return f"{value:.4g}"
    places = max(0, min(1 - math.floor(math.log10(spread)), 6))
    return f"{value:.{places}f} ± {spread:.{places}f}"


def _draw_weights(axes: Axes, estimate: Estimate, truth: Sequence[float]) -> None:
    """Draw the weight of each candidate length scale, and the true and estimated scales."""
    by_scale = estimate.weights_by_scale
    axes.set_title("weight of each length scale" if by_scale else "no weights")
    if not by_scale:
        axes.set_axis_off()
        return
    scale, unit = axis_unit(max(by_scale), "m")
    candidates, weights = np.array(list(by_scale)) / scale, np.array(list(by_scale.values()))
    axes.axhline(0.0, color=GREY, lw=0.5)
    for place, length in enumerate(truth):
        axes.axvline(length / scale, color=COLOURS[1], ls=(0, (4, 2)), lw=1.2,
                     label=None if place else "truth")  # fmt: skip
    if math.isfinite(estimate.length_scale):
        axes.axvline(estimate.length_scale / scale, color=COLOURS[2], ls=":", lw=1.6,
                     label="estimate")  # fmt: skip
    axes.vlines(candidates, 0.0, weights, color=COLOURS[0], lw=1.2, zorder=3)
    used = weights != 0
    axes.plot(candidates[used], weights[used], "o", color=COLOURS[0], ms=2.5, zorder=4)
    low, high = axes.get_xlim()
    if high - low < NARROW * high:  # a few candidates side by side
        axes.set_xlim((1 - NARROW) * low, (1 + NARROW) * high)
    axes.set_ylabel("weight")
    axes.set_xlabel(f"length scale [{unit}]")
    if axes.get_legend_handles_labels()[1]:
        axes.legend(loc="best")


def _draw_left(
    axes: Axes,
    power: Axes,
    estimate: Estimate,
    estimator: Estimator,
    flights: Sequence[Flight],
) -> None:
    """Draw the velocity of the air less that of the flow in time, and the spectra of both.

    A residual as flat as the sensors' noise has no structure left; the line marks the frequency at
    which the vehicle meets cells, speed over 2 L.
    """
    derivative: Any = estimator.derivative  # a setting that the estimator has resolved
    samples = derivative(flights[0])
    air = samples.flow_velocity(_vehicle(flights[0].vehicle, estimate))
    residual, flow = air, estimate.flow
    if flow is not None:
        x, y = samples.position.T
        residual = air - flow.velocity(x, y, samples.time)
    several = " of the first flight" if len(flights) > 1 else ""
    words = "residual" if flow is not None else "velocity of the air"
    axes.set_title(f"{words}{several}, {'less the flow' if flow is not None else 'no flow found'}")
    scale, unit = axis_unit(float(np.abs(samples.time).max()), "s")
    steps = np.diff(samples.time)
    cuts = np.flatnonzero(steps > GAP * np.median(steps)) + 1
    time, shown = np.insert(samples.time, cuts, np.nan), np.insert(residual, cuts, np.nan, axis=0)
    for place, name in enumerate("xy"):
        axes.plot(time / scale, shown[:, place], color=COLOURS[place], lw=0.7, label=name)
    low, high = float(residual.min()), float(residual.max())
    if high > low:
        axes.set_ylim(low - 0.05 * (high - low), low + ROOM * (high - low))
    axes.legend(loc="upper right", ncols=2)
    axes.set_xlabel(f"time [{unit}]")
    axes.set_ylabel(f"{words} [m/s]")
    pieces = np.split(np.arange(len(samples.time)), cuts)
    piece = max(pieces, key=len)
    power.set_title("spectrum")
    if len(piece) < 2 * FEWEST:
        power.text(0.5, 0.5, "too few samples", transform=power.transAxes, ha="center")
        power.set_axis_off()
        return
    step = float(np.median(np.diff(samples.time[piece])))
    frequency, whole = spectrum(air[piece], step)
    power.loglog(frequency, whole.sum(axis=1), color=GREY, lw=0.9, label="velocity of the air")
    lowest = LEAST * float(whole.max())
    if flow is not None:
        rest = spectrum(residual[piece], step)[1]
        lowest = LEAST * max(float(rest.max()), lowest)
        for place, name in enumerate("xy"):
            power.loglog(frequency, rest[:, place], color=COLOURS[place], lw=0.8,
                         label=f"residual {name}")  # fmt: skip
    speed = math.sqrt(float(np.mean(np.sum(samples.velocity**2, axis=1))))
    meets = speed / (2.0 * estimate.length_scale)
    if frequency[0] < meets < frequency[-1]:
        power.axvline(meets, color=COLOURS[2], ls=":", lw=1.6, label="cells")
    power.set_ylim(max(power.get_ylim()[0], lowest))
    power.set_xlim(frequency[0], frequency[-1])
    logarithmic(power.xaxis, *power.get_xlim())
    logarithmic(power.yaxis, *power.get_ylim())
    power.set_xlabel("frequency [Hz]")
    power.set_ylabel("power [(m/s)²/Hz]")
    power.legend(loc="best")


def _vehicle(believed: PointMassVehicle, estimate: Estimate) -> PointMassVehicle:
    """Return the vehicle as it was believed to be, with what was estimated of it."""
    own = estimate.flights[0] if estimate.flights else estimate
    freed: dict[str, float] = {
        name: getattr(own, name)
        for name in ("response_time", "drag", "thrust_scale")
        if math.isfinite(getattr(own, name))
    }
    thrust = own.thrust_acceleration or believed.thrust_acceleration
    return replace(believed, **freed, thrust_acceleration=thrust)


def spectrum(values: Array, step: float) -> tuple[Array, Array]:
    """Return frequencies (f,) [Hz] and the power (f, c) of even samples (m, c), in their unit²/Hz.

    One-sided, by Welch's method: the mean of segments under a Hann window, half of each in the
    next, their means taken out. The sum over frequencies times their step is the variance.

    Args:
        step: between the samples [s].
    """
    width = max(2 * len(values) // (SEGMENTS + 1), FEWEST)
    window = np.hanning(width + 1)[:-1]
    starts = range(0, len(values) - width + 1, width // 2)
    total = np.zeros((width // 2 + 1, values.shape[1]))
    for start in starts:
        part = values[start : start + width]
        transformed = np.fft.rfft(window[:, None] * (part - part.mean(axis=0)), axis=0)
        total += np.abs(transformed) ** 2
    power = 2.0 * step * total / (len(starts) * float(np.sum(window**2)))
    frequency: Array = np.arange(1, width // 2 + 1) / (width * step)
    return frequency, power[1:]
