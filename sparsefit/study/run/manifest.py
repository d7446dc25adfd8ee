"""`manifest.json`: what made these results, and what came out, in one small file.

It holds the sha256 of what was written beside it: rows that a disk or a hand has changed since are
not read as if they were the answer.
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
import subprocess
from collections.abc import Mapping
from contextlib import suppress
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Any

import sparsefit
from sparsefit.errors import InputError
from sparsefit.study.spec.identity import AnyStudy
from sparsefit.whole_file import write_whole

MANIFEST = "manifest.json"
PACKAGES = ("numpy", "scipy", "pandas", "pyarrow", "cvxpy", "clarabel", "osqp")


def write_manifest(
    study: AnyStudy,
    folder: Path,
    *,
    statuses: Mapping[str, int],
    wall_seconds: float,
    solver_seconds: float,
    processes: int,
    resumed: int,
    more: Mapping[str, object] | None = None,
) -> None:
    """Write the manifest of a finished run; `resumed` rows came from an earlier, broken-off one.

    wall_seconds of all `processes` at once; solver_seconds, their sum in back-ends, is of this
    run's rows only too; more: what its kind of study tells beside.
    """
    content = {
        "study": study.name,
        "study_hash": study.hash,
        "seed": study.seed,
        "cases": study.planned,
        "statuses": dict(sorted(statuses.items())),
        "sha256": {path.name: _sha256(path) for path in sorted(folder.glob("*.parquet"))},
        "wall_seconds": round(wall_seconds, 3),
        "solver_seconds": round(solver_seconds, 3),
        "resumed_cases": resumed,
        "processes": processes,
        "finished": datetime.now(UTC).isoformat(timespec="seconds"),
        "versions": versions(),
        "platform": platform.platform(),
        "machine": platform.machine(),
        "processors": os.cpu_count(),
        "load": _load(),
        "git_commit": git_commit(),
        **(more or {}),
    }
    write_whole(folder / MANIFEST, json.dumps(content, indent=2) + "\n")


def read_manifest(folder: Path) -> dict[str, Any] | None:
    """The manifest of a results folder; None where there is none that can be read."""
    return read_record(folder / MANIFEST)


def read_record(path: Path) -> dict[str, Any] | None:
    """The JSON object in a file; None where there is none that can be read."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return None
    return content if isinstance(content, dict) else None


def check_whole(path: Path) -> None:
    """Raise `InputError` unless a file is what the manifest beside it says that was written.

    Results from before there were checksums are taken as they are.
    """
    written = (read_manifest(path.parent) or {}).get("sha256")
    if not isinstance(written, dict) or path.name not in written:
        return
    if _sha256(path) != written[path.name]:
        raise InputError(
            f"{path}: not what was written (its sha256 is not that of {MANIFEST}): "
            "take both files from where they came, or run the study with --fresh"
        )


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _load() -> list[float] | None:
    """The load of the last 1, 5 and 15 minutes, the run's own among it; None where none is told."""
    return [round(one, 2) for one in os.getloadavg()] if hasattr(os, "getloadavg") else None


def versions() -> dict[str, str | None]:
    """Versions of sparsefit, Python and what computes; None for what is not installed."""
    return {
        "sparsefit": sparsefit_version(),
        "python": platform.python_version(),
        **{name: version_of(name) for name in PACKAGES},
    }


def sparsefit_version() -> str:
    """The version of the package that runs, installed or not."""
    return str(getattr(sparsefit, "__version__", None) or version_of("sparsefit") or "unknown")


def version_of(name: str) -> str | None:
    """The version of an installed package; None where it is not."""
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def git_commit() -> str | None:
    """The commit of the checkout that holds this package, `+changes` if it was edited since."""
    package = Path(sparsefit.__file__).resolve().parent
    top = _git(package, "rev-parse", "--show-toplevel")
    # An installed copy may lie inside a checkout of something else.
    if not top or Path(top).resolve() != package.parent:
        return None
    commit = _git(package, "rev-parse", "--verify", "HEAD")
    changed = _git(package, "status", "--porcelain", "--", ".")
    return f"{commit}+changes" if commit and changed else commit


def _git(folder: Path, *words: str) -> str | None:
    """What git answers; None where git, the checkout or the answer is missing."""
    try:
        done = subprocess.run(
            ["git", "-C", str(folder), *words],
            capture_output=True,
            check=True,
            text=True,
            timeout=10,
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip() or None


def processor() -> str:
    """The name of the CPU, where the system tells it."""
    with suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()
