"""What a regression problem takes and refuses, column by column, and that nobody changes it."""

import numpy as np
import pytest

from sparsefit.errors import InputError
from sparsefit.regression.problem import RegressionProblem

ROWS = 96


def columns(**changed):
    """Four columns of ones, some with other values in their last row."""
    theta = np.ones((ROWS, 4))
    for name, value in changed.items():
        theta[-1, "abcd".index(name)] = value
    return theta


@pytest.mark.parametrize("layout", [np.ascontiguousarray, np.asfortranarray])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e200])
def test_a_column_that_is_not_finite_is_named(value, layout):
    theta = layout(columns(c=value))
    with pytest.raises(InputError, match=r"column 'c' holds NaN, infinity or values above 1e\+140"):
        RegressionProblem.from_arrays(theta, np.ones(ROWS), names=list("abcd"))
    with pytest.raises(InputError, match=r"column '1' of the target holds NaN"):
        RegressionProblem.from_arrays(np.ones((ROWS, 1)), theta[:, 1:3])


def test_only_a_column_that_is_too_large_itself_is_refused():
    size = 0.9e140  # each norm is in range, that of all columns is not
    theta = columns(a=size, b=size, c=size, d=size)
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
    assert theta.flags.writeable
    assert target.flags.writeable


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


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda theta: np.ma.masked_array(theta, theta > 1), "masked: drop the rows"),
        (lambda theta: theta.astype("M8[s]"), "real numbers"),
        (lambda theta: theta + 0j, "real numbers"),
    ],
)
def test_arrays_that_only_look_like_numbers_are_refused(change, words):
    with pytest.raises(InputError, match=words):
        RegressionProblem.from_arrays(change(columns(a=2.0)), np.ones(ROWS))


@pytest.mark.parametrize(
    ("labels", "words"),
    [
        ({"groups": [0, 0, 1, np.nan]}, "groups holds NaN"),
        ({"groups": [0, 0, 1, None]}, "labels of one kind"),
        ({"groups": [0, 0, 1]}, "one label per column"),
        ({"names": "abcd"}, "names must be a list"),
        ({"names": 4}, "names must be a list"),
    ],
)
def test_labels_that_are_missing_are_refused(labels, words):
    with pytest.raises(InputError, match=words):
        RegressionProblem.from_arrays(columns(), np.ones(ROWS), **labels)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"target": np.ones((ROWS - 1, 2))}, "the same number of rows"),
        ({"target": np.ones((ROWS, 0))}, "must not be empty"),
        ({"subgroups": [0, 0, 1, 1], "groups": [0, 1, 2, 2]}, "one of them spans two groups"),
        ({"names": ("a",)}, "one name per column, 4 of them"),
    ],
)
def test_shapes_that_do_not_match_are_refused(change, words):
    arrays = {"theta": columns(), "target": np.ones((ROWS, 2))}
    with pytest.raises(InputError, match=words):
        RegressionProblem.from_arrays(**(arrays | change))
