"""What is read from waves: cells' sides, heading and drift, and how they change with theta."""

import math
from dataclasses import replace

import numpy as np
import pytest

import sparsefit as sf
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.library.equal_waves import EqualWaves
from sparsefit.library.nuisance import Nuisance
from sparsefit.library.waves import PAIR, RECTANGLE, SQUARE, Waves
from sparsefit.modes.fitted_rows import Rows
from sparsefit.modes.projection import project
from sparsefit.uncertainty.model import Model
from sparsefit.uncertainty.shape import values_of, waves

KNOWN = Nuisance((), PointMassVehicle(0.5, (5.0, 3.0)))
RNG = np.random.default_rng(9)
POSITION = np.column_stack([RNG.uniform(-9, 9, (50, 2)), np.linspace(-4, 4, 50)])


def model_of(family, q):
    values = family.values(POSITION, q)[0]
    flow = values.T @ RNG.standard_normal(len(values))
    rows = Rows(POSITION, flow.reshape(2, -1).T, np.zeros((2, len(POSITION), 0)))
    return Model.of(family, rows, project(family, rows, q))


def test_rectangles_that_drift_are_read_as_they_are():
    side, drift = np.array([2.0, 3.0]), np.array([0.7, -0.4])
    q = np.array([[*(math.pi / side), 0.0, 0.0, 0.4]])
    q[0, 2:4] = RECTANGLE.moving.phases(q)[0, :, :2] @ drift
    read = waves(model_of(Waves(RECTANGLE.moving), q), KNOWN)
    known = dict(zip(read.names, read.values, strict=True))
    np.testing.assert_allclose([known["length_scale_x"], known["length_scale_y"]], side)
    np.testing.assert_allclose([known["drift_x"], known["drift_y"]], drift)
    assert known["heading"] == pytest.approx(0.4)
    mean = 0.5 * np.sum((math.pi / side) ** 2)
    assert known["length_scale"] == pytest.approx(math.pi / math.sqrt(mean))
    assert known["timescale"] == pytest.approx(known["length_scale"] / known["mean_velocity"])


def test_the_mean_velocity_is_that_of_the_field():
    model = model_of(Waves(PAIR), np.array([[1.0, 0.5, -0.5, 1.0]]))
    axis = np.arange(64) * (4 * math.pi / 64)  # a period of both waves along x and along y
    place = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    field = model.family.values(place, model.parameters)[0].T @ model.weights[0]
    expected = math.sqrt(2 * float(np.sum(field**2)) / len(place))
    assert waves(model, KNOWN).values[0] == pytest.approx(expected)


def test_equally_strong_waves_know_more_than_free_ones():
    bound = model_of(EqualWaves(SQUARE), np.array([[0.9, 0.3, 1.1]]))
    free = replace(bound, tangent=None)
    spreads = [
        np.linalg.norm(model.information.basis.T @ waves(model, KNOWN).gradients.T, axis=0)
        for model in (bound, free)
    ]
    assert (spreads[0] <= spreads[1] * (1 + 1e-6)).all()
    own = bound.weights[0, :, 0]
    moved = bound.moved(RNG.standard_normal(bound.jacobian.size) * 1e-6).weights[0, :, 0]
    gap = np.hypot(*moved[:2]) - np.hypot(*moved[2:])
    assert abs(gap) < 1e-3 * np.abs(moved - own).max()  # they stay equally strong to first order


@pytest.mark.parametrize("degrees", [-44.0, -20.0, 0.0, 13.0, 44.0])
@pytest.mark.parametrize("sides", [(4.0, 4.0), (4.0, 7.0)])
def test_headings_and_length_scales_are_those_of_the_cells(degrees, sides):
    flow = sf.ShapedCells(5.0, sides, heading=math.radians(degrees))
    for signs in ([1, 1], [-1, 1], [-1, -1]):  # k and -k are one wave
        phases = np.zeros((2, 3))
        phases[:, :2] = flow.waves.wavevectors * np.array(signs)[:, None]
        amplitudes = np.column_stack([flow.waves.cosine, flow.waves.sine])
        _, scale, _, *read = values_of(phases, amplitudes, drifting=False)
        assert scale == pytest.approx(flow.length_scale)
        np.testing.assert_allclose(read, [*sides, math.radians(degrees)], atol=1e-12)
