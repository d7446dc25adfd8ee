import math

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from sparsefit.study import resampling
from sparsefit.study.resampling import interval, mean, quantile, ratio, resampled, wilson

RNG = np.random.default_rng(3)
VALUES = RNG.exponential(2.0, (4, 9))
PLAIN = {
    "mean": np.mean,
    "geometric mean": lambda row: stats.gmean(np.maximum(row, resampling.TINY)),
    "rms": lambda row: math.sqrt(np.mean(row**2)),
    "share": lambda row: 100.0 * np.mean(row),
    "largest": np.max,
}
MEAN = resampling.pooled(mean)


@pytest.mark.parametrize("name", resampling.SUMMARIES)
def test_summaries_by_their_definitions(name):
    values = np.floor(VALUES)
    assert resampling.SUMMARIES[name](values) == pytest.approx([PLAIN[name](row) for row in values])


@pytest.mark.parametrize("share", resampling.QUANTILES.values())
def test_quantiles_are_those_of_numpy(share):
    holes = VALUES.copy()
    holes[0, 3] = holes[2, :4] = np.nan
    assert quantile(holes, share) == pytest.approx(np.nanquantile(holes, share, axis=1))
    failed = np.concatenate([VALUES, np.full((4, 3), np.inf)], axis=1)
    expected = np.quantile(failed, share, axis=1, method="inverted_cdf")
    assert quantile(failed, share, observed=True) == pytest.approx(expected)


def test_of_nothing_nothing_is_known():
    nothing = np.full((2, 3), np.nan)
    assert np.isnan(mean(nothing)).all()
    assert np.isnan(quantile(nothing, 0.5)).all()
    assert all(map(math.isnan, (*wilson(0, 0), *ratio(np.array([]), np.array([])))))
    assert all(map(math.isnan, interval(MEAN, VALUES[:1])))


def test_the_interval_is_that_of_scipy_and_draws_units_not_cases():
    units = RNG.normal(1.0, 2.0, 60)
    ours = resampling.ends(resampled(lambda at: units[at].mean(axis=1), 60, resamples=4000))
    theirs = stats.bootstrap((units,), np.mean, n_resamples=4000, method="percentile")
    assert ours == pytest.approx(tuple(theirs.confidence_interval), abs=0.06)
    once = interval(MEAN, units[:, None])
    assert interval(MEAN, np.repeat(units[:, None], 4, axis=1)) == pytest.approx(once)


def test_units_drawn_in_parts_are_the_same_units(monkeypatch):
    whole = resampled(lambda at: at.sum(axis=1), 7, resamples=50)
    monkeypatch.setattr(resampling, "CHUNK", 21)
    assert np.array_equal(resampled(lambda at: at.sum(axis=1), 7, resamples=50), whole)


def test_values_by_unit():
    grid = resampling.by_unit(np.array([1.0, 2.0, 3.0]), pd.Series([4, 7, 4]))
    np.testing.assert_allclose(grid, [[1.0, 3.0], [2.0, np.nan]])


def test_wilson_by_hand():
    low, high = wilson(0, 4)  # z^2 / (4 + z^2)
    assert (low, high) == pytest.approx((0.0, 100 * 3.8414588 / 7.8414588))
    assert wilson(9, 10) == pytest.approx((59.58, 98.21), abs=0.01)


def test_ratios_by_hand():
    middle, low, high = ratio(np.array([2.0, 8.0, np.inf]), np.ones(3))
    assert middle == pytest.approx(4.0)
    assert math.isnan(low)
    assert math.isnan(high)
    middle, low, high = ratio(np.full(6, 3.0), np.ones(6))
    assert (middle, low, high) == pytest.approx((3.0, 3.0, 3.0))
