"""One case that is run again: its picture, and its numbers beside the stored ones."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pandas as pd

from sparsefit.errors import InputError
from sparsefit.plot import draw_estimate, encoded
from sparsefit.study.figures import Picture
from sparsefit.study.page import drawing, to_html
from sparsefit.study.table import Table, plain
from sparsefit.whole_file import write_whole

CAPTION = (
    "The track over the vorticity of the flow that was estimated, the weight of each candidate "
    "scale, what that flow leaves of the velocity of the air, and its spectrum."
)


def write_case(study: Any, case_id: str, file: Path | None = None) -> Table:
    """Run a case again, draw it into a file, and return its numbers, stored and now.

    Args:
        file: .html, .svg, .png or .pdf; a regression problem is not drawn.

    Raises:
        InputError: if the study plans no such case, or the file has another ending.
    """
    if file is not None and file.suffix.lower() not in (".html", ".svg", ".png", ".pdf"):
        raise InputError(f"{file} must end in .html, .svg, .png, .pdf: no other is drawn")
    again, cases = study.again(case_id), study.cases
    mine = cases[cases["case_id"] == case_id].to_dict("records")
    stored: dict[Any, Any] = mine[0] if mine else {}
    truth = {f"est_{name[5:]}": value for name, value in stored.items() if name[:5] == "true_"}
    rows = [
        (name, truth.get(name), stored.get(name), value)
        for name, value in again.values.items()
        if plain(stored.get(name)) is not None or plain(value) not in (None, "")
    ]
    frame = pd.DataFrame(rows, columns=["what", "truth", "stored", "run again"], dtype=object)
    frame.attrs["title"] = f"Case {case_id}"
    frame.attrs["notes"] = () if stored else ("The case has no stored row yet.",)
    made = Table.of(frame.map(_text))
    if file is None or study.kind != "flights":
        return made
    plan = study.plan()
    case = plan[plan["case_id"] == case_id].iloc[0]
    name = f"{study.name}, case {case_id}: {case['title']}"
    flow = again.flown.draw.flow
    truths = [part.length_scale for part in flow.cells] if flow is not None else []
    estimate, estimator = again.estimate, study.estimator(case["candidate"])
    figure = draw_estimate(estimate, estimator, list(again.flown.fleet[:1]), name, truths)
    if file.suffix.lower() != ".html":
        write_whole(file, encoded(figure, file.suffix.lower()))
        return made
    answer = f"{estimate.status}: {estimate.reason}".removesuffix(": ")
    picture = drawing("case", Picture(figure, CAPTION))
    page = to_html(study.name, name, [answer], {"Picture": [picture], "Numbers": [made]})
    write_whole(file, page)
    return made


def _text(value: object) -> str:
    cell = plain(value)
    return "–" if cell is None else f"{cell:.6g}" if isinstance(cell, float) else str(cell)
