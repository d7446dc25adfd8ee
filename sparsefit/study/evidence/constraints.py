"""What a candidate must keep in every regime, and where it does not."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from sparsefit.arrays import Array
from sparsefit.study.evidence.candidates import Trial, over_flights
from sparsefit.study.evidence.cases import estimated, has_status, in_a_flow, in_still_air
from sparsefit.study.evidence.readings import is_off, sizes, where
from sparsefit.study.evidence.sentence import shown
from sparsefit.study.evidence.summary import reduce
from sparsefit.study.spec.selection import SelectionRule

if TYPE_CHECKING:
    from sparsefit.study.run.latency import Latency

# Of each candidate one number for all regimes: where it is measured apart from the cases.
MEASURED: Mapping[str, Callable[[Latency], float]] = {
    "max_latency_p99": lambda latency: latency.p99,
    "max_memory": lambda latency: latency.memory,
}


def _failures(cases: pd.DataFrame) -> Array:
    return where(in_a_flow(cases), ~estimated(cases))


def _silent(cases: pd.DataFrame) -> Array:
    """Called ok and off, or called ok where there was nothing to find."""
    called_ok = has_status(cases, "ok")
    wrong = np.where(in_a_flow(cases), is_off(cases), in_still_air(cases))
    return (called_ok & wrong).astype(float)


def _largest(cases: pd.DataFrame) -> Array:
    largest: Array = sizes(cases).max(axis=1)
    return largest


@dataclass(frozen=True)
class Kept:
    """A constraint of the cases: what is read of each, its summary in a regime, how it is told."""

    read: Callable[[pd.DataFrame], Array]
    summary: str
    words: str
    share: bool

    def by_regime(self, trial: Trial) -> Array:
        """(regimes,) the summary in each regime; NaN where there is nothing to find.

        Where there is, and no case has the number, it is infinite: nobody keeps a limit of an
        error by never giving an answer.
        """
        in_one, read = (
            over_flights(trial.grid(values))
            for values in (in_a_flow(trial.cases).astype(float), self.read(trial.cases))
        )
        flow, values = reduce("largest", in_one), reduce(self.summary, read)
        return np.where(np.isnan(values) & (flow > 0), np.inf, values)


KEPT: Mapping[str, Kept] = {
    "max_failure": Kept(_failures, "mean", "flights without an estimate", True),
    "max_silent_misses": Kept(_silent, "mean", "silent misses", True),
    "max_error": Kept(_largest, "95th percentile", "95th percentile of the largest error", False),
}
WORDS: Mapping[str, str] = {
    **{name: kept.words for name, kept in KEPT.items()},
    "max_latency_p99": "99th percentile of the latency",
    "max_memory": "peak memory",
}


def told(name: str, value: float) -> str:
    """A value of a constraint with its unit."""
    if name in MEASURED and math.isinf(value):
        return "not measured"
    if name == "max_latency_p99":
        return f"{shown(1e3 * value)} ms"
    if name == "max_memory":
        return f"{shown(value)} MB"
    share = name in KEPT and KEPT[name].share
    return f"{shown(100.0 * value if share else value)} %"


@dataclass(frozen=True)
class Breach:
    """A constraint that a candidate does not keep: in which regime, by what value."""

    constraint: str
    regime: str
    value: float
    limit: float

    @property
    def excess(self) -> float:
        """How far beyond the limit: shares in themselves, what has a unit as a share of it."""
        share = self.constraint in KEPT and KEPT[self.constraint].share
        return self.value - self.limit if share else self.value / self.limit - 1.0

    @property
    def words(self) -> str:
        """`silent misses 5 % in turbulence 30 %, 1 % is the most`."""
        where_ = f" in {self.regime}" if self.regime else ""
        value, limit = told(self.constraint, self.value), told(self.constraint, self.limit)
        return f"{WORDS[self.constraint]} {value}{where_}, {limit} is the most"


def breaches(
    rule: SelectionRule, trial: Trial, regimes: tuple[str, ...], latency: Latency | None
) -> tuple[Breach, ...]:
    """The constraints of a rule that a candidate breaks, each in its worst regime.

    One that was not timed because it breaks another is not told to break what was not measured.
    """
    broken = tuple(
        Breach(name, regime, value, limit)
        for name, limit, value, regime in _worst(rule, trial, regimes, latency)
        if value > limit
    )
    of_cases = tuple(breach for breach in broken if breach.constraint in KEPT)
    return of_cases if latency is None and of_cases else broken


def _worst(
    rule: SelectionRule, trial: Trial, regimes: tuple[str, ...], latency: Latency | None
) -> Iterator[tuple[str, float, float, str]]:
    """Each constraint that is asked for, its limit, the worst value and the regime it is in."""
    for name, kept in KEPT.items():
        limit = getattr(rule, name)
        if limit is not None:
            values = kept.by_regime(trial)
            at = int(np.nanargmax(values)) if not np.isnan(values).all() else 0
            yield name, limit, float(values[at]), regimes[at] if len(regimes) > 1 else ""
    for name, read in MEASURED.items():
        limit = getattr(rule, name)
        if limit is not None:
            value = math.inf if latency is None else read(latency)
            yield name, limit, value, ""
