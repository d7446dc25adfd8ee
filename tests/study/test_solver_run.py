"""Studies of solvers run for real, small: rows, limits, resuming, pages, and the command line."""

import dataclasses
import json
import math
import os
import signal

import numpy as np
import pandas as pd
import pytest

from sparsefit.cli import main
from sparsefit.errors import InputError
from sparsefit.study.evidence.solver_compared import solvers_compared
from sparsefit.study.evidence.solver_ratios import ratios
from sparsefit.study.run import runner, solver_crew, solver_kind, solver_worker
from sparsefit.study.run.merge import merge
from sparsefit.study.run.solver_clock import Repeats, median_interval
from sparsefit.study.run.solver_solve import (
    Task,
    Timing,
    Verdict,
    fresh,
    judged,
    reference_bounds,
    solve,
)
from sparsefit.study.run.solver_worker import Answer, Ask, Hand, Lost, Worker, small_problem
from sparsefit.study.run.store import read_cases
from sparsefit.study.spec.choices import make_backend
from sparsefit.study.spec.solver_study import Clock, SolverCase, SolverStudy
from tests.study.solver_files import HEAD, LASSO, STLSQ, write_data, write_study

TEXT = (
    HEAD
    + 'question = "Which?"\ntolerances = [1e-3, 1e-8]\naccuracies = [1e-6]\n'
    + '[[problems]]\nfile = "one.npz"\n[[problems]]\nfile = "two.npz"\n'
    + LASSO
    + '[[backends]]\nname = "lasso"\ncertified = true\n'
    + STLSQ
    + "[path]\npoints = 4\n[clock]\nrepeats = 3\nseconds = 9.0\n"
)


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("solvers")
    write_data(folder)
    write_data(folder, "two", seed=1, targets=2)
    path = write_study(folder, TEXT)
    assert main(["study", "run", str(path), "--results", str(folder / "results")]) == 0
    return SolverStudy.load(path), path, folder / "results"


def test_every_planned_case_is_a_row_and_what_is_missing_too(finished):
    study, _, results = finished
    cases = read_cases(results / study.name)
    planned = [study.case(*at) for at in np.ndindex(study.count, len(study.cells))]
    assert list(cases["case_id"]) == list(map(study.case_id, planned))
    done = runner.status(study, results)
    assert (done.planned, done.done, done.finished) == (len(cases), len(cases), True)
    assert set(cases[cases["solver"] == "adelie"]["status"]) == {"skipped"}
    ran = cases[cases["solver"] != "adelie"]
    assert set(ran["status"]) == {"ok"}
    assert (ran["excess"] <= ran["tolerance"].fillna(1e-8)).all()
    assert (ran["excess"] <= ran["certificate"] + 1e-12).all()
    assert (ran["cpu"] > 0).all()
    assert (ran["repeats"] == 3).all()
    assert not (results / study.name / ".partial").exists()
    greedy = cases[cases["solver"] == "stlsq"]
    assert set(greedy["certificate_kind"]) == {"fixed_point"}
    assert set(greedy["points"]) == {1}  # it has no penalty, and so no path


def test_a_finished_study_is_not_run_again_and_a_changed_one_is_refused(finished, tmp_path):
    study, path, results = finished
    again = runner.run(study, results)
    assert again.resumed == again.planned
    other = write_study(path.parent, TEXT.replace("points = 4", "points = 5"))
    with pytest.raises(InputError, match="different study"):
        runner.run(SolverStudy.load(other), results)
    write_study(path.parent, TEXT)


def test_a_run_that_was_stopped_goes_on(finished, tmp_path, monkeypatch):
    study, *_ = finished
    asked = []

    def answers(_, ask):
        asked.append(ask)
        if len(asked) == 18:
            raise KeyboardInterrupt
        verdict = Verdict("duality_gap", 0.0, 0.0, "", 4, 4)
        return Answer(Timing(0.01, 0.01), verdict, 1.0)

    monkeypatch.setattr(solver_crew.Crew, "ask", answers)
    with pytest.raises(KeyboardInterrupt):
        runner.run(study, tmp_path)
    half = runner.status(study, tmp_path)
    assert 0 < half.done < half.planned
    torn = tmp_path / study.name / ".partial" / "rows.jsonl"
    torn.write_bytes(torn.read_bytes() + b'{"case_id": "torn')
    told = []
    done = runner.run(study, tmp_path, progress=lambda *more: told.append(more))
    assert (done.resumed, done.finished, told[-1][0]) == (half.done, True, study.planned)
    assert len(read_cases(tmp_path / study.name)) == study.planned
    turns = [ask.case for ask in asked if ask.what == "time"]
    assert turns[:4] == turns[7:3:-1]  # by turns, in alternating order


