"""Problems in a common form, for solvers that know arrays alone, and solvers that are commands.

With omega_j the weight of column j's block, u_j = omega_j v_j and targets divided by the largest
alpha, a penalty of weighted norms is one with weights of one,

    minimise over u:   1/(2m) |y - X u|^2 + f (sum_g |u_g| + sum_j lambda_j |u_j| + rho/2 |u|^2),

X = Z diag(1/omega), f = alpha / alpha_1.
"""

import json
import os
import select
import shutil
import signal
import subprocess
import tempfile
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any, Literal, Self, TypeAlias

import numpy as np
from scipy import sparse

from sparsefit.arrays import Array, IntArray
from sparsefit.errors import InputError, MissingExtra, SparsefitError, one_line
from sparsefit.regression.backend import Tolerance
from sparsefit.regression.design import Design
from sparsefit.regression.group_penalties import GroupNorms, NestedNorms
from sparsefit.regression.losses import SQUARES
from sparsefit.regression.ordered_penalties import SortedNorm
from sparsefit.regression.penalties import AbsoluteValues, Penalty

FOREVER = 1e6  # s: the longest wait that the system takes
Kind: TypeAlias = Literal[
    "LASSO", "elastic net", "group-LASSO", "joint group-LASSO", "sparse-group LASSO", "SLOPE", ""
]
"""The kinds of penalties that public solvers solve; empty for any other."""


def kind_of(penalty: Penalty) -> Kind:
    """The kind of a penalty."""
    if penalty.loss != SQUARES or (penalty.ridge and type(penalty) is not AbsoluteValues):
        return ""
    if isinstance(penalty, AbsoluteValues) and penalty.ridge:
        return "elastic net" if np.ptp(penalty.weights) == 0.0 else ""
    if isinstance(penalty, NestedNorms):
        plain = type(penalty.inner) is AbsoluteValues and not penalty.coupled
        return "sparse-group LASSO" if plain else ""
    joint: Kind = "joint group-LASSO" if penalty.coupled else "group-LASSO"
    kinds: dict[type, Kind] = {AbsoluteValues: "LASSO", GroupNorms: joint, SortedNorm: "SLOPE"}
    return kinds.get(type(penalty), "")


def matrix_of(design: Design) -> Any:
    """Z (m, k) in columns of unit rms: an array in Fortran order, or scipy's CSC.

    A design in memory whose columns have unit rms to rounding is not copied.
    """
    unscaled = bool(np.all(np.abs(design.rms - 1.0) <= 1e-13))
    if design.kind == "sparse" and design.direction is None:
        return (
            design.csc if unscaled else (design.csc @ sparse.diags_array(1.0 / design.rms)).tocsc()
        )
    if unscaled and design.in_memory and design.weights is None and design.direction is None:
        return np.asfortranarray(design.source)
    return design.columns(np.arange(design.shape[1]))


