"""What one entry of [flights] may be: a number, or a rule that gives every flight its own."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sparsefit.codec import Place, number, only, shown
from sparsefit.study.spec.document import items

RULES = ("linspace", "uniform", "loguniform", "choice")


@dataclass(frozen=True)
class Entry:
    """A quantity of a flight: `rule` is "constant" or one of `RULES`, `values` its numbers."""

    rule: str
    values: tuple[float, ...]

    def at(self, flight: int, count: int, stream: np.random.SeedSequence) -> float:
        """The value for flight `flight` of `count`; `stream` decides what is random.

        One uniform number u in [0, 1) is drawn whatever the rule, so levels of a sweep that
        differ in their range only share it (common random numbers).
        """
        if self.rule == "constant":
            return self.values[0]
        if self.rule == "linspace":
            first, last = self.values
            return first + (last - first) * flight / max(count - 1, 1)
        share = float(np.random.default_rng(stream).random())
        if self.rule == "choice":
            return self.values[int(share * len(self.values))]
        return self._between(share)

    def _between(self, share: float) -> float:
        low, high = self.values
        if self.rule == "loguniform":
            return math.exp(math.log(low) + share * (math.log(high) - math.log(low)))
        return low + share * (high - low)


def read_entry(
    value: object,
    place: Place,
    *,
    least: float | None,
    open_end: bool,
    most: float | None = None,
) -> Entry:
    """An entry from its TOML value; every number in it is in [least, most], or between them."""
    entry = _rule(value, place) if isinstance(value, dict) else _constant(value, place)
    for one in entry.values:
        if least is not None and most is not None:
            within = least < one < most if open_end else least <= one <= most
            if not within:
                raise place.error(f"must lie between {least:g} and {most:g}, not {one:g}")
        if least is not None and (one <= least if open_end else one < least):
            bound = "above" if open_end else "at least"
            raise place.error(f"must be {bound} {least:g}, not {one:g}")
    return entry


def _constant(value: object, place: Place) -> Entry:
    if isinstance(value, list | str):
        rules = ", ".join(RULES)
        raise place.error(f"must be a number or a table with one of {rules}, not {shown(value)}")
    return Entry("constant", (number(value, place),))


def _rule(value: dict[str, object], place: Place) -> Entry:
    only(value, RULES, place)
    if len(value) != 1:
        raise place.error(f"must hold exactly one of {', '.join(RULES)}, not {shown(value)}")
    ((rule, listed),) = value.items()
    values = tuple(number(item, place) for item in items(listed, place))
    if rule != "choice":
        _check_range(rule, values, place)
    return Entry(rule, values)


def _check_range(rule: str, values: tuple[float, ...], place: Place) -> None:
    if len(values) != 2:
        raise place.error(f"{rule} takes two numbers [a, b], not {len(values)}")
    low, high = values
    if rule != "linspace" and low > high:
        raise place.error(f"{rule} range [{low:g}, {high:g}] is empty: write the smaller first")
    if rule == "loguniform" and low <= 0.0:
        raise place.error(f"loguniform range must be above 0, not from {low:g}")
