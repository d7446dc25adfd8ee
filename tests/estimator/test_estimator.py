"""From a flight to the parameters, and the estimator as JSON."""

import json
import math
import subprocess
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import sparsefit as sf
from sparsefit import backends
from sparsefit.errors import InputError
from sparsefit.estimator.estimate import Estimate
from sparsefit.estimator.estimator import Estimator
from sparsefit.estimator.saved import FORMAT
from sparsefit.model import LengthScaleGrid, Library
from sparsefit.regression.certificate import Certificate
from tests.problems import SMALL_GRID, VEHICLE, flight, fly
from tests.test_architecture import PEERS, READERS, ROOMS, room_of

SMALL = Library(SMALL_GRID)


@pytest.mark.parametrize("backend", ["lasso", "group-lasso"])
@pytest.mark.parametrize(("length_scale", "speed"), [(4.21, 15.43), (2.6, 8.0), (7.0, 20.0)])
def test_a_noise_free_flight_gives_its_grid_scale_and_its_flow(backend, length_scale, speed):
    flown = flight(length_scale, speed)
    found = Estimator(backend=backend).estimate(flown)
    assert (found.status, found.reason) == ("ok", "")
    assert found.grid_length_scale == pytest.approx(length_scale, abs=0.02)
    assert found.length_scale == pytest.approx(length_scale, rel=1e-6)
    assert found.mean_velocity == pytest.approx(speed, rel=1e-6)
    assert found.timescale == pytest.approx(length_scale / speed, rel=1e-6)
    assert found.certificate.value <= 1e-8
    assert max(found.weights_by_scale, key=found.weights_by_scale.get) == found.grid_length_scale
    assert found.backend == backend
    assert found.settings["alpha_fraction"] == 0.1
    assert sf.score.score(found, flown.flow, LengthScaleGrid().scales).hit


@pytest.mark.parametrize("target", ["flow-velocity", "acceleration", "state-derivative"])
@pytest.mark.parametrize("derivative", ["forward", "central", "midpoint", "savgol"])
def test_every_derivative_and_target_ends_in_an_estimate(derivative, target):
    found = Estimator(derivative, Library(SMALL_GRID, target)).estimate(flight())
    assert found.status == "ok"
    assert found.columns == 8 * SMALL_GRID.size
    assert found.samples > 900


@pytest.mark.parametrize("backend", list(backends.BACKENDS))
def test_every_back_end_ends_in_an_estimate(backend):
    found = Estimator(library=SMALL, backend=backend).estimate(flight())
    assert found.backend == backend
    assert json.loads(json.dumps(found.to_dict(), allow_nan=False))["backend"] == backend


def test_the_stages_are_the_whole_and_do_not_read_the_truth():
    estimator = Estimator(library=SMALL)
    prepared = estimator.prepare(replace(flight(), flow=None))
    staged = estimator.read(prepared, estimator.fit(prepared))
    whole = estimator.estimate(flight())
    for name in ("mean_velocity", "length_scale", "weights_by_scale"):
        assert getattr(staged, name) == getattr(whole, name)


@pytest.mark.parametrize(
    ("backend", "duration", "status", "reason"),
    [
        (backends.get("lasso", alpha_fraction=1.0), 10.0, "unidentifiable", "no length scale"),
        (backends.get("stlsq", threshold=1e6), 10.0, "unidentifiable", "empty support"),
        ("least-squares", 0.1, "error", "Section V.B"),
    ],
)
def test_a_fit_without_an_answer_is_no_number(backend, duration, status, reason):
    short = flight(duration=duration)
    found = Estimator(library=SMALL, backend=backend).estimate(short)
    assert found.status == status
    assert reason in found.reason
    assert np.isnan([found.mean_velocity, found.length_scale, found.timescale]).all()
    if reason != "no length scale":  # there were weights, all of them zero
        assert found.weights_by_scale == {}


def test_a_mean_velocity_without_sense_is_unidentifiable():
    readout = sf.Readout(mean_velocity="paper", eq24="mean-ratio")
    statuses = set()
    for seed in range(6):
        found = Estimator(library=SMALL, readout=readout).estimate(flight(seed=seed))
        statuses.add(found.status)
        if not found.mean_velocity > 0:
            assert found.status == "unidentifiable"
            assert "mean velocity" in found.reason
    assert statuses <= {"ok", "inaccurate", "unidentifiable"}


def numbers_of(value):
    if isinstance(value, dict):
        value = list(value.values())
    if isinstance(value, list):
        return [n for item in value for n in numbers_of(item)]
    return [value] if isinstance(value, float) else []


