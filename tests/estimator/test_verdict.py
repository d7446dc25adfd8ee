"""What a flight cannot tell is never answered with a number that looks fine."""

import math
from functools import cache

import numpy as np
import pytest

import sparsefit as sf
from sparsefit.errors import InputError
from sparsefit.estimator import Doubt
from tests.worlds import GROUPS, draw

VEHICLE = sf.PointMassVehicle(response_time=0.5, thrust_acceleration=(5.0, 3.0))
FLOW = sf.CellularFlow(mean_velocity=15.43, length_scale=4.21)


@cache
def flown(flow=FLOW, duration=10.0, rate=100.0, seed=7, **noise):
    return sf.simulate_flight(
        flow, VEHICLE, duration=duration, sample_rate=rate, seed=seed, **noise
    )


def estimate(flight, lower=1.0, upper=12.0):
    library = sf.Library(sf.model.LengthScaleGrid(lower, upper))
    return sf.Estimator(library=library).estimate(flight)


@pytest.mark.parametrize(("seed", "noise"), [(0, 0.0), (1, 0.3)])
@pytest.mark.parametrize(
    ("lower", "upper"),
    [(1.0, 3.0), (1.9, 2.3), (4.4, 12.0), (8.0, 9.0)],
)
def test_bounds_that_exclude_the_truth_are_flagged(lower, upper, seed, noise):
    # L/2 = 2.105 m and 2L = 8.42 m, the harmonics, are within some of them.
    found = estimate(flown(seed=seed, velocity_noise=noise), lower, upper)
    assert found.status in ("unidentifiable", "misfit")
    assert found.reason


def test_samples_too_far_apart_are_named_with_the_remedy():
    found = estimate(flown(rate=5.0, duration=20.0))
    assert found.status == "unidentifiable"
    assert "from sample to sample" in found.reason
    assert "Hz or more" in found.reason


def test_sampling_as_the_reason_says_is_enough():
    reason = estimate(flown(rate=5.0, duration=20.0)).reason
    rate = float(reason.split("sample at ")[1].split(" Hz")[0])
    found = estimate(flown(rate=2 * math.ceil(rate), duration=20.0))
    assert found.status == "ok"
    assert found.mean_velocity == pytest.approx(15.43, rel=0.05)


def test_low_rates_are_right_or_flagged():
    for seed in range(8):
        rate = (4.0, 8.0, 16.0, 32.0)[seed % 4]
        found = estimate(flown(rate=rate, duration=20.0, seed=seed))
        if found.status == "ok":
            assert found.mean_velocity == pytest.approx(15.43, rel=0.05)
            assert found.length_scale == pytest.approx(4.21, rel=0.05)


def test_a_noisy_flight_within_one_cell_is_flagged():
    flow = sf.CellularFlow(mean_velocity=6.0, length_scale=10.0)
    for seed in range(4):
        flight = flown(flow, duration=2.0, seed=seed, velocity_noise=0.5, position_noise=0.1)
        assert flight.extent < 10.0
        found = estimate(flight)
        right = (
            abs(found.length_scale / 10.0 - 1) < 0.05 and abs(found.mean_velocity / 6 - 1) < 0.05
        )
        assert found.status == "unidentifiable" or right
        assert found.reason or right


def test_a_rival_that_explains_a_short_flight_as_well_is_told():
    flow = sf.flows.ShapedCells(9.8, (5.89, 6.77), heading=1.3)
    flight = sf.simulate_flight(
        flow,
        sf.PointMassVehicle(0.5, (4.0, 2.0)),
        duration=3.0,
        sample_rate=50.0,
        velocity_noise=0.4,
        position_noise=0.1,
        initial_position=(0.8, 1.0),
        seed=48,
    )
    found = estimate(flight)
    assert found.doubt is Doubt.RIVAL
    # The likelier is wrong and the rival near the truth; both are in the reason.
    assert found.length_scale == pytest.approx(4.2, abs=0.1)
    assert found.rival_length_scale == pytest.approx(6.5, abs=0.1)
    assert f"{found.rival_length_scale:.3g} m (shape" in found.reason


@pytest.mark.parametrize("samples", [3, 5, 12, 18, 21])  # up to 20 of Phi
def test_a_handful_of_samples_tells_nothing(samples):
    whole = flown()
    flight = sf.Flight(
        time=whole.time[:samples],
        position=whole.position[:samples],
        velocity=whole.velocity[:samples],
        vehicle=VEHICLE,
    )
    found = estimate(flight)
    assert found.status == "unidentifiable"
    assert "samples are too few" in found.reason


def test_a_flight_that_stands_still_is_refused():
    time = np.arange(200) * 0.01
    still = sf.Flight(
        time=time, position=np.full((200, 2), 3.0), velocity=np.zeros((200, 2)), vehicle=VEHICLE
    )
    with pytest.raises(InputError, match="does not move"):
        estimate(still)


