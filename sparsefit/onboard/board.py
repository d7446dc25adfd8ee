"""The recurrence that flies, in NumPy: a search for cells, then Kalman filters that follow them.

    x' = v,  v' = F(w + u - v) + a,  u' = -2 u + noise,    w of two waves, (kx, ky) and (-ky, kx)

The state of a filter is (x, v, u, a, b, a, b, kx, ky), x and phases counted from an anchor near the
vehicle. Each level of the disturbance u has a filter; they are weighed by their likelihoods.
``templates/sf_flow.c`` is this recurrence in C, function for function, and is what the package
compiles; this reference runs where there is no compiler, and a replay holds the two together.
"""

from __future__ import annotations

import math
from importlib import import_module
from typing import Any

import numpy as np

from sparsefit.arrays import Array
from sparsefit.onboard.sweep import (
    EVEN,
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
    waves,
)

try:
    CompiledFlow: Any = import_module("sparsefit.onboard.compiled").CompiledFlow
except ImportError:  # where there is no compiler
    CompiledFlow = None

LEVELS = np.array([0.003, 0.02, 0.08, 0.3])  # of the disturbance, over U0
RATE, FLOOR = 2.0, 0.1  # of the disturbance [1/s], and its share that is white
GATE, FADE, HORIZON, SETTLED, ANNEAL = 25.0, 0.998, 100.0, 64.0, 8.0
WALK = np.array([0.002] * 4 + [0.0005] * 2)  # of amplitudes and wavevectors, over theirs, in 1 s
LARGEST, GAP = 1e7, 20.0
N, FLOW = 12, slice(6, 12)
OK, GAP_TAKEN, BAD_SAMPLE, BAD_TIME = 0, 3, 4, 5  # of `update`, as `sf_status` of the C


