"""An estimator that follows a stream of samples, each in bounded time, and answers at any moment.

The answer is that of the forward pass (`sparsefit.onboard.board`): first a search over square cells
of every size and heading, then Kalman filters over the flow that was found.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator
from typing import Any

import numpy as np

from sparsefit.arrays import Array
from sparsefit.errors import InputError, finite, pair, positive
from sparsefit.estimator import Doubt, Estimate, Estimator
from sparsefit.flight import Flight
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.flight.waves import WaveFlow
from sparsefit.likelihood.goodness import Uncertainty
from sparsefit.onboard.board import BAD_SAMPLE, BAD_TIME, BoardAnswer, answer_of, board_of
from sparsefit.onboard.square_cells import rebased
from sparsefit.onboard.sweep import BoardDoubt, BoardSettings
from sparsefit.regression.backend import settings_of

WIDEST = 16.0  # the largest length scale over the least: beyond it the path held is too short
CANDIDATES = 8  # looked at with each sample of the search
HELD = 2048  # samples for `OnlineEstimator.flight`
NOON = 10**18  # ns that the first sample's clock is given: others may come before it
_NUMBERS = {float, int, np.float64}
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

    A derivative, a back-end and the steps of a grid are the batch's: on board the search takes
    their place. The vehicle is known, the flow one of square cells, and U0 its rms.
    """
    library, readout, grid = estimator.library, estimator.readout, estimator.library.grid
    causes = []
    if library.unknown:
        causes.append(f"unknown {', '.join(library.unknown)}: the vehicle is known (leave it out)")
    if getattr(estimator, "free", ()):
        causes.append("free: the vehicle and the sensors are known (leave it out)")
    if readout.scales != "one":
        causes.append("several scales are a search over all rows (use scales 'one')")
    if readout.mean_velocity != "rms":
        causes.append(f"readout {readout.mean_velocity!r}: U0 is the rms (use 'rms')")
    if grid.upper > WIDEST * grid.lower:
        span = f"{grid.lower:g} to {grid.upper:g} m"
        causes.append(f"a grid of {span} is wider than {WIDEST:g} times (use narrower bounds)")
    return f"this estimator cannot run on board: {'; '.join(causes)}" if causes else ""


def board_settings(
    estimator: Estimator, vehicle: PointMassVehicle, memory: float = 0.0
) -> BoardSettings:
    """Return the settings of the board that an estimator flies as.

    memory: the time in which the weight of a sample falls by e [s]; 0: all count alike.
    """
    grid, readout = estimator.library.grid, estimator.readout
    turned = readout.refine == "ladder" or estimator.library.family == "waves"
    return BoardSettings(
        *vehicle.parameters,
        float(grid.lower),
        float(grid.upper),
        float(readout.precision),
        memory,
        int(turned),
        CANDIDATES,
    )


