"""The ladder of shapes: the shape that was flown is the one that is found, and no freer one."""

import math
from dataclasses import replace

import numpy as np
import pytest

from sparsefit.library.waves import AXIS, PAIR, RECTANGLE, SQUARE, Waves
from sparsefit.modes.ladder import climbed
from sparsefit.modes.rung import as_pattern
from sparsefit.modes.search import locate_one
from sparsefit.modes.space import SearchSpace

BOUNDS = math.pi / 6, math.pi / 2.5
TIME = np.linspace(0, 12, 300)
TRACK = np.column_stack(
    [14 * np.sin(0.61 * TIME) + 1.7 * TIME, 11 * np.cos(0.83 * TIME) - 0.9 * TIME]
)


def flown(pattern, q, weights=(1.0, 0.4, -0.4, 1.0), noise=0.05, memory=0.0):
    """The ladder of a track through waves of such parameters; memory of the noise, per sample."""
    position = np.column_stack([TRACK, TIME - TIME.mean()])
    columns = Waves(pattern).values(position, np.array([q]))[0]
    flow = (columns.T @ np.array(weights)).reshape(2, -1).T
    errors = np.random.default_rng(11).standard_normal(flow.shape)
    for row in range(1, len(errors)):
        errors[row] += memory * errors[row - 1]
    space = SearchSpace.plain(TRACK, flow + noise * errors, BOUNDS)
    return climbed(space, TIME, locate_one(space).fit)


CASES = {
    "axis": (AXIS, (0.9,)),
    "square": (SQUARE, (0.9, 0.4)),
    "rectangle": (RECTANGLE, (0.8, 1.0, -0.3)),
    "drifting": (AXIS.moving, (0.9, 0.8, -0.3)),
}


@pytest.mark.parametrize("name", CASES)
def test_the_shape_that_was_flown_is_found(name):
    pattern, q = CASES[name]
    ladder = flown(pattern, q)
    best = ladder.best
    assert (best.shape, best.drifting) == (pattern.name, pattern.drifting)
    assert ladder.quiet
    assert ladder.evidence > ladder.chance
    assert ladder.steady_cells == (name == "axis")
    reach = math.pi / np.array([*[np.ptp(TRACK, axis=0).max()] * 2, np.ptp(TIME)])
    truth = pattern.phases(np.array([q]))[0]
    for wave in truth:
        apart = [np.abs((sign * best.phases - wave) / reach).max(axis=1) for sign in (1, -1)]
        assert np.min(apart) < 0.03


def test_two_waves_that_make_no_cells_are_a_pair():
    best = flown(PAIR, (1.0, 0.3, -0.2, 0.7), (1.0, 0.4, 0.9, -1.5)).best
    assert (best.shape, best.drifting) == ("pair", False)


def test_turbulence_is_no_reason_for_more_waves():
    ladder = flown(AXIS, (0.9,), noise=0.15, memory=0.97)
    assert not ladder.quiet
    assert ladder.steady_cells
    assert all(rung.shape != "several" for rung in ladder.rungs)


@pytest.mark.parametrize("heading", [0.3, -0.7, 1.2, 2.9, -2.2])
def test_any_two_waves_of_a_rectangle_lead_back_to_it(heading):
    given = np.array([[0.8, 0.5, 0.7, -0.2, heading]])
    phases = RECTANGLE.moving.phases(given)[0]
    for waves in (phases, -phases, phases[::-1], phases * [[1], [-1]]):
        q = as_pattern(RECTANGLE.moving, waves)
        assert -math.pi / 4 < q[-1] <= math.pi / 4
        again = RECTANGLE.moving.phases(q[None])[0]
        same = [np.abs(again - sign * phases[order]).max(axis=1)
                for sign in (1, -1) for order in ([0, 1], [1, 0])]  # fmt: skip
        assert np.min(same, axis=0).max() < 1e-12


def test_what_another_shape_explains_as_well_is_a_rival():
    drifting = flown(AXIS.moving, (0.9, 0.1, 0.1), noise=1.0)
    best, rival = drifting.best, drifting.rival
    assert (best.drifting, rival.drifting) == (True, False)
    assert not rival.alike(best)
    assert rival.bic - best.bic < 10
    assert flown(AXIS, (0.9,), noise=1.0).rival is None


def test_rungs_are_alike_by_what_they_say_of_the_flow():
    best = flown(SQUARE, (0.9, 0.4)).best
    assert best.length_scale == pytest.approx(math.pi / 0.9, rel=1e-3)
    assert best.mean_velocity == pytest.approx(math.sqrt(2 * 2 * (1 + 0.4**2)) * 0.9, rel=0.02)
    louder = replace(best, fit=replace(best.fit, weights=1.05 * best.fit.weights))
    longer = replace(best, fit=replace(best.fit, parameters=best.fit.parameters * [[0.98, 1, 1]]))
    assert best.alike(best)
    assert not best.alike(louder)
    assert not best.alike(longer)
