"""The answers of a study: sentences that its cases, not its author, give.

An answer is a measure and a comparison. A new comparison is one function here, which says which
cases stand against which; it is named in `ANSWERS` and then speaks of every measure.
"""

from __future__ import annotations

import math
from collections import Counter
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from sparsefit.study.evidence.along import at_level
from sparsefit.study.evidence.asked import Asked, Kind
from sparsefit.study.evidence.candidates import Criterion, Trial, candidates_of
from sparsefit.study.evidence.cases import (
    STATUSES,
    Group,
    by_setting,
    estimated,
    factors,
    failures,
    first_settings,
    in_a_flow,
)
from sparsefit.study.evidence.level_answers import head, protocols, spread, until
from sparsefit.study.evidence.measure import Failure, Measure, Share, together
from sparsefit.study.evidence.measures import MEASURES, at_least
from sparsefit.study.evidence.reference import closest_readings, printed, sensitivity_rows
from sparsefit.study.evidence.sentence import capital, gathered, listed, ranged, shown, some
from sparsefit.study.evidence.worlds import in_regimes, regime_names

if TYPE_CHECKING:
    from sparsefit.study.spec.study import Study

# What a candidate of a selection is judged by, unless another criterion is asked for.
LEAST = {"measure": "mean timescale-error", "failures": "miss"}


def settings(asked: Asked, study: Study, cases: pd.DataFrame) -> str:
    """Say which settings are best and worst, protocol by protocol or back-end by back-end."""
    asked.needs(study.name, "measure")
    if not asked.at_least:
        ranked = f"{_ranked(asked, cases)}{_printed(asked, study)}"
        return f"{head(asked.measures)} ({_flights(cases)}). {ranked}."
    reached = at_least(cases, dict(asked.at_least))
    least = [f"{MEASURES[name].words} at least {to:g}" for name, to in asked.at_least.items()]
    known = np.isfinite([MEASURES[name].read(cases) for name in asked.at_least]).any(axis=0)
    parts = [(f"Where {listed(least)}", reached), ("Elsewhere", ~reached & known)]
    said = [
        f"{words} ({_flights(cases[kept])}): {_ranked(asked, cases[kept])}."
        for words, kept in parts
        if kept.any()
    ]
    return " ".join([f"{head(asked.measures)}.", *said]) if said else _nothing(asked)


def _printed(asked: Asked, study: Study) -> str:
    """What the study's reference has of the measure."""
    value = printed(study.reference, asked.first)
    if study.reference is None or value is None:
        return ""
    return f"; {study.reference.name}: {asked.first.say(value)}"


def _nothing(asked: Asked) -> str:
    return f"No case has a number for the {asked.first.phrase}."


def _flights(cases: pd.DataFrame) -> str:
    many = len(cases.drop_duplicates(["flight", *factors(cases)]))
    return f"{many} flight{'' if many == 1 else 's'}"


def _ranked(asked: Asked, cases: pd.DataFrame) -> str:
    groups = by_setting(cases) if asked.settings == "every" else first_settings(cases)
    divided = gathered((str(group.key[asked.within]), group) for group in groups)
    said = []
    for name, compared in divided.items():
        told = [_order(measure, compared, asked) for measure in asked.measures]
        if any(measure.failure is Failure.LEFT_OUT for measure in asked.measures):
            lost = [100.0 * failures(group.cases) / len(group.cases) for group in compared]
            told += [f"no estimate in {ranged(lost, ' %')} of the cases"] if any(lost) else []
        said.append(f"{name}: {', '.join(told)}" if len(divided) > 1 else ", ".join(told))
    return "; ".join(said)


def _order(measure: Measure, groups: list[Group], asked: Asked) -> str:
    """`0.98 % (lasso) to 4.1 % (stlsq)`, `0.98 % (lasso)`, or all of them in order."""
    values = [measure.summarise(group.cases) for group in groups]
    titles = [one.title if asked.within == "protocol" else one.setting for one in groups]
    names = gathered(zip(map(measure.say, values), titles, strict=True))
    sizes = {measure.say(one): -one if measure.more else abs(one) for one in values}
    order = sorted(names, key=lambda text: (math.isnan(sizes[text]), sizes[text]))
    chosen = {"best": order[:1], "ends": [order[0], order[-1]][: len(order)], "every": order}
    words = [
        f"{text} ({'all' if len(order) == 1 < len(groups) else some(names[text])})"
        for text in chosen[asked.show]
    ]
    symbol = f"{measure.symbol} " if len(asked.measures) > 1 else ""
    return symbol + (" to " if asked.show == "ends" else ", ").join(words)


def regimes(asked: Asked, study: Study, cases: pd.DataFrame) -> str:
    """Say from where to where shares go by protocol and level, and which leave the limits."""
    asked.needs(study.name, "limits")
    low, high = min(asked.limits), max(asked.limits)
    swept, every, outside = factors(cases), [], []
    for group in by_setting(cases[in_a_flow(cases)], *swept):
        shares = [Share.of(measure, group.cases) for measure in asked.measures]
        shares = [share for share in shares if share.whole]
        every += shares
        if not all(low <= share.percent <= high for share in shares):
            levels = (at_level(name, group.key[name]) for name in swept)
            where = ", ".join([group.protocol, *levels])
            outside.append(f"{where} ({_percents(shares)})")
    if not every:
        return _nothing(asked)
    total = Share(sum(share.part for share in every), sum(share.whole for share in every))
    words = f"not within {low:g} to {high:g} %: {listed(outside)}"
    return (
        f"Share of {together(asked.measures)}: {total.percent:.1f} % over all, "
        f"{_percents(every)} by regime and parameter; "
        f"{words if outside else f'all within {low:g} to {high:g} %'}."
    )


