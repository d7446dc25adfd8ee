"""Unknowns beside the flow, in the rows of the search: the vehicle's parameters and a steady wind.

With the parameters tau_0, a_0 that the vehicle is believed to have, Phi_0 = tau_0 (v' - a_0) + v,
and v' = (C W + wind - v)/tau + a gives

    Phi_0 = (tau_0/tau) C W + (1 - tau_0/tau) v + [tau_0 (a - a_0) + (tau_0/tau) wind]:

linear in a coefficient of v and a constant per component. Of a measured thrust m(t) that is scaled
by s, believed to be s_0, one column more: tau_0 (s - s_0) m. Where drag is quadratic only, Phi_0 =
v + r_0 with c_0 |r_0| r_0 = v' - a, and w = v + r_0 sqrt(c_0/c): linear in v with sqrt(c/c_0) in
the place of tau_0/tau. These columns N join the regression without a penalty: minimising over them
first leaves a problem in (I - P_N) C and (I - P_N) Phi_0 (Frisch and Waugh, 1933; Lovell, 1963),
exactly, for every back-end.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sparsefit.arrays import Array
from sparsefit.errors import InputError, one_of
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.rows import Samples

UNKNOWNS = ("response_time", "drag", "thrust_scale", "thrust_acceleration", "wind")
Pair = tuple[float, float]


def checked_unknowns(names: object, target: str) -> tuple[str, ...]:
    """The names in the order of `UNKNOWNS`; InputError on any other, or a pair that none can tell.

    A constant thrust and a steady wind act alike, as a + wind/tau.
    """
    if isinstance(names, str) or not isinstance(names, Sequence):
        raise InputError(
            f"unknown must be a list of names such as ('response_time',); got {names!r}"
        )
    for name in names:
        one_of("parameter of the vehicle", name, UNKNOWNS)
    ordered = tuple(name for name in UNKNOWNS if name in names)
    if {"thrust_acceleration", "wind"} <= set(ordered):
        raise InputError(
            "thrust_acceleration and wind cannot both be unknown: a flight only tells "
            "a + wind/tau; give one of them"
        )
    if ordered and target != "flow-velocity":
        raise InputError(
            f"unknown {ordered[0]!r} needs the target 'flow-velocity', not {target!r}; "
            "leave one out"
        )
    return ordered


@dataclass(frozen=True)
class UnknownColumns:
    """The columns of the unknowns: coefficients of v and of m, and a constant per component.

    Raises InputError where the drag of the believed vehicle does not let it be sought.
    """

    unknown: tuple[str, ...]
    believed: PointMassVehicle

    def __post_init__(self) -> None:
        """Check that the rows are linear in the unknowns."""
        quadratic = math.isinf(self.believed.response_time)
        possible = {"drag", "wind"} if quadratic else {"wind"}
        if not self.believed.drag:
            possible = set(UNKNOWNS) - {"drag"}
        for name in self.unknown:
            if name not in possible:
                law = "without quadratic drag"
                if self.believed.drag:
                    law = f"with {'' if quadratic else 'linear and '}quadratic drag"
                raise InputError(
                    f"unknown {name!r} cannot be sought of a vehicle {law}, whose rows are linear "
                    f"in {' and '.join(sorted(possible))} alone: leave it out, or give another "
                    "vehicle to start from"
                )

    @property
    def scaled(self) -> bool:
        """Whether v has a column: tau or c is unknown."""
        return bool({"response_time", "drag"} & set(self.unknown))

    def columns(self, source: Samples) -> Array:
        """N (m, 2, p) of rows with velocities (m, 2): of v, of m, then of a constant in x and in y.

        Raises InputError where the scale of a thrust is unknown that was not measured.
        """
        columns = [source.velocity] if self.scaled else []
        if "thrust_scale" in self.unknown:
            if source.push is None:
                raise InputError(
                    "unknown 'thrust_scale' needs a measured thrust: the flight has none (columns "
                    "ax, ay of its file)"
                )
            columns.append(source.push)
        if {"thrust_acceleration", "wind"} & set(self.unknown):
            columns += [np.broadcast_to(unit, source.velocity.shape) for unit in np.eye(2)]
        if not columns:
            return np.zeros((*source.velocity.shape, 0))
        return np.stack(columns, axis=2)

    def basis(self, source: Samples, *, shared: bool) -> Array:
        """An orthonormal basis (2 m, r) of the span of N, or (m, r) of its series.

        shared: whether both components share their coefficients, rows x before y of each sample.
        A back-end whose components have weights of their own shares one theta between them, and
        so each has coefficients of its own, of v_x and of v_y.
        """
        columns = self.columns(source)
        if shared:
            columns = columns.reshape(2 * len(columns), -1)
        else:
            moving = columns[:, :, : self.scaled + ("thrust_scale" in self.unknown)]
            constant = np.ones((len(columns), int(columns.shape[2] > moving.shape[2])))
            series = moving.swapaxes(1, 2).reshape(len(columns), -1)
            columns = np.hstack([series, constant])
        vectors, roots, _ = np.linalg.svd(columns, full_matrices=False)
        basis: Array = vectors[:, roots > 1e-10 * roots.max(initial=0.0)]
        return basis

    def read(self, coefficients: Array) -> tuple[PointMassVehicle, Pair, float]:
        """The vehicle, the wind and tau_0/tau by coefficients (p,).

        The ratio, by which Phi of the believed vehicle is larger, is sqrt(c/c_0) where drag is
        quadratic; NaN, beside the believed vehicle, where coefficients say what cannot be.
        """
        vehicle = self.believed
        ratio = 1.0 - float(coefficients[0]) if self.scaled else 1.0
        if not ratio > 0 or not np.isfinite(coefficients).all():
            return vehicle, (0.0, 0.0), math.nan
        changes: dict[str, Any] = {}
        x, y = coefficients[-2:].tolist() if len(coefficients) > 1 else (0.0, 0.0)
        if "thrust_scale" in self.unknown:
            push = float(coefficients[int(self.scaled)]) / vehicle.response_time
            changes["thrust_scale"] = vehicle.thrust_scale + push
        if "thrust_acceleration" in self.unknown:
            given, tau = vehicle.thrust_acceleration, vehicle.response_time
            changes["thrust_acceleration"] = given[0] + x / tau, given[1] + y / tau
        if "response_time" in self.unknown:
            changes["response_time"] = vehicle.response_time / ratio
        if "drag" in self.unknown:
            changes["drag"] = vehicle.drag * ratio**2
        wind = (x / ratio, y / ratio) if "wind" in self.unknown else (0.0, 0.0)
        return replace(vehicle, **changes), wind, ratio


def side_by_side(parts: Sequence[UnknownColumns], sources: Sequence[Samples]) -> Array:
    """N (m, 2, f p) of the rows of f flights, those of each beside those of the others."""
    own = [part.columns(source) for part, source in zip(parts, sources, strict=True)]
    flight = np.repeat(np.eye(len(own)), [len(columns) for columns in own], axis=0)
    columns = flight[:, None, :, None] * np.concatenate(own)[:, :, None]
    return columns.reshape(len(flight), 2, -1)


def read_vehicles(
    parts: Sequence[UnknownColumns], coefficients: Array
) -> tuple[tuple[PointMassVehicle, ...], Pair, float]:
    """The vehicle of each flight from coefficients (f p,), the first wind, and the mean tau_0/tau.

    A vehicle that cannot be is as it was believed.
    """
    shares = np.array_split(coefficients, len(parts))
    reads = [part.read(share) for part, share in zip(parts, shares, strict=True)]
    possible = [own for own in reads if own[2] > 0] or [(reads[0][0], (0.0, 0.0), 1.0)]
    ratio = float(np.mean([own[2] for own in possible]))
    return tuple(own[0] for own in reads), possible[0][1], ratio


def project_out(basis: Array, theta: Array, target: Array) -> tuple[Array, Array]:
    """(I - Q Q') theta and target, Q (m, r) orthonormal.

    Raises InputError where a candidate is a combination of Q.
    """
    squares = np.einsum("ij,ij->j", theta, theta)
    theta = theta - basis @ (basis.T @ theta)
    if (np.einsum("ij,ij->j", theta, theta) <= 1e-18 * squares).any():  # what is left is rounding
        raise InputError(
            "a candidate is a combination of the velocity and a constant: the flight is too "
            "straight to tell what is unknown; turn, or give the vehicle"
        )
    return theta, target - basis @ (basis.T @ target)
