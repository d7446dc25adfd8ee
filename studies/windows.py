"""How long one must fly: the duration from which on the median flight, and 9 of 10, is known so well."""

import pandas as pd

from sparsefit.study.measures import measure

LIMITS = (5.0, 1.0)  # percent, of the largest error of U0, L_w and tau_w


def needed(cases):
    """Return the least duration [s] from which on, at every longer one too, a limit is kept."""
    rows = {}
    for title, here in cases.groupby("title", sort=False):
        row = rows.setdefault(title, {})
        for summary in ("median", "9 of 10"):
            error = measure(f"{summary} largest-error")
            parts = here.groupby("flights.duration")
            told = {time: error.summary_of(error.values(part)) for time, part in parts}
            for limit in LIMITS:
                kept = [time for time in told if all(told[t] <= limit for t in told if t >= time)]
                row[summary, f"within {limit:g} % [s]"] = min(kept, default=float("nan"))
    frame = pd.DataFrame.from_dict(rows, orient="index").rename_axis("title")
    frame.attrs["title"] = "Duration needed"
    return frame
