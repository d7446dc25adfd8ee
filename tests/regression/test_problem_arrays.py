"""Problems from arrays and from blocks of rows: what is refused, and the inner products kept."""

import dataclasses

import numpy as np
import pytest
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
        (THETA, np.ones((4, 1, 1)), r"\(m, k\)"),
        (THETA, np.ones(3), "same number of rows"),
        (np.ones((0, 2)), np.ones(0), "must not be empty"),
        (np.ones((4, 0)), TARGET, "must not be empty"),
        (THETA, np.ones((4, 0)), "must not be empty"),
        (THETA * [1.0, 0.0], TARGET, "1.* is zero in every sample"),
        (THETA * [1e-200, 1.0], TARGET, "0.* is zero in every sample"),
        (THETA * [1.0, np.nan], TARGET, "1.* NaN"),
        (THETA * [np.inf, 1.0], TARGET, "0.* infinity"),
        (THETA * [1e200, 1.0], TARGET, r"values above 1e\+140"),
        (THETA, TARGET * np.nan, "target holds NaN"),
        (THETA, TARGET * np.inf, "target holds NaN"),
        ([["a", "b"]], [1.0], "real numbers"),
        ([[1.0, 2.0], [3.0]], [1.0, 2.0], "real numbers"),
        (THETA + 1j, TARGET, "complex"),
        (THETA, TARGET * 1j, "complex"),
        (None, TARGET, "theta"),
    ],
)
def test_bad_arrays_are_refused(theta, target, words):
    with pytest.raises(InputError, match=words):
        RegressionProblem.from_arrays(theta, target)


def test_the_message_names_the_column_and_counts_the_others():
    theta = np.ones((4, 3)) * [0.0, 1.0, 0.0]
    with pytest.raises(InputError, match=r"b.*1 more|a.*1 more"):
        RegressionProblem.from_arrays(theta, TARGET, names=["a", "b", "c"])


def test_names_and_groups_must_match_the_columns():
    with pytest.raises(InputError, match="one name per column"):
        RegressionProblem.from_arrays(THETA, TARGET, names=["only one"])
    for groups in ([0], [0, 1, 2], [[0, 1]], 0):
        with pytest.raises(InputError, match="one label per column"):
            RegressionProblem.from_arrays(THETA, TARGET, groups=groups)


@pytest.mark.parametrize(
    "labels", [["b", "a", "b"], [30, 10, 30], [1.5, -2.0, 1.5], [True, False, True]]
)
def test_labels_of_groups_are_arbitrary(labels):
    theta = np.arange(1.0, 13.0).reshape(4, 3)
    problem = RegressionProblem.from_arrays(theta, TARGET, groups=labels)
    assert problem.groups.tolist() == [1, 0, 1]


def test_one_target_may_be_a_vector_and_columns_are_their_own_groups():
    problem = RegressionProblem.from_arrays(THETA.tolist(), TARGET.tolist())
    assert (problem.samples, problem.columns, problem.targets) == (4, 2, 1)
    assert problem.groups.tolist() == [0, 1]
    assert problem.group_scales is None


def test_statistics_are_the_direct_formulas():
    problem = regular()
    s = problem.statistics
    z = problem.theta / np.sqrt(np.mean(problem.theta**2, axis=0))
    assert s.rms == pytest.approx(np.sqrt(np.mean(problem.theta**2, axis=0)))
    assert s.gram == pytest.approx(z.T @ z / 60)
    assert s.cross == pytest.approx(z.T @ problem.target / 60)
    assert s.target_square == pytest.approx(np.mean(problem.target**2, axis=0))
    assert problem.statistics is s  # formed once


@pytest.mark.parametrize("size", [1, 7, 60])
def test_a_triangle_of_blocks_keeps_every_inner_product_and_the_fits(size):
    whole = regular()
    rows = [slice(i, i + size) for i in range(0, 60, size)]
    theta, target = compressed((whole.theta[r], whole.target[r]) for r in rows)
    folded = dataclasses.replace(whole, theta=theta, target=target, sample_count=60)
    assert (folded.samples, len(theta)) == (60, whole.columns + whole.targets)
    for name in ("rms", "gram", "cross", "target_square"):
        expected = getattr(whole.statistics, name)
        assert getattr(folded.statistics, name) == pytest.approx(expected, rel=1e-12, abs=1e-13)
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
