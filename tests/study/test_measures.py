"""Measures of cases and their statistics: by hand, and against closed forms."""

import json
import math

import numpy as np
import pytest
from scipy import stats

from sparsefit.errors import InputError
from sparsefit.study import measures
from sparsefit.study.measures import MEASURES, interval, mean, measure, quantile, resampled, wilson
from sparsefit.study.solver_times import ratio
from tests.study.frames import TRUE, case, frame


def told(words, *rows):
    each = measure(words)
    return each.summary_of(each.values(frame(*rows)))


def test_signed_errors_sizes_and_their_units_by_hand():
    rows = [case(0, (10.0, -4.0)), case(1, (-20.0, 2.0))]
    assert told("mean-velocity-deviation", *rows) == pytest.approx(-0.5)
    assert told("mean-velocity-signed-error", *rows) == pytest.approx(-5.0)
    assert told("mean length-scale-size", *rows) == pytest.approx(3.0)
    tau = 100 * abs(0.96 / 1.1 - 1), 100 * abs(1.02 / 0.8 - 1)
    assert told("timescale-size", *rows) == pytest.approx(np.mean(tau))
    assert told("largest largest-error", *rows) == pytest.approx(27.5)
    assert MEASURES["mean-velocity-deviation"].unit == "m/s"


def test_one_rule_of_failure():
    """Behind every number in a quantile, 100 % in a mean, left out where nothing counts it."""
    failed = case(2, None, status="unidentifiable")
    rows = [case(0, (0.0, 4.0)), case(1, (0.0, 8.0)), failed]
    assert told("length-scale-error", *rows) == pytest.approx(8.0)
    assert math.isinf(told("length-scale-error", rows[0], failed, failed))
    assert told("mean length-scale-error", *rows) == pytest.approx(112 / 3)
    assert told("length-scale-size", *rows) == pytest.approx(6.0)
    still = case(3, None, status="unidentifiable", flow="none")
    assert told("mean length-scale-error", *rows, still) == pytest.approx(112 / 3)
    assert math.isnan(told("mean length-scale-error", still))


def test_an_estimate_is_ok_or_inaccurate_with_three_finite_numbers():
    rows = [case(status="inaccurate"), case(status="misfit"), case(est_timescale=math.nan)]
    assert told("answered", *rows) == pytest.approx(100 / 3)


def test_what_ok_is_worth():
    rows = [case(0), case(1, (9.0, 0.0)), case(2, (9.0, 0.0), status="unidentifiable"),
            case(3, status="misfit"), case(4, flow="none")]  # fmt: skip
    shares = {"silent-misses": 40, "called-misfit": 20, "called-ok": 60}
    assert {name: told(name, *rows) for name in shares} == pytest.approx(shares)


def test_coverage_and_half_widths_are_of_flights_called_ok():
    ends = {"low_length_scale": 4.9, "high_length_scale": 5.1}
    rows = [case(0, (0.0, 1.0), **ends), case(1, (0.0, 4.0), low_length_scale=5.1,
                                              high_length_scale=5.3),
            case(2, status="misfit", **ends)]  # fmt: skip
    assert told("length-scale-coverage", *rows) == pytest.approx(50.0)
    assert told("length-scale-half-width", rows[0]) == pytest.approx(100 * 0.1 / 5.05)
    assert math.isnan(told("mean-velocity-coverage", *rows))


def test_efficiency_is_the_rms_of_error_over_bound():
    # U0: 2 and 4 % at bounds of 1 and 4 %: sqrt((2^2 + 1^2) / 2).
    def bounded(flight, percent, bound, **more):
        bounds = {f"bound_{name}": bound * value / 100 for name, value in TRUE.items()}
        return case(flight, percent, **bounds, **more)

    rows = [bounded(0, (2.0, 0.0), 1.0), bounded(1, (4.0, -8.0), 4.0)]
    assert told("mean-velocity-efficiency", *rows) == pytest.approx(math.sqrt(2.5))
    others = [bounded(2, (50.0, 50.0), 1.0, status="inaccurate"), bounded(3, (9.0, 9.0), math.inf),
              bounded(4, (9.0, 9.0), math.nan)]  # fmt: skip
    assert told("mean-velocity-efficiency", *rows, *others) == pytest.approx(math.sqrt(2.5))
    assert told("bounded", *rows, *others) == 40


