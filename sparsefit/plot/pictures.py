"""Figures of a flow and of an estimate."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from sparsefit.arrays import Array
from sparsefit.flight import Flight
from sparsefit.flight.waves import FlowField
from sparsefit.logs.checks import gaps_of
from sparsefit.plot.style import COLOURS, GREY, labels, panels, styled, wrapped

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.image import AxesImage

    from sparsefit.estimator import Estimate, Estimator
    from sparsefit.rows import Samples

OPAQUE: dict[str, Any] = {"frameon": True, "framealpha": 0.8, "edgecolor": "none"}  # over lines


def vorticity(
    flow: FlowField, position: Array, time: float = 0.0, points: int = 160
) -> tuple[tuple[float, float, float, float], Array]:
    """Return the edges (left, right, bottom, top) [m] of a map around positions (m, 2) [m], and
    the vorticity dv_y/dx - dv_x/dy [1/s] of the flow there at a time [s], rows along y."""
    low, high = position.min(axis=0), position.max(axis=0)
    room = 0.06 * float((high - low).max()) or 1.0
    low, high = low - room, high + room
    step = float((high - low).max()) / points
    x, y = (np.arange(first, last + step, step) for first, last in zip(low, high, strict=True))
    velocity = flow.velocity(*np.meshgrid(x, y), time)
    turning = np.gradient(velocity[..., 1], step, axis=1)
    turning -= np.gradient(velocity[..., 0], step, axis=0)
    return (float(x[0]), float(x[-1]), float(y[0]), float(y[-1])), turning


def draw_map(
    axes: Axes,
    flow: FlowField | None,
    flights: Sequence[Flight],
    length_scale: float = np.nan,
    drift: tuple[float, float] = (0.0, 0.0),
) -> AxesImage | None:
    """Draw tracks over the vorticity of a flow, in the frame that moves with its drift [m/s]."""
    middle = float(np.median(flights[0].time))
    tracks = [
        flight.position - (flight.time - middle)[:, None] * np.array(drift) for flight in flights
    ]
    every = np.concatenate(tracks)
    scale, unit = axis_unit(float(np.abs(every).max()), "m")
    shades = None
    if flow is not None:
        cells = float(np.ptp(every, axis=0).max()) / length_scale if length_scale > 0 else 0.0
        points = min(max(160, int(8 * cells)), 640)
        edges, turning = vorticity(flow, every, middle, points)
        most = float(np.quantile(np.abs(turning), 0.99)) or 1.0
        shades = axes.imshow(
            turning, origin="lower", extent=tuple(np.divide(edges, scale)), cmap="RdBu",
            vmin=-most, vmax=most, alpha=0.7, interpolation="bilinear", aspect="equal",
        )  # fmt: skip
    for place, track in enumerate(tracks):
        x, y = track.T / scale
        axes.plot(x, y, color="black", lw=0.6 if place else 0.9)
        axes.plot(x[0], y[0], "o", color="black", ms=4)
    axes.set_aspect("equal", adjustable="datalim" if flow is None else "box")
    axes.locator_params(nbins=5)
    axes.grid(False)
    directions = {"ENU": (" east", " north"), "NED": (" north", " east")}
    x_way, y_way = directions.get(flights[0].frame, ("", ""))
    begin = "flights begin at the dots" if len(flights) > 1 else "the flight begins at the dot"
    axes.set_xlabel(f"x{x_way} [{unit}], {begin}")
    axes.set_ylabel(f"y{y_way} [{unit}]")
    return shades


@styled
def draw_flow(flow: FlowField, *flights: Flight, length_scale: float = np.nan) -> Figure:
    """Return a figure of tracks over the vorticity of a flow, rows along y.

    Args:
        flow: any object with ``velocity(x, y, t)`` [m/s]; at the median time of the first flight.
        flights: at least one; their positions set the edges of the map.
        length_scale: L [m] of the smallest cells, for the resolution of the map, if known.
    """
    figure, ((axes,),) = panels(1, 1, height=5.0)
    shades = draw_map(axes, flow, flights, length_scale)
    if shades is not None:
        figure.colorbar(shades, ax=axes, label="vorticity [1/s]", shrink=0.8)
    return figure


def axis_unit(largest: float, unit: str) -> tuple[float, str]:
    """Return the scale of the values of an axis, and the unit of the scaled values."""
    if unit == "m":
        return (1e3, "km") if largest >= 5e3 else (1.0, unit)
    return (86400.0, "days") if largest >= 3e5 else (3600.0, "h") if largest >= 2e4 else (1.0, unit)


@styled
def draw_estimate(
    estimate: Estimate,
    estimator: Estimator,
    flights: Sequence[Flight],
    title: str,
    truth: Sequence[float] = (),
) -> Figure:
    """Return the tracks over the flow, the weights, and the residual.

    Args:
        estimate: of these flights, by this estimator, whose derivative gives the residual.
        flights: as estimated, at least one; the residual is that of the first.
        title: the first line over the figure.
        truth: the true length scales [m], if known.
    """
    figure, ((track, weights), (residual, corner)) = panels(2, 2, height=5.9)
    corner.remove()
    grid: Any = residual.get_gridspec()
    residual.set_subplotspec(grid[1, :])
    flow = estimate.flow
    drift = estimate.drift or (0.0, 0.0)
    shades = draw_map(track, flow, flights, estimate.length_scale, drift)
    moving = ", moving with it" if any(drift) else ""
    track.set_title(f"track over the vorticity{moving}" if flow else "no flow to be drawn")
    if shades is not None:
        turn = ", clockwise" if flights[0].frame == "NED" else ""
        beside = track.inset_axes((1.03, 0.0, 0.04, 1.0))  # as high as the map
        figure.colorbar(shades, cax=beside, label=f"vorticity{turn} [1/s]")
    draw_weights(weights, estimate, truth)
    samples, air, less = along_track(estimate, estimator, flights[0])
    draw_residual(residual, samples, air, less, " of the first flight" * (len(flights) > 1))
    figure.suptitle(labels([title], 90)[title] + f"\n{wrapped(str(estimate), 100)}", fontsize=9)
    return figure


def draw_weights(axes: Axes, estimate: Estimate, truth: Sequence[float]) -> None:
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
    if high - low < 0.2 * high:  # a few candidates side by side
        axes.set_xlim(0.8 * low, 1.2 * high)
    axes.set_ylabel("weight")
    axes.set_xlabel(f"length scale [{unit}]")
    if axes.get_legend_handles_labels()[1]:
        axes.legend(loc="best", **OPAQUE)


def along_track(
    estimate: Estimate, estimator: Estimator, flight: Flight
) -> tuple[Samples, Array, Array | None]:
    """Return the samples of a flight, the air velocity (m, 2) [m/s] there, and its residual, or
    None without a flow; with the parameters of the vehicle as given or estimated."""
    derivative: Any = estimator.derivative  # a setting that the estimator has resolved
    samples: Samples = derivative(flight)
    own = estimate.flights[0] if estimate.flights else estimate
    estimated = {name: getattr(own, name) for name in ("response_time", "drag", "thrust_scale")}
    freed: dict[str, Any] = {k: value for k, value in estimated.items() if math.isfinite(value)}
    if own.thrust_acceleration:
        freed["thrust_acceleration"] = own.thrust_acceleration
    air = samples.flow_velocity(replace(flight.vehicle, **freed))
    if estimate.flow is None:
        return samples, air, None
    x, y = samples.position.T
    return samples, air, air - estimate.flow.velocity(x, y, samples.time)


def draw_residual(
    axes: Axes, samples: Samples, air: Array, less: Array | None, several: str = ""
) -> None:
    """Draw the air velocity in time or, given a flow, its residual."""
    words = "velocity of the air" if less is None else "residual"
    axes.set_title(f"{words}{several}{', no flow found' * (less is None)}")
    scale, unit = axis_unit(float(np.abs(samples.time).max()), "s")
    residual, gaps = air if less is None else less, np.flatnonzero(gaps_of(samples.time)) + 1
    time, shown = np.insert(samples.time, gaps, np.nan), np.insert(residual, gaps, np.nan, axis=0)
    for place, name in enumerate("xy"):  # no line over a gap
        axes.plot(time / scale, shown[:, place], color=COLOURS[place], lw=0.7, label=name)
    low, high = float(residual.min()), float(residual.max())
    if high > low:
        axes.set_ylim(low - 0.05 * (high - low), low + 1.4 * (high - low))  # a legend above
    axes.legend(loc="upper right", ncols=2)
    axes.set_xlabel(f"time [{unit}]")
    axes.set_ylabel(f"{words} [m/s]")
