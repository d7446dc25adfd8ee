"""The certificate of a group-LASSO of waves over the whole plane of wavevectors.
Two flows of cells at once, one of them turned. Where the map is at most 1 no wave is worth adding,
at any wavevector; it touches 1 at the waves that were chosen (circles).
"""

import matplotlib.pyplot as plt

import sparsefit as sf
from sparsefit import backends
from sparsefit.estimator.certificate_map import certificate_map

flow = sf.flows.SuperposedFlow(
    (
        sf.flows.ShapedCells(mean_velocity=10.0, length_scales=5.0, heading=0.3),
        sf.CellularFlow(mean_velocity=6.0, length_scale=3.6),
    )
)
vehicle = sf.PointMassVehicle(response_time=0.5, thrust_acceleration=(5.0, 3.0))
flight = sf.simulate_flight(
    flow, vehicle, duration=12.0, sample_rate=25.0, seed=3, velocity_noise=0.05, position_noise=0.01
)
library = sf.Library(grid=sf.model.LengthScaleGrid(lower=3.0, upper=8.0), family="waves")
gridless = backends.get("gridless-group-lasso", alpha_fraction=0.1)
shown = certificate_map(sf.Estimator(library=library, backend=gridless), flight)

figure, axes = plt.subplots(figsize=(6.5, 5.2))
ends = (shown.axis[0], shown.axis[-1])
image = axes.imshow(
    shown.eta.T, origin="lower", extent=(*ends, *ends), cmap="viridis", vmin=0.0, vmax=1.0
)
figure.colorbar(image, label="certificate η")
for sign in (1.0, -1.0):
    axes.scatter(*(sign * shown.wavevectors.T), s=60, facecolors="none", edgecolors="#d55e00")
axes.set(xlabel="$k_x$ [rad/m]", ylabel="$k_y$ [rad/m]")
axes.set_title(f"largest η: {shown.highest:.6f}", loc="left")
