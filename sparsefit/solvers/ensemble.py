"""An ensemble over blocks of time: how often a group is chosen, and the groups that often are.

Z and Y are cut into blocks of consecutive samples. Half of them, drawn at random, are fitted by the
LASSO or the group-LASSO at one penalty; so is the other half; and so on. The share of these fits in
which a weight is not zero is its inclusion probability Pi. What has Pi >= threshold is fitted again
by least squares on all samples. Blocks stay whole since neighbours resemble each other: fits to
samples drawn one by one would all be alike. Gram matrices of blocks add up, so that a draw costs
no more than its path.

Of G groups, of which a fit chooses q on average, at most q^2 / ((2 threshold - 1) G) are expected
to be kept falsely, where those that do not belong are exchangeable; by the LASSO, whose targets
choose by themselves, so many for each target.

Sources: Meinshausen and Buehlmann, J. R. Stat. Soc. B 72 (2010) 417-473, stability selection; Shah
and Samworth, J. R. Stat. Soc. B 75 (2013) 55-80, complementary halves; Fasel, Kutz, Brunton and
Brunton, Proc. R. Soc. A 478 (2022) 20210904, ensembles for dynamics.
"""

from dataclasses import dataclass
from typing import ClassVar, Literal, get_args

import numpy as np

from sparsefit.arrays import Array, BoolArray, IntArray
from sparsefit.errors import integer_setting, number_setting, one_of
from sparsefit.regression.backend import Solution, checked_alpha_fraction
from sparsefit.regression.certificate import CertificateKind
from sparsefit.regression.group_penalties import GroupNorms
from sparsefit.regression.penalties import Penalty, alpha_max, lasso_penalty
from sparsefit.regression.problem import RegressionProblem
from sparsefit.regression.statistics import Statistics
from sparsefit.solvers.group_search import fit_on
from sparsefit.solvers.kernels import path_on_gram

Base = Literal["group-lasso", "lasso"]
TOLD = 5  # inclusion probabilities that the solver's status has


