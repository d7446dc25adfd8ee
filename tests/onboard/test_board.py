"""The filter on board: in numpy and in C, its sizes, and what cannot be exported."""

import math
import re
import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pytest

import sparsefit as sf
from sparsefit.flight.vehicle import turning
from sparsefit.onboard import board as module
from sparsefit.onboard import c_source
from sparsefit.onboard.board import Board, board_of, conditioned
from sparsefit.onboard.c_source import package, ram
from sparsefit.onboard.sweep import BoardDoubt, BoardSettings, features, rebased, slopes, waves
from tests.problems import fly

SETTINGS = BoardSettings(0.3, 0.0, 2.0, -1.0, 1.0, 2.0, 8.0, 0.03)
FLOW = np.array([1.5, -1.0, 0.7, 1.8, 0.6, 0.7])
TURNED = sf.flows.ShapedCells(9.0, 3.5, heading=0.3)
VEHICLE = sf.PointMassVehicle(0.3, (2.0, -1.0))
compiled = pytest.mark.skipif(module.CompiledFlow is None, reason="there was no compiler")


def flown(flow=TURNED, vehicle=VEHICLE, **changes):
    options = {"duration": 9.0, "rate": 50.0, "seed": 5, "noise": (0.1, 0.03)}
    return fly(flow, vehicle, **(options | changes))


def fed(board, flight, rows=slice(None)):
    clock = np.rint((flight.time - flight.time[0]) * 1e9).astype(np.int64)
    thrust = [None] * flight.samples if flight.thrust is None else flight.thrust.tolist()
    samples = np.column_stack([flight.position, flight.velocity]).tolist()
    for row in range(flight.samples)[rows]:
        yield board.update(int(clock[row]), *samples[row], thrust[row])


def differences(function, point, step=1e-6):
    """Central differences of a function of a vector, the last axis along it."""
    sides = [
        (function(point + step * axis) - function(point - step * axis)) / (2 * step)
        for axis in np.eye(len(point))
    ]
    return np.stack(sides, axis=-1)


def test_waves_are_cells_and_their_features_those_of_cells():
    k, amplitudes = TURNED.waves.wavevectors, [TURNED.waves.cosine, TURNED.waves.sine]
    flow, at = np.concatenate([np.ravel(amplitudes, "F"), k[0]]), np.array([1.3, -0.7])
    np.testing.assert_allclose(k[1], [-k[0, 1], k[0, 0]], atol=1e-12)
    np.testing.assert_allclose(waves(flow, at), TURNED.velocity(1.3, -0.7), atol=1e-12)
    np.testing.assert_allclose(features(flow), [9.0, 3.5, 3.5 / 9.0, 0.3, 0.0], atol=1e-12)
    away = np.array([0.8, -0.5])
    there = waves(rebased(FLOW, away), at - away)  # another anchor is the same flow
    np.testing.assert_allclose(there, waves(FLOW, at), atol=1e-12)
    for function in (features, lambda p: waves(p, at), lambda p: rebased(p, away)):
        np.testing.assert_allclose(slopes(function, FLOW), differences(function, FLOW), atol=1e-7)


def test_a_step_is_the_motion_and_its_covariance_the_linear_one():
    board = Board(replace(SETTINGS, drag_coefficient=0.05))
    start = np.array([2.0, 1.0, 0.1, 0.2, 0.3, -0.4, *FLOW])

    def stepped(state):
        board.state = np.tile(state, (4, 1))
        board.covariance = np.tile(np.eye(12), (4, 1, 1))
        board._predict(0.02, np.array([2.0, -1.0]), 0.0)
        return board.state[0].copy()

    transition = differences(stepped, start, 1e-5)
    stepped(start)
    np.testing.assert_allclose(board.covariance[0], transition @ transition.T, atol=5e-3)
    np.testing.assert_allclose(board.covariance[0], board.covariance[0].T, atol=1e-14)


