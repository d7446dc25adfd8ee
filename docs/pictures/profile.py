"""How often is the error at most so large?
95 flights of the paper's Table 2, read on its grid (better readouts, one setting each): the share
of flights whose length scale is off by at most x. A flight without an estimate never gets there.
Drawn from results/table2/cases.parquet. Half a grid step is about 1 %; plain least squares chooses
other scales.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

root = next(folder for folder in Path(__file__).resolve().parents if (folder / "results").exists())
cases = pd.read_parquet(root / "results" / "table2" / "cases.parquet")
cases = cases[cases.protocol == "better readouts"]
settings = {
    "least-squares": '"rcond":null',
    "stlsq": '"threshold":0.03',
    "lasso": '"alpha_fraction":0.1,',
    "group-lasso": '"alpha_fraction":0.1,',
}

figure, axes = plt.subplots(figsize=(8.0, 4.5))
for backend, setting in settings.items():
    kept = cases[(cases.backend == backend) & cases.settings.str.contains(setting, regex=False)]
    error = 100.0 * (kept.est_length_scale / kept.true_length_scale - 1.0).abs()
    error = np.sort(error.fillna(np.inf))
    axes.step(error, 100.0 * np.arange(1, len(error) + 1) / len(error), where="post", label=backend)
axes.set(xscale="log", xlim=(0.01, 300.0), ylim=(0.0, 101.0))
axes.set(xlabel="|error| of L_w [%]", ylabel="flights with at most so much [%]")
axes.legend(frameon=False)
