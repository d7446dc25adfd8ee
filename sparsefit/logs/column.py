"""A column of a table, as texts or as what its file holds: to numbers, and to times."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime
from typing import Any, TypeAlias

import numpy as np

from sparsefit.arrays import Array, IntArray
from sparsefit.errors import InputError
from sparsefit.logs.anchor import moment_at, moment_of
from sparsefit.logs.layout import is_number
from sparsefit.logs.table import finite_in, number

Cells: TypeAlias = "list[str] | np.ndarray[Any, Any]"
"""Texts, or an array of numbers or of moments (``datetime64``)."""
_NEITHER = "neither a finite number nor an ISO time, 2012-07-22T14:15:00"


@dataclass(frozen=True, eq=False)
class Column:
    """The cells of one column.

    Args:
        name: of the column, as the header spells it.
        cells: its values, a row each.
        row: what a row, counted from 0, is called in the file: ``line 7``.
        commas: whether a comma in a number is a decimal mark.
    """

    name: str
    cells: Cells
    row: Callable[[int], str]
    commas: bool = False

    def taken(self, kept: IntArray) -> Column:
        """The same column of some of the rows."""
        if isinstance(self.cells, np.ndarray):
            cells: Cells = self.cells[kept]
        else:
            cells = [self.cells[row] for row in kept]
        return Column(self.name, cells, lambda row: self.row(int(kept[row])), self.commas)

    def words(self) -> list[str]:
        """Every cell as text; whole numbers without a point."""
        if isinstance(self.cells, np.ndarray):
            return [str(cell).removesuffix(".0") for cell in self.cells.tolist()]
        return [cell.strip() for cell in self.cells]

    @property
    def tells_moments(self) -> bool:
        """Whether the first cell is a time of a calendar, or at least no number."""
        if isinstance(self.cells, np.ndarray):
            return bool(self.cells.dtype.kind == "M")
        return bool(self.cells) and not is_number(self.cells[0])

    def numbers(self) -> Array:
        """The numbers (m,). Raises InputError, naming the row, where a cell is none."""
        if isinstance(self.cells, np.ndarray):
            if self.tells_moments:
                raise InputError(f"column {self.name} holds times; it must hold numbers")
            values, texts = self.cells.astype(np.float64), []
        else:
            texts = self._with_points(self.cells)
            values = _floats(texts)
        if not np.isfinite(values).all() or any("_" in text for text in texts):
            self._refuse(texts or list(map(str, values.tolist())))
        return values

    def _refuse(self, texts: list[str]) -> None:
        """Raise InputError of the first cell that is no number, saying how many there are."""
        row, *others = (row for row, text in enumerate(texts) if math.isnan(finite_in(text)))
        more = f" and {len(others)} more such rows (a gap is mended)" if others else ""
        number(texts[row], f"{self.row(row)}, column {self.name}", more)

    def _with_points(self, texts: list[str]) -> list[str]:
        if not self.commas or not any("," in text for text in texts):
            return texts
        if any("." in text for text in texts):
            words = f"column {self.name} has numbers with commas and with points"
            raise InputError(f"{words}; write them without marks between thousands")
        return [text.replace(",", ".") for text in texts]

    def since_first(self) -> tuple[Array, datetime | None]:
        """Seconds since the first moment (m,), and when that was.

        Raises:
            InputError: naming the row, where a cell is no ISO time.
        """
        if isinstance(self.cells, np.ndarray):
            empty = np.flatnonzero(np.isnat(self.cells))
            if len(empty):
                place = f"{self.row(int(empty[0]))}, column {self.name}"
                raise InputError(f"{place} is empty; repair or drop it")
            if not len(self.cells):
                return np.zeros(0), None
            epoch = moment_at(int(self.cells[0].astype("datetime64[us]").astype(np.int64)))
            return (self.cells - self.cells[0]) / np.timedelta64(1, "s"), epoch
        moments: list[datetime] = []
        for row, text in enumerate(self.cells):
            moment = moment_of(text)
            if moment is None:
                kind = "not an ISO time as those before" if row else _NEITHER
                place = f"{self.row(row)}, column {self.name}"
                raise InputError(f"{place}: {text.strip()[:40]!a} is {kind}; repair or drop it")
            moments.append(moment)
        seconds = [(moment - moments[0]).total_seconds() for moment in moments]
        return np.array(seconds), moments[0]


def _floats(texts: list[str]) -> Array:
    """The numbers that texts are; NaN alone where one is none."""
    try:
        return np.fromiter(map(float, texts), np.float64, len(texts))
    except ValueError:
        return np.full(1, np.nan)
