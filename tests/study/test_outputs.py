"""Tables and figures of frames made by hand."""

import io
import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import sparsefit as sf
from sparsefit.errors import InputError
from sparsefit.plot.style import COLOURS, encoded, labels
from sparsefit.study import figures, measures, page, solver_times, tables
from sparsefit.study.columns import PARAMETERS, STATUSES
from sparsefit.study.keys import Reference
from sparsefit.study.table import Column, Table, cell_text, significant
from tests.study.frames import case, frame, solve, spread, study

STUDIES = Path(__file__).parents[2] / "studies"
COMPUTED = (  # studies whose first case of each status takes less than a second
    *("coverage", "derivatives", "drag", "grids", "limits", "mismatch", "multiscale"),
    *("online", "readings", "select", "several", "table2", "thrust", "vehicle", "windows"),
)


def made(entry, cases, **outputs):
    return sf.Study.table(study(cases, **outputs), entry)


def column(table, name):
    return table.frame[name].tolist()


class TestTables:
    def test_rows_are_groups_and_columns_measures(self):
        cases = frame(case(0, (10.0, 0.0)), case(1, (20.0, 0.0)), case(2, None, status="timeout"),
                      case(0, (-4.0, 0.0), label="stlsq"))  # fmt: skip
        table = made({"name": "x", "measure": ["mean mean-velocity-size", "hits"]}, cases)
        assert column(table, "title") == ["lasso", "stlsq"]
        assert [column(table, name) for name in ("n", "ok", "failures")] == [[3, 1], [2, 1], [1, 0]]
        assert column(table, "mean |error| U0 [%]") == pytest.approx([15.0, 4.0])

    def test_intervals_hold_the_summary_and_shares_have_wilsons(self):
        entry = {"name": "x", "measure": ["mean timescale-error", "hits"], "interval": True}
        row = made(entry, spread()).rows[0]
        error, low, high, _, least, most = row[4:]
        assert low < error < high
        assert (least, most) == pytest.approx((75.75, 100.0), abs=0.01)

    def test_a_pivot_has_a_column_per_level_numbers_ascending(self):
        cases = pd.concat([
            spread(**{"flights.duration": seconds}) for seconds in (20.0, 5.0)
        ])  # fmt: skip
        table = made({"name": "x", "measure": ["timescale-error"], "compare": "protocols",
                      "along": "flights.duration", "rows": ["title"]}, cases)  # fmt: skip
        group = "median |error| τ_w, duration"
        assert table.heads == ["title", "n", "ok", "failures", f"{group} 5 [%]", f"{group} 20 [%]"]
        with pytest.raises(InputError, match="did you mean"):
            made({"name": "x", "measure": ["timescale-error"], "compare": "protocols",
                  "along": "flights.duratio"}, cases)  # fmt: skip

    def test_status_against_truth(self):
        cases = frame(case(0), case(1, (9.0, 0.0)), case(2, status="misfit"),
                      case(3, flow="none"), case(4, None, status="error"))  # fmt: skip
        table = made("status", cases)
        told = dict(zip((each.full for each in table.columns), table.rows[0], strict=True))
        assert told == {"title": "lasso", "n": 5, "ok ≤ 5 %": 1, "ok off": 1, "ok no flow": 1,
                        "misfit ≤ 5 %": 1, "error all": 1}  # fmt: skip

    def test_notes_of_problems_are_not_of_flights(self):
        cases = frame(*(solve(f"p{n}", "a", 1.0, holdout_error=0.1 * n) for n in range(3)))
        table = made({"name": "x", "measure": ["holdout-error"], "interval": True}, cases)
        assert "draws of whole problems" in table.notes[-1]
        assert made("status", cases).notes == ()

    def test_coverage(self):
        ends = {"low_length_scale": 4.9, "high_length_scale": 5.1}
        (row,) = made("coverage", frame(case(0, **ends), case(1, **ends))).rows
        assert row[1:6] == ("L_w", 2, 2, 2, 100.0)

    def test_a_reference_stands_first(self):
        reference = Reference("paper, Table 2", 95, signed_error=(-18.8, -5.91, 33.3))
        table = made("errors", spread(), reference=reference)
        assert table.rows[0][:2] == ("paper, Table 2", 95)
        assert column(table, "mean signed % error τ_w [%]")[0] == 33.3
        assert "paper, Table 2: +33.30 %" in page.headline(
            study(spread(), reference=reference, headline="timescale-signed-error"), spread()
        )

    def test_without_outputs_what_fits_is_made(self):
        assert list(tables.tables(study(spread()), spread())) == [
            "summary", "status", "errors-absolute", "errors", "times",
        ]  # fmt: skip
        assert list(tables.tables(study(frame(case())), frame(case()))) == ["parameters", "times"]

    @pytest.mark.parametrize(
        ("entry", "words"),
        [("errrors", 'did you mean "errors"'), ({"name": "x"}, "needs measure"),
         ({"name": "x", "mesure": ["hits"]}, 'did you mean "measure"'),
         ({"name": "x", "measure": ["hit"]}, 'did you mean "hits"'),
         ({"name": "x", "measure": ["hits"], "rows": ["titel"]}, 'did you mean "title"'),
         ({"name": "../x", "measure": ["hits"]}, "leave out /"),
         ({"name": "x", "measure": ["hits"], "compare": "levels"}, "unknown compare"),
         ("prediction", "is of problems, and these cases are of flights")],
    )  # fmt: skip
    def test_what_is_not_known_is_refused_with_the_nearest(self, entry, words):
        with pytest.raises(InputError, match=words):
            made(entry, spread())


