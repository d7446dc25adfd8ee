import json
import math
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import matplotlib as mpl
import numpy as np
import pandas as pd
import pytest
from matplotlib.transforms import Bbox

from sparsefit.errors import InputError
from sparsefit.study import Study
from sparsefit.study.evidence.measures import MEASURES
from sparsefit.study.report import pages
from sparsefit.study.report.drawing import to_png, to_svg
from sparsefit.study.report.figures import FIGURES, caption, figures_for
from sparsefit.study.report.pages import render_show, write_report
from sparsefit.study.report.scatter import Frame, first_listed

BACKENDS = {"least-squares": 0.5, "lasso": 0.05, "a $name_{x}$ & 100 %": 0.02}


def study(**changes):
    return SimpleNamespace(
        **{
            "name": "demo",
            "question": "Which <back-end> reads it best?",
            "seed": 7,
            "hash": "ab" * 32,
            "planned": 0,
            "given": {"flights.response_time": "0.5", "flights.length_scale": '{"uniform":[2,10]}'},
            "tables": (),
            "figures": (),
            "answers": (),
            "reference": None,
            "path": "demo.toml",
            "count": 24,
            "validate_count": None,
            "protocols": (),
            "sweep": (),
            "backends": (),
            "cells": (),
            "tolerance": 1e-8,
            "case_timeout": 60.0,
        }
        | changes
    )


def synthetic(flights=24, levels=({},), protocols=("paper", "matched")):
    """Cases with heavy-tailed errors, and one failure in twelve."""
    rng = np.random.default_rng(3)
    scales = rng.uniform(2, 10, flights)
    rows = []
    for flight in range(flights):
        tau, scale = 0.05 + 0.95 * flight / max(flights - 1, 1), scales[flight]
        for protocol in protocols:
            for level in levels:
                for backend, size in BACKENDS.items():
                    for alpha in (0.1, 0.2):
                        failed = len(rows) % 12 == 5
                        error = size * rng.standard_t(2, 2)
                        speed, found = scale / tau * (1 + error[0]), scale * (1 + error[1])
                        estimate = (math.nan,) * 3 if failed else (speed, found, found / speed)
                        rows.append(
                            {
                                "case_id": f"{len(rows):05d}",
                                "flight": flight,
                                "split": "all",
                                "protocol": protocol,
                                "backend": backend,
                                "label": backend,
                                "settings": json.dumps({"alpha": alpha}),
                                "status": "error" if failed else "ok",
                                "true_mean_velocity": scale / tau,
                                "true_length_scale": scale,
                                "true_timescale": tau,
                                "est_mean_velocity": estimate[0],
                                "est_length_scale": estimate[1],
                                "est_timescale": estimate[2],
                                "grid_length_scale": math.nan if failed else round(found * 5) / 5,
                                "hit": None if failed else abs(error[1]) < 0.02,
                                "certificate_kind": "duality_gap",
                                "certificate": 1e-10,
                                "seconds": 0.01,
                                **level,
                            }
                        )
    return pd.DataFrame(rows)


def weights_of(cases):
    scales = np.arange(1.0, 12.01, 0.2)
    rows = [(name, scale, math.exp(-scale)) for name in cases["case_id"] for scale in scales]
    return pd.DataFrame(rows, columns=["case_id", "length_scale", "weight"])


LEVELS = tuple(
    {"flights.velocity_noise": noise, "library.target": target}
    for noise in (0.0, 0.1, 1.0)
    for target in ("a", "b")
)


NOISES = tuple(
    {"flights.measurement_noise": noise, "readout.refine": refine}
    for noise in ("[0,0]", "[0.05,0.01]", "[0.5,0.1]")
    for refine in ("none", "variable-projection")
)
SCALES = """
name = "two"
question = "?"
seed = 3
[flights]
count = 1
mean_velocity = 10.0
length_scale = 3.0
second_scale_ratio = 1.5
second_velocity_ratio = 0.8
response_time = 0.5
thrust_acceleration = [12.0, 7.0]
duration = 4.0
sample_rate = 50.0
[library]
lower = 2.0
upper = 6.0
[[backends]]
name = "gridless-group-lasso"
[sweep]
"flights.duration" = [2.0, 4.0]
"""

