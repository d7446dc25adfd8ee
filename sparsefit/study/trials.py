"""Candidates compared on the same units: a criterion with its interval, and constraints.

Numbers stand as arrays (candidates, units, regimes, cases). A regime is a condition of the study.

Latency and memory of one estimate are measured as in deployment. One candidate at a time runs in a
process of its own, on one core with one thread, one flight after the other, from the log to the
estimate; times are wall times by the parent's clock. The first flights are a warm-up. A flight
during which the machine was disturbed (`worker.disturbed`) is timed again; if it is disturbed
again, the CPU time takes the place of the wall time.
"""

from __future__ import annotations

import json
import math
import os
import platform
import time
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from sparsefit.arrays import Array
from sparsefit.codec import finite_or_none
from sparsefit.errors import InputError
from sparsefit.study import measures
from sparsefit.study.flight_experiment import FlightExperiment
from sparsefit.study.measures import ROUNDING, Measure, ends, mean, resampled
from sparsefit.study.plan import processor, versions
from sparsefit.study.store import read_record
from sparsefit.study.table import significant
from sparsefit.study.worker import Answer, NoAnswerError, Worker, disturbed, memory_limit
from sparsefit.whole_file import write_whole

LIMITS = {  # the quantity of a constraint, the factor to its unit, and the unit
    "max_failure": ("cases without an answer", 100.0, "%"),
    "max_silent_misses": ("silent misses", 100.0, "%"),
    "max_error": ("95th percentile of the largest error", 1.0, "%"),
    "max_latency_p99": ("99th percentile of the latency", 1e3, "ms"),
    "max_memory": ("peak memory", 1.0, "MB"),
}
LATENCY = "latency.json"
TIMED = {"max_latency_p99": "p99", "max_memory": "memory"}


@dataclass(frozen=True)
class Criterion:
    """A measure summarised over the units of each regime, and over the regimes.

    over: `average`, `worst`, or the name of a regime.
    """

    measure: Measure
    regimes: tuple[str, ...]
    over: str

    @property
    def words(self) -> str:
        """`mean |error| of τ_w, averaged over the regimes`."""
        where = {"average": "averaged over the regimes", "worst": "in the worst regime"}
        over = f", {where.get(self.over, f'in {self.over}')}"
        return self.measure.phrase + over * (len(self.regimes) > 1)

    @property
    def sign(self) -> float:
        """The factor by which a score becomes a loss, of which less is better."""
        return -1.0 if self.measure.more else 1.0

    def by_regime(self, grid: Array) -> Array:
        """Return the summary (..., regimes) of a grid (..., units, regimes, cases)."""
        return self.measure.reduce(pooled_regimes(grid))

    def loss(self, grid: Array) -> Array:
        """Return the one number (...,) of a grid (..., units, regimes, cases), less is better."""
        losses = self.sign * self.by_regime(grid)
        if self.over == "average":
            return mean(losses)
        if self.over == "worst":
            return np.asarray(np.fmax.reduce(losses, axis=-1))  # passes over NaN
        return np.asarray(losses[..., self.regimes.index(self.over)])

    def say(self, value: float) -> str:
        """Return a value of the criterion with its unit."""
        return f"{significant(value)} {self.measure.unit}".rstrip()


def pooled_regimes(grid: Array) -> Array:
    """Return (..., regimes, all) of (..., units, regimes, cases)."""
    swapped = np.moveaxis(grid, -3, -2)
    return swapped.reshape(*swapped.shape[:-2], -1)


@dataclass(frozen=True)
class Breach:
    """A constraint that a candidate violates: the regime, the value there and the limit."""

    constraint: str
    regime: str
    value: float
    limit: float

    @property
    def words(self) -> str:
        """`silent misses 5 % in turbulence 30 %, 1 % is the most`."""
        where = f" in {self.regime}" if self.regime else ""
        value, limit = (limit_text(self.constraint, each) for each in (self.value, self.limit))
        return f"{LIMITS[self.constraint][0]} {value}{where}, {limit} is the most"


def limit_text(constraint: str, value: float) -> str:
    """Return a value of a constraint with its unit."""
    _, factor, unit = LIMITS[constraint]
    if math.isinf(value) and constraint in TIMED:
        return "not measured"
    return f"{significant(factor * value).removesuffix('.00').removesuffix('.0')} {unit}"