def _percents(shares: list[Share]) -> str:
    low, high = (f"{end(share.percent for share in shares):.1f}" for end in (min, max))
    return f"{low} %" if low == high else f"{low} to {high} %"


def pooled(asked: Asked, study: Study, cases: pd.DataFrame) -> str:
    """Say what share of all cases each measure is, with its Wilson limit where it is small."""
    said = []
    for measure in asked.measures:
        share = Share.of(measure, cases)
        if share.whole:
            most = "" if measure.more else f", at most {share.interval[1]:.2f} %"
            words = f"{share.part} ({share.percent:.2f} %{most}) {measure.words}"
            said.append((f"of {share.whole} {measure.asked}", words))
    text = "; ".join(f"{of} {', '.join(told)}" for of, told in gathered(said).items())
    return f"{capital(text)}." if text else _nothing(asked)


def splits(asked: Asked, study: Study, cases: pd.DataFrame) -> str:
    """Say who is best on the validate flights, and what that is on the evaluate flights."""
    names = regime_names(in_regimes(study, cases))
    criterion = Criterion(asked.first, tuple(names), study.selection.over)
    every = candidates_of(study, cases)
    first = [_score(criterion, one.trials["validate"]) for one in every]
    least = shown(max(first) if asked.first.more else min(first))
    best = [one for one, score in zip(every, first, strict=True) if shown(score) == least]
    scores = sorted({shown(_score(criterion, one.trials["evaluate"])) for one in best})
    return (
        f"{'Most' if asked.first.more else 'Least'} {criterion.words} on the validate flights, "
        f"{asked.first.convention}: {least} {asked.first.unit}, by "
        f"{some([one.title for one in best])}; on the evaluate flights {listed(scores)} "
        f"{asked.first.unit}. Of those near the best, sparsefit select takes the simplest."
    )


def _score(criterion: Criterion, trial: Trial) -> float:
    return float(criterion.score(criterion.by_regime(criterion.grid(trial))))


def reference(asked: Asked, study: Study, cases: pd.DataFrame) -> str:
    """Say which reading comes closest to the study's reference numbers."""
    table = closest_readings(asked, study, cases)
    row, names = table.rows[0], [column.name for column in table.columns]
    levels = [
        at_level(name, row[place])
        for place, name in enumerate(names[: names.index("n")])
        if "." in name
    ]
    chosen = f" with {', '.join(levels)}" if levels else ""
    return (
        f"Of {len(table.rows)} readings {row[names.index('setting')]}{chosen} comes closest, "
        f"{shown(float(row[-1] or 0))} percentage points from {study.reference.name}."
        if study.reference
        else ""
    )


def one_at_a_time(asked: Asked, study: Study, cases: pd.DataFrame) -> str:
    """Say which factor, alone, moves the median error of tau_w most."""
    rows = sensitivity_rows(cases)
    if not rows:
        return "Nothing was varied."
    return (
        f"The error of τ_w hangs most on {rows[0][0]}: changed alone, it moves the median by "
        f"{shown(float(rows[0][5] or 0))} percentage points."
    )


def plan(asked: Asked, study: Study, cases: pd.DataFrame) -> str:
    """Say how many planned cases ended as rows, and how."""
    ended = Counter(cases["status"])
    statuses = [f"{ended[name]} {name}" for name in STATUSES if ended[name]]
    answered = int(estimated(cases).sum())
    verdict = "Yes" if len(cases) == study.planned and answered == len(cases) else "Not wholly"
    return (
        f"{verdict}: {len(cases)} of {study.planned} planned cases ended as rows, "
        f"{answered} of them with an estimate ({', '.join(statuses)})."
    )


ANSWERS: Kind[str] = Kind(
    "answer",
    {
        "settings": settings,
        "protocols": protocols,
        "spread": spread,
        "until": until,
        "regimes": regimes,
        "all": pooled,
        "splits": splits,
        "reference": reference,
        "one-at-a-time": one_at_a_time,
        "plan": plan,
    },
    {
        "completeness": {"compare": "plan"},
        "identifiability": {
            "compare": "all",
            "measure": ("off", "deserved", "called-so", "false-alarms"),
        },
        "selection": {"compare": "splits", **LEAST},
        "least-errors": {"settings": "every", "show": "best", **LEAST},
    },
)


def sentences(study: Study, cases: pd.DataFrame, *, varies: bool | None = None) -> list[str]:
    """Return what the study's [outputs] asks to be said, computed from its cases.

    varies: only what depends on the machine, or only what does not.
    """
    every = [ANSWERS.read(entry) for entry in study.answers]
    asked = [one for one in every if varies is None or one.varies == varies]
    return [ANSWERS.make(one, study, cases) for one in asked]
