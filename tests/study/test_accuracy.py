"""Efficiency, windows and grids by hand."""

import json
import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from sparsefit.errors import InputError
from sparsefit.study import Study, cells
from sparsefit.study.evidence.along import level_needed
from sparsefit.study.evidence.answers import ANSWERS, sentences
from sparsefit.study.evidence.measures import MEASURES
from sparsefit.study.evidence.sentence import extremes, listed, some
from sparsefit.study.evidence.tables import TABLES
from sparsefit.study.run.execution import run_flight
from sparsefit.study.run.jobs import SolverTime
from sparsefit.study.run.outcome import Outcome
from sparsefit.study.run.store import cases_table
from sparsefit.study.spec.draw import SIMULATION, stream
from sparsefit.study.spec.plan import fit_key
from sparsefit.uncertainty.bound import cramer_rao
from tests.study.test_tables import STUDY, TABLE1, beside, case, column, frame

GROUP = "rms of error/bound"


def bounded(flight, percent, bound, **more):
    """A case of U0 = 10 m/s, L = 5 m; `bound` in percent of each truth."""
    values = {
        f"bound_{name}": bound * true / 100
        for name, true in (("mean_velocity", 10.0), ("length_scale", 5.0), ("timescale", 0.5))
    }
    return case(flight, percent=percent, **values, **more)


class TestEfficiency:
    def test_the_root_mean_square_of_error_over_bound_by_hand(self):
        # U0: 2 and 4 % at bounds of 1 and 4 %: sqrt((2^2 + 1^2) / 2). L: 0 and -8 %: sqrt(4 / 2).
        cases = frame(bounded(0, (2.0, 0.0), 1.0), bounded(1, (4.0, -8.0), 4.0))
        table = TABLES.make("efficiency", STUDY, cases)
        assert column(table, "U0", GROUP) == pytest.approx([math.sqrt(2.5)])
        assert column(table, "L_w", GROUP) == pytest.approx([math.sqrt(2.0)])
        assert column(table, "L_w", "rms error") == pytest.approx([math.sqrt(32.0)])
        assert column(table, "L_w", "rms bound") == pytest.approx([math.sqrt(8.5)])
        assert column(table, "with bound") == [2]

    def test_only_flights_called_ok_with_a_finite_bound_count(self):
        cases = frame(
            bounded(0, (3.0, 3.0), 1.0),
            bounded(1, (50.0, 50.0), 1.0, status="inaccurate"),
            bounded(2, (50.0, 50.0), math.inf),
            bounded(3, (50.0, 50.0), math.nan),
            bounded(4, (50.0, 50.0), 1.0, status="unidentifiable"),
        )
        table = TABLES.make("efficiency", STUDY, cases)
        assert column(table, "U0", GROUP) == pytest.approx([3.0])
        names = ("n", "ok", "failures", "with bound")
        assert [column(table, name)[0] for name in names] == [5, 3, 1, 1]

    def test_cases_from_before_there_were_bounds_have_none(self):
        table = TABLES.make("efficiency", STUDY, frame(case(), case(1)))
        assert column(table, "with bound") == [0]
        assert np.isnan(column(table, "U0", GROUP)).all()

    def test_the_answer_names_the_best_and_the_worst(self):
        cases = frame(
            bounded(0, (2.0, 3.0), 1.0, backend="lasso", label="lasso"),
            bounded(0, (8.0, 3.0), 1.0, backend="stlsq", label="stlsq"),
        )
        measures = ["length-scale-efficiency", "mean-velocity-efficiency"]
        said = ANSWERS.make({"measure": measures}, STUDY, cases)
        assert said.startswith("Rms L_w and U0 error / Cramér-Rao bound (1 flight).")
        assert "L_w 3.00 (all), U0 2.00 (lasso) to 8.00 (stlsq)" in said


def seconds_to(cases, limit, summary):
    """Seconds from which on the largest error keeps the limit."""
    measure = replace(MEASURES["largest-error"], summary=summary)
    return level_needed(cases, "flights.duration", measure, limit)


def flown(sizes):
    """Per duration, the percentage errors of U0 of its flights; None: no estimate."""
    rows = [
        case(
            flight,
            percent=(size or 0.0, 0.0),
            status="unidentifiable" if size is None else "ok",
            **{"flights.duration": seconds},
        )
        for seconds, errors in sizes.items()
        for flight, size in enumerate(errors)
    ]
    return frame(*rows)


