"""How well U0, L and tau_w can be known from rows at best: the Cramer-Rao bound of Eq. 7.

Phi_t = C(k) w_t + e_t for the two components t, C (m, 8) the candidates at k = pi/L. With e of
variance s^2 a function of theta = (k, w_1, w_2) with the gradient g has at least the variance
s^2 g'(J'J)^+ g, infinite along what the flight does not tell. Under quadratic drag e is the
vehicle's response dr/dF times the noise, and the rows of J are multiplied by its inverse. What the
log itself can tell, trajectory included, is `sparsefit.likelihood.limit`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from sparsefit.arrays import Array
from sparsefit.errors import InputError, non_negative, one_of
from sparsefit.flight.flow import CellularFlow
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.model.cells import candidate_jet, rms_mean_velocity

FlowModel = Literal["parametric", "semiparametric"]
RANK = 1e-12  # of the largest eigenvalue: a direction below it is not told
LOST = 1e-6  # of a gradient: more of it along what is not told, and there is no bound


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
        velocity: (m, 2) [m/s], needed where drag is quadratic.

    Raises:
        InputError: for an unknown model, sigma < 0, or quadratic drag without velocities.
    """
    sigma = non_negative("process_noise", process_noise, "m/s^2")
    deviation = vehicle.response_time * sigma if not vehicle.drag else sigma
    one_of("model", model, get_args(FlowModel))
    if vehicle.drag and velocity is None:
        raise InputError("the bound under quadratic drag needs the velocities too: give velocity=")
    if deviation == 0.0:
        return Bound(0.0, 0.0, 0.0)
    by_speed, by_scale = -flow.timescale / flow.mean_velocity, 1 / flow.mean_velocity
    if model == "parametric":
        jacobian = parametric_jacobian(position, flow)
        gradients = np.array([[1.0, 0.0], [0.0, 1.0], [by_speed, by_scale]])
    else:
        jacobian, gradients = semiparametric_jacobian(position, flow)
    if vehicle.drag and velocity is not None:
        slopes = vehicle.slope(flow.velocity(*position.T) - velocity)
        halves = jacobian.reshape(2, -1, jacobian.shape[1])
        jacobian = np.einsum("abm,bmn->amn", slopes, halves).reshape(jacobian.shape)
    size = np.sqrt(np.sum(jacobian**2, axis=0))
    size[size == 0.0] = 1.0
    roots, axes = np.linalg.eigh((jacobian / size).T @ (jacobian / size))
    told = roots > RANK * roots[-1]
    scaled = gradients / size
    along = (scaled @ axes[:, told]) / np.sqrt(roots[told])
    lost = np.linalg.norm(scaled @ axes[:, ~told], axis=1) > LOST * np.linalg.norm(scaled, axis=1)
    spreads = np.where(lost, np.inf, deviation * np.linalg.norm(along, axis=1))
    return Bound(*spreads.tolist())


def parametric_jacobian(position: Array, flow: CellularFlow) -> Array:
    """J (2m, 2) = [f, U0 df/dL], x components first, for positions (m, 2) [m]."""
    (x, y), k, u0 = position.T, flow.wavenumber, flow.mean_velocity
    sin_x, cos_x, sin_y, cos_y = np.sin(k * x), np.cos(k * x), np.sin(k * y), np.cos(k * y)
    shape = np.concatenate([sin_x * cos_y, -cos_x * sin_y])
    along = (x * cos_x * cos_y - y * sin_x * sin_y, x * sin_x * sin_y - y * cos_x * cos_y)
    return np.column_stack([shape, -u0 * k / flow.length_scale * np.concatenate(along)])


def semiparametric_jacobian(position: Array, flow: CellularFlow) -> tuple[Array, Array]:
    """J (2m, 17) by k and the weights, x components first, and gradients (3, 17) of the values."""
    period = 2 * flow.length_scale
    middle = 0.5 * (position.max(axis=0) + position.min(axis=0))
    near = position - period * np.round(middle / period)  # the same flow, with all its digits
    weights = np.zeros((8, 2))
    weights[5, 0], weights[6, 1] = flow.mean_velocity, -flow.mean_velocity
    values, slopes, _ = candidate_jet(near, np.array([flow.wavenumber]))
    columns, count = values[0].T, len(near)
    jacobian = np.zeros((2 * count, 17))
    jacobian[:, 0] = (slopes[0].T @ weights).T.ravel()
    jacobian[:count, 1:9], jacobian[count:, 9:] = columns, columns
    gradients, step = np.zeros((3, 17)), 1e-6 * flow.mean_velocity
    for place in range(16):
        push = np.zeros((8, 2))
        push[place % 8, place // 8] = step
        ends = rms_mean_velocity(weights + push), rms_mean_velocity(weights - push)
        gradients[0, 1 + place] = (ends[0] - ends[1]) / (2 * step)
    gradients[1, 0] = -flow.length_scale / flow.wavenumber
    gradients[2] = (gradients[1] - flow.timescale * gradients[0]) / flow.mean_velocity
    return jacobian, gradients
