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
    places: dict[tuple[Value, ...], list[int]] = {}
    columns = [[plain(value) for value in cases[name]] for name in names]
    for place, key in enumerate(zip(*columns, strict=True)):
        places.setdefault(key, []).append(place)
    return [
        Group(dict(zip(names, key, strict=True)), cases.iloc[rows]) for key, rows in places.items()
    ]


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
    every = groups_by(cases, SETTING[1:])
    varied = varied_settings(cases)
    names = {}
    for group in every:
        backend, settings = str(group.key["backend"]), parsed(group.key["settings"])
        label = str(group.key["label"]).removeprefix(backend).strip(" ,:")
        shown = [f"{key}={settings[key]}" for key in varied[backend] if key in settings]
        # A label that was given for one setting alone says enough.
        alone = sum(other.key["label"] == group.key["label"] for other in every) == 1
        names[_identity(group)] = " ".join([label, *([] if label and alone else shown)]).strip()
    return {key: name or DEFAULT for key, name in names.items()}


def _identity(group: Group) -> tuple[Value, ...]:
    return tuple(group.key[name] for name in SETTING[1:])


def varied_settings(cases: pd.DataFrame) -> dict[str, list[str]]:
    """For each back-end, the names of its settings that take at least two values."""
    varied: dict[str, list[str]] = {}
    for backend in groups_by(cases, ["backend"]):
        every = [parsed(group.key["settings"]) for group in groups_by(backend.cases, ["settings"])]
        names = dict.fromkeys(name for settings in every for name in settings)
        varied[str(backend.key["backend"])] = [
            name for name in names if len({str(settings.get(name)) for settings in every}) > 1
        ]
    return varied


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
    return [name for name in dotted if len({plain(value) for value in cases[name]}) > 1]


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
    known = cases["status"].isin(ESTIMATED).to_numpy(dtype=bool)
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
    return np.array([plain(value) in words for value in cases["flow"]], dtype=bool)


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
