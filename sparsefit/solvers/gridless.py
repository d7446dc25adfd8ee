"""Gridless group-LASSO: finitely many groups of a continuum, by sliding Frank-Wolfe.

The limit of ever finer grids (see `continuous_dual` for the problem and its certificate), of the
paper's cells over the length scale and of waves over the plane of wavevectors. Each round: the
place q of largest eta(q) joins; a group-LASSO on the groups at hand sets the weights and drops what
is not needed; places and weights slide downhill together. It ends when the duality gap over the
whole continuum does.

Source: Denoyelle, Duval, Peyre and Soubies, "The sliding Frank-Wolfe algorithm and its application
to super-resolution microscopy" (2019).
"""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sparsefit.arrays import Array
from sparsefit.regression.backend import Solution, checked_alpha_fraction
from sparsefit.regression.certificate import Certificate, CertificateKind
from sparsefit.regression.continuum import Bounds, Continuum, Jet
from sparsefit.regression.group_penalties import GroupNorms
from sparsefit.regression.problem import RegressionProblem
from sparsefit.solvers.continuous_dual import (
    Scanner,
    checked_bounds,
    continuous_alpha_max,
    continuous_gap,
    gap_of,
    places_of,
    refusal,
)
from sparsefit.solvers.kernels import path_on_gram
from sparsefit.solvers.sliding import Atoms, slide

ROUNDS = 60
STOP = 1e-10  # relative duality gap, below any tolerance the certificate is asked to meet
CORRECTION = 1e-3  # of the gap: weights before the slide, which makes them exact
PATIENCE = 12  # rounds without a smaller gap
EAGER = 0.7  # peaks of eta - 1 this close to the highest join in the same round
APART = 0.3  # in 1/extent: nearer groups than this are one lobe, and are tried as one


@dataclass(frozen=True)
class GridlessGroupLasso:
    """min 1/(2m) |Y - sum_j Z(q_j) V_j|^2 + alpha sum_j |V_j| over any q_j of the continuum.

    q is the length scale of cells, or the wavevector of waves in groups by wave. alpha =
    alpha_fraction * alpha_max, alpha_max = max over q of |Z(q)'Y|/m. lower, upper: bounds of the
    length scale [m]; None takes those of the problem's grid, of which nothing else is used.
    """

    name: ClassVar[str] = "gridless-group-lasso"
    certificate_kind: ClassVar[CertificateKind] = "duality_gap"
    alpha_fraction: float = 0.1
    lower: float | None = None
    upper: float | None = None

    def __post_init__(self) -> None:
        checked_alpha_fraction(self.name, self.alpha_fraction)
        checked_bounds(self.name, self.lower, self.upper)

    def solve(self, problem: RegressionProblem) -> Solution:
        """Weights over the groups found, which the solution's own problem holds."""
        refused = refusal(self.name, problem, self.lower, self.upper)
        if refused is not None:
            return refused
        assert problem.continuum is not None
        bounds = problem.continuum.interval(self.lower, self.upper)
        atoms, rounds, done = _sliding_frank_wolfe(problem, self.alpha_fraction, bounds)
        order = np.argsort(-atoms.places[:, 0])
        found = problem.at(atoms.places[order])
        scaled = atoms.weights[order] / atoms.jet.rms[order][:, :, None]
        return Solution(
            scaled.reshape(-1, problem.targets),
            "ok" if done else "inaccurate",
            "" if done else "the sliding Frank-Wolfe rounds stalled",
            "converged" if done else "stalled",
            rounds,
            found,
        )

    def certify(self, problem: RegressionProblem, solution: Solution) -> Certificate:
        """The duality gap of a solution over the whole continuum, from rows and places alone."""
        places, weights = places_of(solution)
        assert problem.continuum is not None
        bounds = problem.continuum.interval(self.lower, self.upper)
        top = continuous_alpha_max(problem.continuum, problem.target, bounds)
        own = problem.at(places)
        return continuous_gap(own, weights, self.alpha_fraction * top, bounds)


