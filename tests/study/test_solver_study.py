"""Files of ``kind = "solvers"``: what they plan, and what they refuse before work starts."""

import io
import math
import zipfile
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from sparsefit.errors import InputError
from sparsefit.study.spec import contenders
from sparsefit.study.spec.solver_study import SolverStudy, is_solver_study
from sparsefit.study.spec.study import Study
from tests.study.solver_files import HEAD, LASSO, write_data, write_study

ROOT = Path(__file__).parents[2]
ONE = '[[problems]]\nfile = "one.npz"\n'


def loaded(folder, text):
    return SolverStudy.load(write_study(folder, text))


def refusal(folder, text):
    with pytest.raises(InputError) as caught:
        loaded(folder, text).build()
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_a_file_plans_problems_times_solvers_times_tolerances(tmp_path):
    write_data(tmp_path)
    study = loaded(tmp_path, HEAD + "tolerances = [1e-8, 1e-4]\n" + ONE + LASSO)
    told = [(study.contenders[c.contender].solver, c.tolerance) for c in study.cells]
    assert told[0][0] == "homotopy"
    assert math.isnan(told[0][1])
    assert told[1:3] == [("clarabel-direct", 1e-4), ("clarabel-direct", 1e-8)]
    assert study.planned == len(told) == 4
    assert "numpy < 2" in study.contenders[2].missing
    assert len({study.case_id(study.case(0, cell)) for cell in range(4)}) == 4


def test_a_path_and_single_fits(tmp_path):
    write_data(tmp_path)
    whole = loaded(tmp_path, HEAD + ONE + LASSO + "[path]\npoints = 3\nlowest = 0.01\n")
    assert np.allclose(whole.fractions, [1.0, 0.1, 0.01])
    single = loaded(tmp_path, HEAD + ONE + LASSO + "alpha_fraction = [0.1, 0.2]\n")
    assert single.fractions == ()
    assert single.objectives == ("lasso alpha_fraction=0.1", "lasso alpha_fraction=0.2")
    words = refusal(tmp_path, HEAD + ONE + LASSO + "alpha_fraction = 0.1\n[path]\n")
    assert "[path] sets the penalties" in words


def test_what_is_solved_is_told_without_the_solver(tmp_path):
    write_data(tmp_path)
    study = loaded(tmp_path, HEAD + ONE + LASSO)
    first, second, _ = study.contenders
    assert first.problem_of == second.problem_of
    assert first.identity != second.identity


def test_files_of_both_kinds_are_the_same_problem(tmp_path):
    write_data(tmp_path, targets=2, groups=np.repeat([0, 1], 3))
    with np.load(tmp_path / "one.npz") as arrays:
        table = {f"c{j}": arrays["theta"][:, j] for j in range(6)}
        table |= {f"target_{t}": arrays["target"][:, t] for t in range(2)}
    pd.DataFrame(table).to_parquet(tmp_path / "two.parquet")
    text = HEAD + ONE + '[[problems]]\nfile = "two.parquet"\ngroups = 3\n' + LASSO
    one, two = loaded(tmp_path, text).build()
    assert np.array_equal(one.theta, two.theta)
    assert np.array_equal(one.target, two.target)
    assert np.array_equal(one.groups, two.groups)


def test_flights_sweeps_and_degenerate_problems(tmp_path):
    text = (
        HEAD
        + "seed = 4\n[flights]\nmean_velocity = 10.0\nlength_scale = 4.0\nresponse_time = 0.5\n"
        + "duration = 1.0\nsample_rate = 50.0\n"
        + '[[problems]]\nname = "grid"\nflights = { count = 2 }\n'
        + 'sweep = { "library.count" = [2, 3] }\n'
        + '[[problems]]\nname = "odd"\nflights = { duration = 2.0 }\nlibrary = { count = 3 }\n'
        + 'alter = ["as it is", "duplicated columns"]\n'
        + LASSO
    )
    study = loaded(tmp_path, text)
    built = study.build()
    assert [p.columns for p in built] == [16, 16, 24, 24, 24, 24]
    assert [s.level for s in study.problems[:4:2]] == ["library.count 2", "library.count 3"]
    assert {s.series for s in study.problems} == {"grid", "odd"}
    assert np.linalg.matrix_rank(built[5].theta) < np.linalg.matrix_rank(built[4].theta)
    again = loaded(tmp_path, text).build()
    assert all(np.array_equal(a.theta, b.theta) for a, b in zip(built, again, strict=True))


