"""Sequentially thresholded least squares (Brunton, Proctor & Kutz 2016), after PySINDy 2.1.

Each iteration, for each target on its own support S: w = (X_S'X_S + ridge I)^-1 X_S'y, then
columns with |w| < threshold leave for good. It stops when nothing has ever left, or when the
last two supports agree for all targets. ``unbias``: a last ordinary least squares on the support.
"""

from dataclasses import dataclass
from typing import ClassVar, Literal, get_args

import numpy as np

from sparsefit.arrays import Array, BoolArray, IntArray
from sparsefit.errors import InputError, flag_setting, integer_setting, number_setting, one_of
from sparsefit.regression.backend import Solution
from sparsefit.regression.certificate import CertificateKind
from sparsefit.regression.problem import RegressionProblem

Mode = Literal["scaled", "pysindy"]
UNBIAS_RCOND = 1e-6
DEFAULT_THRESHOLD = {"scaled": 0.03, "pysindy": 0.1}
SAFE_RCOND = (
    1e-10  # of the Gram matrix: below it, refined normal equations lose digits that QR keeps
)


@dataclass(frozen=True)
class STLSQ:
    """Sequentially thresholded least squares.

    mode: ``scaled`` works in columns of unit rms, with ridge relative to Z'Z/m and the threshold
    relative to the rms of the target, so neither depends on units or the number of samples.
    ``pysindy`` is PySINDy's STLSQ: threshold and ridge (its alpha) act on the plain sum of
    squares; ``normalize_columns`` divides columns by their 2-norm first, as its option does.
    threshold: None is 0.03 in mode ``scaled`` and PySINDy's 0.1 in mode ``pysindy``. Columns
    that resemble each other share a ridge's weight: the largest scaled weight is well below 1.
    Raises InputError on settings that are out of range.
    """

    name: ClassVar[str] = "stlsq"
    certificate_kind: ClassVar[CertificateKind] = "fixed_point"
    mode: Mode = "scaled"
    threshold: float | None = None
    ridge: float = 0.05
    unbias: bool = True
    max_iterations: int = 20
    normalize_columns: bool = False

    def __post_init__(self) -> None:
        one_of("mode of stlsq", self.mode, get_args(Mode))
        if self.threshold is None:
            object.__setattr__(self, "threshold", DEFAULT_THRESHOLD[self.mode])
        number_setting(self.name, "threshold", self.threshold, low=0.0)
        number_setting(self.name, "ridge", self.ridge, low=0.0)
        integer_setting(self.name, "max_iterations", self.max_iterations, least=1)
        for flag in ("unbias", "normalize_columns"):
            flag_setting(self.name, flag, getattr(self, flag))
        if self.normalize_columns and self.mode == "scaled":
            raise InputError(
                "stlsq: normalize_columns belongs to mode 'pysindy'; mode 'scaled' always scales"
            )

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
        previous = support
        for iteration in range(1, self.max_iterations + 1):
            previous, (values, support) = support, self._step(problem, system, support)
            if not support.any():
                return Solution(
                    None,
                    "unidentifiable",
                    f"empty support: threshold {_threshold(self):g} removed every column; lower it",
                    iterations=iteration,
                )
            if support.all() or (iteration > 1 and np.array_equal(support, previous)):
                break
        weights = values / system.scale[:, None]
        if self.unbias:
            weights = _least_squares_on(problem, system, support)
        empty = [
            name for name, on in zip(problem.target_names, support.T, strict=True) if not on.any()
        ]
        note = f"support of {', '.join(empty)} is empty" if empty else ""
        return Solution(weights, reason=note, iterations=iteration)

    def next_weights(self, problem: RegressionProblem, weights: Array) -> Array:
        """The weights (k, n) that one more iteration makes of the support of these."""
        system = _System.of(problem, self)
        values, support = self._step(problem, system, weights != 0)
        if self.unbias:
            return _least_squares_on(problem, system, support)
        return values / system.scale[:, None]

    def _step(
        self, problem: RegressionProblem, system: "_System", support: BoolArray
    ) -> tuple[Array, BoolArray]:
        values = np.zeros(support.shape)
        for targets in _alike(support):
            on = np.flatnonzero(support[:, targets[0]])
            if len(on):
                values[on[:, None], targets] = _ridge_solve(problem, system, on, targets)
        kept = (np.abs(values) >= system.threshold) & support
        return np.where(kept, values, 0.0), kept


