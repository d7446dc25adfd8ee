"""Residuals and BIC of the shapes that the ladder fits."""

import matplotlib.pyplot as plt

import sparsefit as sf

flow = sf.flows.ShapedCells(
    mean_velocity=15.43, length_scales=(4.21, 5.05), heading=0.3, drift=(0.5, 0.2)
)
vehicle = sf.PointMassVehicle(response_time=0.5, thrust_acceleration=(5.0, 3.0))
flight = sf.simulate_flight(
    flow, vehicle, duration=15.0, sample_rate=50.0, seed=1, velocity_noise=0.1, position_noise=0.02
)
estimate = sf.Estimator().estimate(flight)

rungs = sorted(estimate.rungs, key=lambda rung: -rung.residual)
names = [f"{rung.shape}{', drifting' if rung.drifting else ''}" for rung in rungs]
figure, axes = plt.subplots(figsize=(8.0, 0.42 * len(rungs) + 1.2))
colours = ["#d55e00" if rung.bic == 0.0 else "#0072b2" for rung in rungs]
bars = axes.barh(names, [100.0 * rung.residual for rung in rungs], color=colours)
axes.bar_label(
    bars, [f"BIC +{rung.bic:.0f}" if rung.bic else "chosen" for rung in rungs], padding=4
)
axes.set(xlabel="residual energy of the flow velocity [%]", xscale="log")
axes.set_xlim(right=1000.0)
