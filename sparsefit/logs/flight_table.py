"""A flight as a file holds it: three to seven named columns, and where and when its zeros are."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta

import numpy as np

from sparsefit.arrays import Array
from sparsefit.errors import InputError, pair
from sparsefit.flight.record import Flight
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.logs.head import Head, vehicle_of

POSITIONS = ("time", "x", "y")  # s, m, m: all that some logs hold
VELOCITY = ("vx", "vy")  # m/s
COLUMNS = (*POSITIONS, *VELOCITY)
THRUST = ("ax", "ay")  # m/s^2, measured; in some logs


def moment_of(text: str) -> datetime | None:
    """Return the time that a calendar names, UTC where no zone is named; None of anything else."""
    try:
        moment = datetime.fromisoformat(text.strip())
    except ValueError:
        return None
    return moment if moment.tzinfo else moment.replace(tzinfo=UTC)


def moment_at(microseconds: int) -> datetime | None:
    """Return the time so many microseconds after 1970 began; None beyond all calendars."""
    try:
        return datetime.fromtimestamp(0, UTC) + timedelta(microseconds=microseconds)
    except OverflowError:
        return None


@dataclass(frozen=True)
class Anchor:
    """The zero of a log's coordinates and of its time, which several logs must share.

    Args:
        origin: longitude and latitude of x = y = 0 [degrees]; None where they are not known.
        epoch: the time of t = 0; None where it is not known.
    """

    origin: tuple[float, float] | None = None
    epoch: datetime | None = None

    @classmethod
    def of(cls, origin: object = None, epoch: str | datetime | None = None) -> Anchor:
        """Return an anchor from a pair of degrees and an ISO 8601 time, UTC without a zone.

        Raises:
            InputError: if they are none.
        """
        place = None if origin is None else pair("origin", origin, "degrees")
        if place is not None and not (abs(place[0]) <= 360.0 and abs(place[1]) <= 90.0):
            raise InputError(f"origin must be longitude and latitude in degrees; got {place}")
        if epoch is None:
            return cls(place)
        moment = moment_of(epoch) if isinstance(epoch, str) else epoch
        if not isinstance(moment, datetime):
            raise InputError(f"epoch must be an ISO time, 2012-07-22T14:15:00, say; got {epoch!r}")
        return cls(place, moment if moment.tzinfo else moment.replace(tzinfo=UTC))


@dataclass(frozen=True)
class FlightTable:
    """The columns of a flight and the head of its file.

    Args:
        columns: `COLUMNS` and `THRUST` by name, (m,) each, in SI units.
        head: the vehicle, the true flow and the axes, which may be missing.
        notes: how a foreign log was read, in words.
        anchor: where and when the zeros are, as far as the log says.
    """

    columns: dict[str, Array]
    head: Head = Head()
    notes: tuple[str, ...] = ()
    anchor: Anchor = Anchor()

    @classmethod
    def from_flight(cls, flight: Flight) -> FlightTable:
        """Return the table of ``flight``; `flight` gives it back exactly."""
        values = np.column_stack([flight.time, flight.position, flight.velocity])
        names = COLUMNS if flight.velocity_measured else POSITIONS
        columns = {name: values[:, place] for place, name in enumerate(names)}
        if flight.thrust is not None:
            columns |= dict(zip(THRUST, flight.thrust.T, strict=True))
        return cls(columns, Head.of(flight))

    def flight(self, vehicle: PointMassVehicle | None = None) -> Flight:
        """Return the flight; a ``vehicle`` given here replaces the one in the settings.

        Raises:
            InputError: if there is no vehicle, or the flight is not a valid one.
        """
        vectors = {
            names: np.column_stack([self.columns[name] for name in names])
            for names in (("x", "y"), VELOCITY, THRUST)
            if names[0] in self.columns
        }
        flown = vehicle_of(self.head.settings) if vehicle is None else vehicle
        first, thrust = (self.columns["time"], vectors["x", "y"]), vectors.get(THRUST)
        flow, frame = self.head.flow, self.head.frame
        if VELOCITY not in vectors:
            return Flight.from_positions(*first, flown, flow, thrust, frame)
        return Flight(*first, vectors[VELOCITY], flown, flow, True, thrust, frame)

    def since(self, epoch: datetime | None) -> FlightTable:
        """Return the same rows by a clock that is 0 at ``epoch``, where the log has a calendar."""
        own = self.anchor.epoch
        if epoch is None or own is None or epoch == own:
            return self
        late = (own - epoch).total_seconds()
        columns = self.columns | {"time": late + self.columns["time"]}
        return replace(self, columns=columns, anchor=replace(self.anchor, epoch=epoch))

    def between(self, start: float | None, end: float | None) -> FlightTable:
        """Return the rows from one time of the log to another [s]; None is its own end.

        Raises:
            InputError: where no row is between them.
        """
        if start is None and end is None:
            return self
        time = self.columns["time"]
        low, high = -math.inf if start is None else start, math.inf if end is None else end
        inside = (time >= low) & (time <= high)
        if not inside.any():
            ends = f"{time.min():g} … {time.max():g} s" if len(time) else "nothing"
            raise InputError(f"no sample from {low:g} s to {high:g} s; the log has {ends}")
        return replace(self, columns={name: row[inside] for name, row in self.columns.items()})
