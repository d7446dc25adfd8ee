"""Distribution of the error of the length scale, by back-end."""

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

cases = pd.read_parquet("results/table2/cases.parquet")
cases = cases[cases.protocol == "better readouts"]
settings = {
    "least-squares": '"rcond":null',
    "stlsq": '"threshold":0.03',
    "lasso": '"alpha_fraction":0.1,',
    "group-lasso": '"alpha_fraction":0.1,',
}

figure, axes = plt.subplots(figsize=(8.0, 4.5))
for backend, setting in settings.items():
    rows = cases[(cases.backend == backend) & cases.settings.str.contains(setting, regex=False)]
    error = 100.0 * (rows.est_length_scale / rows.true_length_scale - 1.0).abs()
    error = np.sort(error.fillna(np.inf))
    axes.step(error, 100.0 * np.arange(1, len(error) + 1) / len(error), where="post", label=backend)
axes.set(xscale="log", xlim=(0.01, 300.0), ylim=(0.0, 101.0))
axes.set(xlabel="|error| of L_w [%]", ylabel="share of flights [%]")
axes.legend(frameon=False)
