"""The regressors: scikit-learn's own checks, its own models, and its search and pipelines."""

import importlib.util
import sys

import numpy as np
import pytest
from scipy import sparse
from sklearn import linear_model
from sklearn.exceptions import ConvergenceWarning
from sklearn.model_selection import GridSearchCV, TimeSeriesSplit
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import PolynomialFeatures
from sklearn.utils.estimator_checks import check_estimator

import sparsefit as sf
import sparsefit.sklearn as regressors
from sparsefit import backends
from sparsefit.errors import InputError, MissingExtra

EQUIVALENCE = "check_sample_weight_equivalence_on_dense_data"
EXPLAINED = {
    "LeastSquares": "by default it refuses fewer samples than columns, and one case has such",
}


def failures(regressor):
    told = check_estimator(regressor, on_fail=None, on_skip=None)
    return {one["check_name"]: one["exception"] for one in told if one["status"] == "failed"}


def data(seed=0, samples=80, columns=8, targets=2):
    rng = np.random.default_rng(seed)
    design = rng.normal(size=(samples, columns)) * np.geomspace(0.1, 10, columns) + 3.0
    weights = rng.normal(size=(columns, targets)) * (rng.random((columns, targets)) < 0.5)
    return design, design @ weights + 5.0 + 0.3 * rng.normal(size=(samples, targets))


def test_the_checks_of_scikit_learn_pass():
    assert failures(regressors.Lasso()) == {}


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::sklearn.exceptions.ConvergenceWarning")  # of exact fits
@pytest.mark.parametrize("name", ["SparseRegressor", *sorted(regressors.NAMED)])
def test_the_checks_of_scikit_learn_pass_for_each(name):
    regressor = getattr(regressors, name)
    expected = {EQUIVALENCE} if name in EXPLAINED else set()
    assert set(failures(regressor())) == expected, EXPLAINED.get(name)
    if name == "LeastSquares":
        assert failures(regressor(rcond=1e-12)) == {}


@pytest.mark.parametrize("intercept", [True, False])
def test_the_lasso_is_that_of_scikit_learn(intercept):
    design, target = data(targets=1)
    target = target[:, 0]
    ours = regressors.Lasso(alpha_fraction=0.05, fit_intercept=intercept).fit(design, target)
    scale = design.std(axis=0) if intercept else np.sqrt(np.mean(design**2, axis=0))
    level = target - target.mean() if intercept else target
    shifted = design - design.mean(axis=0) if intercept else design
    alpha = 0.05 * np.abs(shifted.T @ level / scale).max() / len(design)
    theirs = linear_model.Lasso(alpha=alpha, fit_intercept=intercept, tol=1e-12, max_iter=100_000)
    theirs.fit(design / scale, target)
    assert ours.coef_ * scale == pytest.approx(theirs.coef_, abs=1e-7)
    assert ours.intercept_ == pytest.approx(theirs.intercept_, abs=1e-7)
    assert ours.predict(design) == pytest.approx(theirs.predict(design / scale), abs=1e-7)
    assert ours.status_ == "ok"
    assert ours.certificate_.value <= 1e-12
    assert ours.alpha_fraction_ == 0.05
    assert ours.alpha_ == pytest.approx(alpha)
    assert ours.n_iter_ >= 1


def test_groups_and_settings_are_those_of_the_back_end():
    design, target = data()
    groups = ["a", "b", "b", "a", "c", "c", "d", "d"]
    ours = regressors.GroupLasso(
        alpha_fraction=0.3, separate=True, groups=groups, fit_intercept=False
    ).fit(design, target)
    problem = sf.RegressionProblem.from_arrays(design, target, groups)
    backend = backends.get("group-lasso", alpha_fraction=0.3, separate=True)
    assert np.array_equal(ours.coef_.T, sf.fit(problem, backend).weights)
    any_backend = regressors.SparseRegressor(backend, groups=groups, fit_intercept=False)
    assert np.array_equal(any_backend.fit(design, target).coef_, ours.coef_)
    with pytest.raises(InputError, match="groups must have one label per column"):
        regressors.GroupLasso(groups=groups[:3]).fit(design, target)


