"""How well the heading, the sides and the drift of cells are known, from so long a flight."""

import numpy as np
import pandas as pd

from sparsefit.study.measures import answered


def geometry(cases):
    """Return median sizes of the errors of heading, sides and drift, by world and seconds flown."""
    cases = cases[answered(cases)]
    turn = np.degrees(cases["est_heading"] - cases["true_heading"])
    true, estimate = (
        np.sort(cases[[f"{kind}_length_scale_x", f"{kind}_length_scale_y"]].astype(float))
        for kind in ("true", "est")
    )
    drift = np.hypot(*(
        cases[f"est_drift_{axis}"].fillna(0.0) - cases[f"true_drift_{axis}"] for axis in "xy"
    ))  # fmt: skip
    errors = pd.DataFrame({
        "protocol": cases["protocol"], "duration [s]": cases["flights.duration"],
        "heading [°]": np.abs((turn + 45.0) % 90.0 - 45.0),  # cells repeat after a quarter turn
        "worse side [%]": 100.0 * np.abs(estimate / true - 1.0).max(axis=1),
        "drift, of U0 [%]": 100.0 * drift / cases["true_mean_velocity"],  # steady: by 0
    })  # fmt: skip
    groups = errors.groupby(["protocol", "duration [s]"], sort=False)
    frame = groups.median().add_prefix("median |error| of ")
    frame.insert(0, "answered", groups.size())
    frame.attrs["title"] = "Heading, sides and drift of the cells"
    return frame
