"""The Jacobian of fitted rows, a block for each velocity component, and nothing that is zero.

    Phi_t = sum_j Psi C(q_j) W_jt + N_t b + e_t,    t the two velocity components,

is linear in the weights W and the coefficients b, so that the rows of component t depend on theta
through J_t = [Psi dC/dq W_t, Psi C, N_t]. A family whose components have weights of their own
(n = 2) has columns C for either, each with its own half of W; where the weights are shared (n = 1)
the blocks share their columns of theta. theta = (all q, all W of one component after the other, b).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sparsefit.arrays import Array, ComplexArray, IntArray
from sparsefit.cached import cached_property
from sparsefit.modes.fitted_rows import Rows


@dataclass(frozen=True, eq=False)
class Jacobian:
    """J of both velocity components, as the columns that differ and where they belong.

    Args:
        columns: what is not zero in J, each column once, (u, q).
        picks: which of them are in J_t, (2, k).
        places: which entries of theta they belong to, (2, k).
        size: the length of theta.
    """

    columns: Array
    picks: IntArray
    places: IntArray
    size: int

    @classmethod
    def of(cls, rows: Rows, values: Array, bent: Array) -> Jacobian:
        """J of rows, from the columns (s, c, r) of the modes and their `bent` flow (s, p, r, n)."""
        targets, length = bent.shape[3], values.shape[2]
        free, bodies = bent.shape[0] * bent.shape[1], values.shape[0] * values.shape[1]
        unknown, count = rows.nuisance.shape[2], len(rows.target)
        body = rows.averaged(values.reshape(bodies, length))
        head = rows.averaged(np.moveaxis(bent, 3, 0).reshape(targets * free, length))
        if targets == 1:  # both components in one column: part them
            body = np.concatenate([body[:, :count], body[:, count:]])
            head = np.concatenate([head[:, :count], head[:, count:]])
        columns = np.concatenate([head, *rows.nuisance.transpose(0, 2, 1), body])
        size = free + targets * bodies + unknown
        heads, tails, middle = np.arange(free), np.arange(unknown), np.arange(bodies)
        first = 2 * (free + unknown)
        picks, places = [], []
        for t in range(2):
            own, shift = (0, bodies * t) if targets == 2 else (bodies * t, 0)
            picks.append(
                np.concatenate(
                    [heads + free * t, 2 * free + unknown * t + tails, first + own + middle]
                )
            )
            places.append(np.concatenate([heads, size - unknown + tails, free + shift + middle]))
        return cls(columns, np.stack(picks), np.stack(places), size)

    @cached_property
    def _ones(self) -> Array:
        """1 where a column is in J_t and belongs to an entry of theta, else 0: (2, n, u)."""
        ones = np.zeros((2, self.size, len(self.columns)))
        for own, place, pick in zip(ones, self.places, self.picks, strict=True):
            own[place, pick] = 1.0
        return ones

    @cached_property
    def gram(self) -> Array:
        """J'J (n, n)."""
        return self.onto_theta(self.columns @ self.columns.T)

    def score(self, errors: Array) -> Array:
        """J'e (n,) of errors (q, 2) of the rows."""
        return self.placed(self.columns @ errors)

    def placed(self, products: Array) -> Array:
        """J'e (n,), from the products (u, 2) of `columns` and errors of either component."""
        score: Array = np.sum(self._ones @ products.T[:, :, None], axis=0)[:, 0]
        return score

    def scores(self, columns: Array) -> Array:
        """J'z (n, k) of columns z (k, 2, q) for the rows."""
        scores = np.zeros((self.size, len(columns)))
        for t in range(2):
            scores[self.places[t]] += self.columns[self.picks[t]] @ columns[:, t].T
        return scores

    def times(self, by_theta: Array) -> Array:
        """J times directions (n, f) of theta, (f, 2, q)."""
        return self._combined(by_theta, self.columns)

    def spectra(self, size: int) -> ComplexArray:
        """The real transforms (u, size/2 + 1) of `columns`."""
        spectra: ComplexArray = np.fft.rfft(self.columns, size)
        return spectra

    def turned(self, by_theta: Array, spectra: ComplexArray) -> ComplexArray:
        """The transforms (f, 2, size/2 + 1) of `times`, from those of the columns."""
        return self._combined(by_theta, spectra.view(np.float64)).view(np.complex128)

    def onto_theta(self, products: Array) -> Array:
        """sum_t J_t'S J_t (n, n), from the products (u, u) of `columns` under some S."""
        summed: Array = np.sum(self._ones @ products @ self._ones.swapaxes(1, 2), axis=0)
        return summed

    def onto_columns(self, form: Array) -> Array:
        """The form (u, u) in `columns` that is sum_t J_t K J_t', K (n, n) in theta."""
        summed: Array = np.sum(self._ones.swapaxes(1, 2) @ form @ self._ones, axis=0)
        return summed

    def _combined(self, by_theta: Array, columns: Array) -> Array:
        combined: Array = (by_theta.T @ self._ones).swapaxes(0, 1) @ columns
        return combined
