import json
import math

import numpy as np
import pytest

from sparsefit import bench
from sparsefit.bench.contender import interpolated, rows_form
from sparsefit.bench.contenders import ALL
from sparsefit.bench.measure import Reach, Run, needed, reach
from sparsefit.bench.problems import NAMED, QUICK_GRID, tasks
from sparsefit.bench.robustness import ALTERATIONS, draw_problem
from sparsefit.bench.scaling import exponent
from sparsefit.bench.targets import judged
from sparsefit.errors import InputError
from sparsefit.regression.certificate import duality_gaps

pytestmark = pytest.mark.slow  # peers are compiled and run


@pytest.fixture(scope="module")
def result():
    return bench.run(quick=True, repeats=2)


@pytest.fixture(scope="module")
def small():
    return tasks(NAMED[1], points=6, grid=QUICK_GRID)


@pytest.mark.parametrize("contender", ALL, ids=[c.name for c in ALL])
def test_every_contender_solves_the_objective_that_we_certify(contender, small):
    if not contender.installed:
        pytest.skip(f"{contender.package} is not installed")
    for task in small:
        if task.kind in contender.kinds:
            setting = contender.settings[min(2, len(contender.settings) - 1)]
            weights = contender.solve(task, task.fractions, setting)
            p = task.problem
            found = duality_gaps(
                p.theta, p.target, p.statistics.rms, weights, task.alphas, task.penalty
            )
            assert max(c.value for c in found) < 1e-3, task.kind


def test_quick_run_measures_ours_to_the_promised_gap(result):
    for kind in ("lasso", "group-lasso", "joint-group-lasso"):
        assert result.reach(kind, NAMED[0].name, "sparsefit", 1e-8, "gap").seconds > 0
    assert {r.kind for r in result.robustness} == {"lasso", "joint-group-lasso"}
    assert all(row.certified == row.points for row in result.robustness)


def test_nobody_vanishes(result, tmp_path):
    text = (bench.write(result, tmp_path) / "README.md").read_text(encoding="utf-8")
    for contender in ALL:
        assert contender.name in text
    assert "adelie" in text
    assert "numpy<2" in text


def test_written_files(result, tmp_path):
    folder = bench.write(result, tmp_path)
    assert folder == tmp_path / "solvers"
    names = {path.name for path in folder.iterdir()}
    tables = {f"{t}.{s}" for t in ("times", "targets", "scaling") for s in ("md", "tex", "csv")}
    wanted = {"times.svg", "times.png", "README.md", "manifest.json", "runs.csv", *tables}
    assert wanted <= names
    manifest = json.loads((folder / "manifest.json").read_text(encoding="utf-8"))
    assert manifest["quick"] is True
    assert manifest["versions"]["numpy"] == np.__version__


def test_every_target_is_judged(result):
    words = " ".join(j.what for j in judged(result))
    for part in ("certified", "cvxpy", "Clarabel direct", "best public peer", "Theta", "threads"):
        assert part in words


def test_unknown_names_are_refused():
    with pytest.raises(InputError, match="short clean"):
        bench.run(problems=("short cleam",))
    with pytest.raises(InputError, match="celer"):
        bench.run(contenders=("celery",))


def _run(setting, seconds, gap, *, last=False):
    return Run("lasso", "p", "c", setting, (seconds,), gap, gap / 10, 0, last)


def test_reach_is_the_loosest_setting_that_suffices():
    runs = [_run(1e-4, 0.1, 1e-3), _run(1e-6, 0.2, 1e-7), _run(1e-8, 0.3, 1e-9)]
    assert reach(runs, 1e-6).seconds == 0.2
    assert reach(runs, 1e-6, "sub").seconds == 0.2
    assert reach(runs, 1e-10) == Reach(None, 1e-9)
    assert needed(runs) == runs


def test_reach_of_a_solver_that_was_stopped_is_a_lower_bound():
    at = reach([_run(1e-4, 5.0, 1e-3, last=True)], 1e-8)
    assert at == Reach(None, 1e-3, 5.0)


def test_interpolated_path():
    knots, coefficients = np.array([4.0, 2.0, 1.0]), np.array([[0.0, 2.0, 3.0]])
    found = interpolated(knots, coefficients, np.array([5.0, 4.0, 3.0, 2.0, 1.5, 0.1]))
    np.testing.assert_allclose(found, [[0.0, 0.0, 1.0, 2.0, 2.5, 3.0]])


@pytest.mark.parametrize("place", [0, 2])
def test_rows_form_keeps_the_objective(small, place):
    task = small[place]
    rows = rows_form(task)
    draw = np.random.default_rng(0)
    coefficients = draw.standard_normal((rows.design.shape[1], 1))
    weights = rows.weights(coefficients)[0]
    loss = np.sum((rows.target - rows.design @ coefficients[:, 0]) ** 2) / (2 * len(rows.target))
    residual = task.problem.target - task.problem.theta @ weights
    np.testing.assert_allclose(loss, np.sum(residual**2) / (2 * task.problem.samples))


def test_degenerate_flights_are_reproducible_and_of_every_kind():
    names = {draw_problem(seed)[0].split(",")[0] for seed in range(2 * len(ALTERATIONS))}
    assert names == set(ALTERATIONS)
    np.testing.assert_array_equal(draw_problem(3)[1].theta, draw_problem(3)[1].theta)


def test_exponent_of_a_power():
    assert exponent([1, 10, 100], [2, 200, 20_000]) == pytest.approx(2.0)
    assert math.isfinite(exponent([1, 2], [1, 1]))
