"""A package of back-ends that pip installs: what it brings works, and each fault is named."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import sparsefit as sf
from sparsefit import backends
from sparsefit.cli import main
from sparsefit.regression.backend import plugins
from sparsefit.sklearn import SparseRegressor
from sparsefit.study import worker
from tests.problems import regular

PACKAGE = Path(__file__).parent / "plugin"
NAMES = {"damped", "half-lasso", "scribbler", "chatterbox", "misshapen", "needy", "absent"}
PIP = (
    "pip",
    "install",
    "--quiet",
    "--no-deps",
    "--no-build-isolation",
    "--no-index",
    "--no-compile",
)


@pytest.fixture(scope="module", autouse=True)
def installed(tmp_path_factory):
    """The package in a folder of its own that is on the path, built from a copy of the source."""
    folder = tmp_path_factory.mktemp("plugin")
    shutil.copytree(PACKAGE, folder / "source", ignore=shutil.ignore_patterns("__pycache__"))
    command = [sys.executable, "-m", *PIP, "--disable-pip-version-check", "--target"]
    subprocess.run([*command, folder / "site", folder / "source"], check=True, cwd=folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(folder / "site"))
        plugins.cache_clear()
        yield folder / "site"
    plugins.cache_clear()


def test_it_is_a_back_end_like_any_other(installed):
    assert set(backends.known()) >= NAMES
    assert backends.distribution("damped") == "odd-backends 0.7"
    backend = backends.get("damped", amount=0.25)
    assert sys.modules[type(backend).__module__].__file__.startswith(str(installed))
    problem = regular()
    found = sf.fit(problem, backend)
    augmented = np.diag(0.5 * problem.design.rms * np.sqrt(problem.samples))
    rows = np.vstack([problem.theta, augmented])
    target = np.vstack([problem.target, np.zeros((problem.columns, 2))])
    assert found.status == "ok"
    assert backends.settings_of(found.backend) == {"amount": 0.25}
    estimator = sf.Estimator(backend="damped")
    assert sf.Estimator.from_json(estimator.to_json()) == estimator
    assert found.weights == pytest.approx(np.linalg.lstsq(rows, target)[0], rel=1e-9)
    regressor = SparseRegressor("damped", fit_intercept=False)
    regressor.fit(problem.theta, problem.target)
    assert np.array_equal(regressor.coef_.T, sf.fit(problem, backends.get("damped")).weights)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("damped", None),
        ("half-lasso", "it says ok of an answer that is not: duality_gap"),
        ("scribbler", "'scribbler' writes into problem.theta, which it is given to read"),
        ("chatterbox", "it prints: 'iteration 1 of 1"),
        ("misshapen", "'misshapen' returned weights of shape (2, 24), not (24, 2)"),
        ("needy", "it needs the package 'no_such_solver', which is not installed"),
    ],
)
def test_check_names_what_is_wrong(capfd, monkeypatch, name, words):
    """In this process: tests/cli has the one that a check starts."""
    monkeypatch.setattr(worker, "in_child", lambda work, *told, seconds: work(*told))
    code = main(["backends", "check", name, "--json"])
    record = json.loads(capfd.readouterr().out)  # what a back-end prints is elsewhere
    assert record["backend"] == name
    assert code == (1 if words else 0)
    assert len(record["faults"]) == (1 if words else 0), record["faults"]
    assert words is None or words in record["faults"][0]
