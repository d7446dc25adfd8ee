"""The certificate over the plane: against columns, at the waves chosen, between them, refusals."""

import math
from dataclasses import replace

import numpy as np
import pytest

import sparsefit as sf
from sparsefit import backends
from sparsefit.errors import InputError
from sparsefit.estimator.certificate_map import STEP, certificate_map
from sparsefit.model.columns import APART
from sparsefit.model.continuum import PlaneHeights

VEHICLE = sf.PointMassVehicle(0.5, (5.0, 3.0))
FLOW = sf.flows.ShapedCells(12.0, 4.2, heading=math.radians(25.0))
FLIGHT = sf.simulate_flight(
    FLOW, VEHICLE, duration=8.0, sample_rate=100.0, seed=7, velocity_noise=0.2, position_noise=0.05
)
WAVES = sf.Library(sf.model.LengthScaleGrid(3.0, 8.0), family="waves", every=10)
ESTIMATOR = sf.Estimator(library=WAVES, backend=backends.get("group-lasso", alpha_fraction=0.3))


def heights_by_columns(position, residual, k):
    """|Z(k)'R| / (2 m) at wavevectors (w, 2), one column after the other."""
    phase = k @ position.T  # psi = cos or sin of it, and the velocity (psi_y, -psi_x)
    along = np.stack([k[:, 1], -k[:, 0]], axis=1)
    theta = np.stack([-np.sin(phase), np.cos(phase)], axis=1)[:, :, None] * along[:, None, :, None]
    z = theta / np.sqrt(np.mean(theta**2, axis=(2, 3)))[:, :, None, None]
    return np.linalg.norm(np.einsum("wcdm,md->wc", z, residual), axis=1) / residual.size


def plane_of(position):
    return PlaneHeights(position, (0.5, 1.5), STEP / np.ptp(position, axis=0).max())


def test_heights_are_those_of_the_columns_in_unit_rms():
    rng = np.random.default_rng(0)
    position, residual = rng.uniform(-10.0, 20.0, (60, 2)), rng.normal(size=(60, 2))
    plane = plane_of(position)
    heights = plane.heights(residual.reshape(-1, 1))
    places = rng.integers(0, len(plane.axis), (200, 2))
    places = places[np.hypot(*plane.axis[places].T) > 0.1]
    expected = heights_by_columns(position, residual, plane.axis[places])
    np.testing.assert_allclose(heights[tuple(places.T)], expected, rtol=1e-6)


def test_nothing_is_missed_between_the_wavevectors_of_the_map():
    rng = np.random.default_rng(1)
    position, residual = rng.uniform(-10.0, 10.0, (60, 2)), rng.normal(size=(60, 2))
    angle, size = rng.uniform(0.0, math.pi, 4000), rng.uniform(0.5, 1.5, 4000)
    k = size[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    highest = heights_by_columns(position, residual, k).max()
    assert highest <= plane_of(position).heights(residual.reshape(-1, 1)).max() * 1.02


def test_eta_is_one_at_the_waves_chosen_and_at_most_one_on_the_grid():
    shown = certificate_map(ESTIMATOR, FLIGHT)
    prepared = ESTIMATOR.prepare(FLIGHT)
    fit = ESTIMATOR.fit(prepared)
    residual = (prepared.problem.target - prepared.problem.theta @ fit.weights).reshape(-1, 2)
    position = prepared.samples.position[::10]
    penalty = fit.backend.penalty(prepared.problem)
    top = penalty.block_norms(prepared.problem.statistics.cross).max()
    on_grid = heights_by_columns(position, residual, prepared.problem.parameters) / (0.3 * top)
    used = fit.weights.reshape(-1, 2).any(axis=1)
    np.testing.assert_allclose(on_grid[used], 1.0, atol=1e-6)
    assert on_grid.max() <= 1.0 + 1e-6
    np.testing.assert_array_equal(shown.wavevectors, prepared.problem.parameters[used])
    assert (shown.strengths > 0).all()


def test_between_its_waves_the_map_is_above_one_around_the_true_ones():
    shown = certificate_map(ESTIMATOR, FLIGHT)
    assert shown.highest > 1.05
    top = np.unravel_index(np.nanargmax(shown.eta), shown.eta.shape)
    both = np.concatenate([FLOW.waves.wavevectors, -FLOW.waves.wavevectors])
    off = np.linalg.norm(both - shown.axis[list(top)], axis=1).min()
    assert off < APART * math.pi / FLIGHT.extent  # in the neighbourhood that is one peak
    finer = replace(ESTIMATOR, library=replace(WAVES, waves=sf.model.WaveGrid(0.5)))
    assert certificate_map(finer, FLIGHT).highest < shown.highest
    np.testing.assert_allclose(shown.eta, shown.eta[::-1, ::-1], rtol=1e-6)  # k and -k


def test_of_the_gridless_group_lasso_eta_is_at_most_one_on_the_whole_plane():
    backend = backends.get("gridless-group-lasso", alpha_fraction=0.3)
    shown = certificate_map(replace(ESTIMATOR, backend=backend), FLIGHT)
    assert 0.97 < shown.highest <= 1.0 + 1e-8
    for wave in shown.wavevectors:  # the map is 1 near each, to what its step can show
        near = np.linalg.norm(np.stack(np.meshgrid(shown.axis, shown.axis, indexing="ij"), axis=-1)
                              - wave, axis=-1)  # fmt: skip
        assert np.nanmax(np.where(near < 0.5 / FLIGHT.extent, shown.eta, np.nan)) > 0.97


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"library": sf.Library()}, "needs Library.family='waves'. in groups by wave"),
        ({"library": replace(WAVES, groups="ring")}, "not 'waves' by 'ring'"),
        ({"library": replace(WAVES, unknown=("wind",))}, "a known vehicle"),
        ({"library": replace(WAVES, every=1), "derivative": "weak"}, "not averages of them"),
        ({"backend": "lasso"}, "is that of group-lasso or gridless-group-lasso, not lasso"),
    ],
)
def test_other_fits_have_no_such_certificate(changed, words):
    with pytest.raises(InputError, match=words):
        certificate_map(replace(ESTIMATOR, **changed), FLIGHT)
