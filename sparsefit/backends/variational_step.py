"""The bound-constrained quadratic subproblem of a projected Newton step, by an active set.

One source for two loops, as in `homotopy_walk`.

Source: Nocedal and Wright, "Numerical Optimization" (2006), section 16.5.
"""

import numpy as np

from sparsefit.arrays import Array, IntArray
from sparsefit.backends import dense, dense_groups, linear

RIDGE = 1e-13  # on the unit diagonal: duplicated groups make H singular
ROUNDING = 1e-13  # of the largest pull: what a bound that is left must exceed
FIRST_RIDGE = 1e-12  # of a face that is singular, tenfold at each of the
RIDGES = 13  # trials
TURNS = 10  # per variable, and as many more: what is more is taken for cycling


class Bounded:
    """Minimise x'Hx/2 - drive'x over x >= lower (lower <= 0), for up to `size` variables.

    `step` (size,) is the solution. On the way the variables have a unit diagonal: `unit` is that
    H, `pull` the drive and `floor` the bound; `free` is 1 where a variable is not held at it.
    """

    drive: Array
    lower: Array
    step: Array
    scale: Array
    pull: Array
    floor: Array
    free: Array
    fixed: Array
    x: Array
    target: Array
    right: Array
    ones: Array
    unit: Array
    block: Array
    inside: IntArray

    def __init__(self, size: int) -> None:
        self.unit, self.block = np.zeros((size, size)), np.zeros((size, size))
        self.inside = np.zeros(size, np.intp)
        self.share_out(np.zeros((12, size)))
        dense.fill(size, 1.0, self.ones)

    def share_out(self, rows: Array) -> None:
        """Give each vector its memory (size,)."""
        self.drive, self.lower, self.step, self.scale = rows[0], rows[1], rows[2], rows[3]
        self.pull, self.floor, self.free, self.fixed = rows[4], rows[5], rows[6], rows[7]
        self.x, self.target, self.ones = rows[8], rows[9], rows[11]
        self.right = rows[10:11]

    def minimise(self, n: int, hessian: Array) -> None:
        """Fill `step` (n,) for H (n, n), `drive` and `lower`."""
        if n == 0:
            return
        dense_groups.unit_scale(n, hessian, self.scale)
        dense.multiply(n, self.scale, self.drive, self.pull)
        dense.divide(n, self.scale, self.lower, self.floor)
        dense_groups.scaled(n, self.scale, hessian, self.block)
        dense.lift(n, RIDGE, self.block)
        settled = linear.factorised(n, self.block)
        if settled:
            dense.copy(n, self.pull, self.right[0])
            linear.solve(n, 1, self.block, self.right)
            dense.copy(n, self.right[0], self.x)
            settled = dense_groups.all_above(n, self.floor, self.x)
        else:
            dense.copy(n, self.pull, self.x)
        if not settled:
            dense_groups.start_free(n, self.floor, self.x, self.free)
            dense_groups.scaled(n, self.scale, hessian, self.unit)
            dense.lift(n, RIDGE, self.unit)
            self.search(n)
        dense.multiply(n, self.scale, self.x, self.step)

    def search(self, n: int) -> None:
        """Primal active set: move towards each face's minimiser, stop at the first bound met."""
        slack, pull = ROUNDING * dense.largest(n, self.pull), self.right[0]
        dense.fill(n, 0.0, self.x)
        for _ in range(TURNS * n + TURNS):
            dense.copy(n, self.x, self.target)
            self.face(n)
            hit = dense_groups.first_bound(n, self.free, self.floor, self.x, self.target)
            if hit >= 0:
                reach = (self.floor[hit] - self.x[hit]) / (self.target[hit] - self.x[hit])
                dense_groups.advance(n, reach, self.target, self.floor, self.free, self.x)
                continue
            dense.copy(n, self.target, self.x)
            dense.apply(n, self.unit, self.x, pull)
            dense.subtract(n, self.pull, pull)
            dense_groups.opposite(n, self.free, self.fixed)
            dense.multiply(n, self.fixed, pull, pull)
            worst = dense.highest(n, pull)
            if not pull[worst] > slack:
                break
            self.free[worst] = 1.0

    def face(self, n: int) -> None:
        """Minimiser over the free variables, the others fixed; a larger ridge where singular."""
        count, right = dense_groups.chosen(n, self.free, self.inside), self.right[0]
        dense_groups.opposite(n, self.free, self.fixed)
        dense.multiply(n, self.x, self.fixed, self.fixed)
        dense.apply(n, self.unit, self.fixed, right)
        dense.subtract(n, self.pull, right)
        dense.take(count, right, self.inside, right)
        ridge, added = FIRST_RIDGE, 0.0
        for _ in range(RIDGES + 1):
            dense.upper_block(count, self.unit, self.inside, self.ones, self.block)
            dense.lift(count, added, self.block)
            if linear.factorised(count, self.block):
                linear.solve(count, 1, self.block, self.right)
                break
            added += ridge
            ridge *= 10.0
        dense.put(count, right, self.inside, self.target)
