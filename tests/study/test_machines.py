"""A study says the same on every machine: `table2` in small, with another kernel of OpenBLAS."""

import os
import platform
import re
import subprocess
import sys
from pathlib import Path

import pytest

from sparsefit.study import Study
from sparsefit.study.report.pages import write_report
from sparsefit.study.run.execution import run_flight
from sparsefit.study.run.outcome import Outcome
from sparsefit.study.run.store import read_cases, write_cases

STUDIES = Path(__file__).parents[2] / "studies"
OF_THE_RUN = {"cases.parquet", "times.csv", "times.md", "times.tex"}
OTHER_KERNEL = "Nehalem"  # runs on every processor of this kind
X86 = platform.machine().lower() in ("x86_64", "amd64")


def in_small(text):
    """Two flights, one setting of each back-end, one picture with its raster and its vectors."""
    text = re.sub(r"(?m)^count = .*", "count = 2", text)
    text = re.sub(r"(?m)^(rcond|threshold|alpha_fraction) = \[([\d.]+),.*", r"\1 = \2", text)
    return re.sub(r"(?m)^figures = .*", 'figures = ["errors"]', text)


def run(path, results):
    """What `study run` writes of rows, tables and pictures, in this process."""
    study, folder = Study.load(path), Path(results) / "table2"
    folder.mkdir(parents=True)
    events = [event for n in range(study.count) for event in run_flight(study, n, study.cells)]
    write_cases(study, [event for event in events if isinstance(event, Outcome)], folder)
    write_report(study, results, read_cases(folder))


def content(file):
    """The bytes of a file; of the page without the section on the run."""
    section = rb'<section id="section-this-run">.*?</section>'
    return re.sub(section, b"", file.read_bytes(), flags=re.DOTALL)


@pytest.mark.skipif(not X86, reason="kernels of OpenBLAS are chosen by name on x86-64 only")
@pytest.mark.slow
def test_another_kernel_changes_the_files_of_the_run_alone(tmp_path):
    study = tmp_path / "table2.toml"
    study.write_text(in_small((STUDIES / "table2.toml").read_text()))
    kernel = {"OPENBLAS_CORETYPE": OTHER_KERNEL, "OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, __file__, str(study), str(tmp_path / "there")]
    other = subprocess.Popen(command, env=os.environ | kernel)
    run(study, tmp_path / "here")
    assert other.wait(timeout=120) == 0
    here, there = (tmp_path / name / "table2" for name in ("here", "there"))
    mine, others = (read_cases(folder)["est_mean_velocity"] for folder in (here, there))
    if mine.equals(others):
        pytest.skip(f"this machine's kernel rounds as {OTHER_KERNEL} does: nothing to compare")
    names = {path.name for path in here.iterdir()}
    assert {path.name for path in there.iterdir()} == names > OF_THE_RUN
    differ = {name for name in names if content(here / name) != content(there / name)}
    assert differ <= OF_THE_RUN


if __name__ == "__main__":
    run(*sys.argv[1:])
