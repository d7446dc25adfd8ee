"""Back-ends over a continuum of columns: a gridless group-LASSO, and least squares of Eq. 1.

The limit of ever finer grids (see `continuous_dual` for the problem P and its certificate), of the
paper's cells over the length scale and of waves over the plane of wavevectors, by sliding Frank-
Wolfe: each round the places of largest eta join; a group-LASSO on the groups at hand sets the
weights and drops what is not needed; places and weights slide downhill together, by Newton's
method. With R the residual, D_jp = dZ/dq_p (q_j), A_jp = D_jp V_j and u = V_j / |V_j|,

    dP/dV_j = alpha u - Z_j'R / m                       dP/dq_jp = -<R, A_jp> / m
    d2P/dV_i dV_j = Z_i'Z_j / m (x) I + [i = j] alpha (I - u u') / |V_j|
    d2P/dV_i dq_jp = Z_i'A_jp / m - [i = j] D_jp'R / m
    d2P/dq_ip dq_jr = <A_ip, A_jr> / m - [i = j] <R, d2Z/dq_p dq_r V_j> / m

Source: Denoyelle, Duval, Peyre and Soubies, "The sliding Frank-Wolfe algorithm and its application
to super-resolution microscopy" (2019).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sparsefit.arrays import Array
from sparsefit.errors import InputError, integer_setting, is_number
from sparsefit.regression.backend import Solution, checked_alpha_fraction
from sparsefit.regression.certificate import Certificate, CertificateKind
from sparsefit.regression.continuous_columns import Bounds, Continuum
from sparsefit.regression.group_penalties import GroupNorms
from sparsefit.regression.problem import RegressionProblem
from sparsefit.solvers.continuous_dual import (
    Curve,
    Jet,
    Scanner,
    block_norms,
    continuous_alpha_max,
    continuous_gap,
    gap_of,
    known_column,
    newton,
)
from sparsefit.solvers.kernels import path_on_gram

POINTS = 4_000_000  # of a scan: beyond it, memory
ROUNDS, PATIENCE = 60, 12  # of Frank-Wolfe, and those without a smaller gap
STOP = 1e-10  # relative duality gap, below any tolerance the certificate is asked to meet
APART = 0.3  # in 1/extent: nearer groups than this are one lobe, and are tried as one


@dataclass(frozen=True, eq=False)
class Atoms:
    """Places q (s, p) and scaled weights V (s, c, n), with what they make of Y.

    residual (m, n); value: P; jet: Z and its derivatives at q.
    """

    places: Array
    weights: Array
    jet: Jet
    residual: Array
    value: float

    @classmethod
    def at(
        cls, continuum: Continuum, target: Array, places: Array, weights: Array, alpha: float
    ) -> Atoms:
        """Evaluate P for a target Y (m, n) at places q (s, p) with scaled weights V (s, c, n)."""
        jet, m = Jet.of(*continuum.columns(places)), len(target)
        flat = weights.reshape(-1, weights.shape[-1])
        residual = target - jet.value.reshape(-1, m).T @ flat
        value = float(np.sum(residual**2)) / (2 * m) + alpha * float(block_norms(weights).sum())
        return cls(places, weights, jet, residual, value)

    def derivatives(self, alpha: float, spans: Array) -> tuple[Array, Array]:
        """Gradient (N,) and Hessian (N, N) of P in (q spans, V), spans (s, p).

        N = p s + c s n: q as (s, p), then V as (s, c, n).
        """
        (s, c, n), (m, _), p = self.weights.shape, self.residual.shape, spans.shape[1]
        jet, residual, weights, count = self.jet, self.residual, self.weights, s * p
        z = jet.value.reshape(c * s, m)
        slope = jet.slope / spans[:, :, None, None]
        bent = weights.transpose(0, 2, 1)[:, None] @ slope  # A_jp' (s, p, n, m)
        flat = bent.reshape(count, n * m)
        norms = np.maximum(block_norms(weights), 1e-300)
        unit = weights / norms[:, None, None]
        gradient_v = alpha * unit - (z @ residual / m).reshape(s, c, n)
        hessian = np.zeros((count + c * s * n, count + c * s * n))
        bend = np.sum((jet.bend @ residual) * weights[:, None, None], axis=(3, 4)) / m
        own = (flat @ flat.T / m).reshape(s, p, s, p)
        own[range(s), :, range(s)] -= bend / (spans[:, :, None] * spans[:, None])
        hessian[:count, :count] = own.reshape(count, count)
        mixed = (bent.reshape(count * n, m) @ z.T / m).reshape(s, p, n, s, c)
        mixed = mixed.transpose(0, 1, 3, 4, 2).copy()
        mixed[range(s), :, range(s)] -= slope @ residual / m
        hessian[:count, count:] = mixed.reshape(count, -1)
        hessian[count:, :count] = hessian[:count, count:].T
        hessian[count:, count:] = np.kron(z @ z.T / m, np.eye(n))
        for j in range(s):
            block, u = slice(count + c * n * j, count + c * n * (j + 1)), unit[j].ravel()
            hessian[block, block] += alpha / norms[j] * (np.eye(c * n) - np.outer(u, u))
        return np.concatenate([-flat @ residual.T.ravel() / m, gradient_v.ravel()]), hessian


@dataclass(frozen=True, eq=False)
class Sliding:
    """Sliding Frank-Wolfe on a target Y (m, n) at one alpha, wavenumbers within bounds."""

    continuum: Continuum
    target: Array
    alpha: float
    bounds: Bounds

    def at(self, places: Array, weights: Array) -> Atoms:
        """The atoms at places q (s, p) with scaled weights V (s, c, n)."""
        return Atoms.at(self.continuum, self.target, places, weights, self.alpha)

    def solve(self, scanner: Scanner, first: Array) -> tuple[Atoms, int, bool]:
        """Atoms, rounds, and whether the gap reached STOP, from a first place (p,)."""
        nothing = np.zeros((1, self.continuum.size, self.target.shape[1]))
        best = atoms = self.at(first[None], nothing)
        least, since = math.inf, 0
        for rounds in range(ROUNDS):
            peaks = scanner.peaks(atoms.residual)
            norm, top = float(block_norms(atoms.weights).sum()), peaks[0][1]
            gap = gap_of(atoms.residual, self.target, self.alpha, norm, top).value
            if gap < least:
                best, least, since = atoms, gap, rounds
            if least <= STOP or rounds - since >= PATIENCE:
                return best, rounds, least <= STOP
            # Peaks of eta - 1 this close to the highest join in the same round.
            wanted = self.alpha + 0.7 * (top - self.alpha)
            new = [place for place, height in peaks if height >= wanted]
            merged: Atoms | None = self.slide(*self.corrected(atoms, np.array(new), 1e-3 * gap))
            while merged is not None:
                atoms, merged = merged, self.merged(merged)
        return best, ROUNDS, False

    def corrected(self, atoms: Atoms, new: Array, tolerance: float) -> tuple[Array, Array]:
        """The group-LASSO on old and new groups: those that it keeps, and their weights."""
        (m, n), size = self.target.shape, self.continuum.size
        q = np.unique(np.concatenate([atoms.places, new]), axis=0)
        z = Jet.of(*self.continuum.columns(q)).value.reshape(-1, m)
        penalty = GroupNorms(np.repeat(np.arange(len(q)), size), np.ones(len(q)))
        square = float(np.sum(self.target**2)) / m
        gram, cross = z @ z.T / m, z @ self.target / m
        path = path_on_gram(gram, cross, penalty, np.array([self.alpha]), square, tolerance)
        weights = path.values[0].reshape(-1, size, n)
        used = np.any(weights != 0, axis=(1, 2))
        used = used if used.any() else np.arange(len(q)) == 0
        return q[used], weights[used]

    def slide(self, places: Array, weights: Array) -> Atoms:
        """The stationary point of P that Newton's method reaches from (q, V), less what fades."""
        spans, size = self.continuum.spans(places), places.size

        def atoms(x: Array) -> Atoms:
            q = x[:size].reshape(places.shape) / spans
            return self.at(q, x[size:].reshape(weights.shape))

        def curve(x: Array) -> Curve:
            here = atoms(x)
            return here.value, *here.derivatives(self.alpha, spans)

        start = np.concatenate([(places * spans).ravel(), weights.ravel()])
        low, high = np.full_like(start, -math.inf), np.full_like(start, math.inf)
        step = places.shape[1]
        for side, bound in zip((low, high), self.bounds, strict=True):
            side[:size:step] = bound * spans[:, 0]
        longest = np.where(np.arange(len(start)) < size, 0.5, math.inf)  # within a lobe
        null = float(np.sum(self.target**2)) / (2 * len(self.target)) or 1.0
        there = atoms(newton(curve, start, (low, high), longest, null))
        norms = block_norms(there.weights)
        used = norms > 1e-9 * norms.max()
        if used.all() or not used.any():
            return there
        return self.at(there.places[used], there.weights[used])

    def merged(self, atoms: Atoms) -> Atoms | None:
        """The two nearest groups as one, where that is no worse; None where they stay two."""
        order = np.argsort(atoms.places[:, 0])
        q, v = atoms.places[order], atoms.weights[order]
        if len(q) < 2:
            return None
        images, signs = self.continuum.images(q)
        apart = np.linalg.norm((images[:, None] - q[:, None]) * self.continuum.spans(q)[:, None],
                               axis=3)  # fmt: skip
        apart[:, np.tri(len(q), dtype=bool)] = math.inf  # image, one group, the other above it
        image, i, j = np.unravel_index(int(np.argmin(apart)), apart.shape)
        if apart[image, i, j] > APART:
            return None
        other, weights = images[image, j], v[j] * signs[image][:, None]
        share = np.array([np.linalg.norm(v[i]), np.linalg.norm(weights)])
        if share.sum() > 0:
            q[i] = share @ np.stack([q[i], other]) / share.sum()
        v[i] += weights
        rest = np.arange(len(q)) != j
        joint = self.slide(q[rest], v[rest])
        return joint if joint.value <= atoms.value * (1 + 1e-12) else None


