"""Runs that are killed, that hang, that crash: every planned case still ends as its own row."""

import json
import os
import signal
import subprocess
import sys
from functools import partial
from pathlib import Path
from unittest.mock import Mock

import pandas as pd
import pytest

import sparsefit as sf
from sparsefit.errors import InputError
from sparsefit.regression.backend import plugins
from sparsefit.study.plan import sources, without_words
from sparsefit.study.runner import locked
from sparsefit.study.schema import digest_of
from sparsefit.study.store import CASES, STORE, Row, Store, read_cases
from sparsefit.study.trials import Latency
from tests.study import attacks, hostile
from tests.study.small_study import small_study

ROOT = Path(__file__).parents[2]
LASSO = '[[backends]]\nname = "lasso"\nalpha_fraction = [0.3, 0.1]\n'
SQUARES = '[[backends]]\nname = "least-squares"\n'
SWEEP = '[sweep]\n"flights.velocity_noise" = [0.0, 0.2]\n'
WHOLE = LASSO + SQUARES + SWEEP


@pytest.fixture(scope="module", autouse=True)
def plugin(tmp_path_factory):
    folder = tmp_path_factory.mktemp("plugin")
    hostile.install(folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(folder))
        patch.setenv("PYTHONPATH", os.pathsep.join([str(ROOT), str(folder)]))
        plugins.cache_clear()
        yield folder
    plugins.cache_clear()


def load(folder, body, *, count=3, timeout=30.0, name="r"):
    text = f"{small_study(name, count=count)}[run]\ncase_timeout = {timeout}\n{body}"
    (folder / "s.toml").write_text(text)
    return sf.Study.from_file(folder / "s.toml")


def deeds(*names):
    return f'[[backends]]\nname = "hostile"\ndeed = {json.dumps(names)}\n'


def stable(folder):
    return read_cases(folder).drop(columns=["seconds"])


def by_deed(cases):
    named = {row.backend: row for row in cases.itertuples()}
    hostile_ones = cases[cases["backend"] == "hostile"].itertuples()
    return named | {json.loads(row.settings)["deed"]: row for row in hostile_ones}


@pytest.fixture(scope="module")
def whole(plugin, tmp_path_factory):
    study = load(tmp_path_factory.mktemp("whole"), WHOLE)
    return study, study.run(processes=1)


def test_a_run_leaves_every_case_in_plan_order(whole):
    study, summary = whole
    assert summary.finished
    assert (summary.computed, summary.resumed, summary.planned) == (18, 0, 18)
    cases = read_cases(study.folder)
    assert cases["case_id"].tolist() == study.plan()["case_id"].tolist()
    assert sorted(path.name for path in study.folder.iterdir()) == [CASES, "manifest.json"]
    assert study.cases["candidate"].tolist() == study.plan()["candidate"].tolist()
    assert study.status().finished
    again = study.run(processes=1)
    assert (again.computed, again.finished) == (0, True)


@pytest.mark.parametrize("victim", ["parent", pytest.param("worker", marks=pytest.mark.slow)])
def test_killed_and_resumed_is_as_if_never_killed(whole, tmp_path, victim):
    body = LASSO + SQUARES + '[[backends]]\nname = "hostile"\nseconds = 0.2\n' + SWEEP
    study = load(tmp_path, body)
    process = attacks.started(tmp_path, 2 if victim == "worker" else 1)
    attacks.until(lambda: len(attacks.stored(study.folder)) > 2 or process.poll() is not None)
    if victim == "worker":
        for child in attacks.children_of(process.pid):
            os.kill(child, signal.SIGKILL)
        assert process.wait(120.0) == 0
    else:
        os.kill(process.pid, signal.SIGKILL)
        process.wait(10.0)
        assert study.status().done > 0
        study.run(processes=1)
    cases, expected = (stable(each.folder).set_index("case_id") for each in (study, whole[0]))
    mine = cases[cases["backend"] != "hostile"]
    if victim == "worker":  # what was at work when it died may be its own case's end
        mine = mine[mine["status"] != "crashed"]
        assert len(mine) >= len(expected) - 2
        expected = expected.loc[mine.index]
    pd.testing.assert_frame_equal(mine, expected)
    assert len(cases) == study.planned.size


