"""The model of the exported C is the library's own answer where both do the same."""

import numpy as np
import pytest

import sparsefit as sf
from sparsefit.export import Tuning, answers
from sparsefit.export.model import GENERATED, sums_at
from sparsefit.export.model_choice import lasso, stlsq
from sparsefit.export.model_rows import microseconds, rows_of
from sparsefit.export.model_scale import cross_of, gram_of, least_squares
from tests.export.boards import VEHICLE, estimator, fly, plan_of

FLIGHT = fly()
LAST = np.array([FLIGHT.samples - 1])


def at_the_end(plan, flight=FLIGHT, tuning=GENERATED):
    return next(answers(plan, flight, np.array([flight.samples - 1]), tuning))


def sums_at_the_end(plan, tuning=GENERATED):
    return next(sums_at(plan, FLIGHT, LAST, tuning))[1]


@pytest.mark.parametrize(
    "derivative",
    [
        sf.Derivative("forward"),
        sf.Derivative("central"),
        sf.Derivative("midpoint"),
        sf.Derivative("savgol", window=7, order=3),
    ],
    ids=lambda derivative: derivative.method,
)
def test_rows_are_those_of_the_derivative(derivative):
    plan = plan_of(derivative=derivative)
    rows = list(rows_of(plan, FLIGHT, np.array([], dtype=int), (0.0, 0.0)))
    samples = derivative(FLIGHT)
    np.testing.assert_allclose([row.place for row in rows], samples.position, rtol=1e-12)
    np.testing.assert_allclose([row.phi for row in rows], samples.flow_velocity(VEHICLE), rtol=1e-9)


def test_a_central_difference_weighs_uneven_steps_as_the_batch_does():
    time = microseconds(FLIGHT.time) + np.random.default_rng(3).integers(
        -2000, 2000, FLIGHT.samples
    )
    flight = sf.Flight(time=time * 1e-6, position=FLIGHT.position, velocity=FLIGHT.velocity,
                       vehicle=VEHICLE)  # fmt: skip
    derivative = sf.Derivative("central", repair=False)
    rows = list(rows_of(plan_of(derivative=derivative), flight, np.array([], dtype=int), (0, 0)))
    expected = derivative(flight).flow_velocity(VEHICLE)
    np.testing.assert_allclose([row.phi for row in rows], expected, rtol=1e-7)


def test_every_third_row_is_that_of_the_library():
    plan = plan_of(every=3)
    prepared = estimator(every=3).prepare(FLIGHT)
    assert sums_at_the_end(plan).rows == prepared.problem.samples


def test_sums_of_harmonics_are_the_gram_matrices_of_the_library():
    problem = estimator().prepare(FLIGHT).problem
    scales = sums_at_the_end(plan_of()).scales
    for g in (0, 17, 29):
        theta = problem.theta[:, 8 * g : 8 * g + 8]
        np.testing.assert_allclose(gram_of(scales[g, 0]), theta.T @ theta, rtol=0, atol=1e-9)
        expected = theta.T @ problem.target
        np.testing.assert_allclose(cross_of(scales[g, 0]), expected, rtol=0, atol=1e-7)


def test_taylor_coefficients_are_derivatives_in_k():
    step = 1e-4
    near = [
        estimator().library.grid.scales,
        np.pi / (np.pi / estimator().library.grid.scales + step),
        np.pi / (np.pi / estimator().library.grid.scales - step),
    ]
    values = []
    for scales in near:
        plan = plan_of()
        object.__setattr__(plan, "scales", scales)
        values.append(next(sums_at(plan, FLIGHT, LAST))[1].scales)
    here, after, before = values
    slope, bend = (after - before)[:, 0] / (2 * step), (after - 2 * here + before)[:, 0] / step**2
    np.testing.assert_allclose(here[:, 1], slope, atol=1e-5 * np.abs(slope).max())
    np.testing.assert_allclose(here[:, 2], bend / 2, atol=1e-4 * np.abs(bend).max())


def test_blocks_and_answers_before_change_nothing_but_rounding():
    plan = plan_of()
    alone = at_the_end(plan, tuning=Tuning(block=10_000))
    several = list(answers(plan, FLIGHT, np.array([200, 300, *LAST]), Tuning(block=7)))[-1]
    assert several.length_scale == pytest.approx(alone.length_scale, rel=1e-10)
    assert several.mean_velocity == pytest.approx(alone.mean_velocity, rel=1e-9)


def test_best_scale_on_the_grid_is_the_batch_estimate():
    batch = estimator(refine="none").estimate(FLIGHT)
    answer = at_the_end(plan_of(refine="none"))
    assert answer.status == batch.status == "ok"
    assert answer.length_scale == batch.length_scale
    assert answer.mean_velocity == pytest.approx(batch.mean_velocity, rel=1e-9)
    assert answer.timescale == pytest.approx(batch.timescale, rel=1e-9)