class TestScript:
    TEXT = """
import pandas as pd
from matplotlib.figure import Figure

def sizes(cases):
    frame = cases.groupby("title").size().to_frame("cases")
    frame.attrs["title"] = "How many"
    return frame

def drawn(cases, study):
    figure = Figure()
    figure.subplots().loglog(range(1, 9), range(1, 9), label=study.name)
    return figure

def broken(cases):
    return cases["nothing"]

def _helper(cases):
    return 1
"""

    def of(self, tmp_path, **outputs):
        (tmp_path / "mine.py").write_text(self.TEXT)
        return study(spread(), tmp=tmp_path, script="mine.py", **outputs)

    def test_its_functions_are_tables_and_figures(self, tmp_path):
        mine = self.of(tmp_path, tables=("sizes",), figures=("drawn",))
        page.check_outputs(mine)
        made = tables.tables(mine, mine.cases)["sizes"]
        assert made.title == "How many"
        assert made.rows == [("lasso", 12), ("stlsq", 12)]
        (axes,) = figures.figures(mine, mine.cases)["drawn"].figure.axes
        assert all(number.get_parse_math() for number in axes.get_xticklabels())  # 10^0

    @pytest.mark.parametrize(("name", "words"), [("broken", "KeyError"), ("drawn", "no DataFrame"),
                                                 ("_helper", "unknown table")])  # fmt: skip
    def test_what_fails_names_the_function(self, tmp_path, name, words):
        with pytest.raises(InputError, match=words):
            sf.Study.table(self.of(tmp_path), name)


