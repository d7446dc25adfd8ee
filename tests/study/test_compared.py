import math

import numpy as np
import pandas as pd
import pytest

from sparsefit.errors import InputError
from sparsefit.study.evidence.compared import changes_table, compared, effects_table, worse
from sparsefit.study.report.comparison import write_comparison

NAMES = ("old", "new")


def cases(taus, *, backend="lasso", status="ok"):
    return pd.DataFrame(
        {
            "case_id": [f"{flight:04d}-{backend}" for flight in range(len(taus))],
            "flight": range(len(taus)), "protocol": "paper", "backend": backend,
            "label": backend, "settings": "{}", "identity": backend,
            "status": [status if not math.isnan(tau) else "timeout" for tau in taus],
            "true_mean_velocity": 10.0, "true_length_scale": 5.0, "true_timescale": 0.5,
            "est_mean_velocity": np.where(np.isnan(taus), np.nan, 10.0),
            "est_length_scale": np.where(np.isnan(taus), np.nan, 5.0),
            "est_timescale": taus,
        }
    )  # fmt: skip


def test_the_same_is_the_same():
    frame = cases([0.5, 0.51, math.nan])
    both = compared(frame, frame.sample(frac=1.0, random_state=1), NAMES, 1e-6)
    assert not both.changed.any()
    assert both.sentence == (
        "0 of 3 cases changed, 0 of them in status; the largest change of a number is 0 %."
    )
    assert effects_table(both).rows[0][-1] == "tie"
    assert changes_table(both).rows == ()
    assert not worse(both, effects_table(both))


def test_changes_by_hand():
    first, second = cases([0.5, 0.5, 0.5, 0.5]), cases([0.5, 0.5 * (1 + 1e-9), 0.55, math.nan])
    both = compared(first, second, NAMES, 1e-6)
    assert both.change == pytest.approx([0.0, 1e-9, 1 / 11, math.inf], abs=1e-12)
    assert both.changed.tolist() == [False, False, True, True]
    assert both.restated.tolist() == [False, False, False, True]
    rows = changes_table(both).rows
    assert [row[0] for row in rows] == ["0003-lasso", "0002-lasso"]
    assert rows[0][2:5] == ("ok", "timeout", math.inf)
    assert rows[1][-2:] == pytest.approx((0.0, 10.0), abs=1e-9)
    assert worse(both, effects_table(both))  # an answer was lost


def test_what_only_one_has_is_counted():
    both = compared(cases([0.5, 0.5]), cases([0.5, 0.5, 0.5]), NAMES, 0.0)
    assert both.only == (0, 1)
    assert both.sentence.endswith("; 1 only in new.")


def test_renamed_cases_are_known_by_what_determines_their_numbers():
    first = cases([0.5, 0.6])
    second = first.assign(case_id=["a", "b"], protocol="renamed")
    assert len(compared(first, second, NAMES, 0.0).change) == 2
    with pytest.raises(InputError, match="old and new have no case in common"):
        compared(first, second.assign(identity="other"), NAMES, 0.0)


def test_what_is_no_study_of_flights_is_refused():
    with pytest.raises(InputError, match="new: holds no cases of flights, without a column flight"):
        compared(cases([0.5]), pd.DataFrame({"case_id": ["a"]}), NAMES, 0.0)


@pytest.mark.parametrize(("sign", "verdict"), [(1.0, "worse"), (-1.0, "better")])
def test_a_setting_is_worse_only_beyond_its_interval(sign, verdict):
    errors = np.random.default_rng(2).uniform(0.02, 0.1, 20)
    first, second = cases(0.5 * (1 + errors)), cases(0.5 * (1 + errors * (1 + 0.2 * sign)))
    both = compared(first, second, NAMES, 1e-6)
    effects = effects_table(both)
    (row,) = effects.rows
    assert row[-4] == pytest.approx(20.0 * sign * errors.mean())
    assert row[-1] == verdict
    assert worse(both, effects) == (verdict == "worse")


def test_pages(tmp_path):
    both = compared(cases([0.5, 0.6]), cases([0.5, math.nan]), ("old|run", "new"), 1e-6)
    written = write_comparison(
        both, (effects_table(both), changes_table(both)), tmp_path / "deep" / "folder"
    )
    page = written[-1].read_text()
    assert page.startswith("# old\\|run and new\n\n1 of 2 cases changed, 1 of them in status")
    assert (tmp_path / "deep" / "folder" / "comparison.svg").read_text().startswith("<?xml")
