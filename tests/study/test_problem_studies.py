"""Studies of regression problems: judged by what is predicted, timed from outside, never fooled."""

import dataclasses
import math
import os
import shutil
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import sparsefit as sf
from sparsefit.cli import main
from sparsefit.errors import InputError, MissingExtra
from sparsefit.study.arena import Case, cross_validated, median_interval, recovered
from sparsefit.study.data_sets import Data, altered, drawn, read_data, read_public
from sparsefit.study.keys import Clock, DataSet, Generator
from sparsefit.study.problem_desk import part_of
from sparsefit.study.selection import check_rule, select
from sparsefit.study.store import read_cases
from sparsefit.study.worker import cpu_seconds
from tests.study import solver_deeds
from tests.study.small_study import CORRELATED, PROBLEMS

PUBLIC = Path(__file__).parents[2] / "studies/solvers/public_solvers.py"
PLAIN = '[[solvers]]\nname = "plain"\nfile = "deeds.py"\n'


def load(folder, text):
    (folder / "p.toml").write_text(text)
    return sf.Study.from_file(folder / "p.toml")


def refusal(folder, text):
    with pytest.raises(InputError) as caught:
        load(folder, text)
    return str(caught.value)


def test_deeds_of_solvers_are_their_own_cases(tmp_path):
    """Time is the wall's, answers are judged elsewhere, and a hang costs its limit once."""
    shutil.copy(solver_deeds.__file__, tmp_path / "deeds.py")
    deeds = solver_deeds.DEEDS
    solvers = "".join(f'[[solvers]]\nname = "{name}"\nfile = "deeds.py"\n' for name in deeds)
    names = ", ".join(f'"{name}"' for name in deeds)
    lasso = f'[[backends]]\nname = "lasso"\nsolver = ["homotopy", {names}]\n'
    text = PROBLEMS.replace('"problems"', '"solvers"').replace("seconds = 0.5", "seconds = 9.0")
    text = text.replace("repeats = 4", "repeats = 2").replace("limit = 5.0", "limit = 3.0")
    text += "[run]\nmax_memory = 3000\n"
    study = load(tmp_path, text + CORRELATED + "count = 2\n" + solvers + lasso)
    study.run()
    cases = study.cases
    first = cases[cases["flight"] == 0].set_index("solver")
    ends = first["status"].to_dict()
    for name in ("homotopy", "plain", "lazy", "sleeps", "clock"):
        assert ends[name] == "ok", first.loc[name, "reason"]
        assert first.loc[name, "excess"] <= 1e-4
    assert first.loc[["lazy", "clock"], "wall"].min() > 0.3 * first.loc["plain", "wall"]
    assert first.loc["sleeps", "wall"] > max(0.3, first.loc["sleeps", "cpu"])
    assert "answered another problem" in first.loc["caches", "reason"]
    assert "points answered" in first.loc["silent", "reason"]
    for name in ("caches", "silent", "memory", "exits", "odd", "spoils", "cuts"):
        assert ends[name] == "error", name
    assert first.loc["memory", "reason"].find("emory") >= 0
    assert "SystemExit: away" in first.loc["exits", "reason"]
    assert (ends["judge"], ends["hangs"], ends["dies"]) == ("inaccurate", "timeout", "crashed")
    assert "message channel of the worker process was written" in first.loc["writes", "reason"]
    assert "its first call took longer than 3 s" in first.loc["hangs", "reason"]


def test_a_penalty_that_is_not_even_keeps_its_sign_in_repeats(tmp_path):
    lasso = '[[backends]]\nname = "lasso"\npositive = true\nsolver = "exact"\n'
    study = load(tmp_path, PROBLEMS + CORRELATED + lasso)
    study.run()
    assert study.cases["status"].tolist() == ["ok"], study.cases["reason"].tolist()


@pytest.fixture(scope="module")
def own(tmp_path_factory):
    """Two settings of one's own solver beside ours, on three problems."""
    folder = tmp_path_factory.mktemp("own")
    shutil.copy(solver_deeds.__file__, folder / "deeds.py")
    rng = np.random.default_rng(0)
    theta = rng.standard_normal((60, 8))
    target = theta[:, 0] + 0.1 * rng.standard_normal(60)
    np.savez(folder / "a.npz", theta=theta[:40], target=target[:40], truth=np.arange(8) == 0)
    np.savez(folder / "later.npz", theta=theta[40:], target=target[40:])
    problems = '[[problems]]\nfile = "a.npz"\ntest = "later.npz"\n[[problems]]\ndataset = "iris"\n'
    solvers = f"{PLAIN}steps = [1, 10000]\n"
    lasso = '[[backends]]\nname = "lasso"\nsolver = ["homotopy", "plain"]\n'
    study = load(folder, PROBLEMS + CORRELATED + problems + solvers + lasso)
    study.run()
    return study


