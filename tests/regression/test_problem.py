"""Problems of any arrays, what people do with a fit and a path of them, and what is refused."""

import dataclasses
from operator import attrgetter

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure
from scipy import sparse

import sparsefit as sf
from sparsefit import backends
from sparsefit.errors import InputError
from sparsefit.regression.problem import RegressionProblem, compressed
from tests.problems import regular

THETA, TARGET = np.arange(1.0, 9.0).reshape(4, 2), np.ones(4)


@pytest.mark.parametrize(
    ("theta", "target", "words"),
    [
        (np.ones(4), TARGET, r"\(m, k\)"),
        (THETA, np.ones((4, 1, 1)), r"\(m, n\)"),
        (THETA, np.ones(3), "same number of rows"),
        (np.ones((0, 2)), np.ones(0), "must not be empty"),
        (np.ones((4, 0)), TARGET, "must not be empty"),
        (THETA, np.ones((4, 0)), "must not be empty"),
        ([["a", "b"]], [1.0], "real numbers"),
        (THETA + 1j, TARGET, "complex"),
        (None, TARGET, "theta"),
        (np.ma.masked_array(THETA, THETA > 1), TARGET, "masked: drop the rows"),
        (THETA.astype("M8[s]"), TARGET, "real numbers"),
    ],
)
def test_bad_arrays_are_refused(theta, target, words):
    with pytest.raises(InputError, match=words):
        RegressionProblem.from_arrays(theta, target)


def test_a_constant_column_beside_an_intercept_is_called_so():
    with pytest.raises(InputError, match="column '1' is constant, as the intercept is; drop it"):
        RegressionProblem.from_arrays(THETA * [1.0, 0.0] + [0.0, 3.0], TARGET, intercept=True)


@pytest.mark.parametrize(
    ("labels", "words"),
    [
        ({"groups": [0, np.nan]}, "groups holds NaN"),
        ({"groups": [0, None]}, "labels of one kind"),
        *(({"groups": groups}, "one label per column") for groups in ([0], [0, 1, 2], [[0, 1]], 0)),
        ({"intercept": "no"}, "intercept must be true or false, not 'no'"),
        ({"names": "ab"}, "names must be a list"),
        ({"names": 4}, "names must be a list"),
        ({"names": ["only one"]}, "one name per column, 2 of them"),
        ({"subgroups": [0, 0], "groups": [0, 1]}, "must lie within groups.*spans two groups"),
        ({"subgroups": [0, 1, 2]}, "subgroups must have one label per column"),
        ({"sample_weight": [1, 2]}, r"sample_weight must have shape \(4,\); got \(2,\)"),
        *(
            ({"sample_weight": bad}, "sample_weight must be ")
            for bad in ([0] * 4, [-1, 1, 1, 1], [np.inf] * 4, [1e308] * 4, ["a"] * 4, [[1], [1, 2]])
        ),
    ],
)
def test_labels_that_do_not_fit_are_refused(labels, words):
    with pytest.raises(InputError, match=words):
        RegressionProblem.from_arrays(THETA, TARGET, **labels)


def test_each_column_is_a_group_or_labels_are_arbitrary():
    problem = RegressionProblem.from_arrays(THETA.tolist(), TARGET.tolist())
    assert (problem.samples, problem.columns, problem.targets) == (4, 2, 1)
    assert (problem.groups.tolist(), problem.group_scales) == ([0, 1], None)
    for labels in (["b", "a", "b"], [30, 10, 30], [1.5, -2.0, 1.5], [True, False, True]):
        posed = RegressionProblem.from_arrays(np.ones((4, 3)), TARGET, groups=labels)
        assert posed.groups.tolist() == [1, 0, 1]


