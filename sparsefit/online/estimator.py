"""An estimator that follows a stream of samples, each in bounded time, and answers at any moment.

A sample is kept; a block of them becomes rows of theta and Phi by a derivative that needs only
neighbours (`window`), whose products join Z'Z and leave it with the window, a slice of them with
every sample (`sums`). An answer is fitted, located, assessed and judged by the estimator itself, on
the rows of the window and with these sums: it is the batch answer of the same window.
"""

from __future__ import annotations

import math
from time import perf_counter

from sparsefit.derivative.pieces import GAP
from sparsefit.derivative.steps import ONE_STEP
from sparsefit.errors import InputError, finite, pair
from sparsefit.estimator import Doubt, Estimate, Estimator
from sparsefit.estimator.locate import located_one
from sparsefit.estimator.prepare import Prepared
from sparsefit.flight import Flight
from sparsefit.flight.record import LARGEST, SMALLEST_STEP
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.library.nuisance import Nuisance
from sparsefit.modes.stack import Part
from sparsefit.online.lobes import Lobes
from sparsefit.online.settings import Settings
from sparsefit.online.window import Window
from sparsefit.regression.backend import settings_of
from sparsefit.uncertainty import LAGS

REHEARSED = 128  # samples in the window of a rehearsal


class OnlineEstimator:
    """Follows the flow from samples as they come: over the last ``window`` seconds, or fading.

    Args:
        estimator: how the flow is estimated. Its derivative must be a local one that repairs
            nothing (``Derivative("savgol", window=11, repair=False)``; also ``central``,
            ``midpoint`` and ``forward``), and its library cells on a grid of its own, nothing
            unknown. Any back-end and any readout will do.
        vehicle: that flies, as `Flight` has it.
        window: how far back samples count [s], all alike.
        memory: instead of a window, the time in which the weight of a sample falls by e [s];
            samples older than five memories count nothing.

    Raises:
        InputError: where the estimator cannot follow a stream, naming what stands in the way.
    """

    def __init__(
        self,
        estimator: Estimator,
        *,
        vehicle: PointMassVehicle,
        window: float | None = None,
        memory: float | None = None,
    ) -> None:
        self.settings = Settings.of(estimator, vehicle, window, memory)
        self.restarts = 0
        self._last = -math.inf
        self._window = Window(self.settings)
        self._lobes = Lobes.of(self._window)

    def update(
        self, time: float, position: object, velocity: object, thrust: object = None
    ) -> None:
        """Take one sample: time [s], position (x, y) [m] and velocity (vx, vy) [m/s].

        thrust: the measured thrust acceleration [m/s^2], as `Flight` has it, with every sample or
        with none.

        After a gap, a step of more than four mean steps, the window begins anew, and `restarts`
        counts it.

        Raises:
            InputError: where a value is not finite, the time does not increase, or, for
                ``savgol``, time steps are not even. The sample is left out, and nothing changes.
        """
        t = finite("time", time, "s")
        pushed = () if thrust is None else pair("thrust", thrust, "m/s^2")
        state = *pair("position", position, "m"), *pair("velocity", velocity, "m/s")
        sample = (t, *state, *pushed)
        if self._window.count and self._window.pushed is not (thrust is not None):
            raise InputError("give a thrust with every sample or with none; restart() between")
        if max(map(abs, sample)) > LARGEST:
            raise InputError(f"a sample of {max(map(abs, sample)):g}: no flight; change the unit")
        step = t - self._last
        if step <= 0:
            raise InputError(
                f"time must increase strictly: {t} follows {self._last}; leave the sample out, or "
                "restart() where the clock was set"
            )
        if step < SMALLEST_STEP:
            raise InputError(f"samples {step:.3g} s apart are no flight; give time in seconds")
        if self._gap(step, t):
            self.restart()
            self.restarts += 1
        self._window.push(sample)
        self._last = t
        if self._lobes is not None:
            self._lobes.advance()

    def _gap(self, step: float, time: float) -> bool:
        """Whether a step is a gap; InputError where it is uneven and must not be."""
        count = self._window.samples
        if count < 2:
            return False
        mean = (self._last - self._window.begin) / (count - 1)
        if step > GAP * mean:
            return True
        if self.settings.derivative.method == "savgol":
            # The steps of a block, which its derivative checks, may be less even than these.
            slack = 0.45 * ONE_STEP * mean + 3.0 * math.ulp(time)
            if abs(step - mean) > slack:
                raise InputError(
                    f"savgol needs uniform time steps; this one is {step:.6g} s, the mean "
                    f"{mean:.6g} s: use central or midpoint"
                )
        return False

    def rehearse(self) -> None:
        """Follow a made-up flight once and forget it, and all samples so far.

        Before take-off: else the first samples and the first estimate pay for imports, and for what
        is worked out once, about a second.
        """
        step = self.settings.reach / REHEARSED
        size, turn = 2.0 * self.settings.library.grid.upper, 0.05 / step
        self.restart()
        for number in range(2 * REHEARSED):
            time = number * step
            x, y = math.sin(turn * time), math.sin(1.7 * turn * time)
            vx, vy = math.cos(turn * time), 1.7 * math.cos(1.7 * turn * time)
            self.update(time, (size * x, size * y), (size * turn * vx, size * turn * vy))
        self.estimate()
        self.restart()

    def restart(self) -> None:
        """Forget all samples; the next may have any time."""
        self._last = -math.inf
        self._window = Window(self.settings)
        self._lobes = Lobes.of(self._window)

    @property
    def samples(self) -> int:
        """The number of samples that the window holds."""
        return self._window.samples

    @property
    def flight(self) -> Flight:
        """The window's samples as a flight, for any other estimator.

        Raises InputError while there are fewer than three.
        """
        return self._window.flight()

    @property
    def lag(self) -> float:
        """How far the middle of the newest row's neighbours is behind the newest sample [s].

        NaN while there are fewer than two samples. What comes later than a row is not awaited:
        this is all that the answer is late by.
        """
        count = self._window.samples
        if count < 2:
            return math.nan
        mean = (self._last - self._window.begin) / (count - 1)
        return self.settings.behind * mean

    @property
    def nbytes(self) -> int:
        """Bytes of memory that samples, rows and sums take: no more once the window is full."""
        return self._window.nbytes

    def prepared(self, *, scan: bool = False) -> Prepared:
        """The window as back-ends see it, for `Estimator.fit` and `Estimator.read`.

        scan: whether all length scales are scanned for now, which takes milliseconds, instead of
        taking the lobes that the last scan along the stream has found. It holds views of memory
        that later samples overwrite. Raises InputError where the window has too few samples for a
        row, or candidates of zeros.
        """
        start = perf_counter()
        window, settings = self._window, self.settings
        if not window.rows:
            raise InputError(f"{window.samples} samples make no row yet; fly on")
        held, library = window.contents(), settings.library
        problem = library.of_rows(
            held.samples.position, held.theta, held.target, window.columns, sums=held.statistics
        )
        seconds = perf_counter() - start
        lobes = self._lobes.places() if self._lobes and not scan else None
        nuisance = Nuisance(library.unknown, settings.vehicle)
        part = Part(held.samples, nuisance, fading=held.fading)
        return Prepared((part,), library, problem, held.target, seconds, lobes)

    def estimate(self, *, scan: bool = False) -> Estimate:
        """The flow's parameters from the window, as `Estimator.estimate` gives them of `flight`.

        scan: whether all length scales are scanned for now, as the batch does, instead of searching
        the lobes of the last scan along the stream, at most half a window old.
        With too few samples, or none that a length scale could be told from, the status is
        ``unidentifiable``.
        """
        if self._window.rows <= LAGS:
            words = f"{self._window.samples} samples are too few for a length scale; fly longer"
            return self._nothing(Doubt.FEW_SAMPLES, words)
        estimator = self.settings.estimator
        try:
            prepared = self.prepared(scan=scan)
            estimate = estimator.read(prepared, estimator.fit(prepared))
        except InputError as error:  # a flight along an axis, or one that stands still
            return self._nothing(Doubt.SHORT_TRACK, str(error))
        if self._lobes is not None and math.isfinite(estimate.grid_length_scale):
            located = located_one(prepared, estimate.grid_length_scale)
            self._lobes.moved(located.ends, located.space.scan.step)
        return estimate

    def _nothing(self, doubt: Doubt, reason: str) -> Estimate:
        backend = self.settings.estimator.backend
        assert not isinstance(backend, str)
        return Estimate(
            math.nan,
            math.nan,
            math.nan,
            "unidentifiable",
            reason,
            backend.name,
            settings_of(backend),
            samples=self._window.rows,
            doubt=doubt,
        )
