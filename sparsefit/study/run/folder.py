"""A results folder: where it is, and what stands in it."""

from __future__ import annotations

from pathlib import Path

from sparsefit.errors import InputError
from sparsefit.study.run import partial
from sparsefit.study.run.manifest import MANIFEST
from sparsefit.study.spec.identity import AnyStudy

CASES = "cases.parquet"
WEIGHTS = "weights.parquet"
UNPLANNED = "unplanned.jsonl"


def made_folder(study: AnyStudy, results_dir: str | Path) -> Path:
    """`results_dir/<name>`, made if need be; `InputError` where it cannot be."""
    folder = Path(results_dir) / study.name
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            f"{folder}: cannot be made: {error.strerror}: choose another results folder"
        ) from None
    return folder


def clear(folder: Path) -> None:
    """Remove the rows and the manifest of whatever study was run here."""
    partial.discard(folder)
    for name in (CASES, WEIGHTS, MANIFEST, UNPLANNED):
        (folder / name).unlink(missing_ok=True)
