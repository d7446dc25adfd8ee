"""Both products of a block of rows against exact sums, and the refusals of the compiled one."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sparsefit.regression import gram
from sparsefit.regression.objective import accumulate, block_products, row_blocks


def compiled():
    """The compiled kernel; a test that needs it is skipped where it does not run."""
    kernel = pytest.importorskip("sparsefit._gram")
    if not kernel.supported():
        pytest.skip("this CPU has no AVX-512")
    return kernel


@given(st.integers(1, 300), st.integers(1, 60), st.integers(1, 4), st.integers(0, 10**6))
def test_products_are_those_of_extended_precision(samples, columns, targets, seed):
    rng = np.random.default_rng(seed)
    theta = rng.normal(size=(samples, columns)) * 10.0 ** rng.uniform(-6, 6, columns)
    target = rng.normal(size=(samples, targets))
    wide, goal = theta.astype(np.longdouble), target.astype(np.longdouble)
    sizes = np.abs(theta).T @ np.abs(theta), np.abs(theta).T @ np.abs(target), (target**2).sum(0)
    exact = wide.T @ wide, wide.T @ goal, (goal**2).sum(0)
    for found, right, size in zip(gram.products(theta, target), exact, sizes, strict=True):
        assert found.shape == right.shape
        assert np.all(np.abs(found - right) <= samples * np.finfo(float).eps * size)


@pytest.mark.parametrize("columns", [1, 7, 8, 22, 23, 24, 25, 448])
def test_the_compiled_gram_matrix_is_symmetric_and_agrees_with_numpy(columns):
    compiled()
    rng = np.random.default_rng(columns)
    theta, target = rng.normal(size=(517, columns)), rng.normal(size=(517, 2))
    found = gram.products(theta, target)
    np.testing.assert_array_equal(found[0], found[0].T)
    for one, other in zip(found, block_products(theta, target), strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-13 * 517)


def test_rows_in_any_layout_and_in_blocks_give_the_same_statistics():
    rng = np.random.default_rng(1)
    theta, target = rng.normal(size=(900, 30)), rng.normal(size=(900, 2))
    plain = accumulate(row_blocks(theta, target))
    for layout in (np.asfortranarray(theta), np.hstack([theta, theta])[:, :30]):
        blocks = row_blocks(layout, target, size=250)
        found = accumulate(blocks, products=gram.products)
        np.testing.assert_allclose(found.gram, plain.gram, atol=1e-13)
        np.testing.assert_allclose(found.cross, plain.cross, atol=1e-13)
        np.testing.assert_allclose(found.target_square, plain.target_square, rtol=1e-13)


def test_what_is_not_finite_stays_in_its_own_row_and_column():
    theta = np.ones((5, 9))
    theta[2, 8] = np.inf
    found, cross, _ = gram.products(theta, np.ones((5, 1)))
    assert np.isfinite(found[:8, :8]).all()
    assert not np.isfinite(found[8]).any()
    assert np.isfinite(cross[:8]).all()


def test_buffers_that_do_not_fit_are_refused():
    kernel = compiled()
    room = np.empty((3, 3)), np.empty((3, 1)), np.empty(1)
    with pytest.raises(ValueError, match="theta"):
        kernel.products(np.ones((4, 3)), np.ones((5, 1)), *room)
    with pytest.raises(ValueError, match="theta"):
        kernel.products(np.ones(12), np.ones((4, 1)), *room)
    with pytest.raises((ValueError, BufferError)):
        kernel.products(np.ones((4, 6))[:, ::2], np.ones((4, 1)), *room)


def test_without_the_kernel_numpy_runs(monkeypatch):
    monkeypatch.setattr(gram, "product_loop", lambda: "numpy")
    theta, target = np.arange(6.0).reshape(3, 2), np.ones((3, 1))
    for found, right in zip(
        gram.products(theta, target), block_products(theta, target), strict=True
    ):
        np.testing.assert_array_equal(found, right)
