"""The plan of a study file: one frame with unit, condition, candidate of every case.

    case = unit x cell,    cell = condition x candidate

A unit is what statistics draw whole (a flight with all its conditions; a regression problem), a
candidate what is compared. A kind of study, of which there are two (flights; regression problems),
says its units, its cells and how a batch of cases is run; all else is common.

    code_version("my-plugin 1.2")  ->  "0.4.0+1a2b3c4d my-plugin 1.2"

The version of a row has a digest of every source file that can change a number.
"""

from __future__ import annotations

import hashlib
import itertools
import platform
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import cache, cached_property
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from sparsefit.arrays import BoolArray
from sparsefit.errors import InputError, suggestion
from sparsefit.study.columns import Column, Outcome
from sparsefit.study.keys import FlightFile, ProblemFile
from sparsefit.study.schema import canonical_json
from sparsefit.study.worker import Crew

if TYPE_CHECKING:
    import pandas as pd

Columns: TypeAlias = Mapping[str, Sequence[Any]]
STUDY = (  # files of `study/` that no number of a case depends on
    *("__init__", "compare", "evidence", "figures", "measures", "page"),
    *("runner", "selection", "solver_times", "store", "study", "table", "tables", "trials"),
)
# No number of a case depends on these: they run, store and show.
NOT_COMPUTING = {"cli", "plot", "__main__.py", "sklearn.py", "pysindy.py"} | {
    f"study/{name}.py" for name in STUDY
}
COMPUTING = (  # packages
    *("sparsefit", "numpy", "scipy", "pandas", "pyarrow", "cvxpy", "clarabel", "osqp"),
    *("scikit-learn", "celer", "skglm", "group-lasso", "spams-bin", "scs", "highspy", "piqp"),
    *("daqp", "pysindy", "numba"),
)
DOCSTRING = re.compile(r'(\A|:(?:  #[^\n]*)?\n)( *)r?"""(?:[^"\\]|\\.|"(?!""))*"""\n')
COMMENT = re.compile(r"""(?m)^\s*#.*\n|^\s*\n|  #[^"'\n]*$""")


def telling(words: Sequence[tuple[str, ...]]) -> list[tuple[str, ...]]:
    """The words of each candidate that distinguish it, the others empty.

    An aspect that all share, or that those before it settle, is left out: a title is the shortest.
    """
    kept = list[tuple[str, ...]]([("",) * len(each) for each in words])
    for at in range(len(words[0])):
        more = [(*a[:at], b[at], *a[at + 1 :]) for a, b in zip(kept, words, strict=True)]
        kept = more if len(set(more)) > len(set(kept)) else kept
    return kept


