"""Every planned case once, in one frame; draws that do not depend on other cases."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from sparsefit.errors import InputError
from sparsefit.study.draw import SIMULATION, Draw, stream
from sparsefit.study.study import Study

HEAD = """
name = "d"
question = "?"
seed = 5
[flights]
count = 5
timescale = { linspace = [0.1, 0.5] }
length_scale = { uniform = [2.0, 10.0] }
response_time = { uniform = [0.1, 0.5] }
process_noise = { loguniform = [0.01, 1.0] }
duration = 1.0
sample_rate = 50.0
"""
LASSO = """
[[backends]]
name = "lasso"
alpha_fraction = [0.1, 0.01]
"""
REST = """
[[backends]]
name = "least-squares"
[[protocols]]
name = "one"
[[protocols]]
name = "two"
"readout.mean_velocity" = "paper"
[sweep]
"flights.velocity_noise" = [0.0, 0.5]
"library.target" = ["flow-velocity", "acceleration"]
"""


def load(tmp_path: Path, text: str) -> Study:
    path = tmp_path / "d.toml"
    path.write_text(text, encoding="utf-8")
    return Study.from_file(path)


def draws(study: Study) -> list[Draw]:
    rules = study.planned.points[0].setup.flights
    return [rules.draw(flight, 5, study.seed) for flight in range(5)]


def test_the_plan_holds_every_combination_once(tmp_path: Path) -> None:
    study = load(tmp_path, HEAD + LASSO + REST)
    plan = study.plan()
    assert len(plan) == 5 * 2 * 2 * 2 * 3
    assert plan["case_id"].is_unique
    keys = ["flight", "protocol", "flights.velocity_noise", "library.target", "settings", "backend"]
    assert not plan.duplicated(keys).any()
    assert study.planned.factors() == {
        "flights.velocity_noise": "condition",
        "library.target": "candidate",
        "readout.mean_velocity": "candidate",
    }
    assert plan["condition"].unique().tolist() == ["velocity_noise 0", "velocity_noise 0.5"]
    assert plan["candidate"].nunique() == plan["title"].nunique() == 12
    assert not plan.duplicated(["flight", "condition", "candidate"]).any()
    assert "two: lasso alpha_fraction=0.01 with target acceleration" in set(plan["title"])
    assert plan["flights.velocity_noise"].dtype == float
    assert plan["unit"].iloc[0] == "0000 in velocity_noise 0"
    counts = study.counts()
    assert (counts["units"], counts["cases"], len(counts["candidates"])) == (5, 120, 12)
    assert counts["conditions"] == ["velocity_noise 0", "velocity_noise 0.5"]
    assert counts["levels"]["library.target"] == 2


READINGS = {"on the grid": "none", "refined": "variable-projection"}
WORLDS = "".join(
    f'[[protocols]]\nname = "{world}, {reading}"\n"readout.refine" = "{refine}"\n{noise}'
    for world, noise in (("one flow", ""), ("noise", '"flights.velocity_noise" = 0.2\n'))
    for reading, refine in READINGS.items()
)


def test_protocols_are_worlds_and_readings_by_what_they_set(tmp_path: Path) -> None:
    plan = load(tmp_path, HEAD + LASSO + WORLDS).plan()
    assert plan["reading"].unique().tolist() == list(READINGS)
    assert plan["condition"].unique().tolist() == ["one flow", "noise"]
    assert plan["candidate"].nunique() == 4


CALM = '[[protocols]]\nname = "calm"\n'
FORWARD = '[[protocols]]\nname = "forward, noise"\n"derivative.method" = "forward"\n'
NOISE = '"flights.velocity_noise" = 0.2\n'
LABELLED = '[[backends]]\nname = "lasso"\nlabel = "referee"\nsolver = "clarabel"\n'


@pytest.mark.parametrize(
    ("text", "titles"),
    [
        (f"{CALM}{CALM.replace('calm', 'noise')}{NOISE}{FORWARD}{NOISE}", ["lasso", "forward"]),
        (CALM + FORWARD, ["calm", "forward, noise"]),
        ('[sweep]\n"readout.refine" = ["none", "ladder"]', ["refine none", "refine ladder"]),
        ('[sweep]\n"estimator.free" = ["auto", ["wind", "lag"], []]',
         ["free auto", "free wind / lag", "free none"]),
        (LABELLED, ["lasso", "referee"]),
        (LABELLED.replace("referee", "lasso"),
         [f"lasso solver={n}" for n in ("homotopy", "clarabel")]),
    ],
)  # fmt: skip
def test_a_title_is_the_shortest_name_that_tells_it_apart(tmp_path: Path, text, titles) -> None:
    plan = load(tmp_path, f'{HEAD}[[backends]]\nname = "lasso"\n{text}').plan()
    assert plan["title"].unique().tolist() == titles


def test_a_new_backend_or_level_changes_no_case_id(tmp_path: Path) -> None:
    small = set(load(tmp_path, HEAD + LASSO).plan()["case_id"])
    more = HEAD + LASSO + '[[backends]]\nname = "stlsq"\n[[protocols]]\nname = "default"\n'
    more += '[[protocols]]\nname = "b"\n"derivative.method" = "forward"\n'
    assert small < set(load(tmp_path, more).plan()["case_id"])


def test_order_in_the_file_does_not_matter_for_a_sweep(tmp_path: Path) -> None:
    lines = REST.strip().splitlines()
    turned = "\n".join([*lines[:-2], lines[-1], lines[-2]])
    one, other = load(tmp_path, HEAD + LASSO + REST), load(tmp_path, HEAD + LASSO + turned)
    assert one.hash == other.hash
    assert one.plan()["case_id"].tolist() == other.plan()["case_id"].tolist()


def test_draws_follow_their_rules_and_fixing_one_moves_no_other(tmp_path: Path) -> None:
    found = draws(load(tmp_path, HEAD + LASSO))
    fixed = HEAD.replace("{ uniform = [0.1, 0.5] }", "0.3")
    others = draws(load(tmp_path, fixed + LASSO))
    for one, other in zip(found, others, strict=True):
        assert one.flow == other.flow
        assert one.values["process_noise"] == other.values["process_noise"]
    assert np.allclose([one.flow.timescale for one in found], np.linspace(0.1, 0.5, 5))
    assert all(2.0 <= one.flow.length_scale <= 10.0 for one in found)
    assert all(0.01 <= one.values["process_noise"] <= 1.0 for one in found)
    assert all(0.1 <= one.vehicle.response_time <= 0.5 for one in found)
    assert len({one.flow.length_scale for one in found}) == 5


@pytest.mark.parametrize("second", ["length_scale = 4.0", "timescale = 0.5"])
def test_the_third_flow_parameter_follows(tmp_path: Path, second: str) -> None:
    lines = [s for s in HEAD.splitlines() if not s.startswith(("timescale", "length_scale"))]
    text = "\n".join([*lines, "mean_velocity = 8.0", second])
    flow = draws(load(tmp_path, text + LASSO))[0].flow
    assert (flow.mean_velocity, flow.length_scale, flow.timescale) == (8.0, 4.0, 0.5)


def test_backends_and_levels_share_their_flights(tmp_path: Path) -> None:
    """Common random numbers: only what is swept differs between levels."""
    plain = draws(load(tmp_path, HEAD + LASSO))
    study = load(tmp_path, HEAD + LASSO + REST)
    cells = study.planned.points
    quiet, noisy = dict.fromkeys(cell.setup.flights for cell in cells)
    for flight, alone in enumerate(plain):
        low, high = (rules.draw(flight, 5, 5) for rules in (quiet, noisy))
        assert low.values | {"velocity_noise": 0.0} == alone.values | {"velocity_noise": 0.0}
        assert low.flow == high.flow
        assert [draw.values["velocity_noise"] for draw in (low, high)] == [0.0, 0.5]
    flown = [rules.draw(2, 5, 5).fly(stream(5, 2, SIMULATION)) for rules in (quiet, noisy)]
    assert np.array_equal(flown[0].position, flown[1].position)
    noise = flown[1].velocity - flown[0].velocity
    assert 0.3 < noise.std() < 0.7


def test_initial_state_can_be_given(tmp_path: Path) -> None:
    text = HEAD + "initial_position = [1.0, { uniform = [2.0, 3.0] }]\ninitial_velocity = [1, 2]\n"
    draw = draws(load(tmp_path, text + LASSO))[0]
    flight = draw.fly(stream(5, 0, SIMULATION))
    assert flight.position[0, 0] == 1.0
    assert 2.0 <= flight.position[0, 1] < 3.0
    assert np.allclose(flight.velocity[0], (1.0, 2.0))


def test_a_wind_and_a_wrong_belief_are_those_of_the_flight(tmp_path: Path) -> None:
    more = """wind = [1.0, { uniform = [2.0, 3.0] }]
