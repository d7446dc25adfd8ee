"""An unknown vehicle and a wind on the command line."""

import json

import pytest

from sparsefit.cli import main
from sparsefit.estimator import Estimator
from sparsefit.library import LengthScaleGrid, Library

SIMULATE = ("simulate", "--mean-velocity", "15", "--length-scale", "4.2", "--duration", "8")
GRID = ("--grid-lower", "3", "--grid-upper", "6", "--grid-step", "0.5")


@pytest.fixture(autouse=True)
def in_empty_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main([*SIMULATE, "-o", "flight.csv"]) == 0
    assert main([*SIMULATE, "--wind", "1", "-2", "-o", "windy.csv"]) == 0
    with open("flight.csv") as file:
        bare = [line for line in file if not line.startswith("#")]
    with open("bare.csv", "w") as file:
        file.writelines(bare)


def printed(capsys, *argv):
    capsys.readouterr()
    assert main(["estimate", *argv]) == 0
    return capsys.readouterr().out


def test_no_vehicle_is_needed_where_it_is_unknown(capsys):
    out = printed(capsys, "bare.csv", *GRID, "--unknown", "response_time", "thrust_acceleration")
    lines = {line[:20].strip(): line[20:].split() for line in out.splitlines()}
    assert lines["vehicle"] == ["unknown"]
    assert lines["response time  tau"] == ["0.5000", "s"]
    assert lines["thrust         a"] == ["(5.0000,", "3.0000)", "m/s^2"]
    assert "wind" not in lines


def test_json_has_what_was_estimated_and_null_for_the_rest(capsys):
    options = ("--unknown", "wind", "response_time", "--derivative", "weak", "--json")
    found = json.loads(printed(capsys, "windy.csv", *GRID, *options))
    assert found["wind"] == pytest.approx([1.0, -2.0], rel=1e-5)
    assert found["response_time"] == pytest.approx(0.5, rel=1e-5)
    assert found["thrust_acceleration"] is None


def test_an_estimator_file_may_leave_it_unknown(capsys):
    library = Library(LengthScaleGrid(3.0, 6.0, 0.5), unknown=("response_time",))
    with open("estimator.json", "w") as file:
        file.write(Estimator(library=library).to_json())
    out = printed(capsys, "flight.csv", "--estimator", "estimator.json")
    assert "vehicle               thrust (5, 3) m/s^2\n" in out
    assert "response time  tau       0.5000 s\n" in out


def test_refuses_what_cannot_be_told(capsys):
    options = ("--unknown", "wind", "thrust_acceleration")
    assert main(["estimate", "flight.csv", *options]) == 2
    assert "cannot both be unknown" in capsys.readouterr().err
