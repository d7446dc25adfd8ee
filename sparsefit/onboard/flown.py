"""A recorded flight as the stream that it was: the estimator scored as it would fly."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any, cast

from sparsefit.errors import InputError, positive
from sparsefit.estimator import Estimate, Estimator
from sparsefit.flight import Flight
from sparsefit.onboard.board import BoardAnswer, answer_of
from sparsefit.onboard.online import OnlineEstimator, estimate_of, refusal, samples_of
from sparsefit.regression import Fit

if TYPE_CHECKING:
    from sparsefit.estimator.prepare import Prepared


class FlownRows:
    """The rows of a flight for a back-end, with the answer of the board after its last sample."""

    def __init__(self, prepared: Prepared, answer: BoardAnswer) -> None:
        self._prepared, self._answer = prepared, answer

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__") or name in ("_prepared", "_answer"):
            raise AttributeError(name)
        return getattr(self._prepared, name)

    def read(self, estimator: Estimator, fit: Fit) -> Estimate:
        """Return the board's answer, with the certificate of the back-end's fit."""
        seconds = self._prepared.seconds + fit.seconds
        return estimate_of(
            estimator,
            self._answer,
            certificate=fit.certificate,
            columns=fit.problem.columns,
            seconds=seconds,
        )


@dataclass(frozen=True)
class Stream:
    """Whether an estimator follows its flights sample by sample, and how fast it forgets.

    Args:
        window: seconds that count, as of `OnlineEstimator`.
        memory: or the time in which the weight of a sample falls by e [s].

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
        if self.asked and (reason := refusal(estimator)):
            raise InputError(f"online: {reason}")

    def prepare(self, estimator: Estimator, fleet: Sequence[Flight]) -> Prepared:
        """Return the rows of a flight, which `Estimator.read` reads as they were flown if asked."""
        return self.flown(estimator).prepare(fleet) if self.asked else estimator.prepare(fleet)

    def flown(self, estimator: Estimator) -> FlownEstimator:
        """Return the estimator as it flies."""
        own = {item.name: getattr(estimator, item.name) for item in fields(Estimator)}
        return FlownEstimator(**own, stream=self)

    def followed(self, estimator: Estimator, flight: Flight) -> OnlineEstimator:
        """Return an online estimator that was given all samples of a flight, one by one."""
        online = OnlineEstimator(
            estimator, vehicle=flight.vehicle, window=self.window, memory=self.memory
        )
        for sample in samples_of(flight):
            online.update(*sample)
        return online


@dataclass(frozen=True)
class FlownEstimator(Estimator):
    """An estimator as it flies: its estimate is that of the board after a flight's last sample."""

    stream: Stream = field(default=Stream(), kw_only=True)

    def prepare(self, flights: Flight | Sequence[Flight]) -> Prepared:
        """Return the rows of a flight for the back-end, with the board's answer beside them."""
        fleet = [flights] if isinstance(flights, Flight) else list(flights)
        if len(fleet) != 1:
            raise InputError(f"on board one flight is followed, not {len(fleet)} together")
        answer = answer_of(self.stream.followed(self.batch, fleet[0])._board)
        return cast("Prepared", FlownRows(self.batch.prepare(fleet[0]), answer))

    def estimate(self, flights: Flight | Sequence[Flight]) -> Estimate:
        """Estimate from a flight, sample by sample."""
        prepared = self.prepare(flights)
        return self.read(prepared, self.fit(prepared))

    @property
    def batch(self) -> Estimator:
        """The estimator that it was made of."""
        return Estimator(**{item.name: getattr(self, item.name) for item in fields(Estimator)})


def as_flown(
    estimator: Estimator, *, window: float | None = None, memory: float | None = None
) -> FlownEstimator:
    """Return an estimator as it flies, to be scored like any other.

    Raises:
        InputError: where it cannot (`refusal` says why).
    """
    if reason := refusal(estimator):
        raise InputError(reason)
    return Stream(window, memory).flown(estimator)
