"""Logs of PX4 and of gliders' recorders: what is read of them, and how bad ones are refused."""

import sys
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from pyproj import Proj

import sparsefit as sf
from sparsefit.errors import InputError, MissingExtra
from sparsefit.logs.files import read_table
from sparsefit.logs.layout import Layout
from tests.logs.log_writers import LANDED, LOCAL, igc, ulog, ulog_at, ulog_of

VEHICLE = sf.PointMassVehicle(0.5, (5.0, 3.0))
STANDING = Path(__file__).parent / "shipped" / "sample_log_small.ulg"  # of PX4/pyulog, BSD-3
EARTH = Proj(proj="aeqd", lon_0=8, lat_0=47, ellps="WGS84")
SECONDS = np.arange(0.0, 120.0)
# A glider in a thermal: its plane [m], (m, 2), longitude and latitude.
CIRCLES = 150.0 * np.column_stack([np.cos(0.2 * SECONDS), np.sin(0.2 * SECONDS)])
CIRCLES += 2.0 * SECONDS[:, None]
LONGITUDE, LATITUDE = EARTH(*CIRCLES.T, inverse=True)
RECORDING = igc(SECONDS, LATITUDE, LONGITUDE)


@pytest.fixture(scope="module")
def flight():
    flow = sf.CellularFlow(15.43, 4.21)
    return sf.simulate_flight(flow, VEHICLE, duration=3.0, sample_rate=50.0, seed=7)


def write(folder, name, content):
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def test_a_px4_log_is_read_in_ned_and_seconds(tmp_path, flight):
    path = write(tmp_path, "log.ulg", ulog_of(flight, landed=False))
    found = sf.read_flight(path, vehicle=VEHICLE)
    np.testing.assert_allclose(found.time, flight.time, atol=1e-9)
    np.testing.assert_allclose(found.position, flight.position, rtol=1e-6, atol=1e-6)  # float32
    np.testing.assert_allclose(found.velocity, flight.velocity, rtol=1e-6, atol=1e-6)
    assert found.frame == "NED"
    assert read_table(path).notes == ("PX4's vehicle_local_position",)


def test_samples_that_the_filter_calls_invalid_are_left_out(tmp_path, flight):
    valid = np.ones(flight.samples, bool)
    valid[:20] = False
    path = write(tmp_path, "log.ulg", ulog_of(flight, valid=valid))
    table = read_table(path)
    assert len(table.columns["time"]) == flight.samples - 20
    assert table.columns["time"][0] == 0.0
    assert table.notes[1] == f"20 of {flight.samples} samples are not valid, and left out"


def test_logs_of_two_boots_share_a_frame_and_a_clock(tmp_path, flight):
    """The second began 300 m north and 100 m east of the first, an hour later."""
    booted = 1_700_000_000_000_000
    first = write(tmp_path, "a.ulg", ulog_at(flight, 8.0, 47.0, booted))
    there = EARTH(100.0, 300.0, inverse=True)
    second = write(tmp_path, "b.ulg", ulog_at(flight, *there, booted + 3600 * 10**6))
    table = read_table(first)
    assert table.origin == (8.0, 47.0)
    assert table.epoch == datetime(2023, 11, 14, 22, 13, 40, tzinfo=UTC)
    moved = sf.read_flight(second, vehicle=VEHICLE, origin=table.origin, epoch=table.epoch)
    np.testing.assert_allclose(moved.time, flight.time + 3600.0, atol=1e-6)
    np.testing.assert_allclose(moved.position, np.add(flight.position, [300, 100]), atol=1e-3)


def test_a_log_is_read_as_far_as_it_goes(tmp_path, flight, capsys):
    path = write(tmp_path, "log.ulg", ulog_of(flight)[:-40])
    cut = sf.read_flight(path, vehicle=VEHICLE)
    assert flight.samples - 2 <= cut.samples < flight.samples
    np.testing.assert_allclose(cut.position, flight.position[: cut.samples], atol=1e-5)
    assert capsys.readouterr().out == ""
    with pytest.raises(InputError, match=r"not a ULog|not in the log"):
        sf.read_flight(write(tmp_path, "log.ulg", ulog_of(flight)[:70]), vehicle=VEHICLE)


