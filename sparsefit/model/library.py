"""Candidate functions over a grid, and the regression problem they make.

Two families: the paper's cells (Eqs. 17-19), for every length scale L the 8 products and singles of
sin and cos of pi x / L and pi y / L, with weights for each velocity component; and ``waves``, those
of a stream function over the plane of wavevectors, cells of any heading and shape among them. Both
components share the weights of a wave: theta has a row for each, x before y, sample after sample.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Literal, get_args

import numpy as np

from sparsefit.arrays import Array, IntArray
from sparsefit.errors import InputError, integer, one_of, told_of
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.model.columns import CANDIDATES, candidate_columns, wave_names, wave_theta
from sparsefit.model.grid import Bounds, LengthScaleGrid, extent_of, wave_rings
from sparsefit.model.unknowns import UnknownColumns, checked_unknowns, project_out
from sparsefit.regression.problem import RegressionProblem, compressed
from sparsefit.rows import Samples

Target = Literal["flow-velocity", "acceleration", "state-derivative"]
FamilyName = Literal["cells", "waves"]
WaveGroups = Literal["wave", "ring", "nested"]

TARGET_NAMES: dict[str, tuple[str, ...]] = {
    "flow-velocity": ("w_x", "w_y"),
    "acceleration": ("dv_x/dt", "dv_y/dt"),
    "state-derivative": ("dx/dt", "dy/dt", "dv_x/dt", "dv_y/dt"),
}
STREAM_BYTES = 2**30  # beyond this, theta is compressed as it is built


@dataclass(frozen=True, eq=False)
class GridColumns:
    """The columns of theta before any flight is put into them.

    Args:
        family: of the columns.
        parameters: of the modes on the grid, (s, p): k [1/m], or wavevectors [rad/m].
        group: of each column (k,).
        scales: the length scale of each group (g,) [m].
        names: of the columns (k,).
        subgroups: the mode of each column (k,), where modes are groups within their groups.
    """

    family: FamilyName
    parameters: Array
    group: IntArray
    scales: Array
    names: tuple[str, ...]
    subgroups: IntArray | None = None

    @property
    def components(self) -> int:
        """Rows of a sample: 2 where the velocity components share their weights."""
        return 1 if self.family == "cells" else 2

    def at(self, position: Array) -> Array:
        """Theta at positions (m, 2) [m]; InputError where it would not fit in memory."""
        if self.family == "cells":
            return candidate_columns(position, self.scales)
        return wave_theta(position, self.parameters)

    def blocks(self, source: Samples, *, whole: bool) -> Iterator[tuple[slice, Array]]:
        """Rows of theta in blocks, of samples or of averages of them, and which they are.

        whole: whether all samples are one block.
        """
        per, size = self.components, len(self.names)
        if whole and source.operator is None:
            yield slice(0, per * len(source.time)), self.at(source.position)
            return
        for rows, psi, position in source.blocks():
            values = self.at(position)
            if psi is not None:
                values = (psi @ values.reshape(len(position), -1)).reshape(-1, size)
            yield slice(per * rows.start, per * rows.stop), values


@dataclass(frozen=True)
class Library:
    """The library builder: candidates of a family over a grid, and what they are regressed on.

    ``target``: ``flow-velocity`` Phi = tau (v' - a) + v (Eq. 23), ``acceleration`` v', or
    ``state-derivative`` (x', v'), the literal reading of Eq. 20.
    ``unknown``: what is estimated with the flow, of `sparsefit.model.unknowns.UNKNOWNS`; the rest
    is as the vehicle says, and the air at rest but for the flow.
    ``family``: ``cells`` or ``waves``. Waves have one weight for both velocity components, and
    their one target is the flow velocity.
    ``groups`` of waves, between the length scales of ``grid``: the ``wave``, the ``ring`` of waves
    of one |k|, which is the length scale, or ``nested``: waves within rings, for penalties of
    groups in groups.
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
        if self.family != "cells" and self.target != "flow-velocity":
            raise InputError(
                "family 'waves' is of a stream function, which gives the flow velocity: "
                f"target {self.target!r} needs family 'cells'"
            )
        if self.family != "waves" and self.groups != "wave":
            raise InputError(
                f"library: 'groups' is a setting of family 'waves', not of {self.family!r}; "
                "leave it out"
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

    def columns(self, position: Array) -> GridColumns:
        """The columns that the grid gives flights at positions (m, 2) [m].

        Raises InputError where they are too many to hold.
        """
        extent = extent_of(position)
        if self.family == "waves":
            k, ring, scales = wave_rings(self.grid.lower, self.grid.upper, extent)
            wave, names = np.repeat(np.arange(len(k)), 2), wave_names(k)
            if self.groups == "wave":
                return GridColumns("waves", k, wave, scales[ring], names)
            nested = wave if self.groups == "nested" else None
            return GridColumns("waves", k, np.repeat(ring, 2), scales, names, nested)
        scales = self.grid.resolving(extent).scales
        words = [f" (L = {scale:g} m)" for scale in scales.tolist()]
        names = tuple(name + scale for scale in words for name in CANDIDATES)
        group = np.repeat(np.arange(len(scales)), len(CANDIDATES))
        return GridColumns("cells", math.pi / scales[:, None], group, scales, names)

    def build(self, samples: Samples, vehicle: PointMassVehicle) -> RegressionProblem:
        """The regression problem of a flight: theta (m, 8 g), group-major, and the target.

        Of waves theta has two rows a sample, x and y, and one column of the target.
        """
        return self.build_flights([samples], [vehicle], [1.0])

    def build_flights(
        self,
        flights: Sequence[Samples],
        vehicles: Sequence[PointMassVehicle],
        weights: Sequence[float],
    ) -> RegressionProblem:
        """The problem of flights through one flow: the rows of each times its weight.

        Gram matrices add up. What is unknown of a flight is taken from its own rows.

        Where theta would exceed 1 GiB it is compressed block by block
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
        columns = self.columns(position)
        sources = [samples.source for samples in flights]
        if self.every > 1:
            sources = [samples.every(self.every) for samples in flights]
        targets = []
        for source, vehicle in zip(sources, vehicles, strict=True):
            response = self.response(source, vehicle)
            targets.append(response.reshape(-1, response.shape[1] // columns.components))
        rows, size = sum(map(len, targets)), len(columns.names)
        large = rows * size * 8 > STREAM_BYTES and rows > size + targets[0].shape[1]

        def rows_of(number: int) -> Iterator[tuple[slice, Array, Array]]:
            source, target, weight = sources[number], targets[number], weights[number]
            for rows, theta in columns.blocks(source, whole=not large):
                own = target[rows]
                yield (rows, theta, own) if weight == 1.0 else (rows, weight * theta, weight * own)

        def blocks() -> Iterator[tuple[Array, Array]]:
            again: Callable[[], Iterable[tuple[slice, Array, Array]]]
            for number, (source, vehicle) in enumerate(zip(sources, vehicles, strict=True)):
                with told_of("flight", number + 1, len(flights)):
                    if not self.unknown:
                        yield from ((theta, target) for _, theta, target in rows_of(number))
                        continue
                    unknowns = UnknownColumns(self.unknown, vehicle)
                    basis = unknowns.basis(source, shared=columns.components == 2)
                    again = partial(rows_of, number)
                    if not large:  # built once, as they are few
                        again = partial(list, list(rows_of(number)))
                    yield from project_out(basis, again)

        if large:
            theta, target = compressed(blocks())
        else:
            theta, target = (
                part[0] if len(part) == 1 else np.concatenate(part)
                for part in zip(*blocks(), strict=True)
            )
        names = TARGET_NAMES[self.target]
        return RegressionProblem(
            theta,
            target,
            columns.group,
            columns.names,
            names if columns.components == 1 else (" ".join(names),),
            columns.scales,
            rows if large else None,
            columns.subgroups,
            columns.parameters,
        )
