"""The tables of a study: measures of groups of cases, and a few layouts of one purpose.

A table groups the frame of cases by columns (`rows`) and summarises measures over each group. An
entry of [outputs] is the name of a shipped table, of a function of the study's script, or a mapping
of the fields of `Entry`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

from sparsefit.arrays import Array
from sparsefit.errors import InputError, suggestion
from sparsefit.study import solver_times
from sparsefit.study.entries import (
    Entry,
    Options,
    Script,
    factor_words,
    grouped,
    level_text,
    read_entry,
    sort_levels,
)
from sparsefit.study.measures import (
    OFF,
    PARAMETERS,
    STATUSES,
    SYMBOLS,
    UNITS,
    Measure,
    answered,
    bounded,
    ended,
    factors,
    in_flow,
    in_still_air,
    measure,
    numbers,
    off,
    only,
    parameters,
    three,
)
from sparsefit.study.statistics import (
    EXCHANGES,
    RESAMPLES,
    Difference,
    by_unit,
    difference,
    exchange_p,
    holm,
    interval,
    pooled,
    wilson,
)
from sparsefit.study.table import Column, Table, Value, cell_text, plain

ROWS = ("condition", "title")
NOISE = "flights.measurement_noise"
STEPS = (0.1, 1.0, 5.0, 20.0)  # percent: limits of an error profile, unless a study names its own
SUMMARY = (
    "answered", "median mean-velocity-size", "median length-scale-size",
    "95th percentile largest-error", "silent-misses", "length-scale-coverage", "median seconds",
    "largest certificate",
)  # fmt: skip
PREDICTION = ("holdout-error", "support", "precision", "recall", "f1", "stability", "median wall")


def name_columns(cases: pd.DataFrame, rows: Sequence[str]) -> list[str]:
    """Return the columns that tell rows apart, without those that hold one value throughout.

    Raises:
        InputError: for a column that the cases do not have.
    """
    for name in rows:
        if name not in cases:
            raise InputError(f'rows: the cases have no column "{name}"'
                             f"{suggestion(name, map(str, cases.columns))}")  # fmt: skip
    several = [name for name in rows if cases[name].nunique(dropna=False) > 1]
    return several or list(rows[-1:])


def column_of(each: Measure) -> Column:
    """Return the column of a measure in a table, the summary before its heading or above it."""
    head, symbol = each.heading or each.words, ""
    for sign in SYMBOLS.values():
        if head.endswith(f" {sign}"):
            head, symbol = head.removesuffix(f" {sign}"), sign
    words = head if each.summary in ("share", "number") else f"{each.summary} {head}"
    format, unit = ("d", "") if each.summary == "number" else (each.format, each.unit)
    name, group = (symbol, words) if symbol else (words, "")
    return Column(name, unit, format, group, each.least, each.varies)


def settings(entry: Entry, cases: pd.DataFrame) -> Table:
    """Return a row per group: planned, answered, and each measure, with its interval if asked."""
    names = name_columns(cases, entry.rows or ROWS)
    columns = [*map(Column, names), Column("n", format="d"), Column("ok", format="d"),
               Column("failures", format="d")]  # fmt: skip
    values = [each.values(cases) for each in entry.measures]
    for each in entry.measures:
        column = column_of(each)
        columns.append(column)
        if entry.interval:
            columns.append(Column("95 %", column.unit, group=column.group or column.name))
    ok, failed, rows = ended(cases, "ok"), ~answered(cases), []
    for key, places in grouped(cases, names):
        cells: list[Value] = []
        for each, numbers_ in zip(entry.measures, values, strict=True):
            here = numbers_[places]
            empty = np.isnan(here).all()
            summary = math.nan if empty and each.summary != "number" else float(each.reduce(here))
            cells.append(int(summary) if each.summary == "number" else summary)
            if entry.interval:
                cells.append(_between(each, here, cases["flight"].iloc[places]))
        counts = (len(places), int(ok[places].sum()), int(failed[places].sum()))
        rows.append((*map(level_text, key), *counts, *cells))
    conventions = dict.fromkeys(
        f"{each.phrase[:1].upper()}{each.phrase[1:]}: {each.convention}."
        for each in entry.measures if each.miss is not None
    )  # fmt: skip
    more = (f"95 %: bootstrap over flights, {RESAMPLES} draws.",) if entry.interval else ()
    title = entry.title or entry.name.replace("-", " ").capitalize() or "Measures"
    return Table(title, tuple(columns), rows, (*entry.notes, *conventions, *more), 60, len(names))


def _between(each: Measure, values: Array, flights: pd.Series) -> str | None:
    """Return the 95 % interval of a summary over flights, Wilson's where all or none is a share."""
    column, grid = column_of(each), by_unit(values, flights)
    if each.summary == "share" and grid.shape[1] == 1:
        low, high = wilson(float(np.nansum(values)), int((~np.isnan(values)).sum()))
    else:
        low, high = interval(pooled(each.reduce), grid)
    return None if math.isnan(low) else f"{cell_text(low, column)} to {cell_text(high, column)}"


