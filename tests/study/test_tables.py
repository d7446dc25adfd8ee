import csv
import io
import json
import math
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from sparsefit.errors import InputError
from sparsefit.study import Study
from sparsefit.study.evidence.cases import by_setting, estimated
from sparsefit.study.evidence.measures import MEASURES
from sparsefit.study.evidence.readings import percent_errors
from sparsefit.study.evidence.reference import distance
from sparsefit.study.evidence.table import (
    SIGNIFICANT,
    Column,
    Table,
    cell_text,
    display_width,
    plain,
    significant,
)
from sparsefit.study.evidence.tables import TABLES, tables_for
from sparsefit.study.report.escape import escape_markdown, escape_tex
from sparsefit.study.report.render import to_csv, to_latex, to_markdown, to_text
from sparsefit.study.report.typical import typical
from sparsefit.study.spec.outputs import Reference

STUDY = SimpleNamespace(
    name="demo",
    question="?",
    seed=1,
    hash="ab" * 32,
    planned=0,
    path="demo.toml",
    given={},
    tables=(),
    figures=(),
    answers=(),
    reference=None,
)
TABLE1 = Reference(
    "paper, Table 1",
    estimate=(15.95, 4.20, 0.26),
    signed_error=(3.37, -0.24, -3.70),
    note="rounded",
)
TABLE2 = Reference(
    "paper, Table 2",
    flights=95,
    deviation=(-4.43, -0.17, 0.10),
    signed_error=(-18.80, -5.91, 33.30),
)


def beside(reference):
    """The study with printed numbers to be held against."""
    return SimpleNamespace(**{**vars(STUDY), "reference": reference})


def case(flight=0, *, percent=(0.0, 0.0), status="ok", true=(10.0, 5.0), **more):
    """One row; `percent` are the errors of U0 and L, tau_w follows."""
    answered = status in ("ok", "inaccurate")
    speed, scale = (t * (1 + p / 100) for t, p in zip(true, percent, strict=True))
    row = {
        "case_id": f"{flight}-{more.get('backend', 'lasso')}-{more}",
        "flight": flight,
        "protocol": "matched",
        "backend": "lasso",
        "label": "lasso",
        "settings": "{}",
        "status": status,
        "true_mean_velocity": true[0],
        "true_length_scale": true[1],
        "true_timescale": true[1] / true[0],
        "est_mean_velocity": speed if answered else math.nan,
        "est_length_scale": scale if answered else math.nan,
        "est_timescale": scale / speed if answered else math.nan,
        "hit": True if answered else None,
        "certificate_kind": "duality_gap" if answered else "",
        "certificate": 1e-9 if answered else math.nan,
        "seconds": 0.1,
    }
    return row | more


def frame(*rows):
    return pd.DataFrame(list(rows))


def column(table, name, group=""):
    (place,) = [i for i, c in enumerate(table.columns) if (c.name, c.group) == (name, group)]
    return [row[place] for row in table.rows]


STUDIES = Path(__file__).parents[2] / "studies"
NASTY = r"a|b&c%d$e#f_g{h}~i^j\k`<l>"
TABLE = Table(
    "Title 100 % & more",
    (Column("name", align="left"), Column("x", "m", ".2f", tex="$x$"), Column("n", format="d")),
    ((NASTY, 1.23456789012345, 3), ('ü, "q"', math.nan, None), ("z", -4.5, 12)),
    ("A note_1.",),
)


