"""An unknown vehicle and a wind on the command line."""

import json

import pytest

from sparsefit.cli import main
from sparsefit.estimator.estimator import Estimator
from sparsefit.model import LengthScaleGrid, Library

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
    value, unit, sign, spread = lines["response time  tau"][:4]
    assert (round(float(value), 6), unit, sign) == (0.5, "s", "±")
    assert 0 < float(spread) < 1e-4
    assert lines["thrust         a"][2:4] == ["m/s^2", "±"]
    thrust = [float(word.strip("(),")) for word in lines["thrust         a"] if word[0] == "("]
    assert thrust[0] == pytest.approx(5.0, abs=1e-4)
    assert "wind" not in lines


def test_json_has_what_was_estimated_and_null_for_the_rest(capsys):
    options = ("--unknown", "wind", "response_time", "--derivative", "weak", "--json")
    found = json.loads(printed(capsys, "windy.csv", *GRID, *options))
    assert found["wind"] == pytest.approx([1.0, -2.0], rel=1e-5)
    assert found["response_time"] == pytest.approx(0.5, rel=1e-5)
    assert found["thrust_acceleration"] is None
    known = found["vehicle_uncertainty"]
    assert known["thrust_acceleration"] is known["thrust_acceleration_intervals"] is None
    low, high = known["response_time_interval"]
    assert low - 1e-6 < 0.5 < high + 1e-6
    for (low, high), wind in zip(known["wind_intervals"], (1, -2), strict=True):
        assert low - 1e-5 < wind < high + 1e-5


def test_an_estimator_file_may_leave_it_unknown(capsys):
    library = Library(LengthScaleGrid(3.0, 6.0, 0.5), unknown=("response_time",))
    with open("estimator.json", "w") as file:
        file.write(Estimator(library=library).to_json())
    out = printed(capsys, "flight.csv", "--estimator", "estimator.json")
    assert "vehicle               thrust (5, 3) m/s^2\n" in out
    assert "response time  tau" in out
    assert "0.5000" in out
    assert "thrust         a" not in out


def test_noise_is_told_with_the_response_time(capsys):
    noisy = ("--velocity-noise", "0.2", "--position-noise", "0.05", "--seed", "3")
    assert main([*SIMULATE, *noisy, "-o", "noisy.csv"]) == 0
    out = printed(capsys, "noisy.csv", *GRID, "--unknown", "response_time", "wind")
    lines = {line[:20].strip(): line[20:].split() for line in out.splitlines()}
    _, unit, sign, spread, _, _, low, _, high = lines["response time  tau"]
    assert (unit, sign) == ("s", "±")
    assert float(high.rstrip(")")) - float(low) == pytest.approx(3.92 * float(spread), abs=2e-4)
    assert lines["wind"][2:4] == ["m/s", "±"]
    assert [float(one.strip("(),")) < 0.5 for one in lines["wind"][4:]] == [True, True]


def test_refuses_what_cannot_be_told(capsys):
    options = ("--unknown", "wind", "thrust_acceleration")
    assert main(["estimate", "flight.csv", *options]) == 2
    assert "cannot both be unknown" in capsys.readouterr().err
