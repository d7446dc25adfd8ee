"""What a refusal says: the exceptions, the nearest known name, and the checks of scalars."""

from __future__ import annotations

import math
from collections.abc import Iterable
from difflib import get_close_matches
from numbers import Real

import numpy as np


class SparsefitError(Exception):
    """Anything this package raises on purpose."""


class InputError(SparsefitError, ValueError):
    """Bad input. The message is one line: the cause and the remedy."""


class MissingExtra(SparsefitError, ImportError):  # noqa: N818 - says what is the matter
    """An optional dependency is absent. The message names the extra that brings it."""


def nearest(name: str, valid: Iterable[str]) -> str:
    """Return ``'; did you mean "x"?'`` for the known name closest to ``name``, or ``''``."""
    found = _closest(name, valid)
    return f'; did you mean "{found}"?' if found else ""


def unknown(kind: str, name: object, valid: Iterable[str]) -> InputError:
    """Return (not raise) the error for a name that is not among ``valid``."""
    known = list(valid)
    found = _closest(str(name), known)
    hint = f': did you mean "{found}"?' if found else ""
    return InputError(f'unknown {kind} "{name}"{hint} (known: {", ".join(known)})')


def _closest(name: str, valid: Iterable[str]) -> str | None:
    by_folded = {candidate.casefold(): candidate for candidate in valid}
    found = get_close_matches(name.casefold(), by_folded, n=1)
    return by_folded[found[0]] if found else None


def finite(name: str, value: object, unit: str = "") -> float:
    """Return ``value`` as a float, or raise `InputError` unless it is one finite real number."""
    number = _real(value)
    if not math.isfinite(number):
        raise InputError(f"{name} must be a finite number{_in(unit)}; got {value!r}")
    return number


def positive(name: str, value: object, unit: str = "") -> float:
    """Return ``value`` as a float, or raise `InputError` unless it is finite and > 0."""
    number = _real(value)
    if not 0.0 < number < math.inf:
        raise InputError(f"{name} must be a finite number above 0{_in(unit)}; got {value!r}")
    return number


def non_negative(name: str, value: object, unit: str = "") -> float:
    """Return ``value`` as a float, or raise `InputError` unless it is finite and >= 0."""
    number = _real(value)
    if not 0.0 <= number < math.inf:
        raise InputError(f"{name} must be a finite number, 0 or above{_in(unit)}; got {value!r}")
    return number


def pair(name: str, value: object, unit: str = "") -> tuple[float, float]:
    """Return ``value`` as two floats, or raise `InputError` unless it is two finite numbers."""
    items = list(value) if isinstance(value, (tuple, list, np.ndarray)) else []
    if len(items) != 2:
        raise InputError(f"{name} must be two numbers, (x, y){_in(unit)}; got {value!r}")
    return finite(f"{name}[0]", items[0], unit), finite(f"{name}[1]", items[1], unit)


def _real(value: object) -> float:
    """NaN stands for everything that is not a real number, so every check refuses it."""
    if isinstance(value, bool) or not isinstance(value, Real):
        return math.nan
    try:
        return float(value)
    except OverflowError:
        return math.inf


def _in(unit: str) -> str:
    return f" [{unit}]" if unit else ""
