"""What tables and pictures count: groups of cases, their errors, and who failed.

An error is over the cases with an estimate (status `ok` or `inaccurate`, three finite numbers);
every other planned case is a failure, and is counted as one wherever errors are shown.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import pandas as pd

from sparsefit.arrays import Array, BoolArray
from sparsefit.study.evidence.table import Cell, plain

PARAMETERS = ("mean_velocity", "length_scale", "timescale")
SYMBOLS = {"mean_velocity": "U0", "length_scale": "L_w", "timescale": "τ_w"}
TEX_SYMBOLS = {"mean_velocity": "$U_0$", "length_scale": "$L_w$", "timescale": r"$\tau_w$"}
UNITS = {"mean_velocity": "m/s", "length_scale": "m", "timescale": "s"}
STATUSES = ("ok", "inaccurate", "unidentifiable", "error", "timeout", "crashed", "skipped")
ESTIMATED = ("ok", "inaccurate")
DEFAULT = "default"
REFINE = "readout.refine"
FLOOR = 1e-4  # percent: what is smaller is shown as this, so that a log axis has room for it
SETTING = ("protocol", "backend", "label", "settings")


class StudyRecord(Protocol):
    """What the pages of a study say about it; `sparsefit.study.Study` is one."""

    @property
    def name(self) -> str:
        """Its results folder."""
        ...

    @property
    def question(self) -> str:
        """What it asks."""
        ...

    @property
    def seed(self) -> int:
        """What its random numbers start from."""
        ...

    @property
    def hash(self) -> str:
        """sha256 of what its cases depend on."""
        ...

    @property
    def planned(self) -> int:
        """How many cases it plans."""
        ...

    @property
    def given(self) -> Mapping[str, str]:
        """The keys of its sections that the study file sets, dotted, each with canonical JSON."""
        ...

    @property
    def tables(self) -> tuple[str, ...]:
        """Names of the tables asked for; empty: those that apply."""
        ...

    @property
    def figures(self) -> tuple[str, ...]:
        """Names of the figures asked for; empty: those that apply."""
        ...

    @property
    def answers(self) -> tuple[str, ...]:
        """Names of the sentences that answer the question; empty: none."""
        ...


@dataclass(frozen=True, eq=False)
class Group:
    """The cases that share `key`, the values of the columns they were grouped by.

    `setting` tells the setting from the others of its back-end, in a few words.
    """

    key: dict[str, Cell]
    cases: pd.DataFrame
    setting: str = ""

    @property
    def title(self) -> str:
        """Back-end and setting, for a legend."""
        backend = str(self.key["backend"])
        if self.setting == DEFAULT:
            return backend
        # A label of its own, "least squares, truncated", already names the back-end.
        own = not str(self.key["label"]).startswith(backend)
        return self.setting if own else f"{backend} {self.setting}"


def grouped(cases: pd.DataFrame, by: Sequence[str]) -> list[Group]:
    """Groups in the order in which they first appear; an absent value is a value."""
    places: dict[tuple[Cell, ...], list[int]] = {}
    columns = [[plain(value) for value in cases[name]] for name in by]
    for place, key in enumerate(zip(*columns, strict=True)):
        places.setdefault(key, []).append(place)
    return [
        Group(dict(zip(by, key, strict=True)), cases.iloc[rows]) for key, rows in places.items()
    ]


def by_setting(cases: pd.DataFrame, *more: str) -> list[Group]:
    """Groups of one protocol, back-end and setting, and of one value of each of `more`."""
    names = _setting_names(cases)
    return [
        replace(group, setting=names[_identity(group)])
        for group in grouped(cases, [*SETTING, *more])
    ]


def first_settings(cases: pd.DataFrame) -> list[Group]:
    """The first listed setting of each protocol and back-end, over all levels."""
    firsts: dict[tuple[object, object], Group] = {}
    for group in by_setting(cases):
        firsts.setdefault((group.key["protocol"], group.key["backend"]), group)
    return list(firsts.values())


def _setting_names(cases: pd.DataFrame) -> dict[tuple[Cell, ...], str]:
    every = grouped(cases, SETTING[1:])
    varied = varied_settings(cases)
    names = {}
    for one in every:
        backend, settings = str(one.key["backend"]), parsed(one.key["settings"])
        label = str(one.key["label"]).removeprefix(backend).strip(" ,:")
        shown = [f"{key}={settings[key]}" for key in varied[backend] if key in settings]
        # A label that was given for one setting alone says enough.
        alone = sum(other.key["label"] == one.key["label"] for other in every) == 1
        names[_identity(one)] = " ".join([label, *([] if label and alone else shown)]).strip()
    return {key: name or DEFAULT for key, name in names.items()}


def _identity(group: Group) -> tuple[Cell, ...]:
    return tuple(group.key[name] for name in SETTING[1:])


def varied_settings(cases: pd.DataFrame) -> dict[str, list[str]]:
    """For each back-end, the names of its settings that take at least two values."""
    varied: dict[str, list[str]] = {}
    for backend in grouped(cases, ["backend"]):
        every = [parsed(group.key["settings"]) for group in grouped(backend.cases, ["settings"])]
        names = dict.fromkeys(name for settings in every for name in settings)
        varied[str(backend.key["backend"])] = [
            name for name in names if len({str(one.get(name)) for one in every}) > 1
        ]
    return varied


def parsed(settings: Cell) -> dict[str, Cell]:
    """Canonical settings as cells by name; what is not a JSON object has none."""
    try:
        tree = json.loads(str(settings))
    except json.JSONDecodeError:
        return {}
    return {str(key): plain(value) for key, value in tree.items()} if isinstance(tree, dict) else {}


def factors(cases: pd.DataFrame) -> list[str]:
    """The swept factors: columns with a dotted name that take at least two values."""
    dotted = [name for name in cases.columns if "." in name]
    return [name for name in dotted if len({plain(value) for value in cases[name]}) > 1]


def is_condition(factor: str) -> bool:
    """Whether a factor belongs to the flights, which no estimator can choose."""
    return factor.startswith(("flight.", "flights."))


def estimated(cases: pd.DataFrame) -> BoolArray:
    """(rows,) whether a case has an estimate: status `ok` or `inaccurate`, all three finite."""
    known = cases["status"].isin(ESTIMATED).to_numpy(dtype=bool)
    finite = np.asarray(np.isfinite(_columns(cases, "est")).all(axis=1), dtype=bool)
    both: BoolArray = known & finite
    return both


def failures(cases: pd.DataFrame) -> int:
    """Number of cases without an estimate."""
    return int((~estimated(cases)).sum())


def hits(cases: pd.DataFrame) -> BoolArray:
    """(rows,) whether a case chose the grid scale nearest the truth; a failure did not."""
    hit = np.array([plain(value) is True for value in cases["hit"]], dtype=bool)
    return hit & estimated(cases)


def signed_errors(cases: pd.DataFrame) -> Array:
    """(rows, 3) estimate - truth of U0 [m/s], L_w [m], tau_w [s]; NaN without an estimate."""
    errors = _columns(cases, "est") - _columns(cases, "true")
    errors[~estimated(cases)] = np.nan
    return errors


def percent_errors(cases: pd.DataFrame) -> Array:
    """(rows, 3) signed errors in percent of the truth; NaN where there is no estimate."""
    percent: Array = 100.0 * signed_errors(cases) / _columns(cases, "true")
    return percent


def quartiles(cases: pd.DataFrame, name: str) -> Array:
    """(3,) quartiles of |% error|, each an observed value; a failure is an infinite error."""
    percent = np.abs(percent_errors(cases)[:, PARAMETERS.index(name)])
    # Without a flow to find there is no truth: an estimate is a false alarm.
    known = estimated(cases) & ~np.isnan(percent)
    sizes = np.where(known, np.maximum(percent, FLOOR), np.inf)
    return np.asarray(np.quantile(sizes, [0.25, 0.5, 0.75], method="inverted_cdf"))


def _columns(cases: pd.DataFrame, prefix: str) -> Array:
    names = [f"{prefix}_{name}" for name in PARAMETERS]
    return np.column_stack([numbers(cases, name) for name in names])


def numbers(cases: pd.DataFrame, name: str) -> Array:
    """(rows,) a numeric column as floats, absent values as NaN."""
    return np.asarray(cases[name].to_numpy(dtype=np.float64, na_value=np.nan))


def recorded(cases: pd.DataFrame, name: str) -> Array:
    """(rows,) a numeric column; NaN where the study was run before there was such a column."""
    return numbers(cases, name) if name in cases else np.full(len(cases), np.nan)


def three_of(cases: pd.DataFrame, prefix: str) -> Array:
    """(rows, 3) the columns `prefix`_* of U0, L_w and tau_w; NaN where there are none."""
    return np.column_stack([recorded(cases, f"{prefix}_{name}") for name in PARAMETERS])


def in_a_flow(cases: pd.DataFrame) -> BoolArray:
    """(rows,) whether there was a flow to find; where there was none, an estimate is wrong."""
    if "flow" not in cases:
        return np.ones(len(cases), dtype=bool)
    return np.array([plain(value) != "none" for value in cases["flow"]], dtype=bool)


def mean(values: Array) -> list[float]:
    """Mean of each column over its finite entries; NaN where there is none."""
    return [float(np.mean(column)) if column.size else np.nan for column in _finite(values)]


def quantile(values: Array, share: float) -> list[float]:
    """Quantile (linear interpolation) of each column over its finite entries."""
    return [float(np.quantile(one, share)) if one.size else np.nan for one in _finite(values)]


def _finite(values: Array) -> list[Array]:
    return [column[np.isfinite(column)] for column in values.T]
