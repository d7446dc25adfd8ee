"""The active columns of a LASSO path: an inverse that columns enter and leave one at a time.

What an active column owns is stored times its sign, so an active correlation is +alpha and an
active weight is positive.  With H = S G_AA S (S = diag of signs) the set keeps M = H^-1 by
bordering (enter) and by elimination (leave): M +- x x'/pivot.  The product G x, which the path
needs anyway, shows how far x is from exact on the active rows, so one step of iterative
refinement costs little and happens only where digits are missing; M is rebuilt when they are many.

One source for two loops: this file runs as it stands, on numpy's arrays, and is compiled with the
types of compiled/active_set.pxd.  What is done to whole arrays is a function of `dense`.

Source: Golub and Van Loan, Matrix Computations, 4th ed., 2013, sections 2.1.4 and 3.5.3.
"""

import numpy as np

from sparsefit.arrays import Array, IntArray
from sparsefit.backends import dense

REFINE_ABOVE = 1e-11  # error of a direction on the active rows that is worth one refinement
STALE_ABOVE = 1e-8  # error at which M is rebuilt, but not more often than every STALE_AGE updates:
STALE_AGE = 10  # on a nearly singular block a rebuild gains little
WRONG_ABOVE = 1e-3  # error at which M is rebuilt at once
DEPENDENT_BELOW = 1e-13  # pivot, per unit of x'x: what rounding in G alone can produce
TINY = 1e-300  # what divisors and pivots are at least
ROOM = 64  # active columns that there is room for at first

FINE = 0
DEPENDENT = 1  # the column lies in the span of the active ones
SINGULAR = 2  # M no longer describes the active block: start again from fewer columns
NO_MEMORY = 3
EARLY = 4  # a rebuilt inverse would gain nothing yet


