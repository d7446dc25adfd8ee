"""A large study and what may happen to it, run by hand: it takes some ten minutes on two cores.

    python -m tests.study.endurance [--cases 100000] [--kills 25] [--seed 0] [--folder FOLDER]

A study of very cheap cases, least squares on flights of 50 samples, beside back-ends that crash,
hang in native code and take memory without end, is run once undisturbed and its verbs are timed.
Then it is run again, killed and damaged in every way that `FAULTS` names at random moments, and
goes on each time. At its end its rows must be those of the first run. What is printed is measured.

As root the results lie in a small file system that runs full; else no disk does.
"""

import argparse
import json
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from tests.study import hostile
from tests.study.small_study import small_study

ROOT = Path(__file__).parents[2]
SETTINGS = 96  # of least squares, per flight
DEEDS = {  # what a back-end does, and what the study calls it
    "segfault": "<script>alert(1)</script>",
    "die": '=HYPERLINK(\\"x\\")',
    "hang-native": "../../$(touch owned) `%s` ' ; |",
    "memory": "été\\u202e λ & <b>",
}
FOLDER = "ré sults $(touch owned) ' \" & \\ %s <b>\n"
TIMEOUT = 10.0  # seconds that a case may take
MEMORY = 4 << 30  # bytes of address space of each process
ROOM = 1 << 30  # bytes of the small file system
FAULTS = {  # and how often each comes, for 25 kills of the parent
    "kill": 25,
    "SIGKILL of a worker": 10,
    "SIGSEGV of a worker": 10,
    "torn": 8,
    "another run": 2,
    "stopped": 2,
    "full disk": 3,
    "read-only": 2,
}
STUDY = """
[readout]
refine = "none"
[run]
case_timeout = {timeout}
[split]
validate = 0.5
evaluate = 0.5
[[backends]]
name = "least-squares"
rcond = {rcond}
"""
ENTRY = '[[backends]]\nname = "hostile"\nlabel = "{label}"\ndeed = "{deed}"\nrarely = {rarely}\n'


@dataclass(frozen=True)
class Ended:
    """A command that has ended: code, output, seconds by the clock and of processors, peak [MB]."""

    code: int
    told: str
    wall: float
    used: float
    peak: float


@dataclass(frozen=True)
class Place:
    """A study file and the results folder of one of its runs."""

    study: Path
    results: Path

    @property
    def folder(self) -> Path:
        return self.results / "endurance"

    @property
    def size(self) -> int:
        """Bytes of unfinished rows."""
        path = self.folder / ".partial" / "rows.jsonl"
        return path.stat().st_size if path.exists() else 0

    def start(self, verb, *words):
        words = ("study", verb, str(self.study), "--results", str(self.results), *words)
        return subprocess.Popen(
            [
                sys.executable,
                "-m",
                "sparsefit",
                *(words[:3] if verb in ("plan", "check") else words),
            ],
            env={**os.environ, "PYTHONPATH": f"{ROOT}{os.pathsep}{self.study.parent}"},
            cwd=self.study.parent,
            stdout=subprocess.PIPE,
            stderr=(tell := tempfile.TemporaryFile("w+")),
            start_new_session=True,
            preexec_fn=_limit,
            text=True,
        ), tell

    def run(self, verb, *words):
        begun = time.monotonic()
        process, tell = self.start(verb, *words)
        out = process.stdout.read()
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        tell.seek(0)
        spent = used.ru_utime + used.ru_stime
        told = out + tell.read()
        return Ended(
            process.returncode, told, time.monotonic() - begun, spent, used.ru_maxrss / 1e3
        )


def _limit():
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def write_study(folder, cases):
    """The study file, with the plug-in beside it."""
    flights = max(2, round(cases / (SETTINGS + len(DEEDS))))
    rcond = json.dumps([float(f"{10 ** (-6 + 5 * n / SETTINGS):.6g}") for n in range(SETTINGS)])
    text = small_study("endurance", count=flights, seed=5)
    text += STUDY.format(timeout=TIMEOUT, rcond=rcond)
    for deed, label in DEEDS.items():
        text += ENTRY.format(label=label, deed=deed, rarely=min(1.0, 3.0 / flights))
    hostile.install(folder)
    path = folder / "a study; of 'many' $(touch owned).toml"
    path.write_text(text)
    return path, flights * (SETTINGS + len(DEEDS))