def test_what_took_too_long_is_not_tried_at_a_tighter_tolerance(finished, tmp_path, monkeypatch):
    study, *_ = finished
    lost = Lost("timeout", "the solve took longer than 1 s")
    monkeypatch.setattr(solver_crew.Crew, "ask", lambda *_: lost)
    runner.run(study, tmp_path)
    cases = read_cases(tmp_path / study.name)
    told = cases[cases["solver"] == "clarabel-direct"]["reason"].tolist()
    assert told[0] == lost.reason
    assert told[1] == f"not tried: at tolerance 0.001 {lost.reason}"


def test_what_failed_is_timed_again_with_all_that_took_turns_with_it(
    finished, tmp_path, monkeypatch
):
    study, *_ = finished
    good = Answer(Timing(0.01, 0.01), Verdict("duality_gap", 0.0, 0.0, "", 4, 4), 1.0)
    lost = Lost("crashed", "the process died")
    asked = []

    def answers(_, ask):
        asked.append(ask.case)
        ill = len(asked) < 100 and ask.case.problem == 1
        return lost if ill else good

    monkeypatch.setattr(solver_crew.Crew, "ask", answers)
    assert runner.run(study, tmp_path).statuses["crashed"] > 0
    asked += [None] * 100
    assert runner.run(study, tmp_path).resumed == study.planned
    again = runner.run(study, tmp_path, retry_failed=True)
    assert again.statuses["crashed"] == 0
    assert 0 < again.resumed < again.planned
    assert {case.problem for case in asked[asked.index(None) :] if case} == {1}
    assert len(read_cases(tmp_path / study.name)) == study.planned
    assert runner.run(study, tmp_path, retry_failed=True).resumed == study.planned


def test_a_changed_file_keeps_what_was_timed_together(tmp_path, monkeypatch):
    asked = []

    def answers(_, ask):
        asked.append(ask.case.problem)
        return Answer(Timing(0.01, 0.01), Verdict("duality_gap", 0.0, 0.0, "", 4, 4), 1.0)

    def ran(text):
        asked.clear()
        return runner.run(SolverStudy.load(write_study(tmp_path, text)), tmp_path / "results")

    monkeypatch.setattr(solver_crew.Crew, "ask", answers)
    for name, seed in (("one", 0), ("two", 1), ("three", 2)):
        write_data(tmp_path, name, seed=seed)
    whole = ran(TEXT)
    fewer = ran(TEXT.replace(STLSQ, ""))
    assert (asked, fewer.planned) == ([], fewer.resumed)
    assert 0 < fewer.planned < whole.planned
    first = '[[problems]]\nfile = "three.npz"\n[[problems]]\nfile = "one.npz"'
    more = ran(TEXT.replace(STLSQ, "").replace('[[problems]]\nfile = "one.npz"', first))
    assert (set(asked), more.resumed, more.finished) == ({0}, fewer.planned, True)
    rows = read_cases(more.folder)
    assert list(dict.fromkeys(rows["problem"])) == ["three", "one", "two"]
    assert list(rows["case_id"].str[:3].unique()) == ["000", "001", "002"]
    with pytest.raises(InputError, match="different study"):
        ran(TEXT.replace("repeats = 3", "repeats = 4"))


def answered(*_):
    return Answer(Timing(0.01, 0.01), Verdict("duality_gap", 0.0, 0.0, "", 4, 4), 1.0)


def test_only_computes_whole_turns_and_parts_of_one_machine_come_together(
    finished, tmp_path, monkeypatch, capsys
):
    study, path, _ = finished
    monkeypatch.setattr(solver_crew.Crew, "ask", answered)
    for place, name in (("a", "one"), ("b", "two")):
        done = runner.run(study, tmp_path / place, only=[name])
        assert 0 < done.computed == done.done < study.planned
    turns = runner.run(study, tmp_path / "c", only=["clarabel-direct"])
    lasso = [cell for cell in study.cells if cell.label == "lasso"]
    assert turns.done == study.count * len(lasso)
    parts = [str(tmp_path / place / study.name) for place in "ab"]
    assert merge(study, tmp_path / "all", parts).finished
    assert len(read_cases(tmp_path / "all" / study.name)) == study.planned
    monkeypatch.setattr(solver_kind, "processor", lambda: "another")
    runner.run(study, tmp_path / "d", only=["two"])
    elsewhere = ["study", "merge", str(path), parts[0], str(tmp_path / "d")]
    assert main([*elsewhere, "--results", str(tmp_path / "none")]) == 2
    assert "another machine" in capsys.readouterr().err
    assert not (tmp_path / "none" / study.name / "cases.parquet").exists()


