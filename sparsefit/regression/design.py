"""Columns on demand: a design matrix theta (m, k) as the few sums over its rows that solvers need.

Everywhere Z has the columns of theta in unit rms, z_j = theta_j / rms_j, and sums over the rows are
divided by the number m of samples. A design is asked for

    rms (k,),   Z'R/m (k, n),   Z V (m, n),   Z_J (m, j),   Z_J'Z_K/m (j, l),

and never for Z'Z of all columns at once unless somebody asks. Rounding: with u = 2^-53, a sum that
is formed in blocks of b terms, B of them, is off by at most gamma_{b + B} times the sum of the
moduli (Higham 2002, section 4.2); `terms` is that b + B. Where a mean was taken off the columns,
rounding is relative to what they were before: `spread` is the largest ratio of the two.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from sparsefit.arrays import Array, IntArray
from sparsefit.cached import cached_property
from sparsefit.errors import InputError

ROW_BLOCK = 8192  # rows a pass of a dense design: they stay in cache for what is done to them
BLOCK_BYTES = 2**26  # of a block of rows that is read from a disk
SPARSE_BELOW = 0.5  # share of the columns in use, below which gathering these pays


class Design(ABC):
    """A design matrix (m, k) by its sums; `samples` is what sums are divided by.

    A subclass states the sums in the units of theta (`raw_...`), the scaling is done here.
    """

    kind: ClassVar[str]  # in words, for `solver_status`
    samples: int

    @property
    @abstractmethod
    def shape(self) -> tuple[int, int]:
        """Rows m and columns k."""

    @property
    @abstractmethod
    def terms(self) -> int:
        """The number of terms that rounding of a sum over the rows grows with."""

    @abstractmethod
    def raw_squares(self) -> Array:
        """The squares of the columns' norms (k,)."""

    @abstractmethod
    def raw_correlate(self, rows: Array) -> Array:
        """theta'R (k, n) of R (m, n)."""

    @abstractmethod
    def raw_columns(self, index: IntArray) -> Array:
        """theta_J (m, j), dense."""

    @abstractmethod
    def raw_predict(self, values: Array) -> Array:
        """Theta W (m, n) of W (k, n)."""

    @abstractmethod
    def raw_products(self, index: IntArray | slice, others: IntArray | slice) -> Array:
        """theta_J'theta_K (j, l)."""

    @property
    def spread(self) -> float:
        """The largest rms of a column before its mean was taken off, over that after."""
        return 1.0

    @cached_property
    def squares(self) -> Array:
        """The squares of the columns' norms (k,), in the units of theta, finite or not."""
        return self.raw_squares()

    @cached_property
    def rms(self) -> Array:
        """The rms of the columns (k,), in the units of theta; 1 for a column of zeros."""
        rms = np.sqrt(np.maximum(self.squares, 0.0) / self.samples)
        rms[rms == 0.0] = 1.0
        rms.setflags(write=False)
        return rms

    def correlate(self, rows: Array) -> Array:
        """Z'R/m (k, n) of R (m, n)."""
        out = self.raw_correlate(rows)
        out /= (self.rms * self.samples)[:, None]
        return out

    def columns(self, index: IntArray) -> Array:
        """Z_J (m, j), dense; a copy."""
        out = self.raw_columns(index)
        out /= self.rms[index]
        return out

    def predict(self, values: Array) -> Array:
        """Z V (m, n) of V (k, n); columns that are not in use are not read."""
        return self.raw_predict(values / self.rms[:, None])

    def products(self, index: IntArray | slice, others: IntArray | slice | None = None) -> Array:
        """Z_J'Z_K/m (j, l); K is J where there is none."""
        others = index if others is None else others
        out = self.raw_products(index, others)
        out /= (self.rms[index] * self.samples)[:, None]
        out /= self.rms[others]
        return out

    def residual_sums(self, target: Array, values: Array, bound: Array) -> tuple[Array, Array]:
        """Z'u/m (k, q), and |u_q|^2/m, <u_q, Y_q>/m, <u_q, R_q>/m (3, q).

        R = Y - Z V for Y (m, q) and V (k, q), u = R where |R| <= bound (q,), cut to it elsewhere.
        """
        residual = target - self.predict(values)
        pull, sums = _cut_sums(residual, target, bound)
        return self.correlate(pull), sums / self.samples


