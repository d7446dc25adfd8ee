"""The rows of a study on disk: `cases.sqlite` while it runs, `cases.parquet` when it is finished.

    with Store.opened(folder, plan) as store:      # one writer, by the folder's lock
        store.put(outcome, version)
        store.sync()                               # on the disk
        store.export()                             # Parquet, in plan order

`cases.sqlite` begins with the rows of an earlier export, in one transaction, and counts alone as
long as it is there. A row is kept by what it is (its identity) and has a checksum of its own: a
damaged one is none, a damaged file is refused in a line. A process that is killed leaves all that
was committed. Rows that the study no longer plans go with the next export.
"""

from __future__ import annotations

import sqlite3
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from sparsefit.arrays import BoolArray
from sparsefit.errors import InputError
from sparsefit.study.columns import FAILED, STATUSES, Outcome, body_of
from sparsefit.study.export import Row, exported_rows, is_regular, write_rows
from sparsefit.study.manifest import MANIFEST, read_record
from sparsefit.study.plan import Plan
from sparsefit.whole_file import refusing

STORE = "cases.sqlite"
SCHEMA = """CREATE TABLE IF NOT EXISTS cases (key TEXT PRIMARY KEY, status TEXT NOT NULL,
reason TEXT NOT NULL, version TEXT NOT NULL, body TEXT NOT NULL, crc INTEGER NOT NULL)"""
REMEDIES = {  # by what SQLite says
    **dict.fromkeys(("full", "I/O"), "make room, and run it again"),
    **dict.fromkeys(("readonly", "unable to open"), "check the folder's permissions"),
    "locked": "another run writes to it: wait for it",
}


