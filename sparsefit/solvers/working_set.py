"""The problem on some columns of a design, as kernels take it and as a working set extends it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sparsefit.arrays import Array, IntArray
from sparsefit.cached import cached_property
from sparsefit.regression.design import Design
from sparsefit.regression.penalties import Penalty

JOINING, MANY = 8, 32  # rows of G that are formed first, then as many again; all after so many
STORED = 2**25  # entries of Z_J, at most, of which a dense copy is stored


class Growing:
    """Rows of G = Z'Z/m (k, k) of a design, formed as columns enter: values (k, k), ready (k,).

    With a column come those that are most correlated with the residual.
    """

    def __init__(self, design: Design) -> None:
        self.design, k = design, design.shape[1]
        self.values, self.ready = np.zeros((k, k)), np.zeros(k, np.uint8)
        design.share_rows(self.values, self.ready)  # with certificates

    def fill(self, column: int, correlation: Array) -> None:
        """Form the row of a column and some others; all, where MANY are not enough."""
        count = np.count_nonzero(self.ready)
        if count >= MANY:
            self.complete()
            return
        rank = np.where(self.ready, -1.0, np.abs(correlation))
        rank[column] = np.inf
        index = np.sort(np.argsort(-rank, kind="stable")[: max(JOINING, count)])
        self.values[index], self.ready[index] = self.design.products(index, slice(None)), True

    def complete(self) -> None:
        """Form all rows."""
        self.values[:], self.ready[:] = self.design.gram, True


@dataclass(frozen=True, eq=False)
class Columns:
    """The problem on the columns J of a design, for a target of unit rms, |Y|^2/m = 1.

    penalty: on these columns; cross B = Z_J'Y/m (j, q); gram G = Z_J'Z_J/m (j, j), or None, where
    the rows Z_J (m, j) are used, dense or scipy's CSC, off which the design's direction is to be
    projected. growing: by what G is formed. What has G alone needs nothing else.

    A working set also has the design Z (m, k), the target Y (m, q), the penalty on all columns
    (whole), J as index (j,), and store (s, m): Z_J' and space for further columns, whose pages are
    not touched before; None where it would be large, or the design is sparse. rotations: block
    descent has orthogonal columns within each block, Z_g Q_g with the eigenvectors Q_g of Z_g'Z_g,
    which leaves |V_g| as it is; positions (b, size) of the blocks of one size, and Q_g'
    (b, size, size).
    """

    penalty: Penalty
    cross: Array
    gram: Array | None
    rows: Any = None
    design: Any = None
    target: Any = None
    growing: Growing | None = None
    whole: Any = None
    index: Any = None
    store: Array | None = None
    rotations: tuple[tuple[IntArray, Array], ...] | None = None

    def extended(self, new: IntArray, cross: Array, by_gram: bool) -> Columns:
        """The set with the columns ``new``, whole blocks, at its end; cross is Z'Y/m (k, q)."""
        blocks, old, gram, rotations = self.whole.blocks, len(self.index), None, self.rotations
        design, rows = self.design, None
        new = new[np.argsort(blocks[new], kind="stable")]
        index, pull = np.concatenate([self.index, new]), np.concatenate([self.cross, cross[new]])
        store = self.store if design.shape[0] * len(index) <= STORED else None
        if store is not None:
            store[old : len(index)] = design.columns(new).T
            rows = store[: len(index)].T
        if store is not None and rotations is not None:
            first, sizes = np.unique(blocks[new], return_index=True, return_counts=True)[1:]
            for size in np.unique(sizes):
                part = old + np.add.outer(first[sizes == size], np.arange(size))
                block = store[part]
                rotation = np.linalg.eigh(block @ block.transpose(0, 2, 1))[1].transpose(0, 2, 1)
                store[part], pull[part] = rotation @ block, rotation @ pull[part]
                rotations = (*rotations, (part, rotation))
        if by_gram and self.gram is not None:
            gram = np.empty((len(index), len(index)))
            gram[:old, :old] = self.gram
            if rows is not None:
                gram[old:] = rows[:, old:].T @ rows / design.samples
            else:
                gram[old:] = design.products(new, index)
            gram[:old, old:] = gram[old:, :old].T
        elif rows is None:  # of a sparse design
            rows = sparse_columns(design, index)
        own: dict[str, Any] = {"index": index, "store": store, "rotations": rotations}
        part = self.whole.restricted(index)
        return replace(self, penalty=part, cross=pull, gram=gram, rows=rows, **own)

    def unrotated(self, values: Array) -> Array:
        """V (a, j, q) of the columns of Z, from those of the rotated ones."""
        out = values.copy()
        for part, rotation in self.rotations or ():
            out[:, part] = rotation.transpose(0, 2, 1) @ values[:, part]
        return out

    def fitted(self, values: Array) -> Array:
        """Z_J V (m, q) of V (j, q)."""
        if isinstance(self.rows, np.ndarray):  # V is narrow: numpy is slower the other way round
            return np.asarray((values.T @ self.across).T)
        if self.rows is not None:
            return np.asarray(self.design.off(self.rows @ values))
        full = np.zeros((self.design.shape[1], values.shape[1]))
        full[self.index] = values
        return np.asarray(self.design.predict(full))

    def times(self, values: Array) -> Array:
        """G V (j, q) of V (j, q)."""
        if self.gram is not None:
            return np.asarray(self.gram @ values)
        return np.asarray(self.across @ self.fitted(values) / self.design.samples)

    @cached_property
    def across(self) -> Any:
        """Z_J' (j, m), a view, which scipy takes longer to make than to multiply."""
        return self.rows.T

    @cached_property
    def roots(self) -> tuple[Array, Array, float]:
        """Rows R (r, j), targets T (q, r) and their number c: R'R = c G and R'T' = c B.

        Z_J and the target or, of G alone, its pivoted Cholesky factor, with c = 1.
        """
        if self.gram is None:
            return self.rows, self.target.T, float(self.design.samples)
        from scipy.linalg.lapack import dpstrf, dtrtrs

        root, pivots, rank, _ = dpstrf(self.gram.T)
        rows, order = np.zeros((rank, len(root)), order="F"), pivots - 1
        root[np.tril_indices(rank, -1)] = 0.0
        rows[:, order] = root[:rank]
        target, _ = dtrtrs(root[:rank, :rank], self.cross[order[:rank]], trans=1)
        return rows, np.ascontiguousarray(target.T), 1.0

    def solved(self, on: IntArray, factor: Any, pull: Array, step: float, targets: int) -> Array:
        """s N (I + s N'G N)^-1 N' pull (c,) on the coefficients ``on`` (c,), flat in (j, q)."""
        right = pull if factor is None else factor.T @ pull
        if self.rows is not None and len(right) > targets * self.rows.shape[0]:
            column, target = np.divmod(on, targets)
            tall = self._dense(column) * np.sqrt(step / self.design.samples)
            if targets > 1:  # each has rows of its own
                apart = np.zeros((len(on), targets, len(tall)))
                apart[np.arange(len(on)), target] = tall.T
                tall = apart.reshape(len(on), -1).T
            tall = tall if factor is None else (factor.T @ tall.T).T
            outer = tall @ tall.T
            outer.flat[:: len(outer) + 1] += 1.0
            y = right - tall.T @ _nearest(outer, tall @ right)
        else:
            square = step * self.within(on, factor, targets)
            square.flat[:: len(square) + 1] += 1.0
            y = _nearest(square, right)
        lifted: Array = step * (y if factor is None else factor @ y)
        return lifted

    def _dense(self, columns: IntArray) -> Array:
        part = self.rows[:, columns]
        return part if isinstance(part, np.ndarray) else self.design.off(part.toarray())

    def within(self, on: IntArray, factor: Any, targets: int) -> Array:
        """N'G N on the coefficients ``on`` (c,), flat in (j, q), of N (c, d), None for identity."""
        column, target = np.divmod(on, targets)
        if self.gram is not None:
            square = self.gram.take(column, 0).take(column, 1)
        else:
            part = self._dense(column)
            square = part.T @ part / self.design.samples
        if targets > 1:
            square = np.where(target[:, None] == target, square, 0.0)
        return square if factor is None else factor.T @ (factor.T @ square).T


def sparse_columns(design: Design, index: IntArray) -> Any:
    """Z_J (m, j) of a sparse design in scipy's CSC, before its direction is projected off."""
    rows = design.csc[:, index]
    rows.data = rows.data / np.repeat(design.rms[index], np.diff(rows.indptr))
    return rows


def definite(matrix: Array, right: Array) -> Array | None:
    """The solution of a symmetric positive definite system; None where Cholesky's method fails."""
    from scipy.linalg.lapack import dposv

    _, solution, failed = dposv(matrix.T, right, lower=1)
    return None if failed else solution


def _nearest(matrix: Array, right: Array) -> Array:
    """The solution of a positive definite system, or of least squares where Cholesky fails."""
    solution = definite(matrix, right)
    if solution is None:
        solution = np.asarray(np.linalg.lstsq(matrix, right, rcond=1e-14)[0])
    return solution
