"""The online answer against the batch answer of the same samples, and what a stream may do."""

from dataclasses import replace

import numpy as np
import pytest

import sparsefit as sf

VEHICLE = sf.PointMassVehicle(0.5, (5.0, 3.0))
FLOW = sf.CellularFlow(mean_velocity=6.0, length_scale=4.21)
LIBRARY = sf.Library(grid=sf.LengthScaleGrid(2.0, 8.0, step=0.5))
ESTIMATOR = sf.Estimator(
    derivative=sf.Derivative("savgol", window=7, repair=False),
    library=LIBRARY,
    backend="best-scale",
    readout=sf.Readout(refine="variable-projection"),
)
FLIGHT = sf.simulate_flight(
    FLOW, VEHICLE, duration=30.0, sample_rate=25.0, seed=7, velocity_noise=0.1, position_noise=0.02
)


def fed(online, flight, start=0, stop=None):
    rows = zip(flight.time, flight.position, flight.velocity, strict=True)
    for sample in list(rows)[start:stop]:
        online.update(*sample)
    return online


def online_of(estimator=ESTIMATOR, **kept):
    return sf.OnlineEstimator(estimator, vehicle=VEHICLE, **(kept or {"window": 8.0}))


def assert_same(online, batch, rounding=1e-11):
    assert (online.status, online.doubt, online.reason) == (batch.status, batch.doubt, batch.reason)
    for name in ("mean_velocity", "length_scale", "timescale"):
        own, other = getattr(online, name), getattr(batch, name)
        np.testing.assert_allclose(own, other, rtol=rounding, err_msg=name)
    assert online.grid_length_scale == batch.grid_length_scale
    assert online.samples == batch.samples
    assert (online.uncertainty is None) == (batch.uncertainty is None)
    if online.uncertainty is not None:
        np.testing.assert_allclose(
            online.uncertainty.length_scale_interval,
            batch.uncertainty.length_scale_interval,
            rtol=rounding,
        )


@pytest.mark.parametrize("method", ["forward", "midpoint", "central", "savgol"])
def test_the_answer_is_that_of_the_batch_on_the_same_window(method):
    derivative = sf.Derivative(method, repair=False)
    estimator = replace(ESTIMATOR, derivative=derivative)
    online = online_of(estimator)
    for start, stop in ((0, 40), (40, 203), (203, 555), (555, 751)):
        fed(online, FLIGHT, start, stop)
        flight = online.flight
        held = FLIGHT.time[:stop]
        np.testing.assert_array_equal(flight.time, held[held >= held[-1] - 8.0 - 1e-9])
        batch, scanned = estimator.estimate(flight), online.estimate(scan=True)
        assert_same(online.estimate(), batch)
        assert_same(scanned, batch)
        np.testing.assert_allclose(scanned.rival_length_scale, batch.rival_length_scale, rtol=1e-9)


@pytest.mark.parametrize("backend", ["lasso", "group-lasso", "stlsq"])
def test_other_back_ends_and_readouts_agree_too(backend):
    readout = sf.Readout(refine="none")
    estimator = replace(ESTIMATOR, backend=backend, readout=readout)
    online = fed(online_of(estimator, window=12.0), FLIGHT, 0, 500)
    assert_same(online.estimate(), estimator.estimate(online.flight), 1e-7)
