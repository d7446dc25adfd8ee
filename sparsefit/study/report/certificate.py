"""The dual certificate of the gridless group-LASSO: eta(k) over the whole interval."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sparsefit.arrays import Array
from sparsefit.backends.continuous_dual import Scanner
from sparsefit.backends.gridless import GridlessGroupLasso
from sparsefit.errors import InputError
from sparsefit.flight.flow import Flow
from sparsefit.library.scan import CellScan, extent_of
from sparsefit.study.evidence.asked import Asked
from sparsefit.study.report.drawing import COLOURS, GREY, legend, panels
from sparsefit.study.spec.design import Cell
from sparsefit.study.spec.draw import SIMULATION, stream
from sparsefit.study.spec.study import Study

FLIGHT = 0
PANELS = 4
ALONG = "flights.duration"
TICKS = (0.5, 0.75, 1, 1.5, 2, 3, 4, 6, 12, 25, 50)  # m
HAIR = 2e-3  # the scan may end this far inside the interval


@dataclass(frozen=True, eq=False)
class Curve:
    """eta (q,) at length scales (q,) [m]; the atoms [m] with their |V|; the true flow."""

    length_scale: Array
    eta: Array
    atoms: Array
    sizes: Array
    flow: Flow
    title: str


def certificate_figure(
    _: Asked, study: Study, cases: pd.DataFrame, weights: object = None
) -> Figure:
    """Draw eta(k) of the first flight, computed again from the study file.

    A panel per duration, where it is swept; the middle level of every other factor.

    Raises:
        InputError: if the study has no gridless back-end, or it found nothing on this flight.
    """
    chosen = _chosen(study)
    if not chosen:
        raise InputError(
            f"{study.name} lists no {GridlessGroupLasso.name}: "
            'drop the figure "dual-certificate" from [outputs]'
        )
    curves = [_curve(study, cell) for cell in chosen]
    figure, grid = panels(len(curves), 1, height=0.8 + 1.55 * len(curves))
    for curve, (axes,) in zip(curves, grid, strict=True):
        _panel(axes, curve)
    for (axes,) in grid[:-1]:
        axes.tick_params(labelbottom=False)
    grid[-1][0].set_xlabel("length scale [m], uniform in wavenumber")
    legend(figure, grid[0])
    return figure


def _chosen(study: Study) -> list[Cell]:
    """The first gridless cell of every duration; of other factors the middle level."""
    middle = {f.key: f.levels[len(f.levels) // 2] for f in study.sweep if f.key != ALONG}
    found: dict[object, Cell] = {}
    for cell in study.cells:
        fixed = all(cell.levels[key] == level for key, level in middle.items())
        if cell.backend == GridlessGroupLasso.name and fixed:
            found.setdefault(cell.levels.get(ALONG), cell)
    return list(found.values())[:PANELS]


def _curve(study: Study, cell: Cell) -> Curve:
    draw = study.draw(FLIGHT, cell)
    fleet = draw.fleet(stream(study.seed, FLIGHT, SIMULATION))
    if draw.flow is None:
        raise InputError(f"{study.name}: no certificate to draw: its first flight has no flow")
    estimator = study.estimator(cell)
    prepared = estimator.prepare([replace(flown, flow=None) for flown in fleet])
    found = estimator.fit(prepared)
    continuum, target = found.problem.continuum, found.problem.target
    scales = found.problem.group_scales
    if continuum is None or scales is None or not np.isfinite(found.weights).all():
        raise InputError(f"{study.name}: no certificate to draw: {found.status}: {found.reason}")
    rms = np.sqrt(np.mean(found.problem.theta**2, axis=0))[:, None]
    sizes = np.sqrt(np.sum((found.weights * rms).reshape(len(scales), -1) ** 2, axis=1))
    backend = found.backend
    assert isinstance(backend, GridlessGroupLasso)
    scanner = Scanner.of(continuum, continuum.interval(backend.lower, backend.upper))
    assert isinstance(scanner.scan, CellScan)
    residual = target - found.problem.theta @ found.weights
    alpha = backend.alpha_fraction * scanner.peaks(target)[0].height
    largest = max(part.length_scale for part in draw.flow.cells)
    return Curve(
        math.pi / scanner.scan.wavenumbers,
        scanner.scan.heights(residual) / alpha,
        scales[sizes > 0],
        sizes[sizes > 0],
        draw.flow,
        f"{fleet[0].duration:g} s, {extent_of(prepared.samples.position) / largest:.0f} cells",
    )


def _panel(axes: Axes, curve: Curve) -> None:
    axes.set_xscale("function", functions=(_wavenumber, _wavenumber))
    for place, part in enumerate(curve.flow.cells):
        axes.axvline(
            part.length_scale, color=COLOURS[1], ls=(0, (4, 2)), lw=1.0,
            label="true length scale" if place == 0 else None,
        )  # fmt: skip
    axes.axhline(1.0, color=GREY, lw=0.8)
    axes.plot(curve.length_scale, curve.eta, color=COLOURS[0], lw=0.8, label="η(k)")
    axes.scatter(
        curve.atoms, np.ones(len(curve.atoms)), s=12 + 60 * curve.sizes / curve.sizes.max(),
        color=COLOURS[2], zorder=4, label="scales chosen, area by weight", clip_on=False,
    )  # fmt: skip
    axes.set_ylim(0, 1.15)
    axes.set_xlim(float(curve.length_scale.max()), float(curve.length_scale.min()))
    low, high = curve.length_scale.min() * (1 - HAIR), curve.length_scale.max() * (1 + HAIR)
    ticks = [scale for scale in TICKS if low <= scale <= high]
    axes.set_xticks(ticks, [f"{scale:g}" for scale in ticks])
    axes.minorticks_off()
    axes.set_ylabel("η")
    axes.set_title(curve.title, loc="left")


def _wavenumber(scale: Array) -> Array:
    """Pi / L, its own inverse."""
    return np.pi / np.maximum(scale, 1e-9)