def test_what_was_timed_on_another_machine_is_stale_and_no_part_of_a_new_comparison(
    finished, tmp_path, monkeypatch
):
    study, *_ = finished
    monkeypatch.setattr(solver_crew.Crew, "ask", answered)
    runner.run(study, tmp_path, only=["one"])
    monkeypatch.setattr(solver_kind, "processor", lambda: "another")
    assert runner.status(study, tmp_path).stale == study.planned // 2
    assert runner.run(study, tmp_path).computed == study.planned
    again = runner.run(study, tmp_path)
    assert (again.computed, again.stale, again.finished) == (0, 0, True)


def test_two_runs_are_held_against_each_other(finished, tmp_path, capsys):
    study, path, results = finished
    first = results / study.name
    rows = read_cases(first)
    slower = rows.assign(cpu=np.where(rows["solver"] == "homotopy", 3 * rows["cpu"], rows["cpu"]))
    slower.loc[slower["solver"] == "stlsq", "status"] = "error"
    (tmp_path / "second").mkdir()
    slower.to_parquet(tmp_path / "second" / "cases.parquet")
    pair = ["study", "compare", str(path), str(tmp_path / "second"), "--results", str(results)]
    assert main([*pair, "--json", "--fail-on", "worse", "-o", str(tmp_path / "told")]) == 1
    told = json.loads(capsys.readouterr().out)
    assert (told["changed"], told["cases"]) == (study.count, study.planned)
    assert told["largest_change"] == pytest.approx(2.0)
    assert (tmp_path / "told" / "comparison.svg").exists()
    assert main(["study", "compare", str(path), str(path), "--results", str(results)]) == 0
    many = [
        pd.concat(
            [
                one.assign(problem=one["problem"] + str(n), case_id=one["case_id"] + str(n))
                for n in range(3)
            ]
        )
        for one in (rows, slower)
    ]
    both = solvers_compared(*many, ("a", "b"))
    assert "1 slower, 0 faster" in both.sentence


def test_an_exact_path_may_be_charged_for_its_certificates(finished):
    study, _, results = finished
    rows = read_cases(results / study.name)
    plain = rows[rows["solver"] == "homotopy"]["excess"].to_numpy()
    charged = rows[rows["solver"] == "homotopy, certified"]["excess"].to_numpy()
    assert len(charged) == study.count
    assert np.allclose(plain, charged, atol=1e-12)
    table = ratios(study, rows, "lasso")
    assert {row[0] for row in table.rows} == {"homotopy", "homotopy, certified"}
    best = [row for row in table.rows if row[1] == "best of the others"]
    direct = rows[(rows["solver"] == "clarabel-direct") & (rows["excess"] <= 1e-6)]
    exact = rows[rows["solver"] == "homotopy"].set_index("problem")["cpu"]
    for place, name in enumerate(("one", "two"), 2):
        ratio = direct[direct["problem"] == name]["cpu"].min() / exact[name]
        assert float(best[0][place]) == pytest.approx(ratio, rel=0.01)


def test_pages_name_every_contender_and_say_what_they_cannot_tell(finished):
    study, _, results = finished
    folder = results / study.name
    text = (folder / "README.md").read_text(encoding="utf-8")
    for contender in study.contenders:
        assert contender.solver in text
    assert "numpy" in text
    assert "cannot tell" in text
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert page.count("<figure>") >= 3
    assert page.index("What this comparison cannot tell") < page.index("Versions, machine")
    names = {path.name for path in folder.iterdir()}
    assert {
        "summary-lasso.csv",
        "times-lasso.md",
        "clock.tex",
        "profiles.svg",
        "accuracy.png",
    } <= names
    assert {"cases.parquet", "manifest.json", "data-profiles.svg"} <= names


