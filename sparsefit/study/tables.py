"""The entries of [outputs], and the tables of a study: measures of groups of cases.

A table groups the cases by columns of the frame, a row per group, and summarises measures, a column
each. An entry is the name of a table (or figure) of outputs.toml or of a function of the study's
script, or a mapping of the fields of `Entry`.
"""

from __future__ import annotations

import json
import runpy
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import partial
from inspect import signature
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import pandas as pd

from sparsefit.arrays import Array, BoolArray, IntArray
from sparsefit.codec import Place, build
from sparsefit.errors import InputError, one_of, unknown
from sparsefit.study import measures, solver_times, trials
from sparsefit.study.columns import STATUSES
from sparsefit.study.crossing import spelled
from sparsefit.study.keys import QUANTITIES
from sparsefit.study.measures import MEASURES, SYMBOLS, Measure
from sparsefit.study.schema import Range, key, shipped
from sparsefit.study.table import Column, Table, Value, listed, plain

Options: TypeAlias = Mapping[str, object]
MEASURED = ("settings", "protocols", "lines", "ecdf")  # layouts of any measures
OF = {  # other layouts: the kind of study
    **dict.fromkeys(("coverage", "scatter"), "flights"),
    **dict.fromkeys(("solvers", "failed", "profiles", "shapes"), "problems"),
}
Cells: TypeAlias = dict[Column, Value]
FAILURES = "In a quantile, a failure counts as worse than any number; in a mean, as 100 %."


@dataclass(frozen=True, kw_only=True)
class Entry:
    """One table or figure that a study asks for.

    name: of its file; title, notes: over and under it; measure: names of measures, each alone or
    behind a summary; compare: its layout; rows: the columns of the frame by which rows, or panels,
    differ; along: a swept factor, the columns of a table or the axis of a picture.
    columns, lines: the column of the frame by which columns of panels, and lines, differ.
    limits: values that a measure is held against; interval: whether summaries have a 95 % interval
    over flights beside them.
    """

    name: str = ""
    title: str = ""
    notes: tuple[str, ...] = ()
    measure: tuple[str, ...] = ()
    compare: str = ""
    rows: tuple[str, ...] = ()
    along: str = ""
    columns: str = ""
    lines: str = "title"
    limits: tuple[float, ...] = ()
    interval: bool = False
    width: float = key(7.0, Range(least=2.0, most=50.0), "in")

    @property
    def measures(self) -> list[Measure]:
        """The measures by name.

        Raises:
            InputError: for a name or a summary that is unknown, with the nearest.
        """
        return [measures.measure(words) for words in self.measure]


def script_of(study: Any) -> Path | None:
    """Return the Python file that a study names, beside its own."""
    name = study.definition.outputs.script
    return Path(study.path).parent / name if name else None


def functions_of(study: Any) -> dict[str, Callable[..., Any]]:
    """Return the public functions of the study's script, by name, which take the frame of cases.

    One with two arguments is given the study, too. Each refuses to return none of the types that
    follow the cases.

    Raises:
        InputError: with what the script, or a function of it, raised.
    """
    path = script_of(study)

    @contextmanager
    def raised(name: str) -> Iterator[None]:
        try:
            yield
        except Exception as error:
            raise InputError(f"{name} raised {type(error).__name__}: {error}") from None

    def of_cases(function: Callable[..., Any], cases: pd.DataFrame, *kinds: type) -> Any:
        name = f"{path}: {function.__name__}(cases)"
        with raised(name):
            made = function(*(cases, study)[: len(signature(function).parameters)])
        if kinds and not isinstance(made, kinds):
            names = " and no ".join(kind.__name__ for kind in kinds)
            raise InputError(f"{name} returned no {names}")
        return made

    with raised(f"script {path}"):
        names = runpy.run_path(str(path), run_name="script") if path else {}
    return {
        name: partial(of_cases, value) for name, value in names.items()
        if callable(value) and name[0] != "_" and getattr(value, "__module__", "") == "script"
    }  # fmt: skip


def is_predicted(cases: pd.DataFrame) -> bool:
    """Return whether a problem has a held-out error."""
    return bool(np.isfinite(measures.numbers(cases, "holdout_error")).any())


def defaults(study: Any, cases: pd.DataFrame, kind: str) -> list[str]:
    """Return the names of the tables, or figures, of a study that declares none."""
    if study.kind == "problems":
        groups = ["prediction"] * is_predicted(cases) + ["race"] * solver_times.is_race(cases)
    elif cases["flight"].nunique() < 2:
        groups = ["single flight"]
    else:
        groups = ["sweep" if measures.numeric_factors(cases) else "flights"]
    entries = shipped("outputs.toml")["defaults"]
    return [name for group in groups or ["race"] for name in entries[group][kind]]


