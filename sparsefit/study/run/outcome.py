"""What a worker tells of a case: the stage that begins, and how it ended."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TypeAlias

from sparsefit.study.run.columns import Value
from sparsefit.study.run.solver_columns import EVERY_KIND

READING = "reading the weights"  # the stage that ends a fit; every other one begins something


@dataclass(frozen=True)
class Stage:
    """What begins now, for which cells; if it hangs or dies, they are the ones it takes along.

    `fits` is how many fits the stage makes: the time it may take is that many case timeouts.
    """

    name: str
    cells: tuple[int, ...]
    fits: int = 1


@dataclass(frozen=True)
class Outcome:
    """How the case of one flight and cell ended.

    `values` holds what was read for the columns of `cases.parquet`, by name; shared_seconds of its
    `seconds` [s] were spent for other fits too; weights: (length scale [m], weight) pairs;
    version: of the code that made it, where that is known.
    """

    flight: int
    cell: int
    status: str
    reason: str = ""
    values: Mapping[str, Value] = field(default_factory=dict)
    shared_seconds: float = 0.0
    weights: tuple[tuple[float, float], ...] = ()
    version: str = ""

    def __getitem__(self, column: str) -> Value:
        """What stands in a column of `cases.parquet` that is not planned."""
        if column in ("status", "reason", "version"):
            return str(getattr(self, column))
        return self.values.get(column, EVERY_KIND[column].empty)


Event: TypeAlias = Stage | Outcome
