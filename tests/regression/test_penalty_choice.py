"""alpha_fraction = "auto": the choice is told from the data alone, and is what it says it is."""

import dataclasses
import json
from dataclasses import dataclass
from typing import get_args

import numpy as np
import pytest

import sparsefit as sf
from sparsefit import backends
from sparsefit.errors import InputError
from sparsefit.model.library import Library
from sparsefit.regression.backend import Selection, Solution
from sparsefit.regression.group_penalties import GroupNorms
from sparsefit.regression.penalties import alpha_max, lasso_penalty
from sparsefit.regression.penalty_choice import (
    FRACTIONS,
    degrees_of_freedom,
    effective_samples,
    held_out_errors,
)
from sparsefit.regression.problem import RegressionProblem
from sparsefit.solvers.penalised import Lasso
from sparsefit.study.study import Study
from tests.problems import SMALL_GRID, degenerate, flight, flight_problem, regular
from tests.study.small_study import small_study

NAMES = ("lasso", "group-lasso")
every = pytest.mark.parametrize("selection", get_args(Selection))
both = pytest.mark.parametrize("name", NAMES)
STUDY = small_study("auto", count=1, seed=11, duration=4.0) + (
    '[[backends]]\nname = "lasso"\nalpha_fraction = ["auto", 0.1]\nselection = "bic"\n'
)


def auto(name="lasso", selection="bic", **more):
    return backends.get(name, alpha_fraction="auto", selection=selection, **more)


def noisy(seed=3):
    return flight_problem(seed=seed, velocity_noise=0.1)


@dataclass(frozen=True)
class Failing(Lasso):
    """Solves nothing below ``least``."""

    least: float = 0.0

    def solve_path(self, problem, alpha_fractions):
        good = super().solve_path(problem, alpha_fractions)
        gave_up = Solution(None, "error", "gave up")
        return tuple(
            s if f >= self.least else gave_up for s, f in zip(good, alpha_fractions, strict=True)
        )

    def referee(self):
        return None


@every
@both
def test_auto_is_the_point_fit_at_the_fraction_it_chose(name, selection):
    problem = regular(2)
    found = sf.fit(problem, auto(name, selection))
    assert found.backend.alpha_fraction in FRACTIONS
    assert found.criterion.shape == (30,)
    point = sf.fit(problem, found.backend)
    assert found.status == point.status == "ok"
    assert found.reason == ""
    assert point.criterion is None
    assert found.weights == pytest.approx(point.weights, abs=1e-5 * np.abs(point.weights).max())


@every
@both
def test_the_choice_does_not_depend_on_units(name, selection):
    problem = noisy()
    choice = sf.fit(problem, auto(name, selection))
    units = np.geomspace(1e-3, 1e3, problem.columns)
    scaled = dataclasses.replace(
        problem, theta=problem.theta * units, target=problem.target * 1024.0
    )
    moved = sf.fit(scaled, auto(name, selection))
    assert moved.alpha_fraction == choice.alpha_fraction
    assert moved.criterion == pytest.approx(choice.criterion, rel=1e-4, abs=1e-4)


@every
@both
@pytest.mark.parametrize("velocity_noise", [0.0, 0.1])
def test_the_scale_of_a_flight_is_found_and_the_settings_say_how(name, selection, velocity_noise):
    estimator = sf.Estimator(library=Library(SMALL_GRID), backend=auto(name, selection))
    estimate = estimator.estimate(flight(4.5, velocity_noise=velocity_noise))
    assert estimate.status == "ok"
    assert estimate.grid_length_scale == 4.5
    assert estimate.settings["selection"] == selection
    assert estimate.settings["alpha_fraction"] in FRACTIONS
    json.dumps(estimate.to_dict(), allow_nan=False)
    assert sf.Estimator.from_json(estimator.to_json()) == estimator


@both
def test_the_information_criterion_is_minimised(name):
    choice = sf.fit(noisy(), auto(name))
    assert choice.alpha_fraction == FRACTIONS[np.argmin(choice.criterion)]


@both
def test_cross_validation_takes_the_strongest_penalty_within_a_standard_error(name):
    problem, backend = noisy(), auto(name, "cross-validation")
    choice, folds = sf.fit(problem, backend), held_out_errors(problem, backend)
    np.testing.assert_array_equal(choice.criterion, folds.mean(axis=0))
    best = int(np.argmin(choice.criterion))
    excess = folds - folds[:, [best]]
    error = np.sqrt(excess.var(axis=0, ddof=1) / 5)
    index = int(np.flatnonzero(excess.mean(axis=0) <= error * (1 + 1e-12))[0])
    assert choice.alpha_fraction == FRACTIONS[index] >= FRACTIONS[best]
    assert choice.criterion[0] == pytest.approx(1.0, rel=1e-3)  # nothing explained


