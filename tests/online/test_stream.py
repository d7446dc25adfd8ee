"""Flights followed as streams: by a study, and by the clock."""

import numpy as np
import pytest

import sparsefit as sf
from sparsefit.online.__main__ import main
from sparsefit.online.clock import clocked
from sparsefit.online.stream import Stream
from tests.online.streams import ESTIMATOR, FLIGHT, VEHICLE, assert_same, online_of


def test_a_study_sees_what_the_stream_left():
    stream = Stream(window=8.0)
    prepared = stream.prepare(ESTIMATOR, [FLIGHT])
    estimate = ESTIMATOR.read(prepared, ESTIMATOR.fit(prepared))
    last = FLIGHT.time >= FLIGHT.time[-1] - 8.0 - 1e-9
    held = sf.Flight(FLIGHT.time[last], FLIGHT.position[last], FLIGHT.velocity[last], VEHICLE)
    assert_same(estimate, ESTIMATOR.estimate(held))


def test_without_a_window_the_whole_flight_counts_at_once():
    assert not Stream().asked
    assert len(Stream().prepare(ESTIMATOR, [FLIGHT]).samples.time) == FLIGHT.samples - 6
    Stream().refuse_unfit(sf.Estimator())
    with pytest.raises(sf.InputError, match="savgol, central"):
        Stream(memory=1.0).refuse_unfit(sf.Estimator())
    with pytest.raises(sf.InputError, match="not both"):
        Stream(window=1.0, memory=1.0)


def test_the_clock_counts_every_sample_and_estimate_after_the_warm_up():
    times = clocked(online_of(window=4.0), FLIGHT, every=100, warm_up=10.0)
    assert (len(times.updates), len(times.estimates)) == (500, 5)
    assert np.all(times.updates >= 0)
    assert np.all(times.estimates > 0)
    assert (times.samples, times.columns) == (101, 104)


def test_the_module_prints_a_line_for_every_back_end(monkeypatch, capsys):
    asked = "--window 2 --rate 20 --seconds 4 --every 1 --backend best-scale lasso"
    monkeypatch.setattr("sys.argv", ["online", *asked.split()])
    main()
    first, *lines = capsys.readouterr().out.splitlines()
    assert "median" in first
    assert [line.split()[0] for line in lines] == ["best-scale", "lasso"]
    assert all("41 samples x 448 columns" in line for line in lines)
