"""The verdict misfit in words, and what comes before it."""

import math
from dataclasses import replace

import pytest

import sparsefit as sf
from sparsefit.estimator import Doubt
from sparsefit.estimator.misfit import misfit
from sparsefit.uncertainty import Cause, Goodness, Suspect

VEHICLE = sf.PointMassVehicle(response_time=0.5, thrust_acceleration=(5.0, 3.0))


def suspected(cause, *size):
    return Goodness(0.99, 0.0, 40.0, 3.0, 0.5, Suspect(cause, size, 1e-9, 0.5))


@pytest.mark.parametrize(
    ("cause", "size", "words"),
    [
        (
            Cause.WIND,
            (1.0, -2.0),
            'wind of (1, -2) m/s; free it: unknown = ["wind"] (--unknown wind)',
        ),
        (Cause.RESPONSE_TIME, (-0.02,), "0.02 s shorter"),
        (Cause.SWELLING, (0.14,), "change in time, by 14 % rms"),
        (Cause.DRIFT, (0.5, 0.1), "drift at about (0.5, 0.1) m/s"),
        (Cause.TURN, (math.radians(5),), "turned, by about 5 degrees"),
        (Cause.STRETCH, (-0.1,), "longer in y than in x, by about 10 %"),
        (Cause.TURBULENCE, (3.0,), "turbulence of 3 m/s, 50 % of U0"),
    ],
)
def test_the_reason_says_what_the_flow_seems_to_be(cause, size, words):
    verdict = misfit(suspected(cause, *size))
    assert verdict.status == "misfit"
    assert verdict.doubt is Doubt.MISFIT
    assert words in verdict.reason
    assert "R² 0.99" in verdict.reason


def test_the_remedy_keeps_what_is_freed_already():
    verdict = misfit(suspected(Cause.WIND, 1.0, 0.0), ("response_time",))
    assert verdict.reason.endswith(
        'unknown = ["response_time", "wind"] (--unknown response_time wind)'
    )


def test_no_cause_is_named_where_little_is_explained():
    goodness = replace(suspected(Cause.WIND, 1.0, 0.0), r_squared=0.62)
    verdict = misfit(goodness)
    assert verdict.status == "misfit"
    assert "explains only 62 % of the flow velocity" in verdict.reason
    assert "wind" not in verdict.reason


def test_what_a_filter_does_to_a_flow_of_few_samples_is_no_cause():
    # 26 ms a sample would do; at 100 ms the filter takes a quarter of the flow.
    flow = sf.CellularFlow(mean_velocity=3.6 / 0.13, length_scale=3.6)
    noise = {"velocity_noise": 0.2, "position_noise": 0.05}
    flight = sf.simulate_flight(flow, VEHICLE, duration=20.0, sample_rate=10.0, seed=0, **noise)
    assert sf.Estimator().estimate(flight).goodness.suspect is None


def test_nothing_suspected_is_no_misfit():
    assert misfit(None) is None
    assert misfit(Goodness(0.99)) is None


@pytest.mark.parametrize("noise", [0.0, 0.2])
def test_less_than_one_period_is_told_only_where_it_fits_exactly(noise):
    flow = sf.CellularFlow(mean_velocity=20.0, length_scale=10.0)
    slow = sf.PointMassVehicle(response_time=0.1, thrust_acceleration=(0.0, 0.0))
    flight = sf.simulate_flight(
        flow,
        slow,
        duration=6.0,
        sample_rate=100.0,
        seed=3,
        initial_position=(3.0, 5.0),
        velocity_noise=noise,
        position_noise=0.05 * noise,
    )
    found = sf.Estimator().estimate(flight)
    assert flight.extent < 20.0  # it circles in one eddy
    assert found.length_scale == pytest.approx(10.0, rel=0.01)
    assert found.status == ("unidentifiable" if noise else "ok")
    assert found.doubt is (Doubt.SHORT_TRACK if noise else None)


def test_the_command_line_tells_the_goodness_of_fit():
    from sparsefit.cli.answer import Log, lines
    from sparsefit.logs.checks import quality_of

    flow = sf.SuperposedFlow((sf.CellularFlow(12.0, 4.0),), (1.5, 0.0))
    flight = sf.simulate_flight(
        flow, VEHICLE, duration=10.0, sample_rate=100.0, seed=5, velocity_noise=0.1
    )
    found = sf.Estimator().estimate(flight)
    log = Log("flight.csv", flight, quality_of(flight), ())
    text = "\n".join(lines([log], found, ()))
    assert f"R² {found.goodness.r_squared:.6f}" in text
    assert "status                misfit: " in text
