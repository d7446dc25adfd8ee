"""Rows that an earlier run of a study left in `cases.parquet`, for one that plans them again."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any, TypeAlias

from sparsefit.study.run.columns import Kind as ColumnKind
from sparsefit.study.run.folder import CASES, WEIGHTS
from sparsefit.study.run.kinds import kind_of
from sparsefit.study.run.ledger import Ledger
from sparsefit.study.run.manifest import read_manifest
from sparsefit.study.run.outcome import Outcome
from sparsefit.study.run.store import BATCH, check_cases, reading
from sparsefit.study.spec.identity import AnyStudy

Weights: TypeAlias = tuple[tuple[float, float], ...]  # (length scale [m], weight) pairs
ENDED = ("status", "reason", "version")  # what every row has


@dataclass(frozen=True)
class Known:
    """How rows of the file name their cases: a column, and the cases of the plan by its values.

    As long as the study is the same, that is their case_id, however identities are told by now;
    rows of another one are known by their identity, those from before there was one not at all.
    case: by the row's flight and its name; version: of rows that do not carry it.
    """

    column: str
    case: Callable[[int, str], tuple[int, int] | None]
    version: str

    def of(self, row: Mapping[str, Any]) -> tuple[int, int] | None:
        """(flight, cell) of a row of the file; None where the study does not plan it."""
        return self.case(_flight(row), row[self.column])


def _flight(row: Mapping[str, Any]) -> int:
    """Its number, which older files of studies of solvers have in the case_id only."""
    return int(row["flight"]) if "flight" in row else _number(row["case_id"])


def _number(case_id: str) -> int:
    return int(case_id.partition("-")[0])


def note_earlier(ledger: Ledger, folder: Path) -> int:
    """Enter into the ledger what `cases.parquet` holds of the plan and nothing else does.

    Such a row stands at place -2 - its number in the file. Returns how many rows the file has
    that are not of the plan; 0 where there is no file.
    """
    if not (folder / CASES).exists():
        return 0
    unplanned = 0
    with reading(folder / CASES) as file:
        check_cases(folder / CASES, file.schema_arrow)
        names = set(file.schema_arrow.names)
        known = _known(ledger, folder, names)
        wanted = [name for name in (known.column, "flight", "status", "version") if name in names]
        number = 0
        for batch in file.iter_batches(columns=wanted):
            columns = {name: batch.column(name).to_pylist() for name in wanted}
            versions = columns.get("version", [known.version] * batch.num_rows)
            flights = columns.get("flight") or map(_number, columns["case_id"])
            told = zip(flights, columns[known.column], strict=True)
            for row, (flight, name) in enumerate(told):
                case = known.case(flight, name)
                if case is None:
                    unplanned += 1
                elif not ledger.has(*case):
                    ledger.note(*case, columns["status"][row], versions[row], -2 - number - row)
            number += batch.num_rows
    return unplanned


def earlier_rows(ledger: Ledger, folder: Path) -> Iterator[Outcome]:
    """The rows of the plan that stand in `cases.parquet` and nowhere else."""
    if not ledger.earlier.any():
        return
    read = _read(ledger.study)
    for number, (known, row, weights) in enumerate(_rows_of_file(ledger, folder)):
        case = known.of(row)
        if case and ledger.place[case] == -2 - number:
            yield _outcome(read, row, case, weights)


def unplanned_rows(ledger: Ledger, folder: Path) -> Iterator[tuple[str, Outcome]]:
    """(identity, row) of the rows of `cases.parquet` that the study does not plan."""
    if not (folder / CASES).exists():
        return
    read = _read(ledger.study)
    for known, row, weights in _rows_of_file(ledger, folder):
        if known.column != "identity":  # the same study, or one from before there were any
            return
        if known.of(row) is None:
            yield row["identity"], _outcome(read, row, (_flight(row), 0), weights)


def _rows_of_file(ledger: Ledger, folder: Path) -> Iterator[tuple[Known, dict[str, Any], Weights]]:
    """Every row of `cases.parquet` with its weights, and how it names its case."""
    weights = _Weights(ledger.study, folder)
    with reading(folder / CASES) as file:
        known = _known(ledger, folder, set(file.schema_arrow.names))
        for batch in file.iter_batches(batch_size=BATCH):
            for row in batch.to_pylist():
                row.setdefault("version", known.version)
                yield known, row, weights.of(row["case_id"])


def _known(ledger: Ledger, folder: Path, names: set[str]) -> Known:
    manifest = read_manifest(folder) or {}
    versions = manifest.get("versions")
    made_by = str(versions.get("sparsefit")) if isinstance(versions, dict) else "unknown"
    if manifest.get("study_hash") == ledger.study.hash:
        find = kind_of(ledger.study).find
        return Known("case_id", lambda _, name: find(name), made_by)
    if "identity" in names:
        return Known("identity", ledger.names.at, made_by)
    return Known("case_id", lambda _, __: None, made_by)


def _read(study: AnyStudy) -> dict[str, ColumnKind]:
    """The columns that are not told by the plan."""
    columns = kind_of(study).columns
    return {one.name: one.kind for one in columns if not one.planned and one.name not in ENDED}


def _outcome(
    read: Mapping[str, ColumnKind],
    row: Mapping[str, Any],
    case: tuple[int, int],
    weights: Weights,
) -> Outcome:
    values = {name: kind.of(row[name]) for name, kind in read.items() if name in row}
    status, reason, version = (str(row[name]) for name in ENDED)
    return Outcome(*case, status, reason, values, weights=weights, version=version)


class _Weights:
    """Weights by case, read along with the cases: both files are in the same order."""

    def __init__(self, study: AnyStudy, folder: Path) -> None:
        kept = study.store_weights and (folder / WEIGHTS).exists()
        self._cases = _grouped(folder / WEIGHTS) if kept else iter(())
        self._next = next(self._cases, None)

    def of(self, case_id: str) -> Weights:
        """(length scale [m], weight) pairs of a case; every case is asked for, in the order."""
        if self._next is None or self._next[0] != case_id:
            return ()
        pairs, self._next = self._next[1], next(self._cases, None)
        return pairs


def _grouped(path: Path) -> Iterator[tuple[str, Weights]]:
    for case_id, rows in groupby(_rows(path), key=lambda row: row["case_id"]):
        yield case_id, tuple((row["length_scale"], row["weight"]) for row in rows)


def _rows(path: Path) -> Iterator[dict[str, Any]]:
    with reading(path) as file:
        for batch in file.iter_batches(batch_size=BATCH):
            yield from batch.to_pylist()
