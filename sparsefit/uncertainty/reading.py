"""What is read from theta, as data: values, and how they change with theta.

Of a mode of a cellular flow, W its weights and k its wavenumber: U0^2 = 2 sum h W^2, h the mean
square of a column over a cell, L = pi/k and tau_w = L/U0. Where the response time is unknown
all fitted weights are 1 - b_v of the true ones, b_v the coefficient of the velocity; of the vehicle
(`sparsefit.library.nuisance`), tau = tau_0/(1 - b_v), the thrust is a_0 + b_c/tau_0 and the
wind b_c/(1 - b_v); its scale s_0 + b_m/tau_0, and quadratic drag c_0 (1 - b_v)^2.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from sparsefit.arrays import Array, BoolArray
from sparsefit.library.cells import MEAN_SQUARE, rms_mean_velocity
from sparsefit.library.nuisance import NUMBERS, Nuisance
from sparsefit.uncertainty.model import Model

FIRST_ORDER = 0.2  # of a value that a correction may move it: beyond it first order is no guide
MODE = ("mean_velocity", "length_scale", "timescale")


@dataclass(frozen=True, eq=False)
class Reading:
    """Functions of theta where a model is.

    Args:
        names: what each value is, (f,).
        values: (f,), in SI units.
        gradients: their derivatives by theta, (f, n).
        limits: how far a correction of first order may move each value, (f,).
        norms: which values are norms of weights (f,): they grow along every direction that is
            not told, if not to first order.
        kept: which values keep their bias even where others are corrected (f,); None: none.
    """

    names: tuple[str, ...]
    values: Array
    gradients: Array
    limits: Array
    norms: BoolArray
    kept: BoolArray | None = None

    @property
    def stay(self) -> BoolArray:
        """`kept`, told of every value."""
        return np.zeros(len(self.values), dtype=bool) if self.kept is None else self.kept


Reader: TypeAlias = Callable[[Model], Reading]


def joined(first: Reading, second: Reading) -> Reading:
    """Both readings of one model, one after the other."""
    return Reading(
        first.names + second.names,
        np.concatenate([first.values, second.values]),
        np.concatenate([first.gradients, second.gradients]),
        np.concatenate([first.limits, second.limits]),
        np.concatenate([first.norms, second.norms]),
        np.concatenate([first.stay, second.stay]),
    )


def cellular(model: Model, nuisance: Nuisance) -> Reading:
    """U0 [m/s], L [m] and tau_w [s] of every mode of a model of `Cells`, mode by mode."""
    ratio = nuisance.ratio(model.coefficients)
    values, gradients = [], []
    for j, (wavenumber, weights) in enumerate(
        zip(model.parameters[:, 0], model.weights, strict=True)
    ):
        k, amplitude = float(wavenumber), rms_mean_velocity(weights) or math.nan
        speed, scale = amplitude / ratio, math.pi / k
        values += [speed, scale, scale / speed]
        by_k, by_weight = np.zeros(model.parameters.shape), np.zeros(model.weights.shape)
        by_loose = np.zeros(len(model.coefficients))
        by_weight[j] = 2 * MEAN_SQUARE[:, None] * weights / (amplitude * ratio)
        if nuisance.shared:
            by_loose[0] = speed / ratio
        of_speed = model.joined(by_k, by_weight, by_loose)
        by_k[j] = -scale / k
        of_scale = model.joined(by_k, 0 * by_weight, 0 * by_loose)
        gradients += [of_speed, of_scale, of_scale / speed - scale / speed**2 * of_speed]
    read = np.array(values)
    norms = np.tile([True, False, True], len(model.parameters))
    names = MODE * len(model.parameters)
    return Reading(names, read, np.array(gradients), FIRST_ORDER * np.abs(read), norms)


def vehicle(model: Model, nuisance: Nuisance, place: int = 0) -> Reading:
    """What is unknown of the vehicle and the wind, in the order of `Nuisance.unknown`.

    place: of the first coefficient of its flight.
    """
    coefficients = model.coefficients[place : place + len(nuisance.pairs)]
    found, ratio = nuisance.read(coefficients), nuisance.ratio(coefficients)
    first = model.parameters.size + model.weights.size + place
    constants = slice(first + len(coefficients) - 2, first + len(coefficients))
    names, values, gradients = [], [], []
    for name in nuisance.unknown:
        value = np.atleast_1d(getattr(found, name))
        by_theta = np.zeros((len(value), first - place + len(model.coefficients)))
        if name == "response_time":
            by_theta[0, first] = found.response_time / ratio
        elif name == "drag":
            by_theta[0, first] = -2 * found.drag / ratio
        elif name == "thrust_scale":
            by_theta[0, first + nuisance.shared] = 1 / nuisance.believed.response_time
        else:
            step = 1 / ratio if name == "wind" else 1 / nuisance.believed.response_time
            by_theta[:, constants] = step * np.eye(2)
            if nuisance.shared and name == "wind":
                by_theta[:, first] = value / ratio
        names += [name] * len(value)
        values.append(value)
        gradients.append(by_theta)
    limits = [
        FIRST_ORDER * v if n in NUMBERS else math.inf
        for n, v in zip(names, np.concatenate(values), strict=True)
    ]
    return Reading(
        tuple(names),
        np.concatenate(values),
        np.concatenate(gradients),
        np.array(limits),
        np.zeros(len(names), dtype=bool),
    )
