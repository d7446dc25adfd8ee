import dataclasses
import math
import subprocess
import sys
from datetime import datetime
from types import SimpleNamespace

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from sparsefit.errors import InputError
from sparsefit.flight import Flight
from sparsefit.flight.flow import CellularFlow, ShapedCells
from sparsefit.flight.record import SMALLEST_STEP
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.logs import read_flight, write_flight
from tests.problems import VEHICLE, flight_with

FLOW = CellularFlow(15.43, 4.21)
NUMBERS = st.floats(-1e6, 1e6)
POSITIVE = st.floats(1e-6, 1e6)
FLOWS = st.one_of(st.none(), st.builds(CellularFlow, POSITIVE, POSITIVE))


@st.composite
def flights(draw):
    time = sorted(draw(st.sets(st.floats(-1e3, 1e9), min_size=3, max_size=6)))
    assume(min(np.diff(time)) > SMALLEST_STEP)
    plane = st.lists(st.tuples(NUMBERS, NUMBERS), min_size=len(time), max_size=len(time))
    push, drag = draw(st.tuples(NUMBERS, NUMBERS)), draw(st.one_of(st.just(0.0), POSITIVE))
    tau = draw(st.sampled_from([math.inf, 0.5]) if drag else POSITIVE)
    vehicle = PointMassVehicle(tau, push, drag, draw(st.sampled_from([1.0, -1.1])))
    measured, thrust = draw(st.booleans()), draw(st.one_of(st.none(), plane))
    frame = draw(st.sampled_from(["", "ENU", "NED"]))
    return Flight(time, draw(plane), draw(plane), vehicle, draw(FLOWS), measured, thrust, frame)


HEADER = "# response_time=0.5\ntime,x,y,vx,vy\n"
ROWS = "0.0,1,2,3,4\n0.1,1,2,3,4\n0.2,1,2,3,4\n"


@pytest.fixture
def csv_of(tmp_path):
    def write(text):
        path = tmp_path / "flight.csv"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return path

    return write


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
@settings(max_examples=40, deadline=None)
@given(flight=flights())
def test_round_trip_is_exact(tmp_path_factory, suffix, flight):
    path = tmp_path_factory.mktemp("trip") / f"flight{suffix}"
    write_flight(flight, path)
    read = read_flight(path)
    for field in dataclasses.fields(Flight):
        np.testing.assert_array_equal(getattr(read, field.name), getattr(flight, field.name))
    assert [entry.name for entry in path.parent.iterdir()] == [path.name]


def test_csv_is_as_documented(tmp_path):
    write_flight(flight_with(flow=FLOW), tmp_path / "a.csv")
    assert (tmp_path / "a.csv").read_text().splitlines()[:7] == [
        "# response_time=0.5",
        "# thrust_ax=5.0",
        "# thrust_ay=3.0",
        "# mean_velocity=15.43",
        "# length_scale=4.21",
        "time,x,y,vx,vy",
        "0.0,0.0,1.0,0.0,1.0",
    ]


def test_column_order_extra_columns_quotes_comments_and_line_ends_do_not_matter(csv_of):
    text = (
        '\ufeff# logged by hand, gain = 3\r\n# a comment\r\n"vy", vx ,y,x,note,time\r\n'
        '4,3,2,1,"a, b",0.0\r\n#response_time = 0.5 \r\n\r\n4,3,2,1,,0.1\r\n4,3,2,1,c,0.2\r\n'
    )
    flight = read_flight(csv_of(text))
    np.testing.assert_array_equal(flight.time, [0.0, 0.1, 0.2])
    np.testing.assert_array_equal(flight.position[1], [1.0, 2.0])
    np.testing.assert_array_equal(flight.velocity[2], [3.0, 4.0])
    assert flight.vehicle == PointMassVehicle(0.5, (0.0, 0.0))
    assert flight.flow is None


