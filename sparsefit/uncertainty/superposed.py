"""The fitted model of several scales, of averages, and of an unknown vehicle, and its Jacobian.

    Psi Phi_t = sum_j Psi C(k_j) W_jt + N_t b + e_t,    t the two components,

Psi (q, m) the test functions of the weak form, or none; N (2, q, p) the columns of what is unknown
of the vehicle, or none; s scales. theta = (k_1 ... k_s, W_x, W_y, b): 17 s + p parameters, and the
Jacobian of both components, stacked, is J = [Psi dC/dk W, blockdiag(Psi C, Psi C), N].
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from sparsefit.arrays import Array, BoolArray, IntArray
from sparsefit.cached import cached_property
from sparsefit.uncertainty.model import LOST, NULL, Fitted
from sparsefit.uncertainty.spectra import frequency_weights

if TYPE_CHECKING:
    from scipy.sparse import csr_array


LEFT = 0.02  # of a spectrum, at least: what is left of less is the ends of the flight


@dataclass(frozen=True, eq=False)
class Superposed:
    """Weights (s, 8, 2) at wavenumbers k (s,) [1/m] on centred positions (m, 2) [m].

    nuisance N (2, q, p): of q rows; operator Psi (q, m), or None: the rows are the samples.
    """

    position: Array
    wavenumbers: Array
    weights: Array
    nuisance: Array
    operator: csr_array | None = None

    @cached_property
    def parts(self) -> tuple[Fitted, ...]:
        """Each scale alone."""
        pairs = zip(self.wavenumbers.tolist(), self.weights, strict=True)
        return tuple(Fitted(self.position, k, own) for k, own in pairs)

    @cached_property
    def flow(self) -> Array:
        """The summed flow velocity at the samples (m, 2) [m/s]."""
        total: Array = np.sum([part.flow for part in self.parts], axis=0)
        return total

    @cached_property
    def gradient(self) -> Array:
        """The summed flow's derivative in x and in y, (2, m, 2) [1/s]."""
        total: Array = np.sum([part.gradient for part in self.parts], axis=0)
        return total

    @property
    def scales(self) -> int:
        """How many."""
        return len(self.wavenumbers)

    @property
    def parameters(self) -> int:
        """17 s + p."""
        return 17 * self.scales + int(self.nuisance.shape[2])

    def averaged(self, values: Array) -> Array:
        """Rows (q, n) of values at the samples (m, n)."""
        found: Array = values if self.operator is None else self.operator @ values
        return found

    @cached_property
    def _blocks(self) -> tuple[Array, IntArray]:
        """J by component, without what is zero (2, q, 9 s + p), and where its columns belong."""
        s, p = self.scales, self.nuisance.shape[2]
        value = self.averaged(np.concatenate([part.columns for part in self.parts]).T)
        bend = self.averaged(np.concatenate([part.bend for part in self.parts], axis=1))
        both = [np.hstack([bend[:, t::2], value, self.nuisance[t]]) for t in range(2)]
        shared = np.arange(s), 17 * s + np.arange(p)
        places = [
            np.concatenate([shared[0], s + 8 * s * t + np.arange(8 * s), shared[1]])
            for t in range(2)
        ]
        return np.stack(both), np.stack(places)

    @cached_property
    def _roots(self) -> tuple[Array, Array, BoolArray, Array]:
        """Eigenvalues and vectors of J'J in scaled columns, which to keep, and the scales."""
        gram = np.zeros((self.parameters, self.parameters))
        for block, place in zip(*self._blocks, strict=True):
            gram[np.ix_(place, place)] += block.T @ block
        scale = np.sqrt(np.diag(gram))
        scale[scale == 0] = 1.0
        roots, vectors = np.linalg.eigh(gram / np.outer(scale, scale))
        return roots, vectors, roots > NULL * roots[-1], scale

    def solved(self, values: Array) -> Array:
        """(J'J)^+ values (17 s + p, f)."""
        roots, vectors, kept, scale = self._roots
        basis = vectors[:, kept] / scale[:, None]
        found: Array = (basis / roots[kept]) @ (basis.T @ values)
        return found

    def lost(self, gradients: Array) -> BoolArray:
        """Which functions of theta, gradients (f, 17 s + p), the flight does not tell."""
        _, vectors, kept, scale = self._roots
        turned = vectors.T @ (gradients / scale).T
        hidden, whole = (np.linalg.norm(one, axis=0) for one in (turned[~kept], turned))
        found: BoolArray = ~(hidden <= LOST * whole)
        return found

    @property
    def whole(self) -> bool:
        """Whether the flight tells every weight: U0 grows along a null direction if it does not."""
        return bool(self._roots[2].all())

    def left(self, shapes: Array, size: int) -> Array:
        """Spectra (n, size/2 + 1) of what a fit leaves of errors with these spectra.

        With P = Q Q' the projection onto J, S the spectra and F the transform,

            E |F (I - P) e|^2 = S (1 - 2 diag F P F') + diag F Q (Q'S Q) Q'F'.

        Slow columns take power at low frequencies, where smoothed noise has its own.
        """
        roots, vectors, kept, scale = self._roots
        basis = vectors[:, kept] / scale[:, None] / np.sqrt(roots[kept])
        blocks = zip(*self._blocks, strict=True)
        spectra = [np.fft.rfft(block @ basis[at], size, axis=0) for block, at in blocks]
        both, weight = 2 * len(self._blocks[0][0]), frequency_weights(size)
        taken = sum(np.sum(one.real**2 + one.imag**2, axis=1) for one in spectra) / both
        found = np.empty(shapes.shape)
        for row, shape in zip(found, shapes, strict=True):
            loaded = (weight * shape)[:, None]
            inner = sum((one.conj().T @ (loaded * one)).real for one in spectra)
            back = sum(np.sum((one @ inner) * one.conj(), axis=1).real for one in spectra) / both
            row[:] = np.maximum(shape * (1 - 2 * taken) + back, LEFT * shape)
        return found

    def influence(self, gradients: Array) -> Array:
        """c (2, q, f): an error e of a row moves the functions of theta by sum c e."""
        by_theta = self.solved(gradients.T)
        return np.stack([block @ by_theta[at] for block, at in zip(*self._blocks, strict=True)])

    def score(self, errors: Array) -> Array:
        """J'e (17 s + p,) of errors (q, 2) of the rows."""
        found = np.zeros(self.parameters)
        for block, place, error in zip(*self._blocks, errors.T, strict=True):
            found[place] += block.T @ error
        return found

    @cached_property
    def values(self) -> Array:
        """U0 [m/s], L [m] and tau_w [s] of every scale, (s, 3)."""
        return np.stack([part.values for part in self.parts])

    @cached_property
    def gradients(self) -> Array:
        """Of `values` in theta, (3 s, 17 s + p), scale by scale."""
        s = self.scales
        found = np.zeros((3 * s, self.parameters))
        for j, part in enumerate(self.parts):
            own, rows = part.gradients, slice(3 * j, 3 * j + 3)
            found[rows, j] = own[:, 0]
            for t in range(2):
                first = s + 8 * s * t + 8 * j
                found[rows, first : first + 8] = own[:, 1 + 8 * t : 9 + 8 * t]
        return found
