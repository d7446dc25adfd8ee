"""A flight over the estimated flow."""

import matplotlib.pyplot as plt
import numpy as np

import sparsefit as sf

flow = sf.CellularFlow(mean_velocity=15.43, length_scale=4.21)
vehicle = sf.PointMassVehicle(response_time=0.5, thrust_acceleration=(12.0, 2.0))
flight = sf.simulate_flight(
    flow, vehicle, duration=10.0, sample_rate=100.0, seed=9, velocity_noise=0.1, position_noise=0.02
)
estimate = sf.Estimator().estimate(flight)

low, high = flight.position.min(axis=0) - 2.0, flight.position.max(axis=0) + 2.0
x, y = np.meshgrid(np.linspace(low[0], high[0], 360), np.linspace(low[1], high[1], 180))
u, v = np.moveaxis(estimate.flow.velocity(x, y, 0.0), -1, 0)

figure, axes = plt.subplots(figsize=(9.0, 4.2))
speed = axes.pcolormesh(x, y, np.hypot(u, v), cmap="Blues", shading="gouraud", rasterized=True)
figure.colorbar(speed, label="speed of the flow [m/s]")
axes.plot(*flight.position.T, color="#d55e00", linewidth=1.4)
axes.plot(*flight.position[0], "o", color="#d55e00")
axes.set(aspect="equal", xlabel="x [m]", ylabel="y [m]")
axes.set_title(
    f"L = {estimate.length_scale:.3f} m, U0 = {estimate.mean_velocity:.2f} m/s", loc="left"
)