def test_the_vehicle_may_come_from_the_caller_alone(csv_of):
    assert read_flight(csv_of(HEADER + ROWS), vehicle=VEHICLE).vehicle == VEHICLE
    path = csv_of("time,x,y,vx,vy\n" + ROWS)
    assert read_flight(path, vehicle=VEHICLE).vehicle == VEHICLE
    with pytest.raises(InputError, match="no vehicle: no response time; add `# response_time=`"):
        read_flight(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("\n", "no column time, x, y; found nothing"),
        ("# response_time=1\ntime,x,y,vx\n0,1,2,3\n", "no column vy; found time, x, y, vx"),
        ("t,x,y,vx,vy\n" + ROWS, "no column time; found t, .*; rename or add it"),
        ("time;x;y;vx\n", "no column vy; found time, x, y, vx;"),
        ("# drag=0.2\ntime,x,y,vx,vy,ax\n0,0,0,0,0,0\n1,0,0,0,0,0\n", "no column ay"),
        ("time,x,X,vx,vy\n", "no column y"),
        ("time,X (m),X [m],y\n", r"column X \(m\) appears more than once"),
        ("time,x [hand],y\n0,1,2\n", 'unknown unit of x "hand"'),
        (ROWS, "no column .*; found 0.0, 1, 2, 3, 4; rename"),
        ("time;x;y\n0;1.234,5;1\n", "line 2, column x: '1.234,5' is not"),
        (HEADER, "no rows below the header"),
        (HEADER + "0,1,2,3,4\n1,1,2,3,4\n", "at least 3 samples; got 2"),
        (HEADER + "0,1,2,3,4\n1,1,abc,3,4\n", "line 4, column y: 'abc' is not a finite number"),
        (HEADER + "0,1,2,3,4\n\n1,1,2,,4\n", "line 5, column vx: '' is not"),
        (HEADER + "0,1,2,3,nan\n1,1,1,1,\n", "line 3, column vy: 'nan' is not a finite number"),
        (HEADER + "0,1_0,2,3,4\n", "line 3, column x: '1_0' is not"),
        (HEADER + "0,1,2,3\n", "line 3 has 4 cells, the header has 5"),
        (HEADER + ROWS + "0.2,1,2,3,4\n", r"row 3 \(t=0\.2\) follows t=0\.2; sort or drop"),
        ("# respons_time=1\n" + HEADER + ROWS, 'line 1: unknown key .*mean "response_time"'),
        ("# response_time=1\n" + HEADER + ROWS, "line 2: response_time is given twice"),
        ("# thrust_ax=fast\n" + HEADER + ROWS, "line 1, thrust_ax: 'fast' is not a finite"),
        ("# response_time=-1\ntime,x,y,vx,vy\n" + ROWS, "response_time must be .* above 0"),
        ("# length_scale=1\n" + HEADER + ROWS, "the flow has no mean_velocity; add it"),
        ("# frame=NWU\n" + HEADER + ROWS, 'line 1: unknown frame "NWU"'),
        (bytes(range(256)) * 4, "no text in UTF-8"),
        ("\x00\x01\x02" * 50, "no column time, x, y; found"),
        (HEADER + "0,1,2,3," + "4" * 200_000 + "\n", "line 3 is longer than 65536 bytes"),
    ],
)
def test_bad_csv_is_one_line_that_names_the_place(csv_of, text, message):
    path = csv_of(text)
    with pytest.raises(InputError, match=message) as caught:
        read_flight(path)
    assert str(caught.value).startswith(f"{path}: ")


def put(name, *values):
    """The change of a table that these values of a column are."""
    return lambda t: t.set_column(t.column_names.index(name), name, pa.array(values))


NOW = datetime(2024, 6, 1)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: t.drop_columns(["vx"]), "no column vx; found time, x, y, vy"),
        (lambda t: t.append_column("x", t["y"]), "column x appears more than once"),
        (put("x", "1", "2", "three", "4"), "row 2, column x: 'three' is not a finite number"),
        (put("x", 1.0, None, 3.0, 4.0), "row 1, column x: 'nan' is not a finite number"),
        (put("x", NOW, NOW, NOW, NOW), "row 0, column x is of type datetime64"),
        (put("time", NOW, None, NOW, NOW), "row 1, column time: 'NaT' is no ISO time"),
        (put("x", True, True, True, False), "column x is of type bool; it must be a number"),
        (put("time", [1.0], [1.0], [1.0], [1.0]), "column time holds list"),
        (lambda t: put("time", NOW, NOW, NOW, NOW)(t)[:0], "no rows below"),
        (lambda t: t.replace_schema_metadata({"pandas": "{}"}), "no vehicle"),
        (lambda t: t.replace_schema_metadata({"response_time": "a"}), "metadata, response_time"),
    ],
)
def test_bad_parquet_is_named(tmp_path, change, message):
    path = tmp_path / "a.parquet"
    write_flight(flight_with(), path)
    pq.write_table(change(pq.read_table(path)), path)
    with pytest.raises(InputError, match=message):
        read_flight(path)


