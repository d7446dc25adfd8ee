"""From a finished study to one candidate that can be defended, or to the reason why there is none.

Numbers stand as arrays (candidates, units, regimes, cases), candidates as rows of a frame. A
candidate is chosen on the units of split `validate` and scored once on those of split `evaluate`:
of all that keep every constraint in every regime, the first listed within the margin of the best.
What the units do not tell from it is a tie. A regime is a condition of the study.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from sparsefit.arrays import Array
from sparsefit.errors import InputError, one_of, told_with
from sparsefit.study import measures, resampling
from sparsefit.study.entries import factor_words
from sparsefit.study.measures import Measure, factors
from sparsefit.study.resampling import ROUNDING, Difference, ends, mean
from sparsefit.study.table import significant

if TYPE_CHECKING:
    import pandas as pd

SPLITS = ("validate", "evaluate")
LIMITS = {  # what a constraint is of, the factor to its unit, and the unit
    "max_failure": ("cases without an answer", 100.0, "%"),
    "max_silent_misses": ("silent misses", 100.0, "%"),
    "max_error": ("95th percentile of the largest error", 1.0, "%"),
    "max_latency_p99": ("99th percentile of the latency", 1e3, "ms"),
    "max_memory": ("peak memory", 1.0, "MB"),
}
TIMED = {"max_latency_p99": "p99", "max_memory": "memory"}


@dataclass(frozen=True)
class Criterion:
    """A measure summarised over the units of each regime, and over the regimes.

    over: `average`, `worst`, or the name of a regime.
    """

    measure: Measure
    regimes: tuple[str, ...]
    over: str

    @property
    def words(self) -> str:
        """`mean |error| of τ_w, averaged over the regimes`."""
        where = {"average": "averaged over the regimes", "worst": "in the worst regime"}
        over = f", {where.get(self.over, f'in {self.over}')}"
        return self.measure.phrase + over * (len(self.regimes) > 1)

    @property
    def sign(self) -> float:
        """The factor by which a score becomes a loss, of which less is better."""
        return -1.0 if self.measure.more else 1.0

    def by_regime(self, grid: Array) -> Array:
        """Return the summary (..., regimes) of a grid (..., units, regimes, cases)."""
        return self.measure.reduce(pooled_regimes(grid))

    def loss(self, grid: Array) -> Array:
        """Return the one number (...,) of a grid (..., units, regimes, cases), less is better."""
        losses = self.sign * self.by_regime(grid)
        if self.over == "average":
            return mean(losses)
        if self.over == "worst":
            return np.asarray(np.fmax.reduce(losses, axis=-1))  # passes over NaN
        return np.asarray(losses[..., self.regimes.index(self.over)])

    def say(self, value: float) -> str:
        """Return a value of the criterion with its unit."""
        return f"{significant(value)} {self.measure.unit}".rstrip()


def pooled_regimes(grid: Array) -> Array:
    """Return (..., regimes, all) of (..., units, regimes, cases)."""
    swapped = np.moveaxis(grid, -3, -2)
    return swapped.reshape(*swapped.shape[:-2], -1)


@dataclass(frozen=True)
class Breach:
    """A constraint that a candidate does not keep: the regime, the value there and the limit."""

    constraint: str
    regime: str
    value: float
    limit: float

    @property
    def words(self) -> str:
        """`silent misses 5 % in turbulence 30 %, 1 % is the most`."""
        where = f" in {self.regime}" if self.regime else ""
        value, limit = (limit_text(self.constraint, each) for each in (self.value, self.limit))
        return f"{LIMITS[self.constraint][0]} {value}{where}, {limit} is the most"


def limit_text(constraint: str, value: float) -> str:
    """Return a value of a constraint with its unit."""
    _, factor, unit = LIMITS[constraint]
    if math.isinf(value) and constraint in TIMED:
        return "not measured"
    return f"{significant(factor * value)} {unit}"


class Trials:
    """The cases of a split as a grid (candidates, units, regimes, cases), and what it tells.

    loss: (candidates,) of the criterion; drawn: (candidates, resamples) of it over units, of which
    one seed draws the same for all candidates.
    """

    def __init__(self, cases: pd.DataFrame, candidates: Sequence[str], criterion: Criterion,
                 seed: int) -> None:  # fmt: skip
        """Place the cases of a split.

        Raises:
            InputError: if the candidates were not all tried on the same units and conditions.
        """
        import pandas as pd

        self.cases, self.candidates, self.criterion = cases, candidates, criterion
        candidate = pd.Index(candidates).get_indexer(pd.Index(cases["candidate"]))
        unit, units = pd.factorize(cases["flight"])
        regime = pd.Index(criterion.regimes).get_indexer(pd.Index(regimes_of(cases)))
        keys = pd.DataFrame({"c": candidate, "u": unit, "r": regime})
        within = keys.groupby(["c", "u", "r"]).cumcount().to_numpy()
        self.at = (candidate, unit, regime, within)
        self.shape = (len(candidates), len(units), len(criterion.regimes),
                      int(within.max(initial=-1)) + 1)  # fmt: skip
        self.values = self.grid(criterion.measure.values(cases))
        count = self.grid(np.ones(len(cases)))
        unequal = (np.isnan(count) != np.isnan(count[:1])).any(axis=(1, 2, 3))
        if unequal.any():
            title = cases.loc[candidate == unequal.argmax(), "title"].iloc[:1]
            raise InputError(
                f"{', '.join(title) or candidates[int(unequal.argmax())]} was not tried on the "
                "same flights as the others: finish the study first (sparsefit study run)"
            )
        self.loss = criterion.loss(self.values)

        def resampled(own: Array) -> Array:
            return resampling.resampled(
                lambda at: criterion.loss(own[at]), len(own), own[0].size, seed
            )

        self.drawn = np.array([resampled(own) for own in self.values])

    def grid(self, values: Array) -> Array:
        """Return values (rows,) as a grid, NaN where a regime has fewer cases."""
        grid = np.full(self.shape, np.nan)
        grid[self.at] = values
        return grid

    def score(self, at: int) -> tuple[float, tuple[float, float]]:
        """Return the criterion of a candidate and its 95 % interval."""
        sign = self.criterion.sign
        low, high = sorted(sign * end for end in self.ends(self.drawn[at]))
        return sign * float(self.loss[at]), (low, high)

    def against(self, at: int, other: int) -> Difference:
        """Return the loss of a candidate less that of another, paired by unit."""
        pair, least = (self.values[at], self.values[other]), self.criterion.measure.least
        alike = np.allclose(*pair, rtol=ROUNDING, atol=least, equal_nan=True)
        with np.errstate(invalid="ignore"):  # two that fail wholly
            effect, drawn = self.loss[at] - self.loss[other], self.drawn[at] - self.drawn[other]
        return Difference(float(effect), *self.ends(drawn), bool(alike))

    def ends(self, drawn: Array) -> tuple[float, float]:
        """Return the 95 % interval of resampled values; of a single unit there is none."""
        return ends(drawn) if self.shape[1] > 1 else (math.nan, math.nan)

    def breaches(
        self, rule: Any, timed: Mapping[str, Mapping[str, float]]
    ) -> list[tuple[Breach, ...]]:
        """Return the constraints that each candidate breaks, each in its worst regime.

        What breaks a constraint of the cases need not be timed.
        """
        cases, flown = self.cases, measures.in_flow(self.cases)

        def by_regime(values: Array) -> Array:
            return pooled_regimes(self.grid(values))

        silent = error = np.zeros(len(cases))
        if "est_mean_velocity" in cases:
            missed = np.where(flown, measures.off(cases), measures.in_still_air(cases))
            silent = (missed & measures.ended(cases, "ok")).astype(float)
            error = measures.MEASURES["largest-error"].read(cases)
        largest = resampling.quantile(by_regime(error), 0.95)
        is_flown = (by_regime(flown.astype(float)) > 0).any(axis=-1)
        values = {
            "max_failure": mean(by_regime(measures.only(flown, ~measures.answered(cases)))),
            "max_silent_misses": mean(by_regime(silent)),
            "max_error": np.where(np.isnan(largest) & is_flown, np.inf, largest),
        }
        for name, column in TIMED.items():
            times = [timed.get(each, {}).get(column, math.inf) for each in self.candidates]
            values[name] = np.array(times)[:, None]
        every: list[list[Breach]] = [[] for _ in self.candidates]
        for name, levels in values.items():
            limit = getattr(rule, name)
            for broken, own in zip(every, np.nan_to_num(levels, nan=-np.inf, posinf=np.inf),
                                   strict=True):  # fmt: skip
                place = int(own.argmax())
                is_untimed = name in TIMED and np.isinf(own[place])
                is_broken = any(breach.constraint not in TIMED for breach in broken)
                if limit is not None and own[place] > limit and not (is_untimed and is_broken):
                    where = self.criterion.regimes[place] if len(own) > 1 else ""
                    broken.append(Breach(name, where, float(own[place]), limit))
        return [tuple(broken) for broken in every]


@dataclass(frozen=True, eq=False)
class Selection:
    """The choice by a rule, and every candidate with its evidence.

    ranked: a row a candidate, the best first: `candidate`, `title`, `reading` and `label` in words;
    `validate` and `evaluate`, the criterion on either split, `low` and `high` its 95 % interval on
    evaluate, `by_regime` (regimes,) there; `breaches`, what it does not keep on validate, `broken`
    on evaluate; `best`, the probability over drawn units of validate that it is the best of those
    that keep everything; `apart`, its loss less that of the chosen there; `within`, the margin.
    chosen: a row; None where no candidate keeps the constraints. regret: how much worse the chosen
    is on evaluate than `hindsight`, the best there of those that keep the constraints on validate.
    latencies: a row of the latency frame by candidate; refused: why others cannot be on board.
    """

    study: str
    rule: Any
    criterion: Criterion
    ranked: tuple[Any, ...]
    chosen: Any
    regret: Difference | None
    hindsight: Any
    units: Mapping[str, int]
    latencies: Mapping[str, Mapping[str, float]]
    refused: Mapping[str, str]
    cases: pd.DataFrame = field(repr=False)

    @property
    def passing(self) -> list[Any]:
        """The candidates that keep every constraint, the best first."""
        return [each for each in self.ranked if not each.breaches]

    @property
    def tied(self) -> list[Any]:
        """Those that keep everything and that the validate units do not tell from the chosen."""
        return [each for each in self.passing if each.apart is not None and each.apart.tie]

    @property
    def contenders(self) -> list[str]:
        """The chosen candidate and what is not ruled out: tied, or within the margin."""
        return [each.candidate for each in self.passing if each.within or each in self.tied]

    def counted(self, count: int) -> str:
        """Return a number of units in words, `1 problem`."""
        return f"{count} {'problem' if 'objective' in self.cases else 'flight'}{'s' * (count != 1)}"

    def __str__(self) -> str:
        from sparsefit.study.evidence import headline, lines

        return "\n".join([headline(self), *(f"- {line}" for line in lines(self))])


@dataclass(frozen=True)
class Check:
    """The chosen candidate on units of fresh seeds, and its regret against the best of them there.

    score, between: the criterion and its 95 % interval; broken: what it does not keep there;
    hindsight: the title of the best; candidates: how many were run.
    """

    units: int
    score: float
    between: tuple[float, float]
    regret: Difference
    hindsight: str
    broken: tuple[Breach, ...]
    candidates: int


def select(
    study: Any,
    rule: Any = None,
    *,
    latencies: Mapping[str, Any] | None = None,
    refusals: Mapping[str, str] | None = None,
    **options: Any,
) -> Selection:
    """Choose a candidate by a rule, that of the study unless another is given.

    Args:
        latencies: `median` [s], `p99` [s], `memory` [MB] and `busy` (share) by candidate, as the
            study has stored them unless given; a candidate without keeps no limit of either.
        refusals: by title why a candidate cannot be on board, where that is asked for.
        options: of [select], in place of those of the rule.

    Raises:
        InputError: if the rule names what does not exist, the study has no split or is
            unfinished, or its candidates were not tried alike.
    """
    rule = rule or study.definition.selection
    rule = rule.changed(**options) if options else rule
    if study.kind == "problems" and rule.criterion == type(rule)().criterion:
        rule = rule.changed(criterion="mean holdout-error")
    cases, refused = study.cases, dict(refusals or {})
    _check_split(study, cases)
    cases = cases[~cases["title"].isin(refused)]
    criterion = _criterion(rule, cases)
    if not np.isfinite(criterion.measure.read(cases)).any():
        raise InputError(
            f"{study.name} has no case with a number for {criterion.measure.words}: choose by "
            "another criterion (for predictions, set [run] prediction_flights)"
        )
    latencies = study.latencies if latencies is None else latencies
    timed = {name: asdict(seen) for name, seen in latencies.items()}
    splits = [name for name in SPLITS if (cases["split"] == name).any()] or ["all"]
    frame = _in_words(cases)
    every = [Trials(cases[cases["split"] == name], list(frame["candidate"]), criterion, place)
             for place, name in enumerate(splits)]  # fmt: skip
    first, last = every[0], every[-1]
    breaches, broken = (each.breaches(rule, timed) for each in (first, last))
    order = np.argsort(first.loss, kind="stable").tolist()
    passing = [at for at in order if not breaches[at] and not math.isnan(first.loss[at])]
    best = float(first.loss[passing[0]]) if passing else math.nan
    limit = best + (rule.margin + ROUNDING) * abs(best) + criterion.measure.least
    within = [at for at in passing if first.loss[at] <= limit]
    chosen = min(within, default=None)  # the first listed is the simplest
    shares = np.zeros(len(order))
    if passing:
        shares[passing] = resampling.best_probabilities(first.drawn[passing])
    places = range(len(order))
    values: dict[str, Any] = {
        "validate": criterion.sign * first.loss, "evaluate": criterion.sign * last.loss,
        "between": [last.score(at)[1] for at in places],
        "by_regime": list(criterion.by_regime(last.values)),
        "breaches": breaches, "broken": broken, "best": shares,
        "within": [at in within for at in places],
        "apart": [None if chosen in (None, at) else first.against(at, chosen) for at in places],
    }  # fmt: skip
    rows = list(frame.assign(**values).itertuples(name="Candidate"))
    hindsight = min(passing, default=None, key=lambda at: (float(last.loss[at]), at != chosen))
    return Selection(
        study=study.name, rule=rule, criterion=criterion,
        ranked=tuple(rows[at] for at in (*passing, *(at for at in order if at not in passing))),
        chosen=None if chosen is None else rows[chosen],
        regret=None if chosen is None or hindsight is None else last.against(chosen, hindsight),
        hindsight=None if hindsight is None else rows[hindsight],
        units={name: each.shape[1] for name, each in zip(splits, every, strict=True)},
        latencies=timed, refused=refused, cases=cases,
    )  # fmt: skip


def _in_words(cases: pd.DataFrame) -> pd.DataFrame:
    """Return `candidate`, `title`, the reading with its factors, and the back-end's `label`."""
    import pandas as pd

    of_units = ("flights.", "problems.")
    own, rows = [name for name in factors(cases) if not name.startswith(of_units)], []
    for row in cases.drop_duplicates("candidate").to_dict("records"):
        levels = (f"{factor_words(n)} none" if row[n] == "none" else str(row[n]) for n in own)
        words = [str(row.get("reading", row.get("protocol", ""))), *levels]
        reading = ", ".join(part for part in words if part and part != "default")
        label = str(row.get("label") or row["backend"])
        rows.append((str(row["candidate"]), str(row["title"]), reading, label))
    return pd.DataFrame(rows, columns=["candidate", "title", "reading", "label"])


