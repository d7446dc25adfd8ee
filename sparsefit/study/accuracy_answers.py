"""How accurate, how soon, on which grid: the sentences of limits, windows and grids."""

from __future__ import annotations

import math

import pandas as pd

from sparsefit.study.efficiency import bounded, ratios, rms
from sparsefit.study.error_figures import first_settings, quartiles
from sparsefit.study.grids_figure import REFINE
from sparsefit.study.sentence import extremes, ranged
from sparsefit.study.summary import (
    PARAMETERS,
    SYMBOLS,
    Group,
    StudyRecord,
    factors,
    failures,
    grouped,
)
from sparsefit.study.windows import LIMITS, SHARES, duration_groups, seconds_to


def by_protocol(cases: pd.DataFrame) -> dict[str, list[Group]]:
    """The first listed setting of each back-end, by protocol."""
    found: dict[str, list[Group]] = {}
    for group in first_settings(cases):
        found.setdefault(str(group.key["protocol"]), []).append(group)
    return found


def efficiency(study: StudyRecord, cases: pd.DataFrame) -> str:
    """Rms of error / bound of L_w and U0, from the best back-end to the worst."""
    kept, said = bounded(cases), []
    for protocol, groups in by_protocol(cases).items():
        values = {
            name: {one.title: rms(ratios(one.cases))[PARAMETERS.index(name)] for one in groups}
            for name in ("length_scale", "mean_velocity")
        }
        words = ", ".join(f"of {SYMBOLS[name]} {extremes(one)}" for name, one in values.items())
        lost = ranged([100.0 * failures(one.cases) / len(one.cases) for one in groups], " %")
        said.append(f"{protocol}: {words}, without an estimate {lost}")
    flights = len(kept.drop_duplicates(["flight", *factors(cases)]))
    return f"Rms error over the Cramér-Rao bound, {flights} flights; {'; '.join(said)}."


def windows(study: StudyRecord, cases: pd.DataFrame) -> str:
    """Seconds until within 5 % and 1 %, for the median flight and 9 in 10, best to worst."""
    duration_groups(study, cases)
    said = []
    for protocol, groups in by_protocol(cases).items():
        words = []
        for share, level in SHARES.items():
            for limit in LIMITS:
                seconds = {one.title: seconds_to(one.cases, limit, level) for one in groups}
                words.append(f"{share} within {limit:g} % after {_seconds(seconds)}")
        said.append(f"{protocol}: {', '.join(words)}")
    return f"{'; '.join(said)}."


def _seconds(values: dict[str, float]) -> str:
    if all(math.isinf(value) for value in values.values()):
        return "no duration flown"
    return extremes(values, " s").replace("∞ s", "no duration")


def grids(study: StudyRecord, cases: pd.DataFrame) -> str:
    """How far the median error of L_w moves from grid to grid, with and without refinement."""
    said = []
    for level in grouped(cases, [REFINE]):
        groups = first_settings(level.cases)
        medians = {
            backend: [
                float(quartiles(one.cases, "length_scale")[1])
                for one in groups
                if one.title == backend
            ]
            for backend in dict.fromkeys(one.title for one in groups)
        }
        every = [value for values in medians.values() for value in values]
        moves = {name: _factor(values) for name, values in medians.items()}
        said.append(
            f"with refine = {level.key[REFINE]} the median |error| of L_w is "
            f"{ranged(every, ' %')}, and the worst grid's is {extremes(moves)} times the best's"
        )
    return f"Over {cases['protocol'].nunique()} grids: {'; '.join(said)}."


def _factor(values: list[float]) -> float:
    low, high = min(values), max(values)
    return high / low if low > 0 else math.nan