class TestWindows:
    def test_the_duration_from_which_on_all_are_within(self):
        cases = flown({1.0: [9, 9], 2.0: [4, 4], 3.0: [6, 6], 5.0: [4, 4], 8.0: [0.5, 0.5]})
        assert seconds_to(cases, 5.0, "median") == 5.0  # 3 s is not within: 2 s was luck
        assert seconds_to(cases, 1.0, "median") == 8.0
        assert seconds_to(cases, 0.1, "median") == math.inf
        assert seconds_to(cases, 10.0, "median") == 1.0

    def test_a_failure_is_infinitely_wrong(self):
        cases = flown({1.0: [1, None, None], 2.0: [1, 1, None], 3.0: [1, 1, 1]})
        assert seconds_to(cases, 5.0, "median") == 2.0
        assert seconds_to(cases, 5.0, "9 of 10") == 3.0

    def test_the_largest_of_the_three_errors_counts(self):
        # tau_w = L / U0 is off by 1 - 1/1.05 where U0 is by 5 %: less; L by -4 % adds to it.
        cases = frame(case(percent=(5.0, -4.0), **{"flights.duration": 1.0}))
        worst = 100 * (1 - 0.96 / 1.05)
        assert seconds_to(cases, worst - 1e-9, "median") == math.inf
        assert seconds_to(cases, worst + 1e-9, "median") == 1.0

    def test_table_and_answer(self):
        cases = flown({1.0: [9, 9], 2.0: [4, None], 3.0: [0.5, 4]})
        table = TABLES.make("windows", STUDY, cases)
        assert column(table, "flights") == [2]
        assert column(table, "within 5 %", "median flight") == [2.0]
        assert column(table, "within 1 %", "median flight") == [3.0]
        assert column(table, "within 5 %", "9 of 10 flights") == [3.0]
        assert column(table, "within 1 %", "9 of 10 flights") == [None]
        asked = {"measure": "largest-error", "compare": "until", "limits": [5.0, 1.0]}
        said = ANSWERS.make(asked | {"along": "flights.duration"}, STUDY, cases)
        assert said.endswith("matched: every back-end 2 / 3 s and 3 / never s.")

    def test_a_study_of_one_duration_is_refused(self):
        with pytest.raises(InputError, match="windows"):
            TABLES.make("windows", STUDY, flown({1.0: [1, 2]}))


def test_a_spread_over_protocols_compares_the_worst_with_the_best():
    rows = [
        case(protocol=grid, percent=(0.0, size), **{"readout.refine": refine})
        for refine, sizes in (("none", (2.0, 6.0)), ("variable-projection", (0.5, 0.5)))
        for grid, size in zip(("coarse", "fine"), sizes, strict=True)
    ]
    asked = {"measure": "length-scale-error", "compare": "spread", "over": "protocol"}
    said = ANSWERS.make(asked, STUDY, frame(*rows))
    assert said.startswith("Median |error| of L_w, and how far the protocol alone moves it.")
    assert "2.00 % to 6.00 %, the worst protocol's 3.00 (lasso) times" in said
    assert "0.500 % to 0.500 %, the worst protocol's 1.00 (lasso) times" in said


class TestPaperAnswers:
    def test_least_errors_counts_a_failure_as_a_hundred_percent(self):
        rows = [
            case(0, backend="lasso", label="lasso"),
            case(1, backend="lasso", label="lasso", status="error"),
            case(0, backend="stlsq", label="stlsq", percent=(0.0, 10.0)),
            case(1, backend="stlsq", label="stlsq", percent=(0.0, 30.0)),
        ]
        rows = [row | {"split": "all"} for row in rows]
        said = ANSWERS.make("least-errors", STUDY, frame(*rows))
        assert "a flight without an estimate counting as 100 %" in said
        assert said.endswith("20.0 % (stlsq).")

    def test_rules_of_the_penalty_stand_beside_the_best_and_the_worst_fixed_one(self):
        def row(fraction, size, **more):
            settings = json.dumps({"alpha_fraction": fraction, **more})
            return case(settings=settings, percent=(0.0, size)) | {"split": "all"}

        rows = [row(0.1, 2.0), row(0.3, 5.0), row("auto", 3.0, selection="bic")]
        asked = {"measure": "timescale-error", "summary": "mean", "failures": "miss"}
        every = {"within": "backend", "settings": "every", "show": "every"}
        said = ANSWERS.make(asked | every, STUDY, frame(*rows))
        assert "2.00 % (alpha_fraction=0.1 selection" not in said
        order = [said.index(size) for size in ("2.00 % (", "3.00 % (", "5.00 % (")]
        assert order == sorted(order)
        assert "3.00 % (alpha_fraction=auto selection=bic)" in said

    def test_parameters_by_closeness(self):
        cases = frame(
            case(backend="lasso", label="lasso", percent=(0.0, 2.0)),
            case(backend="stlsq", label="stlsq", percent=(0.0, -40.0)),
        )
        asked = {"measure": "timescale-signed-error", "settings": "every"}
        assert "+2.00 % (lasso) to -40.00 % (stlsq)." in ANSWERS.make(asked, STUDY, cases)
        printed = ANSWERS.make(asked, beside(TABLE1), cases)
        assert printed.endswith("(stlsq); paper, Table 1: -3.70 %.")

    def test_completeness(self):
        study = SimpleNamespace(**{**vars(STUDY), "planned": 2})
        assert ANSWERS.make("completeness", study, frame(case(), case(1))).startswith("Yes: 2 of 2")
        broken = frame(case(), case(1, status="crashed"))
        assert ANSWERS.make("completeness", study, broken).startswith("Not wholly: 2 of 2")

    def test_sentences_are_those_that_the_study_names(self):
        study = SimpleNamespace(
            **{**vars(STUDY), "answers": ("completeness", {"measure": "seconds"})}
        )
        cases = frame(case(), case(1))
        expected = [ANSWERS.make(entry, study, cases) for entry in study.answers]
        assert sentences(study, cases) == expected
        assert sentences(STUDY, cases) == []