@dataclass(frozen=True, eq=False)
class Task:
    """Targets y (m, n) and the design X (m, k), dense in Fortran order or CSC, at fractions f (p,).

    groups (k,): the block of each column, from 0; lambdas (k,): weights of single coefficients of
    the sparse-group LASSO, or the sequence of SLOPE; ridge: rho. Columns that are zero throughout
    are left out, as some solvers divide by a group's norm: X has those of ``live`` (k,) out of
    ``columns``, and v = ``factor`` (k,) u. coupled: whether targets are solved together.
    """

    design: Any
    target: Array
    groups: IntArray
    fractions: Array
    kind: Kind
    ridge: float
    lambdas: Array | None
    live: IntArray
    factor: Array
    columns: int
    coupled: bool

    @classmethod
    def of(
        cls,
        design: Design,
        target: Array,
        penalty: Penalty,
        alphas: Array,
        *,
        dense: bool = False,
    ) -> Self:
        """The common form of a penalty that has a `kind_of`.

        dense: a sparse design is handed over as an array.
        """
        live, unit, lambdas = np.flatnonzero(design.squares > 0), float(alphas[0]), None
        columns, omega = penalty.columns, np.ones(len(live))
        penalty = penalty if len(live) == columns else penalty.restricted(live) or penalty
        if isinstance(penalty, SortedNorm):
            lambdas = penalty.weights
        elif isinstance(penalty, NestedNorms):
            omega = penalty.outer.weights[penalty.blocks]
            lambdas = penalty.inner.weights / omega
        elif isinstance(penalty, AbsoluteValues | GroupNorms):
            omega = penalty.weights[penalty.blocks]
        matrix = matrix_of(design)
        matrix = matrix if len(live) == columns else matrix[:, live]
        if np.any(omega != 1.0):
            is_array = isinstance(matrix, np.ndarray)
            scaled = matrix / omega if is_array else matrix @ sparse.diags_array(1.0 / omega)
            matrix = np.asfortranarray(scaled) if is_array else scaled.tocsc()
        if dense and not isinstance(matrix, np.ndarray):
            matrix = matrix.toarray(order="F")
        return cls(
            design=matrix,
            target=target / unit,
            groups=penalty.blocks,
            fractions=alphas / unit,
            kind=kind_of(penalty),
            ridge=unit * penalty.ridge / float(omega[0]) ** 2,
            lambdas=lambdas,
            live=live,
            factor=unit / omega,
            columns=columns,
            coupled=penalty.coupled,
        )

    def weights(self, call: Callable[[slice], Array]) -> Array:
        """Weights V (p, k, n) by a call that gives u (p, k b) of the b targets of a slice.

        Its coefficients stand target by target.
        """
        points, count = len(self.fractions), self.target.shape[1]
        apart = [slice(None)] if self.coupled else [slice(t, t + 1) for t in range(count)]
        parts = [call(targets).reshape(points, -1, len(self.live)) for targets in apart]
        weights = np.zeros((points, self.columns, count))
        weights[:, self.live] = (
            np.concatenate(parts, axis=1).transpose(0, 2, 1) * self.factor[:, None]
        )
        return weights


class LateError(SparsefitError):
    """A command exceeded a time limit and was ended; the message continues `the solve`."""