def _refusal(
    name: str, problem: RegressionProblem, lower: float | None, upper: float | None
) -> Solution | None:
    """Why a back-end that makes its own columns cannot search [lower, upper]; None if it can."""
    continuum = problem.continuum
    if continuum is None:
        return Solution(
            None,
            "error",
            f"{name} makes its own columns and needs the position of every row; build the problem "
            "with Library of family 'cells', or of one flight 'waves' in groups by wave, where the "
            "vehicle is known and whose columns fit in memory (a coarser grid or fewer samples "
            "where they do not), from samples and not averages; or use group-lasso",
        )
    if not continuum.extent > 0:
        return Solution(None, "unidentifiable", f"{name}: the flight stands still: no extent")
    if continuum.scan_points(continuum.interval(lower, upper)) > POINTS:
        return Solution(
            None,
            "error",
            f"{name}: the extent of the flight holds more than {POINTS} scan points "
            "between the bounds; raise lower, or use fewer cells of the flight",
        )
    return None


def _check_bounds(name: str, lower: float | None, upper: float | None) -> None:
    """Raise InputError unless the bounds [m] are positive and in order; None is open."""
    for key, value in (("lower", lower), ("upper", upper)):
        if value is not None and not is_number(value, 0.0, open_low=True):
            raise InputError(f"{name}: {key} must be a length above 0 m, not {value!r}")
    if lower is not None and upper is not None and lower > upper:
        raise InputError(f"{name}: lower ({lower:g} m) is above upper ({upper:g} m); swap them")


