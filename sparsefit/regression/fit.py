"""The front door: ``fit(problem, backend)`` and ``path(problem, backend, alpha_fractions)``.

Validation, timing and the certificate live here, once, for every back-end alike.
"""

import dataclasses
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any

import numpy as np

from sparsefit.arrays import Array, IntArray
from sparsefit.errors import InputError, number_setting
from sparsefit.regression.backend import (
    Backend,
    ChoosingBackend,
    OffGridBackend,
    PathBackend,
    PenalisedBackend,
    Solution,
    checked_alpha_fraction,
    numeric_fraction,
)
from sparsefit.regression.certificate import Certificate, duality_gaps, gram_gaps
from sparsefit.regression.objective import Penalty, alpha_max
from sparsefit.regression.penalty_choice import FRACTIONS, PenaltyChoice, choose_penalty
from sparsefit.regression.problem import RegressionProblem

TOLERANCE = 1e-8


@dataclass(frozen=True, eq=False)
class Fit:
    """A back-end's weights with what the caller verified about them.

    weights (k, n) in the original units of theta, NaN throughout where there is no solution;
    status ``ok``, ``inaccurate`` (certificate above tolerance), ``unidentifiable`` or ``error``,
    with its reason; seconds of the solve; ``repaired``: the certificate rejected the fast path's
    answer and this one is the referee's. ``penalty_choice``: how the back-end's alpha_fraction,
    here the chosen number, was found where "auto" was asked for. ``shared_seconds``: the part of
    seconds that an earlier fit spent, on a factorisation that this one uses.
    """

    weights: Array
    status: str
    reason: str
    certificate: Certificate | None
    seconds: float
    backend: Backend
    solver_status: str = ""
    iterations: int | None = None
    repaired: bool = False
    penalty_choice: PenaltyChoice | None = field(default=None, repr=False, kw_only=True)
    shared_seconds: float = field(default=0.0, repr=False, kw_only=True)
    problem: RegressionProblem = field(repr=False, kw_only=True)

    @property
    def support(self) -> IntArray:
        """Columns with a weight that is not zero for some target."""
        return np.flatnonzero(np.any((self.weights != 0) & np.isfinite(self.weights), axis=1))

    @property
    def samples(self) -> int:
        """Rows m of the problem."""
        return self.problem.samples

    @property
    def columns(self) -> int:
        """Columns k of the problem."""
        return self.problem.columns

    @property
    def rank(self) -> int:
        """Numerical rank of theta, as far as Z'Z/m shows it."""
        return self.problem.statistics.rank


@dataclass(frozen=True, eq=False)
class Path:
    """Fits along descending penalties: alpha = alpha_fraction * alpha_max."""

    alpha_fractions: Array
    alpha_max: float
    fits: tuple[Fit, ...]
    seconds: float

    @property
    def weights(self) -> Array:
        """Weights (p, k, n) in the original units of theta."""
        return np.stack([fit.weights for fit in self.fits])

    @property
    def gaps(self) -> Array:
        """Relative duality gap of each point, NaN where there is no solution."""
        return np.array([f.certificate.value if f.certificate else np.nan for f in self.fits])

    @property
    def repaired(self) -> int:
        """How many points the referee had to repair."""
        return sum(fit.repaired for fit in self.fits)


def fit(problem: RegressionProblem, backend: Backend, *, tolerance: float = TOLERANCE) -> Fit:
    """Solve one problem and certify the answer.

    A certificate above ``tolerance`` gives status ``inaccurate``, with the best solution found.
    An alpha_fraction of "auto" is chosen first: the fit is the chosen point of the path.
    """
    _check(problem, backend, tolerance)
    if isinstance(backend, ChoosingBackend) and backend.alpha_fraction == "auto":
        return _chosen(problem, backend, tolerance)
    if isinstance(backend, PathBackend):
        fraction = numeric_fraction(backend.name, backend.alpha_fraction)
        return path(problem, backend, (fraction,), tolerance=tolerance).fits[0]
    start = perf_counter()
    solution = backend.solve(problem)
    seconds = perf_counter() - start + solution.shared_seconds
    certificate: Certificate | None
    if isinstance(backend, OffGridBackend):
        certificate = backend.certify(problem, solution) if _usable(solution) else None
    elif isinstance(backend, PenalisedBackend) and backend.certificate_kind == "duality_gap":
        fractions = (numeric_fraction(backend.name, backend.alpha_fraction),)
        certificate = _gaps(problem, backend, (solution,), fractions, tolerance)[0]
    else:
        certificate = _certify(problem, backend, solution)
    return _judged(problem, backend, solution, certificate, seconds, tolerance)


