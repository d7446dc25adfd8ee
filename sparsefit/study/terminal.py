"""A `Table` as text for a terminal."""

from __future__ import annotations

from collections.abc import Sequence

from sparsefit.study.table import (
    Column,
    Table,
    column_groups,
    column_widths,
    display_width,
    pad,
    padded,
)

_NARROWEST_NAME = 10


def to_text(table: Table, *, width: int = 100) -> str:
    """The table for a terminal `width` columns wide.

    Names are shortened with `…` first; numbers never are: columns that still do not fit follow
    in a further block, behind the same names.
    """
    cells = table.texts
    heads = [column.heading for column in table.columns]
    widths = _fitted(table.columns, column_widths([heads, *cells]), width)
    blocks = [
        _block(table.columns, [heads, *cells], widths, chosen)
        for chosen in _blocks(table.columns, widths, width)
    ]
    return "\n\n".join([table.title, *blocks, *table.remarks]) + "\n"


def _fitted(columns: Sequence[Column], natural: Sequence[int], width: int) -> list[int]:
    """Shrink the widest name column, one letter at a time, while the table is too wide."""
    widths = list(natural)
    names = [place for place, column in enumerate(columns) if column.align == "left"]
    while names and sum(widths) + 2 * (len(widths) - 1) > width:
        widest = max(names, key=lambda place: widths[place])
        if widths[widest] <= _NARROWEST_NAME:
            break
        widths[widest] -= 1
    return widths


def _blocks(columns: Sequence[Column], widths: Sequence[int], width: int) -> list[list[int]]:
    """Column numbers of each block: the names, then as many numbers as fit, at least one."""
    names = [place for place, column in enumerate(columns) if column.align == "left"]
    blocks: list[list[int]] = [[]]
    for place in (place for place in range(len(columns)) if place not in names):
        taken = [*names, *blocks[-1], place]
        if blocks[-1] and sum(widths[one] + 2 for one in taken) - 2 > width:
            blocks.append([])
        blocks[-1].append(place)
    return [sorted([*names, *block]) for block in blocks]


def _block(
    columns: Sequence[Column],
    rows: Sequence[Sequence[str]],
    widths: Sequence[int],
    chosen: list[int],
) -> str:
    picked = [columns[place] for place in chosen]
    sizes = [widths[place] for place in chosen]
    lines = [
        "  ".join(padded([_cut(row[place], widths[place]) for place in chosen], sizes, picked))
        for row in rows
    ]
    rule = "  ".join("-" * size for size in sizes)
    body = [lines[0], rule, *lines[1:]]
    return "\n".join(line.rstrip() for line in [*_group_line(picked, sizes), *body])


def _group_line(columns: Sequence[Column], widths: Sequence[int]) -> list[str]:
    if not any(column.group for column in columns):
        return []
    line, start = [], 0
    for name, span in column_groups(columns):
        room = sum(widths[start : start + span]) + 2 * (span - 1)
        line.append(pad(_cut(name, room), room, "right"))
        start += span
    return ["  ".join(line)]


def _cut(text: str, width: int) -> str:
    if display_width(text) <= width:
        return text
    while text and display_width(text) > width - 1:
        text = text[:-1]
    return text + "…"
