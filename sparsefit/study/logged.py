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
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import ClassVar

import numpy as np

from sparsefit.codec import Place, number, only, text
from sparsefit.errors import InputError
from sparsefit.flight import Flight
from sparsefit.flight.record import MINIMUM_SAMPLES
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.logs import read_flight
from sparsefit.logs.files import LARGEST
from sparsefit.study.toml_file import Section, items, positive
from sparsefit.whole_file import read_whole

FILES, WINDOWS = "files", "windows"
KEYS = (FILES, WINDOWS, "response_time", "drag", "thrust_acceleration")
MOST = 1000  # files
OPEN = 4  # logs that are kept while their pieces are flown


@dataclass(frozen=True)
class Piece:
    """A piece of a log: its file, the file's digest, and from when to when [s] of its own time."""

    file: str
    digest: str
    start: float
    end: float

    @property
    def label(self) -> str:
        """The file's name and the seconds, as a reader would look it up."""
        return f"{Path(self.file).name} {self.start:g}-{self.end:g} s"


@dataclass(frozen=True)
class Logged:
    """A flight that was flown, in the place of a draw to fly; its flow is not known."""

    piece: Piece
    vehicle: PointMassVehicle | None
    flow: ClassVar[None] = None

    def fleet(self, seed: np.random.SeedSequence) -> tuple[Flight]:
        """The flight as it was logged, alone, its time from 0 on: nothing of it is random.

        Raises:
            InputError: if the file has changed since the study was read.
        """
        whole, digest = _read(self.piece.file, self.vehicle)
        if digest != self.piece.digest:
            changed = f"{self.piece.file} has changed since the study was read"
            raise InputError(f"{changed}: run it again")
        inside = (whole.time >= self.piece.start) & (whole.time <= self.piece.end)
        time, position = whole.time[inside] - self.piece.start, whole.position[inside]
        thrust = None if whole.thrust is None else whole.thrust[inside]
        if not whole.velocity_measured:
            return (Flight.from_positions(time, position, whole.vehicle, thrust=thrust),)
        return (Flight(time, position, whole.velocity[inside], whole.vehicle, thrust=thrust),)


@dataclass(frozen=True)
class Logs:
    """The flights of a study that come from files; vehicle: in place of those in the files."""

    pieces: tuple[Piece, ...]
    vehicle: PointMassVehicle | None

    def draw(self, flight: int, count: int, seed: int) -> Logged:
        """Flight number `flight`, of the pieces in order."""
        return Logged(self.pieces[flight], self.vehicle)


def _read(file: str, vehicle: PointMassVehicle | None) -> tuple[Flight, str]:
    """The flight of a file and the sha256 of its content now."""
    digest = hashlib.sha256(read_whole(file, most=LARGEST)).hexdigest()
    return _parsed(file, digest, vehicle), digest


@lru_cache(maxsize=OPEN)
def _parsed(file: str, digest: str, vehicle: PointMassVehicle | None) -> Flight:
    """The flight of a file of this digest, parsed once for all its pieces."""
    return read_flight(file, vehicle=vehicle)


def read_logs(section: Section, place: Place) -> Logs:
    """The logs of [flights]; `InputError` names the key, the file or the line of a fault."""
    only(section, KEYS, place)
    files = [
        file
        for pattern in items(section[FILES], place.at(FILES))
        for file in _matching(text(pattern, place.at(FILES)), place.at(FILES))
    ]
    if len(set(files)) < len(files) or len(files) > MOST:
        why = "are more than 1000" if len(files) > MOST else "name a file twice"
        raise place.at(FILES).error(why)
    vehicle, windows = _vehicle(section, place), None
    if WINDOWS in section:
        given = section[WINDOWS]
        listed = items(given, place.at(WINDOWS)) if isinstance(given, list) else [given]
        windows = tuple(positive(item, place.at(WINDOWS)) for item in listed)
    pieces = tuple(piece for file in files for piece in _pieces(file, vehicle, windows))
    if not pieces:
        raise place.at(WINDOWS).error("are longer than every log: no flight is left")
    return Logs(pieces, vehicle)


def _matching(pattern: str, place: Place) -> list[str]:
    """The files that a pattern names, beside the study file, in order."""
    folder = Path(place.file).parent
    plain = not set(pattern) & set("*?[")
    if Path(pattern).is_absolute() and not plain:
        raise place.error(f'"{pattern}": a pattern is relative to the study file')
    files = [folder / pattern] if plain else sorted(folder.glob(pattern))
    if not files:
        raise place.error(f'"{pattern}" matches no file beside {Path(place.file).name}')
    return [str(file) for file in files]


def _vehicle(section: Section, place: Place) -> PointMassVehicle | None:
    """The vehicle of the section, in place of those in the files; None where it names none."""
    if not {"response_time", "drag"} & set(section):
        if "thrust_acceleration" in section:
            raise place.at("response_time").error("missing: a vehicle has it beside its thrust")
        return None
    thrust = section.get("thrust_acceleration", [0.0, 0.0])
    if not isinstance(thrust, list) or len(thrust) != 2:
        raise place.at("thrust_acceleration").error("must be a pair [x, y]")
    x, y = (number(item, place.at("thrust_acceleration")) for item in thrust)
    response, drag = math.inf, 0.0
    if "response_time" in section:
        response = positive(section["response_time"], place.at("response_time"))
    if "drag" in section:
        drag = positive(section["drag"], place.at("drag"))
    return PointMassVehicle(response, (x, y), drag)


def _pieces(
    file: str, vehicle: PointMassVehicle | None, windows: tuple[float, ...] | None
) -> Iterator[Piece]:
    """The log whole, or cut into pieces of each length; the rest at its end is not flown."""
    flight, digest = _read(file, vehicle)
    first, last = float(flight.time[0]), float(flight.time[-1])
    step = float(np.median(np.diff(flight.time)))
    for window in windows or (last - first,):
        for place in range(int((last - first + step) / window + 1e-9) or (windows is None)):
            start = first + place * window
            end = last if windows is None else min(start + window - 0.5 * step, last)
            inside = (flight.time >= start) & (flight.time <= end)
            if np.count_nonzero(inside) >= MINIMUM_SAMPLES:
                yield Piece(file, digest, start, end)
