"""`sparsefit estimate --scales several`: what a user reads of superposed flows."""

import json

import sparsefit as sf
from sparsefit.cli import main


def written(tmp_path, *parts):
    flow = sf.SuperposedFlow(tuple(sf.CellularFlow(*part) for part in parts))
    vehicle = sf.PointMassVehicle(response_time=0.5, thrust_acceleration=(20.0, 11.3))
    flight = sf.simulate_flight(flow, vehicle, duration=8.0, sample_rate=100.0, seed=3)
    sf.write_flight(flight, tmp_path / "two.csv")
    return str(tmp_path / "two.csv")


def test_every_flow_has_its_line(tmp_path, capsys):
    path = written(tmp_path, (10.0, 3.1), (5.0, 4.4))
    assert main(["estimate", path, "--scales", "several"]) == 0
    lines = capsys.readouterr().out.splitlines()
    (head,) = [i for i, line in enumerate(lines) if line.startswith("cellular flows  2")]
    assert lines[head].split()[3:] == [
        *("U0", "[m/s]", "±", "L_w", "[m]", "±", "tau_w", "[s]", "±", "heading")
    ]
    rows = [lines[head + i].split() for i in (1, 2)]
    assert [row.pop() for row in rows] == ["0.000", "0.000"]  # degrees: along the axes
    assert all(0 < float(spread) < 0.05 for row in rows for spread in row[2::2])
    (place, speed, scale, time), (other, *second) = ([row[0], *row[1::2]] for row in rows)
    assert (place, other) == ("1", "2")
    assert (round(float(speed), 1), round(float(scale), 2), round(float(time), 2)) == (
        10.0,
        3.1,
        0.31,
    )
    assert [round(float(one), 1) for one in second] == [5.0, 4.4, 0.9]


def test_json_lists_them_and_so_does_the_ladder(tmp_path, capsys):
    path = written(tmp_path, (10.0, 3.1), (5.0, 4.4))
    main(["estimate", path, "--scales", "several", "--json"])
    assert len(json.loads(capsys.readouterr().out)["scales"]) == 2
    main(["estimate", path, "--json"])
    scales = json.loads(capsys.readouterr().out)["scales"]
    assert [round(scale["length_scale"], 1) for scale in scales] == [3.1, 4.4]
    main(["estimate", path, "--refine", "variable-projection", "--json"])
    assert json.loads(capsys.readouterr().out)["scales"] == []


def test_an_unknown_number_of_scales_is_refused(tmp_path, capsys):
    path = written(tmp_path, (10.0, 3.1), (5.0, 4.4))
    assert main(["estimate", path, "--scales", "two"]) == 2
    assert "--scales has unknown value 'two' (known: one, several)" in capsys.readouterr().err