WAVES = """
name = "turned"
question = "?"
seed = 3
[flights]
count = 1
mean_velocity = 10.0
length_scale = 4.0
response_time = 0.5
thrust_acceleration = [5.0, 3.0]
duration = 4.0
sample_rate = 50.0
[library]
family = "waves"
lower = 3.0
upper = 6.0
[[backends]]
name = "group-lasso"
[[protocols]]
name = "straight"
[[protocols]]
name = "turned"
"flights.heading" = 0.4
"""
FLOWN = {"dual-certificate": SCALES, "plane-certificate": WAVES}


def with_scales(cases):
    """Half the flights found, each of two scales."""
    found = cases["flight"].to_numpy() % 2.0
    return cases.assign(
        scales_true=2.0, scales_within_1_percent=found, extent=100.0, true_scales="[[3,9],[5,4]]"
    )


PROCESS_NOISES = tuple(
    {"flights.process_noise": noise, "flights.duration": seconds}
    for noise in (0.1, 1.0, 10.0)
    for seconds in (5.0, 20.0)
)
DURATIONS = tuple({"flights.duration": seconds} for seconds in (1.0, 3.0, 10.0, 60.0))
REFINES = tuple({"readout.refine": refine} for refine in ("none", "variable-projection"))


def bounded(cases):
    """The cases with a bound of 1 %, and intervals of 5 % to either side."""
    columns = {}
    for name in ("mean_velocity", "length_scale", "timescale"):
        columns[f"bound_{name}"] = 0.01 * cases[f"true_{name}"]
        columns[f"low_{name}"] = 0.95 * cases[f"est_{name}"]
        columns[f"high_{name}"] = 1.05 * cases[f"est_{name}"]
    return cases.assign(**columns)


def flown(folder, text):
    """A study of which a figure repeats a fit."""
    path = folder / "flown.toml"
    path.write_text(text)
    return Study.load(path)


# What each figure is drawn of.
GIVEN = {
    "weights": lambda: synthetic(1).query("backend != 'least-squares'"),
    "scatter": lambda: synthetic(4).query("backend != 'least-squares'"),
    "dual-certificate": lambda: synthetic(1),
    "plane-certificate": lambda: synthetic(1),
    "errors": lambda: synthetic(4),
    "coverage": lambda: bounded(synthetic(4)),
    "sweep": lambda: synthetic(2, LEVELS, ("paper",)),
    "methods": lambda: synthetic(4, NOISES),
    "scales": lambda: with_scales(synthetic(4, LEVELS)),
    "efficiency": lambda: bounded(synthetic(2, PROCESS_NOISES, ("paper",))),
    "windows": lambda: synthetic(4, DURATIONS).query("backend != 'least-squares'"),
    "grids": lambda: synthetic(4, REFINES),
    "profiles": lambda: synthetic(4),
}


# One figure of each way to draw, the last that is named; that of settings is drawn twice below.
DRAWN = {FIGURES.read(name).compare: name for name in FIGURES.named}
AGAIN = [name for compare, name in DRAWN.items() if compare != "settings"]
EVERY = [
    name if name in DRAWN.values() else pytest.param(name, marks=pytest.mark.slow)
    for name in FIGURES.named
]


@cache
def drawn(name):
    return FIGURES.make(name, study(), GIVEN[name](), None)


@pytest.mark.parametrize("name", EVERY)
def test_a_figure_is_the_same_each_time_and_nothing_in_it_is_cut_or_covered(name, tmp_path):
    cases = GIVEN[name]()
    weights = weights_of(cases) if name == "weights" else None
    of = flown(tmp_path, FLOWN[name]) if name in FLOWN else study()
    simple = weights is None and name not in FLOWN
    first = drawn(name) if simple else FIGURES.make(name, of, cases, weights)
    svg = to_svg(first)
    if name in AGAIN:
        assert to_svg(FIGURES.make(name, of, cases, weights)) == svg
    assert b"<dc:date>" not in svg
    assert b"Matplotlib v" not in svg
    assert caption(FIGURES.read(name))
    panels = [axes.get_tightbbox() for axes in first.axes if axes.get_visible()]
    assert_apart(panels)
    beside = [artist.get_tightbbox() for artist in (*first.legends, *first.texts)]
    assert_within(first.bbox, Bbox.union([*panels, *beside]))


