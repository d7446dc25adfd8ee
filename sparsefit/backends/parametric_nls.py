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

from sparsefit.arrays import Array
from sparsefit.backends.continuous_dual import MODES, Scanner, climb
from sparsefit.backends.off_grid import checked_bounds, columns_at, found_by, interval, refusal
from sparsefit.errors import integer_setting
from sparsefit.library.builder import CANDIDATES, TARGET_NAMES
from sparsefit.regression.backend import Solution
from sparsefit.regression.certificate import Certificate, CertificateKind
from sparsefit.regression.problem import RegressionProblem

Columns = tuple[Array, Array, Array]


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
        assert problem.position is not None
        if problem.target_names != TARGET_NAMES["flow-velocity"]:
            return Solution(
                None,
                "error",
                f"{self.name} knows the flow velocity (w_x, w_y), not "
                f"({', '.join(problem.target_names)}); use Library(target='flow-velocity')",
            )
        position, phi = problem.position, problem.target
        bounds = interval(problem, self.lower, self.upper)
        starts, step = _starts(position, phi, bounds, self.starts)
        if not len(starts):
            return Solution(None, "unidentifiable", "no cellular flow of Eq. 1 fits with U0 > 0")
        peaks = [climb(lambda k: _height(position, phi, k), k, step, bounds) for k in starts]
        k = max(peaks, key=lambda peak: peak[1])[0]
        found = columns_at(problem, np.array([math.pi / k]))
        f = _flow(position, k)[0]
        weights = np.zeros((len(CANDIDATES), 2))
        weights[_SIN_COS, 0] = float(np.sum(f * phi) / np.sum(f * f))
        weights[_COS_SIN, 1] = -weights[_SIN_COS, 0]
        edge = k in bounds
        return Solution(
            weights,
            "unidentifiable" if edge else "ok",
            f"the best length scale is at the edge of the interval, {math.pi / k:g} m; widen it"
            if edge
            else "",
            iterations=len(starts),
            problem=found,
        )

    def certify(self, problem: RegressionProblem, solution: Solution) -> Certificate:
        """Stationarity in (U0, k): max of |<J, R>| / (|J| |Phi|), J = f and U0 df/dk."""
        scales, weights = found_by(solution)
        assert problem.position is not None
        k = math.pi / float(scales[0])
        f, slope, _ = _flow(problem.position, k)
        residual = problem.target - float(weights[_SIN_COS, 0]) * f
        size = float(np.linalg.norm(problem.target)) or 1.0
        parts = [abs(float(np.sum(j * residual))) / float(np.linalg.norm(j)) for j in (f, slope)]
        return Certificate("normal_equations", max(parts) / size)


_SIN_COS, _COS_SIN = CANDIDATES.index("sin x cos y"), CANDIDATES.index("cos x sin y")


def _flow(position: Array, k: float) -> Columns:
    """f (m, 2) and its first and second derivatives by k."""
    s, (x, y) = k * position, position.T
    (sin_x, sin_y), (cos_x, cos_y) = np.sin(s).T, np.cos(s).T
    u, v = sin_x * cos_y, cos_x * sin_y
    both, cross, twice = x * cos_x * cos_y, sin_x * sin_y, x * x + y * y
    du, dv = both - y * cross, y * cos_x * cos_y - x * cross
    ddu, ddv = -twice * u - 2 * x * y * v, -twice * v - 2 * x * y * u
    return (
        np.column_stack([u, -v]),
        np.column_stack([du, -dv]),
        np.column_stack([ddu, -ddv]),
    )


def _height(position: Array, phi: Array, k: float) -> tuple[float, float, float]:
    """h = a^2/b and its derivatives by k, a = <f, Phi>, b = <f, f>; 0 where U0 would be < 0."""
    f, slope, bend = _flow(position, k)
    a, da, dda = (float(np.sum(part * phi)) for part in (f, slope, bend))
    b, db = float(np.sum(f * f)), 2 * float(np.sum(f * slope))
    ddb = 2 * float(np.sum(slope * slope) + np.sum(f * bend))
    u = a / b
    rate = 2 * u * da - u * u * db
    du = (da - u * db) / b
    turn = 2 * u * dda + 2 * du * da - 2 * u * du * db - u * u * ddb
    return (a * u, rate, turn) if a > 0 else (0.0, rate, turn)


def _starts(
    position: Array, phi: Array, bounds: tuple[float, float], most: int
) -> tuple[Array, float]:
    """The highest peaks of h on a scan of the interval, and the scan's step."""
    scanner = Scanner.of(position, bounds)
    loads = np.ascontiguousarray(phi.T)
    plus, minus = (scanner.sums(mode, loads) for mode in MODES[2:])
    wide = [scanner.sums(2 * mode, loads[:0])[0].real for mode in MODES[2:]]
    # sin x cos y = (sin(x + y) + sin(x - y)) / 2, and sums hold exp(-i k s).
    a = 0.5 * (-(plus[1] + minus[1]) + (plus[2] - minus[2])).imag
    b = 0.5 * len(phi) - 0.25 * (wide[0] + wide[1])
    height = np.where(a > 0, a * a / np.maximum(b, 1e-6 * len(phi)), 0.0)
    padded = np.concatenate([[0.0], height, [0.0]])
    top = np.flatnonzero((height > 0) & (height >= padded[:-2]) & (height >= padded[2:]))
    return scanner.wavenumbers[top[np.argsort(-height[top], kind="stable")][:most]], scanner.step
