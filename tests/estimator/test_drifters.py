"""Real drifters (GLAD, Gulf of Mexico 2012): water that is no cellular flow is not called one."""

from pathlib import Path

import numpy as np
import pytest

import sparsefit as sf
from tests.problems import VEHICLE, fly

FILE = Path(__file__).parents[2] / "studies" / "drifters" / "drifter_079.csv"
EVERY = 900.0  # s
DAY = 96  # samples
WATER = sf.PointMassVehicle(60.0)  # follows the water
GRID = sf.model.LengthScaleGrid(2e3, 200e3, spacing="flight")


@pytest.fixture(scope="module")
def track():
    """x east and y north [m], (m, 2)."""
    flight = sf.read_flight(FILE)
    assert not flight.velocity_measured
    assert flight.vehicle == WATER
    assert np.all(np.diff(flight.time) == EVERY)
    return flight.position


PIECES = [(10, 0), *(pytest.param(*own, marks=pytest.mark.slow)
                    for own in ((10, 15), (5, 0), (5, 15), (25, 0)))]  # fmt: skip


@pytest.mark.parametrize(("days", "first"), PIECES)
def test_no_piece_of_a_drifter_is_called_a_cellular_flow(track, days, first):
    position = track[first * DAY : (first + days) * DAY]
    flight = sf.Flight.from_positions(EVERY * np.arange(len(position)), position, WATER)
    estimate = sf.Estimator(library=sf.Library(GRID)).estimate(flight)
    assert estimate.status in ("unidentifiable", "misfit")
    assert estimate.reason
    assert not estimate.repairs.words


def test_a_grid_of_metres_is_refused_for_a_sea(track):
    flight = sf.Flight.from_positions(EVERY * np.arange(5 * DAY), track[: 5 * DAY], WATER)
    with pytest.raises(sf.InputError, match="too small for a flight of"):
        sf.Estimator().estimate(flight)


def test_positions_alone_tell_a_cellular_flow():
    logged = fly(sf.CellularFlow(6.0, 4.0), duration=15.0, noise=(0.0, 0.002))
    flight = sf.Flight.from_positions(logged.time, logged.position, VEHICLE)
    estimate = sf.Estimator().estimate(flight)
    assert estimate.status == "ok"
    assert estimate.length_scale == pytest.approx(4.0, rel=5e-3)
    assert estimate.mean_velocity == pytest.approx(6.0, rel=3e-2)
