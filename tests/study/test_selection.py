import math
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from sparsefit.errors import InputError
from sparsefit.study.evidence.candidates import measure_of, paired_interval
from sparsefit.study.evidence.selection import CRITERIA, select
from sparsefit.study.report.render import to_csv, to_markdown

FLIGHTS = 12


def cases(sizes, *, flights=FLIGHTS, levels=({},), seconds=None, failed=()):
    """`sizes`: back-end -> (|% error| of tau_w on validate, on evaluate); errors alternate."""
    rows = []
    for flight in range(flights):
        for level in levels:
            for backend, (validate, evaluate) in sizes.items():
                split = "validate" if flight % 2 else "evaluate"
                size = (validate if split == "validate" else evaluate) * (-1) ** (flight // 2)
                missing = (backend, flight) in failed
                tau = math.nan if missing else 0.5 * (1 + size / 100)
                rows.append(
                    {
                        "case_id": f"{flight:04d}-{backend}-{level}",
                        "flight": flight,
                        "split": split,
                        "protocol": "matched",
                        "backend": backend,
                        "label": backend,
                        "settings": f'{{"of":"{backend}"}}',
                        "status": "timeout" if missing else "ok",
                        "true_mean_velocity": 10.0,
                        "true_length_scale": 5.0,
                        "true_timescale": 0.5,
                        "est_mean_velocity": math.nan if missing else 5.0 / tau,
                        "est_length_scale": math.nan if missing else 5.0,
                        "est_timescale": tau,
                        "hit": None if missing else True,
                        "certificate_kind": "duality_gap",
                        "certificate": 1e-9,
                        "seconds": (seconds or {}).get(backend, 0.1),
                        **level,
                    }
                )
    return pd.DataFrame(rows)


def study(frame):
    return SimpleNamespace(
        name="demo", question="?", seed=1, hash="ab", planned=len(frame), given={}, tables=(),
        figures=(),
    )  # fmt: skip


def chosen(frame, **options):
    return select(study(frame), frame, **options)


def test_the_winner_is_that_of_validate_and_is_scored_on_evaluate():
    selection = chosen(cases({"lasso": (2.0, 9.0), "stlsq": (3.0, 1.0), "slow": (30.0, 30.0)}))
    assert selection.winner.of("backend") == "lasso"
    assert selection.winner.of("settings") == '{"of":"lasso"}'
    assert selection.winner.validate == pytest.approx(2.0)
    assert selection.winner.evaluate == pytest.approx(9.0)
    assert (selection.candidates, selection.eligible) == (3, 3)
    rows = {row[2]: row for row in selection.table.rows}
    assert [row[2] for row in selection.table.rows] == ["lasso", "stlsq", "slow"]
    assert rows["lasso"][-3:] == (None, None, None)
    # The errors have one size, so every resample has the same difference.
    assert rows["stlsq"][-3:] == pytest.approx((-8.0, -8.0, -8.0))
    assert rows["slow"][-3:] == pytest.approx((21.0, 21.0, 21.0))
    assert "seed 0" in to_markdown(selection.table)


def test_a_failure_counts_as_a_hundred_percent():
    frame = cases({"lasso": (2.0, 2.0), "stlsq": (10.0, 2.0)}, failed={("lasso", 1)})
    selection = chosen(frame)
    assert selection.winner.of("backend") == "stlsq"
    assert selection.table.rows[1][4] == pytest.approx((5 * 2.0 + 100.0) / 6)
    assert selection.table.rows[1][5] == pytest.approx(100 / 6)
    median = chosen(frame, criterion="median-absolute-percentage-error-timescale")
    assert median.winner.of("backend") == "lasso"
    assert median.winner.validate == pytest.approx(2.0)
    assert "counting as 100 %" in selection.table.notes[0]


def test_every_criterion_reads_its_own_parameter():
    frame = cases({"lasso": (25.0, 25.0)}, flights=4)
    by_name = {name: measure_of(name).values(frame) for name in CRITERIA}
    assert len(CRITERIA) == 6
    assert by_name["mean-absolute-percentage-error-length_scale"].tolist() == [0.0] * 4
    assert by_name["mean-absolute-percentage-error-timescale"] == pytest.approx(25.0)
    speeds = by_name["mean-absolute-percentage-error-mean_velocity"]
    assert speeds == pytest.approx([20.0, 20.0, 100 / 3, 100 / 3])


class TestLimits:
    frame = cases(
        {"lasso": (2.0, 2.0), "stlsq": (3.0, 3.0)},
        seconds={"lasso": 4.0, "stlsq": 0.5},
        failed={("stlsq", 1)},
    )

    def test_time(self):
        selection = chosen(self.frame, max_seconds=1.0)
        assert (selection.winner.of("backend"), selection.eligible) == ("stlsq", 1)
        assert selection.winner.seconds == 0.5

    def test_failure_rate(self):
        assert chosen(self.frame, max_failure_rate=0.1).winner.of("backend") == "lasso"
        assert chosen(self.frame, max_failure_rate=0.1).winner.failure_rate == 0.0

    def test_none_keeps_them_and_the_closest_is_named(self):
        with pytest.raises(InputError, match=r"none of the 2 candidates .* matched: stlsq, "):
            chosen(self.frame, max_failure_rate=0.1, max_seconds=1.0)

    @pytest.mark.parametrize("limit", [{"max_failure_rate": 2.0}, {"max_seconds": 0.0},
                                       {"max_failure_rate": math.nan}])  # fmt: skip
    def test_limits_that_mean_nothing(self, limit):
        with pytest.raises(InputError, match="must be"):
            chosen(self.frame, **limit)


class TestRefusals:
    frame = cases({"lasso": (2.0, 2.0), "stlsq": (3.0, 3.0)})

    def test_no_split(self):
        with pytest.raises(InputError, match=r"no flights to evaluate or to validate: .*\[split\]"):
            chosen(self.frame.assign(split="all"))

    def test_unfinished(self):
        with pytest.raises(InputError, match="unfinished, 23 of 24 planned cases"):
            select(study(self.frame), self.frame.iloc[1:])

    def test_rows_of_one_candidate_missing(self):
        short = self.frame.iloc[:-1]
        with pytest.raises(InputError, match="not tried on the same flights"):
            chosen(short)

    def test_a_case_twice(self):
        with pytest.raises(InputError, match="a case twice"):
            chosen(pd.concat([self.frame, self.frame.iloc[:1]]))

    def test_a_row_without_status(self):
        with pytest.raises(InputError, match="without a status"):
            chosen(self.frame.assign(status=[None, *self.frame["status"].iloc[1:]]))

    def test_a_flight_in_both_splits(self):
        split = self.frame["split"].to_numpy().copy()
        split[0] = "validate"
        with pytest.raises(InputError, match="flight 0 in both splits"):
            chosen(self.frame.assign(split=split))

    def test_unknown_criterion(self):
        with pytest.raises(InputError, match="did you mean"):
            chosen(self.frame, criterion="mean-absolute-percentage-error-timescal")


class TestFactors:
    def test_a_factor_of_the_estimator_is_chosen(self):
        levels = ({"library.target": "a"}, {"library.target": "b"})
        frame = cases({"lasso": (2.0, 2.0)}, levels=levels)
        worse = frame["library.target"] == "a"
        frame.loc[worse, "est_timescale"] = 0.5 * 1.5
        selection = chosen(frame)
        assert selection.winner.factors == {"library.target": "b"}
        assert selection.candidates == 2

    def test_a_factor_of_the_flights_is_a_condition(self):
        levels = ({"flights.velocity_noise": 0.0}, {"flights.velocity_noise": 0.5})
        frame = cases({"lasso": (2.0, 2.0)}, levels=levels)
        frame.loc[frame["flights.velocity_noise"] == 0.5, "est_timescale"] = 0.5 * 1.2
        selection = chosen(frame)
        assert selection.winner.factors == {}
        assert selection.candidates == 1
        assert selection.winner.validate == pytest.approx((2.0 + 20.0) / 2)


class TestInterval:
    rng = np.random.default_rng(5)
    first, second = rng.exponential(5.0, (40, 1)), rng.exponential(5.0, (40, 1))

    def test_it_is_seeded(self):
        one = paired_interval(self.first, self.second, "mean", 3)
        assert one == paired_interval(self.first, self.second, "mean", 3)
        assert one != paired_interval(self.first, self.second, "mean", 4)

    def test_it_agrees_with_the_normal_approximation(self):
        low, high = paired_interval(self.first, self.second, "mean", 3)
        difference = (self.first - self.second).ravel()
        half = 1.96 * difference.std() / math.sqrt(difference.size)
        assert low == pytest.approx(difference.mean() - half, abs=0.25 * half)
        assert high == pytest.approx(difference.mean() + half, abs=0.25 * half)

    def test_it_is_paired(self):
        low, high = paired_interval(self.first + 1.0, self.first, "mean", 3)
        assert (low, high) == pytest.approx((1.0, 1.0))


def test_the_order_of_the_rows_does_not_matter_to_the_numbers():
    frame = cases({"lasso": (2.0, 9.0), "stlsq": (3.0, 1.0)})
    frame["est_timescale"] *= np.random.default_rng(1).uniform(0.9, 1.1, len(frame))
    shuffled = frame.sample(frac=1.0, random_state=2)
    assert to_csv(chosen(frame).table) == to_csv(chosen(shuffled).table)