def assert_within(page, box):
    """No text is cut by the edge of the page."""
    assert box.x0 >= page.x0 - 2
    assert box.x1 <= page.x1 + 2
    assert box.y0 >= page.y0 - 2
    assert box.y1 <= page.y1 + 2


def assert_apart(boxes):
    """Panels and their labels do not overlap."""
    for place, one in enumerate(boxes):
        for other in boxes[place + 1 :]:
            wide = min(one.x1, other.x1) - max(one.x0, other.x0)
            high = min(one.y1, other.y1) - max(one.y0, other.y0)
            assert min(wide, high) < 3.0


def test_the_users_own_style_changes_nothing_and_is_left_alone():
    cases = synthetic(1, protocols=("paper",))
    figure = FIGURES.make("errors", study(), cases, None)
    plain = to_svg(figure)
    assert b"tEXt" not in to_png(figure)
    with mpl.rc_context({"font.size": 20.0, "axes.facecolor": "black", "lines.linewidth": 9}):
        assert to_svg(FIGURES.make("errors", study(), cases, None)) == plain
        assert mpl.rcParams["font.size"] == 20.0


class TestScatter:
    def test_the_frame_is_that_of_the_truth(self):
        assert Frame.around(np.array([0.05, 1.0])) == Frame(0.025, 2.0, True)
        assert Frame.around(np.array([2.0, 10.0])) == Frame(0.0, pytest.approx(12.4), False)
        assert Frame.around(np.array([4.0, 4.0])) == Frame(2.0, 6.0, False)

    def test_the_first_listed_setting_is_shown_not_the_best(self):
        cases = synthetic(4, LEVELS)
        groups = first_listed(cases)
        assert len(groups) == 2 * len(BACKENDS)
        assert {group.key["settings"] for group in groups} == {'{"alpha": 0.1}'}
        assert {group.key["flights.velocity_noise"] for group in groups} == {0.0}

    def test_every_case_is_a_point_a_triangle_or_a_cross(self):
        cases, figure = GIVEN["scatter"](), drawn("scatter")
        shown = {group.key["backend"]: 0 for group in first_listed(cases)}
        for group in first_listed(cases):
            shown[group.key["backend"]] += len(group.cases)
        rows = [figure.axes[place : place + 3] for place in range(0, 6, 3)]
        for row, expected in zip(rows, shown.values(), strict=True):
            for axes in row:
                assert sum(len(one.get_offsets()) for one in axes.collections) == expected

    @pytest.mark.usefixtures("not_laid_out")
    def test_outliers_and_failures_are_counted(self):
        cases = synthetic(3, protocols=("paper",)).query("backend == 'lasso'").copy()
        cases = cases[cases["settings"] == '{"alpha": 0.1}']
        cases["status"] = ["ok", "ok", "timeout"]
        cases["est_timescale"] = [1e6, 0.1, math.nan]
        cases["est_length_scale"] = cases["est_mean_velocity"] = 1.0
        axes = FIGURES.make("scatter", study(), cases, None).axes[0]
        assert axes.get_title(loc="right") == "▲ 1 above  × 1 failed"


