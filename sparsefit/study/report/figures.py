"""The figures of a study, by name: each is a pure function of the study and its cases."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import matplotlib as mpl
import pandas as pd
from matplotlib.figure import Figure

from sparsefit.study.evidence.confidence import has_intervals
from sparsefit.study.evidence.scale_sets import has_scales
from sparsefit.study.evidence.summary import StudyRecord, in_a_flow
from sparsefit.study.evidence.windows import many_durations
from sparsefit.study.report.certificate_figure import certificate_figure
from sparsefit.study.report.coverage_figure import coverage_figure
from sparsefit.study.report.drawing import STYLE
from sparsefit.study.report.efficiency_figure import efficiency_figure, legible
from sparsefit.study.report.error_figures import errors, numeric_factors, sweep
from sparsefit.study.report.grids_figure import grids_figure
from sparsefit.study.report.methods_figure import has_methods, methods_figure
from sparsefit.study.report.scales_figure import scales_figure
from sparsefit.study.report.scatter_figure import scatter
from sparsefit.study.report.weights_figure import weights_figure
from sparsefit.study.report.windows_figure import windows_figure

FigureFunction: TypeAlias = Callable[[StudyRecord, pd.DataFrame, pd.DataFrame | None], Figure]


def _styled(draw: FigureFunction) -> FigureFunction:
    """Draw in this package's style, whatever the user's own settings are."""

    def styled(study: StudyRecord, cases: pd.DataFrame, weights: pd.DataFrame | None) -> Figure:
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
    "errors": _styled(errors),
    "sweep": _styled(sweep),
    "methods": _styled(methods_figure),
    "scales": _styled(scales_figure),
    "dual-certificate": _styled(certificate_figure),
    "efficiency": _styled(efficiency_figure),
    "windows": _styled(windows_figure),
    "coverage": _styled(coverage_figure),
    "grids": _styled(grids_figure),
}
CAPTIONS = {
    "weights": "Weight of every candidate length scale, first flight, first listed setting of "
    "each back-end.",
    "scatter": "Estimated against true parameters, first listed setting of each back-end and "
    "first level of every swept factor. Triangles: outside the frame; crosses: failures.",
    "errors": "Sizes of the percentage errors: every case a point, box the quartiles, line the "
    "5th to 95th percentile, thick line the median; all levels of swept factors together.",
    "sweep": "Median size of the percentage error and its quartiles against each swept number, "
    "first listed setting of each back-end. A failure counts as an infinite error: where half "
    "the cases fail, the line stops. Other swept factors are pooled.",
    "methods": "Median size of the percentage error of τ_w against the measurement noise, a line "
    "per protocol, a column per back-end and setting. A failure counts as an infinite error: where "
    "half the flights fail, the line stops.",
    "scales": "Share of the planned flights in which every superposed flow's length scale comes "
    "out within 1 %, first listed setting of each back-end. Cells: extent over the largest true "
    "length scale, median. Lines are set apart a little sideways; other swept factors are pooled.",
    "dual-certificate": "The proof of optimality of the gridless group-LASSO, η(k) = |Z(k)'R|/(m "
    "alpha) of its residual R: at most 1 everywhere, 1 at the scales it chose. First flight, "
    "middle level of the other swept factors, computed again from the study file.",
    "efficiency": "Rms error of L_w with the Cramér-Rao bound, and rms of error / bound, against "
    "the process noise, over flights with status ok, the bound over those that every line called "
    "ok; a row per combination of the other swept factors. First listed setting of each back-end. "
    "Lines that agree lie on each other.",
    "windows": "Largest of the errors of U0, L_w and τ_w that the median flight, and 9 in 10 "
    "flights, keep after so many seconds; other swept factors are pooled. A failure counts as "
    "infinite: where the flight that a line stands for has no estimate, the line breaks.",
    "coverage": "Share of the flights with status ok whose 95 % interval holds the truth, with "
    "its 95 % Wilson interval. Band: 93 to 97 %.",
    "grids": "Median size of the error of L_w and its quartiles on each grid, without and with "
    "refinement off the grid; other swept factors are pooled. A failure counts as infinite.",
}


def figures_for(cases: pd.DataFrame, weights: pd.DataFrame | None) -> list[str]:
    """Return the names of the figures that have something to show of these cases."""
    single = cases["flight"].nunique() == 1
    shows = {
        "weights": weights is not None and not weights.empty,
        "scatter": not single and bool(in_a_flow(cases).any()),
        "errors": not single,
        "sweep": not single and bool(numeric_factors(cases)),
        "methods": not single and has_methods(cases),
        "scales": not single and has_scales(cases) and bool(numeric_factors(cases)),
        "dual-certificate": False,  # it repeats a fit: for studies that ask for it
        "efficiency": legible(cases),
        "windows": not single and many_durations(cases),
        "coverage": has_intervals(cases),
        "grids": False,  # its protocols have to be grids, which only the study's author knows
    }
    return [name for name in FIGURES if shows[name]]