def _sliding_frank_wolfe(
    problem: RegressionProblem, alpha_fraction: float, bounds: Bounds
) -> tuple[Atoms, int, bool]:
    """(atoms, rounds, whether the gap reached STOP)."""
    continuum, target = problem.continuum, problem.target
    assert continuum is not None
    scanner = Scanner.of(continuum, bounds)
    start = scanner.peaks(target)[0]
    alpha = alpha_fraction * start.height
    nothing = np.zeros((1, continuum.size, target.shape[1]))
    atoms = Atoms.at(continuum, target, start.place[None], nothing, alpha)
    best, least, since = atoms, math.inf, 0
    for rounds in range(ROUNDS):
        peaks = scanner.peaks(atoms.residual)
        norm = float(np.sqrt(np.sum(atoms.weights**2, axis=(1, 2))).sum())
        gap = gap_of(atoms.residual, target, alpha, norm, peaks[0].height, len(target)).value
        if gap < least:
            best, least, since = atoms, gap, rounds
        if least <= STOP or rounds - since >= PATIENCE:
            return best, rounds, least <= STOP
        wanted = 1 + EAGER * (peaks[0].height / alpha - 1)
        new = [p.place for p in peaks if p.height >= wanted * alpha]
        atoms = _joined(continuum, target, atoms, new, alpha, bounds, gap)
    return best, rounds + 1, False


def _joined(
    continuum: Continuum,
    target: Array,
    atoms: Atoms,
    new: list[Array],
    alpha: float,
    bounds: Bounds,
    gap: float,
) -> Atoms:
    """Fully corrective weights on the old groups and the new, pruned, slid and merged."""
    q = np.unique(np.concatenate([atoms.places, np.array(new)]), axis=0)
    q, weights = _corrected(continuum, target, q, alpha, CORRECTION * gap)
    here = slide(continuum, target, q, weights, alpha, bounds)
    while True:
        merged = _merged(continuum, target, here, alpha, bounds)
        if merged is None:
            return here
        here = merged


def _corrected(
    continuum: Continuum, target: Array, q: Array, alpha: float, tolerance: float
) -> tuple[Array, Array]:
    """The group-LASSO on groups at q (s, p): those it keeps, and their weights (s, c, n)."""
    (m, n), size = target.shape, continuum.size
    z = Jet.of(*continuum.columns(q)).value.reshape(-1, m)
    path = path_on_gram(
        z @ z.T / m,
        z @ target / m,
        GroupNorms(np.repeat(np.arange(len(q)), size), np.ones(len(q))),
        np.array([alpha]),
        float(np.sum(target**2)) / m,
        tolerance,
    )
    weights = path.values[0].reshape(-1, size, n)
    kept = np.any(weights != 0, axis=(1, 2))
    kept = kept if kept.any() else np.arange(len(q)) == 0
    return q[kept], weights[kept]


def _merged(
    continuum: Continuum, target: Array, atoms: Atoms, alpha: float, bounds: Bounds
) -> Atoms | None:
    """The two nearest groups as one, where that is no worse; None where they stay two."""
    order = np.argsort(atoms.places[:, 0])
    q, v = atoms.places[order], atoms.weights[order]
    if len(q) < 2:
        return None
    images, signs = continuum.images(q)
    spans = continuum.spans(q)
    apart = np.linalg.norm((images[:, None] - q[:, None]) * spans[:, None], axis=3)
    apart[:, np.tri(len(q), dtype=bool)] = math.inf  # image, the one group, the other above it
    image, i, j = np.unravel_index(int(np.argmin(apart)), apart.shape)
    if apart[image, i, j] > APART:
        return None
    other, weights = images[image, j], v[j] * signs[image][:, None]
    share = np.array([np.linalg.norm(v[i]), np.linalg.norm(weights)])
    total = float(share.sum())
    q[i] = share @ np.stack([q[i], other]) / total if total > 0 else q[i]
    v[i] += weights
    kept = np.arange(len(q)) != j
    one = slide(continuum, target, q[kept], v[kept], alpha, bounds)
    return one if one.value <= atoms.value * (1 + 1e-12) else None
