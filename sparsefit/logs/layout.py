"""Which columns of a foreign table are a flight, and in which units: ``time=t,x=lon,vx=u[cm/s]``.

A field (``time``, ``x``, ``y``, ``vx``, ``vy``, ``ax``, ``ay``) is read from the column that a map
names, else from the one of its own name, whatever its case; ``ax`` and ``ay``, a measured thrust,
beside a map only where it says so. The unit is that of the map, else the one that stands behind the
name in the header, ``u [cm/s]`` or ``u (cm/s)``, else the SI unit. Columns that a map names and
that begin with ``lon`` and ``lat`` are degrees.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from itertools import chain
from typing import TypeAlias

from sparsefit.errors import InputError, one_of, suggestion
from sparsefit.logs.anchor import Anchor
from sparsefit.logs.table import COLUMNS, POSITIONS, THRUST, VELOCITY
from sparsefit.logs.units import DEGREES, factor_of, spelled

Columns: TypeAlias = "str | Mapping[str, str] | None"
"""A column map as it is typed, or as a mapping of fields to columns."""
FIELDS = (*COLUMNS, *THRUST)
_TYPED = re.compile(r"(?P<name>.*?)\s*\[(?P<unit>[^\[\]]*)\]")
_HEADING = re.compile(r"(?P<name>.+?)\s*(?:\[(?P<unit>[^\[\]]*)\]|\((?P<other>[^()]*)\))")
_GEOGRAPHIC = ("lon", "lat")  # how names of columns begin that hold degrees


@dataclass(frozen=True)
class Source:
    """Where a field is read from.

    Args:
        column: the name of the column, as the header spells it.
        unit: empty for s, m and m/s.
    """

    column: str
    unit: str = ""

    def __str__(self) -> str:
        told = not self.unit or spelled(_heading(self.column)[1]) == self.unit
        return self.column if told else f"{self.column} [{self.unit}]"


@dataclass(frozen=True)
class Layout:
    """How a table is read.

    Args:
        sources: the fields that a column map names; none where the table is as this package
            writes it.
        only: a column and the text in it of the rows that are read; None for all rows.
        anchor: where and when the zeros shall be, of a log that tells places and times; its own
            middle and its first sample where nothing is said.
    """

    sources: Mapping[str, Source] = field(default_factory=dict)
    only: tuple[str, str] | None = None
    anchor: Anchor = Anchor()

    @classmethod
    def of(
        cls, columns: Columns = None, only: str | None = None, anchor: Anchor | None = None
    ) -> Layout:
        """Read ``time=t,x=lon[deg],...``, or a mapping, and ``column=value``.

        Raises:
            InputError: on a field that is none, or is given twice, and on an unknown unit.
        """
        sources: dict[str, Source] = {}
        for name, text in _pairs(columns):
            one_of("field", name, FIELDS)
            if name in sources:
                raise InputError(f"columns: {name} is given twice; keep one")
            sources[name] = _source(name, text)
        return cls(sources, None if only is None else _only(only), anchor or Anchor())

    @property
    def foreign(self) -> bool:
        """Whether the table is not one that this package has written."""
        return bool(self.sources)

    def chosen(self, names: list[str]) -> dict[str, Source]:
        """The sources of all fields that a table with these columns has.

        Raises:
            InputError: where a column is missing or stands twice.
        """
        typed = {name: _mapped(name, source, names) for name, source in self.sources.items()}
        rest = COLUMNS if self.foreign else FIELDS
        own = {name: _own(name, names) for name in rest if name not in typed}
        found = typed | {name: source for name, source in own.items() if source}
        return _complete({name: found[name] for name in FIELDS if name in found}, names)

    def refuse_any(self, what: str) -> None:
        """Raise `InputError` if anything is asked of a file whose columns are its own."""
        if self.sources or self.only:
            raise InputError(f"{what} tells its own columns; leave columns and only out")


def _pairs(columns: Columns) -> Iterable[tuple[str, str]]:
    if columns is None:
        return []
    if isinstance(columns, Mapping):
        return [(str(name), str(text)) for name, text in columns.items()]
    if not isinstance(columns, str):
        raise InputError(
            f"columns must be text or a mapping, as time=t,x=lon,y=lat; got {columns!r}"
        )
    pairs = [pair.partition("=") for pair in columns.split(",")]
    for name, equals, text in pairs:
        if not equals or not name.strip() or not text.strip():
            told = f"{name}{equals}{text}".strip()
            raise InputError(f'columns: "{told}" is not field=column, as in time=t,x=lon,y=lat')
    return [(name.strip(), text.strip()) for name, _, text in pairs]


def _source(name: str, text: str) -> Source:
    match = _TYPED.fullmatch(text)
    column, unit = (match["name"], match["unit"].strip()) if match else (text, "")
    factor_of(name, unit)
    return Source(column, spelled(unit))


def _only(text: str) -> tuple[str, str]:
    column, equals, value = str(text).partition("=")
    if not equals or not column.strip():
        raise InputError(f'"{text}" is not column=value, as in id=7')
    return column.strip(), value.strip()


def _heading(text: str) -> tuple[str, str]:
    """The name of a column, and the unit behind it."""
    match = _HEADING.fullmatch(text)
    return (match["name"], (match["unit"] or match["other"] or "").strip()) if match else (text, "")


def _named(wanted: str, names: list[str]) -> list[str]:
    """The headings that are a name: exactly, or but for their unit, or their case."""
    for key in (
        lambda heading: heading,
        lambda heading: _heading(heading)[0],
        lambda heading: _heading(heading)[0].casefold(),
    ):
        found = [name for name in names if key(name) == key(wanted)]
        if found:
            return found
    return []


def _own(name: str, names: list[str]) -> Source | None:
    """The source of a field by its own name, where a table has one."""
    found = _named(name, names)
    return _in_unit(name, Source(_single(found)), "") if found else None


def _mapped(name: str, source: Source, names: list[str]) -> Source:
    """The source of a field that a map names, as the header spells it."""
    wanted = source.column
    found = _named(f"{wanted} [{source.unit}]", names) if source.unit else []
    found = found or _named(wanted, names)
    if not found:
        raise InputError(f'no column "{wanted}"{suggestion(wanted, names)}')
    degrees = name in "xy" and wanted.casefold().startswith(_GEOGRAPHIC)
    return _in_unit(name, replace(source, column=_single(found)), DEGREES if degrees else "")


def _in_unit(name: str, source: Source, unit: str) -> Source:
    """The source in its own unit, else in that of the header, else in a ``unit``."""
    if source.unit:
        return source
    source = replace(source, unit=spelled(_heading(source.column)[1]) or unit)
    factor_of(name, source.unit)
    return source


def _single(found: list[str]) -> str:
    if len(found) > 1:
        raise InputError(f"column {found[0]} appears more than once; keep one of each")
    return found[0]


def _complete(found: dict[str, Source], names: list[str]) -> dict[str, Source]:
    """The sources, if none is missing; with neither vx nor vy they are of positions only."""
    pairs = [pair for pair in (VELOCITY, THRUST) if set(pair) & set(found)]
    wanted = COLUMNS if not found else (*POSITIONS, *chain.from_iterable(pairs))
    missing = [name for name in wanted if name not in found]
    if missing:
        raise InputError(_lacks(missing, names))
    if len({found[name].unit == DEGREES for name in "xy"}) > 1:
        told = f"x = {found['x']}, y = {found['y']}"
        raise InputError(f"columns: {told}: both are degrees, or none; say [deg] or [m]")
    return found


def _lacks(missing: list[str], names: list[str]) -> str:
    lack, header = ", ".join(missing), ascii(", ".join(names)[:200])[1:-1] or "nothing"
    if names and all(is_number(name) for name in names):
        return f"no column {lack}: the first line holds numbers; put the names of columns above it"
    remedy = "rename or add it, or say which it is: --columns time=t,x=lon,..."
    return f"no column {lack}; found {header}; {remedy}"


def is_number(text: str) -> bool:
    """Whether a cell is a number, infinite or NaN too, with a decimal point or comma."""
    try:
        float(text.replace(",", "."))
    except ValueError:
        return False
    return True