def test_a_reading_is_conditioned_on():
    """Against the formula of a Gaussian, by hand; an outlier changes nothing."""
    rng = np.random.default_rng(1)
    root, h = rng.normal(size=(12, 12)), rng.normal(size=12)
    state, p = rng.normal(size=12), root @ root.T
    moved, covariance, unit, _ = conditioned(state[None], p[None], h, np.array([1.0]), 0.5)
    gain = p @ h / (h @ p @ h + 0.5)
    np.testing.assert_allclose(moved[0], state + gain)
    np.testing.assert_allclose(covariance[0], p - np.outer(gain, h @ p), atol=1e-12)
    assert unit[0] == pytest.approx(1.0 / math.sqrt(h @ p @ h + 0.5))
    moved, covariance, unit, _ = conditioned(state[None], p[None], h, np.array([1e3]), 0.5)
    assert (moved[0].tolist(), unit[0]) == (state.tolist(), 5.0)
    np.testing.assert_array_equal(covariance[0], p)


def spoiled():
    """Outliers of either sign, then another flow, which is lost and found again."""
    first, later = flown(duration=8.0), flown(sf.CellularFlow(9.0, 6.0), duration=12.0)
    both = {name: np.concatenate([getattr(first, name), getattr(later, name)])
            for name in ("position", "velocity")}  # fmt: skip
    both["velocity"][280:400:15] += [[4.0, -4.0], [-4.0, 4.0]] * 4
    return replace(first, time=np.append(first.time, later.time + 8.02), **both)


WORLDS = {
    "turned": (flown, {}),
    "spoiled": (spoiled, {"memory": 3.0}),
    "slow": (lambda: flown(sf.CellularFlow(4.0, 5.0), rate=10.0, duration=60.0), {}),
    "axes": (lambda: flown(sf.CellularFlow(9.0, 3.5)), {"any_heading": 0}),
    "thrust, memory": (
        lambda: flown(
            flow=sf.CellularFlow(8.0, 4.0),
            vehicle=sf.PointMassVehicle(0.5, (2.0, -1.0), 0.05, 1.1),
            seed=4,
            position_noise=0.02,
            thrust=turning(
                np.arange(9 * 50 + 2) / 50, constant=(1.0, 0.5), size=4.0, period=4.0, phase=0.3
            ),
        ),
        {"response_time": 0.5, "drag_coefficient": 0.05, "thrust_scale": 1.1, "memory": 4.0},
    ),
    "turbulence": (lambda: flown(sf.flows.Turbulence(3.0, 5.0, seed=1)), {}),
}


@compiled
@pytest.mark.parametrize("name", WORLDS)
def test_c_and_numpy_are_one_recurrence(name):
    world, changes = WORLDS[name]
    settings, flight = replace(SETTINGS, **changes), world()
    plain, fast = board_of(settings, compiled=False), board_of(settings)
    assert isinstance(plain, Board)
    assert not isinstance(fast, Board)
    followed = 0
    for row, both in enumerate(zip(fed(plain, flight), fed(fast, flight), strict=True)):
        assert both[0] == both[1]
        if row % 10:
            continue
        own, other = plain.estimate(), fast.estimate()
        assert (own.doubt, own.samples) == (other.doubt, other.samples)
        followed += plain.following
        np.testing.assert_allclose(other.value, own.value, rtol=1e-6, atol=1e-8)
        np.testing.assert_allclose(other.error, own.error, rtol=1e-5, atol=1e-12)
        np.testing.assert_allclose(other.flow, own.flow, rtol=1e-5, atol=1e-6)
        tests = [[a.innovation, a.correlation, a.unexplained, a.rival] for a in (own, other)]
        np.testing.assert_allclose(*tests, rtol=1e-5, atol=1e-7)
    assert (followed > 5) == (name != "turbulence")


@compiled
@pytest.mark.parametrize(
    ("name", "bad"),
    [("response_time", 0.0), ("lower", 9.0), ("drag_coefficient", math.nan), ("candidates", 0)],
)
def test_settings_out_of_range_are_refused(name, bad):
    with pytest.raises(ValueError, match="out of its range"):
        module.CompiledFlow(replace(SETTINGS, **{name: bad}))


