"""The front door: ``fit(problem, backend)`` and ``path(problem, backend, alpha_fractions)``.

Validation, timing and the certificate live here, once, for every back-end alike.
"""

import dataclasses
from time import perf_counter
from typing import Any

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
    checked_alpha_fraction,
    numeric_fraction,
)
from sparsefit.regression.foreign import (
    check_declared,
    check_unharmed,
    declared_penalty,
    is_foreign,
    lent,
    quiet,
    received,
    received_all,
)
from sparsefit.regression.judgement import certificate_of, judged, path_certificates
from sparsefit.regression.objective import alpha_max
from sparsefit.regression.penalty_choice import FRACTIONS, choose_penalty
from sparsefit.regression.problem import RegressionProblem

__all__ = ["TOLERANCE", "Fit", "Path", "fit", "path"]

TOLERANCE = 1e-8


def fit(problem: RegressionProblem, backend: Backend, *, tolerance: float = TOLERANCE) -> Fit:
    """Solve one problem and certify the answer.

    A certificate above ``tolerance``, with all that rounding can hide of it, gives status
    ``inaccurate``, with the best solution found. An alpha_fraction of "auto" is chosen first: the
    fit is the chosen point of the path. Raises InputError on what is not a problem, a back-end or a
    tolerance >= 0.
    """
    _check(problem, backend, tolerance)
    if is_foreign(backend):
        _check_backend(backend)
        with quiet():
            return _fit(problem, backend, tolerance)
    return _fit(problem, backend, tolerance)


def _fit(problem: RegressionProblem, backend: Backend, tolerance: float) -> Fit:
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
    given = lent(problem) if is_foreign(backend) else problem
    solution, seconds = _timed(given, backend)
    seconds += solution.shared_seconds
    certificate = certificate_of(problem, backend, solution, given)
    if given is not problem:
        check_unharmed(backend, given, problem)
    return judged(problem, backend, solution, certificate, seconds, tolerance)


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
        asked = given.astype(float) if given.dtype.kind in "fiuO" else np.empty(0)
    except (TypeError, ValueError):
        asked = np.empty(0)
    if asked.ndim != 1 or not asked.size:
        raise InputError(
            f"path needs a list of at least one alpha_fraction, not {alpha_fractions!r}"
        )
    for value in asked[~((asked > 0) & (asked <= 1))].tolist():
        checked_alpha_fraction(backend.name, value)
    if is_foreign(backend):
        _check_backend(backend)
        with quiet():
            return _along(problem, backend, asked, tolerance)
    return _along(problem, backend, asked, tolerance)


def _along(
    problem: RegressionProblem, backend: PenalisedBackend, asked: Array, tolerance: float
) -> Path:
    """The fits at the penalty fractions ``asked`` (p,), solved from the strongest on."""
    order = np.argsort(-asked, kind="stable")
    fractions = tuple(asked[order].tolist())
    points = _at(backend, fractions)
    given = lent(problem) if is_foreign(backend) else problem
    start = perf_counter()
    if isinstance(backend, PathBackend):
        solutions = backend.solve_path(given, fractions)
        seconds = [(perf_counter() - start) / len(fractions)] * len(fractions)
    else:
        timed = [_timed(given, point) for point in points]
        solutions, seconds = tuple(s for s, _ in timed), [t for _, t in timed]
    if given is problem:
        penalty = backend.penalty(problem)
    else:
        solutions = received_all(solutions, backend, problem, len(fractions))
        penalty = declared_penalty(backend, given)
    unit = alpha_max(problem.statistics.cross, penalty)
    alphas = unit * np.array(fractions)
    if backend.certificate_kind == "duality_gap":
        certificates = path_certificates(problem, solutions, alphas, penalty, tolerance)
    else:
        pairs = zip(points, solutions, strict=True)
        certificates = [certificate_of(problem, *pair, given) for pair in pairs]
    if given is not problem:
        check_unharmed(backend, given, problem)
    fits = [
        _repaired(judged(problem, *point, tolerance), tolerance)
        for point in zip(points, solutions, certificates, seconds, strict=True)
    ]
    as_asked = tuple(fits[place] for place in np.argsort(order).tolist())
    return Path(asked, unit, as_asked, perf_counter() - start)


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
    solution, seconds = backend.solve(problem), perf_counter() - start
    return (received(solution, backend, problem) if is_foreign(backend) else solution), seconds


def _repaired(fast: Fit, tolerance: float) -> Fit:
    """The referee's answer where the certificate rejects the fast path's, if it is the better."""
    if fast.certificate is not None and fast.certificate.value <= tolerance:
        return fast  # what rounding hides of it, another solver's answer hides too
    referee = fast.backend.referee() if isinstance(fast.backend, PathBackend) else None
    if referee is None:
        return fast
    slow = fit(fast.problem, referee, tolerance=tolerance)
    worse = fast.certificate is not None and (
        slow.certificate is None or slow.certificate.value >= fast.certificate.value
    )
    best = fast if worse else slow
    return dataclasses.replace(
        best,
        backend=fast.backend,
        seconds=fast.seconds + slow.seconds,
        repaired=best is slow and slow.certificate is not None,
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
    if not isinstance(backend, Backend):
        raise InputError(f"fit needs a back-end, not {backend!r}; see backends.get(name)")
    if is_foreign(backend):
        check_declared(backend)
