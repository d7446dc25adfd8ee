"""Flight tables as Parquet: the same columns, the settings in the file's metadata."""

from __future__ import annotations

import io
from collections.abc import Mapping
from datetime import UTC, datetime, timedelta
from importlib import import_module
from types import ModuleType
from typing import Any

from sparsefit.errors import InputError, MissingExtra
from sparsefit.flight.anchor import Anchor
from sparsefit.flight.layout import (
    Layout,
    Source,
    check_one_vehicle,
    epoch_of,
    reader_of,
    settled,
    vehicle_columns,
)
from sparsefit.flight.record import MOST_SAMPLES
from sparsefit.flight.table import FlightTable, frame_of, is_key, number
from sparsefit.flight.units import factor_of


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
        if file.metadata.num_rows > MOST_SAMPLES:
            words = f"{file.metadata.num_rows} samples are more than {MOST_SAMPLES}"
            raise InputError(f"{words}: cut the flight into pieces")
        names = file.schema_arrow.names
        sources = layout.chosen(names)
        beside = vehicle_columns(names, sources)
        place, _ = layout.filtered(names)
        beside += [] if place is None or names[place] in beside else [names[place]]
        wanted = [source.column for source in sources.values()]
        read = file.read(columns=[*dict.fromkeys(wanted), *beside])
    except (arrow.ArrowException, OSError):
        raise InputError("not a Parquet file, or a damaged one; write it again") from None
    read = _of_one_vehicle(read, layout, vehicle_columns(names, sources))
    columns = {
        name: _values(arrow, name, source, read.column(source.column))
        for name, source in sources.items()
    }
    epoch = _epoch(arrow, sources["time"], read.column(sources["time"].column))
    settings, frame = _settings(read.schema.metadata or {})
    table = FlightTable(columns, settings, frame, anchor=Anchor(None, epoch))
    return settled(table, sources, layout) if layout.foreign else table


def _of_one_vehicle(read: Any, layout: Layout, naming: list[str]) -> Any:
    """The rows that the layout takes; InputError where they are of several vehicles."""
    if layout.only is not None:
        column, value = layout.only
        read = read.filter([str(one) == value for one in read.column(column).to_pylist()])
    for column in naming:
        pairs = read.column(column).value_counts().to_pylist()
        check_one_vehicle(column, {pair["values"]: pair["counts"] for pair in pairs})
    return read


def _arrow() -> tuple[ModuleType, ModuleType]:
    """Import pyarrow when the first Parquet file is met; CSV works without it."""
    try:
        return import_module("pyarrow"), import_module("pyarrow.parquet")
    except ImportError:
        raise MissingExtra(
            "Parquet files need pyarrow: pip install pyarrow, or use a .csv file"
        ) from None


def _epoch(arrow: ModuleType, source: Source, column: Any) -> datetime | None:
    """The time of the first row, where the column tells times."""
    if arrow.types.is_timestamp(column.type) and len(column):
        first = column[0].cast(arrow.timestamp("us")).cast(arrow.int64()).as_py()
        return datetime.fromtimestamp(0, UTC) + timedelta(microseconds=first)
    texts = arrow.types.is_string(column.type) or arrow.types.is_large_string(column.type)
    return epoch_of(source, column[0].as_py()) if texts and len(column) else None


def _values(arrow: ModuleType, name: str, source: Source, column: Any) -> list[float]:
    """The numbers of a column in SI units; of times, too, that are text or the file's own."""
    kind, place = column.type, source.column
    if column.null_count:
        row = column.is_null().index(True).as_py()
        raise InputError(f"row {row}, column {place} is empty; repair or drop it")
    if name == "time" and arrow.types.is_timestamp(kind):
        moments = column.cast(arrow.timestamp("ns")).cast(arrow.int64()).to_pylist()
        return [1e-9 * (moment - moments[0]) for moment in moments]
    if name == "time" and (arrow.types.is_string(kind) or arrow.types.is_large_string(kind)):
        texts = column.to_pylist()
        read = reader_of(name, source, texts[0] if texts else "")
        return [read(text, f"row {row}, column {place}") for row, text in enumerate(texts)]
    if not (arrow.types.is_floating(kind) or arrow.types.is_integer(kind)):
        raise InputError(f"column {place} holds {kind}; it must hold numbers")
    values: list[float] = column.cast(arrow.float64(), safe=False).to_pylist()
    factor = factor_of(name, source.unit)
    return values if factor == 1.0 else [factor * value for value in values]


def _settings(metadata: Mapping[bytes, bytes]) -> tuple[dict[str, float], str]:
    """Pick our keys, and the frame; writers such as pandas add their own."""
    texts = {_text(key): _text(value) for key, value in metadata.items()}
    frame = frame_of(texts["frame"], "metadata frame") if "frame" in texts else ""
    known = {key: number(value, f"metadata {key}") for key, value in texts.items() if is_key(key)}
    return known, frame


def _text(raw: bytes) -> str:
    return raw.decode(errors="replace")
