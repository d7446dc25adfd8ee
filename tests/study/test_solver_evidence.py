"""Profiles, means and intervals of a study of solvers, on rows made by hand."""

import math

import numpy as np
import pandas as pd
import pytest

from sparsefit.study.evidence import solver_measures as measures
from sparsefit.study.evidence.solver_answers import limits, sentences
from sparsefit.study.evidence.solver_tables import failures, tables_of
from sparsefit.study.spec.solver_study import SolverStudy
from tests.study.solver_files import HEAD, LASSO, write_data, write_study

COLUMNS = {"level": "", "series": "s", "targets": 1, "samples": 10, "columns": 4, "reason": "",
           "first": 0.1, "memory": 1.0, "repeats": 9, "known": True, "disturbed": False,
           "load": 1.0, "tolerance": math.nan, "certificate_kind": "duality_gap"}  # fmt: skip


def row(problem, solver, cpu, excess=1e-12, status="ok", **more):
    values = {"objective": "lasso", "problem": problem, "solver": solver, "cpu": cpu}
    return COLUMNS | values | {"wall": cpu, "excess": excess, "status": status} | more


@pytest.fixture
def cases():
    rows = [row(f"p{i}", "quick", 0.01) for i in range(8)]
    rows += [row(f"p{i}", "slow", 0.04, tolerance=1e-8) for i in range(6)]
    rows += [row(f"p{i}", "slow", 0.02, 1e-5, "inaccurate", tolerance=1e-4) for i in range(6)]
    rows += [row(f"p{i}", "slow", math.nan, math.nan, "timeout", tolerance=1e-8, repeats=0,
                 reason=f"took {i} s") for i in (6, 7)]  # fmt: skip
    rows += [row(f"p{i}", "absent", math.nan, math.nan, "skipped", repeats=0, reason="pip it")
             for i in range(8)]  # fmt: skip
    return pd.DataFrame(rows)


@pytest.fixture
def study(tmp_path):
    write_data(tmp_path)
    return SolverStudy.load(
        write_study(tmp_path, HEAD + '[[problems]]\nfile = "one.npz"\n' + LASSO)
    )


def test_failures_stay_in_every_denominator(cases):
    strict = measures.times_to(cases, "lasso", 1e-8)
    assert strict.solvers == ("quick", "slow")  # who is missing is not judged
    assert strict.solved.sum(axis=0).tolist() == [8, 6]
    assert np.isinf(strict.ratios()[6:, 1]).all()
    assert np.allclose(strict.ratios()[:6, 1], 4.0)
    loose = measures.times_to(cases, "lasso", 1e-4)
    assert np.allclose(loose.seconds[:6, 1], 0.02)  # the looser tolerance is enough, and quicker


def test_a_shifted_geometric_mean_charges_failures_the_limit(cases):
    times = measures.times_to(cases, "lasso", 1e-8)
    quick, slow = times.means(shift=0.01, limit=10.0)
    assert quick == pytest.approx(0.01)
    expected = math.exp((6 * math.log(0.05) + 2 * math.log(10.01)) / 8) - 0.01
    assert slow == pytest.approx(expected)


def test_a_ratio_has_a_paired_interval_and_few_problems_have_none(cases):
    ratio = measures.times_to(cases, "lasso", 1e-8).against_best(limit=10.0)
    assert np.allclose(ratio[0], 1.0)
    assert ratio[1, 1] < ratio[1, 0] < ratio[1, 2]
    assert ratio[1, 1] >= 4.0 - 1e-9  # it is slower on each of them
    few = cases[cases["problem"].isin(["p0", "p1"])]
    assert np.isnan(measures.times_to(few, "lasso", 1e-8).against_best(limit=10.0)[:, 1:]).all()


def test_solvers_that_take_turns_to_be_quicker_are_a_tie(study):
    rows = [
        row(f"p{i}", name, 0.01 * math.exp(0.3 * (-1) ** i * sign))
        for i in range(12)
        for name, sign in (("one", 1), ("two", -1))
    ]
    table = tables_of(study, pd.DataFrame(rows))["summary"]
    assert [cells[-1] for cells in table.rows] == ["fastest", "tie with the fastest"]
    assert "cannot be told apart" in sentences(study, pd.DataFrame(rows))[0]


def test_equal_solvers_are_seldom_told_apart():
    draw = np.random.default_rng(5).normal(size=(150, 20, 2))
    slower = []
    for logs in draw:
        problems = tuple(map(str, range(20)))
        times = measures.Times("lasso", 1e-8, problems, ("one", "two"), np.exp(logs))
        slower.append(times.against_best(limit=1e9)[:, 1].max() > 1.0)
    assert np.mean(slower) <= 0.13  # 5 % for many problems; a bootstrap of 20 has some more


def test_a_reader_is_told_of_tolerances_that_stop_short_and_of_other_certificates(study):
    rows = [row(f"p{i}", "loose", 0.01, 1e-5, tolerance=1e-4) for i in range(6)]
    rows += [row(f"p{i}", "exact", 0.02) for i in range(6)]
    table = tables_of(study, pd.DataFrame(rows))["summary"]
    assert any("loose: never asked for 1e-8" in note for note in table.notes)
    assert "no other solver" in sentences(study, pd.DataFrame(rows))[0]
    other = pd.DataFrame(rows).assign(certificate_kind="fixed_point")
    assert any("claims no optimum" in n for n in tables_of(study, other)["summary"].notes)


def test_a_profile_is_a_staircase_to_the_share_that_is_solved():
    x, y = measures.steps(np.array([3.0, 1.0, np.inf, 2.0]), 1.0, 10.0)
    assert x.tolist() == [1.0, 1.0, 2.0, 3.0, 10.0]
    assert y.tolist() == [0.0, 0.25, 0.5, 0.75, 0.75]


def test_growth_follows_the_size_that_varies(study):
    rows = [
        row(f"g, {k}", solver, factor * (k / 10) ** power, columns=k, level=str(k), series="g")
        for k in (10, 20, 40)
        for solver, factor, power in (("flat", 0.1, 1.0), ("steep", 0.1, 3.0))
    ]
    grown = measures.growth(pd.DataFrame(rows), 1e-6)
    assert set(grown["along"]) == {"columns"}
    for solver, power in (("flat", 1.0), ("steep", 3.0)):
        mine = grown[grown["solver"] == solver]
        assert measures.exponent(mine["size"], mine["seconds"]) == pytest.approx(power)
    assert math.isnan(measures.exponent([10], [1.0]))
    table = tables_of(study, pd.DataFrame(rows))["growth"]
    assert "k^3.00" in {cells[5] for cells in table.rows}


def test_who_fails_is_told_with_what_it_said(cases, study):
    table = failures(cases)
    told = {cells[2]: cells for cells in table.rows}
    assert told["timeout"][3] == 2  # reasons that differ in a number are one
    assert told["timeout"][5] == "p6, p7"
    assert told["timeout"][6] == "took 6 s"
    words = sentences(study, cases)
    assert "8 of 8" in words[0]
    assert "6 of 8" in words[0]
    assert "pip it" in words[1]
    assert "cannot" not in words[0]
    assert "not judged" in limits(study, cases)


def test_each_objective_has_its_own_summary(cases, study):
    other = cases.assign(objective="group-lasso separate=True")
    tables = tables_of(study, pd.concat([cases, other]))
    assert {"summary-lasso", "summary-group-lasso-separate-true"} <= set(tables)
    rows = tables["summary-lasso"].rows
    assert [cells[0] for cells in rows] == ["quick", "slow", "absent"]
    assert rows[-1][-1] == "missing"
