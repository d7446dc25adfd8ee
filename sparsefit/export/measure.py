"""What a compiler makes of the C: bytes of flash and of stack, measured where there is one."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from sparsefit.errors import InputError, one_line
from sparsefit.whole_file import write_whole

FLAGS = ("-std=c99", "-Os", "-fstack-usage", "-c", "sf_flow.c", "-o", "sf_flow.o")
SECONDS = 120  # for one file


@dataclass(frozen=True)
class Footprint:
    """What `sf_flow.c` takes beside its state.

    compiler: its own words for itself; flash: bytes of code and constants, without the functions of
    math.h; stack: bytes of the frames of all functions together, which no call exceeds, as nothing
    recurs.
    """

    compiler: str
    flash: int
    stack: int


def footprint(files: dict[str, bytes], compiler: str | None) -> Footprint | None:
    """Compile the C for size. None where no compiler is named and there is none.

    Raises InputError where a named one is missing or refuses the source.
    """
    command = (compiler or "cc").split()
    if not shutil.which(command[0]):
        if compiler:
            raise InputError(f"--compiler {compiler}: there is no such program; check its name")
        return None
    with TemporaryDirectory() as folder:
        for name in ("sf_flow.h", "sf_flow.c"):
            write_whole(Path(folder) / name, files[name])
        told = _run([*command, *FLAGS], folder)
        if told.returncode and compiler:
            first = one_line(told.stderr.strip().partition("\n")[0])
            raise InputError(f"--compiler {compiler}: {first or 'it failed'}; is it for C99?")
        flash, stack = _text_size(command[0], folder), _frames(Path(folder))
    if told.returncode or flash is None:
        return None
    version = _run([*command, "--version"]).stdout.partition("\n")[0]
    return Footprint(one_line(version) or command[0], flash, stack)


def _run(command: Sequence[str], folder: str | None = None) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        command, cwd=folder, capture_output=True, text=True, check=False, timeout=SECONDS
    )


def _text_size(compiler: str, folder: str) -> int | None:
    """The size of code and constants by the `size` that belongs to a compiler."""
    size = re.sub(r"(gcc|clang|cc)$", "size", compiler)
    if size == compiler or not shutil.which(size):
        size = "size"
    if not shutil.which(size):
        return None
    lines = _run([size, "sf_flow.o"], folder).stdout.splitlines()
    return int(lines[1].split()[0]) if len(lines) > 1 else None


def _frames(folder: Path) -> int:
    """The frames of all functions, as the compiler writes them to `.su` files."""
    lines = [line for file in folder.glob("*.su") for line in file.read_text().splitlines()]
    return sum(int(line.split("\t")[1]) for line in lines)
