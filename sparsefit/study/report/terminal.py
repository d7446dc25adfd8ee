"""A `Table` as text for a terminal."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

from sparsefit.study.evidence.table import (
    Column,
    Table,
    column_groups,
    column_widths,
    display_width,
    pad,
    padded,
)

_NAMES_SHARE = 0.7
_NARROWEST_NAME = 8
_WIDEST_GROUP = 20


def to_text(table: Table, *, width: int = 100) -> str:
    """Return the table for a terminal `width` columns wide.

    Numbers are never cut: columns that do not fit follow in a further block, behind the same
    names. Names that take more than their share lose letters in their middle; words behind the
    numbers, a verdict, stand once.
    """
    cells = table.texts
    heads = [column.heading for column in table.columns]
    natural = _with_groups(table.columns, column_widths([heads, *cells]))
    widths = _fitted(table.columns, natural, width)
    blocks = [
        _block(table.columns, [heads, *cells], widths, chosen)
        for chosen in _blocks(table.columns, widths, width)
    ]
    notes = [textwrap.fill(note, width) for note in table.remarks]
    return "\n\n".join([table.title, *blocks, *notes]) + "\n"


def _with_groups(columns: Sequence[Column], natural: Sequence[int]) -> list[int]:
    """Widen the first column of a group whose heading would be cut, as far as one is read."""
    widths, start = list(natural), 0
    for name, span in column_groups(columns):
        room = sum(natural[start : start + span]) + 2 * (span - 1)
        widths[start] += max(min(display_width(name), _WIDEST_GROUP) - room, 0)
        start += span
    return widths


def _fitted(columns: Sequence[Column], natural: Sequence[int], width: int) -> list[int]:
    """Shrink the widest name column, one letter at a time, while the names take too much."""
    widths, names = list(natural), _names(columns)
    if sum(widths) + 2 * (len(widths) - 1) <= width:
        return widths
    while sum(widths[place] + 2 for place in names) > _NAMES_SHARE * width:
        widest = max(names, key=lambda place: widths[place])
        if widths[widest] <= _NARROWEST_NAME:
            break
        widths[widest] -= 1
    room = max(width - sum(widths[place] + 2 for place in names), _NARROWEST_NAME)
    behind = {place for place, column in enumerate(columns) if column.align == "left"} - {*names}
    return [min(one, room) if place in behind else one for place, one in enumerate(widths)]


def _names(columns: Sequence[Column]) -> list[int]:
    """The places of the columns that say what a row is: those of words before any number."""
    left = [place for place, column in enumerate(columns) if column.align == "left"]
    first = next((place for place in left if place + 1 not in left), 0)
    return [place for place in left if place <= first]


def _blocks(columns: Sequence[Column], widths: Sequence[int], width: int) -> list[list[int]]:
    """Column numbers of each block: the names, then as many groups of numbers as fit."""
    names = _names(columns)
    room = width - sum(widths[place] + 2 for place in names) + 2
    blocks: list[list[int]] = [[]]
    for run in _runs(columns, widths, room, set(names)):
        if blocks[-1] and sum(widths[place] + 2 for place in [*blocks[-1], *run]) > room:
            blocks.append([])
        blocks[-1] += run
    return [sorted([*names, *block]) for block in blocks]


def _runs(
    columns: Sequence[Column], widths: Sequence[int], room: int, names: set[int]
) -> list[list[int]]:
    """Column numbers that stay together: a group where it fits a line, else each alone."""
    runs, start = [], 0
    for name, span in column_groups(columns):
        run = [place for place in range(start, start + span) if place not in names]
        together = name and sum(widths[place] + 2 for place in run) <= room
        runs += [run] if together else [[place] for place in run]
        start += span
    return runs


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
    """Leave out the middle: names of one family differ at their ends."""
    if display_width(text) <= width:
        return text
    head = tail = len(text) // 2
    while head + len(text) - tail and display_width(text[:head] + text[tail:]) > width - 1:
        if head > len(text) - tail:
            head -= 1
        else:
            tail += 1
    return text[:head] + "…" + text[tail:]
