"""Z'Z, Z'Y and |Y|^2 of a window that moves, block by block and a slice of a block at a time.

    G <- lambda G + B'B - O'O,    B the rows that enter, O those that leave, lambda the decay.

The products of one block are spread over as many slices of G as there are samples until the next,
so that no sample pays for a block.

Rounding. What is added and taken away again leaves its rounding behind. A second sum, F, is begun
anew with some block and only ever added to; once the window has left the blocks before that one, F
is the sum of the window: it takes the place of G, and another F is begun. So G never holds the
rounding of more than two windows of blocks that entered and one that left, u in a window of m rows,
however long the flight. Where |Z| <= 1 a product errs by BLOCK^2 eps and a sum by m eps, at most:

    |dG_ij| <= 3 (u + 2) (m + BLOCK^2) eps.
"""

from __future__ import annotations

import numpy as np

from sparsefit.arrays import Array

BLOCK = 32  # rows: fewer make slow products, more a long tail at every estimate
SLICES = 28  # of the products of a block: the samples of a block but for a few
MOST_OUT = 2  # blocks that leave as one enters: a slower stream catches up


class Sums:
    """The sums of a window of blocks of rows theta (BLOCK, k) and target (BLOCK, n).

    Args:
        columns: k.
        targets: n.
    """

    def __init__(self, columns: int, targets: int) -> None:
        self.gram, self._fresh = np.zeros((2, columns, columns))
        self.cross, self._fresh_cross = np.zeros((2, columns, targets))
        self.square, self._fresh_square = np.zeros((2, targets))
        self.low = self.high = self._fresh_low = 0  # blocks: in G those of [low, high)
        self._edges = np.linspace(0, columns, SLICES + 1).astype(int).tolist()
        self._entering = self._leaving = np.zeros((0, columns))
        self._decay, self._next = 1.0, SLICES

    @property
    def nbytes(self) -> int:
        """Bytes of memory."""
        both = (self.gram, self._fresh, self.cross, self._fresh_cross)
        return sum(array.nbytes for array in both)

    def outgoing(self, first: int) -> range:
        """The numbers of the blocks to take away next, of those before block ``first``."""
        most = self.low + MOST_OUT
        if self.low < self._fresh_low:  # F is never taken from
            most = min(most, self._fresh_low)
        return range(self.low, max(self.low, min(first, most, self.high)))

    def enter(
        self,
        entering: tuple[Array, Array],
        leaving: list[tuple[Array, Array]],
        decay: float = 1.0,
    ) -> None:
        """Begin to add a block (theta, target), and to take away those that `outgoing` named.

        The products themselves are for `advance`.
        """
        self.finish()
        if self._fresh_low == self.low:  # the window begins where F does
            self._swap()
        theta, target = entering
        cross, square = theta.T @ target, np.sum(target * target, axis=0)
        for values, change in (
            (self.cross, cross),
            (self._fresh_cross, cross),
            (self.square, square),
            (self._fresh_square, square),
        ):
            values *= decay
            values += change
        for old, old_target in leaving:
            self.cross -= old.T @ old_target
            self.square -= np.sum(old_target * old_target, axis=0)
        self._entering, self._decay, self._next = theta, decay, 0
        self._leaving = np.concatenate([old for old, _ in leaving]) if leaving else theta[:0]
        self.low, self.high = self.low + len(leaving), self.high + 1

    def _swap(self) -> None:
        """F takes the place of G, and begins anew with the block that enters."""
        self.gram, self._fresh = self._fresh, self.gram
        self.cross, self._fresh_cross = self._fresh_cross, self.cross
        self.square, self._fresh_square = self._fresh_square, self.square
        for values in (self._fresh, self._fresh_cross, self._fresh_square):
            values[...] = 0.0
        self._fresh_low = self.high

    def advance(self) -> bool:
        """Take the products of one slice of G; whether a block was not yet done."""
        if self._next >= SLICES:
            return False
        rows = slice(self._edges[self._next], self._edges[self._next + 1])
        self._next += 1
        if rows.start == rows.stop:  # fewer columns than slices
            return True
        added = self._entering[:, rows].T @ self._entering
        for values in (self.gram, self._fresh):
            if self._decay != 1.0:
                values[rows] *= self._decay
            values[rows] += added
        if len(self._leaving):
            self.gram[rows] -= self._leaving[:, rows].T @ self._leaving
        return True

    def finish(self) -> None:
        """Take all products that are left of the block that entered last."""
        while self.advance():
            pass

    def total(
        self, more: tuple[Array, Array], less: tuple[Array, Array], decay: float = 1.0
    ) -> tuple[Array, Array, Array]:
        """Z'Z (k, k), Z'Y (k, n) and |Y|^2 (n,), with some rows (theta, target) more and some less.

        decay: of what was summed before.
        """
        self.finish()
        theta = np.concatenate([more[0], less[0]])
        signed = np.concatenate([more[0], -less[0]])
        target = np.concatenate([more[1], less[1]])
        gram = theta.T @ signed
        gram += self.gram if decay == 1.0 else decay * self.gram
        square = decay * self.square + np.sum(more[1] ** 2, axis=0) - np.sum(less[1] ** 2, axis=0)
        return gram, decay * self.cross + signed.T @ target, square
