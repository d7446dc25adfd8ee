"""Solvers by name, of a file, another package or a command; public ones: one objective for all."""

import sys
import warnings
from dataclasses import dataclass, replace
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
from scipy import sparse

from sparsefit.errors import InputError, MissingExtra, SparsefitError
from sparsefit.regression.backend import plugins
from sparsefit.regression.design import Design
from sparsefit.regression.group_penalties import GroupNorms, NestedNorms
from sparsefit.regression.losses import RootSquares, Squares
from sparsefit.regression.ordered_penalties import FusedNorm, SortedNorm
from sparsefit.regression.penalties import (
    AbsoluteValues,
    BoundedValues,
    SquaredNorm,
    alpha_max,
    lasso_penalty,
)
from sparsefit.regression.problem import RegressionProblem
from sparsefit.solvers.commands import Task, kind_of
from sparsefit.solvers.conic import Cvxpy
from sparsefit.solvers.registry import LateError, Recipe, answers, solver_names

PUBLIC = Path(__file__).parents[2] / "studies/solvers/public_solvers.py"
MINE = '''
from __future__ import annotations
from dataclasses import dataclass
from typing import ClassVar
import numpy as np

@dataclass(frozen=True)
class Descent:
    """Proximal gradient descent."""
    name: ClassVar[str] = "mine"
    iterations: int = 1000

    def path(self, design, target, penalty, alphas, tolerance):
        step = 1.0 / np.linalg.eigvalsh(design.products(slice(None)))[-1]
        weights, found = np.zeros((design.shape[1], target.shape[1])), []
        for alpha in alphas:
            for _ in range(self.iterations):
                pull = design.correlate(target - design.predict(weights))
                weights = penalty.prox(weights + step * pull, step * alpha)
            found.append(weights)
        return np.stack(found)
'''
PROGRAM = """
import json, sys
import numpy as np
from pathlib import Path
folder = Path(sys.argv[1])
problem = json.loads((folder / "problem.json").read_text())
X, y = np.load(folder / "design.npy"), np.load(folder / "target.npy")
print("ready", flush=True)
sys.stdin.readline()
cross, factor = X.T @ y / len(y), problem["settings"]["factor"]
u = [np.clip(cross, -f, f).T * factor for f in problem["fractions"]]
print("done", flush=True)
np.save(folder / "answer.npy", np.stack(u))
"""


def problem(targets=2):
    rng = np.random.default_rng(3)
    theta = rng.normal(size=(50, 6)) * [1.0, 10.0, 0.1, 1.0, 2.0, 3.0]
    return RegressionProblem.from_arrays(theta, theta[:, :targets] + 0.1)


@dataclass(frozen=True)
class Odd:
    name: ClassVar[str] = "odd"
    deed: str = "shape"

    def path(self, design, target, penalty, alphas, tolerance):
        if self.deed == "raises":
            raise ZeroDivisionError("of its own")
        if self.deed == "boasts":
            return np.ones((1, 6, 2)), (0.0, 0.0)
        return np.zeros((1, 1))


def recipe_of(name, **settings):
    """The solver of the file of public solvers, or the referee."""
    return Recipe(name, settings, "" if name == "clarabel" else str(PUBLIC))


def solver(name, **settings):
    return recipe_of(name, **settings).make()


def test_names_settings_and_packages_are_refused_in_a_line(monkeypatch):
    assert solver_names() == ("clarabel",)
    with pytest.raises(InputError, match='did you mean "celer"'):
        solver("celerr")
    with pytest.raises(InputError, match=r'setting of solver celer.*"iterations"'):
        solver("celer", iteration=3)
    with pytest.raises(InputError, match="iterations"):
        solver("celer", iterations=0)
    with pytest.raises(InputError, match='"celer"'):
        Recipe("celer").make()
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    for name in ("celer", "piqp"):
        with pytest.raises(MissingExtra, match=rf"^{name} is not .* 'sparsefit\[peers\]'"):
            solver(name)
    assert "pip install gurobipy" in recipe_of("gurobi").missing


