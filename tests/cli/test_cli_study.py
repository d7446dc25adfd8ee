"""The verbs on studies, on one small study that is run once."""

import io
import json
import os
import re
import shutil
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from unittest.mock import Mock

import pytest

from sparsefit.cli import main
from sparsefit.cli.terminal import Progress
from sparsefit.estimator.estimator import Estimator
from sparsefit.study import evidence, study
from sparsefit.study.store import read_cases
from sparsefit.study.study import Study
from sparsefit.study.trials import Latency
from tests.cli.verbs import refused, run
from tests.study.small_study import small_study

STUDY = f"""{small_study("small", count=4, seed=1, duration=2.0)}
[readout]
refine = "none"
[[backends]]
name = "lasso"
alpha_fraction = [0.01, 0.1]
[[backends]]
name = "stlsq"
threshold = 50
[[protocols]]
name = "default"
[[protocols]]
name = "paper"
"derivative.method" = "forward"
[sweep]
"flights.velocity_noise" = [0.0, 0.1]
"library.target" = ["flow-velocity", "acceleration"]
[split]
validate = 2
evaluate = 2
[outputs]
tables = ["errors", "times"]
figures = ["errors"]
headline = "median timescale-error"
"""
UNTIMED = ("--latency-flights", "0")
PLANNED = 4 * 2 * 4 * 3


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    folder = tmp_path_factory.mktemp("home")
    (folder / "small.toml").write_text(STUDY)
    part = ["study", "run", str(folder / "small.toml"), "--processes", "1", "--only", "stlsq"]
    assert main(part) == 0
    shutil.copytree(folder, f"{folder}-half")
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        assert main([*part[:-2], "--json"]) == 0
    said = {"out": out.getvalue(), "err": err.getvalue()}
    (folder / "resumed.json").write_text(json.dumps(said))
    return folder


@pytest.fixture
def finished(home, tmp_path):
    shutil.copytree(home, tmp_path, dirs_exist_ok=True)
    return "small.toml"


@pytest.fixture
def half(home, tmp_path):
    shutil.copytree(f"{home}-half", tmp_path, dirs_exist_ok=True)
    return "small.toml"


def test_check_and_plan_say_what_is_planned(capsys, half):
    code, out, _ = run(capsys, "study", "check", half)
    assert code == 0
    assert re.match(rf"study +small\nstatus +ok\nkind +flights\ncases +{PLANNED}\n", out)
    assert json.loads(run(capsys, "study", "check", half, "--json")[1])["cases"] == PLANNED
    assert "levels library.target" in run(capsys, "study", "plan", half)[1]
    record = json.loads(run(capsys, "study", "plan", half, "--json")[1])
    assert (record["units"], len(record["conditions"]), len(record["candidates"])) == (4, 2, 12)
    assert record["cases"] == PLANNED


def test_run_leaves_report_and_prints_the_main_table(capsys, finished):
    code, out, err = run(capsys, "study", "run", finished)
    assert (code, err) == (0, "")
    assert out.startswith("small: ?\nMedian |error| of τ_w, over ")
    headline = out.splitlines()[1]
    assert headline.replace("|", "\\|") in Path("results/small/README.md").read_text()
    for label, value in (("computed", 0), ("statuses ok", 64), ("statuses unidentifiable", 32)):
        assert re.search(rf"^{label} +{value}$", out, re.MULTILINE)
    assert re.search(r"^report +results/small/README.md$", out, re.MULTILINE)
    for name in ("README.md", "errors.tex", "errors.svg", "cases.parquet", "manifest.json"):
        assert Path("results/small", name).is_file()


def test_run_goes_on_where_it_was_stopped(home):
    said = json.loads((home / "resumed.json").read_text())
    found = json.loads(said["out"])
    assert (found["cases"], found["resumed"]) == (PLANNED, 32)
    assert found["headline"].startswith("Median |error| of τ_w")
    manifest = json.loads((home / "results/small/manifest.json").read_text())
    assert manifest["wall_seconds"] == pytest.approx(found["seconds"], abs=1e-3)
    assert said["err"].startswith(f"32/{PLANNED} cases, 33 %\n")
    assert said["err"].endswith(f"{PLANNED}/{PLANNED} cases, 100 %\n")


@pytest.mark.parametrize("fresh_run", [False, True])
def test_ctrl_c_says_how_to_go_on(capsys, half, monkeypatch, fresh_run):
    monkeypatch.setattr(study, "run", Mock(side_effect=KeyboardInterrupt))
    code, _, err = run(capsys, "study", "run", half, *["--fresh"] * fresh_run)
    again = "without --fresh to continue" if fresh_run else "again to continue"
    assert code == 130
    assert err.strip() == f"stopped; run the same command {again}"


