"""What a picture of lines shows: its axes, and panel by panel the cases of each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from sparsefit.study.evidence.along import at_level
from sparsefit.study.evidence.asked import Asked, refuse
from sparsefit.study.evidence.cases import (
    Group,
    by_level,
    by_setting,
    factors,
    first_settings,
    groups_by,
    numeric_factors,
)
from sparsefit.study.evidence.measure import Measure
from sparsefit.study.report.drawing import shortened

if TYPE_CHECKING:
    from sparsefit.study.spec.study import Study

SETTING = "setting"  # as a dimension, beside the protocol and the swept factors
OTHERS = "others"  # as rows: every swept factor that has no other place


@dataclass(frozen=True)
class Panel:
    """What one panel shows: cases, a measure, its horizontal axis, and its two titles."""

    cases: pd.DataFrame
    measure: Measure
    along: str
    rows: tuple[str, ...]
    title: str
    heading: str = ""

    @property
    def named(self) -> bool:
        """Whether the axis has names instead of numbers."""
        return self.along not in numeric_factors(self.cases)


def checked_axes(asked: Asked, study: Study, cases: pd.DataFrame) -> list[str]:
    """The factors that the entry draws along, each of them there and with something to show."""
    asked.needs(study.name, "measure")
    output, dimensions = f'the figure "{asked.file_name}"', ("protocol", SETTING, *factors(cases))
    axes_of = [asked.along] if asked.along else numeric_factors(cases)
    for name in (*axes_of, *asked.columns, *(one for one in asked.rows if one != OTHERS)):
        if name not in dimensions:
            raise refuse(study.name, f'does not sweep "{name}"', output)
    if not axes_of:
        raise refuse(study.name, "sweeps no number", output)
    if not any(np.isfinite(one.read(cases)).any() for one in asked.measures):
        raise refuse(study.name, f"has no {asked.first.words}", output)
    return axes_of


def titled(cases: pd.DataFrame, *, every: bool) -> pd.DataFrame:
    """The cases of the settings to draw, with the setting's title as a column."""
    groups = by_setting(cases) if every else first_settings(cases)
    return pd.concat([group.cases.assign(**{SETTING: group.title}) for group in groups])


def rows_of(asked: Asked, cases: pd.DataFrame, along: str) -> list[list[Panel]]:
    """The panels of one axis: a list per row."""
    placed = {along, *asked.columns}
    if OTHERS in asked.rows:
        names = [name for name in factors(cases) if name not in placed]
    else:
        free = asked.over != "protocol" and "protocol" not in placed
        names = [*(asked.rows or (["protocol"] if free else []))]
    rows = []
    for row in groups_by(cases, names) if names else [Group({}, cases)]:
        many = cases["protocol"].nunique() > 1 or names != ["protocol"]
        title = _words(row) if names and many else ""
        parts = [Group({}, row.cases)]
        if asked.columns:
            every = [level for name in asked.columns for level in by_level(row.cases, name)]
            parts = every[:4] if SETTING in asked.columns else every
        rows.append(
            [
                Panel(part.cases, measure, along, tuple(names), title, _words(part))
                for part in parts
                for measure in asked.measures
            ]
        )
    return rows


def _words(group: Group) -> str:
    return ", ".join(
        shortened(str(level).replace("alpha_fraction=", "alpha "), 24)
        if name in ("protocol", SETTING)
        else at_level(name, level)
        for name, level in group.key.items()
    )
