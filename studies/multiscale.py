"""Where two flows are told apart: thirty cells flown, scales and velocities well apart."""

import numpy as np

from sparsefit.study.measures import measure

LEAST = {"cells": 30.0, "scale-ratio": 1.3, "velocity-ratio": 0.3}


def where(cases):
    """Return the share of flights with every scale found, where the flows are well apart or not."""
    told = cases.assign(
        apart=np.all([measure(name).values(cases) >= least - 1e-6 for name, least in LEAST.items()],
                     axis=0),
        found=measure("scales-found").values(cases),
    )  # fmt: skip
    share = 100.0 * told.pivot_table(index="title", columns="apart", values="found", sort=False)
    frame = share.rename(columns={True: "30 cells, ratios 1.3 and 0.3 [%]", False: "elsewhere [%]"})
    frame.attrs["title"] = "Share of flights with every length scale within 1 %"
    return frame
