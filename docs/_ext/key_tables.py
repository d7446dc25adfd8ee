"""All keys of a study file, from the records that read them, with the words of study-keys.toml.

A key that has no words, and words that have no key, are an error: neither side goes stale alone.
"""

from __future__ import annotations

import tomllib
import types
from collections.abc import Iterator, Mapping
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any, Literal, NamedTuple, Union, get_args, get_origin, get_type_hints

from sparsefit.study.evidence.asked import Asked
from sparsefit.study.spec.contenders import RESERVED as CONTENDER_KEYS
from sparsefit.study.spec.flights import WORDS
from sparsefit.study.spec.logs import KEYS as LOG_KEYS
from sparsefit.study.spec.outputs import KINDS, Reference
from sparsefit.study.spec.quantities import QUANTITIES, REQUIRED, Quantity
from sparsefit.study.spec.selection import SelectionRule
from sparsefit.study.spec.setup import SECTION_KEYS
from sparsefit.study.spec.solver_problems import KEYS as PROBLEM_KEYS
from sparsefit.study.spec.solver_study import KEYS as SOLVER_KEYS
from sparsefit.study.spec.solver_study import Clock, PathRule
from sparsefit.study.spec.study import KEYS, SPLITS, Run

from sparsefit import backends
from sparsefit.derivative import Derivative
from sparsefit.library import LengthScaleGrid, Library, WaveGrid
from sparsefit.modes import Readout
from sparsefit.onboard import Stream

NEEDED = "needed"
MEANINGS = Path(__file__).parents[1] / "study-keys.toml"


class Key(NamedTuple):
    """One key: what it may hold, and its default, as text."""

    name: str
    kind: str = ""
    default: str = ""


def sections() -> dict[str, list[Key]]:
    """Section -> its keys, of all that a study file may hold."""
    return {
        "study": [Key(name) for name in KEYS],
        "flights": [Key("count", "whole number"), *_flights()],
        "logs": [Key(name) for name in LOG_KEYS],
        "derivative": _of(Derivative),
        "library": [key for key in _of(LengthScaleGrid) + _of(Library) if key.name != "grid"],
        "library.waves": _of(WaveGrid),
        "readout": _of(Readout),
        "online": _of(Stream),
        "backends": [Key("name", "text"), Key("label", "text")],
        "protocols": [Key("name", "text"), Key("SECTION.KEY")],
        "sweep": [Key("SECTION.KEY", "list")],
        "split": [Key(name, "number") for name in SPLITS],
        "run": _of(Run),
        "select": _of(SelectionRule),
        "outputs": [Key(name, "list") for name in KINDS] + [Key("reference", "table")],
        "outputs.reference": _of(Reference),
        "outputs.tables": _of(Asked),
        "solvers": [Key(name) for name in SOLVER_KEYS],
        "contenders": [Key(name) for name in (*CONTENDER_KEYS, "solver")],
        "problems": [Key(name) for name in PROBLEM_KEYS],
        "path": _of(PathRule),
        "clock": _of(Clock),
    }


def checked() -> None:
    """Refuse sections whose keys are other than those that `SECTION_KEYS` lets pass."""
    known = sections()
    for name, keys in SECTION_KEYS.items():
        listed = {key.name for key in known[name]} - ({"count"} if name == "flights" else set())
        if listed != set(keys):
            raise ValueError(f"[{name}] has other keys than are documented: {listed ^ set(keys)}")


def table(section: str) -> list[str]:
    """The lines of a Markdown table of the keys of a section.

    Raises:
        ValueError: where a key has no words in study-keys.toml, or words have no key.
    """
    keys = sections()[section]
    words = meanings().get(section, {})
    missing = [key.name for key in keys if key.name not in words]
    stale = set(words) - {key.name for key in keys}
    if missing or stale:
        raise ValueError(
            f"study-keys.toml, [{section}]: no words for {missing}; words for nothing: {stale}"
        )
    return ["| key | what it holds |", "|---|---|", *(_row(key, words[key.name]) for key in keys)]


def _row(key: Key, words: str) -> str:
    default = key.default if key.default in ("", NEEDED) else f"default {key.default}"
    beside = [part for part in (key.kind, default) if part]
    told = f"<br>*{'; '.join(beside)}*" if beside else ""
    cell = f"{words}{told}".replace("|", "\\|")
    return f"| `{key.name}` | {cell} |"


def meanings() -> Mapping[str, Mapping[str, str]]:
    """Section -> key -> what it is, in words."""
    return tomllib.loads(MEANINGS.read_text("utf-8"))


def settings(name: str) -> list[Key]:
    """The settings of a back-end."""
    return _of(backends.load(name))


def _flights() -> Iterator[Key]:
    for name in SECTION_KEYS["flights"]:
        if name in WORDS:
            words = WORDS[name]
            yield Key(name, " or ".join(f'`"{word}"`' for word in words), f'`"{words[0]}"`')
        elif name in QUANTITIES:
            yield Key(name, _range(QUANTITIES[name]), "" if name not in REQUIRED else NEEDED)


def _range(quantity: Quantity) -> str:
    pair = "a pair; " if len(quantity.streams) == 2 else ""
    if quantity.least is None:
        return f"{pair}any number"
    word = "above" if quantity.open_end else "at least"
    if quantity.most is None:
        return f"{pair}{word} {quantity.least:g}"
    low, high = (f"{end:.4g}" for end in (quantity.least, quantity.most))
    within = f"between {low} and {high}" if quantity.open_end else f"from {low} to {high}"
    return f"{pair}{within}"


def _of(record: type[Any]) -> list[Key]:
    """The fields of a record, with their types and defaults."""
    hints = get_type_hints(record)
    return [
        Key(item.name, _kind(hints[item.name]), _default(item))
        for item in fields(record)
        if item.init
    ]


def _default(item: Any) -> str:
    if item.default is MISSING:
        return NEEDED if item.default_factory is MISSING else ""
    if item.default in (None, "", ()):
        return ""
    if isinstance(item.default, bool):
        return f"`{str(item.default).lower()}`"
    if isinstance(item.default, str):
        return f'`"{item.default}"`'
    return f"`{item.default!r}`" if isinstance(item.default, int | float) else ""


NAMES: dict[Any, str] = {
    float: "number",
    int: "whole number",
    str: "text",
    bool: "`true` or `false`",
    type(None): "",
}


def _kind(hint: Any) -> str:
    """A type as somebody who writes TOML would say it."""
    if hint in NAMES:
        return NAMES[hint]
    origin, parts = get_origin(hint), get_args(hint)
    if origin is Literal:
        return " or ".join(f'`"{word}"`' for word in parts)
    if origin in (Union, types.UnionType):
        return " or ".join(dict.fromkeys(word for word in map(_kind, parts) if word))
    if origin is tuple:
        if parts[-1] is ...:
            return f"list of {_plural(_kind(parts[0]))}"
        return f"list of {len(parts)}"
    return "table"


PLURALS = {"number": "numbers", "text": "texts", "whole number": "whole numbers"}


def _plural(kind: str) -> str:
    return PLURALS.get(kind, "lists")
