"""Recursive estimation from a stream of samples, each in bounded time and constant memory.

The recurrence is `sparsefit.onboard.board`: a search over square cells of every size and heading,
then Kalman filters for the flow. `as_flown` scores recorded flights as if they were streamed.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any

import numpy as np

from sparsefit.errors import InputError, finite, pair, positive, shown
from sparsefit.estimator import Doubt, Estimate, Estimator
from sparsefit.flight import Flight
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.flight.waves import WaveFlow
from sparsefit.likelihood.goodness import Uncertainty
from sparsefit.onboard.board import BAD_SAMPLE, BAD_TIME, board_of
from sparsefit.onboard.sweep import BoardAnswer, BoardDoubt, BoardSettings, rebased
from sparsefit.regression import Fit
from sparsefit.regression.backend import settings_of

if TYPE_CHECKING:
    from sparsefit.estimator.prepare import Prepared

WIDEST = 16.0  # the largest length scale over the least: beyond it the path held is too short
ERA = 4.5e9  # [s]: no clock of a flight is farther from zero
NOON = 9 * 10**18  # ns that the first sample's clock is given: all others are within two eras
_WORDS = {
    BoardDoubt.FEW_SAMPLES: (Doubt.FEW_SAMPLES, "too few samples for a search; fly on"),
    BoardDoubt.NO_FLOW: (Doubt.NO_FLOW, "no cells of one size and heading explain the flight"),
    BoardDoubt.RIVAL: (Doubt.RIVAL, "another length scale fits nearly as well; fly across more"),
    BoardDoubt.SETTLING: (Doubt.FEW_SAMPLES, "the filters have just started; fly on"),
    BoardDoubt.IMPRECISE: (Doubt.IMPRECISE, "a parameter is known too poorly; fly across more"),
    BoardDoubt.INNOVATIONS: (Doubt.MISFIT, "innovations are too large, or have a memory"),
    BoardDoubt.SHAPE: (Doubt.MISFIT, "the two waves are not as strong as each other"),
    BoardDoubt.TURNED: (Doubt.MISFIT, "the cells are turned; readout refine 'ladder' allows it"),
    BoardDoubt.EDGE: (Doubt.EDGE, "the length scale is outside of the grid's bounds"),
}


def refusal(estimator: Estimator) -> str:
    """Return the reason why an estimator cannot run on board, with its remedy; empty if it can.

    On board the vehicle is known, the flow is one of square cells and U0 its rms. The search
    replaces the derivative, the back-end and the steps of the grid.
    """
    library, readout, grid = estimator.library, estimator.readout, estimator.library.grid
    causes = []
    if library.unknown:
        unknown = ", ".join(library.unknown)
        causes.append(f"unknown {unknown}: on board the vehicle is known (leave it out)")
    if estimator.free:
        causes.append(f"free = {estimator.free!r}: on board the vehicle is known (leave it out)")
    if readout.scales != "one":
        causes.append("several scales are a search over all rows (use scales 'one')")
    if readout.mean_velocity != "rms":
        causes.append(f"readout {readout.mean_velocity!r}: U0 is the rms (use 'rms')")
    if grid.upper > WIDEST * grid.lower:
        span = f"a grid of {grid.lower:g} to {grid.upper:g} m is wider than {WIDEST:g} times"
        causes.append(f"{span} (use narrower bounds)")
    return f"this estimator cannot run on board: {'; '.join(causes)}" if causes else ""


def board_settings(
    estimator: Estimator, vehicle: PointMassVehicle, memory: float = 0.0
) -> BoardSettings:
    """Return the settings on board of an estimator.

    memory: time constant of the weights of past samples [s]; 0: equal weights.
    """
    grid, precision = estimator.library.grid, float(estimator.readout.precision)
    search = float(grid.lower), float(grid.upper), precision, memory, int(_any_heading(estimator))
    return BoardSettings(*vehicle.parameters, *search)


def _any_heading(estimator: Estimator) -> bool:
    return estimator.readout.refine == "ladder" or estimator.library.family == "waves"


class OnlineEstimator:
    """Estimates the flow recursively from a stream of samples, in constant memory.

    An instance can be pickled in flight and resumed, and is safe to share between threads.

    Args:
        estimator: gives the bounds of the length scale, the precision, and whether any heading is
            allowed (readout refine ``ladder``); its derivative and back-end are not used.
        vehicle: of the flight, as in `Flight`.
        window: effective number of seconds; a window of T is a memory of T/2.
        memory: time constant of the exponential weights of past samples [s]. Default: equal
            weights.

    Raises:
        InputError: if the estimator cannot run on board, with the reason.
    """

    def __init__(
        self,
        estimator: Estimator,
        *,
        vehicle: PointMassVehicle,
        window: float | None = None,
        memory: float | None = None,
    ) -> None:
        if not isinstance(estimator, Estimator):
            raise InputError(f"online: estimator must be an Estimator, not {shown(estimator)}")
        if not isinstance(vehicle, PointMassVehicle):
            raise InputError(f"online: vehicle must be a PointMassVehicle; got {shown(vehicle)}")
        if reason := refusal(estimator):
            raise InputError(f"online: {reason}")
        self.estimator = estimator
        self.settings = board_settings(estimator, vehicle, Stream(window, memory).fading)
        self._lock = threading.RLock()
        self.restart()

    def __getstate__(self) -> dict[str, Any]:
        with self._lock:
            return {**self.__dict__, "_lock": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state, _lock=threading.RLock())

    def __repr__(self) -> str:
        grid = self.estimator.library.grid
        bounds = f"{grid.lower:g} to {grid.upper:g} m"
        return f"<OnlineEstimator of cells of {bounds} after {self._count} samples>"

    def restart(self) -> None:
        """Discard all samples; the next may have any time."""
        with self._lock:
            self._board: Any = board_of(self.settings)
            self._first, self._pushed, self._count = 0.0, False, 0

    def update(self, time: float, position: Any, velocity: Any, thrust: Any = None) -> None:
        """Take one sample: time [s], position (x, y) [m] and velocity (vx, vy) [m/s].

        A sample more than 20 mean steps after the last, or not after it, is rejected. If the next
        one continues from it, the clock has changed or there was a gap, and that one is accepted;
        tracking continues if the velocities measured next agree with the flow, otherwise the
        search starts again.

        Args:
            time: of the sample [s].
            position: (x, y) [m].
            velocity: (vx, vy) [m/s].
            thrust: the measured thrust acceleration (x, y) [m/s^2], with every sample or with none.

        Raises:
            InputError: if a value is not finite or above 1e7, or the time is beyond 4.5e9 s or out
                of line. The sample is rejected and the state does not change.
        """
        with self._lock:
            if self._count and self._pushed is not (thrust is not None):
                raise InputError("give a thrust with every sample or with none; restart() between")
            first = self._first if self._count else time
            status = BAD_SAMPLE
            with suppress(TypeError, ValueError, OverflowError):  # no numbers, or none of a clock
                (x, y), (vx, vy) = position, velocity
                if abs(time) < ERA:
                    clock = round((time - first) * 1e9) + NOON
                    status = self._board.update(clock, x, y, vx, vy, thrust)
            if status not in (BAD_SAMPLE, BAD_TIME):
                self._first, self._pushed = first, thrust is not None
                self._count += 1
                return
        finite("time", time, "s")
        pair("position", position, "m")
        pair("velocity", velocity, "m/s")
        if thrust is not None:
            pair("thrust", thrust, "m/s^2")
        if status == BAD_SAMPLE:
            words = f"beyond 1e7 in SI units, or {ERA:g} s: no flight"
            raise InputError(f"a sample {words}; change the unit, or give seconds")
        raise InputError(
            f"time {time} s is out of line with the samples before; it is left out, and taken as a "
            "new clock if the next sample goes on from it"
        )

    @property
    def samples(self) -> int:
        """The number of accepted samples."""
        return self._count

    @property
    def answer(self) -> BoardAnswer:
        """The numbers of the recurrence after the last sample."""
        with self._lock:
            answer: BoardAnswer = self._board.estimate()
        return answer

    def estimate(self) -> Estimate:
        """Return the flow's parameters from all samples so far, with their 95 % intervals."""
        return estimate_of(self.estimator, self.answer)


