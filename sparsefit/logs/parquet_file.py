"""Flight tables as Parquet: columns as in CSV, the settings in the file's metadata."""

from __future__ import annotations

import io
from typing import Any, BinaryIO

import numpy as np

from sparsefit.errors import InputError
from sparsefit.logs.flight_table import FlightTable, Settings, settings_of
from sparsefit.logs.layout import Cells, Layout, check_size


def encode(table: FlightTable) -> bytes:
    """Return the file's content."""
    import pyarrow as arrow
    from pyarrow import parquet

    buffer = io.BytesIO()
    parquet.write_table(arrow.table(table.columns, metadata=table.texts()), buffer)
    return buffer.getvalue()


def decode(file: BinaryIO, layout: Layout) -> FlightTable:
    """Return the table in a file, read by a layout; other columns than it needs are not unpacked.

    Raises:
        InputError: naming the column, if it is no Parquet, lacks a column, a value is no number, or
            the file unpacks to more than a flight.
    """
    import pyarrow as arrow
    from pyarrow import parquet

    def read(wanted: list[str]) -> tuple[dict[str, Cells], Settings]:
        meta = source.metadata
        groups = [meta.row_group(group) for group in range(meta.num_row_groups)]
        for name in wanted:
            kind = schema.field(name).type
            if arrow.types.is_nested(kind):
                raise InputError(f"column {name} holds {kind}; it must hold numbers")
            place = [meta.schema.column(i).path for i in range(meta.num_columns)].index(name)
            unpacked = sum(group.column(place).total_uncompressed_size for group in groups)
            if unpacked > 64 * meta.num_rows + (1 << 20):  # bytes, and of pages and dictionaries
                size = f"column {name} unpacks to {unpacked / 1e6:.0f} MB for {meta.num_rows} rows"
                raise InputError(f"{size}: no log of a flight; write it again")
        # Texts stay packed as places in a dictionary until they are cells, which share them.
        table = parquet.ParquetFile(file, read_dictionary=wanted).read(columns=wanted)
        cells = {name: _cells(name, table.column(name)) for name in wanted}
        entries = (
            ("metadata", key.decode(errors="replace"), text.decode(errors="replace"))
            for key, text in (schema.metadata or {}).items()
        )
        return cells, settings_of(entries, strict=False)

    try:
        source = parquet.ParquetFile(file)
        check_size(source.metadata.num_rows)
        schema = source.schema_arrow
        return layout.flight_table(schema.names, read, "row {}".format)
    except (arrow.ArrowException, OSError, UnicodeDecodeError):
        raise InputError("not a Parquet file, or a damaged one; write it again") from None


def _cells(name: str, column: Any) -> Cells:
    """The cells of a column; texts as objects, empty ones as no text."""
    from pyarrow import types

    if not types.is_dictionary(column.type):
        return np.asarray(column.to_numpy())
    packed = column.combine_chunks()
    words = [*map(str, packed.dictionary.to_pylist()), ""]
    if max(map(len, words)) > 64:
        raise InputError(f"column {name} holds texts of over 64 characters; it must hold numbers")
    places = packed.indices.fill_null(len(words) - 1).to_numpy(zero_copy_only=False)
    texts: Cells = np.array(words, dtype=object)[places]
    return texts
