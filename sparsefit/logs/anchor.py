"""Where x = y = 0 is on the Earth, and when t = 0 was: what several logs must share."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

from sparsefit.errors import InputError, pair


@dataclass(frozen=True)
class Anchor:
    """The zero of a log's coordinates and of its time, where they are known.

    Args:
        origin: longitude and latitude of x = y = 0 [degrees].
        epoch: the time of t = 0.
    """

    origin: tuple[float, float] | None = None
    epoch: datetime | None = None

    @classmethod
    def of(cls, origin: object = None, epoch: str | datetime | None = None) -> Anchor:
        """An anchor from a pair of degrees and an ISO 8601 time, UTC where it names no zone.

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


def moment_of(text: str) -> datetime | None:
    """Return the time that a calendar names, UTC where no zone is told; None of anything else."""
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
