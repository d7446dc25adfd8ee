"""Words for answers: lists, ranges and numbers as a sentence has them."""

from __future__ import annotations

import math
import re
from collections.abc import Hashable, Iterable, Mapping, Sequence
from typing import TypeVar

from sparsefit.study.evidence.table import significant

Key = TypeVar("Key", bound=Hashable)
Item = TypeVar("Item")
NUMBER = re.compile(r"[-+]?\d+(\.\d+)?(e[-+]?\d+)?", re.IGNORECASE)
DIGITS = 3  # as a sentence shows them; what agrees in them is named together
NAMED = 3  # of those that agree; the rest are counted


def numberless(text: str) -> str:
    """The text with `#` for each number: what differs in numbers alone is alike."""
    return NUMBER.sub("#", text)


def gathered(pairs: Iterable[tuple[Key, Item]]) -> dict[Key, list[Item]]:
    """Return the items of each key, both in order of first appearance."""
    lists: dict[Key, list[Item]] = {}
    for key, item in pairs:
        lists.setdefault(key, []).append(item)
    return lists


def capital(text: str) -> str:
    """`Text`, as a sentence begins."""
    return f"{text[:1].upper()}{text[1:]}"


def listed(names: Sequence[str]) -> str:
    """`a`, `a and b`, `a, b and c`."""
    if len(names) < 2:
        return "".join(names)
    return f"{', '.join(names[:-1])} and {names[-1]}"


def some(names: Sequence[str]) -> str:
    """All of them, or the first few and how many more."""
    if len(names) <= NAMED + 1:
        return listed(names)
    return f"{', '.join(names[:NAMED])} and {len(names) - NAMED} more"


def shown(value: float) -> str:
    """Three significant digits."""
    return "∞" if math.isinf(value) else "–" if math.isnan(value) else significant(value, DIGITS)


def extremes(values: Mapping[str, float], unit: str = "") -> str:
    """`1.02 (lasso) to 4.1 (stlsq)`, or `1.02 (all)` where all agree; NaN has no say.

    Units stand once, at the end of each number.
    """
    finite = {name: value for name, value in values.items() if not math.isnan(value)}
    if not finite:
        return "nothing"
    low, high = min(finite.values()), max(finite.values())
    if shown(low) == shown(high):
        who = "all" if len(finite) > 1 else next(iter(finite))
        return f"{shown(low)}{unit} ({who})"
    ends = (f"{shown(end)}{unit} ({_holders(finite, end)})" for end in (low, high))
    return " to ".join(ends)


def _holders(values: Mapping[str, float], wanted: float) -> str:
    return some([name for name, value in values.items() if shown(value) == shown(wanted)])


def ranged(values: Sequence[float], unit: str = "") -> str:
    """`0.9 to 2.1 %`, or one number where they agree."""
    known = [value for value in values if not math.isnan(value)]
    if not known:
        return "nothing"
    low, high = shown(min(known)), shown(max(known))
    return f"{low}{unit}" if low == high else f"{low} to {high}{unit}"
