"""How long one estimate takes and how much memory, measured as it would be deployed.

One candidate at a time in a process of its own, on one core with one thread, one flight after the
other, from the record of the flight to the answer. The first flights warm it up and do not count.
A flight during which the wall clock ran ahead of the processor's is timed again; where it does so
again another program has the core, and the processor's own time stands in.
"""

from __future__ import annotations

import json
import math
import multiprocessing
import os
import platform
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

from sparsefit.child import Child
from sparsefit.codec import finite_or_none
from sparsefit.flight import Flight
from sparsefit.study.run.manifest import processor, read_record, sparsefit_version
from sparsefit.study.spec.design import Cell
from sparsefit.study.spec.draw import SIMULATION, stream
from sparsefit.study.spec.study import Study
from sparsefit.whole_file import write_whole

LATENCY = "latency.json"
WARM_UP = 2
AHEAD = 1.1  # wall clock over processor time: more, and something else had the core
TICK = 2e-4  # seconds by which the two clocks may differ anyway
BUDGET = 15.0  # seconds for a candidate; a slow one is timed on fewer flights, and says so
FEWEST = 10  # flights, whatever they take
PATIENCE = 60.0  # seconds to start


@dataclass(frozen=True)
class Latency:
    """Seconds of one estimate, over `flights` of them, and the peak memory of its process [MB].

    busy: the share of flights that another program disturbed, of which processor time is told.
    Infinite where the process died or was ended.
    """

    median: float
    p99: float
    memory: float
    flights: int
    busy: float = 0.0

    @classmethod
    def failed(cls) -> Latency:
        """What is known of a process that gave no time."""
        return cls(math.inf, math.inf, math.inf, 0)


Trials = Mapping[str, Sequence[Cell]]  # the cells of each candidate, one for each of its worlds


def measure(
    study: Study,
    trials: Trials,
    flights: int,
    *,
    progress: Callable[[int, int], None] | None = None,
) -> dict[str, Latency]:
    """Time `flights` estimates of every candidate, the worlds of the study in turn.

    The flights are those that a candidate is chosen on.
    """
    measured = {}
    for done, (name, cells) in enumerate(trials.items()):
        if progress:
            progress(done, len(trials))
        measured[name] = _of_one(replace(study, cells=tuple(cells)), flights)
    return measured


def _of_one(study: Study, flights: int) -> Latency:
    method = "forkserver" if "forkserver" in multiprocessing.get_all_start_methods() else "spawn"
    if method == "forkserver":  # imported once, by what all are forked from
        multiprocessing.get_context(method).set_forkserver_preload([__name__])
    ours, theirs = multiprocessing.Pipe(duplex=False)
    child = Child.start(_timed, study, flights, theirs, method=method)
    theirs.close()
    try:
        limit = PATIENCE + BUDGET + 2.0 * (WARM_UP + FEWEST) * study.case_timeout
        latency: Latency = ours.recv() if ours.poll(limit) else Latency.failed()
    except EOFError:
        latency = Latency.failed()
    finally:
        child.kill()
        ours.close()
    return latency


def _timed(study: Study, flights: int, pipe: Connection) -> None:
    _stay_on_one_core()
    times, busy, begun = [], 0, time.monotonic()
    for place in range(-WARM_UP, flights):
        cell, flown = _flight(study, max(place, 0))
        seconds, disturbed = _clocked(partial(study.estimator(cell).estimate, flown))
        if place >= 0:
            times.append(seconds)
            busy += disturbed
        if len(times) >= FEWEST and time.monotonic() - begun > BUDGET:
            break
    middle, late = np.quantile(times, [0.5, 0.99])
    pipe.send(Latency(float(middle), float(late), _peak(), len(times), busy / len(times)))


def _flight(study: Study, place: int) -> tuple[Cell, list[Flight]]:
    """The flights at a place of those to be timed: worlds in turn, then the next flight."""
    kept = [one for one in range(study.count) if study.split(one) != "evaluate"]
    cell = study.cells[place % len(study.cells)]
    number = kept[place // len(study.cells) % len(kept)]
    fleet = study.draw(number, cell).fleet(stream(study.seed, number, SIMULATION))
    return cell, [replace(flown, flow=None) for flown in fleet]


def _clocked(step: Callable[[], object]) -> tuple[float, bool]:
    """The time of a step [s], and whether only the processor's is known."""
    used = math.inf
    for _ in range(2):
        wall, before = time.perf_counter(), _processor_time()
        with suppress(Exception):  # a refusal takes its time too
            step()
        wall, used = time.perf_counter() - wall, min(used, _processor_time() - before)
        if wall <= AHEAD * used + TICK:
            return wall, False
    return used, True


def _processor_time() -> float:
    """Seconds of this process, and of those that it started and that have ended."""
    children = os.times()
    return time.process_time() + children.children_user + children.children_system


def _stay_on_one_core() -> None:
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})


def _peak() -> float:
    """The most memory that this process ever had [MB]; NaN where the system does not say."""
    if sys.platform == "win32":
        return math.nan
    import resource

    unit = 1e6 if sys.platform == "darwin" else 1e3
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit


def machine() -> dict[str, object]:
    """What the times are of: the processor, the system, the version and its load."""
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else math.nan
    known = {"processor": processor(), "system": platform.platform()}
    return {**known, "sparsefit": sparsefit_version(), "load": load}


def write_latency(study: Study, folder: Path, measured: Mapping[str, Latency]) -> None:
    """Write the times into the results folder, in a file of their own: no other machine's agree."""
    content = {
        "study_hash": study.hash,
        "machine": machine(),
        "candidates": {name: asdict(latency) for name, latency in measured.items()},
    }
    write_whole(folder / LATENCY, json.dumps(finite_or_none(content), indent=2) + "\n")


def read_latency(study: Study, folder: Path) -> dict[str, Latency]:
    """The times of these very candidates, from this version; none where there are no such."""
    content = read_record(folder / LATENCY) or {}
    try:
        made = content["study_hash"], content["machine"]["sparsefit"]
        if made != (study.hash, sparsefit_version()):
            return {}
        return {name: _latency(entry) for name, entry in content["candidates"].items()}
    except (AttributeError, ValueError, KeyError, TypeError):
        return {}


def _latency(entry: Mapping[str, float | None]) -> Latency:
    def read(name: str) -> float:
        value = entry[name]
        return math.inf if value is None else float(value)

    return Latency(read("median"), read("p99"), read("memory"), int(read("flights")), read("busy"))


def processor_of(folder: Path) -> str:
    """The processor that the stored times are of; empty where there are none."""
    told = (read_record(folder / LATENCY) or {}).get("machine")
    return str(told.get("processor", "")) if isinstance(told, dict) else ""