class TestCells:
    @pytest.mark.parametrize(
        ("value", "text"),
        [(0.0123456, "0.0123"), (123.4, "123"), (1234.5, "1230"), (0.0, "0"), (-2.0, "-2.00"),
         (9.996, "10.0"), (99.97, "100"), (1e-7, "1.00e-07"), (2.5e7, "2.50e+07")],
    )  # fmt: skip
    def test_significant(self, value, text):
        assert significant(value) == text

    def test_absent_is_a_dash_and_infinity_a_sign(self):
        number = Column("x", format=".2f")
        assert cell_text(None, number) == cell_text(math.nan, number) == "–"
        assert cell_text(-math.inf, number) == "-∞"

    def test_a_rounded_zero_has_no_sign(self):
        assert cell_text(-0.001, Column("x", format="+.2f")) == "0.00"
        assert cell_text(-0.01, Column("x", format="+.2f")) == "-0.01"

    def test_a_terminal_obeys_no_name(self):
        assert cell_text("\x1b[31mred\nline", Column("x")) == "�[31mred line"

    def test_plain_unwraps_and_blanks(self):
        assert plain(np.float64(2.5)) == 2.5
        assert plain(np.bool_(True)) is True
        assert [plain(one) for one in (None, math.nan, pd.NA, pd.NaT)] == [None] * 4

    def test_a_row_of_the_wrong_length_is_refused(self):
        with pytest.raises(ValueError, match="1 cells in a row of 3"):
            replace(TABLE, rows=(("a",),))


class TestLeast:
    ERROR = Column("|error|", "%", SIGNIFICANT, least=1e-6)
    SIGNED = Column("error", "%", "+.2f", least=1e-6)

    def csv(self, column, *values):
        table = Table("t", (column,), tuple((value,) for value in values))
        return to_csv(table).split()[-len(values) :]

    def test_an_error_of_rounding_is_printed_as_below(self):
        texts = [cell_text(value, self.ERROR) for value in (3.9e-9, 0.0, -2e-15, 2.66e-6)]
        assert texts == ["< 1e-6", "< 1e-6", "< 1e-6", "2.66e-06"]

    def test_shares_and_counts_of_zero_stay(self):
        assert cell_text(0.0, Column("hits", "%", ".0f")) == "0"
        assert cell_text(0.0, Column("x", "m", SIGNIFICANT)) == "0"

    def test_csv_is_no_finer(self):
        texts = self.csv(self.ERROR, 3.9e-9, 2.66123e-6, 1.23456789, 1234567.8, math.inf)
        assert texts == ["0", "3e-06", "1.23457", "1.23457e+06", "inf"]
        assert self.csv(self.SIGNED, -3.9e-9, -0.1) == ["0", "-0.1"]

    def test_no_cell_of_a_csv_file_is_a_formula(self):
        names = ('=HYPERLINK("x")', "+1", "-1", "@x", "a=b")
        written = to_csv(Table("t", (Column("name"),), tuple((name,) for name in names)))
        read = [row[0] for row in csv.reader(io.StringIO(written))][1:]
        assert read == [*(f"'{name}" for name in names[:4]), "a=b"]


class TestTypical:
    def of(self, measure, *cases):
        return int(typical(MEASURES[measure], frame(*cases))["flight"].iloc[0])

    def test_is_the_largest_that_is_not_above_the_summary(self):
        """Errors of L_w 1, 5, 3 and a failure: of an even number the lower middle."""
        cases = [case(n, percent=(0.0, one)) for n, one in enumerate((1.0, 5.0, 3.0))]
        assert self.of("length-scale-error", *cases) == 2
        assert self.of("length-scale-error", *cases, case(3, status="error")) == 2

    def test_rounding_does_not_choose(self):
        for errors in ((1e-12, 2e-12, 3e-12), (3e-12, 1e-12, 2e-12)):
            cases = [case(n, percent=(0.0, one)) for n, one in enumerate(errors)]
            assert self.of("length-scale-error", *cases) == 0

    def test_of_a_share_it_speaks_against_it(self):
        assert self.of("hits", case(0), case(1, hit=False), case(2, hit=False)) == 1
        assert self.of("silent-misses", case(0), case(1), case(2, percent=(9.0, 0.0))) == 2

    def test_where_nobody_answers_it_is_the_first(self):
        failed = [case(n, status="error") for n in range(2)]
        assert self.of("length-scale-error", *failed) == 0


