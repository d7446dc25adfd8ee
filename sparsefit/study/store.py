"""The rows of a study on disk: `cases.sqlite` while it runs, `cases.parquet` when it is finished.

    with Store.opened(folder, plan) as store:      # one writer, by the folder's lock
        store.put(outcome)                         # on the disk within half a second
    store.export(plan)                             # Parquet, in plan order, with its checksums

A row is kept by what it is (its identity) and has a checksum of its own; of two rows for a case the
later one counts. A process that is killed leaves all that was committed. A damaged row is none; a
damaged file is refused in a line. Rows that the study no longer plans stay until it does again.
"""

from __future__ import annotations

import sqlite3
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from sparsefit.arrays import BoolArray
from sparsefit.errors import InputError
from sparsefit.study.columns import STATUSES, Outcome, body_of
from sparsefit.study.export import CASES, WEIGHTS, Row, exported_rows, is_regular, write_rows
from sparsefit.study.manifest import MANIFEST, read_manifest
from sparsefit.study.plan import Plan
from sparsefit.whole_file import refusing

STORE = "cases.sqlite"
SCHEMA = """CREATE TABLE IF NOT EXISTS cases (key TEXT PRIMARY KEY, status TEXT NOT NULL,
reason TEXT NOT NULL, version TEXT NOT NULL, body TEXT NOT NULL, crc INTEGER NOT NULL)"""
PUT = "INSERT OR REPLACE INTO cases VALUES (?, ?, ?, ?, ?, ?)"
SYNC_SECONDS = 0.5
SYNC_ROWS = 512


@dataclass
class Store:
    """The rows of one results folder against a plan.

    status and version: of each case of the plan, empty where there is no row; damaged: rows whose
    checksum is wrong; unplanned: rows of cases that are not planned.
    """

    folder: Path
    plan: Plan
    status: list[str]
    version: list[str]
    exported: bool = False
    damaged: int = 0
    unplanned: int = 0
    base: sqlite3.Connection | None = None
    pending: int = 0
    synced: float = field(default_factory=time.monotonic)

    @classmethod
    def read(cls, folder: Path, plan: Plan) -> Store:
        """The rows that the folder has, to be looked at and not written.

        Raises:
            InputError: where a file is damaged or no regular one, or there are rows, and all of
                them are of another study.
        """
        store = cls(folder, plan, [""] * plan.size, [""] * plan.size)
        store._note_exported()
        if is_regular(folder / STORE):
            with _reading(folder / STORE) as base:
                store._note(base)
        if store.unplanned and not any(store.status):
            made = read_manifest(folder) or {}
            other = made.get("study_hash") != plan.experiment.definition.hash
            which = f" (hash {str(made['study_hash'])[:12]})" if made and other else ""
            raise InputError(
                f"{folder} was made by a different study{which}, and no case of it is of this one: "
                "study run --fresh starts over, or rename this study"
            )
        return store

    @classmethod
    @contextmanager
    def opened(cls, folder: Path, plan: Plan) -> Iterator[Store]:
        """The store to write to, with the rows of an earlier export in it; synced at the end."""
        store = cls.read(folder, plan)
        with _telling(folder / STORE):
            base = sqlite3.connect(folder / STORE, timeout=60.0, isolation_level=None)
            try:
                base.execute("PRAGMA synchronous=FULL")
                base.execute(SCHEMA)
                base.execute("BEGIN")
                store.base = base
                store._take_exported()
                store.sync()
                yield store
                store.sync()
            finally:
                with suppress(sqlite3.Error):
                    if base.in_transaction:
                        base.execute("COMMIT")
                base.close()
                store.base = None

    @property
    def done(self) -> BoolArray:
        """Which cases of the plan have a row (u, c)."""
        return np.array([bool(s) for s in self.status], dtype=bool).reshape(self.plan.shape)

    def ended(self, *statuses: str) -> BoolArray:
        """Which cases have a row of one of these statuses (u, c)."""
        return np.array([s in statuses for s in self.status], dtype=bool).reshape(self.plan.shape)

    @property
    def stale(self) -> BoolArray:
        """Which rows other code than this has computed (u, c)."""
        current = self.plan.versions * self.plan.shape[0]
        others = [v != now for v, now in zip(self.version, current, strict=True)]
        return np.array(others, dtype=bool).reshape(self.plan.shape) & self.done

    @property
    def statuses(self) -> Counter[str]:
        """How many cases ended in each status."""
        return Counter(status for status in self.status if status)

    @property
    def versions(self) -> Counter[str]:
        """How many rows each version made."""
        return Counter(v for v, s in zip(self.version, self.status, strict=True) if s)

    @property
    def finished(self) -> bool:
        """Whether every planned case stands in `cases.parquet`, and nothing beside it."""
        made = read_manifest(self.folder) or {}
        same = made.get("study_hash") == self.plan.experiment.definition.hash
        return same and self.exported and all(self.status)

    def put(self, outcome: Outcome, version: str) -> None:
        """Write a row of the plan, made by this version, in the place of an earlier one."""
        place = outcome.unit * self.plan.shape[1] + outcome.cell
        content = (outcome.status, outcome.reason, version, body_of(outcome))
        self.put_row(Row(self.plan.keys[place], *content))
        self.status[place], self.version[place] = outcome.status, version

    def put_row(self, row: Row) -> None:
        """Write a row, planned or not."""
        assert self.base is not None
        with _telling(self.folder / STORE):
            content = (row.key, row.status, row.reason, row.version, row.body, row.crc)
            self.base.execute(PUT, content)
        self.exported = False
        self.pending += 1
        if self.pending >= SYNC_ROWS or time.monotonic() - self.synced > SYNC_SECONDS:
            self.sync()

    def sync(self) -> None:
        """Commit what is pending to the disk."""
        assert self.base is not None
        if not (self.folder / STORE).exists():
            raise InputError(f"{self.folder / STORE}: was removed during the run: run it again")
        with _telling(self.folder / STORE):
            if self.base.in_transaction:
                self.base.execute("COMMIT")
            self.base.execute("BEGIN")
        self.pending, self.synced = 0, time.monotonic()

    def rows(self) -> Iterator[Row]:
        """The whole rows of the plan, in its order."""
        stored = self._every()
        yield from (stored[key] for key in self.plan.keys if key in stored)

    def _every(self) -> dict[str, Row]:
        """Every whole row by its key: those of `cases.parquet`, under those of `cases.sqlite`."""
        stored: dict[str, Row] = {}
        there: set[str] = set()
        if self.base is not None:
            stored.update((row.key, row) for row in _rows(self.base) if row)
        elif is_regular(self.folder / STORE):
            with _reading(self.folder / STORE) as base:
                stored.update((row.key, row) for row in _rows(base) if row)
        there.update(stored)
        if self.base is None:  # once the store is open, all rows of the export are in it
            for row in exported_rows(self.folder, self.plan):
                if row.key not in there:
                    stored[row.key] = row
        return stored

    def _note_exported(self) -> None:
        """Note the rows of `cases.parquet`."""
        for row in exported_rows(self.folder, self.plan, brief=True):
            self._place(row.key, row.status, row.version)
        self.exported = all(self.status) and not self.unplanned

    def _note(self, base: sqlite3.Connection) -> None:
        """Note the rows of `cases.sqlite`, each against its checksum."""
        for row in _rows(base):
            if row is None:
                self.damaged += 1
            else:
                self.exported = False
                self._place(row.key, row.status, row.version)

    def _place(self, key: str, status: str, version: str) -> None:
        place = self.plan.place_of.get(key)
        if place is None:
            self.unplanned += 1
        elif status in STATUSES:
            self.status[place], self.version[place] = status, version or "unknown"

    def _take_exported(self) -> None:
        """Copy into `cases.sqlite` the rows that stand in `cases.parquet` alone."""
        assert self.base is not None
        there = {key for (key,) in self.base.execute("SELECT key FROM cases")}
        for row in exported_rows(self.folder, self.plan):
            if row.key not in there:
                self.put_row(row)

    def export(self) -> bool:
        """Write `cases.parquet` (and `weights.parquet`), all rows in plan order, each file whole.

        Of the store only the rows stay that the study does not plan. Returns whether there are any.
        """
        stored = self._every()
        planned = [stored.pop(key) for key in self.plan.keys if key in stored]
        write_rows(self.folder, self.plan, planned)
        if stored and self.base is not None:
            self.base.execute("DELETE FROM cases")
            for row in stored.values():
                self.put_row(row)
            self.sync()
        self.exported = True
        return bool(stored)


