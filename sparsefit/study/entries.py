"""The entries of [outputs]: a name, a mapping of options, or a function of the study's script."""

from __future__ import annotations

import json
import runpy
import tomllib
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, partial
from importlib import resources
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import pandas as pd

from sparsefit.arrays import IntArray
from sparsefit.codec import Place, build
from sparsefit.errors import InputError, one_of, suggestion, unknown
from sparsefit.study.crossing import spelled
from sparsefit.study.keys import QUANTITIES
from sparsefit.study.measures import Measure, measure, numbers, numeric_factors
from sparsefit.study.schema import Range, key
from sparsefit.study.solver_times import is_race
from sparsefit.study.table import Value, plain

Options: TypeAlias = Mapping[str, object]
MEASURED = ("settings", "protocols", "lines", "ecdf")  # layouts of any measures
OF = {  # other layouts: the kind of study
    **dict.fromkeys(("coverage", "scatter"), "flights"),
    **dict.fromkeys(("solvers", "failed", "profiles", "shapes"), "problems"),
}


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
        return [measure(words) for words in self.measure]


def script_of(study: Any) -> Path | None:
    """Return the Python file that a study names, beside its own."""
    name = study.definition.outputs.script
    return Path(study.path).parent / name if name else None


def functions_of(study: Any) -> dict[str, Callable[..., Any]]:
    """Return the public functions of the study's script, by name.

    Each takes the frame of cases, and the study if it has two arguments.

    Raises:
        InputError: with what the script raised.
    """
    path = script_of(study)
    try:
        names = runpy.run_path(str(path), run_name="script") if path else {}
    except Exception as error:
        raise InputError(f"script {path}: {type(error).__name__}: {error}") from None
    return {
        name: value for name, value in names.items() if callable(value) and name[0] != "_"
        and getattr(value, "__module__", "") == "script"
    }  # fmt: skip


def call(function: Callable[..., Any], study: Any, cases: pd.DataFrame, *kinds: type) -> Any:
    """Return what a function of a script gives of the cases.

    Raises:
        InputError: with what it raised, or if it returns none of the kinds asked for.
    """
    name = f"{script_of(study)}: {getattr(function, '__name__', 'script')}(cases)"
    count = function.__code__.co_argcount if hasattr(function, "__code__") else 1
    try:
        made = function(*(cases, study)[:count])
    except Exception as error:
        raise InputError(f"{name} raised {type(error).__name__}: {error}") from None
    if not isinstance(made, kinds):
        raise InputError(f"{name} returned no {' and no '.join(kind.__name__ for kind in kinds)}")
    return made


@cache
def shipped(kind: str) -> dict[str, dict[str, Any]]:
    """Return the entries of outputs.toml by name: the `tables`, the `figures` or the `defaults`."""
    text = (resources.files(__package__) / "outputs.toml").read_text(encoding="utf-8")
    named: dict[str, dict[str, Any]] = tomllib.loads(text)[kind]
    return named


def is_predicted(cases: pd.DataFrame) -> bool:
    """Return whether a problem has a held-out error."""
    return bool(np.isfinite(numbers(cases, "holdout_error")).any())


def defaults(study: Any, cases: pd.DataFrame, kind: str) -> list[str]:
    """Return the names of the tables, or figures, of a study that declares none."""
    if study.kind == "problems":
        groups = ["prediction"] * is_predicted(cases) + ["race"] * is_race(cases)
    elif cases["flight"].nunique() < 2:
        groups = ["single flight"]
    else:
        groups = ["sweep" if numeric_factors(cases) else "flights"]
    return [name for group in groups or ["race"] for name in shipped("defaults")[group][kind]]


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
    named = shipped(f"{kind}s")
    declared = {each["name"]: each for each in own if not isinstance(each, str) and "name" in each}
    for entry in names or own:
        given = declared.get(entry, {"name": entry}) if isinstance(entry, str) else entry
        name = str(given.get("name", ""))
        if isinstance(entry, str) and name not in declared:
            if name in functions:
                yield name, partial(call, functions[name], study)
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
        if name not in cases:
            near = suggestion(name, map(str, cases.columns))
            raise InputError(f'{key}: the cases have no column "{name}"{near}')


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
