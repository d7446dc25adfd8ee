"""Back-ends of other packages at the door: what they are lent, and what is taken from them.

Such a back-end solves a copy of the problem, so that nothing it writes reaches another one; a copy
that comes back changed is refused, as its answer is to another problem. What it returns is checked
before anything reads it, and what it prints goes to stderr. Its certificate must be able to fail:
a ``next_support`` that confirms any support it is shown verifies nothing.
"""

import copy
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, redirect_stdout
from dataclasses import replace
from typing import Any, get_args

import numpy as np

from sparsefit.arrays import Array, BoolArray
from sparsefit.errors import InputError, is_integer, is_real
from sparsefit.regression.backend import (
    Backend,
    OffGridBackend,
    PenalisedBackend,
    Solution,
    SolutionStatus,
)
from sparsefit.regression.certificate import CertificateKind
from sparsefit.regression.objective import Penalty
from sparsefit.regression.problem import RegressionProblem

OURS = __name__.partition(".")[0]
ARRAYS = ("theta", "target", "groups", "group_scales", "subgroups", "parameters")


def is_foreign(backend: object) -> bool:
    """Whether a back-end is of another package."""
    return type(backend).__module__.partition(".")[0] != OURS


@contextmanager
def quiet() -> Iterator[None]:
    """What code of others prints is told, but is no output of ours."""
    with redirect_stdout(sys.stderr):
        yield


def check_declared(backend: Any) -> None:
    """Raise InputError unless a back-end has what its kind of certificate is computed from."""
    kind, name = backend.certificate_kind, backend.name
    needs = {
        "duality_gap": isinstance(backend, PenalisedBackend | OffGridBackend),
        "normal_equations": hasattr(backend, "rcond"),
        "fixed_point": isinstance(backend, OffGridBackend)
        or callable(getattr(backend, "next_support", None)),
    }
    missing = {
        "duality_gap": "alpha_fraction and penalty(problem)",
        "normal_equations": "rcond",
        "fixed_point": "next_support(problem, weights)",
    }
    if kind not in needs:
        known = ", ".join(get_args(CertificateKind))
        raise InputError(f"back-end {name!r}: certificate_kind {kind!r} is none of {known}")
    if not needs[kind]:
        raise InputError(
            f"back-end {name!r} declares the certificate {kind} and has no {missing[kind]}, from "
            "which it is computed"
        )


def lent(problem: RegressionProblem) -> RegressionProblem:
    """A copy of a problem that shares no array with it."""
    arrays = {name: getattr(problem, name) for name in ARRAYS}
    copies: dict[str, Any] = {
        name: None if one is None else one.copy() for name, one in arrays.items()
    }
    return replace(problem, **copies, continuum=copy.deepcopy(problem.continuum))


def check_unharmed(backend: Backend, borrowed: RegressionProblem, own: RegressionProblem) -> None:
    """Raise InputError where a back-end has written into the copy that it was lent."""
    for name in ARRAYS:
        mine, theirs = getattr(own, name), getattr(borrowed, name)
        if mine is not None and not np.array_equal(mine, theirs):
            raise InputError(
                f"back-end {backend.name!r} writes into problem.{name}, which it is given to "
                "read: work on a copy"
            )


def received(solution: Any, backend: Backend, problem: RegressionProblem) -> Solution:
    """The solution that a back-end returned, as plain values of the right kinds.

    Raises:
        InputError: which names what is not as a `Solution` has it.
    """
    where = f"back-end {backend.name!r} returned"
    if not isinstance(solution, Solution):
        raise InputError(f"{where} {type(solution).__name__}, not a Solution")
    if solution.status not in get_args(SolutionStatus):
        known = ", ".join(get_args(SolutionStatus))
        raise InputError(f"{where} the status {solution.status!r}, which is none of {known}")
    if not (solution.problem is None or isinstance(solution.problem, RegressionProblem)):
        raise InputError(f"{where} a problem that is no RegressionProblem")
    shared = solution.shared_seconds
    counted = solution.iterations if is_integer(solution.iterations, 0) else None
    return replace(
        solution,
        weights=_weights(solution.weights, where, solution.problem or problem),
        reason=str(solution.reason),
        solver_status=str(solution.solver_status),
        iterations=None if counted is None else int(counted),
        shared_seconds=float(shared) if is_real(shared) and np.isfinite(shared) else 0.0,
    )