def test_a_file_beside_a_study_has_solvers_with_settings(tmp_path):
    path = tmp_path / "mine.py"
    path.write_text(MINE)
    recipes = [Recipe("mine", {"iterations": n}, file=str(path)) for n in (1, 3000)]
    data, penalty = problem(), lasso_penalty(6)
    rough, fine = (answers(r.make(), data, penalty, (1.0, 0.1)) for r in recipes)
    exact = answers(solver("clarabel"), data, penalty, (1.0, 0.1), 1e-13)
    reference = exact[1].weights
    np.testing.assert_allclose(fine[1].weights, reference, atol=1e-8)
    assert np.abs(rough[1].weights - reference).max() > 1e-3
    assert recipes[0].declared("stops")
    with pytest.raises(InputError, match=r'solver of mine\.py "other"'):
        Recipe("other", file=str(path)).make()
    (tmp_path / "bad.py").write_text("1 / 0")
    with pytest.raises(InputError, match="ZeroDivisionError"):
        Recipe("mine", file=str(tmp_path / "bad.py")).make()
    (tmp_path / "none.py").write_text("")
    with pytest.raises(InputError, match="no frozen dataclass"):
        Recipe("mine", file=str(tmp_path / "none.py")).make()
    with pytest.raises(InputError, match="no such Python file"):
        Recipe("mine", file=str(tmp_path / "absent.py")).make()


def test_a_plug_in_is_found_by_its_entry_point(monkeypatch):
    entry = EntryPoint("odd", f"{__name__}:Odd", "sparsefit.solvers")
    plugins.cache_clear()
    monkeypatch.setattr("importlib.metadata.entry_points", lambda group: [entry])
    monkeypatch.setitem(sys.modules, __name__, sys.modules[Odd.__module__])
    assert solver_names()[-1] == "odd"
    assert Recipe("odd", {"deed": "raises"}).make() == Odd("raises")
    plugins.cache_clear()


@pytest.mark.parametrize("deed", ["shape", "raises"])
def test_what_goes_wrong_in_a_solver_is_an_answer_with_a_reason(deed):
    found = answers(Odd(deed), problem(), lasso_penalty(6), (1.0, 0.5))
    assert [each.status for each in found] == ["error", "error"]
    assert found[0].weights is None
    assert ("of its own" if deed == "raises" else "(2, 6, 2)") in found[0].reason


def test_only_a_command_is_timed_by_its_own_clock():
    data = problem()
    (answer,) = answers(Odd("boasts"), data, lasso_penalty(6), (1.0,))
    assert (answer.status, answer.clock) == ("error", None)


@pytest.mark.parametrize(
    ("words", "shown"), [("not converged", "not converged"), ("n" * 200, "n" * 104 + "...")]
)
def test_a_warning_makes_an_answer_inaccurate(words, shown):
    @dataclass(frozen=True)
    class Warns(Odd):
        def path(self, design, target, penalty, alphas, tolerance):
            import warnings

            warnings.warn(words, UserWarning, stacklevel=1)
            warnings.warn("deprecated", FutureWarning, stacklevel=1)
            return np.zeros((1, 6, 2))

    (found,) = answers(Warns(), problem(), lasso_penalty(6), (1.0,))
    assert (found.status, found.reason) == ("inaccurate", f"odd: UserWarning: {shown}")
    assert len(found.solver_status) <= 120


def test_a_command_is_handed_a_folder_and_timed_between_its_lines(tmp_path):
    (tmp_path / "program.py").write_text(PROGRAM)
    words = (sys.executable, "program.py")
    recipe = Recipe("theirs", {"factor": 2.0}, str(tmp_path / "study.toml"), words)
    data, penalty = problem(), AbsoluteValues(np.full(6, 0.5))
    design = Design(data.theta, 50)
    cross = design.correlate(data.target)
    asked = (design, data.target, penalty, np.array([0.4, 0.1]), 1e-8)
    weights, _ = recipe.make().timed(*asked)
    expected = [2.0 * np.clip(cross / 0.5, -a, a) / 0.5 for a in (0.4, 0.1)]
    np.testing.assert_allclose(weights, expected)
    np.testing.assert_array_equal(recipe.make().path(*asked), weights)
    (answered,) = answers(recipe.make(), data, penalty, (1.0,))
    assert answered.status == "ok"
    assert answered.clock[1] < 0.1  # without the start of an interpreter and its imports


