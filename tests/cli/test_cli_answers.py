"""Answers of `sparsefit estimate` beside one flow: superposed flows, an unknown vehicle, a wind."""

import json
import re

import pytest

import sparsefit as sf
from sparsefit.cli import main
from tests.cli import verbs

SIMULATE = ("simulate", "--mean-velocity", "15", "--length-scale", "4.2", "--duration", "8")
NOISE = ("--velocity-noise", "0.2", "--position-noise", "0.05", "--seed", "3")
GRID = ("--grid-lower", "3", "--grid-upper", "6", "--grid-step", "0.5")


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    """A flight, one in a wind, one with noise, one without a vehicle, and one through two flows."""
    folder = tmp_path_factory.mktemp("logs")
    for name, options in (("flight", ()), ("windy", ("--wind", "1", "-2")), ("noisy", NOISE)):
        assert main([*SIMULATE, *options, "-o", str(folder / f"{name}.csv")]) == 0
    lines = (folder / "flight.csv").read_text().splitlines(keepends=True)
    (folder / "bare.csv").write_text("".join(line for line in lines if line[0] != "#"))
    flow = sf.flows.SuperposedFlow((sf.CellularFlow(10.0, 3.1), sf.CellularFlow(5.0, 4.4)))
    vehicle = sf.PointMassVehicle(response_time=0.5, thrust_acceleration=(20.0, 11.3))
    flight = sf.simulate_flight(flow, vehicle, duration=8.0, sample_rate=100.0, seed=3)
    sf.write_flight(flight, folder / "two.csv")
    return folder


@pytest.fixture(autouse=True)
def in_their_folder(logs, monkeypatch):
    monkeypatch.chdir(logs)


def printed(capsys, *argv):
    code, out, _ = verbs.run(capsys, "estimate", *argv)
    assert code == 0
    return out


def columns(out):
    return {line[:20].strip(): line[20:].split() for line in out.splitlines()}


def test_no_vehicle_is_needed_where_it_is_unknown(capsys):
    out = printed(capsys, "bare.csv", *GRID, "--unknown", "response_time", "thrust_acceleration")
    lines = columns(out)
    assert lines["vehicle"] == ["unknown"]
    value, unit, sign, spread = lines["response time"][:4]
    assert (round(float(value), 6), unit, sign) == (0.5, "s", "±")
    assert 0 < float(spread) < 1e-4
    assert lines["thrust acceleration"][2:4] == ["m/s^2", "±"]
    thrust = [float(word.strip("(),")) for word in lines["thrust acceleration"] if word[0] == "("]
    assert thrust[0] == pytest.approx(5.0, abs=1e-4)
    assert "wind" not in lines


def test_json_has_what_was_estimated_and_null_for_the_rest(capsys):
    options = ("--unknown", "wind", "response_time", "--set", "derivative.method=weak", "--json")
    record = json.loads(printed(capsys, "windy.csv", *GRID, *options))
    assert record["wind"] == pytest.approx([1.0, -2.0], rel=1e-5)
    assert record["response_time"] == pytest.approx(0.5, rel=1e-5)
    assert record["thrust_acceleration"] is None
    spread = record["vehicle_uncertainty"]
    assert spread["thrust_acceleration"] is spread["thrust_acceleration_intervals"] is None
    low, high = spread["response_time_interval"]
    assert low - 1e-6 < 0.5 < high + 1e-6
    for (low, high), wind in zip(spread["wind_intervals"], (1, -2), strict=True):
        assert low - 1e-5 < wind < high + 1e-5


def test_noise_is_told_with_the_response_time(capsys):
    lines = columns(printed(capsys, "noisy.csv", *GRID, "--unknown", "response_time", "wind"))
    _, unit, sign, spread, _, _, low, _, high = lines["response time"]
    assert (unit, sign) == ("s", "±")
    assert lines["vehicle"] == ["thrust", "(5,", "3)", "m/s^2"]
    assert "thrust acceleration" not in lines
    assert float(high.rstrip(")")) - float(low) == pytest.approx(3.92 * float(spread), abs=2e-4)
    assert lines["wind"][2:4] == ["m/s", "±"]
    assert [float(word.strip("(),")) < 0.5 for word in lines["wind"][4:]] == [True, True]


def test_every_flow_has_its_line(capsys):
    lines = printed(capsys, "two.csv", "--set", "readout.scales=several").splitlines()
    rows = [re.split(" +", line, maxsplit=4)[4] for line in lines if line.startswith("flow ")]
    for row, expected in zip(rows, ([10.0, 3.1, 0.31], [5.0, 4.4, 0.88]), strict=True):
        *parts, heading = row.split(", ")
        assert heading == "heading 0.000 degrees"
        assert [part.split()[0] for part in parts] == ["U0", "L_w", "tau_w"]
        assert [float(part.split()[1]) for part in parts] == pytest.approx(expected, rel=0.01)
        assert all(0 < float(part.split(" ± ")[1]) < 0.05 for part in parts)


@pytest.mark.parametrize(
    ("options", "sizes"), [((), [3.1, 4.4]), (("--set", "readout.refine=variable-projection"), [])]
)
def test_json_lists_the_flows_that_the_ladder_finds(capsys, options, sizes):
    out = verbs.run(capsys, "estimate", "two.csv", *options, "--json")[1]
    scales = json.loads(out)["scales"]
    assert [round(scale["length_scale"], 1) for scale in scales] == sizes