def test_still_air_flown_slowly_with_noisy_instruments_is_no_flow():
    # Long windows leave few independent errors: their correlation is read from their spectrum.
    time = np.arange(2001) * 0.01
    vehicle = sf.PointMassVehicle(0.5, (1.0, 0.6))
    end, decay = 0.5 * np.array([1.0, 0.6]), np.exp(-time / 0.5)[:, None]
    for seed in range(2):
        rng = np.random.default_rng(seed)
        position = end * (time[:, None] - 0.5 * (1 - decay)) + 1.0
        flight = sf.Flight(
            time=time,
            position=position + 0.1 * rng.standard_normal(position.shape),
            velocity=end * (1 - decay) + 0.5 * rng.standard_normal(position.shape),
            vehicle=vehicle,
        )
        found = sf.Estimator().estimate(flight)
        assert found.status == "unidentifiable"
        assert found.doubt == Doubt.NO_FLOW, found.reason


@pytest.mark.parametrize("late", [-0.2, 0.2])
def test_a_large_latency_is_named_or_freed(late):
    whole = flown(rate=50.0, duration=20.0, seed=3, velocity_noise=0.2, position_noise=0.05)
    shift = round(late * 50)
    there, then = (slice(10, -10), slice(10 - shift, len(whole.time) - 10 - shift))
    flight = sf.Flight(
        time=whole.time[there], position=whole.position[then], velocity=whole.velocity[there],
        vehicle=VEHICLE,
    )  # fmt: skip
    found = estimate(flight)
    if found.status == "ok":  # with the latency freed, which moves the flow by nothing
        assert found.freed == ("latency",)
        assert found.mean_velocity == pytest.approx(15.43, rel=0.01)
    else:
        words = f"the logged {'position' if late > 0 else 'velocity'} seems late, by"
        assert (found.status, words in found.reason) == ("misfit", True)
        milliseconds = float(found.reason.split(words)[1].split(" ms")[0])
        assert milliseconds == pytest.approx(200, abs=40)
    freed = sf.Estimator(free="auto").estimate(flight)  # rows so far apart may not show the flow
    assert freed.status == "misfit" or freed.mean_velocity == pytest.approx(15.43, rel=0.01)


def test_causes_beside_which_something_wanders_are_not_believed():
    whole = flown(duration=20.0, rate=50.0, seed=5, velocity_noise=0.2, position_noise=0.05)
    slow, share = whole.velocity.copy(), 0.02 / (0.1 + 0.02)
    for row in range(1, len(slow)):  # a low-pass filter of 0.1 s, which is no latency
        slow[row] = slow[row - 1] + share * (whole.velocity[row] - slow[row - 1])
    flight = sf.Flight(time=whole.time, position=whole.position, velocity=slow, vehicle=VEHICLE)
    found = sf.Estimator(free="auto").estimate(flight)
    assert found.status != "ok" or found.mean_velocity == pytest.approx(15.43, rel=0.02)


def test_how_precise_an_answer_must_be_is_a_setting():
    flight = flown(velocity_noise=0.3, position_noise=0.05)
    asked = {
        share: sf.Estimator(readout=sf.Readout(precision=share)).estimate(flight)
        for share in (1e-4, 0.03)
    }
    assert asked[0.03].status == "ok"
    assert (asked[1e-4].status, asked[1e-4].doubt) == ("unidentifiable", Doubt.IMPRECISE)
    assert "ask for less (readout precision)" in asked[1e-4].reason
    assert asked[1e-4].mean_velocity == asked[0.03].mean_velocity
    with pytest.raises(InputError, match="readout: precision must be"):
        sf.Readout(precision=-0.1)


class Growing:
    """Cells whose mean velocity grows by 1 % in a second."""

    period = 8.0

    def velocity(self, x, y, t):
        u, v = sf.CellularFlow(8.0, 4.0).velocity(x, y)
        return (1.0 + 0.01 * (t - 7.5)) * u, (1.0 + 0.01 * (t - 7.5)) * v


def test_a_mean_velocity_that_grows_is_a_misfit_with_its_rate():
    vehicle = sf.PointMassVehicle(0.4, (5.0, 3.0))
    noise = {"velocity_noise": 0.2, "position_noise": 0.05}
    flight = sf.simulate_flight(
        Growing(), vehicle, duration=15.0, sample_rate=40.0, seed=3, **noise
    )
    estimate = sf.Estimator().estimate(flight)
    assert (estimate.status, estimate.goodness.suspect.cause) == ("misfit", "decay")
    low, high = estimate.constancy.interval
    assert 0.0 < low < 0.08 < high


def test_a_lag_is_as_sure_as_its_first_order():
    """One of 33 ms in a response time of 125 ms: by the noise alone U0 was known to 0.03 %."""
    world = next(own for own in GROUPS["vehicle"] if own.name == "lag 0.03")
    ((flight, truth),) = draw(world, 2, 61001, first=1)
    estimate = sf.Estimator(free="auto").estimate(flight)
    assert estimate.freed == ("lag",)
    low, high = estimate.uncertainty.mean_velocity_interval
    assert low < truth.mean_velocity < high
    assert high - low < 0.03 * truth.mean_velocity
