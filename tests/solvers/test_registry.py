"""Solvers by name, with settings; of a file, of another package, and as a command."""

import sys
from dataclasses import dataclass
from importlib.metadata import EntryPoint
from typing import ClassVar

import numpy as np
import pytest

import sparsefit as sf
from sparsefit.errors import InputError, MissingExtra, SparsefitError
from sparsefit.regression.backend import plugins
from sparsefit.regression.design import Design
from sparsefit.regression.penalties import AbsoluteValues, SquaredNorm, lasso_penalty
from sparsefit.regression.problem import RegressionProblem
from sparsefit.solvers.registry import LateError, Recipe, answers, solver, solver_names

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


def test_names_settings_and_packages_are_refused_in_a_line(monkeypatch):
    assert {"celer", "clarabel", "skglm", "glum"} <= set(solver_names())
    with pytest.raises(InputError, match='did you mean "celer"'):
        solver("celerr")
    with pytest.raises(InputError, match=r'setting of solver celer.*"iterations"'):
        solver("celer", iteration=3)
    assert solver("osqp").name == "osqp"
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(MissingExtra, match=r"pip install 'sparsefit\[peers\]'"):
        solver("celer")
    assert "sparsefit[peers]" in Recipe("celer").missing


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
    assert recipes[0].stops
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
    assert solver("odd", deed="raises") == Odd("raises")
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
    (answer,) = answers(solver("clarabel"), data, lasso_penalty(6), (1.0,))
    assert (answer.status, answer.clock) == ("ok", None)


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
    recipe = Recipe(
        "theirs", {"factor": 2.0}, str(tmp_path / "study.toml"), (sys.executable, "program.py")
    )
    data, penalty = problem(), AbsoluteValues(np.full(6, 0.5))
    design = Design(data.theta, 50)
    cross = design.correlate(data.target)
    asked = (design, data.target, penalty, np.array([0.4, 0.1]), 1e-8)
    weights, (wall, _) = recipe.make().timed(*asked)
    expected = [2.0 * np.clip(cross / 0.5, -a, a) / 0.5 for a in (0.4, 0.1)]
    np.testing.assert_allclose(weights, expected)
    assert 0.0 < wall < 10.0
    np.testing.assert_array_equal(recipe.make().path(*asked), weights)
    answered = answers(recipe.make(), data, penalty, (1.0,))
    assert answered[0].status == "ok"
    assert (
        answered[0].clock[1] < 0.1
    )  # neither the start of an interpreter nor its imports are in it


def test_a_command_that_fails_says_so(tmp_path):
    with pytest.raises(MissingExtra, match="no program"):
        Recipe("theirs", command=("no-such-program",)).make()
    assert "install it" in Recipe("theirs", command=("./absent",)).missing
    data = problem()
    for words, reason in (("raise SystemExit('no licence')", "no licence"), ("", "code 0")):
        command = Recipe("theirs", command=(sys.executable, "-c", words)).make()
        with pytest.raises(SparsefitError, match=reason):
            command.path(
                Design(data.theta, 50), data.target, lasso_penalty(6), np.array([1.0]), None
            )
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


@pytest.mark.parametrize(
    ("name", "remedy"),
    [("celer", r"'sparsefit\[peers\]'"), ("piqp", r"'sparsefit\[peers\]'"), ("gurobi", "gurobipy")],
)
def test_a_fit_by_what_is_missing_names_the_extra_that_brings_it(name, remedy, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda module: None)
    with pytest.raises(MissingExtra, match=f"{name} is not installed: pip install {remedy}"):
        sf.fit(np.eye(3), np.ones(3), "lasso", solver=name)
