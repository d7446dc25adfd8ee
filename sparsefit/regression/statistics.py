"""Sufficient statistics of a regression problem: Z'Z, Z'Y and |y_t|^2, summed once and shared.

numpy's BLAS sums Z'Z as a symmetric product; on AMD CPUs with AVX-512, which public BLAS builds
leave unused there, a compiled kernel does it 1.7 times faster. Both sum the same products in
double precision, in another order; the choice depends on the machine alone, never on the data.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from typing import Literal

import numpy as np

from sparsefit.arrays import Array, IntArray
from sparsefit.cached import cached_property
from sparsefit.errors import InputError

ROW_BLOCK = 8192  # rows per pass: the block of theta stays in cache for what is done to it
_KERNEL = "sparsefit.regression._gram"  # compiled; absent where there was no compiler


@dataclass(frozen=True, eq=False)
class Statistics:
    """Sufficient statistics of a regression problem in scaled columns z_j = theta_j / rms_j.

    samples: the number m of samples; rows: of how many rows the sums were taken, fewer than m
    where a QR compressed them. cross = Z'Y/m (k, n), target_square = |y_t|^2/m (n,), rms (k,) in
    the units of theta. square: Z'Z/m (k, k) where it is known, or the rows theta (m, k) that it is
    formed from when `gram` is first asked for. The arrays are read-only: every back-end and the
    certificate read the same ones.
    """

    samples: int
    rows: int
    rms: Array
    cross: Array
    target_square: Array
    square: Array | None = None
    theta: Array | None = None

    def __post_init__(self) -> None:
        for array in (self.rms, self.cross, self.target_square):
            array.setflags(write=False)

    @classmethod
    def of(cls, theta: Array, target: Array, *, count: int) -> "Statistics":
        """The statistics of rows theta (r, k) and target (r, n) of ``count`` samples.

        Z'Z/m is left to who asks for it: a back-end that keeps few columns needs few rows of it.
        """
        square = np.einsum("ij,ij->j", theta, theta)
        rms = np.sqrt(square / count)
        scale = np.where(rms > 0, rms, 1.0)
        cross = (target.T @ theta).T / (scale[:, None] * count)
        target_square = np.einsum("ij,ij->j", target, target) / count
        return cls(count, len(theta), scale, cross, target_square, theta=theta)

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
            assert self.theta is not None
            try:
                gram = squared(self.theta)
            except MemoryError:
                k = len(self.rms)
                words = f"Z'Z of {k} columns takes {k * k / 2**27:.1f} GiB, which are not there"
                raise InputError(f"{words}: use fewer columns") from None
            gram /= self.rms[:, None] * self.samples
            gram /= self.rms
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
        assert self.theta is not None
        rows: Array = self.theta[:, columns].T @ self.theta
        rows /= self.rms[columns, None] * self.samples
        rows /= self.rms
        return rows

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
    """The same rows of every array (m, ...), ``size`` at a time."""
    for start in range(0, len(arrays[0]), size):
        yield tuple(array[start : start + size] for array in arrays)


def squared(theta: Array) -> Array:
    """theta'theta (k, k) of rows theta (m, k), by the product that `product_loop` names."""
    if product_loop() == "compiled":
        return kernel_products(theta, np.zeros((len(theta), 1)))[0]
    gram: Array = theta.T @ theta
    return gram


def kernel_products(theta: Array, target: Array) -> tuple[Array, Array, Array]:
    """Z'Z (k, k), Z'Y (k, n) and |y_t|^2 (n,) of rows theta (m, k), target (m, n), compiled."""
    kernel = import_module(_KERNEL)
    k, n = theta.shape[1], target.shape[1]
    gram, cross, square = np.empty((k, k)), np.empty((k, n)), np.empty(n)
    rows, values = (np.ascontiguousarray(part, dtype=np.float64) for part in (theta, target))
    kernel.products(rows, values, gram, cross, square)
    return gram, cross, square


@cache
def product_loop() -> Literal["compiled", "numpy"]:
    """Which of the two sums up Gram matrices on this machine."""
    try:
        preferred = import_module(_KERNEL).preferred
    except (ImportError, AttributeError):  # not built: no compiler; or of older sources
        return "numpy"
    return "compiled" if preferred() else "numpy"
