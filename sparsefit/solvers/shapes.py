"""Regression problems of given shapes, drawn with their truth: wide, correlated, sparse, grouped.

    y = Z w + e,   Z (m, k) of unit rms, dense or scipy.sparse, e white

Neighbouring columns of a dense Z are correlated by rho: z_j = rho z_{j-1} + sqrt(1 - rho^2) e_j. A
sparse Z has a share `density` of entries that are not zero, at uniform places. The truth w has
`active` columns, or as many whole groups, at uniform places, with normal weights.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from sparsefit.arrays import Array, IntArray
from sparsefit.errors import integer_setting, number_setting

__all__ = ["DrawnProblem", "Shape"]


@dataclass(frozen=True, eq=False)
class DrawnProblem:
    """A problem with its truth: theta (m, k) dense or CSC, target (m, n), weights (k, n).

    groups (k,): the number of each column's group.
    """

    theta: Any
    target: Array
    groups: IntArray
    weights: Array


@dataclass(frozen=True)
class Shape:
    """The shape of a problem that is drawn.

    samples m, columns k, targets n; correlation of neighbouring columns in [0, 1), of dense ones;
    density: the share of entries that are not zero, below 1 a sparse matrix; group_size: columns
    in a group; active: columns, or groups where group_size is above 1, with weights; noise: its
    root mean square over that of Z w.
    """

    samples: int = 500
    columns: int = 1000
    targets: int = 1
    correlation: float = 0.0
    density: float = 1.0
    group_size: int = 1
    active: int = 20
    noise: float = 0.1

    def __post_init__(self) -> None:
        for name in ("samples", "columns", "targets", "group_size", "active"):
            integer_setting("shape", name, getattr(self, name), least=1)
        number_setting("shape", "correlation", self.correlation, low=0.0, high=1.0 - 1e-9)
        number_setting("shape", "density", self.density, low=0.0, high=1.0, open_low=True)
        number_setting("shape", "noise", self.noise, low=0.0)

    def draw(self, seed: int) -> DrawnProblem:
        """The problem of a seed: the same matrix, truth and noise for the same shape and seed."""
        rng = np.random.default_rng(seed)
        theta = self._sparse(rng) if self.density < 1.0 else self._dense(rng)
        groups = np.arange(self.columns) // self.group_size
        count = int(groups[-1]) + 1
        chosen = rng.choice(count, size=min(self.active, count), replace=False)
        weights = np.zeros((self.columns, self.targets))
        used = np.isin(groups, chosen)
        weights[used] = rng.standard_normal((int(used.sum()), self.targets))
        signal = theta @ weights
        noise = rng.standard_normal(signal.shape)
        target = signal + self.noise * np.sqrt(np.mean(np.square(signal), axis=0)) * noise
        return DrawnProblem(theta, target, groups, weights)

    def _dense(self, rng: np.random.Generator) -> Array:
        theta = np.empty((self.samples, self.columns), order="F")
        fresh = np.sqrt(1.0 - self.correlation**2)
        for j in range(self.columns):
            theta[:, j] = rng.standard_normal(self.samples)
            if j and self.correlation:
                theta[:, j] = self.correlation * theta[:, j - 1] + fresh * theta[:, j]
        theta /= np.sqrt(np.einsum("ij,ij->j", theta, theta) / self.samples)
        return theta

    def _sparse(self, rng: np.random.Generator) -> Any:
        from scipy import sparse

        entries = np.maximum(rng.binomial(self.samples, self.density, self.columns), 1)
        starts = np.concatenate([[0], np.cumsum(entries)])
        rows = np.concatenate(
            [np.sort(rng.choice(self.samples, size=count, replace=False)) for count in entries]
        )
        values = rng.standard_normal(len(rows))
        squares = np.add.reduceat(np.square(values), starts[:-1])
        values /= np.repeat(np.sqrt(squares / self.samples), entries)
        return sparse.csc_matrix((values, rows, starts), shape=(self.samples, self.columns))
