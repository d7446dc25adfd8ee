"""An estimator as JSON: what `Estimator.to_json` writes and `Estimator.from_json` reads."""

import json
import math
import re
from collections.abc import Mapping
from typing import Any

from sparsefit import backends
from sparsefit.codec import Place, build, mapping, only, plain, shown
from sparsefit.errors import InputError
from sparsefit.model import Library, Readout
from sparsefit.model.readout import UNNAMED
from sparsefit.regression.backend import Backend
from sparsefit.rows import Derivative

FORMAT = "sparsefit-estimator/1"
RECORDS = {"derivative": Derivative, "library": Library, "readout": Readout}
BESIDE = ("format", "provenance")  # what a file says of itself: no part of the estimator
HERE = Place("estimator")
NAME = re.compile(r"[A-Za-z0-9_.-]*")  # of a back-end, if it is one


def text_of(parts: Mapping[str, Any]) -> str:
    """The JSON text of an estimator's fields."""
    record = {"format": FORMAT} | {name: _written(part) for name, part in parts.items()}
    return json.dumps(record, indent=2, allow_nan=False) + "\n"


def _written(part: Any) -> Any:
    if isinstance(part, Backend):
        return {"name": part.name, **plain(part)}
    if isinstance(part, tuple):
        return list(part)
    return part if isinstance(part, float | int | str) else plain(part)


def record_of(text: str) -> dict[str, Any]:
    """The object that `text_of` wrote. Raises InputError on any other text."""
    try:
        record = json.loads(text, object_pairs_hook=_once)
    except InputError:
        raise
    except json.JSONDecodeError as error:
        raise InputError(f"not an estimator: line {error.lineno}: {error.msg}") from None
    except RecursionError:
        raise InputError("not an estimator: too deep; write one with to_json") from None
    except ValueError:  # Python reads no decimal integer of more than 4300 digits
        raise InputError("not an estimator: a number of more than 4300 digits") from None
    _check_format(record)
    _check_numbers(record, "")
    readout = record.get("readout", {})
    if isinstance(readout, dict):
        record["readout"] = {"refine": UNNAMED} | readout
    return {key: value for key, value in record.items() if key not in BESIDE}


def _check_numbers(value: object, place: str) -> None:
    """Refuse NaN and infinities wherever they stand: Python reads them, and JSON has none."""
    if isinstance(value, float) and not math.isfinite(value):
        raise InputError(f"not an estimator: {place} is {value}, no number; write it with to_json")
    parts = dict(enumerate(value)) if isinstance(value, list) else value
    for key, part in parts.items() if isinstance(parts, dict) else ():
        _check_numbers(part, f"{place}.{key}" if place else str(key))


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    record = dict(pairs)
    if len(record) < len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in names if names.count(name) > 1)
        raise InputError(f"not an estimator: key {shown(twice)} stands twice; keep one")
    return record


def _check_format(record: object) -> None:
    """Refuse what is no estimator's record, and one of another version of the format."""
    told = record.get("format") if isinstance(record, dict) else None
    kind, _, number = FORMAT.partition("/")
    if isinstance(told, str) and told != FORMAT and told.startswith(f"{kind}/"):
        raise InputError(
            f"an estimator of format {shown(told.removeprefix(f'{kind}/'))}, and this version of "
            f"sparsefit reads format {number}: update sparsefit, or write it with this version"
        )
    if told != FORMAT:
        raise InputError(f'not an estimator: no "format": "{FORMAT}"; write one with to_json')


def _backend_name(given: object, place: Place) -> str:
    """The name of a back-end as it was given, unless it could be none: a path, say."""
    if not isinstance(given, str) or not NAME.fullmatch(given):
        raise place.at("name").error(f"must be the name of a back-end, and no path: {shown(given)}")
    return given


def parts_of(record: Mapping[str, object], place: Place = HERE) -> dict[str, Any]:
    """The fields of an estimator from nested mappings; what is left out keeps its default.

    Raises InputError with the place on unknown keys and on values that do not fit.
    """
    only(record, (*RECORDS, "backend", "tolerance", "free"), place)
    sections = {
        name: mapping(part, place.at(name))
        for name, part in record.items()
        if name not in ("tolerance", "free")
    }
    parts: dict[str, Any] = {
        name: build(kind, sections[name], place.within(name))
        for name, kind in RECORDS.items()
        if name in sections
    }
    if "backend" in sections:
        settings = dict(sections["backend"])
        try:
            name = _backend_name(settings.pop("name", ""), place.within("backend"))
            parts["backend"] = backends.get(name, **settings)
        except TypeError as error:  # a value of a type the back-end does not check
            raise InputError(f"estimator: {error}") from None
    return parts | {key: record[key] for key in ("tolerance", "free") if key in record}
