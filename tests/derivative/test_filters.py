import numpy as np
import pytest

from sparsefit.derivative import Derivative
from sparsefit.derivative.filters import DEGREE, Filters
from sparsefit.derivative.transform import fast_length
from sparsefit.flight import Flight, simulate_flight
from sparsefit.flight.flow import CellularFlow
from sparsefit.flight.vehicle import PointMassVehicle

VEHICLE = PointMassVehicle(0.5, (5.0, 3.0))
FLOW = CellularFlow(12.0, 4.0)
RULES = [
    Derivative("forward"),
    Derivative("central"),
    Derivative("midpoint"),
    Derivative("savgol", 5, 4),
    Derivative("savgol", 15, 4),
    Derivative(),
]


@pytest.fixture(scope="module")
def exact():
    return simulate_flight(FLOW, VEHICLE, duration=6.0, sample_rate=100.0, seed=2)


@pytest.fixture(scope="module")
def noisy(exact):
    rng = np.random.default_rng(0)
    shape = exact.position.shape
    return Flight(
        time=exact.time,
        position=exact.position + 0.05 * rng.standard_normal(shape),
        velocity=exact.velocity + 0.2 * rng.standard_normal(shape),
        vehicle=VEHICLE,
    )


def applied(kernel, *series):
    """Weighted sums (m - n + 1, 2) of series (m, 2) by a kernel per series."""
    columns = [
        [np.correlate(column, one, "valid") for column in values.T]
        for one, values in zip(kernel, series, strict=True)
    ]
    return np.sum(columns, axis=0).T


@pytest.mark.parametrize("rule", RULES, ids=str)
def test_raw_weights_are_the_derivative(rule, noisy):
    samples = rule(noisy)
    filters = Filters.of(samples)
    for kernel, values in zip(
        filters.raw, (samples.position, samples.velocity, samples.acceleration), strict=True
    ):
        found = applied(kernel, noisy.position, noisy.velocity)
        np.testing.assert_allclose(found, values, atol=1e-9)


@pytest.mark.parametrize("rule", RULES, ids=str)
def test_the_mean_of_the_acceleration_is_the_filtered_one(rule, exact, noisy):
    # P takes the exact V' to what the derivative makes of the exact path; noise picks the window.
    samples = rule(noisy)
    filters = Filters.of(samples)
    window, half = filters.raw.shape[2], len(filters.mean) // 2
    read = applied(filters.raw[2], exact.position, exact.velocity)
    truth = VEHICLE.acceleration(exact.velocity, FLOW.velocity(*exact.position.T))
    middle = read[half : len(read) - half]
    if rule.method == "midpoint":  # P stands on the samples: between those of the flight
        pytest.skip("no samples of V' between the flight's")
    first = half + (window // 2 if window != 2 else 0)
    plain = truth[first : first + len(middle)]
    start = first - half
    by_mean = applied([filters.mean], truth[start : start + len(middle) + 2 * half])
    bias, error = np.std(middle - plain), np.std(middle - by_mean)
    assert error < 0.02 * bias + 1e-6


def test_forward_differences_are_means_over_their_step():
    time = np.arange(40) * 0.1
    flight = Flight(
        time=time,
        position=np.column_stack([time**4 / 12, time**3 / 6]),
        velocity=np.column_stack([time**3 / 3, time**2 / 2]),
        vehicle=VEHICLE,
    )
    filters = Filters.of(Derivative("forward")(flight))
    places = np.arange(DEGREE + 1) - DEGREE / 2
    # Means over [0, 1] of 1, t, t^2: 1, 1/2, 1/3.
    moments = [filters.mean @ places**j for j in range(3)]
    assert moments == pytest.approx([1.0, 1 / 2, 1 / 3])
    assert filters.kicks == pytest.approx([1.0])


@pytest.mark.parametrize("rule", RULES, ids=str)
def test_weights_sum_to_one(rule, noisy):
    filters = Filters.of(rule(noisy))
    assert filters.mean.sum() == pytest.approx(1.0)
    assert filters.kicks.sum() == pytest.approx(1.0)
    assert filters.path[0, 0].sum() == pytest.approx(1.0)


def test_kicks_are_what_a_jump_in_the_acceleration_does(noisy):
    # V' = 1 in one step, 0 elsewhere: velocity rises by h over it, position follows.
    filters = Filters.of(Derivative()(noisy))
    window, step = filters.raw.shape[2], 0.01
    for j in (0, window // 3, window - 2):
        time = step * (np.arange(window) - j)
        velocity = np.clip(time, 0.0, step)
        position = np.where(time >= step, step * (time - step / 2), 0.0)
        found = filters.raw[2] * [position, velocity]
        assert found.sum() == pytest.approx(filters.kicks[j], abs=1e-9)


def test_uneven_steps_have_no_weights_on_samples(noisy):
    time = noisy.time + 0.002 * np.sin(np.arange(len(noisy.time)))
    flight = Flight(time=time, position=noisy.position, velocity=noisy.velocity, vehicle=VEHICLE)
    filters = Filters.of(Derivative("midpoint")(flight))
    assert filters.mean is None
    assert filters.path is None


def test_fast_lengths_have_small_factors_only():
    for samples in (1, 2, 7, 97, 1009, 3001):
        found = fast_length(samples)
        assert samples <= found < 2 * samples + 1
        for factor in (2, 3, 5):
            while found % factor == 0:
                found //= factor
        assert found == 1