class TestWords:
    def test_lists(self):
        assert listed([]) == ""
        assert listed(["a"]) == "a"
        assert listed(["a", "b", "c"]) == "a, b and c"
        assert some(["a", "b", "c", "d"]) == "a, b, c and d"
        assert some(["a", "b", "c", "d", "e"]) == "a, b, c and 2 more"

    def test_extremes(self):
        assert extremes({"a": 1.0, "b": 1.0}) == "1.00 (all)"
        assert extremes({"a": 2.0, "b": 1.0, "c": math.nan}, " s") == "1.00 s (b) to 2.00 s (a)"
        assert extremes({"a": math.nan}) == "nothing"


TEXT = """
name = "bounds"
question = "?"
seed = 3
[flights]
count = 1
mean_velocity = 10.0
length_scale = 4.0
response_time = 0.5
thrust_acceleration = [5.0, 3.0]
duration = 2.0
sample_rate = 50.0
process_noise = 1.0
[library]
lower = 3.0
upper = 6.0
step = 1.0
[[backends]]
name = "lasso"
[[backends]]
name = "best-scale"
[sweep]
"flights.velocity_noise" = [0.0, 0.1]
"readout.refine" = ["none", "variable-projection"]
"""


@pytest.fixture(scope="module")
def ran(tmp_path_factory):
    path = tmp_path_factory.mktemp("bounds") / "bounds.toml"
    path.write_text(TEXT)
    study = Study.load(path)
    every = cells(study)
    rows = [one for one in run_flight(study, 0, every) if isinstance(one, Outcome)]
    return study, every, sorted(rows, key=lambda row: row.cell)


def seconds_of(study, rows):
    time = SolverTime(study)
    for row in rows:
        time.note(row)
    return time.total


class TestRows:
    def test_the_bound_is_that_of_the_flight_as_flown(self, ran):
        study, every, rows = ran
        draw = every[0].setup.flights.draw(0, 1, study.seed)
        flight = draw.fly(stream(study.seed, 0, SIMULATION))
        bound = cramer_rao(
            flight.position, draw.flow, draw.vehicle, process_noise=1.0, model="semiparametric"
        )
        for row in rows:
            noisy = every[row.cell].levels["flights.velocity_noise"] > 0
            expected = math.nan if noisy else bound.length_scale
            assert row["bound_length_scale"] == pytest.approx(expected, nan_ok=True)
            assert row["extent"] == flight.extent

    def test_a_fit_that_two_cases_read_is_timed_once(self, ran):
        study, every, rows = ran
        fits = {fit_key(every[row.cell]): row["seconds"] for row in rows}
        assert len(fits) == len(rows) / 2
        assert seconds_of(study, rows) == pytest.approx(sum(fits.values()))
        lent = [replace(row, values={"seconds": 2.0}, shared_seconds=1.5) for row in rows]
        assert seconds_of(study, lent) == pytest.approx(0.5 * len(fits))

    def test_columns_of_uncertainty_are_absent_numbers_where_there_is_none(self, ran):
        study, _, rows = ran
        frame_: pd.DataFrame = cases_table(study, rows).to_pandas()
        assert frame_["se_timescale"].isna().all() == all(
            math.isnan(r["se_timescale"]) for r in rows
        )
        assert (frame_["flow"] == "cellular").all()