def _in_use(values: Array) -> IntArray | slice:
    """The rows of values (k, n) that are not zero, where these are few; else all of them."""
    used = np.flatnonzero(values.any(axis=1))
    return used if len(used) < SPARSE_BELOW * len(values) else slice(None)


def _cut_sums(residual: Array, target: Array, bound: Array) -> tuple[Array, Array]:
    """u (m, q), and the sums of u^2, u Y and u R (3, q)."""
    pull = residual if np.isinf(bound).all() else np.clip(residual, -bound, bound)
    sums = [np.einsum("iq,iq->q", pull, other) for other in (pull, target, residual)]
    return pull, np.stack(sums)


@dataclass(frozen=True, eq=False)
class RowDesign(Design):
    """A dense array, in memory or on a disk, or anything with a shape whose rows can be sliced.

    source (m, k) is not copied, in whichever order it is stored; ``weights`` (m,): factors of the
    rows. In memory rows are taken `ROW_BLOCK` at a time, from a disk `BLOCK_BYTES`.
    """

    kind: ClassVar[str] = "dense"
    source: Any
    samples: int
    weights: Array | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """Rows m and columns k."""
        return int(self.source.shape[0]), int(self.source.shape[1])

    @property
    def in_memory(self) -> bool:
        """Whether the rows are an array in memory, and not a file's or another's."""
        return isinstance(self.source, np.ndarray) and not isinstance(self.source, np.memmap)

    @property
    def _step(self) -> int:
        m, k = self.shape
        return ROW_BLOCK if self.in_memory else max(min(BLOCK_BYTES // (8 * k), m), 1)

    @property
    def terms(self) -> int:
        """The number of terms that rounding of a sum over the rows grows with."""
        m, step = self.shape[0], self._step
        return min(m, step) + -(-m // step) - 1

    def blocks(self) -> Iterator[tuple[slice, Array]]:
        """Slices of the rows, and theta there."""
        m, step = self.shape[0], self._step
        for start in range(0, m, step):
            rows = slice(start, min(start + step, m))
            block = np.asarray(self.source[rows], dtype=np.float64)
            yield rows, block if self.weights is None else block * self.weights[rows, None]

    def raw_squares(self) -> Array:
        """The squares of the columns' norms (k,)."""
        total = np.zeros(self.shape[1])
        with np.errstate(over="ignore", invalid="ignore"):  # refused by what the sum becomes
            for _, block in self.blocks():
                total += np.einsum("ij,ij->j", block, block)
        return total

    def raw_correlate(self, rows: Array) -> Array:
        """theta'R (k, n) of R (m, n)."""
        total = np.zeros((self.shape[1], rows.shape[1]))
        for part, block in self.blocks():
            # numpy multiplies the other way round up to four times faster where R is narrow
            total += (rows[part].T @ block).T
        return total

    def raw_columns(self, index: IntArray) -> Array:
        """theta_J (m, j), dense, in the order that products want."""
        out = np.empty((self.shape[0], len(index)), order="F")
        for part, block in self.blocks():
            out[part] = block[:, index]
        return out

    def raw_predict(self, values: Array) -> Array:
        """Theta W (m, n) of W (k, n)."""
        used = _in_use(values)
        out = np.empty((self.shape[0], values.shape[1]))
        for part, block in self.blocks():
            out[part] = block[:, used] @ values[used]
        return out

    def raw_products(self, index: IntArray | slice, others: IntArray | slice) -> Array:
        """theta_J'theta_K (j, l), symmetric where K is J."""
        same, total = others is index, None
        for _, block in self.blocks():
            left = block[:, index]
            part = left.T @ (left if same else block[:, others])
            total = part if total is None else np.add(total, part, out=total)
        assert total is not None
        return total

    def residual_sums(self, target: Array, values: Array, bound: Array) -> tuple[Array, Array]:
        """Z'u/m (k, q) and the three sums (3, q), in one pass over the rows."""
        k, count = values.shape
        raw = values / self.rms[:, None]
        used = _in_use(raw)
        raw = raw[used]
        total, sums = np.zeros((count, k)), np.zeros((3, count))
        for part, block in self.blocks():
            pull, each = _cut_sums(target[part] - block[:, used] @ raw, target[part], bound)
            sums += each
            total += pull.T @ block
        return total.T / (self.rms * self.samples)[:, None], sums / self.samples


@dataclass(frozen=True, eq=False)
class SparseDesign(Design):
    """A sparse matrix by columns (scipy's CSC), of which zeros are neither stored nor summed."""

    kind: ClassVar[str] = "sparse"
    matrix: Any
    samples: int

    @property
    def shape(self) -> tuple[int, int]:
        """Rows m and columns k."""
        return int(self.matrix.shape[0]), int(self.matrix.shape[1])

    @cached_property
    def terms(self) -> int:
        """The entries of the fullest column: a sum over the rows has no other terms."""
        return int(np.diff(self.matrix.indptr).max())

    @cached_property
    def _transposed(self) -> Any:
        return self.matrix.T

    def raw_squares(self) -> Array:
        """The squares of the columns' norms (k,)."""
        squares = self.matrix.multiply(self.matrix).sum(axis=0)
        return np.asarray(squares, dtype=np.float64).ravel()

    def raw_correlate(self, rows: Array) -> Array:
        """theta'R (k, n) of R (m, n)."""
        out: Array = self._transposed @ np.ascontiguousarray(rows)
        return out

    def raw_columns(self, index: IntArray) -> Array:
        """theta_J (m, j), dense."""
        out: Array = self.matrix[:, index].toarray(order="F")
        return out

    def raw_predict(self, values: Array) -> Array:
        """Theta W (m, n) of W (k, n)."""
        used = np.flatnonzero(values.any(axis=1))
        out: Array = self.matrix[:, used] @ values[used]
        return out

    def raw_products(self, index: IntArray | slice, others: IntArray | slice) -> Array:
        """theta_J'theta_K (j, l)."""
        right = self.matrix[:, others]
        left = right if others is index else self.matrix[:, index]
        out: Array = (left.T @ right).toarray()
        return out


@dataclass(frozen=True, eq=False)
class DaskDesign(Design):
    """A dask array (m, k) in blocks of rows, whose sums are formed where the blocks are.

    The scheduler is whichever dask is set up with; a block that is lost with its worker is made
    again there.
    """

    kind: ClassVar[str] = "dask"
    source: Any
    samples: int

    @property
    def shape(self) -> tuple[int, int]:
        """Rows m and columns k."""
        return int(self.source.shape[0]), int(self.source.shape[1])

    @property
    def terms(self) -> int:
        """The number of terms that rounding of a sum over the rows grows with."""
        sizes = self.source.chunks[0]
        return int(max(sizes)) + len(sizes)

    def raw_squares(self) -> Array:
        """The squares of the columns' norms (k,)."""
        return np.array((self.source**2).sum(axis=0).compute(), dtype=np.float64)

    def _matching(self, rows: Array) -> Any:
        """R (m, n) as a dask array in the blocks of the design."""
        from dask.array import from_array  # of the extra `dask`: needed only here

        split: Any = from_array  # which has no types
        return split(rows, chunks=(self.source.chunks[0], rows.shape[1]))

    def raw_correlate(self, rows: Array) -> Array:
        """theta'R (k, n) of R (m, n)."""
        return np.array((self.source.T @ self._matching(rows)).compute(), dtype=np.float64)

    def raw_columns(self, index: IntArray) -> Array:
        """theta_J (m, j), dense, brought here."""
        return np.array(self.source[:, index].compute(), dtype=np.float64, order="F")

    def raw_predict(self, values: Array) -> Array:
        """Theta W (m, n) of W (k, n)."""
        used = np.flatnonzero(values.any(axis=1))
        if not len(used):
            return np.zeros((self.shape[0], values.shape[1]))
        return np.array((self.source[:, used] @ values[used]).compute(), dtype=np.float64)

    def raw_products(self, index: IntArray | slice, others: IntArray | slice) -> Array:
        """theta_J'theta_K (j, l)."""
        left, right = self.source[:, index], self.source[:, others]
        return np.array((left.T @ right).compute(), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class CentredDesign(Design):
    """A design off which its part along one direction was taken: (I - e e') theta.

    e (m,), |e| = 1, is a constant where rows count alike: an intercept that is not penalised,
    projected out. means (k,) = e'theta. The columns themselves stay as they are stored.
    """

    inner: Design
    direction: Array
    means: Array

    @classmethod
    def of(cls, inner: Design, direction: Array) -> CentredDesign:
        """The design without its part along a direction (m,) of any length."""
        unit = direction / np.linalg.norm(direction)
        return cls(inner, unit, inner.raw_correlate(unit[:, None])[:, 0])

    @property
    def kind(self) -> str:  # type: ignore[override]
        """That of the design below."""
        return self.inner.kind

    @property
    def samples(self) -> int:  # type: ignore[override]
        """What sums are divided by."""
        return self.inner.samples

    @property
    def shape(self) -> tuple[int, int]:
        """Rows m and columns k."""
        return self.inner.shape

    @property
    def terms(self) -> int:
        """Three sums over the rows in place of one."""
        return 3 * self.inner.terms + 8

    @cached_property
    def spread(self) -> float:
        """The largest rms of a column before its mean was taken off, over that after."""
        return max(float((self.inner.rms / self.rms).max()), 1.0)

    def off(self, rows: Array) -> Array:
        """R (m, n) without its part along the direction."""
        out: Array = rows - np.multiply.outer(self.direction, self.direction @ rows)
        return out

    def raw_squares(self) -> Array:
        """The squares of the columns' norms (k,), by differences where few digits cancel.

        A column that is constant to rounding counts as zero.
        """
        total = self.inner.raw_squares()
        left = np.maximum(total - self.means**2, 0.0)
        close = np.flatnonzero(left < 1e-4 * total)
        for start in range(0, len(close), 256):
            part = close[start : start + 256]
            columns = self.raw_columns(part)
            left[part] = np.einsum("ij,ij->j", columns, columns)
        left[left <= (self.terms * 2.0**-53) ** 2 * total] = 0.0
        return left

    def raw_correlate(self, rows: Array) -> Array:
        """theta'R (k, n) of R (m, n)."""
        return self.inner.raw_correlate(self.off(rows))

    def raw_columns(self, index: IntArray) -> Array:
        """theta_J (m, j), dense."""
        out = self.inner.raw_columns(index)
        out -= np.multiply.outer(self.direction, self.means[index])
        return out

    def raw_predict(self, values: Array) -> Array:
        """Theta W (m, n) of W (k, n)."""
        out = self.inner.raw_predict(values)
        out -= np.multiply.outer(self.direction, self.means @ values)
        return out

    def raw_products(self, index: IntArray | slice, others: IntArray | slice) -> Array:
        """theta_J'theta_K (j, l)."""
        out = self.inner.raw_products(index, others)
        out -= np.multiply.outer(self.means[index], self.means[others])
        return out


def dense_rows(design: Design) -> Array:
    """The array theta (m, k) of a dense design; InputError with a remedy for any other."""
    if isinstance(design, RowDesign) and design.weights is None and design.in_memory:
        rows: Array = design.source
        return rows
    raise InputError(
        f"this needs theta as one array in memory, and the design is {design.kind}, weighted or "
        "centred: use lasso, group-lasso or another penalised back-end, or hand in the array"
    )
