"""Interchangeable back-ends: ``get(name, **settings)``.

Those of other packages are found by the entry-point group ``sparsefit.backends``; a plug-in that
cannot be loaded is listed with its error and raises it when asked for, it does not vanish.
"""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from functools import cache
from importlib import import_module
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, cast

from sparsefit.errors import InputError, SparsefitError, unknown
from sparsefit.regression.backend import Backend, Solution, settings_of
from sparsefit.regression.foreign import quiet

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

__all__ = [
    "BACKENDS",
    "PUBLIC",
    "Backend",
    "Solution",
    "distribution",
    "finds_its_own",
    "get",
    "known",
    "load",
    "named",
    "settings_of",
]

BACKENDS: Mapping[str, str] = MappingProxyType(
    {
        "least-squares": "sparsefit.backends.least_squares:LeastSquares",
        "stlsq": "sparsefit.backends.stlsq:STLSQ",
        "lasso": "sparsefit.backends.lasso:Lasso",
        "group-lasso": "sparsefit.backends.group_lasso:GroupLasso",
        "sparse-group-lasso": "sparsefit.backends.sparse_group_lasso:SparseGroupLasso",
        "adaptive-lasso": "sparsefit.backends.adaptive_lasso:AdaptiveLasso",
        "adaptive-group-lasso": "sparsefit.backends.adaptive_group_lasso:AdaptiveGroupLasso",
        "group-mcp": "sparsefit.backends.group_mcp:GroupMCP",
        "square-root-lasso": "sparsefit.backends.square_root_lasso:SquareRootLasso",
        "elastic-net": "sparsefit.backends.elastic_net:ElasticNet",
        "ridge": "sparsefit.backends.ridge:Ridge",
        "gridless-group-lasso": "sparsefit.backends.gridless:GridlessGroupLasso",
        "group-omp": "sparsefit.backends.group_omp:GroupOMP",
        "ensemble": "sparsefit.backends.ensemble:Ensemble",
        "best-subset": "sparsefit.backends.best_subset:BestSubset",
        "best-scale": "sparsefit.backends.best_scale:BestScale",
        "parametric-nls": "sparsefit.backends.parametric_nls:ParametricNLS",
    }
)
"""The back-ends of sparsefit: name -> where the class lives, imported when first asked for."""

PUBLIC: Mapping[str, str] = MappingProxyType({"pysindy": "sparsefit.backends.sindy:PySindy"})
"""Back-ends that are another package's, behind an adapter here; they need the extra ``peers``."""


@cache
def _plugins() -> "Mapping[str, EntryPoint]":
    from importlib.metadata import entry_points  # of no use to our own back-ends, and slow

    return MappingProxyType(
        {
            entry.name: entry
            for entry in entry_points(group="sparsefit.backends")
            if entry.name not in BACKENDS and entry.name not in PUBLIC
        }
    )


def known() -> tuple[str, ...]:
    """Names of all back-ends: sparsefit's own, then the plug-ins."""
    return (*BACKENDS, *sorted(_plugins()))


def distribution(name: str) -> str:
    """`NAME VERSION` of what a plug-in was installed with; nothing for our own and unknown ones."""
    entry = None if name in BACKENDS else _plugins().get(name)
    if entry is None or entry.dist is None:
        return ""
    return f"{entry.dist.name} {entry.dist.version}"


def load(name: str) -> type[Backend]:
    """The class of a back-end. Raises InputError on an unknown name or a plug-in that is broken."""
    home = BACKENDS.get(name) or PUBLIC.get(name)
    if home:
        module, _, attribute = home.partition(":")
        return cast(type[Backend], getattr(import_module(module), attribute))
    if name not in _plugins():
        raise unknown("back-end", name, (*known(), *PUBLIC))
    try:
        with quiet():
            loaded = _plugins()[name].load()
    except (Exception, SystemExit) as error:  # a plug-in may raise anything on import
        raise InputError(
            f"back-end {name!r} (plug-in {_plugins()[name].value}) cannot be loaded: "
            f"{type(error).__name__}: {error}"
        ) from error
    if not (is_dataclass(loaded) and callable(getattr(loaded, "solve", None))):
        raise InputError(
            f"back-end {name!r} (plug-in {_plugins()[name].value}) is not a frozen dataclass with "
            "a `solve` method"
        )
    for needed in ("name", "certificate_kind"):
        if not isinstance(getattr(loaded, needed, None), str):
            raise InputError(
                f"back-end {name!r} (plug-in {_plugins()[name].value}) has no `{needed}`, a text "
                "that its class holds"
            )
    return cast(type[Backend], loaded)


@cache
def finds_its_own(name: str) -> bool:
    """Whether a back-end of sparsefit finds columns of its own instead of choosing from a grid."""
    return name in BACKENDS and hasattr(load(name), "certify")


def get(name: str, **settings: Any) -> Backend:
    """The back-end of that name with these settings.

    Raises InputError on an unknown name, an unknown setting or a value out of range.
    """
    backend = load(name)
    valid = [item.name for item in fields(cast(Any, backend))]
    for key in settings:
        if key not in valid:
            raise unknown(f"setting of {name}", key, valid)
    if name in BACKENDS or name in PUBLIC:
        return backend(**settings)
    return _plugin(name, backend, settings)


def named(backend: Backend | str) -> Backend:
    """The back-end, or the one of that name with its default settings."""
    return get(backend) if isinstance(backend, str) else backend


def _plugin(name: str, backend: type[Backend], settings: Mapping[str, Any]) -> Backend:
    """A plug-in with these settings: it may check none of them itself, or refuse in any words."""
    for item in fields(cast(Any, backend)):
        value = settings.get(item.name)
        if item.type in (int, float, "int", "float") and isinstance(value, str):
            raise InputError(f"{name}: {item.name} must be a number, not {value!r}")
    try:
        with quiet():
            return backend(**settings)
    except SparsefitError:
        raise
    except (TypeError, ValueError) as error:
        raise InputError(f"back-end {name!r} refuses these settings: {error}") from None
