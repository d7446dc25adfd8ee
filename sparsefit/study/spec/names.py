"""What the cases of a study are called where their rows are kept, and which case a name is of.

A row belongs to what determines its numbers. Of a flight that is its number, beside the digest of
the cell; of a problem of a study of solvers a digest of its own stands before that of the cell.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from functools import cached_property

SPLIT = "."


class Names:
    """The names of all cases, flights (or problems) by cells.

    cells: a name for each cell, in plan order; count: how many flights; rows: a name for each
    flight, None where a flight is known by its number.
    """

    def __init__(self, cells: Sequence[str], count: int, rows: Sequence[str] | None = None) -> None:
        self._cells, self._count, self._rows = cells, count, rows

    def of(self, flight: int, cell: int) -> str:
        """The name of a case."""
        name = self._cells[cell]
        return name if self._rows is None else f"{self._rows[flight]}{SPLIT}{name}"

    def at(self, flight: int, name: str) -> tuple[int, int] | None:
        """(flight, cell) of the case that a row is of; None where it is not planned.

        flight: the number that the row tells, which counts where flights have no names.
        """
        row, _, last = name.rpartition(SPLIT)
        number = flight if self._rows is None else self._place_of_row.get(row, -1)
        cell = self._place_of_cell.get(last if self._rows is not None else name)
        return None if cell is None or not 0 <= number < self._count else (number, cell)

    @cached_property
    def _place_of_cell(self) -> dict[str, int]:
        return {name: place for place, name in enumerate(self._cells)}

    @cached_property
    def _place_of_row(self) -> dict[str, int]:
        return {name: place for place, name in enumerate(self._rows or ())}


def numbered(names: Iterable[str]) -> tuple[str, ...]:
    """The names, the second of equal ones told by `-2`: they differ in what is not in them."""
    seen: Counter[str] = Counter()
    return tuple(_next(name, seen) for name in names)


def _next(name: str, seen: Counter[str]) -> str:
    seen[name] += 1
    return name if seen[name] == 1 else f"{name}-{seen[name]}"