def test_an_interrupt_keeps_the_rows_so_far(tmp_path):
    study = load(tmp_path, '[[backends]]\nname = "hostile"\nseconds = 0.3\n', count=20)
    # A shell that runs the tests in the background has its children ignore SIGINT.
    heard = partial(signal.signal, signal.SIGINT, signal.SIG_DFL)
    process = attacks.started(tmp_path, 1, preexec_fn=heard)
    attacks.until(lambda: attacks.stored(study.folder) or process.poll() is not None)
    os.kill(process.pid, signal.SIGINT)
    assert process.wait(60.0) != 0
    done = study.status().done
    assert 0 < done < 20
    assert len(study.cases) == done


def test_deeds_of_a_back_end_are_its_own_rows(tmp_path, whole, capfd):
    """A hang, deaths, messages and patches: nobody else's numbers, nobody else's time."""
    lies = ("forge", "foreign", "patch")  # how else processes end: test_workers
    names = ("work", "fork", "print", "name", "status", *lies, "hang-native", "raise", "memory")
    text = small_study("r", count=1) + "[run]\ncase_timeout = 3.0\nmax_memory = 1500\n"
    text += deeds(*names) + LASSO + SQUARES
    (tmp_path / "s.toml").write_text(text)
    study = sf.Study.from_file(tmp_path / "s.toml")
    cases = read_cases(study.run(processes=1).folder)
    assert len(cases) == study.planned.size
    ours = cases["backend"].isin(["lasso", "least-squares"])
    expected = read_cases(whole[0].folder)
    calm = (expected["flight"] == 0) & (expected["flights.velocity_noise"] == 0.0)
    expected = expected[calm].reset_index(drop=True)
    numbers = [name for name in cases if name.startswith(("est_", "status", "certificate"))]
    pd.testing.assert_frame_equal(
        cases.loc[ours, numbers].reset_index(drop=True), expected[numbers]
    )
    told = by_deed(cases[~ours])
    for good in ("work", "fork", "print"):
        assert told[good].status in ("ok", "unidentifiable"), told[good]
    ends = [told[name].status for name in ("forge", "foreign", "hang-native", "memory")]
    assert ends == ["crashed", "crashed", "timeout", "error"]
    assert "took longer than 3 s" in told["hang-native"].reason
    assert told["memory"].reason.startswith("memory: ")
    assert (told["raise"].status, told["raise"].reason) == ("error", "ZeroDivisionError: one two")
    assert "\\udcff\\x1b" in told["name"].reason
    assert "status 7" in told["status"].reason
    assert cases["true_length_scale"].between(3.0, 6.0).all()
    assert capfd.readouterr().out == ""


def test_a_path_that_hangs_blames_one_of_its_cases(tmp_path):
    """Cases that share a path are tried one by one when it is lost."""
    study = load(tmp_path, deeds("work", "hang"), count=1, timeout=2.0)
    cases = by_deed(read_cases(study.run(processes=1).folder))
    assert cases["hang"].status == "timeout"
    assert cases["work"].status in ("ok", "unidentifiable")


def changed(whole, tmp_path, body):
    """The finished study's folder beside a study file that differs."""
    study = load(tmp_path, body)
    study.folder.mkdir(parents=True)
    for path in whole[0].folder.iterdir():
        (study.folder / path.name).write_bytes(path.read_bytes())
    return study


@pytest.fixture
def copied(whole, tmp_path):
    """The finished study once more, in a folder of its own."""
    return changed(whole, tmp_path, WHOLE)


