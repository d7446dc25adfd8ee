"""The answers of a study on disk: `cases.parquet`, `weights.parquet`, and where they stand.

Both are written a group of rows at a time, and read only if they are what the manifest beside
them says that was written (`manifest.py`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from sparsefit.errors import InputError, is_real
from sparsefit.study.run.columns import LEVEL, TEXT, Column
from sparsefit.study.run.folder import CASES, WEIGHTS
from sparsefit.study.run.kinds import kind_of
from sparsefit.study.run.manifest import check_whole
from sparsefit.study.run.outcome import Outcome
from sparsefit.study.run.solver_columns import EVERY_KIND
from sparsefit.study.spec.design import Factor
from sparsefit.study.spec.document import canonical_json
from sparsefit.study.spec.identity import AnyStudy, names_of
from sparsefit.study.spec.names import Names
from sparsefit.study.spec.study import MAX_CASES
from sparsefit.whole_file import whole_file

WEIGHT_COLUMNS = {"case_id": TEXT, "length_scale": LEVEL, "weight": LEVEL}
TEXTS = ("string", "large_string")  # the second by pandas, of whoever writes a part of them
OF_ANY = ("case_id", "status", "reason", "backend", "settings")
OF_FLIGHTS = ("split", "protocol", "label")
OF_SOLVERS = ("problem", "objective", "solver")
BATCH = 2048  # rows that are held as records at once
GROUP = 65_536  # rows of a group in the file, and the most that are held as columns


def read_cases(folder: str | Path) -> pd.DataFrame:
    """The rows of a finished study from its results folder, `results/<name>`.

    Raises:
        InputError: if there are none yet, the file is not readable, or not as it was written.
    """
    path = Path(folder) / CASES
    with reading(path) as file:
        rows = file.metadata.num_rows
        if rows > MAX_CASES:
            raise InputError(f"{path}: {rows} rows, more than a study has: it is another file")
        check_cases(path, file.schema_arrow)
        frame: pd.DataFrame = file.read().to_pandas()
    return frame


def check_cases(path: Path, schema: pa.Schema) -> None:
    """Raise `InputError` unless columns are those of cases, of the oldest version too."""
    kind = OF_SOLVERS if "solver" in schema.names else OF_FLIGHTS
    for name in (*OF_ANY, *kind):
        if name not in schema.names or str(schema.field(name).type) not in TEXTS:
            raise InputError(
                f'{path}: no cases of a study, without a column "{name}" of text: take the file '
                "from where it came, or run the study with --fresh"
            )


def read_weights(folder: str | Path) -> pd.DataFrame:
    """`case_id, length_scale [m], weight` of a study whose figures include `weights`."""
    with reading(Path(folder) / WEIGHTS) as file:
        frame: pd.DataFrame = file.read().to_pandas()
    return frame


@contextmanager
def reading(path: Path) -> Iterator[pq.ParquetFile]:
    """A Parquet file of a results folder, if it is there, whole, and as it was written.

    Raises:
        InputError: with the cause and the remedy, also where it breaks while it is read.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such file: run the study first (sparsefit study run)")
    check_whole(path)
    try:
        with pq.ParquetFile(path, page_checksum_verification=True) as file:
            yield file
    except (OSError, pa.ArrowException) as error:
        raise InputError(f"{path}: not readable ({error}): run the study with --fresh") from None


def write_cases(study: AnyStudy, outcomes: Iterable[Outcome], folder: Path) -> None:
    """All rows in plan order, in one atomic step; the weights too where the study keeps them."""
    ordered = sorted(outcomes, key=lambda outcome: (outcome.flight, outcome.cell))
    write_rows(study, lambda: iter(ordered), folder)


def write_rows(study: AnyStudy, rows: Callable[[], Iterator[Outcome]], folder: Path) -> None:
    """What ``rows()`` gives, in plan order and a group at a time, each file in one atomic step."""
    if study.store_weights:
        _replace((_weights_table(study, part) for part in _parts(rows())), folder / WEIGHTS)
    names = names_of(study)
    tables = (cases_table(study, part, names) for part in _parts(rows()))
    _replace(tables, folder / CASES)


def _parts(rows: Iterator[Outcome]) -> Iterator[list[Outcome]]:
    """Lists of a few rows, at least one of them, so that no study is without columns."""
    part = list(islice(rows, BATCH))
    yield part
    while part := list(islice(rows, BATCH)):
        yield part


def cases_table(
    study: AnyStudy, ordered: Sequence[Outcome], names: Names | None = None
) -> pa.Table:
    """The rows of `cases.parquet`, one per outcome: its columns, then one per swept factor.

    names: what the rows are kept by, where it is known already.
    """
    kind = kind_of(study)
    planned = kind.planned(ordered, names or names_of(study))
    arrays = {column.name: _array(column, planned, ordered) for column in kind.columns}
    for factor in study.sweep:
        levels = (row.case.cell.levels[factor.key] for row in planned)
        arrays[factor.key] = _levels_array(factor, levels)
    return pa.table(arrays)


def _array(column: Column[Any], planned: Sequence[Any], ordered: Sequence[Outcome]) -> pa.Array:
    if column.planned:
        values = [column.kind.of(column.planned(row)) for row in planned]
    else:
        values = [outcome[column.name] for outcome in ordered]
    return pa.array(values, type=pa.type_for_alias(column.kind.arrow))


def _levels_array(factor: Factor, levels: Iterable[object]) -> pa.Array:
    """Where all levels of a factor are numbers they stay numbers; else all are text."""
    if all(is_real(level) for level in factor.levels):
        return pa.array(levels, type=pa.float64())
    texts = (level if isinstance(level, str) else canonical_json(level) for level in levels)
    return pa.array(texts, type=pa.string())


def _weights_table(study: AnyStudy, ordered: Iterable[Outcome]) -> pa.Table:
    kind = kind_of(study)
    rows = [
        (kind.case_id(outcome.flight, outcome.cell), *pair)
        for outcome in ordered
        for pair in outcome.weights
    ]
    return pa.table(
        {
            name: pa.array([row[place] for row in rows], type=pa.type_for_alias(kind.arrow))
            for place, (name, kind) in enumerate(WEIGHT_COLUMNS.items())
        }
    )


def _replace(tables: Iterator[pa.Table], path: Path) -> None:
    first = next(tables)
    dense = [name for name in first.column_names if name in EVERY_KIND and EVERY_KIND[name].dense]
    with (
        whole_file(path) as file,
        pq.ParquetWriter(
            file,
            first.schema,
            compression="zstd",
            compression_level=9,
            use_dictionary=[name for name in first.column_names if name not in dense],
            column_encoding=dict.fromkeys(dense, "BYTE_STREAM_SPLIT"),
            write_page_checksum=True,
        ) as writer,
    ):
        for group in _groups(first, tables):
            writer.write_table(group, row_group_size=GROUP)


def _groups(first: pa.Table, others: Iterator[pa.Table]) -> Iterator[pa.Table]:
    """The tables joined until a group is full."""
    group = [first]
    for table in others:
        if sum(part.num_rows for part in group) + table.num_rows > GROUP:
            yield pa.concat_tables(group)
            group = []
        group.append(table)
    yield pa.concat_tables(group)