@both
def test_noise_without_a_signal_is_left_unexplained(name):
    rng = np.random.default_rng(5)
    chosen = []
    for _ in range(5):
        theta, target = rng.normal(size=(200, 30)), rng.normal(size=(200, 2))
        problem = RegressionProblem.from_arrays(theta, target, np.repeat(np.arange(10), 3))
        found = sf.fit(problem, auto(name))
        chosen.append(len(np.unique(problem.groups[found.support])))
    assert np.mean(chosen) <= 0.5


def divergence(problem, penalty, name, alpha, **more):
    """sum_it d(fit_it)/d(Y_it) at a fixed alpha, by central differences."""

    def fitted(target):
        moved = dataclasses.replace(problem, target=target)
        fraction = alpha / alpha_max(moved.cross, penalty)
        weights = backends.get(name, alpha_fraction=fraction, **more).solve(moved).weights
        return problem.theta @ weights

    step, total = 1e-4, 0.0
    for place in np.ndindex(problem.target.shape):
        bump = np.zeros(problem.target.shape)
        bump[place] = step
        difference = fitted(problem.target + bump) - fitted(problem.target - bump)
        total += difference[place] / (2 * step)
    return total


@pytest.mark.parametrize("fraction", [0.2, 0.03])
@pytest.mark.parametrize(
    ("name", "more"),
    [
        ("lasso", {}),
        ("group-lasso", {}),
        ("group-lasso", {"separate": True}),
        ("sparse-group-lasso", {"l1_ratio": 0.3}),
        ("ridge", {}),
        ("slope", {}),
        ("fused-lasso", {}),
    ],
)
def test_degrees_of_freedom_are_the_divergence_of_the_fit(name, more, fraction):
    problem = regular(5, samples=7, groups=3, size=2)
    backend = backends.get(name, alpha_fraction=fraction, **more)
    penalty = backend.penalty(problem)
    alpha = fraction * alpha_max(problem.cross, penalty)
    scaled = backend.solve(problem).weights * problem.design.rms[:, None]
    pull = problem.cross - problem.design.gram @ scaled
    found = degrees_of_freedom(problem.design, scaled, pull, alpha, penalty)
    assert found == pytest.approx(divergence(problem, penalty, name, alpha, **more), abs=2e-3)


def test_degrees_of_freedom_of_nothing_and_of_everything():
    design, none = regular().design, np.zeros((12, 2))
    joint = GroupNorms(np.repeat(np.arange(4), 3), np.ones(4))
    assert degrees_of_freedom(design, none, none, 0.1, joint) == 0
    full = np.random.default_rng(0).normal(size=(12, 2))
    assert degrees_of_freedom(design, full, none, 1e9, joint) == 0
    assert degrees_of_freedom(design, full, none, 1e-12, joint) == pytest.approx(24, abs=1e-6)
    assert degrees_of_freedom(design, full, none, 0.1, lasso_penalty(12)) == 24


@pytest.mark.parametrize("correlation", [0.0, 0.5, 0.9])
def test_effective_samples_of_an_autoregression(correlation):
    rng = np.random.default_rng(1)
    residual = rng.normal(size=(20_000, 2))
    for i in range(1, len(residual)):
        residual[i] += correlation * residual[i - 1]
    expected = 20_000 * (1 - correlation) / (1 + correlation)
    assert effective_samples(residual) == pytest.approx(expected, rel=0.25)


@pytest.mark.parametrize(
    ("residual", "least", "most"),
    [
        (np.zeros((9, 2)), 9, 9),
        *((np.ones((m, 1)), max(m, 2), max(m, 2)) for m in (1, 3)),
        (np.ones((100, 1)), 0, 9.9),
        (np.arange(1000.0)[:, None] - 499.0, 0, 19.9),
    ],
)
def test_effective_samples_of_nothing_to_correlate_and_of_what_hangs_together(
    residual, least, most
):
    assert least <= effective_samples(residual) <= most


