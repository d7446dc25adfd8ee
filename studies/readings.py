"""Which reading of the paper comes closest to its Table 2, and on which choice the errors hang."""

import numpy as np
import pandas as pd

from sparsefit.study.measures import answered, factors, measure, three

PAPER = [-18.80, -5.91, 33.30]  # percent: mean signed errors of U0, L_w, tau_w


def closest(cases):
    """Return every reading with its distance to the paper's three numbers, the closest first."""
    errors = pd.DataFrame({name: measure(name).values(cases) for name in three("signed-error")})
    errors[["title", "condition"]] = cases[["title", "condition"]]
    errors["failures"] = ~answered(cases)
    mean = errors.groupby(["title", "condition"], sort=False).agg(
        {**dict.fromkeys(three("signed-error"), "mean"), "failures": "sum"}
    )
    off = mean[list(three("signed-error"))] - PAPER
    mean["distance [pp]"] = np.sqrt((off**2).mean(axis=1, skipna=False))
    frame = mean.sort_values("distance [pp]")
    frame.attrs["title"] = "Readings, closest to the paper's Table 2 first"
    return frame


def one_at_a_time(cases):
    """Return how far the median |error| of tau_w moves when one factor alone changes."""
    keys = ["protocol", "label", "settings", *factors(cases)]
    error = pd.Series(np.abs(measure("timescale-signed-error").values(cases)), cases.index)
    told = error.groupby([cases[key] for key in keys]).median()
    rows = {}
    for key in factors(cases):
        moved = told.groupby([other for other in keys if other != key]).agg(np.ptp)
        rows[key] = {"median range [pp]": moved.median(), "largest range [pp]": moved.max()}
    frame = pd.DataFrame.from_dict(rows, orient="index").rename_axis("factor")
    frame = frame.sort_values("median range [pp]", ascending=False)
    frame.attrs["title"] = "How far the median error of tau_w moves with one factor alone"
    return frame
