"""The rows of a study on disk: `cases.sqlite` while it runs, `cases.parquet` when it is finished.

    with Store.opened(folder, plan) as store:      # one writer, by the folder's lock
        store.put(outcome, version)
        store.sync()                               # on the disk
        store.export()                             # Parquet, in plan order, as it ships
    read_cases(folder)                             # a frame, if the checksum of the file is right

`cases.sqlite` begins with the rows of an earlier export, copied in one transaction, and takes the
place of it until the next. The key of a row is the id of its case. Each row has a checksum,
an export has its own in `manifest.json`, beside versions and the machine: a damaged row is ignored,
a damaged file is refused in a line. What was committed survives a kill. The next export leaves out
rows that are not planned.
"""

from __future__ import annotations

import json
import math
import os
import platform
import re
import sqlite3
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple
from zlib import crc32

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from sparsefit.arrays import BoolArray
from sparsefit.errors import InputError, is_real
from sparsefit.study.columns import (
    FAILED,
    FLIGHT_COLUMNS,
    PARAMETERS,
    PROBLEM_COLUMNS,
    STATUSES,
    Outcome,
    Value,
    kinds_of,
)
from sparsefit.study.plan import Plan, versions
from sparsefit.study.schema import digest_of
from sparsefit.whole_file import read_whole, refusing, whole_file, write_whole

STORE, CASES, MANIFEST = "cases.sqlite", "cases.parquet", "manifest.json"
LARGEST = 1 << 24  # bytes of a record that is read
SCHEMA = """CREATE TABLE IF NOT EXISTS cases (case_id TEXT PRIMARY KEY, body TEXT NOT NULL,
crc INTEGER NOT NULL)"""
REMEDIES = {  # by what SQLite says
    **dict.fromkeys(("full", "I/O"), "make room, and run it again"),
    **dict.fromkeys(("readonly", "unable to open"), "check the folder's permissions"),
    "locked": "another run writes to it: wait for it",
}
FRESH = "study run --fresh starts over, or rename this study"
BATCH, GROUP = 2048, 16_384  # rows that are read, and written, at once


class Row(NamedTuple):
    """A stored row: the id of its case, and the columns that are not planned as JSON."""

    case_id: str
    body: str

    @classmethod
    def of(cls, case_id: str, values: Mapping[str, Value | None]) -> Row:
        """The row of a case with these columns, `status`, `reason` and `version` among them."""
        content = {n: v for n, v in values.items() if v == v and v is not None and v != ""}
        return cls(case_id, json.dumps(content, separators=(",", ":")))

    @property
    def values(self) -> dict[str, Any]:
        """The columns that are not planned, empty ones left out; none of a forged body."""
        with suppress(ValueError, RecursionError):
            if isinstance(content := json.loads(self.body), dict):
                return content
        return {}

    @property
    def crc(self) -> int:
        """The checksum of the whole row."""
        return crc32("\0".join(self).encode(errors="backslashreplace"))

    def agrees(self, other: Row) -> bool:
        """Whether status and estimates, to 6 digits as across machines, are those of another."""
        mine, theirs = self.values, other.values
        names = [f"est_{name}" for name in PARAMETERS]
        near = (math.isclose(mine.get(n, 0.0), theirs.get(n, 0.0), rel_tol=1e-6) for n in names)
        return mine["status"] == theirs["status"] and all(near)


