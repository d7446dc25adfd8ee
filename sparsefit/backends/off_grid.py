"""What back-ends share that find groups of their own, off the grid."""

from sparsefit.arrays import Array
from sparsefit.backends.continuous_dual import POINTS
from sparsefit.errors import InputError, is_number
from sparsefit.regression.backend import Solution
from sparsefit.regression.problem import RegressionProblem


def found_by(solution: Solution) -> tuple[Array, Array]:
    """The places q (s, p) and weights (c s, n) of a solution with a problem of its own."""
    assert solution.problem is not None
    assert solution.problem.continuum is not None
    assert solution.problem.parameters is not None
    assert solution.weights is not None
    return solution.problem.continuum.places(solution.problem.parameters), solution.weights


def refusal(
    name: str, problem: RegressionProblem, lower: float | None, upper: float | None
) -> Solution | None:
    """Why a back-end that makes its own columns cannot search [lower, upper]; None if it can.

    A problem without a continuum, rows in one place, more scan points than memory holds.
    """
    continuum = problem.continuum
    if continuum is None:
        return Solution(
            None,
            "error",
            f"{name} makes its own columns and needs the position of every row; build the problem "
            "with Library of family 'cells', or of one flight 'waves' in groups by wave, where the "
            "vehicle is known and whose columns fit in memory (a coarser grid or fewer samples "
            "where they do not), not in the weak form; or use group-lasso",
        )
    if not continuum.extent > 0:
        return Solution(None, "unidentifiable", f"{name}: the flight stands still: no extent")
    if continuum.scan_points(continuum.interval(lower, upper)) > POINTS:
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
