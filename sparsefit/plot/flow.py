"""A flow as a map of its vorticity, with the tracks of flights over it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import AxesImage

from sparsefit.arrays import Array
from sparsefit.flight import Flight
from sparsefit.plot.style import panels, styled

POINTS = 160  # of the map along its longer side, at least
MOST_POINTS, PER_CELL = 640, 8
MARGIN = 0.06  # of the extent, around the tracks
UNITS = {"m": ((5e3, 1e3, "km"),), "s": ((3e5, 86400.0, "days"), (2e4, 3600.0, "h"))}
AXES = {"": ("x", "y"), "ENU": ("x east", "y north"), "NED": ("x north", "y east")}


class Field(Protocol):
    """Anything with the velocity (..., 2) [m/s] of the air at x, y [m] and time t [s]."""

    def velocity(self, x: Array, y: Array, t: float, /) -> Array:
        """Return the velocity of the air."""
        ...


def vorticity(
    flow: Field, position: Array, time: float = 0.0, points: int = POINTS
) -> tuple[tuple[float, float, float, float], Array]:
    """Return the edges (left, right, bottom, top) [m] of a map around positions (m, 2) [m], and
    there dv_y/dx - dv_x/dy [1/s] of the flow at a time [s], rows along y."""
    low, high = position.min(axis=0), position.max(axis=0)
    room = MARGIN * float((high - low).max()) or 1.0
    low, high = low - room, high + room
    step = float((high - low).max()) / points
    x, y = (np.arange(first, last + step, step) for first, last in zip(low, high, strict=True))
    velocity = flow.velocity(*np.meshgrid(x, y), time)
    turning = np.gradient(velocity[..., 1], step, axis=1)
    turning -= np.gradient(velocity[..., 0], step, axis=0)
    return (float(x[0]), float(x[-1]), float(y[0]), float(y[-1])), turning


def draw_map(
    axes: Axes,
    flow: Field | None,
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
        points = min(max(POINTS, int(PER_CELL * cells)), MOST_POINTS)
        edges, turning = vorticity(flow, every, middle, points)
        most = float(np.quantile(np.abs(turning), 0.99)) or 1.0
        west, east_edge, bottom, top = (edge / scale for edge in edges)
        shades = axes.imshow(
            turning, origin="lower", extent=(west, east_edge, bottom, top), cmap="RdBu", vmin=-most,
            vmax=most, alpha=0.7, interpolation="bilinear", aspect="equal",
        )  # fmt: skip
    for place, track in enumerate(tracks):
        x, y = track.T / scale
        axes.plot(x, y, color="black", lw=0.6 if place else 0.9)
        axes.plot(x[0], y[0], "o", color="black", ms=4)
    axes.set_aspect("equal", adjustable="datalim" if flow is None else "box")
    axes.locator_params(nbins=5)
    axes.grid(False)
    east, north = AXES[flights[0].frame]
    begin = "flights begin at the dots" if len(flights) > 1 else "the flight begins at the dot"
    axes.set_xlabel(f"{east} [{unit}], {begin}")
    axes.set_ylabel(f"{north} [{unit}]")
    return shades


def draw_flow(flow: Field, *flights: Flight, length_scale: float = np.nan) -> Figure:
    """Return a picture of flights over the vorticity of a flow."""

    def draw() -> Figure:
        figure, ((axes,),) = panels(1, 1, height=5.0)
        shades = draw_map(axes, flow, flights, length_scale)
        if shades is not None:
            figure.colorbar(shades, ax=axes, label="vorticity [1/s]", shrink=0.8)
        return figure

    return styled(draw)


def axis_unit(largest: float, unit: str) -> tuple[float, str]:
    """Return by what the values of an axis are divided, and the unit that they then have."""
    for least, factor, larger in UNITS[unit]:
        if largest >= least:
            return factor, larger
    return 1.0, unit