def test_the_verbs_work_on_a_study_of_solvers(finished, capsys):
    study, path, results = finished
    where = [str(path), "--results", str(results)]
    assert main(["study", "check", str(path)]) == 0
    assert "missing: adelie" in capsys.readouterr().out
    assert main(["study", "plan", str(path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["cases"] == study.planned
    assert main(["study", "status", *where]) == 0
    assert "finished" in capsys.readouterr().out
    assert main(["study", "show", *where, "--table", "times"]) == 0
    assert "homotopy" in capsys.readouterr().out
    case = study.case_id(study.case(1, 0))
    assert main(["study", "show", *where, "--case", case, "--json"]) == 0
    assert case in capsys.readouterr().out
    assert main(["study", "show", *where, "--case", "000-nothing"]) == 2
    assert "plans no case" in capsys.readouterr().err
    assert main(["study", "errors", *where]) == 0
    assert main(["study", "run", *where, "--processes", "2"]) == 2
    assert "one process" in capsys.readouterr().err
    assert main(["study", "run", *where, "--executor", "dask"]) == 2
    assert "this machine" in capsys.readouterr().err
    told = runner.run(study, results, renew_stale=True)
    assert (told.computed, told.stale, told.done) == (0, 0, study.planned)
    assert main(["study", "run", *where, "--only", "lasoo"]) == 2
    assert "a problem, a back-end, an objective, a solver" in capsys.readouterr().err
    assert main(["study", "show", *where, "--table", "tims"]) == 2
    assert 'did you mean "times"' in capsys.readouterr().err


def test_a_solve_beyond_the_limit_is_killed_and_one_that_dies_is_told(finished, tmp_path):
    study = finished[0]
    hasty = dataclasses.replace(study, clock=Clock(limit=1e-7))
    worker = Worker(hasty)
    case = SolverCase(0, 1, 1e-8)
    try:
        worker.ask(Hand(study.problems[0].build()))
        lost = worker.ask(Ask("judge", case))
        assert lost.status == "timeout"
        assert lost.reason.startswith("the solve took longer than 1e-0")
        assert worker.pid is None
        worker.ask(Ask("first", case))
        os.kill(worker.pid, signal.SIGKILL)
        lost = worker.ask(Ask("judge", case))
        assert lost.status == "crashed"
    finally:
        worker.close()


def test_a_process_that_waits_for_ever_without_working_is_killed_by_the_clock(
    finished, monkeypatch
):
    study = finished[0]
    worker = Worker(study)
    try:
        worker.ask(Hand(study.problems[0].build()))
        os.kill(worker.pid, signal.SIGSTOP)
        monkeypatch.setattr(solver_worker, "HAND_SECONDS", 0.3)
        lost = worker.ask(Ask("first", SolverCase(0, 1, 1e-8)))
        assert lost == Lost("timeout", "the process took longer than 0.3 s (0.0 s of CPU)")
    finally:
        worker.close()


def task_of(solver, tolerance=math.nan, fractions=(0.5, 0.1)):
    return Task(make_backend("lasso", {"solver": solver}), fractions, tolerance)


def test_the_referee_and_not_the_solver_judges():
    problem, task = small_problem(), task_of("clarabel-direct", 1e-2)
    bounds = reference_bounds(problem, task)
    loose = judged(problem, task, solve(task, fresh(problem)), bounds)
    exact_task = task_of("homotopy")
    exact = judged(problem, exact_task, solve(exact_task, fresh(problem)), bounds)
    assert exact.excess <= 1e-12
    assert exact.excess < loose.excess <= loose.gap
    boasting = [type(s)(2.0 * np.asarray(s.weights), "ok") for s in solve(task, problem)]
    assert judged(problem, task, boasting, bounds).excess > 0.01
    nothing = [type(s)(None, "error", "fell over") for s in boasting]
    verdict = judged(problem, task, nothing, bounds)
    assert (verdict.answered, verdict.asked, verdict.excess) == (0, 2, math.inf)


def test_work_is_charged_anew_to_every_solve():
    problem = small_problem()
    assert problem.statistics.gram is not None
    clone = fresh(problem)
    assert "statistics" not in vars(clone)
    assert clone.theta is problem.theta


def test_a_median_is_known_by_order_statistics():
    middle, low, high = median_interval([5.0, 1.0, 3.0, 2.0, 4.0, 6.0])
    assert (middle, low, high) == (3.5, 1.0, 6.0)  # 1 - 2/64 of the probability
    assert all(math.isnan(end) for end in median_interval([1.0] * 5)[1:])
    draw = np.random.default_rng(3).exponential(size=(2000, 11))
    inside = [low <= math.log(2) <= high for _, low, high in map(median_interval, draw)]
    assert np.mean(inside) == pytest.approx(1 - 24 / 2048, abs=0.01)  # P(B < 2) = 12/2048


def test_repeats_end_when_known_or_at_their_limits():
    case, clock = SolverCase(0, 0, math.nan), Clock(repeats=8, seconds=1.0, precision=0.05)
    steady, noisy, slow = Repeats(case), Repeats(case), Repeats(case)
    for place in range(6):
        assert not steady.done(clock)
        steady.note(Timing(0.01, 0.01))
        noisy.note(Timing(0.01 * (1 + place), 0.02 * (1 + place)))
    assert steady.done(clock)
    assert not noisy.done(clock)
    assert noisy.disturbed
    assert not steady.disturbed
    slow.note(Timing(1.5, 1.5))
    assert slow.done(clock)
    assert not slow.known(clock)
