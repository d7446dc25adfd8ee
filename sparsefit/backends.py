"""Interchangeable back-ends: ``get(name, **settings)``, and `fit` and `path` by their names.

Other packages declare theirs in the entry-point group ``sparsefit.backends``; a broken plug-in is
listed with its error, and raises it when requested.
"""

from collections.abc import Mapping
from importlib import import_module
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from sparsefit.errors import InputError, is_integer, shown, unknown
from sparsefit.regression import fit as certified
from sparsefit.regression.answer import Fit, Path
from sparsefit.regression.backend import (
    Backend,
    Solution,
    checked_class,
    imported,
    made,
    plugins,
    settings_of,
)
from sparsefit.regression.fit import TOLERANCE
from sparsefit.regression.fit import path as certified_path
from sparsefit.regression.penalty_choice import FRACTIONS
from sparsefit.regression.problem import RegressionProblem

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

__all__ = [
    "BACKENDS",
    "PUBLIC",
    "Backend",
    "Solution",
    "distribution",
    "fit",
    "get",
    "known",
    "load",
    "named",
    "path",
    "settings_of",
]
BACKENDS: Mapping[str, str] = {
    "least-squares": "sparsefit.solvers.least_squares:LeastSquares",
    "stlsq": "sparsefit.solvers.least_squares:STLSQ",
    "lasso": "sparsefit.solvers.penalised:Lasso",
    "group-lasso": "sparsefit.solvers.penalised:GroupLasso",
    "sparse-group-lasso": "sparsefit.solvers.penalised:SparseGroupLasso",
    "adaptive-lasso": "sparsefit.solvers.penalised:AdaptiveLasso",
    "adaptive-group-lasso": "sparsefit.solvers.penalised:AdaptiveGroupLasso",
    "group-mcp": "sparsefit.solvers.group_mcp:GroupMCP",
    "square-root-lasso": "sparsefit.solvers.penalised:SquareRootLasso",
    "huber-lasso": "sparsefit.solvers.penalised:HuberLasso",
    "slope": "sparsefit.solvers.penalised:Slope",
    "fused-lasso": "sparsefit.solvers.penalised:FusedLasso",
    "box-lasso": "sparsefit.solvers.penalised:BoxLasso",
    "elastic-net": "sparsefit.solvers.penalised:ElasticNet",
    "ridge": "sparsefit.solvers.penalised:Ridge",
    "group-omp": "sparsefit.solvers.searches:GroupOMP",
    "best-scale": "sparsefit.solvers.searches:BestScale",
}
"""The back-ends of sparsefit: name -> module and class, imported at first use."""

PUBLIC: Mapping[str, str] = {"pysindy": "sparsefit.solvers.least_squares:PySindy"}
"""Adapters of back-ends of other packages; they need the extra ``peers``."""


def _plugins() -> "Mapping[str, EntryPoint]":
    return plugins("sparsefit.backends", (*BACKENDS, *PUBLIC))


def known() -> tuple[str, ...]:
    """Names of all back-ends: sparsefit's own, then the plug-ins."""
    return (*BACKENDS, *sorted(_plugins()))


def distribution(name: str) -> str:
    """`NAME VERSION` of the distribution of a plug-in; empty for other names."""
    entry = None if name in BACKENDS else _plugins().get(name)
    return f"{entry.dist.name} {entry.dist.version}" if entry and entry.dist else ""


def load(name: str) -> type[Backend]:
    """The class of a back-end. Raises InputError on an unknown name or a broken plug-in."""
    name = name if isinstance(name, str) else shown(name)
    home = BACKENDS.get(name) or PUBLIC.get(name)
    if home:
        module, _, attribute = home.partition(":")
        return cast(type[Backend], getattr(import_module(module), attribute))
    if name not in _plugins():
        raise unknown("back-end", name, (*known(), *PUBLIC))
    where = f"back-end {name!r} (plug-in {_plugins()[name].value})"
    loaded = imported(where, _plugins()[name].load)
    return cast(type[Backend], checked_class(where, loaded, "solve", "name", "certificate_kind"))