measurement_noise = [0.2, 0.05]
thrust_acceleration = [5.0, 3.0]
believed_response_time_ratio = 1.2
believed_thrust_ratio = 0.5
"""
    plain, draw = (draws(load(tmp_path, HEAD + text + LASSO))[0] for text in ("", more))
    assert draw.flow == plain.flow
    assert draw.flown.components == (plain.flow,)
    assert draw.flown.wind == draw.wind
    assert draw.wind[0] == 1.0
    assert 2.0 <= draw.wind[1] < 3.0
    assert (draw.values["velocity_noise"], draw.values["position_noise"]) == (0.2, 0.05)
    flight = draw.fly(stream(5, 0, SIMULATION))
    assert flight.vehicle.response_time == pytest.approx(1.2 * draw.vehicle.response_time)
    assert flight.vehicle.thrust_acceleration == (2.5, 1.5)
    assert flight.flow == draw.flown
    assert plain.flown == plain.flow
    assert plain.fly(stream(5, 0, SIMULATION)).vehicle == plain.vehicle


def test_an_infinite_flow_is_a_row_of_its_own_case(tmp_path: Path) -> None:
    text = HEAD.replace("{ linspace = [0.1, 0.5] }", "{ linspace = [1e-310, 0.5] }")
    study = load(tmp_path, text + LASSO)
    with pytest.raises(InputError, match=r"timescale must be a finite number .*; got inf"):
        draws(study)
    assert study.planned.truth(0, 0) == {}
    assert study.planned.truth(4, 0)["flow"] == "cellular"