def stat_of(pid):
    """(seconds of its own, resident MB) of a process; None where it is gone."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    except OSError:
        return None
    ticks = int(fields[11]) + int(fields[12])
    return ticks / os.sysconf("SC_CLK_TCK"), int(fields[21]) * resource.getpagesize() / 1e6


def undisturbed(place, cases):
    """Run it, and say what it costs; returns the most bytes that its rows took."""
    begun = time.monotonic()
    process, tell = place.start("run", "--processes", "2")
    watched, largest, parent = [], 0, 0.0
    while process.poll() is None:
        stat = stat_of(process.pid)
        size = place.size
        if stat and size > 0:
            watched.append(stat[1])
            parent = stat[0]
        largest = max(largest, size)
        time.sleep(0.1)
    tell.seek(0)
    assert process.returncode == 0, tell.read()
    wall = time.monotonic() - begun
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    early, late = (watched[int(share * len(watched))] for share in (0.1, 0.9))
    report("undisturbed run, pages included", f"{wall:.0f} s by the clock")
    workers = used.ru_utime + used.ru_stime - parent
    report("the parent", f"{1e3 * parent / cases:.2f} ms a case (of processor time)")
    report("its workers", f"{1e3 * workers / cases:.2f} ms a case, the fits included")
    report("the parent's memory", f"{early:.0f} MB at 10 %, {late:.0f} MB at 90 % of its time")
    return largest


def timed(place, verbs):
    for verb in verbs:
        ended = place.run(*verb.split())
        assert ended.code == 0, ended.told
        spent = f"{ended.used:.1f} s of processor time, {ended.wall:.1f} s by the clock"
        report(f"study {verb}", f"{spent}, peak {ended.peak:.0f} MB")


def report(what, words):
    print(f"{what:<40} {words}", flush=True)


def children(pid):
    try:
        listed = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
        return [int(c) for c in listed if b"spawn_main" in Path(f"/proc/{c}/cmdline").read_bytes()]
    except OSError:
        return []


def kin(session):
    """The live processes of a session."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                fields = (entry / "stat").read_text().rsplit(")", 1)[1].split()
            except OSError:
                continue
            if fields[3] == str(session) and fields[0] != "Z":
                found.append(int(entry.name))
    return found


def refused(ended, *words):
    """A command that ended in one line with these words, and exit code 2."""
    lines = [line for line in ended.told.splitlines() if "cases, " not in line]
    fits = ended.code == 2 and len(lines) == 1 and any(word in lines[0] for word in words)
    assert fits, f"exit code {ended.code}: {ended.told}"


def tear(place, draw):
    """Damage the unfinished rows as a disk may, and an edge of a write."""
    path = place.folder / ".partial" / "rows.jsonl"
    size = path.stat().st_size
    with path.open("r+b") as file:
        file.seek(draw.randrange(size))
        file.write(bytes(draw.choice([1, 7, 4096])))
        file.truncate(size - draw.randrange(1, 200))
        file.seek(0, os.SEEK_END)
        file.write(draw.choice([b"", b'1c291ca3 {"flight":0,"ce', b"\n\n", b"\xff" * 99]))


def remount(place, options):
    subprocess.run(["mount", "-o", f"remount,{options}", str(place.results)], check=True)


def read_only(place, yes):
    if os.geteuid() == 0:  # whom permissions do not bind
        remount(place, "ro" if yes else "rw")
    else:
        place.folder.chmod(0o555 if yes else 0o755)


