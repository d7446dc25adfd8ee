"""What was flown and found, panel by panel: track over the flow, weights, residual and spectrum."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.image import AxesImage

from sparsefit.arrays import Array
from sparsefit.derivative import Samples
from sparsefit.estimator.estimate import Estimate, FlightEstimate
from sparsefit.flight import Flight
from sparsefit.flight.flow import FlowField
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.logs.checks import gaps_of
from sparsefit.study.report.drawing import COLOURS, GREY, logarithmic

POINTS = 160  # of the map, along its longer side, at least
MOST_POINTS, PER_CELL = 640, 8
MARGIN = 0.06  # of the extent, around the track
ROOM = 1.4  # of the residual's range, for a legend above it
NARROW = 0.2  # of a length scale: a range of fewer tells nothing
SEGMENTS = 8  # of a spectrum, half of each in the next: Welch (1967)
FEWEST = 32  # samples of a segment
LEAST = 1e-5  # of the largest power that is drawn
UNITS = {"m": ((5e3, 1e3, "km"),), "s": ((3e5, 86400.0, "days"), (2e4, 3600.0, "h"))}
AXES = {"": ("x", "y"), "ENU": ("x east", "y north"), "NED": ("x north", "y east")}


@dataclass(frozen=True, eq=False)
class Flown:
    """A flight and what was found of its flow.

    Args:
        flight: as it was logged.
        samples: that were fitted.
        measured: Phi, the velocity of the air at the samples [m/s], (m, 2).
        estimate: what was found.
        truth: the true length scales [m], where anybody knows them.
        beside: other flights through the same flow, whose tracks are drawn too.
    """

    flight: Flight
    samples: Samples
    measured: Array
    estimate: Estimate
    truth: tuple[float, ...] = ()
    beside: tuple[Flight, ...] = ()

    @property
    def left(self) -> Array:
        """The velocity of the air less that of the flow found [m/s], (m, 2)."""
        if self.estimate.flow is None:
            return self.measured
        x, y = self.samples.position.T
        return self.measured - self.estimate.flow.velocity(x, y, self.samples.time)


def flown_by(
    flight: Flight, samples: Samples, estimate: Estimate, beside: Sequence[Flight] = ()
) -> Flown:
    """Return what was flown, by the vehicle as it was believed to be, or as it was estimated."""
    own = estimate.flights[0] if estimate.flights else estimate
    measured = samples.flow_velocity(_vehicle(flight.vehicle, own))
    return Flown(flight, samples, measured, estimate, beside=tuple(beside))


def _vehicle(believed: PointMassVehicle, estimate: Estimate | FlightEstimate) -> PointMassVehicle:
    found: dict[str, float] = {
        name: getattr(estimate, name)
        for name in ("response_time", "drag", "thrust_scale")
        if math.isfinite(getattr(estimate, name))
    }
    thrust = estimate.thrust_acceleration or believed.thrust_acceleration
    return replace(believed, **found, thrust_acceleration=thrust)


def draw_track(axes: Axes, flown: Flown) -> AxesImage | None:
    """Draw the track over the vorticity of the flow found; in its own frame, where that drifts."""
    flow, drift = flown.estimate.flow, np.array(flown.estimate.drift or (0.0, 0.0))
    middle = float(np.median(flown.flight.time))
    tracks = [
        one.position - (one.time - middle)[:, None] * drift for one in (flown.flight, *flown.beside)
    ]
    every = np.concatenate(tracks)
    scale, unit = scaled(float(np.abs(every).max()), "m")
    moving = ", moving with it" if drift.any() else ""
    axes.set_title(f"track over the vorticity found{moving}" if flow else _lacking(flown))
    shades = None
    if flow is not None:
        length = flown.estimate.length_scale
        extent = float(np.ptp(every, axis=0).max())
        points = PER_CELL * extent / length if length > 0 else 0.0
        edges, turning = vorticity(flow, every, middle, min(max(POINTS, int(points)), MOST_POINTS))
        most = float(np.quantile(np.abs(turning), 0.99)) or 1.0
        left, right, bottom, top = (edge / scale for edge in edges)
        shades = axes.imshow(
            turning, origin="lower", extent=(left, right, bottom, top), cmap="RdBu", vmin=-most,
            vmax=most, alpha=0.7, interpolation="bilinear", aspect="equal",
        )  # fmt: skip
    for place, track in enumerate(tracks):
        x, y = track.T / scale
        axes.plot(x, y, color="black", lw=0.6 if place else 0.9)
        axes.plot(x[0], y[0], "o", color="black", ms=4)
    axes.set_aspect("equal", adjustable="datalim" if flow is None else "box")
    axes.locator_params(nbins=5)
    axes.grid(False)
    east, north = AXES[flown.flight.frame]
    begins = "flights begin at the dots" if flown.beside else "the flight begins at the dot"
    axes.set_xlabel(f"{east} [{unit}], {begins}")
    axes.set_ylabel(f"{north} [{unit}]")
    return shades


def _lacking(flown: Flown) -> str:
    """Why no flow is drawn: there is none, or its weights are not those of a velocity."""
    found = math.isfinite(flown.estimate.length_scale)
    return "the flow itself is not told" if found else "no flow was found"


def vorticity(
    flow: FlowField, position: Array, time: float, points: int = POINTS
) -> tuple[tuple[float, float, float, float], Array]:
    """Return the edges (left, right, bottom, top) [m] of a map around positions (m, 2) [m], and
    there dv_y/dx - dv_x/dy [1/s] of the flow at a time [s], rows along y."""
    low, high = position.min(axis=0), position.max(axis=0)
    room = MARGIN * float((high - low).max()) or 1.0
    low, high = low - room, high + room
    step = float((high - low).max()) / points
    x, y = (np.arange(one, other + step, step) for one, other in zip(low, high, strict=True))
    velocity = flow.velocity(*np.meshgrid(x, y), time)
    turning = np.gradient(velocity[..., 1], step, axis=1) - np.gradient(
        velocity[..., 0], step, axis=0
    )
    return (float(x[0]), float(x[-1]), float(y[0]), float(y[-1])), turning


def draw_weights(axes: Axes, flown: Flown) -> None:
    """Draw the weight of each candidate length scale."""
    by_scale = flown.estimate.weights_by_scale
    axes.set_title("weight of each length scale" if by_scale else "no weights")
    if not by_scale:
        axes.set_axis_off()
        return
    scale, unit = scaled(max(by_scale), "m")
    candidates = [length / scale for length in by_scale]
    axes.axhline(0.0, color=GREY, lw=0.5)
    draw_scales(axes, flown, scale)
    weights = list(by_scale.values())
    axes.vlines(candidates, 0.0, weights, color=COLOURS[0], lw=1.2, zorder=3)
    used = [(place, weight) for place, weight in zip(candidates, weights, strict=True) if weight]
    axes.plot(*np.array(used or [(np.nan, np.nan)]).T, "o", color=COLOURS[0], ms=2.5, zorder=4)
    low, high = axes.get_xlim()
    if high - low < NARROW * high:  # a few candidates side by side
        axes.set_xlim((1 - NARROW) * low, (1 + NARROW) * high)
    axes.set_ylabel("weight")
    axes.set_xlabel(f"length scale [{unit}]")
    if axes.get_legend_handles_labels()[1]:
        axes.legend(loc="best")


def draw_scales(axes: Axes, flown: Flown, scale: float = 1.0) -> None:
    """Mark the true and the estimated length scales, in units of ``scale`` [m]."""
    for place, length in enumerate(flown.truth):
        axes.axvline(length / scale, color=COLOURS[1], ls=(0, (4, 2)), lw=1.2,
                     label=None if place else "truth")  # fmt: skip
    if np.isfinite(flown.estimate.length_scale):
        axes.axvline(flown.estimate.length_scale / scale, color=COLOURS[2], ls=":", lw=1.6,
                     label="estimate")  # fmt: skip


def draw_residual(axes: Axes, flown: Flown) -> None:
    """Draw what the flow found leaves of the velocity of the air, in time."""
    none = flown.estimate.flow is None
    axes.set_title(f"{_lacking(flown)}: the velocity of the air" if none else
                   "velocity of the air less that of the flow found")  # fmt: skip
    if flown.beside and not none:
        axes.set_title("residual of the first flight")
    time, left = flown.samples.time, flown.left
    scale, unit = scaled(float(np.abs(time).max()), "s")
    for place, name in enumerate("xy"):
        axes.plot(time / scale, left[:, place], color=COLOURS[place], lw=0.7, label=name)
    low, high = float(left.min()), float(left.max())
    if high > low:
        axes.set_ylim(low - 0.05 * (high - low), low + ROOM * (high - low))
    axes.legend(loc="upper right", ncols=2)
    axes.set_xlabel(f"time [{unit}]")
    axes.set_ylabel("velocity [m/s]" if none else "residual [m/s]")


def draw_spectrum(axes: Axes, flown: Flown) -> None:
    """Draw the spectra of the residual and of the velocity of the air itself.

    A residual that is as flat as the sensors' noise has no structure left; the line marks the
    frequency at which the vehicle meets cells, speed over 2 L.
    """
    none = flown.estimate.flow is None
    axes.set_title("spectrum of the velocity of the air" if none else "spectrum of the residual")
    piece = _longest(flown.samples.time)
    step = float(np.median(np.diff(flown.samples.time[piece])))
    if piece.stop - piece.start < 2 * FEWEST:
        axes.text(0.5, 0.5, "too few samples", transform=axes.transAxes, ha="center")
        axes.set_axis_off()
        return
    axes.set_xlabel("frequency [Hz]")
    axes.set_ylabel("power [(m/s)²/Hz]")
    frequency, whole = spectrum(flown.measured[piece], step)
    axes.loglog(frequency, whole.sum(axis=1), color=GREY, lw=0.9, label="velocity of the air")
    lowest = LEAST * float(whole.max())
    if not none:
        left = spectrum(flown.left[piece], step)[1]
        lowest = LEAST * max(float(left.max()), lowest)
        for place, name in enumerate("xy"):
            axes.loglog(
                frequency, left[:, place], color=COLOURS[place], lw=0.8, label=f"residual {name}"
            )
    speed = math.sqrt(float(np.mean(np.sum(flown.samples.velocity**2, axis=1))))
    meets = speed / (2.0 * flown.estimate.length_scale)
    if frequency[0] < meets < frequency[-1]:
        axes.axvline(meets, color=COLOURS[2], ls=":", lw=1.6, label="cells")
    _decades(axes, frequency, lowest)
    axes.legend(loc="best")


def _decades(axes: Axes, frequency: Array, lowest: float) -> None:
    """Number both axes in plain digits; what a smoother has taken out wholly is not shown."""
    axes.set_ylim(max(axes.get_ylim()[0], lowest))
    axes.set_xlim(frequency[0], frequency[-1])
    logarithmic(axes.xaxis, *axes.get_xlim())
    logarithmic(axes.yaxis, *axes.get_ylim())


def spectrum(values: Array, step: float) -> tuple[Array, Array]:
    """Return frequencies (f,) [Hz] and the power (f, c) of even samples (m, c), in their unit²/Hz.

    One-sided, by Welch's method: the mean of segments under a Hann window, half of each in the
    next, their means taken out. The sum over frequencies times their step is the variance.

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


def _longest(time: Array) -> slice:
    """The rows of the longest piece without a gap."""
    ends = [0, *(np.flatnonzero(gaps_of(time)) + 1).tolist(), len(time)]
    sizes = np.diff(ends)
    place = int(np.argmax(sizes))
    return slice(ends[place], ends[place + 1])


def scaled(largest: float, unit: str) -> tuple[float, str]:
    """Return by what values of an axis are divided, and the unit that they then have."""
    for least, factor, larger in UNITS[unit]:
        if largest >= least:
            return factor, larger
    return 1.0, unit
