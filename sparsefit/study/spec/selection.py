"""What a study asks of a selection: the section [select], or the options of `sparsefit select`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Literal

from sparsefit.codec import Place, build
from sparsefit.errors import InputError
from sparsefit.study.spec.design import Factor, Protocol
from sparsefit.study.spec.document import read_section

MOST = {"latency_flights": 100_000, "check": 100_000}  # flights
WORLD = "world"  # as a factor: what a protocol changes of the flights
AVERAGE, WORST = "average", "worst"
LEGACY = "-absolute-percentage-error-"  # of a criterion as it was named before there were measures


@dataclass(frozen=True, kw_only=True)
class SelectionRule:
    """By what a candidate is chosen, and what it must keep.

    criterion: a summary and a measure, `mean timescale-error`.
    regimes: the factors whose levels are the regimes: `world` (what protocols change of the
    flights) and keys of [flights] that are swept or that protocols set; empty: all there are.
    over: `average` of the regimes, the `worst` of them, or the name of one.
    margin: how much worse than the best, as a share of it, a simpler candidate may be.
    simplest: what simple means: `listed` first in the study file, or `fastest` at the median.
    In every regime, where they are given: max_failure: share of flights without an estimate;
    max_silent_misses: share called ok and off by more than 5 %, or ok without a flow;
    max_error: 95th percentile, over the estimates, of the largest error of U0, L_w and tau_w [%].
    Measured for it: max_latency_p99 [s] and max_memory [MB] of one estimate on one core, over
    `latency_flights` of them. check: how many flights of fresh seeds, in every world, the choice
    is checked on. seed: of what is resampled.
    """

    criterion: str = "mean timescale-error"
    regimes: tuple[str, ...] = ()
    over: str = AVERAGE
    margin: float = 0.05
    simplest: Literal["listed", "fastest"] = "listed"
    max_failure: float | None = None
    max_silent_misses: float | None = None
    max_error: float | None = None
    max_latency_p99: float | None = None
    max_memory: float | None = None
    latency_flights: int = 100
    check: int = 0
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("max_failure", "max_silent_misses"):
            share = getattr(self, name)
            if share is not None and not 0.0 <= share <= 1.0:
                raise InputError(f"{name} must be a share from 0 to 1; got {share!r}")
        for name in ("max_error", "max_latency_p99", "max_memory"):
            most = getattr(self, name)
            if most is not None and not most > 0.0:
                raise InputError(f"{name} must be above 0; got {most!r}")
        if not 0.0 <= self.margin < 1.0:
            raise InputError(f"margin must be a share, from 0 to below 1; got {self.margin!r}")
        for name, most in MOST.items():
            if not 0 <= getattr(self, name) <= most:
                raise InputError(f"{name} must be from 0 to {most}; got {getattr(self, name)}")
        if not self.latency_flights and self.timed:
            raise InputError(f"latency_flights = 0 measures nothing, and {self.timed} needs it")

    @property
    def timed(self) -> str:
        """What needs a measured latency or memory; empty where nothing does."""
        if self.simplest == "fastest":
            return 'simplest = "fastest"'
        limits = (name for name in ("max_latency_p99", "max_memory") if getattr(self, name))
        return next(limits, "")

    @property
    def measure(self) -> tuple[str, str]:
        """The summary and the measure that the criterion names; `mean` where it names none."""
        summary, legacy, parameter = self.criterion.partition(LEGACY)
        if legacy:
            return summary, f"{parameter.replace('_', '-')}-error"
        summary, _, name = self.criterion.rpartition(" ")
        return summary, name


def read_selection(
    value: object, protocols: tuple[Protocol, ...], sweep: tuple[Factor, ...], place: Place
) -> SelectionRule:
    """Read [select]; InputError names the first key or factor that does not fit."""
    here = place.within("select")
    rule = build(SelectionRule, read_section(value, place.at("select")), here)
    _check_regimes(rule, protocols, sweep, here)
    return rule


def _check_regimes(
    rule: SelectionRule, protocols: tuple[Protocol, ...], sweep: tuple[Factor, ...], place: Place
) -> None:
    known = regime_factors(protocols, sweep)
    for name in rule.regimes:
        if name not in known:
            others = f"; what does: {', '.join(known)}" if known else ", and nothing else does"
            raise place.at("regimes").error(f'no "{name}" varies between the flights{others}')


def regime_factors(protocols: tuple[Protocol, ...], sweep: tuple[Factor, ...]) -> list[str]:
    """The factors whose levels may be regimes: `world`, and keys of [flights] that vary."""
    keys = dict.fromkeys(key for one in protocols for key in one.overrides)
    every = dict.fromkeys([*keys, *(factor.key for factor in sweep)])
    varied = [key for key in every if key.startswith("flights.")]
    return ([WORLD] if any(key in keys for key in varied) else []) + varied


def changed(
    rule: SelectionRule,
    options: Mapping[str, object],
    protocols: tuple[Protocol, ...],
    sweep: tuple[Factor, ...],
    place: Place,
) -> SelectionRule:
    """The rule with these options in place of its own, checked alike."""
    own = {field.name: getattr(rule, field.name) for field in fields(rule)}
    asked = build(SelectionRule, own | dict(options), place)
    _check_regimes(asked, protocols, sweep, place)
    return asked
