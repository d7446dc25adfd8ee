"""Exceptions, the nearest known name for a message, and checks of scalars.

A quantity (``tau must be ... [s]; got -1``) is checked by `finite` to `integer`, a setting within
limits (``lasso: tolerance must be ..., not 2``) by `number_setting` and `one_of`.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from difflib import get_close_matches
from importlib import import_module
from numbers import Integral, Real
from typing import Any, TypeGuard

LONGEST = 60  # characters of a value that a message shows
REAL = (float, int, Real)  # an abstract class alone takes ten times as long to ask


class SparsefitError(Exception):
    """Base of the exceptions of this package. The message is always one line."""

    def __init__(self, message: str = "") -> None:
        super().__init__(one_line(message))


class InputError(SparsefitError, ValueError):
    """Bad input. The message is one line: the cause and the remedy."""


class MissingExtra(SparsefitError, ImportError):  # noqa: N818 - says what is the matter
    """An optional dependency is absent. The message names the extra that brings it."""


def optional(module: str, needs: str, extra: str) -> Any:
    """The module that an extra of this package installs. Raises MissingExtra without it.

    needs: the words for what needs it, ``IGC files need aerofiles``.
    """
    try:
        return import_module(module)
    except ImportError:
        raise MissingExtra(f"{needs}: pip install 'sparsefit[{extra}]'") from None


@contextmanager
def told_with(place: object) -> Iterator[None]:
    """A context that puts ``place: ``, if not empty, before the message of an `InputError`."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{place}: {error}" if place else str(error)) from None


def one_line(text: str, most: int = sys.maxsize) -> str:
    """The text on one line of at most ``most`` characters, unprintable ones as `\\x1b`."""
    words = " ".join(text[: 4 * most].split())
    line = "".join(c if c.isprintable() else ascii(c)[1:-1] for c in words)
    return line if len(line) <= most else f"{line[: most - 3]}..."


def described(error: BaseException, most: int = 500) -> str:
    """The type and message, if any, of an exception on one line, `ValueError: message`."""
    try:
        message = str(error)
    except Exception:  # a message is code of others, too
        message = "(its message cannot be read)"
    return one_line(": ".join(filter(None, (type(error).__name__, message))), most)


def suggestion(name: str, valid: Iterable[str]) -> str:
    """Return ``: did you mean "x"?`` or, where no valid name is near, ``(known: x, y)``."""
    names = {candidate.casefold(): candidate for candidate in sorted(valid)}
    near = get_close_matches(name.casefold(), names, n=1)
    return f': did you mean "{names[near[0]]}"?' if near else f" (known: {_listed(names.values())})"


def _listed(names: Iterable[str]) -> str:
    """Names with commas between them, in quotes where one has a comma itself."""
    return ", ".join(f'"{name}"' if "," in name else name for name in names)


def unknown(kind: str, name: object, valid: Iterable[str], listed: str = "") -> InputError:
    """The error for a name that is not among ``valid``, which stand ``listed`` if they are many."""
    text = one_line(name if isinstance(name, str) else shown(name), LONGEST)
    near = suggestion(text, names := list(valid))
    every = f"listed in {listed}" if listed else f"known: {_listed(names)}"
    return InputError(f'unknown {kind} "{text}"{near if near[0] == ":" else ""} ({every})')


def one_of(kind: str, value: object, valid: Iterable[str], listed: str = "") -> None:
    """Raise `InputError`, as of `unknown`, unless ``value`` is one of the valid names."""
    names = tuple(valid)
    if not isinstance(value, str) or value not in names:
        raise unknown(kind, value, names, listed)


def is_real(value: object) -> TypeGuard[float]:
    """Whether ``value`` is one real number, infinite or NaN too; True is none."""
    return isinstance(value, REAL) and not isinstance(value, bool)


