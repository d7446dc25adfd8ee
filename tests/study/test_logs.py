"""A study of flights that were flown: cut into pieces, read in every process, known by content."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import sparsefit as sf
from sparsefit.errors import InputError
from sparsefit.study import Study
from sparsefit.study.run.execution import run_flight
from sparsefit.study.run.outcome import Outcome
from sparsefit.study.run.store import cases_table

TEXT = """
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
VEHICLE = sf.PointMassVehicle(0.5, (5.0, 3.0))


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


def load(folder: Path, text: str = TEXT) -> Study:
    (folder / "study.toml").write_text(text)
    return Study.load(folder / "study.toml")


def test_every_log_is_cut_into_whole_pieces_of_each_length(folder, flight):
    study = load(folder)
    cell = study.cells[0]
    labels = [study.draw(number, cell).piece.label for number in range(study.count)]
    assert labels == [
        "a.csv 0-3.99 s", "a.csv 4-7.99 s", "a.csv 0-9.99 s",
        "b.csv 3-6.99 s", "b.csv 7-10.99 s", "b.csv 3-12.99 s",
    ]  # fmt: skip
    second, last = (study.draw(number, cell).fly(np.random.SeedSequence(0)) for number in (1, 5))
    assert second.time[0] == 0.0
    assert second.vehicle == VEHICLE
    np.testing.assert_array_equal(second.position, flight.position[200:400])
    assert second.velocity_measured
    assert not last.velocity_measured


def test_cases_of_logs_have_an_estimate_and_no_error(folder):
    study = load(folder)
    outcomes = [one for one in run_flight(study, 2, study.cells) if isinstance(one, Outcome)]
    (row,) = cases_table(study, outcomes).to_pandas().to_dict("records")
    assert (row["status"], row["flow"], row["log"]) == ("ok", "unknown", "a.csv 0-9.99 s")
    assert row["est_length_scale"] == pytest.approx(4.0, rel=1e-3)
    assert np.isnan(row["true_length_scale"])


def test_a_log_that_changes_is_another_study(folder, flight):
    first = load(folder)
    shorter = sf.Flight(flight.time[:-1], flight.position[:-1], flight.velocity[:-1], VEHICLE)
    sf.write_flight(shorter, folder / "a.csv", overwrite=True)
    assert load(folder).hash != first.hash


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"*.csv"', '"*.parquet"', r'"\*.parquet" matches no file beside study.toml'),
        ('"*.csv"', '"a.csv", "*.csv"', "name a file twice"),
        ('"*.csv"', '"c.csv"', "c.csv"),
        ("[4.0, 10.0]", "[40.0]", "longer than every log"),
        ("[4.0, 10.0]", "[0.0]", "must be above 0"),
        ("windows", "count", "count"),
        ("windows", "window", "windows"),
        ("windows = [4.0, 10.0]", "thrust_acceleration = [1.0, 0.0]", "response_time.*missing"),
        ("windows = [4.0, 10.0]", "duration = 3.0", "duration"),
    ],
)
def test_bad_logs_are_refused_by_key(folder, old, new, message):
    with pytest.raises(InputError, match=message) as caught:
        load(folder, TEXT.replace(old, new))
    assert "\n" not in str(caught.value)


def test_flights_of_unknown_flows_are_neither_silent_misses_nor_false_alarms():
    from sparsefit.study.evidence.measures import MEASURES

    cases = pd.DataFrame({"flow": ["unknown", "unknown"], "status": ["ok", "misfit"]})
    for parameter in ("mean_velocity", "length_scale", "timescale"):
        cases[f"true_{parameter}"], cases[f"est_{parameter}"] = np.nan, 1.0
    for name in ("silent-misses", "false-alarms", "off", "misfits"):
        assert np.isnan(MEASURES[name].read(cases)).all()
    np.testing.assert_array_equal(MEASURES["called-misfit"].read(cases), [0.0, 1.0])
