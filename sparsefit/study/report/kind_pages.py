"""What a study answers and how it is shown, of either kind of study."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import pandas as pd

from sparsefit.errors import one_of
from sparsefit.study.evidence.answers import sentences
from sparsefit.study.evidence.solver_answers import sentences as solver_sentences
from sparsefit.study.evidence.solver_tables import NAMES
from sparsefit.study.evidence.solver_tables import tables_of as solver_tables_of
from sparsefit.study.evidence.table import Table
from sparsefit.study.evidence.tables import TABLES, tables_of
from sparsefit.study.report.pages import check_outputs, render_show, write_report
from sparsefit.study.report.render import to_text
from sparsefit.study.report.solver_pages import render_solvers, write_solver_report
from sparsefit.study.run.folder import WEIGHTS
from sparsefit.study.run.store import read_weights
from sparsefit.study.spec.identity import AnyStudy
from sparsefit.study.spec.solver_study import SolverStudy
from sparsefit.study.spec.study import Study


class Pages(Protocol):
    """A study, and how its cases are shown."""

    def check(self) -> None:
        """Raise InputError where the study asks for a table, a picture or an answer of no name."""
        ...

    def check_tables(self, names: tuple[str, ...]) -> None:
        """Raise InputError on a name of no table."""
        ...

    def sentences(self, cases: pd.DataFrame) -> list[str]:
        """What the study answers."""
        ...

    def tables(self, cases: pd.DataFrame, names: tuple[str, ...] = ()) -> dict[str, Table]:
        """The tables of these names; without names those of the study."""
        ...

    def show(self, cases: pd.DataFrame, *, width: int) -> str:
        """What a reader asks first, for a terminal."""
        ...

    def main_table(self, cases: pd.DataFrame, *, width: int) -> str:
        """The table that says most, for a terminal."""
        ...

    def who(self, cases: pd.DataFrame) -> list[str]:
        """Whose case each row is, in words."""
        ...

    def write(self, results: str | Path, cases: pd.DataFrame) -> list[Path]:
        """Write tables, pictures and pages beside the cases; the files, README.md last."""
        ...


def pages_of(study: AnyStudy) -> Pages:
    """A study with how its cases are shown."""
    return SolverPages(study) if isinstance(study, SolverStudy) else FlightPages(study)


@dataclass(frozen=True)
class FlightPages:
    """A study of flights, as `Pages` asks for it."""

    study: Study

    def check(self) -> None:
        """Refuse outputs that are not known."""
        check_outputs(self.study)

    def check_tables(self, names: tuple[str, ...]) -> None:
        """Raise InputError on a name of no table."""
        for name in names:
            one_of("table", name, TABLES.named)

    def sentences(self, cases: pd.DataFrame) -> list[str]:
        """What the study answers."""
        return sentences(self.study, cases)

    def tables(self, cases: pd.DataFrame, names: tuple[str, ...] = ()) -> dict[str, Table]:
        """The tables of these names; without names those of the study."""
        named = {name: TABLES.make(name, self.study, cases) for name in names}
        return named or tables_of(self.study, cases)

    def show(self, cases: pd.DataFrame, *, width: int) -> str:
        """The question, the answers and all tables."""
        return render_show(self.study, cases, width=width)

    def main_table(self, cases: pd.DataFrame, *, width: int) -> str:
        """The first table."""
        return to_text(next(iter(tables_of(self.study, cases).values())), width=width)

    def who(self, cases: pd.DataFrame) -> list[str]:
        """What the study calls the back-end."""
        return [str(label) for label in cases["label"]]

    def write(self, results: str | Path, cases: pd.DataFrame) -> list[Path]:
        """Write tables, figures and pages, of the weights too where they were kept."""
        folder = Path(results) / self.study.name
        weights = read_weights(folder) if (folder / WEIGHTS).exists() else None
        return write_report(self.study, results, cases, weights)


@dataclass(frozen=True)
class SolverPages:
    """A study of solvers, as `Pages` asks for it."""

    study: SolverStudy

    def check(self) -> None:
        """It asks for no outputs by name."""

    def check_tables(self, names: tuple[str, ...]) -> None:
        """Raise InputError on a name that no table begins with."""
        for name in names:
            one_of("table", name, NAMES if name.partition("-")[0] not in NAMES else (name,))

    def sentences(self, cases: pd.DataFrame) -> list[str]:
        """Who is fastest, by how much, and who is missing."""
        return solver_sentences(self.study, cases)

    def tables(self, cases: pd.DataFrame, names: tuple[str, ...] = ()) -> dict[str, Table]:
        """The tables whose names begin with these; without names all."""
        tables = solver_tables_of(self.study, cases)
        for name in names:
            one_of("table", name, (*NAMES, *tables))
        return {key: table for key, table in tables.items() if key.startswith(names or ("",))}

    def show(self, cases: pd.DataFrame, *, width: int) -> str:
        """The question, the answers, the summary and who failed."""
        return render_solvers(self.study, cases, width=width)

    def main_table(self, cases: pd.DataFrame, *, width: int) -> str:
        """The summaries."""
        tables = self.tables(cases, ("summary",)).values()
        return "\n".join(to_text(table, width=width) for table in tables)

    def who(self, cases: pd.DataFrame) -> list[str]:
        """The solver and what it solves."""
        pairs = zip(cases["solver"], cases["objective"], strict=True)
        return [f"{solver} of {objective}" for solver, objective in pairs]

    def write(self, results: str | Path, cases: pd.DataFrame) -> list[Path]:
        """Write tables, pictures and pages."""
        return write_solver_report(self.study, results, cases)