@pytest.mark.parametrize("fast", [False, pytest.param(True, marks=compiled)])
def test_clocks_gaps_and_bad_samples(fast):
    flight = flown(duration=16.0)
    board = board_of(SETTINGS, compiled=fast)
    assert set(fed(board, flight, slice(0, 500))) == {module.OK}
    before = board.estimate()
    assert before.doubt is BoardDoubt.NO_DOUBT
    last = round((flight.time[499] - flight.time[0]) * 1e9)
    for bad in (math.nan, math.inf, 1e9):
        assert board.update(last + 20_000_000, bad, 0.0, 0.0, 0.0) == module.BAD_SAMPLE
    assert board.update(last, 0.0, 0.0, 0.0, 0.0) == module.BAD_TIME
    assert board.update(last + 10**15, 0.0, 0.0, 0.0, 0.0) == module.BAD_TIME  # far ahead
    assert board.estimate().value.tolist() == before.value.tolist()
    assert set(fed(board, flight, slice(500, 510))) == {module.OK}  # which deafens nothing
    # Two seconds are lost: the second sample after them is taken, and the flow is still followed.
    statuses = list(fed(board, flight, slice(610, 800)))
    assert statuses[:3] == [module.BAD_TIME, module.GAP_TAKEN, module.OK]
    after = board.estimate()
    assert after.doubt is BoardDoubt.NO_DOUBT
    assert after.value[1] == pytest.approx(3.5, rel=0.01)


GRID = sf.model.LengthScaleGrid(2.0, 8.0)
ESTIMATOR = sf.Estimator(library=sf.Library(grid=GRID), readout=sf.Readout(refine="ladder"))
compiler = pytest.mark.skipif(not shutil.which("gcc"), reason="there is no gcc")
STRICT = ("gcc", "-std=c99", "-Wall", "-Wextra", "-Werror", "-Wpedantic", "-Wconversion", "-I.")
SIZES = """#include "sf_flow.h"
#include <stdio.h>
#include <math.h>
#define SAY(value) (void)printf("%d ", (int)(value))
static sf_flow flow;
int main(void)
{
    const sf_real zero[2] = {0, 0}, bad[2] = {(sf_real)NAN, 0};
    sf_config config = {.response_time = 0, .thrust_scale = 1, SF_SETTINGS};
    sf_answer answer;
    SAY(sizeof(sf_flow));
    SAY(sf_update(&flow, 1, zero, zero, 0)); /* not begun */
    SAY(sf_init(&flow, &config));            /* no response time */
    SAY(sf_init(0, &config));
    config.response_time = (sf_real)0.5;
    SAY(sf_init(&flow, &config));
    SAY(sf_update(&flow, 1, bad, zero, 0));
    SAY(sf_update(&flow, 1, zero, zero, bad));
    SAY(sf_update(&flow, 1, zero, zero, 0));
    SAY(sf_update(&flow, 1, zero, zero, 0)); /* no later */
    SAY(sf_estimate(&flow, &answer));
    SAY(answer.doubt);                       /* few samples */
    return 0;
}
"""


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """The folder of an export, built with every warning an error."""
    folders, flight = {}, c_source.example_flight(ESTIMATOR)
    flight = flight.rows(np.arange(flight.samples) < 700)
    answers = c_source.reference(ESTIMATOR, flight)
    for real in ("double", "float"):
        folder = folders[real] = tmp_path_factory.mktemp(real)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(c_source, "reference", lambda *_: answers)
            files = package(ESTIMATOR, real, flight, source="*/ x.json")
        for path, content in files.items():
            (folder / path).parent.mkdir(exist_ok=True)
            (folder / path).write_bytes(content)
        (folder / "sizes.c").write_text(SIZES)
        subprocess.run([*STRICT, "-c", "sf_flow.c"], cwd=folder, check=True)
        for name, program in (("replay", "test/replay.c"), ("sizes", "sizes.c")):
            command = [*STRICT, "sf_flow.o", program, "-lm", "-o", name]
            subprocess.run(command, cwd=folder, check=True)
    return folders


