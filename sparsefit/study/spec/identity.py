"""What a case is, whatever study asks for it: a hash of all that determines its numbers.

That is the seed and the flight rules, what is derived, fitted and read, to which tolerance: not
the names that a study gives to these, nor what else it plans, nor how long a case may take. A
setting at its default counts as one that is not there, so that a new one leaves the rest as it is.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import MISSING, Field, fields, is_dataclass
from typing import Any, TypeAlias

from sparsefit.backends import load
from sparsefit.study.spec.design import Cell
from sparsefit.study.spec.document import canonical_json
from sparsefit.study.spec.flights import FlightRules
from sparsefit.study.spec.logs import Logs
from sparsefit.study.spec.names import Names, numbered
from sparsefit.study.spec.setup import Setup
from sparsefit.study.spec.solver_study import SolverStudy
from sparsefit.study.spec.study import Study

AnyStudy: TypeAlias = Study | SolverStudy
SPACED = "linspace"  # the rule by which a flight depends on how many there are


def identities(study: Study) -> tuple[str, ...]:
    """Of every cell of a study, in plan order, 16 hexadecimal digits; a flight's number is beside.

    Cells that differ in their names alone have equal numbers; the second is told by `-2`.
    """
    return numbered(_digests(study))


def names_of(study: AnyStudy) -> Names:
    """What the rows of a study are kept by: what determines their numbers."""
    if isinstance(study, SolverStudy):
        cells, problems = study.identities()
        return Names(cells, study.count, problems)
    return Names(identities(study), study.count)


def _digests(study: Study) -> Iterator[str]:
    common = canonical_json([study.seed, study.tolerance, study.prediction_flights])
    setups: dict[int, str] = {}
    parts: dict[int, str] = {}  # of setups that share them
    defaults = {name: _defaults(name) for name in {choice.name for choice in study.backends}}
    for cell in study.cells:
        setup = setups.get(id(cell.setup))
        if setup is None:
            setup = setups[id(cell.setup)] = _setup(cell.setup, study.count, parts)
        content = "\n".join((common, setup, cell.backend, _settings(cell, defaults[cell.backend])))
        yield hashlib.sha256(content.encode(errors="backslashreplace")).hexdigest()[:16]


def _setup(setup: Setup, count: int, parts: dict[int, str]) -> str:
    told = [_flights(setup.flights, count)]
    for part in (setup.derivative, setup.library, setup.readout):
        if id(part) not in parts:
            parts[id(part)] = canonical_json(_content(part))
        told.append(parts[id(part)])
    if setup.online.asked:
        told.append(canonical_json(_content(setup.online)))
    return ",".join(told)


def _flights(flights: FlightRules | Logs, count: int) -> str:
    if isinstance(flights, Logs):  # what was logged, wherever the file lies
        pieces = [[piece.digest, piece.start, piece.end] for piece in flights.pieces]
        return canonical_json([pieces, _content(flights.vehicle)])
    spaced = any(entry.rule == SPACED for _, entry in flights.entries)
    rules = (f"{name} {entry.rule} {entry.values!r}" for name, entry in flights.entries)
    log = "" if flights.thrust_log == "measured" else f" {flights.thrust_log}"
    return f"{count if spaced else 0} {flights.cells} {flights.spectrum}{log} {'; '.join(rules)}"


def _settings(cell: Cell, defaults: Mapping[str, object]) -> str:
    settings = json.loads(cell.canonical_settings)
    told = {key: value for key, value in settings.items() if value != defaults.get(key, MISSING)}
    return canonical_json(told)


def _defaults(name: str) -> dict[str, object]:
    known: tuple[Field[Any], ...] = fields(load(name))  # type: ignore[arg-type]
    return {field.name: field.default for field in known}


def _content(value: object) -> object:
    """A record as its name and the fields that are not at their defaults."""
    if is_dataclass(value):
        told = {
            field.name: _content(getattr(value, field.name))
            for field in fields(value)
            if getattr(value, field.name) != _default(field)
        }
        return [type(value).__name__, told]
    if isinstance(value, list | tuple):
        return [_content(item) for item in value]
    return value


def _default(field: Field[Any]) -> object:
    if field.default_factory is not MISSING:
        return field.default_factory()
    return field.default
