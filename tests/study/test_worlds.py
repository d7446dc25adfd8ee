"""Flows and logs as they are, asked for in a study file: what each key makes of a flight."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from sparsefit.errors import InputError
from sparsefit.flight.faults import LogFaults
from sparsefit.flight.flow import CellularFlow, ShapedCells, SuperposedFlow
from sparsefit.flight.turbulence import Turbulence
from sparsefit.study import Study, cells
from sparsefit.study.evidence.measure import Share
from sparsefit.study.evidence.measures import MEASURES
from sparsefit.study.run.columns import COLUMNS, Planned
from sparsefit.study.run.execution import run_flight
from sparsefit.study.run.outcome import Outcome
from sparsefit.study.spec.draw import SIMULATION, Draw, stream
from sparsefit.study.spec.plan import Case

HEAD = """
name = "w"
question = "?"
seed = 5
[flights]
count = 3
mean_velocity = { uniform = [8.0, 12.0] }
length_scale = 4.0
response_time = 0.5
duration = 1.0
sample_rate = 50.0
velocity_noise = 0.1
"""
REST = '[[backends]]\nname = "best-scale"\n'


def load(tmp_path: Path, text: str, head: str = HEAD) -> Study:
    path = tmp_path / "w.toml"
    path.write_text(head + text + "\n" + REST, encoding="utf-8")
    return Study.load(path)


def draw(tmp_path: Path, text: str = "", flight: int = 1) -> Draw:
    return cells(load(tmp_path, text))[0].setup.flights.draw(flight, 3, 5)


EVERYTHING = """
heading = { uniform = [-0.7, 0.7] }
aspect = 1.2
angle = 1.4
offset = [0.5, { uniform = [0.0, 1.0] }]
drift_ratio = 0.1
drift_direction = { uniform = [0.0, 6.28] }
swell = 0.2
swell_period = 30.0
swell_phase = { uniform = [0.0, 6.28] }
wind_ratio = 0.05
wind_direction = 1.5707963267948966
turbulence_ratio = 0.1
turbulence_length = 8.0
turbulence_memory = 2.0
turbulence_spectrum = "von-karman"
time_jitter = 0.3
position_wander = 0.2
position_wander_time = 4.0
outliers = 0.01
outlier_size = 6.0
jumps = 2
jump_size = 3.0
gaps = 2
gap_duration = 0.2
"""


def test_every_key_arrives(tmp_path: Path) -> None:
    plain, drawn = draw(tmp_path), draw(tmp_path, EVERYTHING)
    assert isinstance(plain.flow, CellularFlow)
    speed = plain.flow.mean_velocity
    flow, gusts = drawn.flow, drawn.turbulence
    assert isinstance(flow, ShapedCells)
    assert flow.mean_velocity == speed
    assert flow.length_scales == (4.0, pytest.approx(4.8))
    assert -0.7 <= flow.heading <= 0.7
    assert (flow.angle, flow.offset[0], flow.swell, flow.swell_period) == (1.4, 0.5, 0.2, 30.0)
    assert math.hypot(*flow.drift) == pytest.approx(0.1 * speed)
    assert drawn.wind == pytest.approx((0.0, 0.05 * speed))
    assert isinstance(gusts, Turbulence)
    assert (gusts.intensity, gusts.length, gusts.memory) == (pytest.approx(0.1 * speed), 8.0, 2.0)
    assert gusts.spectrum == "von-karman"
    assert drawn.flown == SuperposedFlow((flow, gusts), drawn.wind)
    assert drawn.time_jitter == 0.3
    assert drawn.faults == LogFaults(0.2, 4.0, 0.01, 6.0, 2, 3.0, 2, 0.2)
    # what is common to both is the same
    assert replace(drawn, flow=plain.flow, wind=(0.0, 0.0), turbulence=None, time_jitter=0.0,
                   faults=LogFaults()) == plain  # fmt: skip


def test_fields_of_turbulence_differ_from_flight_to_flight_only(tmp_path: Path) -> None:
    text = "turbulence_ratio = {}\nturbulence_length = 8.0"
    weak, strong = (draw(tmp_path, text.format(share)).turbulence for share in (0.1, 0.3))
    assert weak is not None
    assert strong is not None
    assert weak.seed == strong.seed
    other = draw(tmp_path, text.format(0.1), flight=2).turbulence
    assert other is not None
    assert other.seed != weak.seed
    assert draw(tmp_path, text.format(0.0)).turbulence is None


def test_faults_and_jitter_are_those_of_the_log(tmp_path: Path) -> None:
    seed = stream(5, 1, SIMULATION)
    plain = draw(tmp_path).fly(seed)
    log = draw(tmp_path, "outliers = 0.1\noutlier_size = 9.0").fly(seed)
    off = np.hypot(*(log.velocity - plain.velocity).T)
    assert 0 < np.sum(off > 0) < 20
    np.testing.assert_allclose(off[off > 0], 9.0)
    np.testing.assert_array_equal(log.position, plain.position)
    jittered = draw(tmp_path, "time_jitter = 0.3").fly(seed)
    assert np.ptp(np.diff(jittered.time)) > 0.005
    np.testing.assert_array_equal(jittered.position[0], plain.position[0])


def test_what_belongs_to_a_key_makes_no_shape(tmp_path: Path) -> None:
    beside = (
        "drift_direction = 1.0\nswell_phase = 2.0\nturbulence_length = 3.0\nwind_direction = 1.0"
    )
    assert draw(tmp_path, beside) == draw(tmp_path)


def test_second_cells_may_have_their_own_heading(tmp_path: Path) -> None:
    second = "second_scale_ratio = 1.5\nsecond_velocity_ratio = 0.5\n"
    flow = draw(tmp_path, second + "heading = 0.1\nsecond_heading = 0.6").flow
    assert isinstance(flow, SuperposedFlow)
    assert [cell.heading for cell in flow.cells] == [0.1, 0.6]
    alike = draw(tmp_path, second + "heading = 0.1").flow
    assert alike is not None
    assert [cell.heading for cell in alike.cells] == [0.1, 0.1]


def test_turbulence_without_cells_is_no_flow_to_find(tmp_path: Path) -> None:
    text = 'flow = "turbulence"\nturbulence_ratio = 0.3\nturbulence_length = 8.0'
    drawn = draw(tmp_path, text)
    assert drawn.flow is None
    assert isinstance(drawn.flown, SuperposedFlow)
    assert drawn.flown.cells == ()
    assert drawn.fly(stream(5, 1, SIMULATION)).extent > 0.0
    still = draw(tmp_path, 'flow = "none"\nwind_ratio = 0.1\nwind_direction = 0.0\nheading = 1.0')
    assert still.flown is None


def test_the_truth_of_a_shape_has_its_columns(tmp_path: Path) -> None:
    study = load(tmp_path, "heading = 0.2\naspect = 1.5\ndrift_ratio = 0.1\ndrift_direction = 0.0")
    cell = study.cells[0]
    flow = study.draw(0, cell).flow
    assert isinstance(flow, ShapedCells)
    row = Planned(study, Case(0, cell), flow)
    values = {column.name: column.planned(row) for column in COLUMNS if column.planned}
    assert values["true_heading"] == 0.2
    assert (values["true_length_scale_x"], values["true_length_scale_y"]) == (4.0, 6.0)
    assert values["true_drift_x"] == pytest.approx(0.1 * flow.mean_velocity)
    assert values["true_length_scale"] == flow.length_scale


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("drift_ratio = 0.1", 'key "drift_direction" missing: drift_ratio needs it too'),
        ("turbulence_ratio = 0.1", "turbulence_length"),
        ("wind_ratio = 0.1\nwind_direction = 0.0\nwind = [1.0, 0.0]", "drop wind, or this"),
        ("swell = 1.0", "must lie between 0 and 0.99, not 1"),
        ("angle = 0.0", "must lie between 0 and 3.14"),
        ("aspect = 0", "must lie between 0.01 and 100, not 0"),
        ("outliers = 2", "must lie between 0 and 1"),
        ("time_jitter = 0.5", "must lie between 0 and 0.49"),
        ("second_heading = 0.5", "second_scale_ratio"),
        ("position_wander_time = 0.0", "must be above 0"),
        ('flow = "turbulence"', "turbulence_ratio"),
        ('turbulence_spectrum = "karman"', 'did you mean "von-karman"'),
        ("turbulence_intensity = 0.1", "turbulence"),
    ],
)
def test_bad_keys_are_named(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        load(tmp_path, text)


def values_of_run(study: Study, flight: int = 0) -> list[dict[str, object]]:
    events = run_flight(study, flight, study.cells)
    return [dict(event.values) for event in events if isinstance(event, Outcome)]


def test_a_case_tells_how_well_it_predicts_other_flights(tmp_path: Path) -> None:
    long = "duration = 6.0\nthrust_acceleration = [5.0, 3.0]\ninitial_position = [1.0, 2.0]"
    study = load(
        tmp_path, f"{long}\n[run]\nprediction_flights = 2", HEAD.replace("duration = 1.0\n", "")
    )
    (good,) = values_of_run(study)
    assert isinstance(good["prediction_error"], float)
    assert 0.0 < good["prediction_error"] < 0.1
    draw = study.draw(0, study.cells[0])
    seed = stream(study.seed, 0, SIMULATION)
    others = draw.others(seed, 2)
    starts = [flight.position[0].tolist() for flight in (draw.fly(seed), *others)]
    assert starts[0] == pytest.approx([1.0, 2.0], abs=1e-12)
    assert len({tuple(start) for start in starts}) == 3
    assert all(flight.flow == draw.flown for flight in others)
    (silent,) = values_of_run(load(tmp_path, long, HEAD.replace("duration = 1.0\n", "")))
    assert math.isnan(float(str(silent["prediction_error"])))


def test_predictions_are_not_shown_where_none_are_made(tmp_path: Path) -> None:
    shown = '[[outputs.answers]]\nmeasure = "prediction-error"\ncompare = "settings"\n'
    with pytest.raises(InputError, match=r"\[run\] key \"prediction_flights\" missing"):
        load(tmp_path, shown)
    assert load(tmp_path, "[run]\nprediction_flights = 1\n" + shown).prediction_flights == 1
    with pytest.raises(InputError, match="prediction_flights"):
        load(tmp_path, "[run]\nprediction_flights = -1\n")


def rows(*cases: tuple[str, float, float]) -> pd.DataFrame:
    """Cases of (status, percent error of U0, prediction error), in a flow of 10 m/s and 4 m."""
    found = [
        {"status": status, "flow": "cellular", "prediction_error": predicted}
        | {"true_mean_velocity": 10.0, "true_length_scale": 4.0, "true_timescale": 0.4}
        | {"est_mean_velocity": 10.0 * (1 + off / 100), "est_length_scale": 4.0}
        | {"est_timescale": 0.4}
        for status, off, predicted in cases
    ]
    return pd.DataFrame(found)


def test_silent_misses_are_of_all_flights_in_a_flow() -> None:
    cases = rows(
        ("ok", 1.0, 0.01), ("ok", 9.0, 0.04), ("misfit", 9.0, 0.5), ("unidentifiable", 9.0, 1.0),
        ("error", math.nan, math.nan),
    )  # fmt: skip
    assert Share.of(MEASURES["silent-misses"], cases) == Share(1, 5)
    assert Share.of(MEASURES["misfits"], cases) == Share(1, 5)
    still = cases.assign(flow="none")
    assert Share.of(MEASURES["silent-misses"], still) == Share(0, 0)


def test_a_flow_that_was_not_given_counts_as_all_of_it_missed() -> None:
    cases = rows(("ok", 0.0, 0.01), ("unidentifiable", 0.0, 0.04), ("error", math.nan, math.nan))
    # (1 % * 4 % * 100 %)^(1/3), and (1 % * 100 % * 100 %)^(1/3) where only offered ones count
    predicted = MEASURES["prediction-error"].summarise(cases)
    assert predicted == pytest.approx(400.0 ** (1 / 3), rel=1e-12)
    offered = MEASURES["offered-prediction-error"].summarise(cases)
    assert offered == pytest.approx(1e4 ** (1 / 3), rel=1e-12)


def test_headings_are_compared_up_to_a_quarter_turn() -> None:
    cases = rows(("ok", 0.0, 0.0), ("ok", 0.0, 0.0), ("misfit", 0.0, 0.0))
    # 44 against -44 degrees: 2 degrees apart on a square lattice
    turned = cases.assign(
        true_heading=np.radians([44.0, 10.0, 10.0]), est_heading=np.radians([-44.0, 11.0, 12.0])
    )
    assert MEASURES["heading-error"].per_case(turned)[:2] == pytest.approx([2.0, 1.0], abs=1e-9)


def test_sides_are_compared_by_size_and_a_steady_answer_drifts_by_nothing() -> None:
    cases = rows(("ok", 0.0, 0.0), ("ok", 0.0, 0.0), ("ok", 0.0, 0.0)).assign(
        true_length_scale_x=4.0, true_length_scale_y=5.0,
        est_length_scale_x=[5.0, 4.0, math.nan], est_length_scale_y=[4.04, 5.1, math.nan],
        true_mean_velocity=10.0, true_drift_x=0.3, true_drift_y=0.4,
        est_drift_x=[0.3, math.nan, math.nan], est_drift_y=[0.41, math.nan, math.nan],
        est_shape=["rectangle", "rectangle", ""],
    )  # fmt: skip
    assert MEASURES["sides-error"].per_case(cases)[:2] == pytest.approx([1.0, 2.0], abs=1e-9)
    assert MEASURES["drift-error"].per_case(cases)[:2] == pytest.approx([0.1, 5.0], abs=1e-9)