@dataclass
class Store:
    """The rows of one results folder against a plan.

    status and version: of each case of the plan, empty where there is no row; exported: whether
    they were read from `cases.parquet`; finished: whether it is of this very study, and holds every
    case; damaged: rows whose checksum or status is wrong; unplanned: rows of cases that are not
    planned; pending: rows to be written at the next `sync`.
    """

    folder: Path
    plan: Plan
    status: list[str]
    version: list[str]
    exported: bool = False
    finished: bool = False
    damaged: int = 0
    unplanned: int = 0
    base: sqlite3.Connection | None = None
    pending: list[Row] = field(default_factory=list)
    synced: float = field(default_factory=time.monotonic)

    @classmethod
    def read(cls, folder: Path, plan: Plan) -> Store:
        """The rows that the folder has, to be looked at and not written.

        Raises:
            InputError: where a file is damaged or no regular one, or there are rows, and all of
                them are of another study.
        """
        store = cls(folder, plan, [""] * plan.size, [""] * plan.size)
        for row in store._every(brief=True):
            place = None if row is None else plan.place_of.get(row.key)
            if row is None:
                store.damaged += 1
            elif place is None:
                store.unplanned += 1
            else:
                store.status[place], store.version[place] = row.status, row.version or "unknown"
        made = read_record(folder / MANIFEST) or {}
        same = made.get("study_hash") == plan.experiment.definition.hash
        if store.unplanned and not any(store.status):
            which = f" (hash {str(made['study_hash'])[:12]})" if made and not same else ""
            raise InputError(
                f"{folder} was made by a different study{which}, and no case of it is of this one: "
                "study run --fresh starts over, or rename this study"
            )
        store.finished = same and store.exported and all(store.status) and not store.unplanned
        return store

    @classmethod
    @contextmanager
    def opened(cls, folder: Path, plan: Plan) -> Iterator[Store]:
        """The store to write to; synced at the end."""
        store, path = cls.read(folder, plan), folder / STORE
        with _telling(path), closing(sqlite3.connect(path, timeout=60.0)) as base:
            if store.exported:
                store.pending = [row for row in store._every() if row]
            store.base = base
            store.sync()
            try:
                yield store
                store.sync()
            except BaseException:
                with suppress(sqlite3.Error, InputError):
                    store.sync()
                raise
            finally:
                store.base = None

    @property
    def done(self) -> BoolArray:
        """Which cases of the plan have a row (u, c)."""
        return self._which([bool(status) for status in self.status])

    @property
    def failed(self) -> BoolArray:
        """Which cases have a row without an answer (u, c)."""
        return self._which([status in FAILED for status in self.status])

    @property
    def stale(self) -> BoolArray:
        """Which rows other code than this has computed (u, c)."""
        current = self.plan.versions * self.plan.shape[0]
        others = [v != now for v, now in zip(self.version, current, strict=True)]
        return self._which(others) & self.done

    def _which(self, cases: list[bool]) -> BoolArray:
        return np.array(cases, dtype=bool).reshape(self.plan.shape)

    def put(self, outcome: Outcome, version: str) -> None:
        """Write a row of the plan, made by this version, in the place of an earlier one."""
        place = outcome.unit * self.plan.shape[1] + outcome.cell
        content = (outcome.status, outcome.reason, version, body_of(outcome.values))
        self.put_row(Row(self.plan.keys[place], *content))
        self.status[place], self.version[place] = outcome.status, version

    def put_row(self, row: Row) -> None:
        """Write a row at the next `sync`."""
        self.pending.append(row)
        if len(self.pending) >= 512:
            self.sync()

    def sync(self, patience: float = 0.0) -> None:
        """Commit what is pending to the disk, if the last time was longer ago than this [s]."""
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
            self.base.executemany("INSERT OR REPLACE INTO cases VALUES (?, ?, ?, ?, ?, ?)", rows)
        self.pending, self.synced = [], time.monotonic()

    def rows(self) -> list[Row]:
        """The whole rows of the plan, in its order."""
        rows = {row.key: row for row in self._every() if row}
        return [rows[key] for key in self.plan.keys if key in rows]

    def _every(self, *, brief: bool = False) -> Iterator[Row | None]:
        """Every row of `cases.sqlite`, or where there is none of `cases.parquet`; None for one
        whose checksum or status is wrong. brief: exported ones without their bodies.
        """
        path = self.folder / STORE
        self.exported = not is_regular(path)
        if not self.exported:
            uri = f"{path.absolute().as_uri()}?mode=rw"
            with _telling(path), closing(sqlite3.connect(uri, uri=True, timeout=10.0)) as base:
                base.text_factory = lambda text: text.decode(errors="replace")  # of a damaged row
                if base.execute("SELECT 1 FROM sqlite_master WHERE name = 'cases'").fetchone():
                    every = base.execute(
                        "SELECT key, status, reason, version, body, crc FROM cases"
                    )
                    for *content, crc in every:
                        row = Row(*content) if all(isinstance(p, str) for p in content) else None
                        yield row if row and row.crc == crc and row.status in STATUSES else None
                    return
            self.exported = True
        for exported in exported_rows(self.folder, self.plan, brief=brief):
            yield exported if exported.status in STATUSES else None

    def export(self) -> None:
        """Write `cases.parquet`, the rows of the plan in its order, whole or not at all."""
        self.sync()
        write_rows(self.folder, self.plan, self.rows())


def discard(folder: Path, *exported: str) -> None:
    """Remove `cases.sqlite`, once everything in it is exported, and other files of the folder."""
    for name in (STORE, f"{STORE}-journal", *exported):
        with refusing(folder / name):
            (folder / name).unlink(missing_ok=True)


@contextmanager
def _telling(path: Path) -> Iterator[None]:
    """Tell an error of SQLite as InputError: cause and remedy in a line."""
    try:
        yield
    except (sqlite3.Error, UnicodeDecodeError) as error:  # the second of SQLite's own words
        remedy = next((words for word, words in REMEDIES.items() if word in str(error)), "")
        cause = str(error) if remedy else f"damaged ({error})"
        remedy = remedy or "study run --fresh starts over"
        raise InputError(f"{path}: {cause}: {remedy}") from None
