"""`cases.parquet`: the rows of a finished study, in plan order, as they ship.

    read_cases("results/smoke")     # a frame, if the file is whole and as it was written

Beside it may stand `weights.parquet`; `manifest.json` holds the checksums of both.
"""

from __future__ import annotations

import stat
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any
from zlib import crc32

from sparsefit.errors import InputError, is_real
from sparsefit.study.columns import (
    LEVEL,
    TEXT,
    Column,
    Outcome,
    body_of,
    kinds_of,
    read_body,
)
from sparsefit.study.manifest import check_whole, read_manifest
from sparsefit.study.plan import Plan, key_of
from sparsefit.whole_file import whole_file

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa

CASES, WEIGHTS = "cases.parquet", "weights.parquet"
MOST_ROWS = 2_000_000
BATCH = 2048  # rows that are read as records at once
GROUP = 65_536  # rows of a group of the Parquet file
TEXTS = ("string", "large_string")  # the second by pandas, of whoever writes a part of them
OF_ANY = ("case_id", "status", "reason", "backend", "settings")
OF_FLIGHTS = ("split", "protocol", "label")
OF_PROBLEMS = ("problem", "objective", "solver")
WEIGHT_COLUMNS = {"case_id": TEXT, "length_scale": LEVEL, "weight": LEVEL}
OUTSIDE = ("case_id", "status", "reason", "version", "identity", "study")


@dataclass(frozen=True)
class Row:
    """A row as it is kept: its key in the plan, how it ended, and its body as JSON."""

    key: str
    status: str
    reason: str
    version: str
    body: str

    @property
    def crc(self) -> int:
        """The checksum over all of it."""
        content = (self.key, self.status, self.reason, self.version, self.body)
        return crc32("\0".join(content).encode(errors="backslashreplace"))


def is_regular(path: Path) -> bool:
    """Whether there is a regular file, no link and no pipe, which may lead anywhere or not end."""
    try:
        mode = path.lstat().st_mode
    except FileNotFoundError:
        return False
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}: check the folder") from None
    if not stat.S_ISREG(mode):
        raise InputError(f"{path}: no regular file: remove it, or study run --fresh starts over")
    return True


@dataclass(frozen=True)
class Known:
    """How rows of `cases.parquet` name their cases.

    As long as the study is the same, by their case_id, however identities are told by now; rows of
    another one by their identity. version: of rows that do not carry it.
    """

    plan: Plan
    column: str
    version: str

    @classmethod
    def of(cls, folder: Path, plan: Plan) -> Known:
        """The way of the file that lies in a folder, by the manifest beside it."""
        made = read_manifest(folder) or {}
        versions = made.get("versions")
        version = str(versions.get("sparsefit")) if isinstance(versions, dict) else "unknown"
        same = made.get("study_hash") == plan.experiment.definition.hash
        return cls(plan, "case_id" if same else "identity", version)

    def keys(self, columns: Mapping[str, Sequence[Any]]) -> list[str]:
        """The key of each row, of its columns; empty where it tells none."""
        if self.column not in columns:
            return [""] * len(columns["status"])
        names = columns[self.column]
        if self.column == "case_id":
            places, keys = self.plan.place_of_case, self.plan.keys
            return [keys[places[name]] if name in places else f"?{name}" for name in names]
        if any(self.plan.experiment.units()["identity"]):
            return list(map(str, names))
        return [key_of(n, name) for n, name in zip(columns["flight"], names, strict=True)]


def exported_rows(folder: Path, plan: Plan, *, brief: bool = False) -> Iterator[Row]:
    """The rows of `cases.parquet`; brief: how each ended, without its body."""
    path = folder / CASES
    if not is_regular(path):
        return
    registered, weights = Known.of(folder, plan), {} if brief else _weights_of(folder)
    kinds = kinds_of(plan.experiment.columns)
    skipped = {*plan.columns(), *OUTSIDE} if not brief else set(kinds)
    with parquet(path) as file:
        names = check_cases(path, file.schema_arrow)
        read = [name for name in names if name in kinds and name not in skipped]
        wanted = [registered.column, "case_id", "flight", "status", "reason", "version", *read]
        for batch in file.iter_batches(
            batch_size=BATCH, columns=[name for name in names if name in wanted]
        ):
            columns = {name: batch.column(name).to_pylist() for name in batch.schema.names}
            versions = columns.get("version") or [registered.version] * batch.num_rows
            for number, key in enumerate(registered.keys(columns)):
                values = {name: kinds[name].of(columns[name][number]) for name in read}
                pairs = weights.get(columns["case_id"][number], ())
                body = "" if brief else body_of(Outcome(0, 0, "", values=values, weights=pairs))
                status, reason = str(columns["status"][number]), str(columns["reason"][number])
                yield Row(key, status, reason, str(versions[number] or "unknown"), body)


def _weights_of(folder: Path) -> dict[str, tuple[tuple[float, float], ...]]:
    if not is_regular(folder / WEIGHTS):
        return {}
    frame = read_weights(folder)
    stored: dict[str, list[tuple[float, float]]] = {}
    for case_id, *pair in frame.itertuples(index=False):
        stored.setdefault(case_id, []).append((float(pair[0]), float(pair[1])))
    return {case_id: tuple(pairs) for case_id, pairs in stored.items()}