class TestText:
    table = Table(
        'Errors of "mine"',
        (Column("name"), Column("U0", "%", group="mean |error|"), Column("τ_w", "s", "+.2f")),
        [("=cmd('x')", 1.23456789, -0.001), ("[a] \\^~_$", math.inf, None), ("<b>é", 3e-9, 2.0)],
        ("A note.",),
    )

    @pytest.mark.parametrize(
        ("value", "text"),
        [(99.97, "100"), (0.00012345, "0.000123"), (1e-5, "1.00e-05"), (123456.0, "123000"),
         (0.0, "0"), (-0.0, "0"), (7, "7")],
    )  # fmt: skip
    def test_three_significant_digits(self, value, text):
        assert significant(value) == text

    def test_cells(self):
        assert cell_text(-0.001, Column("x", format="+.2f")) == "0.00"
        assert cell_text(1e-9, Column("x", least=1e-6)) == "< 1e-6"
        assert cell_text("a\x1b[31m\nb", Column("x")) == "a�[31m b"
        texts = [cell_text(value, Column("x")) for value in (None, math.nan, True)]
        assert texts == ["–", "–", "yes"]
        whole = Table("", (Column("n"),), [(4.0,), (None,), (12.0,)])
        assert whole.texts(9) == [["4"], ["–"], ["12"]]
        assert "12" in str(whole)

    def test_csv_has_all_rows_and_runs_nothing(self):
        read = pd.read_csv(io.StringIO(self.table.to_csv()))
        assert list(read.columns) == ["name", "mean |error| U0 [%]", "τ_w [s]"]
        assert read["name"][0] == "'=cmd('x')"
        assert read["mean |error| U0 [%]"].tolist() == [1.23457, math.inf, 3e-9]
        assert math.isnan(read["τ_w [s]"][1])

    def test_latex_is_escaped_and_quotes_open_and_close(self):
        text = self.table.to_latex("tab:x")
        assert r"\caption{Errors of ``mine''}" in text
        assert r"{}[a] \textbackslash{}\textasciicircum{}\textasciitilde{}\_\$ & $\infty$ & --" in (
            text
        )
        assert r"$\tau_w$ [s]" in text
        assert r"$3.00 \times 10^{-9}$ & $+2.00$" in text
        assert r"\textless{}b\textgreater{}é" in text

    def test_markdown_text_and_json(self):
        assert "\\[a\\]" in self.table.to_markdown()
        assert "&lt;b&gt;" in self.table.to_markdown()
        narrow = self.table.to_text(30).splitlines()
        assert max(map(len, narrow)) <= 30
        rows = [(f"{'a' * 60} {n} {'b' * 60}", n) for n in (1, 2)]
        long = Table("", (Column("name"), Column("n")), rows)
        text = long.to_text(40)
        assert text.count("b") == 120  # nothing is cut
        assert max(map(len, text.splitlines())) <= 40
        parts = [Column(f"part {n}", group="error") for n in range(6)]
        wide = Table("", (Column("name"), *parts), [("a", 1.0, 2.0, 3.0, 4.0, 5.0, 6.0)])
        assert wide.to_text(40).count("error") == 2  # a block each, with its heading
        assert self.table.record()["rows"][1] == ["[a] \\^~_$", None, None]


def drawn(entry, cases, **outputs):
    return sf.Study.figure(study(cases, **outputs), entry)


def legend_of(figure):
    return [text.get_text() for text in figure.legends[0].get_texts()]