class TestHits:
    def test_of_a_back_end_without_a_grid_they_are_a_dash(self):
        cases = frame(
            case(hit=True),
            case(1, status="error"),
            *(case(n, backend="parametric-nls", hit=False) for n in (0, 1)),
            *(case(n, backend="gridless-group-lasso", hit=False) for n in (0, 1)),
        )
        hits = MEASURES["hits"]
        values = [hits.summarise(group.cases) for group in by_setting(cases)]
        assert values[0] == 50.0
        assert [cell_text(value, Column("hits", "%", ".0f")) for value in values[1:]] == ["–"] * 2
        assert math.isnan(hits.summarise(cases[2:], "number"))


class TestRenderers:
    def test_markdown_is_aligned_in_its_source(self):
        lines = [line for line in to_markdown(TABLE).splitlines() if line.startswith("|")]
        assert len({display_width(line) for line in lines}) == 1
        assert len(lines) == 5
        assert lines[1].split("|")[1].endswith("-")
        assert lines[1].split("|")[2].endswith(":")

    def test_markdown_escapes_names(self):
        assert escape_markdown(NASTY) == r"a\|b&amp;c%d\$e#f_g{h}\~i^j\\k\`&lt;l&gt;"
        assert escape_markdown("_a_ [x](y)") == r"\_a\_ [x\](y)"
        row = next(line for line in to_markdown(TABLE).splitlines() if "a\\|b" in line)
        assert len(re.findall(r"(?<!\\)\|", row)) == 4

    def test_tex_escapes_names(self):
        assert escape_tex(r"\&%$#_{}~^") == (
            r"\textbackslash{}\&\%\$\#\_\{\}\textasciitilde{}\textasciicircum{}"
        )
        assert escape_tex("lasso α=0.1–×") == r"lasso $\alpha$=0.1--$\times$"

    @pytest.mark.parametrize("text", [NASTY, "\\input{x}", "%", "$$", "}{", "_" * 5])
    def test_tex_never_lets_a_command_through(self, text):
        known = r"\\(textbackslash|textasciitilde|textasciicircum|textbar|textless|textgreater)\{\}"
        rest = re.sub(r"\\[&%$#_{}]", "", re.sub(known, "", escape_tex(text)))
        assert not set(rest) & set("\\&%$#_{}~^")

    def test_latex_is_balanced_and_booktabs(self):
        wide = replace(TABLE, columns=(*TABLE.columns[:2], replace(TABLE.columns[2], group="g_1")))
        for table in (TABLE, wide):
            source = to_latex(table, label="tab:a_b c")
            bare = re.sub(r"\\[\\{}&%$#_]", "", source)
            assert bare.count("{") == bare.count("}")
            assert bare.count("$") % 2 == 0
            begun = re.findall(r"\\begin\{(\w+)", source)
            assert begun == re.findall(r"\\end\{(\w+)", source)[::-1] == ["table", "tabular"]
            assert all(rule in source for rule in (r"\toprule", r"\midrule", r"\bottomrule"))
            assert r"\label{tab:a-b-c}" in source
            assert r"\caption{Title 100 \% \& more}" in source
        assert r"& \multicolumn{1}{c}{g\_1} \\" in to_latex(wide)
        assert r"\cmidrule(lr){3-3}" in to_latex(wide)

    def test_latex_rows_have_every_column(self):
        body = to_latex(TABLE).split(r"\midrule")[1].split(r"\bottomrule")[0]
        rows = [line for line in body.splitlines() if line.strip()]
        assert [len(re.findall(r"(?<!\\)&", row)) for row in rows] == [2, 2, 2]
        assert "$-4.50$" in rows[2]
        assert "--" in rows[1]

    def test_csv_has_six_digits_and_every_row(self):
        rows = list(csv.reader(io.StringIO(to_csv(replace(TABLE, shown=1)))))
        assert rows[0] == ["name", "x [m]", "n"]
        assert rows[1] == [NASTY, "1.23457", "3"]
        assert rows[2] == ['ü, "q"', "", ""]
        assert len(rows) == 4

    def test_what_is_not_shown_is_announced(self):
        short = replace(TABLE, shown=1)
        for text in (to_markdown(short), to_latex(short), to_text(short)):
            assert "Rows that only the CSV file of this table has: 2." in text

    @pytest.mark.parametrize("width", [40, 60, 80, 120, 300])
    def test_text_fits_the_terminal_and_cuts_no_number(self, width):
        columns = (
            Column("name", align="left"),
            *(Column(f"c{i}", format=".3f", group="g" if i < 3 else "") for i in range(9)),
        )
        numbers = tuple(1000.0 + i for i in range(9))
        table = Table("T", columns, (("a long name " * 4, *numbers), ("b", *numbers)))
        text = to_text(table, width=width)
        assert max(map(display_width, text.splitlines())) <= width
        assert all(text.count(f"{number:.3f}") == 2 for number in numbers)

    def test_words_behind_the_numbers_stand_once(self):
        columns = (Column("who", align="left"), *(Column(f"number {n}") for n in range(4)),
                   Column("verdict", align="left"))  # fmt: skip
        text = to_text(Table("T", columns, (("lasso", 1.0, 2.0, 3.0, 4.0, "worse"),)), width=30)
        assert (text.count("lasso"), text.count("worse")) == (3, 1)
        assert max(map(len, text.splitlines())) <= 30

    def test_text_cuts_the_middle_of_names(self):
        rows = tuple((f"alpha_fraction_of_the_largest={i}", 1.0) for i in range(2))
        text = to_text(Table("T", (Column("s", align="left"), Column("x")), rows), width=24)
        assert "…" in text
        assert len(set(text.splitlines()[-2:])) == 2


