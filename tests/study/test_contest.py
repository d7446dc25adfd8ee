"""The shipped contest of regularisers, cut down: it runs, and refinement pays."""

from pathlib import Path

import numpy as np
import pytest

from sparsefit.study import Study
from sparsefit.study.run.execution import run_flight
from sparsefit.study.run.outcome import Outcome

CONTEST = Path(__file__).parents[2] / "studies" / "contest.toml"
TRIED = ("lasso", "group-lasso", "sparse-group-lasso", "group-omp")


@pytest.fixture(scope="module")
def contest():
    return Study.load(CONTEST)


def test_it_crosses_worlds_groups_and_refinement(contest):
    assert len(contest.protocols) == 12  # six worlds, on the grid and refined
    assert {cell.setup.library.family for cell in contest.cells} == {"waves"}
    assert {cell.setup.library.groups for cell in contest.cells} == {"wave", "nested"}
    assert contest.prediction_flights == 2


def test_a_flight_of_it_is_told_by_every_back_end_and_better_off_the_grid(contest):
    tried = [
        cell for cell in contest.cells
        if cell.protocol.startswith("one flow") and cell.backend in TRIED
        and cell.setup.library.groups == "nested" and cell.settings.get("alpha_fraction") != 0.03
    ]  # fmt: skip
    events = run_flight(contest, 0, tried)
    outcomes = {event.cell: event for event in events if isinstance(event, Outcome)}
    assert set(outcomes) == {cell.index for cell in tried}
    assert {outcome.status for outcome in outcomes.values()} == {"ok"}
    errors = {
        (cell.backend, cell.setup.readout.refine): outcomes[cell.index].values["prediction_error"]
        for cell in tried
    }
    assert np.isfinite(list(errors.values())).all()
    for name in TRIED:
        assert errors[name, "variable-projection"] < errors[name, "none"]
    assert errors["group-lasso", "variable-projection"] < 0.1
