"""Square cells of any heading as six parameters, a, b, a, b, kx, ky: their flow, U0, L and heading.

psi = sum over k = (kx, ky), (-ky, kx) of a cos(k.x) + b sin(k.x),   w = (psi_y, -psi_x),
U0 = |k| sqrt(sum of a^2 + b^2),   L = sqrt(2) pi/|k|
"""

from __future__ import annotations

import math

import numpy as np

from sparsefit.arrays import Array

M = 6  # parameters


def waves(flow: Array, x: Array, y: Array) -> tuple[Array, Array, Array]:
    """Return w (2, ...), its gradient by the place (2, 2, ...) and by the flow (2, 6, ...).

    flow: a, b, a, b [m^2/s], kx, ky [rad/m], (6, ...); x, y: from where phases count [m], (...).
    """
    w, place = np.zeros((2, *np.shape(x))), np.zeros((2, 2, *np.shape(x)))
    gradient = np.zeros((2, M, *np.shape(x)))
    for j, (k, l) in enumerate(((flow[4], flow[5]), (-flow[5], flow[4]))):  # noqa: E741
        a, b, phase = flow[2 * j], flow[2 * j + 1], k * x + l * y
        c, s = np.cos(phase), np.sin(phase)
        slope, height, normal = b * c - a * s, a * c + b * s, np.stack([l + 0 * x, -k + 0 * x])
        w += slope * normal
        place -= height * normal[:, None] * np.stack([k + 0 * x, l + 0 * x])
        gradient[:, 2 * j], gradient[:, 2 * j + 1] = -s * normal, c * normal
        by_k = np.stack([-height * l * x, height * k * x - slope])
        by_l = np.stack([slope - height * l * y, height * k * y])
        gradient[:, 4] += by_l if j else by_k
        gradient[:, 5] += -by_k if j else by_l
    return w, place, gradient


def length_of(flow: Array) -> float:
    """L [m] of the cells of a flow (6,)."""
    return math.sqrt(2.0) * math.pi / math.hypot(flow[4], flow[5])


def speed_of(flow: Array) -> float:
    """U0 [m/s] of the cells of a flow (6,)."""
    return math.hypot(flow[4], flow[5]) * float(np.linalg.norm(flow[:4]))


def heading_of(angle: float) -> float:
    """An angle [rad] less the nearest multiple of a right one."""
    return angle - math.pi / 2 * math.floor(angle / (math.pi / 2) + 0.5)


def unevenness(flow: Array) -> tuple[float, Array]:
    """Half the logarithm of the ratio of the waves' squared amplitudes, and its gradient (6,)."""
    first, second = flow[0] ** 2 + flow[1] ** 2, flow[2] ** 2 + flow[3] ** 2
    gradient = np.concatenate([-flow[:2] / first, flow[2:4] / second, [0.0, 0.0]])
    return math.log(second / first) / 2, gradient


def heading(flow: Array) -> tuple[float, Array]:
    """The heading [rad] of the cells, and its gradient (6,)."""
    k = flow[4] ** 2 + flow[5] ** 2
    gradient = np.array([0.0, 0.0, 0.0, 0.0, -flow[5] / k, flow[4] / k])
    return heading_of(math.atan2(flow[5], flow[4]) - math.pi / 4), gradient


def parameters(flow: Array, covariance: Array) -> tuple[Array, Array]:
    """U0, L, L/U0 and the heading of a flow (6,), (4,), and their variances (4,)."""
    k, speed, length = flow[4] ** 2 + flow[5] ** 2, speed_of(flow), length_of(flow)
    angle, by_angle = heading(flow)
    by_speed = np.concatenate([k * flow[:4], speed**2 / k * flow[4:]]) / speed
    by_length = np.concatenate([np.zeros(4), -length * flow[4:] / k])
    by_time = length / speed * (by_length / length - by_speed / speed)
    gradients = np.stack([by_speed, by_length, by_time, by_angle])
    variances: Array = np.einsum("gi,ij,gj->g", gradients, covariance, gradients)
    return np.array([speed, length, length / speed, angle]), variances


def rebased(flow: Array, place: Array) -> tuple[Array, Array]:
    """A flow (6,) whose phases count from a place (2,) [m], and the Jacobian (6, 6) of that."""
    moved, jacobian = flow.copy(), np.eye(M)
    for j, by in enumerate((place, np.array([place[1], -place[0]]))):
        turn = float(flow[4:] @ by)
        c, s, two = math.cos(turn), math.sin(turn), slice(2 * j, 2 * j + 2)
        turned = np.array([[c, s], [-s, c]])
        moved[two] = turned @ flow[two]
        jacobian[two, two] = turned
        jacobian[two, 4:] = np.outer([moved[2 * j + 1], -moved[2 * j]], by)
    return moved, jacobian
