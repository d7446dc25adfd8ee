"""Protocols against measurement noise: medians, and the sentences that they give."""

import math
from types import SimpleNamespace

import pandas as pd
import pytest
from test_tables import case

from sparsefit.errors import InputError
from sparsefit.study.evidence.answers import ANSWERS
from sparsefit.study.evidence.methods import NOISE, lines, median_size, methods, noise_label
from sparsefit.study.report.figures import FIGURES

STUDY = SimpleNamespace(name="demo")
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
    assert noise_label("[0.05,0.01]") == "0.05 / 0.01"
    assert noise_label("[0,0]") == "0 / 0"
    assert noise_label("all") == "all"


def test_a_failure_is_an_infinite_error():
    cases = cases_of(ERRORS)
    sizes = [median_size(cases[(cases.protocol == p) & (cases[NOISE] == n)]) for p, n in ERRORS]
    assert sizes == [pytest.approx(2.0), pytest.approx(0.2), math.inf, pytest.approx(1.0)]


def test_table_by_hand():
    table = methods(STUDY, cases_of(ERRORS))
    assert [column.full_heading for column in table.columns] == [
        "back-end", "protocol", "noise 0 / 0 [%]", "noise 0.5 / 0.1 [%]", "failures",
    ]  # fmt: skip
    assert table.rows[0] == ("lasso", "crude", pytest.approx(2.0), math.inf, "2/6")
    assert table.rows[1] == ("lasso", "fine", pytest.approx(0.2), pytest.approx(1.0), "1/6")


def test_rows_of_one_setting_stand_together():
    other = cases_of(ERRORS, settings='{"alpha_fraction": 0.3}')
    both = pd.concat([cases_of(ERRORS, settings='{"alpha_fraction": 0.1}'), other])
    names = [(row[0], row[1]) for row in methods(STUDY, both).rows]
    assert [name[1] for name in names] == ["crude", "fine"] * 2
    assert len({name[0] for name in names[:2]}) == 1
    assert len(lines(both)) == 4


def test_derivatives_answer_by_hand():
    one = cases_of(ERRORS, settings='{"alpha_fraction": 0.1}')
    worse = {key: tuple(e and 3 * e for e in sizes) for key, sizes in ERRORS.items()}
    other = cases_of(worse, settings='{"alpha_fraction": 0.3}')
    said = ANSWERS["derivatives"](STUDY, one)
    assert "At 0 / 0 from 0.20 % (fine) to 2.0 % (crude)" in said
    assert "at 0.5 / 0.1 from 1.0 % (fine) to no answer (crude)" in said
    assert said.endswith("for any one derivative, move it not at all.")
    said = ANSWERS["derivatives"](STUDY, pd.concat([one, other]))
    assert said.endswith("move it by a factor of at most 3.0.")


def test_what_else_is_swept_is_told_apart():
    parts = [cases_of(ERRORS, **{"readout.refine": level}) for level in ("none", "some")]
    said = ANSWERS["derivatives"](STUDY, pd.concat(parts))
    assert "With refine = none, at 0 / 0" in said
    assert "With refine = some, at 0 / 0" in said


def test_vehicle_answer_by_hand():
    said = ANSWERS["vehicle"](STUDY, cases_of(ERRORS))
    assert said == (
        "Median |error| of τ_w at measurement noise 0 / 0, 0.5 / 0.1 (m/s / m): "
        "crude 2.0 %, no answer; fine 0.20 %, 1.0 %; in brackets, against crude at the last noise."
    )
    quiet = {key: sizes for key, sizes in ERRORS.items() if key[1] == QUIET}
    assert "crude 2.0 %; fine 0.20 % (× 0.10);" in ANSWERS["vehicle"](STUDY, cases_of(quiet))


def test_the_figure_needs_a_noise():
    with pytest.raises(InputError, match="does not sweep"):
        FIGURES["methods"](STUDY, pd.DataFrame([case(0), case(1)]), None)
