"""Problems of given shapes are drawn as they are described."""

import numpy as np
import pytest
from scipy import sparse

from sparsefit.errors import InputError
from sparsefit.solvers.shapes import Shape


def test_a_dense_shape_has_unit_columns_correlated_neighbours_and_its_truth():
    shape = Shape(4000, 30, targets=2, correlation=0.8, group_size=3, active=4, noise=0.5)
    drawn, again = shape.draw(1), shape.draw(1)
    np.testing.assert_array_equal(drawn.theta, again.theta)
    np.testing.assert_allclose(np.mean(drawn.theta**2, axis=0), 1.0)
    neighbours = np.mean(drawn.theta[:, 1:] * drawn.theta[:, :-1], axis=0)
    np.testing.assert_allclose(neighbours, 0.8, atol=0.05)
    used = np.unique(drawn.groups[drawn.weights.any(axis=1)])
    assert len(used) == 4
    assert np.count_nonzero(drawn.weights) == 4 * 3 * 2
    signal = drawn.theta @ drawn.weights
    noise = np.std(drawn.target - signal, axis=0) / np.sqrt(np.mean(signal**2, axis=0))
    np.testing.assert_allclose(noise, 0.5, rtol=0.1)


def test_a_sparse_shape_has_its_density_and_unit_columns():
    drawn = Shape(2000, 300, density=0.01, active=5).draw(2)
    assert sparse.issparse(drawn.theta)
    assert drawn.theta.nnz == pytest.approx(0.01 * 2000 * 300, rel=0.05)
    assert drawn.theta.has_sorted_indices
    squares = np.asarray(drawn.theta.multiply(drawn.theta).mean(axis=0)).ravel()
    np.testing.assert_allclose(squares, 1.0)


def test_what_is_no_shape_is_refused():
    with pytest.raises(InputError, match="density"):
        Shape(density=0.0)
    with pytest.raises(InputError, match="columns"):
        Shape(columns=0)