def test_one_s_own_solver_is_compared_by_its_settings(own):
    plan, cases = own.plan(), own.cases
    assert plan["solver"].unique().tolist() == ["homotopy", "plain steps=1", "plain steps=10000"]
    assert plan["candidate"].nunique() == 3
    assert (cases["status"] != "error").all(), cases["reason"].tolist()
    excess = cases.groupby("solver")["excess"].max()
    assert excess["plain steps=10000"] <= 1e-4 < excess["plain steps=1"]
    assert (cases.loc[cases["solver"] == "plain steps=1", "status"] == "inaccurate").all()
    assert cases.attrs == {"limit": 5.0}
    assert own.missing == {}
    assert own.run().computed == 0


COMMAND = """
import sys, time
import numpy as np
from pathlib import Path
time.sleep(0.7)
folder = Path(sys.argv[1])
X, y = np.load(folder / "design.npy"), np.load(folder / "target.npy")
print("ready", flush=True)
sys.stdin.readline()
u = np.linalg.lstsq(X, y, rcond=None)[0].T
print("done", flush=True)
np.save(folder / "answer.npy", np.stack([u] * 4))
"""


def test_a_command_is_neither_charged_nor_ended_for_its_start(tmp_path):
    (tmp_path / "program.py").write_text(COMMAND)
    text = (
        PROBLEMS.replace('"problems"', '"solvers"').replace("repeats = 4", "repeats = 1")
        + CORRELATED
    )
    text += f'[[solvers]]\nname = "theirs"\ncommand = ["{sys.executable}", "program.py"]\n'
    text += '[[solvers]]\nname = "stuck"\ncommand = ["sh", "-c", "sleep 60"]\nstart = 0.3\n'
    text += '[[backends]]\nname = "lasso"\nsolver = ["theirs", "stuck"]\n'
    text = text.replace("limit = 5.0", "limit = 0.5")
    study = load(tmp_path, text + "tolerances = [1e-8]\n")
    study.run()
    theirs, stuck = study.cases.to_dict("records")
    assert theirs["status"] == "inaccurate"  # least squares, of a LASSO
    words = "its first call took longer than 0.3 s to start, to read or to write"
    assert (stuck["status"], stuck["reason"]) == ("timeout", words)


COMPILED = """
import time
from dataclasses import dataclass
import numpy as np
SEEN = set()

@dataclass(frozen=True)
class Compiled:
    name = "compiled"
    compiles = True

    def path(self, design, target, penalty, alphas, tolerance):
        time.sleep(0.0 if design.kind in SEEN else 1.0)
        SEEN.add(design.kind)
        return np.zeros((len(alphas), design.shape[1], target.shape[1]))
"""


def test_a_first_call_that_compiles_is_not_charged_on_dense_nor_on_sparse_columns(tmp_path):
    (tmp_path / "mine.py").write_text(COMPILED)
    text = PROBLEMS.replace('"problems"', '"solvers"').replace("limit = 5.0", "limit = 0.9")
    sparse = '[[problems]]\ngenerator = "sparse"\nsamples = 60\ncolumns = 8\nsupport = 2\n'
    text += f'{CORRELATED}{sparse}density = 0.5\n[[solvers]]\nfile = "mine.py"\n'
    study = load(tmp_path, f'{text}[[backends]]\nname = "lasso"\nsolver = "compiled"\n')
    study.run()
    assert study.cases["status"].tolist() == ["inaccurate", "inaccurate"]


def test_problems_are_judged_by_held_out_rows_and_truth(own):
    cases = own.cases[own.cases["solver"] == "homotopy"].set_index("problem")
    row = cases.loc["a"]
    assert row["holdout_error"] < 0.05
    assert (row["true_support"], row["recall"]) == (1, 1.0)
    assert 0.0 < row["f1"] <= 1.0
    assert row["alpha_fraction"] == pytest.approx(0.1)
    assert 0.0 < row["stability"] <= 1.0
    assert math.isnan(cases.loc["iris", "precision"])
    assert cases.loc["iris", "targets"] == 3
    assert cases.loc["iris", "support"] > 0
    # A path of one step is further from the data.
    lazy = own.cases[own.cases["solver"] == "plain steps=1"].set_index("problem")
    assert lazy.loc["correlated", "holdout_error"] > cases.loc["correlated", "holdout_error"]


