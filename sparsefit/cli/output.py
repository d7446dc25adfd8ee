"""What verbs write on stdout: JSON, durations, proofs; and what they do not overwrite unasked."""

from __future__ import annotations

import json
import os
import shutil
import sys
from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sparsefit.errors import InputError, one_of

if TYPE_CHECKING:
    from sparsefit.regression import Certificate
    from sparsefit.study.evidence.table import Table


def print_json(record: object) -> None:
    """Print one JSON document; what is not finite must be None by now."""
    print(json.dumps(record, indent=2, allow_nan=False, ensure_ascii=False))


def check_output(path: str, *, force: bool, endings: Collection[str] = ()) -> None:
    """Raise InputError, before any work, where a file could not be written or would be overwritten.

    endings: of a name, lower case, that say what is written; any where there are none.
    """
    file = Path(path)
    if not path.strip():
        raise InputError("the name of the file to write is empty; give one")
    if endings:
        one_of("file type", file.suffix.lower() or file.name, endings)
    if not file.parent.is_dir():
        raise InputError(f"cannot write {path}: there is no folder {file.parent}; make it first")
    if file.is_dir():
        raise InputError(f"{path} is a folder; choose another name")
    if os.path.lexists(path) and not force:
        raise InputError(f"{path} exists; add --force or choose another name")


def check_folder(path: str, *, force: bool = False, own: str = "") -> Path:
    """Return the folder; InputError, before any work, where it holds what was not written here.

    own: a file that shows that it was, of a verb without --force.
    """
    folder = Path(path)
    if not path.strip():
        raise InputError("the name of the folder to write is empty; give one")
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{path} is a file; choose another name for the folder")
    written = force or (own and (folder / own).exists())
    if folder.is_dir() and any(folder.iterdir()) and not written:
        remedy = f"it has no {own}: choose" if own else "add --force or choose"
        raise InputError(f"{path} is not empty; {remedy} another name")
    return folder


def proof(certificate: Certificate | None) -> str:
    """`duality_gap 1.2e-10`, or `none`."""
    return f"{certificate.kind} {certificate.value:.1e}" if certificate else "none"


def duration(seconds: float) -> str:
    """`0.42 s`, `35 s`, `4 min 05 s`, `2 h 10 min`."""
    if seconds < 9.95:
        return f"{seconds:.2g} s"
    if seconds < 59.5:
        return f"{seconds:.0f} s"
    minutes, rest = divmod(round(seconds), 60)
    if minutes < 60:
        return f"{minutes} min {rest:02d} s"
    return f"{minutes // 60} h {minutes % 60:02d} min"


def terminal_width() -> int:
    """Columns of the terminal; a pipe or a file takes wide tables as they are."""
    return shutil.get_terminal_size().columns if sys.stdout.isatty() else 160


def table_record(table: Table) -> dict[str, Any]:
    """Every row of a table, JSON-ready; what is not finite is None."""
    from sparsefit.codec import finite_or_none

    return {
        "title": table.title,
        "columns": [column.full_heading for column in table.columns],
        "rows": finite_or_none(list(table.rows)),
        "notes": list(table.notes),
    }
