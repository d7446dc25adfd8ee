"""Measures: what is read from a case, how it is summarised, and how a failure counts.

A measure gives one number per case, NaN where the case has none. What becomes of that NaN is one
of three named conventions, `Failure`; nothing else in the study's pages decides it. A new measure
is one `Measure` in `MEASURES`: tables, sentences and pictures take it by its name.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Literal, TypeAlias

import numpy as np
import pandas as pd

from sparsefit.arrays import Array, BoolArray
from sparsefit.study.evidence.cases import (
    PARAMETERS,
    SYMBOLS,
    TEX_SYMBOLS,
    UNITS,
    called_empty,
    estimated,
    has_status,
    in_a_flow,
    numbers,
    three_of,
)
from sparsefit.study.evidence.readings import (
    OFF,
    bounded,
    half_width,
    held,
    is_off,
    largest_errors,
    nearest_hits,
    percent_errors,
    regime,
    signed_errors,
    where,
)
from sparsefit.study.evidence.sentence import listed, shown
from sparsefit.study.evidence.table import SIGNIFICANT

Read: TypeAlias = Callable[[pd.DataFrame], Array]
NORMAL_95 = 1.959963984540054
TINY = 1e-6  # percent: a smaller error is quadrature and rounding, no ratio of them says anything
HAIR = 1e-6  # 1.3 L / L is not 1.3 in binary, and stored scales keep 7 digits


class Failure(StrEnum):
    """How a case without the number counts."""

    LEFT_OUT = "left out"  # the summary is over the others; the failures are counted beside it
    MISS = "miss"  # the measure's `miss`: an error of 100 %, or not found
    INFINITE = "infinite"  # worse than any number, so that nobody gains by giving no answer


FAILURE_WORDS = {
    Failure.LEFT_OUT: "over the cases that have one",
    Failure.MISS: "a flight without an estimate counting as {miss:g} %",
    Failure.INFINITE: "a flight without an estimate counting as infinite",
}


@dataclass(frozen=True)
class Measure:
    """One number of a case.

    words: the quantity in a sentence, `|error| of τ_w`; of: its parameter, where it has one.
    read: (rows,) the number of each case in `unit`, NaN where it has none.
    miss: what a failure counts as under `Failure.MISS`.
    summary: the name in `QUANTILES` or `SUMMARIES` by which a group of cases is told.
    format: of the summary in a table and a sentence.
    more: whether more of it is better; target: the value that none can pass, if there is one.
    beside: the measure that a picture draws beside it, over the cases that every line has.
    asked: for shares, the cases of which it is a share, in words.
    """

    name: str
    words: str
    unit: str
    read: Read
    failure: Failure = Failure.LEFT_OUT
    miss: float = 100.0
    summary: str = "median"
    format: str = SIGNIFICANT
    of: str = ""
    more: bool = False
    target: float | None = None
    beside: str = ""
    asked: str = "flights"

    @property
    def symbol(self) -> str:
        """`L_w` for what belongs to a parameter, else its words."""
        return SYMBOLS[self.of] if self.of else self.words

    @property
    def tex(self) -> str:
        """The symbol as TeX, nothing where there is none."""
        return TEX_SYMBOLS[self.of] if self.of else ""

    @property
    def noun(self) -> str:
        """Its words; of a share, whose they are too: `flights called ok that were off`."""
        return f"{self.asked} that {self.words}" if self.summary == "share" else self.words

    @property
    def phrase(self) -> str:
        """The summary of the measure in words, `median |error| of τ_w`."""
        return f"{SUMMARY_WORDS[self.summary]} {self.noun}"

    @property
    def convention(self) -> str:
        """How a failure counts, in words."""
        return FAILURE_WORDS[self.failure].format(miss=self.miss)

    def values(self, cases: pd.DataFrame) -> Array:
        """The numbers of the cases: (rows,), or fewer where a failure is left out."""
        read = self.read(cases)
        if self.failure is Failure.LEFT_OUT:
            return read[~np.isnan(read)]
        return np.where(np.isnan(read), math.inf if self.failure is Failure.INFINITE else self.miss,
                        read)  # fmt: skip

    def summarise(self, cases: pd.DataFrame, summary: str = "") -> float:
        """The summary of a group of cases; NaN of none."""
        values, summary = self.values(cases), summary or self.summary
        if not values.size:
            return math.nan
        if summary not in QUANTILES:
            return SUMMARIES[summary](values)
        # Nothing lies halfway to infinity: there, a quantile is an observed value.
        observed = self.failure is Failure.INFINITE or np.isinf(values).any()
        method: Literal["inverted_cdf", "linear"] = "inverted_cdf" if observed else "linear"
        return float(np.quantile(values, QUANTILES[summary], method=method))

    def say(self, value: float) -> str:
        """A summary as a sentence has it, with its unit."""
        unit = f" {self.unit}" if self.unit else ""
        if math.isnan(value) or math.isinf(value):
            return "no answer"
        if self.summary == "share":
            # No rounding up to all, or down to none.
            near = 0 < value < 1 or 99 < value < 100
            return f"{value:.1f}{unit}" if near else f"{value:.0f}{unit}"
        if self.unit == "%" and 0 <= value < TINY and self.format == SIGNIFICANT:
            return f"below {TINY:f} %"
        signed = self.format.startswith("+")
        return f"{value:{self.format}}{unit}" if signed else f"{shown(value)}{unit}"


QUANTILES = {
    "median": 0.5,
    "first quartile": 0.25,
    "third quartile": 0.75,
    "9 of 10": 0.9,
    "95th percentile": 0.95,
}
SUMMARIES: dict[str, Callable[[Array], float]] = {
    "mean": lambda values: float(np.mean(values)),
    "rms": lambda values: float(np.sqrt(np.mean(values**2))),
    "share": lambda values: 100.0 * float(np.mean(values)),
    "largest": lambda values: float(np.max(values)),
}
SUMMARY_WORDS = {name: name for name in (*QUANTILES, *SUMMARIES)} | {"share": "share of"}


@dataclass(frozen=True)
class Share:
    """`part` of `whole` cases, and the interval that holds the true share in 95 % of studies."""

    part: int
    whole: int

    @classmethod
    def of(cls, measure: Measure, cases: pd.DataFrame) -> Share:
        """Count a measure that is 1 or 0."""
        values = measure.values(cases)
        return cls(int(values.sum()), len(values))

    @property
    def percent(self) -> float:
        """The share [%]; NaN of nothing."""
        return 100.0 * self.part / self.whole if self.whole else math.nan

    @property
    def interval(self) -> tuple[float, float]:
        """The Wilson score interval [%] (Wilson, 1927); NaN of nothing."""
        if not self.whole:
            return math.nan, math.nan
        n, p, z2 = self.whole, self.part / self.whole, NORMAL_95**2
        middle = (p + z2 / (2 * n)) / (1 + z2 / n)
        half = NORMAL_95 / (1 + z2 / n) * math.sqrt(p * (1 - p) / n + z2 / (4 * n * n))
        return 100.0 * max(middle - half, 0.0), 100.0 * min(middle + half, 1.0)


def _of_parameter(place: int, name: str) -> list[Measure]:
    """The measures that each of U0, L_w and tau_w has."""
    symbol, dashed = SYMBOLS[name], name.replace("_", "-")

    def percent(cases: pd.DataFrame) -> Array:
        return percent_errors(cases)[:, place]

    def relative(cases: pd.DataFrame) -> Array:
        return where(bounded(cases), signed_errors(cases)[:, place] / _bounds(cases))

    def _bounds(cases: pd.DataFrame) -> Array:
        return three_of(cases, "bound")[:, place]

    def bound(cases: pd.DataFrame) -> Array:
        return where(bounded(cases), 100.0 * _bounds(cases) / numbers(cases, f"true_{name}"))

    error = Measure(
        f"{dashed}-error", f"|error| of {symbol}", "%", lambda cases: np.abs(percent(cases)),
        failure=Failure.INFINITE, of=name,
    )  # fmt: skip
    signed = Measure(
        f"{dashed}-signed-error", f"error of {symbol}", "%", percent,
        summary="mean", format="+.2f", of=name,
    )  # fmt: skip
    return [
        error,
        signed,
        replace(
            signed, name=f"{dashed}-deviation", unit=UNITS[name],
            read=lambda cases: signed_errors(cases)[:, place],
        ),
        Measure(
            f"{dashed}-efficiency", f"{symbol} error / Cramér-Rao bound", "", relative,
            summary="rms", of=name, target=1.0,
        ),
        Measure(
            f"{dashed}-bounded-error", f"{symbol} error", "%",
            lambda cases: where(bounded(cases), percent(cases)), summary="rms", of=name,
            beside=f"{dashed}-bound",
        ),
        Measure(f"{dashed}-bound", f"{symbol} bound", "%", bound, summary="rms", of=name),
        Measure(
            f"{dashed}-coverage", "hold the truth", "%",
            lambda cases: held(cases, place), summary="share", format=".1f", of=name, more=True,
            asked=f"95 % intervals of {symbol} in flights called ok",
        ),
        Measure(
            f"{dashed}-half-width", f"half-width of the 95 % interval of {symbol}", "%",
            lambda cases: half_width(cases, place), of=name,
        ),
    ]  # fmt: skip


def _flow_called(status: str, found: Callable[[pd.DataFrame], BoolArray]) -> Read:
    """`found`, of the cases in a flow that ended in this status."""

    def read(cases: pd.DataFrame) -> Array:
        return where(in_a_flow(cases) & has_status(cases, status), found(cases))

    return read


def _of_empty(found: Callable[[pd.DataFrame], BoolArray]) -> Read:
    """`found`, of the cases without a flow."""
    return lambda cases: where(~in_a_flow(cases), found(cases))


def _alarm(cases: pd.DataFrame) -> BoolArray:
    return has_status(cases, "ok") | has_status(cases, "inaccurate")


def _called_so(cases: pd.DataFrame) -> BoolArray:
    return has_status(cases, "unidentifiable") & called_empty(cases)


def _column(name: str) -> Read:
    return lambda cases: numbers(cases, name)


def _share(
    name: str, words: str, read: Read, asked: str = "flights", *, more: bool = False,
    failure: Failure = Failure.LEFT_OUT,
) -> Measure:  # fmt: skip
    """A measure that is 1 or 0: a share, of which a failure that counts is no part."""
    return Measure(
        name, words, "%", read, failure, 0.0, "share", ".0f", more=more, asked=asked
    )  # fmt: skip


_EVERY = [
    *(one for place, name in enumerate(PARAMETERS) for one in _of_parameter(place, name)),
    Measure(
        "largest-error", "largest |error| of U0, L_w and τ_w", "%", largest_errors,
        failure=Failure.INFINITE,
    ),
    _share("hits", "chose the nearest grid scale", nearest_hits, more=True,
           failure=Failure.MISS),
    Measure("seconds", "time of a case", "s", _column("seconds")),
    Measure("certificate", "certificate",
            "", lambda cases: where(estimated(cases), numbers(cases, "certificate")),
            summary="largest", format=".1e"),
    _share("answered", "have an estimate", lambda cases: estimated(cases).astype(float),
           more=True),
    _share("off", f"were off by more than {OFF:g} %", _flow_called("ok", is_off),
           "flights called ok"),
    _share("deserved", "deserved it", _flow_called("unidentifiable", is_off),
           "flights called unidentifiable", more=True),
    _share("called-so", "were called so", _of_empty(_called_so), "flights without a flow",
           more=True),
    _share("false-alarms", "were false alarms", _of_empty(_alarm), "flights without a flow"),
    _share("scales-found", "found every length scale within 1 %",
           _column("scales_within_1_percent"), more=True, failure=Failure.MISS),
    Measure("scales-missed", "scales missed", "", _column("scales_missed"), summary="mean",
            format=".2f"),
    Measure("scales-spurious", "scales spurious", "", _column("scales_spurious"), summary="mean",
            format=".2f"),
    Measure("scales-length-scale-error", "largest error of L_w", "%",
            _column("scales_max_length_scale_error"), of="length_scale"),
    Measure("scales-mean-velocity-error", "largest error of U0", "%",
            _column("scales_max_mean_velocity_error"), of="mean_velocity"),
    Measure("cells", "cells flown", "",
            lambda cases: numbers(cases, "extent") / regime(cases, 0), more=True),
    Measure("scale-ratio", "scale ratio", "", lambda cases: regime(cases, 1), more=True),
    Measure("velocity-ratio", "velocity ratio", "", lambda cases: regime(cases, 2), more=True),
]  # fmt: skip
MEASURES: dict[str, Measure] = {measure.name: measure for measure in _EVERY}


def three(kind: str) -> tuple[Measure, ...]:
    """The measures `kind` of U0, L_w and tau_w, in this order."""
    return tuple(MEASURES[f"{name.replace('_', '-')}-{kind}"] for name in PARAMETERS)


def together(measures: Sequence[Measure]) -> str:
    """Return measures in words, what differs by its parameter alone said once."""
    symbols: dict[str, list[str]] = {}
    for measure in measures:
        words = measure.noun.replace(measure.symbol, "{}") if measure.of else measure.noun
        symbols.setdefault(words, []).append(measure.symbol)
    return listed([words.format(listed(named)) for words, named in symbols.items()])


def at_least(cases: pd.DataFrame, least: Mapping[str, float]) -> BoolArray:
    """(rows,) whether every named measure reaches its least value."""
    reached = [MEASURES[name].read(cases) >= value - HAIR for name, value in least.items()]
    return np.asarray(np.all(reached, axis=0), dtype=bool)
