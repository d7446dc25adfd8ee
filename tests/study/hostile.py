"""A plug-in of back-ends that behave as they are told; `install` puts it where Python finds it."""

import ctypes
import json
import math
import os
import shutil
import subprocess
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from sparsefit.regression.backend import Solution

NO_ROW: tuple[Any, ...] = ("ok", "", {})
FORGED = {
    "forge": {"number": 3, "answer": {"rows": [[0, *NO_ROW]]}},
    "empty": {},
    "odd": {"number": 3, "answer": [7]},
    "foreign": {"number": 3, "answer": {"rows": [[9, *NO_ROW]]}},
}
WRITTEN = {deed: json.dumps(record).encode() + b"\n" for deed, record in FORGED.items()}
WRITTEN["scribble"] = b"\xff\xff\xff\x7f" * 9
ENTRY_POINTS = "[sparsefit.backends]\nhostile = hostile:Hostile\n"


@dataclass(frozen=True)
class Hostile:
    """deed: what it does to a problem before least squares, or in their place."""

    name: ClassVar[str] = "hostile"
    certificate_kind: ClassVar[str] = "fixed_point"
    deed: str = "work"
    seconds: float = 0.0

    def solve(self, problem):
        time.sleep(self.seconds)
        return do(self.deed) or Solution(
            np.linalg.lstsq(problem.theta, problem.target, rcond=1e-2)[0]
        )

    def next_weights(self, problem, weights):
        return np.linalg.lstsq(problem.theta, problem.target, rcond=1e-2)[0]


def do(deed):
    """The deed, and what it answers: None where it goes on."""
    if deed == "hang":
        time.sleep(600.0)
    if deed == "hang-native":  # in C, with the interpreter's lock held
        ctypes.PyDLL(None).sleep(600)
    if deed == "die":
        os.kill(os.getpid(), 9)
    if deed == "memory":
        held = []
        while True:
            held.append(np.empty(1 << 24))
    if deed == "exit":
        os._exit(3)
    if deed == "raise":
        raise ZeroDivisionError("one\ntwo")
    if deed == "fork" and os.fork() == 0:
        time.sleep(0.2)
    if deed == "print":
        print("not JSON")
        os.write(1, b"not JSON")
    if deed == "name":
        raise ValueError(os.fsdecode(b"\xff\x1b"))
    if deed == "status":
        return Solution(None, 7, "seven")
    if deed == "patch":  # what others compute with
        np.linalg.lstsq = np.linalg.solve = lambda *a, **k: (np.zeros(1), None, 0, None)
        math.pi = np.pi = 3.0
    if deed in WRITTEN:  # into every channel, before the true message
        for descriptor in range(3, 60):
            with suppress(OSError):
                os.write(descriptor, WRITTEN[deed])
    if deed == "leave":  # a child that has left the session, and whose parent has ended
        seconds = os.environ["ASLEEP"]  # by which it is known
        subprocess.run(["setsid", "--fork", "sleep", seconds], check=True)
        time.sleep(600.0)
    return None


def install(folder):
    """Copy this file and its entry points into a folder that is, or will be, on `sys.path`."""
    shutil.copy(__file__, folder)
    info = Path(folder) / "hostile-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: hostile\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(ENTRY_POINTS)