def test_parquet_of_other_writers(tmp_path):
    path = tmp_path / "a.parquet"
    columns = {name: pa.array([0, 1, 2], pa.int32()) for name in ("vy", "x", "y", "vx", "time")}
    metadata = {"response_time": "0.5", "pandas": "{}", b"\xff": b"\xff"}
    pq.write_table(pa.table({**columns, "note": ["a", "b", "c"]}, metadata=metadata), path)
    assert read_flight(path).vehicle == PointMassVehicle(0.5)


def test_bombs_are_refused_before_they_unpack(tmp_path):
    names = ("long.csv", "ends.csv", "packed.parquet", "shared.parquet")
    long, ends, packed, shared = (tmp_path / name for name in names)
    with long.open("wb") as file:
        file.write(HEADER.encode())
        file.truncate(400_000_000)  # a line of zero bytes, without a byte on the disk
    ends.write_bytes(HEADER.replace("\n", "\r").encode() + b"1\r" * 5_100_000)
    texts = pa.array(["1" * 5_000_000] * 4)
    pq.write_table(pa.table(dict.fromkeys(("time", "x", "y"), texts)), packed)
    rows = pa.DictionaryArray.from_arrays(np.zeros(4_000_000, np.int32), ["1" * 10_000])
    pq.write_table(pa.table(dict.fromkeys(("time", "x", "y"), rows)), shared)  # of 40 GB
    assert packed.stat().st_size + shared.stat().st_size < 10_000_000
    script = f"""
import resource, sys
resource.setrlimit(resource.RLIMIT_DATA, (2**30, 2**30))
import sparsefit as sf
for path in {[str(tmp_path / name) for name in names]}:
    try: sf.read_flight(path)
    except sf.InputError as error: print(error)
"""
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60)
    words = ("is longer than 65536 bytes", "are more than the 5000000", "column time unpacks to 5")
    words += ("column time holds texts of over 64 characters",)
    assert len(run.stdout.splitlines()) == 4, run.stderr
    for line, expected in zip(run.stdout.splitlines(), words, strict=True):
        assert expected in line


@pytest.mark.parametrize("name", ["a.text", "a", "a.csvv", "a.csv.gz"])
def test_unknown_file_type(tmp_path, name):
    known = r"\(known: \.csv, \.parquet, \.txt, .*\.igc\)"
    (tmp_path / name).write_text("junk")
    with pytest.raises(InputError, match=f"unknown file type .*{known}"):
        read_flight(tmp_path / name)
    for unwritten in (name, "a.ulg"):
        with pytest.raises(InputError, match=r"unknown file .*\(known: \.csv, \.parquet\)"):
            write_flight(flight_with(), tmp_path / unwritten)


@pytest.mark.parametrize("content", [b"", b"PAR1", b"junk" * 100, b"PAR1" + b"\0" * 99 + b"PAR1"])
def test_junk_is_not_parquet(tmp_path, content):
    path = tmp_path / "a.parquet"
    write_flight(flight_with(), path)
    path.write_bytes(content or path.read_bytes().replace(b"time", b"\xf1ime"))
    with pytest.raises(InputError, match="not a Parquet file, or a damaged one"):
        read_flight(path)


def test_files_that_are_none(tmp_path):
    for name in ("absent.csv", "absent.parquet", "absent/flight.csv"):
        with pytest.raises(InputError, match=r"cannot read .*No such file.*check the path"):
            read_flight(tmp_path / name)
    (tmp_path / "a.csv").mkdir()
    for folder in (tmp_path, tmp_path / "a.csv"):
        with pytest.raises(InputError, match="it is a folder; give a file in it"):
            read_flight(folder)
    (tmp_path / "b.csv").touch()
    with pytest.raises(InputError, match="it is empty; give another, or write it again"):
        read_flight(tmp_path / "b.csv")


def test_writing_refuses_to_overwrite_unless_told(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("precious")
    with pytest.raises(InputError, match="exists; pass overwrite=True"):
        write_flight(flight_with(), path)
    assert path.read_text() == "precious"
    write_flight(flight_with(), path, overwrite=True)
    assert read_flight(path).samples == 4


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_files_leave_out_flows_of_other_kinds(tmp_path, suffix):
    path = tmp_path / f"flight.{suffix}"
    for flow in (ShapedCells(6.0, 4.0), SimpleNamespace(velocity=FLOW.velocity)):
        write_flight(flight_with(flow=flow), path, overwrite=True)
        assert read_flight(path).flow is None
