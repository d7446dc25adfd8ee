"""How far intervals and statuses can be believed: the sentences of coverage."""

from __future__ import annotations

import pandas as pd

from sparsefit.study.evidence.confidence import OFF, Share, held, verdicts
from sparsefit.study.evidence.sentence import listed
from sparsefit.study.evidence.summary import PARAMETERS, StudyRecord, by_setting, factors, in_a_flow

NOMINAL = (93.0, 97.0)  # percent: what 95 % intervals must keep


def coverage(study: StudyRecord, cases: pd.DataFrame) -> str:
    """From where to where the coverage goes, and which regimes are not within 93-97 %."""
    swept, every, outside = factors(cases), [], []
    for group in by_setting(cases[in_a_flow(cases)], *swept):
        shares = [share for share, _ in (held(group.cases, name) for name in PARAMETERS)]
        shares = [share for share in shares if share.whole]
        every += shares
        if not all(NOMINAL[0] <= share.percent <= NOMINAL[1] for share in shares):
            where = ", ".join(str(group.key[one]) for one in ("protocol", *swept))
            outside.append(f"{where} ({_percents(shares)})")
    if not every:
        return "No case has an interval: the coverage is not known."
    total = Share(sum(one.part for one in every), sum(one.whole for one in every))
    words = f"not within 93 to 97 %: {listed(outside)}" if outside else "all within 93 to 97 %"
    return (
        f"The 95 % intervals of U0, L_w and τ_w held the truth in {total.percent:.1f} % of the "
        f"flights called ok, {_percents(every)} by regime and parameter; {words}."
    )


def _percents(shares: list[Share]) -> str:
    low, high = (f"{end(one.percent for one in shares):.1f}" for end in (min, max))
    return f"{low} %" if low == high else f"{low} to {high} %"


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
