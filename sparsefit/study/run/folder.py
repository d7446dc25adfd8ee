"""A results folder: whose rows it holds, whether they are all there, and where a run goes on."""

from __future__ import annotations

from pathlib import Path
from typing import TypeAlias

from sparsefit.errors import InputError
from sparsefit.study.run import partial
from sparsefit.study.run.manifest import MANIFEST, read_manifest, sparsefit_version
from sparsefit.study.run.outcome import Outcome
from sparsefit.study.spec.study import Study

CASES = "cases.parquet"
WEIGHTS = "weights.parquet"
Outcomes: TypeAlias = dict[tuple[int, int], Outcome]  # by flight and cell


def made_folder(study: Study, results_dir: str | Path) -> Path:
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
    for name in (CASES, WEIGHTS, MANIFEST):
        (folder / name).unlink(missing_ok=True)


def refuse_foreign(study: Study, folder: Path) -> None:
    """Rows of another study, or of another version, are never mixed with these."""
    header = partial.read_header(folder)
    for made in (header, read_manifest(folder)):
        if made is not None and made.get("study_hash") != study.hash:
            short = str(made.get("study_hash"))[:12]
            raise InputError(
                f"{folder} was made by a different study (hash {short}): "
                "use --fresh to start over, or rename this study"
            )
    if header is not None and header.get("sparsefit") != sparsefit_version():
        raise InputError(
            f"{folder} was begun by sparsefit {header.get('sparsefit')}, this is "
            f"{sparsefit_version()}: use --fresh to start over, or go on with that version"
        )
    if header is None and (folder / CASES).exists() and read_manifest(folder) is None:
        raise InputError(
            f"{folder} holds cases of an unknown study: use --fresh to start over, or rename"
        )


def is_finished(folder: Path) -> bool:
    """Whether all rows of the study are in the folder, and none are left to be put in order."""
    done = partial.read_header(folder) is None and read_manifest(folder) is not None
    return done and (folder / CASES).exists()


def resume(study: Study, folder: Path) -> Outcomes:
    """The rows that are there; without a header there is nothing to trust, and all begins anew."""
    if partial.read_header(folder) is None:
        versions = {"study_hash": study.hash, "sparsefit": sparsefit_version()}
        partial.begin(folder, {**versions, "study": study.name, "planned": study.planned})
        return {}
    rows = partial.read_rows(folder)
    return {
        key: row
        for key, row in rows.items()
        if row.flight < study.count and row.cell < len(study.cells)
    }
