"""The evidence of a selection: its tables, its figure, and the files written."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, astuple
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sparsefit.codec import finite_or_none
from sparsefit.plot.style import GREY, logarithmic, panels, styled, wrapped
from sparsefit.study.figures import Picture, dressed, scale
from sparsefit.study.measures import factors
from sparsefit.study.page import files_of, joined, linked
from sparsefit.study.selection import Selection, headline, lines, verdict
from sparsefit.study.table import Column, Row, Table
from sparsefit.study.tables import FAILURES, Cells
from sparsefit.whole_file import write_files

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PARETO = (
    "The criterion with its 95 % interval against the latency of one estimate, median to 99th "
    "percentile. Ringed: the chosen candidate; dashed: the front of those that keep every "
    "constraint."
)


def tables(selection: Selection) -> dict[str, Table]:
    """Return the tables of candidates and regimes and, if measured, of latency."""
    criterion, study, unit = selection.criterion, selection.study, selection.criterion.measure.unit
    ranked = sorted(selection.ranked, key=lambda each: each is not selection.chosen)
    rows, by_regime, timed = list[Cells](), list[Row](), list[Cells]()

    def scored(name: str, group: str = "") -> Column:
        return Column(name, unit, group=group, least=criterion.measure.least)

    is_split = len(selection.units) > 1
    first, last = ("validate", "evaluate") if is_split else ("difference", "score")
    for place, each in enumerate(ranked, 1):
        names: Cells = {Column("candidate"): each.title}
        of: Cells = names | {Column("verdict"): verdict(selection, each)}
        gap = (None, None, None) if each.apart is None else astuple(each.apart)[:3]
        rows.append({
            Column("rank"): str(place), **of, scored("criterion", last): each.evaluate,
            **dict(zip((scored("from", last), scored("to", last)), each.between, strict=True)),
            **({scored("criterion", first): each.validate} if is_split else {}),
            **{Column(name, unit, group=first): value
               for name, value in zip(("worse by", "from", "to"), gap, strict=True)},
        })  # fmt: skip
        by_regime.append((*of.values(), *each.by_regime.tolist(), each.evaluate))
        if seen := selection.latencies.get(each.candidate):
            timed.append(names | {
                Column("median", "ms", varies=True): 1e3 * seen["median"],
                Column("99th percentile", "ms", varies=True): 1e3 * seen["p99"],
                Column("peak memory", "MB", ".0f", varies=True): seen["memory"],
                Column("disturbed", "%", ".0f", varies=True): 100.0 * seen["busy"],
            })  # fmt: skip
    rows += [
        {Column("rank"): "–", Column("candidate"): title, Column("verdict"): f"not on board: {why}"}
        for title, why in selection.refused.items()
    ]
    made = {"selection": Table.of_cells(f"Candidates of the selection ({study})", rows, (
        f"Criterion: {criterion.words}. {FAILURES * (criterion.measure.miss is not None)}".strip(),
        "Worse by: than the chosen. Intervals: 95 %, by bootstrap over the same "
        f"{selection.unit}s for all.",
    ))}  # fmt: skip
    if len(criterion.regimes) > 1:
        heads = (*of, *map(scored, (*criterion.regimes, "all")))  # one may be called "all", too
        made["regimes"] = Table(f"Regimes ({study})", heads, by_regime)
    if timed:
        made["latency"] = Table.of_cells(f"Latency and memory ({study})", timed, (
            "One flight at a time in a process of its own with BLAS on one thread, after a warm-up."
            " Disturbed: flights during which other programs had the core.",
        ))  # fmt: skip
    return made


def record(selection: Selection, check: Selection | None = None) -> dict[str, Any]:
    """Return the selection for JSON; check: the same candidates on flights of fresh seeds."""
    made, chosen, cases = tables(selection), selection.chosen, selection.cases
    of: dict[str, Any] = {
        **{name: getattr(selection, name) for name in ("study", "units", "refused")},
        "rule": asdict(selection.rule), "criterion": selection.criterion.words,
        "unit": selection.criterion.measure.unit, "summary": headline(selection),
        "candidates": len(selection.ranked), "eligible": len(selection.passing),
        "tied": [each.title for each in selection.tied], "table": made["selection"].record(),
        "regimes": made["regimes"].record() if "regimes" in made else None,
    }  # fmt: skip
    if chosen is not None:
        row = cases[cases["candidate"] == chosen.candidate].iloc[0]
        own = [name for name in factors(cases) if not name.startswith("flights.")]
        regimes = zip(selection.criterion.regimes, chosen.by_regime.tolist(), strict=True)
        names = ("candidate", "title", "backend", "validate", "evaluate")
        of |= {name: getattr(chosen, name) for name in names} | {
            "protocol": row.get("reading", row.get("protocol", "")),
            "settings": json.loads(row["settings"]),
            "factors": {name: str(row[name]) for name in own},
            "interval": chosen.between, "by_regime": dict(regimes),
            "regret": selection.regret.effect if selection.regret else None,
            "latency": selection.latencies.get(chosen.candidate), "check": None,
        }  # fmt: skip
    if check is not None:
        (units,), best = check.units.values(), check.hindsight
        of["check"] = {
            "units": units, "candidates": len(check.ranked),
            "score": check.chosen.evaluate, "between": check.chosen.between,
            "broken": [asdict(breach) for breach in check.chosen.broken],
            "regret": asdict(check.regret) if check.regret else None,
            "hindsight": best.title if best else None,
        }  # fmt: skip
    cleaned: dict[str, Any] = finite_or_none(of)
    return cleaned


def provenance(study: Any, selection: Selection) -> dict[str, Any]:
    """Return the origin of an estimator for its file: study, rule and evidence."""
    if selection.chosen is None:
        return {}
    evidence = {"study_hash": study.hash, "seed": study.seed, **record(selection)}
    return {name: value for name, value in evidence.items() if name not in ("table", "regimes")}


@styled
def pareto(selection: Selection) -> Figure | None:
    """Draw the criterion of the timed candidates against their latencies [ms], with their front."""
    criterion = selection.criterion
    timed = [
        (each, 1e3 * seen["median"], 1e3 * seen["p99"])
        for each in selection.ranked
        if (seen := selection.latencies.get(each.candidate)) and math.isfinite(seen["median"])
    ]
    ranks = {each.title: criterion.sign * each.evaluate for each, *_ in timed}
    _, ((axes,),) = panels(1, 1, height=3.6)
    for each, x, slowest in timed:
        axes.plot(x, each.evaluate, "o", ms=5.0, gid=each.title)
        axes.hlines(each.evaluate, x, slowest, color=GREY, lw=0.6, zorder=1)
        axes.vlines(x, *each.between, color=GREY, lw=0.6, zorder=1)
        if each is selection.chosen:
            axes.plot(x, each.evaluate, "o", ms=13, mfc="none", mec="black", mew=1.0)
    front = sorted((x, ranks[each.title]) for each, x, _ in timed if not each.breaches)
    times, losses = np.array(front).reshape(-1, 2).T
    best = criterion.sign * np.minimum.accumulate(losses)
    axes.step(times, best, where="post", color=GREY, lw=0.9, ls="--", zorder=1)
    axes.set(
        xlabel="latency of one estimate [ms]", xscale="log",
        ylabel=wrapped(f"{criterion.words} [{criterion.measure.unit}]", 50),
    )  # fmt: skip
    logarithmic(axes.xaxis, *axes.get_xlim())
    scale([axes], is_share=False)
    return dressed([[axes]], ranks)


def write_selection(
    study: Any, selection: Selection, folder: Path | None = None, check: Selection | None = None
) -> list[Path]:
    """Write the tables and the figure of a selection, and evidence.md, the last."""
    said, made, picture = list(lines(selection, check)), tables(selection), pareto(selection)
    files = files_of(study.name, made, {"pareto": Picture(picture, "")})
    text = [
        f"# {study.name}: the selection\n\n**{study.question}**\n\n**{headline(selection)}**",
        "\n".join(f"- {line}" for line in said),
        f"![accuracy and latency](pareto.svg)\n\n*{PARETO}*" if picture is not None else "",
        made["selection"].to_markdown(12, "selection.csv"),
        f"{linked(made)} Written by `sparsefit select`; do not edit.",
    ]
    return write_files(folder or study.folder, files | {"evidence.md": joined(text)})