class TestSummary:
    def test_a_failure_is_no_error_and_no_hit(self):
        cases = frame(
            case(0, percent=(10, 0)), case(1, status="unidentifiable"), case(2, status="timeout"),
            case(3, status="ok", est_timescale=math.inf), case(4, status="inaccurate"),
        )  # fmt: skip
        assert estimated(cases).tolist() == [True, False, False, False, True]
        assert MEASURES["hits"].per_case(cases).tolist() == [1, 0, 0, 0, 1]
        assert percent_errors(cases)[0].tolist() == pytest.approx([10, 0, -100 / 11])
        assert np.isnan(percent_errors(cases)[1:4]).all()

    def test_a_number_that_an_unidentifiable_case_carries_is_not_an_estimate(self):
        cases = frame(case(0) | {"status": "unidentifiable"})
        assert not estimated(cases).any()

    def test_settings_of_one_label_are_told_apart_by_what_varies(self):
        cases = frame(
            *(case(0, settings=json.dumps({"alpha": a, "joint": True})) for a in (0.1, 0.2)),
            case(0, backend="stlsq", label="stlsq"),
            case(0, backend="stlsq", label="stlsq strong", settings='{"threshold": 9}'),
        )
        assert [group.setting for group in by_setting(cases)] == [
            "alpha=0.1", "alpha=0.2", "default", "strong",
        ]  # fmt: skip


