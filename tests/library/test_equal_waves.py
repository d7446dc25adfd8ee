"""Waves bound together: equally strong, or with amplitudes by piece; slopes are differences."""

import numpy as np

from sparsefit.library.equal_waves import EqualWaves
from sparsefit.library.pieced_waves import PiecedWaves
from sparsefit.library.waves import AXIS, RECTANGLE, SQUARE, Waves
from sparsefit.modes.fitted_rows import Rows
from sparsefit.modes.projection import project

STEP = 1e-6
RNG = np.random.default_rng(3)
POSITION = np.column_stack([RNG.uniform(-9, 9, (30, 2)), np.linspace(-4, 4, 30)])


def check_bent(family, q, weights):
    bent = family.bent(POSITION, q, family.values(POSITION, q), weights)
    for i, unit in enumerate(np.eye(q.shape[1])):
        ends = [
            family.values(POSITION, q + sign * STEP * unit).swapaxes(1, 2) @ weights
            for sign in (1, -1)
        ]
        np.testing.assert_allclose(bent[:, i], (ends[0] - ends[1]) / (2 * STEP), atol=1e-6)


def test_slopes_are_those_of_differences():
    check_bent(
        EqualWaves(RECTANGLE.moving),
        np.array([[0.7, 0.5, 0.8, -0.4, 0.3, 1.2]]),
        np.array([[[1.3], [-0.4]]]),
    )
    check_bent(PiecedWaves(SQUARE.moving, 3), np.array([[0.7, 0.8, -0.4, 0.3]]),
               RNG.standard_normal((1, 12, 1)))  # fmt: skip


def test_freed_waves_are_the_same_flow_equally_strong():
    family, q, weights = EqualWaves(AXIS), np.array([[0.7, 1.2]]), np.array([[[1.3], [-0.4]]])
    parameters, own, tangent = family.freed(q, weights)
    np.testing.assert_allclose(np.hypot(*own[0, :2]), np.hypot(*own[0, 2:]))
    flows = [
        one.values(POSITION, at)[0].T @ by[0]
        for one, at, by in ((family, q, weights), (Waves(AXIS), parameters, own))
    ]
    np.testing.assert_allclose(*flows, atol=1e-13)
    theta = np.concatenate([q.ravel(), weights.ravel()])

    def free(at):
        k, w, _ = family.freed(at[None, :2], at[2:].reshape(1, 2, 1))
        return np.concatenate([k.ravel(), w.ravel()])

    for i, unit in enumerate(STEP * np.eye(4)):
        slope = (free(theta + unit) - free(theta - unit)) / (2 * STEP)
        np.testing.assert_allclose(tangent[:, i], slope, atol=1e-8)


def test_waves_that_are_equally_strong_are_bound_without_loss():
    family, q = EqualWaves(AXIS), np.array([[0.7, 1.2]])
    flow = family.values(POSITION, q)[0].T @ [1.3, -0.4]
    rows = Rows.plain(POSITION[:, :2], flow.reshape(2, -1).T)
    free = project(Waves(AXIS), rows, q[:, :1])
    fit = project(family, rows, family.bound(free.parameters, free.weights))
    assert fit.residual < 1e-20


def test_one_piece_is_the_flight():
    whole, q = Waves(SQUARE), np.array([[0.7, 0.3]])
    values = PiecedWaves(SQUARE, 1).values(POSITION, q)
    np.testing.assert_array_equal(values, whole.values(POSITION, q))
    parts = PiecedWaves(SQUARE, 4).values(POSITION, q).reshape(4, 4, -1)
    np.testing.assert_array_equal(parts.sum(axis=0), whole.values(POSITION, q)[0])
