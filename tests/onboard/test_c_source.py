"""The C: it compiles without a word, replays what Python computes, and says what it takes."""

import re
import shutil
import subprocess

import numpy as np
import pytest

import sparsefit as sf
from sparsefit.flight.vehicle import turning
from sparsefit.onboard import c_source
from sparsefit.onboard.c_source import package, ram

GRID = sf.model.LengthScaleGrid(2.0, 8.0)
ESTIMATOR = sf.Estimator(library=sf.Library(grid=GRID), readout=sf.Readout(refine="ladder"))
compiler = pytest.mark.skipif(not shutil.which("gcc"), reason="there is no gcc")
STRICT = ("gcc", "-std=c99", "-O1", "-Wall", "-Wextra", "-Werror", "-Wpedantic", "-I.")
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
    flight = sf.simulate_flight(
        sf.CellularFlow(8.0, 4.0), sf.PointMassVehicle(0.5), duration=6.0, sample_rate=50.0, seed=1,
        thrust=thrust,
    )  # fmt: skip
    files = package(ESTIMATOR, flight=flight)
    assert b"time,x,y,vx,vy,ax,ay" in files["test/flight.csv"]
    assert len(files["test/reference.csv"].splitlines()) == 7


def test_refusals():
    with pytest.raises(sf.InputError, match="several scales"):
        package(sf.Estimator(readout=sf.Readout(scales="several")))
    with pytest.raises(sf.InputError, match="unknown C type"):
        package(ESTIMATOR, "half")
