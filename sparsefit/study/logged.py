"""Flights that were flown: the [flights] of a study that reads its flights from files.

    [flights]
    files = ["logs/*.csv"]            # relative to the study file, in order of name
    windows = [432000, 864000]        # [s] each log in pieces of so long; without, the whole of it
    response_time = 60.0              # [s] replaces the vehicle in the files, as do thrust and drag

Nobody knows the flow of a log: its cases have a status and an estimate, and no error.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import ClassVar

import numpy as np

from sparsefit.codec import Place
from sparsefit.errors import InputError
from sparsefit.flight import Flight
from sparsefit.flight.record import MINIMUM_SAMPLES
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.logs import read_flight
from sparsefit.logs.files import LARGEST
from sparsefit.study.keys import LogRules
from sparsefit.study.schema import record_of
from sparsefit.study.toml_file import Section
from sparsefit.whole_file import read_whole

MOST = 1000  # files


@dataclass(frozen=True)
class Logged:
    """A piece of a log, in the place of a draw to fly; its flow is not known.

    digest: of the file; start, end: from when to when [s] of its own time; vehicle: in place of the
    one in the file.
    """

    file: str = field(repr=False)  # wherever it lies, its digest says what was logged
    digest: str
    start: float
    end: float
    vehicle: PointMassVehicle | None
    flow: ClassVar[None] = None

    @property
    def label(self) -> str:
        """The file's name and the seconds, as a reader would look it up."""
        return f"{Path(self.file).name} {self.start:g}-{self.end:g} s"

    def fleet(self, seed: np.random.SeedSequence) -> tuple[Flight]:
        """The flight as it was logged, alone, its time from 0 on: nothing of it is random.

        Raises:
            InputError: if the file has changed since the study was read.
        """
        whole, digest = _read(self.file, self.vehicle)
        if digest != self.digest:
            raise InputError(f"{self.file} has changed since the study was read: run it again")
        inside = (whole.time >= self.start) & (whole.time <= self.end)
        time, position = whole.time[inside] - self.start, whole.position[inside]
        thrust = None if whole.thrust is None else whole.thrust[inside]
        if not whole.velocity_measured:
            return (Flight.from_positions(time, position, whole.vehicle, thrust=thrust),)
        return (Flight(time, position, whole.velocity[inside], whole.vehicle, thrust=thrust),)


@dataclass(frozen=True)
class Logs:
    """The flights of a study that come from files."""

    pieces: tuple[Logged, ...]

    def draw(self, flight: int, count: int, seed: int) -> Logged:
        """Flight number `flight`, of the pieces in order."""
        return self.pieces[flight]


def _read(file: str, vehicle: PointMassVehicle | None) -> tuple[Flight, str]:
    """The flight of a file and the sha256 of its content now."""
    digest = hashlib.sha256(read_whole(file, most=LARGEST)).hexdigest()
    return _parsed(file, digest, vehicle), digest


@lru_cache(maxsize=4)  # logs that are kept while their pieces are flown
def _parsed(file: str, digest: str, vehicle: PointMassVehicle | None) -> Flight:
    """The flight of a file of this digest, parsed once for all its pieces."""
    return read_flight(file, vehicle=vehicle)


def read_logs(section: Section, place: Place) -> Logs:
    """The logs of [flights]; `InputError` names the key, the file or the line of a fault."""
    rules, here = record_of(LogRules, section, place), place.at("files")
    folder, files = Path(place.file).parent, []
    for pattern in rules.files:
        named = [folder / pattern]
        if set(pattern) & set("*?["):
            named = [] if Path(pattern).is_absolute() else sorted(folder.glob(pattern))
        if not named:
            raise here.error(f'"{pattern}" matches no file beside {Path(place.file).name}')
        files += list(map(str, named))
    if not 0 < len(files) <= MOST or len(set(files)) < len(files):
        raise here.error(f"must name 1 to {MOST} files, each of them once")
    vehicle = None
    if rules.response_time or rules.drag:
        thrust = rules.thrust_acceleration or (0.0, 0.0)
        vehicle = PointMassVehicle(rules.response_time or math.inf, thrust, rules.drag or 0.0)
    elif rules.thrust_acceleration is not None:
        raise place.at("response_time").error("missing: a vehicle has it beside its thrust")
    pieces = tuple(piece for file in files for piece in _pieces(file, vehicle, rules.windows))
    if not pieces:
        raise place.at("windows").error("are longer than every log: no flight is left")
    return Logs(pieces)


def _pieces(
    file: str, vehicle: PointMassVehicle | None, windows: tuple[float, ...]
) -> Iterator[Logged]:
    """The log whole, or cut into pieces of each length; the rest at its end is not flown."""
    flight, digest = _read(file, vehicle)
    first, last = float(flight.time[0]), float(flight.time[-1])
    step = float(np.median(np.diff(flight.time)))
    for window in windows or (last - first,):
        for place in range(int((last - first + step) / window + 1e-9) if windows else 1):
            start = first + place * window
            end = min(start + window - 0.5 * step, last) if windows else last
            inside = (flight.time >= start) & (flight.time <= end)
            if np.count_nonzero(inside) >= MINIMUM_SAMPLES:
                yield Logged(file, digest, start, end, vehicle)