def test_a_solver_is_named_where_there_are_several(own, tmp_path):
    both = '[[backends]]\nname = "lasso"\n[[backends]]\nname = "ridge"\n'
    two = f'{both[:28]}solver = ["homotopy", "clarabel"]\n[[backends]]\nname = "stlsq"\n'
    assert load(tmp_path, PROBLEMS + CORRELATED + two).plan()["title"].tolist()[-1] == "stlsq"
    study = load(tmp_path, PROBLEMS + CORRELATED + both)
    assert study.plan()["title"].tolist() == ["lasso", "ridge"]
    assert repr(study) == f"Study p of problems: 2 cases, in {study.folder}"
    assert own.plan()["title"][0] == "homotopy"


def test_the_winner_is_a_call(own, capsys, tmp_path):
    assert main(["select", own.path, "--output", str(tmp_path / "e.json")]) == 0
    assert select(own).criterion.measure.name == "holdout-error"
    assert "use it: sf.fit(problem, 'lasso', alpha_fraction='auto')" in capsys.readouterr().out


def test_the_winner_of_single_fits_is_a_call_with_its_penalty(tmp_path):
    lasso = '[[backends]]\nname = "lasso"\nalpha_fraction = [0.3, 0.01]\nsolver = "clarabel"\n'
    study = load(
        tmp_path, PROBLEMS.replace("[path]\npoints = 4\nlowest = 0.1\n", "") + CORRELATED + lasso
    )
    words = "sf.fit(problem, 'lasso', alpha_fraction=0.01)"
    assert study.call(study.plan()["candidate"][1]) == words


def test_a_changed_solver_file_is_another_case(own):
    before = own.plan()["case_id"]
    path = Path(own.path).parent / "deeds.py"
    text = path.read_text()
    path.write_text(text + "\n# changed\n")
    after = sf.Study.from_file(own.path).plan()["case_id"]
    path.write_text(text)
    ours = (own.plan()["solver"] == "homotopy").to_numpy()
    assert (before == after).to_numpy().tolist() == ours.tolist()


def test_a_changed_file_of_a_command_is_another_case(tmp_path):
    words = f'command = ["{sys.executable}", "../program.py", "--quick", "{"long " * 99}"]'
    text = f'{PROBLEMS}{CORRELATED}[[solvers]]\nname = "theirs"\n{words}\n'
    text += '[[backends]]\nname = "lasso"\nsolver = ["theirs", "homotopy"]\n'
    identities = []
    (tmp_path / "studies").mkdir()
    for program in (COMMAND, f"{COMMAND}# changed"):
        (tmp_path / "program.py").write_text(program)
        identities.append(load(tmp_path / "studies", text).plan()["case_id"])
    assert (identities[0] == identities[1]).tolist() == [False, True]


def test_a_rule_of_flights_is_refused_before_any_work(tmp_path):
    text = f'{PROBLEMS}{CORRELATED}[[backends]]\nname = "lasso"\n[select]\n'
    refusals = {"max_error = 1.0": "max_error is for flights",
                'criterion = "mean timescale-error"': "is a measure of flights"}  # fmt: skip
    for rule, words in refusals.items():
        with pytest.raises(InputError, match=words):
            check_rule(load(tmp_path, text + rule))


def test_a_data_set_without_its_package_is_refused_before_any_work(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "sklearn.datasets", None)
    text = '[[problems]]\ndataset = "iris"\n[[backends]]\nname = "lasso"\n'
    study = load(tmp_path, PROBLEMS + text)
    assert main(["study", "check", study.path]) != 0
    assert "ships with scikit-learn: pip install" in capsys.readouterr().err
    with pytest.raises(MissingExtra):
        study.run(progress=lambda *_: pytest.fail("work began"))