def local(rows, **topics):
    return ulog({"vehicle_local_position": (LOCAL, rows), **topics})


FINE = [(i, i, 0, 0, 0, True, True) for i in range(5)]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"u", "not a ULog of PX4"),
        (b"junk" * 99, "not a ULog of PX4"),
        (STANDING.read_bytes(), "no valid local position in any of 636 samples"),
        (ulog({"vehicle_attitude": (LANDED, [(1, True)])}), "position is not in the log"),
        (ulog({"vehicle_local_position": (LANDED, [(1, True)])}), "has no vx, vy, x, y; log it"),
        (local([(i, 0, 0, 0, 0, True, False) for i in range(5)]), "in any of 5 samples"),
        (local([(i, i, 0, 0, 0, False, True) for i in range(5)]), "in any of 5 samples;"),
        (local(FINE[1::-1]), "at least 3 samples"),
        (local(FINE[::-1]), "time runs backwards: row 1"),
        ("\n", "none of 0 fixes"),
        ("time,x,y\n1,2,3\n", "none of 0 fixes|not an IGC"),
        (RECORDING.replace("HFDTE010624\r\n", ""), "not an IGC file, or a damaged one: .*date"),
        (RECORDING.replace("A00500", "V00500"), "none of 120 fixes is valid"),
    ],
)
def test_bad_logs_of_px4_and_of_gliders_are_one_line(tmp_path, content, words):
    path = write(tmp_path, "log.igc" if isinstance(content, str) else "log.ulg", content)
    with pytest.raises(InputError, match=words) as caught:
        sf.read_flight(path, vehicle=VEHICLE)
    assert str(caught.value).startswith(f"{path}: ")


def test_a_gliders_recording_is_read_on_a_plane_past_midnight(tmp_path):
    path = write(tmp_path, "log.igc", RECORDING)
    flight = sf.read_flight(path, vehicle=VEHICLE)
    np.testing.assert_array_equal(flight.time, SECONDS)
    moved = CIRCLES - CIRCLES[0]
    np.testing.assert_allclose(flight.position - flight.position[0], moved, atol=2.0)
    assert (flight.frame, flight.velocity_measured) == ("ENU", False)
    assert read_table(path).notes[0] == "fixes from 2024-06-01 23:59:30 UTC, rounded to 1.9 m"


def test_southern_and_western_degrees(tmp_path):
    text = igc([0.0, 1.0, 2.0], [-33.1, -33.11, -33.12], [-70.1, -70.1, -70.1])
    flight = sf.read_flight(write(tmp_path, "log.igc", text), vehicle=VEHICLE)
    np.testing.assert_allclose(np.diff(flight.position[:, 1]), -1109.0, rtol=1e-3)  # north


def test_two_recordings_share_a_plane_and_a_clock(tmp_path):
    first = read_table(write(tmp_path, "a.igc", RECORDING))
    late = igc(SECONDS, LATITUDE, LONGITUDE + 0.01, start=datetime(2024, 6, 2, 1, 0, 0))
    path = write(tmp_path, "b.igc", late)
    second = read_table(path, Layout.of(None, first.origin, first.epoch)).flight(VEHICLE)
    np.testing.assert_allclose(second.time, SECONDS + 3630.0)
    east = EARTH(8.01, 47.0)[0]
    shift = second.position - first.flight(VEHICLE).position
    np.testing.assert_allclose(shift, np.tile([east, 0.0], (120, 1)), atol=4.0)


@pytest.mark.parametrize(("name", "package"), [("a.ulg", "pyulog"), ("a.igc", "aerofiles")])
def test_absent_packages_are_named_with_the_extra(tmp_path, monkeypatch, name, package):
    for module in (package, "aerofiles.igc"):
        monkeypatch.setitem(sys.modules, module, None)
    path = write(tmp_path, name, b"u")
    with pytest.raises(MissingExtra, match=rf"{package}: pip install 'sparsefit\[logs\]'"):
        sf.read_flight(path, vehicle=VEHICLE)
    with pytest.raises(InputError, match="unknown file type with columns="):
        sf.read_flight(path, vehicle=VEHICLE, columns="time=t")