class TestErrorsAndSweep:
    def test_a_failure_is_an_infinite_error(self):
        cases = synthetic(4, protocols=("paper",)).iloc[:4].copy()
        cases["status"] = ["ok", "ok", "error", "crashed"]
        cases[["est_mean_velocity", "est_timescale"]] = 1.0
        cases["est_length_scale"] = cases["true_length_scale"] * [1.1, 1.2, 1.0, 1.0]
        error = MEASURES["length-scale-error"]
        quartiles = [error.summarise(cases, f"{name} quartile") for name in ("first", "third")]
        assert quartiles == [pytest.approx(10.0), math.inf]
        assert error.summarise(cases) == pytest.approx(20.0)

    @pytest.mark.usefixtures("not_laid_out")
    def test_a_median_that_failed_leaves_a_gap(self):
        cases = synthetic(2, LEVELS, ("paper",))
        cases.loc[cases["flights.velocity_noise"] == 1.0, "status"] = "timeout"
        figure = FIGURES.make("sweep", study(), cases, None)
        line = figure.axes[0].get_lines()[0]
        assert np.isnan(line.get_ydata()).tolist() == [False, False, True]

    @pytest.mark.usefixtures("not_laid_out")
    def test_the_smallest_error_is_in_the_frame_beside_one_of_ten_decades_more(self):
        cases = synthetic(8)
        sure = cases["protocol"] == "matched"
        for name in ("mean_velocity", "length_scale", "timescale"):
            cases.loc[sure, f"est_{name}"] = cases.loc[sure, f"true_{name}"]
        cases.loc[cases.index[~sure][0], "est_timescale"] = 100.0
        for axes in FIGURES.make("errors", study(), cases, None).axes:
            assert axes.get_xlim()[0] < 1e-6

    @pytest.mark.usefixtures("not_laid_out")
    def test_panels_below_each_other_agree_and_one_without_an_answer_says_so(self):
        cases = synthetic(4, LEVELS)
        cases.loc[cases["protocol"] == "matched", "status"] = "timeout"
        figure = FIGURES.make("sweep", study(), cases, None)
        above, below = figure.axes[0], figure.axes[3]
        assert above.get_xlim() == below.get_xlim()
        assert [one.get_text() for one in below.texts] == ["no answer"]
        assert not above.texts

    def test_long_names_keep_the_legend_on_the_page(self):
        long = tuple(f"{place} flown with noise of 0.2 m/s and 0.05 m, calm" for place in "abcd")
        cases = synthetic(2, protocols=long).query("backend == 'lasso'")
        figure = FIGURES.make("errors", study(), cases, None)
        figure.draw_without_rendering()
        assert_within(figure.bbox, figure.legends[0].get_tightbbox())

    def test_nothing_to_sweep_is_refused(self):
        with pytest.raises(InputError, match='sweeps no number: drop the figure "sweep"'):
            FIGURES.make("sweep", study(), synthetic(2), None)

    @pytest.mark.usefixtures("not_laid_out")
    def test_a_setting_without_any_answer_keeps_its_row(self):
        cases = synthetic(2, protocols=("paper",))
        cases.loc[cases["backend"] == "lasso", "status"] = "crashed"
        axes = FIGURES.make("errors", study(), cases, None).axes[0]
        assert [one.get_text() for one in axes.texts] == []
        assert "lasso alpha=0.1" in [tick.get_text() for tick in axes.get_yticklabels()]


def test_weights_are_needed_for_the_weights():
    with pytest.raises(InputError, match="kept no weights"):
        FIGURES.make("weights", study(), synthetic(1), None)


@pytest.mark.usefixtures("not_laid_out")
def test_the_true_and_the_chosen_scale_are_marked():
    cases = synthetic(1, protocols=("paper",))
    axes = FIGURES.make("weights", study(), cases, weights_of(cases)).axes[0]
    marks = {line.get_label(): line.get_xdata()[0] for line in axes.get_lines()}
    assert marks["true length scale"] == cases["true_length_scale"].iloc[0]
    assert abs(marks["chosen scale"] - cases["grid_length_scale"].iloc[0]) <= 0.1001


def test_figures_that_apply():
    assert figures_for(synthetic(1), None) == []
    assert figures_for(synthetic(1), weights_of(synthetic(1))) == ["weights"]
    assert figures_for(synthetic(2, LEVELS), None) == ["scatter", "errors", "sweep"]
    unanswered = synthetic(2, LEVELS).assign(status="error")
    assert figures_for(unanswered, None) == ["scatter", "errors"]


