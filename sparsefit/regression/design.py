"""Columns on demand: a design matrix theta (m, k) by the sums over its rows that solvers need.

Everywhere Z has the columns of theta in unit rms, z_j = theta_j / rms_j, and sums over the rows are
divided by the number m of samples. A design computes

    rms (k,),   Z'R/m (k, n),   Z V (m, n),   Z_J (m, j),   Z_J'Z_K/m (j, l),

and Z'Z of all columns on request only. Its rows are read in blocks: of an array in memory short
enough to stay in cache, of a file or any source of row slices as long as memory allows. A sparse
matrix is one block, whose zeros are neither stored nor summed, and so is a dask array, whose sums
are formed where its own blocks are (a block lost with its worker is computed again there).

Rounding: with u = 2^-53, a sum that is formed in blocks of b terms, B of them, is off by at most
gamma_{b + B} times the sum of the moduli (Higham 2002, section 4.2); `terms` is that b + B, of sums
with a column of theta and of `in_blocks`. Where a mean was taken off the columns, rounding is
relative to what they were before: `spread` is the largest ratio of the two.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from hashlib import blake2b
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sparsefit.arrays import Array, IntArray
from sparsefit.cached import cached_property
from sparsefit.errors import InputError

ROW_BLOCK = 8192  # rows a pass of a dense design: they stay in cache for what is done to them
SUMMED = 1024  # rows at a time in sums of what is not a column of theta
BLOCK_BYTES = 2**26  # of a block of rows that is read from a disk

Index = IntArray | slice


@dataclass(frozen=True, eq=False)
class Design:
    """A design matrix (m, k) by its sums, which are divided by ``samples``.

    source (m, k): an array, in C or Fortran order, which is not copied; anything with a shape whose
    rows can be sliced; a sparse matrix by columns (scipy's CSC); a dask array. weights (m,):
    factors of the rows. direction e (m,), |e| = 1: the columns are (I - e e') theta; where rows
    count alike and e is constant, an intercept that is not penalised was projected out. The columns
    themselves stay as they are stored. shift (k,): an offset of the columns of dense rows, which is
    taken off each block beside an intercept, so that the projection loses no digits.
    """

    source: Any
    samples: int
    weights: Array | None = None
    direction: Array | None = None
    shift: Array | None = None

    @cached_property
    def kind(self) -> str:
        """The storage of the columns: `dense`, `sparse` or `dask`."""
        package = type(self.source).__module__.partition(".")[0]
        return {"scipy": "sparse", "dask": "dask"}.get(package, "dense")

    @property
    def shape(self) -> tuple[int, int]:
        """Rows m and columns k."""
        return int(self.source.shape[0]), int(self.source.shape[1])

    @property
    def in_memory(self) -> bool:
        """Whether the rows are an array in memory, not a file or another source."""
        return isinstance(self.source, np.ndarray) and not isinstance(self.source, np.memmap)

    @property
    def _step(self) -> int:
        m, k = self.shape
        return ROW_BLOCK if self.in_memory else max(min(BLOCK_BYTES // (8 * k), m), 1)

    @cached_property
    def terms(self) -> int:
        """The number N of terms in the rounding bound gamma_N of a sum over the rows."""
        m, step = self.shape[0], self._step
        if self.kind == "sparse":  # the fullest column: a sum over the rows has no other terms
            count = int(np.diff(self.source.indptr).max())
        elif self.kind == "dask":
            count = int(max(self.source.chunks[0])) + len(self.source.chunks[0])
        else:
            count = min(m, step) + -(-m // step) - 1
        count = max(count, min(m, SUMMED) + -(-m // SUMMED) - 1)
        return count if self.direction is None else 3 * count + 8  # three sums in place of one

    def blocks(self) -> Iterator[tuple[slice, Any]]:
        """Slices of the rows with the weighted rows of theta in each."""
        if self.kind != "dense":
            yield slice(None), self._weighted
            return
        m, step = self.shape[0], self._step
        for start in range(0, m, step):
            rows = slice(start, min(start + step, m))
            block = np.asarray(self.source[rows], dtype=np.float64)
            block = block if self.shift is None else block - self.shift
            yield rows, block if self.weights is None else block * self.weights[rows, None]

    def digest(self) -> bytes:
        """A digest of up to 512 entries of what is in memory; empty of files and of dask arrays.

        It detects an array that was changed in place as a whole, but not a single entry.
        """
        values = self.source.data if self.kind == "sparse" else self.source
        if self.kind == "dask" or not (self.kind == "sparse" or self.in_memory):
            return b""
        flat = values.ravel(order="K")  # no copy: the arrays are contiguous
        return blake2b(flat[:: max(len(flat) // 512, 1)].tobytes(), digest_size=16).digest()

    @cached_property
    def _weighted(self) -> Any:
        if self.weights is None:
            return self.source
        if self.kind == "dask":
            return self.source * self.weights[:, None]
        return self.source.multiply(self.weights[:, None]).tocsc()

    @cached_property
    def csc(self) -> Any:
        """The weighted, uncentred matrix of a sparse design.

        Its indices are 32-bit integers, as compiled loops read them, unless it has 2^31 entries.
        """
        matrix = self._weighted
        if matrix.indices.dtype == np.int32 or matrix.nnz >= 2**31:
            return matrix
        places = (matrix.indices.astype(np.int32), matrix.indptr.astype(np.int32))
        return type(matrix)((matrix.data, *places), shape=matrix.shape)

    @cached_property
    def means(self) -> Array:
        """The components e'theta (k,) of the columns along the direction e (m,).

        e is projected off the columns; zeros without a direction.
        """
        if self.direction is None:
            return np.zeros(self.shape[1])
        return replace(self, direction=None).raw_correlate(self.direction[:, None])[:, 0]

    def off(self, rows: Array) -> Array:
        """(I - e e') R (m, n); R without a direction."""
        if self.direction is None:
            return rows
        along = in_blocks(np.matmul, self.direction, rows)
        return rows - np.multiply.outer(self.direction, along)

    @cached_property
    @np.errstate(over="ignore", invalid="ignore")  # refused by what the sums become
    def squares(self) -> Array:
        """The squares of the columns' norms (k,), in the units of theta, finite or not.

        Of a centred column: a difference where few digits cancel; 0 where it is constant to
        rounding.
        """
        total = np.zeros(self.shape[1])
        for _, block in self.blocks():
            if self.kind == "dense":
                total += np.einsum("ij,ij->j", block, block)
            else:
                square = block.multiply(block) if self.kind == "sparse" else block**2
                total += _array(square.sum(axis=0)).ravel()
        if self.direction is None:
            return total
        rest = np.maximum(total - self.means**2, 0.0)
        close = np.flatnonzero(rest < 1e-4 * total)
        for start in range(0, len(close), 256):
            part = close[start : start + 256]
            columns = self.raw_columns(part)
            rest[part] = np.einsum("ij,ij->j", columns, columns)
        rest[rest <= (self.terms * 2.0**-53) ** 2 * total] = 0.0
        return rest

    @cached_property
    def rms(self) -> Array:
        """The rms of the columns (k,), in the units of theta; 1 for a column of zeros.

        Of a column that is constant to rounding: before it was centred.
        """
        rms = np.sqrt(np.maximum(self.squares, 0.0) / self.samples)
        if self.direction is not None and not rms.all():
            rms = np.where(rms > 0.0, rms, replace(self, direction=None).rms)
        rms[rms == 0.0] = 1.0
        rms.setflags(write=False)
        return rms

    @cached_property
    def spread(self) -> float:
        """The largest ratio of a column's rms before centring to that after; 1 without centring."""
        if self.direction is None:
            return 1.0
        return max(float((replace(self, direction=None).rms / self.rms).max()), 1.0)

    def raw_correlate(self, rows: Array) -> Array:
        """theta'R (k, n) of R (m, n)."""
        rows = np.ascontiguousarray(self.off(rows))
        if self.kind == "dask":
            from dask.array import from_array  # of the extra `dask`: needed only here

            split: Any = from_array  # which has no types
            chunks = (self.source.chunks[0], rows.shape[1])
            return _array(self._weighted.T @ split(rows, chunks=chunks))
        total: Any = None
        for part, block in self.blocks():
            # numpy multiplies the other way round up to four times faster where R is narrow
            each = (rows[part].T @ block).T if self.kind == "dense" else block.T @ rows[part]
            total = each if total is None else np.add(total, each, out=total)
        return np.asarray(total)

    def raw_columns(self, index: IntArray) -> Array:
        """theta_J (m, j), weighted and centred: a dense copy in Fortran order."""
        if self.in_memory and self.source.flags.f_contiguous:  # no block is copied on the way
            out = np.take(self.source.T, index, axis=0).astype(np.float64, copy=False).T
            if self.shift is not None:
                out -= self.shift[index]
            if self.weights is not None:
                out *= self.weights[:, None]
        else:
            out = np.empty((self.shape[0], len(index)), order="F")
            for part, block in self.blocks():
                out[part] = _array(block[:, index])
        if self.direction is not None:
            out -= np.multiply.outer(self.direction, self.means[index])
        return out

    def raw_predict(self, values: Array) -> Array:
        """Theta W (m, n) of W (k, n); columns with zero weights are not read."""
        few = np.flatnonzero(values.any(axis=1))
        used: Index = few if len(few) < 0.5 * len(values) else slice(None)
        out = np.empty((self.shape[0], values.shape[1]))
        for part, block in self.blocks():
            out[part] = _array(_taken(block, used) @ values[used])
        if self.direction is not None:
            out -= np.multiply.outer(self.direction, self.means @ values)
        return out

    def correlate(self, rows: Array) -> Array:
        """Z'R/m (k, n) of R (m, n)."""
        out = self.raw_correlate(rows)
        out /= (self.rms * self.samples)[:, None]
        return out

    def overlaps(self, first: Array, second: Array) -> Array:
        """<r_q, s_q>/m (q,) of the columns of R and S (m, q)."""
        return in_blocks(partial(np.einsum, "iq,iq->q"), first, second) / self.samples

    def columns(self, index: IntArray) -> Array:
        """Z_J (m, j), dense; a copy."""
        out = self.raw_columns(index)
        out /= self.rms[index]
        return out

    def predict(self, values: Array) -> Array:
        """Z V (m, n) of V (k, n); columns with zero weights are not read."""
        return self.raw_predict(values / self.rms[:, None])

    def products(self, index: Index, others: Index | None = None) -> Array:
        """Z_J'Z_K/m (j, l); K is J by default, and the result symmetric."""
        total: Any = None
        for _, block in self.blocks():
            first = _taken(block, index)
            part = _array(first.T @ (first if others is None else _taken(block, others)))
            total = part if total is None else np.add(total, part, out=total)
        others = index if others is None else others
        if self.direction is not None:
            total -= np.multiply.outer(self.means[index], self.means[others])
        total /= (self.rms[index] * self.samples)[:, None]
        out: Array = np.divide(total, self.rms[others], out=total)
        return out

    def formed(self, index: IntArray) -> Array | None:
        """Z_J'Z/m (j, k) where Z'Z, or these rows of it for a path, were formed; None else."""
        if "gram" in vars(self):
            return self.gram.take(index, 0)
        values, ready = vars(self).get("rows_of_gram", (None, None))
        return values.take(index, 0) if ready is not None and ready.take(index).all() else None

    def share_rows(self, values: Array, ready: NDArray[np.uint8]) -> None:
        """Take rows of Z'Z/m (k, k) as a path forms them, and which are ready (k,)."""
        vars(self)["rows_of_gram"] = values, ready

    @cached_property
    def gram(self) -> Array:
        """Z'Z/m (k, k), read-only. Raises InputError where half of the memory is less."""
        size = 8 * self.shape[1] ** 2
        try:
            if size > 0.5 * os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"):
                raise MemoryError
            gram = self.products(slice(None))
        except MemoryError:
            words = (
                f"Z'Z of {self.shape[1]} columns takes {size / 2**30:.1f} GiB, more than is free"
            )
            raise InputError(f"{words}: use fewer columns") from None
        gram.setflags(write=False)
        return gram


def in_blocks(product: Callable[..., Any], first: Array, second: Array) -> Array:
    """The sum of ``product`` of the rows of both arrays, SUMMED of them at a time."""
    parts = [slice(start, start + SUMMED) for start in range(0, len(first), SUMMED)]
    total: Array = sum(product(first[part], second[part]) for part in parts)
    return total


def _array(product: Any) -> Array:
    """A product of blocks as a dense array."""
    if hasattr(product, "compute"):
        product = product.compute()
    dense: Array = product.toarray(order="F") if hasattr(product, "toarray") else product
    return np.asarray(dense, dtype=np.float64)


def _taken(block: Any, index: Index) -> Any:
    """Columns of a block; all of them without a copy."""
    return block if isinstance(index, slice) and index == slice(None) else block[:, index]
