import math

import numpy as np
import pandas as pd
import pytest

from sparsefit.errors import InputError
from sparsefit.study.evidence import provenance, record, tables, write_selection
from sparsefit.study.measures import measure
from sparsefit.study.selection import headline, lines, select
from sparsefit.study.trials import Latency
from tests.study.frames import case, frame, select_rule, solve, study

FLIGHTS = 12


def cases(sizes, *, flights=FLIGHTS, conditions=("",), failed=(), **more):
    """`sizes`: back-end -> (|% error| of tau_w on validate, on evaluate); errors alternate."""
    rows = []
    for flight in range(flights):
        for condition in conditions:
            for backend, pair in sizes.items():
                split = "validate" if flight % 2 else "evaluate"
                size = pair[split == "evaluate"] * (-1) ** (flight // 2)
                missing = (backend, flight) in failed
                tau = 0.5 * (1 + size / 100)
                rows.append(case(
                    flight, None if missing else (0.0, 0.0), "timeout" if missing else "ok",
                    split=split, backend=backend, label=backend, condition=condition,
                    est_timescale=math.nan if missing else tau, **more,
                ))  # fmt: skip
    return frame(*rows)


def chosen(made, *, latencies=None, refusals=None, **rule):
    return select(study(made), select_rule(**rule), latencies=latencies or {}, refusals=refusals)


def by_name(selection):
    return {each.title: each for each in selection.ranked}


def test_the_best_of_validate_is_chosen_and_scored_on_evaluate():
    selection = chosen(cases({"lasso": (2.0, 9.0), "stlsq": (3.0, 1.0), "slow": (30.0, 30.0)}))
    assert list(by_name(selection)) == ["lasso", "stlsq", "slow"]
    best, other = selection.chosen, by_name(selection)["stlsq"]
    assert best.title == "lasso"
    assert (best.validate, best.evaluate) == pytest.approx((2.0, 9.0))
    # The errors have one size, so every resample has the same difference.
    assert (other.apart.effect, other.apart.low, other.apart.high) == pytest.approx((1, 1, 1))
    assert selection.regret.effect == pytest.approx(8.0)
    assert selection.hindsight is other
    assert "Regret: 8.00 % (8.00 to 8.00) against stlsq." in " ".join(lines(selection))


def test_the_simplest_within_the_margin_is_the_one_listed_first():
    made = cases({"plain": (2.1, 2.1), "fancy": (2.0, 2.0), "bad": (4.0, 4.0)})
    assert chosen(made, margin=0.04).chosen.title == "fancy"
    selection = chosen(made, margin=0.06)
    verdicts = {row[1]: row[2] for row in tables(selection)["selection"].rows}
    assert verdicts == {"plain": "chosen", "bad": "worse by 1.90",
                        "fancy": "better by 0.100, within the margin, less simple"}  # fmt: skip


def test_a_latency_that_was_disturbed_is_told():
    made = cases({"first": (2.0, 2.0), "fast": (2.0, 2.0)})
    times = {"first": Latency(0.2, 0.4, 90.0, 50, 0.8), "fast": Latency(0.1, 0.9, 80.0, 50)}
    selection = chosen(made, latencies=times)
    assert selection.chosen.title == "first"
    assert "80 % of the timed flights disturbed" in " ".join(lines(selection))


def test_equals_tie_and_the_first_sentence_can_be_read_aloud():
    made = cases({"lasso": (2.0, 2.0), "stlsq": (2.0, 2.0), "bad": (5.0, 5.0)}, reading="ladder")
    selection = chosen(made)
    assert [each.title for each in selection.tied] == ["stlsq"]
    assert selection.tied[0].apart.identical
    assert headline(selection) == "Use ladder; lasso or stlsq will do, lasso is the simplest."
    assert next(lines(selection)).startswith("Score: 2.00 % (2.00 to 2.00) on 6 flights")
    swept = made.assign(**{"readout.refine": np.where(made["label"] == "bad", "ladder", "none")})
    said = "Use ladder, refine none; any of 2 back-ends will do, lasso is the simplest."
    assert headline(chosen(swept)) == said
    every = chosen(made[made["label"] != "bad"])
    assert headline(every) == "Use ladder; any of 2 back-ends will do, lasso is the simplest."


def test_of_one_problem_there_is_no_interval_and_errors_are_of_rows_held_out():
    made = frame(*(solve("p0", name, 0.1, holdout_error=size)
                   for name, size in (("a", 0.2), ("b", 0.1))))  # fmt: skip
    selection = chosen(made, criterion="mean holdout-error")
    assert str(selection).startswith("Use b.\n- Score: 10.0 % on 1 problem.\n- Rule: mean held-out")
    assert "- Ties: not tested, 1 problem shows no spread." in str(selection)
    assert selection.tied == []


def test_nobody_is_recommended_by_an_infinite_score():
    made = cases({"lasso": (2.0, 2.0)}, failed={("lasso", n) for n in (1, 3, 5, 7)})
    assert "has a finite score" in headline(chosen(made, criterion="median timescale-error"))


def test_two_penalties_of_one_back_end_are_told_by_their_settings():
    made = cases({"0.1": (2.0, 2.0), "0.3": (2.0, 2.0)}, reading="ladder")
    made["settings"] = '{"alpha_fraction":' + made["backend"] + "}"
    made["title"] = "ladder: lasso with care " + made["backend"]
    said = "Use ladder; any of 2 candidates will do, lasso with care alpha_fraction=0.1 is"
    selection = chosen(made.assign(label="lasso with care", backend="lasso"))
    assert headline(selection) == f"{said} the simplest."


def test_a_noisy_difference_is_a_tie():
    made = cases({"lasso": (2.0, 2.0), "stlsq": (2.0, 2.0)}, flights=60)
    rng = np.random.default_rng(4)
    noise = np.where(made["backend"] == "stlsq", rng.normal(0.02, 1.0, len(made)), 0.0)
    made["est_timescale"] *= 1 + noise / 100
    other = by_name(chosen(made))["stlsq"].apart
    assert other.tie
    assert other.low < other.effect < other.high


@pytest.mark.parametrize("words", ["mean timescale-error", "95th percentile timescale-error",
                                   "rms timescale-size", "share silent-misses",
                                   "geometric mean timescale-error"])  # fmt: skip
def test_a_criterion_is_the_summary_of_its_measure(words):
    made = cases({"lasso": (4.0, 4.0)}, failed={("lasso", 3)})
    made["est_timescale"] *= np.random.default_rng(1).uniform(0.9, 1.1, len(made))
    scored, each = chosen(made, criterion=words).ranked[0], measure(words)
    for split, value in (("validate", scored.validate), ("evaluate", scored.evaluate)):
        assert value == pytest.approx(each.summary_of(each.values(made[made["split"] == split])))


TIMES = {"lasso": Latency(0.01, 4.0, 300.0, 50), "stlsq": Latency(0.01, 0.5, 90.0, 50)}


class TestConstraints:
    made = cases({"lasso": (2.0, 2.0), "stlsq": (3.0, 3.0)}, failed={("stlsq", 1)})

    @pytest.mark.parametrize(
        ("limit", "winner"),
        [({"max_failure": 0.1}, "lasso"), ({"max_latency_p99": 1.0}, "stlsq"),
         ({"max_memory": 100.0}, "stlsq"), ({"max_error": 2.5}, "lasso"),
         ({"max_silent_misses": 0.0}, "lasso")],
    )  # fmt: skip
    def test_each(self, limit, winner):
        assert chosen(self.made, latencies=TIMES, **limit).chosen.title == winner

    def test_where_none_keeps_them_the_closest_is_named(self, tmp_path):
        limits = {"max_failure": 0.1, "max_latency_p99": 1.0}
        selection = chosen(self.made, latencies=TIMES, **limits)
        assert (selection.chosen, selection.regret) == (None, None)
        said = " ".join(lines(selection))
        assert "max_failure: refuses 1; the closest is stlsq" in said
        assert "latency 4000 ms, 1000 ms is the most" in said
        assert headline(selection) == "No candidate of 2 keeps every constraint."
        page = write_selection(study(self.made), selection, tmp_path)[-1]
        assert "No candidate of 2" in page.read_text()
        assert provenance(study(self.made), selection) == {}

    def test_nobody_keeps_a_limit_of_the_error_by_never_answering(self):
        mute = {("mute", flight) for flight in range(FLIGHTS)}
        made = cases({"mute": (1.0, 1.0), "lasso": (9.0, 9.0)}, failed=mute)
        assert chosen(made, max_error=5.0).chosen is None

    def test_what_was_not_timed_keeps_no_limit_of_time(self):
        selection = chosen(self.made, max_memory=100.0, max_failure=0.1)
        assert selection.chosen is None
        words = {each.title: [breach.words for breach in each.breaches]
                 for each in selection.ranked}  # fmt: skip
        assert words["lasso"] == ["peak memory not measured, 100 MB is the most"]
        assert len(words["stlsq"]) == 1  # what fails on flights need not be timed

    def test_what_cannot_be_on_board_is_not_chosen(self):
        selection = chosen(self.made, refusals={"lasso": "its search needs the whole flight"})
        assert [each.title for each in selection.ranked] == ["stlsq"]
        last = tables(selection)["selection"].rows[-1]
        assert last[:3] == ("–", "lasso", "not on board: its search needs the whole flight")


class TestRegimes:
    """Back-end `calm` is good in the first condition only, `steady` the same in both."""

    made = cases({"calm": (1.0, 1.0), "steady": (4.0, 4.0)}, conditions=("air", "storm"))
    made.loc[(made["condition"] == "storm") & (made["backend"] == "calm"), "est_timescale"] = 0.53

    def test_over(self):
        average, worst, one = (chosen(self.made, over=over).chosen
                               for over in ("average", "worst", "air"))  # fmt: skip
        assert (average.title, average.validate) == ("calm", pytest.approx(3.5))
        assert average.by_regime == pytest.approx([1.0, 6.0])
        assert (worst.title, worst.validate) == ("steady", pytest.approx(4.0))
        assert (one.title, one.validate) == ("calm", pytest.approx(1.0))
        with pytest.raises(InputError, match="did you mean"):
            chosen(self.made, over="strom")

    def test_a_constraint_holds_in_every_regime(self):
        selection = chosen(self.made, max_silent_misses=0.4)
        assert selection.chosen.title == "steady"
        (breach,) = by_name(selection)["calm"].breaches
        assert breach.words == "silent misses 100 % in storm, 40 % is the most"

    def test_flights_without_a_flow_have_no_error_but_may_be_missed(self):
        made = self.made.assign(flow=np.where(self.made["condition"] == "storm", "none", "cells"))
        selection = chosen(made, max_failure=0.0, max_silent_misses=0.5)
        assert selection.chosen is None
        assert {each.constraint for each in selection.ranked[0].breaches} == {"max_silent_misses"}


class TestRefusals:
    made = cases({"lasso": (2.0, 2.0), "stlsq": (3.0, 3.0)})

    def test_unfinished(self):
        of = study(self.made)
        of.plan = lambda: pd.concat([self.made] * 2)
        with pytest.raises(InputError, match="unfinished, 24 of 48 planned cases"):
            select(of, select_rule(), latencies={})

    def test_in_a_line(self):
        unseen = self.made.assign(est_timescale=np.nan)
        for made, words in (
            (self.made.assign(split="all"), r"no flights to evaluate or to validate: .*\[split\]"),
            (self.made.iloc[:-1], "stlsq was not tried on the same flights"),
            (unseen, r"no case with a number for .* prediction_flights"),
        ):
            with pytest.raises(InputError, match=words):
                chosen(made)


def test_the_order_of_the_rows_does_not_matter():
    made = cases({"lasso": (2.0, 9.0), "stlsq": (3.0, 1.0)})
    made["est_timescale"] *= np.random.default_rng(1).uniform(0.9, 1.1, len(made))
    shuffled = made.sample(frac=1.0, random_state=2).sort_values("backend", kind="stable")
    first, second = ([row.validate for row in chosen(each).ranked] for each in (made, shuffled))
    assert first == pytest.approx(second)


def test_fresh_flights_check_the_choice(tmp_path):
    made = cases({"lasso": (2.0, 9.0), "stlsq": (3.0, 1.0)})
    times = {"lasso": Latency(0.01, 0.02, 90.0, 50), "stlsq": Latency(0.1, 0.12, 90.0, 50)}
    selection = chosen(made, latencies=times, margin=0.6)
    assert selection.contenders == ["lasso", "stlsq"]
    new = cases({"lasso": (4.0, 4.0), "stlsq": (1.0, 1.0)}, flights=20).assign(split="all")
    told = select(study(new), selection.rule, latencies=times, candidate="lasso")
    assert (told.units, told.chosen.evaluate) == ({"all": 20}, pytest.approx(4.0))
    assert (told.hindsight.title, told.regret.effect) == ("stlsq", pytest.approx(3.0))
    files = {path.name: path for path in write_selection(study(made), selection, tmp_path, told)}
    assert list(files)[-1] == "evidence.md"
    assert "Fresh seeds: 4.00 %" in files["evidence.md"].read_text()
    assert files["pareto.svg"].read_bytes().startswith(b"<?xml")
    assert record(selection, told)["check"]["hindsight"] == "stlsq"
    assert provenance(study(made), selection)["validate"] == pytest.approx(2.0)
