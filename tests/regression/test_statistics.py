"""Statistics by hand; the compiled products against exact sums and numpy's; refusals."""

from unittest.mock import Mock

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sparsefit.errors import InputError
from sparsefit.regression import statistics
from sparsefit.regression.statistics import (
    Statistics,
    kernel_products,
    product_loop,
    row_blocks,
    squared,
)
from tests.problems import regular


def kernel_runs():
    try:
        from sparsefit.regression import _gram
    except ImportError:  # no compiler
        return False
    return _gram.supported()


needs_kernel = pytest.mark.skipif(not kernel_runs(), reason="not built, or no AVX-512 here")


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
    for name in ("samples", "rows", "rms", "gram", "cross", "target_square"):
        assert getattr(found, name) == pytest.approx(getattr(whole, name), rel=1e-13, abs=1e-14)


def test_rank_counts_a_repeated_column_once():
    theta = regular().theta
    repeated = np.hstack([theta, theta[:, :2]])
    assert statistics_of(repeated, regular().target).rank == 12


@needs_kernel
@given(st.integers(1, 300), st.integers(1, 60), st.integers(1, 4), st.integers(0, 10**6))
def test_products_are_those_of_extended_precision(samples, columns, targets, seed):
    rng = np.random.default_rng(seed)
    theta = rng.normal(size=(samples, columns)) * 10.0 ** rng.uniform(-6, 6, columns)
    target = rng.normal(size=(samples, targets))
    wide, goal = theta.astype(np.longdouble), target.astype(np.longdouble)
    sizes = np.abs(theta).T @ np.abs(theta), np.abs(theta).T @ np.abs(target), (target**2).sum(0)
    exact = wide.T @ wide, wide.T @ goal, (goal**2).sum(0)
    for found, right, size in zip(kernel_products(theta, target), exact, sizes, strict=True):
        assert found.shape == right.shape
        assert np.all(np.abs(found - right) <= samples * np.finfo(float).eps * size)


@needs_kernel
@pytest.mark.parametrize("columns", [1, 7, 8, 22, 23, 24, 25, 448])
def test_the_compiled_gram_matrix_is_symmetric_and_agrees_with_numpy(columns):
    rng = np.random.default_rng(columns)
    theta, target = rng.normal(size=(517, columns)), rng.normal(size=(517, 2))
    found = kernel_products(theta, target)
    np.testing.assert_array_equal(found[0], found[0].T)
    plain = theta.T @ theta, theta.T @ target, (target * target).sum(axis=0)
    for one, other in zip(found, plain, strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-13 * 517)


@pytest.mark.parametrize("loop", [pytest.param("compiled", marks=needs_kernel), "numpy"])
def test_rows_in_any_layout_give_the_same_statistics(monkeypatch, loop):
    rng = np.random.default_rng(1)
    theta, target = rng.normal(size=(900, 30)), rng.normal(size=(900, 2))
    monkeypatch.setattr(statistics, "product_loop", lambda: loop)
    for layout in (np.asfortranarray(theta), np.hstack([theta, theta])[:, :30]):
        found = statistics_of(layout, target)
        size = found.rms * np.sqrt(900)
        np.testing.assert_allclose(found.gram, theta.T @ theta / np.outer(size, size), atol=1e-13)
        np.testing.assert_allclose(found.cross, theta.T @ target / size[:, None] / 30.0, atol=1e-13)


@needs_kernel
def test_what_is_not_finite_stays_in_its_own_row_and_column():
    theta = np.ones((5, 9))
    theta[2, 8] = np.inf
    found, cross, _ = kernel_products(theta, np.ones((5, 1)))
    assert np.isfinite(found[:8, :8]).all()
    assert not np.isfinite(found[8]).any()
    assert np.isfinite(cross[:8]).all()


@needs_kernel
def test_buffers_that_do_not_fit_are_refused():
    from sparsefit.regression import _gram

    room = np.empty((3, 3)), np.empty((3, 1)), np.empty(1)
    with pytest.raises(ValueError, match="theta"):
        _gram.products(np.ones((4, 3)), np.ones((5, 1)), *room)
    with pytest.raises(ValueError, match="theta"):
        _gram.products(np.ones(12), np.ones((4, 1)), *room)
    with pytest.raises((ValueError, BufferError)):
        _gram.products(np.ones((4, 6))[:, ::2], np.ones((4, 1)), *room)


@needs_kernel
@pytest.mark.parametrize("loop", ["compiled", "numpy"])
def test_the_loop_that_is_named_is_the_one_that_runs(monkeypatch, loop):
    spy = Mock(wraps=kernel_products)
    monkeypatch.setattr(statistics, "kernel_products", spy)
    monkeypatch.setattr(statistics, "product_loop", lambda: loop)
    assert squared(THETA) == pytest.approx(2.0 * np.eye(2))
    assert spy.called == (loop == "compiled")


@pytest.mark.parametrize("kernel", ["_absent", "objective"])
def test_without_the_kernel_of_these_sources_numpy_runs(monkeypatch, kernel):
    monkeypatch.setattr(statistics, "_KERNEL", f"sparsefit.regression.{kernel}")
    product_loop.cache_clear()
    try:
        assert product_loop() == "numpy"
        assert statistics_of(THETA, TARGET).gram == pytest.approx(np.eye(2))
    finally:
        product_loop.cache_clear()


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
    def lacking(theta):
        raise MemoryError

    monkeypatch.setattr(statistics, "squared", lacking)
    with pytest.raises(InputError, match=r"Z'Z of 2 columns takes .* GiB.*: use fewer columns"):
        _ = statistics_of(THETA, TARGET).gram