def test_times_are_those_of_whole_comparisons(own):
    study = sf.Study.from_file(own.path)
    named = study.planned.named(["plain steps=1"])
    whole = study.planned.whole(named, np.full(named.shape, ""))
    assert whole.all()
    assert study.planned.named(["iris"]).sum() == 3
    assert read_cases(own.folder)["version"].str.contains(" on ").all()
    with pytest.raises(InputError, match="give a back-end, objective, solver, unit or case id"):
        study.planned.named(["theirs"])
    with pytest.raises(InputError, match="one at a time"):
        study.run(processes=2)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('[[problems]]\ndataset = "digit"\n', 'did you mean "digits"?'),
        ('[[problems]]\ngenerator = "wide"\nsupport = 9999\n', "lie within the columns"),
        ('[[problems]]\ngenerator = "wide"\ncount = 10001\n', "at most 10000"),
        ('[[problems]]\ngenerator = "wyde"\n', 'did you mean "wide"?'),
        ('[[problems]]\nfile = "no.npz"\n', "No such file"),
        ('[[problems]]\nfil = "no.npz"\n', 'did you mean "file"?'),
        (f'{CORRELATED}[[solvers]]\nname = "mine"\n', "is of no package: give its file"),
        ('[[problems]]\nfile = "x.bin"\n', "x.bin: a problem is read from .npz alone"),
        ('[[problems]]\ndataset = "iris"\nalter = "as it was"\n', 'did you mean "as it is"?'),
        ('[[problems]]\ndataset = "iris"\ncount = 2\n', 'key "count" unknown'),
        ("[[problems]]\n", "flights, file, dataset, generator; entry 1 has none"),
        (CORRELATED + CORRELATED, "twice"),
    ],
)
def test_what_is_no_problem_is_refused_by_key(tmp_path, text, said):
    whole = PROBLEMS + text + '[[backends]]\nname = "lasso"\n'
    assert said in refusal(tmp_path, whole)
    assert 'says kind = "problems"' in refusal(tmp_path, whole.replace("kind", "#", 1))


def test_a_misspelt_kind_is_no_missing_one(tmp_path):
    text = 'name = "x"\nquestion = "?"\nkind = "problem"\n[[problems]]\ndataset = "iris"\n'
    assert "unknown value 'problem': did you mean" in refusal(tmp_path, text)
    assert "unknown value 'flight': did you mean" in refusal(tmp_path, 'kind = "flight"\n')


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('name = "lasso"\nsolver = "celr"', 'did you mean "celer"?'),
        ('name = "lasso"\n[[solvers]]\nfile = "deeds.py"', "one file without a name"),
        ('name = "lasso"\nsolver = "homotpy"', 'did you mean "homotopy"? (known: homotopy, exa'),
        ('name = "least-squares"\nsolver = "clarabel"', "has no penalty"),
        ('name = "lasso"\nalpha_fraction = 0.1', "[path] sets the penalties"),
        ('name = "lasso"\nsolver = ["homotopy", "homotopy"]', "twice"),
        ('name = "lasso"\nsolver = "clarabel"\ncertified = true', "exact path of sparsefit"),
        ('name = "elastic-net"\nsolver = "plain"', "no ridge"),
    ],
)
def test_what_is_no_contender_is_refused_by_key(tmp_path, text, said):
    shutil.copy(solver_deeds.__file__, tmp_path / "deeds.py")
    solvers = f'{PLAIN}[[solvers]]\nfile = "{PUBLIC}"\n'
    assert said in refusal(tmp_path, f"{PROBLEMS}{CORRELATED}{solvers}[[backends]]\n{text}\n")


@pytest.mark.parametrize("name", DataSet.__args__)
def test_every_data_set_is_a_problem(name):
    pytest.importorskip("sklearn")
    data = read_public(name)
    assert len(data.theta) == len(data.target)
    assert np.abs(data.theta.mean(axis=0)).max() < 1e-9 * np.abs(data.theta).max()
    sf.RegressionProblem.from_arrays(data.theta, data.target, data.groups)


@pytest.mark.parametrize("settings", [{"correlation": 0.8}, {"density": 0.05}, {"group": 5}])
def test_generators_know_their_truth(settings):
    rules = Generator(samples=400, columns=50, support=3, snr=9.0, **settings)
    data, again = (drawn(rules, np.random.SeedSequence(1)) for _ in range(2))
    theta = data.theta.toarray() if "density" in settings else data.theta
    assert abs(data.theta - again.theta).max() == 0.0
    assert data.truth.sum() == 3 * settings.get("group", 1)
    weights = np.linalg.lstsq(theta[:, data.truth], data.target, rcond=None)[0]
    missed = data.target - theta[:, data.truth] @ weights
    assert (missed**2).sum() / (data.target**2).sum() == pytest.approx(0.1, abs=0.03)
    if "correlation" in settings:
        assert np.corrcoef(theta[:, :2].T)[0, 1] == pytest.approx(0.8, abs=0.1)
    for name, of_truth in (("units 1e-12 to 1e12", True), ("duplicated columns", False)):
        other = altered(name, dataclasses.replace(data, test=data), np.random.default_rng(0))
        assert (other.truth is not None) == of_truth  # which of two equal columns is none
        np.testing.assert_array_equal(other.test.theta, other.theta)


