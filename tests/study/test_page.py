"""Pages, and two runs held against each other."""

import math
import re

import pytest

from sparsefit.errors import InputError
from sparsefit.study import page, tables
from sparsefit.study.compare import compare
from tests.study.frames import case, frame, solve, spread, study

HOSTILE = "</script><script>alert(1)</script>\"'&"


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """The files of a page of two tables and two pictures, a back-end with a hostile name in it."""
    cases = spread(flights=10)
    cases.loc[cases["label"] == "stlsq", ["title", "candidate"]] = HOSTILE
    made = study(cases, tmp=tmp_path_factory.mktemp("page"), tables=("errors", "status"),
                 figures=("errors", "scatter"))  # fmt: skip
    made.question = HOSTILE
    return {path.name: path for path in page.write(made)}


class TestPage:
    def test_every_output_is_a_file_and_the_readme_is_the_last(self, files):
        assert set(files) == {"errors.csv", "errors.tex", "errors.svg", "scatter.svg",
                              "status.csv", "status.tex", "report.html", "README.md"}  # fmt: skip
        assert list(files)[-1] == "README.md"
        text = files["README.md"].read_text()
        assert "![scatter](scatter.svg)" in text
        assert "20 of 20 planned cases: 20 ok" in text
        assert "Dashed" not in text  # errors are below 5 %

    def test_the_page_is_one_file_that_fetches_and_runs_nothing_of_others(self, files):
        text = files["report.html"].read_text()
        assert text.count("<script>") == 1
        assert "alert(1)</script>" not in text.replace("&lt;/script&gt;", "")
        assert not re.search(r"(src|href)=\"https?:", text)
        assert "default-src 'none'; script-src 'sha256-" in text

    def test_lines_hide_axes_turn_and_parts_share_no_name(self, files):
        text = files["report.html"].read_text()
        assert 'data-line="line-0" aria-pressed="true">lasso<' in text
        assert "linear axes" in text
        clips = re.findall(r'<clipPath id="(\w+)"', text)
        assert len(set(clips)) == len(clips)

    def test_a_readme_is_short_whatever_the_study(self, tmp_path):
        many = frame(*(case(n % 2, (0.0, 0.1 * n), label=f"setting {n // 2}") for n in range(200)))
        made = study(many, tmp=tmp_path, figures=("errors",))
        (made.folder / "manifest.json").write_text("[")  # damaged
        text = page.write(made)[-1].read_text()
        assert (len(text.split()) <= 800, "quantile. Dashed: 5 %.*" in text) == (True, True)
        assert "more rows in the [CSV file](status.csv)" in text

    def test_the_verdict_stands_in_front(self, tmp_path):
        cases = frame(*(solve(f"p{n}", name, 0.1) for n in range(5) for name in ("a", "b")))
        page.write(study(cases, tmp=tmp_path, figures=("shapes",)))
        text = (tmp_path / "report.html").read_text()
        heads = re.findall(r'<button type="button">([^<]*)</button></th>', text)
        assert heads[:3] == ["objective", "solver", "verdict"]
        assert text.index("Solvers: success and time") < text.index("<figure")

    def test_a_study_of_problems_that_are_predicted_begins_with_that(self, tmp_path):
        sizes = {"a": 0.2, "b": 0.1}
        cases = frame(*(solve(f"p{n}", name, 0.1, holdout_error=size) for n in range(3)
                        for name, size in sizes.items()))  # fmt: skip
        made = study(cases, tmp=tmp_path, figures=("shapes",))
        assert next(iter(tables.tables(made, cases))) == "prediction"
        text = page.write(made)[-1].read_text()
        assert (
            "Median held-out error, of the target's variance, over 3 problems: 10.0 % (b)" in text
        )
        assert text.index("What is predicted and recovered") < text.index("![shapes]")

    def test_a_headline_without_any_word_of_the_study(self):
        cases = spread(flights=10)
        said = page.headline(study(cases), cases)
        assert re.match(r"Median \|error\| of τ_w, over 10 flights: [\d.]+ % \(\w+\) to", said)
        failed = frame(case(0, None, status="error"))
        assert ": no answer (lasso)" in page.headline(study(failed), failed)

    @pytest.mark.parametrize("outputs", [
        {"tables": ("eror",)}, {"figures": ("skat",)}, {"headline": "err"}, {"figures": ("sweep",)},
    ])  # fmt: skip
    def test_unknown_outputs_are_refused_before_anything_is_run(self, outputs):
        with pytest.raises(InputError):
            page.check_outputs(study(spread(flights=10), **outputs))


class TestComparison:
    def test_what_changed(self):
        first, second = spread(flights=10), spread(flights=10)
        lasso = second["label"] == "lasso"
        second.loc[lasso, "est_timescale"] *= 1.2
        second.loc[second.index[-1], "status"] = "misfit"
        made = compare(first, second, ("a", "b"))
        assert made.sentence.startswith("11 of 20 cases changed, 1 of them in status")
        assert "the largest change is 16.7 %" in made.sentence
        sizes = made.changes.groupby(["label", "status, second"])["change [%]"].max().to_dict()
        assert sizes["lasso", "ok"] == pytest.approx(100 / 6)
        assert sizes["stlsq", "misfit"] == 0.0
        assert made.record()["changed"] == 11

    def test_a_number_that_is_lost_is_an_infinite_change(self):
        second = spread(flights=10)
        names = ["est_mean_velocity", "est_length_scale", "est_timescale"]
        second.loc[second.index[0], names] = math.nan
        made = compare(spread(flights=10), second, ("a", "b"))
        assert math.isinf(made.changes["change [%]"].iloc[0])

    def test_problems_are_compared_by_their_held_out_error_and_not_by_time(self):
        def solved(factor, error=0.1):
            return frame(*(solve(f"p{n}", "ours", factor * 0.1, holdout_error=error + 0.01 * n)
                           for n in range(6)))  # fmt: skip

        made = compare(solved(1.0), solved(1.5), ("a", "b"))
        assert not made.differs
        made = compare(solved(1.0), solved(1.0, 0.2), ("a", "b"))
        assert made.changes["change [%]"].max() == pytest.approx(50.0)
        assert len(made.changes) == 6

    def test_runs_that_have_nothing_in_common_are_refused(self):
        other = spread(flights=10).assign(case_id=[f"x{n}" for n in range(20)])
        with pytest.raises(InputError, match="no case in common"):
            compare(spread(flights=10), other, ("a", "b"))
        with pytest.raises(InputError, match="no case in common"):
            compare(spread(flights=10), frame(solve("p0", "a", 1.0)), ("a", "b"))
