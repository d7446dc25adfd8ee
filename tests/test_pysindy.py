"""SINDy models fitted by our back-ends, beside PySINDy's own optimizer and the truth."""

import numpy as np
import pysindy as ps
import pytest
from pysindy.utils import lorenz
from scipy.integrate import solve_ivp
from sklearn.base import clone
from sklearn.exceptions import ConvergenceWarning

from sparsefit import backends
from sparsefit.pysindy import Optimizer

TIMES = np.arange(0.0, 4.0, 0.002)
TRUTH = {("x", "x"): -10, ("x", "y"): 10, ("y", "x"): 28, ("y", "y"): -1, ("y", "x z"): -1}
TRUTH |= {("z", "z"): -2.66667, ("z", "x y"): 1}


@pytest.fixture(scope="module")
def states():
    return solve_ivp(lorenz, (0.0, 4.0), [-8.0, 8.0, 27.0], t_eval=TIMES, rtol=1e-9, atol=1e-9).y.T


def fitted(optimizer, states):
    model = ps.SINDy(optimizer=optimizer, feature_library=ps.PolynomialLibrary(2))
    return model.fit(states, t=TIMES, feature_names=["x", "y", "z"])


@pytest.mark.parametrize(
    ("optimizer", "peer"),
    [
        (Optimizer(), ps.STLSQ()),
        (Optimizer("stlsq"), ps.STLSQ()),
        (Optimizer(backends.get("stlsq", mode="pysindy", threshold=0.2)), ps.STLSQ(threshold=0.2)),
    ],
)
def test_stlsq_is_that_of_pysindy_and_finds_the_noise_free_lorenz_system(states, optimizer, peer):
    ours, theirs = fitted(optimizer, states), fitted(peer, states)
    assert ours.coefficients() == pytest.approx(theirs.coefficients(), rel=1e-9)
    assert ours.predict(states[:5]) == pytest.approx(theirs.predict(states[:5]), rel=1e-9)
    assert ours.complexity == theirs.complexity == 7
    assert ours.optimizer.status_ == "ok"
    terms = ours.get_feature_names()
    found = {
        ("xyz"[state], terms[term]): ours.coefficients()[state, term]
        for state, term in zip(*np.nonzero(ours.coefficients()), strict=True)
    }
    assert found == pytest.approx(TRUTH, rel=5e-3)  # finite differences of steps of 0.002


def test_printing_says_that_ok_is_no_word_on_the_truth(states):
    optimizer = Optimizer()
    assert str(optimizer) == "Optimizer()"
    fitted(optimizer, states)
    words = str(optimizer).splitlines()[-1]
    assert words == (
        "ok (fixed_point 0.0e+00): one more iteration keeps these terms: no optimum is claimed; "
        "not that the model is true"
    )
    lasso = Optimizer("lasso", certificate_tolerance=0.0)
    with pytest.warns(ConvergenceWarning):
        fitted(lasso, states)
    assert "inaccurate (duality_gap" in str(lasso)
    assert "were it ok, these weights are the optimum" in str(lasso)


def test_weights_that_are_not_fitted_again_are_those_that_are_certified(states):
    shrunk = Optimizer(backends.get("lasso", alpha_fraction=0.02), unbias=False)
    fitted(shrunk, states)
    assert clone(shrunk).get_params() == shrunk.get_params()
    certificate = shrunk.certificate_
    assert certificate.kind == "duality_gap"
    assert certificate.value <= 1e-8
    assert shrunk.alpha_fraction_ == 0.02
    unbiased = Optimizer(shrunk.backend)
    fitted(unbiased, states)
    assert np.array_equal(unbiased.coef_ != 0, shrunk.coef_ != 0)
    assert np.abs(unbiased.coef_ - shrunk.coef_).max() > 1e-3
