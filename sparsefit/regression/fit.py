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

__all__ = ["TOLERANCE", "Fit", "Path", "certificate_of", "fit", "path"]

TOLERANCE = 1e-8
SEVERAL = 4  # solutions, from which certificates are taken from Z'Z where it is there
NEEDS = {
    "duality_gap": ("alpha_fraction", "penalty"),
    "normal_equations": ("rcond",),
    "fixed_point": ("next_support",),
}
"""Kind of certificate -> what a back-end must have for it, unless it certifies itself."""


def fit(problem: RegressionProblem, backend: Backend, *, tolerance: float = TOLERANCE) -> Fit:
    """Solve one problem and certify the answer; `sparsefit.fit` says of what and how."""
    _check(problem, backend, tolerance)
    # To recognise a protocol takes longer than many a solve: the most common is asked for first.
    along = isinstance(backend, PathBackend)
    if not isinstance(backend, PathBackend):
        _check_backend(backend)
    elif backend.alpha_fraction == "auto" and isinstance(backend, ChoosingBackend):
        start = perf_counter()
        whole = _along(problem, backend, np.array(FRACTIONS), tolerance)
        choice = choose_penalty(problem, backend, whole.weights)
        seconds, chosen = perf_counter() - start, whole.fits[choice.index]
        return dataclasses.replace(chosen, seconds=seconds, penalty_choice=choice)
    convex = backend.certificate_kind == "duality_gap"
    if (along or convex) and isinstance(backend, PenalisedBackend):
        fraction = numeric_fraction(backend.name, backend.alpha_fraction)
        return _along(problem, backend, np.array([fraction]), tolerance).fits[0]
    start = perf_counter()
    with quiet():
        raw, seconds = backend.solve(problem), perf_counter() - start
    solution = _received(raw, backend, problem)
    problem.refuse_changes()
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
    """Solve along a penalty grid and certify every point; `sparsefit.path` says of what and how."""
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
    # `dataclasses.replace` would look the fields up at each penalty.
    names = [field.name for field in dataclasses.fields(backend) if field.init]  # type: ignore[arg-type]
    settings = {name: getattr(backend, name) for name in names}
    points = [type(backend)(**(settings | {"alpha_fraction": f})) for f in fractions]
    start, raw, seconds = perf_counter(), [], []
    with quiet():
        if isinstance(backend, PathBackend):
            raw = list(backend.solve_path(problem, fractions))
            seconds = [(perf_counter() - start) / len(fractions)] * len(fractions)
        else:
            for point in points:
                begun = perf_counter()
                raw.append(point.solve(problem))
                seconds.append(perf_counter() - begun)
    if len(raw) != len(points):
        words = f"{len(raw)} solutions for a path of {len(points)} penalties"
        raise InputError(f"back-end {backend.name!r} returned {words}")
    solutions = [_received(solution, backend, problem) for solution in raw]
    problem.refuse_changes()
    penalty = backend.penalty(problem)
    if not isinstance(penalty, Penalty):
        raise InputError(
            f"back-end {backend.name!r} declares a penalty that is {type(penalty).__name__}, not "
            "one of sparsefit.penalties"
        )
    unit = problem.alpha_max(penalty)
    if backend.certificate_kind == "duality_gap":
        alphas = unit * np.array(fractions)
        certificates = _path_certificates(problem, solutions, alphas, penalty, tolerance)
    else:
        pairs = zip(points, solutions, strict=True)
        certificates = [certificate_of(problem, *pair) for pair in pairs]
    fits = [
        _repaired(_judged(problem, *point, tolerance), tolerance)
        for point in zip(points, solutions, certificates, seconds, strict=True)
    ]
    in_turn = tuple(fits[place] for place in np.argsort(order).tolist())
    return Path(wanted, unit, in_turn, perf_counter() - start)


