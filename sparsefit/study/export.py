"""`cases.parquet`: the rows of a finished study, in plan order, as they ship.

    read_cases("results/smoke")     # a frame, if the file is whole and as it was written

`manifest.json` beside it holds its checksum.
"""

from __future__ import annotations

import json
import stat
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple
from zlib import crc32

from sparsefit.errors import InputError, is_real
from sparsefit.study.columns import body_of, kinds_of
from sparsefit.study.manifest import MANIFEST, check_whole, read_record
from sparsefit.study.plan import Plan
from sparsefit.whole_file import whole_file

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa

CASES = "cases.parquet"
BATCH, GROUP = 2048, 16_384  # rows that are read, and written, as records at once
ENDED = ("status", "reason", "version")


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
    if not is_regular(folder / CASES):
        return
    made = read_record(folder / MANIFEST) or {}
    same = made.get("study_hash") == plan.experiment.definition.hash
    with parquet(folder / CASES) as file:
        names, own = file.schema_arrow.names, list[str]()
        if not brief:
            other = {*plan.columns, *ENDED}
            own = [n for n in kinds_of(plan.experiment.columns) if n in names and n not in other]
        heads = [name for name in ("case_id", "flight", "identity", *ENDED) if name in names]
        for batch in file.iter_batches(batch_size=BATCH, columns=[*heads, *own]):
            content = {name: batch.column(name).to_pylist() for name in (*heads, *own)}
            keys = plan.keys_of(content, by_case=same)
            for number, key in enumerate(keys):
                body = "" if brief else body_of({name: content[name][number] for name in own})
                status, reason, version = (content[name][number] or "" for name in ENDED)
                yield Row(key, status, reason, version, body)


@contextmanager
def parquet(path: Path) -> Iterator[Any]:
    """A Parquet file of cases, if it is there, whole, and as it was written.

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
            facts, schema = file.metadata, file.schema_arrow
            size = sum(facts.row_group(i).total_byte_size for i in range(facts.num_row_groups))
            if facts.num_rows > 2_000_000 or size > 1000 * (path.stat().st_size + 1_000_000):
                words = f"{facts.num_rows} rows of {size} bytes"
                raise InputError(f"{path}: {words}: it is another file")
            of_text = {name for name in schema.names if "string" in str(schema.field(name).type)}
            if missing := sorted({"case_id", "backend", "settings", "identity", *ENDED} - of_text):
                raise InputError(
                    f'{path}: no cases of a study, without a column "{missing[0]}" of text: take '
                    "the file from where it came, or run the study with --fresh"
                )
            yield file
    except (OSError, pa.ArrowException, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path}: not readable ({error}): run the study with --fresh") from None


def read_cases(folder: str | Path) -> pd.DataFrame:
    """The rows of `cases.parquet` in a results folder, with whatever columns it has.

    Raises:
        InputError: if there are none yet, the file is not readable, or not as it was written.
    """
    with parquet(Path(folder) / CASES) as file:
        frame: pd.DataFrame = file.read().to_pandas()
    return frame


def cases_table(plan: Plan, rows: Sequence[Row]) -> pa.Table:
    """Rows of `cases.parquet`: of the plan, of the row or of its body; then swept factors."""
    import pyarrow as pa

    bodies = [json.loads(row.body) for row in rows]
    places = [plan.place_of[row.key] for row in rows]
    arrays: dict[str, Any] = {}
    for column in plan.experiment.columns:
        name, kind, empty = column.name, column.kind, column.kind.empty
        if name in ENDED:
            values = [getattr(row, name) for row in rows]
        elif name in plan.columns:
            values = [plan.columns[name][place] for place in places]
        else:
            values = [body.get(name, empty) for body in bodies]
        arrays[name] = pa.array(values, type=pa.type_for_alias(kind.arrow))
    swept: Mapping[str, Any] = getattr(plan.experiment.definition.design, "sweep", {})
    for key, levels in swept.items():
        kind_ = pa.float64() if all(map(is_real, levels)) else pa.string()
        arrays[key] = pa.array([plan.columns[key][place] for place in places], type=kind_)
    return pa.table(arrays)


def write_rows(folder: Path, plan: Plan, rows: Sequence[Row]) -> None:
    """Write `cases.parquet` of rows in plan order; it appears whole or not at all."""
    import pyarrow.parquet as pq

    starts = range(0, max(len(rows), 1), GROUP)  # one table at least has the columns
    tables = (cases_table(plan, rows[start : start + GROUP]) for start in starts)
    first = next(tables)
    dense = [column.name for column in plan.experiment.columns if column.kind.dense]
    with (
        whole_file(folder / CASES) as file,
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
        for table in chain([first], tables):
            writer.write_table(table)
