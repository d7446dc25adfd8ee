"""The recurrence that flies, in NumPy: a search for cells, then Kalman filters that follow them.

    x' = v,  v' = F(w + u - v) + a,  u' = -2 u + noise,    w of two waves, (kx, ky) and (-ky, kx)

The state of a filter is (v, u, x, a, b, a, b, kx, ky), x and phases counted from an anchor near the
vehicle. Each level of the disturbance u has a filter; the answer is that of the likeliest.
``templates/sf_flow.c`` is this recurrence in C, function for function, and is what the package
compiles; this reference, with derivatives by complex steps, runs where there is no compiler, and a
replay compares the two.
"""

from __future__ import annotations

import math
from importlib import import_module
from typing import Any

import numpy as np

from sparsefit.arrays import Array
from sparsefit.onboard.sweep import (
    HEADING,
    LENGTH,
    SPEED,
    UNEVEN,
    BoardAnswer,
    BoardDoubt,
    BoardSettings,
    M,
    Peak,
    Sweep,
    features,
    rebased,
    slopes,
    waves,
)

try:
    CompiledFlow: Any = import_module("sparsefit.onboard.compiled").CompiledFlow
except ImportError:  # where there is no compiler
    CompiledFlow = None

LEVELS = np.array([0.003, 0.02, 0.08, 0.3])  # of the disturbance, over U0
RATE = 2.0  # of the disturbance [1/s]
GATE, FADE, HORIZON, SETTLED, ANNEAL = 25.0, 0.998, 100.0, 64.0, 8.0
WALK = np.array([0.002] * 4 + [0.0005] * 2)  # of amplitudes and wavevectors, over theirs, in 1 s
EVEN, UNEXPLAINED, LARGEST, GAP, CHECK_ROWS = 0.03, 0.3, 1e7, 20.0, 8
N, V, U, X, FLOW = 12, slice(0, 2), slice(2, 4), slice(4, 6), slice(6, 12)
MEASURED = (4, 5, 0, 1)  # the places of x, y, vx, vy in a state
OK, GAP_TAKEN, BAD_SAMPLE, BAD_TIME = 0, 3, 4, 5  # of `update`, as `sf_status` of the C


def conditioned(
    state: Array, covariance: Array, gradient: Array, innovation: Array, variance: float
) -> tuple[Array, Array, Array, Array]:
    """States (l, 12) and covariances (l, 12, 12) given a reading of a quantity.

    gradient: of the quantity by the state (12,); innovation: of the reading (l,); variance: of its
    noise. Also returned are normalised innovations (l,) and log-likelihoods (l,); an outlier
    changes these alone.
    """
    spread = covariance @ gradient
    deviation = np.sqrt(spread @ gradient + variance)
    unit = innovation / deviation
    gain = (unit**2 < GATE)[:, None] * spread / deviation[:, None]
    covariance = covariance - gain[:, :, None] * gain[:, None]
    unit = np.clip(unit, -math.sqrt(GATE), math.sqrt(GATE))
    return state + gain * unit[:, None], covariance, unit, -np.log(deviation) - unit**2 / 2


