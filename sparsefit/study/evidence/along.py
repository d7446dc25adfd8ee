"""A measure along a swept factor: its summaries, and the level from which it suffices."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from sparsefit.arrays import Array
from sparsefit.study.evidence.asked import Asked, refuse
from sparsefit.study.evidence.cases import by_level, factors, level_text
from sparsefit.study.evidence.measure import Measure
from sparsefit.study.evidence.table import Value

if TYPE_CHECKING:
    from sparsefit.study.spec.study import Study

FLIGHTS = {"median": "median flight", "9 of 10": "9 of 10 flights"}  # a summary, in words
UNITS = {
    "duration": "s",
    "sample_rate": "Hz",
    "process_noise": "m/s²",
    "measurement_noise": "m/s / m",
    "mean_velocity": "m/s",
    "length_scale": "m",
    "timescale": "s",
    "response_time": "s",
    "thrust_acceleration": "m/s²",
    "velocity_noise": "m/s",
    "position_noise": "m",
    "position_wander": "m",
    "position_wander_time": "s",
    "initial_position": "m",
    "initial_velocity": "m/s",
    "wind": "m/s",
    "offset": "m",
    "turbulence_length": "m",
    "gap_duration": "s",
    "jump_size": "m",
    "outlier_size": "m/s",
    "heading": "rad",
    "windows": "s",
    "lower": "m",
    "upper": "m",
    "step": "m",
}
NUMBERS = re.compile(r"[-+.e\d]+( / [-+.e\d]+)*")  # a level that has a unit
WORDS = {"together": "number of flights"}  # of keys that do not speak for themselves


def unit_of(factor: str) -> str:
    """Return the unit of the levels of a factor, nothing where they have none."""
    return UNITS.get(factor.rpartition(".")[2], "")


def words_of(factor: str) -> str:
    """Return a factor in words, `measurement noise`."""
    name = factor.rpartition(".")[2]
    return WORDS.get(name, name.replace("_", " "))


def at_level(factor: str, level: Value) -> str:
    """Return a level with its factor and unit, `duration 10 s`."""
    told = "not set" if level is None else level_text(level)
    unit = unit_of(factor) if NUMBERS.fullmatch(told) else ""
    return f"{words_of(factor)} {told} {unit}".rstrip()


def summaries(cases: pd.DataFrame, factor: str, measure: Measure) -> tuple[Array, Array]:
    """Return the levels of a factor of numbers, ascending, and the summary at each."""
    levels = by_level(cases, factor)
    at = np.array([float(level.key[factor] or 0.0) for level in levels])
    return at, np.array([measure.summarise(level.cases) for level in levels])


def level_needed(cases: pd.DataFrame, factor: str, measure: Measure, limit: float) -> float:
    """Return the level from which on, at every later one too, a measure keeps a limit; or inf."""
    levels, values = summaries(cases, factor, measure)
    late = np.flatnonzero(~((values >= limit) if measure.more else (values <= limit)))
    first = int(late[-1]) + 1 if late.size else 0
    return float(levels[first]) if first < len(levels) else math.inf


def axis_of(asked: Asked, study: Study, cases: pd.DataFrame) -> str:
    """The factor that is compared along.

    Raises:
        InputError: if the study does not sweep it.
    """
    swept = factors(cases)
    along = asked.along or (swept[0] if swept else "")
    if along not in swept:
        what = f'"{along}"' if along else "anything"
        raise refuse(study.name, f"does not sweep {what}", f'"{asked.name or asked.compare}"')
    return along
