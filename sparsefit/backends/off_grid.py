"""Regression problems over length scales off the grid, for back-ends that find their own."""

import math

import numpy as np

from sparsefit.arrays import Array
from sparsefit.backends.continuous_dual import POINTS, Interval, scan_points
from sparsefit.errors import InputError, is_number
from sparsefit.library.builder import CANDIDATES, candidate_columns
from sparsefit.regression.backend import Solution
from sparsefit.regression.problem import RegressionProblem


def columns_at(problem: RegressionProblem, scales: Array) -> RegressionProblem:
    """The problem's rows and target with the 8 candidates of each of the scales (s,) [m]."""
    assert problem.position is not None  # `refusal` answers first
    return RegressionProblem(
        candidate_columns(problem.position, scales),
        problem.target,
        np.repeat(np.arange(len(scales)), len(CANDIDATES)),
        tuple(f"{name} (L = {scale:.6g} m)" for scale in scales for name in CANDIDATES),
        problem.target_names,
        scales,
        position=problem.position,
    )


def found_by(solution: Solution) -> tuple[Array, Array]:
    """The scales (s,) [m] and weights (8 s, n) of a solution with a problem of its own."""
    assert solution.problem is not None
    assert solution.problem.group_scales is not None
    assert solution.weights is not None
    return solution.problem.group_scales, solution.weights


def refusal(
    name: str, problem: RegressionProblem, lower: float | None, upper: float | None
) -> Solution | None:
    """Why a back-end that makes its own columns cannot search [lower, upper] [m]; None if it can.

    Rows without a position, a flight that stands still, more scan points than memory holds.
    """
    if problem.position is None or problem.group_scales is None:
        return Solution(
            None,
            "error",
            f"{name} makes its own columns and needs the position of every row; build the problem "
            "with Library from a flight whose columns fit in memory (a coarser grid or fewer "
            "samples where they do not), or use group-lasso",
        )
    if not np.ptp(problem.position, axis=0).max() > 0:
        return Solution(None, "unidentifiable", f"{name}: the flight stands still: no extent")
    if scan_points(problem.position, interval(problem, lower, upper)) > POINTS:
        return Solution(
            None,
            "error",
            f"{name}: the extent of the flight holds more than {POINTS} scan points "
            "between the bounds; raise lower, or use fewer cells of the flight",
        )
    return None


def checked_bounds(name: str, lower: float | None, upper: float | None) -> None:
    """Raise InputError unless the bounds [m] are positive and in order; None is open."""
    for key, value in (("lower", lower), ("upper", upper)):
        if value is not None and not is_number(value, 0.0, open_low=True):
            raise InputError(f"{name}: {key} must be a length above 0 m, not {value!r}")
    if lower is not None and upper is not None and lower > upper:
        raise InputError(f"{name}: lower ({lower:g} m) is above upper ({upper:g} m); swap them")


def interval(problem: RegressionProblem, lower: float | None, upper: float | None) -> Interval:
    """[pi/upper, pi/lower] [1/m]; where a bound is None, that of the problem's scales."""
    assert problem.group_scales is not None
    low = float(problem.group_scales.min()) if lower is None else lower
    high = float(problem.group_scales.max()) if upper is None else upper
    return math.pi / max(low, high), math.pi / min(low, high)
