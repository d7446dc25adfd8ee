"""Least squares, as the paper prints it (Eq. 20), and sequentially thresholded (STLSQ).

Each iteration of STLSQ (Brunton, Proctor and Kutz 2016, after PySINDy 2.1), for each target on its
own support S: w = (X_S'X_S + ridge I)^-1 X_S'y, then columns with |w| < threshold leave for good.
It stops when nothing has ever left, or when the last two supports agree for all targets.
``unbias``: a last ordinary least squares on the support. `PySindy` is that of PySINDy itself.
"""

import warnings
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from typing import Any, ClassVar, Literal

import numpy as np

from sparsefit.arrays import Array, BoolArray, IntArray
from sparsefit.errors import MissingExtra, described, one_line
from sparsefit.regression.backend import Checked, Solution, setting
from sparsefit.regression.certificate import CertificateKind
from sparsefit.regression.problem import RegressionProblem

UNBIAS_RCOND = 1e-6
SAFE_RCOND = 1e-10  # of Z'Z: below it, refined normal equations lose digits that QR keeps


@dataclass(frozen=True)
class LeastSquares(Checked):
    """argmin_W |Y - theta W|_F, the minimum-norm solution (Eq. 20; LAPACK QR and SVD).

    rcond: singular values of theta below rcond * s_max count as zero. None, the default, is the
    literal reading: the rounding level, eps * max(m, k). Fewer samples than columns are refused
    unless rcond says how to regularise (Section V.B).
    """

    name: ClassVar[str] = "least-squares"
    certificate_kind: ClassVar[CertificateKind] = "normal_equations"
    rcond: float | None = setting(
        None, low=0.0, high=1.0, meaning="it is relative to the largest singular value"
    )

    def solve(self, problem: RegressionProblem) -> Solution:
        """The minimum-norm least-squares weights over the retained singular values."""
        if problem.samples < problem.columns and self.rcond is None:
            return Solution(
                None,
                "error",
                f"{problem.samples} samples are fewer than {problem.columns} columns: the set of "
                "candidates cannot exceed the data (paper, Section V.B); use more samples, fewer "
                "columns, or stlsq, lasso or group-lasso, which do not need it",
            )
        shared = "spectrum" in vars(problem)
        spectrum = problem.spectrum
        retained = spectrum.retained(self.rcond, problem.samples)
        scaled = spectrum.projected[retained] / spectrum.singular_values[retained, None]
        return Solution(
            spectrum.right_vectors[retained].T @ scaled,
            solver_status=f"rank {int(retained.sum())}",
            shared_seconds=spectrum.seconds if shared else 0.0,
        )