def test_a_changed_study_computes_its_new_cases_and_drops_others_when_it_is_finished(
    whole, tmp_path
):
    study = changed(whole, tmp_path, SQUARES + '[[backends]]\nname = "stlsq"\n' + SWEEP)
    summary = study.run(processes=1, only=["least-squares"])
    assert (summary.resumed, summary.computed, summary.dropped) == (6, 0, 12)
    back = load(tmp_path, WHOLE)
    assert back.run(processes=1).computed == 0
    pd.testing.assert_frame_equal(stable(back.folder), stable(whole[0].folder))
    summary = study.run(processes=1)
    assert (summary.resumed, summary.computed, summary.dropped) == (6, 6, 12)
    assert study.cases["backend"].unique().tolist() == ["least-squares", "stlsq"]
    assert study.status().dropped == 0


def test_only_stale_and_failed_rows(whole, tmp_path, monkeypatch):
    split = "[split]\nvalidate = 1\nevaluate = 2"
    study = changed(whole, tmp_path, WHOLE + split)
    with pytest.raises(InputError, match=r'"lasso"\?; give a back-end, label, protocol, unit or'):
        study.run(only=["laso"], fresh=True)  # and nothing is lost
    monkeypatch.setattr("sparsefit.study.plan._digest", lambda: "other")
    later = sf.Study.from_file(tmp_path / "s.toml")
    assert later.status().stale == 18
    summary = later.run(processes=1, stale=True, only=["least-squares"])
    assert (summary.computed, summary.stale) == (6, 12)
    with Store.opened(later.folder, later.planned) as store:
        for row in store.rows()[:2]:
            store.put_row(row.of(row.case_id, row.values | {"status": "timeout", "reason": "slow"}))
    assert later.run(processes=1, retry_failed=True).computed == 2
    (later.folder / "README.md").write_text("what the rows from before told")
    assert later.run(processes=1, fresh=True, only=[later.plan()["case_id"][3]]).done == 1
    assert [path.name for path in later.folder.iterdir()] == [STORE]


def forged(study, bodies):
    attacks.unpack(study)
    with Store.opened(study.folder, study.planned) as store:
        for row, body in zip(store.rows(), bodies, strict=False):
            store.put_row(row._replace(body=body))
    return study


def test_forged_rows_are_computed_again(whole, copied, monkeypatch):
    forged(copied, ["{", "[" * 100_000, "[]", '{"status": []}'])
    monkeypatch.setattr(Row, "crc", 1)
    with Store.opened(copied.folder, copied.planned) as store:  # as it was, but for its checksum
        store.put_row(store.rows()[-1])
    monkeypatch.undo()
    assert copied.run(processes=1).damaged == 5
    pd.testing.assert_frame_equal(stable(copied.folder), stable(whole[0].folder))


@pytest.mark.parametrize(
    ("value", "said"),
    [
        ('"version": [1]', "'list' object"), ('"samples": "many"', "'many'"),
        (f'"samples": {2**70}', "too large"), ('"reason": "\\ud800"', "surrogates"),
    ],
)  # fmt: skip
def test_a_forged_value_is_refused_in_a_line(copied, value, said):
    assert forged(copied, [f'{{"status": "ok", {value}}}']).status().done == 18
    with pytest.raises(InputError, match=f"another type .*{said}"):
        copied.run(processes=1)


def test_a_run_that_ends_between_its_files_goes_on(copied, monkeypatch):
    attacks.unpack(copied)
    with Store.opened(copied.folder, copied.planned) as store:  # an export that is another
        store.put_row((row := store.rows()[0]).of(row.case_id, row.values | {"reason": "another"}))
    monkeypatch.setattr("sparsefit.study.store.write_whole", Mock(side_effect=KeyboardInterrupt))
    with pytest.raises(KeyboardInterrupt):
        copied.run(processes=1)
    assert (copied.folder / CASES).exists() > copied.status().finished
    (copied.folder / f".{CASES}.a.partial").touch()  # of a kill while it was written
    monkeypatch.undo()
    assert (copied.run(processes=1).computed, len([*copied.folder.iterdir()])) == (0, 2)
    assert read_cases(copied.folder)["reason"][0] == "another"