def protocols(entry: Entry, cases: pd.DataFrame) -> Table:
    """Return a row per group and a column per level of the factor `along`, of the first measure."""
    along, each = entry.along or _only_factor(cases), entry.measures[0]
    levels = sort_levels(cases, along)
    names = name_columns(cases, entry.rows or _all_rows(cases, along))
    values, failed, rows = each.values(cases), ~answered(cases), []
    texts_ = np.array([level_text(plain(value)) for value in cases[along]], dtype=object)
    for key, places in grouped(cases, names):
        cells = [
            float(each.reduce(values[places[texts_[places] == level]]))
            if (texts_[places] == level).any() else None
            for level in levels
        ]  # fmt: skip
        rows.append((*map(level_text, key), *cells, f"{failed[places].sum()}/{len(places)}"))
    base, words = column_of(each), factor_words(along)
    columns = (
        *map(Column, names),
        *(replace(base, name=level, group=words) for level in levels),
        Column("failures"),
    )
    title = entry.title or f"{each.phrase[:1].upper()}{each.phrase[1:]} along {words}"
    return Table(title, columns, rows, (*entry.notes, f"{each.convention.capitalize()}."), 60,
                 len(names))  # fmt: skip


def _only_factor(cases: pd.DataFrame) -> str:
    swept = factors(cases)
    if len(swept) != 1:
        raise InputError(f"along = … names which factor: {', '.join(swept) or 'none is swept'}")
    return swept[0]


def _all_rows(cases: pd.DataFrame, along: str) -> list[str]:
    """Return what tells cases apart beside one factor: protocol, back-end, setting and the rest."""
    names = ["protocol", "backend", "label", "settings"] if "protocol" in cases else []
    others = [name for name in factors(cases) if name != along]
    varied = [name for name in [*names, *others] if cases[name].nunique() > 1]
    return varied or ["title"]


def status(entry: Entry, cases: pd.DataFrame) -> Table:
    """Return how cases ended against what was true: within 5 %, off, no flow, nobody knows."""
    names = name_columns(cases, entry.rows or ROWS)
    if "est_mean_velocity" in cases:
        truth = np.where(off(cases), "off", f"≤ {OFF:g} %").astype(object)
        truth[in_still_air(cases)] = "no flow"
        truth[~in_flow(cases) & ~in_still_air(cases)] = ""
    else:
        truth = np.full(len(cases), "", dtype=object)
    ends = cases["status"].to_numpy(dtype=object)
    truth[~np.isin(ends, STATUSES[:4])] = ""
    order = [
        (name, fact)
        for name in STATUSES for fact in (f"≤ {OFF:g} %", "off", "no flow", "")
        if ((ends == name) & (truth == fact)).any()
    ]  # fmt: skip
    rows: list[tuple[Value, ...]] = [
        (*map(level_text, key), len(places), *(
            int(((ends[places] == name) & (truth[places] == fact)).sum()) for name, fact in order
        ))
        for key, places in grouped(cases, names)
    ]  # fmt: skip
    columns = (
        *map(Column, names),
        Column("n", format="d"),
        *(Column(fact or "all", format="d", group=name) for name, fact in order),
    )
    note = (
        f"Off: U0, L_w or τ_w misses the truth by more than {OFF:g} %, or there is no number. "
        "Ok and off is a silent miss; ok without a flow a false alarm; unidentifiable and off was "
        "deserved."
    )
    return Table(entry.title or "How cases ended, and what was true", columns, rows,
                 (*entry.notes, *([note] if "est_mean_velocity" in cases else [])), 60,
                 len(names))  # fmt: skip


