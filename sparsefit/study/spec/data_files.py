"""A regression problem from a file of numbers: theta, target and, where it has any, groups.

``.npz``: arrays ``theta`` (m, k), ``target`` (m,) or (m, n) and ``groups`` (k,). ``.parquet`` and
``.csv``, which begins with a line of names: the columns whose names begin with ``target`` are
targets, all others are columns of theta. Sizes are read before the numbers are, of a ``.csv`` its
bytes, and nothing in a file is ever run.
"""

from __future__ import annotations

import hashlib
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Any, TypeAlias

import numpy as np

from sparsefit.arrays import Array
from sparsefit.errors import InputError

Arrays: TypeAlias = tuple[Array, Array, Array | None]
"""theta (m, k), target (m,) or (m, n), labels of groups (k,) or None."""
MOST_VALUES = 64_000_000  # numbers in a problem: half a gigabyte
MOST_BYTES = 1 << 30  # of a file
MOST_COLUMNS = 10_000  # beyond, Z'Z alone takes a gigabyte
SUFFIXES = (".npz", ".parquet", ".csv")
WIDEST = 256  # bytes of a label of a group
TARGET = "target"


def digest(path: Path) -> str:
    """sha256 of a data file. Raises InputError unless it is a regular file of a size to read."""
    _check_file(path)
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def read_data(path: Path) -> Arrays:
    """The arrays of a data file.

    Raises:
        InputError: if there is no such file, it is too large, holds no theta or target, or
            anything but plain numbers.
    """
    _check_file(path)
    try:
        return READERS[path.suffix](path)
    except InputError:
        raise
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, MemoryError) as error:
        words = str(error) or type(error).__name__
        raise InputError(f"{path}: not readable: {words[:200]}") from None


def _check_file(path: Path) -> None:
    if path.suffix not in SUFFIXES:
        raise InputError(f"{path}: must be a file of kind {', '.join(SUFFIXES)}")
    if not path.is_file():
        found = "is no regular file" if path.exists() else "no such file"
        raise InputError(f"{path}: {found}: it is sought beside the study file")
    if path.stat().st_size > MOST_BYTES:
        raise InputError(f"{path}: larger than {MOST_BYTES >> 20} MB: take fewer samples")


def _read_npz(path: Path) -> Arrays:
    with zipfile.ZipFile(path) as archive:
        shapes = {
            member.filename.removesuffix(".npy"): _shape(archive, member)
            for member in archive.infolist()
            if member.filename.endswith(".npy")
        }
    _check_names(path, shapes)
    _check_size(path, sum(int(np.prod(shape)) for shape in shapes.values()))
    with np.load(path, allow_pickle=False) as arrays:
        groups = np.asarray(arrays["groups"]) if "groups" in arrays else None
        theta, target = np.asarray(arrays["theta"]), np.asarray(arrays["target"])
    for name, values in (("theta", theta), (TARGET, target)):
        if values.dtype.kind not in "fiub":
            raise InputError(f"{path}: {name} holds {values.dtype}, not real numbers")
    return theta, target, groups


def _shape(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> tuple[int, ...]:
    """What the header of an array says, before its numbers are unpacked."""
    with archive.open(member) as stream:
        return _header_shape(stream)


def _header_shape(stream: IO[bytes]) -> tuple[int, ...]:
    version = np.lib.format.read_magic(stream)
    read = np.lib.format.read_array_header_1_0
    if version != (1, 0):
        read = np.lib.format.read_array_header_2_0
    shape, _, kind = read(stream)
    if kind.hasobject:
        raise ValueError("it holds Python objects, and only numbers are read")
    if kind.itemsize > WIDEST:
        raise ValueError(f"it holds {kind}, and only numbers are read")
    return tuple(int(length) for length in shape)


def _read_parquet(path: Path) -> Arrays:
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        file = pq.ParquetFile(path)
        _check_size(path, file.metadata.num_rows * len(file.schema_arrow.names))
        _check_columns(path, file.schema_arrow)
        return _arrays(file.read())
    except pa.ArrowException as error:
        raise ValueError(str(error)) from None


def _read_csv(path: Path) -> Arrays:
    import pyarrow as pa
    import pyarrow.csv

    try:
        table = pyarrow.csv.read_csv(path)
    except pa.ArrowException as error:
        raise ValueError(str(error)) from None
    _check_columns(path, table.schema)
    return _arrays(table)


def _check_columns(path: Path, schema: Any) -> None:
    """Columns of numbers, targets among them; the types come before their numbers are used."""
    import pyarrow as pa

    for field in schema:
        if not (pa.types.is_floating(field.type) or pa.types.is_integer(field.type)):
            raise InputError(f'{path}: column "{field.name}" holds {field.type}, not numbers')
    if len(set(schema.names)) < len(schema.names):
        raise InputError(f"{path}: has two columns of one name: give each its own")
    targets = [name for name in schema.names if name.startswith(TARGET)]
    shapes: dict[str, tuple[int, ...]] = {} if len(targets) == len(schema.names) else {"theta": ()}
    _check_names(path, shapes | ({TARGET: ()} if targets else {}))


def _arrays(table: Any) -> Arrays:
    targets = [name for name in table.column_names if name.startswith(TARGET)]
    columns = [name for name in table.column_names if name not in targets]
    theta, target = (
        np.column_stack([table[name].to_numpy().astype(np.float64) for name in kept])
        for kept in (columns, targets)
    )
    return theta, target, None


READERS = {".npz": _read_npz, ".parquet": _read_parquet, ".csv": _read_csv}


def _check_names(path: Path, shapes: Mapping[str, tuple[int, ...]]) -> None:
    for name in ("theta", TARGET):
        if name not in shapes:
            found = ", ".join(sorted(shapes)[:8]) or "nothing"
            raise InputError(f"{path}: holds no {name} (found: {found}): it needs theta and target")


def _check_size(path: Path, values: int) -> None:
    if values > MOST_VALUES:
        words = f"holds {values} numbers, more than {MOST_VALUES}"
        raise InputError(f"{path}: {words}: take fewer samples or columns")