def test_spoiled_bytes_are_refused_or_passed_over(copied):
    wrong, refused = attacks.damaged(copied, 40)
    assert (wrong, 10 < refused < 40) == (0, True)


@pytest.mark.parametrize("name", [STORE, CASES, "manifest.json"])
def test_a_pipe_or_a_link_in_a_file_s_place_is_not_waited_for(copied, name):
    (copied.folder / name).unlink(missing_ok=True)
    os.mkfifo(copied.folder / name)
    if name == "manifest.json":
        assert copied.status().done == 18
        return
    with pytest.raises(InputError, match="no regular file"):
        copied.run(processes=1)


def test_a_full_disk_and_a_lost_folder_are_told_in_a_line(copied):
    import resource

    row = Store.read(copied.folder, copied.planned).rows()[0]
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)

    def fill():
        with Store.opened(copied.folder, copied.planned) as store:
            resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, hard))
            for number in range(500):
                store.put_row(row._replace(case_id=f"x{number}"))

    def lose():
        with Store.opened(copied.folder, copied.planned) as store:
            (copied.folder / STORE).unlink()
            store.sync()

    try:
        with pytest.raises(InputError, match=r"full|I/O") as caught:
            fill()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        signal.signal(signal.SIGXFSZ, before)
    assert "\n" not in str(caught.value)
    assert copied.status().done == 18
    with pytest.raises(InputError, match="removed during the run"):
        lose()


def test_two_runs_at_once_and_wrong_requests_are_refused(whole):
    study, _ = whole
    with locked(study.folder), pytest.raises(InputError, match="another run is under way"):
        study.run(processes=1)
    with pytest.raises(InputError, match="whole number of at least 1"):
        study.run(processes=0)


def test_parts_are_merged_and_no_part_is_believed_without_its_checksum(whole, tmp_path):
    parts = []
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        part = changed(whole, tmp_path / name, WHOLE)
        attacks.unpack(part)
        with Store.opened(part.folder, part.planned) as store, store.base:
            flight = "0000" if name == "a" else "0002"
            store.base.execute(f"DELETE FROM cases WHERE case_id LIKE '{flight}-%'")
        parts.append(part)
    target = load(tmp_path, WHOLE)
    merged = target.merge([part.folder for part in parts])
    assert [part.taken for part in merged] == [12, 6]
    pd.testing.assert_frame_equal(stable(target.folder), stable(whole[0].folder))
    (full_copy := tmp_path / "c").mkdir()
    bare = changed(whole, full_copy, WHOLE)
    manifest, frame = bare.folder / "manifest.json", read_cases(bare.folder)
    pd.concat([frame, frame]).to_parquet(bare.folder / CASES)
    forged = {"sha256": {CASES: digest_of(bare.folder / CASES)}}
    for content, words in ((forged, "two rows .*: leave this part"), ({}, "no checksum of it")):
        manifest.write_text(json.dumps(content))
        with pytest.raises(InputError, match=words):
            target.merge([bare.folder])
    frame.assign(flow=1).to_parquet(bare.folder / CASES)
    with pytest.raises(InputError, match='without one column "flow" of text'):
        read_cases(bare.folder)
    with Store.opened(parts[0].folder, parts[0].planned) as store:
        store.put_row((row := store.rows()[0]).of(row.case_id, row.values | {"status": "misfit"}))
    with pytest.raises(InputError, match=r"differs between .* leave one"):
        target.merge([parts[0].folder])
    (parts[0].folder / "cases.sqlite").write_bytes(b"x" * 4096)
    with pytest.raises(InputError, match=r"damaged .*: leave this part out"):
        target.merge([parts[0].folder])


