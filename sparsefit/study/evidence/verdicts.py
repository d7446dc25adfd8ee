"""A selection in words: what was chosen, what ties with it, why each other lost."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator

from sparsefit.study.evidence.candidates import Criterion
from sparsefit.study.evidence.constraints import WORDS, told
from sparsefit.study.evidence.fresh import Check
from sparsefit.study.evidence.resampling import RESAMPLES, Difference
from sparsefit.study.evidence.selection import Scored, Selection
from sparsefit.study.evidence.sentence import listed, shown, some

CONSTRAINTS = tuple(WORDS)


def headline(selection: Selection) -> str:
    """The answer in a sentence: who was chosen, or that nobody keeps what was asked for."""
    chosen, criterion = selection.chosen, selection.criterion
    if chosen is None:
        return f"None of the {len(selection.ranked)} candidates keeps every constraint."
    others = len(selection.tied)
    tie = f", in a tie with {others} other{'s' if others > 1 else ''}" if others else ""
    low, high = chosen.between
    return (
        f"{chosen.candidate.title}{tie}: {say(criterion, chosen.evaluate)} "
        f"(95 % interval {shown(low)} to {shown(high)}) {criterion.words} on "
        f"{selection.flights['evaluate']} flights that had no part in the choice."
    )


def sentences(selection: Selection) -> list[str]:
    """What a review asks: how it was chosen, the tie, the chance to be best, regret, the worst."""
    said = [_how(selection)]
    if selection.chosen is None:
        return [*said, *_binding(selection)]
    said += [_tie(selection), _odds(selection), _regret(selection), _worst(selection)]
    broken = selection.chosen.broken
    if broken:
        said.append(
            f"On the evaluate flights it does not keep {listed([one.words for one in broken])}: "
            "the constraint is not sure to be kept."
        )
    return [one for one in said if one]


def checked(selection: Selection, check: Check) -> list[str]:
    """What fresh flights say of the choice."""
    criterion, low, high = selection.criterion, *check.between
    said = (
        f"On {check.flights} flights of fresh seeds: {say(criterion, check.score)} "
        f"(95 % interval {shown(low)} to {shown(high)})"
    )
    if check.regret.same:
        said += f"; of the {check.candidates} that were not ruled out none is better there."
    else:
        ends = f"{shown(check.regret.low)} to {shown(check.regret.high)}"
        said += (
            f"; the best of the {check.candidates} that were not ruled out is then "
            f"{check.hindsight}, the regret {say(criterion, check.regret.effect)} ({ends})."
        )
    broken = [breach.words for breach in check.broken]
    return [said, *([f"There it does not keep {listed(broken)}."] if broken else [])]


def say(criterion: Criterion, value: float) -> str:
    """A value of the criterion with its unit."""
    return criterion.measure.say(value)


def _how(selection: Selection) -> str:
    rule, passing = selection.rule, len(selection.passing)
    limits = [
        f"{WORDS[name]} at most {told(name, limit)}"
        for name in CONSTRAINTS
        if (limit := getattr(rule, name)) is not None
    ]
    kept = f"; {passing} keep {listed(limits)} in every regime" if limits else ""
    first = "listed first" if rule.simplest == "listed" else "fastest"
    criterion = selection.criterion
    counted = f" ({criterion.measure.convention})" if criterion.measure.unit else ""
    tried = (
        f"{len(selection.ranked)} candidates in {len(criterion.regimes)} "
        f"{'regimes' if len(criterion.regimes) > 1 else 'regime'}, chosen on "
        f"{selection.flights['validate']} flights{kept}."
    )
    if not passing:
        return tried
    return (
        f"{tried} Of those within {100 * rule.margin:g} % of the best by "
        f"{criterion.words}{counted}, the one {first} is chosen."
    )


def _tie(selection: Selection) -> str:
    tied = selection.tied
    if not tied:
        return "No other candidate that keeps the constraints ties with it."
    same = [one for one in tied if one.apart and one.apart.same]
    rest = [one for one in tied if one.apart and not one.apart.same]
    said = f"The flights do not tell it from {some([one.candidate.title for one in tied])}."
    if same:
        said += f" {len(same)} of these gave the same numbers on every flight."
    needed = [one for one in rest if one.apart and math.isfinite(one.apart.more_flights)]
    if needed:
        easiest = min(needed, key=_more)
        hardest = max(needed, key=_more)
        many = f"{_more(easiest):.0f} more flight{'s' if _more(easiest) > 1 else ''}"
        said += f" About {many} would tell it from {easiest.candidate.title}"
        if hardest is not easiest:
            said += f", {_more(hardest):.0f} from {hardest.candidate.title}"
        said += ", if the differences are what they seem."
    return said


def _more(one: Scored) -> float:
    return one.apart.more_flights if one.apart else math.nan


def _odds(selection: Selection) -> str:
    ranked = sorted(selection.passing, key=lambda one: -one.best)[:3]
    told_ = [f"{100 * one.best:.0f} % {one.candidate.title}" for one in ranked if one.best > 0.005]
    return (
        f"Best of those that keep everything, over flights drawn again {RESAMPLES} times: "
        f"{listed(told_)}."
    )


def _regret(selection: Selection) -> str:
    best, regret, criterion = selection.hindsight, selection.regret, selection.criterion
    if best is None or regret is None or best is selection.chosen:
        return "With hindsight, on the evaluate flights, nothing that keeps everything is better."
    return (
        f"With hindsight {best.candidate.title} is best on the evaluate flights: the regret is "
        f"{say(criterion, regret.effect)} (95 % interval {shown(regret.low)} to "
        f"{shown(regret.high)})."
    )


def _worst(selection: Selection) -> str:
    chosen, criterion = selection.chosen, selection.criterion
    if chosen is None or len(criterion.regimes) < 2:
        return ""
    name = criterion.worst(chosen.by_regime)
    value = chosen.by_regime[criterion.regimes.index(name)] if name else math.nan
    return f"Its worst regime is {name}: {say(criterion, float(value))}."


def _binding(selection: Selection) -> Iterator[str]:
    """Which constraint binds: what each alone refuses, and who comes closest."""
    counted = Counter(breach.constraint for one in selection.ranked for breach in one.breaches)
    alone = Counter(
        one.breaches[0].constraint for one in selection.ranked if len(one.breaches) == 1
    )
    if alone:
        name, many = alone.most_common(1)[0]
        yield f"{name} binds: {many} candidates keep everything but that."
    for name, many in counted.most_common():
        values = [
            (breach.value, one.candidate.title, breach.regime)
            for one in selection.ranked
            for breach in one.breaches
            if breach.constraint == name
        ]
        value, title, regime = min(values)
        limit = getattr(selection.rule, name)
        where = f" in {regime}" if regime else ""
        yield (
            f"{name} = {limit:g} refuses {many} of {len(selection.ranked)}; the closest is "
            f"{title} with {told(name, value)}{where}."
        )


def verdict(selection: Selection, one: Scored) -> str:
    """Why a candidate was chosen, or lost."""
    if one is selection.chosen:
        return "chosen"
    if one.breaches:
        return "; ".join(breach.words for breach in one.breaches)
    apart = one.apart
    if apart is None or math.isnan(one.validate):
        return "nothing to judge it by"
    if apart.same:
        return "the same on every flight, less simple"
    if selection.within(one):
        words = "tied" if apart.tie else f"{_by(apart)}, within the margin"
        return f"{words}, less simple"
    return f"tied, but {_by(apart)}: beyond the margin" if apart.tie else _by(apart)


def _by(apart: Difference) -> str:
    worse = apart.effect > 0
    ends = (apart.low, apart.high) if worse else (-apart.high, -apart.low)
    return (
        f"{'worse' if worse else 'better'} by {shown(abs(apart.effect))} "
        f"({shown(ends[0])} to {shown(ends[1])})"
    )