@dataclass(frozen=True)
class Difference:
    """A difference with its 95 % interval.

    identical: whether both candidates have equal values, to rounding, in every case.
    """

    effect: float
    low: float
    high: float
    identical: bool = False

    @property
    def tie(self) -> bool:
        """Whether the interval contains 0; for a single unit, whether the values are identical."""
        return self.identical or self.low <= 0.0 <= self.high


class Trials:
    """The cases of a split as a grid (candidates, units, regimes, cases).

    loss (candidates,): of the criterion; drawn (candidates, resamples): of resampled units, the
    same ones for all candidates.
    """

    def __init__(self, cases: pd.DataFrame, candidates: Sequence[str], criterion: Criterion,
                 seed: int) -> None:  # fmt: skip
        """Place the cases of a split.

        Raises:
            InputError: if the candidates were not all tried on the same units and conditions.
        """
        self.cases, self.candidates, self.criterion = cases, candidates, criterion
        candidate = pd.Index(candidates).get_indexer(pd.Index(cases["candidate"]))
        regime = pd.Index(criterion.regimes).get_indexer(pd.Index(regimes_of(cases)))
        unit, units = pd.factorize(cases["flight"])
        self.at = (candidate, unit, regime)
        self.shape = (len(candidates), len(units), len(criterion.regimes))
        self.values = self.grid(criterion.measure.values(cases))
        count = self.grid(np.ones(len(cases)))
        unequal = (np.isnan(count) != np.isnan(count[:1])).any(axis=(1, 2, 3))
        if unequal.any():
            title = cases.loc[candidate == unequal.argmax(), "title"].iloc[:1]
            words = f"the same {unit_of(cases)}s as the others: finish the study first"
            first = ", ".join(title) or candidates[int(unequal.argmax())]
            raise InputError(f"{first} was not tried on {words} (sparsefit study run)")
        self.loss = criterion.loss(self.values)

        def drawn(own: Array) -> Array:
            return resampled(lambda at: criterion.loss(own[at]), len(own), own[0].size, seed)

        self.drawn = np.array(list(map(drawn, self.values)))

    def grid(self, values: Array) -> Array:
        """Return values (rows,) as a grid, NaN where a regime has fewer cases."""
        return measures.gridded(values, self.at, self.shape)

    def between(self, at: int) -> list[float]:
        """Return the 95 % interval of the criterion of a candidate."""
        return sorted(self.criterion.sign * end for end in ends(self.drawn[at]))

    def against(self, at: int, other: int) -> Difference:
        """Return the loss of a candidate less that of another, paired by unit."""
        pair, least = (self.values[at], self.values[other]), self.criterion.measure.least
        alike = np.allclose(*pair, rtol=ROUNDING, atol=least, equal_nan=True)
        with np.errstate(invalid="ignore"):  # two that fail wholly
            effect, drawn = self.loss[at] - self.loss[other], self.drawn[at] - self.drawn[other]
        return Difference(float(effect), *ends(drawn), bool(alike))

    def breaches(
        self, rule: Any, timed: Mapping[str, Mapping[str, float]]
    ) -> list[tuple[Breach, ...]]:
        """Return the constraints that each candidate violates, each in its worst regime.

        A candidate that violates another constraint need not be timed.
        """
        cases, flown = self.cases, measures.in_flow(self.cases)

        def by_regime(values: Array) -> Array:
            return pooled_regimes(self.grid(values))

        silent, error = (
            by_regime(measures.MEASURES[name].read(cases))
            for name in ("silent-misses", "largest-error")
        )
        largest = measures.quantile(error, 0.95)
        is_flown = (by_regime(flown.astype(float)) > 0).any(axis=-1)
        values = {
            "max_failure": mean(by_regime(measures.only(flown, ~measures.answered(cases)))),
            "max_silent_misses": mean(silent),
            "max_error": np.where(np.isnan(largest) & is_flown, np.inf, largest),
        }
        for name, column in TIMED.items():
            times = [timed.get(each, {}).get(column, math.inf) for each in self.candidates]
            values[name] = np.array(times)[:, None]
        every = [list[Breach]() for _ in self.candidates]
        for name, levels in values.items():
            if (limit := getattr(rule, name)) is None:
                continue
            for broken, own in zip(every, np.where(np.isnan(levels), -np.inf, levels), strict=True):
                place = int(own.argmax())
                untimed = name in TIMED and np.isinf(own[place])
                if own[place] > limit and not (untimed and broken):
                    where = self.criterion.regimes[place] if len(own) > 1 else ""
                    broken.append(Breach(name, where, float(own[place]), limit))
        return [tuple(broken) for broken in every]