def test_sums_are_the_direct_formulas():
    problem = regular()
    z = problem.theta / np.sqrt(np.mean(problem.theta**2, axis=0))
    assert problem.design.rms == pytest.approx(np.sqrt(np.mean(problem.theta**2, axis=0)))
    assert problem.design.gram == pytest.approx(z.T @ z / 60)
    assert problem.cross == pytest.approx(z.T @ problem.target / 60)
    assert problem.target_square == pytest.approx(np.mean(problem.target**2, axis=0))
    assert problem.null_objective == pytest.approx(problem.target_square.sum() / 2)
    assert problem.cross is problem.cross  # formed once
    for array in (problem.design.rms, problem.design.gram, problem.cross, problem.target_square):
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0.0


@pytest.mark.parametrize("size", [1, 7, 60])
def test_a_triangle_of_blocks_keeps_every_inner_product_and_the_fits(size):
    whole = regular()
    rows = [slice(i, i + size) for i in range(0, 60, size)]
    theta, target = compressed((whole.theta[r], whole.target[r]) for r in rows)
    folded = dataclasses.replace(whole, theta=theta, target=target, sample_count=60)
    assert (folded.samples, len(theta)) == (60, whole.columns + whole.targets)
    for name in ("design.rms", "design.gram", "cross", "target_square"):
        expected = attrgetter(name)(whole)
        assert attrgetter(name)(folded) == pytest.approx(expected, rel=1e-12, abs=1e-13)
    for name in ("least-squares", "stlsq", "lasso", "group-lasso"):
        expected, found = (sf.fit(p, backends.get(name)) for p in (whole, folded))
        assert found.weights == pytest.approx(expected.weights, rel=1e-8, abs=1e-10)
        assert found.status == expected.status == "ok"
        size = expected.certificate.primal
        assert found.certificate.primal == pytest.approx(size, rel=1e-12, nan_ok=True)


@pytest.mark.parametrize("kind", ["array", "sparse"])
def test_a_design_that_is_changed_under_a_problem_is_refused(kind):
    theta = np.random.default_rng(0).normal(size=(200, 100))
    held = theta if kind == "array" else sparse.csc_matrix(theta)
    problem = RegressionProblem.from_arrays(held, theta[:, 0])
    assert sf.fit(problem, "lasso").status == "ok"
    if kind == "array":
        theta *= 2.0
    else:
        held.data *= 2.0
    with pytest.raises(InputError, match="theta was changed"):
        sf.fit(problem, "lasso")


ROWS = 96


def columns(**changed):
    """Four columns of ones, some with other values in their last row."""
    theta = np.ones((ROWS, 4))
    for name, value in changed.items():
        theta[-1, "abcd".index(name)] = value
    return theta


@pytest.mark.parametrize("layout", [np.ascontiguousarray, np.asfortranarray, sparse.csc_array])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e200])
def test_a_column_that_is_not_finite_is_named(value, layout):
    theta, rise, labels = columns(c=value, d=value) * [0, 0, 1, 1], np.c_[:ROWS], list("abcd")
    for intercept in (False, True):
        with pytest.raises(InputError, match=r"'c' \(and 1 more\) holds NaN.* above 1e\+140"):
            RegressionProblem.from_arrays(layout(theta), rise, None, labels, intercept=intercept)
        with pytest.raises(InputError, match=r"column '1' of the target holds NaN"):
            RegressionProblem.from_arrays(rise, theta[:, 1:3], intercept=intercept)


def test_only_a_column_that_is_too_large_itself_is_refused():
    theta = columns(**dict.fromkeys("abcd", 0.9e140))  # each norm is in range, that of all is not
    assert RegressionProblem.from_arrays(theta, np.ones(ROWS)).columns == 4


