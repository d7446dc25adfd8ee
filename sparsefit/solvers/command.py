"""A solver as a command: any program of any environment or language that reads and writes files.

    COMMAND... FOLDER

is started once for a path of each target, or of all where a penalty couples these. FOLDER holds the
problem in the form of `peers`, with columns of unit rms and weights of one,

    minimise over u (k, b):   1/(2m) |y - X u|^2 + f Omega(u),
    Omega(u) = sum_g |u_g| + sum_j lambda_j |u_j| + rho/2 |u|^2

as ``problem.json`` (kind, fractions f (p,), ridge rho, tolerance, settings), ``target.npy`` y
(m, b), ``groups.npy`` (k,), from 0, ``lambdas.npy`` (k,) where the kind has them (of SLOPE its
sequence), and X as ``design.npy`` (m, k) or, where it is sparse, ``design.npz`` of scipy. The
program reads them, prints a line, reads a line, solves, prints a line, and writes ``answer.npy``
(p, b, k). Its time is the one between both of its lines: neither its start nor files are in it.
"""

import json
import os
import shutil
import subprocess
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from scipy import sparse

from sparsefit.arrays import Array
from sparsefit.errors import InputError, MissingExtra, SparsefitError, one_line
from sparsefit.regression.design import Design
from sparsefit.regression.penalties import Penalty
from sparsefit.solvers.peers import Part, Timed, kind_of, parts_of


@dataclass(frozen=True)
class Command:
    """A solver that is a command.

    name: what tables call it; command: the program and its arguments, relative to ``folder``;
    settings: what problem.json tells it of them.
    """

    name: str
    command: tuple[str, ...]
    folder: str = "."
    settings: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not self.command or not all(isinstance(word, str) for word in self.command):
            raise InputError(f"{self.name}: command must be a list of words, a program first")
        program = self.command[0]
        path = Path(self.folder, program)
        if not (path.is_file() if "/" in program else shutil.which(program)):
            raise MissingExtra(f"{self.name}: there is no program {program!r}; install it")

    def takes(self, penalty: Penalty) -> str:
        """The families of penalties that a problem.json can name."""
        return "" if kind_of(penalty) else f"{self.name}: a command is handed no such penalty"

    def path(
        self,
        design: Design,
        target: Array,
        penalty: Penalty,
        alphas: Array,
        tolerance: float | None,
    ) -> Array | Timed:
        """Weights (p, k, n) of the program, and its time. Raises InputError as it fails."""
        if reason := self.takes(penalty):
            raise InputError(reason)
        parts = parts_of(design, target, penalty, alphas)
        return parts.joined([self._solved(part, tolerance) for part in parts.parts])

    def _solved(self, part: Part, tolerance: float | None) -> Timed:
        with tempfile.TemporaryDirectory(prefix="sparsefit-") as name:
            folder = Path(name)
            if isinstance(part.design, np.ndarray):
                np.save(folder / "design.npy", part.design)
            else:
                sparse.save_npz(folder / "design.npz", part.design, compressed=False)
            np.save(folder / "target.npy", part.target)
            np.save(folder / "groups.npy", part.groups)
            if part.lambdas is not None:
                np.save(folder / "lambdas.npy", part.lambdas)
            words: dict[str, Any] = {"kind": part.kind, "ridge": part.ridge, "tolerance": tolerance}
            words |= {"fractions": part.fractions.tolist(), "settings": dict(self.settings)}
            with (folder / "problem.json").open("w", encoding="utf-8") as file:
                json.dump(words, file)
            wall, cpu = self._run(folder)
            try:
                return Timed(np.load(folder / "answer.npy"), wall, cpu)
            except (OSError, ValueError) as error:
                raise InputError(f"{self.name} wrote no answer.npy ({error})") from None

    def _run(self, folder: Path) -> tuple[float, float]:
        """Seconds of wall and CPU [s] between the two lines of the program."""
        program, *rest = self.command
        first = str(Path(self.folder, program).absolute()) if "/" in program else program
        process = subprocess.Popen(
            [first, *rest, str(folder)],
            cwd=self.folder or None,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        assert process.stdin is not None
        assert process.stdout is not None
        try:
            ready = process.stdout.readline()
            wall, cpu = perf_counter(), _cpu_seconds(process.pid)
            if ready:
                process.stdin.write("go\n")
                process.stdin.flush()
            done = process.stdout.readline() if ready else ""
            wall, cpu = perf_counter() - wall, _cpu_seconds(process.pid) - cpu
            _, printed = process.communicate()
        finally:
            process.kill()
            process.wait()
        if not done or process.returncode:
            last = one_line(printed.strip().splitlines()[-1] if printed.strip() else "", 200)
            raise SparsefitError(f"{self.name} ended with code {process.returncode}: {last}")
        return wall, cpu


def _cpu_seconds(pid: int) -> float:
    """CPU seconds that a process has used, by /proc; NaN where there is none."""
    try:
        words = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    except OSError:
        return float("nan")
    return sum(map(int, words[11:13])) / os.sysconf("SC_CLK_TCK")