def _chosen(problem: RegressionProblem, backend: ChoosingBackend, tolerance: float) -> Fit:
    start = perf_counter()
    along = path(problem, backend, FRACTIONS, tolerance=tolerance)
    choice = choose_penalty(problem, backend, along.weights)
    found = along.fits[choice.index]
    return dataclasses.replace(found, seconds=perf_counter() - start, penalty_choice=choice)


def path(
    problem: RegressionProblem,
    backend: Backend,
    alpha_fractions: Any,
    *,
    tolerance: float = TOLERANCE,
) -> Path:
    """Solve along a penalty grid, in any order given, and certify every point.

    Back-ends without a path of their own are run point by point. Raises InputError for back-ends
    that have no penalty.
    """
    _check(problem, backend, tolerance)
    if not isinstance(backend, PenalisedBackend):
        raise InputError(f"back-end {backend.name!r} has no penalty, and so no path; use fit")
    asked = np.atleast_1d(np.asarray(alpha_fractions, dtype=float))
    if asked.ndim != 1 or not asked.size:
        raise InputError(f"path needs a list of at least one alpha_fraction, not {asked.tolist()}")
    for value in asked.tolist():
        checked_alpha_fraction(backend.name, value)
    order = np.argsort(-asked, kind="stable")
    fractions = tuple(asked[order].tolist())
    points = [dataclasses.replace(backend, alpha_fraction=f) for f in fractions]  # type: ignore[type-var]
    start = perf_counter()
    if isinstance(backend, PathBackend):
        solutions = backend.solve_path(problem, fractions)
        seconds = [(perf_counter() - start) / len(fractions)] * len(fractions)
    else:
        timed = [_timed(problem, point) for point in points]
        solutions, seconds = tuple(s for s, _ in timed), [t for _, t in timed]
    gaps = _gaps(problem, backend, solutions, fractions, tolerance)
    judged = (
        _repaired(_judged(problem, *item, tolerance), tolerance)
        for item in zip(points, solutions, gaps, seconds, strict=True)
    )
    fits: list[Any] = [None] * len(fractions)
    for position, one in zip(order, judged, strict=True):
        fits[position] = one
    unit = alpha_max(problem.statistics.cross, backend.penalty(problem))
    return Path(asked, unit, tuple(fits), perf_counter() - start)


def _check(problem: Any, backend: Any, tolerance: Any) -> None:
    if not isinstance(problem, RegressionProblem):
        raise InputError(
            f"fit needs a RegressionProblem, not {type(problem).__name__}; see "
            "RegressionProblem.from_arrays"
        )
    if not isinstance(backend, Backend):
        raise InputError(f"fit needs a back-end, not {backend!r}; see backends.get(name)")
    number_setting("fit", "tolerance", tolerance, low=0.0)


def _timed(problem: RegressionProblem, backend: Backend) -> tuple[Solution, float]:
    start = perf_counter()
    return backend.solve(problem), perf_counter() - start


def _gaps(
    problem: RegressionProblem,
    backend: PenalisedBackend,
    solutions: tuple[Solution, ...],
    fractions: tuple[float, ...],
    tolerance: float,
) -> list[Certificate | None]:
    """Duality gaps of the solutions that are finite, None for the others."""
    gaps: list[Certificate | None] = [None] * len(solutions)
    usable = [i for i, solution in enumerate(solutions) if _usable(solution)]
    if usable:
        penalty = backend.penalty(problem)
        alphas = alpha_max(problem.statistics.cross, penalty) * np.array(fractions)[usable]
        weights = np.stack([np.asarray(solutions[i].weights) for i in usable])
        certified = _certified(problem, weights, alphas, penalty, tolerance)
        for i, certificate in zip(usable, certified, strict=True):
            gaps[i] = certificate
    return gaps


