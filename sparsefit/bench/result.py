"""What a benchmark measured: one frozen record that the tables and the picture read."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from sparsefit.bench.contender import Contender
from sparsefit.bench.measure import Reach, Run, reach
from sparsefit.bench.ours import OURS
from sparsefit.bench.problems import Kind
from sparsefit.bench.robustness import Robustness
from sparsefit.bench.scaling import Scaling
from sparsefit.bench.side import CertificateShare, Ratio


@dataclass(frozen=True)
class ProblemSize:
    """Samples m, columns k and numerical rank of a named problem."""

    name: str
    samples: int
    columns: int
    rank: int


@dataclass(frozen=True)
class BestPeer:
    """Name and seconds of a peer ('' and infinity: none); ``at_least``: a lower bound."""

    name: str
    seconds: float
    at_least: bool


@dataclass(frozen=True, eq=False)
class BenchResult:
    """All measurements of one run of the benchmark."""

    sizes: tuple[ProblemSize, ...]
    contenders: tuple[Contender, ...]
    absent: Mapping[str, str]
    runs: tuple[Run, ...]
    shares: tuple[CertificateShare, ...]
    ratios: tuple[Ratio, ...]
    scalings: tuple[Scaling, ...]
    robustness: tuple[Robustness, ...]
    repeats: int
    points: int
    quick: bool
    seconds: float

    @property
    def problems(self) -> tuple[str, ...]:
        """Names of the problems, in order."""
        return tuple(size.name for size in self.sizes)

    def of(self, kind: Kind, problem: str, contender: str) -> list[Run]:
        """The runs of one contender on one path, loosest setting first."""
        key = (kind, problem, contender)
        return [run for run in self.runs if (run.kind, run.problem, run.contender) == key]

    def reach(
        self, kind: Kind, problem: str, contender: str, level: float, measure: str = "sub"
    ) -> Reach:
        """When a contender reaches a level on a path."""
        return reach(self.of(kind, problem, contender), level, measure)

    def ours(self, kind: Kind, problem: str, name: str = OURS) -> float:
        """CPU seconds of our path."""
        runs = self.of(kind, problem, name)
        return runs[0].median if runs else float("nan")

    def best_peer(
        self, kind: Kind, problem: str, level: float = 1e-8, measure: str = "sub"
    ) -> BestPeer:
        """The fastest public peer to reach a level.

        A peer that was stopped for taking too long counts with its last run: a lower bound.
        """
        found = BestPeer("", math.inf, at_least=False)
        for contender in self.contenders:
            if contender.peer and contender.installed:
                at = self.reach(kind, problem, contender.name, level, measure)
                seconds = at.seconds if at.seconds is not None else at.at_least
                if seconds is not None and seconds < found.seconds:
                    found = BestPeer(contender.name, seconds, at_least=at.seconds is None)
        return found


def geometric_mean(values: list[float]) -> float:
    """Geometric mean; NaN of nothing."""
    return float(np.exp(np.mean(np.log(values)))) if values else float("nan")
