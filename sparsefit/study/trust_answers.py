"""How far intervals and statuses can be believed: the sentences of coverage."""

from __future__ import annotations

import pandas as pd

from sparsefit.study.confidence import OFF, Share, held, verdicts
from sparsefit.study.sentence import listed
from sparsefit.study.summary import PARAMETERS, SYMBOLS, StudyRecord, by_setting, factors, in_a_flow

NOMINAL = (93.0, 97.0)  # percent: what 95 % intervals must keep


def coverage(study: StudyRecord, cases: pd.DataFrame) -> str:
    """From where to where the coverage goes, and which regimes leave 93-97 %."""
    swept, shares, outside = factors(cases), [], []
    for group in by_setting(cases[in_a_flow(cases)], *swept):
        for name in PARAMETERS:
            share, _ = held(group.cases, name)
            if not share.whole:
                continue
            shares.append(share)
            if not NOMINAL[0] <= share.percent <= NOMINAL[1]:
                where = ", ".join(str(group.key[one]) for one in ("protocol", *swept))
                outside.append(f"{SYMBOLS[name]} of {where} ({share.percent:.1f} %)")
    if not shares:
        return "No case has an interval: the coverage is not known."
    low, high = min(one.percent for one in shares), max(one.percent for one in shares)
    held_, tried = sum(one.part for one in shares), sum(one.whole for one in shares)
    words = f"outside 93-97 %: {listed(outside)}" if outside else "all within 93-97 %"
    return (
        f"The 95 % intervals held the truth in {Share(held_, tried).percent:.1f} % of the cases "
        f"called ok, {low:.1f} to {high:.1f} % by regime and parameter; {words}."
    )


def identifiability(study: StudyRecord, cases: pd.DataFrame) -> str:
    """Of ok, how many were off; of unidentifiable, how many deserved it; of no flow, called so."""
    found = verdicts(cases)
    off = Share(found.off, found.ok)
    words = [
        f"Of {found.ok} flights called ok {found.off} ({off.percent:.2f} %, at most "
        f"{off.interval[1]:.2f} %) were off by more than {OFF:g} %"
        if found.ok
        else "No flight was called ok"
    ]
    if found.unidentifiable:
        deserved = Share(found.deserved, found.unidentifiable)
        words.append(
            f"of {found.unidentifiable} called unidentifiable {deserved.percent:.0f} % deserved it"
        )
    if found.empty:
        called = Share(found.called_so, found.empty)
        words.append(
            f"of {found.empty} flights without a flow {called.percent:.1f} % were called so, "
            f"with {found.false_alarms} false alarms"
        )
    return f"{'; '.join(words)}."