def unit_of(cases: pd.DataFrame) -> str:
    """Return the word for a unit."""
    return "problem" if "objective" in cases else "flight"


def regimes_of(cases: pd.DataFrame) -> pd.Series:
    """Return the regime of each case: its condition."""
    return cases["condition"].astype(str).replace("", "everywhere")


@dataclass(frozen=True)
class Latency:
    """Times [s] of one estimate over a number of flights, and the peak memory [MB] of its process.

    busy: the share of flights that were disturbed twice. All infinite where the process died or was
    killed at its limit, and where no flight can be simulated.
    """

    median: float
    p99: float
    memory: float
    flights: int
    busy: float = 0.0


def measured(plan: FlightExperiment, cells: Sequence[int], flights: int) -> Latency:
    """The latency of a candidate over flights of splits other than `evaluate`.

    cells: of the candidate, one a condition, which take turns. A slow candidate is timed on fewer
    flights, at least 10.
    """
    limit, memory = plan.definition.run.case_timeout, plan.definition.run.max_memory
    units = [unit for unit in range(plan.count) if plan.split(unit) != "evaluate"]
    begun, times, busy, peak = time.monotonic(), list[float](), 0, None
    with closing(Worker(*plan.desk(""), memory=memory_limit(memory, 1))) as worker:
        for place in (0, 0, *range(flights)):  # two to warm up
            unit = units[place // len(cells) % len(units)]
            content = {"unit": unit, "cells": [cells[place % len(cells)]]}
            runs: list[Answer] = []
            try:
                while len(runs) < 2:
                    peak = worker.ask("ready", content, limit).content.get("memory")
                    runs.append(run := worker.ask("estimate", content, limit, timed=True))
                    if not (late := disturbed(run.wall, run.cpu)):
                        break
            except NoAnswerError as failed:
                if failed.lost:
                    times.clear()
                    break
                continue  # a flight that cannot be simulated is not timed
            times.append(min(run.cpu for run in runs) if late else run.wall)
            busy += late and len(times) > 2
            if len(times) >= 12 and time.monotonic() - begun > 15.0:
                break
    del times[:2]
    if not times:
        return Latency(math.inf, math.inf, math.inf, 0)
    median, p99 = map(float, np.quantile(times, [0.5, 0.99]))
    return Latency(median, p99, peak or math.nan, len(times), busy / len(times))


def write_latencies(study_hash: str, folder: Path, measured: Mapping[str, Latency]) -> None:
    """Write `latency.json` into the results folder, with the machine that was timed."""
    candidates = {name: asdict(latency) for name, latency in measured.items()}
    machine: dict[str, object] = {"processor": processor(), "system": platform.platform()}
    machine |= {"load": os.getloadavg()[0], "sparsefit": versions()["sparsefit"]}
    content = {"study_hash": study_hash, "machine": machine, "candidates": candidates}
    write_whole(folder / LATENCY, json.dumps(finite_or_none(content), indent=2) + "\n")


def read_latencies(study_hash: str, folder: Path) -> dict[str, Latency]:
    """The stored latencies of this study and this version of sparsefit; empty without any."""
    content, stored = read_record(folder / LATENCY) or {}, {}
    try:
        made = (content["study_hash"], content["machine"]["sparsefit"])
        for name, entry in content["candidates"].items():
            numbers = {key: math.inf if v is None else float(v) for key, v in entry.items()}
            flights = int(numbers.pop("flights"))
            stored[name] = Latency(flights=flights, **numbers)
    except (AttributeError, ValueError, KeyError, TypeError, OverflowError):
        return {}
    return stored if made == (study_hash, versions()["sparsefit"]) else {}
