"""How well U0, L and tau_w can be known from rows at best: the Cramer-Rao bound of Eq. 7.

Phi_t = C(k) w_t + e_t for the two components t, C (m, 8) the candidates at k = pi/L. With e of
variance s^2 a function of theta = (k, w_1, w_2) with the gradient g has at least the variance
s^2 g'(J'J)^+ g, infinite along what the flight does not tell. Of a vehicle that does not respond
linearly e is dr/dF times the noise, and the rows of J are multiplied by its inverse. What the log
itself can tell, trajectory included, is `sparsefit.likelihood.limit`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from sparsefit.arrays import Array
from sparsefit.errors import InputError, non_negative, one_of
from sparsefit.flight.flow import CellularFlow
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.model.columns import CANDIDATES, MEAN_SQUARE, candidate_columns
from sparsefit.model.grid import middle

FlowModel = Literal["parametric", "semiparametric"]
EQUATION_1 = np.zeros((8, 2))
"""The weights of Eq. 1 for U0 = 1 m/s."""
EQUATION_1[CANDIDATES.index("sin x cos y"), 0] = 1.0
EQUATION_1[CANDIDATES.index("cos x sin y"), 1] = -1.0


@dataclass(frozen=True)
class Bound:
    """Least standard deviations of any unbiased estimator: [m/s], [m], [s]; inf where none."""

    mean_velocity: float
    length_scale: float
    timescale: float


def cramer_rao(
    position: Array,
    flow: CellularFlow,
    vehicle: PointMassVehicle,
    *,
    process_noise: float,
    model: FlowModel = "parametric",
    velocity: Array | None = None,
) -> Bound:
    """Bound the standard deviations of U0, L and tau_w under Eq. 7.

    Args:
        position: known positions (m, 2) [m].
        flow: the true one.
        vehicle: the true one.
        process_noise: sigma of iid noise of v' in each component [m/s^2].
        model: ``parametric``, the flow known up to U0 and L; ``semiparametric``, the 2 x 8 weights
            free and profiled out, U0 their root mean square over the cell.
        velocity: (m, 2) [m/s], needed where the vehicle's response is not linear.

    Raises:
        InputError: for an unknown model, sigma < 0, or a vehicle that does not respond linearly
            without velocities.
    """
    sigma = non_negative("process_noise", process_noise, "m/s^2")
    deviation = vehicle.response_time * sigma if vehicle.linear else sigma
    one_of("model", model, get_args(FlowModel))
    if not vehicle.linear and velocity is None:
        raise InputError("the bound of this vehicle needs the velocities too: give velocity=")
    if deviation == 0.0:
        return Bound(0.0, 0.0, 0.0)
    rows, gradients = jacobian(position, flow, model)
    if not vehicle.linear and velocity is not None:
        slopes = vehicle.slope(flow.velocity(*position.T) - velocity)
        halves = rows.reshape(2, -1, rows.shape[1])
        rows = np.einsum("abm,bmn->amn", slopes, halves).reshape(rows.shape)
    size = np.sqrt(np.sum(rows**2, axis=0))
    size[size == 0.0] = 1.0
    roots, axes = np.linalg.eigh((rows / size).T @ (rows / size))
    seen = roots > 1e-12 * roots[-1]
    scaled = gradients / size
    along = (scaled @ axes[:, seen]) / np.sqrt(roots[seen])
    # More than a millionth of a gradient along what is not seen, and there is no bound.
    lost = np.linalg.norm(scaled @ axes[:, ~seen], axis=1) > 1e-6 * np.linalg.norm(scaled, axis=1)
    return Bound(*np.where(lost, np.inf, deviation * np.linalg.norm(along, axis=1)).tolist())


def jacobian(position: Array, flow: CellularFlow, model: FlowModel) -> tuple[Array, Array]:
    """J (2 m, p) of Phi, x components first, and the gradients (3, p) of U0, L and tau_w.

    By U0 and L, or by k and the 8 weights of x, then of y, where these are free.
    """
    speed, k, scale = flow.mean_velocity, flow.wavenumber, flow.length_scale
    near = position
    if model == "semiparametric":  # phases are free: the same flow, with all its digits
        near = position - 2 * scale * np.round(middle(position) / (2 * scale))
    value, x, y = candidate_columns(near, np.array([scale])), near[:, 0], near[:, 1]
    by_k = speed * np.concatenate(
        [x * value[:, 7] - y * value[:, 4], x * value[:, 4] - y * value[:, 7]]
    )
    if model == "parametric":
        rows = np.column_stack([(value @ EQUATION_1).T.ravel(), -k / scale * by_k])
        gradients = np.array([[1.0, 0.0], [0.0, 1.0], [0.0, 0.0]])
    else:
        rows = np.column_stack([by_k, np.kron(np.eye(2), value)])
        gradients = np.zeros((3, 17))
        gradients[0, 1:] = (2 * MEAN_SQUARE[:, None] * EQUATION_1).T.ravel()  # of the rms
        gradients[1, 0] = -scale / k
    gradients[2] = (gradients[1] - flow.timescale * gradients[0]) / speed
    return rows, gradients