def disturb(fault, place, process, draw):
    """One fault, while ``process`` runs; it may end of it."""
    if fault.endswith("of a worker"):
        workers = children(process.pid)
        if workers:
            os.kill(draw.choice(workers), getattr(signal, fault.split()[0]))
        return
    if fault == "another run":
        refused(place.run("run"), "another run is under way")
        return
    if fault == "stopped":
        stopped = kin(process.pid)
        for signal_ in (signal.SIGSTOP, signal.SIGCONT):
            for pid in stopped:
                os.kill(pid, signal_)
            time.sleep(TIMEOUT + 2.0 if signal_ == signal.SIGSTOP else 0.0)
        return
    if fault == "full disk":
        taken = shutil.disk_usage(place.results).used
        remount(place, f"size={taken + (1 << 16)}")
        code = process.wait()
        assert code == 2, f"a full disk ends in exit code {code}"
        remount(place, f"size={ROOM}")
        return
    process.kill()
    process.wait()
    until = time.monotonic() + 20.0
    while kin(process.pid):
        assert time.monotonic() < until, f"processes outlive their parent: {kin(process.pid)}"
        time.sleep(0.05)
    if fault == "torn":
        tear(place, draw)
    if fault == "read-only":
        read_only(place, True)
        refused(place.run("run"), "choose another results folder", "check the folder")
        read_only(place, False)


def disturbed(place, planned_faults, size, draw):
    """Run it to its end through all faults, each at its share of the rows; counts of them."""
    done, runs = Counter(), 0
    left = sorted((draw.uniform(0.01, 0.96), fault) for fault in planned_faults)
    while True:
        process, tell = place.start("run", "--processes", "2")
        runs += 1
        while process.poll() is None:
            if left and place.size >= left[0][0] * size:
                time.sleep(draw.uniform(0.0, 0.3))
                if process.poll() is None:
                    disturb(left[0][1], place, process, draw)
                    done[left.pop(0)[1]] += 1
            time.sleep(0.02)
        tell.seek(0)
        told = tell.read()
        assert process.returncode in (0, 2, -signal.SIGKILL), told
        assert "Traceback" not in told, told
        if process.returncode == 0:
            report("runs until it was finished", str(runs))
            return done


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--cases", type=int, default=100_000)
    parser.add_argument("--kills", type=int, default=FAULTS["kill"])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--folder", type=Path)
    args = parser.parse_args()
    home = args.folder or Path(tempfile.mkdtemp(prefix="endurance-"))
    home.mkdir(exist_ok=True)
    home.chmod(0o755)
    study, cases = write_study(home, args.cases)
    report("cases", str(cases))
    calm, wild = Place(study, home / "calm"), Place(study, home / FOLDER)
    calm.results.mkdir()
    wild.results.mkdir()
    size = undisturbed(calm, cases)
    timed(calm, ("check", "plan", "status", "errors", "show", "report", "run"))

    draw = random.Random(args.seed)
    faults = [f for f, n in FAULTS.items() for _ in range(-(-n * args.kills // FAULTS["kill"]))]
    small = os.geteuid() == 0
    if small:
        room = f"size={ROOM}"
        subprocess.run(["mount", "-t", "tmpfs", "-o", room, "endurance", wild.results], check=True)
    else:
        faults = [fault for fault in faults if fault != "full disk"]
    try:
        done = disturbed(wild, faults, size, draw)
        report("faults", ", ".join(f"{count} x {fault}" for fault, count in done.items()))
        compare(calm, wild)
    finally:
        if small:
            subprocess.run(["umount", wild.results], check=True)
    if (home / "owned").exists():
        raise SystemExit("a name was run as a command")
    if not args.folder:
        shutil.rmtree(home)


def compare(calm, wild):
    """Rows that a worker's death from outside took are computed again; then all must be equal."""
    from sparsefit.study import read_cases

    def differing():
        one, other = (read_cases(place.folder).drop(columns="seconds") for place in (calm, wild))
        return one[(one.ne(other) & ~(one.isna() & other.isna())).any(axis=1)]

    report("rows that outside deaths took", f"{len(differing())}, computed again")
    again = wild.run("run", "--processes", "2", "--retry-failed", "--json")
    assert again.code == 0, again.told
    rows, differ = read_cases(calm.folder), differing()
    report("statuses", ", ".join(f"{n} {s}" for s, n in rows["status"].value_counts().items()))
    report("rows", f"{len(rows)}, {len(differ)} of them not as in the undisturbed run")
    if len(differ):
        raise SystemExit(differ.to_string())


if __name__ == "__main__":
    main()
