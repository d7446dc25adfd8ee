"""The measures there are, by name: every table, sentence and picture takes them from here.

A new measure is one `Measure` in `_EVERY`, or one in `FAMILIES` for each of the three parameters.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np
import pandas as pd

from sparsefit.arrays import Array, BoolArray
from sparsefit.study.evidence.cases import (
    PARAMETERS,
    SYMBOLS,
    UNITS,
    estimated,
    has_status,
    in_a_flow,
    numbers,
)
from sparsefit.study.evidence.measure import Failure, Measure, Read
from sparsefit.study.evidence.readings import (
    OFF,
    bounded,
    bounds,
    called_so,
    efficiencies,
    false_alarms,
    half_widths,
    held,
    is_off,
    nearest_hits,
    off_among,
    on_a_grid,
    percent_errors,
    regimes,
    signed_errors,
    sizes,
    where,
)
from sparsefit.study.evidence.summary import TINY

HAIR = 1e-6  # 1.3 L / L is not 1.3 in binary, and stored scales keep 7 digits
LISTED = "docs/study-file.md"  # where a reader finds all names
OWN = "own"  # in place of a unit: that of the parameter
# Of each parameter: `words` with its symbol in place of {}, `read` gives (rows, 3).
FAMILIES = (
    Measure("error", "|error| of {}", "%", sizes, Failure.INFINITE, column="|error|",
            least=TINY),
    Measure("size", "|error| of {}", "%", sizes, column="|error|", least=TINY),
    Measure("signed-error", "error of {}", "%", percent_errors, summary="mean", format="+.2f",
            column="signed % error", least=TINY),
    Measure("deviation", "error of {}", OWN, signed_errors, summary="mean", format="+.2f",
            column="signed error", least=TINY),
    Measure("efficiency", "{} error / Cramér-Rao bound", "", efficiencies, summary="rms",
            column="of error/bound", target=1.0),
    Measure("bounded-error", "{} error", "%",
            lambda cases: where(bounded(cases), percent_errors(cases)), summary="rms",
            column="error", beside="bound", least=TINY),
    Measure("bound", "{} bound", "%", bounds, summary="rms", column="bound"),
    Measure("coverage", "hold the truth", "%", held, summary="share", format=".1f", more=True,
            asked="95 % intervals of {} in flights called ok"),
    Measure("half-width", "half-width of the 95 % interval of {}", "%", half_widths,
            column="half-width", least=TINY),
)  # fmt: skip


def names(kind: str) -> tuple[str, ...]:
    """The names of the measures `kind` of U0, L_w and tau_w, in this order."""
    return tuple(_named(name, kind) for name in PARAMETERS)


def three(kind: str) -> tuple[Measure, ...]:
    """The measures `kind` of U0, L_w and tau_w, in this order."""
    return tuple(MEASURES[name] for name in names(kind))


def _named(parameter: str, kind: str) -> str:
    return f"{parameter.replace('_', '-')}-{kind}"


def _at(read: Read, place: int) -> Read:
    """One column of what is read."""
    return lambda cases: read(cases)[:, place]


def _of_parameter(place: int, parameter: str) -> Iterator[Measure]:
    """The measures of one parameter."""
    symbol = SYMBOLS[parameter]
    for family in FAMILIES:
        yield replace(
            family,
            name=_named(parameter, family.name),
            words=family.words.format(symbol),
            asked=family.asked.format(symbol),
            unit=UNITS[parameter] if family.unit == OWN else family.unit,
            read=_at(family.read, place),
            beside=family.beside and _named(parameter, family.beside),
            of=parameter,
        )


def _column(name: str) -> Read:
    return lambda cases: numbers(cases, name)


def _share(
    name: str, words: str, read: Read, asked: str = "flights", *, more: bool = False,
    failure: Failure = Failure.LEFT_OUT, column: str = "", format: str = ".0f",
) -> Measure:  # fmt: skip
    """A measure that is 1 or 0: a share, of which a failure that counts is no part."""
    return Measure(name, words, "%", read, failure, 0.0, "share", format, column=column,
                   more=more, asked=asked)  # fmt: skip


def _number(name: str, words: str, column: str, read: Read) -> Measure:
    """A measure that is 1 or 0, of which the ones are counted."""
    return Measure(name, words, "", read, Failure.MISS, 0.0, "number", "d", column=column)


def _unseen(cases: pd.DataFrame) -> Array:
    missed = ~(MEASURES["scales-found"].read(cases) > 0)
    return where(missed & has_status(cases, "ok"), np.ones(len(cases)))


def _silent(cases: pd.DataFrame) -> Array:
    """(rows,) whether a case in a flow is called ok and off; every other case in one is not."""
    return where(in_a_flow(cases), has_status(cases, "ok") & is_off(cases))


def _misfit(cases: pd.DataFrame) -> Array:
    """(rows,) whether a case in a flow ended as a misfit."""
    return where(in_a_flow(cases), has_status(cases, "misfit"))


def _ended(status: str) -> Read:
    """(rows,) whether a case ended so, in a flow or not."""
    return lambda cases: has_status(cases, status).astype(float)


def _heading_errors(cases: pd.DataFrame) -> Array:
    """(rows,) |error| of the heading [degrees], up to a quarter turn, of cases with an estimate."""
    quarter = math.pi / 2.0
    turn = numbers(cases, "est_heading") - numbers(cases, "true_heading")
    nearest = np.abs((turn + quarter / 2.0) % quarter - quarter / 2.0)
    return where(estimated(cases), np.degrees(nearest))


def _side_errors(cases: pd.DataFrame) -> Array:
    """(rows,) the larger |error| of the two sides of the cells [%], the shorter first."""
    true, found = (
        np.sort(np.column_stack([numbers(cases, f"{kind}_length_scale_{axis}") for axis in "xy"]))
        for kind in ("true", "est")
    )
    return where(estimated(cases), np.max(100.0 * np.abs(found / true - 1.0), axis=1))


def _drift_errors(cases: pd.DataFrame) -> Array:
    """(rows,) the error of the drift [% of U0]; cells that were found steady drift by 0."""
    true, found = (
        np.column_stack([numbers(cases, f"{kind}_drift_{axis}") for axis in "xy"])
        for kind in ("true", "est")
    )
    shape = cases.get("est_shape", pd.Series("", index=cases.index)).astype(str) != ""
    steady = np.isnan(found).all(axis=1) & np.asarray(shape, dtype=bool)
    found[steady] = 0.0
    off = np.linalg.norm(found - true, axis=1) / numbers(cases, "true_mean_velocity")
    return where(estimated(cases), 100.0 * off)


def _predicted(cases: pd.DataFrame) -> Array:
    """(rows,) the error of the flow along other flights [%], whatever the status."""
    return 100.0 * numbers(cases, "prediction_error")


_EVERY = (
    *(one for place, name in enumerate(PARAMETERS) for one in _of_parameter(place, name)),
    Measure("largest-error", "largest |error| of U0, L_w and τ_w", "%",
            lambda cases: sizes(cases).max(axis=1), Failure.INFINITE, least=TINY),
    replace(_share("hits", "chose the nearest grid scale", nearest_hits, more=True,
                   failure=Failure.MISS, column="hits"), applies=on_a_grid),
    Measure("seconds", "time of a case", "s", _column("seconds"), varies=True),
    Measure("certificate", "certificate", "",
            lambda cases: where(estimated(cases), numbers(cases, "certificate")),
            summary="largest", format=".1e", varies=True),
    _share("answered", "have an estimate", lambda cases: estimated(cases).astype(float),
           more=True),
    _share("off", f"were off by more than {OFF:g} %", lambda cases: off_among(cases, "ok"),
           "flights called ok", column="off", format=".2f"),
    _share("silent-misses", f"were called ok and off by more than {OFF:g} %", _silent,
           column="silent misses", format=".2f"),
    _share("misfits", "were called a misfit", _misfit, column="misfit", format=".1f"),
    *(_share(f"called-{status}", f"ended as {status}", _ended(status), more=status == "ok",
             column=status, format=".1f")
      for status in ("ok", "misfit", "unidentifiable")),
    Measure("r-squared", "R² of the fit", "", _column("r_squared"), more=True, column="R²",
            format=".4f"),
    Measure("heading-error", "|error| of the heading", "°", _heading_errors, column="heading",
            least=TINY),
    Measure("sides-error", "largest |error| of the cells' sides", "%", _side_errors,
            column="sides", least=TINY),
    Measure("drift-error", "error of the drift, of U0", "%", _drift_errors, column="drift",
            least=TINY),
    Measure("prediction-error", "error of the flow along other flights", "%", _predicted,
            Failure.MISS, summary="geometric mean", column="prediction", least=TINY),
    Measure("offered-prediction-error", "error of the flow along other flights, where offered",
            "%", lambda cases: where(estimated(cases), _predicted(cases)),
            Failure.MISS, summary="geometric mean", column="prediction, where offered",
            least=TINY),
    _share("deserved", "deserved it", lambda cases: off_among(cases, "unidentifiable"),
           "flights called unidentifiable", more=True, column="deserved", format=".1f"),
    _share("called-so", "were called so", called_so, "flights without a flow", more=True,
           column="called so", format=".1f"),
    _share("false-alarms", "were false alarms", false_alarms, "flights without a flow",
           column="false alarms", format=".1f"),
    _number("bounded", "cases with a bound", "with bound",
            lambda cases: bounded(cases).astype(float)),
    _number("unseen", "cases called ok without all scales", "unseen", _unseen),
    _share("scales-found", "found every length scale within 1 %",
           _column("scales_within_1_percent"), more=True, failure=Failure.MISS,
           column="all found"),
    Measure("scales-missed", "scales missed", "", _column("scales_missed"), summary="mean",
            format=".2f", column="missed"),
    Measure("scales-spurious", "scales spurious", "", _column("scales_spurious"), summary="mean",
            format=".2f", column="spurious"),
    Measure("scales-length-scale-error", "largest error of L_w", "%",
            _column("scales_max_length_scale_error"), of="length_scale", column="error",
            least=TINY),
    Measure("scales-mean-velocity-error", "largest error of U0", "%",
            _column("scales_max_mean_velocity_error"), of="mean_velocity", column="error",
            least=TINY),
    Measure("cells", "cells flown", "",
            lambda cases: numbers(cases, "extent") / regimes(cases)[:, 0], more=True),
    Measure("scale-ratio", "scale ratio", "", _at(regimes, 1), more=True),
    Measure("velocity-ratio", "velocity ratio", "", _at(regimes, 2), more=True),
)  # fmt: skip
MEASURES: dict[str, Measure] = {measure.name: measure for measure in _EVERY}


def at_least(cases: pd.DataFrame, least: Mapping[str, float]) -> BoolArray:
    """(rows,) whether every named measure reaches its least value."""
    reached = [MEASURES[name].read(cases) >= value - HAIR for name, value in least.items()]
    return np.asarray(np.all(reached, axis=0), dtype=bool)
