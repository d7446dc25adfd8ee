"""Candidate functions over a grid, and the regression problem they make.

Three families: the paper's cells (Eqs. 17-19), for every length scale L the 8 products and singles
of sin and cos of pi x / L and pi y / L, with weights for each velocity component; ``stream``, the 4
amplitudes of a stream function for every L, which both components share; ``waves``, the waves of a
stream function over the plane of wavevectors, cells of any heading and shape among them.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from sparsefit.arrays import Array
from sparsefit.derivative import Samples, WeakRows
from sparsefit.errors import InputError, integer_setting, one_of, told_of
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.library.columns import LibraryColumns, cell_columns, stream_columns, wave_columns
from sparsefit.library.continuum import EQUATION_1, CellContinuum
from sparsefit.library.grid import LengthScaleGrid
from sparsefit.library.nuisance import Nuisance, checked_unknowns, project_out, refuse_spanned
from sparsefit.library.scan import extent_of
from sparsefit.library.wave_continuum import WaveContinuum
from sparsefit.library.wave_grid import WaveGrid
from sparsefit.regression.problem import RegressionProblem, compressed
from sparsefit.regression.statistics import Statistics

Target = Literal["flow-velocity", "acceleration", "state-derivative"]
FamilyName = Literal["cells", "stream", "waves"]
WaveGroups = Literal["wave", "ring", "nested"]

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
    ``unknown``: what is estimated with the flow, of ``response_time``, ``drag``, ``thrust_scale``,
    ``thrust_acceleration`` and ``wind`` (`sparsefit.library.nuisance`); what is not is as the
    vehicle says, the wind 0.
    ``family``: ``cells``, ``stream`` or ``waves``. Those of a stream function have one weight for
    both velocity components, and their one target is the flow velocity.
    ``waves``: how fine the wavevectors of ``waves`` are; ``grid`` gives the bounds of the length
    scale. ``groups``: what its groups are: the ``wave``, the ``ring`` of waves of one |k|, which is
    the length scale, or ``nested``: waves within rings, for penalties of groups in groups.
    ``every``: rows are every so many-th sample, where a smoothed flight has more than it has to
    say; what is refined off the grid still takes all. Raises InputError on settings out of range.
    """

    grid: LengthScaleGrid = LengthScaleGrid()
    target: Target = "flow-velocity"
    unknown: tuple[str, ...] = ()
    family: FamilyName = "cells"
    waves: WaveGrid = WaveGrid()
    groups: WaveGroups = "wave"
    every: int = 1

    def __post_init__(self) -> None:
        one_of("target", self.target, TARGET_NAMES)
        one_of("family of the library", self.family, get_args(FamilyName))
        one_of("groups of the library", self.groups, get_args(WaveGroups))
        if self.family != "cells" and self.target != "flow-velocity":
            raise InputError(
                f"family {self.family!r} is of a stream function, which gives the flow velocity: "
                f"target {self.target!r} needs family 'cells'"
            )
        if self.family != "waves" and (self.groups != "wave" or self.waves != WaveGrid()):
            setting = "groups" if self.groups != "wave" else "waves"
            raise InputError(
                f"library: {setting!r} is a setting of family 'waves', not of {self.family!r}; "
                "leave it out"
            )
        integer_setting("library", "every", self.every, least=1)
        object.__setattr__(self, "unknown", checked_unknowns(self.unknown, self.target))

    def response(self, samples: Samples | WeakRows, vehicle: PointMassVehicle) -> Array:
        """What the candidates are regressed on, (m, n), one row per sample."""
        if self.target == "flow-velocity":
            return samples.flow_velocity(vehicle)
        if self.target == "acceleration":
            return samples.acceleration
        return np.hstack([samples.position_rate, samples.acceleration])

    def build(self, samples: Samples, vehicle: PointMassVehicle) -> RegressionProblem:
        """The regression problem of a flight: theta (m, 8 g), group-major, and the target.

        Of a stream function theta has two rows a sample, x and y, and one column of the target.
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
        (`RegressionProblem.from_blocks`): the same solutions and certificates, memory of k^2.
        """
        position = _stacked([samples.position for samples in flights])
        if self.family == "cells":
            _refuse_axes(position)
        columns = self.columns(position)
        thinned = [self._thinned(samples) for samples in flights]
        sources = [samples.weak or samples for samples in thinned]
        targets = [self._target(*pair, columns) for pair in zip(sources, vehicles, strict=True)]
        rows, size = sum(map(len, targets)), columns.size
        large = rows * size * 8 > STREAM_BYTES and rows > size + targets[0].shape[1]
        each = [
            self._blocks(source, vehicle, target, columns, large)
            for source, vehicle, target in zip(sources, vehicles, targets, strict=True)
        ]
        blocks = _weighted(each, weights)
        if large:
            triangle, _, _ = compressed(blocks)
            theta, target = triangle[:, :size].copy(), triangle[:, size:].copy()
            return self._problem(theta, target, columns, rows, None)
        theta, target = (_stacked(part) for part in zip(*blocks, strict=True))
        if self.unknown or thinned[0].weak:
            return self._problem(theta, target, columns, None, None)
        counts = [len(samples.time) for samples in thinned]
        weight = np.repeat(weights, counts) if len(flights) > 1 else None
        place = _stacked([samples.position for samples in thinned])
        return self.of_rows(place, theta, target, columns, weight=weight)

    def of_rows(
        self,
        position: Array,
        theta: Array,
        target: Array,
        columns: LibraryColumns,
        *,
        sums: Statistics | None = None,
        weight: Array | None = None,
    ) -> RegressionProblem:
        """The problem of rows theta (m, k) and target (m, n) that are there already.

        position: of the samples (m, 2) [m]; sums: the statistics of the rows, where they are known;
        weight (m,): of the samples' rows, of several flights.
        """
        if self.family == "cells":
            _refuse_axes(position)
        continuum = self._continuum(position, columns, weight)
        own = len(target) if self.family == "cells" else None
        return self._problem(theta, target, columns, own, continuum, sums)

    def _target(
        self, source: Samples | WeakRows, vehicle: PointMassVehicle, columns: LibraryColumns
    ) -> Array:
        """What the candidates are regressed on, a row for each of theta's."""
        response = self.response(source, vehicle)
        return response.reshape(-1, response.shape[1] // columns.components)

    def _blocks(
        self,
        source: Samples | WeakRows,
        vehicle: PointMassVehicle,
        target: Array,
        columns: LibraryColumns,
        large: bool,
    ) -> Iterator[tuple[Array, Array]]:
        """Rows of theta and of the target of a flight, less what is unknown of it explains."""
        if self.unknown or isinstance(source, WeakRows):
            yield self._reduced(source, vehicle, target, columns, large)
        elif large:
            for rows, block in columns.blocks(source):
                yield block, target[rows]
        else:
            yield columns.at(source.position), target

    def columns(self, position: Array) -> LibraryColumns:
        """The columns that the grid gives flights at positions (m, 2) [m].

        Raises InputError where they are too many to hold.
        """
        extent = extent_of(position)
        if self.family == "waves":
            rings = self.waves.rings(self.grid.lower, self.grid.upper, extent)
            return wave_columns(rings, self.groups)
        scales = self.grid.resolving(extent).scales
        return cell_columns(scales) if self.family == "cells" else stream_columns(scales)

    def _continuum(
        self, position: Array, columns: LibraryColumns, weight: Array | None = None
    ) -> CellContinuum | WaveContinuum | None:
        """The columns between those of the grid, at positions (m, 2) [m], where they are known.

        weight (m,): of their rows, of several flights.
        """
        low, high = (float(np.pi / scale) for scale in (columns.scales.max(), columns.scales.min()))
        if self.family == "cells":
            pattern = EQUATION_1 if self.target == "flow-velocity" else None
            return CellContinuum(position, (low, high), pattern, weight)
        if self.family == "waves" and self.groups == "wave" and weight is None:
            return WaveContinuum(position, (low, high))
        return None

    def _thinned(self, samples: Samples) -> Samples:
        if self.every == 1:
            return samples
        if samples.weak:
            raise InputError(
                "library: 'every' thins samples, but the weak form has averages of its own; leave "
                "it out, or use a larger window"
            )
        return samples.every(self.every)

    def _reduced(
        self,
        source: Samples | WeakRows,
        vehicle: PointMassVehicle,
        target: Array,
        columns: LibraryColumns,
        large: bool,
    ) -> tuple[Array, Array]:
        """theta and target averaged by test functions, less what the unknown columns explain.

        Folding [Q, theta, target] into a triangle, Q a basis of those columns, and dropping the
        first rows and columns of it, takes the projection in the same pass.
        """
        size = columns.size
        basis = np.zeros((len(target), 0))
        if self.unknown:
            basis = Nuisance(self.unknown, vehicle).basis(
                source.velocity, source.thrust, shared=columns.components == 2
            )
        pieces = columns.blocks(source)
        if not large:
            theta = np.vstack([block for _, block in pieces])
            return project_out(basis, theta, target)
        triangle, _, _ = compressed(
            (np.hstack([basis[rows], block]), target[rows]) for rows, block in pieces
        )
        skip = basis.shape[1]
        left = triangle[skip:, skip:].copy()
        before = np.linalg.norm(triangle[:, skip : skip + size], axis=0)
        refuse_spanned(np.linalg.norm(left[:, :size], axis=0), before)
        return left[:, :size].copy(), left[:, size:].copy()

    def _problem(
        self,
        theta: Array,
        target: Array,
        columns: LibraryColumns,
        count: int | None,
        continuum: CellContinuum | WaveContinuum | None,
        sums: Statistics | None = None,
    ) -> RegressionProblem:
        names = TARGET_NAMES[self.target]
        return RegressionProblem(
            theta,
            target,
            columns.groups,
            columns.names,
            names if columns.components == 1 else (" ".join(names),),
            columns.scales,
            count,
            continuum,
            columns.subgroups,
            columns.parameters,
            sums,
        )


def _weighted(
    flights: Sequence[Iterator[tuple[Array, Array]]], weights: Sequence[float]
) -> Iterator[tuple[Array, Array]]:
    """The blocks of rows of all flights, each times the weight of its flight."""
    for number, (blocks, weight) in enumerate(zip(flights, weights, strict=True), 1):
        with told_of("flight", number, len(flights)):
            for theta, target in blocks:
                yield (theta, target) if weight == 1.0 else (weight * theta, weight * target)


def _stacked(arrays: Sequence[Array]) -> Array:
    """The rows of all arrays; one alone as it is."""
    return arrays[0] if len(arrays) == 1 else np.concatenate(arrays)


def _refuse_axes(position: Array) -> None:
    """InputError where a flight stays on a line on which candidates are zero."""
    for axis, values in zip("xy", position.T, strict=True):
        if not values.any():
            raise InputError(
                f"the flight stays on the line {axis} = 0, where the candidates of sin {axis} "
                "are zero: no length scale can be told; leave that line"
            )
