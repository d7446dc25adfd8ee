"""The records: words for what is hardly known, and a vehicle by hand."""

import math

import pytest

from sparsefit.uncertainty import Uncertainty, VehicleUncertainty


def test_words_for_what_is_hardly_known():
    known = Uncertainty.around([10.0, 4.0, 0.4], [2.0, 0.01, 0.08])
    assert "mean velocity is known only to +-39 %" in known.wide((10.0, 4.0, 0.4), 0.03)
    assert (
        Uncertainty.around([10.0, 4.0, 0.4], [0.02, 0.01, 0.002]).wide((10.0, 4.0, 0.4), 0.03) == ""
    )
    lost = Uncertainty.around([10.0, 4.0, 0.4], [math.nan, 0.01, 0.002])
    assert lost.mean_velocity == math.inf
    assert "does not tell the mean velocity" in lost.wide((10.0, 4.0, 0.4), 0.03)


def test_the_widest_value_is_data():
    known = Uncertainty.around([10.0, 4.0, 0.4], [0.2, 0.2, 0.004])
    name, share = known.widest((10.0, 4.0, 0.4))
    assert name == "length_scale"
    assert share == pytest.approx(1.96 * 0.05, rel=1e-4)
    lost = Uncertainty.around([10.0, 4.0, 0.4], [0.2, 0.2, math.nan])
    assert lost.widest((10.0, 4.0, 0.4)) == ("timescale", math.inf)


def test_the_record_of_a_vehicle_by_hand():
    known = VehicleUncertainty.around({"response_time": (0.5,)}, {"response_time": (0.01,)})
    assert known.response_time == 0.01
    assert known.response_time_interval == pytest.approx((0.5 - 0.0196, 0.5 + 0.0196), abs=1e-5)
    assert known.wind is known.wind_intervals is None
    known = VehicleUncertainty.around({"wind": (1.0, 2.0)}, {"wind": (0.1, math.inf)})
    assert math.isnan(known.response_time)
    assert known.wind_intervals[1] == (-math.inf, math.inf)