def is_number(
    value: object, low: float = -math.inf, high: float = math.inf, *, open_low: bool = False
) -> TypeGuard[float]:
    """Whether ``value`` is one finite real number in [low, high], or in (low, high]."""
    try:
        number = float(value) if is_real(value) else math.nan  # which every check refuses
    except OverflowError:
        number = math.inf
    above = low < number if open_low else low <= number
    return math.isfinite(number) and above and number <= high


def is_integer(
    value: object, least: float = -math.inf, most: float = math.inf, *, odd: bool = False
) -> TypeGuard[int]:
    """Whether ``value`` is an integer from ``least`` to ``most``; True and 2.0 are none."""
    if isinstance(value, bool) or not isinstance(value, Integral):
        return False
    return least <= int(value) <= most and not (odd and int(value) % 2 == 0)


def finite(
    name: str, value: object, unit: str = "", low: float = -math.inf, which: str = ""
) -> float:
    """Return ``value`` as a float, or raise `InputError` unless it is one finite real number.

    low: the least, which ``which`` says in words.
    """
    if not is_number(value, low):
        words = f"{name} must be a finite number{which}" + (f" [{unit}]" if unit else "")
        raise InputError(f"{words}; got {shown(value)}")
    return float(value)


def positive(name: str, value: object, unit: str = "") -> float:
    """Return ``value`` as a float, or raise `InputError` unless it is finite and > 0."""
    return finite(name, value, unit, math.nextafter(0.0, 1.0), " above 0")


def non_negative(name: str, value: object, unit: str = "") -> float:
    """Return ``value`` as a float, or raise `InputError` unless it is finite and >= 0."""
    return finite(name, value, unit, 0.0, ", 0 or above")


def pair(name: str, value: object, unit: str = "") -> tuple[float, float]:
    """Return ``value`` as two floats, or raise `InputError` unless it is two finite numbers."""
    items = getattr(value, "tolist", lambda: value)()  # what an array holds
    if not isinstance(items, tuple | list) or len(items) != 2:
        words = f"{name} must be two numbers, (x, y)" + (f" [{unit}]" if unit else "")
        raise InputError(f"{words}; got {shown(value)}")
    return finite(f"{name}[0]", items[0], unit), finite(f"{name}[1]", items[1], unit)


def integer(name: str, value: int, least: int, *, odd: bool = False) -> int:
    """Return ``value`` as an int, or raise `InputError` unless it is an (odd) integer >= least."""
    if not is_integer(value, least, odd=odd):
        kind = "an odd integer" if odd else "an integer"
        raise InputError(f"{name} must be {kind}, {least} or above; got {shown(value)}")
    return int(value)


def store(record: object, check: Callable[..., object], extra: Any, *names: str) -> None:
    """Replace fields of a frozen record by the values that ``check(name, value, extra)`` returns.

    extra: the third argument of the check: a unit, a least value or a shape. names: of the fields.

    Raises:
        InputError: as the check does.
    """
    for name in names:
        object.__setattr__(record, name, check(name, getattr(record, name), extra))


def number_setting(
    owner: str,
    name: str,
    value: object,
    *,
    low: float,
    high: float = math.inf,
    meaning: str = "",
    open_low: bool = False,
) -> None:
    """Raise `InputError`, with ``meaning``, unless value is in [low, high] or (low, high]."""
    if not is_number(value, low, high, open_low=open_low):
        limits = f"{'(' if open_low else '['}{low:g}, {high:g}{']' if high < math.inf else ')'}"
        words = f"{owner}: {name} must be a number in {limits}, not {shown(value)}"
        raise InputError(f"{words}; {meaning}" if meaning else words)


def shown(value: object) -> str:
    """A value as it appears in a message: cut to one line, and the shape of an array."""
    shape = getattr(value, "shape", ())
    if isinstance(shape, tuple) and shape:
        return f"{type(value).__name__} of shape {shape}"
    try:
        return one_line(repr(value), LONGEST)
    except ValueError:  # Python writes no integer of more than 4300 digits
        return "a number of more than 4300 digits"
