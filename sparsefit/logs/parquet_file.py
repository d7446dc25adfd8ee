"""Flight tables as Parquet: the same columns, the settings in the file's metadata."""

from __future__ import annotations

import io
from collections.abc import Mapping
from importlib import import_module
from types import ModuleType
from typing import Any

from sparsefit.errors import InputError, MissingExtra
from sparsefit.logs.column import Cells
from sparsefit.logs.layout import Layout
from sparsefit.logs.sheet import Sheet, check_size
from sparsefit.logs.table import FlightTable, frame_of, is_key, number


def encode(table: FlightTable) -> bytes:
    """Return the file's content.

    Raises:
        MissingExtra: without pyarrow.
    """
    arrow, parquet = _arrow()
    metadata = {key: repr(value) for key, value in table.settings.items()}
    metadata |= {"frame": table.frame} if table.frame else {}
    buffer = io.BytesIO()
    parquet.write_table(arrow.table(table.columns, metadata=metadata), buffer)
    return buffer.getvalue()


def decode(content: bytes, layout: Layout) -> FlightTable:
    """Return the table in a file's content, read by a layout.

    Raises:
        InputError: naming the column, if it is no Parquet, lacks a column or a value is no number.
        MissingExtra: without pyarrow.
    """
    arrow, parquet = _arrow()
    try:
        file = parquet.ParquetFile(io.BytesIO(content))
        check_size(file.metadata.num_rows)
        settings, frame = _settings(file.schema_arrow.metadata or {})

        def read(wanted: list[str]) -> dict[str, Cells]:
            table = file.read(columns=wanted)
            names = table.column_names
            return {name: _cells(arrow, table.column(names.index(name))) for name in wanted}

        sheet = Sheet(file.schema_arrow.names, read, "row {}".format, settings, frame)
        return sheet.flight_table(layout)
    except (arrow.ArrowException, OSError, UnicodeDecodeError):
        raise InputError("not a Parquet file, or a damaged one; write it again") from None


def _arrow() -> tuple[ModuleType, ModuleType]:
    """Import pyarrow when the first Parquet file is met; CSV works without it."""
    try:
        return import_module("pyarrow"), import_module("pyarrow.parquet")
    except ImportError:
        raise MissingExtra(
            "Parquet files need pyarrow: pip install pyarrow, or use a .csv file"
        ) from None


def _cells(arrow: ModuleType, column: Any) -> Cells:
    """The cells as an array of numbers or moments, or as texts; NaN or no text where empty."""
    kind, types = column.type, arrow.types
    if types.is_timestamp(kind) or types.is_floating(kind) or types.is_integer(kind):
        cells: Cells = column.to_numpy()
        return cells
    return ["" if cell is None else str(cell) for cell in column.to_pylist()]


def _settings(metadata: Mapping[bytes, bytes]) -> tuple[dict[str, float], str]:
    """Pick our keys, and the frame; writers such as pandas add their own."""
    texts = {_text(key): _text(value) for key, value in metadata.items()}
    frame = frame_of(texts["frame"], "metadata frame") if "frame" in texts else ""
    known = {key: number(value, f"metadata {key}") for key, value in texts.items() if is_key(key)}
    return known, frame


def _text(raw: bytes) -> str:
    return raw.decode(errors="replace")
