"""The plan of a study: every case, before any is run, and what several of them share."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

from sparsefit.study.spec.design import Cell
from sparsefit.study.spec.study import Study


class Case(NamedTuple):
    """One flight x one cell: one row of `cases.parquet`."""

    flight: int
    cell: Cell

    @property
    def case_id(self) -> str:
        """Readable by flight, stable from run to run: `0007-3f9c0d6a41b2e857`."""
        return f"{self.flight:04d}-{self.cell.key}"


@dataclass(frozen=True)
class Counts:
    """How large a study is: numbers of flights, protocols, levels by factor, settings by label.

    simulations, problems, fits: the work to be done, what is shared counted once; cases: the rows.
    """

    flights: int
    protocols: int
    levels: Mapping[str, int]
    settings: Mapping[str, int]
    simulations: int
    problems: int
    fits: int
    cases: int


def cells(study: Study) -> tuple[Cell, ...]:
    """Every cell of a study, in plan order."""
    return study.cells


def plan(study: Study) -> tuple[Case, ...]:
    """Every case, flight by flight, in the order of the rows of `cases.parquet`."""
    return tuple(Case(flight, cell) for flight in range(study.count) for cell in study.cells)


def counts(study: Study) -> Counts:
    """What a run of the study has to do."""
    return Counts(
        flights=study.count,
        protocols=len(study.protocols),
        levels={factor.key: len(factor.levels) for factor in study.sweep},
        settings={choice.label: choice.size for choice in study.backends},
        simulations=study.count * len(sharing(study.cells, flight_key)),
        problems=study.count * len(sharing(study.cells, problem_key)),
        fits=study.count * len(sharing(study.cells, fit_key)),
        cases=study.planned,
    )


def flight_key(cell: Cell) -> Hashable:
    """Cells of equal key fly the same flight."""
    return cell.setup.flights


def problem_key(cell: Cell) -> Hashable:
    """Cells of equal key solve the same regression problem."""
    return (cell.setup.flights, cell.setup.derivative, cell.setup.library, cell.setup.online)


def fit_key(cell: Cell) -> Hashable:
    """Cells of equal key read the same fit."""
    return (problem_key(cell), cell.choice, cell.canonical_settings)


def sharing(cells: Iterable[Cell], key: Callable[[Cell], Hashable]) -> list[tuple[Cell, ...]]:
    """The cells in groups of equal key, in order of first appearance."""
    groups: dict[Hashable, list[Cell]] = {}
    for cell in cells:
        groups.setdefault(key(cell), []).append(cell)
    return [tuple(group) for group in groups.values()]