@dataclass(frozen=True)
class STLSQ(Checked):
    """Sequentially thresholded least squares.

    mode: ``scaled`` works in columns of unit rms, with ridge relative to Z'Z/m and the threshold
    relative to the rms of the target, so neither depends on units or the number of samples.
    ``pysindy`` is PySINDy's STLSQ: threshold and ridge (its alpha) act on the plain sum of squares.
    threshold: None is 0.03 in mode ``scaled`` and PySINDy's 0.1 in mode ``pysindy``. Columns
    that resemble each other share a ridge's weight: the largest scaled weight is well below 1.
    Raises InputError on settings that are out of range.
    """

    name: ClassVar[str] = "stlsq"
    certificate_kind: ClassVar[CertificateKind] = "fixed_point"
    mode: Literal["scaled", "pysindy"] = "scaled"
    threshold: float | None = setting(None, low=0.0)
    ridge: float = setting(0.05, low=0.0)
    unbias: bool = True
    max_iterations: int = setting(20, least=1)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.threshold is None:
            default = {"scaled": 0.03, "pysindy": 0.1}[self.mode]
            object.__setattr__(self, "threshold", default)

    def solve(self, problem: RegressionProblem) -> Solution:
        """Weights on the support that thresholding leaves."""
        if problem.samples < problem.columns and self.ridge == 0:
            return Solution(
                None,
                "error",
                f"{problem.samples} samples are fewer than {problem.columns} columns and ridge "
                "is 0: the first solve is not unique; set ridge above 0 or use lasso",
            )
        system = _System.of(problem, self)
        support = np.ones((problem.columns, problem.targets), dtype=bool)
        for iteration in range(1, self.max_iterations + 1):
            previous, (values, support) = support, system.thresholded(support)
            if not support.any():
                words = f"threshold {self.threshold:g} removed every column; lower it"
                empty = f"empty support: {words}"
                return Solution(None, "unidentifiable", empty, iterations=iteration)
            if support.all() or (iteration > 1 and np.array_equal(support, previous)):
                break
        names = zip(problem.target_names, support.T, strict=True)
        bare = ", ".join(name for name, on in names if not on.any())
        note = f"support of {bare} is empty" if bare else ""
        return Solution(self._final(system, values, support), reason=note, iterations=iteration)

    def next_weights(self, problem: RegressionProblem, weights: Array) -> Array:
        """The weights (k, n) that one more iteration makes of the support of these."""
        system = _System.of(problem, self)
        return self._final(system, *system.thresholded(weights != 0))

    def _final(self, system: "_System", values: Array, support: BoolArray) -> Array:
        if self.unbias:
            return system.least_squares(support)
        return values / system.scale[:, None]


@dataclass(frozen=True, eq=False)
class _System:
    """Normal equations (k, k) and (k, n) in the units in which ridge and threshold (n,) act.

    scale (k,): of the columns; rows: what the normal equations were divided by.
    """

    problem: RegressionProblem
    gram: Array
    cross: Array
    scale: Array
    ridge: float
    threshold: Array
    rows: int

    @classmethod
    def of(cls, problem: RegressionProblem, settings: STLSQ) -> "_System":
        s, least = problem.statistics, settings.threshold
        assert least is not None  # resolved when the settings were made
        if settings.mode == "scaled":
            limit = least * np.sqrt(s.target_square)
            return cls(problem, s.gram, s.cross, s.rms, settings.ridge, limit, s.samples)
        gram, cross = s.gram * (s.rms[:, None] * s.rms * s.samples), s.cross * s.rms[:, None]
        limit = np.full(len(s.target_square), least)
        ones = np.ones_like(s.rms)
        return cls(problem, gram, cross * s.samples, ones, settings.ridge, limit, 1)

    def thresholded(self, support: BoolArray) -> tuple[Array, BoolArray]:
        """The ridge fits (k, n) on a support (k, n) where they reach the threshold, and where."""
        values = np.zeros(support.shape)
        alike: dict[bytes, list[int]] = {}
        for t in range(support.shape[1]):  # targets that share a support share a factor
            alike.setdefault(support[:, t].tobytes(), []).append(t)
        for targets in alike.values():
            on = np.flatnonzero(support[:, targets[0]])
            if len(on):
                values[on[:, None], targets] = self._ridge_fit(on, targets)
        large = (np.abs(values) >= self.threshold) & support
        return np.where(large, values, 0.0), large

    def _ridge_fit(self, on: IntArray, targets: list[int]) -> Array:
        from scipy.linalg.lapack import dpocon, dpotrf, dpotrs  # an estimator loads without it

        # Whole rows first, which is five times faster than rows and columns at once.
        block = self.gram.take(on, 0).take(on, 1)
        block.flat[:: len(on) + 1] += self.ridge
        size, floor = float(np.trace(block)), len(on) * np.finfo(float).eps
        factor, failed = dpotrf(block.T, lower=1, overwrite_a=1)
        # The ridge bounds |inverse|_1 by sqrt(n) / ridge; only where that is too little, estimate.
        safe = self.ridge > 2.0 * floor * size * np.sqrt(len(on))
        if failed == 0 and (safe or dpocon(factor, size, uplo="L")[0] > floor):
            solution: Array = dpotrs(factor, self.cross[on[:, None], targets], lower=1)[0]
            return solution
        # A ridge that rounds away in Z'Z still counts beside Z: the same problem by its rows.
        design = self.problem.design
        rows = design.columns(on) * (design.rms[on] / self.scale[on])
        columns = np.vstack([rows, np.sqrt(self.ridge * self.rows) * np.eye(len(on))])
        target = np.vstack([self.problem.target[:, targets], np.zeros((len(on), len(targets)))])
        least: Array = np.linalg.lstsq(columns, target, rcond=None)[0]
        return least

    def least_squares(self, support: BoolArray) -> Array:
        """Ordinary least squares of each target on its own support, in the units of theta.

        Singular values below UNBIAS_RCOND of the largest count as zero, as scikit-learn's
        LinearRegression (which PySINDy calls) has them.
        """
        from scipy.linalg.lapack import dpocon, dpotrf, dpotrs

        s, weights = self.problem.statistics, np.zeros(support.shape)
        for t in np.flatnonzero(support.any(axis=0)):
            on = np.flatnonzero(support[:, t])
            columns, target = self.problem.design.columns(on), self.problem.target[:, t]
            factor, failed = dpotrf(s.gram.take(on, 0).take(on, 1), lower=1)
            if failed or dpocon(factor, 1.0 * len(on), uplo="L")[0] < SAFE_RCOND:
                lift = s.rms[on] / self.scale[on]
                least = np.linalg.lstsq(columns * lift, target, rcond=UNBIAS_RCOND)[0]
                weights[on, t] = least / self.scale[on]
                continue
            value = dpotrs(factor, s.cross[on, t], lower=1)[0]
            for _ in range(2):  # corrected semi-normal equations: as accurate as QR here
                gradient = columns.T @ (target - columns @ value) / s.samples
                value = value + dpotrs(factor, gradient, lower=1)[0]
            weights[on, t] = value / s.rms[on]
        return weights