def test_the_version_is_that_of_every_file_that_can_change_a_number():
    """Modules that a worker imports, also for all that it computes, are in the version."""
    code = (
        "import sys, sparsefit.study.problem_desk, sparsefit.study.flight_experiment, "
        "sparsefit.study.problem_experiment, sparsefit.solvers.registry\n"
        "from sparsefit.study.flight_desk import FlightDesk\n"
        "from types import SimpleNamespace as Some\n"
        "FlightDesk(Some(points=()))\n"  # which estimates once
        "print('\\n'.join(m.__file__ for n, m in sys.modules.items() "
        "if n.startswith('sparsefit') and getattr(m, '__file__', None)))"
    )
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = {Path(line) for line in told.stdout.split()}
    counted = set(sources())
    package = Path(sf.__file__).parent
    uncounted = {path.relative_to(package).as_posix() for path in loaded - counted}
    compiled = {name for name in uncounted if name.endswith(".so")}
    assert uncounted - compiled <= {"study/__init__.py"}
    assert len(counted) > 100


def test_words_change_no_version():
    source = "def area(side):\n    return side * side\n"
    wordy = '# Why.\n\ndef area(side):  # a\n    """The area."""\n    return side * side  # b\n'
    assert without_words(wordy) == without_words(source) == source
    assert without_words(source.replace("*", "+")) != without_words(source)


def test_latency_and_variants_of_candidates(copied, tmp_path):
    candidate = copied.plan()["candidate"].iloc[-1]
    (latency,) = copied.latency([candidate], 10).values()
    assert 0.0 < latency.median <= latency.p99 < 10.0 < latency.memory
    assert copied.latencies == copied.latency([candidate], 10) == {candidate: latency}
    mad = load(tmp_path, SQUARES + '[sweep]\n"flights.thrust_acceleration" = [[1e12, 0.0]]\n')
    (unknown,) = mad.latency([mad.plan()["candidate"][0]], 2).values()  # no flight is simulated
    assert (unknown.p99, unknown.memory, unknown.flights) == (float("inf"), float("inf"), 0)
    fresh = copied.variant([candidate], 2)
    assert [*fresh.plan()["candidate"].unique(), fresh.seed == copied.seed] == [candidate, False]
    assert copied.estimator(candidate).backend.name == "least-squares"
    again = copied.again(copied.plan()["case_id"][0])
    row = copied.cases.iloc[0]
    assert again.values["est_length_scale"] == row["est_length_scale"]
    with pytest.raises(InputError, match="plans no case '0000-1'"):
        copied.again("0000-1")


def test_an_interrupt_keeps_the_candidates_that_were_timed(copied, monkeypatch):
    first, second = copied.plan()["candidate"].unique()[:2]
    timed = iter([Latency(0.1, 0.2, 30.0, 10)])
    monkeypatch.setattr("sparsefit.study.study.measured", lambda *_: next(timed))
    with pytest.raises(StopIteration):
        copied.latency([first, second], 10)
    assert list(copied.latencies) == [first]


@pytest.mark.slow
def test_rows_from_dask_are_those_of_processes(whole, tmp_path):
    dask = pytest.importorskip("distributed")
    study = load(tmp_path, SQUARES + SWEEP, count=1)
    how = {"threads_per_worker": 1, "dashboard_address": None, "processes": True}
    with dask.LocalCluster(n_workers=1, **how) as cluster:
        assert study.run(scheduler=cluster.scheduler_address).finished
    expected = stable(whole[0].folder)
    mine = (expected["flight"] == 0) & (expected["backend"] == "least-squares")
    expected = expected[mine].reset_index(drop=True)
    pd.testing.assert_frame_equal(stable(study.folder), expected)
    with pytest.raises(InputError, match="cannot be reached"):
        study.run(scheduler="tcp://127.0.0.1:1", fresh=True)
