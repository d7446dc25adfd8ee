"""How a study was made, in paragraphs made from its file."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING

from sparsefit.study.evidence.along import unit_of, words_of
from sparsefit.study.evidence.cases import level_text
from sparsefit.study.evidence.sentence import listed
from sparsefit.study.evidence.table import Column, Table
from sparsefit.study.spec.document import canonical_json

if TYPE_CHECKING:
    from sparsefit.study.spec.choices import BackendChoice
    from sparsefit.study.spec.study import Study

FLIGHTS, FILES = "flights.", "flights.files"
RULES = {
    "uniform": "uniform from {} to {}",
    "loguniform": "log-uniform from {} to {}",
    "linspace": "equally spaced from {} to {}",
}


def methods(study: Study) -> list[str]:
    """Return paragraphs: the flights, how they were read, by whom, and what a case is."""
    flights = list(_given(study, flights=True))
    logged = FILES in study.given
    flown = f"{study.count} {'pieces of logs were read' if logged else 'flights were simulated'}"
    seed = "" if logged else f" from seed {study.seed}"
    said = [f"{flown}{seed}, with {listed(flights)}." if flights else f"{flown}{seed}."]
    if study.validate_count:
        left = study.count - study.validate_count
        said.append(f"{study.validate_count} of them are for choosing and {left} for judging.")
    return [" ".join(said), " ".join([*_read(study), _cases(study)])]


def _given(study: Study, *, flights: bool) -> Iterator[str]:
    """What the file sets, `timescale equally spaced from 0.05 to 1 s`."""
    for key, text in study.given.items():
        if key.startswith(FLIGHTS) == flights:
            room, _, name = key.rpartition(".")
            words = words_of(name) if flights else f"{room} {words_of(name)}"
            yield f"{words} {said(json.loads(text), unit_of(name))}"


def said(value: object, unit: str = "") -> str:
    """Return a value of a study file in words, `uniform from 2 to 10 m`."""
    after = f" {unit}" if unit else ""
    if isinstance(value, dict):
        ((rule, numbers),) = value.items()
        if rule in RULES:
            return RULES[rule].format(*map(level_text, numbers)) + after
        return f"one of {listed(list(map(level_text, numbers)))}{after}"
    if isinstance(value, list):
        return f"({', '.join(map(said, value))}){after}"
    return value if isinstance(value, str) else f"{level_text(_level(value))}{after}"


def _read(study: Study) -> Iterator[str]:
    given = list(_given(study, flights=False))
    if given:
        yield f"They were read with {listed(given)}; what is not named is the default."
    if len(study.protocols) > 1:
        names = listed([one.name for one in study.protocols])
        yield f"{len(study.protocols)} protocols, told apart below: {names}."
    for factor in study.sweep:
        levels = listed([level_text(_level(level)) for level in factor.levels])
        after = f" {unit_of(factor.key)}".rstrip()
        yield f"Swept: {words_of(factor.key)} over {levels}{after}."
    yield f"Back-ends: {'; '.join(map(_backend, study.backends))}."


def _level(level: object) -> str | float:
    return level if isinstance(level, str | float | int) else canonical_json(level)


def _backend(choice: BackendChoice) -> str:
    name = choice.label if choice.label == choice.name else f"{choice.label} ({choice.name})"
    settings = [
        f"{key} {', '.join(level_text(_level(value)) for value in values)}"
        for key, values in choice.grid.items()
    ]
    return f"{name} with {listed(settings)}" if settings else name


def _cases(study: Study) -> str:
    return (
        f"That makes {len(study.cells)} cases of each flight, {study.planned} in all. A fit is ok "
        f"only where its certificate, which the back-end does not compute, is at most "
        f"{study.tolerance:g}; a case may take {study.case_timeout:g} s."
    )


def protocols(study: Study) -> Iterable[Table]:
    """Give the table of what each protocol sets, where there are several."""
    if len(study.protocols) > 1:
        rows = [
            (one.name, key, said(value, unit_of(key)))
            for one in study.protocols
            for key, value in one.overrides.items()
        ]
        heads = tuple(Column(name, align="left") for name in ("protocol", "key", "value"))
        yield Table("What each protocol sets", heads, tuple(rows))