def test_a_command_that_fails_says_so(tmp_path):
    with pytest.raises(MissingExtra, match="no program"):
        Recipe("theirs", command=("no-such-program",)).make()
    assert "install it" in Recipe("theirs", command=("./absent",)).missing
    data, penalty = problem(), lasso_penalty(6)
    for words, reason in (("raise SystemExit('no licence')", "no licence"), ("", "code 0")):
        command = Recipe("theirs", command=(sys.executable, "-c", words)).make()
        with pytest.raises(SparsefitError, match=reason):
            command.path(Design(data.theta, 50), data.target, penalty, np.array([1.0]), None)
    assert "no such penalty" in command.takes(SquaredNorm(6))


@pytest.mark.parametrize(
    ("words", "limits", "reason"),
    [
        ("sleep 60", (9.0, 0.2), "longer than 0.2 s to start"),
        ("echo ready; read go; sleep 60", (0.2, 9.0), "took longer than 0.2 s$"),
        ("echo ready; read go; echo done; exec >&-; sleep 60", (9.0, 0.5), "0.5 s .* to write"),
    ],
)
def test_a_command_is_ended_at_its_limits(words, limits, reason):
    limit, start = limits
    command = Recipe("theirs", command=("sh", "-c", words), limit=limit, start=start).make()
    with pytest.raises(LateError, match=reason):
        answers(command, problem(), lasso_penalty(6), (1.0,))


K = 18
GROUPS = np.arange(K) // 3
LASSO = AbsoluteValues(np.ones(K))
EXACT = {  # what a peer reaches here of the objective at zero, where it is not 1e-9
    "celer": 1e-5,  # its own dual point is worse than ours where samples are few
    "glum": 1e-8,
}
PENALTIES = {
    "LASSO": LASSO,
    "adaptive": AbsoluteValues(np.linspace(0.5, 2.0, K)),
    "elastic net": replace(LASSO, ridge=0.7),
    "groups": GroupNorms(GROUPS, np.linspace(1.0, 2.0, 6), together=False),
    "joint": GroupNorms(GROUPS, np.linspace(1.0, 2.0, 6)),
    "sparse-group": NestedNorms(GroupNorms(GROUPS, 0.6 * np.ones(6), together=False), LASSO),
    "SLOPE": SortedNorm(np.linspace(2.0, 0.5, K)),
}
OTHERS = {  # of which only conic solvers take any
    "non-negative": BoundedValues(np.ones(K), lower=np.zeros(K), upper=np.full(K, np.inf)),
    "fused": FusedNorm(K, 0.5),
    "root": replace(LASSO, loss=RootSquares()),
    "Huber": replace(LASSO, loss=Squares(clip=0.5)),
    "ridge": SquaredNorm(K),
}


def posed(rows=60, seed=0):
    rng = np.random.default_rng(seed)
    theta = rng.normal(size=(rows, K)) * rng.uniform(0.5, 2.0, K)
    return theta, theta[:, :4] @ rng.normal(size=(4, 2)) + 0.3 * rng.normal(size=(rows, 2))


def path_of(name, design, target, penalty, points=5):
    alphas = alpha_max(design.correlate(target), penalty) * np.geomspace(1.0, 0.03, points)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return solver(name).path(design, target, penalty, alphas, 1e-11), alphas


def objective(design, target, penalty, weights, alphas):
    residual = target - np.stack([design.predict(values) for values in weights])
    half = np.square(residual).sum(axis=(1, 2)) / (2 * design.samples)
    return half + alphas * penalty.value(weights)


SLOW = ("skglm",)  # half a minute to compile
MODULE = sys.modules[recipe_of("celer").owner.__module__]
NAMES = [each.name for each in MODULE.Public.__subclasses__()]  # not those behind cvxpy: slower
INSTALLED = ["clarabel", *(name for name in NAMES if not recipe_of(name).missing)]


def kinds_and_solvers():
    for kind, penalty in PENALTIES.items():
        takers = [name for name in INSTALLED if not solver(name).takes(penalty)]
        assert len(takers) >= 2, kind
        yield kind, 12, [name for name in takers if name not in SLOW]
        yield kind, 60, [name for name in takers if name not in SLOW]
        slow = [name for name in takers if name in SLOW]
        yield pytest.param(kind, 60, slow, marks=pytest.mark.slow)


