"""The flights of a study: drawn, with a vehicle that is believed, together, or logged."""

import math
from dataclasses import replace

import numpy as np
import pytest

import sparsefit as sf
from sparsefit.errors import InputError
from sparsefit.flight.flow import CellularFlow
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.study.draw import Draw, stream
from sparsefit.study.flight_desk import FlightDesk, fly
from sparsefit.study.keys import FlightWords
from sparsefit.study.study import Study
from tests.problems import VEHICLE
from tests.study.small_study import small_study

VALUES = {"mean_velocity": 8.0, "length_scale": 4.0, "duration": 2.0, "sample_rate": 50.0}
PUSH = {"thrust_x": 5.0, "thrust_y": 3.0}
QUADRATIC = VALUES | PUSH | {"drag": 0.3}
TURNING = VALUES | PUSH | {"response_time": 0.5, "thrust_turn": 6.0, "thrust_period": 4.0}


def believed(values, **told):
    draw = Draw(values, **told)
    return draw, draw.fly(stream(1, 0, 0))


@pytest.mark.parametrize(
    ("told", "vehicle"),
    [
        ({}, PointMassVehicle(math.inf, (5.0, 3.0), 0.3)),
        ({"believed_drag_ratio": 2.0}, PointMassVehicle(math.inf, (5.0, 3.0), 0.6)),
        ({"believed_response_time": 0.5}, PointMassVehicle(0.5, (5.0, 3.0))),
        (
            {"believed_response_time": 0.5, "believed_thrust_ratio": 2.0},
            PointMassVehicle(0.5, (10.0, 6.0)),
        ),
    ],
)
def test_the_law_of_drag_that_is_told(told, vehicle):
    draw, flight = believed(QUADRATIC | told)
    assert draw.vehicle == PointMassVehicle(math.inf, (5.0, 3.0), 0.3)
    assert flight.vehicle == vehicle
    np.testing.assert_array_equal(flight.velocity, believed(QUADRATIC)[1].velocity)


def test_a_thrust_that_turns_is_measured_or_not():
    _, flight = believed(TURNING)
    turn = 2 * np.pi * flight.time / 4.0
    circle = 6.0 * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    np.testing.assert_allclose(flight.thrust, np.add(circle, (5.0, 3.0)), atol=1e-12)
    assert flight.vehicle == PointMassVehicle(0.5)
    scaled = believed(TURNING | {"believed_thrust_ratio": 1.2})[1].vehicle
    assert scaled == PointMassVehicle(0.5, thrust_scale=1.2)
    _, blind = believed(TURNING, words=FlightWords(thrust_log="none"))
    assert blind.thrust is None
    assert blind.vehicle == PointMassVehicle(0.5, (5.0, 3.0))
    np.testing.assert_array_equal(blind.velocity, flight.velocity)


def together(tmp_path, more="", rest=""):
    text = small_study("together", count=2, seed=5, duration=2.0)
    text = text.replace("[library]", f"process_noise = 1.0\n{more}\n[library]")
    path = tmp_path / "together.toml"
    path.write_text(f'{text}[[backends]]\nname = "best-scale"\n{rest}')
    return Study.from_file(path)


def test_more_flights_hold_the_fewer_and_are_bounded_together(tmp_path):
    swept = together(tmp_path, rest='[sweep]\n"flights.together" = [1.0, 3.0]')
    rules = [cell.setup.flights for cell in swept.planned.points]
    both = [fly(swept.planned, 1, each) for each in rules]
    (one, least), (three, less) = ((flown.fleet, flown.bounds) for flown in both)
    assert (len(one), len(three)) == (1, 3)
    np.testing.assert_array_equal(one[0].position, three[0].position)
    assert len({flight.position[0, 0] for flight in three}) == 3
    assert all(flight.flow is None for flight in three)
    assert less["length_scale"] < least["length_scale"]


def test_the_bound_is_no_less_than_that_of_known_phases(tmp_path):
    swept = together(tmp_path, rest='[sweep]\n"flights.together" = [1.0, 3.0]')
    cell = swept.planned.points[0]
    flown, draw = fly(swept.planned, 1, cell.setup.flights), cell.setup.flights.draw(1, 2, 5)
    flow, steps = draw.flow, ((1e-6, 0.0), (0.0, 1e-6))

    def velocity(h, g):
        moved = CellularFlow(flow.mean_velocity + h, flow.length_scale + g)
        return moved.velocity(*flown.fleet[0].position.T).ravel()

    rows = [(velocity(h, g) - velocity(-h, -g)) / 2e-6 for h, g in steps]
    known = draw.vehicle.response_time * np.sqrt(np.diag(np.linalg.inv(rows @ np.transpose(rows))))
    bounds = flown.bounds
    assert known[0] <= bounds["mean_velocity"] < 1.5 * known[0]
    assert known[1] <= bounds["length_scale"] < 5.0 * known[1]


