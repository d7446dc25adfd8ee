"""The front door: ``fit(problem, backend)`` and ``path(problem, backend, alpha_fractions)``.

Validation, timing and the certificate live here, once, for every back-end alike: the certificate is
computed from the data and the weights, and settles the status whatever the back-end says of itself.
A back-end of another package is trusted code, but for what it returns.
"""

import dataclasses
import math
from collections.abc import Sequence
from time import perf_counter
from typing import Any, get_args

import numpy as np

from sparsefit.arrays import Array
from sparsefit.errors import InputError, number_setting
from sparsefit.regression.answer import Fit, Path
from sparsefit.regression.backend import (
    Backend,
    ChoosingBackend,
    OffGridBackend,
    PathBackend,
    PenalisedBackend,
    Solution,
    SolutionStatus,
    checked_alpha_fraction,
    numeric_fraction,
    quiet,
)
from sparsefit.regression.certificate import (
    Certificate,
    CertificateKind,
    duality_gaps,
    gram_gaps,
    sharpened,
)
from sparsefit.regression.losses import RootSquares
from sparsefit.regression.penalties import Penalty
from sparsefit.regression.penalty_choice import FRACTIONS, choose_penalty
from sparsefit.regression.problem import RegressionProblem

__all__ = ["TOLERANCE", "Fit", "Path", "certificate_of", "fit", "path", "path_certificates"]

TOLERANCE = 1e-8
SEVERAL = 4  # solutions, from which certificates are taken from Z'Z where it is there
NEEDS = {
    "duality_gap": ("alpha_fraction", "penalty"),
    "normal_equations": ("rcond",),
    "fixed_point": ("next_support",),
}
"""Kind of certificate -> what a back-end must have for it, unless it certifies itself."""


def fit(problem: RegressionProblem, backend: Backend, *, tolerance: float = TOLERANCE) -> Fit:
    """Solve one problem and certify the answer.

    A certificate above ``tolerance``, with all that rounding can hide of it, gives status
    ``inaccurate``, with the best solution found. An alpha_fraction of "auto" is chosen first: the
    fit is the chosen point of the path. Raises InputError on what is not a problem, a back-end or a
    tolerance >= 0.
    """
    _check(problem, backend, tolerance)
    # To recognise a protocol takes longer than many a solve: the most common is asked for first.
    if not isinstance(backend, PathBackend):
        _check_backend(backend)
    elif backend.alpha_fraction == "auto" and isinstance(backend, ChoosingBackend):
        return _chosen(problem, backend, tolerance)
    if isinstance(backend, PathBackend) or (
        backend.certificate_kind == "duality_gap"
        and isinstance(backend, PenalisedBackend)
        and not isinstance(backend, OffGridBackend)
    ):
        fraction = numeric_fraction(backend.name, backend.alpha_fraction)
        return _along(problem, backend, np.array([fraction]), tolerance).fits[0]
    solution, seconds = _timed(problem, backend)
    certificate = certificate_of(problem, backend, solution)
    seconds += solution.shared_seconds
    return _judged(problem, backend, solution, certificate, seconds, tolerance)


def path(
    problem: RegressionProblem,
    backend: Backend,
    alpha_fractions: Any = FRACTIONS,
    *,
    tolerance: float = TOLERANCE,
) -> Path:
    """Solve along a penalty grid, in any order given, and certify every point.

    alpha_fractions: numbers in (0, 1], the penalties as fractions of the smallest one whose
    solution is zero; by default 30 from 1 to 1e-3. Back-ends without a path of their own are run
    point by point. Raises InputError for back-ends that have no penalty, and as `fit` does.
    """
    _check(problem, backend, tolerance)
    if not isinstance(backend, PathBackend) and not isinstance(backend, PenalisedBackend):
        _check_backend(backend)
        raise InputError(f"back-end {backend.name!r} has no penalty, and so no path; use fit")
    try:
        given = np.atleast_1d(np.asarray(alpha_fractions))
        wanted = given.astype(float) if given.dtype.kind in "fiuO" else np.empty(0)
    except (TypeError, ValueError):
        wanted = np.empty(0)
    if wanted.ndim != 1 or not wanted.size:
        raise InputError(
            f"path needs a list of at least one alpha_fraction, not {alpha_fractions!r}"
        )
    for value in wanted[~((wanted > 0) & (wanted <= 1))].tolist():
        checked_alpha_fraction(backend.name, value)
    return _along(problem, backend, wanted, tolerance)


