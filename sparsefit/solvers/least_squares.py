"""Least squares, as the paper prints it (Eq. 20), and sequentially thresholded (STLSQ).

Each iteration of STLSQ (Brunton, Proctor and Kutz 2016, after PySINDy 2.1), for each target on its
own support S: w = (X_S'X_S + ridge I)^-1 X_S'y, then columns with |w| < threshold leave for good.
It stops when nothing has ever left, or when the last two supports agree for all targets.
``unbias``: a last ordinary least squares on the support. Supports of many sparse columns, of which
X_S'X_S has more entries than X, are solved by conjugate gradients. `PySindy` is that of PySINDy
itself.
"""

from dataclasses import dataclass
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from typing import Any, ClassVar, Literal

import numpy as np

from sparsefit.arrays import Array, BoolArray, IntArray
from sparsefit.errors import InputError, MissingExtra
from sparsefit.regression.backend import Checked, Solution, heard, setting
from sparsefit.regression.certificate import CertificateKind
from sparsefit.regression.problem import RegressionProblem
from sparsefit.solvers.newton import by_gradients

FEW = 2000  # columns, whose Z'Z is formed once for every support


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
            words = f"{problem.samples} samples are fewer than {problem.columns} columns: the set "
            words += "of candidates cannot exceed the data (paper, Section V.B); use more samples, "
            words += "fewer columns, or stlsq, lasso or group-lasso, which do not need it"
            return Solution(None, "error", words)
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
            words = f"{problem.samples} samples are fewer than {problem.columns} columns and ridge "
            words += "is 0: the first solve is not unique; set ridge above 0 or use lasso"
            return Solution(None, "error", words)
        support = np.ones((problem.columns, problem.targets), dtype=bool)
        for iteration in range(1, self.max_iterations + 1):
            previous, (values, support) = support, self._thresholded(problem, support)
            if not support.any():
                words = f"threshold {self.threshold:g} removed every column; lower it"
                empty = f"empty support: {words}"
                return Solution(None, "unidentifiable", empty, iterations=iteration)
            if support.all() or (iteration > 1 and np.array_equal(support, previous)):
                break
        names = zip(problem.target_names, support.T, strict=True)
        bare = ", ".join(name for name, on in names if not on.any())
        note = f"support of {bare} is empty" if bare else ""
        weights = self._unscaled(problem, values, support)
        return Solution(weights, reason=note, iterations=iteration)

    def next_weights(self, problem: RegressionProblem, weights: Array) -> Array:
        """The weights (k, n) that one more iteration makes of the support of these."""
        return self._unscaled(problem, *self._thresholded(problem, weights != 0))

    def _rule(self, problem: RegressionProblem) -> tuple[Array, Array, Array]:
        """In columns of unit rms: ridge (k,), threshold (k, n), and the unit (k,) of a column."""
        rms, level = problem.design.rms, np.sqrt(problem.target_square)
        assert self.threshold is not None  # it was resolved when the settings were made
        if self.mode == "scaled":
            unit = np.ones(len(rms))
            return self.ridge * unit, self.threshold * np.multiply.outer(unit, level), unit
        limit = self.threshold * np.multiply.outer(rms, np.ones(len(level)))
        return self.ridge / (problem.samples * rms**2), limit, rms

    def _thresholded(
        self, problem: RegressionProblem, support: BoolArray
    ) -> tuple[Array, BoolArray]:
        """Ridge fits V (k, n) on a support (k, n) where they reach the threshold, and where."""
        ridge, limit, unit = self._rule(problem)
        values = _fits(problem, support, unit, ridge)
        large = (np.abs(values) >= limit) & support
        return np.where(large, values, 0.0), large

    def _unscaled(self, problem: RegressionProblem, values: Array, support: BoolArray) -> Array:
        """Weights in the units of theta: of the ridge fits, or least squares on their support."""
        if self.unbias:
            values = _fits(problem, support, self._rule(problem)[2])
        return values / problem.design.rms[:, None]


def _fits(problem: RegressionProblem, support: BoolArray, unit: Array, ridge: Any = None) -> Array:
    """`_solved` (k, n) on each target's support (k, n), unit and ridge (k,)."""
    values, alike = np.zeros(support.shape), dict[bytes, list[int]]()
    for t in np.flatnonzero(support.any(axis=0)).tolist():
        alike.setdefault(support[:, t].tobytes(), []).append(t)  # who share it share a factor
    for targets in map(np.array, alike.values()):
        on = np.flatnonzero(support[:, targets[0]])
        own = None if ridge is None else ridge[on]
        values[np.ix_(on, targets)] = _solved(problem, on, targets, unit[on], own)
    return values


