"""Every ``solver=`` of a penalised back-end: what it is, what brings it, and where it lives.

Besides the exact paths there are Clarabel and OSQP called directly, any solver that cvxpy finds,
on the compressed problem (its plain name) or on the m rows as users of cvxpy write it
(``cvxpy-rows-`` before the name), and public packages behind the extra ``peers``. A solver that is
not installed is refused with the extra that brings it.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from typing import Any, TypeAlias, cast

from sparsefit.backends.conic import (
    DIRECT,
    QUADRATIC_ONLY,
    TOLERANCES,
    installed_solvers,
    solve_conic,
    solve_rows,
)
from sparsefit.backends.peer_forms import solved
from sparsefit.errors import InputError, MissingExtra, unknown
from sparsefit.regression.backend import Solution
from sparsefit.regression.objective import Penalty
from sparsefit.regression.problem import RegressionProblem

Solve: TypeAlias = Callable[
    [RegressionProblem, Penalty, tuple[float, ...], float | None], tuple[Solution, ...]
]
"""(problem, penalty, descending penalty fractions, stopping tolerance) -> a solution each."""
AS_WRITTEN = "cvxpy-rows-"


@dataclass(frozen=True)
class Solver:
    """A solver behind a penalised back-end.

    package: what must be importable; brought: what pip installs for it. form: how the problem is
    handed over, in words. quadratic: for penalties of single coefficients only.
    plain: for norms of coefficients or of groups alone, without a ridge or groups within groups.
    stops: whether a stopping tolerance can be set. home: ``module:function`` of an `Along`
    of `peer_forms`, for those called without cvxpy.
    """

    name: str
    package: str
    form: str
    home: str = ""
    brought: str = "sparsefit"
    quadratic: bool = False
    plain: bool = True
    stops: bool = True

    @property
    def installed(self) -> bool:
        """Whether its package can be imported."""
        return find_spec(self.package) is not None

    @property
    def remedy(self) -> str:
        """How it is installed."""
        return f"{self.name} is not installed: pip install {self.brought}"


EXTRA = "'sparsefit[peers]'"
HOMOTOPY, DESCENT = "sparsefit.backends.peer_homotopy", "sparsefit.backends.peer_descent"
PEERS: tuple[Solver, ...] = (
    Solver("scikit-learn-lars", "sklearn", "lars_path_gram on Z'Z", f"{HOMOTOPY}:scikit_lars",
           EXTRA, quadratic=True, stops=False),
    Solver("spams", "spams", "lasso (LARS) on Z'Z", f"{HOMOTOPY}:spams_lars",
           "spams-bin", quadratic=True, stops=False),
    Solver("scikit-learn-cd", "sklearn", "lasso_path, coordinate descent on Z'Z",
           f"{DESCENT}:scikit_descent", EXTRA, quadratic=True),
    Solver("celer", "celer", "celer_path on the triangle of a QR", f"{DESCENT}:celer", EXTRA),
    Solver("skglm", "skglm", "AndersonCD or GroupBCD on the triangle of a QR",
           f"{DESCENT}:skglm", EXTRA),
    Solver("group-lasso-fista", "group_lasso", "FISTA of the package group-lasso, on a QR",
           f"{DESCENT}:fista", EXTRA),
    Solver("osqp-direct", "osqp", "OSQP itself on the dual, in Z'Z, its bounds moved along",
           "sparsefit.backends.osqp_direct:osqp_dual", quadratic=True),
)  # fmt: skip
"""Called without cvxpy."""
CVXPY_PACKAGES = {
    "clarabel": ("clarabel", "clarabel"),
    "osqp": ("osqp", "osqp"),
    "scs": ("scs", "scs"),
    "highs": ("highspy", "highspy"),
    "piqp": ("piqp", EXTRA),
    "daqp": ("daqp", EXTRA),
    "ecos": ("ecos", "ecos"),
    "proxqp": ("proxsuite", "proxsuite"),
    "qoco": ("qoco", "qoco"),
    "cvxopt": ("cvxopt", "cvxopt"),
    "mosek": ("mosek", "mosek"),
    "gurobi": ("gurobipy", "gurobipy"),
}
"""Solver of cvxpy -> its package and what pip installs, for those that it may not find."""
NOT_OFFERED = {"adelie": "adelie pins numpy < 2, which sparsefit needs: they cannot be together"}


def solver_named(name: str) -> Solver | None:
    """The solver of that name, installed or not; None for what is none."""
    folded = name.lower()
    for peer in PEERS:
        if peer.name == folded:
            return peer
    if folded in DIRECT:
        words = "working sets of groups" if folded == DIRECT[1] else "all blocks"
        return Solver(folded, "clarabel", f"Clarabel itself on Z'Z, {words}", plain=False)
    inner = folded.removeprefix(AS_WRITTEN)
    if inner not in CVXPY_PACKAGES and inner not in installed_solvers():
        return None
    package, brought = CVXPY_PACKAGES.get(inner, ("cvxpy", "cvxpy"))
    form = "through cvxpy, as written: m rows" if inner != folded else "through cvxpy, in Z'Z"
    quadratic = inner in QUADRATIC_ONLY
    stops = inner in TOLERANCES
    return Solver(folded, package, form, "", brought, quadratic, plain=False, stops=stops)


def names(exact: str = "") -> list[str]:
    """Names of all solvers that run here, the exact path first."""
    found = installed_solvers()
    peers = [peer.name for peer in PEERS if peer.installed]
    written = [AS_WRITTEN + name for name in found]
    return [*([exact] if exact else []), *DIRECT, *found, *written, *peers]


def check_solver(owner: str, solver: Any, exact: str, *, quadratic: bool, plain: bool) -> None:
    """Raise InputError unless the solver is ``exact`` or one that takes this back-end's problem.

    quadratic: whether the problem is a quadratic program, without cones of group norms; plain:
    whether there is nothing but norms in its penalty. Raises MissingExtra for one that is known
    and not installed.
    """
    if solver in (exact, "clarabel", *DIRECT):  # first: cvxpy takes a second to import
        return
    if not isinstance(solver, str):
        raise InputError(f"{owner}: solver must be a name, not {solver!r}")
    if solver in NOT_OFFERED:
        raise MissingExtra(f"{owner}: {NOT_OFFERED[solver]}")
    known = solver_named(solver)
    if known is None:
        raise unknown(f"solver of {owner} (or it is not installed)", solver, names(exact))
    if known.quadratic and not quadratic:
        what = "penalties of single coefficients" if known.home else "quadratic programs"
        raise InputError(
            f"{owner}: {solver} solves {what} only, and group norms are cones; use "
            f"{exact}, clarabel or another conic solver"
        )
    if known.plain and not plain:
        raise InputError(
            f"{owner}: {solver} takes norms of coefficients or groups alone; use {exact}, "
            "clarabel or another solver that cvxpy finds"
        )
    if not known.installed:
        raise MissingExtra(f"{owner}: {known.remedy}")


def solve_by(
    solver: str,
    problem: RegressionProblem,
    penalty: Penalty,
    alpha_fractions: tuple[float, ...],
    tolerance: float | None = None,
) -> tuple[Solution, ...]:
    """Solutions at descending penalty fractions by a solver that `check_solver` lets pass.

    tolerance: where the solver is to stop, in its own measure; None is sparsefit's choice for
    what solves in Z'Z, and the solver's own for what is written by rows.
    """
    return _solve_of(solver)(problem, penalty, alpha_fractions, tolerance)


def _solve_of(solver: str) -> Solve:
    folded = solver.lower()
    for peer in PEERS:
        if peer.name == folded:
            return partial(_by_peer, peer=peer)
    if folded.startswith(AS_WRITTEN):
        return partial(solve_rows, solver=folded.removeprefix(AS_WRITTEN))
    return partial(_in_gram_form, solver=solver)


def _by_peer(
    problem: RegressionProblem,
    penalty: Penalty,
    alpha_fractions: tuple[float, ...],
    tolerance: float | None,
    *,
    peer: Solver,
) -> tuple[Solution, ...]:
    module, _, function = peer.home.partition(":")
    along = getattr(import_module(module), function)
    return solved(peer.name, problem, penalty, alpha_fractions, along, tolerance)


def _in_gram_form(
    problem: RegressionProblem,
    penalty: Penalty,
    alpha_fractions: tuple[float, ...],
    tolerance: float | None,
    *,
    solver: str,
) -> tuple[Solution, ...]:
    return solve_conic(problem.statistics, penalty, alpha_fractions, solver, tolerance)


def described() -> Iterator[Solver]:
    """Every solver that has a name of its own here, installed or not."""
    yield from (cast(Solver, solver_named(name)) for name in DIRECT)
    for name in CVXPY_PACKAGES:
        yield cast(Solver, solver_named(name))
    yield from PEERS
