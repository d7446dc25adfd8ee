"""Sufficient statistics of a regression problem: Z'Z, Z'Y and |y_t|^2, summed once and shared."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from sparsefit.arrays import Array, IntArray
from sparsefit.cached import cached_property
from sparsefit.errors import InputError
from sparsefit.regression.design import ROW_BLOCK, Design, RowDesign


@dataclass(frozen=True, eq=False)
class Statistics:
    """Sufficient statistics of a regression problem in scaled columns z_j = theta_j / rms_j.

    samples: the number m of samples; terms: what rounding of a sum over the rows grows with.
    cross = Z'Y/m (k, n), target_square = |y_t|^2/m (n,), rms (k,) in the units of theta. square:
    Z'Z/m (k, k) where it is known, or the design that it is formed from when `gram` is first asked
    for. The arrays are read-only: every back-end and the certificate read the same ones.
    """

    samples: int
    terms: int
    rms: Array
    cross: Array
    target_square: Array
    square: Array | None = None
    design: Design | None = None

    def __post_init__(self) -> None:
        for array in (self.rms, self.cross, self.target_square):
            array.setflags(write=False)

    @classmethod
    def on(cls, design: Design, target: Array) -> "Statistics":
        """The statistics of a design and its target (m, n); Z'Z/m is left to who asks for it."""
        square = np.einsum("ij,ij->j", target, target) / design.samples
        cross = design.correlate(target)
        return cls(design.samples, design.terms, design.rms, cross, square, design=design)

    @classmethod
    def of(cls, theta: Array, target: Array, *, count: int) -> "Statistics":
        """The statistics of rows theta (r, k) and target (r, n) of ``count`` samples."""
        return cls.on(RowDesign(theta, count), target)

    @classmethod
    def summed(
        cls, gram: Array, cross: Array, square: Array, *, count: int, rows: int | None = None
    ) -> "Statistics":
        """From theta'theta (k, k), which becomes the square, theta'Y (k, n) and |y_t|^2 (n,).

        count: the number m of samples; rows: that were summed, where they are not as many.
        """
        rms = np.sqrt(np.maximum(np.diagonal(gram), 0.0) / count)
        scale = np.where(rms > 0, rms, 1.0)
        gram /= scale[:, None] * count
        gram /= scale
        return cls(
            count, rows or count, scale, cross / (scale[:, None] * count), square / count, gram
        )

    @cached_property
    def gram(self) -> Array:
        """Z'Z/m (k, k). Raises InputError where it does not fit in memory."""
        gram = self.square
        if gram is None:
            assert self.design is not None
            try:
                gram = self.design.products(slice(None))
            except MemoryError:
                k = len(self.rms)
                words = f"Z'Z of {k} columns takes {k * k / 2**27:.1f} GiB, which are not there"
                raise InputError(f"{words}: use fewer columns") from None
        gram.setflags(write=False)
        return gram

    @property
    def formed(self) -> bool:
        """Whether `gram` is there already."""
        return self.square is not None or "gram" in vars(self)

    def gram_rows(self, columns: IntArray) -> Array:
        """The rows (c, k) of Z'Z/m of some columns; where it is not formed, only these."""
        if self.formed:
            return self.gram[columns]
        assert self.design is not None
        return self.design.products(columns, slice(None))

    @property
    def null_objective(self) -> float:
        """The objective at zero weights, |Y|^2 / 2m."""
        return 0.5 * float(self.target_square.sum())

    @cached_property
    def rank(self) -> int:
        """Numerical rank of Z (singular values above k * eps^(1/2) would be lost in Z'Z)."""
        eigenvalues = np.linalg.eigvalsh(self.gram)
        floor = len(eigenvalues) * np.finfo(float).eps * max(float(eigenvalues[-1]), 0.0)
        return int(np.count_nonzero(eigenvalues > floor))


def row_blocks(*arrays: Array, size: int = ROW_BLOCK) -> Iterator[tuple[Array, ...]]:
    """Blocks of rows of every array (m, ...), ``size`` at a time."""
    for start in range(0, len(arrays[0]), size):
        yield tuple(array[start : start + size] for array in arrays)