class TestReport:
    def test_every_file_is_there_and_linked(self, tmp_path: Path, monkeypatch):
        again = dict.fromkeys(FIGURES.compares, lambda *_: drawn("coverage"))
        monkeypatch.setattr(pages, "FIGURES", replace(FIGURES, compares=again))
        cases = synthetic(6)
        tables = ("errors", "errors-absolute", "times")
        chosen = study(planned=len(cases), tables=tables, figures=("errors",))
        written = write_report(chosen, tmp_path, cases)
        folder = tmp_path / "demo"
        assert sorted(path.name for path in written) == sorted(p.name for p in folder.iterdir())
        text = (folder / "README.md").read_text("utf-8")
        assert text.startswith("# demo\n\n**Which &lt;back-end&gt; reads it best?**\n")
        for name in ("errors.svg", "errors.csv", "errors.tex", "times.md"):
            assert f"({name})" in text
            assert (folder / name).is_file()
        page = (folder / "report.html").read_text("utf-8")
        assert "<h1>Which &lt;back-end&gt; reads it best?</h1>" in page
        assert "24 flights were simulated from seed 7, with response time 0.5 s and" in page
        assert "sparsefit study show demo.toml --case" in page
        assert "- flights.response_time: `0.5`" in text
        assert '- flights.length_scale: `{"uniform":[2,10]}`' in text
        assert "72 of 72 planned cases: 66 ok, 6 error." in text
        rows = text.partition("How cases ended (demo)")[2].partition("###")[0].splitlines()
        counts = [[int(cell) for cell in row.split("|")[-4:-1]] for row in rows if "alpha=" in row]
        assert np.sum(counts, axis=0).tolist() == [72, 66, 6]
        back = pd.read_csv(folder / "errors-absolute.csv")
        assert len(back) == 2 * 2 * len(BACKENDS)
        assert (back["n"] == 6).all()
        first = {path.name: path.read_bytes() for path in written}
        write_report(chosen, tmp_path, cases)
        assert first == {path.name: path.read_bytes() for path in folder.iterdir()}

    def test_no_cases_are_refused(self, tmp_path: Path):
        empty = synthetic(1).iloc[:0]
        with pytest.raises(InputError, match="no cases yet: run it first"):
            write_report(study(), tmp_path, empty)
        with pytest.raises(InputError, match="no cases yet"):
            render_show(study(), empty)

    def test_a_folder_that_cannot_be_made_is_an_input_error(self, tmp_path: Path):
        (tmp_path / "demo").write_text("a file")
        with pytest.raises(InputError, match="choose another results folder"):
            write_report(study(), tmp_path, synthetic(2))

    def test_show_asks_before_it_answers(self):
        shown = render_show(study(planned=99), synthetic(2), width=90)
        assert shown.startswith("demo: Which <back-end> reads it best?\n24 of 99 planned cases:")
        assert max(map(len, shown.split("\n\n", 1)[1].splitlines())) <= 90


@pytest.mark.usefixtures("not_laid_out")
def test_a_failed_first_panel_hides_no_legend():
    cases = synthetic(1, protocols=("paper",))
    cases.loc[0, ["grid_length_scale", "est_length_scale"]] = math.nan
    cases.loc[0, "status"] = "error"
    figure = FIGURES.make("weights", study(), cases, weights_of(cases))
    assert figure.axes[0].get_title(loc="right") == "no scale chosen, error"
    assert "chosen scale" in [text.get_text() for text in figure.legends[0].get_texts()]


def test_a_picture_of_errors_is_drawn_where_none_is_known():
    cases = synthetic(4, protocols=("paper",))
    cases[[name for name in cases if name.startswith("est_")]] = math.nan
    assert to_svg(FIGURES.make("errors", study(), cases, None))


def test_an_efficiency_picture_of_many_rows_is_drawn_only_when_asked_for():
    few = bounded(synthetic(2, PROCESS_NOISES))
    many = bounded(
        synthetic(
            2,
            tuple(
                {"flights.process_noise": noise, "flights.duration": float(seconds)}
                for noise in (0.1, 1.0)
                for seconds in range(1, 10)
            ),
        )
    )
    assert "efficiency" in figures_for(few, None)
    assert "efficiency" not in figures_for(many, None)
