"""An estimator as JSON: what `Estimator.to_json` writes and `Estimator.from_json` reads."""

import json
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

KIND, VERSION = "sparsefit-estimator", "1"
FORMAT = f"{KIND}/{VERSION}"
RECORDS = {"derivative": Derivative, "library": Library, "readout": Readout}
VALUES = ("tolerance", "free")
BESIDE = ("format", "provenance")  # what a file says of itself: no part of the estimator
NAME = re.compile(r"[A-Za-z0-9_.-]*")  # of a back-end, if it is one


def text_of(parts: Mapping[str, Any]) -> str:
    """The JSON text of an estimator's fields."""
    record: dict[str, Any] = {"format": FORMAT}
    for name, part in parts.items():
        own = {"name": part.name} if isinstance(part, Backend) else {}
        record[name] = part if name in VALUES else own | plain(part)
    return json.dumps(record, indent=2, allow_nan=False) + "\n"


def record_of(text: str) -> dict[str, Any]:
    """The object that `text_of` wrote. Raises InputError on any other text."""

    def refused(constant: str) -> None:  # Python reads NaN and infinities, and JSON has none
        raise ValueError(f"{constant} is no number; write it with to_json")

    try:
        record = json.loads(text, parse_constant=refused)
    except (RecursionError, ValueError) as error:
        raise InputError(f"not an estimator: {error}") from None
    given = record.get("format") if isinstance(record, dict) else None
    if isinstance(given, str) and given != FORMAT and given.startswith(f"{KIND}/"):
        raise InputError(
            f"an estimator of format {shown(given.removeprefix(f'{KIND}/'))}, and this version of "
            f"sparsefit reads format {VERSION}: update sparsefit, or write it with this version"
        )
    if given != FORMAT:
        raise InputError(f'not an estimator: no "format": "{FORMAT}"; write one with to_json')
    if isinstance(record.get("readout", {}), dict):
        record["readout"] = {"refine": UNNAMED} | record.get("readout", {})
    return {key: value for key, value in record.items() if key not in BESIDE}


def parts_of(record: Mapping[str, object], place: Place | None = None) -> dict[str, Any]:
    """The fields of an estimator from nested mappings; what is left out keeps its default.

    Raises InputError with the place on unknown keys and on values that do not fit.
    """
    place = place or Place("estimator")
    only(record, (*RECORDS, "backend", *VALUES), place)
    parts: dict[str, Any] = {}
    for name, part in record.items():
        section = {} if name in VALUES else mapping(part, place.at(name))
        if name in VALUES:
            parts[name] = part
        elif name in RECORDS:
            parts[name] = build(RECORDS[name], section, place.within(name))
        else:
            settings = dict(section)
            named = settings.pop("name", "")
            if not isinstance(named, str) or not NAME.fullmatch(named):
                words = f"must be the name of a back-end, and no path: {shown(named)}"
                raise place.within(name).at("name").error(words)
            try:
                parts[name] = backends.get(named, **settings)
            except TypeError as error:  # a value of a type the back-end does not check
                raise InputError(f"estimator: {error}") from None
    return parts
