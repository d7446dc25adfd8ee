"""Attacks on runs of studies, by hand: `nice python -m tests.study.attacks kills 60`.

    kills N     the parent, its group or its workers; flights with 1 and 2 processes, and problems
    disks N     full disks: files that may not grow, and a file system of little room (as root)
    damage N    bytes of a store, an export or a manifest that are other than written

Each prints what was lost: 0 where all is well. The suite has small versions (`test_runs.py`), and
solvers that hang or take all memory (`test_problem_studies.py`).
"""

import os
import random
import resource
import shutil
import signal
import sqlite3
import subprocess
import sys
import tempfile
import time
from contextlib import closing, suppress
from dataclasses import replace
from pathlib import Path

import numpy as np

import sparsefit as sf
from sparsefit.errors import InputError
from sparsefit.study.guardian import children_of
from sparsefit.study.store import CASES, STORE, Store
from tests.study import hostile
from tests.study.small_study import CORRELATED, PROBLEMS, small_study

ROOT = Path(__file__).parents[2]
DRIVER = """
import sys
import sparsefit as sf
try:
    sf.Study.from_file(sys.argv[1]).run(processes=int(sys.argv[2]))
except sf.InputError as error:
    print(error, file=sys.stderr)
    sys.exit(2)
"""
FLIGHTS = """
[[backends]]
name = "lasso"
alpha_fraction = [0.3, 0.1]
[[backends]]
name = "least-squares"
[[backends]]
name = "hostile"
seconds = 0.02
"""
LASSO = '[[backends]]\nname = "lasso"\nsolver = ["homotopy", "clarabel"]\n'


def study_of(folder, kind, count):
    text = f"{PROBLEMS}{CORRELATED}count = {count}\n{LASSO}"
    if kind == "flights":
        text = small_study("f", count=count) + FLIGHTS
    (folder / "s.toml").write_text(text)
    return sf.Study.from_file(folder / "s.toml")


def started(folder, processes, **how):
    (folder / "driver.py").write_text(DRIVER)
    command = [sys.executable, "driver.py", "s.toml", str(processes)]
    return subprocess.Popen(command, cwd=folder, start_new_session=True, **how)


def stored(folder):
    """The checksum of every row that is on the disk, by the id of its case."""
    if (folder / STORE).exists():
        with (
            suppress(sqlite3.OperationalError),  # before its first row
            closing(sqlite3.connect(folder / STORE, timeout=10.0)) as base,
        ):
            return dict(base.execute("SELECT case_id, crc FROM cases"))
    return {}


def until(condition, seconds=120.0):
    limit = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < limit, "waited too long"
        time.sleep(0.02)


def unpack(study):
    """Put the rows of `cases.parquet` into `cases.sqlite`, as if the study were not finished."""
    with Store.opened(study.folder, study.planned) as store:
        for row in store.rows():
            store.put_row(row)
    (study.folder / CASES).unlink()


def kills(count):
    for kind, processes in (("flights", 1), ("flights", 2), ("problems", 1)):
        for victim in ("parent", "group", "workers"):
            lost = killed(kind, processes, victim, count)
            print(f"{kind}, {processes} processes, {victim} x {count}: {lost} lost", flush=True)


def killed(kind, processes, victim, count):
    """Rows that were on the disk at a kill and are not afterwards, or tell something else."""
    with tempfile.TemporaryDirectory() as home:
        folder, lost = Path(home), 0
        study = study_of(folder, kind, 2000 if kind == "flights" else 400)
        for _ in range(count):
            before = stored(study.folder)
            process = started(folder, processes)
            until(lambda before=before: len(stored(study.folder)) > len(before))
            time.sleep(random.uniform(0.0, 0.5))
            if victim == "workers":
                for child in children_of(process.pid):
                    for worker in (*children_of(child), child):
                        with suppress(ProcessLookupError):
                            os.kill(worker, signal.SIGKILL)
                time.sleep(random.uniform(0.5, 2.0))
                lost += process.poll() is not None  # the run goes on without them
            kill = os.kill if victim == "parent" else os.killpg
            kill(process.pid, signal.SIGKILL)
            process.wait()
            after = stored(study.folder)
            lost += sum(after.get(key) != crc for key, crc in before.items())
            lost += study.status().done != len(after)
        return lost


def disks(count):
    for number in range(count):
        with tempfile.TemporaryDirectory() as home:
            folder = Path(home)
            study, mounted = study_of(folder, "flights", 60), number % 3 == 2
            most = int(random.uniform(10_000, 120_000))
            study.folder.mkdir(parents=True)
            command = ["mount", "-t", "tmpfs", "-o", f"size={most}", "tmpfs", str(study.folder)]
            mounted = mounted and subprocess.run(command, check=False).returncode == 0

            def limit(most=most, mounted=mounted):
                if not mounted:
                    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
                    resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))

            process = started(folder, 2, preexec_fn=limit, stderr=subprocess.PIPE, text=True)
            words, before = process.communicate(timeout=600.0)[1], stored(study.folder)
            told = process.returncode == 2 and "Traceback" not in words
            if mounted:
                kept = folder / "kept"
                shutil.copytree(study.folder, kept)
                subprocess.run(["umount", str(study.folder)], check=True)
                shutil.copytree(kept, study.folder, dirs_exist_ok=True)
            finished = study.run(processes=2)
            same = finished.resumed == len(before) and finished.finished
            said = words.strip().splitlines()[-1] if words.strip() else "(it fitted)"
            print(f"{most} bytes{' mounted' * mounted}: told {told}, rows kept {same}: {said}")


def damage(count):
    with tempfile.TemporaryDirectory() as home:
        study = study_of(Path(home), "flights", 5)
        study.run(processes=1)
        wrong, refused = damaged(study, count)
        print(f"{count} damaged stores: {wrong} told wrong rows, {refused} refused in a line")


def damaged(study, count):
    """How many of so many damaged copies of a finished study told wrong rows, or were refused."""
    wrong, refused = 0, 0
    exported = {path.name: path.read_bytes() for path in study.folder.iterdir()}
    unpack(study)
    whole = (study.folder / STORE).read_bytes()
    expected = {row.case_id: row for row in Store.read(study.folder, study.planned).rows()}
    for seed in range(count):
        rng = np.random.default_rng(seed)
        for path in study.folder.iterdir():
            path.unlink()
        content = dict(exported) if seed % 2 else {STORE: whole}
        victim = sorted(content)[rng.integers(len(content))]
        spoiled = bytearray(content[victim])
        for place in rng.integers(0, len(spoiled), 1 << rng.integers(0, 8)):
            spoiled[place] = rng.integers(256)
        if rng.random() < 0.2:
            spoiled = spoiled[: rng.integers(len(spoiled))]
        content[victim] = bytes(spoiled)
        for name, data in content.items():
            (study.folder / name).write_bytes(data)
        try:
            rows = Store.read(study.folder, study.planned).rows()
            wrong += any(expected[row.case_id] != row for row in rows)
            if rows:
                _ = replace(study).cases
        except InputError as error:
            refused += 1
            wrong += "\n" in str(error)
    return wrong, refused


def main(attack, count="20"):
    with tempfile.TemporaryDirectory() as plugin:
        hostile.install(plugin)
        sys.path.insert(0, plugin)
        os.environ["PYTHONPATH"] = os.pathsep.join([str(ROOT), plugin])
        {"kills": kills, "disks": disks, "damage": damage}[attack](int(count))


if __name__ == "__main__":
    main(*sys.argv[1:])