def coverage(entry: Entry, cases: pd.DataFrame) -> Table:
    """Return the share of 95 % intervals that hold the truth, a row per group and parameter."""
    names = name_columns(cases, entry.rows or ROWS)
    shares = [measure(name) for name in three("coverage")]
    halves = [measure(name) for name in three("half-width")]
    covered, wide = ([each.values(cases) for each in kind] for kind in (shares, halves))
    ok, rows = ended(cases, "ok"), list[tuple[Value, ...]]()
    for key, places in grouped(cases, names):
        for place, symbol in enumerate(SYMBOLS.values()):
            here = covered[place][places]
            count = int((~np.isnan(here)).sum())
            if count:
                part = float(np.nansum(here))
                rows.append((
                    *map(level_text, key), symbol, len(places), int(ok[places].sum()), count,
                    100.0 * part / count, *wilson(part, count),
                    float(halves[place].reduce(wide[place][places])),
                ))  # fmt: skip
    columns = (
        *map(Column, [*names, "parameter"]),
        *(Column(name, format="d") for name in ("n", "ok", "with interval")),
        *(Column(name, "%", ".1f") for name in ("coverage", "from", "to")),
        Column("half-width", "%"),
    )
    note = (
        "Share of the flights called ok whose 95 % interval holds the truth, with its 95 % Wilson "
        "interval. Half-width: median, in percent of the estimate."
    )
    return Table(entry.title or "Coverage of the 95 % intervals", columns, rows,
                 (*entry.notes, note), 90, len(names) + 1)  # fmt: skip


def single(entry: Entry, cases: pd.DataFrame) -> Table:
    """Return truth, estimate and percentage error of every case."""
    names = name_columns(cases, entry.rows or ("flight", *ROWS))
    percent = np.column_stack([measure(name).values(cases) for name in three("signed-error")])
    true, estimate = parameters(cases, "true"), parameters(cases, "est")
    rows: list[tuple[Value, ...]] = []
    for key, places in grouped(cases, names):
        words = list(map(level_text, key))
        rows += [
            (*words, *true[at].tolist(), *estimate[at].tolist(), *percent[at].tolist(),
             str(cases["status"].iloc[at]))
            for at in places
        ]  # fmt: skip
    columns = (
        *map(Column, names),
        *(Column(SYMBOLS[name], UNITS[name], ".4g", group)
          for group in ("true", "estimated") for name in PARAMETERS),
        *(Column(SYMBOLS[name], "%", "+.2f", "error") for name in PARAMETERS),
        Column("status"),
    )  # fmt: skip
    return Table(entry.title or "True and estimated flow parameters", columns, rows, entry.notes,
                 60, len(names))  # fmt: skip


def profiles(entry: Entry, cases: pd.DataFrame) -> Table:
    """Return the share of planned cases within each limit; a failure is within none."""
    names, each = name_columns(cases, entry.rows or ROWS), entry.measures[0]
    values = np.abs(each.read(cases))
    within = {limit: only(in_flow(cases), values <= limit) for limit in entry.limits or STEPS}
    rows: list[tuple[Value, ...]] = [
        (*map(level_text, key), len(places), *(
            cell for inside in within.values() for cell in _share_cells(inside[places])
        ))
        for key, places in grouped(cases, names)
    ]  # fmt: skip
    columns = [*map(Column, names), Column("n", format="d")]
    for limit in within:
        head = f"≤ {limit:g} {each.unit}".strip()
        columns += [Column(head, "%", ".1f"), Column("95 %", group=head)]
    title = entry.title or f"Share of cases within so much: {each.words}"
    return Table(title, tuple(columns), rows, (*entry.notes, "Failures are within no limit; 95 %: "
                 "Wilson's interval."), 60, len(names))  # fmt: skip


def _share_cells(held: Array) -> tuple[Value, Value]:
    whole, part = int((~np.isnan(held)).sum()), float(np.nansum(held))
    low, high = wilson(part, whole)
    return (100.0 * part / whole, f"{low:.1f} to {high:.1f}") if whole else (None, None)