@pytest.mark.parametrize("fraction", [0.1, 1.0])
def test_to_dict_is_json_without_nan(fraction):
    backend = backends.get("group-lasso", alpha_fraction=fraction)
    found = Estimator(library=SMALL, backend=backend).estimate(flight())
    record = json.loads(json.dumps(found.to_dict(), allow_nan=False))
    keys = {"mean_velocity", "length_scale", "timescale", "status", "reason", "backend"}
    assert keys | {"certificate"} <= set(record)
    assert np.isfinite(numbers_of(record)).all()
    assert (record["length_scale"] is None) == (fraction == 1.0)
    assert len(record["weights_by_scale"]) == SMALL_GRID.size


def test_to_dict_turns_infinity_and_certificates_without_a_dual_into_none():
    certificate = Certificate("fixed_point", 0.0)
    found = Estimate(math.inf, 4.0, 0.0, status="ok", certificate=certificate)
    record = found.to_dict()
    assert record["mean_velocity"] is None
    assert record["certificate"]["dual"] is None
    assert record["certificate"]["value"] == 0.0


fractions = st.floats(1e-9, 1.0)
derivatives = st.one_of(
    st.builds(sf.Derivative, st.sampled_from(["auto", "forward", "central", "midpoint"])),
    st.builds(partial(sf.Derivative, "savgol"), st.sampled_from([7, 21]), st.integers(1, 6)),
)
grids = st.one_of(
    st.builds(LengthScaleGrid, st.floats(0.1, 9.0), st.floats(9.0, 18.0), st.floats(0.01, 3.0)),
    st.builds(
        partial(LengthScaleGrid, upper=10.0),
        st.floats(0.1, 9.0),
        count=st.integers(1, 99),
        spacing=st.sampled_from(["length-scale", "wavenumber"]),
    ),
)
libraries = st.builds(
    Library, grids, st.sampled_from(["flow-velocity", "acceleration", "state-derivative"])
)
solvers = st.one_of(
    st.builds(backends.load("least-squares"), st.none() | st.floats(0.0, 1.0)),
    st.builds(backends.load("lasso"), fractions, st.sampled_from(["homotopy", "clarabel"])),
    st.builds(backends.load("group-lasso"), fractions, separate=st.booleans()),
)
readouts = st.builds(
    sf.Readout,
    st.sampled_from(["signed-sum", "absolute-sum", "group-norm"]),
    st.sampled_from(["paper", "rms"]),
    st.sampled_from(["mean-ratio", "pseudo-inverse"]),
)
estimators = st.builds(
    Estimator, derivatives, libraries, solvers, readouts, tolerance=st.floats(0.0, 1.0)
)


@given(estimators)
@settings(max_examples=60)
def test_json_round_trip(estimator):
    text = estimator.to_json()
    assert Estimator.from_json(text) == estimator
    assert Estimator.from_json(text).to_json() == text
    json.loads(text, parse_constant=pytest.fail)


@pytest.mark.parametrize(
    ("name", "settings"),
    [("lasso", {"alpha_fraction": np.float64(0.25)}), ("stlsq", {"max_iterations": np.int64(7)})],
)
def test_settings_given_as_numpy_numbers_are_json_too(name, settings):
    backend = backends.get(name, **settings)
    assert Estimator.from_json(Estimator(backend=backend).to_json()).backend == backend


