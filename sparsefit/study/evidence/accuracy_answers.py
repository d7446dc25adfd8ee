"""How accurate, how soon, on which grid: the sentences of limits, windows and grids."""

from __future__ import annotations

import math

import pandas as pd

from sparsefit.study.evidence.efficiency import bounded, ratios, rms
from sparsefit.study.evidence.sentence import extremes, ranged, some
from sparsefit.study.evidence.summary import (
    PARAMETERS,
    REFINE,
    SYMBOLS,
    Group,
    StudyRecord,
    factors,
    failures,
    first_settings,
    grouped,
    quartiles,
)
from sparsefit.study.evidence.windows import LIMITS, SHARES, duration_groups, seconds_to


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
        words = ", ".join(f"{SYMBOLS[name]} {extremes(one)}" for name, one in values.items())
        lost = [100.0 * failures(one.cases) / len(one.cases) for one in groups]
        said.append(f"{protocol}: {words}, no estimate in {ranged(lost, ' %')} of the cases")
    flights = len(kept.drop_duplicates(["flight", *factors(cases)]))
    return f"Rms error over the Cramér-Rao bound in {flights} flights. {'; '.join(said)}."


def windows(study: StudyRecord, cases: pd.DataFrame) -> str:
    """Seconds until within 5 % and 1 %, for the median flight and 9 in 10; who agrees, together."""
    duration_groups(study, cases)
    said = []
    for protocol, groups in by_protocol(cases).items():
        names: dict[str, list[str]] = {}
        for one in groups:
            names.setdefault(_reached(one), []).append(one.title)
        words = [
            f"{'every back-end' if len(names) == 1 else some(who)} {reached}"
            for reached, who in names.items()
        ]
        said.append(f"{protocol}: {', '.join(words)}")
    limits = " / ".join(f"{limit:g} %" for limit in LIMITS)
    head = f"Seconds of flight from which on errors stay within {limits} ({', '.join(SHARES)})"
    return f"{head}. {'; '.join(said)}."


def _reached(group: Group) -> str:
    """`3 / 5 s and 8 / 12 s`, or never."""
    seconds = [
        [seconds_to(group.cases, limit, share) for limit in LIMITS] for share in SHARES.values()
    ]
    if all(math.isinf(one) for pair in seconds for one in pair):
        return "never"
    words = [
        " / ".join("never" if math.isinf(one) else f"{one:g}" for one in pair) for pair in seconds
    ]
    return " s and ".join(words) + " s"


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
