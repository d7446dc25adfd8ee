"""How well U0, L and tau_w can be known at best: the Cramer-Rao bound, for a flow that is known.

The model is Phi_t = C(k) w_t + e_t for the two components t, C (m, 8) the candidates at
k = pi/L. Its parameters are theta = (k, w_1, w_2), 17 of them (`sparsefit.uncertainty.model`), and
with e of variance s^2 a function of theta with the gradient g has at least the variance
s^2 g'(J'J)^+ g, infinite along what the flight does not tell (`information`). Under quadratic drag
e is the vehicle's response dr/dF times the noise, and the rows of J are multiplied by its inverse.
"""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from sparsefit.arrays import Array
from sparsefit.errors import InputError, non_negative, one_of
from sparsefit.flight.flow import CellularFlow
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.library.cells import Cells
from sparsefit.library.nuisance import Nuisance
from sparsefit.modes.fitted_rows import Rows
from sparsefit.uncertainty.information import Information
from sparsefit.uncertainty.model import Model
from sparsefit.uncertainty.reading import cellular

FlowModel = Literal["parametric", "semiparametric"]


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

    Phi = U0 f(x; L) + tau n, n iid N(0, sigma^2) in each component at known positions (m, 2) [m],
    so the Fisher matrix is J'J / (tau sigma)^2, sigma = process_noise [m/s^2].
    ``parametric``: J = [f, U0 df/dL], the flow known up to U0 and L. ``semiparametric``: the
    2 x 8 weights are free and profiled out, U0 is their root mean square over the cell.
    tau_w = L/U0 by the delta method. velocity (m, 2) [m/s]: needed where drag is quadratic, whose
    response takes the place of tau. Raises InputError for an unknown model, sigma < 0, or quadratic
    drag without velocities.
    """
    sigma = non_negative("process_noise", process_noise, "m/s^2")
    deviation = vehicle.response_time * sigma if not vehicle.drag else sigma
    one_of("model", model, get_args(FlowModel))
    if vehicle.drag and velocity is None:
        raise InputError("the bound under quadratic drag needs the velocities too: give velocity=")
    if deviation == 0.0:
        return Bound(0.0, 0.0, 0.0)
    weights = None
    if vehicle.drag and velocity is not None:
        weights = vehicle.slope(flow.velocity(*position.T) - velocity)
    if model == "parametric":
        jacobian = _weighted(parametric_jacobian(position, flow), weights)
        information = Information.of(jacobian.T @ jacobian)
        by_speed, by_scale = -flow.timescale / flow.mean_velocity, 1 / flow.mean_velocity
        gradients = np.array([[1.0, 0.0], [0.0, 1.0], [by_speed, by_scale]])
    else:
        free = semiparametric(position, flow)
        information = free.information
        if weights is not None:
            count = free.jacobian.size
            each = free.jacobian.times(np.eye(count)).reshape(count, -1).T
            each = _weighted(each, weights)
            information = Information.of(each.T @ each)
        gradients = cellular(free, Nuisance((), vehicle)).gradients
    told = np.linalg.norm(information.basis.T @ gradients.T, axis=0)
    spreads = np.where(information.lost(gradients), np.inf, deviation * told)
    return Bound(*spreads.tolist())


def _weighted(jacobian: Array, weights: Array | None) -> Array:
    """J (2m, n), x before y, with the rows of each sample multiplied by (2, 2, m)."""
    if weights is None:
        return jacobian
    halves = jacobian.reshape(2, -1, jacobian.shape[1])
    turned: Array = np.einsum("abm,bmn->amn", weights, halves)
    return turned.reshape(jacobian.shape)


def parametric_jacobian(position: Array, flow: CellularFlow) -> Array:
    """J (2m, 2) = [f, U0 df/dL], x components first, for positions (m, 2) [m]."""
    (x, y), k, u0 = position.T, flow.wavenumber, flow.mean_velocity
    sin_x, cos_x, sin_y, cos_y = np.sin(k * x), np.cos(k * x), np.sin(k * y), np.cos(k * y)
    shape = np.concatenate([sin_x * cos_y, -cos_x * sin_y])
    along = (x * cos_x * cos_y - y * sin_x * sin_y, x * sin_x * sin_y - y * cos_x * cos_y)
    return np.column_stack([shape, -u0 * k / flow.length_scale * np.concatenate(along)])


def semiparametric(position: Array, flow: CellularFlow) -> Model:
    """The flow at positions (m, 2) [m] as a fit of one mode with free weights."""
    period = 2 * flow.length_scale
    middle = 0.5 * (position.max(axis=0) + position.min(axis=0))
    near = position - period * np.round(middle / period)  # the same flow, with all its digits
    weights = np.zeros((1, 8, 2))
    weights[0, 5, 0], weights[0, 6, 1] = flow.mean_velocity, -flow.mean_velocity
    rows = Rows(near, flow.velocity(*near.T), np.zeros((2, len(near), 0)))
    return Model(Cells(), rows, np.array([[flow.wavenumber]]), weights, np.zeros(0))
