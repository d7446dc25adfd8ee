"""`sparsefit export`: what it writes, and what it refuses on one line."""

import json
import shutil
import subprocess

import pytest

import sparsefit as sf
from sparsefit import backends
from sparsefit.cli import main
from sparsefit.export import measure

GRID = sf.LengthScaleGrid(2.0, 8.0, count=8, spacing="wavenumber")
CHANGES = ("--derivative", "savgol", "--refine", "none")


@pytest.fixture
def saved(tmp_path):
    estimator = sf.Estimator(backend="best-scale", library=sf.Library(grid=GRID))
    path = tmp_path / "estimator.json"
    path.write_text(estimator.to_json())
    return path


@pytest.fixture
def unmeasured(monkeypatch):
    """As where there is no compiler, which takes half a second to ask."""
    monkeypatch.setattr(measure, "footprint", lambda files, compiler: None)


def refused(capsys, *arguments):
    """The one line on which an export is refused."""
    assert main(["export", *map(str, arguments)]) == 2
    out, err = capsys.readouterr()
    assert not out
    assert err.count("\n") == 1
    return err


def test_an_export_is_a_folder_that_builds_and_replays(saved, tmp_path, capsys):
    folder = tmp_path / "flow"
    assert main(["export", str(saved), "--c", str(folder), "--float", *CHANGES]) == 0
    out = capsys.readouterr().out
    assert "RAM    " in out
    assert "assumed, not measured" in out
    written = {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}
    assert written == {
        *("sf_flow.h", "sf_flow.c", "CMakeLists.txt", "README.md"),
        *("test/replay.c", "test/flight.csv", "test/reference.csv"),
    }
    assert "from: estimator.json" in (folder / "sf_flow.h").read_text()
    if shutil.which("cc"):
        command = ["cc", "-std=c99", "-I.", "sf_flow.c", "test/replay.c", "-lm", "-o", "replay"]
        subprocess.run(command, cwd=folder, check=True)
        replay = ["./replay", "test/flight.csv", "test/reference.csv", "1e-5"]
        subprocess.run(replay, cwd=folder, check=True, capture_output=True)


@pytest.mark.slow
@pytest.mark.skipif(
    not shutil.which("cmake") or not shutil.which("cc"), reason="no CMake, or no cc"
)
def test_cmake_builds_and_tests_an_export(saved, tmp_path):
    folder = tmp_path / "flow"
    assert main(["export", str(saved), "--c", str(folder), *CHANGES]) == 0
    for command in ("cmake -B build", "cmake --build build", "ctest --test-dir build"):
        subprocess.run(command.split(), cwd=folder, check=True, capture_output=True)


def test_a_recorded_flight_is_replayed(saved, tmp_path, unmeasured, capsys):
    flight = sf.simulate_flight(
        sf.CellularFlow(mean_velocity=15.43, length_scale=4.21),
        sf.PointMassVehicle(0.5, (5.0, 3.0)), duration=3.0, sample_rate=50.0, seed=1,
    )  # fmt: skip
    sf.write_flight(flight, tmp_path / "flight.csv")
    folder = tmp_path / "flow"
    arguments = ["--c", folder, *CHANGES, "--flight", tmp_path / "flight.csv"]
    assert main(["export", str(saved), *map(str, arguments)]) == 0
    assert (folder / "test/flight.csv").read_text() == (tmp_path / "flight.csv").read_text()
    last = (folder / "test/reference.csv").read_text().splitlines()[-1]
    assert last.startswith("150,")
    assert "flash  not measured" in capsys.readouterr().out


def test_the_remedies_make_an_estimator_that_can_run(tmp_path, unmeasured, capsys):
    path = tmp_path / "default.json"
    path.write_text(sf.Estimator().to_json())
    remedies = ["--backend", "best-scale", "--derivative", "central", "--refine", "none"]
    assert main(["export", str(path), "--c", str(tmp_path / "flow"), *remedies]) == 0
    assert "best-scale, 56 scales, 1 to 12 m, double" in capsys.readouterr().out


def test_what_is_in_the_way_is_not_overwritten(saved, tmp_path, unmeasured, capsys):
    folder = tmp_path / "flow"
    folder.mkdir()
    (folder / "mine.txt").write_text("mine")
    assert "is not empty; add --force" in refused(capsys, saved, "--c", folder, *CHANGES)
    assert "is a file" in refused(capsys, saved, "--c", saved, *CHANGES)
    assert main(["export", str(saved), "--c", str(folder), *CHANGES, "--force"]) == 0
    assert (folder / "mine.txt").read_text() == "mine"