@dataclass(frozen=True)
class Command:
    """A solver that is a command: any program that reads and writes files, ``COMMAND... FOLDER``.

    It is started once for a path of each target, or of all where a penalty couples these. FOLDER
    holds the problem in the form of a `Task`: ``problem.json`` (kind, fractions f (p,), ridge rho,
    tolerance, settings), ``target.npy`` y (m, b), ``groups.npy`` (k,), from 0, ``lambdas.npy`` (k,)
    where the kind has them (of SLOPE its sequence), and X as ``design.npy`` (m, k) or, where it is
    sparse, ``design.npz`` of scipy. The program reads them, prints a line, reads a line, solves,
    prints a line, and writes ``answer.npy`` (p, b, k). Its time is the one between its two lines:
    neither its start nor files are in it.

    words: the program, sought from ``folder``, and its arguments; limit: seconds [s] of a path
    between these lines; start: of all beside them: starting, reading and writing.
    """

    name: str
    words: tuple[str, ...]
    folder: Path
    settings: Mapping[str, Any]
    limit: float
    start: float

    def __post_init__(self) -> None:
        if not all(isinstance(word, str) for word in self.words):
            raise InputError(f"{self.name}: command must be a list of words, a program first")
        path = self.folder / self.words[0]
        if not (path.is_file() if "/" in self.words[0] else shutil.which(self.words[0])):
            raise MissingExtra(f"{self.name}: there is no program {self.words[0]!r}; install it")

    def takes(self, penalty: Penalty) -> str:
        """The reason for refusing a penalty: problem.json has no name for its kind."""
        return "" if kind_of(penalty) else f"{self.name}: problem.json has no such penalty"

    def path(self, *problem: Any) -> Array:
        """The weights of `timed`, with the same arguments."""
        return self.timed(*problem)[0]

    def timed(
        self, design: Design, target: Array, penalty: Penalty, alphas: Array, tolerance: Tolerance
    ) -> tuple[Array, tuple[float, float]]:
        """Weights (p, k, n) of the program, and its wall and CPU time [s].

        Raises SparsefitError where it fails, `LateError` where it exceeds a limit.
        """
        spent, remaining = [0.0, 0.0], {"solve": self.limit}

        task = Task.of(design, target, penalty, alphas)

        def solved(targets: slice) -> Array:
            with tempfile.TemporaryDirectory(prefix="sparsefit-solver-") as name:
                folder = Path(name)
                if isinstance(task.design, np.ndarray):
                    np.save(folder / "design.npy", task.design)
                else:
                    sparse.save_npz(folder / "design.npz", task.design, compressed=False)
                arrays = {"groups": task.groups, "lambdas": task.lambdas}
                arrays["target"] = np.ascontiguousarray(task.target[:, targets])
                for key, values in arrays.items():
                    if values is not None:
                        np.save(folder / f"{key}.npy", values)
                words: dict[str, Any] = {"fractions": task.fractions.tolist(), "kind": task.kind}
                words |= {"ridge": task.ridge, "tolerance": tolerance}
                words |= {"settings": dict(self.settings)}
                with (folder / "problem.json").open("w", encoding="utf-8") as file:
                    json.dump(words, file)
                for part, seconds in enumerate(self._run(folder, remaining)):
                    spent[part] += seconds
                try:
                    answer: Array = np.load(folder / "answer.npy", allow_pickle=False)
                except (OSError, ValueError) as error:
                    raise InputError(f"{self.name} wrote no answer.npy ({error})") from None
                return answer

        weights = task.weights(solved)
        return weights, (spent[0], spent[1])

    def _run(self, folder: Path, remaining: dict[str, float]) -> tuple[float, float]:
        """Wall and CPU time [s] between the two lines that the program prints."""
        program, *rest = self.words
        first = str((self.folder / program).absolute()) if "/" in program else program
        remaining["start"], errors = self.start, (folder / "errors").open("w+b")
        pipes: Any = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": errors}
        words, where = [first, *rest, str(folder)], self.folder
        started: Any = subprocess.Popen(words, cwd=where, bufsize=0, process_group=0, **pipes)
        with errors, started as run:
            try:
                ready = self._line(run, "start", remaining)
                wall, cpu = perf_counter(), _cpu_seconds(run.pid)
                if ready:
                    with suppress(BrokenPipeError):  # it has ended: the next line says so
                        run.stdin.write(b"go\n")
                done = self._line(run, "solve", remaining) if ready else b""
                wall, cpu = perf_counter() - wall, _cpu_seconds(run.pid) - cpu
                while self._line(run, "start", remaining):
                    pass
                code = run.wait(max(min(remaining["start"], FOREVER), 0.0))
            except subprocess.TimeoutExpired:
                raise self._late("start") from None
            finally:
                with suppress(ProcessLookupError):
                    os.killpg(run.pid, signal.SIGKILL)
            if not done or code:
                errors.seek(max(errors.seek(0, os.SEEK_END) - 1000, 0))
                printed = errors.read().decode(errors="replace").strip().splitlines()
                last = one_line(printed[-1] if printed else "", 200)
                raise SparsefitError(f"{self.name} ended with code {code}: {last}")
        return wall, cpu

    def _line(self, run: Any, part: str, remaining: dict[str, float]) -> bytes:
        """The next line of the program, empty at its end; its time counts towards ``part``."""
        began = perf_counter()
        if not select.select([run.stdout], [], [], max(min(remaining[part], FOREVER), 0.0))[0]:
            raise self._late(part)
        line: bytes = run.stdout.readline()
        remaining[part] -= perf_counter() - began
        return line

    def _late(self, part: str) -> LateError:
        if part == "solve":
            return LateError(f"took longer than {self.limit:g} s")
        return LateError(f"took longer than {self.start:g} s to start, to read or to write")


def _cpu_seconds(pid: int) -> float:
    """The CPU time [s] of a process from /proc; NaN on systems without it."""
    try:
        words = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    except OSError:
        return float("nan")
    return sum(map(int, words[11:13])) / os.sysconf("SC_CLK_TCK")
