"""What a study shows of its cases: the entries of [outputs].

An entry is a name, or a mapping of options. Only its form is checked here: which names, measures
and comparisons there are, the rooms that make them say.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeAlias

from sparsefit.codec import Place, build, mapping, only, text
from sparsefit.study.spec.document import distinct, items, read_section

Entry: TypeAlias = str | Mapping[str, object]
KINDS = ("tables", "figures", "answers")
Three: TypeAlias = tuple[float, float, float]


@dataclass(frozen=True)
class Reference:
    """Printed numbers that a study is held against; each triple is U0, L_w and tau_w.

    estimate: of one flight [m/s, m, s]; deviation: mean signed errors [m/s, m, s];
    signed_error: in percent; flights: their number; note: printed under the table.
    """

    name: str
    flights: int | None = None
    estimate: Three | None = None
    deviation: Three | None = None
    signed_error: Three | None = None
    note: str = ""


@dataclass(frozen=True)
class Outputs:
    """The tables, figures and answers asked for; empty: what fits the cases."""

    tables: tuple[Entry, ...] = ()
    figures: tuple[Entry, ...] = ()
    answers: tuple[Entry, ...] = ()
    reference: Reference | None = None


def read_outputs(value: object, place: Place) -> Outputs:
    """Read [outputs]; `InputError` names the first entry that has not the right form."""
    section = read_section(value, place.at("outputs"))
    here = place.within("outputs")
    only(section, (*KINDS, "reference"), here)
    tables, figures, answers = (
        _entries(section[kind], here.at(kind)) if kind in section else () for kind in KINDS
    )
    reference = None
    if "reference" in section:
        printed = mapping(section["reference"], here.at("reference"))
        reference = build(Reference, printed, place.within("outputs.reference"))
    return Outputs(tables, figures, answers, reference)


def name_of(entry: Entry) -> str:
    """The name of an entry, or what it measures and compares."""
    if isinstance(entry, str):
        return entry
    return str(
        entry.get("name") or f"{entry.get('measure', '')} {entry.get('compare', '')}".strip()
    )


def _entries(value: object, place: Place) -> tuple[Entry, ...]:
    entries = tuple(
        read_section(item, place) if isinstance(item, dict) else text(item, place)
        for item in items(value, place)
    )
    distinct([entry if isinstance(entry, str) else repr(entry) for entry in entries], place)
    return entries
