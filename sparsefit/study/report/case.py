"""One case as a picture: its track over the flow found, its weights, residual and certificate.

The last panel is what the certificate is made of: how much of the residual R each candidate scale
could still explain, |Z_g'R|/m, in columns Z of unit rms. Of a penalised fit it stands in units of
the penalty, alpha omega_g: at most 1 everywhere, and 1 where there is a weight.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sparsefit.arrays import Array, IntArray
from sparsefit.regression.backend import PenalisedBackend
from sparsefit.regression.fit import Fit
from sparsefit.regression.objective import alpha_max
from sparsefit.study.evidence.cases import PARAMETERS, SYMBOLS, UNITS
from sparsefit.study.evidence.table import Column, Table, plain
from sparsefit.study.report.drawing import COLOURS, GREY, laid_out, logarithmic, panels
from sparsefit.study.report.flown import (
    Flown,
    draw_residual,
    draw_scales,
    draw_track,
    draw_weights,
)
from sparsefit.study.run.one_case import OneCase

if TYPE_CHECKING:
    from sparsefit.study.spec.study import Study

DIGITS = 6
CAPTION = (
    "The vorticity of the flow found, and the track over it; the weight of each candidate scale; "
    "what the flow found leaves of the velocity of the air; and what the candidates could still "
    "explain of the back-end's residual: at most 1, and 1 where there is a weight, if a penalised "
    "fit is optimal."
)
COMPARED = ("status", "reason", "doubt", "cause", "certificate_kind", "certificate",
            "grid_length_scale", "samples", "columns")  # fmt: skip


def case_figure(again: OneCase) -> Figure:
    """Draw the track over the estimated cells, the weights, the residual and the certificate."""
    return laid_out(lambda: _drawn(again))


def _drawn(again: OneCase) -> Figure:
    figure, ((track, weights), (residual, certificate)) = panels(2, 2, height=5.6)
    flown = flown_of(again)
    draw_track(track, flown)
    draw_weights(weights, flown)
    draw_residual(residual, flown)
    _certificate(certificate, again)
    return figure


def flown_of(again: OneCase) -> Flown:
    """Return what was flown and found in a case that was run again."""
    truth = tuple(part.length_scale for part in again.flow.cells) if again.flow else ()
    return Flown(
        again.flown, again.prepared.samples, again.prepared.flow_velocity, again.estimate, truth
    )


def _certificate(axes: Axes, again: OneCase) -> None:
    fit, certificate = again.fit, again.fit.certificate
    title = f"{certificate.kind} {certificate.value:.1e}" if certificate else "no certificate"
    axes.set_title(title.replace("_", " "))
    axes.set_xlabel("length scale [m]")
    if fit.problem.group_scales is None or not np.isfinite(fit.weights).all():
        axes.text(0.5, 0.5, fit.reason or "nothing to show", transform=axes.transAxes, ha="center",
                  wrap=True)  # fmt: skip
        return
    values, words = left_to_explain(fit)
    axes.plot(fit.problem.group_scales, values, "o-", ms=2.5, lw=0.8, color=COLOURS[0])
    axes.set_ylabel(words)
    if isinstance(fit.backend, PenalisedBackend):
        axes.axhline(1.0, color=GREY, lw=0.9)
        axes.set_ylim(0.0, None)
    elif (values > 0).all():
        axes.set_yscale("log")
        logarithmic(axes.yaxis, *axes.get_ylim())
    draw_scales(axes, flown_of(again))


def left_to_explain(fit: Fit) -> tuple[Array, str]:
    """Return how much of the residual each group's columns still explain (g,), and in what.

    |Z_g'R|/m in columns of unit rms: over the penalty where there is one, else over the rms of
    the target.
    """
    problem = fit.problem
    rms = np.sqrt(np.sum(np.square(problem.theta), axis=0) / problem.samples)
    scaled = problem.theta / rms
    cross = scaled.T @ problem.target / problem.samples
    share = scaled.T @ (problem.target - problem.theta @ fit.weights) / problem.samples
    backend = fit.backend
    if isinstance(backend, PenalisedBackend) and not isinstance(backend.alpha_fraction, str):
        penalty = backend.penalty(problem)
        if not penalty.smooth:
            alpha = backend.alpha_fraction * alpha_max(cross, penalty)
            if penalty.root:  # its slope in V is |R| / |Y| times that of half the square
                residual = problem.target - problem.theta @ fit.weights
                alpha *= float(np.linalg.norm(residual) / np.linalg.norm(problem.target))
            blocks = penalty.block_dual_norms(share).max(axis=-1) / alpha
            return _largest(blocks[penalty.groups], problem.groups), "|Z'R| / penalty"
    norm = float(np.sqrt(np.sum(np.square(problem.target)) / problem.samples)) or 1.0
    return _largest(np.linalg.norm(share, axis=1) / norm, problem.groups), "|Z'R| / |Y|"


def _largest(values: Array, groups: IntArray) -> Array:
    """The largest value of each group."""
    out = np.zeros(int(groups.max()) + 1)
    np.maximum.at(out, groups, values)
    return out


def case_table(study: Study, again: OneCase, stored: Mapping[str, object] | None) -> Table:
    """Return the numbers of the case run again beside the stored ones, where there are any."""
    now = again.values | {
        "status": again.estimate.status,
        "reason": again.estimate.reason or "",
    }
    truth = again.flow.cells[0] if again.flow else None
    rows: list[tuple[str, str, str, str]] = []
    for name in PARAMETERS:
        label = f"{SYMBOLS[name]} [{UNITS[name]}]"
        true = text_of(getattr(truth, name)) if truth else "–"
        for prefix, words in (("est", ""), ("low", ", from"), ("high", ", to")):
            key = f"{prefix}_{name}"
            told = true if prefix == "est" else ""
            rows.append((f"{label}{words}", told, _stored(stored, key), text_of(now[key])))
    rows += [
        (name.replace("_", " "), "", _stored(stored, name), text_of(now[name])) for name in COMPARED
    ]
    heads = tuple(Column(name, align="left") for name in ("what", "truth", "stored", "run again"))
    case, cell = again.case, again.case.cell
    setting = ", ".join(f"{key}={value}" for key, value in cell.settings.items()) or "as it is"
    levels = "".join(f", {key} = {level}" for key, level in cell.levels.items())
    where = f"flight {case.flight}, {cell.protocol}, {cell.label} ({setting}){levels}"
    title = f"{study.name}, case {case.case_id}: {where}"
    return Table(title, heads, tuple(rows), tuple(_verdict(rows, stored)))


def _verdict(rows: list[tuple[str, str, str, str]], stored: object) -> list[str]:
    if stored is None:
        return ["The study holds no row of this case yet."]
    other = [what for what, _, before, now in rows if before != now and what != "certificate"]
    if other:
        return [f"Differs from what is stored: {', '.join(other)}."]
    return [f"As stored, to {DIGITS} digits."]


def _stored(stored: Mapping[str, object] | None, key: str) -> str:
    return "" if stored is None else text_of(stored.get(key))


def text_of(value: object) -> str:
    """Return a value of a row in words, numbers to six digits; a dash for none."""
    value = plain(value)
    if isinstance(value, float):
        return "–" if np.isnan(value) else f"{value:.{DIGITS}g}"
    return "–" if value in (None, "") else str(value)


def row_of(cases: pd.DataFrame, case_id: str) -> Mapping[str, object] | None:
    """Return the stored row of a case, None where there is none."""
    rows = cases[cases["case_id"] == case_id]
    return None if rows.empty else {str(name): rows[name].iloc[0] for name in rows}
