"""Foreign logs: tables with maps, units, times and degrees, PX4's and those of gliders."""

import sys
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from pyproj import Geod, Proj

import sparsefit as sf
from sparsefit.errors import InputError, MissingExtra
from sparsefit.logs.files import read_table
from sparsefit.logs.layout import Layout, Source
from sparsefit.logs.plane import plane_of
from tests.logs.log_writers import LANDED, LOCAL, igc, ulog, ulog_at, ulog_of
from tests.problems import VEHICLE, fly

BUOY = sf.PointMassVehicle(60.0)
DRIFTER = Path(__file__).parent / "shipped" / "drifter_079_head.csv"
MAPPED = "time=t[ms],x=east[km],y=north[ft],vx=u[cm/s],vy=v[kn]"
ROWS = [(0, 1.0, 2.0, 30.0, 4.0), (500, 1.5, 3.0, 31.0, 5.0), (1000, 2.0, 4.0, 32.0, 6.0)]


@pytest.fixture
def file(tmp_path):
    return lambda text, name="log.csv": write(tmp_path, name, text)


def csv_text(header, rows, delimiter=","):
    return "\n".join(delimiter.join(map(str, row)) for row in [header, *rows]) + "\n"


def in_si(path, **options):
    flight = sf.read_flight(path, vehicle=BUOY, **options)
    return np.column_stack([flight.time, flight.position, flight.velocity])


WANTED = np.array(ROWS) * [1e-3, 1e3, 0.3048, 1e-2, 1852 / 3600]


@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
def test_units_of_a_column_map_become_si(file, delimiter):
    path = file(csv_text(("t", "east", "north", "u", "v"), ROWS, delimiter))
    np.testing.assert_allclose(in_si(path, columns=MAPPED), WANTED, rtol=1e-15)


def test_parquet_takes_the_same_map_and_its_own_times(tmp_path):
    names = ("t", "east", "north", "u", "v")
    columns = dict(zip(names, np.array(ROWS).T, strict=True))
    pq.write_table(pa.table(columns), tmp_path / "log.parquet")
    np.testing.assert_allclose(in_si(tmp_path / "log.parquet", columns=MAPPED), WANTED)
    moments = pa.array([1_342_966_500_000 + 500 * i for i in range(3)], pa.timestamp("ms", "UTC"))
    pq.write_table(pa.table(columns | {"t": moments}), tmp_path / "log.parquet")
    found = in_si(tmp_path / "log.parquet", columns=MAPPED.replace("t[ms]", "t"))
    np.testing.assert_allclose(found, WANTED)


def test_iso_times_are_seconds_since_the_first_in_any_zone(file):
    times = ("2012-07-22 14:15:00.5", "2012-07-22T14:15:01+00:00", "2012-07-22T16:15:03.25+02:00")
    rows = [(time, x, x) for time, x in zip(times, (0.0, 1.0, 3.0), strict=True)]
    flight = sf.read_flight(file(csv_text(("time", "x", "y"), rows)), vehicle=BUOY)
    assert flight.time.tolist() == [0.0, 0.5, 2.75]
    with pytest.raises(InputError, match="line 3, column time: '12' is no ISO time"):
        sf.read_flight(file(csv_text(("time", "x", "y"), [rows[0], ("12", 0, 0)])))


def test_the_plane_is_true_from_its_middle_and_turns_velocities_with_it():
    """Against geodesics of the ellipsoid, by another part of PROJ (Karney, 2013)."""
    geod = Geod(ellps="WGS84")
    longitude, latitude = np.array([7.0, 9.0, 8.0, 8.6]), np.array([46.6, 47.4, 47.0, 47.3])
    found = plane_of(longitude, latitude, ("lon", "lat"))
    azimuth, _, distance = geod.inv(8.0, 47.0, longitude[3], latitude[3])
    expected = distance * np.array([np.sin(np.radians(azimuth)), np.cos(np.radians(azimuth))])
    np.testing.assert_allclose(found.position[3], expected, atol=1e-3)
    assert found.words == "local plane about 47.0000° N, 8.0000° E, lengths true to 0.003 %"
    ahead = geod.fwd(longitude, latitude, np.full(4, 30.0), np.full(4, 1.0))[:2]
    moved = plane_of(*map(np.concatenate, ([longitude, ahead[0]], [latitude, ahead[1]])), ("", ""))
    step = moved.position[4:] - moved.position[:4]
    heading = np.radians(30.0)
    turned = found.turned(np.tile([np.sin(heading), np.cos(heading)], (4, 1)))
    np.testing.assert_allclose(turned, step, atol=3e-4)
    assert np.abs(turned[0] - turned[1]).max() > 0.02  # the meridians do converge
    across = plane_of(np.array([179.9, -179.9]), np.array([10.0, 10.0]), ("lon", "lat"))
    assert np.ptp(across.position[:, 0]) == pytest.approx(0.2 * 109_640, rel=1e-3)  # the date line


