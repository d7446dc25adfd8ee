"""The wave library: its grid, its columns against flows and differences, its problem."""

import math

import numpy as np
import pytest
from sklearn.linear_model import Lasso

import sparsefit as sf
from sparsefit import backends
from sparsefit.derivative import Derivative
from sparsefit.errors import InputError
from sparsefit.library.builder import Library
from sparsefit.library.columns import stream_columns, wave_columns
from sparsefit.library.grid import LengthScaleGrid
from sparsefit.library.wave_grid import WaveGrid
from sparsefit.regression.penalties import alpha_max
from tests.problems import VEHICLE, flight

GRID = LengthScaleGrid(3.0, 8.0)
WAVES = Library(GRID, family="waves", every=10)
POSITION = np.random.default_rng(5).uniform(-20.0, 20.0, (40, 2))


@pytest.fixture(scope="module")
def samples():
    return Derivative()(flight(velocity_noise=0.1))


@pytest.fixture(scope="module")
def problem(samples):
    return WAVES.build(samples, VEHICLE)


@pytest.mark.parametrize("step", [0.4, 1.0])
def test_rings_leave_no_wave_of_the_annulus_farther_than_the_step_allows(step):
    rings = WaveGrid(step=step).rings(3.0, 8.0, 20.0)
    apart = step * math.pi / 20.0
    rng = np.random.default_rng(1)
    size = math.sqrt(2.0) * math.pi / rng.uniform(3.0, 8.0, 300)
    angle = rng.uniform(0.0, math.pi, 300)
    anywhere = size[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    both = np.concatenate([rings.wavevectors, -rings.wavevectors])  # k and -k are one wave
    nearest = np.linalg.norm(anywhere[:, None] - both, axis=2).min(axis=1)
    assert nearest.max() <= apart / math.sqrt(2.0) * 1.001
    assert nearest.max() >= 0.5 * apart  # and it is no finer than asked


def test_rings_are_length_scales_of_square_cells_over_half_the_plane():
    rings = WaveGrid().rings(3.0, 8.0, 20.0)
    sizes = np.linalg.norm(rings.wavevectors, axis=1)
    assert math.sqrt(2.0) * math.pi / sizes == pytest.approx(rings.scales[rings.ring])
    assert rings.scales[[0, -1]] == pytest.approx([3.0, 8.0])
    assert (np.diff(rings.scales) > 0).all()
    angles = np.arctan2(*rings.wavevectors.T[::-1])
    assert ((angles >= 0) & (angles < math.pi)).all()


def test_one_length_scale_is_one_ring():
    rings = WaveGrid().rings(5.0, 5.0, 20.0)
    assert rings.scales == pytest.approx([5.0])


def test_the_columns_are_those_of_their_stream_functions():
    """u = d psi/dy and v = -d psi/dx, by central differences of psi."""
    columns = wave_columns(WaveGrid().rings(4.0, 8.0, 10.0), "wave")
    theta = columns.at(POSITION).reshape(len(POSITION), 2, -1, 2)
    step = 1e-5

    def psi(x, y):
        phase = np.stack([x, y], axis=1) @ columns.parameters.T
        return np.stack([np.cos(phase), np.sin(phase)], axis=2)

    x, y = POSITION.T
    u = (psi(x, y + step) - psi(x, y - step)) / (2 * step)
    v = -(psi(x + step, y) - psi(x - step, y)) / (2 * step)
    np.testing.assert_allclose(theta[:, 0], u, atol=1e-9)
    np.testing.assert_allclose(theta[:, 1], v, atol=1e-9)


def test_a_cellular_flow_is_two_waves_and_one_scale_of_stream_functions():
    flow = sf.CellularFlow(7.0, 4.2)
    target = flow.velocity(*POSITION.T).reshape(-1, 1)
    stream = stream_columns(np.array([4.2])).at(POSITION)
    left = target - stream @ np.linalg.lstsq(stream, target, rcond=None)[0]
    assert np.abs(left).max() < 1e-12
    # psi = (U0 L/pi) sin(pi x/L) sin(pi y/L) = (U0 L/2 pi) (cos k(x - y) - cos k(x + y))
    weights = 7.0 * 4.2 / (2 * math.pi) * np.array([[-1.0], [0.0], [1.0], [0.0]])
    np.testing.assert_allclose(stream @ weights, target, atol=1e-12)


def test_rows_are_x_and_y_of_one_sample_after_the_other(samples, problem):
    thin = slice(None, None, 10)
    phi = samples.flow_velocity(VEHICLE)[thin]
    np.testing.assert_array_equal(problem.target[:, 0], phi.ravel())
    assert problem.theta.shape == (2 * len(phi), 2 * len(problem.group_scales))
    assert problem.target_names == ("w_x w_y",)


@pytest.mark.parametrize("groups", ["wave", "ring", "nested"])
def test_groups_are_waves_rings_or_both(samples, problem, groups):
    built = Library(GRID, family="waves", every=10, groups=groups).build(samples, VEHICLE)
    waves = np.arange(problem.columns) // 2
    sizes = math.sqrt(2.0) * math.pi / built.group_scales
    k = WAVES.columns(samples.position).parameters
    assert sizes[built.groups] == pytest.approx(np.linalg.norm(k, axis=1)[waves])
    if groups == "wave":
        np.testing.assert_array_equal(built.groups, waves)
    else:
        assert built.groups.max() + 1 == len(np.unique(built.group_scales))
    assert (built.subgroups is None) == (groups != "nested")
    if built.subgroups is not None:
        np.testing.assert_array_equal(built.subgroups, waves)


def test_the_lasso_on_waves_is_that_of_scikit_learn(problem):
    fit = sf.fit(problem, backends.get("lasso", alpha_fraction=0.2))
    assert fit.status == "ok"
    ours = fit.weights * problem.statistics.rms[:, None]
    z = problem.theta / problem.statistics.rms
    alpha = 0.2 * float(np.abs(z.T @ problem.target).max()) / len(z)
    peer = Lasso(alpha=alpha, fit_intercept=False, tol=1e-12, max_iter=1_000_000)
    theirs = peer.fit(z, problem.target[:, 0]).coef_
    np.testing.assert_allclose(ours[:, 0], theirs, atol=1e-5 * np.abs(theirs).max())


@pytest.mark.parametrize("groups", ["wave", "ring"])
def test_the_group_lasso_on_waves_is_that_of_a_conic_solver(samples, groups):
    library = Library(LengthScaleGrid(5.0, 9.0), family="waves", every=20, groups=groups)
    problem = library.build(samples, VEHICLE)
    fits = [
        sf.fit(problem, backends.get("group-lasso", alpha_fraction=0.3, solver=solver))
        for solver in ("variational", "clarabel-direct")
    ]
    assert all(fit.status == "ok" for fit in fits)
    field, other = (problem.theta @ fit.weights for fit in fits)
    np.testing.assert_allclose(field, other, atol=1e-4 * np.abs(field).max())
    top = alpha_max(problem.statistics.cross, backends.get("group-lasso").penalty(problem))
    block = problem.groups == np.argmax(
        [np.linalg.norm(problem.statistics.cross[problem.groups == g])
         for g in range(len(problem.group_scales))]
    )  # fmt: skip
    z = problem.theta[:, block] / problem.statistics.rms[block]
    assert top == pytest.approx(float(np.linalg.norm(z.T @ problem.target)) / len(z))


def test_a_penalty_is_chosen_on_pieces_of_the_flight(samples):
    library = Library(LengthScaleGrid(4.0, 5.0), family="waves", every=10)
    problem = library.build(samples, VEHICLE)
    fit = sf.fit(problem, backends.get("group-lasso", alpha_fraction="auto"))
    assert fit.status == "ok"
    assert 1e-3 < fit.backend.alpha_fraction < 1.0


@pytest.mark.parametrize("family", ["stream", "waves"])
def test_the_weak_form_and_unknowns_join_as_for_cells(family):
    """Noise-free rows of a flight whose vehicle is unknown: the truth explains them."""
    flown = flight(length_scale=4.0)
    believed = sf.PointMassVehicle(0.55, VEHICLE.thrust_acceleration)
    library = Library(
        LengthScaleGrid(4.0, 4.0 if family == "waves" else 6.0),
        family=family,
        unknown=("response_time", "wind"),
    )
    for method in ("auto", "weak"):
        problem = library.build(Derivative(method)(flown), believed)
        fit = sf.fit(problem, backends.get("least-squares", rcond=1e-6))
        left = problem.target - problem.theta @ fit.weights
        assert np.sum(left**2) < (1e-4 if family == "stream" else 0.05) * np.sum(problem.target**2)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"family": "wave"}, 'unknown family of the library "wave": did you mean "waves"'),
        ({"family": "waves", "groups": "rings"}, 'did you mean "ring"'),
        ({"groups": "ring"}, "'groups' is a setting of family 'waves', not of 'cells'"),
        ({"waves": WaveGrid(0.5)}, "'waves' is a setting of family 'waves'"),
        ({"family": "stream", "target": "acceleration"}, "needs family 'cells'"),
        ({"every": 0}, "every must be an integer, at least 1"),
    ],
)
def test_settings_that_cannot_be_are_refused(settings, words):
    with pytest.raises(InputError, match=words):
        Library(**settings)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"step": 0.0}, "waves: step, a share of pi/extent, must be a finite number above 0"),
        ({"most": 1}, "waves: most must be an integer, at least 2"),
        ({"most": 5000}, "most must be 4096 or less"),
    ],
)
def test_a_wave_grid_says_what_it_cannot_be(settings, words):
    with pytest.raises(InputError, match=words):
        WaveGrid(**settings)


