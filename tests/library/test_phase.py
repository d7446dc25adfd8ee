"""Sines and cosines by the tangent of half the phase, against exact arithmetic."""

import mpmath
import numpy as np

from sparsefit.library.phase import sines_and_cosines

UNIT = 2.0**-53


def test_both_are_exact_to_rounding_wherever_the_phase_is():
    rng = np.random.default_rng(3)
    turns = np.pi * np.arange(-8, 9) / 2  # where the tangent of the half is 0, 1 or beyond bounds
    phase = np.concatenate([turns, *(rng.uniform(-s, s, 100) for s in (1e-9, 1.0, 1e2, 1e6))])
    sine, cosine = sines_and_cosines(phase)
    exact = [(mpmath.sin(x), mpmath.cos(x)) for x in map(mpmath.mpf, phase.tolist())]
    for values, place in ((sine, 0), (cosine, 1)):
        errors = [float(abs(e[place] - v)) for e, v in zip(exact, values.tolist(), strict=True)]
        assert max(errors) < 6 * UNIT
    small = np.abs(phase) < 1e-9
    np.testing.assert_allclose(sine[small], phase[small], rtol=4 * UNIT)
