"""The last rows of a stream, in one piece of memory: every row is written twice."""

from __future__ import annotations

import numpy as np

from sparsefit.arrays import Array


class Ring:
    """The last rows of a stream, counted from 0, of which any that are held are one array.

    Row i stands at i mod C and again C further on, C the capacity, so that no piece of at most C
    rows is ever cut in two.

    Args:
        capacity: the number C of rows that are held.
        width: numbers in a row.
    """

    def __init__(self, capacity: int, width: int) -> None:
        self.capacity = capacity
        self._rows = np.zeros((2 * capacity, width))

    @property
    def nbytes(self) -> int:
        """Bytes of memory."""
        return self._rows.nbytes

    def put(self, start: int, rows: Array) -> None:
        """Write rows (r, width), r <= C, as those from number ``start`` on."""
        low = start % self.capacity
        high, again = low + len(rows), max(low + len(rows) - self.capacity, 0)
        self._rows[low:high] = rows
        before = len(rows) - again
        self._rows[low + self.capacity : low + self.capacity + before] = rows[:before]
        self._rows[:again] = rows[before:]

    def rows(self, start: int, stop: int) -> Array:
        """The rows from ``start`` up to ``stop``, at most C of them, as they lie in memory."""
        low = start % self.capacity
        return self._rows[low : low + stop - start]

    def grown(self, capacity: int, start: int, stop: int) -> Ring:
        """A ring of more capacity with the rows from ``start`` up to ``stop``."""
        larger = Ring(capacity, self._rows.shape[1])
        larger.put(start, self.rows(start, stop))
        return larger
