"""What the studies of the paper's own tables say, and the one that only has to run."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pandas as pd

from sparsefit.study.evidence import candidates, paper
from sparsefit.study.evidence import readings as reading_tables
from sparsefit.study.evidence.sentence import listed, shown, some
from sparsefit.study.evidence.summary import (
    STATUSES,
    SYMBOLS,
    StudyRecord,
    by_setting,
    estimated,
    grouped,
    percent_errors,
)

TAU = SYMBOLS["timescale"]


def parameters(study: StudyRecord, cases: pd.DataFrame) -> str:
    """Which back-ends read tau_w closest to the truth, and which farthest."""
    errors: dict[str, list[str]] = {}
    sizes: dict[str, float] = {}
    for group in by_setting(cases):
        error = float(np.mean(percent_errors(group.cases)[:, 2]))
        text = f"{error:+.2f} %" if np.isfinite(error) else "no estimate"
        errors.setdefault(text, []).append(group.title)
        sizes[text] = abs(error) if np.isfinite(error) else np.inf
    order = sorted(errors, key=lambda text: sizes[text])
    said = [f"{listed(errors[text])} ({text})" for text in order]
    first = f"{TAU} is read closest by {said[0]}"
    last = f", farthest by {said[-1]}" if len(said) > 1 else ""
    return f"{first}{last}; the paper's own is {paper.ESTIMATE_PERCENT[2]:+.2f} %."


def least_errors(study: StudyRecord, cases: pd.DataFrame) -> str:
    """The least mean |error| of tau_w for each protocol, and whose it is."""
    said = []
    for protocol in grouped(cases, ["protocol"]):
        values = {
            group.title: float(np.mean(candidates.losses(group.cases, candidates.CRITERIA[0])))
            for group in by_setting(protocol.cases)
        }
        least = shown(min(values.values()))
        best = [name for name, value in values.items() if shown(value) == least]
        said.append(f"{protocol.key['protocol']} {least} % ({some(best)})")
    return (
        f"Least mean |error| of {TAU}, a flight without an estimate counting as 100 %: "
        f"{', '.join(said)}."
    )


def readings(study: StudyRecord, cases: pd.DataFrame) -> str:
    """The closest reading, and the factor that moves tau_w most."""
    closest = reading_tables.readings(study, cases)
    names = [column.name for column in closest.columns]
    row, start = closest.rows[0], names.index("n")
    levels = [
        f"{name.partition('.')[2]} {row[place]}"
        for place, name in enumerate(names[:start])
        if "." in name
    ]
    factor = reading_tables.sensitivity(study, cases).rows[0]
    return (
        f"Of {len(closest.rows)} readings {row[names.index('setting')]} with {', '.join(levels)} "
        f"comes closest, {shown(float(row[-1] or 0))} percentage points from Table 2; the error "
        f"of {TAU} hangs most on {factor[0]} (its median moves by {shown(float(factor[5] or 0))} "
        "points)."
    )


def selection(study: StudyRecord, cases: pd.DataFrame) -> str:
    """The best on the validate flights by the mean |error| of tau_w, and its evaluate score."""
    found = candidates.candidates_of(cases, candidates.CRITERIA[0])
    least = shown(min(one.validate for one in found))
    best = [one for one in found if shown(one.validate) == least]
    scores = sorted({shown(one.evaluate) for one in best})
    return (
        f"Least mean |error| of {TAU} on the validate flights: {least} %, by "
        f"{some([one.title for one in best])}; on the evaluate flights {listed(scores)} %. "
        "Of equals, sparsefit select takes the fastest."
    )


def completeness(study: StudyRecord, cases: pd.DataFrame) -> str:
    """How many planned cases ended as rows, and how."""
    counted = Counter(cases["status"])
    statuses = [f"{counted[name]} {name}" for name in STATUSES if counted[name]]
    answered = int(estimated(cases).sum())
    verdict = "Yes" if len(cases) == study.planned and answered == len(cases) else "Not wholly"
    return (
        f"{verdict}: {len(cases)} of {study.planned} planned cases ended as rows, "
        f"{answered} of them with an estimate ({', '.join(statuses)})."
    )