def asked(
    study: Any,
    kind: str,
    layouts: Collection[str],
    names: Sequence[str | Options] = (),
) -> Iterator[tuple[str, Entry | Callable[..., Any]]]:
    """Give the file name of each output with its entry, or with what calls the script's function.

    An entry with the name of a shipped one starts from that, unless it says `compare`.

    Args:
        kind: `table` or `figure`; layouts: their names.
        names: those that are asked for, by default those that the study declares.

    Raises:
        InputError: for a name, a key, a layout or a measure that is unknown, with the nearest.
    """
    functions, own = functions_of(study), getattr(study.definition.outputs, f"{kind}s")
    named = shipped("outputs.toml")[f"{kind}s"]
    declared = {each["name"]: each for each in own if not isinstance(each, str) and "name" in each}
    for entry in names or own:
        given = declared.get(entry, {"name": entry}) if isinstance(entry, str) else entry
        name = str(given.get("name", ""))
        if isinstance(entry, str) and name not in declared:
            if name in functions:
                yield name, functions[name]
                continue
            if name not in named:
                raise unknown(kind, name, [*named, *functions])
        if "/" in name or "\\" in name or name.startswith("."):
            raise InputError(f"the {kind} name {name!r} is that of a file: leave out / and \\")
        start = {} if "compare" in given else named.get(name, {})
        read = build(Entry, {**start, **given}, Place(f"the {kind}"))
        one_of(f"compare of the {kind}", layout := read.compare or "settings", layouts)
        if layout in MEASURED and not read.measures:
            raise InputError(f"the {kind} {name!r} needs measure = …: add it")
        kinds = {OF.get(layout, ""), *(each.kind for each in read.measures)}
        if other := kinds & {"flights", "problems"} - {study.kind}:
            words = f"is of {other.pop()}, and these cases are of {study.kind}"
            raise InputError(f"the {kind} {name!r} {words}")
        yield name or "-".join(read.measure).replace(" ", "-")[:100], read


def check_columns(cases: pd.DataFrame, names: Sequence[str], key: str) -> None:
    """Raise `InputError` with the nearest name if the cases lack a column; key: what names it."""
    for name in names:
        one_of(f"column of {key}", name, map(str, cases.columns), "cases.parquet")


def grouped(
    cases: pd.DataFrame, names: Sequence[str]
) -> Iterator[tuple[tuple[Value, ...], IntArray]]:
    """Give the values of each group of cases and the places of its rows, as they first appear."""
    keys = [cases[name].to_numpy() for name in names] or [np.zeros(len(cases))]
    places = pd.Series(np.arange(len(cases)))
    for level, own in places.groupby(keys, sort=False, dropna=False):
        yield tuple(map(plain, level if names else ())), own.to_numpy()


def level_text(level: Value) -> str:
    """Return a level in words: `[0.5,0.1]`, a pair of a sweep, as `0.5 / 0.1`, and 60.0 as `60`."""
    if isinstance(level, float):
        return spelled(level)
    with suppress(json.JSONDecodeError):
        if isinstance(listed := json.loads(str(level)), list):
            return spelled(listed)
    return str(level)


def levels_of(cases: pd.DataFrame, factor: str) -> pd.Series:
    """Return a column as text, categories in order: numbers ascending, others as they appear."""
    is_number = pd.api.types.is_numeric_dtype(cases[factor])
    codes, values = pd.factorize(cases[factor], sort=is_number, use_na_sentinel=False)
    words = np.array([level_text(plain(value)) for value in values], dtype=object)
    kinds = pd.CategoricalDtype(list(dict.fromkeys(words)), ordered=True)
    return pd.Series(words[codes], cases.index).astype(kinds)


def factor_words(factor: str) -> str:
    """Return a factor in words, `measurement noise`."""
    return factor.rpartition(".")[2].replace("_", " ")


def unit_of(factor: str) -> str:
    """Return the unit of a factor; empty where it has none."""
    name = factor.rpartition(".")[2]
    unit = "m" if name in ("lower", "upper", "step") else ""
    return QUANTITIES[name].unit if name in QUANTITIES else unit


