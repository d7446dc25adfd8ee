"""How long one estimate takes and how much memory, measured as it would be deployed.

One candidate at a time in a process of its own, on one core with one thread, one flight after the
other, from the record of the flight to the answer, by the parent's clock. The first flights warm it
up and do not count. A flight during which the wall ran ahead of the CPU is timed again; where it
does so again another program has the core, and the CPU's own time stands in.
"""

from __future__ import annotations

import json
import math
import os
import platform
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

import sparsefit
from sparsefit.codec import finite_or_none
from sparsefit.study.definition import Definition
from sparsefit.study.flight_desk import FlightDesk
from sparsefit.study.manifest import processor, read_record
from sparsefit.study.worker import Answer, Ask, Worker, disturbed, memory_limit
from sparsefit.whole_file import write_whole

LATENCY = "latency.json"


@dataclass(frozen=True)
class Latency:
    """Seconds [s] of one estimate, over `flights` of them, and the peak memory [MB] of its process.

    busy: the share of flights that another program disturbed, of which CPU time is told. Infinite
    where the process died or was ended.
    """

    median: float
    p99: float
    memory: float
    flights: int
    busy: float = 0.0


def measured(definition: Definition, cells: Sequence[int], flights: int) -> Latency:
    """The times of `flights` estimates of a candidate, its cells, so conditions, in turn.

    They are of the flights that it is chosen on. A slow candidate is timed on fewer, 10 at least,
    and says so.
    """
    design, limit = definition.flights, definition.rules.case_timeout
    units = [unit for unit in range(design.count) if design.split(unit) != "evaluate"]
    memory = memory_limit(definition.rules.max_memory, 1)
    worker = Worker.start(FlightDesk, (definition,), memory=memory)
    begun, times, busy = time.monotonic(), list[float](), 0
    try:
        for place in (0, 0, *range(flights)):  # two to warm up
            unit = units[place // len(cells) % len(units)]
            content = {"unit": unit, "cells": [cells[place % len(cells)]]}
            runs: list[Answer] = []
            while len(runs) < 2:
                run = worker.wait(Ask("ready", content, limit))
                if not run.lost:
                    run = worker.wait(Ask("estimate", content, limit, timed=True))
                if run.lost:
                    return Latency(math.inf, math.inf, math.inf, 0)
                runs.append(run)
                if not (late := disturbed(run.wall, run.cpu)):
                    break
            times.append(min(run.cpu for run in runs) if late else run.wall)
            busy += late and len(times) > 2
            if len(times) >= 12 and time.monotonic() - begun > 15.0:
                break
        peak = worker.wait(Ask("ready", content, limit)).content.get("memory")
    finally:
        worker.close()
    del times[:2]
    median, p99 = map(float, np.quantile(times, [0.5, 0.99]))
    return Latency(median, p99, peak or math.nan, len(times), busy / len(times))


def write_latencies(study_hash: str, folder: Path, measured: Mapping[str, Latency]) -> None:
    """Write the times into the results folder, in a file of their own: no other machine's agree."""
    candidates = {name: asdict(latency) for name, latency in measured.items()}
    machine: dict[str, object] = {"processor": processor(), "system": platform.platform()}
    machine |= {"load": os.getloadavg()[0], "sparsefit": sparsefit.__version__}
    content = {"study_hash": study_hash, "machine": machine, "candidates": candidates}
    write_whole(folder / LATENCY, json.dumps(finite_or_none(content), indent=2) + "\n")


def read_latencies(study_hash: str, folder: Path) -> dict[str, Latency]:
    """The times of this study's candidates, by this version; none where there are no such."""
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
