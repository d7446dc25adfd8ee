"""Statistics by hand and by blocks, and refusals."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sparsefit.errors import InputError
from sparsefit.regression.design import RowDesign
from sparsefit.regression.statistics import Statistics, row_blocks
from tests.problems import regular

THETA = np.array([[1.0, 1.0], [1.0, -1.0]])
TARGET = np.array([[3.0], [1.0]])  # Z = theta, Z'Z/m = I, c = Z'y/m = (2, 1), |y|^2/2m = 2.5


def statistics_of(theta, target):
    return Statistics.of(theta, target, count=len(theta))


def test_statistics_of_two_columns_worked_by_hand():
    found = statistics_of(THETA * [2.0, 5.0], TARGET)
    assert found.rms == pytest.approx([2.0, 5.0])
    assert found.gram == pytest.approx(np.eye(2))
    assert found.cross[:, 0] == pytest.approx([2.0, 1.0])
    assert found.target_square == pytest.approx([5.0])
    assert found.null_objective == pytest.approx(2.5)
    assert (found.samples, found.rank) == (2, 2)


@given(size=st.integers(1, 70))
def test_statistics_are_the_sums_of_those_of_any_blocks(size):
    problem = regular()
    whole, blocks = problem.statistics, list(row_blocks(problem.theta, problem.target, size=size))
    sums = (sum(t.T @ t for t, _ in blocks), sum(t.T @ y for t, y in blocks))
    square = sum((y * y).sum(axis=0) for _, y in blocks)
    found = Statistics.summed(*sums, square, count=problem.samples)
    for name in ("samples", "rms", "gram", "cross", "target_square"):
        assert getattr(found, name) == pytest.approx(getattr(whole, name), rel=1e-13, abs=1e-14)


def test_rank_counts_a_repeated_column_once():
    theta = regular().theta
    repeated = np.hstack([theta, theta[:, :2]])
    assert statistics_of(repeated, regular().target).rank == 12


def test_statistics_cannot_be_changed_by_who_reads_them():
    found = regular().statistics
    for name in ("rms", "gram", "cross", "target_square"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(found, name)[...] = 0.0


def test_the_gram_matrix_is_formed_for_who_asks_and_by_rows_until_then():
    problem = regular(groups=6)
    theta, target = problem.theta, problem.target
    sums = theta.T @ theta, theta.T @ target, (target * target).sum(axis=0)
    summed = Statistics.summed(*sums, count=len(theta))
    own = problem.statistics
    some = np.array([1, 4, 5])
    assert summed.formed
    assert not own.formed
    np.testing.assert_allclose(own.gram_rows(some), summed.gram[some], rtol=1e-13, atol=1e-15)
    assert not own.formed
    np.testing.assert_allclose(own.gram, summed.gram, rtol=1e-13, atol=1e-15)
    assert own.formed
    np.testing.assert_array_equal(own.gram_rows(some), own.gram[some])
    for name in ("rms", "cross", "target_square"):
        np.testing.assert_allclose(getattr(own, name), getattr(summed, name), rtol=1e-13)


def test_a_gram_matrix_that_does_not_fit_in_memory_is_refused(monkeypatch):
    def lacking(*_anything):
        raise MemoryError

    monkeypatch.setattr(RowDesign, "raw_products", lacking)
    with pytest.raises(InputError, match=r"Z'Z of 2 columns takes .* GiB.*: use fewer columns"):
        _ = statistics_of(THETA, TARGET).gram
