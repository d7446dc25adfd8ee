"""The certificate of a wave library as a map of the plane: eta, the waves chosen, the true ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import AxesImage

from sparsefit.arrays import Array
from sparsefit.errors import InputError
from sparsefit.estimator.certificate_map import CertificateMap, certificate_map
from sparsefit.flight.flow import Flow
from sparsefit.study.evidence.asked import Asked
from sparsefit.study.report.drawing import COLOURS, legend, panels
from sparsefit.study.spec.design import Cell
from sparsefit.study.spec.draw import SIMULATION, Draw, stream
from sparsefit.study.spec.logs import Logged
from sparsefit.study.spec.study import Study

FLIGHT = 0
PANELS = 2
BACKEND = "group-lasso"
SHADES = "cividis"  # told apart with every common colour vision, and in grey


def plane_figure(_: Asked, study: Study, cases: pd.DataFrame, weights: object = None) -> Figure:
    """Draw eta over the plane for the first flight, computed again from the study file.

    A panel for each of the first two worlds in which group-lasso runs on a wave library.

    Raises:
        InputError: if none does.
    """
    chosen = _chosen(study)
    if not chosen:
        raise InputError(
            f"{study.name} runs no {BACKEND} on waves in groups by wave: "
            'drop the figure "plane-certificate" from [outputs]'
        )
    figure, (row,) = panels(1, len(chosen), height=3.9)
    flown = [(cell, study.draw(FLIGHT, cell)) for cell in chosen]
    maps = [_map(study, cell, draw) for cell, draw in flown]
    top = max(1.0, *(shown.highest for shown in maps))
    for axes, shown, (cell, draw) in zip(row, maps, flown, strict=True):
        shades = _panel(axes, shown, _true_waves(draw.flow), top)
        axes.set_title(cell.protocol, loc="left")
    figure.colorbar(shades, ax=row, label="η", shrink=0.8)
    legend(figure, row)
    return figure


def _map(study: Study, cell: Cell, draw: Draw | Logged) -> CertificateMap:
    flown = replace(draw.fly(stream(study.seed, FLIGHT, SIMULATION)), flow=None)
    return certificate_map(study.estimator(cell), flown)


def _chosen(study: Study) -> list[Cell]:
    """The first cell of group-lasso on waves of every world: of flights and their library."""
    found: list[Cell] = []
    for cell in study.cells:
        library = cell.setup.library
        wanted = (cell.backend, library.family, library.groups) == (BACKEND, "waves", "wave")
        worlds = [(other.setup.flights, other.setup.library) for other in found]
        if wanted and (cell.setup.flights, library) not in worlds:
            found.append(cell)
    return found[:PANELS]


def _true_waves(flow: Flow | None) -> Array:
    """The wavevectors (w, 2) [1/m] of the cells of a flow."""
    waves = [part.waves.wavevectors for part in flow.cells] if flow else []
    return np.concatenate(waves) if waves else np.zeros((0, 2))


def _panel(axes: Axes, shown: CertificateMap, truth: Array, top: float) -> AxesImage:
    edge = float(shown.axis[-1])
    shades = axes.imshow(
        shown.eta.T, origin="lower", extent=(-edge, edge, -edge, edge), cmap=SHADES, vmin=0.0,
        vmax=top, interpolation="nearest",
    )  # fmt: skip
    if shown.highest > 1.0:
        axes.contour(shown.axis, shown.axis, shown.eta.T, levels=[1.0], colors="white",
                     linewidths=0.7)  # fmt: skip
    both, sizes = _both(shown.wavevectors), np.tile(shown.strengths, 2)
    axes.scatter(
        both[:, 0], both[:, 1], s=6 + 60 * sizes / sizes.max(), facecolors="none",
        edgecolors=COLOURS[1], linewidths=1.1, label="waves chosen, area by strength",
    )  # fmt: skip
    true = _both(truth)
    axes.scatter(
        true[:, 0], true[:, 1], marker="+", s=40, c="black", linewidths=1.0, label="true waves"
    )
    axes.set_aspect("equal")
    axes.grid(False)
    axes.set_xlabel("k_x [1/m]")
    axes.set_ylabel("k_y [1/m]")
    return shades


def _both(waves: Array) -> Array:
    """Waves k and -k, which are the same."""
    return np.concatenate([waves, -waves])
