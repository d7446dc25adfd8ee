"""A LASSO path and the duality gap of every point."""

import matplotlib.pyplot as plt
import numpy as np

import sparsefit as sf
from sparsefit import backends

flow = sf.CellularFlow(mean_velocity=15.43, length_scale=4.2)
vehicle = sf.PointMassVehicle(response_time=0.5, thrust_acceleration=(5.0, 3.0))
flight = sf.simulate_flight(
    flow, vehicle, duration=8.0, sample_rate=50.0, seed=7, velocity_noise=0.3, position_noise=0.05
)
problem = sf.Estimator().prepare(flight).problem
penalties = np.geomspace(1.0, 1e-3, 40)
path = sf.path(problem, backends.get("lasso"), penalties.tolist())

by_scale = [
    np.linalg.norm(path.weights[:, problem.groups == group], axis=(1, 2))
    for group in range(len(problem.group_scales))
]
largest = sorted(range(len(by_scale)), key=lambda group: -by_scale[group].max())[:5]

figure, (above, below) = plt.subplots(2, sharex=True, figsize=(8.0, 5.5), height_ratios=[2, 1])
for group, weights in enumerate(by_scale):
    if group in largest:
        label = f"{problem.group_scales[group]:.1f} m"
        above.plot(penalties, weights, linewidth=1.8, label=label)
    else:
        above.plot(penalties, weights, color="#999999", linewidth=0.6)
above.set(ylabel="norm of the weights [m/s]")
above.legend(title="length scale", frameon=False)
below.axhline(1e-8, color="#d55e00", linestyle="--")
below.annotate("tolerance", (0.7, 2e-8), color="#d55e00")
below.plot(penalties, np.maximum(np.abs(path.gaps), 1e-17), ".", color="#0072b2")
below.set(
    xscale="log", yscale="log", ylim=(1e-18, 1e-6), ylabel="duality gap", xlabel="alpha / alpha_max"
)
below.invert_xaxis()
