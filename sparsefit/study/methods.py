"""Protocols against measurement noise: the table of medians, and two answers that it gives.

A protocol is a way to take derivatives, or what is believed of the vehicle. A failure counts as an
infinite error, so that no protocol gains by giving no answer.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from sparsefit.study.summary import (
    SYMBOLS,
    Group,
    StudyRecord,
    by_setting,
    estimated,
    factors,
    failures,
    grouped,
    numbers,
)
from sparsefit.study.table import SIGNIFICANT, Cell, Column, Table, significant

NOISE = "flights.measurement_noise"
FLOOR = 1e-6  # percent: smaller medians are quadrature and rounding, no ratio of them says anything
NOTE = (
    f"Median |percentage error| of {SYMBOLS['timescale']} at each measurement noise, velocity "
    "[m/s] / position [m]. A failure (no estimate) counts as an infinite error, and is counted."
)
NEAR = 1.005  # ratios below it are told as none


@dataclass(frozen=True, eq=False)
class Line:
    """The medians of one protocol, back-end setting and level of what else is swept.

    levels: each a noise and the median |error| of tau_w [%] there.
    """

    protocol: str
    setting: str
    others: tuple[Cell, ...]
    levels: dict[str, float]
    failures: int
    cases: int


def noise_label(level: object) -> str:
    """`0.5 / 0.1` from the level `[0.5,0.1]` of the sweep; a level that is no pair as it is."""
    try:
        values = json.loads(str(level))
    except json.JSONDecodeError:
        return str(level)
    return " / ".join(f"{one:g}" for one in values) if isinstance(values, list) else str(level)


def median_size(cases: pd.DataFrame) -> float:
    """Median |% error| of tau_w, an observed value; a failure is an infinite error."""
    truth = numbers(cases, "true_timescale")
    size = 100 * np.abs(numbers(cases, "est_timescale") - truth) / truth
    infinite = np.where(estimated(cases), size, np.inf)
    return float(np.quantile(infinite, 0.5, method="inverted_cdf"))


def lines(cases: pd.DataFrame) -> list[Line]:
    """One line for each protocol, setting and level of the other swept factors."""
    others = [name for name in factors(cases) if name != NOISE]
    return [_line(group, others) for group in by_setting(cases, *others)]


def _line(group: Group, others: Sequence[str]) -> Line:
    levels = grouped(group.cases, [NOISE]) if NOISE in group.cases else [group]
    return Line(
        str(group.key["protocol"]),
        group.title,
        tuple(group.key[name] for name in others),
        {noise_label(one.key.get(NOISE, "all")): median_size(one.cases) for one in levels},
        failures(group.cases),
        len(group.cases),
    )


def methods(study: StudyRecord, cases: pd.DataFrame) -> Table:
    """Median |error| of tau_w: a row for each protocol and setting, a column for each noise."""
    every = lines(cases)
    others = [name for name in factors(cases) if name != NOISE]
    levels = list(dict.fromkeys(level for line in every for level in line.levels))
    columns = (
        *(Column(name, align="left") for name in (*others, "back-end", "protocol")),
        *(Column(level, "%", SIGNIFICANT, group="noise") for level in levels),
        Column("failures", align="right"),
    )
    ordered = sorted(every, key=lambda line: _place(every, line))
    rows = tuple(
        (
            *line.others,
            line.setting,
            line.protocol,
            *(line.levels.get(level) for level in levels),
            f"{line.failures}/{line.cases}",
        )
        for line in ordered
    )
    return Table(f"Protocols against measurement noise ({study.name})", columns, rows, (NOTE,))


def _place(every: list[Line], line: Line) -> tuple[int, int]:
    """Lines of equal levels and setting together, in order of first appearance."""
    others = list(dict.fromkeys(one.others for one in every))
    settings = list(dict.fromkeys(one.setting for one in every))
    return others.index(line.others), settings.index(line.setting)


def derivatives_answer(study: StudyRecord, cases: pd.DataFrame) -> str:
    """How far the choice of derivative moves the median error of tau_w, and how far the penalty."""
    sentences = []
    for others, own in _split(lines(cases)):
        name = f"With {' and '.join(f'{one}' for one in others)}" if others else "Overall"
        parts = [_of_level(level, own) for level in own[0].levels]
        sentences.append(f"{name}: {'; '.join(parts)}.")
    return (
        f"The choice of derivative moves the median |error| of {SYMBOLS['timescale']} "
        "(measurement noise in m/s / m). " + " ".join(sentences)
    )


def _split(every: list[Line]) -> Iterator[tuple[tuple[Cell, ...], list[Line]]]:
    for others in dict.fromkeys(line.others for line in every):
        yield others, [line for line in every if line.others == others]


def _of_level(level: str, every: list[Line]) -> str:
    """At one noise: best and worst protocol at the median setting, and both factors."""
    by_protocol = _median_by(every, level, "protocol")
    best, worst = min(by_protocol, key=by_protocol.__getitem__), max(
        by_protocol, key=by_protocol.__getitem__
    )
    moved = _factor(by_protocol)
    within = [
        _factor({line.setting: line.levels[level] for line in every if line.protocol == protocol})
        for protocol in by_protocol
    ]
    low, high = by_protocol[best], by_protocol[worst]
    return (
        f"at {level} from {_percent(low)} ({best}) to {_percent(high)} ({worst}), "
        f"{_times(moved)}, the back-end and its penalty {_times(float(np.median(within)))}"
    )


def _median_by(every: list[Line], level: str, name: str) -> dict[str, float]:
    keys = dict.fromkeys(getattr(line, name) for line in every)
    return {
        key: float(
            np.quantile(
                [line.levels[level] for line in every if getattr(line, name) == key],
                0.5,
                method="inverted_cdf",
            )
        )
        for key in keys
    }


def _factor(values: dict[str, float]) -> float:
    sizes = [max(value, FLOOR) for value in values.values()]
    return max(sizes) / min(sizes)


def _times(factor: float) -> str:
    if factor < NEAR:
        return "not at all"
    if math.isinf(factor):
        return "without bound"
    return f"by a factor of {factor:.0f}" if factor >= 9.5 else f"by a factor of {factor:.2g}"


def _percent(value: float) -> str:
    if math.isinf(value):
        return "no answer"
    return f"{significant(value, 2)} %" if value >= FLOOR else f"below {FLOOR:g} %"


def vehicle_answer(study: StudyRecord, cases: pd.DataFrame) -> str:
    """What each protocol costs against the first one, which knows the vehicle."""
    every = lines(cases)
    protocols = list(dict.fromkeys(line.protocol for line in every))
    sentences = []
    for level in every[0].levels:
        medians = _median_by(every, level, "protocol")
        known = medians[protocols[0]]
        costs = [f"{one} {_percent(medians[one])}" for one in protocols[1:]]
        sentences.append(f"at {level}: {protocols[0]} {_percent(known)}, {', '.join(costs)}")
    return (
        f"Median |error| of {SYMBOLS['timescale']} (measurement noise in m/s / m) "
        f"{'; '.join(sentences)}."
    )