def _along(
    problem: RegressionProblem, backend: PenalisedBackend, wanted: Array, tolerance: float
) -> Path:
    """The fits at penalty fractions (p,), solved from the strongest on."""
    order = np.argsort(-wanted, kind="stable")
    fractions = tuple(wanted[order].tolist())
    points = _at(backend, fractions)
    start = perf_counter()
    if isinstance(backend, PathBackend):
        with quiet():
            raw = backend.solve_path(problem, fractions)
        solutions = _received_path(raw, backend, problem, points)
        seconds = [(perf_counter() - start) / len(fractions)] * len(fractions)
    else:
        timed = [_timed(problem, point) for point in points]
        solutions, seconds = [s for s, _ in timed], [t for _, t in timed]
    penalty = backend.penalty(problem)
    if not isinstance(penalty, Penalty):
        raise InputError(
            f"back-end {backend.name!r} declares a penalty that is {type(penalty).__name__}, not "
            "one of sparsefit.penalties"
        )
    unit = problem.alpha_max(penalty)
    if backend.certificate_kind == "duality_gap":
        alphas = unit * np.array(fractions)
        certificates = path_certificates(problem, solutions, alphas, penalty, tolerance)
    else:
        pairs = zip(points, solutions, strict=True)
        certificates = [certificate_of(problem, *pair) for pair in pairs]
    fits = [
        _repaired(_judged(problem, *point, tolerance), tolerance)
        for point in zip(points, solutions, certificates, seconds, strict=True)
    ]
    in_turn = tuple(fits[place] for place in np.argsort(order).tolist())
    return Path(wanted, unit, in_turn, perf_counter() - start)


def _at(backend: PenalisedBackend, fractions: tuple[float, ...]) -> list[PenalisedBackend]:
    """The back-end at each penalty; `dataclasses.replace` would look its fields up each time."""
    names = [field.name for field in dataclasses.fields(backend) if field.init]  # type: ignore[arg-type]
    settings = {name: getattr(backend, name) for name in names}
    return [type(backend)(**(settings | {"alpha_fraction": f})) for f in fractions]


def _chosen(problem: RegressionProblem, backend: ChoosingBackend, tolerance: float) -> Fit:
    start = perf_counter()
    along = _along(problem, backend, np.array(FRACTIONS), tolerance)
    choice = choose_penalty(problem, backend, along.weights)
    chosen = along.fits[choice.index]
    return dataclasses.replace(chosen, seconds=perf_counter() - start, penalty_choice=choice)


def _timed(problem: RegressionProblem, backend: Backend) -> tuple[Solution, float]:
    start = perf_counter()
    with quiet():
        solution, seconds = backend.solve(problem), perf_counter() - start
    return _received(solution, backend, problem), seconds