def _solved(
    problem: RegressionProblem, on: IntArray, targets: IntArray, unit: Array, ridge: Any = None
) -> Array:
    """argmin over V (j, t) of |Y - Z_J V|^2/m + V'DV, D = diag(ridge), ridge (j,).

    unit (j,): of the columns, in which V is of least norm where it is not unique. Without a ridge,
    singular values below 1e-6 of the largest count as zero, as scikit-learn's LinearRegression
    (which PySINDy calls) has them. Raises InputError where a ridge is lost to rounding beside
    thousands of columns.
    """
    from scipy.linalg.lapack import dpocon, dpotrf, dpotrs  # an estimator loads without it

    design, right, count = problem.design, problem.target[:, targets], len(on)
    is_plain = ridge is None
    ridge = np.zeros(count) if is_plain else ridge
    size, is_wide = float(count + ridge.sum()), count > len(right)
    if count > FEW and not design.in_memory and (design.kind == "sparse" or is_wide):
        return _by_gradients(problem, on, targets, ridge)  # Z'Z would be larger than the columns
    floor = 1e-10 if is_plain else count * np.finfo(float).eps
    # The ridge bounds |inverse|_1 by sqrt(n) / ridge; only where that is too little, estimate.
    safe = ridge.min() > 2.0 * floor * size * np.sqrt(count)
    if safe and is_wide and design.in_memory:
        columns = design.columns(on)  # D^-1 Z'(Z D^-1 Z'/m + I)^-1 Y/m of Z (m, j)
        square = (columns / ridge) @ columns.T / problem.samples
        square.flat[:: len(square) + 1] += 1.0
        factor = dpotrf(square.T, lower=1, overwrite_a=1)[0]
        pull = columns.T @ dpotrs(factor, right / problem.samples, lower=1)[0]
        return np.asarray(pull / ridge[:, None])
    if not (safe or is_plain) and is_wide and count > FEW:
        words = f"stlsq: its ridge is lost to rounding beside {count} columns"
        raise InputError(f"{words} of {len(right)} samples: raise it, or use lasso")
    factor, failed = None, is_wide and not safe
    if not failed:
        if count < problem.columns and problem.columns > FEW:
            block = design.products(on)
        else:  # whole rows first, which is five times faster than rows and columns at once
            block = design.gram.take(on, 0).take(on, 1)
        block.flat[:: count + 1] += ridge
        factor, failed = dpotrf(block.T, lower=1, overwrite_a=1)
    if failed or not (safe or dpocon(factor, size, uplo="L")[0] > floor):
        columns = design.columns(on) * unit
        if not is_plain:  # a ridge that rounds away in Z'Z still counts beside Z
            lift = unit * np.sqrt(ridge * problem.samples)
            columns = np.vstack([columns, np.diag(lift)])
            right = np.vstack([right, np.zeros((count, len(targets)))])
        least = np.linalg.lstsq(columns, right, rcond=1e-6 if is_plain else None)[0]
        return np.asarray(least * unit[:, None])
    values: Array = dpotrs(factor, problem.cross[np.ix_(on, targets)], lower=1)[0]
    if is_plain:
        columns = design.columns(on)
        for _ in range(2):  # corrected semi-normal equations: as accurate as QR here
            gradient = columns.T @ (right - columns @ values) / problem.samples
            values = values + dpotrs(factor, gradient, lower=1)[0]
    return values


def _by_gradients(
    problem: RegressionProblem, on: IntArray, targets: IntArray, ridge: Array
) -> Array:
    """V (j, t) of (Z_J'Z_J/m + D) V = Z_J'Y/m by conjugate gradients from zero, D = diag(ridge).

    Without a ridge, of the solutions that of least norm. Raises InputError where columns are so
    alike that these do not converge.
    """
    whole = np.zeros((problem.columns, len(targets)))
    root = np.sqrt(1.0 + ridge)[:, None]  # of the diagonal, which scales the system

    def times(x: Array) -> Array:
        whole[on] = x / root
        image = problem.design.correlate(problem.design.predict(whole))[on]
        return (image + ridge[:, None] * whole[on]) / root

    x, steps, is_solved = by_gradients(times, problem.cross[np.ix_(on, targets)] / root)
    if is_solved:
        solution: Array = x / root
        return solution
    words = f"stlsq: {len(on)} of the columns are too alike for {steps} conjugate gradients"
    raise InputError(f"{words}: raise its ridge or its threshold, or use lasso")


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
        fitting = partial(optimizer.fit, problem.rows.copy(), problem.target.copy())
        answer, said = heard(self.name, fitting)
        if answer is None:
            return said
        weights = np.asarray(optimizer.coef_, dtype=float).T
        if not weights.any():
            reason = "pysindy: no column is left: lower the threshold"
            return Solution(None, "unidentifiable", reason, said.solver_status)
        return Solution(weights, solver_status=said.solver_status)

    def next_weights(self, problem: RegressionProblem, weights: Array) -> Array:
        """The weights (k, n) that one more iteration of ours makes of these."""
        ours = STLSQ("pysindy", self.threshold, self.ridge)
        return ours.next_weights(problem, weights)