def test_public_data_are_centred_and_as_published(tmp_path):
    pytest.importorskip("sklearn")
    sets = "".join(f'[[problems]]\ndataset = "{name}"\n' for name in
                   ("diabetes", "diabetes-quadratic", "linnerud"))  # fmt: skip
    built = loaded(tmp_path, HEAD + sets + LASSO).build()
    assert [p.theta.shape for p in built] == [(442, 10), (442, 64), (20, 3)]
    assert [p.targets for p in built] == [1, 1, 3]
    for problem in built:
        assert np.allclose(problem.theta.mean(axis=0), 0.0, atol=1e-9)
    squares = built[1].groups[10:19]
    assert set(squares) <= set(built[1].groups[:10])  # each beside its variable


def test_the_hash_follows_what_a_data_file_holds(tmp_path):
    write_data(tmp_path)
    first = loaded(tmp_path, HEAD + ONE + LASSO).hash
    assert loaded(tmp_path, HEAD + 'question = "Else?"\n' + ONE + LASSO).hash == first
    write_data(tmp_path, seed=1)
    assert loaded(tmp_path, HEAD + ONE + LASSO).hash != first


def nan_theta():
    theta = np.ones((30, 2))
    theta[3, 1] = np.nan
    return theta


@pytest.mark.parametrize(
    ("arrays", "words"),
    [
        ({"theta": None}, "holds no theta"),
        ({"target": np.ones(29)}, "same number of rows"),
        ({"groups": np.zeros(2)}, "one label per column"),
        ({"theta": nan_theta()}, "NaN"),
        ({"theta": np.ones((30, 2), dtype=complex)}, "not real numbers"),
        ({"theta": np.full((30, 2), "1.0")}, "not real numbers"),
        ({"theta": np.ones(30)}, "shape"),
        ({"theta": np.array([{}] * 30, dtype=object)}, "Python objects"),
    ],
)
def test_a_file_that_is_no_problem_is_refused_in_a_line(tmp_path, arrays, words):
    write_data(tmp_path, **arrays)
    if arrays.get("theta", 0) is None:
        np.savez(tmp_path / "one.npz", target=np.ones(30))
    assert words in refusal(tmp_path, HEAD + ONE + LASSO)


def test_the_size_is_read_before_the_numbers(tmp_path):
    header = io.BytesIO()
    shape = {"descr": "<f8", "fortran_order": False, "shape": (10**9, 100)}
    np.lib.format.write_array_header_1_0(header, shape)
    with zipfile.ZipFile(tmp_path / "one.npz", "w") as archive:
        for name in ("theta.npy", "target.npy"):
            archive.writestr(name, header.getvalue())
    assert "more than" in refusal(tmp_path, HEAD + ONE + LASSO)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (LASSO, "missing: write one [[problems]]"),
        ('[[problems]]\ndataset = "diabets"\n' + LASSO, 'did you mean "diabetes"'),
        ('[[problems]]\nfile = "nosuch.npz"\n' + LASSO, "no such file"),
        ('[[problems]]\nfile = "one.txt"\n' + LASSO, ".npz, .parquet, .csv"),
        ('[[problems]]\nname = "f"\nflights = {}\n' + LASSO, "exactly two of"),
        (ONE + LASSO.replace("homotopy", "homotpy"), 'did you mean "homotopy"'),
        (ONE + LASSO.replace('"lasso"', '"laso"'), 'did you mean "lasso"'),
        (ONE + LASSO + LASSO, "twice"),
        (ONE + ONE + LASSO, "twice"),
        ("tolerances = [2.0]\n" + ONE + LASSO, "below 1"),
        (ONE + LASSO + "[clock]\nlimit = -1.0\n", "limit must be above 0"),
        (ONE + LASSO + "[path]\npoints = 0\n", "points must be"),
        (ONE + 'alter = "upside down"\n' + LASSO, "unknown value"),
        (ONE + 'sweep = { "library.count" = [2] }\n' + LASSO, "is for flights"),
    ],
)
def test_bad_files_are_refused_in_a_line(tmp_path, text, words):
    write_data(tmp_path)
    assert words in refusal(tmp_path, HEAD + text)