class Part(NamedTuple):
    """A column of a table: the values (rows,) of all cases, and the measure that summarises them.

    each: the measure, or None for the number of cases with a true value.
    interval: whether columns with the ends of a 95 % interval over units follow.
    """

    column: Column
    values: Array
    each: Measure | None = None
    interval: bool = False

    def cells(self, cases: pd.DataFrame, places: IntArray) -> Cells:
        """Return the summary of a group of cases, and the ends of its interval."""
        here, each, column = self.values[places], self.each, self.column
        if each is None or not self.interval:
            return {column: int(here.sum()) if each is None else each.summary_of(here)}
        unit, units = cases["flight"].iloc[places].factorize()
        grid = measures.gridded(here, [unit], [len(units)])
        if each.summary == "share" and grid.shape[1] == 1:
            ends = measures.wilson(np.nansum(here), (~np.isnan(here)).sum())
        else:
            ends = measures.interval(each.reduce, grid)
        before = f"{column.name} " if column.group else ""
        below = replace(column, group=column.group or column.name)
        columns = (column, *(replace(below, name=f"{before}{end}") for end in ("from", "to")))
        return dict(zip(columns, (each.summary_of(here), *ends), strict=True))


def column_of(each: Measure) -> Column:
    """Return the column of a measure, with the summary before its heading or above it."""
    words, _, symbol = each.heading.rpartition(" ")
    if symbol not in SYMBOLS.values():
        words, symbol = each.heading, ""
    words = each.head + words
    name, group = (symbol, words) if symbol else (words, "")
    return Column(name, each.unit, each.format, group, each.least, each.varies)


def name_columns(entry: Entry, cases: pd.DataFrame) -> list[str]:
    """Return the columns that define the rows: those with several values, a status, or the last.

    By default they are condition and title, along a factor protocol and title. What the title
    implies is left out.

    Raises:
        InputError: for a column that the cases do not have.
    """
    rows = entry.rows or ("condition", "title")
    if entry.along and not entry.rows:
        rows = ("protocol", "title") if "protocol" in cases else ("title",)
    check_columns(cases, [*rows, *filter(None, [entry.along])], "the table")
    names = [name for name in rows if name == "status" or cases[name].nunique(dropna=False) > 1]
    if "title" in names:
        several = cases.groupby("title")[names].nunique(dropna=False).max() > 1
        names = [name for name in names if name in ("title", "status") or several[name]]
    return names or list(rows[-1:])


def summarised(
    entry: Entry, cases: pd.DataFrame, names: Sequence[str], parts: Sequence[Part], *notes: str
) -> Table:
    """Return a row per group of cases by `names`, and a column per part with any number."""
    parts, rows = [part for part in parts if not np.isnan(part.values).all()], list[Cells]()
    for levels, places in grouped(cases, names):
        rows.append(dict(zip(map(Column, names), map(level_text, levels), strict=True)))
        for part in parts:
            rows[-1] |= part.cells(cases, places)
    title = entry.title or entry.name.replace("-", " ").capitalize() or "Measures"
    made = Table.of_cells(title, rows, (*entry.notes, *notes))
    measured = any(part.each for part in parts) or not entry.measures
    return made if measured else replace(made, rows=())


def _count(name: str, mask: BoolArray, group: str = "") -> Part:
    """Return the column with the number of cases where the mask holds."""
    return Part(Column(name, format="d", group=group), mask.astype(float))


def settings(entry: Entry, cases: pd.DataFrame) -> Table:
    """Return counts and measures by group, with intervals if the entry has them.

    With `along`, each measure has a column per level of that factor. Single cases have a status in
    place of counts.
    """
    names, parts = name_columns(entry, cases), list[Part]()
    if "status" not in names:
        parts += [
            _count("n", np.ones(len(cases), dtype=bool)),
            _count("ok", measures.ended(cases, "ok")),
            _count("failures", ~measures.answered(cases)),
        ]
    for each in entry.measures:
        column, values = column_of(each), each.values(cases)
        if not entry.along:
            parts.append(Part(column, values, each, entry.interval))
            continue
        words, levels = factor_words(entry.along), levels_of(cases, entry.along)
        group = f"{column.group} {column.name}, {words}".strip()
        for level in levels.cat.categories:
            here = measures.only((levels == level).to_numpy(), values)
            of_level = replace(column, name=level, group=group)
            parts.append(Part(of_level, here, each, entry.interval))
    notes = [FAILURES] if any(each.miss is not None for each in entry.measures) else []
    if entry.interval:
        drawn = f"From, to: 95 %, by {measures.RESAMPLES} draws of whole {trials.unit_of(cases)}s"
        notes.append(f"{drawn}; a share of single cases: Wilson's.")
    return summarised(entry, cases, names, parts, *notes)