def samples_of(flight: Flight) -> Iterator[tuple[Any, ...]]:
    """Yield the arguments of `OnlineEstimator.update` for every sample of a flight."""
    series = [flight.time, flight.position, flight.velocity]
    series += [] if flight.thrust is None else [flight.thrust]
    yield from zip(*(column.tolist() for column in series), strict=True)


def estimate_of(estimator: Estimator, answer: BoardAnswer, **more: Any) -> Estimate:
    """Return the answer of the on-board recurrence as an estimate; more: other fields of it."""
    backend: Any = estimator.backend
    doubt, reason = _WORDS.get(answer.doubt, (None, ""))
    speed, length, time, heading = answer.value.tolist()
    any_heading = _any_heading(estimator)
    if math.isfinite(length):
        a, b, c, d, kx, ky = rebased(answer.flow[:6], -answer.flow[6:])
        waves = np.array([[kx, ky], [-ky, kx]]), np.array([a, c]), np.array([b, d])
        more |= {
            "uncertainty": Uncertainty.of_flow((speed, length, time), answer.error[:3].tolist()),
            "flow": WaveFlow(*waves),
            "shape": "square" if any_heading else "axis",
            "length_scales": (length, length),
        }
        heading = heading if any_heading else 0.0
    more |= {"backend": backend.name, "settings": settings_of(backend), "samples": answer.samples}
    more |= {"status": answer.status, "doubt": doubt, "reason": reason, "heading": heading}
    return Estimate(speed, length, time, rival_length_scale=answer.rival or math.nan, **more)