class Board:
    """The estimator on board, one instance for one vehicle; `update` and `estimate` as in C."""

    def __init__(self, settings: BoardSettings) -> None:
        self.settings = settings
        self.samples = self.suspects = 0
        self.time_ns = self.suspect_ns = 0
        self.sweep = Sweep(settings)
        self.step = self.counted = 0.0
        self.origin, self.measured, self.noise = np.zeros(2), np.zeros(2), np.zeros(2)
        self.history: list[Array] = []
        self.anchor, self.following = np.zeros(2), False
        self._reset()

    def _reset(self) -> None:
        """Filters that have seen nothing."""
        levels = len(LEVELS)
        self.state, self.covariance = np.zeros((levels, N)), np.zeros((levels, N, N))
        self.log_likelihood, self.square = np.zeros(levels), np.ones(levels)
        self.product, self.last = np.zeros(levels), np.zeros((levels, 4))
        self.age, self.gated, self.remaining = 0.0, 0.0, np.zeros(2)

    def update(
        self, time_ns: int, x: float, y: float, vx: float, vy: float, measured: Any = None
    ) -> int:
        """Take a sample at a time [ns]; the status, as `sf_update` of the C."""
        z = np.array([x, y, vx, vy], dtype=np.float64)
        given = z if measured is None else np.concatenate([z, measured])
        if not (np.abs(given) <= LARGEST).all():
            return BAD_SAMPLE
        if not self.samples:
            self.time_ns, self.origin = time_ns, z[:2].copy()
        h, status = max(time_ns - self.time_ns, 0) * 1e-9, OK
        if self.samples and (not h > 0 or (self.step > 0 and h > GAP * self.step)):
            since = max(time_ns - self.suspect_ns, 0) * 1e-9
            later = self.suspects > 0 and since > 0
            if not later or (since > GAP * self.step and self.suspects < 2):
                self.suspects, self.suspect_ns = self.suspects + 1 if later else 1, time_ns
                return BAD_TIME
            h = self.step = since  # the last one and this: a new clock
            status = GAP_TAKEN
        elif self.samples:
            self.step += (h - self.step) / (16.0 if self.step > 0 else 1.0)
        self.suspects, self.time_ns, self.samples = 0, time_ns, self.samples + 1
        settings = self.settings
        push = np.array([settings.thrust_x, settings.thrust_y])
        z[:2] -= self.origin
        if measured is not None:
            latest = np.array(measured, dtype=np.float64)
            before = self.measured if self.samples > 1 else latest
            push = push + settings.thrust_scale * (before + latest) / 2
            self.measured = latest
        if h > 1.5 * self.step:
            self.history = []
        if status == GAP_TAKEN:
            self._resume(z)
        self._measure_noise(z)
        row = self.sweep.take(z, h, push)
        if row is not None and self.following:
            flow = self.state[int(np.argmax(self.log_likelihood)), FLOW]
            w, _, _ = waves(flow, *(row[:2] - self.anchor))
            squares = np.array([np.sum((row[2:] - w) ** 2), np.sum(row[2:] ** 2)])
            self.remaining = self.remaining + (squares - self.remaining) / 32
        if not self.following:
            if (peak := self.sweep.work()) is not None:
                self.sweep.doubt = self._start(peak, z)
        elif status == OK:
            self._follow(z, h, push)
        return status

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

    def _resume(self, z: Array) -> None:
        """Go on after a gap or from another clock: place and velocity are measured anew."""
        away = z[:2] - self.anchor
        self.history, self.sweep.block = [], []
        if self.following:
            self._settle(away, z)
        self.anchor = z[:2].copy()

    def _settle(self, away: Array, z: Array) -> None:
        """Place and velocity, ``away`` (2,) from the anchor, are as measured; a gust is unknown."""
        self.state[:, :2], self.state[:, 2:4], self.state[:, 4:6] = away, z[2:], 0.0
        self.covariance[:, :6, :] = self.covariance[:, :, :6] = 0.0
        for level, state in enumerate(self.state):
            gust = (LEVELS[level] * features(state[FLOW])[0][SPEED]) ** 2
            diagonal = [*np.repeat(self.noise, 2), gust, gust]
            self.covariance[level, range(6), range(6)] = diagonal
        self._rebase(away)

    def _rebase(self, away: Array) -> None:
        """Count places and phases of the filters from another anchor, ``away`` (2,) from it."""
        for level, state in enumerate(self.state):
            moved, by_flow = rebased(state[FLOW], away)
            jacobian = np.eye(N)
            jacobian[FLOW, FLOW] = by_flow
            state[FLOW] = moved
            self.covariance[level] = jacobian @ self.covariance[level] @ jacobian.T
        self.state[:, :2] -= away

    # ---- the filters

    def _acceleration(self, z: Array, push: Array) -> tuple[Array, Array, Array]:
        """v' (2, l) at states z (12, l), its slope by r (2, 2, l) and gradient (2, 12, l)."""
        settings = self.settings
        w, place, by_flow = waves(z[FLOW], z[0], z[1])
        r = w + z[4:6] - z[2:4]
        speed = np.hypot(*r)
        own = 1.0 / settings.response_time + settings.drag_coefficient * speed
        bend = settings.drag_coefficient / np.where(speed > 0, speed, 1.0)
        slope = own * np.eye(2)[:, :, None] + bend * r[:, None] * r
        minus = -np.broadcast_to(np.eye(2)[:, :, None], slope.shape)
        inner = np.concatenate([place, minus, -minus, by_flow], axis=1)
        return own * r + push[:, None], slope, np.einsum("ijl,jkl->ikl", slope, inner)

    def _predict(self, h: float, push: Array, speed: float) -> None:
        """All filters h seconds later, under a push (2,), at disturbances over a speed [m/s]."""
        z, total, decay = self.state.T.copy(), np.zeros((4, len(LEVELS))), math.exp(-RATE * h)
        for ahead, weight in ((0.5, 1.0), (0.5, 2.0), (1.0, 2.0), (0.0, 1.0)):  # Runge and Kutta
            pull, *slopes = self._acceleration(z, push)
            if ahead == 1.0:
                slope, by_state = slopes  # in the middle of the step
            rate = np.concatenate([z[2:4], pull])
            total += weight * rate
            z[:4] = self.state.T[:4] + ahead * h * rate
        self.state[:, :4] += (h / 6 * total).T
        self.state[:, 4:6] *= decay
        jacobian = np.moveaxis(by_state, -1, 0)  # (l, 2, 12)
        bent = jacobian[:, :, 2:4] @ jacobian
        bent[:, :, 2:4] += jacobian[:, :, :2]
        bent[:, :, 4:6] -= RATE * jacobian[:, :, 4:6]
        step = np.broadcast_to(np.eye(N), (len(LEVELS), N, N)).copy()
        step[:, :2] += h**2 / 2 * jacobian
        step[:, range(2), range(2, 4)] += h
        step[:, 2:4] += h * jacobian + h**2 / 2 * bent
        step[:, range(4, 6), range(4, 6)] = decay
        covariance = step @ self.covariance @ np.swapaxes(step, 1, 2)
        level = (LEVELS * speed) ** 2
        white = FLOOR**2 * level * (2 / RATE) * (slope[0, 0] ** 2 + slope[0, 1] ** 2) * h
        x, v, u = np.arange(6).reshape(3, 2)
        for i, j, kick in (
            *((u, u, level * (1 - decay**2)), (v, v, white), (x, x, white * h**2 / 3)),
            *((x, v, white * h / 2), (v, x, white * h / 2)),
        ):
            covariance[:, i, j] += kick[:, None]
        self.covariance = covariance

    def _correct(self, place: int, measured: float, variance: float) -> tuple[Array, Array]:
        """Take a measured number; normalised innovations (l,) and their log-likelihoods (l,)."""
        spread = self.covariance[:, place, place] + variance
        innovation = measured - self.state[:, place]
        unit = innovation / np.sqrt(spread)
        inside = unit**2 < GATE
        gain = self.covariance[:, :, place] / spread[:, None] * inside[:, None]
        self.state += gain * innovation[:, None]
        self.covariance -= spread[:, None, None] * gain[:, :, None] * gain[:, None, :]
        unit = np.clip(unit, -math.sqrt(GATE), math.sqrt(GATE))
        return unit, -np.log(spread) / 2 - unit**2 / 2

    def _follow(self, z: Array, h: float, push: Array) -> None:
        """Follow the flow with one sample z (4,), h seconds after the last."""
        settings = self.settings
        speed = features(self.state[int(np.argmax(self.log_likelihood)), FLOW])[0][SPEED]
        rate = 1.0 / settings.response_time + 2.0 * settings.drag_coefficient * speed
        parts = 1 + math.floor(min(2 * h * rate, 15.0))
        for _ in range(parts):
            self._predict(h / parts, push, speed)
        anneal = 1 + ANNEAL * math.exp(-self.age / 50)
        away = z[:2] - self.anchor
        units, likelihood = np.zeros((len(LEVELS), 4)), np.zeros(len(LEVELS))
        for i, measured in enumerate((*away, *z[2:])):
            units[:, i], more = self._correct(i, measured, self.noise[i // 2] * anneal)
            likelihood += more
        fade = 1 / (self.age + 2 if self.age < HORIZON else HORIZON + 2)
        self.log_likelihood = FADE * self.log_likelihood + likelihood
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
        outlier = bool((units**2 >= GATE).any(axis=1).all())
        self.gated += (outlier - self.gated) / 32
        astray = self.square.min() > 2 or self.remaining[0] > self.remaining[1] / 2
        if self.gated > 0.3 or (self.age > 150 and astray):  # lost
            self.following = self.sweep.sweeping = False
            self.sweep.doubt = BoardDoubt.NO_FLOW

    def _start(self, peak: Peak, z: Array) -> BoardDoubt:
        """Start the filters from a peak, at the last sample z (4,)."""
        variance = peak.residual / (2 * self.sweep.count - M)
        ridge = np.diag(1e-4 * np.diag(peak.information) + 1e-12)
        inverse = variance * np.asarray(np.linalg.inv(peak.information + ridge), np.float64)
        value, by_flow = features(peak.flow)
        error = np.einsum("gi,ij,gj->g", by_flow, inverse, by_flow)
        if value[UNEVEN] ** 2 > 40 * error[UNEVEN]:
            return BoardDoubt.SHAPE
        both, share = [SPEED, LENGTH], np.array([0.03, 0.01])
        if not (error[both] < (share * value[both]) ** 2).all():
            return BoardDoubt.IMPRECISE
        self._reset()
        self.state[:, FLOW], self.covariance[:, FLOW, FLOW] = peak.flow, 4 * inverse
        self._settle(z[:2] - self.sweep.middle, z)
        self.anchor, self.following = z[:2].copy(), True
        return BoardDoubt.SETTLING

    # ---- the answer

    def estimate(self) -> BoardAnswer:
        """Answer from all samples so far: the filters weighed by their likelihoods."""
        if not self.following:
            doubt, nothing = self.sweep.doubt, np.full(4, math.nan)
            rival = self.sweep.rival if doubt is BoardDoubt.RIVAL else 0.0
            return BoardAnswer(doubt, self.samples, nothing, np.zeros(4), rival=rival)
        weight = np.exp(self.log_likelihood - self.log_likelihood.max())
        weight /= weight.sum()
        flow: Array = weight @ self.state[:, FLOW]
        apart = self.state[:, FLOW] - flow
        spreads = self.covariance[:, FLOW, FLOW] + apart[:, :, None] * apart[:, None]
        covariance = np.einsum("l,lij->ij", weight, spreads)
        value, by_flow = features(flow)  # both waves are as strong: a condition
        uneven, gradient = value[UNEVEN], by_flow[UNEVEN]
        spread = float(gradient @ covariance @ gradient)
        gain = covariance @ gradient / spread
        flow = flow - gain * uneven
        innovation = float(weight @ self.square)
        covariance = (covariance - spread * np.outer(gain, gain)) * max(innovation, 1.0)
        value, by_flow = features(flow)
        variance = np.einsum("gi,ij,gj->g", by_flow, covariance, by_flow)
        value, error = value[:UNEVEN], np.sqrt(np.maximum(variance[:UNEVEN], 0.0))
        remaining = self.remaining
        unexplained = float(remaining[0] / remaining[1]) if remaining[1] > 0 else 1.0
        correlation = float(weight @ self.product)
        settings, doubt = self.settings, BoardDoubt.NO_DOUBT
        if self.age < SETTLED:
            doubt = BoardDoubt.SETTLING
        elif not innovation < 1.6 or correlation > 0.5 or unexplained > 0.3:
            doubt = BoardDoubt.INNOVATIONS
        elif not settings.any_heading and abs(value[HEADING]) > 0.02 + 3 * error[HEADING]:
            doubt = BoardDoubt.TURNED
        elif uneven**2 > 16 * spread and abs(uneven) > EVEN:
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