@pytest.mark.parametrize("value", [0.0, 1e-170])
def test_a_column_of_zeros_is_named_wherever_the_others_begin(value):
    theta = np.zeros((ROWS, 3))
    theta[:, 0] = 1.0
    theta[-1, 1] = 1.0  # not a column of zeros, though all but its last row are
    theta[5, 2] = value
    with pytest.raises(InputError, match="column '2' is zero in every sample") as caught:
        RegressionProblem.from_arrays(theta, np.ones(ROWS))
    assert "more" not in str(caught.value)
    theta[-1, 2] = 1.0
    assert RegressionProblem.from_arrays(theta, np.ones(ROWS)).columns == 3


def test_the_arrays_of_a_problem_are_read_only_and_the_callers_stay_as_they_are():
    theta, target = np.ones((ROWS, 2)), np.ones((ROWS, 1))
    problem = RegressionProblem.from_arrays(theta, target)
    for array in (problem.theta, problem.target):
        with pytest.raises(ValueError, match="read-only"):
            array[0, 0] = 2.0
    assert np.shares_memory(problem.theta, theta)
    assert not np.shares_memory(problem.target, target)  # whose sums are formed once
    assert theta.flags.writeable


@pytest.mark.parametrize(
    "change", [np.float32, np.int64, lambda a: np.repeat(a, 2, axis=1)[:, ::2]]
)
def test_arrays_of_other_kinds_and_layouts_are_taken_as_copies(change):
    theta = np.arange(1.0, 13.0).reshape(4, 3)
    given = change(theta)
    problem = RegressionProblem.from_arrays(given, np.ones(4))
    assert not np.shares_memory(problem.theta, given)
    fortran = np.asfortranarray(theta)  # which is not copied
    assert np.shares_memory(RegressionProblem.from_arrays(fortran, np.ones(4)).theta, fortran)
    assert problem.theta.flags.c_contiguous
    np.testing.assert_array_equal(problem.theta, theta)


def test_a_target_may_be_zero_but_not_so_small_that_its_square_underflows():
    target = np.stack([np.zeros(ROWS), np.ones(ROWS), np.full(ROWS, 1e-160)], axis=1)
    assert RegressionProblem.from_arrays(columns(), target[:, :2]).targets == 2
    with pytest.raises(InputError, match="column '2' of the target is below 1e-140, not 0"):
        RegressionProblem.from_arrays(columns(), target)


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
    assert single.intercept == 0.0
    np.testing.assert_array_equal(fit.to_frame().loc["<b>"], fit.weights[1])
    for rows, words in ((theta[:, :3], "predict needs 4 columns, not 3"), (theta + 1j, "real")):
        with pytest.raises(InputError, match=words):
            fit.predict(rows)


