"""The evidence of a selection: what a review asks of it, its picture, its page and its files."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sparsefit.plot.style import (
    COLOURS,
    GREY,
    MARKERS,
    labels,
    legend,
    logarithmic,
    panels,
    styled,
    wrapped,
)
from sparsefit.study.figures import Picture
from sparsefit.study.page import Code, Section, drawing, joined, picture_files, table_files, to_html
from sparsefit.study.selection import LIMITS, Check, Scored, Selection, limit_text, listed
from sparsefit.study.table import significant
from sparsefit.whole_file import write_files

DISTURBED = 0.1  # share of timed flights with other programs on the core, from which it is told
CAPTION = (
    "The criterion with its 95 % interval against the latency of one estimate, from the median to "
    "the 99th percentile. Ringed: the chosen; hollow: breaks a constraint; line: the front, beaten "
    "by none in both."
)


def lines(selection: Selection, check: Check | None = None) -> list[str]:
    """Return what a review asks: the rule, ties, regret, the worst regime, the clock."""
    criterion, chosen, kind = selection.criterion, selection.chosen, selection.kind
    limits = [
        f"{LIMITS[name][0]} at most {limit_text(name, limit)}"
        for name in (field.name for field in fields(selection.rule.limits))
        if (limit := getattr(selection.rule.limits, name)) is not None
    ]
    keeping = f"; {len(selection.passing)} keep {listed(limits, 'and')}" if limits else ""
    split, regimes = next(iter(selection.units)), len(criterion.regimes)
    said = [
        f"{len(selection.ranked)} candidates{f' in {regimes} regimes' if regimes > 1 else ''}, "
        f"chosen on {selection.units[split]} {kind}{keeping}; the simplest within "
        f"{100 * selection.rule.margin:g} % of the best."
    ]
    if chosen is None:
        return [*said, *_binding(selection)]
    said.insert(0, selection.score_line)
    if selection.tied:
        needed = [each.apart.more_units for each in selection.tied if each.apart is not None]
        finite = [count for count in needed if math.isfinite(count)]
        more = f"; {min(finite):.0f} more {kind} would end the easiest" if finite else ""
        said.append(f"A tie with {listed([each.title for each in selection.tied])}{more}.")
    regret, hindsight = selection.regret, selection.hindsight
    if hindsight is chosen:
        said.append("With hindsight no candidate that keeps everything is better.")
    elif hindsight is not None and regret is not None:
        said.append(f"With hindsight {hindsight.title} is best: regret "
                    f"{criterion.say(regret.effect)} ({significant(regret.low)} to "
                    f"{significant(regret.high)}).")  # fmt: skip
    if regimes > 1 and np.isfinite(chosen.by_regime).any():
        worst = int(np.nanargmax(criterion.sign * chosen.by_regime))
        value = criterion.say(float(chosen.by_regime[worst]))
        said.append(f"Its worst regime is {criterion.regimes[worst]}: {value}.")
    said += [f"On the evaluate {kind} it breaks: {breach.words}." for breach in chosen.broken]
    if seen := selection.latencies.get(chosen.candidate):
        loud = f" ({100 * seen['busy']:.0f} % of the timed flights disturbed: measure again on a "
        loud += "quiet machine)"
        said.append(
            f"One estimate takes {significant(1e3 * seen['median'])} ms, at most "
            f"{significant(1e3 * seen['p99'])} ms in 99 of 100, BLAS on one thread"
            f"{loud if seen['busy'] > DISTURBED else ''}."
        )
    if check is not None:
        low, high = map(significant, check.between)
        best = "none of those not ruled out is better there"
        if not check.regret.identical:
            best = f"{check.hindsight} is best there, regret {criterion.say(check.regret.effect)}"
        said.append(f"On {check.units} fresh {kind}: {criterion.say(check.score)} ({low} to "
                    f"{high}); {best}.")  # fmt: skip
        said += [f"There it breaks: {breach.words}." for breach in check.broken]
    return said


def _binding(selection: Selection) -> Iterator[str]:
    """Give, for each constraint, how many it refuses and who comes closest."""
    every = [(breach, each) for each in selection.ranked for breach in each.breaches]
    single = (each.breaches[0].constraint for each in selection.ranked if len(each.breaches) == 1)
    alone, count = Counter(single), Counter(breach.constraint for breach, _ in every)
    for name, refused in count.most_common():
        mine = [pair for pair in every if pair[0].constraint == name]
        breach, nearest = min(mine, key=lambda pair: pair[0].value)
        binds = f" and alone binds for {alone[name]}" if alone[name] else ""
        yield (f"{name} refuses {refused} of {len(selection.ranked)}{binds}; the closest is "
               f"{nearest.title}: {breach.words}.")  # fmt: skip


def provenance(study: Any, selection: Selection) -> dict[str, Any]:
    """Return what an estimator comes from: the study, the rule, and the evidence."""
    if selection.chosen is None:
        return {}
    record = selection.record()
    kept = ("study", "rule", "units", "criterion", "unit", "title", "validate", "evaluate",
            "interval", "by_regime", "probability_best", "regret", "tied", "latency")  # fmt: skip
    own = {name: record[name] for name in kept}
    return {"study_hash": study.hash, "seed": study.seed, **own}


def pareto(selection: Selection) -> Picture:
    """Return accuracy against latency of all candidates that were timed, with their front."""
    timed = [
        (each, 1e3 * seen["median"], 1e3 * seen["p99"]) for each in selection.ranked
        if (seen := selection.latencies.get(each.candidate)) and math.isfinite(seen["median"])
    ]  # fmt: skip
    if not timed:
        return Picture(None, "No candidate was timed.")

    def draw() -> Figure:
        figure, ((axes,),) = panels(1, 1, height=4.2)
        _draw_candidates(axes, selection, timed)
        sign, front = selection.criterion.sign, list[tuple[float, float]]()
        for x, loss in sorted((x, sign * e.evaluate) for e, x, _ in timed if not e.breaches):
            if not front or loss < front[-1][1]:
                front.append((x, loss))
        axes.step([x for x, _ in front], [sign * loss for _, loss in front], where="post",
                  color=GREY, lw=0.9, ls="--", zorder=1)  # fmt: skip
        values = [each.evaluate for each, *_ in timed]
        spans = (("x", [x for _, x, _ in timed], 2.0), ("y", values, 8.0))
        for name, numbers, least in spans:
            if max(numbers) > least * min(numbers) > 0:
                axes.set(**{f"{name}scale": "log"})
                axis = axes.xaxis if name == "x" else axes.yaxis
                logarithmic(axis, *axis.get_view_interval())
        axes.set_xlabel("latency of one estimate [ms]")
        unit = selection.criterion.measure.unit
        axes.set_ylabel(wrapped(f"{selection.criterion.words} [{unit}]", 50))
        legend(figure, [axes])
        return figure

    return Picture(styled(draw), CAPTION)


def _draw_candidates(axes: Axes, selection: Selection,
                     timed: Sequence[tuple[Scored, float, float]]) -> None:  # fmt: skip
    """Draw each candidate with its intervals: colours are back-ends, markers readings."""
    parts = [selection.parts[each.candidate] for each, *_ in timed]
    readings, backends = (list(dict.fromkeys(names)) for names in zip(*parts, strict=True))
    short = labels([each.title for each, *_ in timed], 50)
    for (each, x, slowest), (reading, backend) in zip(timed, parts, strict=True):
        ink, y = COLOURS[backends.index(backend) % len(COLOURS)], each.evaluate
        if each is selection.chosen:
            axes.plot([x], [y], "o", ms=13, mfc="none", mec="black", mew=1.0, zorder=2)
        axes.plot([x, slowest], [y, y], color=ink, lw=0.7, alpha=0.6)
        axes.plot([x, x], each.between, color=ink, lw=0.7, alpha=0.6)
        axes.plot([x], [y], MARKERS[readings.index(reading) % len(MARKERS)], ms=5, color=ink,
                  mfc="white" if each.breaches else ink, label=short[each.title],
                  zorder=4)  # fmt: skip


def write_selection(
    study: Any, selection: Selection, folder: Path | None = None, check: Check | None = None
) -> list[Path]:
    """Write the tables and pictures of a selection, evidence.html and evidence.md, the last."""
    said, tables, picture = lines(selection, check), selection.tables, pareto(selection)
    rule = json.dumps(selection.record()["rule"], indent=1)
    latency = [each for name, each in tables.items() if name == "latency"]
    sections = [
        Section("Why", [said]),
        Section("Candidates", [tables["selection"]]),
        Section("Accuracy and latency", [drawing("pareto", picture), *latency]),
        Section("Regimes", [tables["regimes"], Code("The rule", rule)]),
    ]
    title = f"{study.name}: the selection"
    page = to_html(title, study.question, [selection.headline], sections)
    image = "![accuracy and latency](pareto.svg)" if picture.figure is not None else ""
    text = [f"# {title}", f"**{study.question}**", f"**{selection.headline}**",
            "\n".join(f"- {line}" for line in said), image, tables["selection"].to_markdown(12),
            "Tables: [selection.csv](selection.csv), [regimes.csv](regimes.csv). Written by "
            "`sparsefit select`; do not edit."]  # fmt: skip
    files = {
        **table_files(study.name, tables), **picture_files({"pareto": picture}),
        "evidence.html": page.encode(), "evidence.md": joined(text),
    }  # fmt: skip
    return write_files(folder or study.folder, files)
