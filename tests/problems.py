"""Problems that several tests share: flights, well-conditioned ones and degenerate ones."""

from dataclasses import replace
from functools import cache

import numpy as np

import sparsefit as sf
from sparsefit.model import LengthScaleGrid, Library
from sparsefit.regression.problem import RegressionProblem

VEHICLE = sf.PointMassVehicle(response_time=0.5, thrust_acceleration=(5.0, 3.0))
SMALL_GRID = LengthScaleGrid(2.0, 7.0, step=0.5)
DEGENERATE_KINDS = (
    "duplicate",
    "opposite",
    "wide",
    "perfect",
    "tiny units",
    "huge units",
    "mixed units",
    "low rank",
    "nearly equal",
    "one sample",
)


def fly(flow, vehicle=VEHICLE, *, seed=3, duration=10.0, rate=100.0, noise=(0.0, 0.0), **settings):
    """A flight through a flow; its noise is that of velocity [m/s] and that of position [m]."""
    settings = {"velocity_noise": noise[0], "position_noise": noise[1], **settings}
    return sf.simulate_flight(
        flow, vehicle, duration=duration, sample_rate=rate, seed=seed, **settings
    )


TIME, PLANE = np.array([0.0, 0.1, 0.2, 0.3]), np.arange(8.0).reshape(4, 2)
FIELDS = {"time": TIME, "position": PLANE, "velocity": PLANE, "vehicle": VEHICLE}


def flight_with(**changes):
    """A flight of four samples, or one with other fields."""
    return sf.Flight(**(FIELDS | changes))


def part(flight, rows):
    """These samples of a flight."""
    names = ("time", "position", "velocity")
    return replace(flight, **{name: getattr(flight, name)[rows] for name in names})


@cache
def flight(length_scale=4.2, mean_velocity=15.0, seed=7, duration=10.0, velocity_noise=0.0):
    flow, noise = sf.CellularFlow(mean_velocity, length_scale), (velocity_noise, 0.0)
    return fly(flow, seed=seed, duration=duration, noise=noise)


@cache
def flight_problem(length_scale=4.2, seed=7, velocity_noise=0.0, grid=SMALL_GRID):
    flown = flight(length_scale, seed=seed, velocity_noise=velocity_noise)
    return Library(grid).build([sf.Derivative()(flown)], [VEHICLE])


def regular(seed=0, samples=60, groups=4, size=3, targets=2, noise=0.3):
    """Full rank, correlated columns of unequal scale, groups of equal size, sparse truth."""
    rng = np.random.default_rng(seed)
    columns = groups * size
    mixing = np.eye(columns) + 0.3 * rng.normal(size=(columns, columns)) / np.sqrt(columns)
    theta = rng.normal(size=(samples, columns)) @ mixing * rng.uniform(0.5, 2.0, columns)
    weights = np.zeros((columns, targets))
    weights[:size] = rng.uniform(1.0, 2.0, (size, targets)) * rng.choice([-1, 1], (size, targets))
    target = theta @ weights + noise * rng.normal(size=(samples, targets))
    return RegressionProblem.from_arrays(theta, target, np.repeat(np.arange(groups), size))


def orthonormal(seed=0, samples=40, columns=6, targets=2):
    """Z'Z/m is the identity, and theta is Z with columns of unequal scale."""
    rng = np.random.default_rng(seed)
    basis = np.linalg.qr(rng.normal(size=(samples, columns)))[0] * np.sqrt(samples)
    target = basis @ rng.normal(size=(columns, targets)) + rng.normal(size=(samples, targets))
    scale = np.geomspace(0.1, 10.0, columns)
    return RegressionProblem.from_arrays(basis * scale, target, np.repeat([0, 1], columns // 2))


def degenerate(kind, seed):
    """A small problem that is degenerate in the way of ``kind``."""
    rng = np.random.default_rng([seed, DEGENERATE_KINDS.index(kind)])
    m, k, n = int(rng.integers(8, 20)), int(rng.integers(3, 9)), int(rng.integers(1, 3))
    m = {"wide": int(rng.integers(2, k)) if k > 2 else 2, "one sample": 1}.get(kind, m)
    theta = rng.normal(size=(m, k))
    if kind in ("duplicate", "opposite"):
        theta[:, -1] = theta[:, 0] if kind == "duplicate" else -2 * theta[:, 0]
    elif kind == "low rank":
        theta = rng.normal(size=(m, 2)) @ rng.normal(size=(2, k))
    elif kind == "nearly equal":
        theta[:, 1:] = theta[:, :1] + 1e-7 * theta[:, 1:]
    weights = rng.normal(size=(k, n)) * (rng.random((k, n)) < 0.5)
    weights[0] = 1.0
    target = theta @ weights + (0.0 if kind == "perfect" else 0.3) * rng.normal(size=(m, n))
    factor = {"tiny units": 1e-12, "huge units": 1e12}.get(kind, 1.0)
    if kind == "mixed units":
        theta = theta * np.geomspace(1e-9, 1e9, k)
    return RegressionProblem.from_arrays(
        theta * factor, target * factor**-0.5, rng.integers(0, max(k // 2, 1), k)
    )
