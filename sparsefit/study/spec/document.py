"""One TOML file as typed values; whatever does not fit is refused by file, section and key."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TypeAlias, cast

from sparsefit.codec import Place, number, shown
from sparsefit.errors import InputError
from sparsefit.whole_file import read_whole

Section: TypeAlias = Mapping[str, object]
LARGEST = 32_000_000  # bytes of a study file
MOST = 10**300  # an integer beyond it is no number that anything is computed with
TOO_LONG = "holds an integer of more than 300 digits: write a smaller one"


def read_toml(path: str | Path) -> dict[str, object]:
    """The parsed file; `InputError` names the file, and the line where it is not TOML."""
    if not Path(path).exists():
        raise InputError(f"{path}: no such file: check the name")
    try:
        text = read_whole(path, most=LARGEST).decode("utf-8")
    except UnicodeDecodeError:
        raise InputError(f"{path}: not UTF-8 text: save the study file as UTF-8") from None
    try:
        parsed = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path}:{_line(str(error), text)}: not TOML: {error}") from None
    except RecursionError:
        raise InputError(f"{path}: nested too deeply for a study file") from None
    except ValueError:  # Python reads no decimal integer of more than 4300 digits
        raise InputError(f"{path}: {TOO_LONG}") from None
    if any(abs(number) > MOST for number in _integers(parsed)):
        raise InputError(f"{path}: {TOO_LONG}")
    return parsed


def _integers(value: object) -> Iterator[int]:
    if isinstance(value, dict | list):
        for item in value.values() if isinstance(value, dict) else value:
            yield from _integers(item)
    elif isinstance(value, int):
        yield value


def _line(message: str, text: str) -> int:
    found = re.search(r"at line (\d+)", message)
    return int(found.group(1)) if found else text.count("\n") + 1


def required(section: Section, key: str, place: Place) -> object:
    """The value of a key that must be given."""
    if key not in section:
        raise place.at(key).error("missing: a study needs it")
    return section[key]


def positive(value: object, place: Place) -> float:
    """A finite number above zero."""
    real = number(value, place)
    if real <= 0.0:
        raise place.error(f"must be above 0, not {shown(value)}")
    return real


def items(value: object, place: Place) -> list[object]:
    """A list of at least one item."""
    if not isinstance(value, list):
        raise place.error(f"must be a list, not {shown(value)}")
    if not value:
        raise place.error("must not be an empty list: remove the key or give values")
    return value


def distinct(values: Sequence[object], place: Place) -> None:
    """Refuse a list that holds one value twice."""
    seen: set[str] = set()
    for value in values:
        canonical = canonical_json(value)
        if canonical in seen:
            raise place.error(f"lists {shown(value)} twice")
        seen.add(canonical)


def read_section(value: object, place: Place) -> Section:
    """A TOML table."""
    if not isinstance(value, dict):
        raise place.error(f"must be a table, not {shown(value)}")
    return cast(Section, value)


def read_sections(value: object, place: Place) -> list[Section]:
    """An array of tables, `[[name]]`, of at least one."""
    if not isinstance(value, list) or not all(isinstance(item, dict) for item in value):
        raise place.error(f"must be written as [[{place.key or place.section}]]")
    return cast(list[Section], items(value, place))


def canonical_json(value: object) -> str:
    """Sorted keys, no blanks, and 10.0 written as 10: equal content gives equal text."""
    return json.dumps(_plain(value), sort_keys=True, separators=(",", ":"), default=str)


def _plain(value: object) -> object:
    if isinstance(value, float) and value.is_integer():
        return int(value)
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return value
