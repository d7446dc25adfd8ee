"""Fits and paths for people: frames of pandas, a picture of a path, tables of a notebook.

The arguments are a `Fit` and a `Path` of `answer`, whose methods call these functions.
"""

from __future__ import annotations

import html
import math
from typing import TYPE_CHECKING, Any

import numpy as np

from sparsefit.arrays import Array
from sparsefit.errors import InputError

if TYPE_CHECKING:
    import pandas as pd

LABELLED = 10  # curves of a picture that a legend names
ROWS = 30  # of a notebook's table


def frame_of_fit(fit: Any) -> pd.DataFrame:
    """Weights (k, n) with a row per column of theta and a column per target, by their names."""
    import pandas as pd

    problem = fit.problem
    return pd.DataFrame(fit.weights, index=pd.Index(problem.names, name="column"),
                        columns=list(problem.target_names))  # fmt: skip


def frame_of_path(path: Any) -> pd.DataFrame:
    """Weights with a row per penalty, by alpha_fraction and alpha, and the columns of theta.

    Of several targets the columns are pairs (target, column).
    """
    import pandas as pd

    problem = path.fits[0].problem
    index = pd.MultiIndex.from_arrays(
        [path.alpha_fractions, path.alphas], names=["alpha_fraction", "alpha"]
    )
    columns: pd.Index = pd.Index(problem.names, name="column")
    if problem.targets > 1:
        pairs = [problem.target_names, problem.names]
        columns = pd.MultiIndex.from_product(pairs, names=["target", "column"])
    flat = path.weights.transpose(0, 2, 1).reshape(len(path.fits), -1)
    return pd.DataFrame(flat, index=index, columns=columns)


def plot_path(path: Any, axes: Any = None) -> Any:
    """Weights in columns of unit rms over the penalty, on axes of matplotlib, which it returns.

    The largest have a name in the legend; points whose certificate is above its tolerance have
    a mark.
    """
    from matplotlib import pyplot

    axes = pyplot.gca() if axes is None else axes
    problem = path.fits[0].problem
    scaled = path.weights * problem.design.rms[:, None]
    order = np.argsort(path.alpha_fractions)
    curves = [(j, t) for j, t in np.ndindex(scaled.shape[1:]) if np.any(scaled[:, j, t])]
    curves.sort(key=lambda curve: -float(np.nanmax(np.abs(scaled[:, curve[0], curve[1]]))))
    for number, (j, t) in enumerate(curves):
        name = problem.names[j] + (f" of {problem.target_names[t]}" if problem.targets > 1 else "")
        label = name if number < LABELLED else None
        axes.plot(path.alpha_fractions[order], scaled[order, j, t], label=label, linewidth=1.0)
    doubtful = [f for f, fit in zip(path.alpha_fractions, path.fits, strict=True)
                if fit.status != "ok"]  # fmt: skip
    if doubtful:
        axes.plot(doubtful, np.zeros(len(doubtful)), "kx", label="not certified")
    axes.set_xscale("log")
    axes.invert_xaxis()
    axes.set_xlabel(r"$\alpha / \alpha_\mathrm{max}$")
    axes.set_ylabel("weight, column of unit rms")
    if curves or doubtful:
        axes.legend(fontsize="small", frameon=False)
    return axes


def html_of_fit(fit: Any) -> str:
    """A heading and the weights that are not zero, the largest first, as HTML."""
    certificate = fit.certificate
    proof = (
        "no certificate" if certificate is None else f"{certificate.kind} {certificate.value:.1e}"
    )
    penalty = "" if math.isnan(fit.alpha) else f", alpha {fit.alpha:.4g}"
    support = fit.support
    words = (
        f"{fit.backend!r}{penalty}: {fit.status} ({proof}), {len(support)} of {fit.columns} columns"
    )
    if fit.reason:
        words += f"; {fit.reason}"
    size = np.abs(fit.weights[support] * fit.problem.design.rms[support, None]).max(axis=1)
    shown = support[np.argsort(-size)][:ROWS]
    table = frame_of_fit(fit).iloc[shown].to_html(float_format="{:.6g}".format)
    more = f"<p>and {len(support) - ROWS} more</p>" if len(support) > ROWS else ""
    return f"<p>{html.escape(words)}</p>{table}{more}"


def html_of_path(path: Any) -> str:
    """A row per penalty: its size, columns in use, status and certificate, as HTML."""
    import pandas as pd

    table = pd.DataFrame(
        {
            "alpha_fraction": path.alpha_fractions,
            "alpha": path.alphas,
            "columns": [len(fit.support) for fit in path.fits],
            "status": [fit.status for fit in path.fits],
            "certificate": path.gaps,
        }
    )
    words = f"{path.fits[0].backend.name}, {len(path.fits)} penalties, {path.seconds:.2g} s"
    return f"<p>{html.escape(words)}</p>{table.to_html(float_format='{:.4g}'.format, index=False)}"


def predicted(fit: Any, theta: Any) -> Array:
    """theta W and the intercept for theta (r, k): (r,) of one target, (r, n)."""
    values = getattr(theta, "to_numpy", lambda: theta)()
    rows = values if hasattr(values, "tocsr") else np.atleast_2d(np.asarray(values, dtype=float))
    if rows.shape[1] != fit.columns:
        raise InputError(f"predict needs {fit.columns} columns, not {rows.shape[1]}")
    predicted: Array = np.asarray(rows @ fit.weights) + fit.problem.intercept_of(fit.weights)
    return predicted[:, 0] if predicted.shape[1] == 1 else predicted