class TestParameters:
    def test_the_paper_flight_stands_beside_the_paper(self):
        cases = frame(case(0, percent=(1, -2), true=(15.43, 4.21)))
        table = TABLES.make("parameters", beside(TABLE1), cases)
        assert table.notes == ("rounded",)
        assert [row[1] for row in table.rows] == ["true value", "paper, Table 1", "matched"]
        assert column(table, "U0", "error")[1:] == [3.37, pytest.approx(1.0)]
        assert column(table, "L_w", "value") == [4.21, 4.20, pytest.approx(4.21 * 0.98)]
        assert column(table, "τ_w", "error")[2] == pytest.approx(100 * (0.98 / 1.01 - 1))

    def test_without_a_reference_there_is_no_such_row(self):
        table = TABLES.make("parameters", STUDY, frame(case(0), case(0, status="error")))
        assert [row[1] for row in table.rows] == ["true value", "matched", "matched"]
        assert table.rows[2][-1] == "error"
        assert "–" in to_text(table)

    def test_the_note_of_table_1_on_rounding_is_right(self):
        reference = Study.load(STUDIES / "table1.toml").reference
        printed = reference.estimate[1] / reference.estimate[0]
        assert 100 * (printed / (4.21 / 15.43) - 1) == pytest.approx(-3.49, abs=0.005)
        assert pytest.approx(-3.70, abs=0.005) == 100 * (0.26 / 0.27 - 1)
        assert "-3.49 %" in reference.note


class TestErrors:
    cases = frame(
        case(0, percent=(10, 2)), case(1, percent=(-30, 4)), case(2, status="error"),
        case(3, percent=(5, 0), status="inaccurate", hit=False),
    )  # fmt: skip

    def test_signed_means_by_hand(self):
        table = TABLES.make("errors", beside(TABLE2), self.cases)
        assert table.rows[0][:1] == ("paper, Table 2",)
        assert table.rows[0][-7:-1] == (-4.43, -0.17, 0.10, -18.80, -5.91, 33.30)
        assert table.rows[1][3:6] == (4, 2, 1)
        assert column(table, "U0", "mean signed error")[1] == pytest.approx(-0.5)
        assert column(table, "U0", "mean signed % error")[1] == pytest.approx(-5.0)
        assert column(table, "L_w", "mean signed % error")[1] == pytest.approx(2.0)
        expected = np.mean([1.02 / 1.1, 1.04 / 0.7, 1 / 1.05]) * 100 - 100
        assert column(table, "τ_w", "mean signed % error")[1] == pytest.approx(expected)
        assert column(table, "hits")[1] == 50.0

    def test_absolute_by_hand(self):
        table = TABLES.make("errors-absolute", STUDY, self.cases)
        assert column(table, "U0", "mean |error|") == [pytest.approx(15.0)]
        assert column(table, "U0", "median |error|") == [pytest.approx(10.0)]
        assert column(table, "U0", "95th percentile |error|") == [pytest.approx(28.0)]
        assert column(table, "failures") == [1]

    def test_nobody_answered(self):
        cases = frame(case(0, status="crashed"), case(1, status="skipped"))
        for name in ("errors", "errors-absolute", "readings", "times", "sensitivity"):
            to_text(TABLES.make(name, beside(TABLE2), cases))
        table = TABLES.make("errors-absolute", STUDY, cases)
        assert column(table, "failures") == [2]
        assert math.isnan(column(table, "U0", "mean |error|")[0])

    def test_a_row_per_factor_level(self):
        rows = [case(i, **{"library.target": t}) for i in range(2) for t in ("a", "b")]
        table = TABLES.make("errors-absolute", STUDY, frame(*rows))
        assert column(table, "library.target") == ["a", "b"]
        assert column(table, "n") == [2, 2]