@dataclass(frozen=True)
class Ensemble:
    """Least squares on what most fits to halves of the samples choose.

    base: what chooses, ``group-lasso`` (groups span all targets) or ``lasso`` (each target's own
    columns), at alpha_fraction of its alpha_max. draws: fits, in pairs of complementary halves.
    blocks: pieces that the samples are cut into. threshold: inclusion probability, above 1/2, that
    keeps. seed: of the draws.
    """

    name: ClassVar[str] = "ensemble"
    certificate_kind: ClassVar[CertificateKind] = "fixed_point"
    base: Base = "group-lasso"
    alpha_fraction: float = 0.1
    draws: int = 50
    blocks: int = 10
    threshold: float = 0.6
    seed: int = 0

    def __post_init__(self) -> None:
        one_of(f"base of {self.name}", self.base, get_args(Base))
        checked_alpha_fraction(self.name, self.alpha_fraction)
        integer_setting(self.name, "draws", self.draws, least=2)
        integer_setting(self.name, "blocks", self.blocks, least=2)
        number_setting(self.name, "threshold", self.threshold, low=0.5, high=1.0, open_low=True)
        integer_setting(self.name, "seed", self.seed, least=0)

    def solve(self, problem: RegressionProblem) -> Solution:
        """Weights on what is kept; ``solver_status`` tells the largest inclusion probabilities."""
        if problem.sample_count is not None and problem.continuum is None:
            reason = f"{self.name} needs samples to draw from, and these are compressed"
            return Solution(None, "error", reason)
        if problem.samples < 2:
            return Solution(None, "error", f"{self.name} needs at least 2 samples")
        if not problem.target.any():
            return Solution(None, "unidentifiable", f"{self.name}: the target is zero throughout")
        shares = self.inclusion(problem)
        words, kept = self._told(problem, shares), shares >= self.threshold
        if not kept.any():
            reason = f"nothing is chosen by {self.threshold:g} of the fits; {words}"
            return Solution(None, "unidentifiable", reason, words)
        weights = self._refitted(problem, kept)
        return Solution(weights, solver_status=words, iterations=2 * self._pairs)

    def _refitted(self, problem: RegressionProblem, kept: BoolArray) -> Array:
        """Least squares (k, n) of each target on the columns that are kept for it."""
        weights = np.zeros(kept.shape)
        for target in range(problem.targets):
            columns = np.flatnonzero(kept[:, target])
            if len(columns):
                weights[:, target] = fit_on(problem, columns)[:, target]
        return weights

    def next_weights(self, problem: RegressionProblem, weights: Array) -> Array:
        """What the inclusion probabilities, worked out again, make of any weights (k, n)."""
        return self._refitted(problem, self.inclusion(problem) >= self.threshold)

    def inclusion(self, problem: RegressionProblem) -> Array:
        """The inclusion probability of every weight (k, n)."""
        pieces = np.array_split(np.arange(problem.samples), min(self.blocks, problem.samples))
        blocks = [_sums(problem, piece) for piece in pieces]
        rng, half = np.random.default_rng(self.seed), len(blocks) // 2
        chosen = np.zeros((problem.columns, problem.targets))
        for _ in range(self._pairs):
            order = rng.permutation(len(blocks))
            for part in (order[:half], order[half:]):
                chosen += self._fitted(problem, _added([blocks[i] for i in part])) != 0
        shares: Array = chosen / (2 * self._pairs)
        return shares

    @property
    def _pairs(self) -> int:
        return (self.draws + 1) // 2

    def _fitted(self, problem: RegressionProblem, statistics: Statistics) -> Array:
        """The weights (k, n) of one half, in scaled columns."""
        grouped = self.base == "group-lasso"
        groups = int(problem.groups.max()) + 1
        penalty: Penalty = lasso_penalty(problem.columns)
        if grouped:
            penalty = GroupNorms(problem.groups, np.ones(groups))
        alpha = alpha_max(statistics.cross, penalty)
        if alpha == 0.0:
            return np.zeros(statistics.cross.shape)
        parts = []
        for targets in problem.together(grouped):
            cross = np.ascontiguousarray(statistics.cross[:, targets])
            square = float(statistics.target_square[targets].sum())
            alphas = np.array([self.alpha_fraction * alpha])
            parts.append(path_on_gram(statistics.gram, cross, penalty, alphas, square).values[0])
        return np.concatenate(parts, axis=1)

    def _told(self, problem: RegressionProblem, shares: Array) -> str:
        """The largest inclusion probabilities, and how many of those kept may be false."""
        if self.base == "group-lasso":
            groups = range(int(problem.groups.max()) + 1)
            items = np.array([[shares[problem.groups == g].max()] for g in groups])
            names = [f"group {g}" for g in groups]
            scales = problem.group_scales
            if scales is not None and len(np.unique(scales)) == len(scales):
                names = [f"{scale:.4g} m" for scale in scales]
        else:
            items, names = shares, list(problem.names)  # each target chooses by itself
        chosen = float(np.sum(items.sum(axis=0) ** 2))
        false = chosen / ((2.0 * self.threshold - 1.0) * len(items))
        false = min(false, float(np.count_nonzero(items >= self.threshold)))
        most = items.max(axis=1)
        order = np.argsort(-most, kind="stable")[:TOLD]
        listed = ", ".join(f"{names[i]} {most[i]:.2f}" for i in order)
        return f"inclusion: {listed}; falsely kept: at most {false:.2g} expected"


def _sums(problem: RegressionProblem, rows: IntArray) -> Statistics:
    """Z'Z, Z'Y and |y_t|^2 of some samples, in columns that have unit rms over all of them."""
    rms = problem.statistics.rms
    z, y = problem.rows[rows] / rms, problem.target[rows]
    return Statistics(len(rows), len(rows), rms, z.T @ y, np.einsum("it,it->t", y, y), z.T @ z)


def _added(blocks: list[Statistics]) -> Statistics:
    """The statistics of several blocks of samples together, per sample."""
    count = sum(block.samples for block in blocks)
    cross, square, gram = (
        sum(getattr(block, name) for block in blocks) / count
        for name in ("cross", "target_square", "gram")
    )
    return Statistics(count, count, blocks[0].rms, cross, square, gram)