def _received(solution: Any, backend: Backend, problem: RegressionProblem) -> Solution:
    """The solution of a back-end, its weights (k, n) of floats. Raises InputError on another."""
    where = f"back-end {backend.name!r} returned"
    if not isinstance(solution, Solution):
        raise InputError(f"{where} {type(solution).__name__}, not a Solution")
    if solution.status not in get_args(SolutionStatus):
        valid = ", ".join(get_args(SolutionStatus))
        raise InputError(f"{where} the status {solution.status!r}, which is none of {valid}")
    if solution.weights is None:
        return solution
    right = (problem.columns, problem.targets)
    try:
        weights = np.asarray(solution.weights, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{where} weights that are no array of real numbers") from None
    if weights.shape != right:
        raise InputError(f"{where} weights of shape {weights.shape}, not {right}")
    same = weights is solution.weights
    return solution if same else dataclasses.replace(solution, weights=weights)


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
    best, seconds = fast if worse else slow, fast.seconds + slow.seconds
    repaired = best is slow and slow.certificate is not None
    return dataclasses.replace(best, backend=fast.backend, seconds=seconds, repaired=repaired)


def _path_certificates(
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
    places = np.array([i for i, each in enumerate(solutions) if _finite(each)], dtype=int)
    if not len(places):
        return gaps
    weights = np.stack([np.asarray(solutions[i].weights) for i in places])
    statistics, proven = problem.statistics, np.zeros(len(places), dtype=bool)
    # Not for a few: whether Z'Z was formed must not show in their certificates.
    if len(solutions) >= SEVERAL and problem.design.formed and np.isinf(penalty.loss.clip):
        from_gram = gram_gaps(statistics, weights, alphas[places], penalty)
        for i, certificate in zip(places.tolist(), from_gram, strict=True):
            gaps[i] = certificate
        proven = np.array([certificate.proves(tolerance) for certificate in from_gram])
    rest = places[~proven]
    if not len(rest):
        return gaps
    data = (problem.design, problem.target, weights[~proven], alphas[rest], penalty)
    for i, certificate in zip(rest.tolist(), duality_gaps(*data), strict=True):
        if isinstance(penalty.loss, RootSquares) and not certificate.proves(tolerance):
            values = np.asarray(solutions[i].weights)
            certificate = sharpened(statistics, values, float(alphas[i]), certificate)
        gaps[i] = certificate
    return gaps


def certificate_of(
    problem: RegressionProblem, backend: Any, solution: Solution
) -> Certificate | None:
    """The certificate of a back-end without a penalty on columns; None without finite weights."""
    if not _finite(solution):
        return None
    weights = np.asarray(solution.weights)
    if backend.certificate_kind == "normal_equations":
        residual, spectrum = problem.target - problem.rows @ weights, problem.spectrum
        retained = spectrum.right_vectors[spectrum.retained(backend.rcond, problem.samples)]
        gradient = np.abs(retained @ (problem.rows.T @ residual))
        scale = spectrum.singular_values[0] * float(np.linalg.norm(problem.target))
        return Certificate("normal_equations", float(gradient.max(initial=0.0)) / (scale or 1.0))
    return _fixed_point(problem, backend, weights)


def _fixed_point(problem: RegressionProblem, backend: Any, weights: Array) -> Certificate:
    """Whether one more iteration gives the support and the fit again.

    A back-end that has only ``next_support`` holds its weights to be least squares there.
    """
    support, design = weights != 0, problem.design
    level = float(np.linalg.norm(problem.target)) or 1.0
    with np.errstate(all="ignore"):  # weights of any size: what overflows is no fixed point
        if hasattr(backend, "next_weights"):
            following = np.asarray(backend.next_weights(problem, weights.copy()), dtype=float)
            after, moved = following != 0, design.raw_predict(following - weights)
            share = float(np.linalg.norm(moved)) / level
        else:
            after = np.asarray(backend.next_support(problem, weights.copy()))
            pull = design.correlate(problem.target - design.raw_predict(weights))
            rms = level / math.sqrt(problem.samples)
            share = float(np.abs(pull[support]).max(initial=0.0)) / rms
    if after.shape != weights.shape or after.dtype != np.bool_:
        raise InputError(
            f"back-end {backend.name!r}: next_support gives {after.dtype} of shape {after.shape}, "
            f"not booleans of shape {weights.shape}"
        )
    changed = int(np.sum(after != support)) / max(int(support.sum()), 1)
    return Certificate("fixed_point", changed if changed > share else share)


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
        *(weights, status, reason, certificate, seconds, backend),
        *(solution.solver_status, solution.iterations),
        problem=problem,
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
        valid = ", ".join(get_args(CertificateKind))
        raise InputError(f"back-end {name!r}: certificate_kind {kind!r} is none of {valid}")
    fixed = kind == "fixed_point" and hasattr(backend, "next_weights")
    missing = [need for need in NEEDS[kind] if not hasattr(backend, need)]
    if missing and not fixed:
        raise InputError(
            f"back-end {name!r} declares the certificate {kind} and has no {', '.join(missing)}, "
            "from which it is computed"
        )