@dataclass(frozen=True)
class PySindy(Checked):
    """PySINDy's own STLSQ, in its conventions: columns as they are (extra peers).

    threshold: of the weights; ridge: PySINDy's alpha. Raises InputError on settings that are out of
    range, and MissingExtra without PySINDy.
    """

    name: ClassVar[str] = "pysindy"
    certificate_kind: ClassVar[CertificateKind] = "fixed_point"
    threshold: float = setting(0.1, low=0.0)
    ridge: float = setting(0.05, low=0.0)
    max_iterations: int = setting(20, least=1)

    def __post_init__(self) -> None:
        super().__post_init__()
        if find_spec("pysindy") is None:
            raise MissingExtra("pysindy is not installed: pip install 'sparsefit[peers]'")

    def solve(self, problem: RegressionProblem) -> Solution:
        """The optimizer's weights; its first warning is its status."""
        package: Any = import_module("pysindy")  # seconds: not before it is needed
        settings = {"alpha": self.ridge, "threshold": self.threshold}
        optimizer = package.STLSQ(max_iter=self.max_iterations, **settings)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            try:
                optimizer.fit(problem.rows.copy(), problem.target.copy())
            except Exception as error:  # a public package may raise anything
                return Solution(None, "error", f"pysindy: {described(error)}", type(error).__name__)
        weights = np.asarray(optimizer.coef_, dtype=float).T
        doubts = [str(w.message) for w in caught if not issubclass(w.category, DeprecationWarning)]
        words = one_line(doubts[0], 120) if doubts else "returned"
        if not weights.any():
            reason = "pysindy: no column is left: lower the threshold"
            return Solution(None, "unidentifiable", reason, words)
        return Solution(weights, solver_status=words)

    def next_weights(self, problem: RegressionProblem, weights: Array) -> Array:
        """The weights (k, n) that one more iteration of ours makes of these."""
        ours = STLSQ("pysindy", self.threshold, self.ridge)
        return ours.next_weights(problem, weights)
