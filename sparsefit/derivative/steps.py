"""How even the time steps of a flight are: two questions, each with its own tolerance."""

import numpy as np

from sparsefit.arrays import Array, IntArray
from sparsefit.errors import InputError

ONE_STEP = 1e-6  # relative: what a polynomial through the samples takes for one and the same step
NEARLY_EVEN = 1e-3  # relative: beyond it, weights for even steps say nothing about a filter


def uniform_step(time: Array) -> float:
    """Return the mean step [s] of ``time`` [s], (m,).

    Raises:
        InputError: if a step differs from the mean by more than `ONE_STEP` of it and the rounding
            of the clock, which is coarse where time counts from 1970.
    """
    steps = np.diff(time)
    mean = float(time[-1] - time[0]) / len(steps)
    row = int(np.argmax(np.abs(steps - mean)))
    if abs(steps[row] - mean) > ONE_STEP * mean + clock_rounding(time):
        raise InputError(
            f"savgol needs uniform time steps; the step after row {row} is {steps[row]:.6g} s, "
            f"the mean {mean:.6g} s: use central or midpoint"
        )
    return mean


def is_even(time: Array, step: float, starts: IntArray) -> bool:
    """Tell whether the steps of ``time`` [s], (m,), are ``step`` [s], but those before ``starts``.

    To the tolerance of `uniform_step`.
    """
    away = np.abs(np.diff(time) - step)
    away[starts - 1] = 0.0
    return bool(away.max() <= ONE_STEP * step + clock_rounding(time))


def nearly_even(steps: Array, mean: float) -> bool:
    """Tell whether all ``steps`` [s], (m - 1,), are within `NEARLY_EVEN` of their mean [s]."""
    return bool(np.abs(steps - mean).max() <= NEARLY_EVEN * mean)


def clock_rounding(time: Array) -> float:
    """Return the rounding [s] of a difference of two times [s], (m,)."""
    return 4.0 * float(np.spacing(np.abs(time).max()))
