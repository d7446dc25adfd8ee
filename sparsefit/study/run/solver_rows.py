"""The rows of a study of solvers: one per case, appended as they come, and `cases.parquet`.

A column is declared here and nowhere else. Times are seconds of CPU unless they say otherwise.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeAlias

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from sparsefit.codec import finite_or_none
from sparsefit.errors import InputError
from sparsefit.study.run.manifest import check_whole
from sparsefit.study.run.partial import FOLDER, ROWS
from sparsefit.study.spec.solver_study import SolverStudy
from sparsefit.whole_file import refusing, whole_file, write_whole

Row: TypeAlias = dict[str, Any]
CASES = "cases.parquet"
COLUMNS: Mapping[str, str] = {
    "case_id": "string",
    "study": "string",
    "problem": "string",  # its name
    "series": "string",  # the [[problems]] entry it is of
    "level": "string",  # what was swept there
    "samples": "int64",
    "columns": "int64",
    "targets": "int64",
    "objective": "string",
    "backend": "string",
    "settings": "string",  # as given, canonical JSON
    "solver": "string",
    "tolerance": "float64",  # asked of the solver; NaN where it has none
    "points": "int64",  # penalties of the path, 1 for a single fit
    "status": "string",
    "reason": "string",
    "word": "string",  # the back-end's own status
    "certificate_kind": "string",
    "certificate": "float64",  # its own duality gap, worst over the path
    "excess": "float64",  # above the best certified lower bound, worst over the path
    "cpu": "float64",  # median
    "cpu_low": "float64",  # 95 % interval of the median, by order statistics
    "cpu_high": "float64",
    "wall": "float64",  # median
    "repeats": "int64",
    "known": "bool",  # whether the median is known to the precision asked for
    "first": "float64",  # imports and compilation, on a small problem
    "memory": "float64",  # MB above what the process had, at its highest
    "load": "float64",  # of the machine, when the case began
    "disturbed": "bool",  # whether the wall clock ran well ahead of the CPU's
}
"""Name of a column -> its Arrow type."""
SCHEMA = pa.schema([(name, pa.type_for_alias(kind)) for name, kind in COLUMNS.items()])


def read_rows(folder: Path) -> list[Row]:
    """The rows of a run that is not finished; reading stops at a torn line."""
    path, found = folder / FOLDER / ROWS, []
    if path.is_file():
        for line in path.read_bytes().splitlines(keepends=True):
            row = _row(line)
            if row is None:
                break
            found.append(row)
    return found


def _row(line: bytes) -> Row | None:
    try:
        row = json.loads(line) if line.endswith(b"\n") else None
    except ValueError:
        return None
    return row if isinstance(row, dict) and row.keys() == COLUMNS.keys() else None


@contextmanager
def appending(folder: Path) -> Iterator[Any]:
    """A function that puts rows on the disk, behind the last that is whole."""
    path = folder / FOLDER / ROWS
    whole = "".join(_line(row) for row in read_rows(folder)).encode()
    with refusing(path), path.open("ab") as file:
        file.truncate(len(whole))

        def append(rows: Sequence[Row]) -> None:
            with refusing(path):
                file.write("".join(map(_line, rows)).encode())
                file.flush()
                os.fsync(file.fileno())

        yield append


def rewrite(folder: Path, rows: Sequence[Row]) -> None:
    """Let these be the rows of the run that is not finished, whatever they were."""
    write_whole(folder / FOLDER / ROWS, "".join(map(_line, rows)))


def _line(row: Row) -> str:
    return json.dumps(finite_or_none(row), separators=(",", ":")) + "\n"


def frame(study: SolverStudy, rows: Sequence[Row]) -> pd.DataFrame:
    """The rows in plan order as a data frame; null numbers are NaN."""
    order = {study.case_id(case): place for place, case in enumerate(study.cases())}
    kept = sorted(
        (row for row in rows if row["case_id"] in order), key=lambda r: order[r["case_id"]]
    )
    table: pd.DataFrame = _table(kept).to_pandas()
    return table


def _table(rows: Sequence[Row]) -> pa.Table:
    return pa.Table.from_pylist([finite_or_none(row) for row in rows], schema=SCHEMA)


def write_cases(study: SolverStudy, rows: Sequence[Row], folder: Path) -> None:
    """`cases.parquet`, every planned case a row, in one atomic step."""
    table = pa.Table.from_pandas(frame(study, rows), schema=SCHEMA, preserve_index=False)
    with whole_file(folder / CASES) as file:
        pq.write_table(table, file, compression="zstd", compression_level=9)


def read_cases(folder: Path) -> pd.DataFrame:
    """The rows of a finished study of solvers. Raises InputError where there are none to read."""
    path = folder / CASES
    if not path.is_file():
        raise InputError(f"{path}: no such file: run the study first (sparsefit study run)")
    check_whole(path)
    try:
        table = pq.read_table(path)
    except (OSError, pa.ArrowInvalid) as error:
        words = " ".join(str(error).split())
        raise InputError(f"{path}: not readable ({words}): run the study with --fresh") from None
    if table.schema.names != SCHEMA.names:
        raise InputError(f"{path}: no rows of a study of solvers: run the study with --fresh")
    found: pd.DataFrame = table.to_pandas()
    return found
