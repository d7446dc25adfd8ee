"""What a results folder holds of a study: finished rows, unfinished ones, or those of another."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from sparsefit.errors import InputError
from sparsefit.study.run import partial
from sparsefit.study.run.ledger import Ledger
from sparsefit.study.run.manifest import read_manifest, sparsefit_version
from sparsefit.study.run.outcome import Outcome
from sparsefit.study.spec.identity import AnyStudy

if TYPE_CHECKING:
    import pandas as pd


def found(study: AnyStudy, folder: Path) -> Ledger:
    """What the folder holds of the study: rows of an unfinished run, and those of a finished one.

    Rows count by what determines their numbers, whatever study file they were made for.

    Raises:
        InputError: where there are rows, and all of them are of another study, or damaged.
    """
    from sparsefit.study.run.earlier import note_earlier  # Arrow: workers import this module

    begun = partial.begun(folder)
    ledger = Ledger.read(study, folder) if begun else Ledger.of(study)
    ledger.unplanned += note_earlier(ledger, folder)
    if not ledger.done.any():
        _refuse_foreign(study, folder, ledger)
    return ledger


def _refuse_foreign(study: AnyStudy, folder: Path, ledger: Ledger) -> None:
    """Rows of another study are not dropped for it, unless that is asked for."""
    for made in (partial.read_header(folder), read_manifest(folder)):
        if made is not None and ledger.unplanned and made.get("study_hash") != study.hash:
            short = str(made.get("study_hash"))[:12]
            raise InputError(
                f"{folder} was made by a different study (hash {short}), and no case of it is of "
                "this one: study run --fresh starts over, or rename this study"
            )
    if ledger.unplanned:
        raise InputError(
            f"{folder} holds cases of an unknown study: study run --fresh starts over, or rename"
        )


def is_finished(study: AnyStudy, folder: Path, ledger: Ledger) -> bool:
    """Whether every planned case is a row of `cases.parquet`, and nothing else is to be done."""
    made = read_manifest(folder)
    same = made is not None and made.get("study_hash") == study.hash
    return same and not partial.begun(folder) and bool(ledger.earlier.all())


def begin(study: AnyStudy, folder: Path) -> None:
    """Start with unfinished rows of a study, or go on with what is there."""
    told = {"study_hash": study.hash, "sparsefit": sparsefit_version()}
    partial.begin(folder, told | {"study": study.name, "planned": study.planned})


def rows_of(ledger: Ledger, folder: Path) -> Iterator[Outcome]:
    """Every row that a folder holds of a study, of an earlier run and of the unfinished one."""
    from sparsefit.study.run.earlier import earlier_rows  # Arrow, as above

    yield from earlier_rows(ledger, folder)
    yield from ledger.rows(folder)


def cases_of(study: AnyStudy, folder: Path) -> pd.DataFrame:
    """The rows that a folder holds of a study, finished or not, in plan order."""
    from sparsefit.study.run.store import cases_table, read_cases

    ledger = found(study, folder)
    if is_finished(study, folder, ledger):
        return read_cases(folder)
    rows = sorted(rows_of(ledger, folder), key=lambda row: (row.flight, row.cell))
    frame: pd.DataFrame = cases_table(study, rows).to_pandas()
    return frame