def test_predictions_count_a_flight_that_is_not_offered_as_missed():
    rows = [case(0, prediction_error=0.04), case(1, status="misfit", prediction_error=0.01)]
    assert told("prediction-error", *rows) == pytest.approx(2.0)
    assert told("mean offered-prediction-error", *rows) == pytest.approx(52.0)


def test_several_scales():
    listed = json.dumps([[3.0, 10.0], [6.0, 2.0]])
    rows = [case(0, true_scales=listed, extent=60.0, scales_within_1_percent=1.0),
            case(1, true_scales=listed, extent=60.0, scales_within_1_percent=0.0),
            case(2, None, status="timeout", true_scales=listed)]  # fmt: skip
    assert told("scales-found", *rows) == pytest.approx(100 / 3)
    assert told("unseen", *rows) == pytest.approx(100 / 3)


@pytest.mark.parametrize("words", ["timescale-eror", "men timescale-error", "mean", ""])
def test_an_unknown_measure_or_summary_is_refused_with_the_nearest(words):
    with pytest.raises(InputError, match="unknown"):
        measure(words)


def test_every_measure_reads_a_case_without_any_column_of_its_own():
    cases = frame(case(), case(1, None, status="error"))
    for each in MEASURES.values():
        assert each.values(cases).shape == (2,)


RNG = np.random.default_rng(3)
VALUES = RNG.exponential(2.0, (4, 9))
PLAIN = {
    "mean": np.mean,
    "value": np.mean,
    "geometric mean": lambda row: stats.gmean(np.maximum(row, measures.TINY)),
    "rms": lambda row: math.sqrt(np.mean(row**2)),
    "share": lambda row: 100.0 * np.mean(row),
    "largest": np.max,
}


@pytest.mark.parametrize("name", measures.SUMMARIES)
def test_summaries_by_their_definitions(name):
    values = np.floor(VALUES)
    assert measures.SUMMARIES[name](values) == pytest.approx([PLAIN[name](row) for row in values])


@pytest.mark.parametrize("share", measures.QUANTILES.values())
def test_quantiles_are_those_of_numpy(share):
    holes = VALUES.copy()
    holes[0, 3] = holes[2, :4] = np.nan
    assert quantile(holes, share) == pytest.approx(np.nanquantile(holes, share, axis=1))
    for count in (8, 9):
        expected = np.quantile(VALUES[:, :count], share, axis=1, method="averaged_inverted_cdf")
        assert quantile(VALUES[:, :count], share, failures=True) == pytest.approx(expected)
    assert quantile(np.array([[1.0, np.inf], [1.0, 3.0]]), 0.5, failures=True).tolist() == [1, 2]


def test_of_nothing_nothing_is_known():
    nothing = np.full((2, 3), np.nan)
    assert np.isnan(mean(nothing)).all()
    assert np.isnan(quantile(nothing, 0.5)).all()
    assert all(map(math.isnan, (*wilson(0, 0), *ratio(np.array([]), np.array([])))))
    assert all(map(math.isnan, interval(mean, VALUES[:1])))


def test_the_interval_is_that_of_scipy_and_draws_units_not_cases():
    units = RNG.normal(1.0, 2.0, 60)
    ours = measures.ends(resampled(lambda at: units[at].mean(axis=1), 60, resamples=4000))
    theirs = stats.bootstrap((units,), np.mean, n_resamples=4000, method="percentile")
    assert ours == pytest.approx(tuple(theirs.confidence_interval), abs=0.06)
    once = interval(mean, units[:, None])
    assert interval(mean, np.repeat(units[:, None], 4, axis=1)) == pytest.approx(once)


def test_units_drawn_in_parts_are_the_same_units(monkeypatch):
    whole = resampled(lambda at: at.sum(axis=1), 7, resamples=50)
    monkeypatch.setattr(measures, "CHUNK", 21)
    assert np.array_equal(resampled(lambda at: at.sum(axis=1), 7, resamples=50), whole)


def test_values_on_a_grid():
    grid = measures.gridded(np.array([1.0, 2.0, 3.0]), [np.array([0, 1, 0])], [2])
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
