"""The figures of a study, by name: each is a pure function of the study and its cases.

A figure of a study's own names its measures and one of `DRAWN`; `FIGURES` need no options.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, TypeAlias

import matplotlib as mpl
import pandas as pd
from matplotlib.figure import Figure

from sparsefit.errors import unknown
from sparsefit.study.evidence.asked import Asked, read_entry
from sparsefit.study.evidence.cases import factors, groups_by, in_a_flow, numeric_factors
from sparsefit.study.evidence.measures import MEASURES, Measure, three
from sparsefit.study.evidence.readings import bounded
from sparsefit.study.evidence.tables import DURATION, MEASUREMENT_NOISE, has_any, many_levels
from sparsefit.study.report.certificate import certificate_figure
from sparsefit.study.report.drawing import STYLE
from sparsefit.study.report.lines import OTHERS, SETTING, lines, pooling_note
from sparsefit.study.report.scatter import scatter
from sparsefit.study.report.strips import strips
from sparsefit.study.report.weights import weights_figure
from sparsefit.study.spec.outputs import Entry

if TYPE_CHECKING:
    from sparsefit.study.spec.study import Study

FigureFunction: TypeAlias = Callable[["Study", pd.DataFrame, pd.DataFrame | None], Figure]
AskedFigure: TypeAlias = Callable[[Asked, "Study", pd.DataFrame, pd.DataFrame | None], Figure]
PROCESS_NOISE = "flights.process_noise"
LEGIBLE = 8  # rows: with more, nobody reads the picture unless the study asks for it
# By name, how the measures of an entry are drawn: `compare` = "settings" is a row per setting.
DRAWN: dict[str, AskedFigure] = {"settings": strips, "protocols": lines, "until": lines}


def _ordered(kind: str) -> tuple[Measure, ...]:
    """The measures of tau_w, L_w and U0: what the paper is after first."""
    return three(kind)[::-1]


PRESETS = {
    "errors": Asked(measures=_ordered("error")),
    "coverage": Asked(
        limits=(93.0, 97.0),
        measures=tuple(MEASURES[f"{name}-coverage"]
                       for name in ("length-scale", "mean-velocity", "timescale")),
    ),
    "sweep": Asked(compare="protocols", over="setting", measures=_ordered("error"), band=True),
    "methods": Asked(
        compare="protocols", measures=(MEASURES["timescale-error"],), along=MEASUREMENT_NOISE,
        columns=(SETTING,), settings="every", rows=(OTHERS,),
    ),
    "scales": Asked(
        compare="protocols", over="setting", measures=(MEASURES["scales-found"],),
    ),
    "efficiency": Asked(
        compare="protocols", over="setting", along=PROCESS_NOISE,
        rows=(OTHERS,),
        measures=(MEASURES["length-scale-bounded-error"], MEASURES["length-scale-efficiency"],
                  MEASURES["mean-velocity-efficiency"]),
    ),
    "windows": Asked(
        compare="until", over="setting", along=DURATION, limits=(5.0, 1.0),
        measures=tuple(replace(MEASURES["largest-error"], summary=summary)
                       for summary in ("median", "9 of 10")),
    ),
    "grids": Asked(
        compare="protocols", over="setting", along="protocol", columns=("readout.refine",),
        measures=(MEASURES["length-scale-error"],),
    ),
}  # fmt: skip
CAPTIONS = {
    "weights": "Weight of every candidate length scale, first flight, first listed setting of "
    "each back-end.",
    "scatter": "Estimated against true parameters, first listed setting of each back-end and "
    "first level of every swept factor. Triangles: outside the frame; crosses: failures.",
    "dual-certificate": "The proof of optimality of the gridless group-LASSO, η(k) = |Z(k)'R|/(m "
    "alpha) of its residual R: at most 1 everywhere, 1 at the scales it chose. First flight, "
    "middle level of the other swept factors, computed again from the study file.",
}
STRIPS = (
    "every case a point, box the quartiles, line the 5th to 95th percentile, thick line the "
    "median; all levels of swept factors together"
)


def caption(entry: Entry) -> str:
    """Return what stands under a figure: what is drawn, and how a failure counts."""
    if isinstance(entry, str) and entry in CAPTIONS:
        return CAPTIONS[entry]
    asked = read_entry(entry, PRESETS, DRAWN)
    phrases = list(dict.fromkeys(one.phrase for one in asked.measures))
    words = _sentence("; ".join(phrases))
    if DRAWN[asked.compare] is strips:
        shares = asked.measure.summary == "share"
        band = f" Band: {min(asked.limits):g} to {max(asked.limits):g} %." if asked.limits else ""
        return f"{words}, with its 95 % Wilson interval.{band}" if shares else f"{words}: {STRIPS}."
    along = asked.along.rpartition(".")[2].replace("_", " ") if asked.along else "each swept number"
    quartiles = ", with quartiles" if asked.band or asked.along == "protocol" else ""
    first = "" if asked.settings == "every" else " First listed setting of each back-end."
    note = pooling_note(asked.measures)
    return f"{words}, along {along}{quartiles}.{first} Other swept factors are pooled. {note}"


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:]


def _styled(draw: FigureFunction) -> FigureFunction:
    """Draw in this package's style, whatever the user's own settings are."""

    def styled(study: Study, cases: pd.DataFrame, weights: pd.DataFrame | None) -> Figure:
        with mpl.rc_context():
            mpl.rcdefaults()
            mpl.rcParams.update(STYLE)
            figure = draw(study, cases, weights)
            # Laid out once: saving twice must not move anything.
            figure.draw_without_rendering()
            figure.set_layout_engine("none")
            return figure

    return styled


FIGURES: dict[str, FigureFunction] = {
    "weights": _styled(weights_figure),
    "scatter": _styled(scatter),
    "dual-certificate": _styled(certificate_figure),
    **{name: _styled(partial(DRAWN[asked.compare], replace(asked, name=name)))
       for name, asked in PRESETS.items()},
}  # fmt: skip


def read_figure(entry: Entry) -> tuple[str, FigureFunction]:
    """Return the file name of a figure that [outputs] asks for, and what draws it.

    Raises:
        InputError: for a name, measure or comparison that is not known.
    """
    if isinstance(entry, str):
        if entry not in FIGURES:
            raise unknown("figure", entry, FIGURES)
        return entry, FIGURES[entry]
    asked = read_entry(entry, PRESETS, DRAWN)
    return asked.file_name, _styled(partial(DRAWN[asked.compare], asked))


def figures_for(cases: pd.DataFrame, weights: pd.DataFrame | None) -> list[str]:
    """Return the names of the figures that have something to show of these cases."""
    single = cases["flight"].nunique() == 1
    shows = {
        "weights": weights is not None and not weights.empty,
        "scatter": not single and bool(in_a_flow(cases).any()),
        "errors": not single,
        "sweep": not single and bool(numeric_factors(cases)),
        "methods": not single and MEASUREMENT_NOISE in factors(cases),
        "scales": not single and has_any(cases, "scales-found") and bool(numeric_factors(cases)),
        "efficiency": _legible(cases),
        "windows": not single and many_levels(cases, DURATION),
        "coverage": has_any(cases, "length-scale-coverage"),
    }
    return [name for name, shown in shows.items() if shown]


def _legible(cases: pd.DataFrame) -> bool:
    """Whether there is a bound over a swept process noise, in no more rows than can be read."""
    if PROCESS_NOISE not in numeric_factors(cases) or not bounded(cases).any():
        return False
    rows = [name for name in factors(cases) if name != PROCESS_NOISE]
    return not rows or len(groups_by(cases, rows)) <= LEGIBLE
