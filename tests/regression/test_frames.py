"""What people do with a fit and a path: frames, predictions, pictures, and calls with arrays."""

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure
from scipy import sparse

import sparsefit as sf
from sparsefit import backends
from sparsefit.errors import InputError


def arrays(targets=2):
    rng = np.random.default_rng(5)
    theta = rng.normal(size=(60, 4)) * [1.0, 10.0, 0.1, 1.0]
    target = theta[:, :2] @ [[1.0, 2.0], [0.3, 0.0]] + 0.01 * rng.normal(size=(60, 2))
    return theta, target[:, :targets]


def problem(targets=2):
    return sf.RegressionProblem.from_arrays(*arrays(targets), names=["a", "<b>", "c", "d"])


def test_a_fit_predicts_and_has_a_frame_by_names():
    theta, target = arrays()
    fit = sf.fit(problem(), "lasso", alpha_fraction=0.01)
    np.testing.assert_allclose(fit.predict(theta), theta @ fit.weights)
    np.testing.assert_allclose(fit.predict(sparse.csr_matrix(theta)), theta @ fit.weights)
    frame = pd.DataFrame(theta, columns=["a", "<b>", "c", "d"])
    single = sf.fit(frame, target[:, 0], "lasso", alpha_fraction=0.01)
    assert single.predict(frame).shape == (60,)
    assert single.predict(theta[0]) == pytest.approx(theta[0] @ single.weights)
    np.testing.assert_array_equal(fit.to_frame().loc["<b>"], fit.weights[1])
    with pytest.raises(InputError, match="predict needs 4 columns, not 3"):
        fit.predict(theta[:, :3])


def test_a_fit_with_an_intercept_predicts_with_it():
    theta, target = arrays(1)
    posed = sf.RegressionProblem.from_arrays(theta, target + 7.0, intercept=True)
    fit = sf.fit(posed, "lasso", alpha_fraction=1e-3)
    assert fit.predict(theta) == pytest.approx(target[:, 0] + 7.0, abs=0.1)
    assert fit.intercept == pytest.approx(7.0, abs=0.1)
    assert sf.fit(theta, target, "lasso").intercept == 0.0


def test_columns_of_a_frame_are_taken_by_their_names():
    theta, target = arrays()
    frame = pd.DataFrame(theta, columns=["a", "<b>", "c", "d"])
    fit = sf.fit(frame, pd.DataFrame(target, columns=["u", "v"]), "lasso", alpha_fraction=0.01)
    turned = frame[["d", "c", "<b>", "a"]].assign(more=1.0)
    np.testing.assert_array_equal(fit.predict(turned), fit.predict(theta))
    np.testing.assert_array_equal(fit.predict(pd.DataFrame(theta)), fit.predict(theta))
    with pytest.raises(InputError, match="predict needs the column 'a', and theta has it not"):
        fit.predict(turned.drop(columns="a"))
    assert list(fit.to_frame().columns) == ["u", "v"]
    assert list(sf.fit(frame, pd.Series(target[:, 0], name="u"), "lasso").to_frame()) == ["u"]
    assert list(sf.fit(frame, pd.Series(target[:, 0]), "lasso").to_frame()) == ["0"]

    class Named(np.ndarray):  # as of packages whose arrays of any shape have a name
        name, to_numpy = "whole", np.asarray

    posed = sf.RegressionProblem.from_arrays(theta.view(Named), target.view(Named))
    assert (posed.names, posed.target_names) == (("0", "1", "2", "3"), ("0", "1"))


@pytest.mark.parametrize("name", ["lasso", "least-squares", "stlsq", "group-omp"])
def test_weights_and_an_intercept_go_with_arrays(name):
    """Samples of weight 2 count as two; rows that are centred by hand have the same weights."""
    theta, target = arrays(1)
    weight = np.repeat([2.0, 1.0], 30)
    fit = sf.fit(theta + 3.0, target + 7.0, name, sample_weight=weight, intercept=True)
    twice = np.repeat(np.arange(60), weight.astype(int))
    centred = [rows - rows.mean(axis=0) for rows in (theta[twice], target[twice])]
    by_hand = sf.fit(*centred, name)
    assert fit.status == by_hand.status == "ok"
    np.testing.assert_allclose(fit.weights, by_hand.weights, atol=1e-9)
    whole = fit.predict(theta + 3.0)[twice]
    assert whole.mean() == pytest.approx(target[twice].mean() + 7.0)


