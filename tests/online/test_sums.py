"""Sums of a window against sums taken anew."""

import math

import numpy as np
import pytest

from sparsefit.online.ring import Ring
from sparsefit.online.sums import BLOCK, SLICES, Sums

COLUMNS, TARGETS = 6, 2
NONE = np.zeros((0, COLUMNS)), np.zeros((0, TARGETS))
EPS = float(np.finfo(float).eps)


def blocks_of(count, seed=0):
    draw = np.random.default_rng(seed)
    return [
        (draw.uniform(-1, 1, (BLOCK, COLUMNS)), draw.standard_normal((BLOCK, TARGETS)))
        for _ in range(count)
    ]


def rolled(blocks, held, decay=1.0):
    """The sums after all blocks have come, of which ``held`` stay; blocks are weighted outside."""
    sums = Sums(COLUMNS, TARGETS)
    for number, block in enumerate(blocks):
        out = sums.outgoing(max(0, number + 1 - held))
        sums.enter(block, [blocks[b] for b in out], decay)
        for _ in range(number % (SLICES + 1)):  # some finish in time, others at the next block
            sums.advance()
    return sums


@pytest.mark.parametrize("held", [1, 2, 7, 40])
def test_a_window_of_blocks_is_the_sum_of_those_blocks(held):
    blocks = blocks_of(30)
    sums = rolled(blocks, held)
    assert (sums.low, sums.high) == (max(0, 30 - held), 30)
    gram, cross, square = sums.total(NONE, NONE)
    theta, target = (np.concatenate(part) for part in zip(*blocks[-held:], strict=True))
    np.testing.assert_allclose(gram, theta.T @ theta, atol=1e-12)
    np.testing.assert_allclose(cross, theta.T @ target, atol=1e-12)
    np.testing.assert_allclose(square, np.sum(target**2, axis=0), rtol=1e-13)


def test_rows_join_and_leave_a_total_without_a_trace():
    blocks = blocks_of(6)
    sums = rolled(blocks, 4)
    more, less = blocks_of(2, seed=1)
    before = sums.total(NONE, NONE)
    theta = np.concatenate([*(block[0] for block in blocks[2:]), more[0]])
    held = theta.T @ theta - less[0].T @ less[0]
    np.testing.assert_allclose(sums.total(more, less)[0], held, atol=1e-12)
    for left, right in zip(before, sums.total(NONE, NONE), strict=True):
        np.testing.assert_array_equal(left, right)


def test_blocks_fade_where_there_is_a_decay():
    blocks, decay = blocks_of(5), 0.5
    gram, cross, square = rolled(blocks, 100, decay).total(NONE, NONE)
    weights = decay ** np.arange(4, -1, -1)
    own = sum(w * t.T @ t for w, (t, _) in zip(weights, blocks, strict=True))
    np.testing.assert_allclose(gram, own, atol=1e-12)
    own = sum(w * t.T @ y for w, (t, y) in zip(weights, blocks, strict=True))
    np.testing.assert_allclose(cross, own, atol=1e-12)
    own = sum(w * np.sum(y**2, axis=0) for w, (_, y) in zip(weights, blocks, strict=True))
    np.testing.assert_allclose(square, own, rtol=1e-13)


def test_rounding_stays_within_the_stated_bound_however_many_blocks_pass():
    held, count, draw = 5, 3200, np.random.default_rng(3)
    blocks = [(draw.uniform(-1, 1, (BLOCK, COLUMNS)), np.ones((BLOCK, TARGETS))) for _ in range(16)]
    sums, rows = Sums(COLUMNS, TARGETS), held * BLOCK
    bound = 3 * (held + 2) * (rows + BLOCK**2) * EPS
    for number in range(count):
        out = sums.outgoing(max(0, number + 1 - held))
        sums.enter(blocks[number % 16], [blocks[b % 16] for b in out])
        if number % 1066 == 1065:
            theta = np.concatenate([blocks[b % 16][0] for b in range(sums.low, sums.high)])
            away = np.abs(sums.total(NONE, NONE)[0] - theta.T @ theta).max()
            assert away < bound
            assert away < 1e-12 * rows


def test_a_ring_gives_pieces_in_one():
    ring, rows = Ring(8, 2), np.arange(80.0).reshape(40, 2)
    for start in range(0, 40, 5):
        ring.put(start, rows[start : start + 5])
        low = max(0, start - 3)
        np.testing.assert_array_equal(ring.rows(low, start + 5), rows[low : start + 5])
    larger = ring.grown(16, 33, 40)
    larger.put(40, rows[:9])
    np.testing.assert_array_equal(larger.rows(33, 49), np.concatenate([rows[33:], rows[:9]]))
    assert larger.nbytes == 2 * ring.nbytes == math.prod((2, 16, 2, 8))
