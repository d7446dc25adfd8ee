"""The tables of a selection: candidates with their verdicts, regimes, latency and memory."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial

from sparsefit.study.evidence.columns import setting_columns, setting_values
from sparsefit.study.evidence.resampling import RESAMPLES, Difference
from sparsefit.study.evidence.selection import Scored, Selection
from sparsefit.study.evidence.sentence import capital, shown
from sparsefit.study.evidence.table import SIGNIFICANT, Column, Table, Value
from sparsefit.study.evidence.verdicts import verdict
from sparsefit.study.spec.selection import AVERAGE, WORST

FASTER = 0.8  # of the median latency of the chosen one: less is told
SHOWN = 30  # rows that a page prints; CSV files have all of them


def selection_table(selection: Selection) -> Table:
    """Every candidate, the chosen first, with its scores and the reason why it lost."""
    criterion = selection.criterion
    names = list(selection.ranked[0].candidate.factors)

    def of(name: str, split: str) -> Column:
        measure = criterion.measure
        return Column(name, measure.unit, SIGNIFICANT, group=split, least=measure.least)

    columns = (
        Column("rank", format="d"),
        *setting_columns(names),
        *(of(name, "validate") for name in ("criterion", "worse by", "95 % from", "to")),
        Column("best", "%", ".0f", group="validate"),
        Column("more flights", "", ".0f", group="validate"),
        *(of(name, "evaluate") for name in ("criterion", "worse by", "95 % from", "to")),
        Column("verdict", align="left"),
    )
    ordered = _ordered(selection)
    rows = tuple(_row(selection, place, one) for place, one in enumerate(ordered, 1))
    notes = (
        f"Criterion: {criterion.words}; {criterion.measure.convention}. Worse by: than the chosen "
        "one; below 0 is better. Intervals and the probability to be the best are by bootstrap "
        f"over flights ({RESAMPLES} draws, the same flights for every candidate, seed "
        f"{selection.rule.seed}). An interval that holds 0 is a tie; more flights: how many would "
        "end it, if the difference is what it seems (∞: there is none).",
    )
    title = f"Candidates of the selection ({selection.study})"
    return Table(title, columns, rows, notes, SHOWN)


def _ordered(selection: Selection) -> list[Scored]:
    """The chosen one, then the others, the best first."""
    others = [one for one in selection.ranked if one is not selection.chosen]
    return [*([selection.chosen] if selection.chosen else []), *others]


def _row(selection: Selection, place: int, one: Scored) -> tuple[Value, ...]:
    named = _named(one)
    best = 100.0 * one.best if one.passes else None
    more = one.apart.more_flights if one.apart and one.apart.tie else None
    at_validate = (one.validate, *_apart(one.apart), best, more)
    at_evaluate = (one.evaluate, *_apart(one.confirmed))
    return (place, *named, *at_validate, *at_evaluate, verdict(selection, one))


def _named(one: Scored) -> tuple[Value, ...]:
    """What a candidate has in the columns of its setting and factors."""
    return (*setting_values(one.candidate.group), *one.candidate.factors.values())


def _apart(apart: Difference | None) -> tuple[Value, Value, Value]:
    return (None, None, None) if apart is None else (apart.effect, apart.low, apart.high)


def regime_table(selection: Selection) -> Table:
    """The criterion on the evaluate flights, a row per candidate, a column per regime."""
    criterion = selection.criterion
    names = list(selection.ranked[0].candidate.factors)
    whole = {AVERAGE: "average", WORST: "worst"}.get(criterion.over, "judged by")
    measure = criterion.measure
    shown_as = partial(Column, unit=measure.unit, format=measure.format, least=measure.least)
    columns = (
        *setting_columns(names),
        *map(shown_as, criterion.regimes),
        shown_as(whole),
        Column("constraints", align="left"),
    )
    rows = tuple(
        (
            *_named(one),
            *map(float, one.by_regime),
            one.evaluate,
            "kept" if one.passes else ", ".join(breach.constraint for breach in one.breaches),
        )
        for one in _ordered(selection)
    )
    notes = (f"{capital(criterion.measure.phrase)} on the evaluate flights, the chosen first; "
             f"{criterion.measure.convention}.",)  # fmt: skip
    return Table(f"Regimes ({selection.study})", columns, rows, notes, SHOWN)


def _faster(selection: Selection) -> Iterator[str]:
    """Whether one within the margin is clearly faster than the chosen one."""
    chosen = selection.chosen
    if chosen is None or chosen.latency is None:
        return
    near = [one for one in selection.passing if one.latency and selection.within(one)]
    fastest = min(near, key=lambda one: one.latency.median if one.latency else math.inf)
    if fastest.latency and fastest.latency.median < FASTER * chosen.latency.median:
        yield (
            f"Within the margin, {fastest.candidate.title} is faster than the chosen one: "
            f"{shown(1e3 * fastest.latency.median)} against {shown(1e3 * chosen.latency.median)} "
            'ms at the median; simplest = "fastest" chooses by that.'
        )


def latency_table(selection: Selection, processor: str = "") -> Table | None:
    """Time and memory of one estimate, a row per candidate; None where none was measured.

    processor: what they were measured on.
    """
    timed = [one for one in selection.ranked if one.latency is not None]
    if not timed:
        return None
    names = list(timed[0].candidate.factors)
    columns = (
        *setting_columns(names),
        Column("median", "ms", SIGNIFICANT, group="latency", varies=True),
        Column("99th percentile", "ms", SIGNIFICANT, group="latency", varies=True),
        Column("peak memory", "MB", ".0f", varies=True),
        Column("flights", format="d", varies=True),
        Column("disturbed", "%", ".0f", varies=True),
    )
    rows = tuple(
        (
            *_named(one),
            1e3 * one.latency.median,
            1e3 * one.latency.p99,
            one.latency.memory,
            one.latency.flights,
            100.0 * one.latency.busy,
        )
        for one in timed
        if one.latency
    )
    notes = (
        "From the record of a flight to the answer, one flight at a time in a process of its own "
        "on one core, after a warm-up; the peak memory is that of the whole process. Disturbed: "
        "flights during which other programs had the core; their processor time is told."
        + (f" Measured on {processor}." if processor else ""),
        *_faster(selection),
    )
    return Table(f"Latency and memory ({selection.study})", columns, rows, notes, SHOWN)
