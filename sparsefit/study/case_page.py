"""One case that is run again: its picture, and its numbers beside the stored ones."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from sparsefit.errors import InputError
from sparsefit.plot.estimate import draw_estimate
from sparsefit.plot.style import encoded
from sparsefit.study import page
from sparsefit.study.figures import Picture
from sparsefit.study.table import Column, Table, Value, plain
from sparsefit.whole_file import write_whole

SUFFIXES = (".html", ".svg", ".png", ".pdf")
CAPTION = (
    "The track over the vorticity of the flow that was estimated, the weight of each candidate "
    "scale, what that flow leaves of the velocity of the air, and its spectrum."
)


def write_case(study: Any, case_id: str, file: Path | None = None) -> Table:
    """Run a case again, draw it into a file, and return its numbers, stored and now.

    Args:
        file: .html, .svg, .png or .pdf; nothing is drawn of a regression problem or without one.

    Raises:
        InputError: if the study plans no such case, or the file has another ending.
    """
    if file is not None and file.suffix.lower() not in SUFFIXES:
        raise InputError(f"{file} must end in {', '.join(SUFFIXES)}: no other is drawn")
    again = study.again(case_id)
    stored = study.cases
    rows = stored[stored["case_id"] == case_id].to_dict("records")
    made = _compared(case_id, rows[0] if rows else {}, again.values)
    if file is None or study.kind != "flights":
        return made
    plan = study.plan()
    case = plan[plan["case_id"] == case_id].iloc[0]
    name = f"{study.name}, case {case_id}: {case['title']}"
    truth = [part.length_scale for part in again.flow.cells] if again.flow is not None else []
    estimate = again.estimate
    figure = draw_estimate(estimate, study.estimator(case["candidate"]), [again.flown], name, truth)
    if file.suffix.lower() != ".html":
        write_whole(file, encoded(figure, file.suffix.lower()))
        return made
    answer = f"{estimate.status}: {estimate.reason}" if estimate.reason else estimate.status
    sections = [
        page.Section("Picture", [page.drawing("case", Picture(figure, CAPTION))]),
        page.Section("Numbers", [made]),
    ]
    write_whole(file, page.to_html(study.name, name, [answer], sections).encode())
    return made


def _compared(case_id: str, stored: dict[str, Any], now: Any) -> Table:
    """Return every number of a case as it is stored and as it is now."""
    rows: list[tuple[Value, ...]] = []
    for name, value in now.items():
        before, after = plain(stored.get(name)), plain(value)
        if before is not None or after not in (None, ""):
            rows.append((name, _told(stored.get(f"true_{name[4:]}")) if name[:4] == "est_" else "",
                         _told(before), _told(after)))  # fmt: skip
    heads = ("what", "truth", "stored", "run again")
    note = "" if stored else "The case has no stored row yet."
    return Table(f"Case {case_id}", tuple(map(Column, heads)), rows, (note,) if note else (), 100)


def _told(value: object) -> str:
    cell = plain(value)
    return "–" if cell is None else f"{cell:.6g}" if isinstance(cell, float) else str(cell)