class TestFigures:
    def test_a_line_per_title_along_a_factor(self):
        cases = pd.concat([spread(**{"flights.duration": time}) for time in (5.0, 20.0, 80.0)])
        figure = drawn({"name": "x", "compare": "lines", "measure": ["timescale-error"]}, cases)
        (axes,) = figure.axes
        assert legend_of(figure) == ["lasso", "stlsq"]
        assert [list(line.get_xdata()) for line in axes.lines] == [[5.0, 20.0, 80.0]] * 2
        part = cases[(cases["title"] == "lasso") & (cases["flights.duration"] == 20.0)]
        each = measures.measure("timescale-error")
        expected = each.summary_of(each.values(part))
        assert axes.lines[0].get_ydata()[1] == pytest.approx(expected)

    def test_a_legend_names_what_is_drawn_and_twins_are_drawn_once(self):
        cases = spread(("lasso",))
        twin = cases.assign(title="twin")
        mute = cases.assign(title="mute", status="error", est_timescale=math.nan)
        figure = drawn("errors", pd.concat([cases, twin, mute]))
        assert legend_of(figure) == ["lasso and 1 alike", "mute"]
        assert max(figure.axes[0].lines[1].get_ydata()) == 0.0

    def test_many_curves_name_the_best(self):
        cases = pd.concat([
            frame(*(case(n, (0.0, size + n / 50), label=f"of {size}") for n in range(9)))
            for size in range(15, 0, -1)
        ])  # fmt: skip
        figure = drawn({"name": "x", "compare": "ecdf", "measure": ["length-scale-size"]}, cases)
        names = legend_of(figure)
        assert names[:3] == ["of 1", "of 2", "of 3"]
        assert names[-1] == f"{15 - figures.NAMED_CURVES} others"

    def test_profiles_end_at_the_share_that_answered(self):
        cases = frame(*(case(n, (0.0, size)) for n, size in enumerate((0.5, 1.0, 2.0))),
                      case(3, None, status="error"))  # fmt: skip
        figure = drawn({"name": "x", "compare": "ecdf", "measure": ["length-scale-size"]}, cases)
        line = figure.axes[0].lines[0]
        assert max(line.get_ydata()) == 75.0

    def test_a_picture_without_a_mark_is_a_sentence(self):
        cases = frame(case(0, None, status="error"), case(1, None, status="error"))
        told = figures.figures(study(cases, figures=("errors", "scatter")), cases)
        assert [each.figure for each in told.values()] == [None, None]
        assert "nothing to draw" in told["errors"].caption
        with pytest.raises(InputError, match="nothing to draw"):
            drawn("errors", cases)

    def test_estimated_against_true_shows_the_best_of_each_reading_and_names_it(self):
        good = spread(("lasso", "stlsq"), reading="refined")
        poor = spread(("lasso", "stlsq"), reading="on the grid").assign(
            title=lambda cases: "grid " + cases["label"]
        )
        cases = pd.concat([good, poor])
        cases.loc[cases.index[3], ["est_mean_velocity", "est_timescale"]] = 500.0, 0.01
        told = figures.figures(study(cases, figures=("scatter",)), cases)["scatter"]
        assert len(told.figure.axes) == 6
        assert not told.figure.legends  # the one condition has no name, and is not grey
        assert told.figure.axes[0].lines[0].get_color() == COLOURS[0]
        beside = [axes.get_ylabel() for axes in told.figure.axes[::3]]
        assert beside[0].startswith("lasso\n")
        assert beside[1].startswith("grid ")
        assert any("1 above" in axes.get_title() for axes in told.figure.axes)

    def test_shares_along_conditions_have_their_wilson_intervals(self):
        cases = pd.concat([
            spread(("lasso",), condition=name, low_length_scale=4.9, high_length_scale=5.1)
            for name in ("calm", "storm")
        ])  # fmt: skip
        figure = drawn("coverage", cases)
        assert [text.get_text() for text in figure.axes[-1].get_xticklabels()] == ["calm", "storm"]
        assert figure.axes[0].collections

    def test_labels_keep_the_words_in_which_names_differ(self):
        names = ["frozen, noise of 0.2 m/s and 0.05 m", "frozen, noise of 0.5 m/s and 0.05 m"]
        assert labels(names, 12) == dict(zip(names, ("0.2", "0.5"), strict=True))
        assert labels(["a", "b"], 12) == {"a": "a", "b": "b"}

    def test_a_figure_is_the_same_bytes_and_runs_nothing(self):
        cases = spread(('<script>alert("$x")</script>', "b"))
        pictures = [encoded(drawn("errors", cases), ".svg", "errors") for _ in range(2)]
        assert pictures[0] == pictures[1]
        assert b"<script" not in pictures[0]


