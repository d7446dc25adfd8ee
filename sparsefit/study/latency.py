"""Latency and memory of one estimate, measured as in deployment.

One candidate at a time runs in a process of its own, on one core with one thread, one flight after
the other, from the log to the estimate; times are wall times by the parent's clock. The first
flights are a warm-up. A flight during which the machine was disturbed (`worker.disturbed`) is timed
again; if it is disturbed again, the CPU time takes the place of the wall time.
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

import numpy as np

import sparsefit
from sparsefit.codec import finite_or_none
from sparsefit.study.flight_experiment import FlightExperiment
from sparsefit.study.manifest import processor, read_record
from sparsefit.study.worker import Answer, NoAnswerError, Worker, disturbed, memory_limit
from sparsefit.whole_file import write_whole

LATENCY = "latency.json"


@dataclass(frozen=True)
class Latency:
    """Times [s] of one estimate over a number of flights, and the peak memory [MB] of its process.

    busy: the share of flights that were disturbed twice. All infinite where the process died or was
    killed at its limit.
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
                    return Latency(math.inf, math.inf, math.inf, 0)
                continue  # a flight that cannot be simulated is not timed
            times.append(min(run.cpu for run in runs) if late else run.wall)
            busy += late and len(times) > 2
            if len(times) >= 12 and time.monotonic() - begun > 15.0:
                break
    del times[:2]
    median, p99 = map(float, np.quantile(times, [0.5, 0.99]))
    return Latency(median, p99, peak or math.nan, len(times), busy / len(times))


def write_latencies(study_hash: str, folder: Path, measured: Mapping[str, Latency]) -> None:
    """Write `latency.json` into the results folder, with the machine that was timed."""
    candidates = {name: asdict(latency) for name, latency in measured.items()}
    machine: dict[str, object] = {"processor": processor(), "system": platform.platform()}
    machine |= {"load": os.getloadavg()[0], "sparsefit": sparsefit.__version__}
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
    return stored if made == (study_hash, sparsefit.__version__) else {}
