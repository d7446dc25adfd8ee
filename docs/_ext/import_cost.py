"""What an estimator costs to load and to run, measured when the page is built: `{import-cost}`.

Each step is a process of its own, the steps by turns, with bytecode as an installed package has it.
Medians of processor time from the start of Python on, and of the most memory held.
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
from pathlib import Path

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective
from written import parsed

TURNS = 3
TOLD = """
import json, pathlib, re, resource, sys, time
seconds = time.process_time()
status = pathlib.Path("/proc/self/status")  # Linux: what the parent held is not counted
if status.exists():
    memory = int(re.search(r"VmHWM:\\s+(\\d+)", status.read_text())[1]) / 1024
else:
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
wanted = "numpy scipy finufft pandas pyarrow cvxpy clarabel osqp matplotlib".split()
print(json.dumps([seconds, memory, [name for name in wanted if name in sys.modules]]))
"""
LOAD = """
import sparsefit
estimator = sparsefit.Estimator.from_json(open("estimator.json").read())
"""
STEPS = {
    "`import numpy`": "import numpy\n",
    "`import sparsefit; Estimator.from_json(...)`": LOAD,
    "and a first estimate": LOAD + "estimator.estimate(sparsefit.read_flight('flight.csv'))\n",
}


def measured(folder: Path) -> list[tuple[str, float, float, list[str]]]:
    """(step, seconds, MB, packages) of each step, medians over `TURNS`."""
    folder.mkdir(parents=True, exist_ok=True)
    _prepare(folder)
    found: dict[str, list[tuple[float, float, list[str]]]] = {name: [] for name in STEPS}
    for turn in range(TURNS + 1):  # the first writes bytecode
        for name, code in STEPS.items():
            told = _told(code, folder)
            if turn:
                found[name].append(told)
    return [
        (
            name,
            statistics.median(one[0] for one in told),
            statistics.median(one[1] for one in told),
            told[0][2],
        )
        for name, told in found.items()
    ]


def _prepare(folder: Path) -> None:
    import sparsefit

    flow = sparsefit.CellularFlow(mean_velocity=15.43, length_scale=4.21)
    vehicle = sparsefit.PointMassVehicle(0.5, (5.0, 3.0))
    flight = sparsefit.simulate_flight(
        flow,
        vehicle,
        duration=10.0,
        sample_rate=100.0,
        velocity_noise=0.05,
        position_noise=0.01,
        seed=7,
    )
    sparsefit.write_flight(flight, folder / "flight.csv", overwrite=True)
    (folder / "estimator.json").write_text(sparsefit.Estimator().to_json(), "utf-8")


def _told(code: str, folder: Path) -> tuple[float, float, list[str]]:
    kept = {key: value for key, value in os.environ.items() if key != "PYTHONDONTWRITEBYTECODE"}
    environment = kept | {
        "PYTHONPYCACHEPREFIX": str(folder / "bytecode"),
        "OPENBLAS_NUM_THREADS": "1",
        "PYTHONPATH": str(Path(__file__).parents[2]),
    }
    done = subprocess.run(
        [sys.executable, "-c", code + TOLD],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    seconds, memory, packages = json.loads(done.stdout.splitlines()[-1])
    return seconds, memory, packages


class ImportCost(SphinxDirective):
    """The table, measured once for each new build folder."""

    def run(self) -> list[nodes.Node]:
        rows = measured(Path(self.env.app.doctreedir) / "import-cost")
        lines = ["| step | processor time | memory | packages |", "|---|---:|---:|---|"]
        for name, seconds, memory, packages in rows:
            listed = ", ".join(packages) or "–"
            lines.append(f"| {name} | {seconds:.2f} s | {memory:.0f} MB | {listed} |")
        return parsed(self, lines)


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the directive."""
    app.add_directive("import-cost", ImportCost)
    return {"parallel_read_safe": False, "parallel_write_safe": True}
