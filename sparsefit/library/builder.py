"""Candidate functions over a grid of length scales, and the regression problem they make.

Paper Eqs. 17-19: for every length scale L the 8 products and singles of sin and cos of
pi x / L and pi y / L. Column groups: the 8 columns of one length scale.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from sparsefit.arrays import Array
from sparsefit.derivative import Samples, WeakRows
from sparsefit.errors import InputError, one_of
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.library.cells import CANDIDATES, candidate_columns
from sparsefit.library.continuum import EQUATION_1, CellContinuum
from sparsefit.library.grid import LengthScaleGrid
from sparsefit.library.nuisance import Nuisance, checked_unknowns, project_out, refuse_spanned
from sparsefit.library.scan import extent_of
from sparsefit.regression.problem import RegressionProblem, compressed
from sparsefit.regression.statistics import row_blocks

Target = Literal["flow-velocity", "acceleration", "state-derivative"]

TARGET_NAMES: dict[str, tuple[str, ...]] = {
    "flow-velocity": ("w_x", "w_y"),
    "acceleration": ("dv_x/dt", "dv_y/dt"),
    "state-derivative": ("dx/dt", "dy/dt", "dv_x/dt", "dv_y/dt"),
}
STREAM_BYTES = 2**30  # beyond this, theta is compressed as it is built


@dataclass(frozen=True)
class Library:
    """The library builder: candidates over ``grid``, and what they are regressed on.

    ``target``: ``flow-velocity`` Phi = tau (v' - a) + v (Eq. 23), ``acceleration`` v', or
    ``state-derivative`` (x', v'), the literal reading of Eq. 20.
    ``unknown``: what is estimated with the flow, of ``response_time``, ``thrust_acceleration`` and
    ``wind`` (`sparsefit.library.nuisance`); what is not is as the vehicle says, the wind 0.
    """

    grid: LengthScaleGrid = LengthScaleGrid()
    target: Target = "flow-velocity"
    unknown: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        one_of("target", self.target, TARGET_NAMES)
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

        Flights whose theta would exceed 1 GiB are compressed block by block
        (`RegressionProblem.from_blocks`): the same solutions and certificates, memory of k^2.
        """
        scales = self.grid.resolving(extent_of(samples.position)).scales
        for axis, values in zip("xy", samples.position.T, strict=True):
            if not values.any():
                raise InputError(
                    f"the flight stays on the line {axis} = 0, where the candidates of sin {axis} "
                    "are zero: no length scale can be told; leave that line"
                )
        source = samples.weak or samples
        held = len(source.time) * len(scales) * len(CANDIDATES) * 8
        target = self.response(source, vehicle)
        columns = len(scales) * len(CANDIDATES)
        large = held > STREAM_BYTES and len(source.time) > columns + target.shape[1]
        if samples.weak or self.unknown:
            theta, target, rows = self._reduced(source, vehicle, target, scales, large)
            return self._problem(theta, target, scales, rows, None)
        if large:
            pieces = row_blocks(samples.position, target)
            triangle, count, _ = compressed(
                (candidate_columns(position, scales), values) for position, values in pieces
            )
            theta, target = triangle[:, :columns].copy(), triangle[:, columns:].copy()
            return self._problem(theta, target, scales, count, None)
        theta = candidate_columns(samples.position, scales)
        pattern = EQUATION_1 if self.target == "flow-velocity" else None
        bounds = float(np.pi / scales.max()), float(np.pi / scales.min())
        continuum = CellContinuum(samples.position, bounds, pattern)
        return self._problem(theta, target, scales, len(target), continuum)

    def _reduced(
        self,
        source: Samples | WeakRows,
        vehicle: PointMassVehicle,
        target: Array,
        scales: Array,
        large: bool,
    ) -> tuple[Array, Array, int | None]:
        """theta and target averaged by test functions, less what the unknown columns explain.

        Folding [Q, theta, target] into a triangle, Q a basis of those columns, and dropping the
        first rows and columns of it, takes the projection in the same pass.
        """
        size = len(scales) * len(CANDIDATES)
        basis = np.zeros((len(target), 0))
        if self.unknown:
            basis = Nuisance(self.unknown, vehicle).basis(source.velocity)
        pieces = _candidate_blocks(source, scales)
        if not large:
            theta = np.vstack([block for _, block in pieces])
            return (*project_out(basis, theta, target), None)
        triangle, count, _ = compressed(
            (np.hstack([basis[rows], block]), target[rows]) for rows, block in pieces
        )
        skip = basis.shape[1]
        left = triangle[skip:, skip:].copy()
        before = np.linalg.norm(triangle[:, skip : skip + size], axis=0)
        refuse_spanned(np.linalg.norm(left[:, :size], axis=0), before)
        return left[:, :size].copy(), left[:, size:].copy(), count

    def _problem(
        self,
        theta: Array,
        target: Array,
        scales: Array,
        count: int | None,
        continuum: CellContinuum | None,
    ) -> RegressionProblem:
        return RegressionProblem(
            theta,
            target,
            np.repeat(np.arange(len(scales)), len(CANDIDATES)),
            tuple(f"{name} (L = {scale:g} m)" for scale in scales for name in CANDIDATES),
            TARGET_NAMES[self.target],
            scales,
            count,
            continuum,
        )


def _candidate_blocks(source: Samples | WeakRows, scales: Array) -> Iterator[tuple[slice, Array]]:
    """Rows of theta in blocks: samples, or averages of them."""
    if isinstance(source, WeakRows):
        for rows, weights, position in source.blocks():
            yield rows, weights @ candidate_columns(position, scales)
        return
    start = 0
    for (position,) in row_blocks(source.position):
        yield slice(start, start + len(position)), candidate_columns(position, scales)
        start += len(position)
