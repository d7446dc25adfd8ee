"""The figures of a study, by name: each is a pure function of the study and its cases.

A figure of a study's own names its measures and a comparison of `FIGURES` that is drawn.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, TypeAlias

import pandas as pd
from matplotlib.figure import Figure

from sparsefit.study.evidence.along import words_of
from sparsefit.study.evidence.asked import DURATION, MEASUREMENT_NOISE, Asked, Kind
from sparsefit.study.evidence.cases import factors, groups_by, in_a_flow, numeric_factors
from sparsefit.study.evidence.measure import Failure, Measure
from sparsefit.study.evidence.measures import names
from sparsefit.study.evidence.readings import bounded
from sparsefit.study.evidence.sentence import capital
from sparsefit.study.evidence.tables import has_any, many_levels
from sparsefit.study.report.certificate import certificate_figure
from sparsefit.study.report.drawing import laid_out
from sparsefit.study.report.line_panels import OTHERS, SETTING
from sparsefit.study.report.lines import lines
from sparsefit.study.report.plane import plane_figure
from sparsefit.study.report.profiles import profiles
from sparsefit.study.report.scatter import scatter
from sparsefit.study.report.strips import strips
from sparsefit.study.report.weights import weights_figure

if TYPE_CHECKING:
    from sparsefit.study.spec.study import Study

Draw: TypeAlias = Callable[[Asked, "Study", pd.DataFrame, pd.DataFrame | None], Figure]
PROCESS_NOISE = "flights.process_noise"
LEGIBLE = 8  # rows: with more, nobody reads the picture unless the study asks for it
ERRORS = names("error")[::-1]  # tau_w, L_w and U0: what the paper is after first
CAPTIONS = {  # of comparisons that draw no measure
    "weights": "Weight of every candidate length scale, first flight, first listed setting of "
    "each back-end.",
    "scatter": "Estimated against true parameters, first listed setting of each back-end and "
    "first level of every swept factor. Triangles: outside the frame; crosses: failures.",
    "dual-certificate": "The proof of optimality of the gridless group-LASSO, η(k) = |Z(k)'R|/(m "
    "alpha) of its residual R: at most 1 everywhere, 1 at the scales it chose. First flight, "
    "middle level of the other swept factors, computed again from the study file.",
    "plane-certificate": "The certificate of the group-LASSO of waves over the plane, η(k) = "
    "|Z(k)'R|/(m alpha) of its residual R: at most 1 at every wave of its grid; within the white "
    "lines, above 1, a finer grid would put a wave. First flight, computed again from the study "
    "file.",
}
PROFILES = "The higher the better; swept levels of the flights are pooled."
STRIPS = (
    "every case a point, box the quartiles, line the 5th to 95th percentile, thick line the "
    "median; all levels of swept factors together"
)


def _styled(draw: Draw) -> Draw:
    """Draw in this package's style, whatever the user's own settings are."""

    def styled(
        asked: Asked, study: Study, cases: pd.DataFrame, weights: pd.DataFrame | None
    ) -> Figure:
        return laid_out(lambda: draw(asked, study, cases, weights))

    return styled


FIGURES: Kind[Figure] = Kind(
    "figure",
    {  # `settings` is a row per setting
        "settings": _styled(strips),
        "protocols": _styled(lines),
        "until": _styled(lines),
        "weights": _styled(weights_figure),
        "scatter": _styled(scatter),
        "dual-certificate": _styled(certificate_figure),
        "plane-certificate": _styled(plane_figure),
        "profiles": _styled(profiles),
    },
    {
        **{name: {"compare": name} for name in CAPTIONS},
        "errors": {"measure": ERRORS},
        "profiles": {"compare": "profiles", "measure": "timescale-error"},
        "coverage": {
            "limits": (93.0, 97.0),
            "measure": ("length-scale-coverage", "mean-velocity-coverage", "timescale-coverage"),
        },
        "sweep": {"compare": "protocols", "over": "setting", "measure": ERRORS, "band": True},
        "methods": {
            "compare": "protocols", "measure": "timescale-error", "along": MEASUREMENT_NOISE,
            "columns": SETTING, "settings": "every", "rows": OTHERS,
        },
        "scales": {"compare": "protocols", "over": "setting", "measure": "scales-found"},
        "efficiency": {
            "compare": "protocols", "over": "setting", "along": PROCESS_NOISE, "rows": OTHERS,
            "measure": ("length-scale-bounded-error", "length-scale-efficiency",
                        "mean-velocity-efficiency"),
        },
        "windows": {
            "compare": "until", "over": "setting", "along": DURATION, "limits": (5.0, 1.0),
            "measure": ("median largest-error", "9 of 10 largest-error"),
        },
        "grids": {
            "compare": "protocols", "over": "setting", "along": "protocol",
            "columns": "readout.refine", "measure": "length-scale-error",
        },
    },
)  # fmt: skip


def caption(asked: Asked) -> str:
    """Return what stands under a figure: what is drawn, and how a failure counts."""
    if asked.compare in CAPTIONS:
        return CAPTIONS[asked.compare]
    words = capital("; ".join(dict.fromkeys(one.phrase for one in asked.measures)))
    if asked.compare == "settings":
        shares = asked.first.summary == "share"
        band = f" Band: {min(asked.limits):g} to {max(asked.limits):g} %." if asked.limits else ""
        return f"{words}, with its 95 % Wilson interval.{band}" if shares else f"{words}: {STRIPS}."
    if asked.compare == "profiles":
        named = "; ".join(dict.fromkeys(one.words for one in asked.measures))
        return f"Share of flights with at most so much: {named}. A failure is a miss. {PROFILES}"
    along = words_of(asked.along) if asked.along else "each swept number"
    quartiles = ", with quartiles" if asked.band or asked.along == "protocol" else ""
    first = "" if asked.settings == "every" else " First listed setting of each back-end."
    note = _pooling_note(asked.measures)
    return f"{words}, along {along}{quartiles}.{first} Other swept factors are pooled. {note}"


def _pooling_note(measures: Sequence[Measure]) -> str:
    """How failures count in a picture of these measures, in a sentence."""
    said = {
        Failure.INFINITE: "A failure counts as infinite: where it decides, the line breaks; what "
        "has no point has no answer.",
        Failure.MISS: "A failure counts as a miss.",
        Failure.LEFT_OUT: "Failures are left out; their number is in the tables.",
    }
    return " ".join(dict.fromkeys(said[one.failure] for one in measures))


def figures_for(cases: pd.DataFrame, weights: pd.DataFrame | None) -> list[str]:
    """Return the names of the figures that have something to show of these cases."""
    single = cases["flight"].nunique() == 1
    several = not single and has_any(cases, "timescale-error")
    shows = {
        "weights": weights is not None and not weights.empty,
        "scatter": not single and bool(in_a_flow(cases).any()),
        "errors": not single,
        "sweep": several and bool(numeric_factors(cases)),
        "methods": several and MEASUREMENT_NOISE in factors(cases),
        "scales": not single and has_any(cases, "scales-found") and bool(numeric_factors(cases)),
        "efficiency": _legible(cases),
        "windows": several and many_levels(cases, DURATION),
        "coverage": has_any(cases, "length-scale-coverage"),
    }
    return [name for name, shown in shows.items() if shown]


def _legible(cases: pd.DataFrame) -> bool:
    """Whether there is a bound over a swept process noise, in no more rows than can be read."""
    if PROCESS_NOISE not in numeric_factors(cases) or not bounded(cases).any():
        return False
    rows = [name for name in factors(cases) if name != PROCESS_NOISE]
    return not rows or len(groups_by(cases, rows)) <= LEGIBLE