def test_an_origin_and_an_epoch_of_ones_own(file):
    rows = [(f"2012-07-22 14:00:0{i}", 8.0 + 1e-4 * i, 47.0) for i in range(4)]
    path = file(csv_text(("Date", "lon", "lat"), rows))
    told = {"columns": "time=Date,x=lon,y=lat", "vehicle": BUOY}
    own = sf.read_flight(path, **told)
    moved = sf.read_flight(path, **told, origin=(8.0, 47.0), epoch="2012-07-22T13:59:50Z")
    np.testing.assert_allclose(moved.time, own.time + 10.0)
    assert moved.position[0] == pytest.approx([0.0, 0.0], abs=1e-6)
    np.testing.assert_allclose(np.diff(moved.position[:, 0]), 7.6, atol=0.01)
    for wrong in ({"origin": (47.0, 99.0)}, {"origin": 8.0}, {"epoch": "noon"}, {"epoch": 5}):
        with pytest.raises(InputError, match=next(iter(wrong))):
            sf.read_flight(path, **told, **wrong)


def test_a_drifter_whose_header_has_latitude_and_longitude_swapped():
    """GLAD drifter 079, MIT licence beside it: the header says Long,Lat and is wrong."""
    with pytest.raises(InputError, match=r"latitude and longitude look swapped: .* x=Lat, y=Long"):
        read_table(DRIFTER, Layout.of("time=Date,x=Long,y=Lat"))
    table = read_table(DRIFTER, Layout.of("time=Date,x=Lat,y=Long"))
    assert (table.frame, table.columns["time"][:2].tolist()) == ("ENU", [0.0, 900.0])
    assert table.notes[0] == "time = Date, x = Lat [deg], y = Long [deg]"
    flight = table.flight(BUOY)
    assert 0.2 < np.hypot(*flight.velocity.T).mean() < 1.0  # m/s, of the Gulf of Mexico
    assert flight.frame == "ENU"


@pytest.mark.parametrize(
    ("x", "y", "words"),
    [
        ((8.0, 8.1), (120.0, 120.1), "y = lat goes 120 … 120.1°: latitude and longitude look"),
        ((120.0, 120.1), (-95.0, -95.1), "or check their units"),
        ((4e8, 4.1e8), (8.0, 8.1), r"x = lon goes 4e\+08 … 4.1e\+08°.*: no degrees; .*degE7"),
        ((-9.0, 51.0), (-8.0, -8.1), "km from its middle: no plane"),
    ],
)
def test_degrees_that_are_none(x, y, words):
    with pytest.raises(InputError, match=words):
        plane_of(np.array(x), np.array(y), ("lon", "lat"))
    with pytest.raises(InputError, match=r"look swapped: .* x=lon, y=lat"):
        plane_of(np.array([47.0, 47.1]), np.array([8.0, 8.1]), ("lat", "lon"))


def test_degrees_without_pyproj_name_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "pyproj", None)
    with pytest.raises(MissingExtra, match=r"pip install 'sparsefit\[logs\]'"):
        read_table(DRIFTER, Layout.of("time=Date,x=Lat,y=Long"))


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        ("t", 'columns: "t" is not NAME=VALUE'),
        (5, 'columns: "5" is not NAME=VALUE'),
        ("tim=t", 'unknown field "tim": did you mean "time"'),
        ("time=t,time=q", "time is given twice"),
        ("time=t[fortnight]", 'unknown unit of time "fortnight"'),
        ("time=t,vx=u[m]", 'unknown unit of vx "m".*m/s'),
        ("time=tt,x=east,y=north", 'no column "tt"'),
        ("x=east,y=north", "no column time; found t, east"),
        ("time=t,x=east,y=north,vx=u", "no column vy; found t, east"),
        ("time=t,x=east[deg],y=north", "both are degrees, or none"),
    ],
)
def test_bad_maps_are_named(file, columns, words):
    path = file(csv_text(("t", "east", "north", "u", "v"), ROWS))
    with pytest.raises(InputError, match=words):
        read_table(path, Layout.of(columns))


def test_degrees_follow_from_names_unless_a_unit_is_said():
    names = ["time", "Longitude", "lat"]
    by_name = {"time": Source("time"), "x": Source("Longitude", "deg"), "y": Source("lat", "deg")}
    assert Layout.of("x=Longitude,y=lat").chosen(names) == by_name
    in_metres = Layout.of("x=Longitude[m],y=lat[m]").chosen(names)
    assert (in_metres["x"], in_metres["y"]) == (Source("Longitude", "m"), Source("lat", "m"))


@pytest.mark.parametrize(("unit", "size"), [("rad", np.pi / 180), ("degE7", 1e7), ("°", 1.0)])
def test_degrees_in_other_units(file, unit, size):
    degrees = [(0, 8.0, 47.0), (1, 8.1, 47.0), (2, 8.0, 46.9)]
    rows = [(t, lon * size, lat * size) for t, lon, lat in degrees]
    header = ("time", f"lon [{unit}]", f"lat [{unit}]")
    found, plain = (
        in_si(file(csv_text(names, own)), columns="x=lon,y=lat")
        for names, own in ((header, rows), (("time", "lon", "lat"), degrees))
    )
    np.testing.assert_allclose(found, plain, atol=1e-6)


