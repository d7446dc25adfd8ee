"""Protocols against measurement noise: medians, and the sentences that they give."""

import math
from types import SimpleNamespace

import pandas as pd
import pytest

from sparsefit.errors import InputError
from sparsefit.study.evidence.along import at_level
from sparsefit.study.evidence.answers import ANSWERS
from sparsefit.study.evidence.asked import MEASUREMENT_NOISE as NOISE
from sparsefit.study.evidence.cases import level_text
from sparsefit.study.evidence.measures import MEASURES
from sparsefit.study.evidence.tables import TABLES
from sparsefit.study.report.figures import FIGURES
from tests.study.test_tables import case

STUDY = SimpleNamespace(name="demo", reference=None)
ALONG = {"measure": "timescale-error", "compare": "protocols", "along": NOISE}
SPREAD = {"measure": "timescale-error", "compare": "spread", "over": "setting", "along": NOISE}
QUIET, LOUD = "[0,0]", "[0.5,0.1]"


def cases_of(errors, **more):
    """Cases of {(protocol, noise): errors of tau_w [%] per flight, None a failure}."""
    return pd.DataFrame(
        [
            case(
                flight,
                percent=(0.0, percent or 0.0),
                status="ok" if percent is not None else "unidentifiable",
                protocol=protocol,
                **{NOISE: noise, **more},
            )
            for (protocol, noise), sizes in errors.items()
            for flight, percent in enumerate(sizes)
        ]
    )


ERRORS = {
    ("crude", QUIET): (1.0, -2.0, 4.0),
    ("fine", QUIET): (0.1, 0.2, -0.3),
    ("crude", LOUD): (5.0, None, None),
    ("fine", LOUD): (1.0, -0.5, None),
}


def test_noise_is_named_as_a_pair():
    assert level_text("[0.05,0.01]") == "0.05 / 0.01"
    assert level_text("[0,0]") == "0 / 0"
    assert level_text("all") == "all"


def test_a_failure_is_an_infinite_error():
    cases = cases_of(ERRORS)
    error = MEASURES["timescale-error"]
    sizes = [error.summarise(cases[(cases.protocol == p) & (cases[NOISE] == n)]) for p, n in ERRORS]
    assert sizes == [pytest.approx(2.0), pytest.approx(0.2), math.inf, pytest.approx(1.0)]


def test_table_by_hand():
    table = TABLES.make("methods", STUDY, cases_of(ERRORS))
    assert [column.full_heading for column in table.columns] == [
        "back-end", "protocol", "measurement noise 0 / 0 [%]",
        "measurement noise 0.5 / 0.1 [%]", "failures",
    ]  # fmt: skip
    assert table.rows[0] == ("lasso", "crude", pytest.approx(2.0), math.inf, "2/6")
    assert table.rows[1] == ("lasso", "fine", pytest.approx(0.2), pytest.approx(1.0), "1/6")


def test_rows_of_one_setting_stand_together():
    other = cases_of(ERRORS, settings='{"alpha_fraction": 0.3}')
    both = pd.concat([cases_of(ERRORS, settings='{"alpha_fraction": 0.1}'), other])
    names = [(row[0], row[1]) for row in TABLES.make("methods", STUDY, both).rows]
    assert [name[1] for name in names] == ["crude", "fine"] * 2
    assert len({name[0] for name in names[:2]}) == 1


def test_derivatives_answer_by_hand():
    one = cases_of(ERRORS, settings='{"alpha_fraction": 0.1}')
    worse = {key: tuple(e and 3 * e for e in sizes) for key, sizes in ERRORS.items()}
    other = cases_of(worse, settings='{"alpha_fraction": 0.3}')
    said = ANSWERS.make(ALONG, STUDY, one)
    assert "At 0 / 0: 0.200 % (fine) to 2.00 % (crude); at 0.5 / 0.1: 1.00 %" in said
    assert said.endswith("1.00 % (fine) to no answer (crude).")
    assert ANSWERS.make(SPREAD, STUDY, one).endswith(
        "the worst setting's 1.00 (all) times the best's."
    )
    said = ANSWERS.make(SPREAD, STUDY, pd.concat([one, other]))
    assert said.endswith("the worst setting's 3.00 (all) times the best's.")


def test_what_else_is_swept_is_told_apart():
    parts = [cases_of(ERRORS, **{"readout.refine": level}) for level in ("none", "some")]
    said = ANSWERS.make(ALONG, STUDY, pd.concat(parts))
    assert "With refine none, at 0 / 0: 0.2" in said
    assert "With refine some, at 0 / 0: 0.2" in said


def test_vehicle_answer_by_hand():
    said = ANSWERS.make(ALONG | {"show": "every"}, STUDY, cases_of(ERRORS))
    assert said == (
        "Median |error| of τ_w by protocol at measurement noise 0 / 0, 0.5 / 0.1; in brackets, "
        "against the first at the last. crude: 2.00 %, no answer; fine: 0.200 %, 1.00 %."
    )
    quiet = {key: sizes for key, sizes in ERRORS.items() if key[1] == QUIET}
    louder = cases_of(quiet | {(name, LOUD): quiet[name, QUIET] for name in ("crude", "fine")})
    said = ANSWERS.make(ALONG | {"show": "every"}, STUDY, louder)
    assert said.endswith("crude: 2.00 %, 2.00 %; fine: 0.200 %, 0.200 % (× 0.100).")


def test_the_figure_needs_a_noise():
    with pytest.raises(InputError, match="does not sweep"):
        FIGURES.make("methods", STUDY, pd.DataFrame([case(0), case(1)]), None)


def test_every_measure_of_an_answer_is_told_with_its_own_summary():
    both = ("median timescale-error", "mean length-scale-error")
    said = ANSWERS.make(ALONG | {"measure": both}, STUDY, cases_of(ERRORS))
    assert "Median |error| of τ_w by protocol" in said
    assert "Mean |error| of L_w by protocol" in said
    settings = {"measure": both, "compare": "settings"}
    said = ANSWERS.make(settings, STUDY, cases_of(ERRORS))
    assert said.startswith("Median |error| of τ_w and mean |error| of L_w (")


@pytest.mark.parametrize(
    ("factor", "level", "words"),
    [
        ("flights.together", 2.0, "number of flights 2"),
        ("flights.duration", 5.0, "duration 5 s"),
        ("flights.thrust_acceleration", "[5,3]", "thrust acceleration 5 / 3 m/s²"),
        ("readout.length_scale", "signed-sum", "length scale signed-sum"),
        ("flights.duration", None, "duration not set"),
    ],
)
def test_a_level_in_words(factor, level, words):
    assert at_level(factor, level) == words
