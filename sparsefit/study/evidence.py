"""The evidence of a selection: its tables, its figure, and the files written."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sparsefit.codec import finite_or_none
from sparsefit.plot.style import GREY, logarithmic, styled, wrapped
from sparsefit.study.figures import Picture
from sparsefit.study.measures import factors
from sparsefit.study.page import Code, drawing, files_of, joined, to_html
from sparsefit.study.panels import Curve, Panel, drawn
from sparsefit.study.selection import Check, Selection, headline, lines, verdict
from sparsefit.study.table import Column, Row, Table
from sparsefit.study.tables import FAILURES
from sparsefit.whole_file import write_files

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def tables(selection: Selection) -> dict[str, Table]:
    """Return the tables of candidates and regimes and, if measured, of latency."""
    criterion, study = selection.criterion, selection.study
    unit, least = criterion.measure.unit, criterion.measure.least
    score: dict[str, Any] = {"unit": unit, "least": least}
    candidates, regimes, times = list[Row](), list[Row](), list[Row]()
    is_split = len(selection.units) > 1
    for each in sorted(selection.ranked, key=lambda each: each is not selection.chosen):
        apart, said = each.apart, verdict(selection, each)
        candidates.append((
            str(len(candidates) + 1), each.title, said, each.evaluate, *each.between,
            *[each.validate] * is_split,
            *((None,) * 3 if apart is None else (apart.effect, apart.low, apart.high)),
        ))  # fmt: skip
        regimes.append((each.title, said, *each.by_regime.tolist(), each.evaluate))
        if seen := selection.latencies.get(each.candidate):
            times.append((each.title, 1e3 * seen["median"], 1e3 * seen["p99"], seen["memory"],
                          100.0 * seen["busy"]))  # fmt: skip
    candidates += [("–", title, f"not on board: {why}", *(None,) * (6 + is_split))
                   for title, why in selection.refused.items()]  # fmt: skip
    first, last = ("validate", "evaluate") if is_split else ("difference", "score")
    heads = (
        *map(Column, ("rank", "candidate", "verdict")),
        *(Column(name, group=last, **score) for name in ("criterion", "from", "to")),
        *[Column("criterion", group=first, **score)] * is_split,
        *(Column(name, unit, group=first) for name in ("worse by", "from", "to")),
    )
    latency = (("median", "ms", ""), ("99th percentile", "ms", ""), ("peak memory", "MB", ".0f"),
               ("disturbed", "%", ".0f"))  # fmt: skip
    made = {
        "selection": Table(f"Candidates of the selection ({study})", heads, candidates, (
            f"Criterion: {criterion.words}. {FAILURES * (criterion.measure.miss is not None)}",
            "Worse by: than the chosen. Intervals: 95 %, by bootstrap over the same "
            f"{selection.unit}s for all.",
        )),
        "regimes": Table(f"Regimes ({study})", (
            *map(Column, ("candidate", "verdict")),
            *(Column(name, **score) for name in (*criterion.regimes, "all")),
        ), regimes),
        "latency": Table(f"Latency and memory ({study})", (
            Column("candidate"), *(Column(*each, varies=True) for each in latency),
        ), times, (
            "One flight at a time in a process of its own with BLAS on one thread, after a "
            "warm-up. Disturbed: flights during which other programs had the core.",
        )),
    }  # fmt: skip
    return {name: each for name, each in made.items() if each.rows}


def record(selection: Selection, check: Check | None = None) -> dict[str, Any]:
    """Return the selection for JSON."""
    made, chosen, cases = tables(selection), selection.chosen, selection.cases
    of: dict[str, Any] = {
        "study": selection.study, "rule": asdict(selection.rule),
        "criterion": selection.criterion.words, "unit": selection.criterion.measure.unit,
        "units": dict(selection.units), "summary": headline(selection),
        "candidates": len(selection.ranked), "eligible": len(selection.passing),
        "tied": [each.title for each in selection.tied], "refused": dict(selection.refused),
        "table": made["selection"].record(), "regimes": made["regimes"].record(),
    }  # fmt: skip
    if chosen is not None:
        row = cases[cases["candidate"] == chosen.candidate].iloc[0]
        own = [name for name in factors(cases) if not name.startswith("flights.")]
        regimes = zip(selection.criterion.regimes, chosen.by_regime.tolist(), strict=True)
        of |= {
            "candidate": chosen.candidate, "title": chosen.title,
            "protocol": row.get("reading", row.get("protocol", "")), "backend": row["backend"],
            "settings": json.loads(row["settings"]),
            "factors": {name: str(row[name]) for name in own},
            "validate": chosen.validate, "evaluate": chosen.evaluate,
            "interval": chosen.between, "by_regime": dict(regimes),
            "regret": selection.regret.effect if selection.regret else None,
            "latency": selection.latencies.get(chosen.candidate),
            "check": asdict(check) if check else None,
        }  # fmt: skip
    cleaned: dict[str, Any] = finite_or_none(of)
    return cleaned


def provenance(study: Any, selection: Selection) -> dict[str, Any]:
    """Return the origin of an estimator for its file: study, rule and evidence."""
    if selection.chosen is None:
        return {}
    of = record(selection)
    names = ("study", "rule", "units", "criterion", "unit", "title", "validate", "evaluate",
             "interval", "by_regime", "regret", "tied", "latency")  # fmt: skip
    return {"study_hash": study.hash, "seed": study.seed, **{name: of[name] for name in names}}


def pareto(selection: Selection) -> Picture:
    """Return the figure of accuracy against latency of the timed candidates, with their front."""
    criterion = selection.criterion
    timed = [
        (each, 1e3 * seen["median"], 1e3 * seen["p99"]) for each in selection.ranked
        if (seen := selection.latencies.get(each.candidate)) and math.isfinite(seen["median"])
    ]  # fmt: skip

    @styled
    def draw() -> Figure | None:
        y_label = wrapped(f"{criterion.words} [{criterion.measure.unit}]", 50)
        curves = [Curve(each.title, np.array([x]), np.array([each.evaluate]))
                  for each, x, _ in timed]  # fmt: skip
        panel = Panel(curves, "latency of one estimate [ms]", y_label, "", {"ls": "", "ms": 5.0},
                      log="x")  # fmt: skip
        ranks = {each.title: criterion.sign * each.evaluate for each, *_ in timed}
        figure = drawn([[panel]], 3.6, ranks)
        front = list[tuple[float, float]]()
        for x, loss in sorted((x, ranks[e.title]) for e, x, _ in timed if not e.breaches):
            if not front or loss < front[-1][1]:
                front.append((x, loss))
        for axes in figure.axes if figure else ():
            axes.autoscale()
            for each, x, slowest in timed:
                axes.hlines(each.evaluate, x, slowest, color=GREY, lw=0.6, zorder=1)
                axes.vlines(x, *each.between, color=GREY, lw=0.6, zorder=1)
                if each is selection.chosen:
                    axes.plot([x], [each.evaluate], "o", ms=13, mfc="none", mec="black", mew=1.0)
            axes.step([x for x, _ in front], [criterion.sign * loss for _, loss in front],
                      where="post", color=GREY, lw=0.9, ls="--", zorder=1)  # fmt: skip
            logarithmic(axes.xaxis, *axes.xaxis.get_view_interval())
        return figure

    caption = (
        "The criterion with its 95 % interval against the latency of one estimate, median to 99th "
        "percentile. Ringed: the chosen candidate; dashed: the front of those that keep every "
        "constraint."
    )
    return Picture(draw(), caption if timed else "No candidate was timed.")


def write_selection(
    study: Any, selection: Selection, folder: Path | None = None, check: Check | None = None
) -> list[Path]:
    """Write the tables and the figure of a selection, evidence.html and evidence.md, the last."""
    said, made, picture = list(lines(selection, check)), tables(selection), pareto(selection)
    answer, title = headline(selection), f"{study.name}: the selection"
    files = files_of(study.name, made, {"pareto": picture})
    sections: dict[str, Sequence[Any]] = {
        "Why": [said],
        "Candidates": [made["selection"]],
        "Accuracy and latency": [drawing("pareto", picture, files.get("pareto.svg", b"")),
                                 made["latency"]] if "latency" in made else [],
        "Regimes": [made["regimes"],
                    Code("The rule", json.dumps(asdict(selection.rule), indent=1))],
    }  # fmt: skip
    image = "![accuracy and latency](pareto.svg)" if picture.figure is not None else ""
    text = [f"# {title}", f"**{study.question}**", f"**{answer}**",
            "\n".join(f"- {line}" for line in said), image, made["selection"].to_markdown(12),
            "Tables: [selection.csv](selection.csv), [regimes.csv](regimes.csv). Written by "
            "`sparsefit select`; do not edit."]  # fmt: skip
    page = to_html(title, study.question, answer, sections).encode()
    files |= {"evidence.html": page, "evidence.md": joined(text)}
    return write_files(folder or study.folder, files)