def test_what_is_left_out_of_the_json_is_the_default():
    read = Estimator.from_json(json.dumps({"format": FORMAT}))
    assert read == Estimator(readout=sf.Readout(refine="variable-projection"))
    partly = {"format": FORMAT, "readout": {"refine": "none"}}
    assert Estimator.from_json(json.dumps(partly)).readout.refine == "none"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"format": "other/1"}, "not an estimator"),
        ({"format": "sparsefit-estimator/2"}, "format '2', and this version of sparsefit reads"),
        ({"tolerance": math.nan}, "not an estimator: NaN is no number"),
        ({"library": {"grid": {"lower": -math.inf}}}, "-Infinity is no number"),
        ({"provenance": {"scores": [1.0, math.nan]}}, "NaN is no number"),
        ({"backend": {"name": "../../lasso"}}, "a back-end, and no path: '../../lasso'"),
        ({"backends": {}}, 'did you mean "backend"'),
        ({"backend": "lasso"}, "must be an object"),
        ({"backend": {"name": "laso"}}, 'did you mean "lasso"'),
        ({"backend": {"name": "lasso", "alpha": 0.1}}, "setting of lasso"),
        ({"backend": {"name": "lasso", "alpha_fraction": 2.0}}, "alpha_fraction"),
        ({"backend": {"name": "lasso", "alpha_fraction": "0.1"}}, "alpha_fraction"),
        ({"backend": {"name": "lasso", "solver": "clarabell"}}, 'did you mean "clarabel"'),
        ({"backend": {"name": "stlsq", "max_iterations": 2.5}}, "integer"),
        ({"backend": {"name": "stlsq", "mode": ["scaled"]}}, "mode"),
        ({"library": {"grid": "paper"}}, '[library] key "grid" must be an object'),
        ({"library": {"grid": {"lower": "one"}}}, '[library.grid] key "lower" must be a num'),
        ({"library": {"grid": {"count": 2.0}}}, "whole number"),
        ({"library": {"targets": 1}}, '[library] key "targets" unknown: did you mean "target"'),
        ({"library": {"target": ["acceleration"]}}, "unknown value ['acceleration'] (known"),
        ({"derivative": {"windows": 5}}, 'did you mean "window"'),
        ({"readout": None}, "must be an object"),
        *(({"tolerance": bad}, "tolerance") for bad in (-1.0, "tight", None)),
    ],
)
def test_bad_json_is_refused_in_one_line(change, words):
    text = json.dumps({"format": FORMAT, **change})
    with pytest.raises(InputError) as error:
        Estimator.from_json(text)
    assert words in str(error.value)


@pytest.mark.parametrize(
    "text", ["", "{", "[]", "[" * 100_000, "null", '"lasso"', "{'format': 1}", "\ufeff{}"]
)
def test_what_is_no_json_object_is_refused(text):
    with pytest.raises(InputError, match="not an estimator"):
        Estimator.from_json(text)


@pytest.mark.parametrize(
    "arguments",
    [
        *({"tolerance": bad} for bad in (math.nan, -1.0)),
        *({"derivative": 5}, {"library": SMALL_GRID}, {"backend": None}, {"readout": "rms"}),
    ],
)
def test_parts_of_the_wrong_kind_are_refused(arguments):
    with pytest.raises(InputError, match="estimator: "):
        Estimator(**arguments)


FILE = Path(__file__).parents[2] / "studies" / "drifters" / "drifter_079.csv"
EVERY = 900.0  # s
DAY = 96  # samples
WATER = sf.PointMassVehicle(60.0)  # follows the water
GRID = sf.model.LengthScaleGrid(2e3, 200e3, spacing="flight")


@pytest.fixture(scope="module")
def track():
    flight = sf.read_flight(FILE)
    assert not flight.velocity_measured
    assert flight.vehicle == WATER
    assert np.all(np.diff(flight.time) == EVERY)
    return flight.position


PIECES = [(5, 0), *(pytest.param(*own, marks=pytest.mark.slow)
                    for own in ((10, 15), (10, 0), (5, 15), (25, 0)))]  # fmt: skip


@pytest.mark.parametrize(("days", "first"), PIECES)
def test_no_piece_of_a_drifter_is_called_a_cellular_flow(track, days, first):
    position = track[first * DAY : (first + days) * DAY]
    flight = sf.Flight.from_positions(EVERY * np.arange(len(position)), position, WATER)
    estimate = sf.Estimator(library=sf.Library(GRID)).estimate(flight)
    assert estimate.status in ("unidentifiable", "misfit")
    assert estimate.reason
    assert not estimate.repairs.words


def test_positions_alone_tell_a_cellular_flow():
    logged = fly(sf.CellularFlow(6.0, 4.0), duration=15.0, noise=(0.0, 0.002))
    flight = sf.Flight.from_positions(logged.time, logged.position, VEHICLE)
    estimate = sf.Estimator().estimate(flight)
    assert estimate.status == "ok"
    assert estimate.length_scale == pytest.approx(4.0, rel=5e-3)
    assert estimate.mean_velocity == pytest.approx(6.0, rel=3e-2)


HEAVY = {"cvxpy", "clarabel", "osqp", "pandas", "pyarrow", "matplotlib", "distributed"}
HEAVY |= PEERS | READERS
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
    assert not {room_of(name) for name in ours} & {*ROOMS[ROOMS.index("estimator") + 1 :]}
    running = {"estimator.prepare", "estimator.measure"}
    assert not ours & {f"sparsefit.{name}" for name in running}
    assert not run & HEAVY
    assert "scipy" in run  # what is looked for would be found
