"""A flight, an estimator that can follow it, and what two estimates have to agree in."""

import numpy as np

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