def discard(folder: Path) -> None:
    """Remove `cases.sqlite`, once everything in it is exported."""
    for name in (STORE, f"{STORE}-journal"):
        with refusing(folder / name):
            (folder / name).unlink(missing_ok=True)


def clear(folder: Path) -> None:
    """Remove the rows and the manifest of whatever study was run here."""
    discard(folder)
    for name in (CASES, WEIGHTS, MANIFEST):
        with refusing(folder / name):
            (folder / name).unlink(missing_ok=True)


@contextmanager
def _telling(path: Path) -> Iterator[None]:
    """Tell an error of SQLite as InputError: cause and remedy in a line."""
    try:
        yield
    except sqlite3.Error as error:
        cause, remedy = str(error), "study run --fresh starts over"
        if "full" in cause or "I/O" in cause:
            remedy = "make room, and run it again"
        elif "readonly" in cause or "unable to open" in cause:
            remedy = "check the folder's permissions"
        elif "locked" in cause:
            remedy = "another run writes to it: wait for it"
        else:
            cause = f"damaged ({cause})"
        raise InputError(f"{path}: {cause}: {remedy}") from None


@contextmanager
def _reading(path: Path) -> Iterator[sqlite3.Connection]:
    with _telling(path):
        base = sqlite3.connect(f"{path.absolute().as_uri()}?mode=rw", uri=True, timeout=10.0)
        try:
            yield base
        finally:
            base.close()


def _rows(base: sqlite3.Connection) -> Iterator[Row | None]:
    """Every row; None for one whose checksum is wrong."""
    try:
        for *content, crc in base.execute(
            "SELECT key, status, reason, version, body, crc FROM cases"
        ):
            row = Row(*content) if all(isinstance(part, str) for part in content) else None
            yield row if row is not None and row.crc == crc else None
    except sqlite3.OperationalError as error:
        if "no such table" not in str(error):
            raise