@dataclass(frozen=True)
class Batch:
    """Cells of one unit that are run together."""

    unit: int
    cells: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Plan(Protocol):
    """Every case of a study, unit by unit, in the order of the rows of `cases.parquet`.

    A kind of study says its units, its cells and how a batch of cases is run. definition: the keys
    of the file; path: of the file, beside which others that it names lie. stored: the columns of
    `cases.parquet`, but for swept factors; called: those with the names by which a user may call a
    cell; alone: whether cases are timed, so that one process works at a time.
    """

    definition: FlightFile | ProblemFile
    path: str
    kind: ClassVar[str]
    stored: ClassVar[Sequence[Column]]
    called: ClassVar[Sequence[str]] = ("backend", "label", "protocol")
    alone: ClassVar[bool] = False

    @property
    def units(self) -> Columns:
        """The columns of the units (u,): `flight`, `unit` and others; their part of `case_id`."""

    @property
    def cells(self) -> Columns:
        """The columns of the cells (c,): `condition`, `candidate`, `title`, factors, `case_id`."""

    def factors(self) -> Mapping[str, str]:
        """The role of each varied dotted key: "condition" or "candidate"."""
        return {}

    def version(self, cell: int) -> str:
        """The code that makes the rows of a cell, here and now."""

    def whole(self, wanted: BoolArray, version: NDArray[Any]) -> BoolArray:
        """The cases (u, c) to compute so that those ``wanted`` are comparable with the rest.

        version: of each row (u, c), empty where there is none.
        """
        return wanted

    def check(self) -> None:
        """Refuse, before any work, what cannot be run here at all."""
        return

    def batches(self, wanted: BoolArray) -> Iterator[Batch]:
        """The cases ``wanted`` (u, c) in batches."""

    def run(self, batches: Iterator[Batch], crew: Crew) -> Iterator[list[Outcome]]:
        """The outcome of each of their cells, from the workers of a crew.

        Those of a list are kept together or not at all: cases that are timed by turns, say.
        """

    def desk(self, name: str) -> tuple[type, tuple[Any, ...]]:
        """The class of a desk by its name, and its arguments: what lives in a worker."""

    @property
    def shape(self) -> tuple[int, int]:
        """The numbers of units and cells (u, c)."""
        return len(self.units["case_id"]), len(self.cells["case_id"])

    @cached_property
    def hash(self) -> str:
        """The sha256 of the units and cells: their names, and all that the cases depend on."""
        return hashlib.sha256(canonical_json([self.units, self.cells]).encode()).hexdigest()

    @property
    def size(self) -> int:
        """The number of cases."""
        return self.shape[0] * self.shape[1]

    @cached_property
    def case_ids(self) -> list[str]:
        """The id of every case, in plan order: all that its numbers depend on, and no names.

        Any study that plans a case plans it under this id, which is its key in a store.
        """
        parts = itertools.product(self.units["case_id"], self.cells["case_id"])
        return list(map("-".join, parts))

    @cached_property
    def place_of(self) -> dict[str, int]:
        """The place of each case id in the plan."""
        return {case_id: place for place, case_id in enumerate(self.case_ids)}

    @cached_property
    def versions(self) -> list[str]:
        """The code that makes the rows of each cell now."""
        return list(map(self.version, range(self.shape[1])))

    @cached_property
    def columns(self) -> dict[str, list[Any]]:
        """Every planned column, a value a case."""
        (rows, count), units, cells = self.shape, self.units, self.cells
        varied = len(set(cells["condition"])) > 1
        return {
            **{name: [value for value in units[name] for _ in range(count)] for name in units},
            **{name: list(cells[name]) * rows for name in cells},
            "case_id": self.case_ids,
            "unit": [f"{unit} in {condition}" if varied and condition else str(unit)
                     for unit, condition in itertools.product(units["unit"], cells["condition"])],
            "study": [self.definition.name] * self.size,
        }  # fmt: skip

    def counts(self) -> dict[str, Any]:
        """The size of the study, JSON-ready: units, conditions, candidates, levels and cases."""
        return {
            "units": self.shape[0],
            "conditions": [name for name in dict.fromkeys(self.cells["condition"]) if name],
            "candidates": list(dict.fromkeys(self.cells["title"])),
            "levels": {key: len(set(map(str, self.cells[key]))) for key in self.factors()},
            "cases": self.size,
        }

    def frame(self) -> pd.DataFrame:
        """The plan as a frame, one row a case."""
        import pandas as pd

        first = ("case_id", "unit", "flight", "condition", "candidate", "title", "split")
        order = dict.fromkeys([*(name for name in first if name in self.columns), *self.columns])
        return pd.DataFrame({name: self.columns[name] for name in order})

    def named(self, names: Iterable[str]) -> BoolArray:
        """The cases (u, c) that any of these names or case ids mean; `*` is for any letters.

        Raises:
            InputError: where a name is that of nothing in the study.
        """
        wanted: BoolArray = np.zeros(self.shape, dtype=bool)
        called = list(zip(*(self.cells[column] for column in self.called), strict=True))
        for name in names:
            units = [[fnmatchcase(str(unit), name)] for unit in self.units["unit"]]
            cells = [any(fnmatchcase(own, name) for own in each) for each in called]
            mine: BoolArray = np.array(units) | np.array(cells)
            if not mine.any() and name in self.place_of:
                mine.flat[self.place_of[name]] = True
            if not mine.any():
                near = suggestion(name, {own for each in called for own in each})
                words = ", ".join((*self.called, "unit")).replace("backend", "back-end")
                study = f"nothing in study {self.definition.name} is called"
                raise InputError(f'{study} "{name}"{near}; give a {words} or case id')
            wanted |= mine
        return wanted


def code_version(plugin: str = "") -> str:
    """The version of the code, `0.4.0+1a2b3c4d`, and of a plug-in's distribution."""
    return f"{metadata.version('sparsefit')}+{_digest()} {plugin}".rstrip()


@cache
def _digest() -> str:
    """The first 8 digits of the sha256 of `sources` without words, equal on every machine."""
    total = hashlib.sha256()
    package = Path(__file__).parents[1]
    for path in sources():
        text = without_words(path.read_text(encoding="utf-8"))
        total.update(f"{path.relative_to(package).as_posix()}\0{text}\0".encode())
    return total.hexdigest()[:8]


def sources() -> Iterator[Path]:
    """The source files of the package that can change a number, in order."""
    package = Path(__file__).parents[1]
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


def versions() -> dict[str, str | None]:
    """Versions of sparsefit, Python and numerical packages; None for those not installed."""
    numbers: dict[str, str | None] = {"python": platform.python_version()}
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
