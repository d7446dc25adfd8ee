"""What is read from waves: U0, L and tau_w, and of two waves the cells' sides, heading and drift.

Four waves are two flows of cells where two and two of them are equally strong, each read alone.

    U0^2 = sum_j |k_j|^2 (a_j^2 + b_j^2),    L = sqrt(2) pi / sqrt(mean |k_j|^2),    tau_w = L/U0

U0 is of all waves of a flow, everything else of the two strongest. Two waves make cells between the
lines on which (k_1 + k_2).x/2 and (k_1 - k_2).x/2 step by pi: L_x and L_y are their distances. The
heading halves the angle of the waves and is brought to (-pi/4, pi/4] by quarter turns; the drift c
solves k_j . c = omega_j. Gradients are differences of these, in parameters scaled to their size.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sparsefit.arrays import Array, IntArray
from sparsefit.library.nuisance import Nuisance
from sparsefit.library.waves import Waves
from sparsefit.uncertainty.model import Model
from sparsefit.uncertainty.reading import FIRST_ORDER, MODE, Reading
from sparsefit.uncertainty.record import interval

CELL = ("length_scale_x", "length_scale_y", "heading")
DRIFT = ("drift_x", "drift_y")
STEP = 1e-6  # of differences, relative to a parameter's size
ALIKE = 0.2  # of ln(amplitude): waves that differ by more make no cells
ANGLE = 0.1  # of |cos| of the angle of two waves, beside ln: of waves all alike, squares are told
TURN = 0.05  # [rad] that a correction of first order may turn cells by

Interval = tuple[float, float]


@dataclass(frozen=True)
class ShapeUncertainty:
    """Standard errors and 95 % intervals of (L_x, L_y) [m], the heading [rad] and the drift [m/s].

    None of a drift that the shape does not have; pairs are (x, y).
    """

    length_scales: tuple[float, float]
    length_scale_intervals: tuple[Interval, Interval]
    heading: float
    heading_interval: Interval
    drift: tuple[float, float] | None = None
    drift_intervals: tuple[Interval, Interval] | None = None


@dataclass(frozen=True)
class Shape:
    """The cells that two waves make.

    Args:
        length_scales: (L_x, L_y) [m], in the cells' own axes.
        heading: by which these are turned counter-clockwise [rad], in (-pi/4, pi/4].
        drift: at which the pattern moves [m/s], (x, y); 0 of a steady shape.
        uncertainty: how sure they are, where that was asked and can be told.
    """

    length_scales: tuple[float, float]
    heading: float
    drift: tuple[float, float]
    uncertainty: ShapeUncertainty | None = None

    @classmethod
    def of(cls, values: Array) -> Shape:
        """Of values (f,) of `CELL`, and of `DRIFT` where it is told."""
        x, y, heading, *drift = values.tolist()
        return cls((x, y), heading, (drift[0], drift[1]) if drift else (0.0, 0.0))

    @classmethod
    def around(cls, values: Array, errors: Array, freedom: Array) -> Shape:
        """Of values (f,) of `CELL`, and of `DRIFT` where it is told; standard errors, freedom."""
        every = (array.tolist() for array in (values, errors, freedom))
        ends = [interval(*one) for one in zip(*every, strict=True)]
        (x, y, heading), drift = values[:3].tolist(), tuple(values[3:].tolist())
        own = errors.tolist()
        moves = (tuple(own[3:]), tuple(ends[3:])) if drift else (None, None)
        sure = ShapeUncertainty((own[0], own[1]), (ends[0], ends[1]), own[2], ends[2], *moves)
        return cls((x, y), heading, drift or (0.0, 0.0), sure)


def names_of(family: Waves, modes: int) -> tuple[str, ...]:
    """What is read of each flow of a model of so many modes of waves."""
    if family.pattern.size * modes < 2:
        return MODE
    return (*MODE, *CELL, *(DRIFT if family.pattern.drifting else ()))


def waves(model: Model, nuisance: Nuisance, flows: list[IntArray] | None = None) -> Reading:
    """The values of `names_of` of a model of `Waves`, of every flow of its waves; None: of all."""
    family = model.family
    assert isinstance(family, Waves)
    theta = model.joined(model.parameters, model.weights, model.coefficients)

    def read(thetas: Array) -> Array:
        parameters, weights, coefficients = model.split(thetas)
        phases = family.pattern.phases(parameters.reshape(-1, family.parameters))
        phases = phases.reshape(len(thetas), -1, 3)
        ratios = np.array([nuisance.ratio(own) for own in coefficients])
        amplitudes = weights.reshape(len(thetas), -1, 2) / ratios[:, None, None]
        drifting = family.pattern.drifting
        every = [_of_flow(phases[:, i], amplitudes[:, i], drifting=drifting) for i in parts]
        return np.concatenate(every, axis=1)

    parts = flows or [np.arange(len(phases_of(model)[0]))]
    names = names_of(family, len(model.parameters)) * len(parts)
    steps = STEP * _sizes(model)
    around = np.diag(steps)
    here, after, before = np.split(
        read(theta + np.vstack([0 * steps, around, -around])), [1, 1 + len(steps)]
    )
    values, gradients = here[0], (after - before).T / (2 * steps)
    limits = FIRST_ORDER * np.abs(values)
    limits[[name == "heading" for name in names]] = TURN
    limits[[name in DRIFT for name in names]] = math.inf
    norms = np.array([name in ("mean_velocity", "timescale") for name in names])
    return Reading(names, values, gradients, limits, norms)


def phases_of(model: Model) -> tuple[Array, Array]:
    """(k_x, k_y, omega) of a model's waves (J, 3), and their amplitudes (J, 2)."""
    assert isinstance(model.family, Waves)
    phases = model.family.pattern.phases(model.parameters).reshape(-1, 3)
    return phases, model.weights.reshape(-1, 2)