@pytest.mark.parametrize(("kind", "rows", "names"), list(kinds_and_solvers()))
def test_every_solver_reaches_the_objective_of_the_referee(kind, rows, names):
    theta, target = posed(rows)
    penalty, design = PENALTIES[kind], Design(theta, rows)
    best, alphas = path_of("clarabel", design, target, penalty)
    reference = objective(design, target, penalty, best, alphas)
    null = np.square(target).sum() / (2 * rows)
    for name in names:
        weights, _ = path_of(name, design, target, penalty)
        excess = (objective(design, target, penalty, weights, alphas) - reference) / null
        assert excess.max() < EXACT.get(name, 1e-9), name
        assert excess.min() > -1e-9, name


@pytest.mark.parametrize("name", ["celer", "scikit-learn-cd", "glum", "sortedl1"])
def test_a_sparse_design_gives_the_weights_of_the_dense_one(name):
    theta, target = posed()
    theta[np.abs(theta) < 0.8] = 0.0
    penalty = next(p for p in PENALTIES.values() if not solver(name).takes(p))
    dense, _ = path_of(name, Design(theta, 60), target, penalty)
    thin, _ = path_of(name, Design(sparse.csc_matrix(theta), 60), target, penalty)
    np.testing.assert_allclose(thin, dense, atol=1e-4 * np.abs(dense).max())


@pytest.mark.parametrize("kind", PENALTIES)
def test_columns_of_zeros_are_left_out_and_get_a_weight_of_zero(kind):
    theta, target = posed()
    theta[:, GROUPS == 0] = 0.0

    task = Task.of(Design(theta, 60), target, PENALTIES[kind], np.array([1.0, 0.5]))
    assert task.design.any(axis=0).all()
    assert np.array_equal(np.unique(task.groups), np.arange(task.groups.max() + 1))
    assert task.lambdas is None or len(task.lambdas) == K - 3
    weights = task.weights(lambda part: np.ones((2, (K - 3) * target[:, part].shape[1])))
    assert np.array_equal(weights.any(axis=(0, 2)), GROUPS > 0)


@pytest.mark.parametrize("kind", OTHERS)
def test_the_referee_takes_every_penalty_whole_and_by_working_sets(kind):
    theta, target = posed()
    design = Design(theta, 60)
    ours, _ = path_of("clarabel", design, target, OTHERS[kind], 3)
    alphas = alpha_max(design.correlate(target), OTHERS[kind]) * np.geomspace(1.0, 0.03, 3)
    theirs = Cvxpy.path(solver("clarabel"), design, target, OTHERS[kind], alphas, None)
    np.testing.assert_allclose(theirs, ours, atol=1e-4 * np.abs(ours).max())
    assert not kind_of(OTHERS[kind])
    assert "only" in solver("celer").takes(OTHERS[kind])


def test_working_sets_of_the_referee_leave_out_what_does_not_object():
    rng = np.random.default_rng(1)
    theta = rng.normal(size=(80, 400))
    target = theta[:, :3] @ np.ones((3, 1)) + 0.1 * rng.normal(size=(80, 1))
    design = Design(theta, 80)
    for penalty in (AbsoluteValues(np.ones(400)), SortedNorm(np.linspace(1.0, 0.9, 400))):
        some, alphas = path_of("clarabel", design, target, penalty, 3)
        correlation = design.correlate(target - design.predict(some[-1]))
        gap = penalty.dual_norm(correlation).max() / alphas[-1] - 1.0
        assert abs(gap) < 1e-6


def test_what_a_solver_does_not_take_is_refused_in_a_line():
    theta, target = posed()
    posed_problem = RegressionProblem.from_arrays(theta, target, GROUPS)
    (found,) = answers(solver("scikit-learn-lars"), posed_problem, PENALTIES["joint"], (1.0,))
    assert (found.status, found.weights) == ("error", None)
    assert "scikit-learn-lars solves LASSO only" in found.reason
    assert "cones" in solver("osqp").takes(PENALTIES["joint"])
    unstated = type("Unstated", (AbsoluteValues,), {"conic": SquaredNorm.__mro__[1].conic})
    assert "no method `conic`" in solver("clarabel").takes(unstated(np.ones(K)))