class OnlineEstimator:
    """Follows the flow from samples as they come, and answers at every one.

    Memory is constant. An instance can be pickled in flight and goes on where it was; several
    threads may use it.

    Args:
        estimator: the bounds of its grid, whether its readout allows any heading (``ladder``) and
            its precision are those of the search; its derivative and back-end are the batch's.
        vehicle: that flies, as `Flight` has it.
        window: seconds that count: older samples fade as with a memory of half of it.
        memory: instead of a window, the time in which the weight of a sample falls by e [s].
            Without either all samples count alike.

    Raises:
        InputError: where the estimator cannot run on board, naming what stands in the way.
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
            raise InputError(f"online: estimator must be an Estimator, not {estimator!r}")
        if not isinstance(vehicle, PointMassVehicle):
            raise InputError(f"online: vehicle must be a PointMassVehicle; got {vehicle!r}")
        if window is not None and memory is not None:
            raise InputError("online: give window or memory [s], not both")
        if reason := refusal(estimator):
            raise InputError(f"online: {reason}")
        self.estimator, self.vehicle = estimator, vehicle
        fading = 0.0
        if window is not None:
            fading = positive("window", window, "s") / 2.0
        elif memory is not None:
            fading = positive("memory", memory, "s")
        self.settings = board_settings(estimator, vehicle, fading)
        self._window = math.inf if window is None else float(window)
        self._lock = threading.RLock()
        self.restart()

    def __getstate__(self) -> dict[str, Any]:
        with self._lock:
            return {**self.__dict__, "_lock": None, "_ring": self._ring.copy()}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state, _lock=threading.RLock())

    def restart(self) -> None:
        """Forget all samples; the next may have any time."""
        with self._lock:
            self._board: Any = board_of(self.settings)
            self._first: float | None = None
            self._pushed = False
            self._ring = np.zeros((HELD, 7))
            self._count = 0

    def update(
        self, time: float, position: object, velocity: object, thrust: object = None
    ) -> None:
        """Take one sample: time [s], position (x, y) [m] and velocity (vx, vy) [m/s].

        A step of more than 20 mean steps, or one back in time, is out of line: the sample is left
        out, and if the next one goes on from it, the clock was set: that one is taken, `restarts`
        counts it, and the flow that was followed stays.

        Args:
            time: of the sample [s].
            position: (x, y) [m].
            velocity: (vx, vy) [m/s].
            thrust: the measured thrust acceleration [m/s^2], as `Flight` has it, with every sample
                or with none.

        Raises:
            InputError: where a value is not finite or no flight has it, or the time is out of
                line. The sample is left out, and nothing changes.
        """
        place, speed = _plain(position), _plain(velocity)
        if place is None or speed is None or type(time) not in _NUMBERS:
            time = finite("time", time, "s")
            place = pair("position", position, "m")
            speed = pair("velocity", velocity, "m/s")
        x, y = place
        vx, vy = speed
        push = None if thrust is None else pair("thrust", thrust, "m/s^2")
        with self._lock:
            if self._first is None:
                self._first, self._pushed = finite("time", time, "s"), push is not None
            if self._pushed is not (push is not None):
                raise InputError("give a thrust with every sample or with none; restart() between")
            since = (time - self._first) * 1e9
            clock = round(since) + NOON if abs(since) < NOON else -1
            status = self._board.update(clock, x, y, vx, vy, push) if clock >= 0 else BAD_SAMPLE
            if status not in (BAD_SAMPLE, BAD_TIME):
                row = self._ring[self._count % HELD]
                row[:5] = time, x, y, vx, vy
                row[5:] = push or 0.0
                self._count += 1
                return
            if not self._count:
                self._first = None
        finite("time", time, "s")
        pair("position", place, "m")
        pair("velocity", speed, "m/s")
        if status == BAD_SAMPLE:
            raise InputError("a sample beyond 1e7 in SI units: no flight; change the unit")
        raise InputError(
            f"time {time} s is out of line with the samples before; it is left out, and taken as a "
            "new clock if the next sample goes on from it"
        )

    def rehearse(self) -> None:
        """Follow a made-up flight once and forget it, and all samples so far.

        Before take-off: else the first samples pay for imports.
        """
        self.restart()
        for number in range(256):
            turn = 0.1 * number
            speed = (self.settings.lower * math.cos(turn), self.settings.lower * math.sin(turn))
            self.update(0.02 * number, speed, speed, (0.0, 0.0) if self._pushed else None)
        self.estimate()
        self.restart()

    @property
    def samples(self) -> int:
        """The number of samples taken."""
        return self._count

    @property
    def restarts(self) -> int:
        """The number of gaps and of clocks that were set."""
        return int(self._board.restarts)

    @property
    def nbytes(self) -> int:
        """Bytes of memory that the board and the samples held take."""
        return int(self._board.nbytes) + self._ring.nbytes

    @property
    def flight(self) -> Flight:
        """The last samples (of the window, 2048 at most) as a flight, for any other estimator.

        Raises InputError while there are fewer than three.
        """
        with self._lock:
            order = np.arange(max(0, self._count - HELD), self._count) % HELD
            rows, pushed = self._ring[order].copy(), self._pushed
        back = np.flatnonzero(np.diff(rows[:, 0]) <= 0)
        rows = rows[int(back[-1]) + 1 :] if len(back) else rows
        if len(rows):
            rows = rows[rows[:, 0] >= rows[-1, 0] - self._window * (1 + 1e-9)]
        thrust: Array | None = rows[:, 5:] if pushed else None
        return Flight(rows[:, 0], rows[:, 1:3], rows[:, 3:5], self.vehicle, thrust=thrust)

    def estimate(self) -> Estimate:
        """Return the flow's parameters from all samples so far, with their 95 % intervals."""
        with self._lock:
            answer = answer_of(self._board)
        return estimate_of(self.estimator, answer)


def samples_of(flight: Flight) -> Iterator[tuple[Any, ...]]:
    """Yield the arguments of `OnlineEstimator.update` for every sample of a flight."""
    series = [flight.time, flight.position, flight.velocity]
    series += [] if flight.thrust is None else [flight.thrust]
    yield from zip(*(column.tolist() for column in series), strict=True)


def _plain(vector: Any) -> tuple[float, float] | None:
    """Two plain numbers, which need no other check than that of the board; None of all else."""
    if type(vector) in (tuple, list, np.ndarray) and len(vector) == 2:
        x, y = vector
        if type(x) in _NUMBERS and type(y) in _NUMBERS:
            return x, y
    return None


def estimate_of(estimator: Estimator, answer: BoardAnswer, **fields: Any) -> Estimate:
    """Return the answer of a board as an estimate; ``fields`` are its others."""
    backend = estimator.backend
    assert not isinstance(backend, str)
    doubt, reason = _WORDS.get(answer.doubt, (None, ""))
    speed, length, time, heading = answer.value.tolist()
    followed = math.isfinite(length)
    uncertainty, flow = None, None
    if followed:
        uncertainty = Uncertainty.of_flow((speed, length, time), answer.error[:3].tolist())
        about_zero, _ = rebased(answer.flow[:6], -answer.flow[6:])
        kx, ky = about_zero[4:]
        flow = WaveFlow(np.array([[kx, ky], [-ky, kx]]), about_zero[[0, 2]], about_zero[[1, 3]])
    turned = bool(board_settings(estimator, PointMassVehicle(1.0)).any_heading)
    return Estimate(
        speed,
        length,
        time,
        status=answer.status,
        reason=reason,
        backend=backend.name,
        settings=settings_of(backend),
        samples=answer.samples,
        rival_length_scale=answer.rival or math.nan,
        uncertainty=uncertainty,
        doubt=doubt,
        heading=heading if turned or not followed else 0.0,
        flow=flow,
        shape=("square" if turned else "axis") if followed else "",
        length_scales=(length, length) if followed else None,
        **fields,
    )
