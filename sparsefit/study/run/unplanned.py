"""Rows of cases that a study no longer plans: kept beside the others until it plans them again.

They stand in `unplanned.jsonl`, line by line as those of an unfinished run (`partial.py`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from sparsefit.study.run import partial
from sparsefit.study.run.folder import UNPLANNED
from sparsefit.study.run.held import begin
from sparsefit.study.run.ledger import Ledger
from sparsefit.study.run.lines import Record, outcome_of, packed, record_of
from sparsefit.whole_file import whole_file


def take_back(ledger: Ledger, folder: Path) -> None:
    """Enter what is kept, planned again and nowhere else, among the rows of the unfinished run."""
    planned = [
        (case, line)
        for line in partial.lines_of(folder / UNPLANNED)
        if line and (case := ledger.names.at(line.flight, line.identity)) is not None
        if not ledger.has(*case)
    ]
    if not planned:
        return
    begin(ledger.study, folder)
    with partial.appending(folder) as rows:
        for (flight, cell), line in planned:
            ledger.enter(rows, replace(outcome_of(line.record), flight=flight, cell=cell))


def set_aside(ledger: Ledger, folder: Path) -> None:
    """Keep what is not planned of all that is there, before a finished run writes over it."""
    if not ledger.unplanned and not (folder / UNPLANNED).exists():
        return
    kept: dict[tuple[int, str], Record] = {}
    for flight, identity, record in _every(ledger, folder):
        if ledger.names.at(flight, identity) is None:
            kept[flight, identity] = record
    if not kept:
        (folder / UNPLANNED).unlink(missing_ok=True)
        return
    with whole_file(folder / UNPLANNED) as file:
        for (_, identity), record in kept.items():
            file.write(packed({"identity": identity, **record}))


def _every(ledger: Ledger, folder: Path) -> Iterator[tuple[int, str, Record]]:
    """(flight, identity, record) of all rows, what counts more later."""
    from sparsefit.study.run.earlier import unplanned_rows  # Arrow: workers import the runner

    for line in partial.lines_of(folder / UNPLANNED):
        if line:
            yield line.flight, line.identity, line.record
    for identity, row in unplanned_rows(ledger, folder):
        yield row.flight, identity, record_of(row)
    for line in partial.lines(folder):
        if line:
            yield line.flight, line.identity, line.record