def _placed(solution: Solution) -> tuple[Continuum, Array, Array]:
    """The continuum, places q (s, p) and weights (c s, n) of a solution with its own problem."""
    own = solution.problem
    assert own is not None
    assert own.continuum is not None
    assert own.parameters is not None
    assert solution.weights is not None
    return own.continuum, own.continuum.places(own.parameters), solution.weights


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
        _check_bounds(self.name, self.lower, self.upper)

    def solve(self, problem: RegressionProblem) -> Solution:
        """Weights over the groups found, which the solution's own problem holds."""
        refused = _refusal(self.name, problem, self.lower, self.upper)
        if refused is not None:
            return refused
        assert problem.continuum is not None
        bounds = problem.continuum.interval(self.lower, self.upper)
        scanner = Scanner.of(problem.continuum, bounds)
        first, height = scanner.peaks(problem.target)[0]
        sliding = Sliding(problem.continuum, problem.target, self.alpha_fraction * height, bounds)
        atoms, rounds, done = sliding.solve(scanner, first)
        order = np.argsort(-atoms.places[:, 0])
        scaled = atoms.weights[order] / atoms.jet.rms[order][:, :, None]
        return Solution(
            scaled.reshape(-1, problem.targets),
            "ok" if done else "inaccurate",
            "" if done else "the sliding Frank-Wolfe rounds stalled",
            "converged" if done else "stalled",
            rounds,
            problem.at(atoms.places[order]),
        )

    def certify(self, problem: RegressionProblem, solution: Solution) -> Certificate:
        """The duality gap of a solution over the whole continuum, from rows and places alone."""
        continuum, places, weights = _placed(solution)
        bounds = continuum.interval(self.lower, self.upper)
        alpha = self.alpha_fraction * continuous_alpha_max(continuum, problem.target, bounds)
        return continuous_gap(problem.at(places), weights, alpha, bounds)


