"""Scans of the plane: what one wave explains is what a least-squares fit of it explains."""

import math

import numpy as np
import pytest

from sparsefit.errors import InputError
from sparsefit.library.drift_scan import DriftScan
from sparsefit.library.plane_scan import PlaneScan, crossed, peaks
from sparsefit.library.waves import AXIS, WAVE, Waves

RNG = np.random.default_rng(5)
TIME = np.linspace(-6, 6, 300)
POSITION = np.column_stack([9 * np.sin(0.9 * TIME) + TIME, 8 * np.cos(0.7 * TIME), TIME])


def test_gains_are_those_of_least_squares():
    scan = PlaneScan.of(POSITION, (0.3, 2.0))
    rest = RNG.standard_normal((len(POSITION), 2))
    gains = scan.gains(rest)
    moved = (rest - rest.mean(axis=0)).T.ravel()
    winds = np.kron(np.eye(2), np.ones((len(POSITION), 1)))
    for i, j in ((0, 3), (9, 8), (12, 4)):
        k = scan.axis[[i, j]]
        if not 0.3 <= np.hypot(*k) <= 2.0:
            assert gains[i, j] == 0
            continue
        design = np.column_stack([Waves(WAVE).values(POSITION[:, :2], k[None])[0].T, winds])
        left = moved - design @ np.linalg.lstsq(design, moved, rcond=None)[0]
        np.testing.assert_allclose(gains[i, j], moved @ moved - left @ left, rtol=1e-3)


def test_a_scan_beyond_all_memory_is_refused():
    with pytest.raises(InputError, match=r"m across .* the lower one to 14 m or more") as caught:
        PlaneScan.of(1e3 * POSITION, (0.1, math.sqrt(2) * math.pi))
    assert "length scales down to 1 m are sought" in str(caught.value)


def test_squares_are_seen_where_they_are():
    k, heading = 1.1, 0.3
    cos, sin = math.cos(heading), math.sin(heading)
    turn = np.array([[cos, -sin], [sin, cos]])
    columns = Waves(AXIS).values(POSITION[:, :2] @ turn, np.array([[k]]))[0]
    own = (columns.T @ [1.0, 0.3, -0.2, 1.0]).reshape(2, -1)
    flow = (turn @ own).T
    scan = PlaneScan.of(POSITION, (0.3, 3.0))
    seen = scan.axis[peaks(crossed(scan.gains(flow)), 1)[0]]
    waves = (np.array([[k, k], [k, -k]]) @ turn.T) * [1.0, 1.0]
    apart = min(np.abs(sign * wave - seen).max() for wave in waves for sign in (1, -1))
    assert apart < 0.75 * scan.step


def test_a_wave_that_drifts_is_seen_in_pieces():
    wave = np.array([[1.2, -0.5, 1.7]])
    flow = (Waves(WAVE.moving).values(POSITION, wave)[0].T @ [1.0, 0.5]).reshape(2, -1).T
    scan = DriftScan.of(POSITION, (0.3, 2.0), 3.0)
    gains, (axis, omega) = scan.gains(flow)
    i, j, w = np.unravel_index(np.argmax(gains), gains.shape)
    seen = np.array([axis[i], axis[j], omega[w]])
    apart = [np.abs((sign * wave[0] - seen) / scan.steps).max() for sign in (1, -1)]
    assert min(apart) < 1.0
