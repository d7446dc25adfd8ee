"""The norms of the penalties against values worked by hand."""

import numpy as np
import pytest

from sparsefit.regression.objective import Penalty, lasso_penalty


def test_group_norm_spans_columns_and_targets_worked_by_hand():
    # V = [[3, 0], [0, 4]]: joint |V| = 5; separate 3 + 4; elementwise 3 + 4; omega 2 doubles.
    values = np.array([[3.0, 0.0], [0.0, 4.0]])
    one = np.zeros(2, dtype=np.intp)
    assert Penalty(one, np.array([2.0]), joint=True).norm(values) == pytest.approx(10.0)
    assert Penalty(one, np.array([2.0]), joint=False).norm(values) == pytest.approx(14.0)
    assert lasso_penalty(2).norm(values) == pytest.approx(7.0)


def test_block_norms_keep_what_squares_would_lose():
    tiny = Penalty(np.zeros(2, dtype=np.intp), np.ones(1), joint=True)
    assert tiny.norm(np.full((2, 1), 1e-200)) == pytest.approx(np.sqrt(2) * 1e-200)