@dataclass(frozen=True)
class Stream:
    """Settings of an estimator that is fed sample by sample; by default it is not.

    Args:
        window: effective number of seconds, as in `OnlineEstimator`.
        memory: or the time constant of the weights [s].

    Raises:
        InputError: if both are given, or one of them is not above 0.
    """

    window: float | None = None
    memory: float | None = None

    def __post_init__(self) -> None:
        """Check both."""
        given = {name: value for name, value in vars(self).items() if value is not None}
        if len(given) > 1:
            raise InputError("online: give window or memory [s], not both")
        for name, value in given.items():
            positive(f"online: {name}", value, "s")

    @property
    def asked(self) -> bool:
        """Whether flights are fed sample by sample."""
        return self.window is not None or self.memory is not None

    @property
    def fading(self) -> float:
        """The time constant [s] with which the weights of older samples fall; 0: equal weights."""
        return self.memory or 0.0 if self.window is None else self.window / 2.0

    def flying(self, estimator: Estimator) -> Estimator:
        """Return the estimator as on board if a window or memory is set, otherwise itself."""
        return as_flown(estimator, self) if self.asked else estimator


@dataclass(frozen=True)
class FlownEstimator(Estimator):
    """An estimator whose estimate is that on board after the last sample of a flight."""

    stream: Stream = field(default=Stream(), kw_only=True)

    def read(self, prepared: Prepared, fit: Fit) -> Estimate:
        """Return the answer on board after the last sample, with the certificate of the fit."""
        flight, *others = prepared.flights
        if others:
            raise InputError(f"on board one flight is followed, not {1 + len(others)} together")
        online = OnlineEstimator(self, vehicle=flight.vehicle, **vars(self.stream))

        def flown() -> BoardAnswer:
            for sample in samples_of(flight):
                online.update(*sample)
            return online.answer

        answer = prepared.once(online.settings, flown)
        seconds = prepared.seconds + fit.seconds
        more = {"certificate": fit.certificate, "columns": fit.problem.columns, "seconds": seconds}
        return estimate_of(self, answer, **more)


def as_flown(estimator: Estimator, stream: Stream = Stream()) -> FlownEstimator:
    """Return an estimator that answers as on board, to be scored like any other.

    Raises:
        InputError: if it cannot run on board (`refusal`).
    """
    if reason := refusal(estimator):
        raise InputError(reason)
    own = {item.name: getattr(estimator, item.name) for item in fields(Estimator)}
    return FlownEstimator(**own, stream=stream)
