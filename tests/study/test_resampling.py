import math

import numpy as np
import pytest
from scipy import stats

from sparsefit.study.evidence.measures import MEASURES
from sparsefit.study.evidence.resampling import (
    Difference,
    best_probabilities,
    holm,
    interval,
    resampled,
)
from sparsefit.study.evidence.summary import QUANTILES, SUMMARIES, TINY, quantile, reduce

RNG = np.random.default_rng(3)
VALUES = RNG.exponential(2.0, (4, 9))


PLAIN = {
    "mean": np.mean,
    "geometric mean": lambda row: stats.gmean(np.maximum(row, TINY)),
    "rms": lambda row: math.sqrt(np.mean(row**2)),
    "share": lambda row: 100.0 * np.mean(row),
    "largest": np.max,
    "number": np.sum,
}


@pytest.mark.parametrize("name", SUMMARIES)
def test_summaries_by_their_definitions(name):
    values = np.floor(VALUES)
    assert reduce(name, values) == pytest.approx([PLAIN[name](row) for row in values])


@pytest.mark.parametrize("name", QUANTILES)
def test_quantiles_among_the_observed_are_those_of_numpy(name):
    failed = np.concatenate([VALUES, np.full((4, 3), np.inf)], axis=1)
    expected = np.quantile(failed, QUANTILES[name], axis=1, method="inverted_cdf")
    assert reduce(name, failed, observed=True) == pytest.approx(expected)


@pytest.mark.parametrize("name", QUANTILES)
def test_quantiles_are_those_of_numpy_over_what_is_known(name):
    holes = VALUES.copy()
    holes[0, 3] = holes[2, :4] = np.nan
    expected = np.nanquantile(holes, QUANTILES[name], axis=1)
    assert reduce(name, holes) == pytest.approx(expected)


def test_of_nothing_nothing_is_known():
    nothing = np.full((2, 3), np.nan)
    assert np.isnan(reduce("mean", nothing)).all()
    assert np.isnan(reduce("largest", nothing)).all()
    assert np.isnan(quantile(nothing, 0.5)).all()


def test_the_interval_is_that_of_scipy():
    flights = RNG.normal(1.0, 2.0, 60)
    ours = interval(resampled(lambda at: flights[at].mean(axis=1), 60, resamples=4000))
    theirs = stats.bootstrap((flights,), np.mean, n_resamples=4000, method="percentile")
    assert ours == pytest.approx(tuple(theirs.confidence_interval), abs=0.06)


def test_flights_to_tell_two_apart():
    apart = Difference(1.0, -1.0, 3.0, 25)
    assert apart.tie
    assert apart.more_flights == 75  # half the interval is twice the effect: four times the flights
    assert not Difference(2.0, 1.0, 3.0, 25).tie
    assert Difference(2.0, 1.0, 3.0, 25).more_flights == 0
    assert math.isinf(Difference(0.0, 0.0, 0.0, 25, same=True).more_flights)


def test_probability_to_be_the_best_by_hand():
    distributions = np.array([[1.0, 2.0, 3.0, 1.0], [2.0, 1.0, 3.0, 2.0], [9.0, 9.0, 3.0, 9.0]])
    assert best_probabilities(distributions) == pytest.approx(
        [(2 + 1 / 3) / 4, (1 + 1 / 3) / 4, 1 / 12]
    )


def test_holm_by_hand():
    assert holm([0.01, 0.04, 0.03]) == pytest.approx([0.03, 0.06, 0.06])
    assert holm([0.5, 0.9]) == pytest.approx([1.0, 1.0])
    assert holm([]) == []
    assert holm([0.03, math.nan, 0.01]) == pytest.approx([0.03, math.nan, 0.02], nan_ok=True)


def test_flights_drawn_in_parts_are_the_same_flights(monkeypatch):
    whole = resampled(lambda at: at.sum(axis=1), 7, resamples=50)
    monkeypatch.setattr("sparsefit.study.evidence.resampling.CHUNK", 21)
    assert np.array_equal(resampled(lambda at: at.sum(axis=1), 7, resamples=50), whole)


def test_more_answers_called_ok_are_better_and_a_mean_of_counts_keeps_its_fraction():
    assert MEASURES["called-ok"].more
    assert not MEASURES["called-misfit"].more
    assert [MEASURES["unseen"].say(value) for value in (3.0, 11.75)] == ["3", "11.8"]
