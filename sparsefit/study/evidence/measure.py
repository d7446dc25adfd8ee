"""A measure: what is read from a case, how it is summarised, and how a failure counts.

A measure gives one number per case, NaN where the case has none. What becomes of that NaN is one
of three named conventions, `Failure`; nothing else in the study's pages decides it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Literal, TypeAlias

import numpy as np
import pandas as pd

from sparsefit.arrays import Array, BoolArray
from sparsefit.study.evidence.cases import SYMBOLS, TEX_SYMBOLS
from sparsefit.study.evidence.sentence import gathered, listed
from sparsefit.study.evidence.table import SIGNIFICANT, sized

Read: TypeAlias = Callable[[pd.DataFrame], Array]
NORMAL_95 = 1.959963984540054
TINY = 1e-6  # percent: a smaller error is quadrature and rounding, no ratio of them says anything


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

    name: by which [outputs] asks for it.
    words: the quantity in a sentence, `|error| of τ_w`; of: its parameter, where it has one.
    read: (rows,) the number of each case in `unit`, NaN where it has none.
    miss: what a failure counts as under `Failure.MISS`.
    summary: the name in `QUANTILES` or `SUMMARIES` by which a group of cases is told.
    format: of the summary in a table and a sentence.
    column: of its heading in a table, beside the symbol where it has one, `|error|`.
    more: whether more of it is better; target: the value that none can pass, if there is one.
    beside: the measure that a picture draws beside it, over the cases that every line has.
    applies: (rows,) the cases that it is of, all where it is None: of others it says nothing,
    not even that they failed.
    least: a smaller size is rounding; varies: whether it is of one run on one machine.
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
    column: str = ""
    more: bool = False
    target: float | None = None
    beside: str = ""
    asked: str = "flights"
    applies: Callable[[pd.DataFrame], BoolArray] | None = None
    least: float = 0.0
    varies: bool = False

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
        """The numbers of the cases: (rows,), or fewer where one is left out or does not apply."""
        read = self.read(cases[self.applies(cases)] if self.applies else cases)
        if self.failure is Failure.LEFT_OUT:
            return read[~np.isnan(read)]
        return np.where(np.isnan(read), math.inf if self.failure is Failure.INFINITE else self.miss,
                        read)  # fmt: skip

    def summarise(self, cases: pd.DataFrame, summary: str = "") -> float:
        """The summary of a group of cases; NaN of none, and where it applies to none."""
        values, summary = self.values(cases), summary or self.summary
        if not values.size:
            return 0 if summary == "number" and not self.applies else math.nan
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
        if self.summary == "number":
            return f"{value:.0f}"
        if self.summary == "share":
            # No rounding up to all, or down to none.
            near = 0 < value < 1 or 99 < value < 100
            return f"{value:.1f}{unit}" if near else f"{value:.0f}{unit}"
        signed = self.format.startswith("+")
        return f"{value:{self.format}}{unit}" if signed else f"{sized(value, self.least)}{unit}"


QUANTILES = {
    "median": 0.5,
    "first quartile": 0.25,
    "third quartile": 0.75,
    "9 of 10": 0.9,
    "95th percentile": 0.95,
}
SUMMARIES: dict[str, Callable[[Array], float]] = {
    "mean": lambda values: float(np.mean(values)),
    "geometric mean": lambda values: float(np.exp(np.mean(np.log(np.maximum(values, TINY))))),
    "rms": lambda values: float(np.sqrt(np.mean(values**2))),
    "share": lambda values: 100.0 * float(np.mean(values)),
    "largest": lambda values: float(np.max(values)),
    "number": lambda values: int(np.sum(values)),
}
SUMMARY_WORDS = {name: name for name in (*QUANTILES, *SUMMARIES)} | {
    "share": "share of",
    "number": "number of",
}


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


def together(measures: Sequence[Measure]) -> str:
    """Return measures in words, what differs by its parameter alone said once."""
    symbols = gathered(
        (one.noun.replace(one.symbol, "{}") if one.of else one.noun, one.symbol) for one in measures
    )
    return listed([words.format(listed(named)) for words, named in symbols.items()])