def test_a_constant_column_has_no_weight():
    design, target = data()
    design[:, 2] = 1e6 / 3
    regressor = regressors.LeastSquares().fit(design, target)
    assert not regressor.coef_[:, 2].any()
    others = np.delete(design, 2, axis=1)
    expected = linear_model.LinearRegression().fit(others, target)
    assert regressor.predict(design) == pytest.approx(expected.predict(others))
    with pytest.raises(regressors.FitFailed, match="every column of X is constant"):
        regressors.Lasso().fit(np.ones((5, 2)), np.arange(5.0))


def test_what_is_not_proven_is_warned_of_and_what_failed_raises():
    design, target = data()
    with pytest.warns(ConvergenceWarning, match="lasso is not certified, inaccurate: duality_gap"):
        regressors.Lasso(certificate_tolerance=0.0).fit(design, target)
    with pytest.raises(regressors.FitFailed, match="stlsq has no answer, unidentifiable: empty"):
        regressors.STLSQ(threshold=5.0).fit(design, target)
    with pytest.raises(ValueError, match="alpha_fraction must be"):
        regressors.Lasso(alpha_fraction=2.0).fit(design, target)
    with pytest.raises(InputError, match="tolerance must be a number"):
        regressors.Lasso(certificate_tolerance="small").fit(design, target)
    with pytest.raises(InputError, match="groups must have labels of one kind"):
        regressors.Lasso(groups=[None, 1, 2, 3, 4, 5, 6, 7]).fit(design, target)


def test_a_search_over_a_pipeline_with_blocks_of_time():
    rng = np.random.default_rng(3)
    states = rng.normal(size=(120, 2)).cumsum(axis=0) / 5.0
    target = 2.0 * states[:, 0] * states[:, 1] - 1.0 + 0.1 * rng.normal(size=120)
    pipeline = make_pipeline(PolynomialFeatures(3, include_bias=False), regressors.Lasso())
    search = GridSearchCV(
        pipeline,
        {"lasso__alpha_fraction": [0.5, 0.05, 0.01], "lasso__selection": ["bic"]},
        cv=TimeSeriesSplit(3),
    )
    search.fit(states, target)
    assert search.best_params_["lasso__alpha_fraction"] < 0.5
    best = search.best_estimator_
    names = best[0].get_feature_names_out()
    assert names[np.argmax(np.abs(best[1].coef_))] == "x0 x1"
    assert best[1].certificate_.kind == "duality_gap"


def test_without_scikit_learn_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "sklearn.base", None)
    spec = importlib.util.spec_from_file_location("again", regressors.__file__)
    with pytest.raises(MissingExtra, match=r"pip install 'sparsefit\[sklearn\]'"):
        spec.loader.exec_module(importlib.util.module_from_spec(spec))
    with pytest.raises(AttributeError, match="no attribute 'Lazzo'"):
        _ = regressors.Lazzo


@pytest.mark.parametrize("name", ["Lasso", "ElasticNet", "GroupLasso", "SquareRootLasso"])
@pytest.mark.parametrize("intercept", [True, False])
@pytest.mark.parametrize("weighted", [True, False])
def test_a_sparse_matrix_gives_what_the_dense_one_gives(name, intercept, weighted):
    design, target = data(targets=1)
    design[np.abs(design) < 3.0] = 0.0
    design[:, 5] = 1e9 * intercept
    weight = np.random.default_rng(2).integers(0, 3, len(design)).astype(float)
    settings = {"alpha_fraction": 0.05, "fit_intercept": intercept}
    weights = weight if weighted else None
    dense = getattr(regressors, name)(**settings).fit(design, target, weights)
    thin = getattr(regressors, name)(**settings).fit(sparse.csr_matrix(design), target, weights)
    assert thin.coef_ == pytest.approx(dense.coef_, abs=1e-9)
    assert thin.intercept_ == pytest.approx(dense.intercept_)
    assert thin.alpha_ == pytest.approx(dense.alpha_)
    assert thin.predict(sparse.csc_matrix(design)) == pytest.approx(dense.predict(design))


def test_a_parameter_that_is_none_is_refused_with_the_one_that_is_meant():
    with pytest.raises(InputError, match='of Lasso "alpha": set alpha_fraction, the penalty'):
        regressors.Lasso(alpha=0.1)
    with pytest.raises(InputError, match='unknown parameter of Lasso "grups"'):
        regressors.Lasso(grups=[1, 2])