@dataclass
class Store:
    """The rows of a results folder, by the cases of a plan.

    same: whether the manifest has the hash of this study; status and version: of each case (u, c),
    empty without a row; remedy: for a damaged file; exported: whether they were read from
    `cases.parquet`; damaged: the number of rows with a wrong checksum or status; unplanned: of rows
    of other cases; pending: rows to be written at the next `sync`.
    """

    folder: Path
    plan: Plan
    same: bool
    status: NDArray[Any]
    version: NDArray[Any]
    remedy: str = FRESH
    exported: bool = False
    damaged: int = 0
    unplanned: int = 0
    base: sqlite3.Connection | None = None
    pending: list[Row] = field(default_factory=list)
    synced: float = field(default_factory=time.monotonic)

    @classmethod
    def read(cls, folder: Path, plan: Plan, remedy: str = FRESH) -> Store:
        """The rows of the folder, read-only; remedy: for rows that are no run of this study.

        Raises:
            InputError: where a file is damaged or no regular one, has two rows of a case, or
                there are rows, and all of them are of another study.
        """
        made = read_record(folder / MANIFEST) or {}
        same = made.get("study_hash") == plan.hash
        status, version = np.full((2, *plan.shape), "", object)
        store = cls(folder, plan, same, status, version, remedy)
        for row in store._every(brief=True):
            values = row.values if row else {}
            place = plan.place_of.get(row.case_id) if row else None
            if row is None or values.get("status") not in STATUSES:
                store.damaged += 1
            elif place is None:
                store.unplanned += 1
            elif store.status.flat[place]:  # of an export; the key of a base is the id
                raise InputError(f"{folder}: has two rows of case {row.case_id}: {remedy}")
            else:
                store.status.flat[place] = values["status"]
                store.version.flat[place] = str(values.get("version", "unknown"))
        if store.unplanned and not store.done.any():
            which = f" (hash {str(made['study_hash'])[:12]})" if made and not same else ""
            words = f"was made by a different study{which}, and no case of it is of this one"
            raise InputError(f"{folder} {words}: {remedy}")
        return store

    @classmethod
    @contextmanager
    def opened(cls, folder: Path, plan: Plan) -> Iterator[Store]:
        """The store, open for writing; synced at the end."""
        store, path = cls.read(folder, plan), folder / STORE
        with _telling(path), closing(sqlite3.connect(path, timeout=60.0)) as base:
            if store.exported:
                store.pending = [row for row in store._every() if row]
            store.base = base
            store.sync()
            try:
                yield store
            finally:
                store.sync()

    @property
    def finished(self) -> bool:
        """Whether `cases.parquet` is of this very study and has every case."""
        return self.same and self.exported and bool(self.done.all()) and not self.unplanned

    @property
    def done(self) -> BoolArray:
        """The cases (u, c) that have a row."""
        return np.asarray(self.status != "", bool)

    @property
    def failed(self) -> BoolArray:
        """The cases (u, c) whose row has no answer."""
        return np.isin(self.status.astype(str), FAILED)

    @property
    def stale(self) -> BoolArray:
        """The cases (u, c) whose row is of another version of the code."""
        others: BoolArray = self.version != np.array(self.plan.versions, object)
        return others & self.done

    def put(self, outcome: Outcome, version: str) -> None:
        """Write the row of an outcome, by this version, in the place of an earlier one."""
        case = outcome.unit, outcome.cell
        case_id = self.plan.case_ids[outcome.unit * self.plan.shape[1] + outcome.cell]
        ended = {"status": outcome.status, "reason": outcome.reason, "version": version}
        self.put_row(Row.of(case_id, {**outcome.values, **ended}))
        self.status[case], self.version[case] = outcome.status, version

    def put_row(self, row: Row) -> None:
        """Write a row at the next `sync`."""
        self.pending.append(row)
        if len(self.pending) >= 512:
            self.sync()

    def sync(self, patience: float = 0.0) -> None:
        """Commit pending rows to disk, unless the last time was less than this [s] ago."""
        if patience and not (self.pending and time.monotonic() - self.synced > patience):
            return
        path = self.folder / STORE
        if not path.exists():
            raise InputError(f"{path}: was removed during the run: run it again")
        assert self.base is not None
        with _telling(path), self.base:
            self.base.execute("BEGIN")  # the first time, the table appears with its rows
            self.base.execute(SCHEMA)
            rows = [(*row, row.crc) for row in self.pending]
            self.base.executemany("INSERT OR REPLACE INTO cases VALUES (?, ?, ?)", rows)
        self.pending, self.synced = [], time.monotonic()

    def rows(self) -> list[Row]:
        """The undamaged rows of planned cases, in plan order."""
        rows = {row.case_id: row for row in self._every() if row}
        done = zip(self.plan.case_ids, self.done.flat, strict=True)
        return [rows[case_id] for case_id, has_row in done if has_row and case_id in rows]

    def _every(self, *, brief: bool = False) -> Iterator[Row | None]:
        """Every row of `cases.sqlite` or, without that, of `cases.parquet`; None for a row whose
        checksum is wrong. brief: exported rows with status and version alone.
        """
        path = self.folder / STORE
        self.exported = not is_regular(path)
        if not self.exported:
            uri = f"{path.absolute().as_uri()}?mode=rw"
            with (
                _telling(path, self.remedy),
                closing(sqlite3.connect(uri, uri=True, timeout=10.0)) as base,
            ):
                base.text_factory = bytes
                if base.execute("SELECT 1 FROM sqlite_master WHERE name = 'cases'").fetchone():
                    for *content, crc in base.execute("SELECT case_id, body, crc FROM cases"):
                        # In a damaged file they may be of any type.
                        texts = set(map(type, content)) == {bytes}
                        whole = texts and crc32(b"\0".join(content)) == crc
                        yield Row(*map(bytes.decode, content)) if whole else None
                    return
            self.exported = True
        if is_regular(self.folder / CASES):
            with parquet(self.folder / CASES) as file:
                there = set(file.schema_arrow.names).difference(self.plan.columns)
                wanted = ("status", "version") if brief else kinds_of(self.plan.stored)
                own = [name for name in wanted if name in there]
                for batch in file.iter_batches(batch_size=BATCH, columns=["case_id", *own]):
                    ids, values = batch["case_id"].to_pylist(), batch.select(own).to_pylist()
                    yield from map(Row.of, ids, values)

    def export(self, content: Mapping[str, object]) -> None:
        """Write `cases.parquet`, in plan order, whole or not at all, then its manifest.

        content: of the run, beside the study, checksums, versions and the machine.
        """
        self.sync()
        rows = self.rows()
        starts = range(0, max(len(rows), 1), GROUP)  # one part at least has the columns
        parts = (cases_table(self.plan, rows[start : start + GROUP]) for start in starts)
        table = pa.concat_tables(parts)
        dense = [column.name for column in self.plan.stored if column.kind.dense]
        with whole_file(self.folder / CASES) as file:
            pq.write_table(
                table,
                file,
                GROUP,
                compression="zstd",
                compression_level=9,
                use_dictionary=[name for name in table.column_names if name not in dense],
                column_encoding=dict.fromkeys(dense, "BYTE_STREAM_SPLIT"),
                write_page_checksum=True,
            )
        plan = self.plan
        manifest = {
            "study": plan.definition.name,
            "study_hash": plan.hash,
            "seed": plan.definition.seed,
            "cases": plan.size,
            **content,
            "sha256": {CASES: digest_of(self.folder / CASES)},
            "finished": datetime.now(UTC).isoformat(timespec="seconds"),
            "versions": versions(),
            "platform": platform.platform(),
            "processors": os.cpu_count(),
        }
        write_whole(self.folder / MANIFEST, json.dumps(manifest, indent=2) + "\n")