SHEET = "Zeit [ms];Ost (km);north [ft];u [cm/s];v (kn);Höhe\r\n" + "".join(
    ";".join(f"{value:.1f}".replace(".", ",") for value in row) + ";5,5\r\n" for row in ROWS
)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig"])
@pytest.mark.parametrize("name", ["sheet.csv", "sheet.txt"])
def test_what_spreadsheets_export(tmp_path, encoding, name):
    """Decimal commas between semicolons, units in the header, a byte order mark, Excel's sep=."""
    path, first = tmp_path / name, "sep=;\r\n" if name.endswith("csv") else ""
    path.write_bytes((first + SHEET).encode(encoding))
    found = in_si(path, columns="time=Zeit,x=ost,y=north,vx=u,vy=v")
    np.testing.assert_allclose(found, WANTED, rtol=1e-15)
    notes = read_table(path, Layout.of("time=Zeit,x=Ost,y=north,vx=u,vy=v")).notes
    assert notes == ("time = Zeit [ms], x = Ost (km), y = north [ft], vx = u [cm/s], vy = v (kn)",)


def test_a_comma_is_no_decimal_mark_beside_decimal_points(file):
    path = file("time;x;y\n0.0;900;1\n0.5;1,234;1\n1.0;2,345;1\n")
    with pytest.raises(InputError, match="line 3, column x: '1,234' is not a finite number"):
        read_table(path)


def test_the_header_that_numpy_writes_is_a_comment(tmp_path, file):
    for mark in (" ", ","):
        header = "Time[ms] x[km] y[ft] vx[cm/s] vy[kts]"
        np.savetxt(tmp_path / "log.txt", ROWS, header=header, delimiter=mark)
        np.testing.assert_allclose(in_si(tmp_path / "log.txt"), WANTED, rtol=1e-15)
    numbered = file("# of a frame\n" + csv_text(range(5), ROWS))  # names of columns are numbers
    found = in_si(numbered, columns="time=0[ms],x=1[km],y=2[ft],vx=3[cm/s],vy=4[kn]")
    np.testing.assert_allclose(found, WANTED, rtol=1e-15)


@pytest.mark.parametrize("encoding", ["utf-16", "cp1252"])
def test_other_encodings_are_refused_with_the_remedy(tmp_path, encoding):
    (tmp_path / "sheet.csv").write_bytes(SHEET.encode(encoding))
    with pytest.raises(InputError, match="save it as UTF-8"):
        read_table(tmp_path / "sheet.csv")


def test_names_of_any_case_and_units_in_a_header_need_no_map(file):
    header = ("Time (s)", "X [km]", "y (ft)", "VX[cm/s]", "vy [kn]")
    path = file(
        "# gain = 3 of a foreign writer\n" + csv_text(("time", "e [km]", *header[2:]), ROWS)
    )
    np.testing.assert_allclose(in_si(path, columns="x=e[km]"), in_si(path, columns="x=e"))
    path = file(csv_text(header, ROWS, "\t"))
    np.testing.assert_allclose(in_si(path), np.array(WANTED) * [1e3, 1, 1, 1, 1], rtol=1e-15)
    assert read_table(path).notes[0].startswith("time = Time (s), x = X [km]")


def test_columns_between_blanks(file):
    text = "  time   x  y\n" + "\n".join(f" {t:5.1f}  {t:g} {2 * t:g} " for t in (0.0, 1.0, 2.0))
    flight = sf.read_flight(file(text, "log.dat"), vehicle=BUOY)
    assert flight.position.tolist() == [[0, 0], [1, 2], [2, 4]]


def test_times_beyond_all_calendars_are_refused(tmp_path):
    times = pa.array([2**60, 2**60 + 1, 2**60 + 2], pa.timestamp("us"))
    still = pa.array([0.0, 1.0, 2.0])
    pq.write_table(pa.table({"time": times, "x": still, "y": still}), tmp_path / "log.parquet")
    with pytest.raises(InputError, match=r"row 0, column time: .* is no ISO time"):
        read_table(tmp_path / "log.parquet")


def test_a_frame_of_pandas_with_times_as_text(tmp_path):
    frame = pd.DataFrame({"Date": ["2012-07-22", "2012-07-23"], "note": list("aa")})
    frame.assign(x=[0.0, 1.0], y=0.0).to_parquet(tmp_path / "log.parquet")
    table = read_table(tmp_path / "log.parquet", Layout.of("time=Date"))
    assert table.columns["time"].tolist() == [0.0, 86400.0]
    assert table.columns["x"].tolist() == [0.0, 1.0]


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
    return fly(sf.CellularFlow(15.43, 4.21), duration=3.0, rate=50.0, seed=7)


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
