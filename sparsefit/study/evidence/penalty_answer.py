"""The answer of a study of penalties: rules that choose from the flight beside fixed penalties."""

from __future__ import annotations

import numpy as np
import pandas as pd

from sparsefit.study.evidence import candidates
from sparsefit.study.evidence.sentence import shown
from sparsefit.study.evidence.summary import SYMBOLS, Group, StudyRecord, by_setting, parsed

AUTO = "auto"


def penalty(study: StudyRecord, cases: pd.DataFrame) -> str:
    """For each back-end the mean |error| of tau_w by every rule, and by the fixed penalties."""
    backends: dict[str, list[Group]] = {}
    for group in by_setting(cases):
        if "alpha_fraction" in parsed(group.key["settings"]):
            backends.setdefault(str(group.key["backend"]), []).append(group)
    said = [f"{name} {_told(groups)}" for name, groups in backends.items()]
    return (
        f"Mean |error| of {SYMBOLS['timescale']} by the rule that chooses the penalty, a flight "
        f"without an estimate counting as 100 %: {'; '.join(said) or 'no back-end has a penalty'}."
    )


def _told(groups: list[Group]) -> str:
    rules: dict[str, list[float]] = {}
    fixed: list[float] = []
    for group in groups:
        settings = parsed(group.key["settings"])
        loss = float(np.mean(candidates.losses(group.cases, candidates.CRITERIA[0])))
        if settings["alpha_fraction"] == AUTO:
            rules.setdefault(str(settings.get("selection")), []).append(loss)
        else:
            fixed.append(loss)
    words = [f"{rule} {shown(float(np.mean(found)))} %" for rule, found in rules.items()]
    if fixed:
        words.append(f"fixed {shown(min(fixed))} to {shown(max(fixed))} %")
    return ", ".join(words)