def discard(folder: Path, *exported: str) -> None:
    """Remove `cases.sqlite`, what a killed export has left, and the exported files named."""
    rests = (path.name for own in (CASES, MANIFEST) for path in folder.glob(f".{own}.*.partial"))
    for name in (STORE, f"{STORE}-journal", *exported, *rests):
        with refusing(folder / name):
            (folder / name).unlink(missing_ok=True)


@contextmanager
def _telling(path: Path, fresh: str = FRESH) -> Iterator[None]:
    """Raise an error of SQLite as an InputError with cause and remedy; fresh: that of damage."""
    try:
        yield
    except (sqlite3.Error, UnicodeDecodeError) as error:  # the second of SQLite's own words
        remedy = next((words for word, words in REMEDIES.items() if word in str(error)), "")
        cause = str(error) if remedy else f"damaged ({error})"
        raise InputError(f"{path}: {cause}: {remedy or fresh}") from None


def is_regular(path: Path) -> bool:
    """Whether there is a regular file. Raises InputError for a link, a pipe or a folder."""
    with refusing(path, "read"):
        is_there = os.path.lexists(path)
        if is_there and (path.is_symlink() or not path.is_file()):
            words = "no regular file: remove it, or study run --fresh starts over"
            raise InputError(f"{path}: {words}")
    return is_there