def get(name: str, **settings: Any) -> Backend:
    """The back-end of that name with these settings.

    Raises InputError on an unknown name or setting and on a value out of range.
    """
    backend: Backend = made(name, load(name), settings)
    return backend


def named(backend: Backend | str) -> Backend:
    """The back-end, or the one of that name with its default settings."""
    return get(backend) if isinstance(backend, str) else backend


def fit(
    problem: Any,
    target: Any = None,
    backend: Backend | str | None = None,
    *,
    tolerance: float = TOLERANCE,
    **settings: Any,
) -> Fit:
    """Solve one problem and certify the weights.

    ``fit(problem, backend)``, or ``fit(theta, target, backend)`` with arrays, a frame or a sparse
    matrix and ``groups``, ``subgroups``, ``names``, ``sample_weight`` and ``intercept`` as in
    `RegressionProblem.from_arrays`. backend: an object as from ``backends.get(name, **settings)``,
    or a name, with ``settings`` as keywords. tolerance: the largest certificate, rounding included,
    of status ``ok``; the best weights found are ``inaccurate`` above it. An alpha_fraction of
    "auto" is chosen from a path of 30 penalties, and the fit is its point there. Raises InputError
    on invalid data, names or settings.
    """
    posed, chosen = _posed("fit", problem, target, backend, settings)
    return certified(posed, chosen, tolerance=tolerance)


def path(
    problem: Any,
    target: Any = None,
    backend: Any = None,
    alpha_fractions: Any = FRACTIONS,
    *,
    tolerance: float = TOLERANCE,
    **settings: Any,
) -> Path:
    """Solve along a grid of penalties in any order and certify every point.

    ``path(problem, backend, alpha_fractions)``, or ``path(theta, target, backend,
    alpha_fractions)``; the rest as in `fit`. alpha_fractions: numbers in (0, 1], the penalties as
    fractions of the smallest one whose solution is zero, or the number of points from 1 to 1e-3; 30
    by default. Back-ends without a path are solved point by point. Raises InputError for a back-end
    without a penalty, and as `fit` does.
    """
    if isinstance(problem, RegressionProblem) and backend is not None:
        alpha_fractions, backend = backend, None
    posed, chosen = _posed("path", problem, target, backend, settings)
    if is_integer(alpha_fractions, 2, 10**6):
        alpha_fractions = np.geomspace(1.0, FRACTIONS[-1], int(alpha_fractions))
    return certified_path(posed, chosen, alpha_fractions, tolerance=tolerance)


def _posed(
    verb: str, problem: Any, target: Any, backend: Any, settings: dict[str, Any]
) -> tuple[RegressionProblem, Backend]:
    """The problem and the back-end of a call in either form."""
    about = ("groups", "subgroups", "names", "sample_weight", "intercept")
    given = {key: settings.pop(key) for key in about if key in settings}
    if isinstance(problem, RegressionProblem):
        for key in given:
            raise InputError(f"{verb}: the problem has its {key}: from_arrays takes others")
        if backend is not None:
            raise InputError(f"{verb} takes a problem and a back-end: {verb}(problem, backend)")
        backend = target
    elif isinstance(target, str) or target is None or backend is None:
        words = f"{verb} needs a RegressionProblem and a back-end, or arrays"
        raise InputError(f'{words}: {verb}(theta, target, "lasso", alpha_fraction=0.1)')
    else:
        problem = RegressionProblem.from_arrays(problem, target, **given)
    if settings and not isinstance(backend, str):
        raise InputError(f'{verb}: settings go with a back-end\'s name: {verb}(..., "lasso", ...)')
    return problem, get(backend, **settings) if isinstance(backend, str) else named(backend)