class Board:
    """The estimator on board, one instance for one vehicle; `update` and `estimate` as in C."""

    def __init__(self, settings: BoardSettings) -> None:
        self.settings = settings
        self.samples = self.suspects = 0
        self.time_ns = self.suspect_ns = 0
        self.sweep = Sweep(settings)
        self.step = self.counted = self.age = 0.0
        self.origin, self.measured, self.noise = np.zeros(2), np.zeros(2), np.zeros(2)
        self.history: list[Array] = []
        self.anchor, self.remaining = np.zeros(2), np.zeros(2)
        self.following = self.waiting = False
        self.state, self.covariance = np.zeros((len(LEVELS), N)), np.zeros((len(LEVELS), N, N))
        self.log_likelihood, self.square = np.zeros(len(LEVELS)), np.ones(len(LEVELS))
        self.product, self.last = np.zeros(len(LEVELS)), np.zeros((len(LEVELS), 4))

    def update(
        self, time_ns: int, x: float, y: float, vx: float, vy: float, measured: Any = None
    ) -> int:
        """Take a sample at a time [ns]; the status, as `sf_update` of the C."""
        z = np.array([x, y, vx, vy], dtype=np.float64)
        given = z if measured is None else np.concatenate([z, measured])
        if not (np.abs(given) <= LARGEST).all():
            return BAD_SAMPLE
        h, status = self._advance(time_ns)
        if status == BAD_TIME:
            return status
        if self.samples == 1:
            self.origin = z[:2].copy()
        settings = self.settings
        push = np.array([settings.thrust_x, settings.thrust_y])
        z[:2] -= self.origin
        if measured is not None:
            latest = np.array(measured, dtype=np.float64)
            before = self.measured if self.samples > 1 else latest
            push = push + settings.thrust_scale * (before + latest) / 2
            self.measured = latest
        if status == GAP_TAKEN or h > 1.5 * self.step:
            self.history = []
        if status == GAP_TAKEN:  # positions may count from another place now
            self.sweep.forget()
            self.remaining, self.waiting = np.zeros(2), self.following
        self._measure_noise(z)
        row = self.sweep.take(z, h, push)
        if row is not None and self.following:
            w = waves(self._likeliest[FLOW], row[:2] - self.anchor)
            squares = np.array([np.sum((row[2:] - w) ** 2), np.sum(row[2:] ** 2)])
            self.remaining = self.remaining + (squares - self.remaining) / 32
        if not self.following:
            if (peak := self.sweep.work()) is not None:
                self.sweep.doubt = self._start(peak, z)
        elif not self.waiting:
            self._follow(z, h, push)
        elif self.sweep.count == CHECK_ROWS:
            self._settle(z[:2] - self.anchor, z)
            self.waiting = False
            self.following = bool(self.remaining[0] < UNEXPLAINED / 2 * self.remaining[1])
        return status

    def _advance(self, time_ns: int) -> tuple[float, int]:
        """The time [s] since the last sample, and a status.

        A sample that is out of line waits for the next: if that goes on from it, the clock was
        set, and the time is that between the two.
        """
        h, status = max(time_ns - self.time_ns, 0) * 1e-9 if self.samples else 0.0, OK
        if self.samples and (not h > 0 or (self.step > 0 and h > GAP * self.step)):
            since = max(time_ns - self.suspect_ns, 0) * 1e-9
            later = self.suspects > 0 and since > 0
            if not later or (since > GAP * self.step and self.suspects < 2):
                self.suspects, self.suspect_ns = self.suspects + 1 if later else 1, time_ns
                return h, BAD_TIME
            h = self.step = since
            status = GAP_TAKEN
        self.step += (h - self.step) / (16.0 if self.step > 0 else 1.0)
        self.suspects, self.time_ns, self.samples = 0, time_ns, self.samples + 1
        return h, status

    def _measure_noise(self, z: Array) -> None:
        """Levels of the noise from third differences, whose variance is 20 times as large."""
        if len(self.history) == 3:
            self.counted += self.counted < 500
            third = (z - 3 * self.history[2] + 3 * self.history[1] - self.history[0]) ** 2 / 40
            both = third.reshape(2, 2).sum(axis=1)
            most = 25 * self.noise if self.counted > 20 else np.full(2, math.inf)
            self.noise = self.noise + (np.minimum(both, most) - self.noise) / self.counted
            self.noise = np.maximum(self.noise, (1e-4 * self.settings.lower) ** 2)
        self.history = [*self.history[-2:], z.copy()]

    # ---- the filters

    @property
    def _likeliest(self) -> Array:
        """The state (12,) of the likeliest filter."""
        state: Array = self.state[int(np.argmax(self.log_likelihood))]
        return state

    def _settle(self, away: Array, z: Array) -> None:
        """Restart the filters at a measured z, ``away`` (2,) from their anchor: the flow stays."""
        size = np.hypot(self.state[:, 10], self.state[:, 11])
        gust = LEVELS * size * np.sqrt(np.sum(self.state[:, 6:10] ** 2, axis=1))
        self.state[:, V], self.state[:, U], self.state[:, X] = z[2:], 0.0, away
        self.covariance[:, :6, :] = self.covariance[:, :, :6] = 0.0
        for place, variance in ((V, self.noise[1]), (U, gust[:, None] ** 2), (X, self.noise[0])):
            self.covariance[:, range(N)[place], range(N)[place]] = variance
        self._rebase(away)
        self.anchor = z[:2].copy()

    def _rebase(self, away: Array) -> None:
        """Count positions and phases of the filters from another anchor, ``away`` (2,) from it."""
        for level, state in enumerate(self.state):
            jacobian = np.eye(N)
            jacobian[FLOW, FLOW] = slopes(lambda flow: rebased(flow, away), state[FLOW])
            self.covariance[level] = jacobian @ self.covariance[level] @ jacobian.T
            state[FLOW] = rebased(state[FLOW], away)
        self.state[:, X] -= away

    def _motion(self, z: Array, push: Array) -> Array:
        """Rates (6, ...) of v, u and x in states (12, ...); the decay of u is left out."""
        settings = self.settings
        relative = waves(z[FLOW], z[X]) + z[U] - z[V]
        speed = np.sqrt(np.sum(relative**2, axis=0) + 1e-300)
        own = 1.0 / settings.response_time + settings.drag_coefficient * speed
        pull = own * relative + push.reshape(2, *[1] * (z.ndim - 1))
        return np.concatenate([pull, 0.0 * z[U], z[V]])

    def _predict(self, h: float, push: Array, speed: float) -> None:
        """All filters h seconds later, under a push (2,), at disturbances over a speed [m/s]."""
        decay = math.exp(-RATE * h)
        for level, state in enumerate(self.state):
            z, total, generator = state.copy(), np.zeros(6), np.zeros((N, N))
            for ahead, weight in ((0.5, 1.0), (0.5, 2.0), (1.0, 2.0), (0.0, 1.0)):  # Runge, Kutta
                if ahead == 1.0:  # the gradient in the middle of the step
                    generator[:6] = slopes(lambda each: self._motion(each, push), z)
                rate = self._motion(z, push)
                total += weight * rate
                z[:6] = state[:6] + ahead * h * rate
            state[:6] += h / 6 * total
            state[U] *= decay
            generator[U, U] -= RATE * np.eye(2)
            step = np.eye(N) + h * generator + h**2 / 2 * generator @ generator
            step[U, U] = decay * np.eye(2)
            covariance = step @ self.covariance[level] @ step.T
            covariance[U, U] += (LEVELS[level] * speed) ** 2 * (1 - decay**2) * np.eye(2)
            self.covariance[level] = covariance

    def _follow(self, z: Array, h: float, push: Array) -> None:
        """Follow the flow with one sample z (4,), h seconds after the last."""
        settings = self.settings
        speed = features(self._likeliest[FLOW])[SPEED]
        rate = 1.0 / settings.response_time + 2.0 * settings.drag_coefficient * speed
        parts = 1 + math.floor(min(2 * h * rate, 15.0))
        for _ in range(parts):
            self._predict(h / parts, push, speed)
        anneal = 1 + ANNEAL * math.exp(-self.age / 50)
        away = z[:2] - self.anchor
        units = np.zeros((len(LEVELS), 4))
        self.log_likelihood *= FADE
        for i, (place, value) in enumerate(zip(MEASURED, (*away, *z[2:]), strict=True)):
            self.state, self.covariance, units[:, i], likelihood = conditioned(
                *(self.state, self.covariance, np.eye(N)[place], value - self.state[:, place]),
                self.noise[i // 2] * anneal,
            )
            self.log_likelihood += likelihood
        fade = 1 / (2 + min(self.age, HORIZON))
        self.square = self.square + fade * ((units**2).mean(axis=1) - self.square)
        self.product = self.product + fade * ((units * self.last).mean(axis=1) - self.product)
        self.last = units
        if settings.memory > 0:
            grow = np.ones(N)
            grow[FLOW] = math.exp(h / settings.memory / 2)
            self.covariance *= grow[:, None] * grow
        power = np.sum(self.state[:, 6:10] ** 2, axis=1, keepdims=True) / 2
        size = np.sum(self.state[:, 10:] ** 2, axis=1, keepdims=True)
        walk = h * WALK**2 * np.concatenate([np.repeat(power, 4, 1), np.repeat(size, 2, 1)], 1)
        self.covariance[:, range(6, N), range(6, N)] += walk
        if away @ away > (settings.lower / 2) ** 2:
            self._rebase(away)
            self.anchor = z[:2].copy()
        self.age += 1
        astray = self.square.min() > 2 or self.remaining[0] > self.remaining[1] / 2
        if self.age > 150 and astray:  # lost
            self.following = False
            self.sweep.forget()

    def _start(self, peak: Peak, z: Array) -> BoardDoubt:
        """Start the filters from a refined candidate: its waves, conditioned on every row."""
        sweep, (places, speeds) = self.sweep, self.sweep.rows
        variance = (1.0 - peak.score) * sweep.total / (2 * sweep.count - M)
        flow = sweep.fit(peak.size, peak.angle)[1]
        state, covariance = np.zeros((1, N)), np.zeros((1, N, N))
        state[0, FLOW] = flow
        covariance[0, range(6, 10), range(6, 10)] = flow[:4] @ flow[:4]
        covariance[0, range(10, N), range(10, N)] = sweep.spacing**2
        for place, measured in zip(places.T, speeds.T, strict=True):
            gradients = np.zeros((2, N))
            gradients[:, FLOW] = slopes(lambda own, at=place: waves(own, at), flow)  # type: ignore
            w = waves(flow, place)
            for r in range(2):
                expected = w[r] + gradients[r, FLOW] @ (state[0, FLOW] - flow)
                innovation = np.array([measured[r] - expected])
                state, covariance, *_ = conditioned(
                    state, covariance, gradients[r], innovation, 4 * variance
                )
        value, gradient = features(state[0, FLOW]), slopes(features, state[0, FLOW])
        error = np.einsum("gi,ij,gj->g", gradient, covariance[0, FLOW, FLOW], gradient)
        both, share = [SPEED, LENGTH], np.array([0.06, 0.02])
        if not (error[both] < (share * value[both]) ** 2).all():
            return BoardDoubt.IMPRECISE
        if abs(value[UNEVEN]) > 10 * EVEN:
            return BoardDoubt.SHAPE
        levels = len(LEVELS)
        self.state, self.covariance = state.repeat(levels, 0), covariance.repeat(levels, 0)
        self.log_likelihood, self.square = np.zeros(levels), np.ones(levels)
        self.product, self.last = np.zeros(levels), np.zeros((levels, 4))
        self.age, self.remaining, self.following = 0.0, np.zeros(2), True
        self._settle(z[:2] - sweep.middle, z)
        return BoardDoubt.SETTLING

    # ---- the answer

    def estimate(self) -> BoardAnswer:
        """Answer from all samples so far: that of the likeliest filter."""
        if not self.following:
            doubt, nothing = self.sweep.doubt, np.full(4, math.nan)
            rival = self.sweep.rival if doubt is BoardDoubt.RIVAL else 0.0
            return BoardAnswer(doubt, self.samples, nothing, np.zeros(4), rival=rival)
        best = int(np.argmax(self.log_likelihood))
        state, covariance = self.state[best : best + 1], self.covariance[best : best + 1]
        uneven, gradient = features(state[0, FLOW])[UNEVEN], np.zeros(N)
        gradient[FLOW] = slopes(features, state[0, FLOW])[UNEVEN]
        state, covariance, unit, _ = conditioned(  # both amplitudes are equal: taken as a reading
            state, covariance, gradient, np.array([-uneven]), 0.0
        )
        flow, innovation = state[0, FLOW], float(self.square[best])
        value, by_flow = features(flow)[:UNEVEN], slopes(features, flow)[:UNEVEN]
        variance = np.einsum("gi,ij,gj->g", by_flow, covariance[0, FLOW, FLOW], by_flow)
        error = np.sqrt(max(innovation, 1.0) * variance)
        remaining = self.remaining
        unexplained = float(remaining[0] / remaining[1]) if remaining[1] > 0 else 1.0
        correlation = float(self.product[best])
        settings, doubt = self.settings, BoardDoubt.NO_DOUBT
        if self.age < SETTLED or self.waiting:
            doubt = BoardDoubt.SETTLING
        elif not innovation < 1.6 or correlation > 0.5 or unexplained > UNEXPLAINED:
            doubt = BoardDoubt.INNOVATIONS
        elif not settings.any_heading and abs(value[HEADING]) > 0.02 + 3 * error[HEADING]:
            doubt = BoardDoubt.TURNED
        elif abs(unit[0]) > 4 and abs(uneven) > EVEN:
            doubt = BoardDoubt.SHAPE
        elif not (error[:3] < settings.precision / 1.96 * value[:3]).all():
            doubt = BoardDoubt.IMPRECISE
        elif not settings.lower <= value[LENGTH] <= settings.upper:
            doubt = BoardDoubt.EDGE
        whole = np.concatenate([flow, self.anchor + self.origin])
        return BoardAnswer(
            doubt, self.samples, value, error, innovation, correlation, unexplained, flow=whole
        )


def board_of(settings: BoardSettings, *, compiled: bool = True) -> Any:
    """Return the compiled board, or `Board` where there is none or it is not wanted."""
    if CompiledFlow is None or not compiled:
        return Board(settings)
    return CompiledFlow(settings)