def test_a_case_of_one_flight_is_what_it_was_and_others_are_others(tmp_path):
    plain, two, three = (
        together(tmp_path, more).plan()["case_id"][0]
        for more in ("", "together = 2", "together = 3")
    )
    assert len({plain, two, three}) == 3


LOGGED = """
name = "logged"
question = "What were these flights through?"
seed = 0

[flights]
files = ["*.csv"]
windows = [4.0, 10.0]

[library]
lower = 2.0
upper = 8.0
step = 1.0

[[backends]]
name = "group-lasso"
"""


@pytest.fixture(scope="module")
def flight():
    flow = sf.CellularFlow(12.0, 4.0)
    return sf.simulate_flight(flow, VEHICLE, duration=10.0, sample_rate=50.0, seed=5)


@pytest.fixture
def folder(tmp_path, flight):
    sf.write_flight(replace(flight, flow=None), tmp_path / "a.csv")
    positions = sf.Flight.from_positions(flight.time + 3.0, flight.position, VEHICLE)
    sf.write_flight(positions, tmp_path / "b.csv")
    return tmp_path


def load_logs(folder, text=LOGGED):
    (folder / "study.toml").write_text(text)
    return Study.from_file(folder / "study.toml")


def test_every_log_is_cut_into_whole_pieces_of_each_length(folder, flight):
    study = load_logs(folder)
    rules = study.planned.points[0].setup.flights
    draws = [rules.draw(number, 6, 0) for number in range(6)]
    labels = [draw.label for draw in draws]
    assert labels == [
        "a.csv 0-3.99 s", "a.csv 4-7.99 s", "a.csv 0-9.99 s",
        "b.csv 3-6.99 s", "b.csv 7-10.99 s", "b.csv 3-12.99 s",
    ]  # fmt: skip
    ((second,), (last,)) = (draws[number].fleet(np.random.SeedSequence(0)) for number in (1, 5))
    assert second.time[0] == 0.0
    assert second.vehicle == VEHICLE
    np.testing.assert_array_equal(second.position, flight.position[200:400])
    assert second.velocity_measured
    assert not last.velocity_measured


def test_cases_of_logs_have_an_estimate_and_no_error(folder):
    study = load_logs(folder)
    desk = FlightDesk(study.planned)
    (row,) = desk.cases(2, [0])["rows"]
    assert study.planned.truth(2, 0) == {"flow": "unknown", "log": "a.csv 0-9.99 s"}
    assert row[1] == "ok"
    assert row[3]["est_length_scale"] == pytest.approx(4.0, rel=1e-3)


def test_a_log_that_changes_leaves_the_cases_of_the_others(folder, flight):
    first = load_logs(folder)
    shorter = sf.Flight(flight.time[:-1], flight.position[:-1], flight.velocity[:-1], VEHICLE)
    sf.write_flight(shorter, folder / "a.csv", overwrite=True)
    (folder / "b.csv").rename(folder / "0.csv")
    later = load_logs(folder)
    assert later.hash != first.hash
    assert later.planned.case_ids[:3] == first.planned.case_ids[3:]
    assert not set(later.planned.case_ids[3:]) & set(first.planned.case_ids)
    assert later.plan()["log"][0] == "0.csv 3-6.99 s"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"*.csv"', '"*.parquet"', r'"\*.parquet" matches no file beside study.toml'),
        ('"*.csv"', '"a.csv", "*.csv"', "each of them once"),
        ('"*.csv"', '"c.csv"', "c.csv"),
        ("[4.0, 10.0]", "[40.0]", "longer than every log"),
        ("[4.0, 10.0]", "[0.0]", "must be above 0"),
        ("windows", "count", "count"),
        ("windows", "window", "windows"),
        ("windows = [4.0, 10.0]", "duration = 3.0", "duration"),
    ],
)
def test_bad_logs_are_refused_by_key(folder, old, new, message):
    with pytest.raises(InputError, match=message):
        load_logs(folder, LOGGED.replace(old, new))


def test_on_board_candidates_are_flown_and_the_others_refused(tmp_path):
    peak = '[[protocols]]\nname = "rms"\n[[protocols]]\nname = "paper"\n'
    study = together(tmp_path, rest=peak + '"readout.mean_velocity" = "paper"')
    assert study.plan()["title"].unique().tolist() == ["rms", "paper"]
    assert list(study.refusals) == ["paper"]
    assert "U0 is the rms" in study.refusals["paper"]
    flown = study.flown()
    assert flown.folder == study.folder / "on-board"
    assert flown.plan()["title"].tolist() == ["rms"] * 2
    assert not set(flown.plan()["case_id"]) & set(study.plan()["case_id"])
    (row,) = FlightDesk(flown.planned).cases(0, [0])["rows"]
    assert row[1] == "unidentifiable"  # two seconds are few for a board
    alone = together(tmp_path, rest='[readout]\nmean_velocity = "paper"')
    with pytest.raises(InputError, match="no candidate can fly"):
        _ = alone.refusals
