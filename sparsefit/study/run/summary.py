"""What a run did, and how far a study is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path


@dataclass(frozen=True)
class RunSummary:
    """What a run did: `resumed` rows were there before; `statuses` counts all rows.

    `solver_seconds` of `processes` times `seconds` were spent in the back-ends. `stale` rows are
    of other code than this; `dropped` ones were of cases that the study no longer plans, and
    `damaged` ones could not be read.
    """

    folder: Path
    planned: int
    resumed: int
    statuses: Mapping[str, int]
    seconds: float
    solver_seconds: float = 0.0
    processes: int = 1
    computed: int = 0
    stale: int = 0
    dropped: int = 0
    damaged: int = 0

    @property
    def done(self) -> int:
        """How many rows there are."""
        return sum(self.statuses.values())

    @property
    def finished(self) -> bool:
        """Whether every planned case is a row."""
        return self.done == self.planned

    @property
    def nothing_to_do(self) -> bool:
        """Whether all that was asked for was there before."""
        return self.computed == 0


@dataclass(frozen=True)
class RunStatus:
    """How far a study is, finished or not: counts of its rows by status and by version.

    `stale` rows are of other code than this.
    """

    folder: Path
    planned: int
    done: int
    finished: bool
    statuses: Mapping[str, int]
    stale: int = 0
    versions: Mapping[str, int] = field(default_factory=dict)