def test_a_package_that_is_absent_is_a_missing_contender(tmp_path, monkeypatch):
    from sparsefit.backends import solvers

    write_data(tmp_path)
    monkeypatch.setattr(solvers, "find_spec", lambda _: None)
    study = loaded(tmp_path, HEAD + ONE + LASSO.replace("adelie", "celer"))
    absent = study.contenders[2]
    assert "sparsefit[peers]" in absent.missing
    assert len(absent.tolerances) == 4  # its cases are planned, and end as skipped
    assert absent.tolerances != contenders.NO_TOLERANCE


def test_the_shipped_study_plans_every_kind_of_problem_and_the_exact_paths():
    study = SolverStudy.load(ROOT / "studies" / "solvers.toml")
    assert {source.kind for source in study.problems} == {"flights", "dataset"}
    assert {one.solver for one in study.contenders} >= {"homotopy", "variational", "adelie"}
    assert study.hash == SolverStudy.load(ROOT / "studies" / "solvers.toml").hash


def test_the_example_of_the_documentation_is_a_study_of_twenty_lines(tmp_path):
    text = (ROOT / "docs" / "your-problems.md").read_text(encoding="utf-8")
    example = text.partition('kind = "solvers"\n')[2].partition("```")[0]
    write_data(tmp_path, "first")
    study = loaded(tmp_path, HEAD.partition("kind")[0] + 'kind = "solvers"\n' + example)
    assert study.planned == 2 * (1 + 3 * 4)
    assert len(example.splitlines()) <= 20


def test_a_study_of_flights_is_no_study_of_solvers(tmp_path):
    write_data(tmp_path)
    path = write_study(tmp_path, HEAD + ONE + LASSO)
    assert is_solver_study(path)
    with pytest.raises(InputError, match='key "kind"'):
        Study.load(path)
    path.write_text('kind = "solver"\n', encoding="utf-8")
    with pytest.raises(InputError, match="has unknown value"):
        is_solver_study(path)


def test_a_csv_file_is_a_problem_and_says_what_is_wrong_with_it(tmp_path):
    text = HEAD + '[[problems]]\nfile = "mine.csv"\ngroups = 2\n' + LASSO
    lines = ["a,b,c,d,target"] + [f"{i},{i % 3},{(-1) ** i},{i * i % 7},{2 * i}" for i in range(9)]
    (tmp_path / "mine.csv").write_text("\n".join(lines), encoding="utf-8")
    (problem,) = loaded(tmp_path, text).build()
    assert (problem.samples, problem.columns, problem.targets) == (9, 4, 1)
    assert problem.groups.tolist() == [0, 0, 1, 1]
    for words, content in (
        ("holds string, not numbers", [*lines, "x,1,1,1,1"]),
        ("two columns of one name", ["a,a,c,d,target", *lines[1:]]),
        ("holds no target", ["a,b,c,d,e", *lines[1:]]),
        ("not readable", [*lines, "1,2"]),
    ):
        (tmp_path / "mine.csv").write_text("\n".join(content), encoding="utf-8")
        assert words in refusal(tmp_path, text)