def test_files_are_bounded_before_they_are_unpacked(tmp_path):
    zeros = np.zeros((20_000, 7_000), np.uint8)
    np.savez_compressed(tmp_path / "big.npz", theta=zeros, target=np.zeros(20_000))
    assert (tmp_path / "big.npz").stat().st_size < 1_000_000
    np.savez(tmp_path / "y.npz", theta=np.zeros((3, 2)), y=np.zeros(3))
    (tmp_path / "cut.npz").write_bytes((tmp_path / "y.npz").read_bytes()[:-40])
    entry = '[[problems]]\nfile = "cut.npz"\n[[backends]]\nname = "lasso"\n'
    assert "cut.npz: not readable" in refusal(tmp_path, PROBLEMS + entry)
    np.savez(tmp_path / "z.npz", theta=np.array([["a"]]), target=np.zeros(1))
    np.savez(tmp_path / "many.npz", **{f"a{number}": number for number in range(2000)})
    for name, words in (
        ("big.npz", "holds 140020000 numbers"), ("y.npz", "holds no target, but theta, y"),
        ("z.npz", "theta holds <U1, and only numbers"), ("many.npz", "holds too many arrays"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=words):
            read_data(tmp_path / name)


def test_each_repeat_is_the_same_problem_in_other_bytes(tmp_path):
    rng = np.random.default_rng(0)
    rows = Data(rng.standard_normal((30, 4)), rng.standard_normal((30, 2)))
    part = part_of(rows, None, 3)
    assert not part.theta.flags.writeable
    assert not np.shares_memory(part.theta, rows.theta)
    np.testing.assert_allclose(part.theta.T @ part.theta, rows.theta.T @ rows.theta)
    np.testing.assert_allclose(part.theta.T @ part.target, -(rows.theta.T @ rows.target))
    assert (np.abs(part.theta[:, 0]) != np.abs(rows.theta[:, 0])).any()
    assert part_of(rows, (2, 29), 0).theta.tolist() == rows.theta[[0, 1, 29]].tolist()


@pytest.mark.parametrize("targets", [(), (1,), (2,)])
def test_truth_in_a_file_is_weights_or_which_columns_are_used(tmp_path, targets):
    arrays = {"theta": np.eye(5, 4), "target": np.ones(5)}
    truth = np.zeros((4, *targets))
    truth[[1, 3]] = [-0.5, 2.0] if not targets else 0.5
    np.savez(tmp_path / "a.npz", **arrays, truth=truth)
    assert read_data(tmp_path / "a.npz").truth.tolist() == [False, True, False, True]
    np.savez(tmp_path / "b.npz", **arrays, truth=truth[:3])
    with pytest.raises(InputError, match=r"b.npz: truth is \(3,.* of \(5, 4\): it needs 4"):
        read_data(tmp_path / "b.npz")


def test_held_out_errors_by_hand():
    errors = np.array([[4.0, 1.0], [2.0, 3.0], [2.0, 1.0]])
    told = cross_validated(errors, np.array([10.0, 10.0, 10.0]))
    # The others choose: fold 1 at (4, 4) the first, fold 2 at (6, 2), fold 3 at (6, 4) the second.
    assert told["holdout_error"] == pytest.approx((4.0 + 3.0 + 1.0) / 30.0)
    used, truth = np.array([True, True, False]), np.array([True, False, True])
    assert recovered(used, truth) == {"true_support": 2, "precision": 0.5, "recall": 0.5, "f1": 0.5}


def test_a_median_is_known_by_order_statistics():
    rng = np.random.default_rng(3)
    hits = 0
    for _ in range(400):
        _, low, high = median_interval(rng.exponential(size=15))
        hits += low <= math.log(2.0) <= high
    assert 0.93 < hits / 400 <= 1.0
    assert math.isnan(median_interval([1.0] * 5)[1])
    repeats, clock = Case(0, None), Clock(repeats=9, seconds=60.0, precision=0.05)
    repeats.note(0.1, 0.1, first=True)
    assert repeats.times(clock)["repeats"] == 0
    for wall in (1.0, 1.0, 1.01, 1.0, 1.0, 1.0):
        assert not repeats.enough(clock)
        repeats.note(wall, 0.5)
    assert repeats.enough(clock)
    assert repeats.times(clock)["disturbed"]


def test_the_clock_of_a_process_is_its_cpu():
    before, own = cpu_seconds(os.getpid()), time.process_time()
    while time.process_time() - own < 0.2:
        pass
    assert cpu_seconds(os.getpid()) - before == pytest.approx(0.2, abs=0.1)
