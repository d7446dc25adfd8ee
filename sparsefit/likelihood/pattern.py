"""Patterns of flow: plane waves of a stream function, constrained by a shape.

    psi = sum_j a_j cos(phi_j) + b_j sin(phi_j),   phi_j = k_j . (x - x0 - c (t - t0)),
    w = (d psi/dy, -d psi/dx)

Cells have two waves k = q + p and q - p of one amplitude A, p and q at right angles:
|p| = pi/L_x at the heading, |q| = pi/L_y, and U0 = A sqrt(|k_1|^2 + |k_2|^2). "axis" has no heading
and L_x = L_y; "square" any heading; "rectangle" two lengths. "scales" are several "axis" flows of
different U0 and L. The waves of "pair" and "several" have independent wavevectors and amplitudes.
Every shape may drift with a velocity c.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sparsefit.arrays import Array
from sparsefit.cached import cached_property
from sparsefit.errors import InputError

SHAPES = ("axis", "square", "rectangle", "pair", "scales", "several")
CELLS = {
    "axis": ("mean_velocity", "length_scale", "phase_1", "phase_2"),
    "square": ("mean_velocity", "length_scale", "heading", "phase_1", "phase_2"),
    "rectangle": (
        *("mean_velocity", "length_scale_x", "length_scale_y", "heading"),
        *("phase_1", "phase_2"),
    ),
}
DRIFT = ("drift_x", "drift_y")
WAVE = ("kx", "ky", "cosine", "sine", "frequency")  # the elementary quantities of a wave


@dataclass(frozen=True)
class StreamPattern:
    """A flow of waves in a shape. Raises InputError if a value is not finite."""

    shape: str  # of `SHAPES`
    #: the parameters of the shape, in the order of `names`; lengths [m], velocities [m/s], angles
    #: and phases [rad], wavevectors [rad/m], amplitudes of psi [m^2/s]
    values: tuple[float, ...]
    drifting: bool = False  # whether the pattern moves; its velocity stands last in `values`
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)  # (x0, y0, t0) [m, m, s] of the phases
    silent: tuple[tuple[float, ...], ...] = ()  # (kx, ky) [rad/m] of waves of amplitude 0 beside

    def __post_init__(self) -> None:
        """Check the values."""
        if not np.isfinite(self.values).all():
            raise InputError(f"a {self.shape} pattern needs finite values; got {self.values}")

    @classmethod
    def of_waves(
        cls,
        shape: str,
        wavevectors: Array,
        cosine: Array,
        sine: Array,
        drift: Sequence[float] | None = None,
    ) -> StreamPattern:
        """Return the pattern of a shape nearest to given waves.

        wavevectors: k (j, 2) [rad/m], two of cells; cosine, sine: a, b (j,) [m^2/s]; drift: the
        velocity c (2,) [m/s] of a pattern that moves.
        """
        waves = np.array(wavevectors, dtype=np.float64).reshape(-1, 2)
        a, b = np.array(cosine, dtype=np.float64), np.array(sine, dtype=np.float64)
        moving = () if drift is None else (float(drift[0]), float(drift[1]))
        if shape == "scales":
            flows = [slice(j, j + 2) for j in range(0, len(waves), 2)]
            cells = [cls.of_waves("axis", waves[own], a[own], b[own]).values for own in flows]
            return cls(shape, (*np.concatenate(cells).tolist(), *moving), drift is not None)
        if shape not in CELLS:
            values = np.column_stack([waves, a, b]).ravel()
            return cls(shape, (*values.tolist(), *moving), drift is not None)
        speed = math.sqrt(float(np.sum(waves**2 * (a**2 + b**2)[:, None])))
        p, q = 0.5 * (waves[0] - waves[1]), 0.5 * (waves[0] + waves[1])
        if abs(p[0]) < abs(p[1]):  # the other sign of the second wave exchanges p and q
            waves[1], b[1], p, q = -waves[1], -b[1], q, p
        if p[0] < 0.0:
            waves, a, b, p = waves[::-1], a[::-1], b[::-1], -p
        if p[0] * q[1] < p[1] * q[0]:
            waves, a, b, q = -waves[::-1], a[::-1], -b[::-1], -q
        phases = np.arctan2(-b, a).tolist()
        heading = 0.5 * (math.atan2(p[1], p[0]) + math.atan2(-q[0], q[1]))
        sides = np.hypot(*p), np.hypot(*q)
        side = math.pi / math.sqrt(float(np.mean(np.square(sides))))
        lengths = {"axis": (side,), "square": (side, heading)}.get(
            shape, (math.pi / float(sides[0]), math.pi / float(sides[1]), heading)
        )
        return cls(shape, (speed, *lengths, *phases, *moving), drift is not None)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """The names of the values; those of a wave j are kx_j, ky_j, cosine_j, sine_j."""
        count = (len(self.values) - 2 * self.drifting) // 4
        own = ("mean_velocity", "length_scale", "phase", "other_phase")
        each = own if self.shape == "scales" else WAVE[:4]
        free = tuple(f"{name}_{j + 1}" for j in range(count) for name in each)
        return CELLS.get(self.shape, free) + DRIFT * self.drifting

    @property
    def drift(self) -> tuple[float, float]:
        """The velocity (c_x, c_y) [m/s] of the pattern, (0, 0) of a steady one."""
        return (self.values[-2], self.values[-1]) if self.drifting else (0.0, 0.0)

    def speed_through(self, velocity: Array) -> Array:
        """The speed (m,) relative to the pattern of a vehicle with the velocity (m, 2) [m/s]."""
        speed: Array = np.hypot(*(velocity - self.drift).T)
        return speed

    @cached_property
    def waves(self) -> Array:
        """The elementary quantities (j, 5): kx, ky [rad/m], a, b [m^2/s] and omega [rad/s]."""
        waves = _expanded(self.shape, np.array(self.values)[:, None], self.drifting)[:, :, 0]
        silent = np.zeros((len(self.silent), 5))
        silent[:, :2] = np.array(self.silent).reshape(-1, 2)
        return np.concatenate([waves, silent])

    @cached_property
    def jacobian(self) -> Array:
        """The derivatives (5 j, p) of the elementary quantities by the values (complex steps)."""
        pushed = np.array(self.values)[:, None] + 1e-30j * np.eye(len(self.values))
        slopes = _expanded(self.shape, pushed, self.drifting).imag / 1e-30
        silent = np.zeros((5 * len(self.silent), len(self.values)))
        return np.concatenate([slopes.reshape(-1, len(self.values)), silent])

    @property
    def mean_velocity(self) -> float:
        """U0 = sqrt(sum |k|^2 (a^2 + b^2)) [m/s]."""
        kx, ky, a, b, _ = self.waves.T
        return math.sqrt(float(np.sum((kx**2 + ky**2) * (a**2 + b**2))))

    @property
    def length_scale(self) -> float:
        """L = sqrt(2) pi / sqrt(mean |k|^2) [m], the side of square cells."""
        kx, ky = self.waves[:, :2].T
        return math.pi * math.sqrt(2.0 / float(np.mean(kx**2 + ky**2)))

    @property
    def bound(self) -> tuple[str, ...]:
        """The freedoms of two waves that the shape does not give them (`causes.SHAPES`)."""
        given = {"turn": self.shape == "pair", "drift": self.drifting}
        pair = len(self.waves) == 2 and self.shape != "several"
        return tuple(name for name, free in given.items() if pair and not free)

    def apart(self, other: StreamPattern) -> tuple[float, float]:
        """Relative differences of U0 and L of another pattern from these."""
        speeds = other.mean_velocity / self.mean_velocity
        return speeds - 1.0, other.length_scale / self.length_scale - 1.0

    def is_near(self, wavevectors: Array, distance: float) -> bool:
        """Whether the waves are near to wavevectors (j, 2), by a distance [rad/m] (`paired`)."""
        return paired(self.waves[:, :2], wavevectors, distance)

    def reshaped(self, shape: str, drifting: bool = False) -> StreamPattern:
        """Return these waves in another shape, about the same origin."""
        kx, ky, a, b, _ = self.waves.T
        drift = self.drift if drifting else None
        other = StreamPattern.of_waves(shape, np.column_stack([kx, ky]), a, b, drift)
        return replace(other, origin=self.origin)

    def about(self, origin: tuple[float, float, float]) -> StreamPattern:
        """Return the same flow with its phases counted from another origin (x0, y0, t0)."""
        kx, ky, a, b, omega = self.waves.T
        x, y, t = np.subtract(origin, self.origin)
        shift = kx * x + ky * y - omega * t
        cos, sin = np.cos(shift), np.sin(shift)
        values = np.array(self.values)
        phases = [place for place, name in enumerate(self.names) if "phase_" in name]
        if phases:
            values[phases] = np.angle(np.exp(1j * (values[phases] + shift)))
        else:
            bare = values[: 4 * len(a)].reshape(-1, 4)
            bare[:, 2], bare[:, 3] = a * cos + b * sin, b * cos - a * sin
        return replace(self, values=tuple(values.tolist()), origin=origin)


def paired(waves: Array, others: Array, distance: float) -> bool:
    """Whether wavevectors (j, 2) and others of equal number are near to each other, up to sign."""
    if len(waves) != len(others):
        return False
    apart = np.minimum(*(np.linalg.norm(waves[:, None] + s * others, axis=2) for s in (-1, 1)))
    return bool((apart.min(axis=1) < distance).all() and (apart.min(axis=0) < distance).all())


def _expanded(shape: str, values: Array, drifting: bool) -> Array:
    """The elementary quantities (j, 5, c) of c sets of values (p, c), complex ones too."""
    bare = values[: len(values) - 2 * drifting]
    if shape == "scales":
        flows = bare.reshape(-1, 4, bare.shape[1])
        waves = np.concatenate([_expanded("axis", own, False) for own in flows])
    elif shape in CELLS:
        value = dict(zip(CELLS[shape], bare, strict=True))
        heading, speed = value.get("heading", 0.0 * bare[0]), value["mean_velocity"]
        p = math.pi / value.get("length_scale_x", value.get("length_scale", 1.0))
        q = math.pi / value.get("length_scale_y", value.get("length_scale", 1.0))
        c, s, height = np.cos(heading), np.sin(heading), speed / np.sqrt(2.0 * (p * p + q * q))
        waves = np.array([
            [-q * s + sign * p * c, q * c + sign * p * s,
             height * np.cos(value[phase]), -height * np.sin(value[phase]), 0.0 * speed]
            for sign, phase in ((1.0, "phase_1"), (-1.0, "phase_2"))
        ])  # fmt: skip
    else:
        waves = np.zeros((len(bare) // 4, 5, bare.shape[1]), dtype=values.dtype)
        waves[:, :4] = bare.reshape(-1, 4, bare.shape[1])
    if drifting:  # omega = k . c
        waves[:, 4] = np.sum(waves[:, :2] * values[-2:], axis=1)
    return waves
