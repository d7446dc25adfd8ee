"""Regression problems of random flights, every second one of them made degenerate."""

from typing import get_args

import numpy as np

import sparsefit as sf
from sparsefit.model import LengthScaleGrid, Library
from sparsefit.regression.problem import RegressionProblem
from sparsefit.study.data_sets import altered
from sparsefit.study.keys import Alteration
from tests.problems import VEHICLE

SAMPLE_RATE, WINDOW = 100.0, 5  # the derivative drops half a window at either end


def odd_problem(seed):
    """What was done to a random flight, with its seed, and the regression problem."""
    draw = np.random.default_rng([20_240, seed])
    noise = float(draw.choice([0.0, 0.01, 0.1]))
    scales = int(draw.integers(6, 40))
    samples, speed = int(draw.integers(60, 500)), draw.uniform(2, 20)
    flight = sf.simulate_flight(
        sf.CellularFlow(speed, draw.uniform(1.5, 9)),
        VEHICLE,
        duration=(samples + WINDOW - 2) / SAMPLE_RATE,
        sample_rate=SAMPLE_RATE,
        seed=seed,
        velocity_noise=noise,
        position_noise=0.1 * noise,
        process_noise=10.0 * noise,
    )
    grid = LengthScaleGrid(count=scales)
    problem = Library(grid).build(sf.Derivative("savgol", WINDOW, 4)(flight), VEHICLE)
    names = get_args(Alteration)
    name = names[0] if seed % 2 == 0 else names[1 + (seed // 2) % (len(names) - 1)]
    theta, target = altered(name, problem.theta, problem.target, draw)
    odd = RegressionProblem.from_arrays(theta, target, groups=problem.groups)
    return f"{name}, seed {seed}", odd
