"""A measure: what is read from a case, how it is summarised, and how a failure counts.

A measure gives one number per case, NaN where the case has none. What becomes of that NaN is one
of three named conventions, `Failure`; nothing else in the study's pages decides it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import TypeAlias

import numpy as np
import pandas as pd

from sparsefit.arrays import Array, BoolArray
from sparsefit.study.evidence.cases import SYMBOLS, TEX_SYMBOLS, in_a_flow
from sparsefit.study.evidence.sentence import gathered, listed
from sparsefit.study.evidence.summary import SUMMARY_WORDS, reduce
from sparsefit.study.evidence.table import SIGNIFICANT, sized

Read: TypeAlias = Callable[[pd.DataFrame], Array]
NORMAL_95 = 1.959963984540054


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

    def per_case(self, cases: pd.DataFrame) -> Array:
        """(rows,) the number of each case, NaN where it has none; a failure counts as it says.

        Only a flight in a flow can fail: of one in still air there is nothing to say.
        """
        of = self.applies(cases) if self.applies else np.ones(len(cases), dtype=bool)
        read: Array = np.where(of, self.read(cases), np.nan)
        if self.failure is Failure.LEFT_OUT:
            return read
        worst = math.inf if self.failure is Failure.INFINITE else self.miss
        return np.where(np.isnan(read) & of & in_a_flow(cases), worst, read)

    def reduce(self, values: Array) -> Array:
        """(...,) the summary of (..., n) numbers of cases, over what is not NaN."""
        return reduce(self.summary, values, observed=self.failure is Failure.INFINITE)

    def summarise(self, cases: pd.DataFrame, summary: str = "") -> float:
        """The summary of a group of cases; NaN of none, and where it applies to none."""
        told = replace(self, summary=summary) if summary else self
        values = told.per_case(cases)
        if not (~np.isnan(values)).any():
            return 0 if told.summary == "number" and not self.applies else math.nan
        value = float(told.reduce(values))
        return int(value) if told.summary == "number" else value

    def say(self, value: float) -> str:
        """A summary as a sentence has it, with its unit."""
        unit = f" {self.unit}" if self.unit else ""
        if math.isnan(value) or math.isinf(value):
            return "no answer"
        if self.summary == "number":
            return f"{value:.0f}" if value == round(value) else f"{value:.1f}"  # of regimes
        if self.summary == "share":
            # No rounding up to all, or down to none.
            near = 0 < value < 1 or 99 < value < 100
            return f"{value:.1f}{unit}" if near else f"{value:.0f}{unit}"
        signed = self.format.startswith("+")
        return f"{value:{self.format}}{unit}" if signed else f"{sized(value, self.least)}{unit}"


@dataclass(frozen=True)
class Share:
    """`part` of `whole` cases, and the interval that holds the true share in 95 % of studies."""

    part: int
    whole: int

    @classmethod
    def of(cls, measure: Measure, cases: pd.DataFrame) -> Share:
        """Count a measure that is 1 or 0."""
        values = measure.per_case(cases)
        return cls(int(np.nansum(values)), int((~np.isnan(values)).sum()))

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