def test_alpha_stands_beside_its_fraction():
    path = sf.path(problem(1), "lasso", [0.5, 0.1])
    theta, target = arrays(1)
    rms = np.sqrt(np.mean(theta**2, axis=0))
    largest = np.abs((theta / rms).T @ target).max() / 60
    np.testing.assert_allclose(path.alphas, largest * np.array([0.5, 0.1]))
    assert path.fits[1].alpha == pytest.approx(path.alphas[1])
    assert path.fits[1].alpha_fraction == 0.1
    assert np.isnan(sf.fit(problem(1), "least-squares").alpha)


@pytest.mark.parametrize("targets", [1, 2])
def test_a_path_has_a_frame_and_a_picture(targets):
    path = sf.path(problem(targets), "lasso", 12)
    assert len(path.fits) == 12
    assert path.alpha_fractions[[0, -1]] == pytest.approx([1.0, 1e-3])
    frame = path.to_frame()
    assert frame.index.names == ["alpha_fraction", "alpha"]
    column = frame["<b>"] if targets == 1 else frame[("1", "<b>")]
    np.testing.assert_array_equal(column, path.weights[:, 1, targets - 1])
    axes = path.plot(Figure().subplots())
    drawn = sum(np.any(path.weights, axis=0).ravel())
    assert len(axes.lines) == drawn
    labels = [text.get_text() for text in axes.get_legend().get_texts()]
    assert labels[0].split(" of ")[0] == "<b>"
    assert axes.xaxis_inverted()


def test_notebooks_show_penalty_status_and_weights_and_escape_names():
    path = sf.path(problem(), "lasso", [0.3, 1e-3])
    shown = path.fits[1]._repr_html_()
    assert "alpha_fraction=0.001" in shown
    assert "ok (duality_gap" in shown
    assert "&lt;b&gt;" in shown
    assert "<b>" not in shown
    assert "<table" in path._repr_html_()


def test_arrays_a_name_and_settings_are_a_fit():
    theta, target = arrays()
    one = sf.fit(theta, target, "group-lasso", groups=[0, 0, 1, 1], alpha_fraction=0.2)
    posed = sf.RegressionProblem.from_arrays(theta, target, [0, 0, 1, 1])
    other = sf.fit(posed, backends.get("group-lasso", alpha_fraction=0.2))
    np.testing.assert_array_equal(one.weights, other.weights)
    path = sf.path(theta, target, "lasso", [0.5, 0.25])
    assert path.alpha_fractions.tolist() == [0.5, 0.25]


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda t, y: sf.fit(t, y), r'or arrays: fit\(theta, target, "lasso"'),
        (lambda t, y: sf.fit(t, "lasso"), "needs a RegressionProblem and a back-end"),
        (lambda t, y: sf.fit(t, y, "lasso", alpha=0.1), '"alpha": set alpha_fraction, the penalty'),
        (lambda t, y: sf.fit(t, y, backends.get("lasso"), alpha_fraction=0.1), "back-end's name"),
        (lambda t, y: sf.fit(t, y, "lasso", groups=[[0, 1], [2]]), "one label per column"),
        (lambda t, y: sf.fit(t, y, "lasso", groups=[[0, 1], [2, 3]]), "one label per column"),
        (lambda t, y: sf.fit(problem(), "lasso", groups=[0, 0, 1, 1]), "has its groups"),
        (lambda t, y: sf.fit(problem(), "lasso", intercept=True), "has its intercept"),
    ],
)
def test_calls_that_cannot_be_meant_are_refused_in_a_line(call, words):
    with pytest.raises(InputError, match=words):
        call(*arrays())
