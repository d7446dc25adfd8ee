import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from sparsefit.errors import InputError
from sparsefit.study.evidence.contrasts import contrast, exchanged
from sparsefit.study.evidence.measure import Failure
from sparsefit.study.evidence.measures import MEASURES
from sparsefit.study.evidence.profiles import profile_of
from sparsefit.study.evidence.resampling import by_flight, interval_of
from sparsefit.study.evidence.tables import TABLES

STUDY = SimpleNamespace(name="demo", reference=None)
MISSED = replace(MEASURES["timescale-error"], failure=Failure.MISS, summary="mean")
RNG = np.random.default_rng(8)
SIZES = {"lasso": RNG.exponential(2.0, 30), "stlsq": RNG.exponential(2.0, 30) + 1.5}


def cases(sizes=SIZES, *, failed=(), protocols=("paper",)):
    """|% error| of tau_w by back-end and flight, the same for every protocol."""
    rows = []
    for protocol in protocols:
        for backend, errors in sizes.items():
            for flight, error in enumerate(errors):
                missing = (backend, flight) in failed
                estimate = (math.nan,) * 3 if missing else (5.0, 5.0, 0.5 * (1 + error / 100))
                rows.append(
                    {
                        "flight": flight, "protocol": protocol, "backend": backend,
                        "label": backend, "settings": "{}",
                        "status": "error" if missing else "ok",
                        "true_mean_velocity": 10.0, "true_length_scale": 5.0,
                        "true_timescale": 0.5, "est_mean_velocity": estimate[0],
                        "est_length_scale": estimate[1], "est_timescale": estimate[2],
                    }
                )  # fmt: skip
    return pd.DataFrame(rows)


def of(frame, backend):
    return frame[frame["backend"] == backend]


def rows(frame, **options):
    entry = {"name": "contrasts", **options}
    table = TABLES.make(entry, STUDY, frame)
    names = [column.full_heading for column in table.columns]
    return [dict(zip(names, row, strict=True)) for row in table.rows]


def test_a_contrast_is_the_mean_of_paired_differences():
    frame = cases()
    made = contrast(MISSED, of(frame, "lasso"), of(frame, "stlsq"))
    apart = SIZES["lasso"] - SIZES["stlsq"]
    assert made.effect == pytest.approx(apart.mean())
    half = 1.96 * apart.std() / math.sqrt(30)
    assert (made.low, made.high) == pytest.approx(
        (apart.mean() - half, apart.mean() + half), abs=0.15 * half
    )
    assert made.flights == 30


def test_the_order_of_the_rows_pairs_nothing_else():
    frame = cases()
    shuffled = frame.sample(frac=1.0, random_state=1)
    first = contrast(MISSED, of(frame, "lasso"), of(frame, "stlsq"))
    second = contrast(MISSED, of(shuffled, "lasso"), of(shuffled, "stlsq"))
    assert second.effect == pytest.approx(first.effect)
    assert second.high - second.low == pytest.approx(first.high - first.low, rel=0.1)


def test_exchanges_are_the_permutation_test_of_scipy():
    first, second = RNG.exponential(2.0, 12), RNG.exponential(2.0, 12) + 0.8
    theirs = stats.permutation_test(
        (first, second), lambda x, y, axis: x.mean(axis) - y.mean(axis),
        permutation_type="samples", vectorized=True, n_resamples=np.inf,
    )  # fmt: skip
    ours = exchanged(MISSED, first[:, None], second[:, None])
    assert ours == pytest.approx(theirs.pvalue, abs=0.02)
    assert exchanged(MISSED, first[:, None], first[:, None]) == 1.0


def test_a_failure_is_a_miss_and_counts_on_its_own_flight():
    frame = cases({"lasso": np.full(10, 2.0), "stlsq": np.full(10, 2.0)}, failed={("stlsq", 3)})
    made = contrast(MISSED, of(frame, "lasso"), of(frame, "stlsq"))
    assert made.effect == pytest.approx(-9.8)
    assert (made.ok, made.planned) == ((10, 9), (10, 10))
    assert made.low <= made.effect <= made.high == 0.0  # most draws have the flight, some have not


def test_declared_contrasts_are_adjusted_together_and_a_tie_is_called_one():
    frame = cases(SIZES | {"same": SIZES["lasso"] + RNG.normal(0, 0.5, 30)})
    declared = [["lasso", "stlsq"], ["lasso", "same"]]
    first, second = rows(frame, contrasts=declared)
    assert first["verdict"] == "lasso is better"
    assert first["p (Holm)"] == pytest.approx(min(1.0, 2 * first["p"]))
    assert second["verdict"] == "tie"
    assert second["p (Holm)"] == second["p"]
    assert (first["ok / n first"], first["flights"]) == ("30/30", 30)


