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
    ("blocks", "words"),
    [
        ([np.ones((3, 2))], "block 0: it must be a pair"),
        ([(np.ones((3, 2)), np.ones(3)), (np.ones((3, 1)), np.ones(3))], "block 1: theta"),
        ([(np.ones((3, 2)), np.ones(2))], "block 0: theta"),
        ([(np.ones((3, 2)), [1.0, np.nan, 1.0])], "block 0: column '0' of the target holds NaN"),
    ],
)
def test_blocks_that_do_not_fit_are_named(blocks, words):
    with pytest.raises(InputError, match=words):
        RegressionProblem.from_blocks(blocks)


def test_blocks_may_have_targets_of_one_dimension():
    theta = np.arange(12.0).reshape(6, 2) ** 2 + 1.0
    blocks = [(theta[:3], [1.0, 2.0, 3.0]), (theta[3:], [1.0, 0.0, 1.0])]
    problem = RegressionProblem.from_blocks(blocks)
    assert (problem.samples, problem.columns, problem.targets) == (6, 2, 1)


WHOLE = {
    "theta": columns(a=2.0, b=3.0),
    "target": np.ones((ROWS, 2)),
    "groups": np.array([0, 0, 1, 1]),
    "names": tuple("abcd"),
    "target_names": ("x", "y"),
}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"groups": np.array([0, 0, 2, 2])}, "groups .* without a gap"),
        ({"groups": np.array([-1, 0, 0, 1])}, "groups .* without a gap"),
        ({"groups": np.array([1, 1, 2, 2])}, "from 0"),
        ({"groups": np.array([0.0, 0.0, 1.0, 1.0])}, "an integer for each of the 4 columns"),
        ({"groups": np.array([0, 1])}, "an integer for each of the 4 columns"),
        ({"groups": [0, 0, 1, 1]}, "must be an array"),
        ({"subgroups": np.array([0, 0, 3, 3])}, "subgroups .* without a gap"),
        ({"theta": np.ones((ROWS, 4), dtype=np.float32)}, "theta must be a float64 array"),
        ({"theta": np.ones((ROWS, 4)).tolist()}, "theta must be a float64 array"),
        ({"target": np.ones(ROWS)}, "target must be a float64 array"),
        ({"target": np.ones((ROWS, 2), dtype=int)}, "target must be a float64 array"),
        ({"names": ("a",)}, "one name per column: 4, not 1"),
        ({"target_names": ("x",)}, "one name per target: 2, not 1"),
        ({"group_scales": np.ones(3)}, "one scale per group: 2, not 3"),
        ({"sample_count": ROWS - 1}, f"an integer, at least {ROWS}"),
    ],
)
def test_what_is_built_without_conversion_has_to_be_whole(change, words):
    assert RegressionProblem(**WHOLE).columns == 4
    with pytest.raises(InputError, match=words):
        RegressionProblem(**(WHOLE | change))
