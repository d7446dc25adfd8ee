"""From longitude and latitude to a local plane, x east and y north, by the PROJ library.

The azimuthal equidistant projection about the middle of the track, on the ellipsoid of WGS 84:
exact along every line through the middle; across it lengths are too long by (r/R)^2/6 at a distance
r, 0.01 % at 150 km (Snyder, Map Projections: A Working Manual, USGS 1395, 1987, ch. 25). East and
north turn against the axes away from the middle by the convergence of the meridians; velocities
are corrected for it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sparsefit.arrays import Array
from sparsefit.errors import InputError, optional


@dataclass(frozen=True, eq=False)
class Plane:
    """A track in its local plane."""

    position: Array  # x east and y north of the origin [m], (m, 2)
    convergence: Array  # the angle from y to true north, counter-clockwise [rad], (m,)
    words: str  # where the plane touches the Earth, and how accurate its lengths are
    origin: tuple[float, float]  # longitude and latitude of that place [degrees]

    def turned(self, velocity: Array) -> Array:
        """Return velocities (m, 2), given to the east and north, along the plane's axes."""
        cos, sin = np.cos(self.convergence), np.sin(self.convergence)
        east, north = velocity.T
        return np.column_stack([cos * east - sin * north, cos * north + sin * east])


def plane_of(
    longitude: Array,
    latitude: Array,
    names: tuple[str, str],
    origin: tuple[float, float] | None = None,
) -> Plane:
    """Project a track onto the plane tangent to the Earth in its middle, or in an origin.

    Args:
        longitude: degrees east, -180 to 360, (m,).
        latitude: degrees north, (m,).
        names: the names of their columns in the log.
        origin: longitude and latitude of x = y = 0 [degrees].

    Raises:
        InputError: if a value is no longitude or latitude, both appear swapped, or the track
            extends beyond 2000 km.
        MissingExtra: without pyproj.
    """
    (x, y), east_by, north_by = names, np.abs(longitude), np.abs(latitude)
    crossed = x.casefold().startswith("lat") and y.casefold().startswith("lon")
    ends = (f"{v.min():.4g} … {v.max():.4g}°" for v in (longitude, latitude))
    given = "x = {} goes {}, y = {} goes {}".format(*sum(zip(names, ends, strict=True), ()))
    if max(east_by.max(), north_by.max()) > 360.0:
        raise InputError(f"{given}: no degrees; say their unit, x={x}[degE7], or [m]")
    if (
        north_by.max() > 90.0
        or longitude.min() < -180.0
        # Few flights are beyond 85 degrees: such columns are most likely swapped.
        or np.median(north_by) > 85.0 >= east_by.max()
        or (crossed and np.median(east_by) <= 85.0)  # else the header itself is wrong
    ):
        raise InputError(
            f"{given}: latitude and longitude look swapped: exchange them, x={y}, y={x}, or check "
            "their units"
        )
    # Continuous across 180 degrees.
    longitude = longitude[0] + (longitude - longitude[0] + 180.0) % 360.0 - 180.0
    middle = [(float(v.min()) + float(v.max())) / 2.0 for v in (longitude, latitude)]
    east, north = origin or middle
    pyproj = optional("pyproj", "longitude and latitude need pyproj", "logs")
    projection = pyproj.Proj(proj="aeqd", lon_0=east, lat_0=north, ellps="WGS84")
    position = np.column_stack(projection(longitude, latitude))
    farthest = float(np.hypot(*position.T).max())
    if not farthest < 2_000e3:  # m
        whence = "the origin" if origin else "its middle"
        raise InputError(f"the track goes {farthest / 1e3:.0f} km from {whence}: no plane; cut it")
    turned = np.radians(projection.get_factors(longitude, latitude).meridian_convergence)
    share = max(1e-3, 100.0 * (farthest / 6_371e3) ** 2 / 6.0)  # %
    place = f"{abs(north):.4f}° {'SN'[north >= 0]}, {abs(east):.4f}° {'WE'[east >= 0]}"
    words = f"local plane about {place}, lengths true to {share:.1g} %"
    return Plane(position, turned, words, (east, north))
