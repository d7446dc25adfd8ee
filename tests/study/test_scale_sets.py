"""Superposed flows in a study: how they are drawn, what a row says, the table and the sentence."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pandas as pd
import pytest

import sparsefit as sf
from sparsefit.errors import InputError
from sparsefit.estimator.estimate import Estimate
from sparsefit.study import Study, cells, read_cases
from sparsefit.study.evidence.answers import ANSWERS
from sparsefit.study.evidence.asked import Asked
from sparsefit.study.evidence.measures import MEASURES, at_least
from sparsefit.study.evidence.tables import TABLES, has_any, tables_for
from sparsefit.study.report.certificate import certificate_figure
from sparsefit.study.report.figures import FIGURES, figures_for
from sparsefit.study.run.columns import KINDS
from sparsefit.study.run.execution import run_flight
from sparsefit.study.run.outcome import Outcome
from sparsefit.study.run.reading import scale_sets
from sparsefit.study.spec.quantities import STREAMS

TEXT = """
name = "two"
question = "?"
seed = 3
[flights]
count = 2
mean_velocity = 10.0
length_scale = { uniform = [2.5, 3.5] }
second_scale_ratio = 1.5
second_velocity_ratio = 0.8
response_time = 0.5
thrust_acceleration = [12.0, 7.0]
duration = 4.0
sample_rate = 50.0
[library]
lower = 2.0
upper = 6.0
[readout]
scales = "several"
[[backends]]
name = "best-scale"
[[backends]]
name = "gridless-group-lasso"
"""
RESOLVED = {"cells": 30.0, "scale-ratio": 1.3, "velocity-ratio": 0.3}
FOUND = {"measure": "scales-found", "show": "every", "at_least": RESOLVED}
RESULTS = Path(__file__).parents[2] / "results"


def load(tmp_path: Path, text: str = TEXT) -> Study:
    (tmp_path / "two.toml").write_text(text)
    return Study.load(tmp_path / "two.toml")


def row(backend="lasso", *, ratio=1.5, velocity=0.5, extent=200.0, found=True, **more):
    """A case with two flows, of 4 m and 4 m * ratio, found within 0.5 % or the first alone."""
    truth = [[4.0, 10.0], [round(4.0 * ratio, 6), 10.0 * velocity]]
    return {
        "flight": 0,
        "protocol": "default",
        "backend": backend,
        "label": backend,
        "settings": "{}",
        "status": "ok",
        "extent": extent,
        "scales_true": 2.0,
        "scales_detected": 2.0 if found else 1.0,
        "scales_missed": 0.0 if found else 1.0,
        "scales_spurious": 0.0 if found else 1.0,
        "scales_max_length_scale_error": 0.5,
        "scales_max_mean_velocity_error": 2.0,
        "scales_within_1_percent": float(found),
        "true_scales": json.dumps(truth),
        "flights.second_scale_ratio": ratio,
    } | more


def test_flows_are_multiples_of_the_first(tmp_path: Path) -> None:
    third = "third_scale_ratio = 2.5\nthird_velocity_ratio = 0.1\nresponse_time"
    study = load(tmp_path, TEXT.replace("response_time", third))
    flow = cells(study)[0].setup.flights.draw(1, 2, 3).flow
    assert isinstance(flow, sf.SuperposedFlow)
    scale = flow.components[0].length_scale
    assert [(p.mean_velocity, p.length_scale) for p in flow.components] == [
        (10.0, scale),
        (8.0, scale * 1.5),
        (1.0, scale * 2.5),
    ]


def test_a_second_flow_changes_no_other_draw(tmp_path: Path) -> None:
    superposed = cells(load(tmp_path))[0].setup.flights.draw(1, 2, 3)
    lines = [line for line in TEXT.splitlines() if not line.startswith("second_")]
    alone = cells(load(tmp_path, "\n".join(lines)))[0].setup.flights.draw(1, 2, 3)
    assert alone.flow == superposed.flow.components[0]
    assert replace(superposed, flow=alone.flow) == alone


def test_streams_are_only_ever_added_at_the_end() -> None:
    assert STREAMS[:3] == ("mean_velocity", "length_scale", "timescale")
    assert STREAMS.index("velocity_noise") == 14
    assert STREAMS[17:24] == (
        "second_scale_ratio",
        "second_velocity_ratio",
        "third_scale_ratio",
        "third_velocity_ratio",
        "believed_response_time_ratio",
        "believed_thrust_ratio",
        "heading",
    )
    assert STREAMS.index("turbulence_field") == 39
    assert STREAMS.index("gap_duration") == 48
    assert len(set(STREAMS)) == len(STREAMS)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("second_velocity_ratio = 0.8\n", "", "second_velocity_ratio"),
        ("second_", "third_", "second_scale_ratio"),
        ("second_scale_ratio = 1.5", "second_scale_ratio = 0.0", "between 0.01 and 100"),
        ("second_scale_ratio = 1.5", "second_scale_ratio = 1e9", "between 0.01 and 100"),
    ],
)
def test_half_a_flow_and_no_flow_are_refused(tmp_path: Path, old: str, new: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        load(tmp_path, TEXT.replace(old, new))


def test_rows_of_a_run(tmp_path: Path) -> None:
    study = load(tmp_path)
    rows = [one for one in run_flight(study, 0, cells(study)) if isinstance(one, Outcome)]
    assert [one["scales_true"] for one in rows] == [2, 2]
    assert rows[0]["scales_detected"] + rows[0]["scales_spurious"] == 1  # best-scale proposes one
    found = json.loads(rows[1]["est_scales"])
    assert len(found) == rows[1]["scales_detected"] + rows[1]["scales_spurious"]
    flow = cells(study)[0].setup.flights.draw(0, 2, 3).flow
    assert json.loads(rows[0]["true_scales"])[1][0] == pytest.approx(
        flow.components[1].length_scale
    )
    assert rows[0]["extent"] > 10.0


def estimate(scales: tuple[sf.ScaleEstimate, ...] = (), scale: float = 4.0) -> Estimate:
    return Estimate(10.0, scale, scale / 10.0, "ok", "", "lasso", {}, scales=scales)


def test_one_flow_read_as_one_leaves_the_columns_blank() -> None:
    assert scale_sets(estimate(), sf.CellularFlow(10.0, 4.0)) is None
    assert math.isnan(Outcome(0, 0, "ok")["scales_true"])
    assert Outcome(0, 0, "ok")["true_scales"] == ""


def test_a_readout_of_one_scale_is_a_set_of_one() -> None:
    flow = sf.SuperposedFlow((sf.CellularFlow(10.0, 4.0), sf.CellularFlow(5.0, 8.0)))
    sets = scale_sets(estimate(scale=4.02), flow)
    assert (sets.score.detected, sets.score.missed, sets.score.spurious) == (1, 1, 0)
    assert sets.score.max_length_scale_error == pytest.approx(0.5)
    assert not sets.score.within(1.0)
    assert json.loads(sets.true) == [[4.0, 10.0], [8.0, 5.0]]
    none = scale_sets(estimate(scale=math.nan), flow)
    assert (none.score.missed, none.estimated) == (2, "[]")


def test_the_regime_worked_by_hand() -> None:
    cases = pd.DataFrame([row(ratio=1.3, velocity=0.3, extent=156.0), row(extent=90.0)])
    read = {name: MEASURES[name].read(cases) for name in RESOLVED}
    assert read["cells"] == pytest.approx([156.0 / 5.2, 90.0 / 6.0])
    assert read["scale-ratio"] == pytest.approx([1.3, 1.5])
    assert read["velocity-ratio"] == pytest.approx([0.3, 0.5])
    assert list(at_least(cases, RESOLVED)) == [True, False]


STUDY = SimpleNamespace(name="demo", reference=None)


def test_the_table_counts_planned_cases() -> None:
    failed = row(
        ratio=1.1, status="error", scales_within_1_percent=math.nan, scales_missed=math.nan,
        scales_spurious=math.nan, scales_max_length_scale_error=math.nan,
        scales_max_mean_velocity_error=math.nan,
    )  # fmt: skip
    table = TABLES.make("scales", STUDY, pd.DataFrame([row(), row(found=False), row(), failed]))
    assert [one[3:5] for one in table.rows] == [
        (None, None),
        ("flights.second_scale_ratio", 1.5),
        ("flights.second_scale_ratio", 1.1),
    ]
    counted = [pytest.approx(row, nan_ok=True) for row in (
        (4, 50.0, 1 / 3), (3, 200 / 3, 1 / 3), (1, 0.0, math.nan),
    )]  # fmt: skip
    assert [one[5:8] for one in table.rows] == counted
    assert table.rows[0][9:] == (0.5, 2.0, 1)


def test_the_answer_is_of_the_cases() -> None:
    far = [
        row("group-lasso"),
        row("group-lasso"),
        row("best-scale", found=False),
        row("best-scale"),
    ]
    near = [
        row("group-lasso", extent=50.0, found=False),
        row("best-scale", extent=50.0, found=False),
    ]
    said = ANSWERS.make(FOUND, STUDY, pd.DataFrame(far + near))
    assert "Where cells flown at least 30, scale ratio at least 1.3" in said
    assert "100 % (group-lasso), 50 % (best-scale)." in said
    assert "Elsewhere (1 flight): 0 % (all)." in said
    blank = pd.DataFrame([row(true_scales="", extent=math.nan)])
    assert ANSWERS.make(FOUND, STUDY, blank).startswith("No case")


def test_cases_of_older_files_have_no_scales_and_are_read() -> None:
    cases = read_cases(RESULTS / "table1").drop(
        columns=[name for name in KINDS if "scales" in name or name == "extent"], errors="ignore"
    )
    assert not has_any(cases, "scales-found")
    assert "scales" not in tables_for(cases)
    assert "scales" not in figures_for(cases, None)


def test_figures_say_what_they_need(tmp_path: Path) -> None:
    lines = TEXT.split("[[backends]]")
    alone = load(tmp_path, "[[backends]]".join(lines[:2]))
    with pytest.raises(InputError, match="no gridless-group-lasso"):
        certificate_figure(Asked(), alone, pd.DataFrame(), None)
    one = pd.DataFrame([row()]).drop(columns="flights.second_scale_ratio")
    with pytest.raises(InputError, match="sweeps no number"):
        FIGURES.make("scales", STUDY, one, None)


def test_the_certificate_touches_one_at_the_scales_chosen(tmp_path: Path) -> None:
    figure = certificate_figure(Asked(), load(tmp_path), pd.DataFrame(), None)
    (axes,) = figure.axes
    (eta,) = [line.get_ydata() for line in axes.lines if line.get_label() == "η(k)"]
    assert 0.98 < eta.max() <= 1 + 1e-5
    (points,) = axes.collections
    assert len(points.get_offsets()) >= 2
