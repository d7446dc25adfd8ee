"""`sparsefit estimate` and the logs of others: what it says of them, and which it refuses."""

import json
import os
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest

import sparsefit as sf
from sparsefit.errors import InputError
from sparsefit.logs import write_flight
from tests.cli import verbs
from tests.logs.log_writers import igc

GRID = ("--grid-lower", "3.2", "--grid-upper", "5.2")
VEHICLE = ("--response-time", "0.5", "--thrust-ax", "5", "--thrust-ay", "3")
MAP = "time=t[ms],x=lon,y=lat,vx=u[cm/s],vy=v[cm/s]"


@pytest.fixture(scope="module")
def flight():
    flow, vehicle = sf.CellularFlow(15.43, 4.21), sf.PointMassVehicle(0.5, (5.0, 3.0))
    return sf.simulate_flight(
        flow, vehicle, duration=5.0, sample_rate=100.0, seed=7, velocity_noise=0.05
    )


@pytest.fixture(autouse=True)
def its_log(in_empty_folder, flight):
    write_flight(flight, "flight.csv")


def run(capsys, *argv):
    return verbs.run(capsys, "estimate", *argv)


def refused(capsys, *argv):
    return verbs.refused(capsys, "estimate", *argv)


def written(flight):
    """The same flight as a foreign log: ms, degrees about 47 N 8 E, cm/s."""
    from pyproj import Proj

    x, y = (flight.position - (flight.position.max(0) + flight.position.min(0)) / 2).T
    lon, lat = Proj(proj="aeqd", lon_0=8, lat_0=47, ellps="WGS84")(x, y, inverse=True)
    rows = np.column_stack([1e3 * flight.time, lon, lat, 100.0 * flight.velocity])
    lines = ["t,lon,lat,u,v", *(",".join(map(repr, row)) for row in rows.tolist())]
    Path("foreign.csv").write_text("\n".join(lines) + "\n")
    return "foreign.csv"


def test_a_log_in_other_columns_units_and_degrees_gives_the_same_flow(capsys, flight):
    code, out, _ = run(capsys, written(flight), *VEHICLE, *GRID, "--columns", MAP, "--json")
    found = json.loads(out)
    assert code == 0
    assert found["mean_velocity"] == pytest.approx(15.43, rel=1e-3)
    assert found["length_scale"] == pytest.approx(4.21, rel=1e-3)
    log = found["log"]
    assert (log["frame"], log["rate"], log["gaps"]) == ("ENU", pytest.approx(100.0), 0)
    assert log["extent"] == pytest.approx(np.ptp(flight.position, axis=0).tolist(), rel=1e-5)
    assert log["velocity_noise"] == pytest.approx(0.05, rel=0.15)
    assert log["read_as"][0].startswith("time = t [ms], x = lon [deg]")


def test_several_logs_in_degrees_are_laid_on_the_plane_of_the_first(capsys, monkeypatch, flight):
    estimating = Mock(side_effect=InputError("enough"))
    monkeypatch.setattr(sf.Estimator, "estimate", estimating)
    first, rest = written(flight), slice(250, 501)
    part = replace(flight, time=flight.time[rest], position=flight.position[rest],
                   velocity=flight.velocity[rest])  # fmt: skip
    lines = Path(first).read_text().splitlines(keepends=True)
    Path("part.csv").write_text("".join([lines[0], *lines[251:]]))
    assert "enough" in refused(capsys, first, "part.csv", *VEHICLE, *GRID, "--columns", MAP)
    (seen,) = estimating.call_args.args
    np.testing.assert_allclose(seen[1].position, seen[0].position[rest], atol=1e-6)
    np.testing.assert_allclose(seen[1].time, part.time)


def test_a_log_of_the_earth_beside_one_of_nowhere_is_refused(capsys):
    degrees = 1e-3 * np.arange(5.0)
    Path("recording.igc").write_text(igc(range(5), 47.0 + degrees, 8.0 + degrees))
    err = refused(capsys, "recording.igc", "flight.csv", *VEHICLE)
    assert "flight.csv: has no longitude and latitude, and recording.igc has" in err


def test_the_log_is_told_before_the_estimate(capsys):
    name = "two\nlines $x_$ \udcff 飛行.csv"
    os.link("flight.csv", name)
    code, out, _ = run(capsys, name, *GRID, "--from", "1", "--to", "4", "--plot", "a.png")
    lines = {line[:20].strip(): (place, line[22:]) for place, line in enumerate(out.splitlines())}
    assert code == 0
    assert lines["flight"][1].startswith("two lines $x_$ \\udcff 飛行.csv: ")
    assert lines["flight"][1].endswith("301 samples over 3 s")
    assert lines["log"][0] < lines["frame"][0] < lines["mean velocity  U0"][0]
    assert lines["log"][1].startswith("100 Hz, even steps; no gaps; ")
    assert lines["frame"][1] == "not stated: x and y as in the file"
    assert Path("a.png").read_bytes().startswith(b"\x89PNG")
    assert "a.png exists; add --force" in refused(capsys, "flight.csv", "--plot", "a.png")
    assert "(known: .png, .svg, .pdf)" in refused(capsys, "flight.csv", "--plot", "a.jpg")
    assert "no is no folder; make it" in refused(capsys, "flight.csv", "--plot", "no/a.png")


def test_a_bad_log_is_refused_by_name_before_any_work(capsys, monkeypatch, flight):
    monkeypatch.setattr(sf.Estimator, "estimate", Mock(side_effect=AssertionError))
    write_flight(replace(flight, time=flight.time + 600.0 * (flight.time > 2)), "bad.csv")
    assert "bad.csv: " in refused(capsys, "bad.csv", "--json")
    assert "a gap of 600 s" in refused(capsys, "bad.csv")
    foreign = (written(flight), *VEHICLE, "--columns", MAP, "--from", "9")
    assert "at least 3 samples" in refused(capsys, *foreign)