def test_lines_are_few_and_truthful(capsys, monkeypatch):
    clock = iter([0.0, 1.0, 4.9, 5.1, 6.0])
    monkeypatch.setattr("time.monotonic", lambda: next(clock))
    lines = Progress()
    for done, left in ((0, None), (10, 200.0), (20, 150.0), (30, 130.0), (100, 0.0)):
        lines(done, 100, left)
    assert capsys.readouterr().err.splitlines() == [
        "0/100 cases, 0 %",
        "30/100 cases, 30 %, about 0:02:10 left",
        "100/100 cases, 100 %",
    ]


def test_a_stopped_study_tells_how_far_it_is(capsys, half):
    _, out, _ = run(capsys, "study", "status", half)
    assert [line.split() for line in out.splitlines()][2:6] == [
        ["planned", "96"], ["done", "32"], ["finished", "false"], ["stale", "0"]
    ]  # fmt: skip
    found = json.loads(run(capsys, "study", "status", half, "--json")[1])
    assert (found["finished"], found["done"]) == (False, 32)
    out = run(capsys, "study", "status", half, "--results", "elsewhere")[1]
    assert re.search(r"done +0\n", out)
    assert re.search(r"planned +96\nnot_ok +32\n", run(capsys, "study", "errors", half)[1])
    assert "32 of 96 planned cases" in run(capsys, "study", "show", half)[1]
    assert "run" in refused(capsys, "select", half)
    assert "32 of 96 cases are there" in refused(capsys, "study", "report", half)


def test_errors_are_grouped_by_reason(capsys, finished):
    code, out, _ = run(capsys, "study", "errors", finished)
    assert code == 0
    assert re.search(r"not_ok +32\n\ncases +8\nstatus +unidentifiable\nlabel +default: stlsq", out)
    group, *_ = json.loads(run(capsys, "study", "errors", finished, "--json")[1])["groups"]
    assert group["first_case"].startswith("0000-")


def test_show_prints_the_tables(capsys, finished):
    code, out, _ = run(capsys, "study", "show", finished)
    assert code == 0
    assert out.startswith("small: ?\nMedian |error| of τ_w, over ")
    assert "96 of 96 planned cases" in out
    assert "Times and certificates" in out
    _, out, _ = run(capsys, "study", "show", finished, "--table", "errors-absolute")
    assert out.startswith("Sizes of the percentage errors")
    tables = json.loads(run(capsys, "study", "show", finished, "--json")[1])
    assert list(tables) == ["errors", "times"]


def test_report_writes_the_same_again(capsys, finished):
    before = Path("results/small/errors.csv").read_text()
    os.remove("results/small/errors.csv")
    code, out, _ = run(capsys, "study", "report", finished)
    assert code == 0
    assert out.startswith("headline  Median |error| of τ_w")
    assert Path("results/small/errors.csv").read_text() == before


def test_select_writes_the_estimator_of_the_winner(capsys, finished):
    code, out, _ = run(capsys, "select", finished, *UNTIMED)
    assert code == 0
    assert out.startswith("Use ")  # the choice comes first
    assert "regime and time: results/small/evidence.md" in out
    assert "use it: sparsefit estimate FLIGHT --estimator estimator.json" in out
    text = Path("estimator.json").read_text()
    _, out, _ = run(capsys, "select", finished, *UNTIMED, "--force", "--json")
    found, estimator = json.loads(out), Estimator.from_json(text)
    assert Path("estimator.json").read_text() == text
    assert estimator.backend.name == found["backend"] == "lasso"
    assert estimator.backend.alpha_fraction == found["settings"]["alpha_fraction"]
    assert estimator.library.target == found["factors"]["library.target"]
    assert estimator.derivative.method == {"default": "auto", "paper": "forward"}[found["protocol"]]
    assert estimator.library.grid.upper == 6.0
    assert json.loads(text)["provenance"]["study_hash"] == Study.from_file(finished).hash


def test_select_times_what_keeps_the_constraints_once(capsys, finished, monkeypatch):
    asked = []

    def measured(definition, cells, flights):
        asked.append(flights)
        return Latency(0.25, 0.5, 90.0, flights)

    monkeypatch.setattr(study, "measured", measured)
    monkeypatch.setattr(evidence, "write_selection", lambda *_, **__: [Path("evidence.md")])
    options = ("--max-failure", "0", "--latency-flights", "7", "--json")
    _, out, _ = run(capsys, "select", finished, *options)
    assert asked == [7] * json.loads(out)["eligible"]
    _, out, _ = run(capsys, "select", finished, *options, "--force")
    assert len(asked) == json.loads(out)["eligible"]
    assert json.loads(out)["latency"] == {
        "median": 0.25, "p99": 0.5, "memory": 90.0, "flights": 7, "busy": 0.0
    }  # fmt: skip
    _, out, _ = run(capsys, "select", finished, *options, "--force", "--measure-again")
    assert len(asked) == 2 * json.loads(out)["eligible"]