class ActiveSet:
    """Active columns of G = `gram` (k, k), whose largest diagonal entry is about one: none yet.

    `index` and `sign` (k + 1,): the `n` active columns, in no particular order, and their signs;
    `inverse` (room, room): M in the leading n x n block, `age` updates after it was rebuilt.
    `step` x (k + 1,) and `product` G x (k,) are the last direction, `pivot` that of its update;
    a pivot counts as that of a dependent column below `below` x'x.  The others are scratch.
    """

    gram: Array
    inverse: Array
    index: IntArray
    sign: Array
    step: Array
    product: Array
    error: Array
    fix: Array
    spare: Array
    change: Array

    def __init__(self, gram: Array) -> None:
        k, room = len(gram), min(ROOM, len(gram))
        self.k, self.n, self.age = k, 0, 0
        self.below, self.pivot = DEPENDENT_BELOW, 0.0
        self.gram, self.inverse = gram, np.zeros((room, room))
        self.index = np.zeros(k + 1, np.intp)
        self.share_out(np.zeros((7, k + 1)))

    def share_out(self, rows: Array) -> None:
        """Give each vector its memory (k + 1,)."""
        self.sign, self.step, self.product, self.change = rows[0], rows[1], rows[2], rows[3]
        self.error, self.fix, self.spare = rows[4], rows[5], rows[6]

    def product_of(self, x: Array, n: int, out: Array) -> None:
        """G x (k,) of the first `n` signed active weights x."""
        dense.combine(n, self.gram, self.index, self.sign, x, out)

    def solve(self, x: Array, out: Array) -> None:
        """M x (n,): a correction, as exact as M is."""
        dense.apply(self.n, self.inverse, x, out)

    def gather(self, full: Array, out: Array) -> None:
        """Signed active entries (n,) of a vector (k,)."""
        dense.gather(self.n, full, self.index, self.sign, out)

    def grown(self) -> bool:
        """Make room for one more active column; false where memory is out."""
        n, room = self.n, min(2 * len(self.inverse), self.k)
        if n < len(self.inverse):
            return True
        try:
            fresh = np.zeros((room, room))
        except MemoryError:
            return False
        fresh[:n, :n] = self.inverse
        self.inverse = fresh
        return True

    def rebuilt(self, error: float) -> int:
        """Replace M by a fresh inverse, unless it is too EARLY, at this error, to gain anything.

        Gauss-Jordan steps, largest diagonal first: rows and columns that were swept hold -inverse.
        """
        n, m, line, left = self.n, self.inverse, self.fix, self.spare
        if self.age < 1 or (self.age < STALE_AGE and error < WRONG_ABOVE):
            return EARLY
        dense.block(n, self.gram, self.index, self.sign, m)
        dense.fill(n, 1.0, left)
        for _ in range(n):
            p = dense.highest_diagonal(n, m, left)
            pivot = m[p, p]
            if not TINY < pivot < 1.0 / TINY:
                return SINGULAR
            dense.copy(n, m[p], line)
            dense.rank_one(n, -1.0 / pivot, line, m)
            dense.scale(n, 1.0 / pivot, line)
            dense.border(n, p, line, m)
            m[p, p] = -1.0 / pivot
            left[p] = 0.0
        dense.negate(n, m)
        self.age = 0
        return FINE

    def corrected(self, count: int, position: int, scale: float) -> int:
        """G x of the x in `step`, both refined where M is worn; FINE: M is fresh, find x again.

        x has `count` entries and should have a unit active correlation at `position`, if >= 0.
        """
        n = self.n
        self.product_of(self.step, count, self.product)
        self.gather(self.product, self.error)
        if position >= 0:
            self.error[position] -= 1.0
        worst = dense.largest(n, self.error) / scale
        if not worst < STALE_ABOVE:
            outcome = self.rebuilt(worst)
            if outcome != EARLY:
                return outcome
        if worst > REFINE_ABOVE:
            self.solve(self.error, self.fix)
            dense.add(n, -1.0, self.fix, self.step)
            self.product_of(self.fix, n, self.change)
            dense.add(self.k, -1.0, self.change, self.product)
        return EARLY

    def entering(self, column: int, sign: float) -> int:
        """One unit of a new column, the others reacting so that their correlations stay."""
        n, diagonal = self.n, self.gram[column, column]
        if n == self.k:
            return SINGULAR
        self.index[n], self.sign[n] = column, sign
        outcome = FINE
        while outcome == FINE:
            self.gather(self.gram[column], self.error)
            self.solve(self.error, self.step)
            dense.scale(n, -sign, self.step)
            self.step[n] = 1.0
            outcome = self.corrected(n + 1, -1, 1.0)
        self.pivot = sign * self.product[column]
        if outcome == SINGULAR or not self.pivot <= 2.0 * diagonal + DEPENDENT_BELOW:
            return SINGULAR
        return DEPENDENT if self.pivot <= self.below * dense.square(n + 1, self.step) else FINE

    def enter(self) -> int:
        """Border M by the direction of the column that enters."""
        n = self.n
        if n == len(self.inverse) and not self.grown():
            return NO_MEMORY
        dense.fill(n + 1, 0.0, self.spare)
        dense.border(n + 1, n, self.spare, self.inverse)
        dense.rank_one(n + 1, 1.0 / self.pivot, self.step, self.inverse)
        self.n += 1
        self.age += 1
        return FINE

    def leaving(self, position: int) -> int:
        """Change of one active correlation by one, the others held: a column of M."""
        n, outcome = self.n, FINE
        while outcome == FINE:
            dense.copy(n, self.inverse[position], self.step)
            outcome = self.corrected(n, position, abs(self.step[position]))
        self.pivot = self.step[position]
        return SINGULAR if outcome == SINGULAR or not self.pivot > 0.1 else FINE

    def leave(self, position: int) -> None:
        """Eliminate the column of the direction from M; the last one takes its place."""
        n, last, m = self.n, self.n - 1, self.inverse
        dense.rank_one(n, -1.0 / self.pivot, self.step, m)
        self.index[position], self.sign[position] = self.index[last], self.sign[last]
        dense.copy(n, m[last], self.spare)
        self.spare[position] = self.spare[last]
        dense.border(n, position, self.spare, m)
        self.n = last
        self.age += 1
