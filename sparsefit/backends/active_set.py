"""Incremental inverse of the active block of a Gram matrix: columns enter and leave one at a time.

Everything an active column owns is stored times its sign, so an active correlation is +alpha and
an active weight is positive.  With H = S G_AA S (S = diag of signs) the set keeps M = H^-1 by
bordering (enter) and by elimination (leave): M +- x x'/pivot.  The product G x, which the path
needs anyway, shows how far x is from exact on the active rows, so one step of iterative
refinement costs little and happens only where digits are missing; M is rebuilt when they are many.

Source: Golub and Van Loan, Matrix Computations, 4th ed., 2013, sections 2.1.4 and 3.5.3.
"""

from dataclasses import dataclass, field

import numpy as np

from sparsefit.arrays import Array, IntArray

REFINE_ABOVE = 1e-11  # error of a direction on the active rows that is worth one refinement
STALE_ABOVE = 1e-8  # error at which M is rebuilt, but not more often than every STALE_AGE updates:
STALE_AGE = 10  # on a nearly singular block a rebuild gains little
WRONG_ABOVE = 1e-3  # error at which M is rebuilt at once
DEPENDENT_BELOW = 1e-13  # pivot, per unit of x'x: what rounding in G alone can produce


class SingularBlockError(ArithmeticError):
    """The active block is singular to working precision; start again from fewer columns."""


@dataclass(frozen=True, eq=False)
class Direction:
    """x (n,) in signed active weights, its product G x (k,), and the pivot of the update."""

    step: Array
    product: Array
    pivot: float

    def dependent(self, below: float = DEPENDENT_BELOW) -> bool:
        """Whether the entering column lies in the span of the active ones: pivot <= below x'x."""
        return self.pivot <= below * float(self.step @ self.step)


@dataclass(frozen=True, eq=False)
class ActiveSet:
    """Active columns of a (k, k) Gram matrix whose largest diagonal entry is about one."""

    gram: Array
    rows: Array = field(repr=False)  # (k, k), the first n in use: sign * gram[column]
    inverse: Array = field(repr=False)  # (k, k), leading n x n block in use: M
    index: IntArray = field(repr=False)  # (k,) columns, in no particular order
    sign: Array = field(repr=False)  # (k,)
    tally: list[int] = field(repr=False)  # [n, updates since the last rebuild]

    @classmethod
    def empty(cls, gram: Array) -> "ActiveSet":
        """No active column yet, room for all."""
        k = len(gram)
        square = np.empty((2, k, k))
        return cls(gram, square[0], square[1], np.empty(k, np.intp), np.empty(k), [0, 0])

    @property
    def size(self) -> int:
        """Number n of active columns."""
        return self.tally[0]

    @property
    def columns(self) -> IntArray:
        """Active columns (n,), in no particular order."""
        return self.index[: self.tally[0]]

    @property
    def signs(self) -> Array:
        """Their signs (n,), +1 or -1."""
        return self.sign[: self.tally[0]]

    def product(self, step: Array) -> Array:
        """G x (k,) of signed active weights x (n,)."""
        product: Array = np.dot(step, self.rows[: self.tally[0]])
        return product

    def gather(self, full: Array) -> Array:
        """Signed active entries (n,) of a vector (k,)."""
        n = self.tally[0]
        return full[self.index[:n]] * self.sign[:n]

    def solve(self, right: Array) -> Array:
        """M right (n,): a correction, as exact as M is."""
        n = self.tally[0]
        solution: Array = np.dot(self.inverse[:n, :n], right)
        return solution

    def entering(self, column: int, sign: float) -> Direction:
        """One unit of a new column, the others reacting so that their correlations stay.

        Raises SingularBlockError if M no longer describes the active block.
        """
        n = self.tally[0]
        if n == len(self.gram):
            raise SingularBlockError
        np.multiply(self.gram[column], sign, out=self.rows[n])
        step = np.empty(n + 1)
        step[n] = 1.0
        block = self.inverse[:n, :n]
        step[:n] = np.dot(block, self.rows[:n, column] * -sign)
        product = np.dot(step, self.rows[: n + 1])
        if n:
            error = self.gather(product)
            worst = np.abs(error).max()
            if not worst < STALE_ABOVE and self.rebuilt(worst):
                return self.entering(column, sign)
            if worst > REFINE_ABOVE:
                correction = np.dot(block, error)
                step[:n] -= correction
                product -= np.dot(correction, self.rows[:n])
        pivot = sign * float(product[column])
        if not pivot <= 2.0 * self.gram[column, column] + DEPENDENT_BELOW:
            raise SingularBlockError
        return Direction(step, product, pivot)

    def enter(self, column: int, sign: float, direction: Direction) -> None:
        """Border M by the entering direction: M += x x'/pivot."""
        n = self.tally[0]
        x = direction.step
        self.inverse[n, : n + 1] = 0.0
        self.inverse[:n, n] = 0.0
        self.inverse[: n + 1, : n + 1] += x[:, None] * (x / direction.pivot)
        self.index[n] = column
        self.sign[n] = sign
        self.tally[:] = n + 1, self.tally[1] + 1

    def leaving(self, position: int) -> Direction:
        """Change of one active correlation by one, the others held: a column of M.

        Raises SingularBlockError if M no longer describes the active block.
        """
        n = self.tally[0]
        step = self.inverse[:n, position].copy()
        product = np.dot(step, self.rows[:n])
        error = self.gather(product)
        error[position] -= 1.0
        worst = np.abs(error).max() / abs(step[position])
        if not worst < STALE_ABOVE and self.rebuilt(worst):
            return self.leaving(position)
        if worst > REFINE_ABOVE:
            correction = self.solve(error)
            step -= correction
            product -= np.dot(correction, self.rows[:n])
        pivot = float(step[position])
        if not pivot > 0.1:
            raise SingularBlockError
        return Direction(step, product, pivot)

    def leave(self, position: int, direction: Direction) -> None:
        """Eliminate one active column, M -= x x'/pivot; the last one takes its place."""
        last = self.tally[0] - 1
        block = self.inverse[: last + 1, : last + 1]
        block -= direction.step[:, None] * (direction.step / direction.pivot)
        self.rows[position] = self.rows[last]
        self.index[position] = self.index[last]
        self.sign[position] = self.sign[last]
        block[position] = block[last]
        block[:, position] = block[:, last]
        self.tally[:] = last, self.tally[1] + 1

    def rebuilt(self, error: float = np.inf) -> bool:
        """Replace M by a fresh inverse, unless at this error it is too early to gain anything.

        Raises SingularBlockError if the active block is singular.
        """
        n = self.tally[0]
        if self.tally[1] < (STALE_AGE if error < WRONG_ABOVE else 1):
            return False
        block = self.rows[:n, self.index[:n]] * self.sign[:n]
        try:
            self.inverse[:n, :n] = np.linalg.inv(block)
        except np.linalg.LinAlgError as singular:
            raise SingularBlockError from singular
        self.tally[1] = 0
        return True