def check_rule(study: Any) -> None:
    """Refuse, before anything is run, a [select] whose measure or `over` is unknown.

    Raises:
        InputError: with the nearest name that is known.
    """
    rule = study.definition.selection
    if rule != type(rule)():
        cases = study.plan()
        _check_split(study, cases)
        _criterion(rule, cases)


def regimes_of(cases: pd.DataFrame) -> pd.Series:
    """Return the regime of each case: its condition."""
    return cases["condition"].astype(str).replace("", "everywhere")


def _criterion(rule: Any, cases: pd.DataFrame) -> Criterion:
    """Return the measure of a rule over the regimes of the cases."""
    regimes = tuple(regimes_of(cases).unique())
    one_of("regime in over =", rule.over, ("average", "worst", *regimes))
    summary, name = rule.measure
    with told_with("[select] criterion"):
        return Criterion(measures.measure(f"{summary or 'mean'} {name}"), regimes, rule.over)


def _check_split(study: Any, cases: pd.DataFrame) -> None:
    """Refuse cases that are not all there, or flights that are not split."""
    planned = len(study.plan())
    if len(cases) < planned or cases.empty:
        raise InputError(
            f"{study.name} is unfinished, {len(cases)} of {planned} planned cases have a row: "
            "finish it first (sparsefit study run)"
        )
    missing = set(SPLITS) - set(cases["split"])
    if missing and study.kind == "flights":
        raise InputError(
            f"{study.name} has no flights to {' or to '.join(sorted(missing))}: "
            "give the study file a [split] with validate and evaluate"
        )


def check(selection: Selection, cases: pd.DataFrame) -> Check:
    """Return what the cases of fresh units, of the same candidates, say of the choice."""
    if selection.chosen is None:
        raise ValueError("nothing was chosen")
    titles = dict(zip(cases["candidate"], cases["title"], strict=True))
    trials = Trials(cases, list(titles), selection.criterion, 0)
    own = list(titles).index(selection.chosen.candidate)
    best = min(range(len(titles)), key=lambda at: (float(trials.loss[at]), at != own))
    broken = trials.breaches(selection.rule, selection.latencies)[own]
    return Check(trials.shape[1], *trials.score(own), trials.against(own, best),
                 str(list(titles.values())[best]), broken, len(titles))  # fmt: skip
