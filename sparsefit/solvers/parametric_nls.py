"""The reference that knows Eq. 1: nonlinear least squares over U0 and k = pi/L, many starts.

    min over U0 > 0, k of |Phi - U0 f(k)|^2,    f = (sin kx cos ky, -cos kx sin ky)

U0 = <f, Phi>/<f, f> in closed form leaves the peaks of h(k) = <f, Phi>^2/<f, f>: all of them are
met by a scan that resolves the lobe, 2 pi/extent, and the highest are climbed by Newton's method.
It has 2 parameters where a length scale of the library has 16: no back-end that does not know the
flow can do better, and it is of no use where Eq. 1 does not hold.
"""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sparsefit.arrays import Array, local_maxima
from sparsefit.errors import integer_setting
from sparsefit.regression.backend import Solution
from sparsefit.regression.certificate import Certificate, CertificateKind
from sparsefit.regression.continuum import Bounds, KnownContinuum
from sparsefit.regression.problem import RegressionProblem
from sparsefit.solvers.continuous_dual import checked_bounds, climb, places_of, refusal

LEAST = 1e-6  # of a row, the mean square of f: below it the sums of a scan err


@dataclass(frozen=True)
class ParametricNLS:
    """U0 and L of one cellular flow; starts: how many of the scan's highest peaks are climbed.

    lower, upper: bounds of the length scale [m]; None takes those of the problem's grid.
    """

    name: ClassVar[str] = "parametric-nls"
    certificate_kind: ClassVar[CertificateKind] = "normal_equations"
    starts: int = 8
    lower: float | None = None
    upper: float | None = None

    def __post_init__(self) -> None:
        integer_setting(self.name, "starts", self.starts, least=1)
        checked_bounds(self.name, self.lower, self.upper)

    def solve(self, problem: RegressionProblem) -> Solution:
        """U0 on ``sin x cos y`` of w_x and -U0 on ``cos x sin y`` of w_y, at the scale found."""
        refused = refusal(self.name, problem, self.lower, self.upper)
        if refused is not None:
            return refused
        continuum, phi = problem.continuum, problem.target
        if not isinstance(continuum, KnownContinuum) or continuum.pattern is None:
            return Solution(
                None,
                "error",
                f"{self.name} knows the flow velocity (w_x, w_y) of cells, not "
                f"({', '.join(problem.target_names)}); use Library(target='flow-velocity') of "
                "family 'cells'",
            )
        known = _Known(continuum, continuum.pattern)
        bounds = continuum.interval(self.lower, self.upper)
        starts, step = _starts(known, phi, bounds, self.starts)
        if not len(starts):
            return Solution(None, "unidentifiable", "no cellular flow of Eq. 1 fits with U0 > 0")
        peaks = [climb(lambda k: _height(known, phi, k), k, step, bounds) for k in starts]
        k = float(max(peaks, key=lambda peak: peak[1])[0][0])
        f = known.jet(k)[0]
        edge = k in bounds
        return Solution(
            float(np.sum(f * phi) / np.sum(f * f)) * continuum.pattern,
            "unidentifiable" if edge else "ok",
            f"the best length scale is at the edge of the interval, {math.pi / k:g} m; widen it"
            if edge
            else "",
            iterations=len(starts),
            problem=problem.at(np.array([k])),
        )

    def certify(self, problem: RegressionProblem, solution: Solution) -> Certificate:
        """Stationarity in (U0, k): max of |<J, R>| / (|J| |Phi|), J = f and U0 df/dk."""
        wavenumbers, weights = places_of(solution)
        assert isinstance(problem.continuum, KnownContinuum)
        assert problem.continuum.pattern is not None
        known = _Known(problem.continuum, problem.continuum.pattern)
        f, slope, _ = known.jet(float(wavenumbers[0, 0]))
        pattern = known.pattern
        speed = float(np.sum(weights * pattern) / np.sum(pattern * pattern))
        residual = problem.target - speed * f
        size = float(np.linalg.norm(problem.target)) or 1.0
        parts = [abs(float(np.sum(j * residual))) / float(np.linalg.norm(j)) for j in (f, slope)]
        return Certificate("normal_equations", max(parts) / size)


@dataclass(frozen=True, eq=False)
class _Known:
    """The flow f(k) = theta(k) S (m, n) that is known up to its speed."""

    continuum: KnownContinuum
    pattern: Array

    def jet(self, k: float) -> tuple[Array, Array, Array]:
        """f (m, n) and its first and second derivatives by k."""
        columns = self.continuum.columns(np.array([[k]]))
        value, slope, bend = (part.reshape(len(self.pattern), -1) for part in columns)
        return value.T @ self.pattern, slope.T @ self.pattern, bend.T @ self.pattern


def _height(known: _Known, phi: Array, k: Array) -> tuple[float, Array, Array]:
    """h = a^2/b and its derivatives by k (1,), a = <f, Phi>, b = <f, f>; 0 where U0 < 0 fits."""
    f, slope, bend = known.jet(float(k[0]))
    a, da, dda = (float(np.sum(part * phi)) for part in (f, slope, bend))
    b, db = float(np.sum(f * f)), 2 * float(np.sum(f * slope))
    ddb = 2 * float(np.sum(slope * slope) + np.sum(f * bend))
    u = a / b
    rate = 2 * u * da - u * u * db
    du = (da - u * db) / b
    turn = 2 * u * dda + 2 * du * da - 2 * u * du * db - u * u * ddb
    return a * u if a > 0 else 0.0, np.array([rate]), np.array([[turn]])


def _starts(known: _Known, phi: Array, bounds: Bounds, most: int) -> tuple[Array, Array]:
    """The highest peaks (j, 1) of h on a scan of the interval, and the scan's step (1,)."""
    scan = known.continuum.scan(bounds)
    a, b = scan.matched(known.pattern, phi)
    height = np.where(a > 0, a * a / np.maximum(b, LEAST * len(phi)), 0.0)
    tops = local_maxima(height)
    tops = tops[height[tops] > 0]
    return scan.wavenumbers[tops[:most]][:, None], np.array([scan.step])