def _sizes(model: Model) -> Array:
    """The size of every entry of theta: parts are alike."""
    sizes = [np.full_like(model.parameters, float(np.abs(model.parameters).max()))]
    weights = np.full_like(model.weights, float(np.abs(model.weights).max()))
    return model.joined(sizes[0], weights, np.ones_like(model.coefficients))


def values_of(phases: Array, amplitudes: Array, *, drifting: bool) -> Array:
    """The values of `names_of` of the fastest flow of waves (J, 3), amplitudes (J, 2)."""
    flows = flows_of(phases, amplitudes)
    every = [_of_flow(phases[None, i], amplitudes[None, i], drifting=drifting)[0] for i in flows]
    return max(every, key=lambda values: float(values[0]))


def flows_of(phases: Array, amplitudes: Array) -> list[IntArray]:
    """The places of the waves of every flow: of four waves that are two flows of cells, or of all.

    Args:
        phases: (k_x, k_y, omega) of waves (J, 3).
        amplitudes: a and b of each, (J, 2).
    """
    if len(phases) != 4:
        return [np.arange(len(phases))]
    pairings = [np.array([[0, j], sorted({1, 2, 3} - {j})]) for j in (1, 2, 3)]
    size = np.log(np.maximum(np.hypot(*amplitudes.T), np.finfo(float).tiny))
    length = np.log(np.hypot(*phases[:, :2].T))
    along = phases[:, :2] / np.exp(length)[:, None]

    def unlike(pairing: IntArray) -> float:
        first, second = pairing.T
        apart = np.abs(size[first] - size[second]) + np.abs(length[first] - length[second])
        turned = np.abs(np.sum(along[first] * along[second], axis=1))
        return float(np.sum(apart + ANGLE * turned))

    best = min(pairings, key=unlike)
    if np.abs(np.diff(size[best], axis=1)).max() > ALIKE:
        return [np.arange(4)]
    return list(best)


def _of_flow(phases: Array, amplitudes: Array, *, drifting: bool) -> Array:
    """U0, L, tau_w (b, ...) of waves (b, J, 3), amplitudes (b, J, 2), for any number b of flows.

    Of two waves or more L_x, L_y, heading and, where they drift, the drift follow.
    """
    squares = np.sum(phases[..., :2] ** 2, axis=2)
    powers = squares * np.sum(amplitudes**2, axis=2)
    strongest = np.sort(np.argsort(-powers, axis=1, kind="stable")[:, :2], axis=1)
    speed = np.sqrt(np.sum(powers, axis=1))
    scale = math.pi * np.sqrt(2.0 / np.take_along_axis(squares, strongest, 1).mean(axis=1))
    timescale = np.divide(scale, speed, out=np.full_like(speed, math.inf), where=speed > 0)
    values = np.stack([speed, scale, timescale], axis=1)
    if phases.shape[1] < 2:
        return values
    pair = np.take_along_axis(phases, strongest[:, :, None], 1)
    first, second = pair[:, 0, :2], pair[:, 1, :2]
    both = first / np.hypot(*first.T)[:, None] + second / np.hypot(*second.T)[:, None]
    heading = np.arctan2(both[:, 1], both[:, 0])
    quarters = np.round(heading / (0.5 * math.pi))
    sides = [2 * math.pi / np.hypot(*one.T) for one in (first + second, first - second)]
    odd = quarters % 2 > 0
    cells = [np.where(odd, *sides[::-1]), np.where(odd, *sides), heading - 0.5 * math.pi * quarters]
    values = np.column_stack([values, *cells])
    if drifting:
        values = np.hstack([values, np.linalg.solve(pair[..., :2], pair[..., 2:])[..., 0]])
    return values
