"""Spectra of the residuals of two flights."""

import matplotlib.pyplot as plt
import numpy as np
from scipy.signal import welch

import sparsefit as sf

cells = sf.CellularFlow(mean_velocity=15.43, length_scale=4.21)
gusts = sf.flows.Turbulence(intensity=1.0, length=8.0, seed=5)
vehicle = sf.PointMassVehicle(response_time=0.5, thrust_acceleration=(5.0, 3.0))
flows = {"calm": cells, "turbulence": sf.flows.SuperposedFlow((cells, gusts))}
estimator = sf.Estimator(readout=sf.Readout(refine="variable-projection"))

figure, axes = plt.subplots(figsize=(8.0, 4.5))
for (name, flow), colour in zip(flows.items(), ("#0072b2", "#d55e00"), strict=True):
    flight = sf.simulate_flight(
        flow, vehicle, duration=20.0, sample_rate=50.0, seed=2,
        velocity_noise=0.1, position_noise=0.02,
    )  # fmt: skip
    estimate = estimator.estimate(flight)
    samples = sf.Derivative()(flight)
    flow = estimate.flow.velocity(*samples.position.T, samples.time)
    residual = samples.flow_velocity(vehicle) - flow
    frequency, power = welch(residual, fs=50.0, nperseg=256, axis=0)
    width = np.ptp(estimate.uncertainty.length_scale_interval) / 2.0
    label = f"{name}: L = {estimate.length_scale:.4f} ± {width:.4f} m (95 %)"
    axes.loglog(frequency[1:], power.sum(axis=1)[1:], color=colour, label=label)
axes.set(xlabel="frequency [Hz]", ylabel="power of the residual [(m/s)²/Hz]")
axes.legend(frameon=False)
