"""What is not known beside the flow: the vehicle's parameters and a steady wind, never penalised.

With the parameters tau_0, a_0 that the vehicle is believed to have, Phi_0 = tau_0 (v' - a_0) + v,
and v' = (C W + wind - v)/tau + a gives

    Phi_0 = (tau_0/tau) C W + (1 - tau_0/tau) v + [tau_0 (a - a_0) + (tau_0/tau) wind]:

linear in a coefficient of v and a constant per component. Of a measured thrust m(t) that is scaled
by s, believed to be s_0, one column more: tau_0 (s - s_0) m. Where drag is quadratic only, Phi_0 =
v + r_0 with c_0 |r_0| r_0 = v' - a, and w = v + r_0 sqrt(c_0/c): the same in v with sqrt(c/c_0) in
the place of tau_0/tau. These columns N join the regression
without a penalty: minimising over them first leaves the same problem in (I - P_N) C and
(I - P_N) Phi_0 (Frisch and Waugh, 1933; Lovell, 1963), exactly, for every back-end. The answer
does not depend on tau_0, nor on a_0 where it is sought: both only rescale or shift Phi_0 along N.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sparsefit.arrays import Array
from sparsefit.errors import InputError, one_of
from sparsefit.flight.vehicle import PointMassVehicle

UNKNOWNS = ("response_time", "drag", "thrust_scale", "thrust_acceleration", "wind")
NUMBERS = UNKNOWNS[:3]  # the others are pairs, (x, y)
LOST = 1e-9  # of the columns' inner products: the error of Fourier sums
RANK = 1e-10  # singular values of N below this, relative, are dropped
SPANNED = 1e-9  # of a candidate's norm; what is left of it beside N is rounding


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
    found = tuple(name for name in UNKNOWNS if name in names)
    if {"thrust_acceleration", "wind"} <= set(found):
        raise InputError(
            "thrust_acceleration and wind cannot both be unknown: a flight only tells "
            "a + wind/tau; give one of them"
        )
    if found and target != "flow-velocity":
        raise InputError(
            f"unknown {found[0]!r} needs the target 'flow-velocity', not {target!r}; leave one out"
        )
    return found


@dataclass(frozen=True)
class VehicleEstimate:
    """tau [s], a [m/s^2], the wind [m/s], c [1/m] and s, believed or estimated, and what was."""

    response_time: float
    thrust_acceleration: tuple[float, float]
    wind: tuple[float, float]
    unknown: tuple[str, ...]
    drag: float = 0.0
    thrust_scale: float = 1.0

    @property
    def possible(self) -> bool:
        """Whether tau is above 0, c no less, and all are finite."""
        values = (*self.thrust_acceleration, *self.wind, self.drag, self.thrust_scale)
        linear = math.isfinite(self.response_time) or self.drag > 0
        return self.response_time > 0 and linear and all(map(math.isfinite, values))

    @property
    def vehicle(self) -> PointMassVehicle:
        """The vehicle, of one that is possible."""
        return PointMassVehicle(
            self.response_time, self.thrust_acceleration, self.drag, self.thrust_scale
        )

    def flow_velocity(
        self, velocity: Array, acceleration: Array, thrust: Array | None = None
    ) -> Array:
        """Phi less the wind [m/s], (..., 2)."""
        phi = self.vehicle.flow_velocity(velocity, acceleration, thrust)
        phi -= np.array(self.wind)
        return phi


@dataclass(frozen=True)
class Nuisance:
    """The columns of what is unknown: shared coefficients of v and m, a constant per component.

    Raises InputError where the drag of the believed vehicle does not let it be sought.
    """

    unknown: tuple[str, ...]
    believed: PointMassVehicle

    def __post_init__(self) -> None:
        """Check that the rows are linear in what is unknown."""
        drag, unknown = self.believed.drag, set(self.unknown)
        if drag and math.isfinite(self.believed.response_time) and self.shared:
            raise InputError(
                "drag that is linear and quadratic at once has to be known: leave response_time "
                "and drag out of unknown, or believe in one of them (drag 0, response_time inf)"
            )
        if drag and "response_time" in unknown:
            raise InputError("quadratic drag has no response time; its unknown is 'drag'")
        if drag and unknown & {"thrust_acceleration", "thrust_scale"}:
            raise InputError(
                "a thrust cannot be sought under quadratic drag, whose flow velocity is not linear "
                "in it: give it, or measure it; drag and wind can be sought"
            )
        if "drag" in unknown and not drag:
            raise InputError("unknown 'drag' needs a vehicle with quadratic drag to start from")

    @property
    def shared(self) -> bool:
        """Whether v has a column: tau or c is unknown."""
        return bool({"response_time", "drag"} & set(self.unknown))

    @property
    def scaled(self) -> bool:
        """Whether m has a column: the scale of the measured thrust is unknown."""
        return "thrust_scale" in self.unknown

    @property
    def constant(self) -> bool:
        """Whether there is a constant: thrust or wind is unknown."""
        return bool({"thrust_acceleration", "wind"} & set(self.unknown))

    @property
    def pairs(self) -> list[tuple[int | None, int | None]]:
        """Which of `series` each unknown coefficient multiplies in the x and in the y component."""
        both = [(2 * row, 2 * row + 1) for row in range(self.shared + self.scaled)]
        offset = 2 * len(both)
        constants: list[tuple[int | None, int | None]] = [(offset, None), (None, offset)]
        return [*both, *(constants * self.constant)]

    def series(self, velocity: Array, thrust: Array | None = None) -> Array:
        """v_x and v_y, m_x and m_y, then 1, as far as they are needed: (j, m).

        velocity (m, 2) [m/s]; thrust: the one that was measured, (m, 2) [m/s^2]. Raises InputError
        where its scale is unknown and it was not measured.
        """
        if self.scaled and thrust is None:
            raise InputError(
                "unknown 'thrust_scale' needs a measured thrust: the flight has none (columns ax, "
                "ay of its file)"
            )
        pushed = thrust.T if self.scaled and thrust is not None else ()
        ones = [np.ones(len(velocity))] * self.constant
        rows = [*(velocity.T if self.shared else ()), *pushed, *ones]
        stacked: Array = np.array(rows).reshape(-1, len(velocity))
        return stacked

    def columns(self, velocity: Array, thrust: Array | None = None) -> Array:
        """N (2, m, p): the columns of the p coefficients in either component."""
        series, zero = self.series(velocity, thrust), np.zeros(len(velocity))
        if not self.unknown:
            return np.zeros((2, len(velocity), 0))
        both = (
            [zero if index is None else series[index] for index in pair]
            for pair in zip(*self.pairs, strict=True)
        )
        return np.array([np.stack(one, axis=1) for one in both])

    def regressed(self, products: Array) -> Array:
        """RSS (q,) of Phi on the columns, from inner products (q, 2 + j, 2 + j).

        Those of Phi_x, Phi_y and the j rows of `series`.
        """
        return regressed(products, self.pairs)

    def basis(self, velocity: Array, thrust: Array | None = None, *, shared: bool = False) -> Array:
        """An orthonormal basis (m, r) of the span of `series`, or (2 m, r) of `columns`.

        A back-end shares one theta between the components, so that each has coefficients of its
        own here, of v_x and v_y; the refinement and the readout share the one of v. ``shared``:
        the rows are those of x and y, sample after sample, and so do the coefficients.
        """
        columns = self.series(velocity, thrust).T
        if shared:
            both = self.columns(velocity, thrust).transpose(1, 0, 2)
            columns = both.reshape(2 * len(velocity), -1)
        left, roots, _ = np.linalg.svd(columns, full_matrices=False)
        kept: Array = left[:, roots > RANK * roots[0]]
        return kept

    def ratio(self, coefficients: Array) -> float:
        """tau_0 / tau, or sqrt(c / c_0), by which Phi of the believed vehicle is the true one's."""
        return 1.0 - float(coefficients[0]) if self.shared else 1.0

    def read(self, coefficients: Array) -> VehicleEstimate:
        """The parameters from the coefficients (p,) of `columns`."""
        tau, thrust = self.believed.response_time, self.believed.thrust_acceleration
        ratio = self.ratio(coefficients)
        shift = coefficients[-2:] if self.constant else np.zeros(2)
        wind = np.zeros(2)
        if "thrust_acceleration" in self.unknown:
            x, y = (np.array(thrust) + shift / tau).tolist()
            thrust = (x, y)
        else:
            wind = shift / ratio if ratio else np.full(2, math.nan)
        east, north = wind.tolist()
        found, drag, scale = tau, self.believed.drag, self.believed.thrust_scale
        if "response_time" in self.unknown:
            found = tau / ratio if ratio else math.inf
        if "drag" in self.unknown:
            drag *= ratio * abs(ratio)
        if self.scaled:
            scale += float(coefficients[int(self.shared)]) / tau
        return VehicleEstimate(found, thrust, (east, north), self.unknown, drag, scale)