def _certified(
    problem: RegressionProblem, weights: Array, alphas: Array, penalty: Penalty, tolerance: float
) -> list[Certificate]:
    """Gaps from the Gram matrix where it proves them small enough, from the rows elsewhere."""
    statistics = problem.statistics
    certified = list(gram_gaps(statistics, weights, alphas, penalty))
    doubtful = [i for i, each in enumerate(certified) if not each.proves(tolerance)]
    if doubtful:
        by_rows = duality_gaps(
            problem.theta,
            problem.target,
            statistics.rms,
            weights[doubtful],
            alphas[doubtful],
            penalty,
            samples=problem.samples,
        )
        for i, certificate in zip(doubtful, by_rows, strict=True):
            certified[i] = certificate
    return certified


def _certify(problem: RegressionProblem, backend: Any, solution: Solution) -> Certificate | None:
    """Certificates of the kinds that have no dual."""
    if not _usable(solution) or solution.weights is None:
        return None
    if backend.certificate_kind == "normal_equations":
        residual = problem.target - problem.theta @ solution.weights
        spectrum = problem.spectrum
        kept = spectrum.right_vectors[spectrum.retained(backend.rcond, problem.samples)]
        gradient = np.abs(kept @ (problem.theta.T @ residual))
        scale = spectrum.singular_values[0] * float(np.linalg.norm(problem.target))
        return Certificate("normal_equations", float(gradient.max(initial=0.0)) / (scale or 1.0))
    support = solution.weights != 0
    changed = int(np.sum(backend.next_support(problem, solution.weights) != support))
    return Certificate("fixed_point", changed / max(int(support.sum()), 1))


def _usable(solution: Solution) -> bool:
    # The weights of a solver that failed are not an answer, whatever they look like.
    return (
        solution.status != "error"
        and solution.weights is not None
        and bool(np.isfinite(solution.weights).all())
    )


def _judged(
    problem: RegressionProblem,
    backend: Backend,
    solution: Solution,
    certificate: Certificate | None,
    seconds: float,
    tolerance: float,
) -> Fit:
    status: str = solution.status
    reason, weights = solution.reason, solution.weights
    if weights is None or not _usable(solution):
        weights = np.full((problem.columns, problem.targets), np.nan)
        status = "unidentifiable" if status == "unidentifiable" else "error"
        reason = reason or "the back-end returned no finite weights"
    elif certificate is not None and status in ("ok", "inaccurate"):
        # The certificate decides: a solver's own word is kept beside it, not trusted.
        status = "ok" if certificate.value <= tolerance else "inaccurate"
        if status == "inaccurate":
            words = f"{certificate.kind} {certificate.value:.1e} above tolerance {tolerance:.1e}"
            reason = f"{words}; {reason}" if reason else words
    return Fit(
        weights,
        status,
        reason,
        certificate,
        seconds,
        backend,
        solution.solver_status,
        solution.iterations,
        problem=solution.problem or problem,
        shared_seconds=solution.shared_seconds,
    )


def _repaired(found: Fit, tolerance: float) -> Fit:
    """The referee's answer where the certificate rejects the fast path's, if it is the better."""
    if found.status == "ok":  # first: to recognise a protocol takes longer than most points
        return found
    referee = found.backend.referee() if isinstance(found.backend, PathBackend) else None
    if referee is None:
        return found
    other = fit(found.problem, referee, tolerance=tolerance)
    worse = found.certificate is not None and (
        other.certificate is None or other.certificate.value >= found.certificate.value
    )
    best = found if worse else other
    return dataclasses.replace(
        best,
        backend=found.backend,
        seconds=found.seconds + other.seconds,
        repaired=best is other and other.certificate is not None,
    )
