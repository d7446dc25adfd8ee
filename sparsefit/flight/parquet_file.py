"""Flight tables as Parquet: the same columns, the settings in the file's metadata."""

from __future__ import annotations

import io
from collections.abc import Mapping
from importlib import import_module
from types import ModuleType
from typing import Any

from sparsefit.errors import InputError, MissingExtra
from sparsefit.flight.record import MOST_SAMPLES
from sparsefit.flight.table import FlightTable, columns_of, is_key, number


def encode(table: FlightTable) -> bytes:
    """Return the file's content.

    Raises:
        MissingExtra: without pyarrow.
    """
    arrow, parquet = _arrow()
    metadata = {key: repr(value) for key, value in table.settings.items()}
    buffer = io.BytesIO()
    parquet.write_table(arrow.table(table.columns, metadata=metadata), buffer)
    return buffer.getvalue()


def decode(content: bytes) -> FlightTable:
    """Return the table in a file's content.

    Raises:
        InputError: naming the column, if it is no Parquet, lacks a column or a value is no number.
        MissingExtra: without pyarrow.
    """
    arrow, parquet = _arrow()
    try:
        file = parquet.ParquetFile(io.BytesIO(content))
        if file.metadata.num_rows > MOST_SAMPLES:
            words = f"{file.metadata.num_rows} samples are more than {MOST_SAMPLES}"
            raise InputError(f"{words}: cut the flight into pieces")
        wanted = columns_of(file.schema_arrow.names)
        read = file.read(columns=list(wanted))
    except (arrow.ArrowException, OSError):
        raise InputError("not a Parquet file, or a damaged one; write it again") from None
    columns = {name: _values(arrow, name, read.column(name)) for name in wanted}
    return FlightTable(columns, _settings(read.schema.metadata or {}))


def _arrow() -> tuple[ModuleType, ModuleType]:
    """Import pyarrow when the first Parquet file is met; CSV works without it."""
    try:
        return import_module("pyarrow"), import_module("pyarrow.parquet")
    except ImportError:
        raise MissingExtra(
            "Parquet files need pyarrow: pip install pyarrow, or use a .csv file"
        ) from None


def _values(arrow: ModuleType, name: str, column: Any) -> list[float]:
    kind = column.type
    if not (arrow.types.is_floating(kind) or arrow.types.is_integer(kind)):
        raise InputError(f"column {name} holds {kind}; it must hold numbers")
    if column.null_count:
        row = column.is_null().index(True).as_py()
        raise InputError(f"row {row}, column {name} is empty; repair or drop it")
    values: list[float] = column.cast(arrow.float64(), safe=False).to_pylist()
    return values


def _settings(metadata: Mapping[bytes, bytes]) -> dict[str, float]:
    """Pick our keys; writers such as pandas add their own."""
    texts = {_text(key): _text(value) for key, value in metadata.items()}
    return {key: number(value, f"metadata {key}") for key, value in texts.items() if is_key(key)}


def _text(raw: bytes) -> str:
    return raw.decode(errors="replace")