class TestReadings:
    def test_distance_is_zero_at_the_printed_numbers(self):
        assert distance(TABLE2.signed_error, TABLE2.signed_error) == 0.0
        assert distance((-18.80 + 3, -5.91, 33.30), TABLE2.signed_error) == pytest.approx(
            math.sqrt(3)
        )
        assert math.isnan(distance((math.nan, 0.0, 0.0), TABLE2.signed_error))

    def test_closest_first_and_unanswered_last(self):
        levels = {"near": (-18.0, -6.0), "far": (50.0, 50.0), "none": (0.0, 0.0)}
        rows = [
            case(0, percent=percent, status="error" if name == "none" else "ok",
                 **{"readout.eq24": name})
            for name, percent in reversed(levels.items())
        ]  # fmt: skip
        table = TABLES.make("readings", beside(TABLE2), frame(*rows))
        assert column(table, "readout.eq24") == ["near", "far", "none"]
        assert column(table, "hits") == [1, 1, 0]
        near = ((-18 + 18.8) ** 2 + (-6 + 5.91) ** 2 + (100 * (0.94 / 0.82 - 1) - 33.3) ** 2) / 3
        assert column(table, "distance")[0] == pytest.approx(math.sqrt(near))

    def test_without_a_reference_nothing_is_close(self):
        with pytest.raises(InputError, match=r"give \[outputs.reference\]"):
            TABLES.make("readings", STUDY, frame(case(0)))

    def test_fifteen_are_shown_and_all_are_in_the_csv(self):
        rows = [case(0, percent=(i, 0), **{"library.step": float(i)}) for i in range(20)]
        table = TABLES.make("readings", beside(TABLE2), frame(*rows))
        assert len(table.visible_rows) == 15
        assert len(to_csv(table).splitlines()) == 21

    def test_sensitivity_changes_one_factor_at_a_time(self):
        effect = {("a", 1.0): 1.0, ("a", 2.0): 3.0, ("b", 1.0): 11.0, ("b", 2.0): 43.0}
        rows = [
            case(0, percent=(0, size), **{"library.target": t, "library.step": s})
            for (t, s), size in effect.items()
        ]
        table = TABLES.make("sensitivity", STUDY, frame(*rows))
        assert column(table, "factor") == ["library.target", "library.step"]
        assert column(table, "comparisons") == [2, 2]
        # target: 10 and 40; step: 2 and 32.
        assert column(table, "L_w", "range of median |error|") == pytest.approx([25.0, 17.0])
        assert column(table, "L_w", "the largest such range") == pytest.approx([40.0, 32.0])

    def test_sensitivity_covers_settings_and_counts_failures(self):
        rows = [
            case(i, percent=(0, size), status="error" if (i, size) == (1, 9) else "ok",
                 settings=json.dumps({"rcond": size}))
            for i in range(2) for size in (1, 9)
        ]  # fmt: skip
        table = TABLES.make("sensitivity", STUDY, frame(*rows))
        assert column(table, "factor") == ["back-end and setting", "lasso rcond"]
        assert column(table, "L_w", "range of mean signed %") == pytest.approx([8.0, 8.0])
        assert column(table, "failures") == [1, 1]


class TestTimes:
    def test_by_hand(self):
        cases = frame(
            case(0, seconds=1.0, certificate=1e-12), case(1, seconds=2.0, certificate=3e-3),
            case(2, seconds=3.0, status="timeout", certificate=5.0),
        )  # fmt: skip
        table = TABLES.make("times", STUDY, cases)
        assert column(table, "median", "time") == [2.0]
        assert column(table, "95 %", "time") == [pytest.approx(2.9)]
        assert column(table, "worst") == [3e-3]
        assert column(table, "certificate") == ["duality_gap"]
        assert column(table, "ok", "cases that ended as") == [2]
        assert column(table, "timeout", "cases that ended as") == [1]


def test_tables_that_apply():
    assert tables_for(frame(case(0))) == ["parameters", "times"]
    assert tables_for(frame(case(0), case(1))) == ["errors", "errors-absolute", "times"]
    swept = [case(i, **{"flights.velocity_noise": n}) for i in range(2) for n in (0.0, 1.0)]
    assert "sensitivity" in tables_for(frame(*swept))
    assert "readings" not in tables_for(frame(*swept))


def test_formats_render_everything_they_are_given():
    for spec in (SIGNIFICANT, ".2f", "+.2f", "d", ".1e", ""):
        assert cell_text(7, Column("x", format=spec))


def test_a_label_of_its_own_is_not_doubled_in_a_legend():
    cases = frame(case(0), case(0, label="truncated", settings='{"rcond": 0.01}', backend="lasso"))
    assert [group.title for group in by_setting(cases)] == ["lasso", "truncated"]