class TestSolvers:
    cases = frame(
        *(solve(f"p{n}", "fast", 0.01 * (n + 1), tolerance=1e-8) for n in range(6)),
        *(solve(f"p{n}", "slow", 0.04 * (n + 1), 1e-9, tolerance=1e-8) for n in range(6)),
        *(solve(f"p{n}", "slow", 0.02 * (n + 1), 1e-5, tolerance=1e-4) for n in range(6)),
        *(solve(f"p{n}", "lost", 9.0, 1.0, "inaccurate", reason=f"gap {n}.5 above 1e-8",
                tolerance=1e-8) for n in range(6)),
        solve("p0", "gone", math.nan, math.nan, "skipped"),
    )  # fmt: skip
    cases.attrs["limit"] = 9.0

    def test_times_are_the_least_that_reach_an_accuracy(self):
        strict, loose = (solver_times.times_to(self.cases, at) for at in (1e-8, 1e-4))
        assert list(strict["lasso"]) == ["fast", "slow", "lost"]
        assert strict["lasso"].loc["p2"].tolist() == pytest.approx([0.03, 0.12, math.inf])
        assert loose["lasso"].loc["p2"].tolist() == pytest.approx([0.03, 0.06, math.inf])
        race = solver_times.race(self.cases, 1e-8)
        assert race.loc[race["solver"] == "slow", "ratio"].tolist() == pytest.approx([4.0] * 6)

    def test_the_summary_names_success_mean_and_ratio_with_its_interval(self):
        rows = {row[1]: row for row in made("solvers", self.cases).rows}
        assert [rows[name][2] for name in rows] == ["fastest", "slower", "solved none", "missing"]
        assert [rows["slow"][place] for place in (3, 7, 11)] == ["6/6"] * 3
        assert rows["slow"][5:7] == ("4.00", "4.00 … 4.00")
        assert rows["lost"][5].startswith("≥ ")
        seconds = np.log([0.041, 0.081, 0.121, 0.161, 0.201, 0.241]).mean()
        assert rows["slow"][4] == pytest.approx(1e3 * (np.exp(seconds) - 1e-3))

    def test_no_accuracy_is_asked_of_a_solver_that_was_never_asked_for_it(self):
        loose = self.cases[~((self.cases["solver"] == "slow") & (self.cases["tolerance"] < 1e-5))]
        assert solver_times.accuracies(self.cases) == (1e-4, 1e-6, 1e-8)
        assert solver_times.accuracies(loose) == (1e-4,)

    def test_failures_and_the_headline(self):
        (failed,) = made("failed", self.cases).rows  # the numbers of a reason may differ
        assert failed[:4] == ("lost", "inaccurate", 6, "p0, p1, p2, p3 and 2 more")
        said = page.headline(study(self.cases), self.cases)
        assert (
            said
            == "Fastest to a certified 1e-8: fast (lasso); the second takes 4.00 times as long."
        )

    def test_pictures(self):
        told = figures.figures(study(self.cases), self.cases)
        assert list(told) == ["profiles", "shapes"]
        line = {each.get_label(): each for each in told["profiles"].figure.axes[2].lines}["slow"]
        assert max(line.get_ydata()) == 100.0
        assert line.get_xdata()[1] == pytest.approx(4.0)


@pytest.mark.parametrize(
    "path", [path for path in sorted(STUDIES.glob("*.toml")) if "\nscript = " in path.read_text()],
    ids=lambda path: path.stem,
)  # fmt: skip
def test_the_script_of_a_shipped_study_makes_its_table(path):
    shipped = sf.Study.from_file(path)
    named = shipped.definition.outputs.tables + shipped.definition.outputs.figures
    names = set(tables.functions_of(shipped)) & {own for own in named if isinstance(own, str)}
    assert names
    for name in names:
        if name in shipped.definition.outputs.tables:
            assert shipped.table(name).rows
        else:
            assert shipped.figure(name) is not None


@pytest.mark.parametrize("name", COMPUTED)
def test_cases_of_a_shipped_study_are_those_of_the_code_here(name):
    shipped = sf.Study.from_file(STUDIES / f"{name}.toml")
    answered = shipped.cases[shipped.cases["status"].isin(STATUSES[:4])]
    for row in answered.drop_duplicates("status").to_dict("records"):
        estimate = shipped.again(row["case_id"]).estimate
        sure = estimate.uncertainty or {}
        values = [getattr(estimate, each) for each in PARAMETERS]
        values += [sure.get(each, math.nan) for each in PARAMETERS]
        expected = [row[f"{own}_{each}"] for own in ("est", "se") for each in PARAMETERS]
        assert estimate.status == row["status"]
        assert values == pytest.approx(expected, rel=1e-5, nan_ok=True)


def test_errors_of_the_shape_of_cells_by_hand():
    degree = math.pi / 180
    cases = frame(case(0, **{
        "true_heading": 1.0 * degree, "est_heading": 88.0 * degree, "flights.duration": 5.0,
        "true_length_scale_x": 4.0, "true_length_scale_y": 6.0, "est_length_scale_x": 6.6,
        "est_length_scale_y": 4.0, "true_drift_x": 0.3, "true_drift_y": 0.4,
        "est_drift_x": math.nan, "est_drift_y": math.nan,
    }))  # fmt: skip
    geometry = tables.functions_of(sf.Study.from_file(STUDIES / "waves.toml"))["geometry"]
    # Cells repeat after a quarter turn; what was found steady lacks all of 0.5 of 10 m/s.
    assert geometry(cases).iloc[0].tolist() == pytest.approx([1, 3.0, 10.0, 5.0])