def test_compressed_samples_are_chosen_for_by_information_only():
    problem = regular(samples=80)
    packed = dataclasses.replace(problem, sample_count=80)
    fit = sf.fit(packed, auto("group-lasso"))
    residual = packed.target - packed.theta @ fit.weights
    share = np.square(residual).sum(axis=0) / np.square(packed.target).sum(axis=0)
    values = fit.weights * packed.design.rms[:, None]
    pull = packed.design.correlate(residual)
    penalty = fit.backend.penalty(packed)
    freedom = degrees_of_freedom(packed.design, values, pull, fit.alpha, penalty)
    expected = 80.0 * np.log(share).sum() + np.log(80.0) * freedom
    assert np.nanmin(fit.criterion) == pytest.approx(expected)
    with pytest.raises(InputError, match="compressed; give alpha_fraction as a number"):
        sf.fit(packed, auto("group-lasso", "cross-validation"))


@every
def test_a_sample_of_weight_zero_has_no_say(selection):
    theta, target = regular(targets=1).theta, regular(targets=1).target
    weight = np.where(np.arange(60) % 7 == 3, 0.0, 1.0)
    choices = []
    for shift in (0.0, 1e3):
        moved = target + shift * (weight == 0)[:, None]
        posed = RegressionProblem.from_arrays(theta, moved, sample_weight=weight, intercept=True)
        choices.append(sf.fit(posed, auto("lasso", selection)))
    assert choices[0].criterion == pytest.approx(choices[1].criterion, rel=1e-9)
    assert choices[0].intercept == pytest.approx(choices[1].intercept)


@pytest.mark.parametrize("name", ["lasso", "ridge", "huber-lasso"])
def test_what_cannot_be_cut_up_is_refused(name):
    with pytest.raises(InputError, match=r"needs at least 10 samples, not 8; give alpha_fraction"):
        sf.fit(regular(samples=8), auto(name, "cross-validation"))


@pytest.mark.parametrize("name", ["lasso", "group-lasso", "ridge", "huber-lasso"])
def test_a_column_that_is_zero_outside_of_a_fold_weighs_nothing_there(name):
    theta = np.random.default_rng(0).normal(size=(20, 3))
    theta[1:, 1] = 0.0  # the second column is zero but for the first sample
    problem = RegressionProblem.from_arrays(theta, theta[:, 0] + 0.1 * theta[:, 2])
    assert sf.fit(problem, auto(name, "cross-validation")).status == "ok"
    rest = problem.part(np.arange(1, 20))
    alone = sf.fit(rest, backends.get(name, alpha_fraction=0.1))
    assert alone.status == "ok"
    assert not alone.weights[1].any()


@pytest.mark.parametrize("kind", ["duplicate", "wide", "perfect", "one sample", "low rank"])
@both
def test_degenerate_problems_are_chosen_for(name, kind):
    found = sf.fit(degenerate(kind, 0), auto(name), tolerance=1e-6)
    assert found.status == "ok"
    assert np.isfinite(found.criterion).all()


@every
@both
def test_a_zero_target_is_fitted_by_zeros(name, selection):
    problem = regular()
    problem = dataclasses.replace(problem, target=np.zeros_like(problem.target))
    found = sf.fit(problem, auto(name, selection))
    assert found.status == "ok"
    assert not found.weights.any()


@every
def test_points_without_a_solution_are_not_chosen(selection):
    failing = Failing("auto", selection=selection, least=0.2)
    found = sf.fit(regular(), failing)
    assert found.status == "ok"
    assert found.alpha_fraction >= 0.2
    assert np.isnan(found.criterion[-1])
    nothing = sf.fit(regular(), Failing("auto", selection=selection, least=2.0))
    assert (nothing.status, nothing.reason) == ("error", "gave up")
    assert np.isnan(nothing.criterion).all()


@both
def test_only_fit_chooses(name):
    with pytest.raises(InputError, match="solve needs a number"):
        auto(name).solve(regular())
    along = sf.path(regular(), auto(name), [0.3, 0.1])
    assert [f.backend.alpha_fraction for f in along.fits] == [0.3, 0.1]


def test_a_study_may_ask_for_auto_beside_numbers(tmp_path):
    path = tmp_path / "auto.toml"
    path.write_text(STUDY)
    study = Study.from_file(path, results=tmp_path)
    study.run(processes=1)
    cases = study.cases
    assert cases["status"].tolist() == ["ok"] * 2, cases["reason"].tolist()
    asked = [json.loads(text)["alpha_fraction"] for text in cases["settings"]]
    assert asked == ["auto", 0.1]