def regressed(products: Array, of_series: list[tuple[int | None, int | None]]) -> Array:
    """RSS (q,) of Phi on nuisance columns, from inner products (q, 2 + j, 2 + j).

    Those of Phi_x, Phi_y and j series; of_series: which of these every coefficient multiplies in
    the x and in the y component.
    """
    pairs = [[None if i is None else i + 2 for i in pair] for pair in of_series]
    gram = np.zeros((len(products), len(pairs), len(pairs)))
    load = np.zeros((len(products), len(pairs), 1))
    for component in range(2):
        for row, first in enumerate(pair[component] for pair in pairs):
            if first is None:
                continue
            load[:, row, 0] += products[:, first, component]
            for column, second in enumerate(pair[component] for pair in pairs):
                if second is not None:
                    gram[:, row, column] += products[:, first, second]
    sizes = np.trace(gram, axis1=1, axis2=2)[:, None, None]
    gram += LOST * sizes * np.eye(len(pairs))
    explained = np.sum(load * np.linalg.solve(gram, load), axis=(1, 2))
    residuals: Array = products[:, 0, 0] + products[:, 1, 1] - explained
    return residuals


def project_out(basis: Array, theta: Array, target: Array) -> tuple[Array, Array]:
    """(I - Q Q') theta and target, Q (m, r): what the penalised problem is left with.

    Raises:
        InputError: if a candidate is a combination of the unknown columns.
    """
    left = theta - basis @ (basis.T @ theta)
    refuse_spanned(np.linalg.norm(left, axis=0), np.linalg.norm(theta, axis=0))
    return left, target - basis @ (basis.T @ target)


def refuse_spanned(left: Array, norms: Array) -> None:
    """InputError if nothing is left of a candidate, norms (k,) before and after."""
    if (left <= SPANNED * norms).any():
        raise InputError(
            "a candidate is a combination of the velocity and a constant: the flight is too "
            "straight to tell what is unknown; turn, or give the vehicle"
        )
