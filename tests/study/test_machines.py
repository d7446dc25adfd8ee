"""A study says the same on every machine: `table2` in small, with another kernel of OpenBLAS."""

import os
import platform
import re
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest

STUDIES = Path(__file__).parents[2] / "studies"
OF_THE_RUN = {"cases.parquet", "manifest.json", "times.csv", "times.md", "times.tex"}
OTHER_KERNEL = "Nehalem"  # runs on every processor of this kind
X86 = platform.machine().lower() in ("x86_64", "amd64")


def started(folder, study, kernel):
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    environment.pop("OPENBLAS_CORETYPE", None)
    command = [sys.executable, "-m", "sparsefit", "study", "run", study, "--results", folder]
    return subprocess.Popen(
        [*map(str, command), "--processes", "1"],
        env=environment | kernel,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
    )


@pytest.mark.skipif(not X86, reason="kernels of OpenBLAS are chosen by name on x86-64 only")
def test_another_kernel_changes_the_files_of_the_run_alone(tmp_path):
    text = re.sub(r"(?m)^count = \d+", "count = 3", (STUDIES / "table2.toml").read_text())
    study = tmp_path / "table2.toml"
    study.write_text(text)
    runs = {
        tmp_path / "here": started(tmp_path / "here", study, {}),
        tmp_path / "there": started(
            tmp_path / "there", study, {"OPENBLAS_CORETYPE": OTHER_KERNEL}
        ),
    }
    for process in runs.values():
        said, _ = process.communicate(timeout=120)
        assert process.returncode == 0, said
    here, there = (folder / "table2" for folder in runs)
    cases = [pd.read_parquet(folder / "cases.parquet") for folder in (here, there)]
    if cases[0]["est_mean_velocity"].equals(cases[1]["est_mean_velocity"]):
        pytest.skip(f"this machine's kernel rounds as {OTHER_KERNEL} does: nothing to compare")
    names = [{path.name for path in folder.iterdir()} for folder in (here, there)]
    assert names[0] == names[1] >= OF_THE_RUN
    differ = {n for n in names[0] if (here / n).read_bytes() != (there / n).read_bytes()}
    assert differ <= OF_THE_RUN