def test_select_checks_the_choice_on_fresh_flights_once(capsys, finished, monkeypatch):
    options = (*UNTIMED, "--max-failure", "0.5", "--processes", "1", "--force", "--check")
    _, out, _ = run(capsys, "select", finished, *options, "3")
    assert (out + Path("results/small/evidence.md").read_text()).count("Fresh seeds: ") == 2
    trues = set(read_cases("results/small/fresh")["true_length_scale"])
    assert len(trues - set(read_cases("results/small")["true_length_scale"])) == len(trues) == 3
    _, again, err = run(capsys, "select", finished, *options, "3")
    assert (again, err) == (out, "")
    monkeypatch.setattr("sparsefit.study.plan._digest", lambda: "other")  # of the code
    run(capsys, "select", finished, *options, "3")
    assert read_cases("results/small/fresh")["version"].str.endswith("other").all()


def test_select_says_what_binds_where_nothing_keeps_the_constraints(capsys, finished):
    code, out, _ = run(capsys, "select", finished, *UNTIMED, "--max-error", "1e-9")
    assert code == 1
    assert "max_error: refuses 12" in out
    assert not Path("estimator.json").exists()
    assert "No candidate" in Path("results/small/evidence.md").read_text()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--criterion", "mean"), "[select] criterion: unknown measure"),
        (("--over", "best"), "[select] over: unknown regime"),
        (("--max-failure", "2"), "--max-failure must be at least 0"),
        (("--check", "1000000000"), "--check must be at least 0 and at most 100000"),
        (("--max-failure", "2%"), '"2%" is not a number'),
        (("--max-memory", "90"), "--max-memory needs it"),
        (("-o", "small.toml"), "small.toml exists; add --force"),
        (("-o", "nowhere/e.json"), "cannot write nowhere/e.json"),
        (("-o", "small.toml/e.json"), "cannot write small.toml/e.json"),
        (("--results", "elsewhere"), "run them first"),
    ],
)
def test_select_refuses(capsys, finished, options, words):
    assert words in refused(capsys, "select", finished, *UNTIMED, *options)


def test_a_rule_of_selection_that_is_none_is_refused_before_a_run(capsys, half):
    Path("bad.toml").write_text(f'{STUDY}[select]\ncriterion = "mean timescale-eror"')
    for action in ("check", "run"):
        words = "bad.toml: [select] criterion: unknown measure"
        assert words in refused(capsys, "study", action, "bad.toml")


def test_results_of_another_study_are_refused(capsys, finished):
    Path(finished).write_text(STUDY.replace("seed = 1", "seed = 2"))
    for action in ("study run", "study status", "study errors", "study show", "select"):
        assert "made by a different study" in refused(capsys, *action.split(), finished)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        *((f"check {name}", name) for name in ("missing.toml", ".")),
        ("run small.toml --results file", "cannot write file/small"),
        ("run small.toml --processes 0", "at least 1"),
        ("show small.toml --table eror", 'did you mean "errors"?'),
        ("compare nowhere small.toml", "No such file"),
        ("compare small.toml small.toml --tolerance -1", "--tolerance must be"),
        ("merge small.toml folder", "holds no rows of small"),
    ],
)
def test_what_no_action_can_do_is_refused(capsys, finished, words, message):
    Path("file").write_text("")
    os.mkdir("folder")
    assert message in refused(capsys, "study", *words.split())


class TestCompare:
    def test_a_run_with_itself(self, capsys, finished):
        shutil.copytree("results/small", "old")
        code, out, _ = run(capsys, "study", "compare", "old", finished)
        assert code == 0
        assert out.startswith("0 of 96 cases changed")

    def test_what_changed_fails(self, capsys, finished):
        cases = read_cases("results/small")
        cases = cases[cases["settings"].str.contains("0.01")]
        for name in ("first", "other"):
            os.mkdir(name)
        cases.to_parquet("first/cases.parquet")
        cases.loc[cases["case_id"] == cases["case_id"].iloc[0], "est_length_scale"] *= 1.001
        cases[1:].to_parquet("other/cases.parquet")
        both = ("study", "compare", "first", "other")
        code, out, _ = run(capsys, *both, "--json")
        found = json.loads(out)
        assert (code, found["changed"], found["only"]) == (1, 0, [1, 0])
        cases.to_parquet("other/cases.parquet")
        code, out, _ = run(capsys, *both)
        assert code == 1
        assert out.splitlines()[-1].startswith("1 of 32 cases changed, 0 of them in status")


class TestMerge:
    def test_parts_make_the_whole(self, capsys, home, finished):
        whole, part = read_cases("results/small"), f"{home}-half/results/small"
        os.rename("results", "before")
        code, out, _ = run(capsys, "study", "merge", finished, part)
        assert code == 0
        assert re.search(r"planned +96\ndone +32\nfinished +false\n", out)
        code, out, _ = run(capsys, "study", "merge", finished, part, "before/small")
        assert re.search(r"half/results/small\nrows +32\ntaken +0\n", out)
        assert re.search(r"before/small\nrows +96\ntaken +64\n", out)
        assert re.search(r"done +96\nfinished +true\n", out)
        assert Path("results/small/README.md").exists()
        assert read_cases("results/small").equals(whole)