@dataclass(frozen=True)
class ParametricNLS:
    """U0 and L of one cellular flow: the reference that knows Eq. 1, by nonlinear least squares.

        min over U0 > 0, k of |Phi - U0 f(k)|^2,    f = (sin kx cos ky, -cos kx sin ky)

    U0 = <f, Phi>/<f, f> leaves the peaks of <f, Phi>^2/<f, f>, of which a scan that resolves the
    lobe, 2 pi/extent, meets all; the highest are climbed. It has 2 parameters where a length scale
    of the library has 16: no back-end that does not know the flow can do better, and it is of no
    use where Eq. 1 does not hold. starts: how many of the scan's highest peaks are climbed. lower,
    upper: bounds of the length scale [m]; None takes those of the problem's grid.
    """

    name: ClassVar[str] = "parametric-nls"
    certificate_kind: ClassVar[CertificateKind] = "normal_equations"
    starts: int = 8
    lower: float | None = None
    upper: float | None = None

    def __post_init__(self) -> None:
        integer_setting(self.name, "starts", self.starts, least=1)
        _check_bounds(self.name, self.lower, self.upper)

    def solve(self, problem: RegressionProblem) -> Solution:
        """U0 on ``sin x cos y`` of w_x and -U0 on ``cos x sin y`` of w_y, at the scale found."""
        refused = _refusal(self.name, problem, self.lower, self.upper)
        if refused is not None:
            return refused
        assert problem.continuum is not None
        pattern = problem.continuum.pattern
        if pattern is None:
            return Solution(
                None,
                "error",
                f"{self.name} knows the flow velocity (w_x, w_y) of cells, not "
                f"({', '.join(problem.target_names)}); use Library(target='flow-velocity') of "
                "family 'cells'",
            )
        bounds = problem.continuum.interval(self.lower, self.upper)
        scanner = Scanner.of(problem.continuum, bounds)
        peaks = scanner.peaks(problem.target, pattern, self.starts)
        if not peaks:
            return Solution(None, "unidentifiable", "no cellular flow of Eq. 1 fits with U0 > 0")
        k = float(peaks[0][0][0])
        f = known_column(problem.continuum.columns(np.array([[k]])), pattern)[0].ravel()
        edge = k in bounds
        return Solution(
            float(f @ problem.target.ravel() / (f @ f)) * pattern,
            "unidentifiable" if edge else "ok",
            f"the best length scale is at the edge of the interval, {math.pi / k:g} m; widen it"
            if edge
            else "",
            iterations=len(peaks),
            problem=problem.at(np.array([k])),
        )

    def certify(self, problem: RegressionProblem, solution: Solution) -> Certificate:
        """Stationarity in (U0, k): max of |<J, R>| / (|J| |Phi|), J = f and U0 df/dk."""
        continuum, places, weights = _placed(solution)
        pattern = continuum.pattern
        assert pattern is not None
        f, slope, _ = (part.ravel() for part in known_column(continuum.columns(places), pattern))
        target = problem.target.ravel()
        speed = float(np.sum(weights * pattern) / np.sum(pattern**2))
        residual, size = target - speed * f, float(np.linalg.norm(target)) or 1.0
        parts = [abs(float(j @ residual)) / float(np.linalg.norm(j)) for j in (f, slope)]
        return Certificate("normal_equations", max(parts) / size)