def contrasts(entry: Entry, cases: pd.DataFrame) -> Table:
    """Return declared pairs, paired by flight, with intervals, tests and Holm's correction.

    A name is a value of one column: a protocol, a title, a back-end, a label or a level; without
    any contrast each title stands against the first.
    """
    pairs = entry.contrasts or _against_first(cases)
    made: list[tuple[str, str, str, str, int, list[float], Difference]] = []
    tests: list[float] = []
    for first, second in pairs:
        sides = sides_of(cases, first, second)
        shared = pd.Index(sides[0]["flight"].unique()).intersection(sides[1]["flight"].unique())
        for each in entry.measures:
            grids = [
                by_unit(each.values(side), side["flight"], shared)
                for side in (part[part["flight"].isin(shared)] for part in sides)
            ]
            statistic = pooled(each.reduce)
            apart = difference(statistic, *grids)
            tests.append(exchange_p(statistic, *grids))
            better = first if (apart.effect > 0) == each.more else second
            pair = [float(statistic(grid)) for grid in grids]
            made.append((each.phrase, first, second, better, len(shared), pair, apart))
    columns = (
        *map(Column, ("measure", "first", "second", "verdict")), Column("flights", format="d"),
        *(Column(name, group="summary") for name in ("first", "second")), Column("effect"),
        Column("from", group="95 %"), Column("to", group="95 %"), Column("p", format=".4f"),
        Column("p (Holm)", format=".4f"),
    )  # fmt: skip
    rows: list[tuple[Value, ...]] = [
        (phrase, first, second,
         "tie" if apart.tie or not adjusted <= 0.05 else f"{better} is better",
         count, *pair, apart.effect, apart.low, apart.high, p, adjusted)
        for (phrase, first, second, better, count, pair, apart), p, adjusted
        in zip(made, tests, holm(tests), strict=True)
    ]  # fmt: skip
    note = (
        f"Paired by flight, first minus second. 95 %: bootstrap over flights ({RESAMPLES}); "
        f"p by {EXCHANGES} exchanges within flights, adjusted for this table by Holm's rule."
    )
    return Table(entry.title or "Contrasts", columns, rows, (*entry.notes, note), 60, 3)


def _against_first(cases: pd.DataFrame) -> list[tuple[str, str]]:
    titles = [str(title) for title in cases["title"].unique()]
    return [(title, titles[0]) for title in titles[1:]]


def sides_of(cases: pd.DataFrame, *pair: str) -> list[pd.DataFrame]:
    """Return the cases of two values of one column.

    Raises:
        InputError: where no column holds both.
    """
    columns = ("protocol", "world", "reading", "condition", "title", "backend", "label", "solver")
    values: set[str] = set()
    for name in (*columns, *factors(cases)):
        if name in cases:
            levels = cases[name].map(lambda value: level_text(plain(value)))
            values |= set(levels)
            if set(pair) <= set(levels):
                return [cases[levels == value] for value in pair]
    missing = next((value for value in pair if value not in values), None)
    if missing is None:
        raise InputError(f'contrasts: "{pair[0]}" and "{pair[1]}" are of no one kind')
    raise InputError(f'contrasts: "{missing}" is unknown{suggestion(missing, values)}')


LAYOUTS: Mapping[str, Callable[[Entry, pd.DataFrame], Table]] = {
    "settings": settings,
    "protocols": protocols,
    "status": status,
    "coverage": coverage,
    "parameters": single,
    "profiles": profiles,
    "contrasts": contrasts,
    "solvers": lambda entry, cases: solver_times.summary(cases),
    "winners": lambda entry, cases: solver_times.winners(cases),
    "failed": lambda entry, cases: solver_times.failures(cases),
    "clock": lambda entry, cases: solver_times.clock(cases),
}
FAILED = "Errors are over the cases with an estimate; failures are counted beside them."
NAMED: Mapping[str, Options] = {
    "solvers": {"compare": "solvers"},
    "winners": {"compare": "winners"},
    "prediction": {"title": "What is predicted and recovered", "measure": PREDICTION,
                   "rows": ("title",)},
    "parameters": {"compare": "parameters"},
    "summary": {"title": "Summary", "measure": SUMMARY},
    "status": {"compare": "status"},
    "errors-absolute": {
        "title": "Sizes of the percentage errors",
        "measure": (*(f"{summary} {name}" for summary in ("mean", "median", "95th percentile")
                      for name in three("size")), "hits"),
        "notes": (FAILED,),
    },
    "errors": {
        "title": "Signed mean errors, the paper's form",
        "measure": (*three("deviation"), *three("signed-error"), "hits"),
        "notes": (FAILED, "Errors of opposite sign cancel."),
    },
    "methods": {"compare": "protocols", "measure": ("timescale-error",), "along": NOISE},
    "efficiency": {
        "title": "Errors against the Cramér-Rao bound",
        "measure": ("bounded", *three("bounded-error"), *three("bound"), *three("efficiency")),
        "notes": ("Rms over the flights called ok that have a bound; 1 is the limit.",),
    },
    "coverage": {"compare": "coverage"},
    "scales": {
        "title": "Several scales at once",
        "measure": ("scales-found", "scales-missed", "scales-spurious",
                    "scales-length-scale-error", "scales-mean-velocity-error", "unseen"),
    },
    "contrasts": {"compare": "contrasts", "measure": ("mean timescale-error",)},
    "profiles": {"compare": "profiles", "measure": ("timescale-error",)},
    "times": {
        "title": "Times and certificates",
        "measure": ("median seconds", "95th percentile seconds", "largest certificate"),
    },
    "failed": {"compare": "failed"},
    "clock": {"compare": "clock"},
}  # fmt: skip


