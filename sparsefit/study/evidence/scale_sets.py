"""Several scales at once, counted: the table `scales`, and the sentence that answers."""

from __future__ import annotations

import json
from dataclasses import dataclass

import numpy as np
import pandas as pd

from sparsefit.arrays import Array, BoolArray
from sparsefit.study.evidence.summary import (
    Group,
    StudyRecord,
    by_setting,
    factors,
    grouped,
    numbers,
    quantile,
)
from sparsefit.study.evidence.table import SIGNIFICANT, Cell, Column, Table, plain

FAR = 30.0  # cells: beyond it, the regime of the answer
RATIO, VELOCITY_RATIO = 1.3, 0.3
HAIR = 1e-6  # 1.3 L / L is not 1.3 in binary, and JSON keeps 7 digits
ROWS_SHOWN = 80

NOTE = (
    "All found: every flow's length scale within 1 %, over all planned cases. A scale counts as "
    "detected within 5 %; missed and spurious are means per case. Errors: the largest over the "
    "detected scales of a case, median over cases. Unseen: cases that ended as ok without all "
    "scales within 1 %. First row of each setting: all its cases; then "
    "each level of each factor, the others pooled."
)


def has_scales(cases: pd.DataFrame) -> bool:
    """Whether any case was scored on a set of scales; older files lack the columns."""
    return "scales_true" in cases and bool(np.isfinite(numbers(cases, "scales_true")).any())


def all_found(cases: pd.DataFrame) -> BoolArray:
    """(rows,) whether every true scale was found within 1 %; a case without an answer was not."""
    found: BoolArray = numbers(cases, "scales_within_1_percent") == 1.0
    return found


@dataclass(frozen=True, eq=False)
class Regime:
    """Per case: cells flown (extent over the largest scale), least ratios of scales, of U0."""

    cells: Array
    ratio: Array
    velocity_ratio: Array

    @classmethod
    def of(cls, cases: pd.DataFrame) -> Regime:
        """From the true scales and the extent; NaN where a case has none."""
        rows = [_regime(plain(one)) for one in cases["true_scales"]]
        largest, ratio, velocity = np.array(rows, dtype=float).reshape(-1, 3).T
        return cls(numbers(cases, "extent") / largest, ratio, velocity)

    @property
    def resolved(self) -> BoolArray:
        """Far enough, and scales and velocities different enough, to find them all."""
        far = (self.cells >= FAR) & (self.ratio >= RATIO - HAIR)
        both: BoolArray = far & (self.velocity_ratio >= VELOCITY_RATIO - HAIR)
        return both


def _regime(text: Cell) -> tuple[float, float, float]:
    pairs = np.array(json.loads(str(text or "[]")), dtype=float).reshape(-1, 2)
    if not len(pairs):
        return np.nan, np.nan, np.nan
    scales, speeds = np.sort(pairs[:, 0]), pairs[:, 1]
    apart = float(np.min(scales[1:] / scales[:-1])) if len(scales) > 1 else np.inf
    return float(scales[-1]), apart, float(speeds.min() / speeds.max())


def scales(study: StudyRecord, cases: pd.DataFrame) -> Table:
    """Scales found, missed and spurious, per setting and level of every factor."""
    rows: list[tuple[Cell, ...]] = []
    for group in by_setting(cases):
        key = (group.key["protocol"], group.key["backend"], group.setting)
        rows.append((*key, None, None, *_counted(group.cases)))
        for factor in factors(cases):
            rows += [
                (*key, factor, level.key[factor], *_counted(level.cases))
                for level in grouped(group.cases, [factor])
            ]
    names = ("protocol", "backend", "setting", "factor", "level")
    columns = (
        *(Column(name, align="left") for name in names),
        Column("n", format="d"),
        Column("all found", "%", ".0f"),
        Column("missed", format=".2f", group="mean"),
        Column("spurious", format=".2f", group="mean"),
        Column("L_w", "%", SIGNIFICANT, group="median error"),
        Column("U0", "%", SIGNIFICANT, group="median error"),
        Column("unseen", format="d"),
    )
    title = f"Several scales at once ({study.name})"
    return Table(title, columns, tuple(rows), (NOTE,), ROWS_SHOWN)


def _counted(cases: pd.DataFrame) -> tuple[Cell, ...]:
    counts = [numbers(cases, f"scales_{name}") for name in ("missed", "spurious")]
    errors = [
        numbers(cases, f"scales_max_{name}_error") for name in ("length_scale", "mean_velocity")
    ]
    means = (float(np.nanmean(one)) if np.isfinite(one).any() else None for one in counts)
    medians = (quantile(one[:, None], 0.5)[0] for one in errors)
    found = all_found(cases)
    unseen = int((~found & (cases["status"] == "ok").to_numpy(dtype=bool)).sum())
    return len(cases), 100.0 * float(found.mean()), *means, *medians, unseen


def answer(study: StudyRecord, cases: pd.DataFrame) -> str:
    """Who finds every scale, where the flight is long enough and where it is not."""
    regime = Regime.of(cases)
    parts = [
        (
            f"Flights of at least {FAR:g} cells, scale ratio at least {RATIO:g}, velocity ratio at "
            f"least {VELOCITY_RATIO:g}",
            regime.resolved,
        ),
        ("All other flights", ~regime.resolved & np.isfinite(regime.cells)),
    ]
    said = [f"{words}: {_ranked(cases[chosen])}" for words, chosen in parts if chosen.any()]
    if not said:
        return "No case has a set of scales to count."
    return "Share of flights with every length scale found within 1 %. " + " ".join(said)


def _ranked(cases: pd.DataFrame) -> str:
    """Back-ends by the share of flights in which they find all, best first, per protocol."""
    by_protocol: dict[str, list[tuple[float, str]]] = {}
    for group in first_settings(cases):
        share = 100.0 * float(all_found(group.cases).mean())
        by_protocol.setdefault(str(group.key["protocol"]), []).append((share, group.title))
    words = []
    for protocol, shares in by_protocol.items():
        order = sorted((one for one in shares if one[0] > 0), key=lambda one: -one[0])
        named = [f"{title} {_percent(share)}" for share, title in order]
        none = [title for share, title in shares if share == 0]
        named += [f"{', '.join(none) if len(none) < 3 else 'all others'} 0 %"] if none else []
        listed = ", ".join(named)
        words.append(f"{protocol}: {listed}" if len(by_protocol) > 1 else listed)
    flights = max(len(group.cases) for group in by_setting(cases))
    return f"{'; '.join(words)} ({flights} flights)."


def _percent(share: float) -> str:
    """No rounding up to all, or down to none."""
    return f"{share:.1f} %" if 0 < share < 1 or 99 < share < 100 else f"{share:.0f} %"


def first_settings(cases: pd.DataFrame) -> list[Group]:
    """The first listed setting of every back-end in every protocol."""
    firsts: dict[tuple[object, object], Group] = {}
    for group in by_setting(cases):
        firsts.setdefault((group.key["protocol"], group.key["label"]), group)
    return list(firsts.values())