@contextmanager
def parquet(path: Path) -> Iterator[Any]:
    """A Parquet file of cases, its checksum, size and columns checked.

    Raises:
        InputError: with cause and remedy, also where reading fails inside the block.
    """
    if not is_regular(path):
        raise InputError(f"{path}: no such file: run the study first (sparsefit study run)")
    check_whole(path)
    try:
        with pq.ParquetFile(path, page_checksum_verification=True) as file:
            facts, schema = file.metadata, file.schema_arrow
            size = sum(facts.row_group(i).total_byte_size for i in range(facts.num_row_groups))
            if facts.num_rows > 2_000_000 or size > 1000 * (path.stat().st_size + 1_000_000):
                words = f"{facts.num_rows} rows of {size} bytes"
                raise InputError(f"{path}: {words}: it is another file")
            there = [(column.name, _content(str(column.type))) for column in schema]
            needed = {"case_id", "backend", "settings", "status", "reason", "version"}
            for name, kind in kinds_of((*PROBLEM_COLUMNS, *FLIGHT_COLUMNS)).items():
                own = [content for other, content in there if other == name]
                if own != [_content(kind.arrow)] and (own or name in needed):
                    words = f'without one column "{name}" of {_content(kind.arrow)}'
                    remedy = "take it from where it came, or run the study with --fresh"
                    raise InputError(f"{path}: no cases of a study, {words}: {remedy}")
            yield file
    except (OSError, pa.ArrowException, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path}: not readable ({error}): run the study with --fresh") from None


def _content(arrow: str) -> str:
    """`text` or `numbers`, as columns of an Arrow type hold, or the type."""
    if re.match(r"(large_)?string|dictionary<values=string", arrow):
        return "text"
    return "numbers" if re.match("u?int|float|double|halffloat", arrow) else arrow


def read_cases(folder: str | Path) -> pd.DataFrame:
    """The rows of `cases.parquet` in a results folder, all its columns.

    Raises:
        InputError: if there is no file, or it is not readable or damaged.
    """
    with parquet(Path(folder) / CASES) as file:
        frame: pd.DataFrame = file.read().to_pandas()
    return frame


def cases_table(plan: Plan, rows: Sequence[Row]) -> pa.Table:
    """The table of `cases.parquet`: columns of the plan, of the rows, and swept factors."""
    places = [plan.place_of[row.case_id] for row in rows]
    kinds, arrays = kinds_of(plan.stored), dict[str, Any]()
    types = {name: pa.type_for_alias(kind.arrow) for name, kind in kinds.items()}
    own = pa.struct({name: types[name] for name in types if name not in plan.columns})
    try:
        bodies = pa.array([row.values for row in rows], own)
    except (ValueError, TypeError, OverflowError) as error:  # of Arrow, or of Python
        words = f"a row has a value of another type ({error}): study run --fresh starts over"
        raise InputError(f"{STORE}: {words}") from None
    for name, kind in kinds.items():
        if name in plan.columns:
            arrays[name] = pa.array([plan.columns[name][at] for at in places], types[name])
        else:
            arrays[name] = bodies.field(name).fill_null(kind.empty)
    swept: Mapping[str, Any] = getattr(plan, "sweep", {})
    for key, levels in swept.items():
        kind_ = pa.float64() if all(map(is_real, levels)) else pa.string()
        arrays[key] = pa.array([plan.columns[key][place] for place in places], type=kind_)
    return pa.table(arrays)


def read_record(path: Path) -> dict[str, Any] | None:
    """The JSON object in a regular file; None without a readable one."""
    try:
        content = json.loads(read_whole(path, most=LARGEST))
    except (InputError, ValueError, RecursionError):
        return None
    return content if isinstance(content, dict) else None


def check_whole(path: Path, *, strict: bool = False) -> None:
    """Raise `InputError` unless a file has the checksum in the manifest beside it.

    strict: also where the manifest has none, for a part that is merged from elsewhere.
    """
    written = (read_record(path.parent / MANIFEST) or {}).get("sha256")
    if not isinstance(written, dict) or path.name not in written:
        if strict:
            words = f"no checksum of it stands in {MANIFEST}"
            raise InputError(f"{path}: {words}: take both files from where they came")
        return
    if digest_of(path) != written[path.name]:
        raise InputError(
            f"{path}: not what was written (its sha256 is not that of {MANIFEST}): "
            "take both files from where they came, or run the study with --fresh"
        )
