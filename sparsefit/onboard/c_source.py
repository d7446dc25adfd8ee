"""Export of an estimator as C99: `templates/` with its settings, and a test.

The settings of the estimator are the macro ``SF_SETTINGS`` of the header. The test replays a flight
and compares with the same recurrence in Python (`sparsefit.onboard.board`).
"""

from __future__ import annotations

import math
from dataclasses import asdict
from importlib.metadata import version
from importlib.resources import files
from typing import Any, Literal

from sparsefit.errors import InputError, one_line, one_of
from sparsefit.estimator import Estimator
from sparsefit.flight import Flight, simulate_flight
from sparsefit.flight.flow import CellularFlow
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.logs import csv_file
from sparsefit.logs.flight_table import FlightTable
from sparsefit.onboard.board import LEVELS, board_of
from sparsefit.onboard.online import board_settings, refusal, samples_of
from sparsefit.onboard.sweep import PEAKS, ROWS

Real = Literal["double", "float"]
TOLERANCES: dict[Real, float] = {"double": 1e-6, "float": 1e-3}
EVERY = 50  # samples between the answers of the reference
CLOCK = 400e6  # of an example processor [Hz]
CYCLES = {"float": (3, 20, 120), "double": (6, 40, 400)}  # of a sum or product, a quotient, a sine
FILES = ("sf_flow.h", "sf_flow.c", "CMakeLists.txt", "README.md", "test/replay.c")
_VEHICLE = ("response_time", "drag_coefficient", "thrust_x", "thrust_y", "thrust_scale")


def ram(real: Real) -> int:
    """Return the bytes of the state: `sizeof(sf_flow)` rounded up to 64."""
    reals = 50 + 4 * ROWS + 9 * PEAKS + len(LEVELS) * (12 + 144 + 3 + 4)
    return math.ceil((reals * (8 if real == "double" else 4) + 96) / 64) * 64


def costs(real: Real, candidates: int) -> list[str]:
    """Return lines of text: RAM, and the largest work and time per sample.

    A sample is followed by all filters in one step of the motion, or in up to 16 where it is longer
    than half of the response time; while searching it evaluates so many candidates.
    """
    filters, rows = len(LEVELS), candidates * ROWS
    sums = 430 + 1008 + 2592 + 4 * 374 + 160 + 1536  # motion, F, F P F', readings, memory, anchor
    lines = [f"RAM    {ram(real)} bytes, all of it `sf_flow`"]
    for name, counts in {
        "following (steps of tau/2 at most)": (filters * sums, filters * 60, filters * 30),
        "searching": (max(rows * 36, ROWS * 1200) + 8 * ROWS, candidates * 12, rows * 4),
    }.items():
        seconds = sum(map(math.prod, zip(counts, CYCLES[real], strict=True))) / CLOCK
        lines += [
            f"work   {name}: {counts[0]} sums and products, {counts[1]} quotients and roots, "
            f"{counts[2]} sines,",
            f"       cosines, logs a sample, at most: {1e6 * seconds:.0f} us at "
            f"{CLOCK / 1e6:.0f} MHz (cycles assumed, not measured)",
        ]
    return lines


def example_flight(estimator: Estimator, seed: int = 7) -> Flight:
    """Return a simulated flight of 1201 samples, with a length scale within the grid."""
    grid = estimator.library.grid
    flow = CellularFlow(15.0, min(math.sqrt(grid.lower * grid.upper), 4.0 * grid.lower))
    tau, step = 1.5 * flow.timescale, max(1, round(1e6 * 0.06 * flow.timescale)) * 1e-6
    vehicle = PointMassVehicle(tau, (3.0 / tau, 2.0 / tau))
    place, speed = 0.01 * flow.length_scale, 0.01 * flow.mean_velocity
    clock: dict[str, Any] = {"duration": 1200 * step, "sample_rate": 1 / step, "seed": seed}
    return simulate_flight(flow, vehicle, position_noise=place, velocity_noise=speed, **clock)


def reference(estimator: Estimator, flight: Flight) -> str:
    """Return the test's reference, a CSV: every 50th answer of the recurrence in Python."""
    board = board_of(board_settings(estimator, flight.vehicle), compiled=False)
    text = (
        "sample,doubt,mean_velocity,length_scale,timescale,heading,mean_velocity_error,"
        "length_scale_error,innovation,unexplained\n"
    )
    for number, (time, place, speed, *push) in enumerate(samples_of(flight), 1):
        clock = math.floor((time - float(flight.time[0])) * 1e9 + 0.5)
        board.update(clock, *place, *speed, *push)
        if number % EVERY == 0:
            answer = board.estimate()
            values = (*answer.value, *answer.error[:2], answer.innovation, answer.unexplained)
            text += f"{number},{int(answer.doubt)},{','.join(repr(float(own)) for own in values)}\n"
    return text


def package(
    estimator: Estimator,
    real: Real = "double",
    flight: Flight | None = None,
    *,
    source: str = "an estimator",
) -> dict[str, bytes]:
    """Return the files of the C by their paths: source, build, README and test.

    Args:
        estimator: whose settings the search has.
        real: the C type of all numbers.
        flight: of the test; by default a simulated one.
        source: name of the estimator's file, for the header.

    Raises:
        InputError: if the estimator cannot run on board.
    """
    one_of("C type", real, TOLERANCES)
    if reason := refusal(estimator):
        raise InputError(reason)
    flown = example_flight(estimator) if flight is None else flight
    settings = board_settings(estimator, flown.vehicle)
    searched = [
        f".{name} = {'(sf_real)' * isinstance(value, float)}{value!r}"
        for name, value in asdict(settings).items()
        if name not in _VEHICLE
    ]
    lines, origin = costs(real, settings.candidates), one_line(source, 50).replace("*/", "")
    marks = {
        "#define SF_REAL double": f"#define SF_REAL {real}",
        "@origin@": f"Made by sparsefit {version('sparsefit')} from {origin}.",
        " * @costs@": "\n".join(f" * {line}" for line in lines),
        "@costs@": "\n".join(f"    {line}" for line in lines),
        "@tolerance@": f"{TOLERANCES[real]:g}",
        "/* @settings@ */": "/* The estimator's search, for an initialiser of sf_config. */\n"
        f"#define SF_SETTINGS {', '.join(searched[:2])}, \\\n    {', '.join(searched[2:])}",
    }
    content = {}
    for path in FILES:
        text = (files("sparsefit.onboard") / "templates" / path.removeprefix("test/")).read_text()
        for mark, words in marks.items():
            text = text.replace(mark, words)
        content[path] = text.encode()
    content["test/flight.csv"] = csv_file.encode(FlightTable.from_flight(flown))
    content["test/reference.csv"] = reference(estimator, flown).encode()
    return content