def test_all_causes_and_remedies_are_told_at_once(tmp_path, capsys):
    path = tmp_path / "default.json"
    path.write_text(sf.Estimator().to_json())
    told = refused(capsys, path, "--c", tmp_path / "flow")
    for words in (
        "'group-lasso' has no solver of bounded work here",
        "(use --backend best-scale or stlsq or lasso)",
        "derivative 'auto' needs the whole flight (use --derivative savgol",
        "refine 'ladder' needs all rows (use --refine",
        "correction 'first-order' needs all rows (use --correction none)",
    ):
        assert words in told
    assert not (tmp_path / "flow").exists()


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"backend": backends.get("lasso", alpha_fraction="auto")}, "give a number"),
        ({"backend": backends.get("stlsq", mode="pysindy")}, "use 'scaled'"),
        ({"backend": backends.get("best-scale", rcond=0.1)}, "leave rcond out"),
        ({"library": sf.Library(family="stream", grid=GRID)}, "use 'cells'"),
        ({"library": sf.Library(target="acceleration", grid=GRID)}, "use 'flow-velocity'"),
        ({"library": sf.Library(unknown=("response_time",), grid=GRID)}, "the vehicle is known"),
        ({"library": sf.Library(grid=sf.LengthScaleGrid(spacing="flight"))}, "--extent"),
        ({"readout": sf.Readout(scales="several")}, "use scales 'one'"),
        ({"readout": sf.Readout(mean_velocity="peak")}, "use 'rms'"),
        ({"derivative": sf.Derivative("weak")}, "--derivative savgol"),
    ],
)
def test_what_cannot_run_on_board_says_why_and_what_can(settings, words, tmp_path, capsys):
    parts = {"backend": "best-scale", "library": sf.Library(grid=GRID)} | settings
    path = tmp_path / "estimator.json"
    path.write_text(sf.Estimator(**parts).to_json())
    assert words in refused(capsys, path, "--c", tmp_path / "flow")


def test_odd_files_and_options_are_refused(saved, tmp_path, capsys):
    record = json.loads(saved.read_text())
    path = tmp_path / "odd.json"
    for change, words in (
        ({"format": "sparsefit-estimator/2"}, "update sparsefit"),
        ({"library": {"grid": {"lower": float("nan")}}}, "is nan"),
        ({"backend": {"name": "../../etc/passwd"}}, "no path"),
        ({"backend": {"name": "*/ int x; /*"}}, "no path"),
    ):
        path.write_text(json.dumps(record | change))
        assert words in refused(capsys, path, "--c", tmp_path / "flow", *CHANGES)
    folder = ("--c", tmp_path / "flow")
    assert "no such program" in refused(capsys, saved, *folder, *CHANGES, "--compiler", "ccc-no")
    assert "at most" in refused(capsys, saved, *folder, *CHANGES, "--ram", "5000")
    assert "spacing 'flight'" in refused(capsys, saved, *folder, *CHANGES, "--extent", "60")
    assert "name of the folder" in refused(capsys, saved, "--c", "", *CHANGES, "--force")
    assert "odd integer" in refused(capsys, saved, *folder, *CHANGES, "--window", "4")
    grid = sf.LengthScaleGrid(2.0, 8.0, spacing="flight")
    path.write_text(sf.Estimator(backend="best-scale", library=sf.Library(grid=grid)).to_json())
    for extent in ("nan", "-3", "0"):
        assert "above 0" in refused(capsys, path, *folder, *CHANGES, "--extent", extent)
    assert "2048" in refused(capsys, path, *folder, *CHANGES, "--extent", "1e9")
    stlsq = sf.Estimator(backend="stlsq", library=sf.Library(grid=GRID))
    path.write_text(stlsq.to_json())
    assert "use --double" in refused(capsys, path, *folder, *CHANGES, "--float")
    assert not (tmp_path / "flow").exists()


def test_the_name_of_a_file_cannot_leave_its_comment(saved, tmp_path, unmeasured):
    path = tmp_path / "x *" / "int y;"
    path.parent.mkdir()
    odd = path.with_name("a*\\ int x;.json")
    shutil.copy(saved, odd)
    assert main(["export", str(odd), "--c", str(tmp_path / "flow"), *CHANGES]) == 0
    assert "from: a*/ int" not in (tmp_path / "flow/sf_flow.h").read_text()
