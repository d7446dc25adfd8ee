"""How well U0, L and tau_w can be known at best: the Cramer-Rao bound, for a flow that is known.

The model is Phi_t = C(k) w_t + e_t for the two components t, C (m, 8) the candidates at
k = pi/L. Its parameters are theta = (k, w_1, w_2), 17 of them; the Jacobian of both components,
stacked, is J (2m, 17) = [dC/dk w, blockdiag(C, C)].
"""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from sparsefit.arrays import Array, BoolArray
from sparsefit.errors import non_negative, one_of
from sparsefit.flight.flow import CellularFlow
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.modes.refine import columns
from sparsefit.uncertainty import Fitted

Model = Literal["parametric", "semiparametric"]

NULL = 1e-9  # singular values of the scaled Jacobian below this, relative, are its null space
LOST = 1e-6  # a gradient with more than this, relative, in the null space: inf


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
    model: Model = "parametric",
) -> Bound:
    """Bound the standard deviations of U0, L and tau_w under Eq. 7.

    Phi = U0 f(x; L) + tau n, n iid N(0, sigma^2) in each component at known positions (m, 2) [m],
    so the Fisher matrix is J'J / (tau sigma)^2, sigma = process_noise [m/s^2].
    ``parametric``: J = [f, U0 df/dL], the flow known up to U0 and L. ``semiparametric``: the
    2 x 8 weights are free and profiled out, U0 is their root mean square over the cell.
    tau_w = L/U0 by the delta method. Raises InputError for an unknown model or sigma < 0.
    """
    deviation = vehicle.response_time * non_negative("process_noise", process_noise, "m/s^2")
    one_of("model", model, get_args(Model))
    if deviation == 0.0:
        return Bound(0.0, 0.0, 0.0)
    if model == "parametric":
        jacobian = parametric_jacobian(position, flow)
        gradients = np.array([[1.0, 0.0], [0.0, 1.0], [-flow.timescale / flow.mean_velocity, 1.0]])
        gradients[2, 1] /= flow.mean_velocity
    else:
        weights = np.zeros((8, 2))
        weights[5, 0], weights[6, 1] = flow.mean_velocity, -flow.mean_velocity
        jacobian, gradients = semiparametric(position, weights, flow.wavenumber)
    rows, lost = _functionals(jacobian, gradients)
    spreads = np.where(lost, np.inf, deviation * np.linalg.norm(rows, axis=0))
    return Bound(*spreads.tolist())


def parametric_jacobian(position: Array, flow: CellularFlow) -> Array:
    """J (2m, 2) = [f, U0 df/dL], x components first, for positions (m, 2) [m]."""
    (x, y), k, u0 = position.T, flow.wavenumber, flow.mean_velocity
    sin_x, cos_x, sin_y, cos_y = np.sin(k * x), np.cos(k * x), np.sin(k * y), np.cos(k * y)
    shape = np.concatenate([sin_x * cos_y, -cos_x * sin_y])
    along = (x * cos_x * cos_y - y * sin_x * sin_y, x * sin_x * sin_y - y * cos_x * cos_y)
    return np.column_stack([shape, -u0 * k / flow.length_scale * np.concatenate(along)])


def semiparametric(position: Array, weights: Array, wavenumber: float) -> tuple[Array, Array]:
    """J (2m, 17), and the gradients (3, 17) of U0, L and tau_w."""
    value, slope = columns(position, wavenumber)
    zero = np.zeros_like(value)
    jacobian = np.block([[value, zero], [zero, value]])
    bend = (slope @ weights).T.ravel()
    gradients = Fitted(position, wavenumber, weights).gradients
    return np.column_stack([bend, jacobian]), gradients


def _functionals(jacobian: Array, gradients: Array) -> tuple[Array, BoolArray]:
    """J (J'J)^+ g (rows, 3) for gradients g (3, parameters), and which g the data do not tell."""
    scale = np.linalg.norm(jacobian, axis=0)
    scale[scale == 0] = 1.0
    triangle = np.linalg.qr(jacobian / scale, mode="r")
    roots, right = np.linalg.svd(triangle)[1:]
    kept = np.arange(len(right)) < np.count_nonzero(roots > NULL * roots[0])
    turned = right @ (gradients / scale).T
    lost = np.linalg.norm(turned[~kept], axis=0) > LOST * np.linalg.norm(turned, axis=0)
    inverse = right[kept].T @ (turned[kept] / roots[kept[: len(roots)], None] ** 2)
    found: Array = (jacobian / scale) @ inverse
    return found, lost
