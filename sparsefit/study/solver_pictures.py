"""Pictures of solvers: performance profiles, times by shape, time against accuracy."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from sparsefit.plot.style import GREY, labels, legend, logarithmic, panels, wrapped
from sparsefit.study import solver_times
from sparsefit.study.curves import PANELS, Looks
from sparsefit.study.entries import Entry, grouped

FLOOR = 1e-16  # an excess below it is drawn there


def solver_profiles(entry: Entry, cases: pd.DataFrame) -> Figure | None:
    """Draw the share of problems solved in at most so many times the fastest solver's time.

    A row per objective, a column per accuracy (Dolan and More, 2002).
    """
    levels, rows = solver_times.accuracies(cases), solver_times.objectives(cases)[:PANELS]
    figure, grid = panels(len(rows), len(levels), height=1.2 + 2.0 * len(rows))
    looks = Looks(_ranked(cases))
    for objective, row in zip(rows, grid, strict=True):
        for level, axes in zip(levels, row, strict=True):
            times = solver_times.times_to(cases, objective, level)
            ratios = times.ratios
            finite = ratios[np.isfinite(ratios)]
            end = max(float(finite.max(initial=1.0)) * 1.5, 10.0)
            for place in reversed(times.order):
                inside = np.sort(ratios[np.isfinite(ratios[:, place]), place])
                if not inside.size:
                    continue
                x = np.concatenate([[1.0], inside, [end]])
                share = np.arange(len(inside) + 1) / len(ratios)
                name = times.solvers[place]
                axes.plot(x, np.append(share, share[-1]), drawstyle="steps-post",
                          gid=looks.gid(name), label=looks.label(name),
                          **(looks.of(name) | {"marker": ""}))  # fmt: skip
            axes.set_xscale("log")
            axes.set_xlim(1.0, end)
            logarithmic(axes.xaxis, 1.0, end)
            axes.set_ylim(-0.03, 1.03)
            axes.set_title(f"to {solver_times.level_text(level)}")
            axes.tick_params(labelleft=level == levels[0])
        row[0].set_ylabel(f"{wrapped(objective, 26)}\n\nshare of problems")
    for axes in grid[-1]:
        axes.set_xlabel("times the fastest")
    legend(figure, [axes for row in grid for axes in row])
    return figure


def _ranked(cases: pd.DataFrame) -> list[str]:
    """Return the solvers by their place in the objectives, the fastest first."""
    strict, ranks = solver_times.accuracies(cases)[-1], dict[str, int]()
    for objective in solver_times.objectives(cases):
        times = solver_times.times_to(cases, objective, strict)
        for rank, place in enumerate(times.order):
            name = times.solvers[place]
            ranks[name] = min(ranks.get(name, rank), rank)
    return sorted(ranks, key=lambda name: ranks[name])


def solver_accuracy(entry: Entry, cases: pd.DataFrame) -> Figure | None:
    """Draw the time of every case against the certified excess of its worst point."""
    rows = solver_times.objectives(cases)[:PANELS]
    across = min(len(rows), 2)
    figure, grid = panels(
        -(-len(rows) // across), across, height=1.0 + 2.5 * -(-len(rows) // across)
    )
    looks = Looks(_ranked(cases))
    every = [axes for row in grid for axes in row]
    for objective, axes in zip(rows, every, strict=False):
        here = cases[cases["objective"].eq(objective) & cases["excess"].notna()]
        axes.set_xscale("log")
        axes.set_yscale("log")
        for level in solver_times.accuracies(cases):
            axes.axhline(level, color=GREY, lw=0.6, ls=":")
        for (name,), places in grouped(here, ["solver"]):
            look = looks.of(str(name)) | {"ls": ""}
            look["marker"] = look["marker"] or "."
            axes.plot(
                here[solver_times.TIME].to_numpy(float)[places],
                np.clip(here["excess"].to_numpy(float)[places], FLOOR, 1.0), ms=3.0, mew=0,
                gid=looks.gid(str(name)), label=looks.label(str(name)), **look,
            )  # fmt: skip
        axes.set_ylim(0.3 * FLOOR, 3.0)
        logarithmic(axes.xaxis, *axes.get_xlim())
        logarithmic(axes.yaxis, *axes.get_ylim())
        axes.set_title(objective)
        axes.set_xlabel("time on the wall [s]")
    for axes in every[len(rows) :]:
        axes.set_visible(False)
    for row in grid:
        row[0].set_ylabel("certified excess")
    legend(figure, every[: len(rows)])
    return figure


def by_shape(entry: Entry, cases: pd.DataFrame) -> Figure | None:
    """Draw the time to the strictest accuracy of every solver, problem by problem, by objective."""
    strict, rows = solver_times.accuracies(cases)[-1], solver_times.objectives(cases)[:PANELS]
    figure, grid = panels(len(rows), 1, height=1.6 + 2.2 * len(rows))
    looks = Looks(_ranked(cases))
    for objective, (axes,) in zip(rows, grid, strict=True):
        times = solver_times.times_to(cases, objective, strict)
        for place in times.order:
            name = times.solvers[place]
            seconds = np.where(times.solved[:, place], times.seconds[:, place], np.nan)
            axes.plot(np.arange(len(seconds)), seconds, ms=3.0, mew=0, label=looks.label(name),
                      gid=looks.gid(name), **looks.of(name))  # fmt: skip
        axes.set_yscale("log")
        logarithmic(axes.yaxis, *axes.get_ylim())
        axes.set_ylabel(
            f"{wrapped(objective, 26)}\n\ntime to {solver_times.level_text(strict)} [s]"
        )
        axes.set_xticks(range(len(times.problems)), [""] * len(times.problems))
    short = labels(times.problems, 30)
    axes.set_xticks(range(len(short)), list(short.values()), rotation=40, ha="right",
                    rotation_mode="anchor")  # fmt: skip
    legend(figure, [axes for row in grid for axes in row])
    return figure