def _received(solution: Any, backend: Backend, problem: RegressionProblem) -> Solution:
    """The solution of a back-end, its weights (k, n) of floats. Raises InputError on another."""
    where = f"back-end {backend.name!r} returned"
    if not isinstance(solution, Solution):
        raise InputError(f"{where} {type(solution).__name__}, not a Solution")
    if solution.status not in get_args(SolutionStatus):
        known = ", ".join(get_args(SolutionStatus))
        raise InputError(f"{where} the status {solution.status!r}, which is none of {known}")
    if solution.weights is None:
        return solution
    own = solution.problem or problem
    right = (own.columns, own.targets)
    try:
        weights = np.asarray(solution.weights, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{where} weights that are no array of real numbers") from None
    if weights.shape != right:
        raise InputError(f"{where} weights of shape {weights.shape}, not {right}")
    return (
        solution if weights is solution.weights else dataclasses.replace(solution, weights=weights)
    )


def _received_path(
    solutions: Sequence[Any], backend: Backend, problem: RegressionProblem, points: Sequence[Any]
) -> list[Solution]:
    if len(solutions) != len(points):
        words = f"{len(solutions)} solutions for a path of {len(points)} penalties"
        raise InputError(f"back-end {backend.name!r} returned {words}")
    return [_received(solution, backend, problem) for solution in solutions]


def _repaired(fast: Fit, tolerance: float) -> Fit:
    """The referee's answer where the certificate rejects the fast path's, if it is the better."""
    if fast.certificate is not None and fast.certificate.value <= tolerance:
        return fast  # what rounding hides of it, another solver's answer hides too
    referee = fast.backend.referee() if isinstance(fast.backend, PathBackend) else None
    if referee is None:
        return fast
    slow = fit(fast.problem, referee, tolerance=tolerance)
    worse = fast.certificate is not None and (
        slow.certificate is None or not slow.certificate.value < fast.certificate.value
    )
    best = fast if worse else slow
    return dataclasses.replace(
        best,
        backend=fast.backend,
        seconds=fast.seconds + slow.seconds,
        repaired=best is slow and slow.certificate is not None,
    )


def path_certificates(
    problem: RegressionProblem,
    solutions: Sequence[Solution],
    alphas: Array,
    penalty: Penalty,
    tolerance: float,
) -> list[Certificate | None]:
    """Duality gaps of solutions at the penalties alphas (p,); None where weights are not finite.

    From the Gram matrix where it is there and proves them small enough, from the rows elsewhere.
    """
    gaps: list[Certificate | None] = [None] * len(solutions)
    finite = [i for i, each in enumerate(solutions) if _finite(each)]
    if not finite:
        return gaps
    weights = np.stack([np.asarray(solutions[i].weights) for i in finite])
    places, statistics = np.array(finite), problem.statistics
    known = np.zeros(len(places), dtype=bool)
    # Not for a few: whether Z'Z was formed must not show in their certificates.
    if len(solutions) >= SEVERAL and statistics.design.formed and np.isinf(penalty.loss.clip):
        from_gram = gram_gaps(statistics, weights, alphas[places], penalty)
        for i, certificate in zip(finite, from_gram, strict=True):
            gaps[i] = certificate
        known = np.array([certificate.proves(tolerance) for certificate in from_gram])
    doubtful = np.flatnonzero(~known)
    if len(doubtful):
        by_rows = duality_gaps(
            problem.design, problem.target, weights[doubtful], alphas[places[doubtful]], penalty
        )
        for i, certificate in zip(places[doubtful].tolist(), by_rows, strict=True):
            if isinstance(penalty.loss, RootSquares) and not certificate.proves(tolerance):
                given = np.asarray(solutions[i].weights)
                certificate = sharpened(statistics, given, float(alphas[i]), certificate)
            gaps[i] = certificate
    return gaps


def certificate_of(
    problem: RegressionProblem, backend: Any, solution: Solution
) -> Certificate | None:
    """The certificate of a back-end without a penalty on columns; None without finite weights."""
    if not _finite(solution):
        return None
    weights = np.asarray(solution.weights)
    if isinstance(backend, OffGridBackend):
        return backend.certify(problem, solution)
    if backend.certificate_kind == "normal_equations":
        return _normal_equations(problem, weights, backend.rcond)
    return _fixed_point(problem, backend, weights)


def _fixed_point(problem: RegressionProblem, backend: Any, weights: Array) -> Certificate:
    """Whether one more iteration gives the support and the fit again.

    A back-end that has only ``next_support`` holds its weights to be least squares there.
    """
    support = weights != 0
    level = float(np.linalg.norm(problem.target)) or 1.0
    with np.errstate(all="ignore"):  # weights of any size: what overflows is no fixed point
        if hasattr(backend, "next_weights"):
            following = np.asarray(backend.next_weights(problem, weights.copy()), dtype=float)
            after, change = following != 0, (following - weights) * problem.design.rms[:, None]
            moved = float(np.linalg.norm(problem.design.predict(change))) / level
        else:
            after = np.asarray(backend.next_support(problem, weights.copy()))
            scaled = weights * problem.design.rms[:, None]
            pull = problem.design.correlate(problem.target - problem.design.predict(scaled))
            rms = level / math.sqrt(problem.samples)
            moved = float(np.abs(pull[support]).max(initial=0.0)) / rms
    if after.shape != weights.shape or after.dtype != np.bool_:
        raise InputError(
            f"back-end {backend.name!r}: next_support gives {after.dtype} of shape {after.shape}, "
            f"not booleans of shape {weights.shape}"
        )
    changed = int(np.sum(after != support)) / max(int(support.sum()), 1)
    return Certificate("fixed_point", changed if changed > moved else moved)


def _normal_equations(
    problem: RegressionProblem, weights: Array, rcond: float | None
) -> Certificate:
    residual = problem.target - problem.rows @ weights
    spectrum = problem.spectrum
    retained = spectrum.right_vectors[spectrum.retained(rcond, problem.samples)]
    gradient = np.abs(retained @ (problem.rows.T @ residual))
    scale = spectrum.singular_values[0] * float(np.linalg.norm(problem.target))
    return Certificate("normal_equations", float(gradient.max(initial=0.0)) / (scale or 1.0))


def _finite(solution: Solution) -> bool:
    """Whether there are finite weights; those of a solver that failed are no answer."""
    weights = solution.weights
    return solution.status != "error" and weights is not None and bool(np.isfinite(weights).all())


def _judged(
    problem: RegressionProblem,
    backend: Backend,
    solution: Solution,
    certificate: Certificate | None,
    seconds: float,
    tolerance: float,
) -> Fit:
    """The fit that a solution with this certificate makes; without one it is an error."""
    status: str = solution.status
    reason, weights = solution.reason, solution.weights
    if weights is None or certificate is None:
        weights = np.full((problem.columns, problem.targets), np.nan)
        status = "unidentifiable" if status == "unidentifiable" else "error"
        reason = reason or "the back-end returned no finite weights"
    elif status in ("ok", "inaccurate"):
        # The certificate decides: a solver's own word is kept beside it, not trusted. But a fixed
        # point settles no doubt about an optimum.
        if not certificate.bound <= tolerance:
            words = f"{certificate.kind} {certificate.value:.1e}"
            if certificate.value <= tolerance:
                words += f", and {certificate.rounding:.1e} more that rounding may hide,"
            words += f" above tolerance {tolerance:.1e}"
            status, reason = "inaccurate", f"{words}; {reason}" if reason else words
        elif status == "inaccurate" and certificate.kind != "fixed_point":
            status, reason = "ok", ""
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


def _check(problem: Any, backend: Any, tolerance: Any) -> None:
    if not isinstance(problem, RegressionProblem):
        raise InputError(
            f"fit needs a RegressionProblem, not {type(problem).__name__}; see "
            "RegressionProblem.from_arrays"
        )
    number_setting("fit", "tolerance", tolerance, low=0.0)
    if isinstance(backend, type):
        raise InputError(f"fit needs a back-end, not its class: {backend.__name__}()")


def _check_backend(backend: Any) -> None:
    """Raise InputError unless a back-end has what its kind of certificate is computed from."""
    if not isinstance(backend, Backend):
        raise InputError(f"fit needs a back-end, not {backend!r}; see backends.get(name)")
    kind, name = backend.certificate_kind, backend.name
    if kind not in NEEDS:
        known = ", ".join(get_args(CertificateKind))
        raise InputError(f"back-end {name!r}: certificate_kind {kind!r} is none of {known}")
    fixed = kind == "fixed_point" and hasattr(backend, "next_weights")
    missing = [need for need in NEEDS[kind] if not hasattr(backend, need)]
    if missing and not fixed and not isinstance(backend, OffGridBackend):
        raise InputError(
            f"back-end {name!r} declares the certificate {kind} and has no {', '.join(missing)}, "
            "from which it is computed"
        )
