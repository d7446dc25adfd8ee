"""Sums over long windows by the Fourier transform, against the sums themselves."""

import numpy as np
import pytest

from sparsefit.derivative.smoothing import LONG, Channels
from sparsefit.derivative.transform import Transformed


@pytest.mark.parametrize(("size", "window"), [(7, 7), (101, 40), (1000, 333)])
def test_windows_are_summed_as_they_stand(size, window):
    rng = np.random.default_rng(size)
    rows, kernels = rng.normal(size=(2, 2, size)), rng.normal(size=(2, window))
    for used in ([0], [1], [0, 1]):
        sums = Transformed.of(rows).windows(kernels, used)
        own = [[np.correlate(r, kernels[c], "valid") for r in rows[c]] for c in used]
        np.testing.assert_allclose(sums, np.sum(own, axis=0), atol=1e-12)


@pytest.mark.parametrize("noise", [0.3, 1e-12])
def test_a_flight_is_smoothed_alike_with_and_without_the_transform(noise, monkeypatch):
    """Above the rounding by the transform, and below it sum by sum."""
    rng, t = np.random.default_rng(4), np.linspace(0, 4, 400)
    path = np.column_stack([np.sin(t), np.cos(2 * t)])
    channels = Channels(path, path + noise * rng.normal(size=path.shape), 0.01, noise, noise)
    kernel = channels.kernels(2 * LONG + 1, coupled=True)[2]
    assert (channels._transformed is None) is (noise < 1e-9)
    smoothed = channels.filtered(kernel)
    monkeypatch.setattr("sparsefit.derivative.smoothing.LONG", 10**6)
    plain = channels.filtered(kernel)
    np.testing.assert_allclose(smoothed, plain, atol=1e-13 if noise > 1e-9 else 0.0)