def test_columns_of_a_frame_are_taken_by_their_names():
    theta, target = arrays()
    frame = pd.DataFrame(theta, columns=["a", "<b>", "c", "d"])
    fit = sf.fit(frame, pd.DataFrame(target, columns=["u", "v"]), "lasso", alpha_fraction=0.01)
    turned = frame[["d", "c", "<b>", "a"]].assign(more=1.0)
    np.testing.assert_array_equal(fit.predict(turned), fit.predict(theta))
    np.testing.assert_array_equal(fit.predict(pd.DataFrame(theta)), fit.predict(theta))
    with pytest.raises(InputError, match="predict needs the column 'a', which theta does not have"):
        fit.predict(turned.drop(columns="a"))
    assert list(fit.to_frame().columns) == ["u", "v"]
    assert list(sf.fit(frame, pd.Series(target[:, 0], name="u"), "lasso").to_frame()) == ["u"]
    assert list(sf.fit(frame, pd.Series(target[:, 0]), "lasso").to_frame()) == ["0"]

    named = pd.Series({"d": 1, "c": 1, "<b>": 0, "a": 0})  # labels by the names of the columns
    for groups in (named, named.to_dict()):
        given = RegressionProblem.from_arrays(frame, target, groups=groups).groups
        assert given.tolist() == [0, 0, 1, 1]
    rows = pd.Series(target[::-1, 0], index=frame.index[::-1])
    for given in ((frame, rows), (frame, target, None, None)):
        weight = rows if len(given) > 2 else None
        with pytest.raises(InputError, match=r"theta and \w+ differ in their index: align them"):
            RegressionProblem.from_arrays(*given, sample_weight=weight)
    with pytest.raises(InputError, match="column 'c' must hold real numbers: could not convert"):
        sf.fit(frame.assign(c="text"), target, "lasso")

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
    alike = RegressionProblem.from_arrays(theta, target, sample_weight=np.full(60, 3.0))
    np.testing.assert_allclose(alike.target, target)  # weights are relative


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
    alike = pd.DataFrame(problem(1).theta, columns=["a", "a", "b", "b"])
    drawn = sf.path(alike, problem(1).target, "lasso", 12).plot(Figure().subplots())
    assert len(drawn.lines) <= 4
    assert len(sf.path(problem(1), "lasso", [1.0]).plot(Figure().subplots()).lines) == 1  # zero


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
        (lambda t, y: sf.fit(t.astype(str) + "!" * 999, y, "ridge"), r"^[^!]+!{1,80}\.\.\.$"),
        (lambda t, y: sf.fit(t, y, "lasso", alpha=0.1), '"alpha": set alpha_fraction, the penalty'),
        (lambda t, y: sf.fit(t, y, backends.get("lasso"), alpha_fraction=0.1), "back-end's name"),
        (lambda t, y: sf.fit(t, y, "lasso", groups=[[0, 1], [2]]), "one label per column"),
        (lambda t, y: sf.fit(t, y, "lasso", solver=t), r'of lasso "ndarray of shape \(\d+, \d\)"'),
        (lambda t, y: sf.fit(t, y, "lasso", intercept=t), r"not ndarray of shape \(\d+, \d\)$"),
        (lambda t, y: sf.fit(problem(), "lasso", groups=[0, 0, 1, 1]), "has its groups"),
        (lambda t, y: sf.fit(problem(), "lasso", intercept=True), "has its intercept"),
    ],
)
def test_calls_that_cannot_be_meant_are_refused_in_a_line(call, words):
    with pytest.raises(InputError, match=words):
        call(*arrays())


@pytest.mark.parametrize("form", [np.ascontiguousarray, np.asfortranarray, sparse.coo_array])
@pytest.mark.parametrize("weight", [None, np.arange(80) % 3])
def test_an_offset_of_the_columns_costs_no_digits_beside_an_intercept(form, weight):
    rng = np.random.default_rng(0)
    theta = np.round(rng.normal(size=(80, 6)), 3)  # exact beside the offset, but for the last digit
    offset = np.array([1e9, 0.0, -1e7, 3.0, 1e5, 0.0])
    target = theta[:, :2].sum(axis=1) + 0.1 * rng.normal(size=80)
    far = form(theta + offset)
    settings = {"alpha_fraction": 0.05, "intercept": True, "sample_weight": weight}
    near, fit = (sf.fit(each, target, "lasso", **settings) for each in (theta, far))
    assert (fit.status, near.status) == ("ok", "ok")
    np.testing.assert_allclose(fit.weights, near.weights, atol=1e-6)
    np.testing.assert_allclose(fit.intercept, near.intercept - offset @ fit.weights, rtol=1e-9)
    assert fit.certificate.rounding < 10 * near.certificate.rounding


@pytest.mark.parametrize("weight", [None, np.arange(80) % 3])
def test_a_constant_target_is_the_intercept_alone(weight):
    theta = np.random.default_rng(0).normal(size=(80, 6))
    for name in ("lasso", "square-root-lasso", "slope"):
        fit = sf.fit(theta, np.full(80, 0.3), name, intercept=True, sample_weight=weight)
        assert (fit.status, fit.reason) == ("ok", "")
        assert fit.weights.tolist() == np.zeros((6, 1)).tolist()
        assert fit.intercept == pytest.approx([0.3], rel=1e-12)
