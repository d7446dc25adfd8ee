"""A recorded flight as the stream that it was."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from sparsefit.errors import InputError, positive
from sparsefit.estimator import Estimator
from sparsefit.estimator.prepare import Prepared
from sparsefit.flight import Flight
from sparsefit.online.estimator import OnlineEstimator
from sparsefit.online.settings import refuse_unfit


@dataclass(frozen=True)
class Stream:
    """Whether an estimator follows its flights sample by sample, and how far back it looks.

    Args:
        window: seconds that count.
        memory: or the time in which the weight of a sample falls by e [s]. Without either the
            whole flight counts, all at once.

    Raises:
        InputError: if both are given, or one of them is not above 0.
    """

    window: float | None = None
    memory: float | None = None

    def __post_init__(self) -> None:
        """Check both."""
        if self.window is not None and self.memory is not None:
            raise InputError("online: give window or memory [s], not both")
        for name in ("window", "memory"):
            if getattr(self, name) is not None:
                positive(f"online: {name}", getattr(self, name), "s")

    @property
    def asked(self) -> bool:
        """Whether flights are followed at all."""
        return self.window is not None or self.memory is not None

    def refuse_unfit(self, estimator: Estimator) -> None:
        """Raise InputError where flights are to be followed by an estimator that cannot."""
        if self.asked:
            refuse_unfit(estimator)

    def prepare(self, estimator: Estimator, fleet: Sequence[Flight]) -> Prepared:
        """What back-ends see at the end of a flight, or of several together."""
        if not self.asked:
            return estimator.prepare(fleet)
        if len(fleet) > 1:
            raise InputError(f"online: one flight is followed, not {len(fleet)} together")
        return self.followed(estimator, fleet[0]).prepared()

    def followed(self, estimator: Estimator, flight: Flight) -> OnlineEstimator:
        """An online estimator that was given all samples of a flight, one by one."""
        online = OnlineEstimator(
            estimator, vehicle=flight.vehicle, window=self.window, memory=self.memory
        )
        series = [flight.time, flight.position, flight.velocity]
        series += [] if flight.thrust is None else [flight.thrust]
        for sample in zip(*(one.tolist() for one in series), strict=True):
            online.update(*sample)
        return online