def test_without_any_each_setting_stands_against_the_first():
    (only,) = rows(cases())
    assert (only["first"], only["second"]) == ("paper: stlsq", "paper: lasso")
    assert only["verdict"] == "paper: lasso is better"


def test_protocols_may_be_compared_and_levels_have_rows_of_their_own():
    frame = cases(protocols=("grid", "refined"))
    better = frame["protocol"] == "refined"
    frame.loc[better, "est_timescale"] = 0.5 + (frame["est_timescale"][better] - 0.5) / 4
    (row,) = rows(frame, contrasts=[["refined", "grid"]])
    assert row["verdict"] == "refined is better"
    by_protocol = rows(frame, contrasts=[["lasso", "stlsq"]], along="protocol")
    assert [row["protocol"] for row in by_protocol] == ["grid", "refined"]
    assert by_protocol[1]["effect"] == pytest.approx(by_protocol[0]["effect"] / 4)


@pytest.mark.parametrize(
    ("declared", "words"),
    [([["laso", "stlsq"]], 'contrasts: "laso" is unknown: did you mean "lasso"'),
     ([["lasso", "paper"]], "no two of a kind")],
)  # fmt: skip
def test_what_cannot_be_compared_is_refused(declared, words):
    with pytest.raises(InputError, match=words):
        rows(cases(), contrasts=declared)


def test_intervals_draw_flights_not_cases():
    """A flight that is there four times is one flight: the interval stays as wide."""
    once = of(cases(), "lasso")
    low, high = interval_of(MISSED, once)
    assert interval_of(MISSED, pd.concat([once] * 4)) == pytest.approx((low, high))
    assert low < MISSED.summarise(once) < high
    one = interval_of(MISSED, once[:1])
    assert all(map(math.isnan, one))


def test_flights_that_all_failed_have_no_interval_and_no_warning():
    failed = cases({"lasso": [1.0] * 4}, failed=[("lasso", flight) for flight in range(4)])
    assert all(map(math.isnan, interval_of(MEASURES["timescale-size"], failed)))


def test_values_by_flight():
    frame = pd.concat([cases({"lasso": [1.0, 2.0]}), cases({"lasso": [3.0]})])
    grid = by_flight(MISSED.per_case(frame), frame)
    np.testing.assert_allclose(grid, [[1.0, 3.0], [2.0, np.nan]])


def test_a_profile_ends_at_the_share_that_answered():
    frame = cases({"lasso": [0.5, 4.0, 1.0, 2.0]}, failed={("lasso", 1)})
    errors, shares = profile_of(MISSED, frame)
    assert errors == pytest.approx([0.5, 1.0, 2.0])
    assert shares == pytest.approx([25.0, 50.0, 75.0])
    entry = {"name": "profiles", "limits": [0.7, 1.5, 99.0]}
    (row,) = TABLES.make(entry, STUDY, frame).rows
    assert [cell.partition(" ")[0] for cell in row[-3:]] == ["25.0", "50.0", "75.0"]
    assert "(0 to 75.0)" in row[-3]
    (row,) = TABLES.make(entry | {"limits": [0.1]}, STUDY, frame).rows
    assert row[-1] == "0 (0 to 49.0)"  # Wilson's, of none of 4


def test_few_measures_have_their_intervals_beside_them():
    entry = {"compare": "settings", "measure": ["mean timescale-error"], "failures": "miss"}
    table = TABLES.make(entry, STUDY, cases())
    assert table.columns[-1].full_heading == "mean |error| 95 % [%]"
    low, high = map(float, table.rows[0][-1].split(" to "))
    assert low < table.rows[0][-2] < high
    assert "bootstrap over flights" in table.notes[-1]
    without = TABLES.make(entry | {"interval": False}, STUDY, cases())
    assert len(without.columns) == len(table.columns) - 1


def test_a_summary_lies_in_its_interval_with_flights_without_a_flow():
    """Still air has no error to miss: neither the summary nor its interval counts it."""
    frame = of(cases(failed={("lasso", 3)}), "lasso").assign(flow="cellular")
    still = frame.assign(flow="none", status="unidentifiable", flight=frame["flight"] + 100)
    both = pd.concat([frame, still])
    assert MISSED.summarise(both) == MISSED.summarise(frame)
    low, high = interval_of(MISSED, both)
    assert low < MISSED.summarise(both) < high