def test_a_grid_too_large_says_how_many_waves_and_what_to_narrow():
    with pytest.raises(InputError, match=r"resolves 2.* waves down to 1 m, more than the 2048 of"):
        WaveGrid().rings(1.0, 12.0, 30.0)
    with pytest.raises(InputError, match="raise the grid's lower bound to about"):
        WaveGrid().rings(1e-9, 12.0, 1e9)
    with pytest.raises(InputError, match="does not move"):
        WaveGrid().rings(1.0, 12.0, 0.0)


def test_the_bound_that_is_proposed_can_be_held():
    with pytest.raises(InputError) as refused:
        WaveGrid().rings(1.0, 12.0, 60.0)
    lower = float(str(refused.value).split("about ")[1].split(" m")[0])
    assert len(WaveGrid().rings(1.05 * lower, 12.0, 60.0).ring) <= 2048


def test_the_weak_form_is_not_thinned():
    library = Library(GRID, family="waves", every=2)
    with pytest.raises(InputError, match="'every' thins samples, but the weak form"):
        library.build(Derivative("weak")(flight()), VEHICLE)


def test_it_is_written_and_read_back():
    estimator = sf.Estimator(
        library=Library(GRID, family="waves", groups="ring", waves=WaveGrid(0.5, 1000), every=4)
    )
    assert sf.Estimator.from_json(estimator.to_json()) == estimator
