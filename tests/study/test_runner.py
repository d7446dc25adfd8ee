"""Runs that are killed, that hang, that crash: every planned case still ends as a row."""

from __future__ import annotations

import contextlib
import json
import math
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import pandas as pd
import pytest

from sparsefit import backends
from sparsefit.errors import InputError, SparsefitError
from sparsefit.study import Study, read_cases, run, status
from sparsefit.study.run import partial, pool, runner
from sparsefit.study.run.lock import LOCK, locked
from sparsefit.study.run.outcome import Outcome
from sparsefit.study.run.worker import Worker
from sparsefit.study.spec.solver_study import SolverStudy
from tests.conftest import SECONDS, run_in_process
from tests.study import hostile
from tests.study.small_study import small_study
from tests.study.solver_files import HEAD, write_data, write_study

ROOT = Path(__file__).parents[2]
REAL = """
[[backends]]
name = "lasso"
alpha_fraction = [0.3, 0.1, 0.03]
[[backends]]
name = "group-lasso"
[[backends]]
name = "hostile"
seconds = 0.1
[[protocols]]
name = "a"
[[protocols]]
name = "b"
"readout.mean_velocity" = "peak"
[sweep]
"flights.velocity_noise" = [0.0, 0.2]
"""
DRIVER = """
import sys
from sparsefit.study import Study, run
if __name__ == "__main__":
    run(Study.load(sys.argv[1]), sys.argv[2], processes=int(sys.argv[3]))
"""

DIES_LOCKED = """
import os, sys
from filelock import SoftFileLock
lock = SoftFileLock(sys.argv[1], timeout=0)
lock.acquire()
os.kill(os.getpid(), 9)
"""

Write = Callable[..., Path]