@pytest.mark.parametrize("seed", [7, *(pytest.param(s, marks=pytest.mark.slow) for s in (11, 12))])
def test_the_refined_readout_is_the_batch_estimate_but_for_the_polynomial(seed):
    flight = fly(seed)
    extent = flight.extent
    step = (np.pi / 2 - np.pi / 8) / 89
    batch = estimator(count=90).estimate(flight)
    answer = at_the_end(plan_of(count=90), flight)
    assert answer.status == batch.status == "ok"
    assert answer.refined
    # Degree 5 leaves less than 1e-4 where steps are an eighth of a lobe.
    assert step * extent / (2 * np.pi) < 0.16
    assert answer.length_scale == pytest.approx(batch.length_scale, rel=3e-5)
    # Its error is on the safe side: five samples count as one.
    known = batch.uncertainty.length_scale
    assert known < answer.length_scale_error < 10 * known
    assert answer.mean_velocity == pytest.approx(batch.mean_velocity, rel=1e-4)


def test_lasso_is_the_batch_fit_and_its_gap_is_the_certificate():
    settings = {"backend": "lasso", "refine": "none", "count": 8, "alpha_fraction": 0.2}
    plan, batch = plan_of(**settings), estimator(**settings)
    fit = batch.fit(batch.prepare(FLIGHT))
    sums, start = sums_at_the_end(plan), np.zeros((64, 2))
    weights, gap = lasso(plan, sums, start, 5000)
    assert -1e-12 < gap < 1e-9
    np.testing.assert_allclose(weights, fit.weights, atol=1e-5 * np.abs(fit.weights).max())
    early, wide = lasso(plan, sums, start, 3)
    by_rows = objective(fit.problem, early) - objective(fit.problem, fit.weights)
    assert 1e-6 < by_rows <= wide


def objective(problem, weights):
    """Of the LASSO at a fifth of alpha_max, from the rows, in units of |Y|^2/2m."""
    m, rms = problem.samples, np.sqrt(np.mean(problem.theta**2, axis=0))
    alpha = 0.2 * np.abs(problem.theta.T @ problem.target / (m * rms[:, None])).max()
    residual = problem.target - problem.theta @ weights
    value = 0.5 * np.sum(residual**2) / m + alpha * np.abs(weights * rms[:, None]).sum()
    return value / (0.5 * np.sum(problem.target**2) / m)


def test_stlsq_is_the_batch_fit():
    settings = {"backend": "stlsq", "refine": "none", "count": 8}
    plan, batch = plan_of(**settings), estimator(**settings)
    fit = batch.fit(batch.prepare(FLIGHT))
    weights, moving = stlsq(plan, sums_at_the_end(plan), np.zeros((64, 2)), 0)
    assert moving == 0
    assert np.array_equal(weights != 0, fit.weights != 0)
    assert 0 < np.count_nonzero(weights) < weights.size
    np.testing.assert_allclose(weights, fit.weights, atol=1e-7 * np.abs(fit.weights).max())


def test_a_dependent_column_has_no_weight():
    terms = np.zeros(43)
    terms[0] = 4.0  # four rows at the origin: sines are zero, all cosines one
    for i in (1, 3):
        terms[i] = terms[5 * i] = 4.0
        for j in (1, 3):
            terms[5 * i + j] = 4.0
    terms[25:] = 1.0
    fit = least_squares(terms, 1e-9)
    assert fit.pivot == 0.0
    assert np.count_nonzero(fit.weights[:, 0]) == 1


def test_an_answer_waits_for_rows_and_for_a_period():
    asked = np.array([30, 80, 140, FLIGHT.samples - 1])
    few, early, _, last = answers(plan_of(), FLIGHT, asked, Tuning(minimum_rows=50))
    assert (few.doubt, few.status) == ("few-samples", "unidentifiable")
    assert np.isnan(few.length_scale)
    assert early.doubt
    assert last.status == "ok"


def test_still_air_and_a_uniform_wind_are_no_flow():
    rng = np.random.default_rng(5)
    velocity = np.full((FLIGHT.samples, 2), 3.0)
    velocity += 0.1 * rng.normal(size=velocity.shape)
    position = np.cumsum(velocity, axis=0) * 0.02
    vehicle = sf.PointMassVehicle(0.5)
    flight = sf.Flight(FLIGHT.time, position, velocity, vehicle)
    assert at_the_end(plan_of(), flight).doubt == "no-flow"
    air = sf.Flight(FLIGHT.time, position, np.zeros_like(velocity), vehicle)
    assert at_the_end(plan_of(), air).doubt == "no-flow"


def test_forgetting_follows_a_flow_that_changes():
    first = fly(1)
    shift = np.array([0.01, 0.0])
    other = sf.simulate_flight(
        sf.CellularFlow(mean_velocity=10.0, length_scale=5.5), VEHICLE, duration=8.0,
        sample_rate=50.0, seed=3, initial_position=tuple(first.position[-1] + shift),
    )  # fmt: skip
    time = np.concatenate([first.time, first.time[-1] + 0.02 + other.time])
    both = sf.Flight(
        time, np.vstack([first.position, other.position]),
        np.vstack([first.velocity, other.velocity]), VEHICLE,
    )  # fmt: skip
    kept = at_the_end(plan_of(count=60), both, Tuning(forgetting=0.8))
    whole = at_the_end(plan_of(count=60), both)
    assert kept.length_scale == pytest.approx(5.5, rel=0.01)
    assert kept.unexplained < 0.02
    assert whole.unexplained > 0.1
