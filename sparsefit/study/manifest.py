"""`manifest.json`: versions, machine, counts of statuses and checksums of a study's results.

    code_version("my-plugin 1.2")  ->  "0.4.0+1a2b3c4d my-plugin 1.2"

Parquet files whose sha256 is not the one in the manifest beside them are not read. The version of
a row has a digest of every source file that can change a number.
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
import re
from collections.abc import Iterator, Mapping
from contextlib import suppress
from datetime import UTC, datetime
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

import sparsefit
from sparsefit.errors import InputError
from sparsefit.whole_file import read_whole, write_whole

MANIFEST = "manifest.json"
LARGEST = 1 << 24  # bytes of a record that is read
STUDY = (  # files of `study/` that no number of a case depends on
    *("__init__", "compare", "entries", "evidence", "figures", "measures", "page", "panels"),
    *("runner", "selection", "solver_times", "store", "study", "table", "tables", "trials"),
)
# No number of a case depends on these: they run, store and show.
NOT_COMPUTING = {"cli", "plot", "__main__.py", "sklearn.py", "pysindy.py"} | {
    f"study/{name}.py" for name in STUDY
}
COMPUTING = (  # packages
    *("numpy", "scipy", "pandas", "pyarrow", "cvxpy", "clarabel", "osqp", "scikit-learn", "celer"),
    *("skglm", "group-lasso", "spams-bin", "scs", "highspy", "piqp", "daqp", "pysindy", "numba"),
)
DOCSTRING = re.compile(r'(\A|:(?:  #[^\n]*)?\n)( *)r?"""(?:[^"\\]|\\.|"(?!""))*"""\n')
COMMENT = re.compile(r"""(?m)^\s*#.*\n|^\s*\n|  #[^"'\n]*$""")


def code_version(plugin: str = "") -> str:
    """The version of the code, `0.4.0+1a2b3c4d`, and of a plug-in's distribution."""
    return f"{sparsefit.__version__}+{_digest()} {plugin}".rstrip()


@cache
def _digest() -> str:
    """The first 8 digits of the sha256 of `sources` without words, equal on every machine."""
    total = hashlib.sha256()
    package = Path(sparsefit.__file__).parent
    for path in sources():
        text = without_words(path.read_text(encoding="utf-8"))
        total.update(f"{path.relative_to(package).as_posix()}\0{text}\0".encode())
    return total.hexdigest()[:8]


def sources() -> Iterator[Path]:
    """The source files of the package that can change a number, in order."""
    package = Path(sparsefit.__file__).parent
    for path in sorted(package.rglob("*.py*")):
        within = path.relative_to(package)
        shows = NOT_COMPUTING & {within.parts[0], within.as_posix()}
        if path.suffix in (".py", ".pyx") and not shows:
            yield path


def without_words(source: str) -> str:
    """A Python source without docstrings, comments and empty lines, which change no number.

    Works on the text, and so alike in every version of Python. Comments stay where a string of
    several lines might contain one.
    """
    text = DOCSTRING.sub(r"\1", source)
    return text if '"""' in text else COMMENT.sub("", text)


def write_manifest(folder: Path, content: Mapping[str, object]) -> None:
    """Write the manifest of a finished run: this content, checksums, versions and the machine."""
    checksums = {path.name: _sha256(path) for path in sorted(folder.glob("*.parquet"))}
    whole = {
        **content,
        "sha256": checksums,
        "finished": datetime.now(UTC).isoformat(timespec="seconds"),
        "versions": versions(),
        "platform": platform.platform(),
        "processors": os.cpu_count(),
    }
    write_whole(folder / MANIFEST, json.dumps(whole, indent=2) + "\n")


def read_record(path: Path) -> dict[str, Any] | None:
    """The JSON object in a regular file; None without a readable one."""
    try:
        content = json.loads(read_whole(path, most=LARGEST))
    except (InputError, ValueError, RecursionError):
        return None
    return content if isinstance(content, dict) else None


def check_whole(path: Path, *, strict: bool = False) -> None:
    """Raise `InputError` unless a file has the checksum in the manifest beside it.

    strict: also where the manifest has none, for a part that is merged from elsewhere.
    """
    written = (read_record(path.parent / MANIFEST) or {}).get("sha256")
    if not isinstance(written, dict) or path.name not in written:
        if strict:
            words = f"no checksum of it stands in {MANIFEST}"
            raise InputError(f"{path}: {words}: take both files from where they came")
        return
    if _sha256(path) != written[path.name]:
        raise InputError(
            f"{path}: not what was written (its sha256 is not that of {MANIFEST}): "
            "take both files from where they came, or run the study with --fresh"
        )


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def versions() -> dict[str, str | None]:
    """Versions of sparsefit, Python and numerical packages; None for those not installed."""
    numbers: dict[str, str | None] = {
        "sparsefit": sparsefit.__version__, "python": platform.python_version()
    }  # fmt: skip
    for name in COMPUTING:
        numbers[name] = None
        with suppress(metadata.PackageNotFoundError):
            numbers[name] = metadata.version(name)
    return numbers


def processor() -> str:
    """The name of the CPU, where the system has it."""
    with suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()