def received_all(
    solutions: Iterable[Any], backend: Backend, problem: RegressionProblem, count: int
) -> tuple[Solution, ...]:
    """The solutions of a path of ``count`` penalties, each as `received` gives it.

    Raises InputError as it does, and where there are not as many.
    """
    checked = tuple(received(one, backend, problem) for one in solutions)
    if len(checked) != count:
        words = f"{len(checked)} solutions for a path of {count} penalties"
        raise InputError(f"back-end {backend.name!r} returned {words}")
    return checked


def _weights(weights: Any, where: str, problem: RegressionProblem) -> Array | None:
    if weights is None:
        return None
    try:
        array = np.array(weights, dtype=np.float64)  # a copy: theirs may change later
    except (TypeError, ValueError):
        raise InputError(f"{where} weights that are no array of real numbers") from None
    if array.shape != (problem.columns, problem.targets):
        right = (problem.columns, problem.targets)
        raise InputError(f"{where} weights of shape {array.shape}, not {right}")
    return array


def declared_penalty(backend: PenalisedBackend, problem: RegressionProblem) -> Penalty:
    """The penalty that a back-end has on a problem, its arrays copied.

    Raises InputError where a gap by it proves nothing: weights that are not above 0, groups that
    are not those of the columns, blocks within blocks that are not within them.
    """
    where = f"back-end {backend.name!r} declares a penalty"
    return _trusted(backend.penalty(problem), where, problem)


def _trusted(penalty: Any, where: str, problem: RegressionProblem) -> Penalty:
    if not isinstance(penalty, Penalty):
        raise InputError(f"{where} that is {type(penalty).__name__}, not a Penalty")
    groups, weights = np.array(penalty.groups), np.array(penalty.weights, dtype=float)
    if groups.shape != (problem.columns,) or groups.dtype.kind not in "iu":
        raise InputError(f"{where} without a group number for each of {problem.columns} columns")
    if set(groups.tolist()) != set(range(len(weights))):
        raise InputError(f"{where} whose groups are not those of its {len(weights)} weights")
    smooth = not weights.any() and penalty.ridge > 0
    if not (np.isfinite(weights).all() and (smooth or (weights > 0).all())):
        raise InputError(f"{where} with weights that are not all finite and above 0")
    if not (is_real(penalty.ridge) and np.isfinite(penalty.ridge) and penalty.ridge >= 0):
        raise InputError(f"{where} with a ridge of {penalty.ridge!r}")
    within = penalty.within
    if within is not None:
        within = _trusted(within, f"{where} within which is one", problem)
        nested = len(set(zip(within.groups.tolist(), groups.tolist(), strict=True)))
        if nested != len(within.weights) or within.joint > penalty.joint:
            raise InputError(f"{where} with blocks within it that span several of its own")
    return replace(penalty, groups=groups, weights=weights, within=within)


def asked_support(backend: Any, problem: RegressionProblem, weights: Array) -> BoolArray:
    """What a back-end says is the support (k, n) of weights (k, n) after one more iteration.

    Raises InputError unless it says so in booleans of that shape.
    """
    said = np.asarray(backend.next_support(problem, weights.copy()))
    if said.shape != weights.shape or said.dtype != np.bool_:
        raise InputError(
            f"back-end {backend.name!r}: next_support gives {said.dtype} of shape {said.shape}, "
            f"not booleans of shape {weights.shape}"
        )
    return said


def confirms_anything(backend: Any, problem: RegressionProblem, weights: Array) -> bool:
    """Whether ``next_support`` confirms supports drawn at random: it verifies none then."""
    rng = np.random.default_rng(0)
    for share in (1.0, 0.5, 0.5):
        drawn = rng.standard_normal(weights.shape) * (rng.random(weights.shape) < share)
        try:
            said = asked_support(backend, problem, drawn)
        except Exception:  # it does not confirm what it cannot take
            return False
        if np.any(said != (drawn != 0)):
            return False
    return True
