"""Workers: a call apart, and nothing that outlives its run."""

import math
import os
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest

from sparsefit.errors import InputError
from sparsefit.study.worker import in_child
from tests.study import hostile
from tests.study.attacks import until

ROOT = Path(__file__).parents[2]


def test_a_file_of_the_users_folder_stands_before_nothing_of_python(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "signal.py").write_text("raise SystemExit('not for you')")
    monkeypatch.delenv("PYTHONSAFEPATH", raising=False)
    assert in_child(math.sqrt, 4.0, seconds=60.0) == 2.0
    assert in_child(os.getenv, "PYTHONSAFEPATH", seconds=60.0) is None


@pytest.mark.parametrize(
    ("deed", "words"),
    [
        ("die", r"died of SIGKILL \(out of memory\?\)"),
        ("exit", "ended with exit code 3"),
        ("raise", "ZeroDivisionError: one two"),
        ("hang-native", "took longer than 2 s"),
        *((deed, "channel of its process was written") for deed in ("empty", "odd", "scribble")),
    ],
)
def test_a_call_that_fails_is_told_in_a_line(deed, words):
    with pytest.raises(InputError, match=words):
        in_child(hostile.do, deed, seconds=2.0 if deed == "hang-native" else 60.0)


def alive(marker):
    """Whether a process sleeps by this number."""
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        with suppress(OSError):  # it has ended
            if path.read_bytes() == f"sleep\0{marker}\0".encode():
                return True
    return False


def test_the_files_of_a_killed_run_go_with_it(tmp_path, monkeypatch):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    code = (
        "import os, threading\nfrom sparsefit.study import worker\n"
        "with worker.scratch() as home:\n"
        "    desk = lambda name: (worker._Caller, ())\n"
        "    crew = worker.Crew(desk, home, 1e3, threading.Event())\n"
        "    crew.worker('any')\n"
        "    crew.worker('other')\n"
        "    (home / 'rows').write_text('1')\n"
        "    print(*os.listdir(home.parent), flush=True)\n"
        "    os.kill(os.getpid(), 9)"
    )
    told = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, check=False)
    assert b"sparsefit-study-" in told.stdout
    until(lambda: not list(tmp_path.iterdir()), 10.0)


@pytest.mark.skipif(sys.platform != "linux", reason="a subreaper is of Linux")
@pytest.mark.parametrize(
    ("end", "seconds"), [("limit", "599.25"), pytest.param("kill", "599.5", marks=pytest.mark.slow)]
)
def test_what_leaves_its_session_ends_with_the_run(monkeypatch, end, seconds):
    """The deed `leave` starts `sleep` in a session of its own, twice removed."""
    monkeypatch.setenv("ASLEEP", seconds)
    code = (
        "from tests.study import hostile\nfrom sparsefit.study.worker import in_child\n"
        f"in_child(hostile.do, 'leave', seconds={5.0 if end == 'limit' else 60.0})"
    )
    run = subprocess.Popen([sys.executable, "-c", code], cwd=ROOT, stderr=subprocess.DEVNULL)
    until(lambda: alive(seconds), 60.0)
    if end == "kill":
        run.kill()
    run.wait(60.0)
    until(lambda: not alive(seconds), 10.0)
