"""Where two flows are told apart: thirty cells flown, scales and velocities well apart."""

import json

import numpy as np
import pandas as pd

from sparsefit.study.measures import measure


def where(cases):
    """Return the share of flights with every scale found, where the flows are well apart or not."""
    pairs = [np.array(json.loads(text)) for text in cases["true_scales"]]  # (scale, velocity) each
    scales = np.array([np.sort(pair[:, 0]) for pair in pairs])
    speeds = np.array([np.sort(pair[:, 1]) for pair in pairs])
    apart = (cases["extent"] / scales[:, 1] >= 30.0 - 1e-6).to_numpy()
    ratios = scales[:, 1] / scales[:, 0], speeds[:, 0] / speeds[:, 1]
    apart = apart & (ratios[0] >= 1.3 - 1e-6) & (ratios[1] >= 0.3 - 1e-6)
    share = pd.DataFrame({"title": cases["title"], "apart": apart,
                          "found": 100.0 * measure("scales-found").values(cases)})  # fmt: skip
    frame = share.pivot_table(index="title", columns="apart", values="found", sort=False)
    frame = frame.rename(columns={True: "30 cells, ratios 1.3 and 0.3 [%]", False: "elsewhere [%]"})
    frame.attrs["title"] = "Share of flights with every length scale within 1 %"
    return frame
