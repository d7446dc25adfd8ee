"""The evidence of a selection: its tables, its figure, and the files written."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, astuple
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sparsefit.codec import finite_or_none
from sparsefit.plot.style import GREY, logarithmic, styled, wrapped
from sparsefit.study.figures import Picture
from sparsefit.study.measures import factors
from sparsefit.study.page import Code, drawing, files_of, joined, linked, to_html
from sparsefit.study.panels import Curve, Panel, drawn
from sparsefit.study.selection import Selection, headline, lines, verdict
from sparsefit.study.table import Column, Row, Table
from sparsefit.study.tables import FAILURES
from sparsefit.whole_file import write_files

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def tables(selection: Selection) -> dict[str, Table]:
    """Return the tables of candidates and regimes and, if measured, of latency."""
    criterion, study = selection.criterion, selection.study
    unit, is_split = criterion.measure.unit, len(selection.units) > 1
    ranked = sorted(selection.ranked, key=lambda each: each is not selection.chosen)
    said = [verdict(selection, each) for each in ranked]

    def scores(*names: str, group: str = "") -> list[Column]:
        return [Column(name, unit, group=group, least=criterion.measure.least) for name in names]

    scored, apart = ("evaluate", "validate") if is_split else ("score", "difference")
    heads = [*map(Column, ("rank", "candidate", "verdict"))]
    heads += scores("criterion", "from", "to", group=scored)
    heads += scores("criterion", group=apart) if is_split else []
    heads += [Column(name, unit, group=apart) for name in ("worse by", "from", "to")]
    rows: list[Row] = []
    for place, (each, words) in enumerate(zip(ranked, said, strict=True), 1):
        row = [str(place), each.title, words, each.evaluate, *each.between]
        row += [each.validate] if is_split else []
        row += [None] * 3 if each.apart is None else astuple(each.apart)[:3]
        rows.append(tuple(row))
    for title, why in selection.refused.items():
        rows.append(("–", title, f"not on board: {why}", *[None] * (len(heads) - 3)))
    ranking = Table(f"Candidates of the selection ({study})", tuple(heads), rows, (
        f"Criterion: {criterion.words}. {FAILURES * (criterion.measure.miss is not None)}".strip(),
        "Worse by: than the chosen. Intervals: 95 %, by bootstrap over the same "
        f"{selection.unit}s for all.",
    ))  # fmt: skip
    by_regime: list[Row] = [
        (each.title, words, *each.by_regime.tolist(), each.evaluate)
        for each, words in zip(ranked, said, strict=True)
    ]
    heads = [*map(Column, ("candidate", "verdict")), *scores(*criterion.regimes, "all")]
    made = {
        "selection": ranking,
        "regimes": Table(
            f"Regimes ({study})", tuple(heads), by_regime * (len(criterion.regimes) > 1)
        ),
        "latency": _latencies(selection, ranked),
    }
    return {name: each for name, each in made.items() if each.rows}


def _latencies(selection: Selection, ranked: Sequence[Any]) -> Table:
    """Return the table of the candidates that were timed."""
    rows: list[Row] = [
        (each.title, 1e3 * seen["median"], 1e3 * seen["p99"], seen["memory"], 100.0 * seen["busy"])
        for each in ranked
        if (seen := selection.latencies.get(each.candidate))
    ]
    columns = (
        Column("candidate"),
        *(Column(name, "ms", varies=True) for name in ("median", "99th percentile")),
        Column("peak memory", "MB", ".0f", varies=True),
        Column("disturbed", "%", ".0f", varies=True),
    )
    note = (
        "One flight at a time in a process of its own with BLAS on one thread, after a warm-up. "
        "Disturbed: flights during which other programs had the core."
    )
    return Table(f"Latency and memory ({selection.study})", columns, rows, (note,))


def record(selection: Selection, check: Selection | None = None) -> dict[str, Any]:
    """Return the selection for JSON."""
    made, chosen, cases = tables(selection), selection.chosen, selection.cases
    of: dict[str, Any] = {name: getattr(selection, name) for name in ("study", "units", "refused")}
    of |= {"rule": asdict(selection.rule), "criterion": selection.criterion.words}
    of |= {"unit": selection.criterion.measure.unit, "summary": headline(selection)}
    of |= {"candidates": len(selection.ranked), "eligible": len(selection.passing)}
    of |= {"tied": [each.title for each in selection.tied]}
    of |= {"table": made["selection"].record()}
    of |= {"regimes": made["regimes"].record() if "regimes" in made else None}
    if chosen is not None:
        row = cases[cases["candidate"] == chosen.candidate].iloc[0]
        own = [name for name in factors(cases) if not name.startswith("flights.")]
        regimes = zip(selection.criterion.regimes, chosen.by_regime.tolist(), strict=True)
        names = ("candidate", "title", "backend", "validate", "evaluate")
        of |= {name: getattr(chosen, name) for name in names}
        of |= {"protocol": row.get("reading", row.get("protocol", ""))}
        of |= {"settings": json.loads(row["settings"])}
        of |= {"factors": {name: str(row[name]) for name in own}}
        of |= {"interval": chosen.between, "by_regime": dict(regimes)}
        of |= {"regret": selection.regret.effect if selection.regret else None}
        of |= {"latency": selection.latencies.get(chosen.candidate)}
        of |= {"check": _checked(check) if check else None}
    cleaned: dict[str, Any] = finite_or_none(of)
    return cleaned


def _checked(check: Selection) -> dict[str, Any]:
    """Return what the chosen candidate scored on fresh flights, for JSON."""
    (units,), chosen, best = check.units.values(), check.chosen, check.hindsight
    of: dict[str, Any] = {"units": units, "candidates": len(check.ranked)}
    of |= {"score": chosen.evaluate, "between": chosen.between}
    of |= {"broken": [asdict(breach) for breach in chosen.broken]}
    of |= {"regret": asdict(check.regret) if check.regret else None}
    return of | {"hindsight": best.title if best else None}


def provenance(study: Any, selection: Selection) -> dict[str, Any]:
    """Return the origin of an estimator for its file: study, rule and evidence."""
    if selection.chosen is None:
        return {}
    of = record(selection)
    tables = ("table", "regimes")
    evidence = {name: value for name, value in of.items() if name not in tables}
    return {"study_hash": study.hash, "seed": study.seed, **evidence}


def pareto(selection: Selection) -> Picture:
    """Return the figure of accuracy against latency of the timed candidates, with their front."""
    timed = [
        (each, 1e3 * seen["median"], 1e3 * seen["p99"])
        for each in selection.ranked
        if (seen := selection.latencies.get(each.candidate)) and math.isfinite(seen["median"])
    ]
    caption = (
        "The criterion with its 95 % interval against the latency of one estimate, median to 99th "
        "percentile. Ringed: the chosen candidate; dashed: the front of those that keep every "
        "constraint."
    )
    return Picture(_drawn(selection, timed), caption if timed else "No candidate was timed.")


@styled
def _drawn(selection: Selection, timed: Sequence[tuple[Any, float, float]]) -> Figure | None:
    """Draw the criterion of candidates against their latencies, median and 99th percentile [ms]."""
    criterion = selection.criterion
    y_label = wrapped(f"{criterion.words} [{criterion.measure.unit}]", 50)
    points = [Curve(each.title, np.array([x]), np.array([each.evaluate])) for each, x, _ in timed]
    style = {"ls": "", "ms": 5.0}
    panel = Panel(points, "latency of one estimate [ms]", y_label, style=style, log="x")
    ranks = {each.title: criterion.sign * each.evaluate for each, *_ in timed}
    figure = drawn([[panel]], 3.6, ranks)
    if figure is None:
        return None
    (axes,) = figure.axes
    axes.autoscale()
    for each, x, slowest in timed:
        axes.hlines(each.evaluate, x, slowest, color=GREY, lw=0.6, zorder=1)
        axes.vlines(x, *each.between, color=GREY, lw=0.6, zorder=1)
        if each is selection.chosen:
            axes.plot([x], [each.evaluate], "o", ms=13, mfc="none", mec="black", mew=1.0)
    front = sorted((x, ranks[each.title]) for each, x, _ in timed if not each.breaches)
    times, losses = np.array(front).reshape(-1, 2).T
    best = criterion.sign * np.minimum.accumulate(losses)
    axes.step(times, best, where="post", color=GREY, lw=0.9, ls="--", zorder=1)
    logarithmic(axes.xaxis, *axes.xaxis.get_view_interval())
    return figure


def write_selection(
    study: Any, selection: Selection, folder: Path | None = None, check: Selection | None = None
) -> list[Path]:
    """Write the tables and the figure of a selection, evidence.html and evidence.md, the last."""
    said, made, picture = list(lines(selection, check)), tables(selection), pareto(selection)
    answer, title = headline(selection), f"{study.name}: the selection"
    files = files_of(study.name, made, {"pareto": picture})
    shown = drawing("pareto", picture, files.get("pareto.svg", b""))
    sections: dict[str, Sequence[Any]] = {
        "Why": [said, Code("The rule", json.dumps(asdict(selection.rule), indent=1))],
        "Candidates": [made["selection"]],
        "Accuracy and latency": [shown, made["latency"]] if "latency" in made else [],
        "Regimes": [made["regimes"]] if "regimes" in made else [],
    }
    text = [
        f"# {title}\n\n**{study.question}**\n\n**{answer}**",
        "\n".join(f"- {line}" for line in said),
        "![accuracy and latency](pareto.svg)" if picture.figure is not None else "",
        made["selection"].to_markdown(12, "selection.csv"),
        f"{linked(made)} Written by `sparsefit select`; do not edit.",
    ]
    page = to_html(title, study.question, answer, sections).encode()
    files |= {"evidence.html": page, "evidence.md": joined(text)}
    return write_files(folder or study.folder, files)
