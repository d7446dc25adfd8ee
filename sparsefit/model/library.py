"""Candidate functions over a grid, and the regression problem they make.

Two families: the paper's cells (Eqs. 17-19), for every length scale L the 8 products and singles of
sin and cos of pi x / L and pi y / L, with weights for each velocity component; and ``waves``, those
of a stream function over the plane of wavevectors, cells of any heading and shape among them. Both
components share the weights of a wave: theta has a row for each, x before y, sample after sample.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np

from sparsefit.arrays import Array
from sparsefit.errors import InputError, integer, one_of, told_with
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.model.grid import (
    CANDIDATES,
    Bounds,
    LengthScaleGrid,
    candidate_columns,
    extent_of,
    wave_columns,
    wave_rings,
)
from sparsefit.model.unknowns import UnknownColumns, checked_unknowns, project_out
from sparsefit.regression.problem import RegressionProblem, compressed
from sparsefit.rows import Samples

Target = Literal["flow-velocity", "acceleration", "state-derivative"]
FamilyName = Literal["cells", "waves"]
WaveGroups = Literal["wave", "nested"]

TARGET_NAMES: dict[str, tuple[str, ...]] = {
    "flow-velocity": ("w_x", "w_y"),
    "acceleration": ("dv_x/dt", "dv_y/dt"),
    "state-derivative": ("dx/dt", "dy/dt", "dv_x/dt", "dv_y/dt"),
}
STREAM_BYTES = 2**30  # beyond this, theta is compressed as it is built


@dataclass(frozen=True)
class Library:
    """The library builder: candidates of a family over a grid, and what they are regressed on.

    ``target``: ``flow-velocity`` Phi = tau (v' - a) + v (Eq. 23), ``acceleration`` v', or
    ``state-derivative`` (x', v'), the literal reading of Eq. 20.
    ``unknown``: what is estimated with the flow, of `sparsefit.model.unknowns.UNKNOWNS`; the rest
    is as the vehicle says, and the air at rest but for the flow.
    ``family``: ``cells`` or ``waves``. Waves have one weight for both velocity components, and
    their one target is the flow velocity.
    ``groups`` of waves, between the length scales of ``grid``: each ``wave``, or ``nested``: waves
    within the ring of waves of one |k|, which is a length scale, for penalties of groups in groups.
    ``every``: rows are every so many-th sample, where a smoothed flight has more than it has to
    say; the search and the measurement still take all. Raises InputError on settings out of range.
    """

    grid: LengthScaleGrid = LengthScaleGrid()
    target: Target = "flow-velocity"
    unknown: tuple[str, ...] = ()
    family: FamilyName = "cells"
    groups: WaveGroups = "wave"
    every: int = 1

    def __post_init__(self) -> None:
        one_of("target", self.target, TARGET_NAMES)
        one_of("family of the library", self.family, get_args(FamilyName))
        one_of("groups of the library", self.groups, get_args(WaveGroups))
        if self.family == "waves" and self.target != "flow-velocity":
            raise InputError(
                "family 'waves' is of a stream function, which gives the flow velocity: "
                f"target {self.target!r} needs family 'cells'"
            )
        if self.family == "cells" and self.groups != "wave":
            raise InputError(
                "library: 'groups' is a setting of family 'waves', not of 'cells'; leave it out"
            )
        integer("library: every", self.every, 1)
        object.__setattr__(self, "unknown", checked_unknowns(self.unknown, self.target))

    @property
    def bounds(self) -> Bounds:
        """The bounds of the wavenumber k = pi/L [1/m]."""
        return math.pi / self.grid.upper, math.pi / self.grid.lower

    def response(self, samples: Samples, vehicle: PointMassVehicle) -> Array:
        """The target of the regression (m, n), one row per sample."""
        if self.target == "flow-velocity":
            return samples.flow_velocity(vehicle)
        if self.target == "acceleration":
            return samples.acceleration
        return np.hstack([samples.position_rate, samples.acceleration])

    def _columns(self, extent: float) -> dict[str, Any]:
        """The columns that the grid gives a flight of that extent [m], as a problem has them.

        Raises InputError where they are too many to hold.
        """
        if self.family == "cells":
            scales = self.grid.resolving(extent).scales
            return {
                "names": tuple(
                    f"{name} (L = {scale:g} m)" for scale in scales.tolist() for name in CANDIDATES
                ),
                "groups": np.repeat(np.arange(len(scales)), len(CANDIDATES)),
                "group_scales": scales,
                "parameters": math.pi / scales[:, None],
            }
        k, ring, scales = wave_rings(self.grid.lower, self.grid.upper, extent)
        wave, nested = np.repeat(np.arange(len(k)), 2), self.groups == "nested"
        pairs = [(part, *pair) for pair in k.tolist() for part in ("cos", "sin")]
        return {
            "names": tuple(f"psi = {part} k.x (k = {x:.4g}, {y:.4g} 1/m)" for part, x, y in pairs),
            "groups": np.repeat(ring, 2) if nested else wave,
            "group_scales": scales if nested else scales[ring],
            "parameters": k,
            "subgroups": wave if nested else None,
        }

    def build(
        self,
        flights: Sequence[Samples],
        vehicles: Sequence[PointMassVehicle],
        weights: Sequence[float] = (1.0,),
    ) -> RegressionProblem:
        """The regression problem of flights through one flow, the rows of each times its weight.

        Theta is (m, 8 g), group-major, of cells; of waves it has two rows a sample, x and y, and
        one column of the target. Gram matrices add up. What is unknown of a flight is taken from
        its own rows. Where theta would exceed 1 GiB it is compressed block by block
        (`problem.compressed`): the same solutions and certificates, memory of k^2.
        """
        position = np.concatenate([samples.position for samples in flights])
        for axis, values in zip("xy", position.T, strict=True):
            if self.family == "cells" and not values.any():
                raise InputError(
                    f"the flight stays on the line {axis} = 0, where the candidates of sin {axis} "
                    "are zero: no length scale can be told; leave that line"
                )
        if self.every > 1 and any(samples.averages for samples in flights):
            raise InputError(
                "library: 'every' thins samples, but the weak form has averages of its own; leave "
                "it out, or use a larger window"
            )
        columns = self._columns(extent_of(position))
        size, per = len(columns["names"]), 1 if self.family == "cells" else 2
        sources = [samples.source.every(self.every) for samples in flights]
        count = per * sum(len(source.time) for source in sources)
        large = 8 * count * size > STREAM_BYTES and count > size + 4

        def blocks(source: Samples) -> Iterator[tuple[slice, Array]]:
            """The rows of theta, in blocks of bounded memory, and which they are."""
            for rows, psi, place in source.blocks(4096 if large else len(source.position)):
                if self.family == "cells":
                    theta = candidate_columns(place, columns["group_scales"])
                else:
                    theta = wave_columns(place, columns["parameters"])
                if psi is not None:
                    theta = (psi @ theta.reshape(len(place), -1)).reshape(-1, size)
                yield slice(per * rows.start, per * rows.stop), theta

        parts, every = [], zip(sources, vehicles, weights, strict=True)
        for number, (source, vehicle, weight) in enumerate(every, 1):
            with told_with(f"flight {number}" if len(flights) > 1 else ""):
                target = self.response(source, vehicle).reshape(per * len(source.time), -1)
                basis = UnknownColumns(self.unknown, vehicle).basis(source, shared=per == 2)
                if large:
                    triangle, target = compressed(
                        (np.hstack([basis[rows], theta]), target[rows])
                        for rows, theta in blocks(source)
                    )
                    basis, theta = np.split(triangle, [basis.shape[1]], axis=1)
                else:
                    theta = _stacked([theta for _, theta in blocks(source)])
                if self.unknown:
                    theta, target = project_out(basis, theta, target)
                parts.append((theta, target) if weight == 1 else (weight * theta, weight * target))
        theta, target = map(_stacked, zip(*parts, strict=True))
        names = TARGET_NAMES[self.target]
        return RegressionProblem(
            theta,
            target,
            target_names=names if per == 1 else (" ".join(names),),
            sample_count=count if large else None,
            **columns,
        )


def _stacked(parts: Sequence[Array]) -> Array:
    """Blocks of rows as one array, and a single one as it is."""
    return parts[0] if len(parts) == 1 else np.concatenate(parts)