@contextmanager
def parquet(path: Path) -> Iterator[Any]:
    """A Parquet file of a results folder, if it is there, whole, and as it was written.

    Raises:
        InputError: with the cause and the remedy, also where it breaks while it is read.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    if not is_regular(path):
        raise InputError(f"{path}: no such file: run the study first (sparsefit study run)")
    check_whole(path)
    try:
        with pq.ParquetFile(path, page_checksum_verification=True) as file:
            rows = file.metadata.num_rows
            size = sum(
                file.metadata.row_group(group).total_byte_size
                for group in range(file.metadata.num_row_groups)
            )
            if rows > MOST_ROWS or size > 1000 * (path.stat().st_size + 1_000_000):
                raise InputError(f"{path}: {rows} rows of {size} bytes: it is another file")
            yield file
    except (OSError, pa.ArrowException, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path}: not readable ({error}): run the study with --fresh") from None


def check_cases(path: Path, schema: Any) -> list[str]:
    """The names of the columns; `InputError` unless they are those of cases."""
    kind = OF_PROBLEMS if "solver" in schema.names else OF_FLIGHTS
    for name in (*OF_ANY, *kind):
        if name not in schema.names or str(schema.field(name).type) not in TEXTS:
            raise InputError(
                f'{path}: no cases of a study, without a column "{name}" of text: take the file '
                "from where it came, or run the study with --fresh"
            )
    return list(schema.names)


def read_cases(folder: str | Path) -> pd.DataFrame:
    """The rows of `cases.parquet` in a results folder, with whatever columns it has.

    Raises:
        InputError: if there are none yet, the file is not readable, or not as it was written.
    """
    path = Path(folder) / CASES
    with parquet(path) as file:
        check_cases(path, file.schema_arrow)
        frame: pd.DataFrame = file.read().to_pandas()
    return frame


def read_weights(folder: str | Path) -> pd.DataFrame:
    """`case_id, length_scale [m], weight` of a study whose figures include `weights`."""
    with parquet(Path(folder) / WEIGHTS) as file:
        frame: pd.DataFrame = file.read().to_pandas()
    return frame


def write_rows(folder: Path, plan: Plan, rows: Sequence[Row]) -> None:
    """Write rows in plan order, and the weights where the study keeps them, each file whole."""
    places = plan.place_of
    # At least one part, so that no study is without columns.
    parts = [rows[i : i + BATCH] for i in range(0, max(len(rows), 1), BATCH)]
    located = [[(places[row.key], row) for row in part] for part in parts]
    if plan.experiment.definition.keeps_weights:
        write_parquet((_weights_table(plan, part) for part in located), folder / WEIGHTS, ())
    dense = [column.name for column in plan.experiment.columns if column.kind.dense]
    planned = plan.columns()
    tables = (cases_table(plan, planned, part) for part in located)
    write_parquet(tables, folder / CASES, dense)


def cases_table(
    plan: Plan, planned: Mapping[str, Sequence[Any]], rows: Sequence[tuple[int, Row]]
) -> pa.Table:
    """Rows of `cases.parquet`: their place in the plan and what is kept; then swept factors."""
    import pyarrow as pa

    bodies = [read_body(row.body)[0] for _, row in rows]
    places = [place for place, _ in rows]
    arrays: dict[str, Any] = {}
    for column in plan.experiment.columns:
        values = _column(column, planned, places, rows, bodies)
        arrays[column.name] = pa.array(values, type=pa.type_for_alias(column.kind.arrow))
    design = plan.experiment.definition.design
    for factor in getattr(design, "sweep", ()):
        levels = [planned[factor.key][place] for place in places]
        number = all(map(is_real, factor.levels))
        arrays[factor.key] = pa.array(levels, type=pa.float64() if number else pa.string())
    return pa.table(arrays)


def _column(
    column: Column,
    planned: Mapping[str, Sequence[Any]],
    places: Sequence[int],
    rows: Sequence[tuple[int, Row]],
    bodies: Sequence[Mapping[str, Any]],
) -> list[Any]:
    """The values of a column: of the row, of the plan, or of its body, where only those are."""
    name, kind = column.name, column.kind
    if name in ("status", "reason", "version"):
        return [getattr(row, name) for _, row in rows]
    if name in planned:
        values = planned[name]
        return [values[place] for place in places]
    empty, numbers = kind.empty, kind.arrow != "string"
    cells = [body.get(name, empty) for body in bodies]
    # Infinity is a text in JSON, and what an earlier file had not is None.
    odd = any(cell is None or (numbers and isinstance(cell, str)) for cell in cells)
    return [kind.of(cell) for cell in cells] if odd else cells


def _weights_table(plan: Plan, rows: Sequence[tuple[int, Row]]) -> pa.Table:
    import pyarrow as pa

    ids = plan.case_ids
    content = [(ids[place], *pair) for place, row in rows for pair in read_body(row.body)[2]]
    return pa.table(
        {
            name: pa.array([item[i] for item in content], type=pa.type_for_alias(kind.arrow))
            for i, (name, kind) in enumerate(WEIGHT_COLUMNS.items())
        }
    )


def write_parquet(tables: Iterator[pa.Table], path: Path, dense: Sequence[str]) -> None:
    """Tables into one file, joined until a row group is full; it appears whole or not at all."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    first = next(tables)
    dense = [name for name in dense if name in first.column_names]
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
        group = [first]
        for table in tables:
            if sum(part.num_rows for part in group) + table.num_rows > GROUP:
                writer.write_table(pa.concat_tables(group), row_group_size=GROUP)
                group = []
            group.append(table)
        writer.write_table(pa.concat_tables(group), row_group_size=GROUP)
