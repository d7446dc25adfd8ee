"""Measures: derived columns of the frame of cases, with their units, and how they are summarised.

A measure gives one number per case, NaN where the case has none. One rule of failure: a case in a
flow without the number of a measure that counts failures ranks behind every number in a quantile
and counts as `miss` in a mean: giving no answer is never an advantage. Of other measures it is left
out, and the tables count it beside them.

Values of summaries form an array (..., units, cases of a unit), with NaN for missing ones; a unit
is a flight or a problem. Intervals are percentiles of a bootstrap that draws whole units, the same
ones for all candidates (Efron, 1979); shares have Wilson intervals (Wilson, 1927).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypeAlias

import numpy as np
import pandas as pd

from sparsefit.arrays import Array, BoolArray, IntArray
from sparsefit.errors import one_of, unknown
from sparsefit.study.columns import PARAMETERS

Read: TypeAlias = "Callable[[pd.DataFrame], Array]"
Statistic: TypeAlias = Callable[[Array], Array]  # of (..., units, cases), (...,)
RESAMPLES = 2000
CHUNK = 4_000_000  # numbers drawn at once, a limit of memory
ROUNDING = 1e-9  # relative difference of equal numbers
TINY = 1e-6  # percent: smaller errors are due to quadrature and rounding
QUANTILES = {"median": 0.5, "9 of 10": 0.9, "95th percentile": 0.95}
SYMBOLS = {"mean_velocity": "U0", "length_scale": "L_w", "timescale": "τ_w"}
UNITS = {"mean_velocity": "m/s", "length_scale": "m", "timescale": "s"}
OFF = 5.0  # percent: an estimate that misses a parameter by more should have been doubted


def mean(values: Array) -> Array:
    """Return the mean (...,) over the last axis, NaN excluded; NaN if all are."""
    finite = ~np.isnan(values)
    count = finite.sum(axis=-1)
    total: Array = np.where(finite, values, 0.0).sum(axis=-1)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


SUMMARIES: dict[str, Statistic] = {
    "mean": mean,
    "value": mean,  # of a single case
    "geometric mean": lambda values: np.exp(mean(np.log(np.maximum(values, TINY)))),
    "rms": lambda values: np.sqrt(mean(values**2)),
    "share": lambda values: 100.0 * mean(values),
    "largest": lambda values: -np.sort(-values, axis=-1)[..., 0],
}
SUMMARY_NAMES = (*QUANTILES, *SUMMARIES)


def quantile(values: Array, share: float, *, failures: bool = False) -> Array:
    """Return the quantile (...,) over the last axis, NaN excluded; infinity is a valid value.

    Linear between observations (Hyndman and Fan, 1996, definition 7); where infinity counts
    `failures`, an observation or the mean of two (definition 2), the lower one beside a failure.
    """
    ordered = np.sort(values, axis=-1)  # NaN comes last
    count = (~np.isnan(ordered)).sum(axis=-1)
    last = np.maximum(count - 1, 0)
    place = share * last
    if failures:
        rank = share * count - 1.0
        place = np.maximum(np.where(rank == np.floor(rank), rank + 0.5, np.ceil(rank)), 0.0)
    low = np.floor(place).astype(np.intp)
    high = np.minimum(low + 1, last)
    first, second = (
        np.take_along_axis(ordered, at[..., None], axis=-1)[..., 0] for at in (low, high)
    )
    exact = (first == second) | (place == low) | (failures & np.isinf(second))
    start, end = np.where(exact, 0.0, first), np.where(exact, 0.0, second)
    between: Array = start + (place - low) * (end - start)
    return np.where(count > 0, np.where(exact, first, between), np.nan)


def gridded(values: Array, places: Sequence[IntArray], shape: Sequence[int]) -> Array:
    """Return values (rows,) by their places, each (rows,), in an array (*shape, rows of a place).

    NaN where a place has fewer rows.
    """
    within = pd.Series(values).groupby([*places], sort=False).cumcount().to_numpy()
    grid = np.full((*shape, int(within.max(initial=-1)) + 1), np.nan)
    grid[(*places, within)] = values
    return grid


def resampled(statistic: Callable[[IntArray], Array], units: int, width: int = 1, seed: int = 0,
              resamples: int = RESAMPLES) -> Array:  # fmt: skip
    """Return the bootstrap distribution (resamples,) of a statistic; of a single unit it is NaN.

    Args:
        statistic: a function of the indices (n, units) of drawn units that returns (n,) values.
        width: numbers of values of a unit, for the limit of memory.
    """
    if units < 2:
        return np.full(resamples, np.nan)
    rng = np.random.default_rng(seed)
    each = max(1, CHUNK // max(1, units * width))
    sizes = [min(each, resamples - start) for start in range(0, resamples, each)]
    return np.concatenate([statistic(rng.integers(units, size=(n, units))) for n in sizes])


def ends(distribution: Array) -> tuple[float, float]:
    """Return the 95 % percentile interval of a bootstrap distribution."""
    low, high = (float(quantile(distribution, share)) for share in (0.025, 0.975))
    return low, high


def interval(reduce: Statistic, grid: Array) -> tuple[float, float]:
    """Return the 95 % interval of a summary of all values of a grid (units, cases)."""
    width = grid[0].size
    return ends(resampled(lambda at: reduce(grid[at].reshape(len(at), -1)), len(grid), width))


def wilson(part: float, whole: int) -> tuple[float, float]:
    """Return the 95 % Wilson score interval [%] of the share part/whole; NaN if whole is 0."""
    if not whole:
        return math.nan, math.nan
    p, z2 = part / whole, 1.959963984540054**2
    middle = (p + z2 / (2 * whole)) / (1 + z2 / whole)
    half = math.sqrt(z2 * (p * (1 - p) / whole + z2 / (4 * whole**2))) / (1 + z2 / whole)
    return 100.0 * max(middle - half, 0.0), 100.0 * min(middle + half, 1.0)


def numbers(cases: pd.DataFrame, name: str) -> Array:
    """Return a numeric column (rows,); NaN where a value, or the column, is absent."""
    if name not in cases:
        return np.full(len(cases), np.nan)
    return np.asarray(cases[name].to_numpy(dtype=np.float64, na_value=np.nan))


def parameters(cases: pd.DataFrame, prefix: str) -> Array:
    """Return the columns `prefix`_* of U0 [m/s], L_w [m] and tau_w [s], (rows, 3)."""
    return np.column_stack([numbers(cases, f"{prefix}_{name}") for name in PARAMETERS])


def texts(cases: pd.DataFrame, name: str) -> pd.Series:
    """Return a column as text; empty text where a value, or the column, is absent."""
    if name not in cases:
        return pd.Series("", index=cases.index)
    return cases[name].astype(object).where(cases[name].notna(), "").astype(str)


def ended(cases: pd.DataFrame, *statuses: str) -> BoolArray:
    """Return whether each case ended in one of these statuses, (rows,)."""
    return cases["status"].isin(statuses).to_numpy(dtype=bool)


def answered(cases: pd.DataFrame) -> BoolArray:
    """Return whether each case has an answer: status `ok` or `inaccurate`, finite estimates."""
    usable = ended(cases, "ok", "inaccurate")
    if "est_mean_velocity" not in cases:
        return usable
    return usable & np.isfinite(parameters(cases, "est")).all(axis=1)


def in_flow(cases: pd.DataFrame) -> BoolArray:
    """Return whether there was a flow, and it is known which, (rows,)."""
    return ~texts(cases, "flow").isin(["none", "unknown"]).to_numpy(dtype=bool)


def in_still_air(cases: pd.DataFrame) -> BoolArray:
    """Return whether the flight was in still air, (rows,); False of a logged flight."""
    return (texts(cases, "flow") == "none").to_numpy(dtype=bool)


def off(cases: pd.DataFrame) -> BoolArray:
    """Return whether the numbers, doubted or not, are missing or miss the truth by > 5 %."""
    true, estimate = parameters(cases, "true"), parameters(cases, "est")
    near = 100.0 * np.abs(estimate - true) <= OFF * np.abs(true)
    return np.asarray(~near.all(axis=1), dtype=bool)


def only(mask: BoolArray, values: Array | BoolArray) -> Array:
    """Return values (rows,) or (rows, 3) where the mask holds, NaN elsewhere."""
    return np.where(mask if values.ndim == 1 else mask[:, None], values, np.nan)


def factors(cases: pd.DataFrame) -> list[str]:
    """Return the swept factors: columns with a dotted name and at least two levels."""
    dotted = [name for name in cases.columns if "." in name]
    return [name for name in dotted if cases[name].nunique(dropna=False) > 1]


def numeric_factors(cases: pd.DataFrame) -> list[str]:
    """Return the swept factors whose every level is a number."""
    return [name for name in factors(cases) if pd.api.types.is_numeric_dtype(cases[name])]


@dataclass(frozen=True)
class Measure:
    """One number of a case.

    name: by which a study asks for it; heading: over a column of a table; words: the quantity in a
    sentence, `|error| of τ_w`; read: the number (rows,) of each case in `unit`, NaN where it has
    none; summary: in `QUANTILES` or `SUMMARIES`, of a group of cases.
    miss: what a failure counts as in a mean; failures are left out where it is None.
    format: of the summary, three significant digits by default; more: whether more is better;
    least: a smaller size is rounding; varies: with the machine; kind: `flights` or `problems`, of
    which alone a case has it.
    """

    name: str
    unit: str
    heading: str
    words: str
    read: Read
    summary: str = "median"
    miss: float | None = None
    format: str = ""
    more: bool = False
    least: float = 0.0
    varies: bool = False
    kind: str = ""

    @property
    def phrase(self) -> str:
        """The summary in words, `median |error| of τ_w`."""
        before = {"share": "share of ", "value": ""}
        return before.get(self.summary, f"{self.summary} ") + self.words

    @property
    def head(self) -> str:
        """The summary as a label has it: empty of shares and of single values."""
        return "" if self.summary in ("share", "value") else f"{self.summary} "

    def values(self, cases: pd.DataFrame) -> Array:
        """Return the number of each case (rows,); infinite for a failure that counts."""
        values = self.read(cases)
        if self.miss is None:
            return values
        return np.where(np.isnan(values) & in_flow(cases), np.inf, values)

    def reduce(self, values: Array) -> Array:
        """Return the summary (...,) of (..., n) values of cases that are not NaN."""
        if self.summary in QUANTILES:
            return quantile(values, QUANTILES[self.summary], failures=self.miss is not None)
        if self.miss is not None:
            values = np.where(np.isposinf(values), self.miss, values)
        return SUMMARIES[self.summary](values)

    def summary_of(self, values: Array) -> float:
        """Return the summary of the values (n,) of a group; NaN where none has the number."""
        return math.nan if np.isnan(values).all() else float(self.reduce(np.asarray(values)))


def measure(words: str) -> Measure:
    """Return the measure of a name, alone or behind a summary: `95th percentile seconds`.

    Raises:
        InputError: with the nearest name, if there is no such measure or summary.
    """
    summary, _, name = words.strip().rpartition(" ")
    if name not in MEASURES:
        raise unknown("measure", name, MEASURES, "docs/study-file.md")
    if not summary:
        return MEASURES[name]
    one_of("summary", summary, SUMMARY_NAMES)
    own = MEASURES[name]
    return replace(own, summary=summary, format=own.format if summary == "value" else "")


def three(kind: str) -> tuple[str, ...]:
    """Return the names of the measures `kind` of U0, L_w and tau_w, `mean-velocity-error` first."""
    return tuple(f"{name.replace('_', '-')}-{kind}" for name in PARAMETERS)


def stated(reference: Any) -> dict[str, Any]:
    """Return the values that a reference of [outputs] prints, by the names of their measures."""
    return {
        name: value for key in ("deviation", "signed_error")
        if (values := getattr(reference, key, None))
        for name, value in zip(three(key.replace("_", "-")), values, strict=True)
    }  # fmt: skip


def bounded(cases: pd.DataFrame) -> BoolArray:
    """Return whether a case has status ok, and its flight a finite Cramér-Rao bound, (rows,)."""
    bounds = parameters(cases, "bound")
    usable: BoolArray = (np.isfinite(bounds) & (bounds > 0)).all(axis=1) & ended(cases, "ok")
    return usable


def of_parameters(cases: pd.DataFrame) -> dict[str, Array]:
    """Return columns (rows, 3) of U0, L_w and tau_w by the names of their measures.

    Errors are of cases with an answer; coverage and half-widths of 95 % intervals, of flights
    called ok; what is held against the Cramér-Rao bound, of flights that have one.
    """
    true, estimate, low, high, bound = (
        parameters(cases, name) for name in ("true", "est", "low", "high", "bound")
    )
    deviation = only(answered(cases), estimate - true)
    percent, is_bounded = 100.0 * deviation / true, bounded(cases)
    has_ends = ended(cases, "ok")[:, None] & ~np.isnan(true + low + high + estimate)
    return {
        **{"deviation": deviation, "signed-error": percent},
        **dict.fromkeys(("size", "error"), np.abs(percent)),
        "efficiency": only(is_bounded, deviation / bound),
        "coverage": np.where(has_ends, (low <= true) & (true <= high), np.nan),
        **{"true": true, "estimated": estimate},
        "half-width": np.where(has_ends, 50.0 * (high - low) / np.abs(estimate), np.nan),
    }


def _column(name: str, factor: float = 1.0) -> Read:
    return lambda cases: factor * numbers(cases, name)


def _timed(name: str) -> Read:
    """Return what reads a column of problems that the clock timed."""
    return lambda cases: only(numbers(cases, "repeats") > 0, numbers(cases, name))


def _of_each(name: str, unit: str | None, heading: str, words: str, **more: Any) -> list[Measure]:
    """Return a measure of each of U0, L_w and tau_w, in the parameter's unit where it is None."""

    def column(place: int) -> Read:
        return lambda cases: of_parameters(cases)[name][:, place]

    return [
        Measure(f"{parameter.replace('_', '-')}-{name}", UNITS[parameter] if unit is None else unit,
                f"{heading} {SYMBOLS[parameter]}", words.format(SYMBOLS[parameter]),
                column(place), **more)
        for place, parameter in enumerate(PARAMETERS)
    ]  # fmt: skip


