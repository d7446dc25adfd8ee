"""What reads and runs an estimator on board does not wait for what only studies need."""

import json
import subprocess
import sys

HEAVY = {"cvxpy", "clarabel", "osqp", "pandas", "pyarrow", "matplotlib", "sklearn", "distributed"}
CODE = """
import json, sys
import sparsefit as sf
from sparsefit import backends

def packages():
    return sorted({name.partition(".")[0] for name in sys.modules})

for name in backends.BACKENDS:
    estimator = sf.Estimator.from_json(sf.Estimator(backend=name).to_json())
print(json.dumps(packages()))
print(json.dumps([name for name in sys.modules if name.startswith("sparsefit.")]))
flow, vehicle = sf.CellularFlow(15.43, 4.21), sf.PointMassVehicle(0.5, (5.0, 3.0))
flight = sf.simulate_flight(
    flow, vehicle, duration=5.0, sample_rate=50.0, seed=7, velocity_noise=0.05, position_noise=0.01
)
for name in ("group-lasso", "lasso", "stlsq", "best-scale"):
    assert sf.Estimator(backend=name).estimate(flight).status == "ok"
print(json.dumps(packages()))
"""


def test_no_back_end_is_loaded_with_scipy_and_none_that_is_ours_runs_with_a_conic_solver():
    done = subprocess.run([sys.executable, "-c", CODE], capture_output=True, text=True, check=True)
    loaded, ours, run = (set(json.loads(line)) for line in done.stdout.splitlines())
    assert not loaded & (HEAVY | {"scipy", "finufft"})
    running = {"estimator.prepare", "estimator.measure"}
    assert not ours & {f"sparsefit.{name}" for name in running}
    assert not run & HEAVY
    assert "scipy" in run  # what is looked for would be found
