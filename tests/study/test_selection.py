import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from sparsefit.codec import Place
from sparsefit.errors import InputError
from sparsefit.study.evidence.candidates import Criterion, candidates_of, measure_of
from sparsefit.study.evidence.selection import select
from sparsefit.study.evidence.selection_tables import regime_table, selection_table
from sparsefit.study.evidence.verdicts import headline, sentences
from sparsefit.study.report.evidence_page import evidence_files
from sparsefit.study.report.render import to_csv
from sparsefit.study.run.latency import Latency
from sparsefit.study.spec.design import Factor, Protocol
from sparsefit.study.spec.selection import SelectionRule, changed, read_selection

FLIGHTS = 12
NOISE = "flights.velocity_noise"


def cases(sizes, *, flights=FLIGHTS, levels=({},), worlds=("matched",), failed=()):
    """`sizes`: back-end -> (|% error| of tau_w on validate, on evaluate); errors alternate."""
    rows = []
    for flight in range(flights):
        for world, level, backend in (
            (world, level, backend) for world in worlds for level in levels for backend in sizes
        ):
            validate, evaluate = sizes[backend]
            split = "validate" if flight % 2 else "evaluate"
            size = (validate if split == "validate" else evaluate) * (-1) ** (flight // 2)
            missing = (backend, flight) in failed
            tau = math.nan if missing else 0.5 * (1 + size / 100)
            rows.append(
                {
                    "case_id": f"{flight:04d}-{backend}-{world}-{level}",
                    "flight": flight,
                    "split": split,
                    "protocol": world,
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
                    **level,
                }
            )
    return pd.DataFrame(rows)


def study(frame, *, protocols=None, sweep=()):
    named = dict.fromkeys(frame["protocol"])
    every = protocols or tuple(Protocol(name, {}) for name in named)
    return SimpleNamespace(
        name="demo", question="?", seed=1, hash="ab", planned=len(frame), given={}, tables=(),
        protocols=every, sweep=sweep, selection=SelectionRule(margin=0.0),
    )  # fmt: skip


def chosen(frame, *, latencies=None, of=None, **rule):
    rule = SelectionRule(**{"margin": 0.0, **rule})
    return select(of or study(frame), frame, rule=rule, latencies=latencies)


def names(selection):
    return [one.candidate.of("backend") for one in selection.ranked]


def by_name(selection):
    return {one.candidate.of("backend"): one for one in selection.ranked}


def test_the_best_of_validate_is_chosen_and_scored_on_evaluate():
    selection = chosen(cases({"lasso": (2.0, 9.0), "stlsq": (3.0, 1.0), "slow": (30.0, 30.0)}))
    assert names(selection) == ["lasso", "stlsq", "slow"]
    best = selection.chosen
    assert best.candidate.of("backend") == "lasso"
    assert (best.validate, best.evaluate) == pytest.approx((2.0, 9.0))
    # The errors have one size, so every resample has the same difference.
    other = by_name(selection)["stlsq"]
    assert (other.apart.effect, other.apart.low, other.apart.high) == pytest.approx((1.0, 1.0, 1.0))
    confirmed = other.confirmed
    assert (confirmed.effect, confirmed.low, confirmed.high) == pytest.approx((-8.0, -8.0, -8.0))
    assert selection.regret.effect == pytest.approx(8.0)
    assert selection.hindsight is other
    assert by_name(selection)["slow"].best == 0.0
    assert "the regret is 8.00 %" in " ".join(sentences(selection))


def test_the_simplest_within_the_margin_is_the_one_listed_first():
    frame = cases({"plain": (2.1, 2.1), "fancy": (2.0, 2.0), "bad": (4.0, 4.0)})
    assert chosen(frame, margin=0.04).chosen.candidate.of("backend") == "fancy"
    selection = chosen(frame, margin=0.06)
    assert selection.chosen.candidate.of("backend") == "plain"
    verdicts = {row[2]: row[-1] for row in selection_table(selection).rows}
    assert verdicts["plain"] == "chosen"
    assert verdicts["fancy"] == "better by 0.100 (0.100 to 0.100), within the margin, less simple"
    assert verdicts["bad"] == "worse by 1.90 (1.90 to 1.90)"
    assert selection.regret.effect == pytest.approx(0.1)


def test_the_simplest_may_be_the_fastest():
    frame = cases({"slow": (2.0, 2.0), "fast": (2.0, 2.0)})
    times = {0: Latency(0.2, 0.4, 90.0, 50), 1: Latency(0.1, 0.9, 80.0, 50)}
    assert chosen(frame, latencies=times).chosen.candidate.of("backend") == "slow"
    fastest = chosen(frame, latencies=times, simplest="fastest")
    assert fastest.chosen.candidate.of("backend") == "fast"
    with pytest.raises(InputError, match="needs measured latencies"):
        chosen(frame, simplest="fastest")


def test_equals_tie_and_share_the_probability_to_be_the_best():
    selection = chosen(cases({"lasso": (2.0, 2.0), "stlsq": (2.0, 2.0), "bad": (5.0, 5.0)}))
    assert [one.candidate.of("backend") for one in selection.tied] == ["stlsq"]
    assert [one.best for one in selection.ranked] == [0.5, 0.5, 0.0]
    assert math.isinf(selection.tied[0].apart.more_flights)
    assert "in a tie with 1 other:" in headline(selection)
    assert "1 of these gave the same numbers on every flight" in " ".join(sentences(selection))


def test_a_noisy_difference_is_a_tie_that_more_flights_would_end():
    frame = cases({"lasso": (2.0, 2.0), "stlsq": (2.0, 2.0)}, flights=60)
    rng = np.random.default_rng(4)
    noise = np.where(frame["backend"] == "stlsq", rng.normal(0.02, 1.0, len(frame)), 0.0)
    frame["est_timescale"] *= 1 + noise / 100
    other = by_name(chosen(frame))["stlsq"].apart
    assert other.tie
    assert other.low < 0 < other.high
    half = (other.high - other.low) / 2
    assert other.more_flights == max(1, math.ceil(30 * ((half / other.effect) ** 2 - 1)))


def test_a_failure_counts_as_a_hundred_percent():
    frame = cases({"lasso": (2.0, 2.0), "stlsq": (10.0, 2.0)}, failed={("lasso", 1)})
    selection = chosen(frame)
    assert selection.chosen.candidate.of("backend") == "stlsq"
    assert by_name(selection)["lasso"].validate == pytest.approx((5 * 2.0 + 100.0) / 6)
    median = chosen(frame, criterion="median timescale-error").chosen
    assert median.candidate.of("backend") == "lasso"
    assert median.validate == pytest.approx(2.0)


@pytest.mark.parametrize("words", ["mean timescale-error", "95th percentile timescale-error",
                                   "rms timescale-size", "share silent-misses",
                                   "geometric mean timescale-error",
                                   "mean-absolute-percentage-error-timescale"])  # fmt: skip
def test_a_criterion_is_the_summary_of_its_measure(words):
    frame = cases({"lasso": (4.0, 4.0)}, failed={("lasso", 3)})
    frame["est_timescale"] *= np.random.default_rng(1).uniform(0.9, 1.1, len(frame))
    rule = SelectionRule(criterion=words)
    scored = chosen(frame, criterion=words).chosen
    for split, value in (("validate", scored.validate), ("evaluate", scored.evaluate)):
        part = frame[frame["split"] == split]
        assert value == pytest.approx(measure_of(rule).summarise(part))


TIMES = {0: Latency(0.01, 4.0, 300.0, 50), 1: Latency(0.01, 0.5, 90.0, 50)}


class TestConstraints:
    frame = cases({"lasso": (2.0, 2.0), "stlsq": (3.0, 3.0)}, failed={("stlsq", 1)})

    @pytest.mark.parametrize(
        ("limits", "winner"),
        [
            ({"max_failure": 0.1}, "lasso"),
            ({"max_latency_p99": 1.0}, "stlsq"),
            ({"max_memory": 100.0}, "stlsq"),
            ({"max_error": 2.5}, "lasso"),
            ({"max_silent_misses": 0.0}, "lasso"),
        ],
    )
    def test_each(self, limits, winner):
        selection = chosen(self.frame, latencies=TIMES, **limits)
        assert selection.chosen.candidate.of("backend") == winner

    def test_none_keeps_them_and_the_binding_one_is_named(self):
        limits = {"max_failure": 0.1, "max_latency_p99": 1.0}
        selection = chosen(self.frame, latencies=TIMES, **limits)
        assert selection.chosen is None
        assert selection.regret is None
        said = " ".join(sentences(selection))
        assert "max_failure = 0.1 refuses 1 of 2; the closest is matched: stlsq with 16.7 %" in said
        assert "max_latency_p99 = 1 refuses 1 of 2; the closest is matched: lasso with 4000 ms" in (
            said
        )
        assert headline(selection) == "None of the 2 candidates keeps every constraint."
        assert b"None of the 2" in evidence_files(study(self.frame), selection)["evidence.md"]

    def test_nobody_keeps_a_limit_of_the_error_by_never_answering(self):
        mute = {("mute", flight) for flight in range(FLIGHTS)}
        frame = cases({"mute": (1.0, 1.0), "lasso": (9.0, 9.0)}, failed=mute)
        assert chosen(frame, max_error=5.0).chosen is None

    def test_what_was_not_timed_keeps_no_limit_of_time(self):
        assert chosen(self.frame, max_memory=100.0).chosen is None

    @pytest.mark.parametrize(
        ("limit", "words"),
        [
            ({"max_failure": 2.0}, "max_failure must be a share"),
            ({"max_latency_p99": 0.0}, "max_latency_p99 must be above 0"),
            ({"max_failure": math.nan}, "must be a share"),
            ({"margin": -0.1}, "margin must be a share"),
            ({"latency_flights": 0, "max_memory": 1.0}, "max_memory needs it"),
        ],
    )
    def test_limits_that_mean_nothing(self, limit, words):
        with pytest.raises(InputError, match=words):
            chosen(self.frame, **limit)


class TestRegimes:
    """Back-end `calm` is good in the first world only, `steady` the same in both."""

    worlds = ("calm air, on the grid", "storm, on the grid")
    protocols = (
        Protocol(worlds[0], {"readout.refine": "none"}),
        Protocol(worlds[1], {"readout.refine": "none", "flights.turbulence_ratio": 0.3}),
    )
    frame = cases({"calm": (1.0, 1.0), "steady": (4.0, 4.0)}, worlds=worlds)
    storm = (frame["protocol"] == worlds[1]) & (frame["backend"] == "calm")
    frame.loc[storm, "est_timescale"] = 0.5 * 1.06

    def of(self, **rule):
        return chosen(self.frame, of=study(self.frame, protocols=self.protocols), **rule)

    def test_worlds_are_regimes_and_readings_are_not(self):
        selection = self.of()
        assert selection.criterion.regimes == ("calm air, on the grid", "storm, on the grid")
        assert len(selection.ranked) == 2
        assert by_name(selection)["calm"].by_regime == pytest.approx([1.0, 6.0])

    def test_over(self):
        assert self.of().chosen.candidate.of("backend") == "calm"
        assert self.of().chosen.validate == pytest.approx(3.5)
        worst = self.of(over="worst").chosen
        assert (worst.candidate.of("backend"), worst.validate) == ("steady", pytest.approx(4.0))
        one = self.of(over="calm air, on the grid").chosen
        assert (one.candidate.of("backend"), one.validate) == ("calm", pytest.approx(1.0))
        with pytest.raises(InputError, match="did you mean"):
            self.of(over="calm air on the grid")

    def test_a_constraint_holds_in_every_regime(self):
        selection = self.of(max_silent_misses=0.4)
        assert selection.chosen.candidate.of("backend") == "steady"
        (breach,) = by_name(selection)["calm"].breaches
        assert breach.words == "silent misses 100 % in storm, on the grid, 40.0 % is the most"

    def test_the_table_of_regimes(self):
        table = regime_table(self.of())
        assert [row[3:6] for row in table.rows] == [
            pytest.approx((1.0, 6.0, 3.5)),
            pytest.approx((4.0, 4.0, 4.0)),
        ]

    def test_worlds_and_readings_share_a_protocol(self):
        readings = ("storm, on the grid", "storm, refined", "calm, on the grid", "calm, refined")
        protocols = tuple(
            Protocol(name, {"readout.refine": name[-4:]}
                     | ({"flights.turbulence_ratio": 0.3} if "storm" in name else {}))
            for name in readings
        )  # fmt: skip
        frame = cases({"lasso": (1.0, 1.0)}, worlds=readings)
        selection = chosen(frame, of=study(frame, protocols=protocols))
        assert selection.criterion.regimes == ("storm", "calm")
        titles = [one.candidate.title for one in selection.ranked]
        assert titles == ["on the grid: lasso", "refined: lasso"]

    def test_a_swept_condition_is_a_regime_and_a_factor_of_the_estimator_is_chosen(self):
        levels = [{NOISE: noise, "library.target": one} for one in "ab" for noise in (0.0, 0.5)]
        frame = cases({"lasso": (2.0, 2.0)}, levels=levels)
        frame.loc[frame["library.target"] == "a", "est_timescale"] = 0.5 * 1.5
        sweep = (Factor(NOISE, (0.0, 0.5)), Factor("library.target", ("a", "b")))
        selection = chosen(frame, of=study(frame, sweep=sweep))
        assert selection.criterion.regimes == ("velocity noise 0 m/s", "velocity noise 0.5 m/s")
        assert selection.chosen.candidate.factors == {"library.target": "b"}
        assert len(selection.ranked) == 2

    def test_flights_without_a_flow_have_no_error_but_may_be_missed(self):
        frame = self.frame.assign(flow="cellular")
        frame.loc[frame["protocol"] == self.worlds[1], "flow"] = "none"
        of = study(frame, protocols=self.protocols)
        selection = chosen(frame, of=of, max_failure=0.0, max_silent_misses=0.5)
        assert selection.chosen is None
        assert {one.constraint for one in selection.ranked[0].breaches} == {"max_silent_misses"}


class TestRefusals:
    frame = cases({"lasso": (2.0, 2.0), "stlsq": (3.0, 3.0)})

    def test_no_split(self):
        with pytest.raises(InputError, match=r"no flights to evaluate or to validate: .*\[split\]"):
            chosen(self.frame.assign(split="all"))

    def test_unfinished(self):
        with pytest.raises(InputError, match="unfinished, 23 of 24 planned cases"):
            select(study(self.frame), self.frame.iloc[1:])

    def test_rows_of_one_candidate_missing(self):
        with pytest.raises(InputError, match="not tried on the same flights"):
            chosen(self.frame.iloc[:-1])

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

    def test_a_criterion_of_which_no_case_has_a_number(self):
        with pytest.raises(InputError, match=r"no case with a number for .* prediction_flights"):
            chosen(self.frame, criterion="mean prediction-error")

    @pytest.mark.parametrize("words", ["mean timescale-eror", "men timescale-error", "mean"])
    def test_unknown_criterion(self, words):
        with pytest.raises(InputError, match="in criterion ="):
            chosen(self.frame, criterion=words)


class TestSection:
    place = Place("a.toml")
    sweep = (Factor(NOISE, (0.0, 0.5)),)

    @pytest.mark.parametrize(
        ("section", "words"),
        [
            ({"criterium": "mean"}, r'a.toml: \[select\] key "criterium" unknown: did you mean'),
            ({"max_failure": 3}, r"a.toml: \[select\] max_failure must be a share"),
            ({"simplest": "fast"}, r'key "simplest" has unknown value .*did you mean "fastest"'),
            ({"regimes": ["flights.noise"]}, f'no "flights.noise" varies .*: {NOISE}'),
            ({"margin": "5 %"}, 'key "margin" must be a number'),
        ],
    )
    def test_bad(self, section, words):
        with pytest.raises(InputError, match=words):
            read_selection(section, (), self.sweep, self.place)

    def test_options_replace_keys_and_are_checked_alike(self):
        rule = read_selection({"margin": 0.2, "regimes": [NOISE]}, (), self.sweep, self.place)
        assert changed(rule, {"over": "worst"}, (), self.sweep, self.place) == replace(
            rule, over="worst"
        )
        with pytest.raises(InputError, match="max_memory must be above 0"):
            changed(rule, {"max_memory": -1.0}, (), self.sweep, self.place)


def test_the_order_of_the_rows_does_not_matter_to_the_numbers():
    frame = cases({"lasso": (2.0, 9.0), "stlsq": (3.0, 1.0)})
    frame["est_timescale"] *= np.random.default_rng(1).uniform(0.9, 1.1, len(frame))
    # Candidates keep the order in which they are listed.
    shuffled = frame.sample(frac=1.0, random_state=2).sort_values("backend", kind="stable")
    first, second = (selection_table(chosen(one)) for one in (frame, shuffled))
    assert to_csv(first) == to_csv(second)


def test_values_of_candidates_stand_flight_by_flight():
    frame = cases({"lasso": (2.0, 9.0), "stlsq": (3.0, 1.0)}, levels=({NOISE: 1.0}, {NOISE: 2.0}))
    of = study(frame, sweep=(Factor(NOISE, (1.0, 2.0)),))
    one, other = candidates_of(of, frame)
    criterion = Criterion.of(SelectionRule(), ["velocity noise 1", "velocity noise 2"])
    assert criterion.grid(one.trials["validate"]).shape == (6, 2, 1)
    assert criterion.grid(other.trials["evaluate"]).ravel() == pytest.approx(1.0)


def test_the_page_draws_time_against_accuracy():
    frame = cases({"lasso": (2.0, 9.0), "stlsq": (3.0, 1.0)})
    times = {0: Latency(0.01, 0.02, 90.0, 50), 1: Latency(0.1, 0.12, 90.0, 50)}
    files = evidence_files(study(frame), chosen(frame, latencies=times), "a processor")
    assert list(files)[-1] == "evidence.md"
    assert files["pareto.svg"].startswith(b"<?xml")
    page = files["evidence.md"].decode()
    assert "![accuracy and latency](pareto.svg)" in page
    assert "Measured on a processor" in files["latency.md"].decode()
    assert "Measured on" not in page  # which is the same on every machine
    html = files["evidence.html"].decode()
    assert html.index("Times on one machine") < html.index("Measured on a processor")
    assert html.count("<table") >= 3
    assert b"latency" not in files["selection.csv"]  # times stand in a file of their own
