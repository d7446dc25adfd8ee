"""Candidate functions over a grid, columns of unknown parameters, and their regression problem.

Two families of candidates: the paper's cells (Eqs. 17-19), for every length scale L the 8 products
and singles of sin and cos of pi x / L and pi y / L, with weights for each velocity component; and
``waves``, those of a stream function over the plane of wavevectors, cells of any heading and shape
among them. Both components share the weights of a wave: theta has a row for each, x before y,
sample after sample.

With the assumed parameters tau_0, a_0 of the vehicle, Phi_0 = tau_0 (v' - a_0) + v,
and v' = (C W + wind - v)/tau + a gives

    Phi_0 = (tau_0/tau) C W + (1 - tau_0/tau) v + [tau_0 (a - a_0) + (tau_0/tau) wind]:

linear in a coefficient of v and a constant per component. A measured thrust m(t) with the scale s,
assumed to be s_0, adds a column: tau_0 (s - s_0) m. If drag is quadratic only, Phi_0 =
v + r_0 with c_0 |r_0| r_0 = v' - a, and w = v + r_0 sqrt(c_0/c): linear in v with sqrt(c/c_0) in
the place of tau_0/tau. These columns N join the regression without a penalty: minimising over them
first gives a problem in (I - P_N) C and (I - P_N) Phi_0 (Frisch and Waugh, 1933; Lovell, 1963).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
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
from sparsefit.regression.problem import RegressionProblem, compressed
from sparsefit.rows import Samples

Target = Literal["flow-velocity", "acceleration", "state-derivative"]
FamilyName = Literal["cells", "waves"]
WaveGroups = Literal["wave", "nested"]

UNKNOWNS = ("response_time", "drag", "thrust_scale", "thrust_acceleration", "wind")
Pair = tuple[float, float]

TARGET_NAMES: dict[str, tuple[str, ...]] = {
    "flow-velocity": ("w_x", "w_y"),
    "acceleration": ("dv_x/dt", "dv_y/dt"),
    "state-derivative": ("dx/dt", "dy/dt", "dv_x/dt", "dv_y/dt"),
}
STREAM_BYTES = 2**30  # a larger theta is compressed as it is built
BLOCK = 1024  # rows of it at once


@dataclass(frozen=True)
class UnknownColumns:
    """The columns of the unknown parameters: v, m, and a constant per component.

    Raises InputError if an unknown is not linear under the drag law of the assumed vehicle.
    """

    unknown: tuple[str, ...]
    believed: PointMassVehicle

    def __post_init__(self) -> None:
        law, possible = "without quadratic drag", set(UNKNOWNS) - {"drag"}
        if math.isinf(self.believed.response_time):
            law, possible = "with quadratic drag", {"drag", "wind"}
        elif self.believed.drag:
            law, possible = "with linear and quadratic drag", {"wind"}
        for name in sorted(set(self.unknown) - possible):
            raise InputError(
                f"unknown {name!r} cannot be sought of a vehicle {law}, whose rows are linear in "
                f"{' and '.join(sorted(possible))} alone: leave it out, or give another vehicle"
            )

    @property
    def scaled(self) -> bool:
        """Whether v is a column: tau or c is unknown."""
        return bool({"response_time", "drag"} & set(self.unknown))

    def columns(self, source: Samples) -> Array:
        """N (m, 2, p) of m rows: v, the measured thrust, then a constant in x and in y.

        Raises InputError if the scale of a thrust is unknown that was not measured.
        """
        columns = [source.velocity] if self.scaled else []
        if "thrust_scale" in self.unknown:
            if source.push is None:
                words = "needs a measured thrust: the flight has none (columns ax, ay of its file)"
                raise InputError(f"unknown 'thrust_scale' {words}")
            columns.append(source.push)
        if {"thrust_acceleration", "wind"} & set(self.unknown):
            columns += [np.broadcast_to(unit, source.velocity.shape) for unit in np.eye(2)]
        if not columns:
            return np.zeros((*source.velocity.shape, 0))
        return np.stack(columns, axis=2)

    def basis(self, source: Samples, *, shared: bool) -> Array:
        """An orthonormal basis (2 m, r) of the span of N, or (m, r) of its series.

        shared: whether both components share coefficients (waves), with rows x before y of each
        sample, or have separate weights on one theta (cells).
        """
        columns = self.columns(source)
        rows = columns.reshape(2 * len(columns), -1)
        if not shared:
            moving = columns[:, :, : self.scaled + ("thrust_scale" in self.unknown)]
            constant = np.ones((len(columns), int(columns.shape[2] > moving.shape[2])))
            rows = np.hstack([*moving.transpose(2, 0, 1), constant])
        vectors, roots, _ = np.linalg.svd(rows, full_matrices=False)
        basis: Array = vectors[:, roots > 1e-10 * roots.max(initial=0.0)]
        return basis

    def read(self, coefficients: Array) -> tuple[PointMassVehicle, Pair, float]:
        """The vehicle, the wind and tau_0/tau from coefficients (p,).

        The ratio, by which Phi of the assumed vehicle is too large, is sqrt(c/c_0) for quadratic
        drag; it is NaN, and the vehicle the assumed one, if the coefficients are not physical.
        """
        vehicle, tau = self.believed, self.believed.response_time
        ratio = 1.0 - float(coefficients[0]) if self.scaled else 1.0
        if not ratio > 0 or not np.isfinite(coefficients).all():
            return vehicle, (0.0, 0.0), math.nan
        changes: dict[str, Any] = {}
        x, y = coefficients[-2:].tolist() if len(coefficients) > 1 else (0.0, 0.0)
        if "thrust_scale" in self.unknown:
            push = float(coefficients[int(self.scaled)]) / tau
            changes["thrust_scale"] = vehicle.thrust_scale + push
        if "thrust_acceleration" in self.unknown:
            given = vehicle.thrust_acceleration
            changes["thrust_acceleration"] = given[0] + x / tau, given[1] + y / tau
        if "response_time" in self.unknown:
            changes["response_time"] = tau / ratio
        if "drag" in self.unknown:
            changes["drag"] = vehicle.drag * ratio**2
        wind = (x / ratio, y / ratio) if "wind" in self.unknown else (0.0, 0.0)
        return replace(vehicle, **changes), wind, ratio


def side_by_side(parts: Sequence[UnknownColumns], sources: Sequence[Samples]) -> Array:
    """The block-diagonal N (m, 2, f p) of the rows of f flights."""
    own = [part.columns(source) for part, source in zip(parts, sources, strict=True)]
    flight = np.repeat(np.eye(len(own)), [len(columns) for columns in own], axis=0)
    columns = flight[:, None, :, None] * np.concatenate(own)[:, :, None]
    return columns.reshape(len(flight), 2, -1)


def project_out(basis: Array, theta: Array, target: Array) -> tuple[Array, Array]:
    """(I - Q Q') theta and target, Q (m, r) orthonormal.

    Raises InputError if a candidate is in the span of Q.
    """
    squares = np.einsum("ij,ij->j", theta, theta)
    theta = theta - basis @ (basis.T @ theta)
    if (np.einsum("ij,ij->j", theta, theta) <= 1e-18 * squares).any():  # the rest is rounding
        words = "the flight is too straight to tell what is unknown; turn, or give the vehicle"
        raise InputError(f"a candidate is a combination of the velocity and a constant: {words}")
    return theta, target - basis @ (basis.T @ target)


@dataclass(frozen=True)
class Library:
    """The library builder: candidates of a family over a grid, and the target of the regression.

    ``target``: ``flow-velocity`` Phi = tau (v' - a) + v (Eq. 23), ``acceleration`` v', or
    ``state-derivative`` (x', v'), the literal reading of Eq. 20.
    ``unknown``: the parameters estimated with the flow, of `sparsefit.model.library.UNKNOWNS`; the
    others are those of the vehicle, without wind.
    ``family``: ``cells`` or ``waves``. Waves have one weight for both velocity components, and only
    the flow velocity as target.
    ``groups`` of waves, between the length scales of ``grid``: each ``wave``, or ``nested``: waves
    within rings of one |k|, which is a length scale, for penalties of nested groups.
    ``every``: rows are every n-th sample, as the samples of a smoothed flight are redundant; the
    search and the likelihood still use all. Raises InputError for settings out of range.
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
        integer("library: every", self.every, 1)
        for name in self.unknown:
            one_of("parameter of the vehicle", name, UNKNOWNS)
        unknown = tuple(name for name in UNKNOWNS if name in self.unknown)
        problem, other = "", self.target != "flow-velocity"
        if not isinstance(self.grid, LengthScaleGrid):
            problem = f"grid must be a LengthScaleGrid, not a {type(self.grid).__name__}"
        elif self.family == "waves" and other:
            problem = f"target {self.target!r} needs family 'cells': waves give the flow velocity"
        elif self.family == "cells" and self.groups != "wave":
            problem = "'groups' is a setting of family 'waves', not of 'cells'; leave it out"
        elif {"thrust_acceleration", "wind"} <= set(unknown):
            problem = "thrust_acceleration and wind cannot both be unknown; give one of them"
        elif unknown and other:
            problem = f"unknown {unknown[0]!r} needs the target 'flow-velocity'"
        if problem:
            raise InputError(f"library: {problem}")
        object.__setattr__(self, "unknown", unknown)

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
        """The columns of the grid for a flight of that extent [m], as fields of a problem."""
        if self.family == "cells":
            scales = self.grid.resolving(extent).scales
            return {
                "names": tuple(
                    f"{own} (L = {s:g} m)" for s in scales.tolist() for own in CANDIDATES
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

        Theta is (m, 8 g), group-major, for cells; for waves it has two rows a sample, x and y, and
        one target. The columns of a flight's unknowns are projected out of its rows. A theta of
        more than 1 GiB is compressed block by block (`problem.compressed`): equal solutions and
        certificates in memory of k^2.
        """
        position = np.concatenate([samples.position for samples in flights])
        for axis, values in zip("xy", position.T, strict=True):
            if self.family == "cells" and not values.any():
                raise InputError(
                    f"the flight stays on the line {axis} = 0, where the candidates of sin {axis} "
                    "are zero: no length scale can be told; leave that line"
                )
        if self.every > 1 and any(samples.averages for samples in flights):
            words = "'every' thins samples, but the weak form has averages of its own; leave it out"
            raise InputError(f"library: {words}")
        columns = self._columns(extent_of(position))
        size, per = len(columns["names"]), 1 if self.family == "cells" else 2
        thin = slice(None, None, self.every)
        sources = [(samples.averages or samples).rows(thin) for samples in flights]
        count = per * sum(len(source.time) for source in sources)
        large = 8 * per * len(position) * size > STREAM_BYTES and count > size + 4

        def theta_of(source: Samples) -> Array:
            if self.family == "cells":
                return source.averaged(candidate_columns(source.position, columns["group_scales"]))
            return source.averaged(wave_columns(source.position, columns["parameters"]))

        parts, every = [], zip(sources, vehicles, weights, strict=True)
        for number, (source, vehicle, weight) in enumerate(every, 1):
            with told_with(f"flight {number}" if len(flights) > 1 else ""):
                target = self.response(source, vehicle).reshape(per * len(source.time), -1)
                basis = UnknownColumns(self.unknown, vehicle).basis(source, shared=per == 2)
                if large:
                    starts = range(0, len(source.time), BLOCK)
                    ends = per * np.array(starts[1:], dtype=np.intp)
                    thetas = (theta_of(source.rows(slice(i, i + BLOCK))) for i in starts)
                    blocks = zip(np.split(basis, ends), thetas, np.split(target, ends), strict=True)
                    triangle, target = compressed((np.hstack(own[:2]), own[2]) for own in blocks)
                    basis, theta = np.split(triangle, [basis.shape[1]], axis=1)
                else:
                    theta = theta_of(source)
                if self.unknown:
                    theta, target = project_out(basis, theta, target)
                if weight != 1:
                    theta, target = weight * theta, weight * target
                parts.append((theta, target))
        if len(parts) > 1:
            theta, target = map(np.concatenate, zip(*parts, strict=True))
        names = TARGET_NAMES[self.target]
        return RegressionProblem(
            theta,
            target,
            target_names=names if per == 1 else (" ".join(names),),
            sample_count=count if large else None,
            **columns,
        )
