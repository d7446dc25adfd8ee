"""The columns that tables share: what a row stands for, its counts, and the three parameters."""

from __future__ import annotations

from collections.abc import Sequence

import pandas as pd

from sparsefit.study.evidence.summary import (
    PARAMETERS,
    SYMBOLS,
    TEX_SYMBOLS,
    UNITS,
    Group,
    StudyRecord,
    failures,
)
from sparsefit.study.evidence.table import Cell, Column


def name_column(name: str) -> Column:
    """A column of words."""
    return Column(name, align="left")


def setting_columns(swept: Sequence[str]) -> tuple[Column, ...]:
    """Protocol, back-end, setting and swept factors."""
    return tuple(map(name_column, ("protocol", "backend", "setting", *swept)))


def key_columns(swept: Sequence[str]) -> tuple[Column, ...]:
    """What a row stands for, and its counts: n, ok, failures."""
    counted = (Column(name, format="d") for name in ("n", "ok", "failures"))
    return (*setting_columns(swept), *counted)


def three(group: str, spec: str, unit: str | None = None) -> tuple[Column, ...]:
    """U0, L_w and tau_w under one heading, in their own units where none is given."""
    return tuple(
        Column(
            SYMBOLS[one],
            UNITS[one] if unit is None else unit,
            spec,
            group=group,
            tex=TEX_SYMBOLS[one],
        )
        for one in PARAMETERS
    )


def key(group: Group, swept: Sequence[str]) -> tuple[Cell, ...]:
    """The cells of `setting_columns`."""
    fixed = (group.key["protocol"], group.key["backend"], group.setting)
    return (*fixed, *(group.key[name] for name in swept))


def counts(cases: pd.DataFrame) -> tuple[int, int, int]:
    """Planned, ok, failures."""
    return len(cases), int((cases["status"] == "ok").sum()), failures(cases)


def titled(study: StudyRecord, words: str) -> str:
    """The title of a table, with its study."""
    return f"{words} ({study.name})"
