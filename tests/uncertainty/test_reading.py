"""What is read of theta: the gradients are those of differences, with anything unknown or not."""

import math
from dataclasses import replace

import numpy as np
import pytest

from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.library.cells import Cells, rms_mean_velocity
from sparsefit.library.nuisance import Nuisance
from sparsefit.modes.fitted_rows import Rows
from sparsefit.uncertainty.assessment import reader
from sparsefit.uncertainty.model import Model

VEHICLE = PointMassVehicle(0.4, (5.0, 3.0))
UNKNOWNS = [
    (),
    ("response_time",),
    ("wind",),
    ("response_time", "thrust_acceleration"),
    ("response_time", "wind"),
]


def model_of(nuisance):
    rng = np.random.default_rng(5)
    position, velocity = rng.uniform(-9, 9, (2, 40, 2))
    rows = Rows(position, np.zeros((40, 2)), nuisance.columns(velocity))
    weights = rng.standard_normal((2, 8, 2))
    return Model(
        Cells(), rows, np.array([[0.8], [1.1]]), weights, 0.3 * rng.random(rows.nuisance.shape[2])
    )


@pytest.mark.parametrize("unknown", UNKNOWNS)
def test_gradients_are_those_of_differences(unknown):
    nuisance = Nuisance(unknown, VEHICLE)
    model, read, step = model_of(nuisance), reader(nuisance), 1e-6
    reading = read(model)
    theta = model.joined(model.parameters, model.weights, model.coefficients)
    for i, shift in enumerate(step * np.eye(len(theta))):
        ends = []
        for sign in (1, -1):
            parameters, weights, coefficients = model.split(theta + sign * shift)
            moved = replace(
                model, parameters=parameters, weights=weights, coefficients=coefficients
            )
            ends.append(read(moved).values)
        difference = (ends[0] - ends[1]) / (2 * step)
        np.testing.assert_allclose(reading.gradients[:, i], difference, atol=1e-7)


@pytest.mark.parametrize("unknown", UNKNOWNS)
def test_values_are_those_of_the_flow_and_the_vehicle(unknown):
    nuisance = Nuisance(unknown, VEHICLE)
    model = model_of(nuisance)
    reading, vehicle = reader(nuisance)(model), nuisance.read(model.coefficients)
    ratio = VEHICLE.response_time / vehicle.response_time
    speeds = np.array([rms_mean_velocity(own) for own in model.weights]) / ratio
    scales = math.pi / model.parameters[:, 0]
    expected = np.stack([speeds, scales, scales / speeds], axis=1).ravel()
    np.testing.assert_allclose(reading.values[:6], expected)
    beside = [np.atleast_1d(getattr(vehicle, name)) for name in unknown]
    np.testing.assert_allclose(reading.values[6:], np.concatenate([[], *beside]))
    assert reading.names[:4] == ("mean_velocity", "length_scale", "timescale", "mean_velocity")
    assert set(reading.names[6:]) == set(unknown)
    assert reading.norms[:3].tolist() == [True, False, True]
    assert not reading.norms[6:].any()
