"""A path of fits as a picture: the weight of every column or group along the penalty."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from sparsefit.arrays import Array
from sparsefit.plot.style import COLOURS, GREY, STYLES, labels, legend, logarithmic, panels, styled

NAMED = 10  # columns with the largest weights, which the legend names
LETTERS = 30  # of a name in the legend


def draw_path(alphas: Array, weights: Array, names: Sequence[str] = ()) -> Figure:
    """Return the size of the weights along a path of penalties.

    Args:
        alphas: (p,) penalties, or shares of alpha_max; weights: (p, k) in scaled columns, or
            (p, k, n), of which the norm over the targets is drawn.
        names: of the k columns; their places where they are not given.
    """

    def draw() -> Figure:
        sizes = weights if weights.ndim == 2 else np.linalg.norm(weights, axis=2)
        figure, ((axes,),) = panels(1, 1, height=4.0)
        titles = list(names) or [f"column {place}" for place in range(sizes.shape[1])]
        order = np.argsort(-np.abs(sizes).max(axis=0), kind="stable")
        short = labels([titles[at] for at in order[:NAMED]], LETTERS)
        for rank, at in enumerate(order[np.abs(sizes[:, order]).max(axis=0) > 0].tolist()):
            named = rank < NAMED
            axes.plot(
                alphas, sizes[:, at], lw=1.2 if named else 0.5,
                color=COLOURS[rank % len(COLOURS)] if named else GREY,
                ls=STYLES[rank // len(COLOURS) % len(STYLES)] if named else "-",
                label=short[titles[at]] if named else None, zorder=3 if named else 2,
            )  # fmt: skip
        axes.set_xscale("log")
        axes.set_xlim(float(alphas.max()), float(alphas.min()))
        logarithmic(axes.xaxis, float(alphas.min()), float(alphas.max()))
        axes.set_xlabel("penalty, as a share of the smallest that gives zero")
        axes.set_ylabel("weight in columns of unit rms")
        legend(figure, [axes])
        return figure

    return styled(draw)
