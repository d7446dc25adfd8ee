"""What a study shows of its cases: the names of its tables, figures and answers.

They are declared here, above the rooms that make them, so that a study file is checked without
loading any of those; tests hold these names and the registries of those rooms together.
"""

from __future__ import annotations

from dataclasses import dataclass

from sparsefit.codec import Place, only
from sparsefit.errors import suggestion
from sparsefit.study.spec.document import distinct, items, read_section, text

NAMES = {
    "tables": (
        *("parameters", "errors", "errors-absolute", "readings", "sensitivity", "scales", "times"),
        *("methods", "efficiency", "coverage", "identifiability", "windows"),
    ),
    "figures": (
        *("weights", "scatter", "errors", "sweep", "methods", "scales", "dual-certificate"),
        *("efficiency", "windows", "coverage", "grids"),
    ),
    "answers": (
        *("derivatives", "vehicle", "multiscale", "parameters", "least-errors", "readings"),
        *("selection", "penalty", "completeness", "efficiency", "windows", "grids"),
        *("coverage", "identifiability"),
    ),
}


@dataclass(frozen=True)
class Outputs:
    """The names of the tables, figures and answers asked for; empty: what fits the cases."""

    tables: tuple[str, ...] = ()
    figures: tuple[str, ...] = ()
    answers: tuple[str, ...] = ()


def read_outputs(value: object, place: Place) -> Outputs:
    """The names in [outputs]; `InputError` names the first that is not in `NAMES`."""
    section = read_section(value, place.at("outputs"))
    here = place.within("outputs")
    only(section, NAMES, here)
    return Outputs(**{kind: _names(section[kind], kind, here) for kind in NAMES if kind in section})


def _names(value: object, kind: str, place: Place) -> tuple[str, ...]:
    here = place.at(kind)
    names = tuple(text(item, here) for item in items(value, here))
    distinct(names, here)
    for name in names:
        if name not in NAMES[kind]:
            raise here.error(f'names "{name}", unknown' + suggestion(name, NAMES[kind]))
    return names
