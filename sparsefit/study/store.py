"""The rows of a study on disk: `cases.sqlite` while it runs, `cases.parquet` when it is finished.

    with Store.opened(folder, plan) as store:      # one writer, by the folder's lock
        store.put(outcome, version)
        store.sync()                               # on the disk
        store.export()                             # Parquet, in plan order, with its checksums

A row is kept by what it is (its identity) and has a checksum of its own; of two rows for a case the
later one counts. A process that is killed leaves all that was committed. A damaged row is none; a
damaged file is refused in a line. Rows that the study no longer plans stay until it does again.
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
from sparsefit.study.export import CASES, Row, exported_rows, is_regular, write_rows
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

    status and version: of each case of the plan, empty where there is no row; exported: whether all
    rows stand in `cases.parquet`; damaged: rows whose checksum is wrong; unplanned: rows of cases
    that are not planned; pending: rows to be written at the next `sync`.
    """

    folder: Path
    plan: Plan
    status: list[str]
    version: list[str]
    exported: bool = False
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
        for row in exported_rows(folder, plan, brief=True):
            store._place(row)
        store.exported = all(store.status) and not store.unplanned
        for stored in store._stored():
            store.exported = False
            store._place(stored)
        if store.unplanned and not any(store.status):
            made = read_record(folder / MANIFEST) or {}
            other = made.get("study_hash") != plan.experiment.definition.hash
            which = f" (hash {str(made['study_hash'])[:12]})" if made and other else ""
            raise InputError(
                f"{folder} was made by a different study{which}, and no case of it is of this one: "
                "study run --fresh starts over, or rename this study"
            )
        return store

    def _place(self, row: Row | None) -> None:
        place = None if row is None else self.plan.place_of.get(row.key)
        if row is None:
            self.damaged += 1
        elif place is None:
            self.unplanned += 1
        elif row.status in STATUSES:
            self.status[place], self.version[place] = row.status, row.version or "unknown"

    @classmethod
    @contextmanager
    def opened(cls, folder: Path, plan: Plan) -> Iterator[Store]:
        """The store to write to; synced at the end."""
        store, path = cls.read(folder, plan), folder / STORE
        with _telling(path), closing(sqlite3.connect(path, timeout=60.0)) as base:
            base.execute(SCHEMA)
            store.base = base
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

    @property
    def finished(self) -> bool:
        """Whether every planned case stands in `cases.parquet`, and nothing beside it."""
        made = read_record(self.folder / MANIFEST) or {}
        same = made.get("study_hash") == self.plan.experiment.definition.hash
        return same and self.exported and all(self.status)

    def put(self, outcome: Outcome, version: str) -> None:
        """Write a row of the plan, made by this version, in the place of an earlier one."""
        place = outcome.unit * self.plan.shape[1] + outcome.cell
        content = (outcome.status, outcome.reason, version, body_of(outcome.values))
        self.put_row(Row(self.plan.keys[place], *content))
        self.status[place], self.version[place] = outcome.status, version

    def put_row(self, row: Row) -> None:
        """Write a row, planned or not, at the next `sync`."""
        self.exported = False
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
            rows = [(*row, row.crc) for row in self.pending]
            self.base.executemany("INSERT OR REPLACE INTO cases VALUES (?, ?, ?, ?, ?, ?)", rows)
        self.pending, self.synced = [], time.monotonic()

    def rows(self) -> Iterator[Row]:
        """The whole rows of the plan, in its order."""
        rows = self._every()
        yield from (rows[key] for key in self.plan.keys if key in rows)

    def _every(self) -> dict[str, Row]:
        """Every whole row by its key: those of `cases.sqlite` over those of `cases.parquet`."""
        rows = (*exported_rows(self.folder, self.plan), *self._stored())
        return {row.key: row for row in rows if row}

    def _stored(self) -> Iterator[Row | None]:
        """Every row of `cases.sqlite`; None for one whose checksum is wrong."""
        path, base = self.folder / STORE, self.base
        if base is None and not is_regular(path):
            return
        with _telling(path):
            uri = f"{path.absolute().as_uri()}?mode=rw"
            base = base or sqlite3.connect(uri, uri=True, timeout=10.0)
            base.text_factory = lambda text: text.decode(errors="replace")  # of a damaged row
            try:
                every = base.execute("SELECT key, status, reason, version, body, crc FROM cases")
                for *content, crc in every:
                    row = Row(*content) if all(isinstance(p, str) for p in content) else None
                    yield row if row is not None and row.crc == crc else None
            except sqlite3.OperationalError as error:
                if "no such table" not in str(error):
                    raise
            finally:
                if base is not self.base:
                    base.close()

    def export(self) -> bool:
        """Write `cases.parquet`, the rows of the plan in its order, whole or not at all.

        Of the store only the rows stay that the study does not plan. Returns whether there are any.
        """
        self.sync()
        others = self._every()
        planned = [others.pop(key) for key in self.plan.keys if key in others]
        self.pending = list(others.values())  # those of an earlier export, too
        self.sync()
        write_rows(self.folder, self.plan, planned)
        assert self.base is not None
        with _telling(self.folder / STORE), self.base:
            keys = [(row.key,) for row in planned if others]
            self.base.executemany("DELETE FROM cases WHERE key = ?", keys)
        self.exported = True
        return bool(others)


def discard(folder: Path, *others: str) -> None:
    """Remove `cases.sqlite`, once everything in it is exported, and other files of the folder."""
    for name in (STORE, f"{STORE}-journal", *others):
        with refusing(folder / name):
            (folder / name).unlink(missing_ok=True)


def clear(folder: Path) -> None:
    """Remove the rows and the manifest of whatever study was run here."""
    discard(folder, CASES, MANIFEST)


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
