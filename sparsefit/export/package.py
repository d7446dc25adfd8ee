"""What is exported, file by file: the C, how to build it, and a flight to test it with."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

import sparsefit
from sparsefit.arrays import IntArray
from sparsefit.errors import InputError
from sparsefit.export.model import nominal_step
from sparsefit.export.model_answer import DOUBTS, STATUS, Answer
from sparsefit.export.model_rows import microseconds
from sparsefit.export.plan import Plan
from sparsefit.export.source import body, filled, header
from sparsefit.flight import Flight
from sparsefit.logs import csv_file
from sparsefit.logs.table import FlightTable

TOLERANCE = {"double": 1e-9, "float": 1e-5}  # relative, of the C to its model in float64
ANSWERS = 12  # of a reference, over the flight
VALUES = (
    *("mean_velocity", "length_scale", "timescale", "grid_length_scale", "rival"),
    *("length_scale_error", "unexplained", "certificate"),
)


def package(
    plan: Plan, flight: Flight, tested: Sequence[Answer], told: dict[str, str]
) -> dict[str, bytes]:
    """The files of an export by their paths within its folder.

    flight: recorded, or simulated, which the test replays; its time stamps are whole microseconds
    from the first. tested: what the model answers on it, after some of its samples. told: of the
    header (`sparsefit.export.source.header`).
    """
    version, tolerance = sparsefit.__version__, repr(TOLERANCE[plan.real])
    values = {"version": version, "tolerance": tolerance, "scales": len(plan.scales)}
    texts = {
        "sf_flow.h": header(plan, told),
        "sf_flow.c": body(plan),
        "CMakeLists.txt": filled("CMakeLists.txt", values),
        "README.md": filled("README.md", values | told),
        "test/replay.c": filled("replay.c", {}),
        "test/reference.csv": reference_text(flight, tested),
    }
    recorded = csv_file.encode(FlightTable.from_flight(flight))
    return {path: text.encode() for path, text in texts.items()} | {"test/flight.csv": recorded}


def refuse_unlike(plan: Plan, flight: Flight) -> None:
    """Raise InputError where a flight is not one that the C can replay."""
    vehicle = flight.vehicle
    if flight.thrust is not None or vehicle.drag:
        raise InputError(
            "its vehicle has quadratic drag or a measured thrust, which the C does not; record a "
            "flight with linear drag and constant thrust, or leave --flight out"
        )
    if not flight.velocity_measured:
        raise InputError("it has no velocities, which the C needs; leave --flight out")
    if flight.samples < plan.window:
        raise InputError(
            f"its {flight.samples} samples are fewer than the window of {plan.window}; use another"
        )
    if int(np.diff(microseconds(flight.time)).min()) < 1:
        raise InputError("two samples are less than a microsecond apart, the clock of the C")


def asked_at(flight: Flight, count: int = ANSWERS) -> IntArray:
    """The samples of a flight after which the reference has answers, the last one too."""
    last = flight.samples - 1
    return np.unique(np.rint(np.linspace(last / count, last, count)).astype(np.intp))


def reference_text(flight: Flight, told: Sequence[Answer]) -> str:
    """A reference as CSV: what the model answers, in the order of the C's enumerations."""
    lines = [
        f"# sample_us={nominal_step(microseconds(flight.time))}",
        ",".join(("sample", "status", "doubt", "rows", "refined", *VALUES)),
    ]
    for answer in told:
        states = (answer.sample, STATUS.index(answer.status), DOUBTS.index(answer.doubt))
        numbers = (repr(float(getattr(answer, name))) for name in VALUES)
        lines.append(",".join(map(str, (*states, answer.rows, int(answer.refined), *numbers))))
    return "\n".join(lines) + "\n"
