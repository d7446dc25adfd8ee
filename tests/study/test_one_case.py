"""One case run again: the numbers of the run, and what its picture is drawn from."""

import math
import re

import numpy as np
import pandas as pd
import pytest

from sparsefit.errors import InputError, SparsefitError
from sparsefit.flight.flow import CellularFlow
from sparsefit.study import Study
from sparsefit.study.report.case import case_figure, case_table, left_to_explain, row_of
from sparsefit.study.report.flown import vorticity
from sparsefit.study.run.execution import run_flight
from sparsefit.study.run.one_case import find_case, run_again
from sparsefit.study.run.outcome import Outcome

TEXT = """
name = "again"
question = "?"
seed = 5
[flights]
count = 3
mean_velocity = { uniform = [8, 15] }
length_scale = { uniform = [3, 6] }
response_time = 0.5
thrust_acceleration = [5.0, 3.0]
duration = 6.0
sample_rate = 50.0
velocity_noise = 0.1
[[backends]]
name = "group-lasso"
alpha_fraction = [0.1, 0.3]
[[backends]]
name = "least-squares"
rcond = 0.03
[[backends]]
name = "parametric-nls"
"""


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    file = tmp_path_factory.mktemp("study") / "again.toml"
    file.write_text(TEXT)
    return Study.load(file)


@pytest.fixture(scope="module")
def cases(study):
    return {cell.backend: run_again(study, f"0001-{cell.key}") for cell in study.cells}


def test_the_numbers_are_those_of_the_run(study, cases):
    """All but the paths of a penalty, which alone start elsewhere, are the same to the last bit."""
    rows = [event for event in run_flight(study, 1, study.cells) if isinstance(event, Outcome)]
    stored = {study.cells[row.cell].backend: row for row in rows}
    for name, again in cases.items():
        for key in ("est_mean_velocity", "est_length_scale", "low_timescale", "high_timescale"):
            assert again.values[key] == pytest.approx(stored[name].values[key], rel=1e-6)
        assert again.estimate.status == stored[name].status == "ok"
    again, row = cases["least-squares"], stored["least-squares"]
    assert again.values["est_timescale"] == row.values["est_timescale"]


def test_the_table_holds_them_against_the_stored_row(study, cases):
    again = cases["least-squares"]
    row = again.values | {"case_id": again.case.case_id, "status": "ok", "reason": ""}
    stored = row_of(pd.DataFrame([row]), again.case.case_id)
    table = case_table(study, again, stored)
    assert table.notes == ("As stored, to 6 digits.",)
    assert table.rows[0][1] == f"{again.flow.mean_velocity:.6g}"
    moved = case_table(study, again, {**row, "est_length_scale": 9.0})
    assert moved.notes == ("Differs from what is stored: L_w [m].",)
    assert row_of(pd.DataFrame([row]), "0000-ab") is None
    assert "no row" in case_table(study, again, None).notes[0]


def test_a_penalised_fit_leaves_the_penalty_where_there_is_a_weight(cases):
    """The optimality conditions of the group-LASSO: at most 1, and 1 in the groups in use."""
    fit = cases["group-lasso"].fit
    values, _ = left_to_explain(fit)
    used = np.zeros(len(values), dtype=bool)
    used[fit.problem.groups[fit.support]] = True
    assert values.max() <= 1.0 + 1e-6
    assert values[used] == pytest.approx(1.0, abs=1e-5)


def test_vorticity_of_square_cells_is_known():
    """w = U (sin kx cos ky, -cos kx sin ky) turns at 2 U k sin kx sin ky, k = pi / L."""
    flow = CellularFlow(mean_velocity=10.0, length_scale=4.0)
    edges, turning = vorticity(flow, np.array([[0.0, 0.0], [8.0, 6.0]]), 0.0)
    k = math.pi / 4.0
    x, y = np.linspace(*edges[:2], turning.shape[1]), np.linspace(*edges[2:], turning.shape[0])
    known = 2 * 10.0 * k * np.outer(np.sin(k * y), np.sin(k * x))
    inside = (slice(1, -1), slice(1, -1))
    assert turning[inside] == pytest.approx(known[inside], abs=0.01 * 2 * 10.0 * k)


@pytest.mark.parametrize("name", ["group-lasso", "least-squares", "parametric-nls"])
def test_the_picture_has_four_panels(cases, name):
    figure = case_figure(cases[name])
    titles = [axes.get_title() for axes in figure.axes]
    assert titles[0] == "track over the vorticity found"
    assert re.match(r"(duality gap|normal equations) \d", titles[3])


def test_an_id_that_is_not_planned_is_refused_with_the_nearest(study):
    cell = study.cells[0]
    for wrong in (f"0001-{cell.key[:-1]}", f"9999-{cell.key}", "", "x\ny", f"٣-{cell.key}"):
        with pytest.raises(InputError, match=f"plans no case .*-{cell.key} say"):
            find_case(study, wrong)


def test_a_case_that_fails_says_why(study, monkeypatch):
    def broken(*_):
        raise ZeroDivisionError("of its own")

    monkeypatch.setattr("sparsefit.estimator.estimator.Estimator.read", broken)
    with pytest.raises(SparsefitError, match="ends in an error: ZeroDivisionError: of its own"):
        run_again(study, f"0000-{study.cells[0].key}")
