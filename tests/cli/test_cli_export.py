"""`sparsefit export`: what it writes, and what it refuses on one line."""

import json
import shutil
import subprocess

import pytest

import sparsefit as sf
from sparsefit.cli import main
from sparsefit.onboard import c_source
from tests.cli import verbs
from tests.problems import fly

GRID = sf.model.LengthScaleGrid(2.0, 8.0)


@pytest.fixture
def saved(tmp_path):
    estimator = sf.Estimator(backend="lasso", library=sf.Library(grid=GRID))
    path = tmp_path / "estimator.json"
    path.write_text(estimator.to_json())
    return path


@pytest.fixture
def quick(monkeypatch):
    """A reference that costs nothing."""
    monkeypatch.setattr(c_source, "reference", lambda estimator, flight: "sample\n1\n")


def refused(capsys, *arguments):
    return verbs.refused(capsys, "export", *arguments)


def test_an_export_is_a_folder_that_builds_and_replays(saved, tmp_path, capsys):
    flight = fly(sf.CellularFlow(15.43, 4.21), duration=3.0, rate=50.0, seed=1)
    sf.write_flight(flight, tmp_path / "flight.csv")
    folder = tmp_path / "flow"
    given = ["--c", str(folder), "--float", "--flight", str(tmp_path / "flight.csv")]
    assert main(["export", str(saved), *given]) == 0
    out = capsys.readouterr().out
    assert "RAM    " in out
    assert "assumed, not measured" in out
    written = {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}
    assert written == {
        *("sf_flow.h", "sf_flow.c", "CMakeLists.txt", "README.md"),
        *("test/replay.c", "test/flight.csv", "test/reference.csv"),
    }
    assert "from estimator.json" in (folder / "sf_flow.h").read_text()
    assert (folder / "test/flight.csv").read_text() == (tmp_path / "flight.csv").read_text()
    assert (folder / "test/reference.csv").read_text().splitlines()[-1].startswith("150,")
    if shutil.which("cc"):
        command = ["cc", "-std=c99", "-I.", "sf_flow.c", "test/replay.c", "-lm", "-o", "replay"]
        subprocess.run(command, cwd=folder, check=True)
        replay = ["./replay", "test/flight.csv", "test/reference.csv", "1e-5"]
        subprocess.run(replay, cwd=folder, check=True, capture_output=True)


def test_what_is_in_the_way_is_not_overwritten(saved, tmp_path, quick, capsys):
    folder = tmp_path / "flow"
    folder.mkdir()
    (folder / "mine.txt").write_text("mine")
    assert "is not empty; add --force" in refused(capsys, saved, "--c", folder)
    assert "is a file" in refused(capsys, saved, "--c", saved)
    assert main(["export", str(saved), "--c", str(folder), "--force"]) == 0
    assert (folder / "mine.txt").read_text() == "mine"


def test_all_causes_and_remedies_are_told_at_once(tmp_path, capsys):
    path = tmp_path / "odd.json"
    library = sf.Library(unknown=("response_time",), grid=sf.model.LengthScaleGrid(1.0, 30.0))
    path.write_text(sf.Estimator(library=library, readout=sf.Readout(scales="several")).to_json())
    line = refused(capsys, path, "--c", tmp_path / "flow")
    for words in ("the vehicle is known", "use scales 'one'", "wider than 16 times"):
        assert words in line
    assert not list((tmp_path / "flow").glob("*"))


def test_odd_files_and_options_are_refused(saved, tmp_path, capsys):
    path, record = tmp_path / "odd.json", json.loads(saved.read_text())
    path.write_text(json.dumps(record | {"format": "sparsefit-estimator/2"}))
    assert "update sparsefit" in refused(capsys, path, "--c", tmp_path / "flow")
    assert "name of the folder" in refused(capsys, saved, "--c", "", "--force")


def test_the_name_of_a_file_cannot_leave_its_comment(saved, tmp_path, quick):
    odd = tmp_path / "x *" / "int y;.json"
    odd.parent.mkdir()
    shutil.copy(saved, odd)
    assert main(["export", str(odd), "--c", str(tmp_path / "flow")]) == 0
    assert "*/ int" not in (tmp_path / "flow/sf_flow.h").read_text()
