"""Optima on faces of penalties are those of Newton's method, wherever they are found."""

import numpy as np
import pytest

from sparsefit.regression.group_penalties import GroupNorms
from sparsefit.regression.ordered_penalties import FusedNorm, SortedNorm
from sparsefit.regression.penalties import AbsoluteValues, BoundedValues
from sparsefit.solvers.newton import Normal, on_a_face, settled

K = 25
PENALTIES = {
    "lasso": AbsoluteValues(np.linspace(0.5, 2.0, K)),
    "elastic net": AbsoluteValues(np.ones(K), ridge=0.3),
    "bounds": BoundedValues(np.ones(K), np.full(K, -0.1), np.full(K, np.inf), ridge=0.1),
    "SLOPE": SortedNorm(np.linspace(2.0, 0.5, K)),
    "fused": FusedNorm(K, 0.5),
}


def normal_of(seed, by_rows=False, targets=2):
    rng = np.random.default_rng(seed)
    theta = np.cumsum(rng.normal(size=(60, K)), axis=1) if seed % 2 else rng.normal(size=(60, K))
    theta /= np.sqrt(np.mean(theta**2, axis=0))
    target = theta[:, :4] @ rng.normal(size=(4, targets)) + 0.3 * rng.normal(size=(60, targets))
    target /= np.sqrt(np.square(target).sum() / 60)
    gram = None if by_rows else theta.T @ theta / 60
    return Normal(gram, np.asfortranarray(theta), 60), theta.T @ target / 60


@pytest.mark.parametrize("kind", PENALTIES)
@pytest.mark.parametrize("by_rows", [False, True])
def test_every_optimum_that_is_found_is_one(kind, by_rows):
    penalty, solved, asked = PENALTIES[kind], 0, 0
    for seed in range(1 + (kind not in ("SLOPE", "fused"))):
        normal, cross = normal_of(seed, by_rows)
        alpha = float(penalty.dual_norm(cross).max())
        start = np.zeros(cross.shape)
        for share in (0.8, 0.3, 0.1, 0.03):
            reference, _, _ = settled(normal, cross, penalty, share * alpha, start, 1e-13)
            found = on_a_face(normal, cross, penalty, share * alpha, start, 1e-12)
            asked += 1
            if found[1] <= 1e-12:
                solved += 1
                assert found[0] == pytest.approx(reference, abs=1e-4)
            start = reference
    assert 3 * solved > asked  # the others are left to Newton, which follows


def test_a_curved_penalty_has_no_faces():
    normal, cross = normal_of(0)
    penalty = GroupNorms(np.arange(K) // 5, np.ones(5))
    start = np.zeros(cross.shape)
    assert on_a_face(normal, cross, penalty, 0.1, start, 1e-10)[1:] == (np.inf, 0)
