"""What a study shows of its cases: the names of its answer, tables and figures."""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Iterable
from dataclasses import dataclass

from sparsefit.errors import suggestion
from sparsefit.study.spec.document import Place, distinct, items, only, table, text


@dataclass(frozen=True)
class Outputs:
    """Names in the registries of tables, figures and answers; empty: what fits the cases."""

    tables: tuple[str, ...] = ()
    figures: tuple[str, ...] = ()
    answers: tuple[str, ...] = ()


REGISTRIES = {"tables": "TABLES", "figures": "FIGURES", "answers": "ANSWERS"}
ROOMS = {"tables": "evidence", "figures": "report", "answers": "evidence"}


def read_outputs(value: object, place: Place) -> Outputs:
    """The names in [outputs], each known to its registry."""
    section = table(value, place.at("outputs"))
    here = place.within("outputs")
    only(section, REGISTRIES, here)
    return Outputs(
        **{kind: _names(section[kind], kind, here) for kind in REGISTRIES if kind in section}
    )


def known(kind: str) -> Iterable[str] | None:
    """The registered names; None where the room that draws them is not installed.

    Imported only when a study asks for it: figures bring in the plotting library.
    """
    module = f"sparsefit.study.{ROOMS[kind]}.{kind}"
    if importlib.util.find_spec(module) is None:
        return None
    names: Iterable[str] = getattr(importlib.import_module(module), REGISTRIES[kind])
    return names


def _names(value: object, kind: str, place: Place) -> tuple[str, ...]:
    here = place.at(kind)
    names = tuple(text(item, here) for item in items(value, here))
    distinct(names, here)
    registered = known(kind)
    for name in names:
        if registered is not None and name not in registered:
            raise here.error(f'names "{name}", unknown' + suggestion(name, registered))
    return names