def fitting(cases: pd.DataFrame) -> list[str]:
    """Return the names of the tables that have something to say about these cases."""
    if "objective" in cases:
        predicted = ["prediction"] if np.isfinite(numbers(cases, "holdout_error")).any() else []
        return ["solvers", "winners", *predicted, "failed", "clock"]
    several = cases["flight"].nunique() > 1
    says = {
        "parameters": not several,
        "summary": several,
        "status": several,
        "errors-absolute": several and bool(in_flow(cases).any()),
        "errors": several and bool(in_flow(cases).any()),
        "efficiency": bool(bounded(cases).any()),
        "coverage": bool(np.isfinite(parameters(cases, "low")).any()),
        "scales": bool(np.isfinite(numbers(cases, "scales_missed")).any()),
        "times": True,
    }
    return [name for name, holds in says.items() if holds]


def table(study: Any, entry: str | Options) -> Table:
    """Return the table that an entry asks for, of the cases of a study.

    Raises:
        InputError: for what is unknown, or of which the cases have nothing.
    """
    return _named_table(study, entry, study.cases, Script.of(study))[1]


def _named_table(
    study: Any, entry: str | Options, cases: pd.DataFrame, script: Script
) -> tuple[str, Table]:
    """Return a table and the name of its file."""
    if isinstance(entry, str) and entry in script.functions:
        made = script.call(entry, study, cases)
        if isinstance(made, Table):
            return entry, made
        if not isinstance(made, pd.DataFrame):
            raise InputError(f"{script.path}: {entry}(cases) returned no DataFrame and no Table")
        title = str(made.attrs.get("title", entry.replace("_", " ").capitalize()))
        return entry, Table.of(made, title, made.attrs.get("notes", ()))
    read = read_entry(entry, NAMED, LAYOUTS, "table", script)
    result = LAYOUTS[read.compare or "settings"](read, cases)
    reference = study.definition.outputs.reference
    if reference is not None:
        result = _with_reference(result, read, reference)
    return read.file_name, result


def printed_value(reference: Any, each: Measure) -> float | None:
    """Return what a reference prints of a measure, None where it prints nothing."""
    kinds = {"deviation": reference.deviation, "signed-error": reference.signed_error}
    for place, name in enumerate(PARAMETERS):
        for kind, values in kinds.items():
            if values and each.name == f"{name.replace('_', '-')}-{kind}":
                return float(values[place])
    return None


def _with_reference(made: Table, entry: Entry, reference: Any) -> Table:
    """Return a table with the printed numbers of a reference as its first row, if it has them."""
    printed = [printed_value(reference, each) for each in entry.measures]
    if entry.compare or entry.interval or all(value is None for value in printed):
        return made
    first = (reference.name, *[None] * (made.names - 1), reference.flights, None, None, *printed)
    return replace(made, rows=[first, *made.rows])


def tables(study: Any, cases: pd.DataFrame, names: Sequence[str] = ()) -> dict[str, Table]:
    """Return tables by file name: these, or those that the study asks for, or all that fit."""
    script = Script.of(study)
    entries = names or study.definition.outputs.tables or fitting(cases)
    every = [_named_table(study, entry, cases, script) for entry in entries]
    return {name: made for name, made in every if made.rows or names}
