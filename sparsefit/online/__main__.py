"""What following a flight takes on this machine: ``python -m sparsefit.online --help``."""

from __future__ import annotations

import argparse
import sys

import numpy as np

from sparsefit import backends
from sparsefit.derivative import Derivative
from sparsefit.errors import InputError
from sparsefit.estimator import Estimator
from sparsefit.flight import simulate_flight
from sparsefit.flight.flow import CellularFlow
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.modes import Readout
from sparsefit.online.clock import Clocked, clocked
from sparsefit.online.estimator import OnlineEstimator

QUANTILES = (50, 99, 100)


def main() -> None:
    """Simulate a flight, follow it once for every back-end asked for, and print the times."""
    asked = _arguments()
    vehicle = PointMassVehicle(response_time=0.5, thrust_acceleration=(5.0, 3.0))
    flight = simulate_flight(
        CellularFlow(mean_velocity=15.43, length_scale=4.21),
        vehicle,
        duration=asked.seconds,
        sample_rate=asked.rate,
        seed=7,
        velocity_noise=0.2,
        position_noise=0.05,
    )
    print("processor time: median, 99th percentile and largest")
    for name in asked.backend:
        estimator = Estimator(
            derivative=Derivative("savgol", window=11, order=4, repair=False),
            backend=backends.get(name),
            readout=Readout(refine=asked.refine),
        )
        online = OnlineEstimator(estimator, vehicle=vehicle, window=asked.window)
        online.rehearse()
        every = max(1, round(asked.every * asked.rate))
        print(f"{name:12} {_told(clocked(online, flight, every, asked.window))}")


def _told(times: Clocked) -> str:
    updates, estimates = (
        "/".join(f"{value:.{digits}f}" for value in scale * np.percentile(values, QUANTILES))
        for values, scale, digits in ((times.updates, 1e6, 0), (times.estimates, 1e3, 1))
    )
    return (
        f"{times.samples} samples x {times.columns} columns, {times.nbytes / 1e6:.0f} MB: "
        f"sample {updates} us, estimate {estimates} ms, {100 * times.answered:.0f} % ok"
    )


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m sparsefit.online", description=main.__doc__)
    parser.add_argument("--window", type=float, default=10.0, help="[s] (default: 10)")
    parser.add_argument("--rate", type=float, default=50.0, help="samples a second (default: 50)")
    parser.add_argument("--seconds", type=float, default=60.0, help="of flight (default: 60)")
    parser.add_argument("--every", type=float, default=0.2, help="[s] between estimates")
    parser.add_argument("--refine", default="variable-projection", help="as in Readout")
    parser.add_argument(
        "--backend", nargs="+", default=["best-scale", "lasso", "group-lasso", "stlsq"]
    )
    return parser.parse_args()


if __name__ == "__main__":
    try:
        main()
    except KeyboardInterrupt:
        sys.exit(130)
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
