"""What a reader learns of a point in a picture: its flight, its case, how to see it again."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import pandas as pd

from sparsefit.study.evidence.along import at_level
from sparsefit.study.evidence.cases import Group, by_setting, factors
from sparsefit.study.evidence.columns import statistic
from sparsefit.study.evidence.measures import MEASURES, names
from sparsefit.study.evidence.table import cell_text, printable
from sparsefit.study.report.html_page import Points

if TYPE_CHECKING:
    from sparsefit.study.spec.study import Study

ERRORS = [MEASURES[name] for name in names("signed-error")]


def points_of(study: Study, cases: pd.DataFrame, named: Iterable[str]) -> Points:
    """Return what stands behind the cases named, links of pictures, and how to see one again."""
    wanted = cases[cases["case_id"].isin(set(named))]
    swept = factors(cases)
    groups = by_setting(wanted, *swept)
    lines = {name: told for group in groups for name, told in _lines(group, swept)}
    return Points(lines, f"sparsefit study show {shlex.quote(_path(study.path))} --case")


def _lines(group: Group, swept: Sequence[str]) -> Iterator[tuple[str, list[str]]]:
    levels = [at_level(name, group.key[name]) for name in swept]
    setting = ", ".join([group.protocol, group.title, *levels])
    texts = [
        [cell_text(value, statistic(measure).column) for value in measure.read(group.cases)]
        for measure in ERRORS
    ]
    columns = (group.cases[name] for name in ("case_id", "flight", "status"))
    for case, flight, status, *errors in zip(*columns, *texts, strict=True):
        told = [f"{measure.symbol} {text} %" for measure, text in zip(ERRORS, errors, strict=True)]
        yield str(case), [f"flight {flight}", printable(setting), f"{status}: {', '.join(told)}"]


def _path(path: str) -> str:
    """The study file as seen from here; its name where it is elsewhere."""
    file = Path(path)
    try:
        return str(file.relative_to(Path.cwd())) if file.is_absolute() else path
    except ValueError:
        return file.name
