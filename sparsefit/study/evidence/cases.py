"""The cases of a study: who has an estimate, what was swept, and which cases belong together.

A case has an estimate where its status is `ok` or `inaccurate` and its three numbers are finite;
every other planned case is a failure. How a failure counts is told by each measure.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from sparsefit.arrays import Array, BoolArray
from sparsefit.estimator.doubt import Doubt
from sparsefit.study.evidence.table import Value, plain

PARAMETERS = ("mean_velocity", "length_scale", "timescale")
SYMBOLS = {"mean_velocity": "U0", "length_scale": "L_w", "timescale": "τ_w"}
TEX_SYMBOLS = {"mean_velocity": "$U_0$", "length_scale": "$L_w$", "timescale": r"$\tau_w$"}
UNITS = {"mean_velocity": "m/s", "length_scale": "m", "timescale": "s"}
STATUSES = (
    "ok",
    "misfit",
    "inaccurate",
    "unidentifiable",
    "error",
    "timeout",
    "crashed",
    "skipped",
)
ESTIMATED = ("ok", "inaccurate")
DEFAULT = "default"
SETTING = ("protocol", "backend", "label", "settings")
NO_FLOW = "no cellular flow"  # what the reason of a flight without a flow begins with


@dataclass(frozen=True, eq=False)
class Group:
    """The cases that share `key`, the values of the columns they were grouped by.

    `setting` tells the setting from the others of its back-end, in a few words.
    """

    key: dict[str, Value]
    cases: pd.DataFrame
    setting: str = ""

    @property
    def title(self) -> str:
        """Back-end and setting, for a legend."""
        backend = str(self.key["backend"])
        if self.setting == DEFAULT:
            return backend
        # A label of its own, "least squares, truncated", already names the back-end.
        labelled = not str(self.key["label"]).startswith(backend)
        return self.setting if labelled else f"{backend} {self.setting}"

    @property
    def protocol(self) -> str:
        """The name of the protocol."""
        return str(self.key["protocol"])


def groups_by(cases: pd.DataFrame, names: Sequence[str]) -> list[Group]:
    """Groups in the order in which they first appear; an absent value is a value."""
    keyed = rows_by(cases, names)
    if not keyed:
        return []
    ordered = cases.iloc[np.concatenate([rows for _, rows in keyed])]
    ends = np.cumsum([len(rows) for _, rows in keyed]).tolist()
    return [
        Group(dict(zip(names, key, strict=True)), ordered.iloc[end - len(rows) : end])
        for (key, rows), end in zip(keyed, ends, strict=True)
    ]


def rows_by(
    cases: pd.DataFrame, names: Sequence[str]
) -> list[tuple[tuple[Value, ...], NDArray[np.intp]]]:
    """The values of each group and the places of its rows, as `groups_by` has them."""
    if not len(cases):
        return []
    coded = [pd.factorize(cases[name], use_na_sentinel=False) for name in names]
    values = [[plain(value) for value in uniques] for _, uniques in coded]
    group = np.zeros(len(cases), dtype=np.int64)
    for codes, uniques in coded:  # numbered anew each time, so that no product grows too large
        group = pd.factorize(group * len(uniques) + codes)[0]
    order = np.argsort(group, kind="stable")
    rows = np.split(order, np.flatnonzero(np.diff(group[order])) + 1)
    keys = [
        tuple(known[codes[at[0]]] for known, (codes, _) in zip(values, coded, strict=True))
        for at in rows
    ]
    return list(zip(keys, rows, strict=True))


def by_setting(cases: pd.DataFrame, *more: str) -> list[Group]:
    """Groups of one protocol, back-end and setting, and of one value of each of `more`."""
    names = _setting_names(cases)
    return [
        replace(group, setting=names[_identity(group)])
        for group in groups_by(cases, [*SETTING, *more])
    ]


def first_settings(cases: pd.DataFrame, *more: str) -> list[Group]:
    """The first listed setting of each protocol and back-end, and first level of each of `more`.

    Nothing here is chosen by looking at the truth.
    """
    firsts: dict[tuple[str, Value], Group] = {}
    for group in by_setting(cases, *more):
        firsts.setdefault((group.protocol, group.key["backend"]), group)
    return list(firsts.values())


def by_level(cases: pd.DataFrame, factor: str) -> list[Group]:
    """A group per level of a factor: numbers ascending, other levels as they first appear."""
    levels = groups_by(cases, [factor])
    if not pd.api.types.is_numeric_dtype(cases[factor]):
        return levels
    return sorted(levels, key=lambda level: float(level.key[factor] or 0.0))


def _setting_names(cases: pd.DataFrame) -> dict[tuple[Value, ...], str]:
    every = [key for key, _ in rows_by(cases, SETTING[1:])]
    varied, labels = varied_settings(cases), [label for _, label, _ in every]
    names = {}
    for key in every:
        backend, settings = str(key[0]), parsed(key[2])
        label = str(key[1]).removeprefix(backend).strip(" ,:")
        shown = [f"{name}={settings[name]}" for name in varied[backend] if name in settings]
        # A label that was given for one setting alone says enough.
        alone = labels.count(key[1]) == 1
        names[key] = " ".join([label, *([] if label and alone else shown)]).strip()
    return {key: name or DEFAULT for key, name in names.items()}


def _identity(group: Group) -> tuple[Value, ...]:
    return tuple(group.key[name] for name in SETTING[1:])


def varied_settings(cases: pd.DataFrame) -> dict[str, list[str]]:
    """For each back-end, the names of its settings that take at least two values."""
    every: dict[str, list[dict[str, Value]]] = {}
    for (backend, settings), _ in rows_by(cases, ("backend", "settings")):
        every.setdefault(str(backend), []).append(parsed(settings))
    return {backend: _varied(settings) for backend, settings in every.items()}


def _varied(every: Sequence[dict[str, Value]]) -> list[str]:
    names = dict.fromkeys(name for settings in every for name in settings)
    return [name for name in names if len({repr(one.get(name)) for one in every}) > 1]


def parsed(settings: Value) -> dict[str, Value]:
    """Canonical settings by name; what is not a JSON object has none."""
    try:
        tree = json.loads(str(settings))
    except json.JSONDecodeError:
        return {}
    return {str(key): plain(value) for key, value in tree.items()} if isinstance(tree, dict) else {}


def factors(cases: pd.DataFrame) -> list[str]:
    """The swept factors: columns with a dotted name that take at least two values."""
    dotted = [name for name in cases.columns if "." in name]
    return [name for name in dotted if cases[name].nunique(dropna=False) > 1]


def numeric_factors(cases: pd.DataFrame) -> list[str]:
    """The swept factors whose every level is a number."""
    return [name for name in factors(cases) if pd.api.types.is_numeric_dtype(cases[name])]


def is_condition(factor: str) -> bool:
    """Whether a factor belongs to the flights, which no estimator can choose."""
    return factor.startswith(("flight.", "flights."))


def level_text(level: Value) -> str:
    """A level in words: `[0.5,0.1]`, a pair of a sweep, as `0.5 / 0.1`, and 60.0 as `60`."""
    if isinstance(level, float):
        return f"{level:g}"
    try:
        values = json.loads(str(level))
    except json.JSONDecodeError:
        return str(level)
    if not isinstance(values, list) or not all(isinstance(one, int | float) for one in values):
        return str(level)
    return " / ".join(f"{number:g}" for number in values)


def estimated(cases: pd.DataFrame) -> BoolArray:
    """(rows,) whether a case has an estimate: status `ok` or `inaccurate`, all three finite."""
    known = np.isin(cases["status"].to_numpy(dtype=object), ESTIMATED)
    both: BoolArray = known & np.isfinite(three_of(cases, "est")).all(axis=1)
    return both


def failures(cases: pd.DataFrame) -> int:
    """Number of cases without an estimate."""
    return int((~estimated(cases)).sum())


def has_status(cases: pd.DataFrame, status: str) -> BoolArray:
    """(rows,) whether a case ended in this status."""
    return np.asarray(cases["status"] == status, dtype=bool)


def in_a_flow(cases: pd.DataFrame) -> BoolArray:
    """(rows,) whether there was a flow to find, and it is known which."""
    return ~_flow_is(cases, "none", "unknown")


def in_still_air(cases: pd.DataFrame) -> BoolArray:
    """(rows,) whether there was no flow to find: an estimate is wrong.

    Of a flight that was logged, neither is known.
    """
    return _flow_is(cases, "none")


def _flow_is(cases: pd.DataFrame, *words: str) -> BoolArray:
    """(rows,) whether the column `flow`, which older files lack, holds one of these words."""
    if "flow" not in cases:
        return np.zeros(len(cases), dtype=bool)
    return cases["flow"].isin(words).to_numpy(dtype=bool)


def called_empty(cases: pd.DataFrame) -> BoolArray:
    """(rows,) whether a case ended because no cellular flow was detected.

    Cases from before there was a column `doubt` are known by their reason.
    """
    if "doubt" in cases:
        return cases["doubt"].isin([doubt for doubt in Doubt if doubt.no_flow]).to_numpy(dtype=bool)
    reasons = cases["reason"] if "reason" in cases else pd.Series("", index=cases.index)
    return np.asarray(reasons.astype(str).str.startswith(NO_FLOW), dtype=bool)


def numbers(cases: pd.DataFrame, name: str) -> Array:
    """(rows,) a numeric column; NaN where a value, or in older files the column, is absent."""
    if name not in cases:
        return np.full(len(cases), np.nan)
    return np.asarray(cases[name].to_numpy(dtype=np.float64, na_value=np.nan))


def three_of(cases: pd.DataFrame, prefix: str) -> Array:
    """(rows, 3) the columns `prefix`_* of U0 [m/s], L_w [m] and tau_w [s]."""
    return np.column_stack([numbers(cases, f"{prefix}_{name}") for name in PARAMETERS])
