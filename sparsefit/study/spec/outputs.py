"""What a study shows of its cases: the entries of [outputs].

An entry is a name, or a mapping of options. Only its form is checked here: which names, measures
and comparisons there are, the rooms that make them say.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeAlias

from sparsefit.codec import Place, integer, number, only
from sparsefit.study.spec.document import distinct, items, read_section, required, text

Entry: TypeAlias = str | Mapping[str, object]
KINDS = ("tables", "figures", "answers")
THREE = ("estimate", "deviation", "signed_error")


@dataclass(frozen=True)
class Reference:
    """Printed numbers that a study is held against; each triple is U0, L_w and tau_w.

    estimate: of one flight [m/s, m, s]; deviation: mean signed errors [m/s, m, s];
    signed_error: in percent; flights: their number; note: printed under the table.
    """

    name: str
    flights: int | None = None
    estimate: tuple[float, float, float] | None = None
    deviation: tuple[float, float, float] | None = None
    signed_error: tuple[float, float, float] | None = None
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
    return Outputs(
        **{kind: _entries(section[kind], here.at(kind)) for kind in KINDS if kind in section},
        reference=_reference(section["reference"], here) if "reference" in section else None,
    )


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


def _reference(value: object, place: Place) -> Reference:
    section = read_section(value, place.at("reference"))
    here = place.within("outputs.reference")
    only(section, ("name", "flights", *THREE, "note"), here)
    given = {key: _three(section[key], here.at(key)) for key in THREE if key in section}
    flights = section.get("flights")
    return Reference(
        name=text(required(section, "name", here), here.at("name")),
        flights=None if flights is None else integer(flights, here.at("flights"), least=1),
        note=text(section["note"], here.at("note")) if "note" in section else "",
        **given,
    )


def _three(value: object, place: Place) -> tuple[float, float, float]:
    values = [number(item, place) for item in items(value, place)]
    if len(values) != 3:
        raise place.error(f"must be three numbers, for U0, L_w and tau_w, not {len(values)}")
    return values[0], values[1], values[2]
