"""Flights of a simulator that shares no code with the package, and what an estimator says of them.

    v' = (1/tau + c |r|) r_lag + a(t)/mu(t) + q noise,   r = w - v,   r_lag' = (r - r_lag)/lag

by a Runge-Kutta scheme of fourth order on 1/400 s; logs are read off by cubic splines, so that
each sensor has its own latency and clock. Flows are sums of waves; those without cells are
functions. Run by hand, one group of worlds at a time:

    python -m tests.worlds own --flights 20
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from types import SimpleNamespace

import numpy as np
import pandas as pd

import sparsefit as sf

STEP = 1.0 / 400.0  # of the integration [s]
COUNTS = ("ok", "silent", "misfit", "named", "error")  # of what an estimator says
MODES = 90  # Fourier modes of a turbulence
Floats = np.ndarray
Field = Callable[[Floats, Floats, float], tuple[Floats, Floats]]


@dataclass(frozen=True)
class World:
    """One kind of flight: how it departs from a known vehicle in steady cells along the axes.

    flow: changes of the waves; air: strength and kind of turbulence, process noise q
    [m/s^2/sqrt(Hz)], uniform wind and its growth as shares of U0, a field without cells; body: true
    over believed vehicle; sensor: faults of the log; causes: the names that explain a misfit.
    """

    name: str
    flow: dict = field(default_factory=dict)
    air: dict = field(default_factory=dict)
    body: dict = field(default_factory=dict)
    sensor: dict = field(default_factory=dict)
    causes: tuple[str, ...] = ()


def _many(name: str, part: str, key: str, values: tuple, causes: tuple = ()) -> list[World]:
    return [World(f"{name} {v}", **{part: {key: v}}, causes=causes) for v in values]


_FAULT = {
    "scale": ("velocity-scale", "position-scale", "velocity_scale", "position_scale"),
    "late": ("latency", "lag"),
}
GROUPS: dict[str, list[World]] = {
    "exact": [
        World(f"noise {x}/{v}", sensor={"noise": (x, v)})
        for x, v in ((0.01, 0.05), (0.05, 0.2), (0.2, 0.8))
    ],
    "process": _many("q", "air", "q", (0.1, 0.3, 1.0)),
    **{
        f"turbulence{share}": [
            World(f"{share} % {kind}", air={"turbulence": (share / 100, kind)})
            for kind in ("broad", "karman", "anisotropic", "3d", "bursts")
        ]
        for share in (10, 30)
    },
    "own": [
        World("nominal"),
        World("turned", flow={"turn": 45.0}),
        World("rectangle", flow={"turn": 45.0, "stretch": (1.2, 2.0)}),
        World("rhomb", flow={"turn": 45.0, "shear": 15.0}),
        World("drift", flow={"drift": (0.02, 0.3)}),
        World("two flows", flow={"second": (0.4, 0.9)}),
        World("short", flow={"duration": (4.0, 8.0)}),
        World("slow", flow={"timescale": (1.0, 3.0)}),
    ],
    "vehicle": [
        *_many("tau", "body", "tau", (1.03, 1.05, 0.9, 1.2), ("response-time", "thrust")),
        *_many("thrust", "body", "thrust", (1.05, 0.9), ("thrust", "wind", "response-time")),
        *_many("thrust turned", "body", "turn", (5.0, 10.0), ("thrust", "wind")),
        *_many("quadratic", "body", "quadratic", (0.03, 0.1), ("drag", "response-time")),
        *_many("mass", "body", "mass", (0.9, 0.8), ("mass", "response-time", "thrust")),
        *_many("lag", "body", "lag", (0.01, 0.03, 0.05), ("lag", "latency")),
    ],
    "sensors": [
        *_many("velocity scale", "sensor", "velocity_scale", (1.03, 1.06, 0.9), _FAULT["scale"]),
        *_many("position scale", "sensor", "position_scale", (1.03, 1.06), _FAULT["scale"]),
        *_many("bias", "sensor", "bias", (0.1, 0.3), ("velocity-bias", "bias", "wind", "thrust")),
        *_many("position late", "sensor", "position_latency", (0.02, 0.1), _FAULT["late"]),
        *_many("velocity late", "sensor", "velocity_latency", (0.02, 0.2), _FAULT["late"]),
        *_many("low-pass", "sensor", "low_pass", (0.02, 0.1), _FAULT["late"]),
        *_many("rotation", "sensor", "rotation", (2.0, 5.0), ("rotation",)),
        *_many("Gauss-Markov", "sensor", "markov", (0.05, 0.2), ("position-noise", "wander")),
        *_many("random walk", "sensor", "walk", (0.02, 0.1), ("position-noise", "wander")),
        *_many("quantised", "sensor", "quantum", (0.1,)),
        *_many("jitter", "sensor", "jitter", (0.05, 0.2)),
        *_many("dropouts", "sensor", "dropouts", (0.05, 0.3)),
        *_many("bursts", "sensor", "bursts", (0.01, 0.03)),
        *_many("heavy tails", "sensor", "tails", (3.0,)),
    ],
    "other": [
        *_many("wind", "air", "wind", (0.02, 0.05, 0.2), ("wind", "thrust")),
        *_many("growing wind", "air", "growth", (0.05, 0.1), ("growing-wind", "wind", "swelling")),
        *_many("swell", "air", "swell", (0.05, 0.2), ("swelling", "decay")),
        *_many("decay", "air", "decay", (0.1, 0.3), ("decay", "swelling")),
    ],
    "none": [
        World(kind, air={"field": kind})
        for kind in ("calm", "thermals", "vortices", "jet", "street", "roll", "shear")
    ]
    + [World(f"{k} alone", air={"turbulence": (1.0, k), "field": "calm"}) for k in ("broad", "3d")],
}
GROUPS["all"] = [world for group in list(GROUPS) for world in GROUPS[group]]


@dataclass(frozen=True)
class Truth:
    """Waves (j, 5) of k_x, k_y, omega, a, b; U0 [m/s] and L [m] of the first flow."""

    waves: Floats
    mean_velocity: float
    length_scale: float


def _cells(rng: np.random.Generator, world: World) -> Truth:
    flow = world.flow
    length = rng.uniform(2, 10)
    speed = length / np.exp(rng.uniform(*np.log(flow.get("timescale", (0.1, 1)))))
    stretch = rng.uniform(*flow["stretch"]) if "stretch" in flow else 1.0
    turn = np.radians(rng.uniform(-1, 1) * flow.get("turn", 0.0))
    shear = np.radians(flow.get("shear", 0.0)) * rng.uniform(0.3, 1)
    kx, ky = np.pi / length, np.pi / length / stretch
    size, angle = np.hypot(kx, ky), np.arctan2(ky, kx)
    angles = np.array([turn + angle + shear, turn - angle - shear])
    drift = rng.uniform(*flow["drift"]) * speed if "drift" in flow else 0.0
    heading = _heading(rng.uniform(0, 2 * np.pi))
    rows = []
    for own in angles:
        k = size * _heading(own)
        phase = rng.uniform(0, 2 * np.pi)
        height = speed / np.sqrt(2) / size
        omega = drift * k @ heading
        rows.append([*k, omega, height * np.cos(phase), height * np.sin(phase)])
    if "second" in flow:
        share, other = rng.uniform(*flow["second"]), length * rng.choice([0.35, 0.5, 1.9, 2.6])
        for sign in (1, -1):
            k, phase = np.pi / other * np.array([1.0, sign]), rng.uniform(0, 2 * np.pi)
            height = share * speed / np.sqrt(2) / np.hypot(*k)
            rows.append([*k, 0.0, height * np.cos(phase), height * np.sin(phase)])
    return Truth(np.array(rows), speed, np.pi * np.sqrt(2) / size)


def _turbulence(rng: np.random.Generator, kind: str, level: float, length: float, speed: float):
    """Random waves with a component's rms of `level` [m/s]; (j, 5), and their slopes if 3-D."""
    k0 = 2 * np.pi / (length * rng.uniform(1, 4))
    size = np.exp(rng.uniform(np.log(k0 / 3), np.log(k0 * 20), MODES))
    angle = rng.uniform(0, 2 * np.pi, MODES)
    if kind == "anisotropic":
        angle = np.where(rng.random(MODES) < 0.75, rng.normal(0.4, 0.3, MODES), angle)
    power = size ** (-2 / 3.0) if kind == "broad" else size * (1 + (size / k0) ** 2) ** (-4 / 3.0)
    k = size[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    along = k[:, ::-1] * [1, -1]
    if kind == "3d":  # a cut through a flow in space: divergence-free no more
        along = rng.normal(size=(MODES, 2)) * size[:, None] / np.sqrt(2) + 0.7 * along
    phase = rng.uniform(0, 2 * np.pi, MODES)
    height = np.sqrt(power) / size
    tall = level / np.sqrt(0.25 * np.sum((height[:, None] * along) ** 2)) * height
    omega = rng.normal(size=MODES) * size * 0.3 * level + size ** (2 / 3) * 0.1 * speed / length
    return np.column_stack([k, omega, tall * np.cos(phase), tall * np.sin(phase)]), along


def _other(kind: str, rng: np.random.Generator) -> Field:
    """A flow without cells, of the speeds that cells have here."""
    speed, size, turn = rng.uniform(3, 15), rng.uniform(2, 8), rng.uniform(0, 2 * np.pi)
    c, s = np.cos(turn), np.sin(turn)
    centres = rng.uniform(-40, 40, (14, 2))
    if kind == "street":
        n = np.arange(-12, 13)
        centres = np.column_stack([3 * size * n, 0.84 * size * (n % 2)])
    signs = np.where(np.arange(len(centres)) % 2, 1.0, -1.0)

    def velocity(x: Floats, y: Floats, t: float) -> tuple[Floats, Floats]:
        along, across = c * x + s * y, c * y - s * x
        if kind == "calm":
            return 0 * x, 0 * x
        if kind in ("jet", "shear", "roll"):
            u = speed * {
                "jet": 1 / np.cosh(np.clip(across / size, -30, 30)) ** 2,
                "shear": across / (5 * size),
                "roll": np.sin(np.pi * across / size),
            }[kind]  # fmt: skip
            return c * u, s * u
        dx = (x if kind != "street" else along)[..., None] - centres[:, 0]
        dy = (y if kind != "street" else across)[..., None] - centres[:, 1]
        fall = signs * speed / size * np.exp(-(dx**2 + dy**2) / (2 * size**2))
        if kind == "thermals":
            return np.sum(dx * fall, -1), np.sum(dy * fall, -1)
        u, v = -np.sum(dy * fall, -1), np.sum(dx * fall, -1)
        return (u, v) if kind != "street" else (c * u - s * v, s * u + c * v)

    return velocity


def draw(world: World, flights: int, seed: int, first: int = 0) -> list[tuple[sf.Flight, Truth]]:
    """Flights of a world with their truth, by a seed, from the first wanted on."""
    import zlib

    name = zlib.crc32(world.name.encode())
    drafts = [_draft(world, np.random.default_rng([seed, name, i])) for i in range(first, flights)]
    every, drawn = _flown(world, drafts), []
    for draft, states in zip(drafts, every.transpose(1, 0, 2), strict=True):
        flight = _logged(states[: len(draft.kicks) + 1], draft, world.sensor)
        decayed = 1.0 - 0.5 * world.air.get("decay", 0.0)  # U0 is that of mid-flight
        truth = replace(draft.truth, mean_velocity=decayed * draft.truth.mean_velocity)
        drawn.append((flight, truth))
    return drawn


def _heading(angle: float) -> Floats:
    return np.array([np.cos(angle), np.sin(angle)])


def _draft(world: World, rng: np.random.Generator) -> SimpleNamespace:
    """A flight before it is flown: all that is drawn of it but the noise of its log."""
    own, air = SimpleNamespace(rng=rng, truth=_cells(rng, world)), world.air
    speed = own.truth.mean_velocity
    own.duration = rng.uniform(*world.flow.get("duration", (10.0, 30.0)))
    own.rate = rng.choice([20.0, 40.0, 50.0, 100.0])
    tau, push = rng.uniform(0.1, 0.5), rng.uniform(3, 8)
    own.vehicle = sf.PointMassVehicle(tau, tuple(push * _heading(rng.uniform(0, 2 * np.pi))))
    own.other = _other(air["field"], rng) if "field" in air else None
    own.gusts, own.slopes = np.zeros((0, 5)), np.zeros((0, 2))
    if "turbulence" in air:
        share, kind = air["turbulence"]
        length = own.truth.length_scale
        own.gusts, own.slopes = _turbulence(rng, kind, share * speed, length, speed)
    own.ahead = speed * _heading(rng.uniform(0, 2 * np.pi))
    own.burst, own.period = rng.uniform(0, 1, 3), rng.uniform(3, 8)
    own.start = rng.uniform(-3, 3, 2)
    steps = int(np.ceil((own.duration + 1.0) / STEP))
    own.kicks = rng.normal(size=(steps, 2)) * air.get("q", 0.0) * np.sqrt(STEP)
    return own


def _flown(world: World, drafts: list[SimpleNamespace]) -> Floats:
    """The states (steps + 1, flights, 6) x, v and the relative wind that a lagging drag follows."""

    def each(name: str) -> Floats:
        return np.array([getattr(own, name) for own in drafts])

    air, body, count = world.air, world.body, len(drafts)
    waves = np.array([own.truth.waves for own in drafts])
    along = waves[..., 1::-1] * [1, -1]
    gusts, slopes, ahead, burst = map(each, ("gusts", "slopes", "ahead", "burst"))
    duration, period = each("duration")[:, None], each("period")[:, None]

    def summed(waves: Floats, slopes: Floats, x: Floats, t: float) -> Floats:
        phase = waves[..., 0] * x[:, :1] + waves[..., 1] * x[:, 1:] - waves[..., 2] * t
        heights = waves[..., 4] * np.cos(phase) - waves[..., 3] * np.sin(phase)
        return (heights[:, None] @ slopes)[:, 0]

    def flow(x: Floats, t: float) -> Floats:
        if drafts[0].other is not None:
            total = np.array([own.other(*at, t) for own, at in zip(drafts, x, strict=True)])
        else:
            total = summed(waves, along, x, t)
        if "swell" in air:
            total *= 1 + air["swell"] * np.sin(2 * np.pi * (t / duration + burst[:, :1]))
        total *= 1 - air.get("decay", 0.0) * t / duration
        if "turbulence" in air:
            gust = summed(gusts, slopes, x, t)
            if air["turbulence"][1] == "bursts":
                gust *= 2 * np.clip(np.sin(2 * np.pi * (t / period + burst[:, 1:2])), 0, None)
            total = total + gust
        if "wind" in air or "growth" in air:
            total += ahead * (air.get("wind", 0.0) + air.get("growth", 0.0) * t / duration)
        return total

    tau = np.array([[own.vehicle.response_time * body.get("tau", 1.0)] for own in drafts])
    quadratic, lag = body.get("quadratic", 0.0), body.get("lag", 0.0)
    turn = np.radians(body.get("turn", 0.0))
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    push = [own.vehicle.thrust_acceleration for own in drafts] @ rotation.T * body.get("thrust", 1)

    def rate_of(state: Floats, t: float) -> Floats:
        relative, rates = flow(state[:, :2], t) - state[:, 2:4], np.zeros_like(state)
        drag = state[:, 4:] if lag else relative
        light = 1.0 - (1.0 - body.get("mass", 1.0)) * t / duration
        stretch = 1 + quadratic * np.hypot(*drag.T)[:, None] if quadratic else 1.0
        rates[:, :2], rates[:, 2:4] = state[:, 2:4], (drag * stretch / tau + push) / light
        if lag:
            rates[:, 4:] = (relative - drag) / lag
        return rates

    steps = max(len(own.kicks) for own in drafts)
    kicks = np.zeros((steps, count, 2))
    for place, own in enumerate(drafts):
        kicks[: len(own.kicks), place] = own.kicks
    state = np.zeros((count, 6))
    state[:, :2] = each("start")
    state[:, 2:4] = flow(state[:, :2], -0.5)
    every = np.empty((steps + 1, count, 6))
    for i in range(steps):
        t = i * STEP - 0.5
        every[i] = state
        k1 = rate_of(state, t)
        k2 = rate_of(state + 0.5 * STEP * k1, t + 0.5 * STEP)
        k3 = rate_of(state + 0.5 * STEP * k2, t + 0.5 * STEP)
        k4 = rate_of(state + STEP * k3, t + STEP)
        state = state + STEP / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        state[:, 2:4] += kicks[i]
    every[-1] = state
    return every


def _logged(every: Floats, draft: SimpleNamespace, sensor: dict) -> sf.Flight:
    from scipy.interpolate import CubicSpline

    rng, rate = draft.rng, draft.rate
    grid = np.arange(len(every)) * STEP - 0.5
    stamps = np.arange(int(draft.duration * rate)) / rate
    keep = np.ones(len(stamps), bool)
    if "dropouts" in sensor:
        keep = rng.random(len(stamps)) >= sensor["dropouts"]
    stamps = stamps[keep]
    true = stamps + rng.uniform(-1, 1, len(stamps)) * sensor.get("jitter", 0.0) / rate
    velocity = every[:, 2:4]
    if "low_pass" in sensor:
        low, share = velocity.copy(), STEP / (sensor["low_pass"] + STEP)
        for i in range(1, len(low)):
            low[i] = low[i - 1] + share * (velocity[i] - low[i - 1])
        velocity = low
    x = CubicSpline(grid, every[:, :2])(true - sensor.get("position_latency", 0.0))
    v = CubicSpline(grid, velocity)(true - sensor.get("velocity_latency", 0.0))
    angle = np.radians(sensor.get("rotation", 0.0))
    v = v @ np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    x, v = x * sensor.get("position_scale", 1.0), v * sensor.get("velocity_scale", 1.0)
    if "bias" in sensor:
        v = v + sensor["bias"] * _heading(rng.uniform(0, 2 * np.pi))
    noise = sensor.get("noise", (0.05, 0.2))
    tails = sensor.get("tails")

    def unit() -> Floats:
        return rng.standard_t(tails, x.shape) / np.sqrt(3.0) if tails else rng.normal(size=x.shape)

    x, v = x + noise[0] * unit(), v + noise[1] * unit()
    steps = np.diff(stamps, prepend=stamps[0])
    if "markov" in sensor:
        wander, size = np.zeros(2), sensor["markov"]
        for i, step in enumerate(steps):
            share = np.exp(-step / 5.0) if i else 0.0
            wander = wander * share + rng.normal(size=2) * size * np.sqrt(1 - share**2)
            x[i] += wander
    if "walk" in sensor:
        x += np.cumsum(rng.normal(size=x.shape) * sensor["walk"] * np.sqrt(steps)[:, None], axis=0)
    if "bursts" in sensor:
        for start in rng.choice(len(x), max(1, int(sensor["bursts"] * len(x) / 5)), replace=False):
            v[start : start + 5] += rng.normal(size=2) * 5.0
    if "quantum" in sensor:
        x, v = (np.round(each / sensor["quantum"]) * sensor["quantum"] for each in (x, v))
    return sf.Flight(stamps, x, v, draft.vehicle)


def answer(estimator: sf.Estimator, flight: sf.Flight, truth: Truth, world: World) -> dict:
    """What an estimator says of a flight; errors [%] and whether intervals hold where it is ok."""
    start, row = time.process_time(), dict.fromkeys(COUNTS, False)
    try:
        e = estimator.estimate(flight)
    except sf.InputError:
        return row | {"error": True, "seconds": time.process_time() - start}
    suspect = str(e.goodness.suspect.cause) if e.goodness and e.goodness.suspect else ""
    named = suspect in world.causes or any(cause in e.reason for cause in world.causes)
    row |= {name: e.status == name for name in ("ok", "misfit", "error")}
    row |= {"named": row["misfit"] and named, "seconds": time.process_time() - start}
    for name, symbol in (("mean_velocity", "U0"), ("length_scale", "L")) if row["ok"] else ():
        value, right = getattr(e, name), getattr(truth, name)
        row[symbol] = 100 * (value / right - 1)
        if e.uncertainty:
            low, high = getattr(e.uncertainty, f"{name}_interval")
            row[f"{symbol} holds"] = float(low <= right <= high)
    wrong = "field" in world.air or max(abs(row.get(name, 0.0)) for name in ("U0", "L")) > 5
    return row | {"silent": row["ok"] and wrong}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("group", choices=GROUPS)
    parser.add_argument("--flights", type=int, default=10, help="of each world")
    parser.add_argument("--seed", type=int, default=2026)
    parser.add_argument("--precision", type=float, default=0.03)
    parser.add_argument("--auto", action="store_true", help='free="auto"')
    given = parser.parse_args()
    settings = {"free": "auto"} if given.auto else {}
    estimator = sf.Estimator(readout=sf.Readout(precision=given.precision), **settings)
    frames = []
    for world in GROUPS[given.group]:
        pairs = draw(world, given.flights, given.seed)
        frames.append(pd.DataFrame([answer(estimator, *pair, world) for pair in pairs]))
        print(f"{world.name:22s}", _words(frames[-1]), flush=True)
    print(f"{'all':22s}", _words(pd.concat(frames)))


def _words(rows: pd.DataFrame) -> str:
    words = [f"{rows[name].sum()} {name}" for name in COUNTS]
    for symbol in ("U0", "L") if "L" in rows else ():
        sizes, holds = rows[symbol].abs(), rows.get(f"{symbol} holds", rows[symbol] * np.nan)
        words += [f"{symbol} rms {np.sqrt((sizes**2).mean()):.2g} median {sizes.median():.2g} %"]
        words += [f"holds {holds.sum():.0f}/{holds.count()}"]
    return "  ".join([f"{len(rows)} flights", *words, f"{rows['seconds'].median():.2f} s"])


if __name__ == "__main__":
    main()