def _share(name: str, heading: str, words: str, read: Callable[[pd.DataFrame], Array | BoolArray],
           format: str = ".1f", *, more: bool = False) -> Measure:  # fmt: skip
    """Return a measure that is 1 or 0, summarised as a share."""
    return Measure(name, "%", heading, words, lambda cases: read(cases).astype(float), "share",
                   format=format, more=more)  # fmt: skip


MEASURES: dict[str, Measure] = {each.name: replace(each, kind=kind) for kind, group in {"": (
    Measure("seconds", "s", "time", "time of a case", _column("seconds"), varies=True),
    Measure("certificate", "", "certificate", "certificate",
            lambda cases: only(answered(cases), numbers(cases, "certificate")), "largest",
            format=".1e", varies=True),
    _share("answered", "answered", "cases with an answer", answered, more=True),
    *(_share(f"called-{name}", name, f"cases that ended as {name}",
             partial(lambda name, cases: ended(cases, name), name), more=name == "ok")
      for name in ("ok", "misfit", "unidentifiable")),
), "flights": (
    # of each parameter
    *_of_each("true", None, "true", "true {}", summary="value", format=".4g"),
    *_of_each("estimated", None, "estimated", "estimated {}", summary="value", format=".4g"),
    *_of_each("error", "%", "|error|", "|error| of {}", miss=100.0, least=TINY),
    *_of_each("size", "%", "|error|", "|error| of {}", least=TINY),
    *_of_each("signed-error", "%", "signed % error", "signed % error of {}", summary="mean",
              format="+.2f"),
    *_of_each("deviation", None, "signed error", "signed error of {}", summary="mean",
              format="+.2f"),
    *_of_each("efficiency", "", "error/bound", "error of {} over the Cramér-Rao bound",
              summary="rms"),
    *_of_each("coverage", "%", "coverage", "95 % intervals of {}, of flights called ok, that hold "
              "the truth", summary="share", format=".1f", more=True),
    *_of_each("half-width", "%", "half-width", "half-width of the 95 % interval of {}",
              least=TINY),
    # of a flight
    Measure("largest-error", "%", "largest |error|", "largest |error| of U0, L_w and τ_w",
            lambda cases: of_parameters(cases)["size"].max(axis=1), miss=100.0, least=TINY),
    _share("hits", "hits", "flights whose nearest grid scale was chosen",
           lambda cases: only(in_flow(cases), answered(cases)
                              & (texts(cases, "hit") == "True").to_numpy()), ".0f", more=True),
    _share("silent-misses", "silent misses",
           f"flights called ok and off by more than {OFF:g} %, or without a flow",
           lambda cases: only(texts(cases, "flow").to_numpy() != "unknown",
                              ended(cases, "ok") & (off(cases) | in_still_air(cases))), ".2f"),
    Measure("r-squared", "", "R²", "R² of the fit", _column("r_squared"), format=".4f", more=True),
    Measure("prediction-error", "%", "prediction error", "error of the flow along other flights",
            _column("prediction_error", 100.0), "geometric mean", 100.0, least=TINY),
    Measure("offered-prediction-error", "%", "prediction error, where offered",
            "error of the flow along other flights, where offered",
            lambda cases: only(answered(cases), 100.0 * numbers(cases, "prediction_error")),
            "geometric mean", 100.0, least=TINY),
    _share("bounded", "with bound", "cases called ok whose flight has a bound", bounded),
    # of several scales at once
    _share("unseen", "unseen", "flights called ok without all of their scales",
           lambda cases: ended(cases, "ok") & ~(numbers(cases, "scales_within_1_percent") > 0)),
    _share("scales-found", "all found", "flights with every length scale within 1 %",
           lambda cases: only(in_flow(cases),
                              np.nan_to_num(numbers(cases, "scales_within_1_percent"))),
           ".0f", more=True),
    Measure("scales-missed", "", "missed", "scales missed", _column("scales_missed"), "mean",
            format=".2f"),
    Measure("scales-spurious", "", "spurious", "scales spurious", _column("scales_spurious"),
            "mean", format=".2f"),
    Measure("scales-length-scale-error", "%", "error L_w", "largest error of L_w",
            _column("scales_max_length_scale_error"), least=TINY),
    Measure("scales-mean-velocity-error", "%", "error U0", "largest error of U0",
            _column("scales_max_mean_velocity_error"), least=TINY),
), "problems": (
    Measure("ratio", "", "× fastest", "time over that of the fastest", _column("ratio"),
            varies=True),
    Measure("holdout-error", "%", "held-out error", "held-out error, of the target's variance",
            _column("holdout_error", 100.0), miss=100.0, least=TINY),
    Measure("support", "", "columns", "columns in use", _column("support")),
    *(Measure(name, "", name, f"{name} of the support", _column(name), more=True)
      for name in ("precision", "recall", "f1")),
    Measure("stability", "", "stability", "overlap of the supports of two halves",
            _column("stability"), more=True),
    Measure("first-call", "s", "first call", "time of the first call, with imports and compilation",
            _timed("first"), "largest", varies=True),
    Measure("peak-memory", "MB", "peak memory", "peak memory", _timed("memory"), "largest",
            format=".0f", varies=True),
    Measure("repeats", "", "repeats", "repeats of a solve", _timed("repeats"), format=".0f",
            varies=True),
    _share("disturbed", "disturbed", "times taken while other programs had the core",
           _timed("disturbed"), ".0f"),
    Measure("cores", "", "CPU / wall", "CPU time over wall time",
            lambda cases: _timed("cpu")(cases) / numbers(cases, "wall"), format=".2f", varies=True),
)}.items() for each in group}  # fmt: skip
