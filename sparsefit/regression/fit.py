"""The front door: ``fit(problem, backend)`` and ``path(problem, backend, alpha_fractions)``.

Validation, timing and certificates are here, once for all back-ends. The certificate is computed
from the data and the weights, and determines the status whatever the back-end reports. Code of
another package is trusted, but what it returns is validated.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from time import perf_counter
from typing import Any, get_args

import numpy as np

from sparsefit.arrays import Array, like
from sparsefit.errors import InputError, number_setting, shown
from sparsefit.regression.answer import Fit, Path
from sparsefit.regression.backend import (
    Backend,
    Checked,
    PathBackend,
    PenalisedBackend,
    Solution,
    SolutionStatus,
    checked_alpha_fraction,
    numeric_fraction,
    quiet,
)
from sparsefit.regression.certificate import Certificate, duality_gaps
from sparsefit.regression.penalty_choice import FRACTIONS, choose_penalty
from sparsefit.regression.problem import RegressionProblem

__all__ = [
    "TOLERANCE",
    "Fit",
    "Path",
    "certificates_of",
    "fit",
    "path",
    "points_of",
    "solutions_of",
]

TOLERANCE = 1e-8
PROVEN = 0.1  # of a tolerance: the gap from Z'Z, with its rounding error, that is not refined


def fit(problem: RegressionProblem, backend: Backend, *, tolerance: float = TOLERANCE) -> Fit:
    """Solve one problem and certify the weights; documented as `sparsefit.fit`."""
    penalised = _checked(problem, backend, tolerance)
    fraction = penalised.alpha_fraction if penalised else np.nan
    if fraction == "auto" and isinstance(backend, PathBackend):
        start = perf_counter()
        whole = _along(problem, backend, np.array(FRACTIONS), tolerance)
        index, criterion = choose_penalty(problem, backend, whole.weights)
        seconds = perf_counter() - start
        return replace(whole.fits[index], seconds=seconds, criterion=criterion)
    wanted = np.array([numeric_fraction(backend.name, fraction)] if penalised else [])
    return _along(problem, backend, wanted, tolerance).fits[0]


def path(
    problem: RegressionProblem,
    backend: Backend,
    alpha_fractions: Any = FRACTIONS,
    *,
    tolerance: float = TOLERANCE,
) -> Path:
    """Solve along a penalty grid and certify every point; documented as `sparsefit.path`."""
    if not _checked(problem, backend, tolerance):
        raise InputError(f"back-end {backend.name!r} has no penalty, and so no path; use fit")
    given = np.atleast_1d(np.array(alpha_fractions, dtype=object))
    if given.ndim != 1 or not given.size:
        words = "path needs a list of at least one alpha_fraction"
        raise InputError(f"{words}, not {shown(alpha_fractions)}")
    for value in given.tolist():
        checked_alpha_fraction(backend.name, value)
    return _along(problem, backend, given.astype(float), tolerance)


def points_of(backend: Any, fractions: Sequence[float]) -> list[Any]:
    """The back-end at each penalty fraction in (0, 1]; itself where there are none."""
    made = like if isinstance(backend, Checked) else replace  # the rest was checked
    return [made(backend, alpha_fraction=each) for each in fractions] or [backend]


def solutions_of(
    problem: RegressionProblem, backend: Any, fractions: Sequence[float]
) -> list[Solution]:
    """The answers of a back-end at penalty fractions, strongest first, as they are returned.

    Without fractions: its one answer by its own settings.
    """
    if fractions and hasattr(backend, "solve_path"):
        return list(backend.solve_path(problem, tuple(fractions)))
    return [point.solve(problem) for point in points_of(backend, fractions)]


def _along(problem: RegressionProblem, backend: Any, wanted: Array, tolerance: float) -> Path:
    """The fits at penalty fractions (p,), strongest first; a single fit where p is 0."""
    order = np.argsort(-wanted, kind="stable")
    fractions = wanted[order].tolist()
    start = perf_counter()
    with quiet():
        raw = solutions_of(problem, backend, fractions)
    points = points_of(backend, fractions)
    seconds = (perf_counter() - start) / len(points)
    if len(raw) != len(points):
        words = f"{len(raw)} solutions for a path of {len(points)} penalties"
        raise InputError(f"back-end {backend.name!r} returned {words}")
    solutions = list(_received(raw, backend, problem))
    problem.refuse_changes()
    weights = np.array([each.weights for each in solutions])
    certificates = certificates_of(problem, points, weights, PROVEN * tolerance)
    fits = [
        _judged(problem, *parts, seconds, tolerance)
        for parts in zip(points, solutions, certificates, strict=True)
    ]
    in_turn = tuple(fits[place] for place in np.argsort(order).tolist()) or tuple(fits)
    return Path(wanted, in_turn, perf_counter() - start)


def _received(
    raw: Sequence[Any], backend: Backend, problem: RegressionProblem
) -> Iterator[Solution]:
    """The solutions with weights (k, n) of floats, finite or not; NaN where one failed.

    Raises InputError on any other return.
    """
    where, right = f"back-end {backend.name!r} returned", (problem.columns, problem.targets)
    statuses, missing = get_args(SolutionStatus), np.full(right, np.nan)
    for solution in raw:
        if not isinstance(solution, Solution):
            raise InputError(f"{where} {type(solution).__name__}, not a Solution")
        if solution.status not in statuses:
            raise InputError(f"{where} the unknown status {shown(solution.status)}")
        is_missing = solution.weights is None or solution.status == "error"
        try:
            weights = missing if is_missing else np.asarray(solution.weights, dtype=np.float64)
        except (TypeError, ValueError):
            raise InputError(f"{where} weights that are no array of real numbers") from None
        if weights.shape != right:
            raise InputError(f"{where} weights of shape {weights.shape}, not {right}")
        yield solution if weights is solution.weights else replace(solution, weights=weights)


def certificates_of(
    problem: RegressionProblem, points: Sequence[Any], weights: Array, enough: float = 0.0
) -> list[Certificate | None]:
    """The certificates of weights (p, k, n), one at each point; None of what is not finite.

    points: a back-end at p penalties, strongest first, or alone. enough: the duality gap, with its
    rounding error, that need not be computed from the rows where Z'Z gives it.
    """
    finite = np.isfinite(weights).all(axis=(1, 2))
    values, solved = weights[finite], np.flatnonzero(finite).tolist()
    kind, certificates = points[0].certificate_kind, dict[int, Certificate]()
    if kind == "duality_gap" and solved:
        penalty = points[0].penalty(problem)
        alphas = problem.alpha_max(penalty) * np.array([points[i].alpha_fraction for i in solved])
        design, cross = problem.design, problem.cross
        gaps = duality_gaps(design, problem.target, values, alphas, penalty, cross, enough)
        certificates = dict(zip(solved, gaps, strict=True))
    elif kind != "duality_gap":
        proof = _normal_equations if kind == "normal_equations" else _fixed_point
        pairs = zip(solved, values, strict=True)
        certificates = {i: proof(problem, points[i], each) for i, each in pairs}
    return [certificates.get(i) for i in range(len(points))]


def _normal_equations(problem: RegressionProblem, backend: Any, weights: Array) -> Certificate:
    """The certificate of least squares on the singular vectors that ``rcond`` retains."""
    residual, spectrum = problem.target - problem.rows @ weights, problem.spectrum
    retained = spectrum.right_vectors[spectrum.retained(backend.rcond, problem.samples)]
    gradient = np.abs(retained @ (problem.rows.T @ residual))
    scale = float(spectrum.singular_values[0]) * float(np.linalg.norm(problem.target))
    return Certificate("normal_equations", float(gradient.max(initial=0.0)) / (scale or 1.0))


def _fixed_point(problem: RegressionProblem, backend: Any, weights: Array) -> Certificate:
    """The change of support and of fitted values by one more iteration."""
    with np.errstate(all="ignore"):  # weights of any size: what overflows is no fixed point
        following = np.asarray(backend.next_weights(problem, weights.copy()), dtype=float)
        if following.shape != weights.shape:
            words = f"next_weights gives weights of shape {following.shape}, not {weights.shape}"
            raise InputError(f"back-end {backend.name!r}: {words}")
        moved = problem.design.raw_predict(following - weights)
        share = float(np.linalg.norm(moved)) / (float(np.linalg.norm(problem.target)) or 1.0)
    changed = int(np.sum((following != 0) != (weights != 0)))
    changed_share = changed / max(int(np.count_nonzero(weights)), 1)
    return Certificate("fixed_point", changed_share if changed_share > share else share)


def _judged(
    problem: RegressionProblem,
    backend: Backend,
    solution: Solution,
    certificate: Certificate | None,
    seconds: float,
    tolerance: float,
) -> Fit:
    """The fit of a solution with its certificate; status ``error`` without one.

    Where the certificate rejects an exact path's weights, the referee solves the problem too, and
    the better certificate counts.
    """
    status: str = solution.status
    reason, weights = solution.reason, np.asarray(solution.weights)
    if certificate is None:
        weights = np.full(weights.shape, np.nan)
        status = "unidentifiable" if status == "unidentifiable" else "error"
        reason = reason or "the back-end returned no finite weights"
    elif status in ("ok", "inaccurate"):
        # The certificate determines the status, not the solver's own report. But a fixed point does
        # not confirm an optimum.
        if not certificate.bound <= tolerance:
            words = f"{certificate.kind} {certificate.value:.1e}"
            if certificate.value <= tolerance:
                words += f", and {certificate.rounding:.1e} more that rounding may hide,"
            words += f" above tolerance {tolerance:.1e}"
            status, reason = "inaccurate", f"{words}; {reason}" if reason else words
        elif status == "inaccurate" and certificate.kind != "fixed_point":
            status, reason = "ok", ""
    fast = Fit(
        *(weights, status, reason, certificate, seconds + solution.shared_seconds, backend),
        *(solution.solver_status, solution.iterations),
        problem=problem,
    )
    if certificate is not None and certificate.value <= tolerance:
        return fast  # what rounding hides of it, another solver's answer hides too
    referee = backend.referee() if isinstance(backend, PathBackend) else None
    if referee is None:
        return fast
    slow = fit(problem, referee, tolerance=tolerance)
    least = math.inf if certificate is None else certificate.value
    better = slow.certificate is not None and slow.certificate.value < least
    best = slow if better or certificate is None else fast
    seconds = fast.seconds + slow.seconds
    return replace(best, backend=backend, seconds=seconds, repaired=better)


def _checked(problem: Any, backend: Any, tolerance: Any) -> PenalisedBackend | None:
    """The back-end, if it has a penalty, else None. Raises InputError on what cannot be solved."""
    if not isinstance(problem, RegressionProblem):
        words = f"fit needs a RegressionProblem, not {type(problem).__name__}"
        raise InputError(f"{words}; see RegressionProblem.from_arrays")
    number_setting("fit", "tolerance", tolerance, low=0.0)
    if isinstance(backend, type):
        raise InputError(f"fit needs a back-end, not its class: {backend.__name__}()")
    if not (hasattr(backend, "solve") and hasattr(backend, "certificate_kind")):
        raise InputError(f"fit needs a back-end, not {shown(backend)}; see backends.get(name)")
    # Not by isinstance, which takes as long for a protocol as a small path.
    has_penalty = hasattr(backend, "penalty") and hasattr(backend, "alpha_fraction")
    return backend if has_penalty else None