def status(entry: Entry, cases: pd.DataFrame) -> Table:
    """Return numbers of cases by status and error: within 5 %, off, no flow, or unknown truth."""
    near, truth = f"≤ {measures.OFF:g} %", np.full(len(cases), "all", object)
    if "est_mean_velocity" in cases:
        flown = measures.in_flow(cases)
        truth[flown] = np.where(measures.off(cases), "off", near)[flown]
        truth[measures.in_still_air(cases)] = "no flow"
        truth[~measures.ended(cases, *STATUSES[:4])] = "all"
    else:
        entry = replace(entry, notes=())  # of errors
    parts = [_count("n", np.ones(len(cases), dtype=bool))]
    for name in STATUSES:
        for fact in (near, "off", "no flow", "all"):
            both = measures.ended(cases, name) & (truth == fact)
            parts += [_count(fact, both, name)] if both.any() else []
    return summarised(entry, cases, name_columns(entry, cases), parts)


def coverage(entry: Entry, cases: pd.DataFrame) -> Table:
    """Return the share of 95 % intervals that contain the truth, a row per group and parameter."""
    shares = measures.of_parameters(cases)
    covered, halves = shares["coverage"].ravel(), shares["half-width"].ravel()
    each = cases.iloc[np.repeat(np.arange(len(cases)), 3)]
    each = each.assign(parameter=np.tile(list(SYMBOLS.values()), len(cases)))
    names = [*name_columns(entry, cases), "parameter"]
    parts = [
        _count("n", np.ones(len(each), dtype=bool)),
        _count("ok", measures.ended(each, "ok")),
        _count("with interval", np.isfinite(covered)),
        Part(Column("coverage", "%", ".1f"), covered, MEASURES["hits"], interval=True),
        Part(Column("half-width", "%"), halves, MEASURES["length-scale-half-width"]),
    ]
    made = summarised(entry, each, names, parts)
    return replace(made, rows=[row for row in made.rows if row[len(names) + 2]])


def failures(cases: pd.DataFrame) -> pd.DataFrame:
    """Return the cases that are not ok by candidate, status and reason but for its numbers."""
    bad = cases[cases["status"] != "ok"]
    alike = bad["reason"].str.replace(r"[-+]?\d[\d.,e+-]*", "#", regex=True)
    groups = bad.groupby(["title", "status", alike], sort=False, dropna=False)
    names = "problem" if "problem" in bad else "unit"
    summaries = {
        "cases": (names, "size"),
        "where": (names, lambda units: listed(units, "and")),
        "first case": ("case_id", "first"),
        "reason of it": ("reason", "first"),
    }
    frame = groups.agg(**summaries)
    frame = frame.droplevel(2).sort_values("cases", ascending=False, kind="stable")
    frame.attrs["title"] = "Who failed where"
    return frame


LAYOUTS: Mapping[str, Callable[[Entry, pd.DataFrame], Table]] = {
    "settings": settings,
    "protocols": settings,
    "status": status,
    "coverage": coverage,
    "solvers": lambda entry, cases: solver_times.summary(cases),
    "failed": lambda entry, cases: Table.of(failures(cases[cases["status"] != "skipped"])),
}


def tables(
    study: Any, cases: pd.DataFrame, names: Sequence[str | Options] = ()
) -> dict[str, Table]:
    """Return tables by file name: those named, else those of [outputs], else what fits."""
    outputs, every = study.definition.outputs, dict[str, Table]()
    wanted = names or outputs.tables or defaults(study, cases, "tables")
    for name, entry in asked(study, "table", LAYOUTS, wanted):
        if not isinstance(entry, Entry):
            made = entry(cases, pd.DataFrame, Table)
            made = made if isinstance(made, Table) else Table.of(made)
            title = made.title or name.replace("_", " ").capitalize()
            every[name] = replace(made, title=title)
            continue
        made = LAYOUTS[entry.compare or "settings"](entry, cases)
        stated = measures.stated(outputs.reference)
        printed = {column_of(own).full: stated.get(own.name) for own in entry.measures}
        if any(value is not None for value in printed.values()):
            printed |= {"n": outputs.reference.flights, made.heads[0]: outputs.reference.name}
            made = replace(made, rows=[tuple(map(printed.get, made.heads)), *made.rows])
        every[name] = made
    return {name: made for name, made in every.items() if made.rows or names}
