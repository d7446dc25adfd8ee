"""`cases.parquet`: the rows of a finished study, in plan order, as they ship.

    read_cases("results/smoke")     # a frame, if the file is whole and as it was written

Beside it may stand `weights.parquet`; `manifest.json` holds the checksums of both.
"""

from __future__ import annotations

import stat
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple
from zlib import crc32

from sparsefit.errors import InputError, is_real
from sparsefit.study.columns import body_of, kinds_of, read_body
from sparsefit.study.manifest import MANIFEST, check_whole, read_record
from sparsefit.study.plan import Plan
from sparsefit.whole_file import whole_file

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa

CASES, WEIGHTS = "cases.parquet", "weights.parquet"
BATCH = 2048  # rows that are read or written as records at once
GROUP = 65_536  # rows of a group of the Parquet file


class Row(NamedTuple):
    """A row as it is kept: its key in the plan, how it ended, and its body as JSON."""

    key: str
    status: str
    reason: str
    version: str
    body: str

    @property
    def crc(self) -> int:
        """The checksum over all of it."""
        return crc32("\0".join(self).encode(errors="backslashreplace"))


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


def exported_rows(folder: Path, plan: Plan, *, brief: bool = False) -> Iterator[Row]:
    """The rows of `cases.parquet`; brief: how each ended, without its body.

    Their cases are known by case_id as long as the study is the same, however identities are told
    by now; those of another study by their identity.
    """
    path = folder / CASES
    if not is_regular(path):
        return
    made = read_record(folder / MANIFEST) or {}
    same = made.get("study_hash") == plan.experiment.definition.hash
    weights: dict[str, list[tuple[float, float]]] = {}
    if not brief and is_regular(folder / WEIGHTS):
        for case_id, *pair in read_weights(folder).itertuples(index=False):
            weights.setdefault(case_id, []).append((float(pair[0]), float(pair[1])))
    kinds = kinds_of(plan.experiment.columns)
    with parquet(path) as file:
        names = check_cases(path, file.schema_arrow)
        other = set(names) if brief else {"status", "reason", "version", *plan.columns()}
        own = [name for name in names if name in kinds and name not in other]
        wanted = {"case_id", "flight", "status", "reason", "version", "identity", *own}
        columns = [name for name in names if name in wanted]
        for batch in file.iter_batches(batch_size=BATCH, columns=columns):
            content = {name: batch.column(name).to_pylist() for name in columns}
            for name in {"version", "identity"} - set(columns):
                content[name] = [""] * batch.num_rows
            keys = plan.keys_of(content, by_case=same)
            heads = zip(*(content[name] for name in ("status", "reason", "version")), strict=True)
            for number, (key, head) in enumerate(zip(keys, heads, strict=True)):
                body = ""
                if not brief:
                    values = {n: content[n][number] for n in own if content[n][number] is not None}
                    pairs = weights.get(content["case_id"][number], ())
                    body = body_of(values, pairs)
                status, reason, version = (text or "" for text in head)
                yield Row(key, status, reason, version, body)


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
            facts = file.metadata
            groups = map(facts.row_group, range(facts.num_row_groups))
            size = sum(group.total_byte_size for group in groups)
            if facts.num_rows > 2_000_000 or size > 1000 * (path.stat().st_size + 1_000_000):
                words = f"{facts.num_rows} rows of {size} bytes"
                raise InputError(f"{path}: {words}: it is another file")
            yield file
    except (OSError, pa.ArrowException, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path}: not readable ({error}): run the study with --fresh") from None


def check_cases(path: Path, schema: Any) -> list[str]:
    """The names of the columns; `InputError` unless they are those of cases."""
    of_text = {name for name in schema.names if "string" in str(schema.field(name).type)}
    if missing := sorted({"case_id", "status", "reason", "backend", "settings"} - of_text):
        raise InputError(
            f'{path}: no cases of a study, without a column "{missing[0]}" of text: take the file '
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
    planned = plan.columns()
    # At least one part, so that no study is without columns.
    parts = [rows[i : i + BATCH] for i in range(0, max(len(rows), 1), BATCH)]
    if plan.experiment.definition.keeps_weights:
        _write((_weights_table(plan, part) for part in parts), folder / WEIGHTS, set())
    dense = {column.name for column in plan.experiment.columns if column.kind.dense}
    _write((cases_table(plan, planned, part) for part in parts), folder / CASES, dense)


def cases_table(plan: Plan, planned: Mapping[str, Sequence[Any]], rows: Sequence[Row]) -> pa.Table:
    """Rows of `cases.parquet`: of the plan, of the row or of its body; then swept factors."""
    import pyarrow as pa

    bodies = [read_body(row.body)[0] for row in rows]
    places = [plan.place_of[row.key] for row in rows]
    arrays: dict[str, Any] = {}
    for column in plan.experiment.columns:
        name, kind, empty = column.name, column.kind, column.kind.empty
        if name in ("status", "reason", "version"):
            values = [getattr(row, name) for row in rows]
        elif name in planned:
            values = [planned[name][place] for place in places]
        else:
            values = [body.get(name, empty) for body in bodies]
        arrays[name] = pa.array(values, type=pa.type_for_alias(kind.arrow))
    swept: Mapping[str, Any] = getattr(plan.experiment.definition.design, "sweep", {})
    for key, levels in swept.items():
        kind_ = pa.float64() if all(map(is_real, levels)) else pa.string()
        arrays[key] = pa.array([planned[key][place] for place in places], type=kind_)
    return pa.table(arrays)


def _weights_table(plan: Plan, rows: Sequence[Row]) -> pa.Table:
    import pyarrow as pa

    ids = [plan.case_ids[plan.place_of[row.key]] for row in rows]
    pairs = [
        {"case_id": name, "length_scale": scale, "weight": weight}
        for name, row in zip(ids, rows, strict=True)
        for scale, weight in read_body(row.body)[1]
    ]
    kinds = {"case_id": pa.string(), "length_scale": pa.float64(), "weight": pa.float64()}
    return pa.Table.from_pylist(pairs, schema=pa.schema(kinds))


def _write(tables: Iterator[pa.Table], path: Path, dense: set[str]) -> None:
    """Tables into one file, joined until a row group is full; it appears whole or not at all."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    first = next(tables)
    names = first.column_names
    with (
        whole_file(path) as file,
        pq.ParquetWriter(
            file,
            first.schema,
            compression="zstd",
            compression_level=9,
            use_dictionary=[name for name in names if name not in dense],
            column_encoding={name: "BYTE_STREAM_SPLIT" for name in names if name in dense},
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