def run(folder, *command):
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)


@compiler
@pytest.mark.parametrize(("real", "tolerance"), [("double", "1e-8"), ("float", "1e-4")])
def test_the_replay_is_what_python_computes(built, real, tolerance):
    replay = run(built[real], "./replay", "test/flight.csv", "test/reference.csv", tolerance)
    assert replay.returncode == 0, replay.stdout
    impossible = run(built[real], "./replay", "test/flight.csv", "test/reference.csv", "0")
    assert impossible.returncode == 1
    lines = run(built[real], "./replay", "test/flight.csv").stdout.splitlines()
    assert lines[0].startswith("sample,doubt,mean_velocity,length_scale")
    numbers = np.array([line.split(",") for line in lines[-5:]], dtype=float)
    assert (numbers[:, 1] == 0).all()
    np.testing.assert_allclose(numbers[:, 3], 4.0, rtol=0.01)
    assert run(built[real], "./replay", "absent.csv").returncode == 2


@compiler
@pytest.mark.parametrize("real", ["double", "float"])
def test_what_it_takes_and_what_it_refuses(built, real):
    size, *statuses = map(int, run(built[real], "./sizes").stdout.split())
    assert size <= ram(real) <= min(size + 128, 65536)
    assert statuses == [6, 6, 6, 0, 4, 4, 0, 5, 1, 1]
    header, readme = ((built[real] / name).read_text() for name in ("sf_flow.h", "README.md"))
    for text in (header, readme):
        assert f"{ram(real)} bytes" in text
        assert "test of misfit" in text
        assert "@" not in re.sub(r"\S+@\S+\.", "", text)
    assert f"#define SF_REAL {real}" in header
    assert ".any_heading = 1" in header
    assert header.count("*/ x.json") == 0


def test_the_work_of_a_sample_by_hand():
    """Of 4 filters 7,222 sums, 60 quotients and 30 sines each; 192 rows of 1,200 sums to start."""
    following, searching = re.findall(r"(?s)work.*?cycles", "\n".join(c_source.costs("float", 10)))
    assert "28888 sums and products, 240 quotients and roots, 120 sines" in following
    assert "231936 sums and products, 120 quotients and roots, 7680 sines" in searching
    microseconds = ((28888, 240, 120), (231936, 120, 7680)) @ np.array((3, 20, 120)) / 400
    for text, expected in zip((following, searching), microseconds, strict=True):
        assert f"{expected:.0f} us at 400 MHz" in text


@compiler
def test_cpp_takes_the_header(built):
    program = "int main() { static sf_flow f; return sf_init(&f, 0) == SF_OK; }"
    (built["double"] / "main.cpp").write_text(f'#include "sf_flow.h"\n{program}\n')
    command = ("g++", "-I.", "-c", "main.cpp")
    assert not shutil.which("g++") or run(built["double"], *command).returncode == 0


def test_a_flight_of_ones_own_with_thrust():
    thrust = turning(
        np.arange(6 * 50 + 2) / 50, constant=(0.0, 0.0), size=1.0, period=6.0, phase=0.0
    )
    flow, vehicle = sf.CellularFlow(8.0, 4.0), sf.PointMassVehicle(0.5)
    flight = fly(flow, vehicle, duration=6.0, rate=50.0, seed=1, thrust=thrust)
    files = package(ESTIMATOR, flight=flight)
    assert b"time,x,y,vx,vy,ax,ay" in files["test/flight.csv"]
    assert len(files["test/reference.csv"].splitlines()) == 7


def test_refusals():
    with pytest.raises(sf.InputError, match="several scales"):
        package(sf.Estimator(readout=sf.Readout(scales="several")))
    with pytest.raises(sf.InputError, match="unknown C type"):
        package(ESTIMATOR, "half")