@pytest.fixture(scope="module", autouse=True)
def plugin(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    folder = tmp_path_factory.mktemp("plugin")
    hostile.install(folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(folder))
        backends._plugins.cache_clear()
        yield folder
    backends._plugins.cache_clear()


def text_of(body: str, *, count: int = 3, timeout: float = 30.0) -> str:
    return f"{small_study('r', count=count)}[run]\ncase_timeout = {timeout}\n{body}"


@pytest.fixture
def write(tmp_path: Path) -> Write:
    def _write(body: str, *, name: str = "r.toml", **how: float) -> Path:
        path = tmp_path / name
        path.write_text(text_of(body, **how))
        return path

    return _write


class Whole(NamedTuple):
    """A study of 3 flights that ran undisturbed, without a worker."""

    path: Path
    folder: Path
    statuses: dict[str, int]


@pytest.fixture(scope="module")
def whole(plugin: Path, tmp_path_factory: pytest.TempPathFactory) -> Whole:
    path = tmp_path_factory.mktemp("whole") / "r.toml"
    path.write_text(text_of(REAL))
    with pytest.MonkeyPatch.context() as patch:
        run_in_process(patch)
        summary = run(Study.load(path), path.parent, processes=1)
    return Whole(path, summary.folder, dict(summary.statuses))


def deeds(*names: str) -> str:
    return f'[[backends]]\nname = "hostile"\ndeed = {json.dumps(names)}\n'


def stable(folder: Path) -> pd.DataFrame:
    return read_cases(folder).drop(columns="seconds")


def start(study: Path, results: Path, plugin: Path, processes: int = 2) -> subprocess.Popen[bytes]:
    driver = study.with_name("driver.py")
    driver.write_text(DRIVER)
    path = os.pathsep.join([str(ROOT), str(plugin)])
    return subprocess.Popen(
        [sys.executable, str(driver), str(study), str(results), str(processes)],
        env={**os.environ, "PYTHONPATH": path},
        start_new_session=True,
        # A shell that runs the tests in the background has its children ignore SIGINT.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )


def rows(folder: Path) -> list[bytes]:
    path = folder / ".partial" / "rows.jsonl"
    return path.read_bytes().splitlines() if path.exists() else []


def until(condition: Callable[[], bool], seconds: float = 60.0) -> None:
    limit = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < limit, "waited too long"
        time.sleep(0.02)


def session_is_gone(session: int) -> bool:
    """Whether no live process of the session is left; zombies do not count."""
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            with contextlib.suppress(OSError, IndexError):
                fields = (entry / "stat").read_text().rsplit(")", 1)[1].split()
                if fields[3] == str(session) and fields[0] != "Z":
                    return False
    return True


def test_same_rows_without_workers_and_with_two(tmp_path: Path, whole: Whole) -> None:
    study = Study.load(whole.path)
    two = run(study, tmp_path, processes=2)
    assert whole.statuses == two.statuses
    assert len(read_cases(whole.folder)) == study.planned == 3 * 2 * 2 * 5
    pd.testing.assert_frame_equal(stable(whole.folder), stable(two.folder))


@pytest.mark.usefixtures("in_process")  # what goes on; what is killed has a worker
def test_killed_and_resumed_is_as_if_never_killed(
    tmp_path: Path, whole: Whole, plugin: Path
) -> None:
    process = start(whole.path, tmp_path / "killed", plugin, processes=1)
    folder = tmp_path / "killed" / "r"
    until(lambda: len(rows(folder)) >= 5)
    process.send_signal(signal.SIGKILL)
    process.wait()
    until(lambda: session_is_gone(process.pid), 10.0)  # the workers ended on their own
    before = rows(folder)
    assert not (folder / "cases.parquet").exists()
    with (folder / ".partial" / "rows.jsonl").open("ab") as file:
        file.write(b'{"flight":1,"cel')  # torn by the kill
    study = Study.load(whole.path)
    so_far = status(study, tmp_path / "killed")
    assert (so_far.finished, so_far.done) == (False, len(before))

    seen: list[int] = []
    resumed = run(
        study, tmp_path / "killed", processes=1, progress=lambda done, _p, _e: seen.append(done)
    )
    assert resumed.resumed == seen[0] == len(before)
    pd.testing.assert_frame_equal(stable(resumed.folder), stable(whole.folder))
    assert sorted(p.name for p in folder.iterdir()) == ["cases.parquet", "manifest.json"]


def test_interrupt_leaves_a_state_to_resume_and_no_process(
    tmp_path: Path, whole: Whole, plugin: Path
) -> None:
    process = start(whole.path, tmp_path / "out", plugin, processes=1)
    folder = tmp_path / "out" / "r"
    until(lambda: len(rows(folder)) >= 3)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does
    assert process.wait(timeout=20) != 0
    until(lambda: session_is_gone(process.pid), 10.0)
    assert not (folder / ".lock").exists()
    assert status(Study.load(whole.path), tmp_path / "out").done == len(rows(folder))


def test_a_fit_that_hangs_is_killed_with_its_readouts_and_processes_and_the_others_go_on(
    tmp_path: Path, write: Write, monkeypatch: pytest.MonkeyPatch
) -> None:
    started: list[Study] = []
    start = Worker.start

    def counted(study: Study, *, patience: float) -> Worker:
        started.append(study)
        return start(study, patience=patience)

    monkeypatch.setattr(Worker, "start", counted)
    sweep = '[sweep]\n"readout.mean_velocity" = ["rms", "peak", "paper"]\n'
    deed = deeds("work", "child", "nothing") + sweep
    study = Study.load(write(deed, count=1, timeout=3.0))
    begun = time.monotonic()
    cases = read_cases(run(study, tmp_path, processes=1).folder)
    assert time.monotonic() - begun < 300.0  # of the 600 s that it would hang
    by_deed = {json.loads(s)["deed"]: g for s, g in cases.groupby("settings")}
    assert (by_deed["child"]["status"] == "timeout").all()
    assert (by_deed["child"]["reason"] == "fitting took longer than 3 s").all()
    assert by_deed["work"]["status"].isin(["ok", "unidentifiable"]).all()
    assert (by_deed["nothing"]["status"] == "error").all()
    assert len(cases) == 3 * 3
    assert len(started) == 2  # the second for the others: none was spent on what had hung
    listed = [entry for entry in Path("/proc").iterdir() if entry.name.isdigit()]
    assert not any(b"sleep\0600" in command(entry) for entry in listed)


def command(entry: Path) -> bytes:
    with contextlib.suppress(OSError):
        return (entry / "cmdline").read_bytes()
    return b""


def test_what_a_back_end_breaks_is_its_own_row(
    tmp_path: Path, write: Write, capfd: pytest.CaptureFixture[str]
) -> None:
    ends = ("die", "exit", "raise")
    names = ("fork", "scribble", "print", "name", "status", *ends, "work")
    late = '[[backends]]\nname = "late"\n[[backends]]\nname = "lasso"\n'
    study = Study.load(write(deeds(*names) + late, count=1))
    summary = run(study, tmp_path, processes=1)
    cases = read_cases(summary.folder)
    assert len(cases) == study.planned == len(names) + 2
    told = {
        json.loads(row.settings)["deed"] if row.backend == "hostile" else row.backend: row
        for row in cases.itertuples()
    }
    for good in ("fork", "print", "work", "lasso"):
        assert told[good].status in ("ok", "unidentifiable"), told[good]
    assert told["scribble"].status == "crashed"
    assert "message channel" in told["scribble"].reason
    assert (told["name"].status, told["status"].status) == ("error", "error")
    assert "\\udcff\\x1b" in told["name"].reason
    assert "status 7, which is none of ok" in told["status"].reason
    assert (told["die"].status, told["exit"].status) == ("crashed", "crashed")
    assert "SIGKILL" in told["die"].reason
    assert "exit code 3" in told["exit"].reason
    assert (told["raise"].status, told["raise"].reason) == ("error", "ZeroDivisionError: one two")
    assert cases["true_length_scale"].between(3.0, 6.0).all()
    assert not math.isnan(told["work"].est_length_scale)
    assert (told["late"].status, told["late"].reason) == ("error", "RuntimeError: not here")
    assert capfd.readouterr().out == ""


def test_what_a_solver_says_or_writes_is_its_own_row(tmp_path: Path) -> None:
    write_data(tmp_path)
    entries = "".join(
        f'[[backends]]\nname = "hostile"\nlabel = "{deed}"\ndeed = "{deed}"\n'
        for deed in ("name", "scribble")
    )
    problem = '[[problems]]\nfile = "one.npz"\n[clock]\nlimit = 5\n'
    path = write_study(tmp_path, HEAD + problem + entries)
    cases = read_cases(run(SolverStudy.load(path), tmp_path).folder).set_index("objective")
    assert cases["status"].to_dict() == {"name": "error", "scribble": "crashed"}
    assert cases.loc["name", "reason"] == "ValueError: \\udcff\\x1b"
    assert "message channel" in cases.loc["scribble", "reason"]


@pytest.mark.usefixtures("in_process")
def test_a_flight_that_cannot_be_read_is_an_error_with_its_reason(
    tmp_path: Path, write: Write
) -> None:
    sweep = '[derivative]\nmethod = "savgol"\n[sweep]\n"derivative.window" = [5, 201]\n'
    study = Study.load(write('[[backends]]\nname = "lasso"\n' + sweep, count=2))
    cases = read_cases(run(study, tmp_path, processes=1).folder)
    long = cases[cases["derivative.window"] == 201.0]
    assert (long["status"] == "error").all()
    assert long["reason"].str.contains("window").all()
    assert (long["samples"] == 0).all()
    assert (cases[cases["derivative.window"] == 5.0]["status"] != "error").all()


@pytest.mark.usefixtures("in_process")
def test_finished_means_nothing_to_do_and_fresh_starts_over(tmp_path: Path, write: Write) -> None:
    study = Study.load(write(deeds("work"), count=1))
    published: list[Path] = []

    def publish(_: Study, folder: Path) -> None:
        published.append(folder)

    first = run(study, tmp_path, processes=1, publish=publish)
    written = (first.folder / "cases.parquet").stat().st_mtime_ns
    again = run(study, tmp_path, processes=1, publish=publish)
    assert published == [tmp_path / "r"] * 2
    assert again.nothing_to_do
    assert again.statuses == first.statuses
    assert (first.folder / "cases.parquet").stat().st_mtime_ns == written
    assert status(study, tmp_path).finished
    assert not run(study, tmp_path, processes=1, fresh=True).nothing_to_do
    assert (first.folder / "cases.parquet").stat().st_mtime_ns != written


@pytest.mark.usefixtures("in_process")
def test_results_of_another_study_are_refused(tmp_path: Path, write: Write) -> None:
    mine = Study.load(write(deeds("work"), count=1))
    other = Study.load(write(deeds("nothing"), count=1, name="other.toml"))
    run(mine, tmp_path, processes=1)
    with pytest.raises(InputError, match=r"made by a different study \(hash .*--fresh"):
        run(other, tmp_path, processes=1)
    assert run(other, tmp_path, processes=1, fresh=True).statuses == {"error": 1}


@pytest.mark.parametrize("header", ['{"study_hash": "0123"}', '{"study_ha'])
def test_unfinished_rows_that_are_all_of_another_study_are_refused(
    tmp_path: Path, write: Write, header: str
) -> None:
    study = Study.load(write(deeds("work"), count=2))
    folder = tmp_path / "r"
    folder.mkdir(parents=True)
    partial.begin(folder, {})
    (folder / ".partial" / "header.json").write_text(header)
    with partial.appending(folder) as rows:
        rows.append(Outcome(0, 0, "ok"), "0123456789abcdef")
    with pytest.raises(InputError, match=r"(different|unknown) study.*--fresh starts over"):
        run(study, tmp_path, processes=1)


def test_workers_that_are_killed_while_they_start_are_started_again(write: Write) -> None:
    crew = pool._Pool(Study.load(write(deeds("work"))), iter(()), 1, bool)
    for _ in range(pool.MAX_KILLED - 1):
        crew._not_started("SIGKILL", by_signal=True)
    with pytest.raises(SparsefitError, match="run again to continue"):
        crew._not_started("SIGKILL", by_signal=True)
    for _ in range(pool.MAX_DEATHS - 1):
        crew._not_started("exit code 1", by_signal=False)
    with pytest.raises(SparsefitError, match="__main__"):
        crew._not_started("exit code 1", by_signal=False)


def test_two_runs_at_once_are_refused(tmp_path: Path, write: Write) -> None:
    folder = tmp_path / "r"
    folder.mkdir()
    holder = f"another run is under way .process {os.getpid()} "
    with locked(folder), pytest.raises(InputError, match=holder):
        run(Study.load(write(deeds("work"))), tmp_path)


@pytest.mark.usefixtures("in_process")
def test_the_lock_of_a_dead_process_is_taken_over(tmp_path: Path, write: Write) -> None:
    study = Study.load(write(deeds("work"), count=1))
    lock = tmp_path / "r" / LOCK
    lock.parent.mkdir()
    subprocess.run([sys.executable, "-c", DIES_LOCKED, str(lock)])
    pid, host, started = lock.read_text().splitlines()
    run(study, tmp_path, processes=1)
    assert not lock.exists()
    lock.write_text(f"{os.getpid()}\n{host}\n{started}\n")  # the id is in use again
    run(study, tmp_path, processes=1)
    assert not lock.exists()
    lock.write_text(f"{pid}\nelsewhere\n{started}\n")
    with pytest.raises(InputError, match="on elsewhere"):
        run(study, tmp_path, processes=1)
    lock.write_text("")  # just being written
    with pytest.raises(InputError, match="just starting"):
        run(study, tmp_path, processes=1)


def test_a_folder_that_cannot_be_written_is_refused_before_work(
    tmp_path: Path, write: Write, monkeypatch: pytest.MonkeyPatch
) -> None:
    study = Study.load(write(deeds("hang"), count=1))
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="choose another results folder"):
        run(study, tmp_path / "file")
    (tmp_path / "r").mkdir()  # read-only, with the lock of a process that was killed
    (tmp_path / "r" / LOCK).write_text(f"{2**22}\n{socket.gethostname()}\n")
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    with pytest.raises(InputError, match="cannot be written: choose another results folder"):
        run(study, tmp_path)


@pytest.mark.parametrize("processes", [0, -1, True, 1.5])
def test_processes_are_counted_in_whole_numbers(
    tmp_path: Path, write: Write, processes: int
) -> None:
    with pytest.raises(InputError, match="processes"):
        run(Study.load(write(deeds("work"))), tmp_path, processes=processes)


@pytest.mark.usefixtures("in_process")
def test_progress_counts_to_the_end_and_tells_the_time_left(
    tmp_path: Path, write: Write, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(runner, "PROGRESS_SECONDS", -1.0)
    seen: list[tuple[int, int, float | None]] = []
    study = Study.load(write(deeds("work"), count=4))
    run(study, tmp_path, processes=2, progress=lambda *said: seen.append(said))
    left = [None, *(pytest.approx(cases * SECONDS / 2) for cases in (3, 2, 1, 0))]
    assert seen == [(done, 4, eta) for done, eta in enumerate(left)]


def test_workers_compute_in_one_thread(write: Write, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    worker = Worker.start(Study.load(write(deeds("work"))), patience=60.0)
    try:
        told = Path(f"/proc/{worker.child.process.pid}/environ")
        until(lambda: bool(told.read_bytes()))
        environment = told.read_bytes().split(b"\0")
        assert b"OPENBLAS_NUM_THREADS=1" in environment
        assert b"OMP_NUM_THREADS=1" in environment
        assert "OMP_NUM_THREADS" not in os.environ
    finally:
        worker.kill()
