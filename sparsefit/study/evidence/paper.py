"""The numbers the paper prints (Tables 1 and 2), in the order U0 [m/s], L_w [m], tau_w [s]."""

from __future__ import annotations

from collections.abc import Iterable

TRUE = (15.43, 4.21, 0.27)
ESTIMATE = (15.95, 4.20, 0.26)
ESTIMATE_PERCENT = (3.37, -0.24, -3.70)
MEAN_ERROR = (-4.43, -0.17, 0.10)
MEAN_PERCENT = (-18.80, -5.91, 33.30)
FLIGHTS = 95

# What the paper leaves open: every one is a setting of a study's [flights] section.
UNPRINTED = {
    "response_time": "inertial response time tau [s]",
    "thrust_acceleration": "thrust acceleration [m/s²]",
    "duration": "duration of a flight [s]",
    "sample_rate": "sampling rate [Hz]",
    "process_noise": "process noise [m/s²]",
    "position_noise": "position noise [m]",
    "velocity_noise": "velocity noise [m/s]",
    "length_scale": "range of the random length scale [m]",
    "initial_position": "initial position [m]",
}


def is_paper_flight(mean_velocity: Iterable[float], length_scale: Iterable[float]) -> bool:
    """Whether every case flew the flow of Table 1 (to the digits printed)."""
    return all(round(value, 2) == TRUE[0] for value in mean_velocity) and all(
        round(value, 2) == TRUE[1] for value in length_scale
    )
