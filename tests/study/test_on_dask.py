"""The same rows from a scheduler and workers of dask, one of which is killed in the run."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path

import pandas as pd
import pytest

from sparsefit.cli import main
from sparsefit.errors import InputError, MissingExtra
from sparsefit.study import Study, read_cases, run
from sparsefit.study.run import on_dask
from tests.study.small_study import small_study

ROOT = Path(__file__).parents[2]
TEXT = (
    small_study("d", count=24)
    + """\
[[backends]]
name = "lasso"
alpha_fraction = [0.3, 0.1]
[[backends]]
name = "stlsq"
"""
)


def until(condition: Callable[[], bool], seconds: float = 120.0) -> None:
    limit = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < limit, "waited too long"
        time.sleep(0.05)


@pytest.fixture
def study(tmp_path: Path) -> Study:
    (tmp_path / "d.toml").write_text(TEXT)
    return Study.load(tmp_path / "d.toml")


@contextlib.contextmanager
def started(*argv: str) -> Iterator[subprocess.Popen[bytes]]:
    process = subprocess.Popen(
        [sys.executable, "-m", "distributed.cli." + argv[0], *argv[1:]],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        start_new_session=True,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        yield process
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


@pytest.mark.slow
@pytest.mark.skipif(find_spec("distributed") is None, reason="the extra dask is not installed")
def test_same_rows_though_a_worker_is_killed(study: Study, tmp_path: Path) -> None:
    here = read_cases(run(study, tmp_path / "here", processes=2).folder)
    told = tmp_path / "scheduler.json"
    shared = ("--scheduler-file", str(told), "--no-dashboard")
    hand = ("dask_worker", *shared, "--nthreads", "1", "--no-nanny")
    with (
        started("dask_scheduler", *shared, "--port", "0"),
        started(*hand),
        started(*hand) as victim,
    ):
        until(told.exists)
        address = json.loads(told.read_text())["address"]
        argv = [sys.executable, "-c", "from sparsefit.cli import main; main()", "study", "run"]
        asked = [study.path, "--results", str(tmp_path / "far")]
        far = subprocess.Popen(
            [*argv, *asked, "--executor", "dask", "--scheduler", address],
            env={**os.environ, "PYTHONPATH": str(ROOT)},
        )
        rows = tmp_path / "far" / "d" / ".partial" / "rows.jsonl"
        until(lambda: rows.exists() and rows.stat().st_size > 0)
        os.killpg(victim.pid, signal.SIGKILL)
        assert far.wait(timeout=300) == 0
    cases = read_cases(tmp_path / "far" / "d")
    assert len(cases) == study.planned
    pd.testing.assert_frame_equal(cases.drop(columns="seconds"), here.drop(columns="seconds"))


def test_what_is_missing_or_does_not_fit_is_told(
    study: Study,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def absent(_: str) -> None:
        raise ImportError

    monkeypatch.setattr(on_dask, "import_module", absent)
    with pytest.raises(MissingExtra, match=r"sparsefit\[dask\]"):
        run(study, tmp_path, executor="dask")
    with pytest.raises(InputError, match="add --executor dask"):
        run(study, tmp_path, scheduler="tcp://nowhere:1")
    with pytest.raises(InputError, match='unknown executor "slurm"'):
        run(study, tmp_path, executor="slurm")
    asked = ["study", "run", study.path, "--results", str(tmp_path), "--executor", "dask"]
    assert main(asked) == 2
    told = capsys.readouterr()
    assert "leave --executor out" in told.err
    assert (told.out, told.err.count("\n")) == ("", 1)
