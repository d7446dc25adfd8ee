"""An estimator as JSON: what `Estimator.to_json` writes and `Estimator.from_json` reads."""

import json
from collections.abc import Mapping
from typing import Any

from sparsefit import backends
from sparsefit.codec import Place, build, mapping, only, plain
from sparsefit.derivative import Derivative
from sparsefit.errors import InputError
from sparsefit.library.builder import Library
from sparsefit.modes.readout import UNNAMED, Readout
from sparsefit.regression.backend import Backend

FORMAT = "sparsefit-estimator/1"
RECORDS = {"derivative": Derivative, "library": Library, "readout": Readout}
BESIDE = ("format", "provenance")  # what a file says of itself: no part of the estimator
HERE = Place("estimator")


def text_of(parts: Mapping[str, Any]) -> str:
    """The JSON text of an estimator's fields."""
    record = {"format": FORMAT} | {name: _written(part) for name, part in parts.items()}
    return json.dumps(record, indent=2, allow_nan=False) + "\n"


def _written(part: Any) -> Any:
    if isinstance(part, Backend):
        return {"name": part.name, **plain(part)}
    return part if isinstance(part, float | int) else plain(part)


def record_of(text: str) -> dict[str, Any]:
    """The object that `text_of` wrote. Raises InputError on any other text."""
    try:
        record = json.loads(text)
    except json.JSONDecodeError as error:
        raise InputError(f"not an estimator: line {error.lineno}: {error.msg}") from None
    except RecursionError:
        raise InputError("not an estimator: too deep; write one with to_json") from None
    except ValueError:  # Python reads no decimal integer of more than 4300 digits
        raise InputError("not an estimator: a number of more than 4300 digits") from None
    if not isinstance(record, dict) or record.get("format") != FORMAT:
        raise InputError(f'not an estimator: no "format": "{FORMAT}"; write one with to_json')
    readout = record.get("readout", {})
    if isinstance(readout, dict):
        record["readout"] = {"refine": UNNAMED} | readout
    return {key: value for key, value in record.items() if key not in BESIDE}


def parts_of(record: Mapping[str, object], place: Place = HERE) -> dict[str, Any]:
    """The fields of an estimator from nested mappings; what is left out keeps its default.

    Raises InputError with the place on unknown keys and on values that do not fit.
    """
    only(record, (*RECORDS, "backend", "tolerance"), place)
    sections = {
        name: mapping(part, place.at(name)) for name, part in record.items() if name != "tolerance"
    }
    parts: dict[str, Any] = {
        name: build(kind, sections[name], place.within(name))
        for name, kind in RECORDS.items()
        if name in sections
    }
    if "backend" in sections:
        settings = dict(sections["backend"])
        try:
            parts["backend"] = backends.get(str(settings.pop("name", "")), **settings)
        except TypeError as error:  # a value of a type the back-end does not check
            raise InputError(f"estimator: {error}") from None
    return parts | {key: value for key, value in record.items() if key == "tolerance"}
