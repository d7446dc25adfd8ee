"""The caller's judgement of a back-end's solution: its certificate, and the status that follows."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from sparsefit.arrays import Array, BoolArray
from sparsefit.regression.answer import Fit
from sparsefit.regression.backend import Backend, OffGridBackend, Solution
from sparsefit.regression.certificate import Certificate, duality_gaps, gram_gaps
from sparsefit.regression.exact_fits import sharpened
from sparsefit.regression.foreign import asked_support, confirms_anything, is_foreign
from sparsefit.regression.objective import Penalty
from sparsefit.regression.problem import RegressionProblem


def path_certificates(
    problem: RegressionProblem,
    solutions: Sequence[Solution],
    alphas: Array,
    penalty: Penalty,
    tolerance: float,
) -> list[Certificate | None]:
    """Duality gaps of solutions at the penalties alphas (p,); None where weights are not finite."""
    gaps: list[Certificate | None] = [None] * len(solutions)
    answered = [i for i, each in enumerate(solutions) if _weights_of(each) is not None]
    if not answered:
        return gaps
    weights = np.stack([np.asarray(solutions[i].weights) for i in answered])
    usable = np.flatnonzero(np.isfinite(weights).all(axis=(1, 2)))
    points = np.array(answered)[usable]
    certified = _smallest_effort(problem, weights[usable], alphas[points], penalty, tolerance)
    for i, certificate in zip(points.tolist(), certified, strict=True):
        gaps[i] = certificate
    return gaps


def _smallest_effort(
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
            if penalty.root and not certificate.proves(tolerance):
                alpha = float(alphas[i])
                certified[i] = sharpened(statistics, weights[i], alpha, certificate)
    return certified


def certificate_of(
    problem: RegressionProblem, backend: Any, solution: Solution, given: RegressionProblem
) -> Certificate | None:
    """The certificate of a back-end without a penalty on columns; None without finite weights.

    given: the problem as it was given to the back-end; a fixed point that says yes to every support
    is certified by NaN.
    """
    weights = _weights_of(solution)
    if weights is None or not np.isfinite(weights).all():
        return None
    if isinstance(backend, OffGridBackend):
        return backend.certify(given, solution)
    if backend.certificate_kind == "normal_equations":
        return _normal_equations(problem, weights, backend.rcond)
    support = weights != 0
    if not is_foreign(backend):
        return _fixed_point(support, backend.next_support(problem, weights))
    if confirms_anything(backend, given, weights):
        return Certificate("fixed_point", math.nan)
    return _fixed_point(support, asked_support(backend, given, weights))


def _fixed_point(support: BoolArray, after: BoolArray) -> Certificate:
    changed = int(np.sum(after != support))
    return Certificate("fixed_point", changed / max(int(support.sum()), 1))


def _normal_equations(
    problem: RegressionProblem, weights: Array, rcond: float | None
) -> Certificate:
    residual = problem.target - problem.theta @ weights
    spectrum = problem.spectrum
    kept = spectrum.right_vectors[spectrum.retained(rcond, problem.samples)]
    gradient = np.abs(kept @ (problem.theta.T @ residual))
    scale = spectrum.singular_values[0] * float(np.linalg.norm(problem.target))
    return Certificate("normal_equations", float(gradient.max(initial=0.0)) / (scale or 1.0))


def _weights_of(solution: Solution) -> Array | None:
    # The weights of a solver that failed are not an answer, whatever they look like.
    return None if solution.status == "error" else solution.weights


def judged(
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
        # point is one of supports, which settles no doubt about the weights.
        if not certificate.bound <= tolerance:
            words = _doubt(certificate, tolerance)
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


def _doubt(certificate: Certificate, tolerance: float) -> str:
    """Why a certificate proves too little."""
    if math.isnan(certificate.value):
        return "nothing is verified: its next_support confirms any support"
    words = f"{certificate.kind} {certificate.value:.1e}"
    if certificate.value <= tolerance:
        words += f", and {certificate.rounding:.1e} more that rounding may hide,"
    return f"{words} above tolerance {tolerance:.1e}"
