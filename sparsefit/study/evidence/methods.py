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

from sparsefit.study.evidence.summary import (
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
from sparsefit.study.evidence.table import SIGNIFICANT, Cell, Column, Table, significant

NOISE = "flights.measurement_noise"
FLOOR = 1e-6  # percent: smaller medians are quadrature and rounding, no ratio of them says anything
_FLOOR = "0.000001 %"
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
    names = [name.rpartition(".")[2] for name in factors(cases) if name != NOISE]
    sentences = []
    for others, own in _split(lines(cases)):
        told = [f"{name} = {one}" for name, one in zip(names, others, strict=True)]
        condition = f"with {', '.join(told)}, " if told else ""
        ranges = [_range(level, own) for level in own[0].levels]
        sentences.append(f"{condition}{', '.join(ranges)}; {_penalty(own)}")
    return (
        f"By the choice of derivative the median |error| of {SYMBOLS['timescale']} goes, at "
        f"measurement noise in m/s / m: {'. '.join(one[0].upper() + one[1:] for one in sentences)}."
    )


def _split(every: list[Line]) -> Iterator[tuple[tuple[Cell, ...], list[Line]]]:
    for others in dict.fromkeys(line.others for line in every):
        yield others, [line for line in every if line.others == others]


def _range(level: str, every: list[Line]) -> str:
    """Best and worst protocol at one noise, each by its median setting."""
    medians = _medians(every, level)
    low, high = min(medians.values()), max(medians.values())
    best, worst = (
        ", ".join(name for name, value in medians.items() if value == one) for one in (low, high)
    )
    return f"at {level} from {_percent(low)} ({best}) to {_percent(high)} ({worst})"


def _penalty(every: list[Line]) -> str:
    """The largest ratio of medians over back-ends and penalties, one derivative at one noise."""
    largest = 1.0
    for protocol in dict.fromkeys(line.protocol for line in every):
        own = [line for line in every if line.protocol == protocol]
        for level in own[0].levels:
            sizes = [max(line.levels[level], FLOOR) for line in own]
            if math.isfinite(min(sizes)):  # where no setting has an answer, there is no ratio
                largest = max(largest, max(sizes) / min(sizes))
    return f"back-end and penalty, for any one derivative, move it {_times(largest)}"


def _medians(every: list[Line], level: str) -> dict[str, float]:
    """By protocol, the median over the settings of the medians at one noise."""
    return {
        protocol: _middle([line.levels[level] for line in every if line.protocol == protocol])
        for protocol in dict.fromkeys(line.protocol for line in every)
    }


def _middle(values: list[float]) -> float:
    return float(np.quantile(values, 0.5, method="inverted_cdf"))


def _times(factor: float) -> str:
    if factor < NEAR:
        return "not at all"
    if math.isinf(factor):
        return "from an answer to none"
    return f"by a factor of at most {significant(factor, 2)}"


def _percent(value: float) -> str:
    if math.isinf(value):
        return "no answer"
    return f"{significant(value, 2)} %" if value >= FLOOR else f"below {_FLOOR}"


def vehicle_answer(study: StudyRecord, cases: pd.DataFrame) -> str:
    """The medians of every protocol over the noise; at the last one, in units of the first's."""
    sentences = []
    for _, own in _split(lines(cases)):
        by_level = [_medians(own, level) for level in own[0].levels]
        first, *_ = by_level[0]
        told = [
            f"{protocol} {', '.join(_percent(medians[protocol]) for medians in by_level)}"
            + ("" if protocol == first else _ratio(by_level[-1][protocol], by_level[-1][first]))
            for protocol in by_level[0]
        ]
        sentences.append("; ".join(told))
    levels = ", ".join(lines(cases)[0].levels)
    return (
        f"Median |error| of {SYMBOLS['timescale']} at measurement noise {levels} (m/s / m): "
        f"{'. '.join(sentences)}; in brackets, against {first} at the last noise."
    )


def _ratio(value: float, reference: float) -> str:
    finite = math.isfinite(value) and FLOOR < reference < math.inf
    return f" (× {significant(value / reference, 2)})" if finite else ""