@dataclass(frozen=True, eq=False)
class _System:
    """Normal equations in the units in which ridge and threshold act."""

    gram: Array
    cross: Array
    scale: Array
    ridge: float
    threshold: Array
    rows: int  # what the normal equations were divided by

    @classmethod
    def of(cls, problem: RegressionProblem, settings: STLSQ) -> "_System":
        s = problem.statistics
        if settings.mode == "scaled":
            threshold = _threshold(settings) * np.sqrt(s.target_square)
            return cls(s.gram, s.cross, s.rms, settings.ridge, threshold, s.samples)
        scale = s.rms * np.sqrt(s.samples) if settings.normalize_columns else np.ones_like(s.rms)
        lift = s.rms / scale
        gram = s.gram * (lift[:, None] * lift * s.samples)
        cross = s.cross * (lift[:, None] * s.samples)
        threshold = np.full(len(s.target_square), _threshold(settings))
        return cls(gram, cross, scale, settings.ridge, threshold, 1)


def _threshold(settings: STLSQ) -> float:
    assert settings.threshold is not None  # resolved when the settings were made
    return settings.threshold


def _alike(support: BoolArray) -> list[list[int]]:
    """Targets by their support: those that share one, as all do at first, share a factor."""
    found: dict[bytes, list[int]] = {}
    for t in range(support.shape[1]):
        found.setdefault(support[:, t].tobytes(), []).append(t)
    return list(found.values())


def _square(gram: Array, on: IntArray) -> Array:
    """Rows and columns ``on``: whole rows first, which is five times faster than at once."""
    block: Array = gram.take(on, 0).take(on, 1)
    return block


def _ridge_solve(
    problem: RegressionProblem, system: _System, on: IntArray, targets: list[int]
) -> Array:
    from scipy.linalg.lapack import dpocon, dpotrf, dpotrs  # loading an estimator needs none of it

    full = len(on) == len(system.gram)
    block = system.gram.copy() if full else _square(system.gram, on)
    block.flat[:: len(on) + 1] += system.ridge
    size, floor = float(np.trace(block)), len(on) * np.finfo(float).eps
    factor, failed = dpotrf(block.T, lower=1, overwrite_a=1)
    # The ridge bounds |inverse|_1 by sqrt(n) / ridge; only where that is too little, estimate.
    safe = system.ridge > 2.0 * floor * size * np.sqrt(len(on))
    if failed == 0 and (safe or dpocon(factor, size, uplo="L")[0] > floor):
        solution: Array = dpotrs(factor, system.cross[on[:, None], targets], lower=1)[0]
        return solution
    # A ridge that rounds away in Z'Z still counts beside Z: the same problem by its rows.
    damping = np.sqrt(system.ridge * system.rows) * np.eye(len(on))
    rows = problem.design.columns(on) * (problem.design.rms[on] / system.scale[on])
    columns = np.vstack([rows, damping])
    target = np.vstack([problem.target[:, targets], np.zeros((len(on), len(targets)))])
    least: Array = np.linalg.lstsq(columns, target, rcond=None)[0]
    return least


def _least_squares_on(problem: RegressionProblem, system: _System, support: BoolArray) -> Array:
    """Ordinary least squares of each target on its own support, in the units of theta.

    Singular values below UNBIAS_RCOND of the largest count as zero, as scikit-learn's
    LinearRegression (which PySINDy calls) has them.
    """
    from scipy.linalg.lapack import dpocon, dpotrf, dpotrs  # loading an estimator needs none of it

    s = problem.statistics
    weights = np.zeros(support.shape)
    for t in range(support.shape[1]):
        on = np.flatnonzero(support[:, t])
        if not len(on):
            continue
        columns, target = problem.design.columns(on), problem.target[:, t]
        factor, failed = dpotrf(_square(s.gram, on), lower=1)
        if failed or dpocon(factor, 1.0 * len(on), uplo="L")[0] < SAFE_RCOND:
            lift = s.rms[on] / system.scale[on]
            least = np.linalg.lstsq(columns * lift, target, rcond=UNBIAS_RCOND)[0]
            weights[on, t] = least / system.scale[on]
            continue
        value = dpotrs(factor, s.cross[on, t], lower=1)[0]
        for _ in range(2):  # corrected semi-normal equations: as accurate as QR here
            gradient = columns.T @ (target - columns @ value) / s.samples
            value = value + dpotrs(factor, gradient, lower=1)[0]
        weights[on, t] = value / s.rms[on]
    return weights
